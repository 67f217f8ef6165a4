"""Bearing lines of a test, in its orders and in its envelopes, each with slip, evidence and a verdict in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import xarray as xr

from crankorder.engine.bearings import Bearing
from crankorder.findings import BearingFinding
from crankorder.identify.bearings.envelope_lines import EnvelopeLine, Spectra, envelope_lines, spectra_of
from crankorder.identify.bearings.places import Place, bearing_places
from crankorder.identify.bearings.shaft_speed import ShaftSpeed, shaft_speed
from crankorder.identify.bearings.verdicts import envelope_evidence, envelope_verdict, races_words, vibration_verdict
from crankorder.identify.found import AgreedOrder, OrderLine
from crankorder.identify.intervals import Z95, half_width, positive_interval
from crankorder.identify.lines.growth import growth, largest, mean_level
from crankorder.identify.stated_parts import StatedPart, parts_at
from crankorder.settings import IdentifySettings


def bearing_records(
    orders: tuple[AgreedOrder, ...],
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
    records = [
        record
        for place in places
        if (record := _vibration_record(place, orders, revs_per_cycle=revs_per_cycle)) is not None
    ]
    if envelope is not None and envelope.sizes["order"] > 1 and envelope.sizes["speed"]:
        spectra = spectra_of(envelope)
        level = settings.bearing_false_alarm_probability
        found = envelope_lines(spectra, places, false_alarm_probability=level)
        speeds = _shaft_speeds(spectra, found) if envelope.attrs["speed_basis"] == "nominal" else {}
        records += [_envelope_record(line, found, spectra, envelope, level=level, shafts=speeds) for line in found]
    return tuple(_with_races(record, records) for record in records if not _is_excluded(record, records))


def _is_excluded(record: BearingFinding, records: Sequence[BearingFinding]) -> bool:
    """Whether a ``record`` of N*fs in the vibration that slips is not the sum of both races as they were found."""
    if record.line != "N*fs" or record.seen_in != "vibration" or record.lock == "locked":
        return False
    races = {one.line: one for one in records if one.name == record.name and one.line in ("BPFO", "BPFI")}
    if len(races) < 2:
        return False
    total = sum(one.order for one in races.values())
    spare = sum(one.order_half for one in (*races.values(), record))
    return bool(abs(record.order - total) > max(2.0 * spare, 1e-3 * total))


def _with_races(record: BearingFinding, records: Sequence[BearingFinding]) -> BearingFinding:
    """``record`` of N*fs with a word on the races of the same bearing: they slip where their sum keeps step."""
    if record.line != "N*fs" or record.seen_in != "vibration":
        return record
    own = [one for one in records if one.name == record.name and one is not record]
    races = sorted({one.line for one in own} & {"BPFO", "BPFI"})
    struck = sorted({one.line for one in own if one.seen_in == "envelope"} - {"BPFO", "BPFI"})
    return replace(record, verdict=f"{record.verdict} {races_words(races, struck)}")


def _vibration_record(place: Place, orders: tuple[AgreedOrder, ...], *, revs_per_cycle: int) -> BearingFinding | None:
    """Record of ``place`` where an order of the vibration lies in it; None where none does."""
    near = [order for order in orders if _within(order, place)]
    if place.line != "N*fs":
        near = [order for order in near if not _is_locked(order, revs_per_cycle)]
    if not near:
        return None
    best = max(near, key=lambda order: max(_height(line) for line in order.lines))
    line = max(best.lines, key=_height)
    law, best_seen = growth(line), largest(line)
    steady = law is not None and law.law == "keeps its size"
    level = mean_level(line) if steady else best_seen
    part = StatedPart("bearing", place.name, best.order, half_width(best.degrees_of_freedom) * best.order_error)
    multiples = [n for n in (2, 3, 4) if any((part, n) in parts_at([part], order).near for order in orders)]
    return _record(
        place,
        best.order,
        best.order_error,
        best.degrees_of_freedom,
        seen_in="vibration",
        amplitude=level.amplitude,
        amplitude_ci95=(level.low, level.high),
        channel=line.channel,
        speed_rpm=best_seen.speed_rpm,
        band_hz=None,
        harmonics=1 + len(multiples),
        sidebands=None,
        lock=best.lock,
        verdict=vibration_verdict(place, best, revs_per_cycle=revs_per_cycle),
        evidence=f"{line.evidence}; {line.level_over_floor_db:.1f} dB over the local floor in {line.channel}, "
        f"{len(best.lines)} channels show it" + ("; its mean over all speeds, for it keeps its size" if steady else ""),
    )


def _height(line: OrderLine) -> float:
    """How far a line stands over the local floor: what compares channels of different units."""
    return line.level_over_floor_db


def _within(order: AgreedOrder, place: Place) -> bool:
    spare = half_width(order.degrees_of_freedom) * order.order_error
    return place.low - spare <= order.order <= place.high + spare


def _is_locked(order: AgreedOrder, revs_per_cycle: int) -> bool:
    """Whether an order belongs to the engine's cycle: locked, or on one of its multiples as far as can be told."""
    multiple = round(order.order * revs_per_cycle) / revs_per_cycle
    return order.lock == "locked" or (
        order.lock == "undecided" and abs(order.order - multiple) <= 2.0 * order.order_error
    )


def _shaft_speeds(spectra: Spectra, found: list[EnvelopeLine]) -> dict[tuple[str, int], ShaftSpeed]:
    """Speed of the shaft by bearing and number of the speed, of the line of each whose sidebands tell it best."""
    made: dict[tuple[str, int], ShaftSpeed] = {}
    for line in found:
        key, speed = (line.place.name, line.speed), shaft_speed(spectra, line)
        if speed is not None and (key not in made or speed.error < made[key].error):
            made[key] = speed
    return made


def _record(
    place: Place, order: float, error: float, freedom: float, shaft: ShaftSpeed | None = None, **seen: Any
) -> BearingFinding:
    """Finding of a line at ``order`` with its standard ``error`` of so many degrees of ``freedom``, as it was ``seen``.

    Slip is that beside the true speed of the ``shaft``, where it was read.
    """
    half = error * half_width(freedom)
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
        **seen,
    )


def _envelope_record(
    line: EnvelopeLine,
    found: list[EnvelopeLine],
    spectra: Spectra,
    envelope: xr.Dataset,
    *,
    level: float,
    shafts: dict[tuple[str, int], ShaftSpeed],
) -> BearingFinding:
    """Record of a ``line`` of the envelope among all ``found``; ``shafts``: speeds that sidebands tell."""
    names = envelope["channel"].values.tolist()
    nominal = envelope.attrs["speed_basis"] == "nominal"
    drawn = [float(envelope[end].values[line.channel, line.speed]) for end in ("band_low", "band_high")]
    band = list(line.band_hz) if math.isfinite(line.band_hz[0]) else drawn
    half = Z95 * line.amplitude_error
    shaft = shafts.get((line.place.name, line.speed))
    spoken = envelope_verdict(line, found, speed_is_nominal=nominal, shaft=shaft)
    return _record(
        line.place,
        line.order,
        line.order_error,
        line.freedom,
        shaft,
        seen_in="envelope",
        amplitude=line.amplitude,
        amplitude_ci95=(max(0.0, line.amplitude - half), line.amplitude + half),
        channel=names[line.channel],
        speed_rpm=float(spectra.speed_rpm[line.speed]),
        band_hz=(band[0], band[1]),
        harmonics=line.harmonics,
        sidebands=line.sidebands,
        lock="slips",
        shaft_order=shaft.factor * line.place.shaft_order if shaft is not None else None,
        verdict=spoken,
        evidence=envelope_evidence(line, names, band, level=level, n_speeds=len(spectra.speed_rpm)),
    )
