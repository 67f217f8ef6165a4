"""Clipping whose plateaus a filter has smoothed since, told by where the samples of a signal lie.

Near the greatest value of any smooth signal the share of samples within a depth d grows at least as the square root of
d: a sine's does (the arcsine law), and where peaks differ in height it grows faster. Below a level at which a signal
was cut off it hardly grows at all, for the samples that lay above are all there, one flat beside the other.
"""

from __future__ import annotations

import math

import numpy as np

from crankorder.ingest.fault import SignalFault
from crankorder.ingest.rawfile import FloatArray
from crankorder.ingest.signal_survey import Survey, grouped
from crankorder.settings import IngestSettings

_PIECE, _PIECES = 2048, 8
"""Samples of a piece, and how many of the strongest pieces are looked at."""
_ABOVE = (0.0005, 0.002, 0.005, 0.01, 0.02, 0.04, 0.08)
"""Shares of the samples above the level that is tried: what a filter rings lies above the plateau."""
_NEAR, _FAR, _WITHIN = 0.03, 0.12, 0.07
"""Depths below the level over which the share is compared, and about the level within which a plateau lies."""
_FEWEST_IN_ROW = 3.0
"""Samples in a row that a plateau has on average: a lone tone at a simple share of the rate hits few levels too."""
_FEWEST = 64


def find_smoothed_clipping(
    signal: FloatArray, survey: Survey, *, settings: IngestSettings, without_doubt: bool
) -> SignalFault | None:
    """Clipping of ``signal`` (sample,) at levels that no two samples need share; only a doubt where one side has it.

    ``survey`` says where the signal is strongest, ``settings`` what a plateau is. The rest of the vibration must be
    smaller on the plateaus than between them for it to be "bad", and the quantity one that has no plateaus of its own
    (``without_doubt``).
    """
    samples = _strongest(signal, survey)
    if samples.size < _PIECE:
        return None
    ordered = np.sort(samples)
    middle = float(ordered[ordered.size // 2])
    sides = [
        _pile_up(ordered - middle, samples - middle, settings),
        _pile_up(middle - ordered[::-1], middle - samples, settings),
    ]
    found = [side for side in sides if side is not None]
    if not found or (len(found) < 2 and not without_doubt):
        return None
    levels = " and ".join(
        f"{middle + sign * side[0]:.4g}" for sign, side in zip((1.0, -1.0), sides, strict=True) if side is not None
    )
    share = sum(side[1] for side in found)
    is_sure = without_doubt and len(found) == 2 and all(side[2] < settings.quiet_plateau for side in found)
    detail = (
        f"{share:.2%} of the strongest samples lie at {levels} as on a plateau that was smoothed later: cut off before "
        "the filter, so odd multiples of its lines may be made up"
    )
    return SignalFault("clipped", "bad" if is_sure else "suspect", detail, is_lost=is_sure)


def _strongest(signal: FloatArray, survey: Survey) -> FloatArray:
    """Samples of the pieces with the largest mean square."""
    group = _PIECE // survey.size
    mean = float(survey.means[:: max(group // 2, 1)].mean())
    mean = mean if math.isfinite(mean) else float(np.nanmean(survey.means))
    power = grouped(survey.variances + np.square(survey.means - mean), group)
    power = np.where(np.isfinite(power), power, -1.0)
    chosen = np.sort(np.argsort(power)[-_PIECES:])
    chosen = chosen[power[chosen] > 0.0]
    if not chosen.size:
        return np.empty(0)
    return np.concatenate([signal[k * _PIECE : (k + 1) * _PIECE] for k in chosen])


def _pile_up(ordered: FloatArray, above: FloatArray, settings: IngestSettings) -> tuple[float, float, float] | None:
    """Level, share of the samples, and roughness over that between the levels, of a plateau on the upper side.

    ``above`` the middle (sample,), and the same ``ordered`` by size.
    """
    levels = ordered[(ordered.size * (1.0 - np.array(_ABOVE))).astype(np.int64)]
    if levels[-1] <= 0.0:
        return None
    top = np.searchsorted(ordered, levels)
    near = top - np.searchsorted(ordered, (1.0 - _NEAR) * levels)
    far = top - np.searchsorted(ordered, (1.0 - _FAR) * levels)
    exponents = np.where(
        near >= _FEWEST, np.log(np.maximum(far, 1) / np.maximum(near, 1)) / math.log(_FAR / _NEAR), 1.0
    )
    best = int(np.argmin(exponents))
    level = float(levels[best])
    if exponents[best] > settings.plateau_exponent:
        return None
    inside = np.abs(above / level - 1.0) < _WITHIN
    share = float(np.mean(inside))
    in_row = np.count_nonzero(inside) / (1 + np.count_nonzero(inside[1:] & ~inside[:-1]))
    if in_row < _FEWEST_IN_ROW or share < settings.max_clipped_fraction:
        return None
    bend = np.square(above[1:-1] - 0.5 * (above[2:] + above[:-2]))
    flat = inside[2:] & inside[1:-1] & inside[:-2]
    between = np.abs(above[1:-1]) < 0.7 * level
    if np.count_nonzero(flat) < _FEWEST or np.count_nonzero(between) < _FEWEST:
        return level, share, math.inf
    return level, share, math.sqrt(float(bend[flat].mean()) / max(float(bend[between].mean()), 1e-300))
