"""Lines at speeds that differ little: which are orders and which stay, as the lines of each recording tell."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from crankorder.identify.found import AgreedOrder, ModalFit, OrderLine, Tone, ToneKind
from crankorder.identify.intervals import Z95
from crankorder.identify.known_lines import LOBE_BINS, Held
from crankorder.identify.known_lines import NUMBERS as KNOWN_LINES
from crankorder.identify.lines.order_lock import lock_of, nearest_multiple
from crankorder.identify.lines.several_orders import DEGREES_OF_FREEDOM, SolvedLine, several_lines
from crankorder.identify.mains import NUMBERS as MAINS
from crankorder.identify.mains import multiples_near
from crankorder.identify.modal.tones import NEAR_BINS, with_one_mains
from crankorder.settings import IdentifySettings

PARTED = "parted by each of {} recordings, in which the orders of the shaft move and it does not"


@dataclass(frozen=True, eq=False)
class _Parted:
    """One line of a test as several recordings hold it: at ``hertz`` (at the speed of each) or at an ``order``."""

    fixed: bool
    seen: tuple[tuple[Held, SolvedLine], ...]

    @property
    def places(self) -> np.ndarray:
        """Frequency in Hz of what stays, order of what goes with the shaft, by recording."""
        return np.array([one.order * (held.rpm / 60.0 if self.fixed else 1.0) for held, one in self.seen])

    @property
    def error(self) -> float:
        """Standard error of the mean place, by the lines' own errors and their scatter."""
        own = [one.error * (held.rpm / 60.0 if self.fixed else 1.0) for held, one in self.seen]
        n = len(own)
        return float(np.hypot(np.sqrt(np.sum(np.square(own))) / n, self.places.std() / np.sqrt(max(n - 1, 1))))


def with_lines_of_recordings(
    orders: tuple[AgreedOrder, ...],
    modal: ModalFit,
    held: Sequence[Held],
    order_map: xr.Dataset,
    *,
    settings: IdentifySettings,
) -> tuple[tuple[AgreedOrder, ...], ModalFit]:
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
    speeds = [one.rpm for one in held]
    if len(held) < 2 or len(modal.frequency_hz) < 2 or max(speeds) > settings.mode_speed_ratio * min(speeds):
        return orders, modal
    step = float(modal.frequency_hz[1] - modal.frequency_hz[0])
    tones, made, changed = list(modal.tones), list(orders), False
    for low, high in _regions(modal.tones, NEAR_BINS * step):
        found = _parted(held, low, high)
        if not found:
            continue
        tones = [tone for tone in tones if not low <= tone.frequency_hz <= high]
        tones += [tone for one in found if one.fixed and (tone := _tone(one, settings)).amplitude]
        changed = True
        made = _with_orders(made, [one for one in found if not one.fixed], (low, high), held, order_map)
    if not changed:
        return orders, modal
    tones.sort(key=lambda tone: tone.frequency_hz)
    parted = replace(modal, tones=with_one_mains(tones, settings=settings))
    return tuple(sorted(made, key=lambda one: one.order)), parted


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


def _parted(held: Sequence[Held], low_hz: float, high_hz: float) -> list[_Parted]:
    """Lines between both frequencies as the recordings agree on them; none where they do not, or do not tell."""
    solved = [(one, lines) for one in held if (lines := _lines(one, low_hz, high_hz))]
    if len(solved) < MAINS.least_speeds:
        return []
    free = {(k, n) for k, (_, lines) in enumerate(solved) for n in range(len(lines))}
    made: list[_Parted] = []
    while free:
        first = max(free, key=lambda at: solved[at[0]][1][at[1]].sigmas)
        chains = [_chain(solved, first, free, (low_hz, high_hz), fixed=fixed) for fixed in (True, False)]
        whole = [chain for chain in chains if chain is not None]
        if len(whole) != 1:  # neither, or both: the speeds are too alike for the length of the recordings
            return []
        fixed = chains[0] is not None
        made.append(_Parted(fixed, tuple((solved[k][0], solved[k][1][n]) for k, n in whole[0])))
        free -= set(whole[0])
    return made


def _lines(held: Held, low_hz: float, high_hz: float) -> list[SolvedLine]:
    turn_hz, beyond = held.rpm / 60.0, LOBE_BINS / held.revs
    low, high = low_hz / turn_hz, high_hz / turn_hz
    if low - beyond <= 0.0 or high + beyond >= held.axis[-1]:
        return []
    return [one for one in several_lines(held, low, high, beyond=beyond) if low <= one.order <= high]


def _chain(
    solved: Sequence[tuple[Held, list[SolvedLine]]],
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
        room = 0.5 * KNOWN_LINES.apart_cycles / min(held.span_rev, own.span_rev)
        if fixed:
            room = max(room, KNOWN_LINES.same_hz * 60.0 / held.rpm)
        near = [n for n in range(len(lines)) if (k, n) in free and abs(lines[n].order - wanted) <= room]
        hidden = any(abs(one.order - wanted) * held.span_rev < 2.0 * KNOWN_LINES.apart_cycles for one in lines)
        outside = (
            not band_hz[0] < (wanted - room) * held.rpm / 60.0 < (wanted + 2.0 * room) * held.rpm / 60.0 < band_hz[1]
        )
        if near:
            chain.append((k, min(near, key=lambda n: abs(lines[n].order - wanted))))
        elif not hidden and not outside:
            return None
    alone = not fixed and abs(2.0 * line.order - round(2.0 * line.order)) * own.span_rev < KNOWN_LINES.apart_cycles
    return chain if len(chain) >= MAINS.least_speeds or alone else None


def _tone(one: _Parted, settings: IdentifySettings) -> Tone:
    """The fixed line ``one``, in the channels that show it; mains where it may be."""
    hertz, error = float(one.places.mean()), one.error
    size = np.array([line.amplitude for _, line in one.seen])
    own = np.sqrt(np.mean([line.amplitude_error**2 for _, line in one.seen], axis=0) / len(size))
    spread = size.std(axis=0) / np.sqrt(max(len(size) - 1, 1))
    amplitude = {
        name: (float(size[:, k].mean()), float(np.hypot(own[k], spread[k])))
        for k, name in enumerate(one.seen[0][0].channels)
        if size[:, k].mean() > Z95 * own[k]
    }
    kind, words = _kind(hertz, error, settings)
    return Tone(hertz, error, kind, amplitude, f"{words}; {PARTED.format(len(one.seen))}")


def _kind(hertz: float, error_hz: float, settings: IdentifySettings) -> tuple[ToneKind, str]:
    for multiple, mains in multiples_near(hertz, error_hz, settings=settings):
        return "mains", f"no damping, {multiple} times the mains frequency of {mains:g} Hz"
    return "tone", "no damping"


def _with_orders(
    orders: list[AgreedOrder],
    found: Sequence[_Parted],
    band_hz: tuple[float, float],
    held: Sequence[Held],
    order_map: xr.Dataset,
) -> list[AgreedOrder]:
    """``orders`` and those ``found`` in the band that are not among them, without those that no recording has."""
    kept: list[AgreedOrder] = []
    places = [float(one.places.mean()) for one in found]
    room = KNOWN_LINES.apart_cycles / min(one.span_rev for one in held)
    for agreed in orders:
        in_band = all(band_hz[0] <= agreed.order * one.rpm / 60.0 <= band_hz[1] for one in held)
        if not in_band or any(abs(agreed.order - place) < room for place in places):
            kept.append(agreed)
    new = [
        one
        for one, place in zip(found, places, strict=True)
        if len(one.seen) >= MAINS.least_speeds and not any(abs(agreed.order - place) < room for agreed in kept)
    ]
    return kept + [_agreed(one, order_map) for one in new]


def _agreed(one: _Parted, order_map: xr.Dataset) -> AgreedOrder:
    """The order ``one`` with a line for each channel that shows it."""
    turns = int(order_map.attrs["revs_per_cycle"])
    order, error = float(one.places.mean()), one.error
    lock = lock_of(order, error, DEGREES_OF_FREEDOM, revs_per_cycle=turns, by_phase=True)
    if lock == "locked":
        exact = nearest_multiple(order, revs_per_cycle=turns)
        order, error = exact, max(error, abs(order - exact) / Z95)
    text = f"{len(one.seen)} recordings part it from what stands beside it"
    lines = tuple(
        line for k, name in enumerate(one.seen[0][0].channels) if (line := _line(one, k, name, order, error, order_map))
    )
    return AgreedOrder(order, error, DEGREES_OF_FREEDOM, lock, None, lines, text)


def _line(one: _Parted, channel: int, name: str, order: float, error: float, order_map: xr.Dataset) -> OrderLine | None:
    speed = np.asarray(order_map["speed"].values, dtype=np.float64)
    rows = {int(np.nanargmin(np.abs(speed - held.rpm))): (held, line) for held, line in one.seen}
    seen = [
        row for row in sorted(rows) if rows[row][1].amplitude[channel] > Z95 * rows[row][1].amplitude_error[channel]
    ]
    if not seen:
        return None
    size = np.array([rows[row][1].amplitude[channel] for row in seen])
    own = np.array([rows[row][1].amplitude_error[channel] for row in seen])
    return OrderLine(
        channel=name,
        order=order,
        order_error=error,
        seen=np.array(seen),
        speed_rpm=np.array([rows[row][0].rpm for row in seen]),
        amplitude=size,
        amplitude_error=own,
        degrees_of_freedom=np.full(len(seen), DEGREES_OF_FREEDOM),
        phase_deg=np.full(len(seen), np.nan),
        evidence="steady, not locked",
        level_over_floor_db=float(20.0 * np.log10((size / np.maximum(own, 1e-300)).max())),
    )
