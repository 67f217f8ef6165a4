"""Lines that single recordings tell apart: orders from what stays at speeds that differ little, and tones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from crankorder.identify.found import AgreedOrder, AgreedOrders, Doubt, ModalFit, Tone
from crankorder.identify.lines.known_lines import NUMBERS as KNOWN_LINES
from crankorder.identify.lines.known_lines import LineSeen, found_near
from crankorder.identify.lines.line_phasors import lock_of, nearest_multiple
from crankorder.identify.lines.mains import NUMBERS as MAINS
from crankorder.identify.lines.mains import multiples_near, shown_amplitudes, with_mains_tones
from crankorder.identify.lines.several_orders import (
    lines_of_sightings,
    lines_within,
    several_lines,
    unparted_reach,
)
from crankorder.identify.modes.tones import NEAR_BINS, times_mains, with_one_mains
from crankorder.orders.intervals import Z95
from crankorder.orders.joint_lines import LOBE_BINS, HeldFrames, Place, Sighting
from crankorder.orders.joint_lines import NUMBERS as JOINT_LINES
from crankorder.settings import IdentifySettings

PARTED = "parted by each of {} recordings, in which the orders of the shaft move and it does not"


@dataclass(frozen=True, eq=False)
class _Parted:
    """One line of a test as several recordings hold it: at ``hertz`` (at the speed of each) or at an ``order``."""

    fixed: bool
    seen: tuple[tuple[HeldFrames, Sighting], ...]

    @property
    def places(self) -> np.ndarray:
        """Frequency in Hz of what stays, order of what goes with the shaft, by recording."""
        return np.array([line.order * (held.rpm / 60.0 if self.fixed else 1.0) for held, line in self.seen])

    @property
    def degrees_of_freedom(self) -> float:
        """Of the errors of the line in a recording, at least."""
        return min(line.degrees_of_freedom for _, line in self.seen)

    @property
    def error(self) -> float:
        """Standard error of the mean place, by the lines' own errors and their scatter."""
        own = [line.order_error * (held.rpm / 60.0 if self.fixed else 1.0) for held, line in self.seen]
        n = len(own)
        return float(np.hypot(np.sqrt(np.sum(np.square(own))) / n, self.places.std() / np.sqrt(max(n - 1, 1))))


def with_tones_settled(
    orders: AgreedOrders,
    modal: ModalFit,
    held: Sequence[HeldFrames],
    known: Sequence[LineSeen],
    order_map: xr.Dataset,
    *,
    parted: Sequence[HeldFrames],
    settings: IdentifySettings,
) -> tuple[AgreedOrders, ModalFit]:
    """``orders`` and ``modal`` with each tone as the recordings hold it: one line or several, mains, or an order.

    ``held`` are the recordings at held speeds, ``parted`` those whose angle comes from pulses; ``known`` lines of the
    mains; ``order_map`` that of the test; ``settings``: the mains frequencies and how far they wander.
    """
    modal = with_tones_parted(modal, held)
    orders, modal = with_lines_of_recordings(orders, modal, parted, order_map, settings=settings)
    modal = without_absent_mains(with_mains_tones(modal, known, orders), held, settings=settings)
    return orders, without_doubles(replace(modal, tones=with_one_mains(list(modal.tones), settings=settings)))


def with_lines_of_recordings(
    orders: AgreedOrders,
    modal: ModalFit,
    held: Sequence[HeldFrames],
    order_map: xr.Dataset,
    *,
    settings: IdentifySettings,
) -> tuple[AgreedOrders, ModalFit]:
    """``orders`` and ``modal`` where tones stand that the map holds as one with others, or that may be orders.

    A bin of the map is wider than an order moves between speeds that differ by some percent: there two lines are one,
    and what is left of an order at all speeds looks fixed. The recordings ``held`` are long enough to part them. About
    every tone the lines of each are solved together; what has one frequency in all of them is a tone, what has one
    order is an order. Where a recording shows a line that is neither, or no set of steady lines, all stays as it was.

    Parameters
    ----------
    orders : those that were agreed on, told by pulses
    modal : tones of the map
    held : recordings at held speeds, all of the test; where a speed is swept nothing is done
    order_map : OrderMap of the test
    settings : ``mode_speed_ratio``, up to which speeds differ little, and the mains
    """
    speeds = [recording.rpm for recording in held]
    if len(held) < 2 or not modal.step_hz or max(speeds) > settings.mode_speed_ratio * min(speeds):
        return orders, modal
    regions = _regions(modal.tones, NEAR_BINS * modal.step_hz)
    parted_in = {region: lines for region in regions if (lines := _parted(held, *region))}
    if not parted_in:
        return orders, modal
    tones, agreed = list(modal.tones), list(orders)
    for (low, high), lines in parted_in.items():
        tones = [tone for tone in tones if not low <= tone.frequency_hz <= high]
        tones += [tone for line in lines if line.fixed and (tone := _tone(line, settings)).amplitude]
        agreed = _with_orders(agreed, [line for line in lines if not line.fixed], (low, high), held, order_map)
    tones.sort(key=lambda tone: tone.frequency_hz)
    parted = replace(modal, tones=with_one_mains(tones, settings=settings))
    return tuple(sorted(agreed, key=lambda order: order.order)), parted


def _regions(tones: Sequence[Tone], reach_hz: float) -> list[tuple[float, float]]:
    """Bands in Hz about the ``tones``, those that meet joined."""
    bands: list[tuple[float, float]] = []
    for hertz in sorted(tone.frequency_hz for tone in tones):
        low, high = hertz - reach_hz, hertz + reach_hz
        if bands and low <= bands[-1][1]:
            bands[-1] = (bands[-1][0], high)
        else:
            bands.append((low, high))
    return bands


def _parted(held: Sequence[HeldFrames], low_hz: float, high_hz: float) -> list[_Parted]:
    """Lines between both frequencies as the recordings agree on them; none where they do not, or do not tell."""
    solved = [
        (run, lines)
        for run in held
        if (lines := lines_within(run, low_hz / (run.rpm / 60.0), high_hz / (run.rpm / 60.0)))
    ]
    if len(solved) < MAINS.least_speeds:
        return []
    free = {(k, n) for k, (_, lines) in enumerate(solved) for n in range(len(lines))}
    parted: list[_Parted] = []
    while free:
        first = max(free, key=lambda at: solved[at[0]][1][at[1]].sigmas)
        chains = [_chain(solved, first, free, (low_hz, high_hz), fixed=fixed) for fixed in (True, False)]
        whole = [chain for chain in chains if chain is not None]
        if len(whole) != 1:  # neither, or both: the speeds are too alike for the length of the recordings
            return []
        fixed = chains[0] is not None
        parted.append(_Parted(fixed, tuple((solved[k][0], solved[k][1][n]) for k, n in whole[0])))
        free -= set(whole[0])
    return parted


def _chain(
    solved: Sequence[tuple[HeldFrames, list[Sighting]]],
    first: tuple[int, int],
    free: Iterable[tuple[int, int]],
    band_hz: tuple[float, float],
    *,
    fixed: bool,
) -> list[tuple[int, int]] | None:
    """The ``first`` line (recording, number) in all recordings, at its frequency or its order; None if one lacks it.

    A recording in which another line stands where it would be may lack it, and so may one at whose speed it would lie
    outside the band: a line of one recording alone is an order where it is a half or whole one.
    """
    own, line = solved[first[0]][0], solved[first[0]][1][first[1]]
    chain = [first]
    for k, (held, lines) in enumerate(solved):
        if k == first[0]:
            continue
        wanted = line.order * own.rpm / held.rpm if fixed else line.order
        room = 0.5 * JOINT_LINES.apart_cycles / min(held.span_rev, own.span_rev)
        if fixed:
            room = max(room, KNOWN_LINES.same_hz * 60.0 / held.rpm)
        near = [n for n in range(len(lines)) if (k, n) in free and abs(lines[n].order - wanted) <= room]
        hidden = any(abs(other.order - wanted) * held.span_rev < 2.0 * JOINT_LINES.apart_cycles for other in lines)
        low, high = (wanted - room) * held.rpm / 60.0, (wanted + 2.0 * room) * held.rpm / 60.0
        outside = not band_hz[0] < low < high < band_hz[1]
        if near:
            chain.append((k, min(near, key=lambda n: abs(lines[n].order - wanted))))
        elif not hidden and not outside:
            return None
    return chain if len(chain) >= MAINS.least_speeds or (not fixed and own.is_half(line.order)) else None


def _tone(parted: _Parted, settings: IdentifySettings) -> Tone:
    """The fixed line ``parted``, in the channels that show it; mains where it may be."""
    hertz, error = float(parted.places.mean()), parted.error
    amplitude = shown_amplitudes(parted.seen)
    near = multiples_near(hertz, error, settings=settings)
    words = f"no damping, {times_mains(*near[0])}" if near else "no damping"
    return Tone(hertz, error, "mains" if near else "tone", amplitude, f"{words}; {PARTED.format(len(parted.seen))}")


def _with_orders(
    orders: list[AgreedOrder],
    parted: Sequence[_Parted],
    band_hz: tuple[float, float],
    held: Sequence[HeldFrames],
    order_map: xr.Dataset,
) -> list[AgreedOrder]:
    """``orders`` and those ``parted`` in the band that are not among them, without those that no recording has."""
    kept: list[AgreedOrder] = []
    places = [float(line.places.mean()) for line in parted]
    room = JOINT_LINES.apart_cycles / min(recording.span_rev for recording in held)
    for agreed in orders:
        in_band = all(band_hz[0] <= agreed.order * recording.rpm / 60.0 <= band_hz[1] for recording in held)
        if not in_band or any(abs(agreed.order - place) < room for place in places):
            kept.append(agreed)
    new = [
        line
        for line, place in zip(parted, places, strict=True)
        if len(line.seen) >= MAINS.least_speeds and not any(abs(agreed.order - place) < room for agreed in kept)
    ]
    return kept + [_agreed(line, order_map) for line in new]


def _agreed(parted: _Parted, order_map: xr.Dataset) -> AgreedOrder:
    """The order ``parted`` with a line for each channel that shows it."""
    turns = int(order_map.attrs["revs_per_cycle"])
    order, error, freedom = float(parted.places.mean()), parted.error, parted.degrees_of_freedom
    lock = lock_of(order, error, freedom, revs_per_cycle=turns, by_phase=True)
    if lock == "locked":
        exact = nearest_multiple(order, revs_per_cycle=turns)
        order, error = exact, max(error, abs(order - exact) / Z95)
    doubt = Doubt("close lines", f"{len(parted.seen)} recordings part it from what stands beside it")
    lines = lines_of_sightings(parted.seen, (order, error), order_map)
    return AgreedOrder(order, error, freedom, lock, None, lines, (doubt,))


UNPARTED = "several lines that the recordings are too short to part, or one that swells"
"""What is said of a tone that is no single steady line."""


def with_tones_parted(modal: ModalFit, held: Sequence[HeldFrames]) -> ModalFit:
    """``modal`` without tones that are the flank of a stronger one, and with intervals that hold all lines of a tone.

    Lines closer than the main lobe of the map's window are one there; what the fit of the stronger leaves beside it is
    a tone only where the longest of the recordings ``held`` shows a line. Where that shows several within a bin of a
    tone, its interval holds all of them and its evidence names them; where it shows that the tone is no single line and
    does not part it, the intervals of frequency and amplitude are as wide as that leaves open.
    """
    step = modal.step_hz
    if not step or not modal.tones:
        return modal
    longest = max(held, key=lambda recording: recording.span_rev, default=None)
    lines = {tone.frequency_hz: _lines_near(longest, tone.frequency_hz, NEAR_BINS * step) for tone in modal.tones}
    kept = [
        tone
        for tone in modal.tones
        if any(abs(hertz - tone.frequency_hz) < 0.5 * step for hertz in lines[tone.frequency_hz])
        or not any(_is_flank(tone, other, NEAR_BINS * step) for other in modal.tones)
    ]
    centres = [tone.frequency_hz for tone in kept]
    tones = []
    for tone in kept:
        near = [f for f in lines[tone.frequency_hz] if abs(f - tone.frequency_hz) <= step]
        own = [f for f in near if min(centres, key=lambda centre: abs(centre - f)) == tone.frequency_hz]
        held_of_it = _holding(tone, own) if len(own) > 1 else tone
        tones.append(held_of_it if near else _unless_several(held_of_it, centres, longest, NEAR_BINS * step))
    return replace(modal, tones=tuple(tones))


def without_absent_mains(modal: ModalFit, held: Sequence[HeldFrames], *, settings: IdentifySettings) -> ModalFit:
    """``modal`` with higher multiples of the mains called tones where one of the recordings ``held`` has none there.

    A supply is there at every speed; what stands near one of its many multiples at some speeds is something else, but
    where it is the exact multiple of a supply that the test shows: a weak one is not seen in every recording. What may
    be mains or an order is an order where most recordings whose shaft has none there do not show it.
    ``settings``: the mains frequencies and how far they wander.
    """
    if not modal.step_hz:
        return modal
    mains = [tone for tone in modal.tones if tone.kind == "mains"]
    alone_hz = MAINS.alone_multiples * max(settings.mains_hz) + 2.0 * settings.mains_tolerance_hz
    supplies = [tone for tone in mains if not tone.frequency_hz > alone_hz]
    high = [tone for tone in mains if tone not in supplies]
    doubted = [tone for tone in high if not any(_is_multiple(tone, supply, settings) for supply in supplies)]
    doubted += [tone for tone in modal.tones if tone.kind == "mains or order"]
    tones = [_unless_absent(tone, held, modal.step_hz) if tone in doubted else tone for tone in modal.tones]
    return replace(modal, tones=tuple(tones))


def _is_multiple(tone: Tone, supply: Tone, settings: IdentifySettings) -> bool:
    """Whether ``tone`` is, within the errors of both, a whole multiple of what ``supply`` is one of."""
    for own, _ in multiples_near(supply.frequency_hz, supply.frequency_error_hz, settings=settings):
        times = round(tone.frequency_hz / supply.frequency_hz * own) / own
        error = np.hypot(tone.frequency_error_hz, times * supply.frequency_error_hz)
        if abs(tone.frequency_hz - times * supply.frequency_hz) <= Z95 * error:
            return True
    return False


def _unless_absent(tone: Tone, held: Sequence[HeldFrames], reach_hz: float) -> Tone:
    """``tone``, or no mains where a recording has none there although no order of its shaft hides the place.

    What may be an order as well is no mains where most of such recordings have none.
    """
    place = tone.frequency_hz
    inside = [run for run in held if run.reaches(1.0, run.order_of(Place(place + reach_hz)))]
    inside = [run for run in inside if not run.is_half(run.order_of(Place(place)))]
    shown = sum(found_near(run, place - reach_hz, place + reach_hz) is not None for run in inside)
    either = tone.kind == "mains or order"
    if not inside or shown >= (0.5 if either else 1.0) * len(inside):
        return tone
    words = f"{tone.evidence if either else 'no damping'}; {shown} of {len(inside)} recordings show it"
    return replace(tone, kind="order" if either else "tone", evidence=words)


def _is_flank(tone: Tone, other: Tone, reach_hz: float) -> bool:
    size, more = (max(value for value, _ in line.amplitude.values()) for line in (tone, other))
    return size < more and abs(tone.frequency_hz - other.frequency_hz) < reach_hz


def _unless_several(tone: Tone, centres_hz: Sequence[float], held: HeldFrames | None, reach_hz: float) -> Tone:
    """``tone``, or with wide intervals where ``held`` shows several lines there that it does not part.

    ``centres_hz``: all tones, which take part where they are within ``reach_hz``.
    """
    if held is None:
        return tone
    turn_hz = held.rpm / 60.0
    low, high = (tone.frequency_hz - reach_hz) / turn_hz, (tone.frequency_hz + reach_hz) / turn_hz
    if not held.reaches(low, high) or several_lines(held, low, high, beyond=LOBE_BINS / held.revs):
        return tone
    orders = [hertz / turn_hz for hertz in centres_hz if abs(hertz - tone.frequency_hz) <= reach_hz]
    halves = 0.5 * np.arange(np.ceil(2.0 * low), np.floor(2.0 * high) + 1.0)
    orders += [half for half in halves.tolist() if _beside(half, orders) * held.span_rev > JOINT_LINES.apart_cycles]
    ends = unparted_reach(held, low, high, orders)
    if ends is None:
        return tone
    far = max(abs(end * turn_hz - tone.frequency_hz) for end in ends)
    words = f"{tone.evidence}; {UNPARTED}"
    amplitude = {name: (size, max(error, size / Z95)) for name, (size, error) in tone.amplitude.items()}
    error = max(tone.frequency_error_hz, far / Z95)
    return replace(tone, frequency_error_hz=error, amplitude=amplitude, evidence=words)


def _beside(order: float, orders: Sequence[float]) -> float:
    return min(abs(order - other) for other in orders)


def _lines_near(held: HeldFrames | None, hertz: float, reach_hz: float) -> list[float]:
    """Frequencies in Hz of the lines of ``held`` within ``reach_hz`` that are no half orders of its shaft."""
    if held is None:
        return []
    turn_hz = held.rpm / 60.0
    orders = [line.order for line in lines_within(held, (hertz - reach_hz) / turn_hz, (hertz + reach_hz) / turn_hz)]
    return [order * turn_hz for order in orders if not held.is_half(order)]


def _holding(tone: Tone, hertz: Sequence[float]) -> Tone:
    """``tone`` with an interval that holds all lines at ``hertz``, of which it is made."""
    far = max(abs(hz - tone.frequency_hz) for hz in hertz)
    named = " and ".join(f"{hz:.6g}" for hz in sorted(hertz))
    words = f"{tone.evidence}; more than one line: the longest recording parts {named} Hz"
    error = max(tone.frequency_error_hz, 1.05 * far / Z95)
    return replace(tone, frequency_error_hz=error, evidence=words)


def without_doubles(modal: ModalFit) -> ModalFit:
    """``modal`` without tones that may be orders and stand on the flank of a stronger tone.

    Lines closer than the main lobe of the window are one in the map; such a one is what the fit of the stronger left.
    """
    reach = NEAR_BINS * modal.step_hz
    flanks = [tone for tone in modal.tones if any(_is_flank(tone, other, reach) for other in modal.tones)]
    return replace(modal, tones=tuple(t for t in modal.tones if "order" not in t.kind or t not in flanks))
