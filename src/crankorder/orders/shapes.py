"""Operating shapes: how every measured point moves at an order, in amplitude and phase, speed by speed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import xarray as xr

from crankorder.errors import RequestError
from crankorder.orders.averages import FEW_CONTRASTS
from crankorder.orders.intervals import is_seen, phase_reference_of, phases_compare
from crankorder.orders.like_speed import Frames, LikeSpeedFrames, like_speed_frames
from crankorder.orders.map import Average, average_of, averaged, intervals_of
from crankorder.orders.true_angle import UNKNOWN_DEG
from crankorder.quantities import Floats, Ints, channel_coords, described, flags_of, with_flags
from crankorder.settings import OrderSettings

LEAST_FRAMES = 2.0
"""Independent frames below which a coherence says nothing: that of one frame is 1 whatever the signals."""

GRID, TERMS = 257, 400
"""Coherences for which the expected estimate is tabulated, and terms of its series: right to 1e-5."""

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

    ``n_frames`` (any shape, which the result has) is the number of independent frames; NaN below two. Source: Carter
    1973, from Goodman's distribution: of independent Gaussian signals it exceeds x with the probability (1 -
    x)^(n_frames - 1).
    """
    n = np.asarray(n_frames, dtype=np.float64)
    enough = n >= LEAST_FRAMES
    return np.where(enough, -np.expm1(np.log1p(-0.95) / np.where(enough, n - 1.0, 1.0)), np.nan)


def expected_coherence(coherence: Floats, *, n_frames: float) -> Floats:
    """Mean of the estimated magnitude-squared coherence from few frames: 1 / n_frames where the true one is 0.

    ``coherence`` is the true one, 0 to 1, of any shape, which the result has; ``n_frames`` is the number of independent
    frames, at least 2. Source: Carter, Knapp and Nuttall 1973, 1 / n + (n - 1) / (n + 1) x 2F1(1, 1; n + 2; x).
    """
    true = np.asarray(coherence, dtype=np.float64)
    index = np.arange(1.0, TERMS)
    terms = np.concatenate([[1.0], np.cumprod(index / (n_frames + 1.0 + index))])
    series = np.polynomial.polynomial.polyval(true, terms)
    return np.asarray(1.0 / n_frames + (n_frames - 1.0) / (n_frames + 1.0) * true * series)


def unbiased_coherence(estimate: Floats, *, n_frames: Floats) -> Floats:
    """Coherence whose expected estimate is the one found: 0 to 1, 0 where chance explains it; NaN below two frames.

    ``estimate`` is the magnitude-squared coherence, of any shape; ``n_frames`` the number of independent frames, of a
    shape that broadcasts with it. The result has the joint shape; it inverts :func:`expected_coherence`.
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
    frames : OrderFrames (channel, frame, order) of the recordings; those of another length than most are left out
    orders : orders wanted, cycles per crank revolution; above the frames' highest they are NaN. Give those that were
        found: from a channel, noise that all channels share, such as that of a mode, has a shape as well
    settings : of orders; ``speed_bin_rpm`` is the width of a group of frames
    reference : name of the channel that phases are measured from; None for the crank's mark. Where there is none that
        all recordings share (or, for half orders, no known cycle, or the order lies between bins because it slips),
        the channel with the strongest line stands in, order by order: ``phase_from`` says what was taken.

    Returns
    -------
    OperatingShapes. A phase from a channel is that channel's lead over it. Amplitudes, phases from the crank and their
    95 % intervals are those of the order map; phases from a channel are told from frames that are turned by its phase.
    ``coherence`` is the share of the power that is locked to ``phase_from``, 0…1, relieved of what chance adds.

    Raises RequestError for a reference that is no channel.
    """
    grouped = like_speed_frames(frames, speed_bin_rpm=settings.speed_bin_rpm)
    first = grouped.used[0]
    names, axis = [str(name) for name in first["channel"].values], first["order"].values
    wanted = np.asarray(orders, dtype=np.float64)
    place = wanted / float(axis[1] - axis[0])
    nearest = np.clip(np.rint(place).astype(np.int64), 0, len(axis) - 1)
    off = place - nearest
    on_bin, held = np.abs(off) <= ON_BIN, (np.abs(off) <= 0.5 + ON_BIN) & (wanted >= 0.0)
    if reference is None:
        located = phases_compare(grouped.used, wanted) & on_bin
        origin = np.where(located, CRANK, _strongest(grouped, nearest))
    else:
        origin = np.full(len(wanted), place_of(reference, names))
    estimates = np.full((len(ESTIMATES), len(names), len(grouped.groups), len(wanted)), np.nan)
    for number, on in np.unique(np.stack([origin, on_bin])[:, held], axis=1).T.tolist():
        at = np.flatnonzero(held & (origin == number) & (on_bin == on))
        columns, by_crank = nearest[at], number == CRANK
        told = _by_crank(grouped, columns) if by_crank else _by_channel(grouped, columns, number, on_bin=bool(on))
        estimates[..., at] = told
    # between bins the Hann window's loss is made up for: the line may lie up to half a bin off
    between = np.where(held & ~on_bin, off, 0.0)
    estimates[:3] /= np.sinc(between) / (1.0 - between * between)
    crank = phase_reference_of(grouped.used)
    phase_from = [crank if place == CRANK else names[place] for place in origin]
    shapes = _dataset(grouped, wanted, estimates, phase_from)
    shapes.attrs |= {"reference": reference or "", "speed_bin_rpm": settings.speed_bin_rpm}
    return with_flags(shapes, [flag for item in grouped.used for flag in flags_of(item)] + grouped.remarks)


def _strongest(grouped: LikeSpeedFrames, columns: Ints) -> Ints:
    """Channel (columns,) of the commonest unit whose frames at the orders numbered ``columns`` are strongest."""
    units = [str(unit) for unit in grouped.used[0]["unit"].values]
    sizes = np.concatenate([np.abs(spectrum[:, :, columns]) for spectrum in grouped.every.spectra], axis=1)
    power = np.square(np.nan_to_num(sizes / np.nanmax(sizes, initial=1e-300))).sum(axis=1)
    alike = np.array([unit == max(units, key=units.count) for unit in units])
    return np.asarray(np.argmax(np.where(alike[:, None], power, -1.0), axis=0))


def _by_crank(grouped: LikeSpeedFrames, columns: Ints) -> Floats:
    """ESTIMATES (…, channels, speeds, columns) at the orders numbered ``columns``, with phases from the crank."""
    whole = averaged(grouped)
    power, none = np.square(np.abs(whole.coherent)), np.full(whole.energy.shape, np.nan)
    share = np.divide(power, whole.energy, out=none, where=whole.energy > 0.0)
    spare = np.where(whole.powers >= LEAST_FRAMES, whole.powers - 1.0, np.nan)
    coherence = np.clip((whole.powers * share - 1.0) / spare, 0.0, 1.0)
    return _estimates(whole, intervals_of(whole, grouped), grouped.every.unit, coherence)[..., columns]


def _by_channel(grouped: LikeSpeedFrames, columns: Ints, origin: int, *, on_bin: bool) -> Floats:
    """ESTIMATES as of :func:`_by_crank`, with phases from those of the channel number ``origin``.

    Where lines lie ``on_bin`` the phase of the channel's mean over a recording is taken, where that is seen: a line
    that keeps its place to the crank has one phase there. Each frame's own phase follows its noise as well, and
    amplitudes from it are those of line and noise together.
    """
    kept, at = np.unique(np.concatenate([columns, grouped.framing.beside[columns].ravel()]), return_inverse=True)
    part, at = grouped.at_columns(kept), at[: len(columns)]

    def turned(frames: Frames) -> Frames:
        line = frames.spectrum[origin].copy()
        for number in np.unique(frames.owner) if on_bin else ():
            own = frames.owner == number
            alone = frames.of(own)._replace(spectrum=line[None, own])
            mean = average_of(alone, part.framing)
            seen = is_seen(np.abs(mean.coherent), mean.noise * mean.left, 2.0 * mean.own)
            line[own] = np.where(np.isfinite(line[own]) & seen, mean.coherent, line[own])
        size = np.abs(line)
        with np.errstate(invalid="ignore"):  # NaN stays
            unit = np.divide(line, size, out=np.ones_like(line), where=size != 0.0)
        return frames._replace(spectrum=frames.spectrum * unit.conj())

    def from_origin(frames: Frames) -> Frames:
        """What turns a channel and the origin alike turns no phase between them."""
        spectrum = turned(frames).spectrum
        mean = np.where(np.isnan(spectrum), 0.0, spectrum).sum(axis=1) / np.isfinite(spectrum).sum(axis=1).clip(1)
        wander = spectrum[origin] - mean[origin]
        with np.errstate(invalid="ignore"):
            relative = np.divide(wander, mean[origin], out=np.zeros_like(wander), where=np.abs(mean[origin]) > 0.0)
        return frames._replace(spectrum=spectrum - mean[:, None] * relative)

    whole, between = averaged(part, turned), averaged(part, from_origin)
    values, phases = (intervals_of(each, part, by_crank=False) for each in (whole, between))
    half, own = phases["phase_ci95"], values["phase_ci95"]
    # frames too few to show how the origin wanders: the noise of both channels turns the phase
    few = (whole.own < FEW_CONTRASTS) & (half < UNKNOWN_DEG)
    half = np.where(few, np.minimum(np.hypot(half, own[origin]), UNKNOWN_DEG), half)
    half[origin] = 0.0
    frames = map(part.every.of, part.groups)
    coherence = unbiased_coherence(np.stack([_coherence(row, origin) for row in frames], axis=1), n_frames=whole.powers)
    coherence[origin] = np.where(np.isfinite(coherence[origin]), 1.0, np.nan)
    return _estimates(whole, values | {"phase_ci95": half}, part.every.unit, coherence)[..., at]


def _estimates(whole: Average, intervals: dict[str, Floats], unit: Floats, coherence: Floats) -> Floats:
    """ESTIMATES (…, channels, speeds, orders) of the averages ``whole`` with their ``intervals``."""
    ends = intervals["coherent_amplitude_low"], intervals["coherent_amplitude_high"]
    phase = np.degrees(np.angle(whole.coherent))
    return np.array([unit * np.abs(whole.coherent), *ends, phase, intervals["phase_ci95"], coherence])


def _coherence(frames: Frames, origin: int) -> Floats:
    """Estimated coherence (channels, orders) of ``frames`` with the channel number ``origin``."""
    spectrum = frames.spectrum
    both = np.isfinite(spectrum) & np.isfinite(spectrum[origin])
    own, other = np.where(both, spectrum, 0.0), np.where(both, spectrum[origin], 0.0)
    power = np.square(np.abs(own)).sum(axis=1) * np.square(np.abs(other)).sum(axis=1)
    cross = np.square(np.abs((own * other.conj()).sum(axis=1)))
    return np.asarray(np.divide(cross, power, out=np.full(power.shape, np.nan), where=power > 0.0))


def _dataset(grouped: LikeSpeedFrames, orders: Floats, estimates: Floats, phase_from: list[str]) -> xr.Dataset:
    """OperatingShapes, without flags, from ``estimates`` (…, channels, speeds, orders)."""
    first = grouped.used[0]
    amplitude, low, high, phase, half, coherence = estimates
    turn = np.stack([phase - half, phase + half], axis=-1)
    dims = ("channel", "speed", "order")
    count = np.array([len(group) for group in grouped.groups], dtype=np.int64)
    contrasts = [grouped.framing.contrasts_of(grouped.every.of(group)) for group in grouped.groups]
    independent = np.array([each.independent_powers for each in contrasts])
    level = coherence_level(independent)
    variables = (
        ("amplitude", dims, amplitude, "see unit", "peak amplitude of the mean phasor"),
        ("amplitude_ci95", (*dims, "bound"), np.stack([low, high], axis=-1), "see unit", "95 % interval of amplitude"),
        ("phase", dims, phase, "degree", "phase from phase_from"),
        ("phase_ci95", (*dims, "bound"), turn, "degree", "95 % interval of phase"),
        ("coherence", dims, coherence, "1", "share of the power that is locked to phase_from"),
        ("coherence_level", ("speed",), level, "1", "95 % level of what is not locked, before bias is taken off"),
        ("phase_from", ("order",), np.array(phase_from, dtype=object), "1", "mark or channel that phases are from"),
        ("n_frames", ("speed",), count, "1", "frames"),
        ("n_independent", ("speed",), independent, "1", "independent frames"),
    )
    words = {"units": "1", "long_name": "order", "order_reference": "crankshaft"}
    axes = {"order": ("order", orders, words), "speed": described("speed", grouped.speed_rpm, "min-1", "speed")}
    made = {name: described(over, values, units, text) for name, over, values, units, text in variables}
    shapes = xr.Dataset(made, coords=channel_coords(first) | axes)
    kept = ("window", "revs_per_frame", "overlap", "amplitude_scaling", "cycle_known", "phase_reference")
    shapes.attrs = {key: first.attrs[key] for key in kept}
    shapes.attrs["phase_reference"] = phase_reference_of(grouped.used)
    return shapes
