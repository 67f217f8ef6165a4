"""Overall level of each channel over a test, what lies above the band looked at, and what limits say of the levels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from crankorder.campbell.levels import UNITS, WITH_ENDS, WITHOUT_ENDS, nominal_hz
from crankorder.campbell.vibration_levels import CONFIDENCE, rms_within
from crankorder.findings import Balance, Level, LimitVerdict, ThirdOctave, VibrationLevel
from crankorder.identify.machine_model import Limit, MachineModel
from crankorder.quantities import Floats, Ints
from crankorder.records import Interval, finite, known

MOST_SPEEDS = 24
"""Speeds at which a level stands in the findings; of more, the loudest alone: all of them are in the dataset."""


_AT_ENDS = 0.2
"""Of what lies at the ends of a band half passes; where less than that share does, it is a level that changes."""


def level_records(levels: Sequence[xr.Dataset]) -> tuple[Level, ...]:
    """Records of all channels from the RecordingLevels ``levels`` of the recordings of a test; none without any.

    ``rms_max`` is that of the loudest recording; ``share_above`` that of all energy of the recordings alike; of the
    lines above the band the strongest is told.
    """
    tables = [
        pd.DataFrame({name: recording[name].values for name in ("channel", "unit", *_LEVELS)}).assign(
            band_hz=recording.attrs["band_hz"]
        )
        for recording in levels
    ]
    return tuple(_record(table) for _, table in pd.concat(tables).groupby("channel", sort=False)) if tables else ()


_LEVELS = ("rms", "share_above", "peak_above", "peak_frequency", "peak_band", "peak_order", "peak_speed")


def _record(table: pd.DataFrame) -> Level:
    """Record of the channel of which ``table`` has a row for each recording."""
    measured = table.dropna(subset=["rms", "share_above"])
    energy = measured["rms"] ** 2
    strongest = table.iloc[int(np.argmax(np.nan_to_num(table["peak_above"])))]
    return Level(
        channel=strongest["channel"],
        unit=strongest["unit"],
        rms_max=finite(measured["rms"].max()),
        band_hz=finite(table["band_hz"].max()),
        share_above=float(energy @ measured["share_above"] / energy.sum()) if energy.sum() > 0.0 else None,
        amplitude_above=strongest["peak_above"] if strongest["peak_above"] > 0.0 else None,
        frequency_hz_above=finite(strongest["peak_frequency"]),
        band_hz_there=finite(strongest["peak_band"]),
        order_above=finite(strongest["peak_order"]),
        speed_rpm_above=finite(strongest["peak_speed"]),
    )


Columns = Mapping[str, NDArray[Any]]
"""Values of VibrationLevels by name: of the levels (level,), the speeds (speed,) or both (level, speed)."""


def _values(vibration: xr.Dataset) -> Columns:
    return {str(name): variable.values for name, variable in vibration.variables.items()}


def vibration_records(vibration: xr.Dataset) -> tuple[VibrationLevel, ...]:
    """Records of the broad-band levels of the VibrationLevels ``vibration``: one per channel, band and speed."""
    records, table = list[VibrationLevel](), _values(vibration)
    for row in _rows(table, kind="broad band"):
        there = np.flatnonzero(np.isfinite(table["rms"][row])).tolist()
        loudest = int(np.nanargmax(table["rms"][row])) if there else -1
        for column in there if len(there) <= MOST_SPEEDS else [loudest]:
            numbers = ("peak", "largest_peak", "crest_factor")
            told: dict[str, Any] = {key: finite(table[key][row, column]) for key in numbers}
            told |= {f"{key}_ci95": _ends(table[f"{key}_ci95"][row, column]) for key in ("rms", "peak", "crest_factor")}
            level = VibrationLevel(
                channel=str(table["channel"][row]),
                quantity=str(table["quantity"][row]),
                unit=str(table["unit"][row]),
                band_hz=(float(table["low_frequency"][row]), float(table["high_frequency"][row])),
                reached_hz=float(table["reached_frequency"][row]),
                speed_rpm=finite(table["speed"][column]),
                rms=float(table["rms"][row, column]),
                largest=column == loudest,
                **told,
            )
            records.append(level)
    return tuple(records)


def third_octave_records(vibration: xr.Dataset) -> tuple[ThirdOctave, ...]:
    """Records of the one-third octaves in the VibrationLevels ``vibration``, at each channel's loudest speed."""
    records, table = list[ThirdOctave](), _values(vibration)
    rms = table["rms"]
    for name in dict.fromkeys(table["channel"].astype(str).tolist()):
        rows = _rows(table, kind="one-third octave", channel=name)
        if not rows or not np.isfinite(rms[rows]).any():
            continue
        column = int(np.argmax(np.nansum(rms[rows] ** 2, axis=0)))
        records += [
            ThirdOctave(
                channel=name,
                unit=str(table["unit"][row]),
                speed_rpm=finite(table["speed"][column]),
                nominal_hz=nominal_hz(math.sqrt(table["low_frequency"][row] * table["high_frequency"][row])),
                rms=float(rms[row, column]),
                rms_ci95=_ends(table["rms_ci95"][row, column]),
            )
            for row in rows
            if np.isfinite(rms[row, column])
        ]
    return tuple(records)


def limit_verdicts(vibration: xr.Dataset, balance: Balance | None, sources: MachineModel) -> tuple[LimitVerdict, ...]:
    """What each limit of ``sources`` comes to in every channel of ``vibration`` that it is for, and for ``balance``."""
    verdicts: list[LimitVerdict] = []
    table = _values(vibration) if sources.limits else {}
    for limit in sources.limits:
        if limit.quantity == "balance grade":
            verdicts.append(_grade_verdict(limit, balance))
            continue
        names = table["channel"].astype(str).tolist()
        band = {"quantity": limit.quantity, "low_frequency": limit.low_hz, "high_frequency": limit.high_hz}
        rows = _rows(table, kind="broad band", **band)
        rows = [row for row in rows if not limit.channels or names[row] in limit.channels]
        verdicts += [_verdict(table, row, limit) for row in rows]
        unit, size = UNITS[limit.quantity]
        judged = [names[row] for row in rows]
        missing = [name for name in limit.channels or dict.fromkeys(names if not rows else ()) if name not in judged]
        untold = "no level could be told in that band: the recordings are too short, or sampled too slowly"
        seen = {"verdict": "not decided", "evidence": untold}
        verdicts += [_on(limit, limit.value_si / size, unit, channel=name, **seen) for name in missing]
    return tuple(verdicts)


def _on(limit: Limit, value: float, unit: str, **seen: Any) -> LimitVerdict:
    """Record of a ``limit``, which is ``value`` in that ``unit``, and of what was ``seen`` of it."""
    if limit.quantity != "balance grade":
        seen["band_hz"] = limit.low_hz, limit.high_hz
    return LimitVerdict(quantity=limit.quantity, value=value, unit=unit, source=limit.source, **seen)


def _verdict(table: Columns, row: int, limit: Limit) -> LimitVerdict:
    """What ``limit`` comes to at the level ``row`` over all speeds, which share the chance of a wrong verdict.

    A filter has no walls: what lies at the ends of the band counts whole where the level is to be surely within, and
    not at all where it is to be surely above.
    """
    value, seen = limit.value_si / float(table["si_per_unit"][row]), dict[str, Any]()
    same = {name: table[name][row] for name in ("channel", "quantity", "low_frequency", "high_frequency")}
    [least], [most] = (_rows(table, kind=kind, **same) for kind in (WITHOUT_ENDS, WITH_ENDS))
    rms = table["rms"][row]
    there = np.flatnonzero(np.isfinite(table["rms"][[row, least, most]]).all(axis=0))
    chance = (1.0 - CONFIDENCE) / max(1, len(there))
    low, high = _surely(table, least, there, chance)[0], _surely(table, most, there, chance)[1]
    loudest = int(there[np.argmax(rms[there])]) if len(there) else -1
    reached_hz = float(table["reached_frequency"][row])
    inner, whole = table["rms"][[least, most]][:, there]
    doubted = (whole > value) & (inner <= value)
    at_ends = bool(np.any(doubted & (rms[there] ** 2 - inner**2 > _AT_ENDS * (whole**2 - inner**2))))
    verdict, evidence = _judged(
        low, high, value, table["speed"][there], cut=reached_hz < limit.high_hz, reached_hz=reached_hz, at_ends=at_ends
    )
    if verdict == "above":
        over = there[np.nan_to_num(low) > value]
        loudest = int(over[np.argmax(rms[over])])
    if loudest >= 0:
        ends = _ends(np.array([table["rms_ci95"][least, loudest, 0], table["rms_ci95"][most, loudest, 1]]))
        seen = {"level": float(rms[loudest]), "level_ci95": ends, "speed_rpm": finite(table["speed"][loudest])}
    channel, unit = str(table["channel"][row]), str(table["unit"][row])
    return _on(limit, value, unit, channel=channel, verdict=verdict, evidence=evidence, **seen)


def _surely(table: Columns, row: int, there: Ints, chance: float) -> Floats:
    """Ends (low and high, speed) that the level of ``row`` leaves by ``chance`` at each speed of ``there``."""
    columns = (table[name][row, there] for name in ("rms", "log_error", "degrees_of_freedom"))
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


def graded(balance: Balance | None, sources: MachineModel, fastest_rpm: float) -> Balance | None:
    """``balance`` with its grade G = e · ω (ISO 21940-11), where its unbalance and the mass of the rotor are known.

    ``sources`` state the mass and, if at all, the speed in service; else it is that of ``fastest_rpm``.
    """
    speed = sources.service_rpm or fastest_rpm
    if balance is None or balance.residual_rotating_gmm is None or sources.rotor_kg is None or not speed > 0.0:
        return balance
    per_gmm = 1e-3 / sources.rotor_kg * 2.0 * math.pi * speed / 60.0  # g mm / kg is µm, times 1/s is µm/s
    ends = known(balance.residual_rotating_gmm_ci95)
    grade, ci95 = balance.residual_rotating_gmm * per_gmm, ends and (ends[0] * per_gmm, ends[1] * per_gmm)
    return replace(balance, grade_mm_s=grade, grade_mm_s_ci95=ci95, grade_speed_rpm=speed)


def _grade_verdict(limit: Limit, balance: Balance | None) -> LimitVerdict:
    value, told = limit.value_si * 1e3, balance or Balance()
    level, ends = told.grade_mm_s, known(told.grade_mm_s_ci95)
    verdict, evidence = "not decided", "the limit lies inside the interval"
    if ends is None:
        evidence = "no rotating unbalance was worked out" if level is None else "its interval is not known"
    elif ends[0] > value or ends[1] <= value:
        verdict, evidence = "above" if ends[0] > value else "within", "by the whole interval"
    seen = {"level": level, "level_ci95": ends, "speed_rpm": told.grade_speed_rpm}
    return _on(limit, value, "mm/s", verdict=verdict, evidence=evidence, **seen)


def _rows(table: Columns, **wanted: object) -> list[int]:
    """Levels of which each column of ``wanted`` has that value."""
    same = [table[name] == value for name, value in wanted.items()]
    return np.flatnonzero(np.logical_and.reduce(same)).tolist()


def _ends(values: Floats) -> Interval | None:
    low, high = values.tolist()
    return (low, high) if math.isfinite(low) and math.isfinite(high) else None
