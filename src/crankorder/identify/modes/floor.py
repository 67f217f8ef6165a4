"""The floor of a Campbell map: what is left of the spectra without the lines that move with speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import fdtrc, fdtri, gammainccinv

from crankorder.fft.windows import WIDEST_LOBE_BINS, window_named
from crankorder.orders.averages import median_of_known
from crankorder.quantities import Bools, Complexes, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "floor")

SMALLEST_TERM = 1e-7
"""Power response of the window below which a term of its autocorrelation is left out."""


FAR = 60.0
"""Size of 2πTz from which the series in 1/z is good to 1e-6."""


class SpectralWindow(NamedTuple):
    """Power response of a window: its autocorrelation over the lag t (1 at its length ``length_s``) is Σ b_k cos(πkt).

    ``order`` (terms,) holds the k, ``weight`` (terms,) the b_k; ``bin_hz`` is the distance of independent bins.
    """

    order: Floats
    weight: Floats
    length_s: float

    @property
    def bin_hz(self) -> float:
        """Width in Hz of a bin of an unpadded transform."""
        return 1.0 / self.length_s

    def kernel(self, offset_hz: Floats) -> Floats:
        """Power response per Hz, its integral over all offsets being one, at ``offset_hz`` (any shape) from a tone."""
        real: Floats = 2.0 * _near(1e-4j + 2j * np.pi * self.length_s * np.abs(offset_hz), self)[0].real
        return real


def spectral_window(window: str, enbw_hz: float) -> SpectralWindow:
    """SpectralWindow of the window ``window`` whose noise bandwidth is ``enbw_hz``.

    A sum of cosines of half a period is complete, for the autocorrelation vanishes at its end: its coefficients are
    the window's power response at every half bin.
    """
    shape = window_named(window, 512)
    order = np.arange(2 * WIDEST_LOBE_BINS + 1, dtype=np.float64)
    power = shape.response(0.5 * order) ** 2
    power[0] = 0.5
    kept = power > SMALLEST_TERM
    return SpectralWindow(order[kept], power[kept] / power[kept].sum(), shape.enbw_bins / enbw_hz)


def _near(a: Complexes, seen: SpectralWindow) -> tuple[Complexes, Complexes]:
    """∫ c(t) exp(−a t) dt over a window's length, times that length, and its derivative by a."""
    decay = np.exp(-a)
    even = np.where(seen.order % 2 == 0, seen.weight, 0.0)
    both = np.stack([even, seen.weight - even], axis=1)  # terms whose cosine ends at 1, and at −1
    top = np.stack([1.0 - decay, 1.0 + decay], axis=-1)
    over = 1.0 / ((a * a)[..., None] + (np.pi * seen.order) ** 2)
    once, twice = over @ both, (over * over) @ both
    value = (top * once).sum(axis=-1)
    slope = value + a * (decay * (once[..., 0] - once[..., 1]) - 2.0 * a * (top * twice).sum(axis=-1))
    return seen.length_s * a * value, seen.length_s * slope


def seen_pole(z_hz: Complexes, seen: SpectralWindow) -> tuple[Complexes, Complexes]:
    """What the window makes of 1 / (2π z): value and derivative by z at ``z_hz`` = σ + i (f − f_d), σ > 0.

    The autocorrelation exp(2π (i f_d − σ) τ) of a resonance is cut by the window's own, whatever its decay, so that
    both the spectrum of a tone (σ → 0) and a broad resonance come out exactly.
    ``seen``: how the window sees power.
    """
    scale = 2.0 * np.pi * seen.length_s
    a = scale * z_hz
    curve = np.pi**2 * float(seen.weight @ seen.order**2)
    fourth = np.pi**4 * float(seen.weight @ seen.order**4)
    inverse = 1.0 / a
    square = inverse * inverse
    value = seen.length_s * inverse * (1.0 - square * (curve - fourth * square))
    slope = -seen.length_s * square * (1.0 - square * (3.0 * curve - 5.0 * fourth * square))
    close = np.abs(a) < FAR
    value[close], slope[close] = _near(a[close], seen)
    return value, scale * slope


Orders = tuple[tuple[float, float], ...]
"""Orders of lines, each with its standard error."""


@dataclass(frozen=True, eq=False)
class Floor:
    """Spectra without order lines, joined over the speeds.

    ``frequency_hz`` (F,) of the bins in use; ``psd`` (C, F) at unit gain; ``averages`` (C, F): independent power
    spectra behind each; ``gain`` (C, K) of each speed; ``cells`` (C, K, F): psd of each speed at unit gain, NaN where
    masked; ``cell_averages`` (C, K). ``moving`` (C, K, F): the cells before those that stand out at few speeds were
    masked. ``seen``: how the window sees power. ``whole`` (C, F): mean psd with all lines.
    ``strong``: (frequency, its error) of lines that are tones for sure.
    """

    frequency_hz: Floats
    psd: Floats
    averages: Floats
    gain: Floats
    cells: Floats
    cell_averages: Floats
    channels: tuple[str, ...]
    speed_rpm: Floats
    seen: SpectralWindow
    whole: Floats
    moving: Floats
    strong: tuple[tuple[float, float], ...] = ()

    @property
    def step_hz(self) -> float:
        """Distance of neighbouring bins."""
        return float(self.frequency_hz[1] - self.frequency_hz[0])


def seen_at_single_speeds(order_map: xr.Dataset, *, top_hz: float) -> list[tuple[float, float]]:
    """Half orders (order, speed in rpm) below ``top_hz`` whose coherent amplitude stands out at that speed.

    Too weak for a line of the test, they would still lift single bins of the floor.
    ``order_map``: the OrderMap.
    """
    order, speed = order_map["order"].values, order_map["speed"].values
    half = np.flatnonzero((np.abs(2.0 * order - np.rint(2.0 * order)) < 1e-6) & (order > 0.0))
    names = "coherent_amplitude", "standard_error", "degrees_of_freedom"
    size, error, degrees_of_freedom = (order_map[name].values[:, :, half].astype(float) for name in names)
    with np.errstate(invalid="ignore", divide="ignore"):
        chance = fdtrc(2.0, np.maximum(degrees_of_freedom, 1.0), 0.5 * (size / error) ** 2)
    seen = (np.where((degrees_of_freedom >= 2.0) & np.isfinite(chance), chance, 1.0) < NUMBERS.line_chance).any(axis=0)
    seen &= speed[:, None] / 60.0 * order[half] < top_hz
    return [(float(order[half[j]]), float(speed[k])) for k, j in np.argwhere(seen)]


def quiet_floor(campbell: xr.Dataset, orders: Orders, *, single: Sequence[tuple[float, float]] = ()) -> Floor | None:
    """Floor of the CampbellMap ``campbell`` without the lines of ``orders`` (order, its error); None where none is.

    Lines are masked as wide as the window's skirt stands over the floor, and so is every cell far above the same bin
    at the other speeds (a line that nobody found); ``single`` (order, rpm) are masked at that speed only. Each
    speed has a gain of its own.
    """
    frequency = campbell["frequency"].values
    seen = spectral_window(str(campbell.attrs["window"]), float(campbell.attrs["enbw_hz"]))
    averages = _independent(campbell)
    used = np.flatnonzero(frequency > NUMBERS.lowest_bins * float(campbell.attrs["enbw_hz"]))
    if len(used) > 1 and averages.sum(axis=1).max(initial=0.0) < NUMBERS.fewest_averages:
        # padding adds bins but tells nothing: half a bin of the window apart they hold all that it lets through
        used = used[:: max(1, int(0.5 * seen.bin_hz / float(frequency[1] - frequency[0]) + 1e-6))]
    psd = campbell["psd"].values.astype(np.float64)
    share = np.ones(psd.shape)
    if "settled_psd" in campbell:  # without start transients
        bins = np.searchsorted(frequency, campbell["settled_frequency"].values - 1e-9)
        psd[..., bins], share[..., bins] = campbell["settled_psd"].values, campbell["settled_share"].values
    psd, share = psd[..., used], share[..., used]
    known = (averages > 0.0).any(axis=0) & np.isfinite(campbell["speed"].values)
    if not known.any():
        known = (averages > 0.0).any(axis=0)
    psd, averages, speed = psd[:, known], averages[:, known], campbell["speed"].values[known]
    independent = averages[:, :, None] * share[:, known]
    if len(used) < 20 or psd.shape[1] == 0:
        return None
    psd[~(psd > 0.0)] = np.nan
    whole = _mean(psd, independent)[0]
    # a line that leaves its bins within a recording is none of the settled cells, but it leaks all the same
    every = campbell["psd"].values[..., used][:, known].astype(np.float64)
    moving = _order_mask(psd, every, frequency[used], speed, orders, campbell, seen.bin_hz)
    psd[moving] = np.nan
    for order, rpm in single:
        if len(speed) > 2 and abs(speed - rpm).min() < 0.01 * rpm:
            near = np.abs(frequency[used] - order * rpm / 60.0) <= NUMBERS.masked_bins * seen.bin_hz
            psd[:, int(np.argmin(np.abs(speed - rpm))), near] = np.nan
    psd, gain = _at_unit_gain(psd, averages)
    if psd.shape[1] > 1:
        _mask_feet(psd, independent, moving)
    unclipped = psd.copy()
    if psd.shape[1] > 2:
        _clip(psd, independent)
    mean, total = _mean(psd, independent)
    names = tuple(str(name) for name in campbell["channel"].values)
    return Floor(frequency[used], mean, total, gain, psd, averages, names, speed, seen, whole, unclipped)


def _mean(psd: Floats, averages: Floats) -> tuple[Floats, Floats]:
    """Mean of ``psd`` over the speeds, weighted by ``averages``, and the sum of those; NaN takes no part."""
    weight = np.where(np.isnan(psd), 0.0, averages)
    total = weight.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.nansum(weight * np.nan_to_num(psd), axis=1) / total, total


def _independent(campbell: xr.Dataset) -> Floats:
    """Equivalent number of independent power spectra (channels, speeds) in the overlapping frames of the map."""
    overlap = float(campbell.attrs.get("overlap", NUMBERS.usual_overlap_fraction))
    window = window_named(str(campbell.attrs["window"]), 256)
    hop = max(1, round(256 * (1.0 - overlap)))
    frames = campbell["n_frames"].values[None, :] * np.ones((campbell.sizes["channel"], 1), dtype=np.int64)
    if "n_frames_used" in campbell:
        frames = campbell["n_frames_used"].values
    independent = {int(n): window.independent_frames(hop, int(n), power=True) if n else 0.0 for n in np.unique(frames)}
    return np.array([[independent[int(n)] for n in row] for row in frames])


def _order_mask(
    psd: Floats, every: Floats, frequency: Floats, speed: Floats, orders: Orders, campbell: xr.Dataset, bin_hz: float
) -> Bools:
    """Cells (channels, speeds, frequencies) of ``psd`` that lines of ``orders`` cover, skirts included.

    ``every`` is the density with start transients, ``bin_hz`` the width of a bin of the window.
    """
    mask = np.zeros(psd.shape, dtype=bool)
    step = float(frequency[1] - frequency[0])
    level = _level(psd)
    skirt = _skirt(str(campbell.attrs["window"]))
    half_bin_rpm = 0.5 * group_width_rpm(campbell)
    for order, error in orders:
        for k, rpm in enumerate(speed):
            line_hz = order * rpm / 60.0
            spread = (3.0 * error * rpm + order * half_bin_rpm) / 60.0
            if not np.isfinite(line_hz) or line_hz - spread > frequency[-1] + 20.0 * bin_hz:
                continue
            away = np.abs(frequency - line_hz) - spread
            mask[:, k, away <= NUMBERS.masked_bins * bin_hz + 0.5 * step] = True
            near, reached = away <= bin_hz, away < NUMBERS.skirt_bins * bin_hz
            if near.any():
                height = np.fmax.reduce(every[:, k, near], axis=1)[:, None]
                leak = height * np.interp(away[reached] / bin_hz, *skirt)
                mask[:, k, reached] |= leak > NUMBERS.leak_share * level[:, k, reached]
    return mask


def _level(psd: Floats) -> Floats:
    """Running median of ``psd`` (channels, speeds, frequencies) over some bins of each speed; NaN takes no part."""
    half = NUMBERS.level_bins // 2
    padded = np.pad(psd, ((0, 0), (0, 0), (half, half)), constant_values=np.nan)
    return median_of_known(np.lib.stride_tricks.sliding_window_view(padded, NUMBERS.level_bins, axis=-1), axis=-1)


@lru_cache
def _skirt(window: str) -> tuple[Floats, Floats]:
    """Distances in bins, and the largest power response of ``window`` from each on: what a line leaks that far away."""
    away = np.arange(0.0, NUMBERS.skirt_bins + 1.0, 0.25)
    response = window_named(window, 8 * NUMBERS.skirt_bins).response(away) ** 2
    return away, np.asarray(np.maximum.accumulate(response[::-1])[::-1])


def _at_unit_gain(psd: Floats, averages: Floats) -> tuple[Floats, Floats]:
    """``psd`` divided by the gain of each speed, and those gains (channels, speeds), 1 on average."""
    level = median_of_known(psd, axis=1)
    gain = median_of_known(psd / level[:, None], axis=2)
    gain = np.where(np.isfinite(gain) & (gain > 0.0), gain, 1.0)
    level = median_of_known(psd / gain[:, :, None], axis=1)
    gain *= np.nan_to_num(median_of_known(psd / gain[:, :, None] / level[:, None], axis=2), nan=1.0)
    mean = (gain * averages).sum(axis=1, keepdims=True) / np.maximum(averages.sum(axis=1, keepdims=True), 1e-9)
    gain /= np.where(mean > 0.0, mean, 1.0)
    return psd / gain[:, :, None], gain


def _clip(psd: Floats, averages: Floats) -> None:
    """NaN into cells (and their neighbours) of ``psd`` that stand over their bin's median as noise hardly ever does."""
    shape, of = np.unique(np.maximum(averages, 1.0), return_inverse=True)
    median = gammainccinv(shape, 0.5) / shape
    limit = (gammainccinv(shape, NUMBERS.clip_chance) / shape / median)[of.reshape(averages.shape)]
    high = psd > limit * median_of_known(psd, axis=1)[:, None]
    wide = high.copy()
    wide[..., 1:] |= high[..., :-1]
    wide[..., :-1] |= high[..., 1:]
    # what stands at a third of the speeds or more is no line that moves
    wide &= (high.mean(axis=1) < 0.34)[:, None]
    psd[wide] = np.nan


def _mask_feet(psd: Floats, averages: Floats, moving: Bools) -> None:
    """NaN into cells of ``psd`` beside ``moving`` lines as far as they stand over the same bins at other speeds.

    From the mask of a line outwards as long as it goes on: a line whose speed or amplitude wanders has a wider foot
    than the window, and no mode is seen at one speed alone. Two speeds are held against the lower of them.
    """
    shape, of = np.unique(np.maximum(1.5 * averages, 1.0), return_inverse=True)
    if psd.shape[1] > 2:
        level = median_of_known(psd, axis=1)
        limit = gammainccinv(shape, NUMBERS.foot_chance) / gammainccinv(shape, 0.5)
    else:
        level = np.fmin.reduce(psd, axis=1)
        limit = fdtri(2.0 * shape, 2.0 * shape, 1.0 - NUMBERS.foot_chance)
    with np.errstate(invalid="ignore", divide="ignore"):
        over = psd / level[:, None] / limit[of.reshape(averages.shape)]
    over = np.nan_to_num(over, posinf=0.0)
    foot = moving.copy()
    for _ in range(NUMBERS.foot_bins):
        grown = foot.copy()
        # the mean of a cell and the next one further out must stand over the others
        grown[..., 1:-1] |= foot[..., :-2] & (over[..., 1:-1] + over[..., 2:] > 2.0)
        grown[..., 1:-1] |= foot[..., 2:] & (over[..., 1:-1] + over[..., :-2] > 2.0)
        if np.array_equal(grown, foot):
            break
        foot = grown
    alone = np.any(~foot & np.isfinite(psd), axis=1, keepdims=True)
    psd[foot & alone] = np.nan


def group_width_rpm(campbell: xr.Dataset) -> float:
    """Width [rpm] of a speed group of ``campbell``, a run-up's, whose groups touch; those of steps are narrow: 0."""
    speed, width = np.sort(campbell["speed"].values), float(campbell.attrs["speed_bin_rpm"])
    return width if len(speed) > 2 and float(np.median(np.diff(speed))) < 1.5 * width else 0.0
