"""Order lines over a stated false-alarm level, each with its order, amplitude and growth with speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import gammaincc, gammainccinv

from crankorder.orders.floor import floor_bins, local_floor
from crankorder.settings import IdentifySettings, OrderSettings

NEIGHBOUR_ORDERS = 0.25
"""Within this of a stronger line nothing is called a line of its own: that is where the stronger one's skirts lie."""

BY_PHASE_CHANCE = 0.01
"""Chance with which frames of noise at one speed agree in phase as well as a line hidden in energy must."""

STEADY_KURTOSIS = -0.4
"""A line 4 dB over the noise in its own bin has this spectral kurtosis; noise alone has 0."""

STEADY_SIGMAS = 5.0
"""Standard deviations by which the spectral kurtosis must lie below that of noise."""

FOLLOWED_SPEEDS = 8
"""A line that is neither locked nor steady must be seen at so many speeds …"""

FOLLOWED_BINS = 20.0
"""… between which a line of fixed frequency would have moved by so many bins …"""

FOLLOWED_SIGMAS = 6.0
"""… and stand so many standard deviations of the noise above the orders beside it."""

STANDING_RATIO = 100.0
"""A line that cannot be proven must stand 20 dB over its floor."""

PROVABLE_FRAMES = 8.0
"""With so many independent frames beyond the first, a lock can be proven and must be."""

SWEPT_BINS = 0.15
"""Standard error, in bins, that a change of amplitude within the frames of a run-up leaves in the place of a line."""

Evidence = Literal[
    "locked to the shaft",
    "steady, not locked",
    "follows the speed",
    "stands out, too few revolutions for proof",
]

Z95 = 1.959964
"""Half width of a 95 % interval in standard deviations."""


@dataclass(frozen=True)
class OrderLine:
    """One order in one channel, over the speeds (``seen``) at which it stands above the false-alarm level.

    ``degrees_of_freedom`` are those of ``amplitude_error``.
    """

    channel: str
    order: float
    order_error: float
    seen: NDArray[np.int64]
    speed_rpm: NDArray[np.float64]
    amplitude: NDArray[np.float64]
    amplitude_error: NDArray[np.float64]
    degrees_of_freedom: NDArray[np.float64]
    phase_deg: NDArray[np.float64]
    evidence: Evidence
    level_over_floor_db: float

    @property
    def strongest(self) -> int:
        """Position, among the speeds seen, of the largest amplitude."""
        return int(np.argmax(self.amplitude))

    def exponent(self) -> tuple[float, float] | None:
        """Exponent n of amplitude ~ speed**n over the speeds seen and its standard error; None for fewer than four."""
        if len(self.seen) < 4 or np.ptp(self.speed_rpm) <= 0.0:
            return None
        x, y = np.log(self.speed_rpm), np.log(self.amplitude)
        x = x - x.mean()
        slope = float(x @ (y - y.mean()) / (x @ x))
        residual = y - y.mean() - slope * x
        return slope, float(np.sqrt(residual @ residual / (len(x) - 2) / (x @ x)))


def order_lines(order_map: xr.Dataset, *, settings: IdentifySettings, orders: OrderSettings) -> list[OrderLine]:
    """Order lines of all channels of the OrderMap ``order_map``, by channel, then by order.

    A line stands above the level that noise alone reaches with ``settings.false_alarm_probability`` at enough speeds
    (``settings.min_speeds``, ``settings.min_speed_fraction``), is the largest within a quarter order, and is no
    resonance that noise excites: its frames agree in phase (locked to the shaft), or in amplitude over speeds at which
    a fixed frequency would have left its bin (it slips), or it follows the speed far. In a test too short for such
    proof, a high line on an order of the cycle is named with that reservation.
    ``orders`` gives the floor's width.
    """
    axis, speed = order_map["order"].values, order_map["speed"].values
    excess, ratio, floor = excess_over_noise(order_map, settings=settings, orders=orders)
    needed = min(len(speed), max(settings.min_speeds, round(settings.min_speed_fraction * len(speed))))
    lines = []
    for channel in range(len(excess)):
        for peak in _peaks(excess[channel], axis, needed):
            seen = np.flatnonzero(excess[channel, :, peak] > 1.0)
            evidence = _evidence(order_map, ratio[channel], channel, int(peak), seen, settings.false_alarm_probability)
            if evidence is not None:
                lines.append(_line(order_map, channel, int(peak), seen, ratio, floor, evidence))
    return lines


def excess_over_noise(
    order_map: xr.Dataset, *, settings: IdentifySettings, orders: OrderSettings
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Energy over the level that noise alone reaches, energy over its floor, and the floor: (channel, speed, order).

    The first is zero where a bin of ``order_map`` is not the highest of three, by energy or by what agrees in phase,
    and at its first bins. ``settings``
    give the chance of a false alarm, ``orders`` the floor's width.
    """
    axis = order_map["order"].values
    energy = order_map["amplitude"].values ** 2
    n_independent = order_map["n_independent"].values
    bins = floor_bins(
        axis,
        line_step=1.0 / int(order_map.attrs["revs_per_cycle"]),
        guard_bins=orders.guard_bins,
        n_bins=orders.floor_bins,
    )
    floor = local_floor(energy, bins, n_averages=n_independent[None, :, None])
    threshold = gammainccinv(n_independent, settings.false_alarm_probability) / n_independent
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.nan_to_num(np.where(floor > 0.0, energy / floor, 0.0), nan=0.0, posinf=0.0)
    excess = np.where(_highest_of_three(energy) | _stands_by_phase(order_map), ratio / threshold[None, :, None], 0.0)
    excess[..., axis < 2.5 * (axis[1] - axis[0])] = 0.0
    return excess, ratio, floor


def _highest_of_three(energy: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where ``energy`` (…, orders) is not below either neighbour: a line that moves past a bin is no line at it."""
    filled = np.nan_to_num(energy)
    highest = np.ones(filled.shape, dtype=bool)
    highest[..., 1:] &= filled[..., 1:] >= filled[..., :-1]
    highest[..., :-1] &= filled[..., :-1] >= filled[..., 1:]
    return highest


def _stands_by_phase(order_map: xr.Dataset) -> NDArray[np.bool_]:
    """Where a line locked to the shaft may stand on the slope of a resonance, whose energy beside it is higher.

    Its coherent amplitude is the highest of three, and frames of noise agree so well in phase only once in
    1 / BY_PHASE_CHANCE (Goodman 1957); that it is locked is proven over all speeds. Nowhere in a map without phases.
    """
    energy = order_map["amplitude"].values ** 2
    if "coherent_amplitude" not in order_map:
        return np.zeros(energy.shape, dtype=np.bool_)
    coherent = order_map["coherent_amplitude"].values ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        coherence = np.nan_to_num(np.where(energy > 0.0, coherent / energy, 0.0))
    frames = np.maximum(1.0, order_map["n_coherent"].values)
    chance = (frames - 1.0) * np.log1p(-np.minimum(coherence, 1.0 - 1e-12))
    return np.asarray(_highest_of_three(coherent) & (chance < np.log(BY_PHASE_CHANCE)))


def _evidence(
    order_map: xr.Dataset,
    ratio: NDArray[np.float64],
    channel: int,
    peak: int,
    seen: NDArray[np.int64],
    false_alarm_probability: float,
) -> Evidence | None:
    """What tells the line from a resonance that noise excites; None where nothing does."""
    if _is_locked(order_map, channel, peak, seen, false_alarm_probability):
        return "locked to the shaft"
    if _has_moved(order_map, peak, seen) and _is_steady(order_map, channel, peak, seen):
        return "steady, not locked"
    if _follows(order_map, ratio, peak, seen):
        return "follows the speed"
    if _stands_out(order_map, ratio, peak, seen):
        return "stands out, too few revolutions for proof"
    return None


def _stands_out(order_map: xr.Dataset, ratio: NDArray[np.float64], peak: int, seen: NDArray[np.int64]) -> bool:
    """Whether a line on an order of the cycle is far over its floor in a test too short to prove any lock.

    ``ratio`` (speeds, orders) is the energy over its floor. Such a line is named with its reservation rather than
    kept back: a resonance that noise excites could be as high, but seldom on an order of the cycle at every speed.
    """
    axis, step = order_map["order"].values, 1.0 / int(order_map.attrs["revs_per_cycle"])
    off = abs(axis[peak] - step * round(axis[peak] / step)) / (axis[1] - axis[0])
    provable = float(np.maximum(order_map["n_independent"].values - 1.0, 0.0).sum())
    high = float(np.median(ratio[seen, peak])) > STANDING_RATIO and len(seen) == order_map.sizes["speed"]
    return off < 0.5 and provable < PROVABLE_FRAMES and high


def _follows(order_map: xr.Dataset, ratio: NDArray[np.float64], peak: int, seen: NDArray[np.int64]) -> bool:
    """Whether the line is a sharp ridge along its order over speeds at which a fixed frequency would have moved far.

    ``ratio`` (speeds, orders) is the energy over its floor. A resonance sweeps over all orders and raises neighbours
    alike; the logarithm of the energy of one frame of noise scatters by pi / sqrt(6) about its mean.
    """
    axis, speed = order_map["order"].values, order_map["speed"].values
    moved = axis[peak] * (speed[seen].max() / speed[seen].min() - 1.0) / (axis[1] - axis[0])
    if len(seen) < FOLLOWED_SPEEDS or moved < FOLLOWED_BINS:
        return False
    span = slice(int(seen[0]), int(seen[-1]) + 1)
    height = np.log(np.maximum(ratio[span], 1e-3)).mean(axis=0)
    beside = [k for k in (*range(peak - 6, peak - 2), *range(peak + 3, peak + 7)) if 0 <= k < len(axis)]
    frames = float(order_map["n_frames"].values[span].sum())
    independent = frames * min(1.0, 2.0 * (1.0 - float(order_map.attrs["overlap"])))
    scatter = np.pi / np.sqrt(6.0 * independent)
    return bool(height[peak] - height[beside].mean() > FOLLOWED_SIGMAS * scatter)


def _is_locked(
    order_map: xr.Dataset, channel: int, peak: int, seen: NDArray[np.int64], false_alarm_probability: float
) -> bool:
    """Whether the frames agree in phase as noise would only with ``false_alarm_probability``.

    The coherence g of n frames of noise exceeds its value with probability (1 - g)**(n - 1) (Goodman 1957); minus the
    logarithms of several speeds add up to a gamma variable. A resonance excited by noise may stand out as far as a
    line does, but its phase wanders.
    """
    energy = order_map["amplitude"].values[channel, seen, peak] ** 2
    coherence = order_map["coherent_amplitude"].values[channel, seen, peak] ** 2 / energy
    n_independent = np.maximum(1.0, order_map["n_coherent"].values[channel, seen, peak])
    evidence = float(np.sum(-(n_independent - 1.0) * np.log1p(-np.minimum(coherence, 1.0 - 1e-12))))
    return bool(gammaincc(len(seen), evidence) < false_alarm_probability)


def _is_steady(order_map: xr.Dataset, channel: int, peak: int, seen: NDArray[np.int64]) -> bool:
    """Whether the amplitude is far steadier from frame to frame than noise: a line that slips against the shaft.

    Spectral kurtosis is 0 ± 2/sqrt(n) for n frames of noise and -1 for a line (Antoni 2006).
    """
    frames = order_map["n_independent"].values[seen]
    kurtosis = order_map["spectral_kurtosis"].values[channel, seen, peak]
    known = np.isfinite(kurtosis)
    if not known.any():
        return False
    mean = float(np.average(kurtosis[known], weights=frames[known]))
    return mean < -STEADY_SIGMAS * 2.0 / float(np.sqrt(frames[known].sum())) and mean < STEADY_KURTOSIS


def _peaks(excess: NDArray[np.float64], axis: NDArray[np.float64], needed: int) -> NDArray[np.int64]:
    """Bins that are above the level at ``needed`` speeds and the largest within a quarter order."""
    resolution = axis[1] - axis[0]
    score = np.log(np.maximum(excess, 1.0)).sum(axis=0)
    reach = max(1, round(NEIGHBOUR_ORDERS / resolution))
    padded = np.pad(score, reach, constant_values=-1.0)
    highest = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).max(axis=-1)
    seen = excess > 1.0
    enough = (seen.sum(axis=0) >= needed) & (score > 0.0) & (score >= highest)
    return np.flatnonzero(enough)


def _has_moved(order_map: xr.Dataset, peak: int, seen: NDArray[np.int64]) -> bool:
    """Whether a line of fixed frequency would have left its bin over the speeds ``seen``; True for a single speed."""
    axis, speed = order_map["order"].values, order_map["speed"].values
    if len(speed) < 2 or not np.isfinite(speed).all():
        return True
    return bool(axis[peak] * (speed[seen].max() / speed[seen].min() - 1.0) > 2.0 * (axis[1] - axis[0]))


def _line(
    order_map: xr.Dataset,
    channel: int,
    peak: int,
    seen: NDArray[np.int64],
    ratio: NDArray[np.float64],
    floor: NDArray[np.float64],
    evidence: Evidence,
) -> OrderLine:
    axis = order_map["order"].values
    resolution = float(axis[1] - axis[0])
    beside = np.clip([peak - 1, peak, peak + 1], 0, len(axis) - 1)
    energy = order_map["amplitude"].values[channel, seen, peak] ** 2
    coherent = order_map["coherent_amplitude"].values[channel, seen, peak]
    coherent_error = order_map["standard_error"].values[channel, seen, peak]
    noise = floor[channel, seen, peak]
    n_frames = order_map["n_independent"].values[seen]
    if evidence == "locked to the shaft":
        amplitude, error = coherent, coherent_error
        dof = order_map["degrees_of_freedom"].values[channel, seen, peak].astype(np.float64)
    else:
        amplitude = np.sqrt(np.maximum(energy - noise, 1e-3 * energy))
        error = np.sqrt((noise * energy + 0.5 * noise**2) / n_frames) / (2.0 * amplitude)
        dof = np.full(len(seen), np.inf)  # the floor is the median of many bins
    lobe = np.nan_to_num(order_map["amplitude"].values[channel][np.ix_(seen, beside)]) ** 2 - noise[:, None]
    distance, distance_error = _refined(np.sqrt(np.maximum(lobe, 0.0)), noise / n_frames)
    if evidence != "locked to the shaft":  # between two bins a window shows less of a line
        loss = float(np.sinc(distance) / (1.0 - distance**2))
        amplitude, error = amplitude / loss, error / loss
    return OrderLine(
        channel=str(order_map["channel"].values[channel]),
        order=float(axis[peak]) + resolution * distance,
        order_error=resolution * float(np.hypot(distance_error, SWEPT_BINS if _is_swept(order_map) else 0.0)),
        seen=seen,
        speed_rpm=order_map["speed"].values[seen],
        amplitude=amplitude,
        amplitude_error=error,
        degrees_of_freedom=dof,
        phase_deg=order_map["phase"].values[channel, seen, peak],
        evidence=evidence,
        level_over_floor_db=float(10.0 * np.log10(ratio[channel, seen, peak].max())),
    )


def _is_swept(order_map: xr.Dataset) -> bool:
    """Whether the speeds are those of a run-up or coast-down, whose groups touch, and not steps."""
    speed = np.sort(order_map["speed"].values)
    return len(speed) > 2 and bool(np.median(np.diff(speed)) < 1.5 * float(order_map.attrs["speed_bin_rpm"]))


def _refined(lobe: NDArray[np.float64], noise: NDArray[np.float64]) -> tuple[float, float]:
    """Distance of a line from its bin, in bins, and its standard error, from the three bins of its main lobe.

    ``lobe`` is (speeds, 3) amplitudes, ``noise`` (speeds,) the noise power in each. Both neighbours of the Hann
    window's main lobe tell the distance, (2 r - 1) / (1 + r) on the right and (1 - 2 l) / (1 + l) on the left (Rife
    and Vincent 1970); their mean has no bias from noise and errs by 0.61 / sqrt(signal-to-noise ratio). Speeds count
    by that ratio.
    """
    left, right = lobe[:, 0] / lobe[:, 1], lobe[:, 2] / lobe[:, 1]
    offset = 0.5 * ((2.0 * right - 1.0) / (1.0 + right) + (1.0 - 2.0 * left) / (1.0 + left))
    weight = lobe[:, 1] ** 2 / np.maximum(noise, 1e-12 * lobe[:, 1] ** 2)
    mean = float(np.average(offset, weights=weight))
    spread = float(np.sqrt(np.average((offset - mean) ** 2, weights=weight) / max(1, len(offset) - 1)))
    return mean, max(spread, 0.61 / float(np.sqrt(weight.sum())))


def orders_agreed(lines: list[OrderLine]) -> list[tuple[float, list[OrderLine]]]:
    """Orders of the test, each with the ``lines`` of the channels that show it.

    The order is their mean weighted by precision: channels see the same shaft. Lines closer than NEIGHBOUR_ORDERS
    are one order; a channel has no two such.
    """
    groups: list[list[OrderLine]] = []
    for line in sorted(lines, key=lambda item: item.order):
        channels = {other.channel for other in groups[-1]} if groups else set()
        if groups and line.order - groups[-1][0].order < 0.5 * NEIGHBOUR_ORDERS and line.channel not in channels:
            groups[-1].append(line)
        else:
            groups.append([line])
    return [(_agreed(group), group) for group in groups]


def _agreed(group: list[OrderLine]) -> float:
    weights = np.array([1.0 / line.order_error**2 for line in group])
    mean = float(np.average([line.order for line in group], weights=weights))
    half = round(2.0 * mean) / 2.0
    # within its error a line is the half order beside it: that is what shafts make
    return half if abs(mean - half) <= max(0.005, Z95 / float(np.sqrt(weights.sum()))) else mean
