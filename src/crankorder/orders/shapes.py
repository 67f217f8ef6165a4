"""Operating shapes: how every measured point moves at an order, in amplitude and phase, speed by speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.fft.windows import power_of_two
from crankorder.orders.averages import NEAREST_BINS, beside_bins, independent_by_memory, pooled, steepest_noise_beside
from crankorder.orders.intervals import (
    amplitude_interval,
    between_recordings,
    is_seen,
    phase_interval_deg,
    phase_reference_of,
    phases_compare,
    wider_of,
)
from crankorder.orders.like_speed import LikeSpeedFrames, like_speed_frames
from crankorder.quantities import (
    Bools,
    Complexes,
    Floats,
    Ints,
    channel_coords,
    described,
    flags_of,
    with_flags,
)
from crankorder.settings import OrderSettings

LEAST_FRAMES = 2.0
"""Independent frames below which a coherence says nothing: that of one frame is 1 whatever the signals."""

GRID, TERMS = 257, 400
"""Coherences for which the expected estimate is tabulated, and terms of its series: right to 1e-5."""

FEW_FRAMES = 2.5
"""With fewer independent frames their scatter says too little, and the bins beside help out."""

ON_BIN = 1e-6
"""An order this close to one of the frames lies on it; between bins no phase from the crank exists."""

CRANK = -1
"""In the place of a channel's number: phases are from the mark of the crank."""


def place_of(name: str, names: list[str]) -> int:
    """Position of the channel ``name`` in ``names``. Raises RequestError where it is none of them."""
    if name not in names:
        raise RequestError("no such channel to refer to", found=name, allowed=", ".join(names))
    return names.index(name)


def coherence_level(n_frames: Floats) -> Floats:
    """Estimated coherence that independent signals stay below in 95 of 100 cases, before its bias is taken off.

    ``n_frames`` independent ones, any shape; NaN below two. Source: Carter 1973, from Goodman's distribution: of
    independent Gaussian signals it exceeds x with the probability (1 - x)^(n_frames - 1).
    """
    n = np.asarray(n_frames, dtype=np.float64)
    enough = n >= LEAST_FRAMES
    return np.where(enough, -np.expm1(np.log1p(-0.95) / np.where(enough, n - 1.0, 1.0)), np.nan)


def expected_coherence(coherence: Floats, *, n_frames: float) -> Floats:
    """Mean of the estimated magnitude-squared coherence from few frames: 1 / n_frames where the true one is 0.

    ``coherence`` the true one, 0…1, any shape; ``n_frames`` independent frames, at least 2. Source: Carter, Knapp and
    Nuttall 1973, 1 / n + (n - 1) / (n + 1) x 2F1(1, 1; n + 2; x).
    """
    true = np.asarray(coherence, dtype=np.float64)
    index = np.arange(1.0, TERMS)
    terms = np.concatenate([[1.0], np.cumprod(index / (n_frames + 1.0 + index))])
    series = np.polynomial.polynomial.polyval(true, terms)
    return np.asarray(1.0 / n_frames + (n_frames - 1.0) / (n_frames + 1.0) * true * series)


def unbiased_coherence(estimate: Floats, *, n_frames: Floats) -> Floats:
    """Coherence whose expected estimate is the one found: 0…1, and 0 where chance explains it; NaN below two frames.

    ``estimate`` magnitude-squared, any shape; ``n_frames`` independent frames, broadcast against it.
    """
    biased, n = np.broadcast_arrays(np.asarray(estimate, dtype=np.float64), np.asarray(n_frames, dtype=np.float64))
    coherence = np.full(biased.shape, np.nan)
    for each in np.unique(n[n >= LEAST_FRAMES]):
        here = n == each
        coherence[here] = np.interp(biased[here], *_expected_table(float(each)))
    return np.where(np.isnan(biased), np.nan, coherence)


@lru_cache(maxsize=256)
def _expected_table(n_frames: float) -> tuple[Floats, Floats]:
    """Expected estimates from ``n_frames`` and the true coherences that they belong to, both growing."""
    true = np.linspace(0.0, 1.0, GRID)
    expected = expected_coherence(true, n_frames=n_frames)
    expected[-1] = 1.0
    return expected, true


ESTIMATES = ("amplitude", "low", "high", "phase_deg", "half_phase_deg", "coherence")
"""What is told of all channels and orders at one speed, each (channels, orders)."""


def operating_shapes(
    frames: list[xr.Dataset], orders: Sequence[float], *, settings: OrderSettings, reference: str | None = None
) -> xr.Dataset:
    """OperatingShapes of a test: peak amplitude and phase of every channel (channel, speed, order), with intervals.

    Parameters
    ----------
    frames : OrderFrames of the recordings of the test; those of another length than most are left out
    orders : orders wanted, cycles per crank revolution; above the frames' highest they are NaN. Give those that were
        found: from a channel, noise that all channels share, such as that of a mode, has a shape as well
    settings : of orders; ``speed_bin_rpm`` is the width of a group of frames
    reference : name of the channel that phases are measured from; None for the crank's mark. Where there is none that
        all recordings share (or, for half orders, no known cycle, or the order lies between bins because it slips),
        the channel with the strongest line stands in, order by order: ``phase_from`` says what was taken.

    Returns
    -------
    OperatingShapes. A phase from a channel is that channel's lead over it. The 95 % intervals come from the scatter of
    the frames, along the mean phasor for the amplitude and across it for the phase; frames that resemble each other
    (overlap, a resonance that noise excites) count for fewer, and where they are too few the bins beside help out. Of
    several recordings they are for the mean over as many more of such recordings as one likes: their scatter counts
    where it says more. ``coherence`` is the share of the power that is locked to ``phase_from``, 0…1, relieved of what
    chance adds.

    Raises RequestError for a reference that is no channel.
    """
    grouped = like_speed_frames(frames, speed_bin_rpm=settings.speed_bin_rpm)
    names = [str(name) for name in grouped.used[0]["channel"].values]
    wanted = np.asarray(orders, dtype=np.float64)
    scale = power_of_two(grouped.spectrum)
    lines, off = _lines(grouped, wanted, scale)
    if reference is None:
        units = [str(unit) for unit in grouped.used[0]["unit"].values]
        located = phases_compare(grouped.used, wanted) & (off <= ON_BIN)
        origin = np.where(located, CRANK, _strongest(lines, scale, units))
    else:
        origin = np.full(len(wanted), place_of(reference, names))
    shape = (len(names), len(grouped.groups), len(wanted))
    estimates = {name: np.full(shape, np.nan) for name in ESTIMATES}
    for row in range(len(grouped.groups)):
        estimate = _estimate(lines, origin, off <= ON_BIN, grouped, row, _Beside(grouped, wanted, scale))
        for values, at_speed in zip(estimates.values(), estimate, strict=True):
            values[:, row] = at_speed
    for name in ("amplitude", "low", "high"):
        estimates[name] *= scale
    crank = phase_reference_of(grouped.used)
    phase_from = [crank if place == CRANK else names[place] for place in origin]
    shapes = _dataset(grouped, wanted, estimates, phase_from)
    shapes.attrs |= {"reference": reference or "", "speed_bin_rpm": settings.speed_bin_rpm}
    return with_flags(shapes, [flag for item in grouped.used for flag in flags_of(item)] + grouped.remarks)


def _lines(grouped: LikeSpeedFrames, orders: Floats, scale: Floats) -> tuple[Complexes, Floats]:
    """Complex amplitudes (channels, frames, orders) in units of ``scale``, and how many bins each is beside its bin.

    Between bins the Hann window's loss is made up for: the line may lie up to half a bin off.
    """
    axis = grouped.used[0]["order"].values
    place = orders / float(axis[1] - axis[0])
    nearest = np.clip(np.rint(place).astype(np.int64), 0, len(axis) - 1)
    off = place - nearest
    outside = (np.abs(off) > 0.5 + ON_BIN) | (orders < 0.0)
    off = np.where(outside, 0.0, off)
    lines = grouped.spectrum[:, :, nearest] / scale / (np.sinc(off) / (1.0 - off * off))
    lines[:, :, outside] = np.nan
    return lines, np.abs(off)


def _strongest(lines: Complexes, scale: Floats, units: list[str]) -> Ints:
    """Channel (orders,) of the commonest unit whose ``lines`` (channels, frames, orders) · ``scale`` are strongest."""
    common = max(units, key=units.count)
    power = np.nan_to_num(np.abs(lines * (scale / scale.max())) ** 2).sum(axis=1)
    alike = np.array([unit == common for unit in units])
    return np.asarray(np.argmax(np.where(alike[:, None], power, -1.0), axis=0))


def _estimate(
    lines: Complexes, origin: Ints, on_bin: Bools, grouped: LikeSpeedFrames, row: int, beside: _Beside
) -> tuple[Floats, ...]:
    """ESTIMATES of ``lines`` (channels, frames, orders) of one group, from the crank or from a channel's phase."""
    group = grouped.groups[row]
    lines, owner = lines[:, group], grouped.owner[group]
    measured_from = _steady(_from_channel(lines, origin), owner, on_bin, grouped.n_complex[row])
    turned = lines * _direction(np.where(origin == CRANK, 1.0, measured_from)).conj()
    kept = ~np.isnan(turned)
    count = np.count_nonzero(kept, axis=1)
    mean = np.where(kept, turned, 0.0).sum(axis=1) / np.maximum(count, 1)
    mean[count == 0] = np.nan
    amplitude = np.abs(mean)
    scatter = np.where(kept, (turned - mean[:, None]) * _direction(mean).conj()[:, None], 0.0)
    scatter = _less_the_origins_own(scatter, amplitude, origin)
    share = count / max(lines.shape[1], 1)
    n_power = grouped.n_power[row] * share
    along, across = _errors(scatter, count, owner, grouped.n_complex[row] * share)
    both, freedom = 0.5 * (along + across), np.where(np.isfinite(along), np.maximum(n_power - 1.0, 0.0), 0.0)
    parts = [(along, freedom), (across, freedom), (both, 2.0 * freedom)]
    if (n_power < FEW_FRAMES).any():
        noise, worth = beside.noise_of_mean(row, share)
        # the channel that phases are from errs in phase as well
        at = np.maximum(origin, 0)[None, :]
        power, size = (np.take_along_axis(values, at, axis=0) for values in (noise, np.nan_to_num(amplitude)))
        relative = np.divide(power, size**2, out=np.zeros_like(power), where=size > 0.0)
        of_channel = np.where(origin == CRANK, 0.0, relative)
        helped = (noise, noise + of_channel * amplitude**2, noise)
        few = n_power < FEW_FRAMES
        parts = [pooled(*own, more, worth, where=few) for own, more in zip(parts, helped, strict=True)]
    between = between_recordings(turned, owner, mean)
    seen = is_seen(amplitude, *parts[2]) & is_seen(amplitude, *wider_of(*parts[2], between.both, between, parts=2))
    low, high = amplitude_interval(amplitude, *wider_of(*parts[0], between.along, between), seen=seen)
    half_phase = phase_interval_deg(amplitude, *wider_of(*parts[1], between.across, between), seen=seen)
    coherence = _coherence(lines, mean, kept, origin, n_power)
    return amplitude, low, high, np.degrees(np.angle(mean)), half_phase, coherence


def _steady(of_channel: Complexes, owner: Ints, on_bin: Bools, n_complex: float) -> Complexes:
    """Lines ``of_channel`` (1, frames, orders), each frame's replaced by its recording's mean where that is seen.

    A line that keeps its place to the crank within a recording has one phase there. Each frame's own phase follows its
    noise as well: amplitudes from it are those of line and noise together, too large beside a natural frequency.
    """
    made = of_channel.copy()
    for number in np.unique(owner):
        own = of_channel[:, owner == number]
        kept = ~np.isnan(own)
        count = np.count_nonzero(kept, axis=1)
        mean = np.where(kept, own, 0.0).sum(axis=1) / np.maximum(count, 1)
        scatter = np.where(kept, (own - mean[:, None]) * _direction(mean).conj()[:, None], 0.0)
        n_own = n_complex * count / len(owner)
        along, across = _errors(scatter, count, np.zeros(own.shape[1], dtype=np.int64), n_own)
        spare = np.where(np.isfinite(along), 2.0 * np.maximum(n_own - 1.0, 0.0), 0.0)
        seen = on_bin & is_seen(np.abs(mean), 0.5 * (along + across), spare)
        made[:, owner == number] = np.where(kept & seen[:, None], mean[:, None], own)
    return made


def _less_the_origins_own(scatter: Complexes, amplitude: Floats, origin: Ints) -> Complexes:
    """``scatter`` (channels, frames, orders) along each mean, and across it against the channel that phases are from.

    What turns both alike turns no phase between them; the channel itself has none.
    """
    at = np.maximum(origin, 0)[None, :]
    size = np.take_along_axis(amplitude, at, axis=0)
    turned = np.divide(
        np.take_along_axis(scatter, at[:, None], axis=0).imag, size[:, None], where=size[:, None] > 0.0,
        out=np.zeros((1, *scatter.shape[1:])),
    )  # fmt: skip
    shared = np.where(origin == CRANK, 0.0, turned) * np.nan_to_num(amplitude)[:, None]
    return np.asarray(scatter.real + 1j * (scatter.imag - np.where(scatter == 0.0, 0.0, shared)))


def _from_channel(lines: Complexes, origin: Ints) -> Complexes:
    """Lines (1, frames, orders) of the channel that each order's phases are measured from."""
    return np.take_along_axis(lines, np.maximum(origin, 0)[None, None, :], axis=0)


def _direction(values: NDArray[Any]) -> Complexes:
    """``values`` of length 1, those that are 0 to the right."""
    length = np.abs(values)
    return np.asarray(np.where(length > 0.0, values / np.where(length > 0.0, length, 1.0), 1.0 + 0j * length))


def _errors(scatter: Complexes, count: Ints, owner: Ints, n_complex: Floats) -> tuple[Floats, Floats]:
    """Noise powers (channels, orders) of the mean, twice its variance along and across it.

    ``scatter`` (channels, frames, orders) is about it, ``n_complex`` is what the frames are worth for their overlap; a
    memory beyond chance (1 - r) / (1 + r) takes more.
    """
    kept = independent_by_memory(scatter, owner, count, chance="passed")
    worth = np.maximum(1.0, np.minimum(n_complex, kept))
    spare = np.where(n_complex > 1.0, count * (1.0 - 1.0 / np.maximum(n_complex, 1.0)), np.nan)
    return (2.0 * (scatter.real**2).sum(axis=1) / spare / worth, 2.0 * (scatter.imag**2).sum(axis=1) / spare / worth)


@dataclass(frozen=True)
class _Beside:
    """What the bins beside ``orders`` say of the noise, in units of ``scale``."""

    grouped: LikeSpeedFrames
    orders: Floats
    scale: Floats

    def noise_of_mean(self, row: int, share: Floats) -> tuple[Floats, Floats]:
        """Noise power (channels, orders) of the mean of group ``row`` by the bins beside, and its degrees of freedom.

        ``share`` (channels, orders) of the frames take part.
        """
        grouped, first = self.grouped, self.grouped.used[0]
        axis = first["order"].values
        bins, worth = beside_bins(axis, line_step=1.0 / int(first.attrs["revs_per_cycle"]), count=NEAREST_BINS)
        nearest = np.clip(np.rint(self.orders / float(axis[1] - axis[0])).astype(np.int64), 0, len(axis) - 1)
        spectrum = grouped.spectrum[:, grouped.groups[row]] / self.scale
        kept = np.isfinite(spectrum.real)
        total = np.square(np.abs(np.where(kept, spectrum, 0.0))).sum(axis=1)
        noise = steepest_noise_beside(total / np.maximum(np.count_nonzero(kept, axis=1), 1), bins[nearest])
        freedom = 2.0 * worth[nearest] * grouped.n_power[row] * share
        return noise / np.maximum(grouped.n_complex[row] * share, 1.0), freedom


def _coherence(lines: Complexes, mean: Complexes, kept: Bools, origin: Ints, n_power: Floats) -> Floats:
    """Share (channels, orders) of the power of ``lines`` that is locked to the crank, or to a channel."""
    filled = np.where(kept, lines, 0.0)
    power = (np.abs(filled) ** 2).sum(axis=1)
    locked = np.abs(mean) ** 2 * np.count_nonzero(kept, axis=1)
    with_crank = np.divide(locked, power, out=np.full(power.shape, np.nan), where=power > 0.0)
    spare = np.where(n_power >= LEAST_FRAMES, n_power - 1.0, np.nan)
    with_crank = np.clip((n_power * with_crank - 1.0) / spare, 0.0, 1.0)
    if (origin == CRANK).all():
        return np.asarray(with_crank)
    other = np.where(kept, np.nan_to_num(_from_channel(lines, origin)), 0.0)
    both = power * (np.abs(other) ** 2).sum(axis=1)
    cross = np.abs((filled * other.conj()).sum(axis=1)) ** 2
    estimate = np.divide(cross, both, out=np.full(power.shape, np.nan), where=both > 0.0)
    itself = np.arange(len(lines))[:, None] == origin[None, :]
    made = unbiased_coherence(estimate, n_frames=n_power)
    made = np.where(itself & np.isfinite(made), 1.0, made)
    return np.asarray(np.where(origin == CRANK, with_crank, made))


def _dataset(
    grouped: LikeSpeedFrames, orders: Floats, estimates: dict[str, Floats], phase_from: list[str]
) -> xr.Dataset:
    """OperatingShapes, without flags, from ``estimates`` (channels, speeds, orders)."""
    first = grouped.used[0]
    amplitude, low, high, phase, half, coherence = (estimates[name] for name in ESTIMATES)
    turn = np.stack([phase - half, phase + half], axis=-1)
    dims = ("channel", "speed", "order")
    count = np.array([len(group) for group in grouped.groups], dtype=np.int64)
    level = coherence_level(grouped.n_power)
    variables = (
        ("amplitude", dims, amplitude, "see unit", "peak amplitude of the mean phasor"),
        ("amplitude_ci95", (*dims, "bound"), np.stack([low, high], axis=-1), "see unit", "95 % interval of amplitude"),
        ("phase", dims, phase, "degree", "phase from phase_from"),
        ("phase_ci95", (*dims, "bound"), turn, "degree", "95 % interval of phase"),
        ("coherence", dims, coherence, "1", "share of the power that is locked to phase_from"),
        ("coherence_level", ("speed",), level, "1", "95 % level of what is not locked, before bias is taken off"),
        ("phase_from", ("order",), np.array(phase_from, dtype=object), "1", "mark or channel that phases are from"),
        ("n_frames", ("speed",), count, "1", "frames"),
        ("n_independent", ("speed",), grouped.n_power, "1", "independent frames"),
    )
    shapes = xr.Dataset(
        {name: described(over, values, units, text) for name, over, values, units, text in variables},
        coords={
            **channel_coords(first),
            "order": ("order", orders, {"units": "1", "long_name": "order", "order_reference": "crankshaft"}),
            "speed": described("speed", grouped.speed_rpm, "min-1", "speed"),
        },
    )
    kept = ("window", "revs_per_frame", "overlap", "amplitude_scaling", "cycle_known", "phase_reference")
    shapes.attrs = {key: first.attrs[key] for key in kept}
    shapes.attrs["phase_reference"] = phase_reference_of(grouped.used)
    return shapes
