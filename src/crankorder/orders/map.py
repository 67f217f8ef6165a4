"""Order map: the order spectra of all frames of a test, averaged at like speed."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import fdtri

from crankorder.orders.averages import (
    FEW_CONTRASTS,
    NEAREST_BINS,
    Contrasts,
    beside_bins,
    contrasts,
    helped_by_beside,
    independent_by_memory,
    neighbour_correlation,
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
    phases_compare,
    wider_of,
)
from crankorder.orders.like_speed import Bins, Frames, all_frames, common_frames, rows
from crankorder.orders.true_angle import AngleErrors, errors_of_rows, given_to
from crankorder.quantities import Bools, Complexes, Floats, Ints, Variables, channel_coords, flags_of, with_flags
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


SWEPT_SHARE = 0.1
"""Share of a speed bin from which frames in it are taken to differ in speed."""
MOST_VALUES = 1 << 20
"""Values of frames that are averaged at a time: the memory does not grow with their number."""


@dataclass(frozen=True)
class Held:
    """Noise power of the mean without what the line itself does, and the values that it held.

    ``least`` and ``most`` amplitude of it, NaN where that is steady; ``turned`` its largest distance [rad] from the
    mean phase, 0 where that is steady; each (channels, orders).
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
    nothing = np.full(mean.shape, np.nan)
    held = Held(noise.copy(), nothing, nothing.copy(), np.zeros(mean.shape))
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
    for name in owners:
        mine = owner == name
        apart[:, mine] -= apart[:, mine].mean(axis=1, keepdims=True)
    waves = apart @ shape.rows.T
    along, across = np.square(waves.real).sum(axis=1), np.square(waves.imag).sum(axis=1)
    surely = float(fdtri(freedom, freedom, 1.0 - CHANGE_CHANCE))
    swells, turns = along > surely * across, across > surely * along
    both = _changes_both(along + across, channel, order, beside=beside, shape=shape)
    low, high, turn = _extremes(turned_back, owner)
    longer, turned = swells | both, turns | both
    held.least[channel[longer], order[longer]] = low[longer]
    held.most[channel[longer], order[longer]] = high[longer]
    held.turned[channel[turned], order[turned]] = turn[turned]
    alone = 2.0 * np.minimum(along, across) / len(shape.rows) * (0.5 * shape.dof / freedom)
    held.noise[channel, order] = np.where(swells | turns, alone, noise[channel, order])
    return held


def _changes_both(waves: Floats, channel: Ints, order: Ints, *, beside: Floats | None, shape: Contrasts) -> Bools:
    """Where the power of slow ``waves`` (lines,) is far more than the noise ``beside`` makes."""
    if beside is None:
        return np.zeros(len(waves), dtype=np.bool_)
    ratio = waves / len(shape.rows) / np.maximum(beside[channel, order] * shape.mean_variance, 1e-300)
    surely = float(fdtri(shape.dof, 2.0 * shape.independent_powers * BESIDE_WORTH, 1.0 - BOTH_CHANCE))
    return np.asarray(ratio > max(BOTH_RATIO, surely))


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
class Average:
    """Averages of a group of frames, each (channels, orders).

    ``energy`` is the mean power, ``coherent`` the complex mean (the root of the mean of the recordings' coherent
    powers where ``apart``, their number, is over one), ``noise`` the noise power of one frame by the frames' own
    scatter with ``own`` complex degrees of freedom, ``share`` what of it is left in ``coherent``, ``bias`` what
    it adds to the power of ``coherent``, ``powers`` the independent power spectra, ``phases`` the complex ones;
    ``along``, ``across``, ``recordings`` and ``between`` (its share) are those of BetweenRecordings; ``least``,
    ``most`` and ``turned`` those of Held.
    """

    energy: Floats
    coherent: Complexes
    kurtosis: Floats
    apart: Floats
    noise: Floats
    own: Floats
    share: Floats
    bias: Floats
    powers: Floats
    phases: Floats
    count: Floats
    along: Floats
    across: Floats
    recordings: Floats
    between: Floats
    least: Floats
    most: Floats
    turned: Floats


@dataclass(frozen=True)
class Framing:
    """Length [rev] and window of the frames; speeds that differ by over ``swept_rpm`` may change amplitudes."""

    revs: float
    window: str
    swept_rpm: float

    def contrasts_of(self, frames: Frames) -> Contrasts:
        """Contrasts of ``frames`` by their overlap, along their speeds too where these are swept."""
        correlation = neighbour_correlation(
            frames.begin_rev, frames.owner, revs_per_frame=self.revs, window=self.window
        )
        swept = float(np.ptp(frames.speed_rpm)) > self.swept_rpm  # False where unknown
        return contrasts(correlation, frames.speed_rpm if swept else None)


def order_map(frames: list[xr.Dataset], *, settings: OrderSettings) -> xr.Dataset:
    """OrderMap of a test from the OrderFrames of its recordings.

    ``frames`` need not be equally many; recordings whose frames are not as long as those of most others are left out
    and flagged "bad", and orders that not all hold are cut off, flagged "info". Frames within
    ``settings.speed_bin_rpm`` share a row, speeds that are held only where their numbers agree. A row is averaged
    twice: by energy (``amplitude``, which also sees lines that slip against the shaft) and coherently
    (``coherent_amplitude`` and ``phase``). Across recordings the coherent average is taken only where all have one and
    the same phase reference (and, for half orders, a known cycle); else the recordings' coherent powers are averaged
    and the phase is NaN. Intervals of several recordings at like speed are for the mean over all such recordings that
    could be made, not for that of those at hand. Amplitude and phase are means over the recording; where they surely
    change within it their intervals reach over all values held, while ``standard_error`` stays that of the mean.
    """
    used, remarks = common_frames(frames)
    order = used[0]["order"].values
    every = all_frames(used)
    comparable = phases_compare(used, order)
    bins, worth = beside_bins(order, line_step=1.0 / int(used[0].attrs["revs_per_cycle"]), count=NEAREST_BINS)
    framing = Framing(
        revs=float(used[0].attrs["revs_per_frame"]),
        window=str(used[0].attrs["window"]),
        swept_rpm=SWEPT_SHARE * settings.speed_bin_rpm,
    )
    groups = rows(
        every,
        bins=Bins(bins, worth, comparable),
        revs_per_frame=framing.revs,
        window=framing.window,
        speed_bin_rpm=settings.speed_bin_rpm,
    )
    parts = (_average(every.of(group), comparable, framing, bins) for group in groups)
    columns = list(zip(*([getattr(part, item.name) for item in fields(Average)] for part in parts), strict=True))
    # each is let go as it is joined: twice the averages of a long sweep fill the memory
    whole = Average(*(np.stack(columns.pop(0), axis=1) for _ in fields(Average)))
    speed = np.array([np.mean(every.speed_rpm[group]) for group in groups])
    unit = np.ldexp(1.0, every.exponent)[:, None, None]
    made: Variables = {}
    _put_averages(made, whole, unit)
    given = given_to(np.abs(whole.coherent), used)
    angle = errors_of_rows(used, every.owner, groups).by_order
    _put_intervals(made, whole, unit, (bins, worth), angle, order, given)
    result = _dataset(made, used, order, speed, settings)
    if not one_phase_reference(used):
        for name in ("phase", "phase_ci95"):
            result[name].values[:] = np.nan
    return with_flags(result, [flag for item in frames for flag in flags_of(item)] + remarks)


def _put_averages(result: Variables, whole: Average, unit: Floats) -> None:
    """Averages of ``whole`` (channel, speed, order) into ``result``; amplitudes are multiples of ``unit``."""
    dims = ("channel", "speed", "order")
    _put(result, "amplitude", dims, unit * np.sqrt(whole.energy), "peak amplitude, energy average")
    _put(result, "coherent_amplitude", dims, unit * np.abs(whole.coherent), "peak amplitude, coherent average")
    phase = np.where(whole.apart == 1, np.degrees(np.angle(whole.coherent)), np.nan)
    _put(result, "phase", dims, phase, "phase from top dead centre", "degree")
    _put(result, "spectral_kurtosis", dims, whole.kurtosis, "spectral kurtosis", "1")
    used = np.max(whole.count, axis=2)
    _put(result, "frames_used", ("channel", "speed"), used.astype(np.int64), "frames averaged of the channel", "1")
    fewest = np.where(used > 0, used, np.inf).min(axis=0)
    fewest = np.where(np.isfinite(fewest), fewest, 0.0).astype(np.int64)
    _put(result, "n_frames", ("speed",), fewest, "frames averaged", "1")
    least = np.where(whole.powers > 0.0, whole.powers, np.inf).min(axis=(0, 2))
    least = np.where(np.isfinite(least), least, 1.0)
    _put(result, "n_independent", ("speed",), least, "independent power spectra", "1")
    _put(result, "n_coherent", dims, whole.phases / whole.apart, "independent complex spectra", "1")


def _put_intervals(
    result: Variables,
    whole: Average,
    unit: Floats,
    beside: tuple[Ints, Floats],
    angle: AngleErrors,
    order: Floats,
    given: Floats,
) -> None:
    """Standard error, degrees of freedom and 95 % intervals of ``whole`` (channel, speed, order) into ``result``.

    Where the frames' own scatter says too little the bins ``beside`` are asked too, worth so many independent ones.
    ``angle`` (speed, 1) are the errors of the crank angle, which turn and lessen a line at each ``order``; ``given``
    is what a swing of the angle may give to it.
    """
    bins, worth = beside
    dims = ("channel", "speed", "order")
    noise, own = np.nan_to_num(whole.noise), whole.own
    few = np.flatnonzero((own < FEW_CONTRASTS).any(axis=(0, 2)))
    if len(few):
        own = own.copy()
        noise[:, few], own[:, few] = helped_by_beside(
            noise[:, few], own[:, few], energy=whole.energy[:, few], powers=whole.powers[:, few], bins=bins, worth=worth
        )
    dof = np.floor(2.0 * own + 0.5)
    coherent = np.abs(whole.coherent)
    power = np.where(own > 0.0, noise * whole.share, np.nan)
    apart = BetweenRecordings(whole.along, whole.across, whole.recordings, whole.between)
    across, across_dof = wider_of(power, dof, apart.across, apart)
    half = np.fmax(phase_interval_deg(coherent, across, across_dof), np.degrees(whole.turned))
    half = angle.phase_half_deg(half, order)
    noise_only = noise * whole.bias * power
    low, high = amplitude_interval(coherent, power, dof)
    within, (power, dof) = (power, dof), wider_of(power, dof, apart.along, apart)
    low, high = ends_between((low, high), coherent, within=within, wider=(power, dof))
    if (whole.apart > 1).any():
        alone = energy_interval(coherent**2, noise=power, bias=noise * whole.bias, noise_variance=noise_only, dof=dof)
        low, high = np.where(whole.apart > 1, alone[0], low), np.where(whole.apart > 1, alone[1], high)
    low = np.maximum(np.fmin(low, whole.least) - given, 0.0)
    high = np.fmax(high, whole.most) / angle.kept(order) + given
    missing = np.isnan(coherent)
    error = np.where(missing, np.nan, np.sqrt(power / 2.0))
    _put(result, "standard_error", dims, unit * error, "standard error of coherent_amplitude")
    _put(result, "degrees_of_freedom", dims, np.where(missing, 0.0, dof), "degrees of freedom of standard_error", "1")
    ends = ((low, "lower"), (high, "upper"))
    for values, end in ends:
        name = f"coherent_amplitude_{'low' if end == 'lower' else 'high'}"
        _put(result, name, dims, unit * values, f"{end} end of the 95 % interval of coherent_amplitude")
    half = np.where(whole.apart > 1, np.nan, half)
    _put(result, "phase_ci95", dims, half, "half width of the 95 % interval of phase; 180: unknown", "degree")


def _average(frames: Frames, comparable: Bools, framing: Framing, bins: Ints) -> Average:
    """Average of a group of ``frames``; those that are NaN, by channel and order, take no part.

    Where some are, columns (one channel, one order) with the same frames are averaged together; of very many frames the
    channels are averaged one by one.
    """
    if len(frames.spectrum) > 1 and frames.spectrum.size > MOST_VALUES:
        each = (replace(frames, spectrum=one[None]) for one in frames.spectrum)
        made_of = [_average(one, comparable, framing, bins) for one in each]
        return Average(*(np.concatenate([getattr(one, item.name) for one in made_of]) for item in fields(Average)))
    seen = np.isfinite(frames.spectrum.real)
    if seen.all():
        return _average_whole(frames, comparable, framing, bins)
    n_channels, _, n_orders = frames.spectrum.shape
    columns = np.moveaxis(frames.spectrum, 1, 2).reshape(n_channels * n_orders, -1)
    patterns, which = np.unique(np.moveaxis(seen, 1, 2).reshape(n_channels * n_orders, -1), axis=0, return_inverse=True)
    made = [np.full(n_channels * n_orders, np.nan, dtype=complex) for _ in fields(Average)]
    for number, pattern in enumerate(patterns):
        at = np.flatnonzero(which.ravel() == number)
        if not pattern.any():
            continue
        part = Frames(np.ascontiguousarray(columns[at].T)[None], frames.owner, frames.begin_rev, frames.speed_rpm)
        mean = _average_whole(part.of(pattern), comparable[at % n_orders], framing)
        for target, item in zip(made, fields(Average), strict=True):
            target[at] = getattr(mean, item.name)[0]
    shaped = [values.reshape(n_channels, n_orders) for values in made]
    filled = Average(*(values if k == 1 else values.real for k, values in enumerate(shaped)))
    none = {name: np.nan_to_num(getattr(filled, name)) for name in ("own", "powers", "phases", "count", "recordings")}
    return replace(filled, apart=np.nan_to_num(filled.apart, nan=1.0), **none)


def _average_whole(frames: Frames, comparable: Bools, framing: Framing, bins: Ints | None = None) -> Average:
    """Average of a group of ``frames`` that all hold numbers; ``comparable`` (orders,) as of :func:`phases_compare`.

    ``bins`` (orders, several) are those beside each, None where the columns are no neighbours.
    """
    spectrum, shape = frames.spectrum, framing.contrasts_of(frames)
    n_frames, columns = spectrum.shape[1], (len(spectrum), spectrum.shape[2])
    power = np.square(spectrum.real) + np.square(spectrum.imag)
    energy = power.mean(axis=1)
    mean = spectrum.mean(axis=1)
    count = np.full(columns, n_frames)
    kept = independent_by_memory(spectrum - mean[:, None], frames.owner, count, chance="taken off")
    # noise of different recordings is surely independent, whatever they differ by
    kept = np.maximum(kept, float(len(np.unique(frames.owner))))
    phases = np.maximum(1.0, np.minimum(kept, 1.0 / shape.mean_variance))
    share = np.full(columns, shape.mean_variance)
    beside = None if bins is None else steepest_noise_beside(energy, bins)
    noise = noise_of_mean(spectrum, shape)
    held = held_values(spectrum, frames.owner, mean=mean, noise=noise, shape=shape, beside=beside)
    noise = held.noise / shape.mean_variance
    apart = between_recordings(spectrum, frames.owner, mean)
    made = Average(
        energy=energy,
        coherent=mean,
        kurtosis=_spectral_kurtosis(power, energy, shape.independent_powers),
        apart=np.ones(columns),
        noise=noise,
        own=np.full(columns, 0.5 * shape.dof),
        share=share,
        bias=share,
        powers=np.full(columns, shape.independent_powers),
        phases=phases,
        count=count.astype(np.float64),
        along=apart.along,
        across=apart.across,
        recordings=apart.recordings,
        between=apart.share,
        least=held.least,
        most=held.most,
        turned=held.turned,
    )
    if comparable.all() or (frames.owner == frames.owner[0]).all():
        return made
    return _without_common_phase(frames, made, comparable, framing)


def _without_common_phase(frames: Frames, made: Average, comparable: Bools, framing: Framing) -> Average:
    """``made`` with the orders whose phases in different recordings say nothing averaged by coherent power instead."""
    names, counts = np.unique(frames.owner, return_counts=True)
    weights = counts / counts.sum()
    power, noise, own, share, bias = (np.zeros(made.energy.shape) for _ in range(5))
    powers = []
    least, most = (np.where(comparable, values, np.nan) for values in (made.least, made.most))
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
        share += weight**2 * shape.mean_variance
        bias += weight * shape.mean_variance
    noise /= np.maximum(own, 1e-9)
    scatter = np.tensordot(weights, np.square(np.array(powers) - power), axes=1)
    scatter = 0.5 * scatter / np.maximum(power, np.finfo(np.float64).tiny)  # as of noise that beats with the line
    return replace(
        made,
        coherent=np.where(comparable, made.coherent, np.sqrt(power)),
        apart=np.where(comparable, 1.0, float(len(names))) * np.ones(made.energy.shape),
        noise=np.where(comparable, made.noise, noise),
        own=np.where(comparable, made.own, own),
        share=np.where(comparable, made.share, share),
        bias=np.where(comparable, made.bias, bias),
        along=np.where(comparable, made.along, scatter),
        least=least,
        most=most,
    )


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


def _put(
    target: Variables, name: str, dims: tuple[str, ...], values: NDArray[Any], long_name: str, units: str = "see unit"
) -> None:
    target[name] = (dims, values, {"units": units, "long_name": long_name})


def _dataset(
    made: Variables, used: list[xr.Dataset], order: Floats, speed: Floats, settings: OrderSettings
) -> xr.Dataset:
    first = used[0]
    result = xr.Dataset(
        made,
        coords={
            **channel_coords(first),
            "order": ("order", order, {"units": "1", "long_name": "order", "order_reference": "crankshaft"}),
            "speed": ("speed", speed, {"units": "min-1", "long_name": "speed"}),
        },
    )
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
