"""Lines that belong to others: sidebands, meshes, harmonics of races and of shafts of their own, swings of a shaft."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product, takewhile
from typing import NamedTuple

import numpy as np
import xarray as xr

from crankorder.cause import BY_A_SWING, Cause, CauseKind
from crankorder.findings import BearingFinding
from crankorder.identify.found import AgreedOrder, AgreedOrders, OrderLine
from crankorder.identify.lines.line_phasors import NO_PULSES
from crankorder.identify.machine_model import MachineModel
from crankorder.orders.intervals import Z95
from crankorder.orders.swing_evidence import HARMONICS
from crankorder.orders.true_angle import TAKEN, swing_shown
from crankorder.quantities import Bools, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-explain.toml", "sidebands")


class Sideband(NamedTuple):
    """Line ``at`` is one of ``carrier`` (positions in the lists given), ``multiple`` times ``spacing`` from it."""

    at: int
    carrier: int
    spacing: float
    multiple: int
    spacing_name: str
    chance: float


def sidebands(
    places: Sequence[float],
    errors: Sequence[float],
    amplitudes: Sequence[float],
    *,
    spacings: dict[str, float],
    highest: float,
    sides: Sequence[bool] | None = None,
) -> list[Sideband]:
    """Which lines are sidebands of stronger ones: pairs on both sides, alike far from their carrier.

    A modulation makes both sides at once, so a carrier has to be the strongest of the three. The spacing is one of the
    known ``spacings``, or any other that a chance of less than 5 % would not put there, counted over all pairs of
    lines. A line is given to its strongest carrier.

    Parameters
    ----------
    places : orders of the shaft, or frequencies in Hz, of the lines of one channel
    errors : their standard errors
    amplitudes : their peak amplitudes
    spacings : names and values, in the unit of the places, of what turns or alternates: "shaft", "cage", a tone
    highest : the range in which lines were sought begins at 0 and ends here, for the chance
    sides : which lines may be sidebands; all where it is None. Lines on one grid, as the multiples of a shaft's order,
        lie alike far from many others by nature and prove nothing
    """
    bands: dict[int, Sideband] = {}
    for carrier in np.argsort(-np.asarray(amplitudes)).tolist():
        if carrier in bands:
            continue
        lower = [k for k, size in enumerate(amplitudes) if size < amplitudes[carrier] and (sides is None or sides[k])]
        below = [k for k in lower if places[k] < places[carrier]]
        above = [k for k in lower if places[k] > places[carrier]]
        pairs = list[Sideband]()
        for low, high in product(below, above):
            spacing, side_error = 0.5 * (places[high] - places[low]), 0.5 * math.hypot(errors[high], errors[low])
            error = math.hypot(side_error, errors[carrier])
            lopsided = abs(places[carrier] - 0.5 * (places[high] + places[low]))
            if lopsided > NUMBERS.same_sigmas * error or places[carrier] < NUMBERS.carrier_spacings * spacing:
                continue
            name, multiple = _known(spacing, side_error, spacings)
            # so many pairs as there are, each with its middle anywhere, would sit so often on this carrier
            chance = len(below) * len(above) * min(1.0, 2.0 * NUMBERS.same_sigmas * error / highest)
            if name or chance < NUMBERS.family_chance:
                pairs += [Sideband(at, carrier, spacing / multiple, multiple, name, chance) for at in (low, high)]
        for side in sorted(pairs, key=lambda band: (not band.spacing_name, band.multiple, band.spacing)):
            bands.setdefault(side.at, side)
    return [bands[at] for at in sorted(bands)]


def _known(spacing: float, error: float, spacings: dict[str, float]) -> tuple[str, int]:
    """Name of the known spacing of which ``spacing`` is the single, double or threefold; ("", 1) where none is."""
    for multiple in (1, 2, 3):
        for name, value in spacings.items():
            if abs(spacing - multiple * value) <= NUMBERS.same_sigmas * error + 1e-9:
                return name, multiple
    return "", 1


def spacings_of(sources: MachineModel, bearings: Sequence[BearingFinding]) -> dict[str, float]:
    """Names and orders of what may modulate a line: shafts and cycle of ``sources``, and the cages of ``bearings``."""
    spacings = {"shaft": 1.0} | ({"half-speed shaft": 0.5} if sources.revs_per_cycle == 2 else {})
    shafts = [(bearing.name, bearing.shaft_ratio) for bearing in sources.bearings]
    for name, order in [*shafts, *((gear.name, gear.shaft_order) for gear in sources.gears)]:
        if order not in spacings.values():
            spacings[name] = order
    cages = [(record.name, record.order) for record in bearings if record.line == "FTF"]
    expected = [(name, order) for (name, line), order in sources.known_bearing_orders.items() if line == "FTF"]
    return spacings | {f"cage of {name}": order for name, order in [*expected, *cages]}


def meshes(amplitude_of: dict[int, float]) -> list[int]:
    """Whole orders that are a mesh of teeth or a passing of blades, by their sidebands.

    ``amplitude_of`` gives the peak amplitudes of the whole orders of one channel. Six teeth or more, a line one shaft
    order below and above, at half of it or less, and nothing within five orders that is as large: harmonics of a shaft
    fall off from the first and have no such summit, or a mode makes one. Where no order is missing from the first up to
    the line, what stands beside it may be harmonics of the shaft as well: then it has to be twice as large as all of
    these, and above the orders at which engines fire, of which any may be the largest.
    """
    found = []
    for order, amplitude in amplitude_of.items():
        if order < NUMBERS.least_teeth or not {order - 1, order + 1} <= amplitude_of.keys():
            continue
        largest_side = max(amplitude_of[order - 1], amplitude_of[order + 1])
        beside = [amplitude_of.get(order + step, 0.0) for step in range(-5, 6) if step]
        whole = all(below in amplitude_of for below in range(1, order))
        if whole and (order <= NUMBERS.most_firings or amplitude < NUMBERS.mesh_ratio * max(beside)):
            continue
        if amplitude >= NUMBERS.mesh_ratio * largest_side and amplitude > max(beside):
            found.append(order)
    return sorted(found)


def other_shafts(places: Sequence[float], errors: Sequence[float]) -> dict[int, tuple[int, int]]:
    """Lines that are harmonics of a shaft of its own speed: {line: (line of its first order, multiple)}.

    ``places`` (orders of the crank) and their standard ``errors`` are those of lines that are not locked to it. A shaft
    has its first order and its second at least; the slowest that explains most lines is taken, where lines that lie
    anywhere would make less than 5 % of such a family.
    """
    order, harmonics = np.argsort(places).tolist(), dict[int, tuple[int, int]]()
    for first in order:
        if first in harmonics:
            continue
        family, chance = {first: 1}, 1.0
        for other in order:
            multiple = round(places[other] / places[first])
            error = float(np.hypot(multiple * errors[first], errors[other]))
            near = abs(places[other] - multiple * places[first]) <= NUMBERS.same_sigmas * error
            if near and multiple > 1 and other not in harmonics:
                family[other] = multiple
                chance *= min(1.0, 2.0 * NUMBERS.same_sigmas * error / places[first])
        # any of the others could have been the one that fits
        if 2 in family.values() and chance * len(places) < NUMBERS.family_chance:
            harmonics |= {line: (first, multiple) for line, multiple in family.items()}
    return harmonics


FAMILY_NUMBERS = MethodNumbers("5-identify-explain.toml", "explain_families")

LineCauses = dict[tuple[str, float], Cause]
"""Causes of lines by channel and AgreedOrder.order."""

Lines = Sequence[tuple[AgreedOrder, OrderLine]]
"""Lines of one channel, each beside the order on which all channels agree."""

BY_ITSELF: tuple[CauseKind, ...] = ("unexplained", "shaft harmonic")
"""Causes of lines that a mesh beside them explains better."""


def explain_families(
    orders: AgreedOrders,
    causes: LineCauses,
    of_cycle: dict[float, float | None],
    *,
    spacings: dict[str, float],
    modes_hz: Sequence[float],
    of_swing: LineCauses,
) -> LineCauses:
    """Causes of the lines that other lines explain, by channel and order; lines that none explains are not in it.

    Parameters
    ----------
    orders : the orders of the test
    causes : what explains each line by itself
    of_cycle : by order, the multiple of the order of the cycle that it is or may be, or None
    spacings : names and orders of what turns and may modulate a line
    modes_hz : natural frequencies; a harmonic that one of them lifts at every speed is no mesh
    of_swing : lines that swings of the angle may make, which are no sidebands of a mesh
    """
    families: LineCauses = {}
    for channel in sorted({line.channel for agreed in orders for line in agreed.lines}):
        lines = [(agreed, line) for agreed in orders for line in agreed.lines if line.channel == channel]
        unswung = [pair for pair in lines if (channel, pair[0].order) not in of_swing]
        families |= _meshes(channel, unswung, causes, of_cycle, modes_hz)
        # unexplained lines off the multiples of the cycle that stand in pairs about a stronger line
        free = [causes[channel, a.order].is_just("unexplained") and of_cycle[a.order] is None for a, _ in lines]
        places = [agreed.order for agreed, _ in lines]
        # an error of the speed shifts all alike
        errors = [min(agreed.order_error, line.order_error) for agreed, line in lines]
        sizes, highest = [float(line.amplitude.max()) for _, line in lines], max(places, default=1.0)
        for band in sidebands(places, errors, sizes, spacings=spacings, highest=highest, sides=free):
            named = f" ({band.spacing_name})" if band.spacing_name else ""
            evidence = f"one of a pair about a stronger line{named}; {band.chance:.1g} such pairs by chance"
            families[channel, places[band.at]] = sideband_of(places[band.carrier], band.spacing, evidence)
    return families | _shafts(orders, causes, families, of_cycle)


def _meshes(
    channel: str, lines: Lines, causes: LineCauses, of_cycle: dict[float, float | None], modes_hz: Sequence[float]
) -> LineCauses:
    """Whole orders of one channel that are a mesh by their sidebands, and these; stated meshes have sidebands too."""
    whole: dict[int, tuple[float, OrderLine]] = {}
    for agreed, line in lines:
        multiple = of_cycle[agreed.order]
        if multiple is not None and multiple == round(multiple):
            whole[round(multiple)] = (agreed.order, line)
    family, sizes = LineCauses(), {number: float(line.amplitude.max()) for number, (_, line) in whole.items()}
    known = {number for number, (order, _) in whole.items() if causes[channel, order].kind == "gear mesh"}
    for mesh in sorted({*meshes(sizes), *known}):
        order, line = whole[mesh]
        stated = mesh in known
        if not stated and (not causes[channel, order].is_just(*BY_ITSELF) or _lifted(line, mesh, modes_hz)):
            continue
        sides = _sides(mesh, sizes)
        if not stated:
            about = ", ".join(str(number) for number in sorted(sides))
            evidence = f"order {mesh} stands over its sidebands at orders {about}"
            family[channel, order] = Cause("gear mesh or blade passing", evidence)
        for number in sides:
            if causes[channel, whole[number][0]].is_just(*BY_ITSELF):
                evidence = f"{abs(number - mesh)} shaft orders from order {mesh}, which stands over it; also whole"
                family[channel, whole[number][0]] = sideband_of(mesh, 1.0, evidence)
    return family


def sideband_of(carrier: float, spacing: float, evidence: str, *, unit: str = "") -> Cause:
    """A sideband of the line ``carrier`` at a ``spacing``, in orders or in that ``unit``, with the ``evidence``."""
    of = "" if unit else "order "
    return Cause("sideband", evidence, {"of": of, "carrier": carrier, "unit": unit, "spacing": spacing})


def _sides(mesh: int, sizes: dict[int, float]) -> list[int]:
    """Whole orders beside ``mesh``, outwards as long as none of ``sizes`` is missing or over half of its amplitude."""
    reach, most = FAMILY_NUMBERS.most_sidebands + 1, sizes[mesh] / NUMBERS.mesh_ratio
    outwards = range(mesh - 1, mesh - reach, -1), range(mesh + 1, mesh + reach)
    return [side for sides in outwards for side in takewhile(lambda order: sizes.get(order, np.inf) <= most, sides)]


def _lifted(line: OrderLine, order: int, modes_hz: Sequence[float]) -> bool:
    """Whether a natural frequency may lift ``line`` at half or more of the speeds at which it is seen."""
    if not len(modes_hz) or not np.isfinite(line.speed_rpm).all():
        return False
    frequency = order * line.speed_rpm / 60.0
    near = np.abs(frequency[:, None] / np.asarray(modes_hz) - 1.0) < FAMILY_NUMBERS.near_mode_share
    return bool(np.mean(near.any(axis=1)) >= 0.5)


def _shafts(
    orders: AgreedOrders, causes: LineCauses, families: LineCauses, of_cycle: dict[float, float | None]
) -> LineCauses:
    """Lines not locked to the shaft, in whole ratios to one another: those of another shaft."""
    free = list[tuple[AgreedOrder, list[tuple[str, float]]]]()
    for agreed in orders:
        keys = [(line.channel, agreed.order) for line in agreed.lines]
        opened = [key for key in keys if key not in families and causes[key].is_just("unexplained")]
        free += [(agreed, opened)] if opened and of_cycle[agreed.order] is None else []
    harmonics = other_shafts([agreed.order for agreed, _ in free], [agreed.order_error for agreed, _ in free])
    counts, shafts = Counter(first for first, _ in harmonics.values()), LineCauses()
    near_first = [agreed for agreed in orders if abs(agreed.order - 1.0) < FAMILY_NUMBERS.first_reach_orders]
    has_first = any(
        not any("mains" in causes[line.channel, agreed.order].kinds for line in agreed.lines) for agreed in near_first
    )
    speed_may_be_wrong = not has_first and all(NO_PULSES in agreed.doubts for agreed, _ in free)
    for at, (first, multiple) in harmonics.items():
        base = free[first][0].order
        evidence = f"not locked to the shaft; {counts[first]} lines are whole multiples of order {base:.5g}"
        if speed_may_be_wrong:
            evidence += "; nothing stands at order 1, and no pulses prove the speed"
        harmonic = "" if multiple == 1 else f"harmonic {multiple} of "
        kind: CauseKind = "stated shaft" if speed_may_be_wrong else "another shaft"
        shafts |= dict.fromkeys(free[at][1], Cause(kind, evidence, {"harmonic": harmonic, "ratio": base}))
    return shafts


RACE_NUMBERS = MethodNumbers("5-identify-explain.toml", "race_harmonics")

STRUCK = ("BPFO", "BPFI", "BSF")


@dataclass(frozen=True)
class StruckRace:
    """Lines at whole multiples of ``order`` and whole multiples of the ``shaft``'s order beside: with errors."""

    name: str
    title: str
    order: float
    order_error: float
    shaft: float
    shaft_error: float

    def nearest(self, order: float, error: float) -> tuple[int, int] | None:
        """Lowest harmonic and turns of the shaft at ``order``, within its standard ``error``; None where none is."""
        harmonic = np.arange(1, RACE_NUMBERS.most_harmonics + 1)
        turns = np.rint((order - harmonic * self.order) / self.shaft)
        known = np.hypot(np.hypot(harmonic * self.order_error, turns * self.shaft_error), error) / self.shaft
        known = np.maximum(known, RACE_NUMBERS.least_error)
        away = np.abs(order - harmonic * self.order - turns * self.shaft) / self.shaft
        few = (harmonic <= RACE_NUMBERS.sure_harmonics) & (np.abs(turns) <= RACE_NUMBERS.sure_turns)
        near = (np.abs(turns) <= RACE_NUMBERS.most_turns) & (few | (known <= RACE_NUMBERS.sure_error))
        near &= away <= RACE_NUMBERS.same_sigmas * np.minimum(known, RACE_NUMBERS.most_error)
        at = int(np.argmin(np.where(near, harmonic + np.abs(turns), np.inf)))
        return (int(harmonic[at]), int(turns[at])) if near[at] else None


def struck_races(
    bearings: Sequence[BearingFinding], sources: MachineModel, lines: Sequence[tuple[float, float]]
) -> list[StruckRace]:
    """Races and rolling elements that ``bearings`` (their findings) show, as fine as ``lines`` (order, error) tell.

    The line of the vibration is the finer one; the shaft's own order is what the record of the envelope read from the
    sidebands, or the one that ``sources`` state.
    """
    struck = [record for record in bearings if record.line in STRUCK and record.lock != "locked"]
    struck.sort(key=lambda record: record.seen_in != "envelope")
    ratio, races = {bearing.name: bearing.shaft_ratio for bearing in sources.bearings}, list[StruckRace]()
    for name, line in dict.fromkeys((record.name, record.line) for record in struck):
        first, *others = (record for record in struck if (record.name, record.line) == (name, line))
        reach = RACE_NUMBERS.same_sigmas / Z95
        same = [
            other
            for other in others
            if abs(other.order - first.order) <= reach * math.hypot(other.order_half, first.order_half)
        ]
        finest, stated = min((first, *same), key=lambda record: record.order_half), float(ratio.get(name, 1.0))
        shaft = first.shaft_order or stated, RACE_NUMBERS.stated_error_share * stated
        race = StruckRace(name, "2 x BSF" if line == "BSF" else line, finest.order, finest.order_half / Z95, *shaft)
        races.append(_refined(race, lines))
    return races


def race_cause(races: Sequence[StruckRace], order: float, error: float, *, few: bool = False) -> Cause | None:
    """What makes a line at ``order`` with its standard ``error`` of the ``races`` that put one there; None: none does.

    ``few``: only of the lowest harmonics and turns, where something else is as likely.
    """
    near = []
    for race in races:
        harmonic, turns = race.nearest(order, error) or (0, 0)
        many = harmonic > RACE_NUMBERS.sure_harmonics or abs(turns) > RACE_NUMBERS.sure_turns
        if harmonic and not (few and many):
            names = f"{race.name} {race.title}" + (f", harmonic {harmonic}" if harmonic > 1 else "")
            names += f" {'+' if turns > 0 else '-'} {abs(turns)} x shaft" if turns else ""
            near.append((harmonic + abs(turns), names))
    # strikes have many harmonics, and turns of the shaft beside each
    evidence = "where the strikes that were found have a harmonic, or one with turns of the shaft beside it"
    return Cause("bearing", evidence, {"names": min(near)[1]}) if near else None


def _refined(race: StruckRace, lines: Sequence[tuple[float, float]]) -> StruckRace:
    """``race`` with its order and that of the shaft fitted to the lines of ``lines`` that are surely its own."""
    hits = [(*place, order, error) for order, error in lines if (place := race.nearest(order, error)) is not None]
    if len(hits) < RACE_NUMBERS.anchors:
        return race
    harmonic, turns, order, error = np.array(hits, dtype=float).T
    lowest = np.argsort(harmonic + np.abs(turns), kind="stable")[: RACE_NUMBERS.anchors]
    harmonic, turns, order = harmonic[lowest], turns[lowest], order[lowest]
    error = np.maximum(error[lowest], RACE_NUMBERS.least_error * race.shaft)
    design = np.column_stack([harmonic, turns]) / error[:, None]
    if np.linalg.matrix_rank(design) < 2:
        return race
    inverse = np.linalg.inv(design.T @ design)
    fitted = inverse @ design.T @ (order / error)
    (of_race, of_shaft), (race_error, shaft_error) = fitted.tolist(), np.sqrt(np.diag(inverse)).tolist()
    return replace(race, order=of_race, order_error=race_error, shaft=of_shaft, shaft_error=shaft_error)


SWING_NUMBERS = MethodNumbers("5-identify-explain.toml", "swing_sidebands")

WHOLE_HALVES = 0.05
"""An order this near, in half orders, to so many half orders from another is one."""

MOST_ROWS = 128
"""Speeds of a line that are looked at, evenly spread."""

MOST_TIMES = 4
"""Most turns of a swing by which a line lies beside its order: the n-th sideband is as large as the n-th power."""


def _swings_shown(frames: Sequence[xr.Dataset]) -> Floats:
    """Swings of the shaft that the pulses of ``frames`` (OrderFrames) show: (speeds, 1 + half orders).

    The rising speed [rpm] and, behind it, peak amplitudes [rev] at 0.5, 1, 1.5 … times a turn.
    """
    recordings, whole = [], [2 * harmonic for harmonic in HARMONICS]
    for spectra in frames:
        swing = np.abs(swing_shown([spectra]))
        swing[:, whole] -= np.minimum(swing[:, whole], spectra.attrs.get(TAKEN, 0.0))
        recordings.append(swing)
    shown = np.concatenate(recordings)
    return np.asarray(shown[np.argsort(shown[:, 0])])


def _swing_at(shown: Floats, half_orders: int, rpm: Floats) -> Floats:
    """Swing [rev] at so many ``half_orders`` and at ``rpm`` (rows,) of those ``shown``; 0 where pulses show none."""
    if not len(shown) or not 0 < half_orders < shown.shape[1]:
        return np.zeros(len(rpm))
    return np.interp(rpm, shown[:, 0], shown[:, half_orders])


def swing_sidebands(orders: Sequence[AgreedOrder], frames: Sequence[xr.Dataset]) -> dict[tuple[str, float], Cause]:
    """Causes of lines of ``orders`` that are no larger than swings of the shaft may make them, by channel and order.

    A force at order n of a shaft that swings by ε sin(k θ) has sidebands π n ε at n ± k in time. The structure
    responds to each at its own frequency, so that π n ε (H(n ± k) / H(n) - 1) times the order is left of them in the
    angle of the shaft (H: the response). What the order itself has where the speed brings it to the frequency of the
    sideband tells the response there. ``frames`` (OrderFrames) say how the angle swings.
    """
    causes = LineCauses()
    if not orders:
        return causes
    shown = _swings_shown(frames)
    for agreed in orders:
        of_order, within = LineCauses(), 0
        for line in agreed.lines:
            beside = [(other.order, item) for other in orders for item in other.lines if item.channel == line.channel]
            others = [pair for pair in beside if pair[1] is not line]
            given = [part for pair in others for part in _given(line, agreed.order, *pair, shown)]
            if not given:
                break
            within += _within(line, given, speeds=max(len(item.amplitude) for _, item in beside))
            most = max(given, key=lambda part: float(np.sum(part.amplitude)))
            beside_it = f"beside order {most.carrier:g}"
            evidence = f"no larger in most channels than what a swing of the shaft gives it {beside_it}"
            of_order[line.channel, agreed.order] = replace(BY_A_SWING, evidence=evidence)
        # an order is one thing in all channels
        causes |= of_order if 2 * within >= len(agreed.lines) else {}
    return causes


class _Given(NamedTuple):
    """Largest ``amplitude`` (rows,) that the order ``carrier`` gives by a swing of the shaft.

    ``known`` (rows,): whether the speeds are close enough to tell how the structure responds.
    """

    carrier: float
    amplitude: Floats
    known: Bools


def _given(line: OrderLine, order: float, number: float, carrier: OrderLine, shown: Floats) -> list[_Given]:
    """What the swings ``shown`` give to ``line`` at ``order`` at most of its ``carrier`` at the order ``number``."""
    if carrier.amplitude.max() < line.amplitude.max():
        return []  # nothing is the sideband of what is weaker
    rpm, parts = line.speed_rpm[_rows(line)], []
    for half_orders in (2.0 * abs(order - number), 2.0 * (order + number)):
        at = round(half_orders)
        if not at or abs(half_orders - at) > WHOLE_HALVES:
            continue
        divisors = [n for n in range(1, MOST_TIMES + 1) if at % n == 0]
        swing = np.sum([(np.pi * number * _swing_at(shown, at // n, rpm)) ** n for n in divisors], axis=0)
        if not swing.any():
            continue
        here, largest, known = _amplitudes(carrier, rpm, order / number)
        parts.append(_Given(number, swing * (here + largest), known))
    return [part for part in parts if part.amplitude.any()]


def _amplitudes(carrier: OrderLine, rpm: Floats, ratio: float) -> tuple[Floats, Floats, Bools]:
    """Amplitude of ``carrier`` at ``rpm`` (rows,), the largest from there to ``ratio`` times that speed, if known.

    The force behind it is taken to grow with the square of the speed. Where speeds are too coarse to tell what is
    between them the largest of all stands for it; beyond their ends a natural frequency may lift it further.
    """
    rising = np.argsort(carrier.speed_rpm)
    speed, amplitude, sought = carrier.speed_rpm[rising], carrier.amplitude[rising], ratio * rpm
    gap = np.append(np.diff(speed), np.inf)[np.searchsorted(speed, sought, side="right") - 1]
    inside = (sought >= speed[0]) & (sought <= speed[-1])
    known = inside & (gap < SWING_NUMBERS.dense_share * sought)
    reach = 1.0 + SWING_NUMBERS.dense_share
    low, high = np.minimum(rpm, sought)[:, None] / reach, np.maximum(rpm, sought)[:, None] * reach
    counts = ~known[:, None] | ((speed >= low) & (speed <= high))
    scaled = amplitude * np.maximum(1.0, np.square(rpm[:, None] / speed))
    largest = np.where(counts, scaled, 0.0).max(axis=1) * np.where(inside, 1.0, SWING_NUMBERS.beyond_lift)
    return np.interp(rpm, speed, amplitude), largest, known


def _within(line: OrderLine, given: Sequence[_Given], *, speeds: int) -> bool:
    """Whether ``line`` is no larger than what is ``given`` to it where that is known, and at most of the ``speeds``.

    At one speed its own scatter may lift it; where speeds are coarse a natural frequency between them may.
    """
    allowed = np.sum([part.amplitude for part in given], axis=0)
    known = np.sum([part.amplitude * part.known for part in given], axis=0) >= 0.5 * allowed
    scatter = np.nan_to_num(line.amplitude_error) * SWING_NUMBERS.scatter_sigmas
    above = line.amplitude[_rows(line)] > (1.0 + SWING_NUMBERS.alike_share) * allowed + scatter[_rows(line)]
    return not (above & known).any() and bool(np.mean(above) * len(line.amplitude) <= 0.5 * speeds)


def _rows(line: OrderLine) -> slice:
    """Rows of a ``line`` that are looked at: those of a sweep are many, and alike."""
    return slice(None, None, -(-len(line.amplitude) // MOST_ROWS))
