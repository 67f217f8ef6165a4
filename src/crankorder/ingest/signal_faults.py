"""What is wrong with the samples of a signal: missing, clipped, constant. Nothing non-finite leaves this module."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from crankorder.errors import InputError
from crankorder.ingest.rawfile import FloatArray, flag
from crankorder.quantities import QualityFlag, Severity
from crankorder.settings import IngestSettings

# beyond any physical signal: fill values of NetCDF (9.97e36) and of LabVIEW lie above it
_FILL_ABOVE = 1e30
_SENTINELS = (-999.0, -9999.0, -99999.0, 9999.0, 99999.0)
# a flat top that falls by more than this many rounding steps within its own length was cut off: twice the smooth fall
_STEEP_STEPS = 10.0


def mend_signal(signal: FloatArray, name: str, path: Path, *, settings: IngestSettings) -> list[QualityFlag]:
    """Flags of ``signal``, shape (sample,), whose missing samples are bridged in place where they are few enough.

    ``name`` and ``path`` say which channel of which recording it is; ``settings`` say how many missing samples are few
    and what counts as clipping. Raises InputError where more are missing than can be bridged.
    """
    low, high, n_still = _survey(signal)
    flags: list[QualityFlag] = []
    if not (low > -_FILL_ABOVE and high < _FILL_ABOVE) or low in _SENTINELS or high in _SENTINELS:
        missing = _missing(signal)
        if missing.any():
            _bridge(signal, missing, name, path, settings)
            detail = (
                f"channel {name}: {int(missing.sum())} missing samples bridged, first at sample {int(missing.argmax())}"
            )
            flags.append(flag(path, "non_finite_interpolated", "suspect", detail))
            low, high, n_still = _survey(signal)
    if low == high:
        return [*flags, flag(path, "constant_signal", "bad", f"channel {name}: all samples equal {low:.6g}")]
    # each fault needs so many samples that stand still: most signals have too few for any, and are done
    if n_still >= 2 * (settings.clip_run_samples - 1):
        flags += _clipping(signal, low, high, name, path, settings)
    if n_still >= settings.dropout_samples - 1:
        flags += _dropout(signal, name, path, settings)
    return flags


def _survey(signal: FloatArray) -> tuple[float, float, int]:
    """Least and greatest sample (NaN where one is NaN), and how many samples equal the one before them."""
    return float(signal.min()), float(signal.max()), int(np.count_nonzero(signal[1:] == signal[:-1]))


def _dropout(signal: FloatArray, name: str, path: Path, settings: IngestSettings) -> list[QualityFlag]:
    """Flag the longest stretch in which the signal stands still, whatever its level, if too long for chance."""
    still = signal[1:] == signal[:-1]
    if not still.any():
        return []
    starts, ends = _runs(still)
    longest = int(np.argmax(ends - starts))
    length = int(ends[longest] - starts[longest]) + 1
    if length < settings.dropout_samples or length < settings.dropout_fraction * signal.size:
        return []
    share = f"{length} samples ({length / signal.size:.1%})"
    detail = f"channel {name}: the same value for {share} from sample {starts[longest]}"
    return [flag(path, "dropout", "bad", detail)]


def _missing(signal: FloatArray) -> npt.NDArray[np.bool_]:
    """Samples that are not finite, fill values, or a sentinel such as -999 that lies far outside all other samples."""
    missing = ~(np.abs(signal) < _FILL_ABOVE)
    for sentinel in _SENTINELS:
        hits = signal == signal.dtype.type(sentinel)
        rest = np.abs(signal[~(missing | hits)])
        if hits.any() and rest.size and float(rest.max()) < 0.1 * abs(sentinel):
            missing |= hits
    return missing


def _bridge(
    signal: FloatArray, missing: npt.NDArray[np.bool_], name: str, path: Path, settings: IngestSettings
) -> None:
    starts, ends = _runs(missing)
    longest = int((ends - starts).max())
    share = float(missing.mean())
    if longest > settings.max_gap_samples or share > settings.max_gap_fraction:
        at = int(starts[np.argmax(ends - starts)])
        raise InputError(
            f"channel {name} has {int(missing.sum())} missing samples (not a number, infinite or a fill value)",
            file=path,
            place=f"sample {at}",
            found=f"{longest} in a row",
            allowed=f"{settings.max_gap_samples} in a row and {settings.max_gap_fraction:.1%} in all",
            remedy="Leave the channel or the recording out, or cut it before the gap",
        )
    places = np.flatnonzero(missing)
    good = np.flatnonzero(~missing)
    signal[places] = np.interp(places, good, signal[good])


def _clipping(
    signal: FloatArray, low: float, high: float, name: str, path: Path, settings: IngestSettings
) -> list[QualityFlag]:
    """Flag runs of equal samples at an extreme, where they are cut off and not the smooth top of a quantised signal."""
    clipped, first, n_runs = 0, signal.size, 0
    for extreme in (low, high):
        flat = signal == signal.dtype.type(extreme)
        if np.count_nonzero(flat) < 2 * settings.clip_run_samples:
            continue
        starts, ends = _runs(flat)
        long = ends - starts >= settings.clip_run_samples
        starts, ends = starts[long], ends[long]
        cut_off = _is_cut_off(signal, extreme, starts, ends)
        if cut_off.any():
            n_runs += int(cut_off.sum())
            clipped += int((ends - starts)[cut_off].sum())
            first = min(first, int(starts[cut_off][0]))
    if n_runs < 2:
        return []
    share = clipped / signal.size
    severity: Severity = "bad" if share > settings.max_clipped_fraction else "suspect"
    detail = f"channel {name}: {share:.3%} of its samples lie flat at {low:.6g} or {high:.6g}, first at sample {first}"
    return [flag(path, "clipped", severity, detail)]


def _is_cut_off(
    signal: FloatArray, extreme: float, starts: npt.NDArray[np.intp], ends: npt.NDArray[np.intp]
) -> npt.NDArray[np.bool_]:
    """Which flat runs the signal enters or leaves steeply.

    The top of a parabola that rounding flattens over L samples has fallen by 4.5 rounding steps L samples further on.
    """
    steps = np.abs(np.diff(signal))
    rounding_step = float(steps[steps > 0].min())
    lengths = ends - starts
    before = np.abs(signal[np.maximum(starts - lengths, 0)] - extreme)
    after = np.abs(signal[np.minimum(ends - 1 + lengths, signal.size - 1)] - extreme)
    steep: npt.NDArray[np.bool_] = np.maximum(before, after) > _STEEP_STEPS * rounding_step
    return steep


def _runs(mask: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    padded = np.concatenate(([False], mask, [False]))
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    return edges[::2], edges[1::2]
