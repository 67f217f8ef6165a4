"""The speed that the name of a recording states: evidence, against which the speed found is held, and no more."""

from __future__ import annotations

import re
from pathlib import PurePath

import numpy as np
import xarray as xr

from crankorder.shaft.pulses import Remark

_SPEED_IN_NAME = (
    re.compile(r"(?<![0-9.])(\d{2,6}(?:[.,]\d+)?)[ _-]?(?:rpm|u_?min|upm|min-?1|r_?min)", re.I),
    re.compile(r"(?:rpm|speed|drehzahl|(?<![a-z])n)[ _=-]?(\d{2,6}(?:\.\d+)?)(?![0-9])", re.I),
)
# Words that make a number a speed; "n12" may be the twelfth measurement.
_SPEED_WORD = re.compile(r"rpm|min|upm|speed|drehzahl", re.I)
# Names state nominal speeds, and a motor's slip or a governor's droop lies within this share of them.
_NOMINAL_SHARE = 0.2
# Share of the knots at either end of the speeds that may be those of a start or of noise.
_ENDS = 0.02


def speed_in_name(name: str) -> float | None:
    """Speed in rpm that the ``name`` of a file states, such as 800 in "800rpm" or "idle_n800"; None where none."""
    for sign in _SPEED_IN_NAME:
        match = sign.search(name)
        if match and float(match[1].replace(",", ".")) > 0:
            return float(match[1].replace(",", "."))
    return None


def named_speed_remarks(shaft: xr.Dataset) -> list[Remark]:
    """Remark where the name of the recording of the ShaftAngle ``shaft`` states a speed far from all that it shows."""
    named = speed_in_name(PurePath(str(shaft.attrs["recording"])).stem)
    speed = shaft["speed"].values[np.isfinite(shaft["speed"].values)]
    if named is None or not _SPEED_WORD.search(str(shaft.attrs["recording"])) or not speed.size:
        return []
    low, high = (float(value) for value in np.quantile(speed, (_ENDS, 1.0 - _ENDS)))
    if low * (1.0 - _NOMINAL_SHARE) <= named <= high * (1.0 + _NOMINAL_SHARE):
        return []
    seen = f"{low:.4g} rpm is" if high - low < 0.01 * high else f"{low:.4g} to {high:.4g} rpm are"
    detail = f"the name states {named:g} rpm, {seen} found: look at [encoder], its source, pulses_per_rev and ratio"
    return [("speed_not_as_named", "suspect", detail)]
