"""What is wrong with the samples of a signal: missing, clipped, constant. Nothing non-finite leaves this module."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from crankorder.errors import InputError
from crankorder.ingest.rawfile import FloatArray, flag
from crankorder.quantities import QualityFlag
from crankorder.settings import IngestSettings

# beyond any physical signal: fill values of NetCDF (9.97e36) and of LabVIEW lie above it
_FILL_ABOVE = 1e30
_SENTINELS = (-999.0, -9999.0, -99999.0, 9999.0, 99999.0)


def mend_signal(signal: FloatArray, name: str, path: Path, *, settings: IngestSettings) -> list[QualityFlag]:
    """Flags of ``signal``, shape (sample,), whose missing samples are bridged in place where they are few enough.

    ``name`` and ``path`` say which channel of which recording it is; ``settings`` say how many missing samples are few
    and what counts as clipping. Raises InputError where more are missing than can be bridged.
    """
    low, high = float(signal.min()), float(signal.max())
    flags: list[QualityFlag] = []
    if not (low > -_FILL_ABOVE and high < _FILL_ABOVE) or low in _SENTINELS or high in _SENTINELS:
        missing = _missing(signal)
        if missing.any():
            _bridge(signal, missing, name, path, settings)
            detail = (
                f"channel {name}: {int(missing.sum())} missing samples bridged, first at sample {int(missing.argmax())}"
            )
            flags.append(flag(path, "non_finite_interpolated", "suspect", detail))
            low, high = float(signal.min()), float(signal.max())
    if low == high:
        return [*flags, flag(path, "constant_signal", "suspect", f"channel {name}: all samples equal {low:.6g}")]
    return flags + _clipping(signal, low, high, name, path, settings)


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
    """Flag runs of equal samples at an extreme; one lone flat top may be a smooth one, coarsely quantised."""
    clipped, first = 0, signal.size
    for extreme in (low, high):
        places = np.flatnonzero(signal == signal.dtype.type(extreme))
        if places.size < 2 * settings.clip_run_samples:
            continue
        edges = np.flatnonzero(np.diff(places) > 1) + 1
        starts, ends = np.concatenate(([0], edges)), np.concatenate((edges, [places.size]))
        long_runs = ends - starts >= settings.clip_run_samples
        if np.count_nonzero(long_runs) >= 2:
            clipped += int((ends - starts)[long_runs].sum())
            first = min(first, int(places[starts[long_runs][0]]))
    if not clipped:
        return []
    share = clipped / signal.size
    severity = "bad" if share > settings.max_clipped_fraction else "suspect"
    detail = f"channel {name}: {share:.3%} of its samples lie flat at {low:.6g} or {high:.6g}, first at sample {first}"
    return [flag(path, "clipped", "bad" if severity == "bad" else "suspect", detail)]


def _runs(mask: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    padded = np.concatenate(([False], mask, [False]))
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    return edges[::2], edges[1::2]
