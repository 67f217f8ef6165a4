"""Paths from force to acceleration: the measured orders that they are sought in, and what a manifest states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from crankorder.engine.machine_parts import StatedPath
from crankorder.identify.modes.order_blocks import swept_rows
from crankorder.identify.modes.order_responses import resonance
from crankorder.orders.vold_kalman import NOISE_BANDWIDTH
from crankorder.quantities import Bools, Complexes, Floats, Ints
from crankorder.settings import STANDARD_GRAVITY_M_S2, MethodNumbers

NUMBERS = MethodNumbers("5-identify-balance.toml", "transfer_path")


Noise = tuple[Floats, Complexes]
"""Frequencies (n,), rising, and complex amplitudes (n, channel) there."""
PER_M_S2 = {"m/s2": 1.0, "mm/s2": 1e-3, "g": STANDARD_GRAVITY_M_S2}
GRID = 1e-6
"""An order counts as a bin of the map within this."""


@dataclass(frozen=True, eq=False)
class MeasuredOrders:
    """Complex amplitudes (m/s²) of some orders in the accelerometers, with errors.

    A row is one order at one speed: ``place_of_row`` (row,) in ``orders`` and ``rpm_of_row`` (row,) say which.
    ``amplitude`` and ``error``, the standard error of its real and of its imaginary part, ∞ where nothing was measured:
    (channel, row). ``freedom``: of the errors. ``steady_error``: the same drawn towards the bins beside, less
    scattered, for weights; ``own_share`` is what it still has of its own. ``correlation`` (row, channel, channel):
    of the channels' errors, Hermitian with unit
    diagonal. ``noise`` (row, channel, channel): covariance
    of the complex errors as noise at like frequency tells it, ``noise_bins`` (row,) in number; where too few do it is
    diagonal, of ``steady_error``, and ``noise_bins`` 0.
    """

    channels: tuple[str, ...]
    orders: tuple[int, ...]
    place_of_row: Ints
    rpm_of_row: Floats
    amplitude: Complexes
    error: Floats
    steady_error: Floats
    own_share: Floats
    freedom: Floats
    correlation: Complexes
    noise: Complexes
    noise_bins: Floats

    @property
    def order_of_row(self) -> Ints:
        """Order of each row."""
        return np.array(self.orders, dtype=np.int64)[self.place_of_row]

    @property
    def frequency_hz(self) -> Floats:
        """Frequency of each row (Hz)."""
        return self.order_of_row * self.rpm_of_row / 60.0

    def without(self, rows: Bools) -> MeasuredOrders:
        """The same with nothing measured in ``rows`` (row,)."""
        error, steady_error = (np.where(rows, np.inf, each) for each in (self.error, self.steady_error))
        return replace(self, error=error, steady_error=steady_error)


def measured_orders(
    order_map: xr.Dataset, orders: Sequence[int], *, lines: Sequence[float] = (), followed: Sequence[xr.Dataset] = ()
) -> MeasuredOrders:
    """The ``orders`` of the OrderMap ``order_map`` in its accelerometers; those that are no bin of it are left out.

    ``lines``: orders at which lines stand, whose bins are no noise. Orders that were ``followed`` through sweeps
    (RecordingTracks) have the rows of these.
    """
    bins = order_map["order"].values
    places = {k: int(np.argmin(np.abs(bins - k))) for k in orders}
    bin_of = {k: i for k, i in places.items() if abs(bins[i] - k) < GRID * max(1, k)}
    unit, quantity = order_map["unit"].values.tolist(), order_map["quantity"].values.tolist()
    known = [c for c, name in enumerate(unit) if name in PER_M_S2 and "accel" in str(quantity[c]).casefold()]
    scale = np.array([PER_M_S2[unit[c]] for c in known]).reshape(-1, 1, 1)
    taken = order_map.isel(channel=known)
    level = scale * taken["coherent_amplitude"].values.astype(np.float64)
    complex_map = level * np.exp(1j * np.radians(taken["phase"].values.astype(np.float64)))
    error_map = scale * taken["standard_error"].values.astype(np.float64)
    swept = [(i, rows) for i, k in enumerate(bin_of) for item in followed if (rows := swept_rows(k, item)) is not None]
    mapped = [i for i in range(len(bin_of)) if all(i != place for place, _ in swept)]
    at = [list(bin_of.values())[i] for i in mapped]
    amplitude, error, freedom = (
        np.moveaxis(values[:, :, at], 2, 1).reshape(len(known), -1)
        for values in (complex_map, error_map, taken["degrees_of_freedom"].values.astype(np.float64))
    )
    sound = np.isfinite(amplitude) & np.isfinite(error) & (error > 0)
    step = float(bins[1] - bins[0]) if len(bins) > 1 else 1.0
    clear = np.abs(bins[:, None] - np.array(lines, dtype=np.float64)) > (NUMBERS.nearest_bin - 0.5) * step
    noise_alone = clear.all(axis=1) & (bins > NUMBERS.nearest_bin * step)
    away = np.abs(np.arange(len(bins)) - np.array(at, dtype=np.int64)[:, None])
    near_bins = (away >= NUMBERS.nearest_bin) & (away <= NUMBERS.furthest_bin) & noise_alone
    beside = [np.flatnonzero(row) for row in near_bins]
    over = np.divide(complex_map, error_map, out=np.full_like(complex_map, np.nan), where=error_map > 0.0)
    correlation = [np.zeros((0, len(known), len(known))), *(_correlation(over[:, :, near]) for near in beside)]
    typical = [_geometric_mean(error_map[:, :, near]) for near in beside]
    around = np.stack(typical, axis=1).reshape(len(known), -1) if at else error
    freedom = np.where(sound, freedom, 1.0)
    steady, share = _steadier(np.where(sound, error, np.nan), around, freedom)
    speed_rpm = order_map["speed"].values.astype(np.float64)
    hertz = bins * speed_rpm[:, None] / 60.0
    quiet = np.broadcast_to(noise_alone, hertz.shape)
    shape, n_bins = noise_shape(complex_map, frequency_hz=hertz, usable=quiet, at_hz=hertz[:, at].T.ravel())
    held = MeasuredOrders(
        channels=tuple(str(order_map["channel"].values[c]) for c in known),
        orders=tuple(bin_of),
        place_of_row=np.repeat(np.array(mapped, dtype=np.int64), speed_rpm.size),
        rpm_of_row=np.tile(speed_rpm, len(at)),
        amplitude=np.where(sound, amplitude, 0.0),
        error=np.where(sound, error, np.inf),
        steady_error=np.where(sound, steady, np.inf),
        freedom=freedom,
        own_share=share,
        correlation=np.concatenate(correlation, dtype=np.complex128),
        noise=_covariance(shape, np.where(sound, steady, 1.0)),
        noise_bins=n_bins,
    )
    if not swept:
        return held
    width_hz = order_map.attrs["enbw_bins"] * step * speed_rpm / 60.0 / order_map["n_independent"].values
    noise = _sorted(complex_map / np.sqrt(width_hz)[:, None], hertz, quiet)
    return _joined([held, *(_swept(held, place, rows, scale[:, 0], noise) for place, rows in swept)])


def _sorted(amplitude: Complexes, frequency_hz: Floats, usable: Bools) -> Noise:
    """Frequencies (n,), rising, of the ``usable`` bins (speed, bin), and their ``amplitude`` (n, channel)."""
    sound = usable & np.isfinite(amplitude).all(axis=0) & (np.abs(amplitude) > 0).all(axis=0)
    sequence = np.argsort(frequency_hz[sound], kind="stable")
    return frequency_hz[sound][sequence], amplitude[:, sound].T[sequence]


def _swept(held: MeasuredOrders, place: int, tracks: xr.Dataset, scale: Floats, noise: Noise) -> MeasuredOrders:
    """Rows of one order through one sweep, as if each speed were held: its ``tracks`` (channel, frame).

    ``scale`` (channel, 1) takes them to m/s².

    They err as the ``noise`` in the band of the filter that followed them: frequencies (n,), rising, and amplitudes
    (n, channel) over the root of their bandwidth. That is seen at other times, when the order is elsewhere: what stands
    beside it while it passes a resonance is less than the noise under it, and more soon after. Few bins tell nothing.
    """
    amplitude = scale * tracks["held_amplitude"].reindex(channel=list(held.channels)).values
    rpm, band_hz = tracks["speed"].values, NOISE_BANDWIDTH * tracks["bandwidth_hz"].values
    low, high = np.searchsorted(noise[0], held.orders[place] * rpm / 60.0 + band_hz * np.array([[-0.5], [0.5]]))
    summed = np.cumsum(np.einsum("nc,nd->ncd", noise[1], noise[1].conj()), axis=0)
    summed = np.concatenate([np.zeros_like(summed[:1]), summed])
    bins = np.maximum(high - low, 1).astype(np.float64)
    covariance = (summed[high] - summed[low]) * (band_hz / bins)[:, None, None]
    sound = np.isfinite(amplitude) & (bins >= NOISE_NUMBERS.fewest_per_channel * len(amplitude))
    error = np.where(sound, np.sqrt(np.einsum("rcc->cr", covariance).real / 2), np.inf)
    return replace(
        held,
        place_of_row=np.full(rpm.size, place),
        rpm_of_row=rpm,
        amplitude=np.where(sound, amplitude, 0.0),
        error=error,
        steady_error=error,
        freedom=np.where(sound, bins, 1.0),
        own_share=np.zeros_like(error),
        correlation=np.ones_like(covariance),
        noise=covariance,
        noise_bins=bins,
    )


def _joined(parts: Sequence[MeasuredOrders]) -> MeasuredOrders:
    """All rows of the ``parts``."""
    axes = dict.fromkeys(("place_of_row", "rpm_of_row", "correlation", "noise", "noise_bins"), 0)
    axes |= dict.fromkeys(("amplitude", "error", "steady_error", "freedom", "own_share"), 1)
    rows: Any = {k: np.concatenate([getattr(part, k) for part in parts], axis=axis) for k, axis in axes.items()}
    return replace(parts[0], **rows)


def _covariance(shape: Complexes, error: Floats) -> Complexes:
    """Covariance (row, channel, channel) of complex errors of ``shape``, as large as ``error`` (channel, row) says.

    Diagonal where no shape is known.
    """
    power = 2 * error.T**2
    with np.errstate(invalid="ignore"):
        scale = (power / np.einsum("rcc->rc", shape).real).mean(axis=1)[:, None, None]
    return np.asarray(np.where(np.isfinite(scale), shape * scale, power[:, :, None] * np.eye(len(error))))


def _geometric_mean(beside: Floats) -> Floats:
    """Geometric mean (channel, speed) of errors (channel, speed, bin); NaN where too few bins tell it."""
    if beside.shape[2] < NUMBERS.fewest_bins:
        return np.full(beside.shape[:2], np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.exp(np.log(beside).mean(axis=2)))


def _steadier(own: Floats, beside: Floats, freedom: Floats) -> tuple[Floats, Floats]:
    """Errors ``own`` drawn towards those ``beside``, as far as these tell them, and the share left of their own.

    All (channel, row). The share is that of the true scatter between the two in the whole one, which ``freedom`` makes
    larger (empirical Bayes, as in Smyth 2004); of few degrees of freedom it stays small.
    """
    usable = np.isfinite(own) & (own > 0) & np.isfinite(beside) & (beside > 0)
    if np.count_nonzero(usable) < NUMBERS.fewest_bins:
        return own, np.minimum(1.0, freedom / 8)
    apart = np.log(np.where(usable, own / np.where(usable, beside, 1.0), 1.0) ** 2)
    middle = float(np.median(apart[usable]))
    true = max(0.0, float(np.mean((apart[usable] - middle) ** 2)) - float(np.mean(2 / freedom[usable])))
    share = np.where(usable, np.minimum(true / (true + 2 / freedom), freedom / 8), np.minimum(1.0, freedom / 8))
    return own * np.exp(0.5 * (share - 1) * np.where(usable, apart - middle, 0.0)), share


def _correlation(noise: Complexes) -> Complexes:
    """Correlation (speed, channel, channel) of ``noise`` (channel, speed, bin); full where too few bins tell it."""
    n_channels, n_speeds, n_bins = noise.shape
    noise = np.where(np.isfinite(noise), noise, 0.0)
    power = np.einsum("csb,dsb->scd", noise, noise.conj())
    size = np.sqrt(np.einsum("scc->sc", power).real)
    if n_bins < NUMBERS.fewest_bins or not (size > 0).all():
        return np.ones((n_speeds, n_channels, n_channels), dtype=np.complex128)
    correlation: Complexes = power / (size[:, :, None] * size[:, None, :])
    return correlation


def accelerance_of(path: StatedPath, frequency_hz: Floats) -> Complexes:
    """Acceleration per force (1/kg) that a stated ``path`` has at ``frequency_hz`` (Hz, any shape); NaN where it ends.

    A table is joined by straight lines in its real and imaginary parts.
    """
    f = np.asarray(frequency_hz, dtype=np.float64)
    value: Complexes | Floats
    if path.points:
        hertz, real, imag = np.array(path.points).T
        value = np.interp(f, hertz, real) + 1j * np.interp(f, hertz, imag)
    elif path.apparent_mass_kg is not None:
        value = np.full(f.shape, 1.0 / path.apparent_mass_kg)
    else:
        value = np.full(f.shape, path.rigid_per_kg, dtype=np.complex128)
        for mode in path.modes:
            residue = mode.residue_per_kg + 1j * mode.residue_imag_per_kg
            answer = resonance(f, np.array([mode.frequency_hz]), np.array([mode.damping_ratio]))
            value = value + residue * answer[..., 0]
    low, high = path.holds_hz
    return np.where((f >= low) & (f <= high), value, np.nan)


NOISE_NUMBERS = MethodNumbers("5-identify-balance.toml", "noise_beside")


ROUNDS = 6
"""Rounds of the estimate of shape."""
FILLING = 1e-9
"""Of the mean variance, added to the diagonal: no combination of channels is without noise."""


def noise_shape(noise: Complexes, *, frequency_hz: Floats, usable: Bools, at_hz: Floats) -> tuple[Complexes, Floats]:
    """Shapes (row, channel, channel), of unit mean diagonal, of the noise's covariance at ``at_hz`` (row,), and bins.

    ``noise`` (channel, speed, bin): complex amplitudes; ``usable`` (speed, bin) of those that hold noise alone, at
    ``frequency_hz`` (speed, bin). Every bin counts alike whatever its size, for speeds differ in how much is left of
    the noise and a line may hide in a few (Tyler 1987, Annals of Statistics 15). Shapes are NaN, and the number of
    bins (row,) 0, where too few tell them.
    """
    n_channels = len(noise)
    places, samples = _sorted(noise, frequency_hz, usable)
    shapes = np.full((at_hz.size, n_channels, n_channels), np.nan, dtype=np.complex128)
    counts = np.zeros(at_hz.size)
    for row, hertz in enumerate(at_hz):
        near = _nearest(places, float(hertz))
        if near.size >= NOISE_NUMBERS.fewest_per_channel * n_channels:
            shapes[row], counts[row] = _tyler(samples[near]), near.size
    return shapes, counts


def whitening(noise: Complexes, *, error: Floats, missed: Floats | None = None) -> Complexes:
    """Combinations (row, combination, channel) of the channels in which real and imaginary errors are 1 and apart.

    ``noise`` (row, channel, channel): covariance of the complex errors. ``error`` (channel, row): ∞ where nothing was
    measured; there the combinations are 0. ``missed`` (channel, row) adds to the real and the imaginary errors.
    """
    known = np.isfinite(error).T
    both = known[:, :, None] & known[:, None, :]
    own = np.where(known, 0.0 if missed is None else np.transpose(missed) ** 2, 1.0)
    covariance = np.where(both, noise / 2, 0.0) + own[:, :, None] * np.eye(known.shape[1])
    return np.asarray(np.where(both, np.linalg.inv(np.linalg.cholesky(covariance)), 0.0))


def _nearest(places: Floats, hertz: float) -> Ints:
    reach = min(NOISE_NUMBERS.furthest_hz, max(NOISE_NUMBERS.furthest_share * hertz, 1.0))
    low, high = np.searchsorted(places, [hertz - reach, hertz + reach])
    bins = np.arange(low, high)
    if bins.size > NOISE_NUMBERS.most_bins:
        bins = bins[np.argsort(np.abs(places[bins] - hertz), kind="stable")[: NOISE_NUMBERS.most_bins]]
    return bins


def _tyler(samples: Complexes) -> Complexes:
    n_samples, n_channels = samples.shape
    shape: Complexes = np.eye(n_channels, dtype=np.complex128)
    start = samples / np.sqrt((np.abs(samples) ** 2).mean(axis=0))
    size = np.sqrt((np.abs(samples) ** 2).mean(axis=0))
    for _ in range(ROUNDS):
        inner = ((start.conj() @ np.linalg.inv(shape)) * start).sum(axis=1).real
        shape = (start / inner[:, None]).T @ start.conj() * (n_channels / n_samples)
        shape = shape / (np.trace(shape).real / n_channels) + FILLING * np.eye(n_channels)
    shape = shape * size[:, None] * size
    return np.asarray(shape / (np.trace(shape).real / n_channels))
