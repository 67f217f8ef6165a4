"""ShaftAngle from a Recording, for every kind of encoder."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from crankorder.errors import InputError
from crankorder.quantities import QualityFlag, ShaftAngle, check_dataset, with_flags
from crankorder.settings import ShaftSettings
from crankorder.shaft.angle import AngleKnots, angle_knots
from crankorder.shaft.pulses import Remark
from crankorder.shaft.speed_signal import integrated_speed
from crankorder.shaft.wheel import NumberedTeeth, number_teeth

# Jitter so many times the noise of sampling is worth a remark.
FEWEST_SAMPLES_PER_TOOTH = 2.5
"""A tooth and its gap need a sample each, and the fastest teeth of a turn are shorter than the mean."""

JITTER_RATIO = 1.5
PULSE_KINDS = ("square", "analogue", "pulse_times", "edge_list")


def shaft_angle(recording: xr.Dataset, *, settings: ShaftSettings) -> ShaftAngle:
    """Crank angle and speed of one recording on time knots, with the standard error of the angle and quality flags.

    Parameters
    ----------
    recording : Recording (see ``data_schema/recording.json``), sampled by time or by crank angle; the knots are on the
        clock of its samples, the first of which is at ``start_s``
    settings : how pulses become angle

    Raises
    ------
    InputError naming the recording where its encoder cannot be decoded or it has none.
    """
    name = str(recording.attrs["recording"])
    try:
        if recording.attrs["domain"] == "crank_angle":
            return _dataset(recording, _sampled_by_angle(recording), "tdc", 0, [])
        kind = str(recording.attrs["encoder_kind"])
        if kind in PULSE_KINDS:
            return _from_pulses(recording, settings)
        if kind == "speed":
            return _from_speed(recording, settings)
        if kind == "constant":
            return _from_constant(recording)
    except InputError as error:
        if error.file:
            raise
        raise type(error)(
            error.problem, file=name, place=error.place, found=error.found, allowed=error.allowed, remedy=error.remedy
        ) from None
    raise InputError(
        "no encoder, so no crank angle",
        file=name,
        place="encoder.kind",
        found=kind,
        allowed=", ".join((*PULSE_KINDS, "speed", "constant")),
        remedy="Name the encoder, a speed channel or a constant speed_rpm in run.toml",
    )


def _from_pulses(recording: xr.Dataset, settings: ShaftSettings) -> ShaftAngle:
    attrs = recording.attrs
    if "pulse_time" not in recording.variables:
        raise InputError(
            "the recording holds no pulse times", place="encoder", remedy="Check the encoder's source in run.toml"
        )
    pulses_per_rev, ratio = int(attrs.get("pulses_per_rev", 1)), float(attrs.get("ratio", 1.0))
    stated = float(attrs.get("pulse_noise_s", 0.0))
    noise = stated if stated > 0.0 else None
    index = recording["index_time"].values.astype(np.float64) if "index_time" in recording.variables else None
    teeth = number_teeth(
        recording["pulse_time"].values.astype(np.float64),
        pulses_per_rev=pulses_per_rev,
        settings=settings,
        missing_teeth=int(attrs.get("missing_teeth", 0)),
        index_time_s=index,
        ratio=ratio,
        noise_s=noise or 0.0,
    )
    knots = angle_knots(
        teeth.time_s,
        teeth.tooth,
        teeth_per_rev=pulses_per_rev * ratio,
        noise_s=noise,
        settings=settings,
    )
    tdc, reference, flags = _tdc(teeth, pulses_per_rev, recording)
    first = (teeth.tooth[0] / (pulses_per_rev * ratio)) - tdc
    if noise is not None and knots.noise_s > JITTER_RATIO * noise:
        share = knots.noise_s / float(np.median(np.diff(teeth.time_s)))
        flags.append(
            ("encoder_jitter", "info", f"pulses jitter by {share:.2g} of their distance, more than their sampling")
        )
    flags += _undersampled(recording, teeth)
    knots = replace(knots, angle_rev=knots.angle_rev - tdc - np.ceil(first - 1e-9))
    return _dataset(recording, knots, reference, teeth.time_s.size, [*teeth.flags, *flags])


def _undersampled(recording: xr.Dataset, teeth: NumberedTeeth) -> list[Remark]:
    """Remark where a sampled encoder has too few samples per tooth: edges are lost then without any trace."""
    if recording.attrs.get("encoder_kind") not in ("square", "analogue") or "rate_hz" not in recording.attrs:
        return []
    steps = np.diff(teeth.time_s) / np.diff(teeth.tooth) * float(recording.attrs["rate_hz"])
    fewest = float(np.quantile(steps, 0.02))
    if fewest >= FEWEST_SAMPLES_PER_TOOTH:
        return []
    start = float(teeth.time_s[int(np.argmax(steps < FEWEST_SAMPLES_PER_TOOTH))])
    detail = f"only {fewest:.1f} samples per tooth, first at {start:.3g} s: teeth pass unseen; sample faster"
    return [("encoder_undersampled", "bad", detail)]


def _tdc(teeth: NumberedTeeth, pulses_per_rev: int, recording: xr.Dataset) -> tuple[float, str, list[Remark]]:
    """Angle [rev] of a top dead centre, on the scale where tooth 0 is 0; what it rests on; remarks."""
    attrs = recording.attrs
    ratio = float(attrs.get("ratio", 1.0))
    to_tdc_rev = float(attrs.get("index_to_tdc_deg", 0.0)) / 360.0
    flags: list[Remark] = []
    if not np.isfinite(teeth.index_tooth):
        if not any(flag == "no_index" for flag, _, _ in teeth.flags):
            flags.append(
                ("no_index", "suspect", "no once-per-revolution mark: orders yes, but their phase has no reference")
            )
        return float(teeth.tooth[0]) / (pulses_per_rev * ratio), "none", flags
    turns = 1.0 / ratio
    if abs(turns - round(turns)) > 1e-9:
        detail = f"the encoder turns {ratio:g} times per crank revolution: its mark is at top dead centre only once"
        flags.append(("index_not_on_crank", "suspect", detail))
    if "index_to_tdc_deg" in attrs:
        reference = "tdc"
    else:
        reference = "pulse" if pulses_per_rev == 1 and "index_time" not in recording.variables else "index"
    if int(attrs["revs_per_cycle"]) != 1:
        flags.append(
            (
                "cycle_phase_unknown",
                "info",
                "which top dead centre fires is not known: half orders may be turned by 180°",
            )
        )
    return teeth.index_tooth / (pulses_per_rev * ratio) + to_tdc_rev, reference, flags


def _from_speed(recording: xr.Dataset, settings: ShaftSettings) -> ShaftAngle:
    if "speed_signal" not in recording.variables:
        raise InputError(
            "the recording holds no speed signal", place="encoder", remedy="Check the encoder's source in run.toml"
        )
    knots, flags = integrated_speed(
        recording["speed_signal"].values, rate_hz=float(recording.attrs["rate_hz"]), settings=settings
    )
    return _dataset(recording, knots, "none", 0, [*flags, _NO_PHASE])


def _from_constant(recording: xr.Dataset) -> ShaftAngle:
    speed = float(recording.attrs.get("speed_rpm", np.nan))
    if not speed > 0.0:
        raise InputError(
            "the constant speed is not known",
            place="encoder",
            found=f"{speed:g} rpm",
            remedy="State speed_rpm in run.toml",
        )
    time_s = np.array([0.0, recording["signal"].shape[1] / float(recording.attrs["rate_hz"])])
    knots = AngleKnots(time_s, time_s * speed / 60.0, np.full(2, speed), np.full(2, np.nan), np.nan, np.nan)
    return _dataset(recording, knots, "none", 0, [_NO_PHASE])


_NO_PHASE: Remark = ("no_index", "suspect", "no encoder pulses: orders yes, but their phase has no reference")


def _sampled_by_angle(recording: xr.Dataset) -> AngleKnots:
    attrs = recording.attrs
    angle = float(attrs.get("start_deg", 0.0)) / 360.0 + np.array(
        [0.0, (recording["signal"].shape[1] - 1) / float(attrs["samples_per_rev"])]
    )
    speed = float(attrs.get("speed_rpm", np.nan))
    return AngleKnots((angle - angle[0]) * 60.0 / speed, angle, np.full(2, speed), np.zeros(2), np.nan, np.nan)


def _dataset(
    recording: xr.Dataset, knots: AngleKnots, reference: str, n_pulses: int, remarks: list[Remark]
) -> ShaftAngle:
    """The ShaftAngle dataset, signed in its history."""
    name = str(recording.attrs["recording"])
    start_s = float(recording.attrs.get("start_s", 0.0))
    columns: dict[str, tuple[Any, str, str]] = {
        "time": (knots.time_s + start_s, "s", "time of the knot"),
        "crank_angle": (knots.angle_rev, "rev", "crank angle from top dead centre"),
        "speed": (knots.speed_rpm, "min-1", "crank speed"),
        "standard_error": (knots.standard_error_rev, "rev", "standard error of the crank angle"),
    }
    signed = f"shaft: {knots.time_s.size} knots from {n_pulses} pulses, angle 0 is {reference}"
    shaft = xr.Dataset(
        {key: ("knot", value, {"units": unit, "long_name": text}) for key, (value, unit, text) in columns.items()},
        attrs={
            "recording": name,
            "phase_reference": reference,
            "cycle_known": int(int(recording.attrs["revs_per_cycle"]) == 1),
            "revs_per_cycle": int(recording.attrs["revs_per_cycle"]),
            "n_pulses": n_pulses,
            "domain": str(recording.attrs["domain"]),
            "history": f"{recording.attrs.get('history', '')}\n{signed}".lstrip(),
        },
    )
    shaft = with_flags(
        shaft, [QualityFlag(recording=name, flag=flag, severity=how, detail=text) for flag, how, text in remarks]
    )
    check_dataset(shaft, "shaft_angle")
    return ShaftAngle(shaft)
