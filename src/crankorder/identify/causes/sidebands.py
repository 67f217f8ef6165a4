"""Lines that belong to others: sidebands, meshes, harmonics of races and of shafts of their own, encoder errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crankorder.cause import Cause, CauseKind
from crankorder.findings import BearingFinding
from crankorder.identify.found import AgreedOrder, AgreedOrders, OrderLine
from crankorder.identify.intervals import Z95
from crankorder.identify.lines.line_phasors import NO_PULSES
from crankorder.identify.machine_model import MachineModel
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-explain.toml", "sidebands")


@dataclass(frozen=True)
class Sideband:
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
    order = np.argsort(-np.asarray(amplitudes))
    bands: dict[int, Sideband] = {}
    for carrier in order.tolist():
        if carrier in bands:
            continue
        may = [(sides is None or sides[k]) and amplitudes[k] < amplitudes[carrier] for k in range(len(places))]
        for pair in _pairs(carrier, places, errors, may, spacings, highest):
            for side in pair:
                bands.setdefault(side.at, side)
    return [bands[at] for at in sorted(bands)]


def _pairs(
    carrier: int,
    places: Sequence[float],
    errors: Sequence[float],
    may: Sequence[bool],
    spacings: dict[str, float],
    highest: float,
) -> list[tuple[Sideband, Sideband]]:
    """Pairs of lines alike far below and above ``carrier``, of those that ``may`` be its sidebands."""
    below = [k for k in range(len(places)) if may[k] and places[k] < places[carrier]]
    above = [k for k in range(len(places)) if may[k] and places[k] > places[carrier]]
    pairs = []
    for low in below:
        for high in above:
            spacing = 0.5 * (places[high] - places[low])
            error = float(np.sqrt(0.25 * (errors[high] ** 2 + errors[low] ** 2) + errors[carrier] ** 2))
            lopsided = abs(places[carrier] - 0.5 * (places[high] + places[low]))
            if lopsided > NUMBERS.same_sigmas * error or places[carrier] < NUMBERS.carrier_spacings * spacing:
                continue
            name, multiple = _known(spacing, 0.5 * float(np.hypot(errors[high], errors[low])), spacings)
            # so many pairs as there are, each with its middle anywhere, would sit so often on this carrier
            chance = len(below) * len(above) * min(1.0, 2.0 * NUMBERS.same_sigmas * error / highest)
            if name or chance < NUMBERS.family_chance:
                of_carrier = (carrier, spacing / multiple, multiple, name, chance)
                pairs.append((Sideband(low, *of_carrier), Sideband(high, *of_carrier)))
    return sorted(pairs, key=lambda pair: (not pair[0].spacing_name, pair[0].multiple, pair[0].spacing))


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
    for bearing in sources.bearings:
        if bearing.shaft_ratio not in spacings.values():
            spacings[bearing.name] = bearing.shaft_ratio
    cages = [(record.name, record.order) for record in bearings if record.line == "FTF"]
    expected = [(name, order) for (name, line), order in sources.known_bearing_orders.items() if line == "FTF"]
    for gear in sources.gears:
        if gear.shaft_order not in spacings.values():
            spacings[gear.name] = gear.shaft_order
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
        sides = [amplitude_of.get(order - 1), amplitude_of.get(order + 1)]
        if order < NUMBERS.least_teeth or None in sides:
            continue
        beside = [amplitude_of.get(order + step, 0.0) for step in range(-5, 6) if step]
        whole = all(below in amplitude_of for below in range(1, order))
        if whole and (order <= NUMBERS.most_firings or amplitude < NUMBERS.mesh_ratio * max(beside)):
            continue
        largest_side = max(side for side in sides if side is not None)
        if amplitude >= NUMBERS.mesh_ratio * largest_side and amplitude > max(beside):
            found.append(order)
    return sorted(found)


def other_shafts(places: Sequence[float], errors: Sequence[float]) -> dict[int, tuple[int, int]]:
    """Lines that are harmonics of a shaft of its own speed: {line: (line of its first order, multiple)}.

    ``places`` (orders of the crank) and their standard ``errors`` are those of lines that are not locked to it. A shaft
    has its first order and its second at least; the slowest that explains most lines is taken, where lines that lie
    anywhere would make less than 5 % of such a family.
    """
    order = np.argsort(places).tolist()
    harmonics: dict[int, tuple[int, int]] = {}
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
    family: LineCauses = {}
    known = {number for number, (order, _) in whole.items() if causes[channel, order].kind == "gear mesh"}
    for mesh in sorted({*meshes({number: float(line.amplitude.max()) for number, (_, line) in whole.items()}), *known}):
        order, line = whole[mesh]
        stated = mesh in known
        if not stated and (not causes[channel, order].is_just(*BY_ITSELF) or _lifted(line, mesh, modes_hz)):
            continue
        sides = _sides(mesh, whole, line)
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


def _sides(mesh: int, whole: dict[int, tuple[float, OrderLine]], carrier: OrderLine) -> list[int]:
    """Whole orders beside ``mesh``, outwards as long as none is missing or stands over half of its ``carrier``."""
    sides = []
    for step in (-1, 1):
        for distance in range(1, FAMILY_NUMBERS.most_sidebands + 1):
            beside = whole.get(mesh + step * distance)
            if beside is None or NUMBERS.mesh_ratio * beside[1].amplitude.max() > carrier.amplitude.max():
                break
            sides.append(mesh + step * distance)
    return sides


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

    def open_lines(agreed: AgreedOrder) -> list[tuple[str, float]]:
        keys = [(line.channel, agreed.order) for line in agreed.lines]
        return [key for key in keys if causes[key].is_just("unexplained") and key not in families]

    free = [agreed for agreed in orders if of_cycle[agreed.order] is None and open_lines(agreed)]
    harmonics = other_shafts([agreed.order for agreed in free], [agreed.order_error for agreed in free])
    shafts: LineCauses = {}
    has_first = any(
        abs(agreed.order - 1.0) < FAMILY_NUMBERS.first_reach_orders
        and not any("mains" in causes[line.channel, agreed.order].kinds for line in agreed.lines)
        for agreed in orders
    )
    speed_may_be_wrong = not has_first and all(NO_PULSES in agreed.doubts for agreed in free)
    for at, (first, multiple) in harmonics.items():
        base = free[first].order
        count = sum(1 for other, _ in harmonics.values() if other == first)
        evidence = f"not locked to the shaft; {count} lines are whole multiples of order {base:.5g}"
        if speed_may_be_wrong:
            evidence += "; nothing stands at order 1, and no pulses prove the speed"
        harmonic = "" if multiple == 1 else f"harmonic {multiple} of "
        kind: CauseKind = "stated shaft" if speed_may_be_wrong else "another shaft"
        cause = Cause(kind, evidence, {"harmonic": harmonic, "ratio": base})
        shafts |= dict.fromkeys(open_lines(free[at]), cause)
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

    def nearest(self, order: float, error: float) -> tuple[int, int, float] | None:
        """Harmonic and turns of the shaft at ``order`` and how far that is; None where, with its ``error``, none is."""
        best = None
        for harmonic in range(1, RACE_NUMBERS.most_harmonics + 1):
            turns = round((order - harmonic * self.order) / self.shaft)
            own = math.hypot(harmonic * self.order_error, turns * self.shaft_error)
            known = max(math.hypot(own, error), RACE_NUMBERS.least_error * self.shaft)
            few = harmonic <= RACE_NUMBERS.sure_harmonics and abs(turns) <= RACE_NUMBERS.sure_turns
            if abs(turns) > RACE_NUMBERS.most_turns or (known > RACE_NUMBERS.sure_error * self.shaft and not few):
                continue
            away = abs(order - harmonic * self.order - turns * self.shaft)
            near = away <= RACE_NUMBERS.same_sigmas * min(known, RACE_NUMBERS.most_error * self.shaft)
            if near and (best is None or harmonic + abs(turns) < best[0] + abs(best[1])):
                best = harmonic, turns, away
        return best

    def cause(self, harmonic: int, turns: int) -> Cause:
        """The line of that ``harmonic``, so many ``turns`` of the shaft beside: strikes have many of both."""
        names = f"{self.name} {self.title}" + (f", harmonic {harmonic}" if harmonic > 1 else "")
        names += f" {'+' if turns > 0 else '-'} {abs(turns)} x shaft" if turns else ""
        evidence = "where the strikes that were found have a harmonic, or one with turns of the shaft beside it"
        return Cause("bearing", evidence, {"names": names})


def struck_races(
    bearings: Sequence[BearingFinding], sources: MachineModel, lines: Sequence[tuple[float, float]]
) -> list[StruckRace]:
    """Races and rolling elements that ``bearings`` (their findings) show, as fine as ``lines`` (order, error) tell.

    The line of the vibration is the finer one; the shaft's own order is what the record of the envelope read from the
    sidebands, or the one that ``sources`` state.
    """
    races: dict[tuple[str, str], StruckRace] = {}
    ratio = {bearing.name: bearing.shaft_ratio for bearing in sources.bearings}
    for record in sorted(bearings, key=lambda record: record.seen_in != "envelope"):
        key = record.name, record.line
        if record.line not in STRUCK or record.lock == "locked":
            continue
        error = record.order_half / Z95
        old, shaft = races.get(key), record.shaft_order
        if old is None:
            title = "2 x BSF" if record.line == "BSF" else record.line
            stated = float(ratio.get(record.name, 1.0))
            shaft_error = RACE_NUMBERS.stated_error_share * stated
            races[key] = StruckRace(record.name, title, record.order, error, shaft or stated, shaft_error)
            continue
        same = abs(record.order - old.order) <= RACE_NUMBERS.same_sigmas * math.hypot(error, old.order_error)
        if same and error < old.order_error:
            races[key] = replace(old, order=record.order, order_error=error)
    return [_refined(race, lines) for race in races.values()]


def race_cause(races: Sequence[StruckRace], order: float, error: float, *, few: bool = False) -> Cause | None:
    """What makes a line at ``order`` with its standard ``error`` of the ``races`` that put one there; None: none does.

    ``few``: only of the lowest harmonics and turns, where something else is as likely.
    """
    near = []
    for race in races:
        harmonic, turns, _ = race.nearest(order, error) or (0, 0, 0.0)
        many = harmonic > RACE_NUMBERS.sure_harmonics or abs(turns) > RACE_NUMBERS.sure_turns
        if harmonic and not (few and many):
            near.append((harmonic + abs(turns), race.cause(harmonic, turns)))
    return min(near, key=lambda pair: (pair[0], pair[1].text))[1] if near else None


def _refined(race: StruckRace, lines: Sequence[tuple[float, float]]) -> StruckRace:
    """``race`` with its order and that of the shaft fitted to the lines of ``lines`` that are surely its own."""
    hits = [
        (harmonic, turns, order, max(error, RACE_NUMBERS.least_error * race.shaft))
        for order, error in lines
        if (found := race.nearest(order, error)) is not None
        for harmonic, turns, _ in [found]
    ]
    hits.sort(key=lambda hit: hit[0] + abs(hit[1]))
    hits = hits[: RACE_NUMBERS.anchors]
    if len(hits) < RACE_NUMBERS.anchors:
        return race
    harmonic, turns, order, error = (np.array(column, dtype=float) for column in zip(*hits, strict=True))
    design = np.column_stack([harmonic, turns]) / error[:, None]
    if np.linalg.matrix_rank(design) < 2:
        return race
    inverse = np.linalg.inv(design.T @ design)
    fitted = inverse @ design.T @ (order / error)
    (of_race, of_shaft), (race_error, shaft_error) = fitted.tolist(), np.sqrt(np.diag(inverse)).tolist()
    return replace(race, order=of_race, order_error=race_error, shaft=of_shaft, shaft_error=shaft_error)
