"""Joint least squares on named orders: orders that are close, that cross, that belong to several shafts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numba import njit
from numpy.typing import NDArray

from crankorder.errors import InputError, RequestError
from crankorder.orders.intervals import amplitude_interval, phase_interval_deg
from crankorder.quantities import Bools, Complexes, Floats, Ints, QualityFlag, channel_coords, flags_of, with_flags
from crankorder.settings import OrderSettings
from crankorder.shaft.angle import angle_at, knots_of, speed_at_angle, time_at

BLOCKS = 64
"""Blocks of a record whose products are kept: they give the residual's spectrum up to a few cycles from each order."""

NEAR_CYCLES = (1, 2, 3, 4)
"""Cycles per record from an order, on both sides, at which the residual tells the noise at the order."""

NORMAL_CONDITION = 300.0
"""Condition up to which normal equations are right to 1e-11 of the amplitude; beyond, orthogonal ones are solved."""

LARGEST_CONDITION = 1e9
"""Condition from which components are not told apart: what noise-free numbers of 1e-16 cannot carry to 1e-6."""

Spans = tuple[Floats, Floats]
"""Crank angles [rev] at which frames begin and end."""

_VARIABLES = (
    ("amplitude", "see unit", "complex peak amplitude about top dead centre"),
    ("combined_amplitude", "see unit", "sum of the orders that cannot be told apart"),
    ("standard_error", "see unit", "standard error of the magnitude of amplitude"),
    ("degrees_of_freedom", "1", "degrees of freedom of standard_error"),
    ("amplitude_low", "see unit", "lower end of the 95 % interval of the magnitude"),
    ("amplitude_high", "see unit", "upper end of the 95 % interval of the magnitude"),
    ("phase_ci95", "degree", "half width of the 95 % interval of the phase; 180: unknown"),
)


@dataclass(frozen=True)
class JointOrders:
    """Amplitudes of components fitted together, and how well they are known.

    ``amplitude`` (channels, components) complex peak about each component's phase, the mean over the record; NaN for
    components that cannot be told apart: these are in ``together``, tuples of their numbers, and
    ``combined_amplitude`` (channels, components) holds the sum of each such group, for others ``amplitude`` again.
    ``standard_error`` (channels, components) is that of the real part, the imaginary part and the magnitude of
    ``amplitude``, with ``degrees_of_freedom`` (components,) behind it; ``condition`` that of the scaled equations.
    """

    amplitude: Complexes
    combined_amplitude: Complexes
    standard_error: Floats
    degrees_of_freedom: Floats
    condition: float
    together: tuple[tuple[int, ...], ...]

    def intervals(self) -> tuple[Floats, Floats, Floats]:
        """Ends of the 95 % intervals of the magnitudes, and half widths [degree] of those of the phases."""
        magnitude, power = np.abs(self.amplitude), 2.0 * self.standard_error**2
        dof = np.broadcast_to(self.degrees_of_freedom, magnitude.shape)
        low, high = amplitude_interval(magnitude, power, dof)
        return low, high, phase_interval_deg(magnitude, power, dof)


def joint_orders(
    signals: NDArray[np.floating], phase_rev: Floats, *, weights: Floats | None = None, usable: Bools | None = None
) -> JointOrders:
    """Complex amplitudes of components of known phases, fitted to ``signals`` together, with their standard errors.

    The real form (a cosine and a sine each) has no image at the negative frequency. Normal equations of unit columns
    are solved where these are well conditioned, orthogonal ones (QR by blocks) where not. The noise at an order comes
    from the residual's spectrum beside it, freed of what the fit takes out; it need not be white.

    Parameters
    ----------
    signals : (channels, samples), float32 or float64; numbers from 1e-300 to 1e300
    phase_rev : (components, samples), rev: order times crank angle of whichever shaft, increasing or not
    weights : (samples,), 0 or more, of the squared errors; None for equal ones, which white noise asks for
    usable : (channels, samples), False where a sample takes no part; None where all do

    Raises
    ------
    RequestError where there are fewer usable samples than unknowns. Source: Golub and Van Loan 2013, ch. 5.
    """
    signals = np.atleast_2d(signals)
    phases = np.atleast_2d(np.asarray(phase_rev, dtype=np.float64))
    if signals.shape[1] != phases.shape[1]:
        raise RequestError(
            "signals and phases differ in length", found=f"{signals.shape[1]} and {phases.shape[1]} samples"
        )
    if usable is None or usable.all():
        return _fitted(signals, phases, weights)
    weight = np.ones(signals.shape[1]) if weights is None else weights
    parts = [_fitted(signals[k : k + 1], phases, weight * usable[k]) for k in range(len(signals))]
    worst = max(parts, key=lambda part: part.condition)
    return replace(
        worst,
        amplitude=np.concatenate([part.amplitude for part in parts]),
        combined_amplitude=np.concatenate([part.combined_amplitude for part in parts]),
        standard_error=np.concatenate([part.standard_error for part in parts]),
        degrees_of_freedom=np.min([part.degrees_of_freedom for part in parts], axis=0),
    )


@dataclass(frozen=True)
class _Products:
    """Sums over each block: of columns with columns, (blocks, unknowns, unknowns), once and twice weighted; of
    columns with signals (blocks, unknowns, channels)."""

    own: Floats
    noise: Floats
    seen: Floats
    total_weight: float


def _fitted(signals: NDArray[np.floating], phases: Floats, weights: Floats | None) -> JointOrders:
    unknowns = 2 * len(phases)
    samples = signals.shape[1] if weights is None else int(np.count_nonzero(weights))
    if samples < unknowns:
        raise RequestError(
            "fewer usable samples than unknowns", found=f"{samples} samples", allowed=f"at least {unknowns}"
        )
    exponent = _exponents(signals)
    edges = np.linspace(0, signals.shape[1], min(BLOCKS, signals.shape[1]) + 1).astype(int)
    sums = _products(signals, phases, weights, edges, exponent)
    gram = sums.own.sum(axis=0)
    length = np.sqrt(np.diag(gram))
    length = np.where(length > 1e-12 * np.sqrt(sums.total_weight), length, np.inf)  # a sine at order 0 is no column
    scaled = gram / np.outer(length, length)
    alive = np.isfinite(length)
    singular = np.sqrt(np.maximum(np.linalg.eigvalsh(scaled[np.ix_(alive, alive)]), 0.0))
    condition = float(singular[-1] / singular[0]) if singular[0] > 0.0 else np.inf
    if condition <= NORMAL_CONDITION:
        inverse = np.zeros_like(scaled)
        inverse[np.ix_(alive, alive)] = np.linalg.inv(scaled[np.ix_(alive, alive)])
        right = sums.seen.sum(axis=0) / length[:, None]
        solved = inverse @ right
        solved += inverse @ (right - scaled @ solved)
        linked = np.zeros((unknowns, 0))
    else:
        triangle, right = _triangle(signals, phases, weights, edges, exponent, length)
        solved, inverse, linked, condition = _by_rank(triangle, right, alive)
    together, members = _groups(linked, len(phases))
    found = solved / length[:, None]
    error, dof = _errors(sums, found, inverse / np.outer(length, length), len(phases))
    unit = np.ldexp(1.0, exponent)[:, None]
    amplitude = (found[0::2] - 1j * found[1::2]).T * unit
    combined = amplitude.copy()
    for group in together:
        combined[:, group] = amplitude[:, group].sum(axis=1, keepdims=True)
    shown = np.where(members, np.nan, 1.0)
    return JointOrders(amplitude * shown, combined, error * unit * shown, dof, condition, together)


def _exponents(signals: NDArray[np.floating]) -> Ints:
    """Exponent (channels,) of the power of two that is taken out of each channel; 0 in the ordinary range."""
    largest = np.maximum(signals.max(axis=1), -signals.min(axis=1)).astype(np.float64)
    exponent = np.where(largest > 0.0, np.frexp(largest)[1], 0)
    return np.asarray(np.where(np.abs(exponent) > 64, exponent, 0), dtype=np.int64)


def _columns(phases: Floats, weights: Floats | None, block: slice) -> tuple[Floats, Floats | None]:
    """Columns (unknowns, samples) of a block: cosine and sine of each component."""
    wave = np.empty((len(phases), 2, block.stop - block.start))
    _waves(np.ascontiguousarray(phases[:, block]), wave)
    return wave.reshape(-1, block.stop - block.start), None if weights is None else weights[block]


@njit(cache=True, nogil=True, error_model="numpy")
def _waves(phase_rev, wave):  # type: ignore[no-untyped-def]
    """Cosine and sine of phases [rev] into ``wave`` (components, 2, samples), to round-off (Cephes polynomials)."""
    for component in range(phase_rev.shape[0]):
        phase, cosine, sine = phase_rev[component], wave[component, 0], wave[component, 1]
        for i in range(phase.size):
            turn = phase[i] - np.rint(phase[i])
            quarter = np.rint(4.0 * turn)
            x = (turn - 0.25 * quarter) * 6.283185307179586
            z = x * x
            s = 1.58962301576546568060e-10 * z - 2.50507477628578072866e-8
            s = ((s * z + 2.75573136213857245213e-6) * z - 1.98412698295895385996e-4) * z
            s = x + x * z * ((s + 8.33333333332211858878e-3) * z - 1.66666666666666307295e-1)
            c = -1.13585365213876817300e-11 * z + 2.08757008419747316778e-9
            c = ((c * z - 2.75573141792967388112e-7) * z + 2.48015872888517045348e-5) * z
            c = 1.0 - 0.5 * z + z * z * ((c - 1.38888888888730564116e-3) * z + 4.16666666666665929218e-2)
            odd = quarter == 1.0 or quarter == -1.0
            a, b = (s, c) if odd else (c, s)
            cosine[i] = -a if (quarter == 1.0 or abs(quarter) == 2.0) else a
            sine[i] = -b if (quarter == -1.0 or abs(quarter) == 2.0) else b


def _products(
    signals: NDArray[np.floating], phases: Floats, weights: Floats | None, edges: Ints, exponent: Ints
) -> _Products:
    """Sums of products over the blocks between ``edges``; the record is gone through once."""
    unknowns, n = 2 * len(phases), len(edges) - 1
    own, seen = np.empty((n, unknowns, unknowns)), np.empty((n, unknowns, len(signals)))
    noise = own if weights is None else np.empty_like(own)
    for k in range(n):
        block = slice(int(edges[k]), int(edges[k + 1]))
        columns, weight = _columns(phases, weights, block)
        values = np.ldexp(signals[:, block].astype(np.float64), -exponent[:, None])
        weighted = columns if weight is None else columns * weight
        own[k] = weighted @ columns.T
        if weight is not None:
            noise[k] = weighted @ weighted.T
            values = np.where(weight > 0.0, values, 0.0)
        seen[k] = weighted @ values.T
    return _Products(own, noise, seen, float(signals.shape[1] if weights is None else weights.sum()))


def _triangle(
    signals: NDArray[np.floating], phases: Floats, weights: Floats | None, edges: Ints, exponent: Ints, length: Floats
) -> tuple[Floats, Floats]:
    """Triangle (unknowns, unknowns) of the QR decomposition of the scaled columns, and the signals turned with them."""
    unknowns = len(length)
    top = np.zeros((0, unknowns + len(signals)))
    for k in range(len(edges) - 1):
        block = slice(int(edges[k]), int(edges[k + 1]))
        columns, weight = _columns(phases, weights, block)
        values = np.ldexp(signals[:, block].astype(np.float64), -exponent[:, None])
        rows = np.concatenate([columns / length[:, None], values]).T
        if weight is not None:
            rows = np.where(weight[:, None] > 0.0, rows, 0.0) * np.sqrt(weight)[:, None]
        top = np.asarray(np.linalg.qr(np.concatenate([top, rows]), mode="r"))
    return top[:unknowns, :unknowns], top[:unknowns, unknowns:]


def _by_rank(triangle: Floats, right: Floats, alive: Bools) -> tuple[Floats, Floats, Floats, float]:
    """Shortest solution, its covariance, the directions (unknowns, several) that are not told, and the condition."""
    left, singular, across = np.linalg.svd(triangle)
    rank = int(np.count_nonzero(singular > singular[0] / LARGEST_CONDITION))
    inverse = across[:rank].T / singular[:rank]
    solved = inverse @ (left[:, :rank].T @ right)
    last = singular[int(np.count_nonzero(alive)) - 1]
    condition = float(singular[0] / last) if last > 0.0 else np.inf
    untold = across[rank:].T
    return solved, inverse @ inverse.T, untold[:, np.abs(untold[alive]).max(axis=0, initial=0.0) > 1e-6], condition


def _groups(linked: Floats, n_components: int) -> tuple[tuple[tuple[int, ...], ...], Bools]:
    """Components that share a direction that is not told, as groups, and a mask (components,) of all in one."""
    share = np.square(linked).reshape(n_components, -1, linked.shape[1]).sum(axis=1) if linked.size else None
    if share is None:
        return (), np.zeros(n_components, dtype=bool)
    strength = np.square(linked @ linked.T).reshape(n_components, -1, n_components, linked.shape[0] // n_components)
    joined = strength.sum(axis=(1, 3)) > 1e-6
    members = np.diag(joined).copy()
    groups: list[set[int]] = []
    for component in np.flatnonzero(members):
        group = set(np.flatnonzero(joined[component]).tolist())
        touching = [other for other in groups if other & group]
        groups = [other for other in groups if not other & group] + [group.union(*touching)]
    return tuple(tuple(sorted(group)) for group in sorted(groups, key=min)), members


def _errors(sums: _Products, found: Floats, inverse: Floats, n_components: int) -> tuple[Floats, Floats]:
    """Standard error (channels, components) and its degrees of freedom (components,).

    The residual is compared with each component's wave, turned by a few cycles over the record either way; what white
    noise would leave there after the fit is known, so the noise follows at the component.
    """
    n_blocks = len(sums.own)
    left = sums.seen - sums.own @ found
    error, dof = np.zeros((n_components, found.shape[1])), np.zeros(n_components)
    if n_blocks < 4 * max(NEAR_CYCLES):
        return np.full((found.shape[1], n_components), np.nan), dof
    turns = np.multiply.outer((*NEAR_CYCLES, *(-j for j in NEAR_CYCLES)), np.arange(n_blocks) + 0.5) / n_blocks
    spread = inverse @ sums.noise.sum(axis=0) @ inverse
    for component in range(n_components):
        cosine = 2 * component
        waves, tops = _turned(np.exp(2j * np.pi * turns), sums, cosine)
        fit = tops[0] @ inverse
        rest = tops[2] - fit @ tops[1].T - tops[1] @ fit.T + fit @ sums.noise.sum(axis=0) @ fit.T
        # what the fit of close components takes out whole says nothing of the noise
        values, vectors = np.linalg.eigh(rest)
        told = values > 0.05 * values[-1]
        seen = vectors[:, told].T @ np.einsum("jbs,bsc->jc", waves, left[:, cosine : cosine + 2])
        noise = np.mean(np.square(seen) / values[told, None], axis=0)
        error[component] = np.sqrt(noise * 0.5 * (spread[cosine, cosine] + spread[cosine + 1, cosine + 1]))
        dof[component] = float(np.count_nonzero(told))
    return error.T, dof


def _turned(turn: Complexes, sums: _Products, cosine: int) -> tuple[Floats, tuple[Floats, Floats, Floats]]:
    """Waves (waves, blocks, 2) in the component's cosine and sine, and their products with columns and themselves.

    cos(wave + turn) is cos(turn) cosine - sin(turn) sine of the component, sin(wave + turn) its quadrature.
    """
    real = np.stack([turn.real, -turn.imag], axis=2)
    imaginary = np.stack([turn.imag, turn.real], axis=2)
    waves = np.concatenate([real, imaginary])
    two = slice(cosine, cosine + 2)
    with_columns = np.einsum("jbs,bsu->ju", waves, sums.own[:, two])
    weighted = with_columns if sums.noise is sums.own else np.einsum("jbs,bsu->ju", waves, sums.noise[:, two])
    themselves = np.einsum("jbs,bst,kbt->jk", waves, sums.noise[:, two, two], waves, optimize=True)
    return waves, (with_columns, weighted, themselves)


def tracked_orders(
    band: xr.Dataset, shaft: xr.Dataset, orders: Sequence[float], *, settings: OrderSettings
) -> xr.Dataset:
    """Complex amplitude (channel, order, frame) of named orders of a recording, with 95 % intervals.

    Frames take in all whole cycles that were recorded, so that nothing is lost; where the speed changes they overlap as
    those of the order map do. The noise beside each order gives the standard error. Orders that cannot be told apart
    are NaN, and the sum of the group stands in ``combined_amplitude``; orders beyond half the sample rate are NaN too.

    Parameters
    ----------
    band : BandRecording, by time or by crank angle; samples that its ``usable`` denies take no part
    shaft : its ShaftAngle
    orders : cycles per crank revolution, above 0; give close ones together
    settings : ``revs_per_frame`` is the least length of a frame, rounded down to whole cycles; ``overlap``

    Raises
    ------
    RequestError for no order or one not above 0; InputError where not even one cycle was recorded.
    """
    named = np.asarray(orders, dtype=np.float64)
    if named.size == 0 or not (named > 0.0).all():
        raise RequestError("orders to track must be above 0", found=str(list(orders)), allowed="one or more")
    angles = _angle_of_samples(band, shaft)
    spans = frame_spans(angles, band, shaft, settings)
    known = np.flatnonzero(np.isfinite(angles))
    part = slice(int(known[0]), int(known[-1]) + 1)
    fits = [_fit(band, angles, part, named, begin, end) for begin, end in zip(*spans, strict=True)]
    return _dataset(band, shaft, named, spans, fits)


def frame_spans(angle_rev: Floats, band: xr.Dataset, shaft: xr.Dataset, settings: OrderSettings) -> Spans:
    """Frames of whole cycles, of ``settings.revs_per_frame`` or a little more each: where they begin and end [rev].

    They take in all whole cycles of ``angle_rev`` (samples,), that of the samples of ``band`` by its ``shaft``. Where
    the speed changes by more than ``settings.speed_bin_rpm`` they overlap by about ``settings.overlap``, so that as
    many speeds are read as by the order map. Raises InputError where there is not even one cycle.
    """
    cycle = int(shaft.attrs["revs_per_cycle"])
    known = angle_rev[np.isfinite(angle_rev)]
    first = known[0] if known.size else 0.0
    cycles = math.floor((known[-1] - first + 1e-9) / cycle) if known.size else 0
    if cycles < 1:
        raise InputError(
            "the recording holds less than one engine cycle", file=band.attrs["recording"], allowed=f"at least {cycle}"
        )
    count = max(1, cycles // max(1, settings.revs_per_frame // cycle))
    edges = np.asarray(first + cycle * np.round(np.linspace(0, cycles, count + 1)), dtype=np.float64)
    speed = _speed_and_time(shaft, (edges[:-1], edges[1:]))[0]
    if not np.ptp(speed) > settings.speed_bin_rpm:  # nor where it is not known
        return edges[:-1], edges[1:]
    parts = max(1, min(cycles // count, round(1.0 / (1.0 - settings.overlap))))
    edges = np.asarray(first + cycle * np.round(np.linspace(0, cycles, count * parts + 1)), dtype=np.float64)
    return edges[:-parts], edges[parts:]


def _angle_of_samples(band: xr.Dataset, shaft: xr.Dataset) -> Floats:
    """Crank angle [rev] of every sample, NaN where it is not known."""
    n = band["signal"].shape[1]
    if band.attrs["domain"] == "crank_angle":
        return np.asarray(float(shaft["crank_angle"].values[0]) + np.arange(n) / float(band.attrs["samples_per_rev"]))
    time_s = float(band.attrs.get("start_s", 0.0)) + np.arange(n) / float(band.attrs["rate_hz"])
    return angle_at(time_s, **knots_of(shaft))


def _fit(
    band: xr.Dataset, angles: Floats, part: slice, orders: Floats, begin: float, end: float
) -> tuple[Ints, list[JointOrders | None]]:
    """Numbers of the orders carried in the frame from ``begin`` to ``end`` [rev], and the fit of each channel.

    ``part`` are the samples whose angle is known. The fit is None where too little is usable. Every sample weighs as
    much crank angle as it stands for, cut off at the ends of the frame: whole cycles then hold nothing of the orders
    that are not named.
    """
    first, last = part.start + np.searchsorted(angles[part], (begin - 0.01, end + 0.01))
    inside = slice(int(first), int(last))
    step = np.gradient(angles[inside])
    low = np.clip(angles[inside] - 0.5 * step, begin, end)
    weight = np.clip(angles[inside] + 0.5 * step, begin, end) - low
    weight /= weight.max()
    signals = band["signal"].values[:, inside]
    highest = 0.5 / float(np.median(step))
    carried = np.flatnonzero(orders < highest)
    if not len(carried):
        return carried, [None] * band.sizes["channel"]
    phases = np.outer(orders[carried], angles[inside] - begin)
    usable = np.isfinite(signals)
    if "usable" in band:
        usable &= band["usable"].values[:, inside]
    if usable.all():
        whole = joint_orders(signals, phases, weights=weight)
        return carried, [_channel(whole, k) for k in range(len(signals))]
    fits: list[JointOrders | None] = []
    for values, mask in zip(signals, usable, strict=True):
        enough = mask.mean() > 0.5
        given = np.where(mask, values, 0.0)[None]
        fits.append(joint_orders(given, phases, weights=weight, usable=mask[None]) if enough else None)
    return carried, fits


def _channel(whole: JointOrders, k: int) -> JointOrders:
    one = slice(k, k + 1)
    return replace(
        whole,
        amplitude=whole.amplitude[one],
        combined_amplitude=whole.combined_amplitude[one],
        standard_error=whole.standard_error[one],
    )


def _dataset(
    band: xr.Dataset, shaft: xr.Dataset, orders: Floats, spans: Spans, fits: list[tuple[Ints, list[JointOrders | None]]]
) -> xr.Dataset:
    shape = (band.sizes["channel"], len(orders), len(fits))
    amplitude, combined = np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan, dtype=complex)
    error, dof = np.full(shape, np.nan), np.zeros(shape)
    condition = np.full((shape[0], shape[2]), np.nan)
    groups: set[tuple[float, ...]] = set()
    for frame, (carried, channels) in enumerate(fits):
        # phases count from angle 0, not the frame's begin
        turned = np.exp(-2j * np.pi * (orders[carried] * spans[0][frame] % 1.0))
        for k, fit in enumerate(channels):
            if fit is None:
                continue
            amplitude[k, carried, frame] = fit.amplitude[0] * turned
            combined[k, carried, frame] = fit.combined_amplitude[0] * turned
            error[k, carried, frame], dof[k, carried, frame] = fit.standard_error[0], fit.degrees_of_freedom
            condition[k, frame] = fit.condition
            groups |= {tuple(float(orders[carried[c]]) for c in group) for group in fit.together}
    values = {
        "amplitude": amplitude,
        "combined_amplitude": combined,
        "standard_error": error,
        "degrees_of_freedom": dof,
    }
    made = tracks_in_frames(band, shaft, orders, spans, values, method="least_squares")
    made["condition"] = (("channel", "frame"), condition, {"units": "1", "long_name": "condition of the equations"})
    seen = {int(k) for carried, _ in fits for k in carried}
    beyond = [float(order) for k, order in enumerate(orders) if k not in seen]
    remarks = _remarks(beyond, float(np.min(spans[1] - spans[0])), groups)
    return with_flags(made, flags_of(shaft) + not_tracked_flags(str(band.attrs["recording"]), remarks))


def not_tracked_flags(recording: str, remarks: Sequence[str]) -> list[QualityFlag]:
    """Flags that say of orders of ``recording`` why they were not tracked, one for each of ``remarks``."""
    return [
        {"recording": recording, "flag": "order_not_tracked", "severity": "suspect", "detail": text} for text in remarks
    ]


def beyond_remark(order: float) -> str:
    """What is said of an ``order`` that no frame carries."""
    return f"order {order:g} is beyond half the sample rate"


def _remarks(beyond: list[float], shortest_rev: float, groups: set[tuple[float, ...]]) -> list[str]:
    """What is to be said of ``groups`` that cannot be told apart and of orders ``beyond`` what frames carry."""
    remarks = [
        f"orders {' and '.join(f'{order:g}' for order in group)} cannot be told apart in frames of "
        f"{shortest_rev:g} revolutions: only their sum is known"
        for group in sorted(groups)
    ]
    return remarks + [beyond_remark(order) for order in beyond]


def tracks_in_frames(
    band: xr.Dataset, shaft: xr.Dataset, orders: Floats, spans: Spans, values: dict[str, NDArray[Any]], *, method: str
) -> xr.Dataset:
    """Tracks of ``orders`` in frames of ``spans`` (begin and end, rev), with the 95 % intervals of ``values``.

    ``values`` (channel, order, frame) hold amplitude, standard_error and degrees_of_freedom at least, found by
    ``method`` in the BandRecording ``band`` with its ShaftAngle ``shaft``.
    """
    begin, end = spans
    made = xr.Dataset(coords={**channel_coords(band), "order": ("order", orders, {"units": "1", "long_name": "order"})})
    speed, time_s = _speed_and_time(shaft, spans)
    made.coords["speed"] = ("frame", speed, {"units": "min-1", "long_name": "speed in the middle of the frame"})
    made.coords["crank_angle"] = ("frame", begin, {"units": "rev", "long_name": "crank angle at the start"})
    made.coords["revs"] = ("frame", np.round(end - begin), {"units": "rev", "long_name": "length of the frame"})
    made.coords["time"] = ("frame", time_s, {"units": "s", "long_name": "time at the start of the frame"})
    made.attrs = {"recording": band.attrs["recording"], "amplitude_scaling": "peak", "track_method": method}
    made.attrs |= {key: shaft.attrs[key] for key in ("phase_reference", "cycle_known", "revs_per_cycle")}
    put_track_values(made, values)
    return made


def put_track_values(made: xr.Dataset, values: dict[str, NDArray[Any]]) -> None:
    """Put ``values`` (channel, order, frame), as of :func:`tracks_in_frames`, and their intervals into ``made``."""
    magnitude, power = np.abs(values["amplitude"]), 2.0 * values["standard_error"] ** 2
    low, high = amplitude_interval(magnitude, power, values["degrees_of_freedom"])
    half = phase_interval_deg(magnitude, power, values["degrees_of_freedom"])
    given = {**values, "amplitude_low": low, "amplitude_high": high, "phase_ci95": half}
    for name, units, said in _VARIABLES:
        if name in given:
            made[name] = (("channel", "order", "frame"), given[name], {"units": units, "long_name": said})


def _speed_and_time(shaft: xr.Dataset, spans: Spans) -> Spans:
    """Speed in the middle [rpm] and first time [s] of the frames of ``spans`` by ``shaft``."""
    begin, end = spans
    if shaft.attrs.get("domain", "time") == "crank_angle":
        return np.full(len(begin), float(shaft["speed"].values.mean())), np.full(len(begin), np.nan)
    return speed_at_angle(shaft, 0.5 * (begin + end), end - begin), time_at(begin, **knots_of(shaft))
