"""Lines of known frequency in the frames of recordings at held speeds: how large they are there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from crankorder.cause import Cause, CauseKind
from crankorder.engine.machine_parts import MotorLine
from crankorder.identify.found import AgreedOrder
from crankorder.identify.lines.line_phasors import Recording, is_swept, recordings_of
from crankorder.orders.intervals import half_width
from crankorder.orders.joint_lines import LOBE_BINS, Band, HeldFrames, Place, Sighting, joint_lines
from crankorder.orders.joint_lines import NUMBERS as JOINT_LINES
from crankorder.quantities import Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-explain.toml", "known_lines")


class LineSeen(NamedTuple):
    """A known line in one recording: its order, frequency and amplitudes.

    ``also``: other known lines that may stand there; ``also_order``: the order of the shaft that may, or None.
    """

    line: MotorLine
    held: HeldFrames
    hertz: float
    sighting: Sighting
    also: tuple[MotorLine, ...] = ()
    also_order: float | None = None

    @property
    def alone(self) -> bool:
        """Whether nothing else that is known may stand there."""
        return not self.also and self.also_order is None

    @property
    def others(self) -> tuple[str, ...]:
        """Names of what else may stand there."""
        names = [line.name for line in self.also]
        return tuple(dict.fromkeys(names if self.also_order is None else [*names, f"order {self.also_order:g}"]))

    def cause(self, evidence: str) -> Cause:
        """What makes the line, with the ``evidence`` for it: the motor, its field or the supply."""
        lines = {other.name: other for other in self.also}.values()
        others = [Cause(_kind(line), parameters={"name": line.name}) for line in lines]
        return Cause(_kind(self.line), evidence, {"name": self.name}).either(*others)

    @property
    def name(self) -> str:
        """What the line is called: "twice mains", "motor, bar pass"."""
        return self.line.name if _kind(self.line) == "mains" else f"motor, {self.line.name}"


def _kind(line: MotorLine) -> CauseKind:
    if line.turns == 0.0 and not line.of:
        return "mains"
    return "motor" if line.mains == 0 else "field of a motor"


def held_of(frames: Sequence[xr.Dataset], order_map: xr.Dataset) -> list[HeldFrames]:
    """The recordings of ``frames`` (their OrderFrames) at held speeds, of which ``order_map`` is the OrderMap."""
    if order_map.attrs.get("window", "hann") != "hann":
        return []
    return held_recordings(recordings_of(frames), [str(name) for name in order_map["channel"].values])


def held_recordings(recordings: Sequence[Recording], channels: Sequence[str]) -> list[HeldFrames]:
    """Those of ``recordings`` whose speed is known and held, with the names of ``channels``."""
    held = []
    for recording in recordings:
        speed = np.asarray(recording.speed_rpm, dtype=np.float64)
        whole = np.isfinite(recording.spectrum.real).all(axis=(0, 2)) & np.isfinite(speed)
        if np.count_nonzero(whole) < NUMBERS.least_frames or is_swept(speed[whole]):
            continue
        frames = recording.spectrum[:, whole], recording.centre_rev[whole], speed[whole]
        held.append(HeldFrames.of(*frames, revs=recording.revs, channels=channels))
    return held


def sightings(held: HeldFrames, places: Sequence[Place]) -> list[Sighting | None]:
    """What lines at ``places`` are in the recording ``held``, all together; None beyond its orders.

    Those of one neighbourhood are solved together; whole and half orders of the shaft that no place holds take part, so
    that none is taken for a line beside it. Those too close to be told apart have the same sighting.
    """
    orders = np.array([held.order_of(place) for place in places])
    seen: list[Sighting | None] = [None] * len(places)
    inside = [k for k in np.argsort(orders, kind="stable").tolist() if held.reaches(orders[k], orders[k])]
    away = np.diff(orders[inside]) > 4.0 * LOBE_BINS / held.revs
    for group in np.split(np.array(inside, dtype=np.int64), np.flatnonzero(away) + 1) if inside else []:
        head_of = dict[int, int]()  # the first of those that are too close
        for k in group.tolist():
            head_of[k] = next((h for h in head_of.values() if not held.parts(orders[k], orders[h])), k)
        heads = list(dict.fromkeys(head_of.values()))
        own = [places[h] for h in heads]
        band = Band.about(held, float(orders[group].min()), float(orders[group].max()))
        if band is None:
            continue
        lines = joint_lines(band, [*own, *_shaft_orders(held, orders[group], own)])
        of_head = {h: lines.sighting(number) for number, h in enumerate(heads)}
        for k, h in head_of.items():
            seen[k] = replace(of_head[h], order=float(orders[k]))
    return seen


def found_near(
    held: HeldFrames, low_hz: float, high_hz: float, *, known: Sequence[Place] | None = None
) -> tuple[float, float] | None:
    """Frequency in Hz, between ``low_hz`` and ``high_hz``, of the strongest fixed line of ``held`` and its error.

    ``known`` lines are taken out first, the half and whole orders of the shaft where it is None. None where noise would
    make it.
    """
    ends = np.array([held.order_of(Place(hertz)) for hertz in (low_hz, high_hz)])
    band = Band.about(held, *ends.tolist())
    if band is None:
        return None
    taken = _shaft_orders(held, ends, []) if known is None else known
    rest = joint_lines(band, taken).left if taken else band.data
    trial, score = band.periodogram(rest, *ends.tolist(), hertz=0.5 * (low_hz + high_hz))
    if len(trial) < 3:
        return None
    # what lies within a cycle of a line that was taken out is its own rest
    for place in taken:
        score[np.abs(trial - held.order_of(place)) * held.span_rev < JOINT_LINES.apart_cycles] = 0.0
    best = int(np.argmax(score))
    if score[best] <= 0.0 or best in (0, len(trial) - 1):
        return None  # at an end it is the flank of a line beyond
    left, middle, right = score[best - 1 : best + 2]
    bend = left - 2.0 * middle + right  # of the parabola through the three
    shift = np.clip(0.5 * (left - right) / bend, -0.5, 0.5) if bend < 0.0 else 0.0
    frequency = float(trial[best] + shift * (trial[1] - trial[0])) * held.rpm / 60.0
    sighting = sightings(held, [Place(frequency), *(known or ())])[0]
    if sighting is None or not sighting.seen:
        return None
    return frequency, np.sqrt(6.0) / (np.pi * sighting.sigmas * float(np.ptp(held.time_s)))


def _shaft_orders(held: HeldFrames, orders: Floats, own: Sequence[Place]) -> list[Place]:
    """Half and whole orders near ``orders`` that none of the places ``own`` is too close to."""
    reach = 2.0 * LOBE_BINS / held.revs
    low, high = max(0.5, float(orders.min()) - reach), float(orders.max()) + reach
    halves = 0.5 * np.arange(np.ceil(2.0 * low), np.floor(2.0 * high) + 1.0)
    taken = [held.order_of(place) for place in own]
    return [Place(turns=half) for half in halves.tolist() if all(held.parts(half, order) for order in taken)]


def named_by(seen: Sequence[LineSeen], agreed: AgreedOrder) -> LineSeen | None:
    """The one of ``seen`` that the order ``agreed`` is: at its order, in a recording at its speeds.

    Of several, which only lines of a large error have, the one whose amplitudes at the speeds are most like its own.
    """
    unlike: dict[tuple[str, int, float], list[tuple[float, LineSeen]]] = {}
    rpm, sizes = agreed.speed_rpm, np.concatenate([np.zeros(0), *(line.amplitude for line in agreed.lines)])
    for known in seen:
        turns, own_rpm, amplitude = known.line.turns, known.held.rpm, float(known.sighting.amplitude.max())
        there = np.abs(rpm - own_rpm) <= NUMBERS.same_speed_share * own_rpm
        if not there.any() or not _is_at(known, agreed):
            continue
        # it stands at the order at most of the speeds at which that was seen: what is fixed leaves it
        at = turns + (60.0 * known.hertz - turns * own_rpm) / np.unique(rpm)
        if np.mean(np.abs(at - agreed.order) < NUMBERS.same_place_orders) > NUMBERS.most_share:
            away = abs(float(np.log(max(amplitude, 1e-300) / max(float(sizes[there].max()), 1e-300))))
            unlike.setdefault((known.line.name, known.line.mains, turns), []).append((away, known))
    if not unlike:
        return None
    best = min(unlike.values(), key=lambda sightings: float(np.mean([away for away, _ in sightings])))
    return max((known for _, known in best), key=lambda known: float(known.sighting.amplitude.max()))


def _is_at(known: LineSeen, agreed: AgreedOrder) -> bool:
    """Whether ``known`` is ``agreed``; a locked one is, if it is a whole order of the rotor, or where both are said."""
    away, apart = abs(known.sighting.order - agreed.order), JOINT_LINES.apart_cycles
    if agreed.lock == "locked":
        exact = known.line.mains == 0 and not known.line.of
        return away * known.held.span_rev < apart and (exact or not known.alone)
    return bool(away <= max(half_width(agreed.degrees_of_freedom) * agreed.order_error, apart / known.held.span_rev))
