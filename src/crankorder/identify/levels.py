"""Overall level of each channel over a test, what lies above the band looked at, and what limits say of the levels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import xarray as xr

from crankorder.campbell.band_levels import UNITS, WITH_ENDS, WITHOUT_ENDS, nominal_hz
from crankorder.campbell.vibration_levels import CONFIDENCE, rms_within
from crankorder.findings import Balance, Level, LimitVerdict, ThirdOctave, VibrationLevel
from crankorder.identify.sources import Limit, Sources
from crankorder.quantities import Floats, Ints
from crankorder.records import Interval, known

MOST_SPEEDS = 24
"""Speeds at which a level stands in the findings; of more, the loudest alone: all of them are in the dataset."""


_AT_ENDS = 0.2
"""Of what lies at the ends of a band half passes; where less than that share does, it is a level that changes."""


def level_records(levels: Sequence[xr.Dataset]) -> tuple[Level, ...]:
    """Records of all channels from the RecordingLevels ``levels`` of the recordings of a test; none without any.

    ``rms_max`` is that of the loudest recording; ``share_above`` that of all energy of the recordings alike; of the
    lines above the band the strongest is told.
    """
    if not levels:
        return ()
    names = levels[0]["channel"].values.tolist()
    return tuple(
        _record(name, [one.sel(channel=name) for one in levels if name in one["channel"].values]) for name in names
    )


def _record(name: str, levels: list[xr.Dataset]) -> Level:
    rms = np.array([float(one["rms"]) for one in levels])
    share = np.array([float(one["share_above"]) for one in levels])
    finite = np.isfinite(rms) & np.isfinite(share)
    energy = rms[finite] ** 2
    ends = [one.attrs["band_hz"] for one in levels if math.isfinite(one.attrs["band_hz"])]
    strongest = max(levels, key=lambda one: float(one["peak_above"]))
    amplitude = float(strongest["peak_above"])
    return Level(
        channel=name,
        unit=str(levels[0]["unit"].item()),
        rms_max=float(rms[finite].max()) if finite.any() else None,
        band_hz=max(ends) if ends else None,
        share_above=float(energy @ share[finite] / energy.sum()) if energy.sum() > 0.0 else None,
        amplitude_above=amplitude if amplitude > 0.0 else None,
        frequency_hz_above=_told(strongest["peak_frequency"]),
        band_hz_there=_told(strongest["peak_band"]),
        order_above=_told(strongest["peak_order"]),
        speed_rpm_above=_told(strongest["peak_speed"]),
    )


def _told(value: xr.DataArray) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None


def vibration_records(vibration: xr.Dataset) -> tuple[VibrationLevel, ...]:
    """Records of the broad-band levels of the VibrationLevels ``vibration``: one per channel, band and speed."""
    made: list[VibrationLevel] = []
    for row in _rows(vibration, "broad band"):
        rms = vibration["rms"].values[row]
        there = np.flatnonzero(np.isfinite(rms))
        if len(there):
            loudest = int(there[np.argmax(rms[there])])
            shown = there.tolist() if len(there) <= MOST_SPEEDS else [loudest]
            made += [_vibration_record(vibration, row, column, largest=column == loudest) for column in shown]
    return tuple(made)


def _vibration_record(vibration: xr.Dataset, row: int, column: int, *, largest: bool) -> VibrationLevel:
    at = vibration.isel(level=row, speed=column)
    return VibrationLevel(
        channel=str(at["channel"].item()),
        quantity=str(at["quantity"].item()),
        unit=str(at["unit"].item()),
        band_hz=(float(at["low_frequency"]), float(at["high_frequency"])),
        reached_hz=float(at["reached_frequency"]),
        speed_rpm=_told(at["speed"]),
        rms=float(at["rms"]),
        rms_ci95=_ends(at["rms_ci95"]),
        peak=_told(at["peak"]),
        peak_ci95=_ends(at["peak_ci95"]),
        largest_peak=_told(at["largest_peak"]),
        crest_factor=_told(at["crest_factor"]),
        crest_factor_ci95=_ends(at["crest_factor_ci95"]),
        largest=largest,
    )


def third_octave_records(vibration: xr.Dataset) -> tuple[ThirdOctave, ...]:
    """Records of the one-third octaves in the VibrationLevels ``vibration``, at each channel's loudest speed."""
    made: list[ThirdOctave] = []
    rms, names = vibration["rms"].values, vibration["channel"].values.astype(str)
    for name in dict.fromkeys(names.tolist()):
        rows = [row for row in _rows(vibration, "one-third octave") if names[row] == name]
        if not rows or not np.isfinite(rms[rows]).any():
            continue
        column = int(np.argmax(np.nansum(rms[rows] ** 2, axis=0)))
        for row in rows:
            at = vibration.isel(level=row, speed=column)
            if np.isfinite(rms[row, column]):
                middle = math.sqrt(float(at["low_frequency"]) * float(at["high_frequency"]))
                made.append(
                    ThirdOctave(
                        channel=name,
                        unit=str(at["unit"].item()),
                        speed_rpm=_told(at["speed"]),
                        nominal_hz=nominal_hz(middle),
                        rms=float(rms[row, column]),
                        rms_ci95=_ends(at["rms_ci95"]),
                    )
                )
    return tuple(made)


def limit_verdicts(vibration: xr.Dataset, balance: Balance | None, sources: Sources) -> tuple[LimitVerdict, ...]:
    """What each limit of ``sources`` comes to in every channel of ``vibration`` that it is for, and for ``balance``."""
    made: list[LimitVerdict] = []
    for limit in sources.limits:
        if limit.quantity == "balance grade":
            made.append(_grade_verdict(limit, balance))
            continue
        rows = [row for row in _rows(vibration, "broad band") if _is_for(vibration, row, limit)]
        made += [_verdict(vibration, row, limit) for row in rows]
        told = {str(vibration["channel"].values[row]) for row in rows}
        everywhere = dict.fromkeys(vibration["channel"].values.astype(str).tolist())
        unit, size = UNITS[limit.quantity]
        made += [
            LimitVerdict(
                quantity=limit.quantity,
                band_hz=(limit.low_hz, limit.high_hz),
                value=limit.value_si / size,
                unit=unit,
                source=limit.source,
                channel=name,
                verdict="not decided",
                evidence="no level could be told in that band: the recordings are too short, or sampled too slowly",
            )
            for name in (limit.channels or (() if rows else tuple(everywhere)))
            if name not in told
        ]
    return tuple(made)


def _is_for(vibration: xr.Dataset, row: int, limit: Limit) -> bool:
    at = vibration.isel(level=row)
    same = str(at["quantity"].item()) == limit.quantity
    ends = (float(at["low_frequency"]), float(at["high_frequency"])) == (limit.low_hz, limit.high_hz)
    return same and ends and (not limit.channels or str(at["channel"].item()) in limit.channels)


def _verdict(vibration: xr.Dataset, row: int, limit: Limit) -> LimitVerdict:
    """What ``limit`` comes to at the level ``row`` over all speeds, which share the chance of a wrong verdict.

    A filter has no walls: what lies at the ends of the band counts whole where the level is to be surely within, and
    not at all where it is to be surely above.
    """
    at = vibration.isel(level=row)
    value, unit = limit.value_si / float(at["si_per_unit"]), str(at["unit"].item())
    least, most = (vibration.isel(level=_beside(vibration, row, kind)) for kind in (WITHOUT_ENDS, WITH_ENDS))
    rms = at["rms"].values
    there = np.flatnonzero(np.isfinite(rms) & np.isfinite(least["rms"].values) & np.isfinite(most["rms"].values))
    chance = (1.0 - CONFIDENCE) / max(1, len(there))
    low, high = _surely(least, there, chance)[0], _surely(most, there, chance)[1]
    loudest = int(there[np.argmax(rms[there])]) if len(there) else -1
    cut, reached_hz = float(at["reached_frequency"]) < limit.high_hz, float(at["reached_frequency"])
    inner, whole = (one["rms"].values[there] for one in (least, most))
    doubted = (whole > value) & (inner <= value)
    at_ends = bool(np.any(doubted & (rms[there] ** 2 - inner**2 > _AT_ENDS * (whole**2 - inner**2))))
    rpm = at["speed"].values[there]
    verdict, evidence = _judged(low, high, value, rpm, cut=cut, reached_hz=reached_hz, at_ends=at_ends)
    if verdict == "above":
        over = there[np.nan_to_num(low) > value]
        loudest = int(over[np.argmax(rms[over])])
    ends = None if loudest < 0 else (_ends(least["rms_ci95"][loudest]), _ends(most["rms_ci95"][loudest]))
    return LimitVerdict(
        quantity=limit.quantity,
        band_hz=(limit.low_hz, limit.high_hz),
        value=value,
        unit=unit,
        source=limit.source,
        channel=str(at["channel"].item()),
        verdict=verdict,
        level=float(rms[loudest]) if loudest >= 0 else None,
        level_ci95=None if ends is None or ends[0] is None or ends[1] is None else (ends[0][0], ends[1][1]),
        speed_rpm=_told(at["speed"][loudest]) if loudest >= 0 else None,
        evidence=evidence,
    )


def _beside(vibration: xr.Dataset, row: int, kind: str) -> int:
    """The level of ``kind`` in ``vibration`` that is else as that of ``row``."""
    same = vibration["kind"].values.astype(str) == kind
    for name in ("channel", "quantity", "low_frequency", "high_frequency"):
        same &= vibration[name].values == vibration[name].values[row]
    return int(np.flatnonzero(same)[0])


def _surely(at: xr.Dataset, there: Ints, chance: float) -> Floats:
    """Ends (low and high, speed) that the level ``at`` leaves by ``chance`` at each speed of ``there``."""
    columns = (at[name].values[there] for name in ("rms", "log_error", "degrees_of_freedom"))
    return rms_within(*columns, chance=chance).T


def _judged(
    low: Floats, high: Floats, value: float, rpm: Floats, *, cut: bool, reached_hz: float, at_ends: bool
) -> tuple[Literal["within", "above", "not decided"], str]:
    """Verdict and why, from the ends of the intervals at all speeds ``rpm`` beside the limit's ``value``."""
    if not len(low):
        return "not decided", "no level could be told: the recordings are too short for that band"
    speeds = f"{len(low)} speed{'s' * (len(low) > 1)}"
    if len(low) > 1 and np.isfinite(rpm).all():
        speeds += f" from {rpm.min():.0f} to {rpm.max():.0f} rpm"
    over = int(np.sum(np.nan_to_num(low) > value))
    if over:
        return "above", f"surely larger than the limit at {over} of {speeds}"
    if cut:
        return "not decided", f"the recorder reaches only to {reached_hz:.4g} Hz: more may lie above"
    if not np.isfinite(high).all():
        return "not decided", "at some speeds there is one piece alone, which has no interval: record longer there"
    if (high <= value).all():
        return "within", f"surely smaller than the limit at each of {speeds}"
    if at_ends:
        return "not decided", "what vibrates at an end of the band decides: state a band that has it inside or outside"
    return "not decided", "the limit lies inside the interval at some speed: record longer there, or sweep more slowly"


def graded(balance: Balance | None, sources: Sources, fastest_rpm: float) -> Balance | None:
    """``balance`` with its grade G = e · ω (ISO 21940-11), where its unbalance and the mass of the rotor are known.

    ``sources`` state the mass and, if at all, the speed in service; else it is that of ``fastest_rpm``.
    """
    speed = sources.service_rpm or fastest_rpm
    if balance is None or balance.residual_rotating_gmm is None or sources.rotor_kg is None or not speed > 0.0:
        return balance
    per_gmm = 1e-3 / sources.rotor_kg * 2.0 * math.pi * speed / 60.0  # g mm / kg is µm, times 1/s is µm/s
    ends = known(balance.residual_rotating_gmm_ci95)
    return replace(
        balance,
        grade_mm_s=balance.residual_rotating_gmm * per_gmm,
        grade_mm_s_ci95=None if ends is None else (ends[0] * per_gmm, ends[1] * per_gmm),
        grade_speed_rpm=speed,
    )


def _grade_verdict(limit: Limit, balance: Balance | None) -> LimitVerdict:
    value = limit.value_si * 1e3
    level = None if balance is None else balance.grade_mm_s
    ends = None if balance is None else known(balance.grade_mm_s_ci95)
    verdict: Literal["within", "above", "not decided"] = "not decided"
    evidence = "no rotating unbalance was worked out" if level is None else "its interval is not known"
    if ends is not None:
        verdict = "above" if ends[0] > value else "within" if ends[1] <= value else "not decided"
        evidence = "the limit lies inside the interval" if verdict == "not decided" else "by the whole interval"
    return LimitVerdict(
        quantity=limit.quantity,
        value=value,
        unit="mm/s",
        source=limit.source,
        verdict=verdict,
        level=level,
        level_ci95=ends,
        speed_rpm=None if balance is None else balance.grade_speed_rpm,
        evidence=evidence,
    )


def _rows(vibration: xr.Dataset, kind: str) -> list[int]:
    return [int(row) for row in np.flatnonzero(vibration["kind"].values.astype(str) == kind)]


def _ends(values: xr.DataArray) -> Interval | None:
    low, high = (float(value) for value in values.values)
    return (low, high) if math.isfinite(low) and math.isfinite(high) else None
