"""Natural frequencies: lines that do not move with speed, from the floor that the order lines leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.fft.windows import window_named
from crankorder.settings import IdentifySettings

MASKED_BINS = 3
"""Bins on each side of an order line that take no part in the floor: its main lobe and a slow speed change."""

TONE_SKIRT = 0.008
"""Largest share of a tone's power three bins away (a Hann window gives 0.0006 at worst; the rest is noise)."""

CLEAR_SIGMAS = 6.0
"""Standard deviations of its scatter by which a spectrum peaks at a mode: a thousand bins are looked at."""

PAIR_BINS = 4
"""Peaks closer than this many bins are one."""


@dataclass(frozen=True)
class FixedLine:
    """One line of fixed frequency in one channel: a natural frequency, or a tone where it has no width."""

    channel: str
    frequency_hz: float
    frequency_error_hz: float
    damping_ratio: float
    damping_error: float
    psd: float
    prominence_db: float
    is_tone: bool


@dataclass(frozen=True)
class Mode:
    """A natural frequency (or tone) as the channels that show it agree on it."""

    lines: tuple[FixedLine, ...]

    @property
    def frequency(self) -> tuple[float, float]:
        """Frequency in Hz and its standard error, weighted by the channels' own errors."""
        return _weighted([(line.frequency_hz, line.frequency_error_hz) for line in self.lines])

    @property
    def damping(self) -> tuple[float, float]:
        """Damping ratio and its standard error."""
        return _weighted([(line.damping_ratio, line.damping_error) for line in self.lines])

    @property
    def strongest(self) -> FixedLine:
        """The channel in which it stands out most."""
        return max(self.lines, key=lambda line: line.prominence_db)


def quiet_spectrum(campbell: xr.Dataset, orders: list[float]) -> NDArray[np.float64]:
    """Median over speed of the power spectral density (channels, frequencies) with the lines of ``orders`` left out.

    ``campbell`` is the CampbellMap. A line that moves with speed is masked where it lies and would be outvoted
    anyway; one that stays is kept. Frequencies that an order covers at every speed are NaN.
    """
    psd = campbell["psd"].values.copy()
    frequency, speed = campbell["frequency"].values, campbell["speed"].values
    resolution = float(campbell.attrs["resolution_hz"])
    width = MASKED_BINS * max(1.0, float(campbell.attrs["enbw_hz"]) / (1.5 * resolution)) * resolution
    for k, rpm in enumerate(speed):
        for order in orders:
            psd[:, k, np.abs(frequency - order * rpm / 60.0) <= width + 0.5 * order * _half_bin(campbell) / 60.0] = (
                np.nan
            )
    count = np.count_nonzero(~np.isnan(psd), axis=1)
    ordered = np.sort(psd, axis=1)
    middle = np.maximum(count - 1, 0)[:, None, :] // 2
    return np.asarray(np.take_along_axis(ordered, middle, axis=1)[:, 0, :])


def _half_bin(campbell: xr.Dataset) -> float:
    """Half the width in rpm of a speed group of a run-up, whose groups touch; a stepped test's groups are narrow."""
    speed, width = np.sort(campbell["speed"].values), float(campbell.attrs["speed_bin_rpm"])
    touching = len(speed) > 2 and float(np.median(np.diff(speed))) < 1.5 * width
    return 0.5 * width if touching else 0.0


def find_modes(campbell: xr.Dataset, orders: list[float], *, settings: IdentifySettings) -> list[Mode]:
    """Natural frequencies and tones of the CampbellMap ``campbell``, lowest first, after removal of ``orders``.

    A peak of the quiet spectrum that stands ``settings.mode_prominence_db`` over the valleys beside it (and clear of
    the scatter) is fitted by a damped resonance seen through the window; channels are joined where their frequencies
    agree.
    """
    spectrum = quiet_spectrum(campbell, orders)
    frequency = campbell["frequency"].values
    lines: list[FixedLine] = []
    for channel, density in zip(campbell["channel"].values, spectrum, strict=True):
        usable = (frequency > 4.0 * float(campbell.attrs["enbw_hz"])) & np.isfinite(density) & (density > 0.0)
        if np.count_nonzero(usable) > 20:
            lines += _lines(str(channel), frequency[usable], density[usable], campbell, settings)
    return _join(sorted(lines, key=lambda line: line.frequency_hz), float(campbell.attrs["resolution_hz"]))


def _lines(
    channel: str,
    frequency: NDArray[np.float64],
    density: NDArray[np.float64],
    campbell: xr.Dataset,
    settings: IdentifySettings,
) -> list[FixedLine]:
    resolution = float(campbell.attrs["resolution_hz"])
    level = 10.0 * np.log10(_smoothed(density))
    n_averages = float(campbell["n_frames"].values.sum())
    # a median of n spectra of three smoothed bins scatters by so much; a mode must stand clear of that
    scatter_db = 4.34 * 1.25 / np.sqrt(1.5 * n_averages)
    peaks = _local_maxima(level, PAIR_BINS)
    prominences = _prominences(level, peaks)
    clear = prominences >= max(settings.mode_prominence_db, CLEAR_SIGMAS * scatter_db)
    peaks, prominences = peaks[clear], prominences[clear]
    found = []
    for number, peak in enumerate(peaks.tolist()):
        prominence = float(prominences[number])
        low = (peaks[number - 1] + peak) // 2 if number else 0
        high = (peaks[number + 1] + peak) // 2 if number + 1 < len(peaks) else len(density) - 1
        tone = _tone(frequency, density, peak, resolution)
        seen_through = (str(campbell.attrs["window"]), float(campbell.attrs["enbw_hz"]))
        fit = tone or _fit(frequency, density, peak, (low, high), *seen_through, n_averages)
        if fit is None:
            continue
        (centre, centre_error), (half_width, half_width_error) = fit
        damping = half_width / centre
        far = abs(centre - frequency[peak]) > max(4 * resolution, 2 * half_width)
        vague = centre_error > 2.0 * max(half_width, resolution)
        if damping > settings.max_damping_ratio or far or vague:
            continue
        found.append(
            FixedLine(
                channel=channel,
                frequency_hz=centre,
                frequency_error_hz=centre_error,
                damping_ratio=damping,
                damping_error=half_width_error / centre,
                psd=float(density[peak]),
                prominence_db=prominence,
                is_tone=tone is not None or 2.0 * half_width < settings.mode_min_width_bins * resolution,
            )
        )
    return found


def _tone(
    frequency: NDArray[np.float64], density: NDArray[np.float64], peak: int, resolution: float
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Frequency and zero width of a line as narrow as the window makes any tone; None where it is wider or unclear.

    Three bins away a tone seen through a Hann window is 32 dB down, a resonance of one bin's half width 10 dB. The
    frequency is that of the two strongest bins (Rife and Vincent 1970).
    """
    if not 3 <= peak < len(density) - 3:
        return None
    height = density[peak]
    if 0.5 * (density[peak - 3] + density[peak + 3]) > TONE_SKIRT * height:
        return None
    side = 1 if density[peak + 1] >= density[peak - 1] else -1
    share = float(np.sqrt(density[peak + side] / height))
    offset = side * (2.0 * share - 1.0) / (share + 1.0)
    error = float(np.sqrt(max(density[peak - 3], density[peak + 3]) / height))
    return (float(frequency[peak]) + offset * resolution, error * resolution), (0.0, 0.5 * resolution)


def _local_maxima(level: NDArray[np.float64], reach: int) -> NDArray[np.int64]:
    """Bins that are the largest within ``reach`` bins on both sides, the ends excluded."""
    padded = np.pad(level, reach, constant_values=-np.inf)
    highest = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).max(axis=-1)
    inner = np.arange(len(level))
    return np.flatnonzero((level >= highest) & (inner > 1) & (inner < len(level) - 2))


def _smoothed(density: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of three neighbouring bins, ends kept: a Hann window's main lobe, within which a peak has no structure."""
    smooth = density.copy()
    smooth[1:-1] = (density[:-2] + density[1:-1] + density[2:]) / 3.0
    return smooth


def _prominences(level: NDArray[np.float64], peaks: NDArray[np.int64]) -> NDArray[np.float64]:
    """Height of each peak above the higher of the two valleys that part it from higher ground (or from the ends)."""
    prominences = np.empty(len(peaks))
    for number, peak in enumerate(peaks):
        higher = np.flatnonzero(level > level[peak])
        left = higher[higher < peak]
        right = higher[higher > peak]
        valleys = (
            level[(left[-1] if len(left) else 0) : peak + 1].min(),
            level[peak : (right[0] if len(right) else len(level) - 1) + 1].min(),
        )
        prominences[number] = level[peak] - max(valleys)
    return prominences


def _fit(
    frequency: NDArray[np.float64],
    density: NDArray[np.float64],
    peak: int,
    between: tuple[int, int],
    window: str,
    enbw_hz: float,
    n_averages: float,
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Centre and half width (Hz, each with its standard error) of the resonance at bin ``peak``; None where none fits.

    Only bins ``between`` the middles to the neighbouring peaks are used.

    Near a lightly damped resonance the response is r0 + r / (f - fn + i ζ fn), r0 what the other modes and the rigid
    body add (Ewins 2000, §4.3); its power is b0 + b1 x + (p + q x) / (x² + (ζ fn)²), x = f - fn, where q is their
    interference. Seen through the window it is fitted by relative deviation, for a power averaged n times scatters by
    1/√n of itself; the four linear terms are eliminated at every step (Golub and Pereyra 1973).
    """
    from scipy.optimize import least_squares

    resolution = float(frequency[1] - frequency[0])
    reach = _half_power_reach(density, peak)
    span = slice(max(between[0], peak - reach), min(between[1], peak + reach) + 1)
    f, s = frequency[span], density[span]
    if len(f) < 8:
        return None
    offsets, kernel = _window_kernel(window, enbw_hz)

    def residual(p: NDArray[np.float64]) -> NDArray[np.float64]:
        x = f[:, None] + offsets - p[0]
        bell = np.exp(2.0 * p[1]) / (x**2 + np.exp(2.0 * p[1]))
        basis = np.stack(
            [np.ones(len(f)), (f - p[0]) / reach, bell @ kernel, (bell * x) @ kernel / np.exp(p[1])], axis=1
        )
        weighted = basis / s[:, None]
        linear = np.linalg.lstsq(weighted, np.ones(len(f)), rcond=None)[0]
        return np.asarray(weighted @ linear - 1.0)

    start = np.log(max(0.3 * resolution, 0.35 * reach * resolution - 0.4 * enbw_hz))
    bounds = ([f[0], np.log(0.02 * resolution)], [f[-1], np.log(f[-1] - f[0])])
    guess = np.clip([frequency[peak], start], *bounds)
    result = least_squares(residual, guess, bounds=bounds, x_scale=[resolution, 0.3], max_nfev=100)
    scatter = max(2.0 * result.cost / (len(f) - 6), 1.0 / n_averages)
    # neighbouring bins of a Hann window tell the same: so many fewer of them are independent
    covariance = np.linalg.pinv(result.jac.T @ result.jac) * scatter * (enbw_hz / resolution)
    centre, half_width = float(result.x[0]), float(np.exp(result.x[1]))
    return (centre, float(np.sqrt(covariance[0, 0]))), (half_width, half_width * float(np.sqrt(covariance[1, 1])))


def _half_power_reach(density: NDArray[np.float64], peak: int) -> int:
    """Bins on each side that the fit takes: four half-power half widths, at least five bins."""
    reach = 1
    while reach < 80 and _mean_side(density, peak, reach) > 0.5 * density[peak]:
        reach += 1
    return max(5, 4 * reach)


def _mean_side(density: NDArray[np.float64], peak: int, reach: int) -> float:
    return float(0.5 * (density[max(0, peak - reach)] + density[min(len(density) - 1, peak + reach)]))


def _window_kernel(name: str, enbw_hz: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Offsets in Hz and weights of the power response of the window ``name`` with the noise bandwidth ``enbw_hz``."""
    window = window_named(name, 256)
    offset_bins, response = window.main_lobe(steps=4)
    return offset_bins * (enbw_hz / window.enbw_bins), response / response.sum()


def _join(lines: list[FixedLine], resolution: float) -> list[Mode]:
    """Lines of all channels, grouped where neighbours lie within 1 % or two bins and no channel counts twice."""
    groups: list[list[FixedLine]] = []
    for line in lines:
        near = groups and line.frequency_hz - groups[-1][-1].frequency_hz < max(
            2.0 * resolution, 0.01 * line.frequency_hz
        )
        if near and line.channel not in {other.channel for other in groups[-1]}:
            groups[-1].append(line)
        else:
            groups.append([line])
    return [Mode(tuple(group)) for group in groups]


def _weighted(values: list[tuple[float, float]]) -> tuple[float, float]:
    """Mean weighted by inverse variance and its error, widened where the values disagree by more than their errors."""
    x = np.array([value for value, _ in values])
    weight = 1.0 / np.maximum(np.array([error for _, error in values]), 1e-9 * np.abs(x) + 1e-12) ** 2
    mean = float(np.average(x, weights=weight))
    inner = 1.0 / float(weight.sum())
    outer = float(np.average((x - mean) ** 2, weights=weight)) / max(1, len(x) - 1)
    return mean, float(np.sqrt(max(inner, outer)))
