"""Lines of known frequency in the frames of recordings at held speeds: how large they are there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.cause import Cause, CauseKind
from crankorder.engine.machine_parts import MotorLine
from crankorder.identify.found import AgreedOrder, ModalFit
from crankorder.identify.intervals import half_width
from crankorder.identify.lines.line_phasors import Recording, is_swept, recordings_of
from crankorder.orders.track_rows import hann_lobe
from crankorder.quantities import Complexes, Floats, Ints
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-explain.toml", "known_lines")


LOBE_BINS = 2.0
"""Reciprocal frame lengths on each side of a line that the main lobe of a Hann window covers."""

BESIDE_CYCLES = tuple(range(2, 14))
"""Where the noise beside a line is looked at, on both sides, in cycles per recording."""

GRID_CYCLES = 0.25
"""Step of the search for a frequency, in cycles per recording: between two of them a line loses at most 10 %."""

Place = tuple[float, float]
"""A line as the frequency in Hz that stays and the order of the shaft that it has beside it."""


@dataclass(frozen=True, eq=False)
class Held:
    """Frames of a recording at one speed: ``spectrum`` (channels, frames, bins) of the orders ``axis`` (bins,).

    ``turn`` (frames,) is the crank angle in rev of the middle of each, ``time_s`` when that was; ``revs`` their length;
    ``rpm`` the mean speed; ``channels`` names.
    """

    spectrum: NDArray[np.complexfloating]
    axis: Floats
    turn: Floats
    time_s: Floats
    revs: float
    rpm: float
    channels: tuple[str, ...]

    @cached_property
    def pace_s(self) -> Floats:
        """Seconds that a revolution takes at each frame (frames, 1)."""
        return np.asarray(np.gradient(self.time_s, self.turn)[:, None])

    @cached_property
    def span_rev(self) -> float:
        """Revolutions from the middle of the first frame to that of the last, and a frame more."""
        return float(np.ptp(self.turn)) + self.revs

    def order_of(self, place: Place) -> float:
        """Order at the mean speed of a line at ``place``."""
        return place[1] + place[0] * 60.0 / self.rpm

    def is_half(self, order: float) -> bool:
        """Whether a line at ``order`` lies so near a half or whole order that the recording does not part them."""
        return bool(abs(2.0 * order - round(2.0 * order)) * self.span_rev < NUMBERS.apart_cycles)

    def hides(self, hertz: float) -> bool:
        """Whether a whole or half order of the shaft stands at ``hertz``, so that nothing else is seen."""
        order = self.order_of((hertz, 0.0))
        return bool(abs(2.0 * order - round(2.0 * order)) * 0.5 * self.span_rev < NUMBERS.apart_cycles)


@dataclass(frozen=True, eq=False)
class Sighting:
    """A line at ``order`` of a recording: peak ``amplitude`` (channels,), and its standard ``error`` along one axis.

    ``order_error`` is the standard error of the order (at the mean speed), 0 where the place was known.
    """

    order: float
    amplitude: Floats
    error: Floats
    order_error: float = 0.0

    @property
    def sigmas(self) -> float:
        """Amplitude over its error in the channel that shows it best."""
        return float(np.max(self.amplitude / np.maximum(self.error, 1e-300)))

    @property
    def seen(self) -> bool:
        """Whether noise would not make it."""
        return bool(self.sigmas > NUMBERS.seen_sigmas)


@dataclass(frozen=True, eq=False)
class LineSeen:
    """A known line in one recording: its order, frequency and amplitudes.

    ``also``: other known lines that may stand there; ``also_order``: the order of the shaft that may, or None.
    """

    line: MotorLine
    held: Held
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


def held_of(frames: Sequence[xr.Dataset], order_map: xr.Dataset) -> list[Held]:
    """The recordings of ``frames`` (their OrderFrames) at held speeds, with the orders of ``order_map``."""
    if order_map.attrs.get("window", "hann") != "hann":
        return []
    names = [str(name) for name in order_map["channel"].values]
    return held_recordings(recordings_of(frames), np.asarray(order_map["order"].values, dtype=np.float64), names)


def held_recordings(recordings: Sequence[Recording], axis: Floats, channels: Sequence[str]) -> list[Held]:
    """Those of ``recordings`` whose speed is known and held, with the orders ``axis`` and the names of ``channels``."""
    held = []
    for recording in recordings:
        speed = np.asarray(recording.speed_rpm, dtype=np.float64)
        whole = np.isfinite(recording.spectrum.real).all(axis=(0, 2)) & np.isfinite(speed)
        if np.count_nonzero(whole) < NUMBERS.least_frames or is_swept(speed[whole]):
            continue
        turn, speed = recording.centre_rev[whole], speed[whole]
        pace = 60.0 / speed
        time_s = np.concatenate([[0.0], np.cumsum(0.5 * (pace[1:] + pace[:-1]) * np.diff(turn))])
        rpm = 60.0 * float(np.ptp(turn)) / float(time_s[-1])
        held.append(Held(recording.spectrum[:, whole], axis, turn, time_s, recording.revs, rpm, tuple(channels)))
    return held


def sightings(held: Held, places: Sequence[Place]) -> list[Sighting | None]:
    """What lines at ``places`` are in the recording ``held``, all together; None beyond its orders.

    Least squares over the frames and the bins that the lines reach, all of one neighbourhood together; whole and half
    orders of the shaft that no place holds take part, so that none is taken for a line beside it. The error is told
    by the same fit of what is left at places close by, where no line is known: what a carrier that wanders sets beside
    itself counts as noise.
    """
    orders = np.array([held.order_of(place) for place in places])
    found: list[Sighting | None] = [None] * len(places)
    top = float(held.axis[-1]) - LOBE_BINS / held.revs
    free = {k for k in range(len(places)) if LOBE_BINS / held.revs < orders[k] < top}
    while free:
        group = _neighbours(min(free, key=lambda k: orders[k]), free, orders, 4.0 * LOBE_BINS / held.revs)
        free -= set(group)
        for k, sighting in zip(group, _fitted(held, [places[k] for k in group]), strict=True):
            found[k] = sighting
    return found


def found_near(
    held: Held, low_hz: float, high_hz: float, *, known: Sequence[Place] | None = None
) -> tuple[float, float] | None:
    """Frequency in Hz, between ``low_hz`` and ``high_hz``, of the strongest fixed line of ``held`` and its error.

    ``known`` lines are taken out first, the half and whole orders of the shaft where it is None. None where noise would
    make it.
    """
    step = GRID_CYCLES / max(float(np.ptp(held.time_s)), 1e-9)
    trial = np.arange(low_hz, high_hz + step, step)
    taken = _shaft_orders(held, [(low_hz, 0.0), (high_hz, 0.0)], []) if known is None else known
    near = bins_of(held, np.array([held.order_of((f, 0.0)) for f in (low_hz, high_hz)]))
    if not near.size or len(trial) < 3:
        return None
    rest = data_of(held, near)
    if taken:
        waves = waves_of(held, near, taken)
        rest = rest - waves @ np.linalg.lstsq(waves, rest, rcond=None)[0]
    shapes = waves_of(held, near, [(float(f), 0.0) for f in trial])
    gain = np.maximum(np.square(np.abs(shapes)).sum(axis=0), 1e-12)
    power = np.square(np.abs(shapes.conj().T @ rest)) / gain[:, None]
    total = np.maximum(np.square(np.abs(rest)).sum(axis=0), 1e-300)
    score = (power / total).sum(axis=1)
    # what lies within a cycle of a line that was taken out is its own rest
    own = np.array([held.order_of((float(f), 0.0)) for f in trial])
    for place in taken:
        score[np.abs(own - held.order_of(place)) * held.span_rev < NUMBERS.apart_cycles] = 0.0
    best = int(np.argmax(score))
    if score[best] <= 0.0 or best in (0, len(trial) - 1):
        return None  # at an end it is the flank of a line beyond
    frequency = _summit(trial, score, best)
    sighting = sightings(held, [(frequency, 0.0), *(known or ())])[0]
    if sighting is None or not sighting.seen:
        return None
    return frequency, np.sqrt(6.0) / (np.pi * sighting.sigmas * float(np.ptp(held.time_s)))


def _summit(trial: Floats, score: Floats, best: int) -> float:
    """Top of the parabola through three points of ``score``."""
    left, middle, right = score[best - 1 : best + 2]
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(trial[best] + np.clip(shift, -0.5, 0.5) * (trial[1] - trial[0]))


def _neighbours(first: int, free: set[int], orders: Floats, reach: float) -> list[int]:
    """Those of ``free`` that stand in one chain with ``first``, no link longer than ``reach``."""
    chain = [first]
    for k in sorted(free - {first}, key=lambda k: orders[k]):
        if orders[k] - orders[chain[-1]] <= reach:
            chain.append(k)
        elif orders[k] > orders[chain[-1]]:
            break
    return chain


def _fitted(held: Held, places: list[Place]) -> list[Sighting]:
    """Sightings of ``places`` that stand together; those too close to be told apart have the same one."""
    orders = np.array([held.order_of(place) for place in places])
    heads: list[int] = []
    head_of = []
    for k in range(len(places)):
        same = [h for h in heads if abs(orders[k] - orders[h]) * held.span_rev < NUMBERS.apart_cycles]
        heads += [] if same else [k]
        head_of.append(same[0] if same else k)
    own = [places[h] for h in heads]
    everything = [*own, *_shaft_orders(held, places, own)]
    bins = bins_of(held, orders)
    waves, data = waves_of(held, bins, everything), data_of(held, bins)
    amplitude = np.linalg.lstsq(waves, data, rcond=None)[0]
    left = data - waves @ amplitude
    all_orders = np.array([held.order_of(place) for place in everything])
    errors = {h: noise_beside(held, bins, places[h], left, all_orders) for h in heads}
    size = {h: np.abs(amplitude[number]) for number, h in enumerate(heads)}
    return [Sighting(float(orders[k]), size[h], errors[h]) for k, h in enumerate(head_of)]


def noise_beside(
    held: Held, bins: Ints, place: Place, left: Complexes, lines: Floats, *, median: bool = False
) -> Floats:
    """Root mean square along one axis (channels,) of what a line beside ``place`` would be in what is ``left``.

    ``left`` (frames x bins, channels) is of ``bins`` of ``held`` without the ``lines`` (orders), beside which
    nothing is looked at; by the ``median`` of the places where other lines may still be left.
    """
    seconds = held.span_rev * 60.0 / held.rpm
    beside = [(place[0] + side * cycles / seconds, place[1]) for cycles in BESIDE_CYCLES for side in (-1.0, 1.0)]
    apart = [np.min(np.abs(held.order_of(other) - lines)) * held.span_rev for other in beside]
    clear = [other for other, away in zip(beside, apart, strict=True) if away >= NUMBERS.apart_cycles]
    shapes = waves_of(held, bins, clear or beside)
    gain = np.maximum(np.square(np.abs(shapes)).sum(axis=0), 1e-12)
    power = np.square(np.abs(shapes.conj().T @ left) / gain[:, None])
    mean = np.median(power, axis=0) / np.log(2.0) if median else power.mean(axis=0)
    return np.asarray(np.sqrt(0.5 * mean))


def _shaft_orders(held: Held, places: Sequence[Place], own: Sequence[Place]) -> list[Place]:
    """Half and whole orders near ``places`` that none of ``own`` is too close to."""
    orders = np.array([held.order_of(place) for place in places])
    reach = 2.0 * LOBE_BINS / held.revs
    low, high = max(0.5, float(orders.min()) - reach), float(orders.max()) + reach
    halves = 0.5 * np.arange(np.ceil(2.0 * low), np.floor(2.0 * high) + 1.0)
    taken = np.array([held.order_of(place) for place in own])
    apart = np.abs(taken - halves[:, None]).min(axis=1, initial=np.inf) * held.span_rev
    return [(0.0, half) for half in halves[apart >= NUMBERS.apart_cycles].tolist()]


def bins_of(held: Held, orders: Floats) -> Ints:
    """Bins of ``held`` that lines between the least and the largest of ``orders`` reach."""
    reach = LOBE_BINS / held.revs
    return np.flatnonzero((held.axis >= orders.min() - reach) & (held.axis <= orders.max() + reach))


def data_of(held: Held, bins: Ints) -> Complexes:
    """Phasors (frames x bins, channels) of ``held`` in ``bins``."""
    chosen = held.spectrum[:, :, bins]
    return np.asarray(chosen.reshape(len(chosen), -1).T, dtype=np.complex128)


def waves_of(held: Held, bins: Ints, places: Sequence[Place]) -> Complexes:
    """What lines of amplitude 1 at ``places`` are in the frames and ``bins`` of ``held``: (frames x bins, places).

    A line x reciprocal frame lengths from a bin is seen there by the response of the Hann window, sinc x / (1 - x²),
    and turns from frame to frame with its own phase less that of the bin.
    """
    axis, turn = held.axis[bins], held.turn[:, None]
    hertz, turns = np.array(places, dtype=np.float64).reshape(-1, 2).T
    away = ((turns + hertz * held.pace_s)[:, None] - axis[:, None]) * held.revs
    phase, of_bin = turns * turn + hertz * held.time_s[:, None], axis * turn
    waves, back = (np.exp(2j * np.pi * (turned - np.floor(turned))) for turned in (phase, of_bin))
    waves_in: Complexes = hann_lobe(away) * (waves[:, None] * back.conj()[..., None])
    return waves_in.reshape(-1, len(places))


def named_by(seen: Sequence[LineSeen], agreed: AgreedOrder) -> LineSeen | None:
    """The one of ``seen`` that the order ``agreed`` is: at its order, in a recording at its speeds.

    Of several, which only lines of a large error have, the one whose amplitudes at the speeds are most like its own.
    """
    unlike: dict[tuple[str, int, float], list[tuple[float, LineSeen]]] = {}
    for known in seen:
        size = _size_at(agreed, known.held.rpm)
        if size is None or not _is_at(known, agreed) or not _goes_with(known, agreed):
            continue
        away = abs(float(np.log(max(float(known.sighting.amplitude.max()), 1e-300) / max(size, 1e-300))))
        unlike.setdefault((known.line.name, known.line.mains, known.line.turns), []).append((away, known))
    if not unlike:
        return None
    best = min(unlike.values(), key=lambda sightings: float(np.mean([away for away, _ in sightings])))
    return max((known for _, known in best), key=lambda known: float(known.sighting.amplitude.max()))


def _size_at(agreed: AgreedOrder, rpm: float) -> float | None:
    """Largest amplitude of an order at the speed ``rpm``; None where it was not seen there."""
    near = NUMBERS.same_speed_share * rpm
    there = (line.amplitude[np.abs(line.speed_rpm - rpm) <= near] for line in agreed.lines)
    return max((float(size) for sizes in there for size in sizes), default=None)


def _is_at(known: LineSeen, agreed: AgreedOrder) -> bool:
    """Whether ``known`` is ``agreed``; a locked one is, if it is a whole order of the rotor, or where both are said."""
    away, apart = abs(known.sighting.order - agreed.order), NUMBERS.apart_cycles
    if agreed.lock == "locked":
        exact = known.line.mains == 0 and not known.line.of
        return away * known.held.span_rev < apart and (exact or not known.alone)
    return bool(away <= max(half_width(agreed.degrees_of_freedom) * agreed.order_error, apart / known.held.span_rev))


def _goes_with(known: LineSeen, agreed: AgreedOrder) -> bool:
    """Whether ``known`` stands at the order at most of the speeds at which that was seen: what is fixed leaves it."""
    fixed_hz = known.hertz - known.line.turns * known.held.rpm / 60.0
    speeds = np.unique(np.concatenate([line.speed_rpm for line in agreed.lines]))
    at = known.line.turns + 60.0 * fixed_hz / speeds
    return bool(np.mean(np.abs(at - agreed.order) < NUMBERS.same_place_orders) > NUMBERS.most_share)


def without_known(modal: ModalFit, known: Sequence[LineSeen]) -> ModalFit:
    """``modal`` without modes that are undecided and stand where one of the ``known`` lines does: these explain them.

    Only where no order's response was fitted through the modes: there each of them takes part in what is said.
    """
    if modal.responses or not known:
        return modal
    kept = [
        number
        for number, mode in enumerate(modal.modes)
        for low, high in [(mode.frequency_ends[0] - NUMBERS.same_hz, mode.frequency_ends[1] + NUMBERS.same_hz)]
        if not mode.undecided or not any(low <= seen.hertz <= high for seen in known)
    ]
    at = np.array([[2 * number, 2 * number + 1] for number in kept], dtype=np.int64).ravel()
    covariance = modal.covariance[np.ix_(at, at)] if len(kept) < len(modal.modes) else modal.covariance
    return replace(modal, modes=tuple(modal.modes[number] for number in kept), covariance=covariance)
