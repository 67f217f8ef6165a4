"""Which way a shaft turns, told by the level of an encoder's second track at the pulses of the first."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from crankorder.ingest.rawfile import FloatArray, flag
from crankorder.quantities import Floats, QualityFlag
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="1-ingest-faults.toml", table="direction"):
    sure_share: float
    fewest_pulses: int


NUMBERS = _Numbers.load()


def direction_flags(levels: FloatArray, pulse_samples: Floats, path: Path, *, falling: bool) -> list[QualityFlag]:
    """What the second track says of the direction of the recording at ``path``; nothing where the shaft turns forwards.

    Forwards the first track leads by a quarter of a pulse: the second, ``levels`` (sample,), is still low where the
    first rises and still high where it falls (``falling``: these are the pulses). ``pulse_samples`` (pulse,) is where
    the pulses lie, in samples.
    """
    low, high = float(np.nanmin(levels)), float(np.nanmax(levels))
    at = np.floor(pulse_samples).astype(np.int64)
    at = at[(at >= 0) & (at < levels.size)]
    if at.size < NUMBERS.fewest_pulses or not high > low:
        detail = "the second track says nothing of the direction: " + ("it is constant" if at.size else "no pulses")
        return [flag(path, "direction_unknown", "info", detail)]
    is_high = levels[at] > 0.5 * (low + high)
    backwards = ~is_high if falling else is_high
    share = float(np.mean(backwards))
    if share <= 1.0 - NUMBERS.sure_share:
        return []
    if share >= NUMBERS.sure_share:
        detail = (
            f"the second track leads at {share:.1%} of the pulses: the shaft turns backwards, or the two tracks are "
            "swapped; the angle is counted up all the same, so phases are those of the other direction"
        )
        return [flag(path, "turns_backwards", "suspect", detail)]
    first = int(np.flatnonzero(np.diff(backwards))[0]) + 1
    detail = (
        f"the second track leads at {share:.1%} of the pulses, first another way at pulse {first}: the shaft changes "
        "its direction, or too few samples lie between the pulses to tell"
    )
    return [flag(path, "direction_changes", "suspect", detail)]
