"""Order map: the order spectra of all frames of a test, averaged at like speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import xarray as xr
from scipy.special import fdtri

from crankorder.orders.averages import (
    FEW_CONTRASTS,
    Contrasts,
    helped_by_beside,
    independent_by_memory,
    noise_of_mean,
    steepest_noise_beside,
)
from crankorder.orders.intervals import (
    BetweenRecordings,
    amplitude_interval,
    between_recordings,
    ends_between,
    energy_interval,
    one_phase_reference,
    phase_interval_deg,
    phase_reference_of,
    wider_of,
)
from crankorder.orders.like_speed import Frames, Framing, LikeSpeedFrames, like_speed_frames
from crankorder.orders.true_angle import errors_of_rows, given_to
from crankorder.quantities import Complexes, Floats, Ints, Variables, channel_coords, described, flags_of, with_flags
from crankorder.settings import OrderSettings

BESIDE_WORTH = 2.0
"""Independent bins that the bins beside are worth."""

LEAST_POWER = 4.0
"""A line is looked at whose power is so many times the noise power of its mean."""

CHANGE_CHANCE = 0.002
"""Chance with which the noise of a steady line looks like a change of its amplitude, or of its phase."""

BOTH_RATIO, BOTH_CHANCE = 30.0, 1e-6
"""Slow waves so many times the noise beside, which it makes with such a chance, change amplitude and phase at once:
two lines too close to be parted do. A resonance within a bin seldom stands so far over the bins beside."""

MOST_BLOCKS = 8
"""Stretches of a recording whose means are the values that it held."""

MOST_VALUES = 1 << 20
"""Values of frames that are averaged at a time: the memory does not grow with their number."""


DIMS = ("channel", "speed", "order")

INTERVALS = {
    "standard_error": ("see unit", "standard error of coherent_amplitude"),
    "degrees_of_freedom": ("1", "degrees of freedom of standard_error"),
    "coherent_amplitude_low": ("see unit", "lower end of the 95 % interval of coherent_amplitude"),
    "coherent_amplitude_high": ("see unit", "upper end of the 95 % interval of coherent_amplitude"),
    "phase_ci95": ("degree", "half width of the 95 % interval of phase; 180: unknown"),
}
"""Variables of an OrderMap that say how sure its coherent averages are: unit and what they are."""


@dataclass(frozen=True)
class Held:
    """Noise power of the mean without the changes of the line itself, and the values it held; each (channels, orders).

    ``noise`` is that power, ``least`` and ``most`` are the extremes of the line's amplitude, NaN where that is steady;
    ``turned`` is its largest distance [rad] from the mean phase, 0 where that is steady.
    """

    noise: Floats
    least: Floats
    most: Floats
    turned: Floats


def held_values(
    spectrum: Complexes, owner: Ints, *, mean: Complexes, noise: Floats, shape: Contrasts, beside: Floats | None = None
) -> Held:
    """Values that lines held within the recordings where these surely differ, and the ``noise`` without them.

    Noise turns a line as much as it lengthens it. Slow waves along a line that are far larger than those across it
    are therefore changes of its amplitude, and the other way round of its phase.

    Parameters
    ----------
    spectrum : (channels, frames, orders)
    owner : (frames,), number of the recording of each
    mean : (channels, orders), mean over the frames
    noise : (channels, orders), noise power of ``mean`` as of :func:`~crankorder.orders.averages.noise_of_mean`
    shape : contrasts of the frames
    beside : (channels, orders), noise power of a frame by the bins beside; None where it is not known
    """
    held = Held(noise.copy(), np.full(mean.shape, np.nan), np.full(mean.shape, np.nan), np.zeros(mean.shape))
    owners = np.unique(owner)
    freedom = 0.5 * shape.dof - (len(owners) - 1.0)
    if freedom < 1.0:
        return held
    with np.errstate(invalid="ignore"):
        channel, order = np.nonzero(np.square(np.abs(mean)) > LEAST_POWER * noise)
    if not len(channel):
        return held
    centre = mean[channel, order]
    size = np.abs(centre)
    turned_back = spectrum[channel, :, order] * (centre.conj() / size)[:, None]
    apart = turned_back.copy()
    for number in owners:
        apart[:, owner == number] -= apart[:, owner == number].mean(axis=1, keepdims=True)
    waves = apart @ shape.rows.T
    along, across = np.square(waves.real).sum(axis=1), np.square(waves.imag).sum(axis=1)
    surely = float(fdtri(freedom, freedom, 1.0 - CHANGE_CHANCE))
    swells, turns = along > surely * across, across > surely * along
    both = np.zeros(len(channel), dtype=np.bool_)
    if beside is not None:  # where the power of slow waves is far more than the noise beside makes
        ratio = (along + across) / len(shape.rows) / np.maximum(beside[channel, order] * shape.mean_variance, 1e-300)
        most = float(fdtri(shape.dof, 2.0 * shape.independent_powers * BESIDE_WORTH, 1.0 - BOTH_CHANCE))
        both = ratio > max(BOTH_RATIO, most)
    low, high, turn = _extremes(turned_back, owner)
    longer, turned = swells | both, turns | both
    held.least[channel[longer], order[longer]] = low[longer]
    held.most[channel[longer], order[longer]] = high[longer]
    held.turned[channel[turned], order[turned]] = turn[turned]
    alone = 2.0 * np.minimum(along, across) / len(shape.rows) * (0.5 * shape.dof / freedom)
    held.noise[channel, order] = np.where(swells | turns, alone, noise[channel, order])
    return held


def _extremes(turned_back: Complexes, owner: Ints) -> tuple[Floats, Floats, Floats]:
    """Least and largest amplitude and largest turn [rad] of stretches of ``turned_back`` (lines, frames)."""
    means = []
    for name in np.unique(owner):
        mine = np.flatnonzero(owner == name)
        means += [turned_back[:, part].mean(axis=1) for part in np.array_split(mine, min(MOST_BLOCKS, len(mine)))]
    values = np.stack(means, axis=1)
    size = np.abs(values)
    least, most, turn = size.min(axis=1), size.max(axis=1), np.abs(np.angle(values)).max(axis=1)
    beyond = (most - least) / (2.0 * len(means))  # a ramp goes on for half a stretch
    return np.maximum(least - beyond, 0.5 * least), most + beyond, turn * (1.0 + 1.0 / len(means))


@dataclass(frozen=True)
class Average(BetweenRecordings, Held):
    """Averages of a group of frames, each field (channels, orders), with what differs between recordings and was held.

    ``energy`` is the mean power, ``coherent`` the complex mean (the root of the mean of the recordings' coherent
    powers where ``apart``, their number, is over one), ``kurtosis`` the spectral kurtosis (0 of Gaussian noise, -1 of a
    steady line), ``noise`` the noise power of one frame by the frames' own scatter with ``own`` complex degrees of
    freedom, ``left`` the share of it that is left in ``coherent``, ``bias`` the share of it that adds to the power of
    ``coherent``, ``powers`` and ``phases`` the numbers of independent power and complex spectra, ``count`` the number
    of frames.
    """

    energy: Floats
    coherent: Complexes
    kurtosis: Floats
    apart: Floats
    own: Floats
    left: Floats
    bias: Floats
    powers: Floats
    phases: Floats
    count: Floats


def order_map(frames: list[xr.Dataset], *, settings: OrderSettings) -> xr.Dataset:
    """OrderMap (channel, speed, order) of a test from the OrderFrames of its recordings.

    ``frames`` (channel, frame, order) need not be equally many; recordings whose frames are not as long as those of
    most others are left out and flagged "bad", and orders that not all hold are cut off, flagged "info". Frames within
    ``settings.speed_bin_rpm`` share a row, speeds that are held only where their numbers agree. A row is averaged
    twice: by energy (``amplitude``, which also sees lines that slip against the shaft) and coherently
    (``coherent_amplitude`` and ``phase``). Across recordings the coherent average is taken only where all have one and
    the same phase reference (and, for half orders, a known cycle); else the recordings' coherent powers are averaged
    and the phase is NaN. Intervals of several recordings at like speed are for the mean over all such recordings that
    could be made, not for that of those at hand. Amplitude and phase are means over the recording; where they surely
    change within it their intervals reach over all values held, while ``standard_error`` stays that of the mean.
    """
    grouped = like_speed_frames(frames, speed_bin_rpm=settings.speed_bin_rpm)
    whole = averaged(grouped)
    intervals = intervals_of(whole, grouped)
    variables = _averages(whole, grouped.every.unit)
    variables |= {name: described(DIMS, intervals[name], units, text) for name, (units, text) in INTERVALS.items()}
    result = _dataset(variables, grouped, settings)
    if not one_phase_reference(grouped.used):
        for name in ("phase", "phase_ci95"):
            result[name].values[:] = np.nan
    return with_flags(result, [flag for item in frames for flag in flags_of(item)] + grouped.remarks)


def averaged(grouped: LikeSpeedFrames, turned: Callable[[Frames], Frames] | None = None) -> Average:
    """Average (channel, speed, order) of the rows of ``grouped``, of frames ``turned`` first where that is given."""
    rows = map(grouped.every.of, grouped.groups)
    parts = (average_of(frames, grouped.framing) for frames in (map(turned, rows) if turned else rows))
    columns = list(zip(*([getattr(part, field.name) for field in fields(Average)] for part in parts), strict=True))
    # each is let go as it is joined: twice the averages of a long sweep fill the memory
    return Average(*(np.stack(columns.pop(0), axis=1) for _ in fields(Average)))


def _averages(whole: Average, unit: Floats) -> Variables:
    """Variables of the averages of ``whole`` (channel, speed, order); amplitudes are multiples of ``unit``."""
    phase = np.where(whole.apart == 1, np.degrees(np.angle(whole.coherent)), np.nan)
    used = np.max(whole.count, axis=2)
    fewest = np.where(used > 0, used, np.inf).min(axis=0)
    fewest = np.where(np.isfinite(fewest), fewest, 0.0).astype(np.int64)
    least = np.where(whole.powers > 0.0, whole.powers, np.inf).min(axis=(0, 2))
    least = np.where(np.isfinite(least), least, 1.0)
    coherent, phases = unit * np.abs(whole.coherent), whole.phases / whole.apart
    return {
        "amplitude": described(DIMS, unit * np.sqrt(whole.energy), "see unit", "peak amplitude, energy average"),
        "coherent_amplitude": described(DIMS, coherent, "see unit", "peak amplitude, coherent average"),
        "phase": described(DIMS, phase, "degree", "phase from top dead centre"),
        "spectral_kurtosis": described(DIMS, whole.kurtosis, "1", "spectral kurtosis"),
        "frames_used": described(DIMS[:2], used.astype(np.int64), "1", "frames averaged of the channel"),
        "n_frames": described(("speed",), fewest, "1", "frames averaged"),
        "n_independent": described(("speed",), least, "1", "independent power spectra"),
        "n_coherent": described(DIMS, phases, "1", "independent complex spectra"),
    }


def intervals_of(whole: Average, grouped: LikeSpeedFrames, *, by_crank: bool = True) -> dict[str, Floats]:
    """Values (channels, speeds, orders) of the variables of INTERVALS of ``whole``.

    Where the scatter of the frames ``grouped`` says too little, the bins beside help out. Phases ``by_crank`` have the
    errors of the crank angle too, which turn and lessen lines, and whose swing may add sidebands of other lines.
    """
    unit, used = grouped.every.unit, grouped.used
    order = used[0]["order"].values if by_crank else np.zeros(whole.energy.shape[2])
    angle = errors_of_rows(used, grouped.every.owner, grouped.groups).by_order
    given = given_to(np.abs(whole.coherent), used) if by_crank else np.zeros(whole.energy.shape)
    noise, own = np.nan_to_num(whole.noise), whole.own
    few = np.flatnonzero((own < FEW_CONTRASTS).any(axis=(0, 2)))
    if len(few):
        own, at_few = own.copy(), (values[:, few] for values in (noise, own, whole.energy, whole.powers))
        noise[:, few], own[:, few] = helped_by_beside(*at_few, bins=grouped.framing.beside, worth=grouped.framing.worth)
    dof = np.floor(2.0 * own + 0.5)
    coherent = np.abs(whole.coherent)
    power = np.where(own > 0.0, noise * whole.left, np.nan)
    across, across_dof = wider_of(power, dof, whole.across, whole)
    half = np.fmax(phase_interval_deg(coherent, across, across_dof), np.degrees(whole.turned))
    half = angle.phase_half_deg(half, order)
    noise_only = noise * whole.bias * power
    low, high = amplitude_interval(coherent, power, dof)
    within, (power, dof) = (power, dof), wider_of(power, dof, whole.along, whole)
    low, high = ends_between((low, high), coherent, within=within, wider=(power, dof))
    if (whole.apart > 1).any():
        alone = energy_interval(coherent**2, noise=power, bias=noise * whole.bias, noise_variance=noise_only, dof=dof)
        low, high = np.where(whole.apart > 1, alone, (low, high))
    low = np.maximum(np.fmin(low, whole.least) - given, 0.0)
    high = np.fmax(high, whole.most) / angle.kept(order) + given
    missing = np.isnan(coherent)
    return {
        "standard_error": unit * np.where(missing, np.nan, np.sqrt(power / 2.0)),
        "degrees_of_freedom": np.where(missing, 0.0, dof),
        "coherent_amplitude_low": unit * low,
        "coherent_amplitude_high": unit * high,
        "phase_ci95": np.where(whole.apart > 1, np.nan, half),
    }


def average_of(frames: Frames, framing: Framing) -> Average:
    """Average (channels, orders) of a group of ``frames`` that lie as ``framing`` says, without those that are NaN.

    Frames are left out by channel and order; columns (one channel, one order) with the same frames are averaged
    together, and the channels of very many frames one by one.
    """
    if len(frames.spectrum) > 1 and frames.spectrum.size > MOST_VALUES:
        each = (frames._replace(spectrum=channel[None]) for channel in frames.spectrum)
        of_channels = [average_of(channel, framing) for channel in each]
        return Average(*(np.concatenate([getattr(of, field.name) for of in of_channels]) for field in fields(Average)))
    seen = np.isfinite(frames.spectrum.real)
    if seen.all():
        return _average_whole(frames, framing)
    n_channels, _, n_orders = frames.spectrum.shape
    columns = np.moveaxis(frames.spectrum, 1, 2).reshape(n_channels * n_orders, -1)
    patterns, which = np.unique(np.moveaxis(seen, 1, 2).reshape(n_channels * n_orders, -1), axis=0, return_inverse=True)
    columns_of = {field.name: np.full(n_channels * n_orders, np.nan, dtype=complex) for field in fields(Average)}
    for number, pattern in enumerate(patterns):
        at = np.flatnonzero(which.ravel() == number)
        if not pattern.any():
            continue
        part = Frames(np.ascontiguousarray(columns[at].T)[None], frames.owner, frames.begin_rev, frames.speed_rpm)
        alone = framing._replace(with_phase=framing.with_phase[at % n_orders], beside=framing.beside[:0])
        mean = _average_whole(part.of(pattern), alone)
        for name, column in columns_of.items():
            column[at] = getattr(mean, name)[0]
    filled = {name: column.reshape(n_channels, n_orders) for name, column in columns_of.items()}
    filled = {name: values if name == "coherent" else values.real for name, values in filled.items()}
    none = {name: np.nan_to_num(filled[name]) for name in ("own", "powers", "phases", "count", "recordings")}
    return Average(**filled | none | {"apart": np.nan_to_num(filled["apart"], nan=1.0)})


def _average_whole(frames: Frames, framing: Framing) -> Average:
    """Average of a group of ``frames`` that all hold numbers."""
    spectrum, shape = frames.spectrum, framing.contrasts_of(frames)
    n_frames, columns = spectrum.shape[1], (len(spectrum), spectrum.shape[2])
    power = np.square(spectrum.real) + np.square(spectrum.imag)
    energy = power.mean(axis=1)
    mean = spectrum.mean(axis=1)
    count = np.full(columns, n_frames)
    kept = independent_by_memory(spectrum - mean[:, None], frames.owner, count)
    # noise of different recordings is surely independent, whatever they differ by
    kept = np.maximum(kept, float(len(np.unique(frames.owner))))
    left = np.full(columns, shape.mean_variance)
    level = steepest_noise_beside(energy, framing.beside) if framing.beside.size else None
    noise = noise_of_mean(spectrum, shape)
    held = held_values(spectrum, frames.owner, mean=mean, noise=noise, shape=shape, beside=level)
    average = Average(
        **vars(held) | {"noise": held.noise / shape.mean_variance},
        **vars(between_recordings(spectrum, frames.owner, mean)),
        energy=energy,
        coherent=mean,
        kurtosis=_spectral_kurtosis(power, energy, shape.independent_powers),
        apart=np.ones(columns),
        own=np.full(columns, 0.5 * shape.dof),
        left=left,
        bias=left,
        powers=np.full(columns, shape.independent_powers),
        phases=np.maximum(1.0, np.minimum(kept, 1.0 / shape.mean_variance)),
        count=count.astype(np.float64),
    )
    if framing.with_phase.all() or (frames.owner == frames.owner[0]).all():
        return average
    return _without_common_phase(frames, average, framing)


def _without_common_phase(frames: Frames, average: Average, framing: Framing) -> Average:
    """``average``, but by coherent power at the orders whose phases in different recordings say nothing."""
    comparable = framing.with_phase
    names, counts = np.unique(frames.owner, return_counts=True)
    weights = counts / counts.sum()
    power, noise, own, left, bias = (np.zeros(average.energy.shape) for _ in range(5))
    powers = []
    least, most = (np.where(comparable, values, np.nan) for values in (average.least, average.most))
    for name, weight in zip(names, weights, strict=True):
        part = frames.of(frames.owner == name)
        shape = framing.contrasts_of(part)
        mean = part.spectrum.mean(axis=1)
        powers.append(np.square(mean.real) + np.square(mean.imag))
        power += weight * powers[-1]
        held = held_values(part.spectrum, part.owner, mean=mean, noise=noise_of_mean(part.spectrum, shape), shape=shape)
        least = np.where(comparable, least, np.fmin(least, held.least))
        most = np.where(comparable, most, np.fmax(most, held.most))
        noise += 0.5 * shape.dof * np.nan_to_num(held.noise / shape.mean_variance)
        own += 0.5 * shape.dof
        left += weight**2 * shape.mean_variance
        bias += weight * shape.mean_variance
    noise /= np.maximum(own, 1e-9)
    scatter = np.tensordot(weights, np.square(np.array(powers) - power), axes=1)
    scatter = 0.5 * scatter / np.maximum(power, np.finfo(np.float64).tiny)  # as of noise that beats with the line
    apart = np.full(average.energy.shape, float(len(names)))
    by_power = {"coherent": np.sqrt(power), "apart": apart, "noise": noise, "own": own, "left": left, "bias": bias}
    by_power |= {"along": scatter}
    joined = {name: np.where(comparable, getattr(average, name), values) for name, values in by_power.items()}
    return replace(average, least=least, most=most, **joined)


def _spectral_kurtosis(power: Floats, energy: Floats, n: float) -> Floats:
    """Spectral kurtosis (channels, orders) of ``power`` (channels, frames, orders) with the mean ``energy``.

    Unbiased for Gaussian noise whose frames are worth ``n`` independent ones (Antoni 2006; Vrabie et al. 2003); NaN
    for less than two.
    """
    if n < 2.0:
        return np.full(energy.shape, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.einsum("cko,cko->co", power, power) / power.shape[1] / energy**2
    return np.asarray(((n + 1.0) * ratio - 2.0 * n) / (n - 1.0))


def _dataset(variables: Variables, grouped: LikeSpeedFrames, settings: OrderSettings) -> xr.Dataset:
    used, first = grouped.used, grouped.used[0]
    words = {"units": "1", "long_name": "order", "order_reference": "crankshaft"}
    axes = {"order": ("order", first["order"].values, words)}
    speed = described("speed", grouped.speed_rpm, "min-1", "speed")
    result = xr.Dataset(variables, coords={**channel_coords(first), **axes, "speed": speed})
    kept = ("window", "enbw_bins", "revs_per_frame", "overlap", "amplitude_scaling", "cycle_known", "revs_per_cycle")
    result.attrs = {key: first.attrs[key] for key in (*kept, "samples_per_rev") if key in first.attrs}
    result.attrs |= {"phase_reference": phase_reference_of(used), "speed_bin_rpm": settings.speed_bin_rpm}
    stated = [frames.attrs for frames in used if "method" in frames.attrs]
    if stated:
        result.attrs["method"] = ", ".join(sorted({str(attrs["method"]) for attrs in stated}))
        for name in ("tolerance", "predicted_error", "achieved_error"):
            # the largest; fmax passes over what was not measured
            result.attrs[name] = float(np.fmax.reduce([float(attrs[name]) for attrs in stated]))
    return result
