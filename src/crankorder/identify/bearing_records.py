"""Bearing lines of a test, in its orders and in its envelopes, each with slip, evidence and a verdict in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from crankorder.engine.machine_parts import Bearing
from crankorder.findings import BearingFinding
from crankorder.identify.envelope_lines import (
    Candidate,
    EnvelopeLine,
    Place,
    Spectra,
    bearing_places,
    envelope_lines,
    parabola,
    place_error,
    spectra_of,
)
from crankorder.identify.found import AgreedOrder, AgreedOrders
from crankorder.identify.lines.growth import growth, mean_level, reported
from crankorder.identify.machine_model import StatedPart, parts_at
from crankorder.orders.intervals import Z95, half_width, positive_interval, size_interval
from crankorder.quantities import Floats
from crankorder.settings import IdentifySettings, MethodNumbers


def bearing_records(
    orders: AgreedOrders,
    envelope: xr.Dataset | None,
    *,
    bearings: tuple[Bearing, ...],
    revs_per_cycle: int,
    settings: IdentifySettings,
) -> tuple[BearingFinding, ...]:
    """One record per bearing line that was found in the vibration or in its envelope, in words of the findings' schema.

    A line may turn slower or faster than in pure rolling by ``settings.bearing_slip_percent``; it is looked for over
    all of that. A rolling element's fault is looked for at twice BSF; N*fs is BPFO + BPFI.

    In the vibration an order that is exactly locked is a bearing line only as N*fs, and is then said to be as likely a
    part with so many teeth: no rolling bearing keeps step. In the envelope nothing is looked for on multiples of the
    cycle's order, where combustion is.

    Parameters
    ----------
    orders : found in the vibration, as all channels agree on them
    envelope : the EnvelopeMap of the test, None where there is none
    bearings : of the machine
    revs_per_cycle : crank revolutions per engine cycle, ≥ 1
    settings : slip and ``bearing_false_alarm_probability``, the chance that noise alone makes any line in the
        envelopes of the whole test: shared out over every bin of every place, channel, speed and band tried
    """
    places = bearing_places(bearings, slip_percent=settings.bearing_slip_percent)
    in_vibration = (_vibration_record(place, orders, revs_per_cycle=revs_per_cycle) for place in places)
    records = [record for record in in_vibration if record is not None]
    if envelope is not None and envelope.sizes["order"] > 1 and envelope.sizes["speed"]:
        spectra = spectra_of(envelope)
        level = settings.bearing_false_alarm_probability
        found = envelope_lines(spectra, places, false_alarm_probability=level)
        # of each bearing at each speed, as the line tells it whose sidebands tell it best
        shafts: dict[tuple[str, int], ShaftSpeed] = {}
        for line in found if envelope.attrs["speed_basis"] == "nominal" else ():
            key, shaft = (line.place.name, line.speed), shaft_speed(spectra, line)
            if shaft is not None and (key not in shafts or shaft.error < shafts[key].error):
                shafts[key] = shaft
        for line in found:
            records.append(_envelope_record(line, found, envelope, shafts.get((line.place.name, line.speed)), level))
    return tuple(filter(None, (_beside_races(record, records) for record in records)))


def _beside_races(record: BearingFinding, records: Sequence[BearingFinding]) -> BearingFinding | None:
    """``record``, of N*fs in the vibration with a word on the races of its bearing: they slip where it keeps step.

    None where it slips and is not the sum of both races as they were found.
    """
    if record.line != "N*fs" or record.seen_in != "vibration":
        return record
    own = [other for other in records if other.name == record.name and other is not record]
    races = {other.line: other for other in own if other.line in ("BPFO", "BPFI")}
    if record.lock != "locked" and len(races) == 2:
        total = sum(other.order for other in races.values())
        spare = sum(other.order_half for other in (*races.values(), record))
        if abs(record.order - total) > max(2.0 * spare, 1e-3 * total):
            return None
    struck = sorted({other.line for other in own if other.seen_in == "envelope"} - {"BPFO", "BPFI"})
    return replace(record, verdict=f"{record.verdict} {races_words(sorted(races), struck)}")


def _vibration_record(place: Place, orders: AgreedOrders, *, revs_per_cycle: int) -> BearingFinding | None:
    """Record of ``place`` where an order of the vibration lies in it; None where none does."""
    ends = [(order, half_width(order.degrees_of_freedom) * order.order_error) for order in orders]
    near = [order for order, spare in ends if place.low - spare <= order.order <= place.high + spare]
    if place.line != "N*fs":  # no order of the engine's cycle: locked, or on a multiple as far as can be told
        off = {order.order: abs(order.order - round(order.order * revs_per_cycle) / revs_per_cycle) for order in near}
        free = [order for order in near if order.lock == "slips" or off[order.order] > 2.0 * order.order_error]
        near = [order for order in free if order.lock != "locked"]
    if not near:
        return None
    # the height over the local floor compares channels of different units
    pairs = [(order, line) for order in near for line in order.lines]
    best, line = max(pairs, key=lambda pair: pair[1].level_over_floor_db)
    law = growth(line)
    steady = law is not None and law.law == "keeps its size"
    level = mean_level(line) if steady else reported(line, law)
    part = StatedPart("bearing", place.name, best.order, half_width(best.degrees_of_freedom) * best.order_error)
    multiples = [n for n in (2, 3, 4) if any((part, n) in parts_at([part], order).near for order in orders)]
    return _record(
        place,
        (best.order, best.order_error, best.degrees_of_freedom),
        shaft=None,
        seen_in="vibration",
        amplitude=level.amplitude,
        amplitude_ci95=(level.low, level.high),
        channel=line.channel,
        speed_rpm=level.speed_rpm,
        is_mean=steady,
        harmonics=1 + len(multiples),
        lock=best.lock,
        judged=vibration_verdict(place, best, revs_per_cycle=revs_per_cycle),
        evidence=f"{line.evidence}; {line.level_over_floor_db:.1f} dB over the local floor in {line.channel}, "
        f"{len(best.lines)} channels show it",
    )


def _record(
    place: Place, told: tuple[float, float, float], shaft: ShaftSpeed | None, judged: Judged, **seen: Any
) -> BearingFinding:
    """Finding of a line as it was ``seen``, of which order, standard error and degrees of freedom of that are ``told``.

    ``judged`` is the verdict on it. Slip is that beside the true speed of the ``shaft``, where it was read.
    """
    order, half = told[0], told[1] * half_width(told[2])
    factor, factor_error = (shaft.factor, shaft.error) if shaft is not None else (1.0, 0.0)
    slip = place.slip_percent(order / factor)
    half_slip = 100.0 / place.expected * math.hypot(half, Z95 * factor_error * order)
    return BearingFinding(
        name=place.name,
        line=place.line,
        order=order,
        order_ci95=positive_interval(order, half),
        order_expected=place.expected,
        slip_percent=slip,
        slip_percent_ci95=(slip - half_slip, slip + half_slip),
        **judged._asdict(),
        **seen,
    )


def _envelope_record(
    line: EnvelopeLine, found: list[EnvelopeLine], envelope: xr.Dataset, shaft: ShaftSpeed | None, level: float
) -> BearingFinding:
    """Record of a ``line`` of the envelope among all ``found``; ``shaft``: its speed, where sidebands tell it.

    ``level``: the false-alarm probability of the whole test.
    """
    names = envelope["channel"].values.tolist()
    nominal = envelope.attrs["speed_basis"] == "nominal"
    drawn = [float(envelope[end].values[line.channel, line.speed]) for end in ("band_low", "band_high")]
    band = list(line.band_hz) if math.isfinite(line.band_hz[0]) else drawn
    seen = line.seen.any(axis=0).sum()
    alone = "" if seen else ", so only in the mean of all"
    apart = "" if line.sidebands is None else f", sidebands {line.sidebands:.3g} apart"
    chance = "below 1e-12" if line.chance < 1e-12 else f"{line.chance:.1e}"
    text = (
        f"{10.0 * math.log10(line.ratio):.1f} dB over the envelope's floor in {names[line.channel]}, band "
        f"{band[0]:.0f} to {band[1]:.0f} Hz; over the level at {seen} of {envelope.sizes['speed']} speeds{alone}; "
        f"{line.harmonics} of its first 4 multiples{apart}; chance that noise makes it anywhere in the test {chance} "
        f"(level {level:g})"
    )
    return _record(
        line.place,
        (line.order, line.order_error, line.freedom),
        shaft,
        seen_in="envelope",
        amplitude=line.amplitude,
        amplitude_ci95=size_interval(line.amplitude, Z95 * line.amplitude_error),
        channel=names[line.channel],
        speed_rpm=float(envelope["speed"].values[line.speed]),
        band_hz=(band[0], band[1]),
        harmonics=line.harmonics,
        sidebands=line.sidebands,
        lock="slips",
        shaft_order=shaft.factor * line.place.shaft_order if shaft is not None else None,
        judged=envelope_verdict(line, found, speed_is_nominal=nominal, shaft=shaft),
        evidence="; ".join([text, *line.also]),
    )


NUMBERS = MethodNumbers("5-identify-bearings.toml", "verdicts")

DAMAGED = {"BPFO": "the outer race", "BPFI": "the inner race", "BSF": "a rolling element", "FTF": "the cage"}

RE_RUN = "Re-run the same test: an amplitude that grows speaks for a failing bearing."


class Judged(NamedTuple):
    """A verdict in words, whether it calls the line damage, and whether running the test again tells more."""

    verdict: str
    damage: bool = False
    re_run: bool = False


def vibration_verdict(place: Place, order: AgreedOrder, *, revs_per_cycle: int) -> Judged:
    """Verdict on an ``order`` of the vibration at ``place``: a bearing, or a part that keeps step with the shaft.

    ``revs_per_cycle``: crank revolutions of an engine cycle, whose multiples combustion makes.
    """
    slip = _slip_words(place.slip_percent(order.order))
    needed = math.inf if order.needed_revs is None else order.needed_revs
    revs = f"; a recording of {math.ceil(needed)} revolutions would tell" if math.isfinite(needed) else ""
    if place.line != "N*fs":
        undecided = f" Whether it slips is not decided{revs}." if order.lock == "undecided" else ""
        text = f"Order {order.order:.4g} may be {DAMAGED[place.line]} of {place.name}: {slip}.{undecided}"
        return Judged(f"{text} {RE_RUN}", re_run=True)
    # BPFO + BPFI for every geometry, and a multiple of the shaft's order as well
    n, shaft = place.elements or 0, place.shaft_order
    whose = "the crankshaft" if shaft == 1.0 else f"the shaft that turns at {shaft:g} of the crank's speed"
    if order.lock == "locked":
        cycle = place.expected * revs_per_cycle
        fired = " In a firing engine combustion makes this order too." if abs(cycle - round(cycle)) < 1e-9 else ""
        text = f"Exactly locked: {n} x of {whose}, such as a toothed or lobed part. BPFO + BPFI adds up to it too, "
        return Judged(f"{text}at any slip of the cage.{fired}")
    if order.lock == "slips":
        text = (
            f"Slips ({slip}), so no part that keeps step with {whose}, nor BPFO + BPFI on it: "
            f"the {n} rolling elements of {place.name}, passing more slowly or faster than it turns."
        )
        return Judged(f"{text} {RE_RUN}", re_run=True)
    return Judged(
        f"Either the {n} rolling elements of {place.name} (N*fs = BPFO + BPFI) or a part with {n} teeth or lobes on "
        f"{whose}: not decided{revs}."
    )


def races_words(races: list[str], struck: list[str]) -> str:
    """What the ``races`` (BPFO, BPFI) of a bearing that were found, in vibration or envelope, say of its N*fs.

    ``struck``: its other lines that the envelope shows.
    """
    if not races and struck:
        verb = "was" if len(struck) == 1 else "were"
        return f"Neither of its races was found, but {' and '.join(struck)} {verb}, in the envelope: see there."
    if not races:
        return "Neither of its races was found: no bearing alarm."
    return f"{' and '.join(races)} of the same bearing {'was' if len(races) == 1 else 'were'} found: see there."


def _damage(place: Place) -> str:
    return "strikes of every rolling element" if place.line == "N*fs" else f"damage of {DAMAGED[place.line]}"


def _slip_words(slip_percent: float) -> str:
    if abs(slip_percent) < 0.005:
        return "just as in pure rolling"
    return f"{abs(slip_percent):.2f} % {'slower' if slip_percent > 0.0 else 'faster'} than in pure rolling"


def envelope_verdict(
    line: EnvelopeLine, found: list[EnvelopeLine], *, speed_is_nominal: bool, shaft: ShaftSpeed | None = None
) -> Judged:
    """Verdict on a ``line`` of the envelope among all ``found``: which part is damaged, and how sure that is.

    ``speed_is_nominal``: where the speed was stated and not measured, its error looks like slip; ``shaft``: what the
    sidebands tell of it.
    """
    place = line.place
    slip = _slip_words(place.slip_percent(line.order / (shaft.factor if shaft is not None else 1.0)))
    kin = [other for other in found if other.place.name == place.name and other.place.line != place.line]
    higher = [other for other in kin if (other.level_db, other.ratio) > (line.level_db, line.ratio)]
    lead = max(higher, key=lambda other: (other.level_db, other.ratio), default=None)
    beside = [] if lead is None else _rivals(lead, found)
    # a line goes with a higher one of its bearing, unless it may be the damage itself
    if lead is not None and place.line not in {rival.place.line for rival in beside}:
        share = line.amplitude / lead.amplitude
        goes = "the strikes there" if beside else f"{_damage(lead.place)} as the load passes the rolling elements"
        return Judged(
            f"{place.title} of {place.name} ({slip}) with {share:.0%} of the amplitude of {lead.place.title}: it goes "
            f"with {goes}; no second damage is concluded."
        )
    rivals = _rivals(line, found)
    text = _part_words(line, rivals, slip)
    if speed_is_nominal and shaft is None:
        text += " The speed is nominal: its error looks like slip."
    elif speed_is_nominal and shaft is not None:
        off, error = 100.0 * (shaft.factor - 1.0), 100.0 * Z95 * shaft.error
        text += (
            f" The stated speed is nominal: by the spacing of the sidebands the shaft turns {abs(off):.2f} % "
            f"{'faster' if off > 0.0 else 'slower'} (± {error:.2f} %), and the slip is counted from that."
        )
    others = [other for other in found if other is not line]
    same = [
        f"{other.place.name} {other.place.title}"
        for other in others
        if abs(other.order - line.order) <= 3.0 * math.hypot(other.order_error, line.order_error)
    ]
    text += f" {', '.join(same)} cannot be told from it." if same else ""
    damage = place.line != "N*fs" and (not rivals or line.ranking.of(place.line) is None)
    return Judged(f"{text} {RE_RUN}", damage, re_run=True)


def _rivals(line: EnvelopeLine, found: list[EnvelopeLine]) -> list[Candidate]:
    """Parts of its bearing that that of ``line`` is not told from.

    They stand about as high by their harmonics, or have a line of about its amplitude among those ``found``; a cage's
    goes with every damage that comes and goes with the load.
    """
    ranked, place_line = line.ranking, line.place.line
    highest = (ranked.candidates[0], *ranked.rivals()) if ranked.candidates else ()
    high = {candidate.place.line for candidate in highest}
    kin = [other for other in found if other.place.name == line.place.name]
    # a damaged cage has many harmonics: a line at one of them speaks for no other part
    large = {
        other.place.line
        for other in kin
        if other.place.line not in ("FTF", "N*fs")
        and other.amplitude >= NUMBERS.companion_share * line.amplitude
        and not (place_line == "FTF" and abs((n := other.order / line.order) - round(n)) <= NUMBERS.off_share)
    }
    return [candidate for candidate in ranked.candidates if candidate.place.line in (high | large) - {line.place.line}]


def _part_words(line: EnvelopeLine, rivals: list[Candidate], slip: str) -> str:
    """Which part a ``line`` that goes with no other tells of, by how much, and which of ``rivals`` it may be."""
    place, ranked = line.place, line.ranking
    own = ranked.of(place.line)
    damaged = f"{_damage(place).capitalize()} of {place.name}: strikes at {place.title}, {slip}"
    if own is None:
        return f"{damaged}."
    if not rivals:
        first, *others = ranked.candidates
        more = f", {first.level_db - others[0].level_db:.0f} dB more than {others[0].place.title}" if others else ""
        return f"{damaged}; its harmonics stand {own.level_db:.0f} dB over the floor{more}."
    levels = ", ".join(f"{rival.place.title} {rival.level_db:.0f} dB" for rival in (own, *rivals))
    levels = f"is not told (harmonics over the floor: {levels})"
    strikes = f"Strikes at {place.title} of {place.name}, {slip}"
    if {place.line, *(rival.place.line for rival in rivals)} == {"BPFO", "BPFI"}:
        both = "both races are struck, as by a damaged rolling element, by dirt or by damage of both"
        return f"{strikes}, and about as strong at {rivals[0].place.title}: {both}; which part {levels}."
    parts = " or ".join(DAMAGED[rival.place.line] for rival in (own, *rivals))
    return f"{strikes}: damage of {parts}; which of them {levels}."


SIDEBAND_NUMBERS = MethodNumbers("5-identify-bearings.toml", "shaft_speed")


class ShaftSpeed(NamedTuple):
    """The shaft's speed as a multiple of the stated one, with its standard error, and pairs of sidebands that tell."""

    factor: float
    error: float
    pairs: int


def shaft_speed(spectra: Spectra, line: EnvelopeLine) -> ShaftSpeed | None:
    """Speed of the shaft beside the stated one by the sidebands of ``line`` in ``spectra``; None where none tell.

    The sidebands of each of its first harmonics stand one turn of the bearing's shaft to both sides: half of their
    distance is free of the error of the line itself. All pairs have to agree.
    """
    ratio, cell = spectra.ratio[line.channel, line.speed], float(spectra.cell[line.speed])
    step, nominal = float(spectra.order[1]), line.place.shaft_order
    carriers = [times * line.order for times in range(1, SIDEBAND_NUMBERS.carriers + 1)]
    pairs = [pair for carrier in carriers if (pair := _pair(ratio, step, cell, carrier, nominal)) is not None]
    if not pairs:
        return None
    spacing, error = np.array(pairs).T
    weight = error**-2.0
    mean = float((weight * spacing).sum() / weight.sum())
    if np.abs(spacing - mean).max() > SIDEBAND_NUMBERS.most_spread_sigmas * float(error.max()):
        return None
    return ShaftSpeed(mean / nominal, float(weight.sum() ** -0.5) / nominal, len(pairs))


def _pair(ratio: Floats, step: float, cell: float, carrier: float, spacing: float) -> tuple[float, float] | None:
    """Distance of a ``carrier`` to its sidebands about ``spacing`` away, with its error; None without a pair."""
    reach = SIDEBAND_NUMBERS.most_off_share * spacing + cell
    peaks = [_peak(ratio, step, carrier + side * spacing, reach) for side in (-1, 1)]
    (low, low_ratio), (high, high_ratio) = (peak or (math.nan, math.nan) for peak in peaks)
    # the pair is one of sidebands only where the carrier is in its middle
    if not abs(0.5 * (low + high) - carrier) <= cell:
        return None
    return 0.5 * (high - low), 0.5 * math.hypot(place_error(low_ratio, cell), place_error(high_ratio, cell))


def _peak(ratio: Floats, step: float, near: float, reach: float) -> tuple[float, float] | None:
    """Order and power ratio of the highest peak within ``reach`` of ``near``; None where none is high enough."""
    first, last = max(math.ceil((near - reach) / step), 1), math.floor((near + reach) / step)
    if last >= len(ratio) - 1 or last < first:
        return None
    at = first + int(np.argmax(ratio[first : last + 1]))
    if ratio[at] < SIDEBAND_NUMBERS.least_ratio or ratio[at] < max(ratio[at - 1], ratio[at + 1]):
        return None
    return (at + parabola(ratio, at)) * step, float(ratio[at])
