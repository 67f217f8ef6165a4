"""The wheel that a recording states or shows, its pulses as teeth of it, and remarks on both."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from crankorder.errors import InputError
from crankorder.settings import ShaftSettings
from crankorder.shaft.pattern_search import find_pattern
from crankorder.shaft.pulses import FloatArray, Remark
from crankorder.shaft.repair import IntArray
from crankorder.shaft.wheel import NumberedTeeth, number_teeth

FEWEST_SAMPLES_PER_TOOTH = 2.5
"""A tooth and its gap need a sample each, and the fastest teeth of a turn are shorter than the mean."""

# Pulses that are enough to tell their noise.
MOST_NOISE_TEETH = 20_000


def stated_wheel(recording: xr.Dataset) -> tuple[dict[str, Any], list[Remark]]:
    """Arguments of ``number_teeth`` that say what wheel the ``recording`` has, and remarks on how it was found."""
    if "pulse_time" not in recording.variables:
        raise InputError(
            "the recording holds no pulse times", place="encoder", remedy="Check the encoder's source in run.toml"
        )
    pulse_s, index_s = recording["pulse_time"].values.astype(np.float64), times_of(recording, "index_time")
    return _wheel_of(recording.attrs, pulse_s, index_s)


def _wheel_of(
    attrs: dict[str, Any], pulse_s: FloatArray, index_s: FloatArray | None
) -> tuple[dict[str, Any], list[Remark]]:
    """Arguments of ``number_teeth`` that say what wheel it is; found from the pulses where nothing states it."""
    if "tooth_angles_deg" in attrs:
        angles = tuple(float(angle) for angle in np.atleast_1d(attrs["tooth_angles_deg"]))
        return {"pulses_per_rev": len(angles), "tooth_angles_deg": angles}, []
    if "pulses_per_rev" in attrs:
        missing = int(attrs.get("missing_teeth", 0))
        return {"pulses_per_rev": int(attrs["pulses_per_rev"]), "missing_teeth": missing}, []
    found = find_pattern(pulse_s, index_time_s=index_s)
    if found is None:
        raise InputError(
            "nothing states the pulses per revolution, and the pulses do not tell: they are even, or too few",
            place="encoder.pulses_per_rev",
            found=f"{pulse_s.size} pulses",
            remedy="State pulses_per_rev, pattern or tooth_angles_deg in run.toml, or name the index",
        )
    remark: Remark = ("encoder_pattern_found", "suspect", f"wheel found from the pulses: {found.told}; state it")
    even = found.pattern.even
    if even is not None:
        return {"pulses_per_rev": even[0], "missing_teeth": even[1]}, [remark]
    angles = found.pattern.angles_deg
    return {"pulses_per_rev": len(angles), "tooth_angles_deg": angles}, [remark]


def uneven_noise_s(time_s: FloatArray, tooth: IntArray) -> float:
    """Standard deviation [s] of the pulse times of uneven teeth, from their fourth divided differences, by the median.

    ``time_s``: (pulses,), s. ``tooth``: (pulses,), their numbers, growing.
    """
    if time_s.size < 8:
        return 0.0
    count = min(time_s.size, MOST_NOISE_TEETH) - 4
    total, power = np.zeros(count), np.zeros(count)
    for k in range(5):
        weight = np.ones(count)
        for other in range(5):
            if other != k:
                weight /= tooth[k : k + count] - tooth[other : other + count]
        total += weight * time_s[k : k + count]
        power += weight**2
    return float(np.median(np.abs(total) / np.sqrt(power))) / 0.6745


def undersampled(recording: xr.Dataset, teeth: NumberedTeeth) -> list[Remark]:
    """Remark where the sampled encoder of ``recording`` has too few samples per pulse of ``teeth``."""
    if recording.attrs.get("encoder_kind") not in ("square", "analogue") or "rate_hz" not in recording.attrs:
        return []
    steps = np.diff(teeth.time_s) * float(recording.attrs["rate_hz"])
    fewest = float(np.quantile(steps, 0.02))
    if fewest >= FEWEST_SAMPLES_PER_TOOTH:
        return []
    start = float(teeth.time_s[int(np.argmax(steps < FEWEST_SAMPLES_PER_TOOTH))])
    detail = f"only {fewest:.1f} samples per tooth, first at {start:.3g} s: teeth pass unseen; sample faster"
    return [("encoder_undersampled", "bad", detail)]


def numbered_part(recording: xr.Dataset, settings: ShaftSettings, wheel: dict[str, Any], part: slice) -> NumberedTeeth:
    """Pulses of the ``part`` of ``recording`` as teeth of the ``wheel`` (for ``number_teeth``, by ``settings``)."""
    pulse_s, index_s = recording["pulse_time"].values.astype(np.float64)[part], times_of(recording, "index_time")
    stated, ratio = (
        float(recording.attrs.get(name, usual)) for name, usual in (("pulse_noise_s", 0.0), ("ratio", 1.0))
    )
    return number_teeth(pulse_s, **wheel, settings=settings, index_time_s=index_s, ratio=ratio, noise_s=stated)


def mark_flags(teeth: NumberedTeeth, recording: xr.Dataset) -> list[Remark]:
    """Remark where the mark of ``teeth`` in ``recording`` is on a shaft whose turns are no whole crank revolutions."""
    ratio = float(recording.attrs.get("ratio", 1.0))
    turns = 1.0 / ratio
    if not np.isfinite(teeth.index_tooth) or abs(turns - round(turns)) <= 1e-9:
        return []
    detail = f"the encoder turns {ratio:g} times per crank revolution: its mark is at top dead centre only once"
    return [("index_not_on_crank", "suspect", detail)]


def times_of(recording: xr.Dataset, name: str) -> FloatArray | None:
    """Times [s] that ``recording`` holds by that ``name``; None where it holds none."""
    return recording[name].values.astype(np.float64) if name in recording.variables else None
