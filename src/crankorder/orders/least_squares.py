"""Joint least squares on named orders: orders that are close, that cross, that belong to several shafts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.orders.intervals import amplitude_interval, phase_interval_deg

BLOCKS = 64
"""Blocks of a record whose products are kept: they give the residual's spectrum up to a few cycles from each order."""

NEAR_CYCLES = (1, 2, 3, 4)
"""Cycles per record from an order, on both sides, at which the residual tells the noise at the order."""

NORMAL_CONDITION = 300.0
"""Condition up to which normal equations are right to 1e-11 of the amplitude; beyond, orthogonal ones are solved."""

LARGEST_CONDITION = 1e9
"""Condition from which components are not told apart: what noise-free numbers of 1e-16 cannot carry to 1e-6."""


@dataclass(frozen=True)
class JointOrders:
    """Amplitudes of components fitted together, and how well they are known.

    ``amplitude`` (channels, components) complex peak about each component's phase, the mean over the record; NaN for
    components that cannot be told apart: these are in ``together``, tuples of their numbers, and
    ``combined_amplitude`` (channels, components) holds the sum of each such group, for others ``amplitude`` again.
    ``coefficients`` (channels, components, degree + 1) of Legendre polynomials over the record; ``standard_error``
    (channels, components) of the real part, the imaginary part and the magnitude of ``amplitude``;
    ``degrees_of_freedom`` (components,) behind it; ``covariance`` (2 components, 2 components) of the real and
    imaginary parts of ``amplitude``, alternating, in white noise of variance 1. ``condition`` of the scaled
    equations, ``method`` the way that they were solved, ``residual_rms`` (channels,).
    """

    amplitude: NDArray[np.complex128]
    combined_amplitude: NDArray[np.complex128]
    coefficients: NDArray[np.complex128]
    standard_error: NDArray[np.float64]
    degrees_of_freedom: NDArray[np.float64]
    covariance: NDArray[np.float64]
    condition: float
    together: tuple[tuple[int, ...], ...]
    method: str
    residual_rms: NDArray[np.float64]

    def along(self, share: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Amplitude (channels, components, places) at ``share`` (places,), 0 to 1, of the record's samples."""
        powers = np.polynomial.legendre.legvander(2.0 * np.asarray(share) - 1.0, self.coefficients.shape[2] - 1)
        return np.asarray(self.coefficients @ powers.T)

    def intervals(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Ends of the 95 % intervals of the magnitudes, and half widths [degree] of those of the phases."""
        magnitude, power = np.abs(self.amplitude), 2.0 * self.standard_error**2
        dof = np.broadcast_to(self.degrees_of_freedom, magnitude.shape)
        low, high = amplitude_interval(magnitude, power, dof)
        return low, high, phase_interval_deg(magnitude, power, dof)


def joint_orders(
    signals: NDArray[np.floating],
    phase_rev: NDArray[np.float64],
    *,
    weights: NDArray[np.float64] | None = None,
    degree: int = 0,
    usable: NDArray[np.bool_] | None = None,
    largest_condition: float = LARGEST_CONDITION,
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
    degree : degree of the polynomial over the record that each amplitude follows: 0 constant, more for run-ups, at
        the cost of noise
    usable : (channels, samples), False where a sample takes no part; None where all do
    largest_condition : from here on components count as not told apart

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
    if degree < 0:
        raise RequestError("the degree of the amplitude is negative", found=str(degree), allowed="0 or more")
    if usable is None or usable.all():
        return _fitted(signals, phases, weights, degree, largest_condition)
    weight = np.ones(signals.shape[1]) if weights is None else weights
    parts = [
        _fitted(signals[k : k + 1], phases, weight * usable[k], degree, largest_condition) for k in range(len(signals))
    ]
    worst = max(parts, key=lambda part: part.condition)
    return replace(
        worst,
        amplitude=np.concatenate([part.amplitude for part in parts]),
        combined_amplitude=np.concatenate([part.combined_amplitude for part in parts]),
        coefficients=np.concatenate([part.coefficients for part in parts]),
        standard_error=np.concatenate([part.standard_error for part in parts]),
        degrees_of_freedom=np.min([part.degrees_of_freedom for part in parts], axis=0),
        residual_rms=np.concatenate([part.residual_rms for part in parts]),
    )


@dataclass(frozen=True)
class _Products:
    """Sums over each block: of columns with columns, (blocks, unknowns, unknowns), once and twice weighted; of
    columns with signals (blocks, unknowns, channels); and of squared signals (channels,)."""

    own: NDArray[np.float64]
    noise: NDArray[np.float64]
    seen: NDArray[np.float64]
    square: NDArray[np.float64]
    total_weight: float


def _fitted(
    signals: NDArray[np.floating],
    phases: NDArray[np.float64],
    weights: NDArray[np.float64] | None,
    degree: int,
    largest_condition: float,
) -> JointOrders:
    unknowns = 2 * len(phases) * (degree + 1)
    samples = signals.shape[1] if weights is None else int(np.count_nonzero(weights))
    if samples < unknowns:
        raise RequestError(
            "fewer usable samples than unknowns", found=f"{samples} samples", allowed=f"at least {unknowns}"
        )
    exponent = _exponents(signals)
    edges = np.linspace(0, signals.shape[1], min(BLOCKS, signals.shape[1]) + 1).astype(int)
    sums = _products(signals, phases, weights, degree, edges, exponent)
    gram = sums.own.sum(axis=0)
    length = np.sqrt(np.diag(gram))
    length = np.where(length > 1e-12 * np.sqrt(sums.total_weight), length, np.inf)  # a sine at order 0 is no column
    scaled = gram / np.outer(length, length)
    alive = np.isfinite(length)
    singular = np.sqrt(np.maximum(np.linalg.eigvalsh(scaled[np.ix_(alive, alive)]), 0.0))
    condition = float(singular[-1] / singular[0]) if singular[0] > 0.0 else np.inf
    method = "normal equations"
    if condition <= NORMAL_CONDITION:
        inverse = np.zeros_like(scaled)
        inverse[np.ix_(alive, alive)] = np.linalg.inv(scaled[np.ix_(alive, alive)])
        right = sums.seen.sum(axis=0) / length[:, None]
        solved = inverse @ right
        solved += inverse @ (right - scaled @ solved)
        linked = np.zeros((unknowns, 0))
    else:
        method = "orthogonal (QR)"
        triangle, right = _triangle(signals, phases, weights, degree, edges, exponent, length)
        solved, inverse, linked, condition = _by_rank(triangle, right, alive, largest_condition)
    together, members = _groups(linked, len(phases))
    found = solved / length[:, None]
    inverse = inverse / np.outer(length, length)
    error, dof = _errors(sums, found, inverse, len(phases), degree)
    return _result(found, inverse, error, dof, exponent, sums, (condition, together, members, method), degree)


def _result(
    found: NDArray[np.float64],
    inverse: NDArray[np.float64],
    error: NDArray[np.float64],
    dof: NDArray[np.float64],
    exponent: NDArray[np.int64],
    sums: _Products,
    solution: tuple[float, tuple[tuple[int, ...], ...], NDArray[np.bool_], str],
    degree: int,
) -> JointOrders:
    condition, together, members, method = solution
    shaped = found.reshape(-1, degree + 1, 2, found.shape[1])
    unit = np.ldexp(1.0, exponent)[:, None]
    coefficients = np.moveaxis(shaped[:, :, 0] - 1j * shaped[:, :, 1], 2, 0)
    amplitude = coefficients[:, :, 0] * unit
    combined = amplitude.copy()
    for group in together:
        combined[:, group] = amplitude[:, group].sum(axis=1, keepdims=True)
    shown = np.where(members, np.nan, 1.0)
    constant = np.arange(len(found)).reshape(-1, degree + 1, 2)[:, 0].ravel()
    with np.errstate(invalid="ignore"):
        rest = sums.square - np.einsum("uc,uc->c", found, sums.seen.sum(axis=0))
    return JointOrders(
        amplitude=amplitude * shown,
        combined_amplitude=combined,
        coefficients=coefficients * unit[:, :, None] * shown[:, None],
        standard_error=error * unit * shown,
        degrees_of_freedom=dof,
        covariance=inverse[np.ix_(constant, constant)],
        condition=condition,
        together=together,
        method=method,
        residual_rms=np.sqrt(np.maximum(rest, 0.0) / sums.total_weight) * unit[:, 0],
    )


def _exponents(signals: NDArray[np.floating]) -> NDArray[np.int64]:
    """Exponent (channels,) of the power of two that is taken out of each channel; 0 in the ordinary range."""
    largest = np.maximum(signals.max(axis=1), -signals.min(axis=1)).astype(np.float64)
    exponent = np.where(largest > 0.0, np.frexp(largest)[1], 0)
    return np.asarray(np.where(np.abs(exponent) > 64, exponent, 0), dtype=np.int64)


def _columns(
    phases: NDArray[np.float64], weights: NDArray[np.float64] | None, degree: int, block: slice, n_samples: int
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Columns (unknowns, samples) of a block: per component, per power of the amplitude, cosine and sine."""
    wave = np.empty((len(phases), 1, 2, block.stop - block.start))
    _waves(np.ascontiguousarray(phases[:, block]), wave[:, 0])
    if degree:
        place = (2.0 * np.arange(block.start, block.stop) + 1.0) / n_samples - 1.0
        wave = wave * np.polynomial.legendre.legvander(place, degree).T[None, :, None]
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
    signals: NDArray[np.floating],
    phases: NDArray[np.float64],
    weights: NDArray[np.float64] | None,
    degree: int,
    edges: NDArray[np.int64],
    exponent: NDArray[np.int64],
) -> _Products:
    """Sums of products over the blocks between ``edges``; the record is gone through once."""
    unknowns, n = 2 * len(phases) * (degree + 1), len(edges) - 1
    own, seen = np.empty((n, unknowns, unknowns)), np.empty((n, unknowns, len(signals)))
    noise = own if weights is None else np.empty_like(own)
    square = np.zeros(len(signals))
    for k in range(n):
        block = slice(int(edges[k]), int(edges[k + 1]))
        columns, weight = _columns(phases, weights, degree, block, signals.shape[1])
        values = np.ldexp(signals[:, block].astype(np.float64), -exponent[:, None])
        weighted = columns if weight is None else columns * weight
        own[k] = weighted @ columns.T
        if weight is not None:
            noise[k] = weighted @ weighted.T
            values = np.where(weight > 0.0, values, 0.0)
        seen[k] = weighted @ values.T
        square += np.einsum("cn,cn->c", values, values if weight is None else values * weight)
    return _Products(own, noise, seen, square, float(signals.shape[1] if weights is None else weights.sum()))


def _triangle(
    signals: NDArray[np.floating],
    phases: NDArray[np.float64],
    weights: NDArray[np.float64] | None,
    degree: int,
    edges: NDArray[np.int64],
    exponent: NDArray[np.int64],
    length: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Triangle (unknowns, unknowns) of the QR decomposition of the scaled columns, and the signals turned with them."""
    unknowns = len(length)
    top = np.zeros((0, unknowns + len(signals)))
    for k in range(len(edges) - 1):
        block = slice(int(edges[k]), int(edges[k + 1]))
        columns, weight = _columns(phases, weights, degree, block, signals.shape[1])
        values = np.ldexp(signals[:, block].astype(np.float64), -exponent[:, None])
        rows = np.concatenate([columns / length[:, None], values]).T
        if weight is not None:
            rows = np.where(weight[:, None] > 0.0, rows, 0.0) * np.sqrt(weight)[:, None]
        top = np.asarray(np.linalg.qr(np.concatenate([top, rows]), mode="r"))
    return top[:unknowns, :unknowns], top[:unknowns, unknowns:]


def _by_rank(
    triangle: NDArray[np.float64], right: NDArray[np.float64], alive: NDArray[np.bool_], largest_condition: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
    """Shortest solution, its covariance, the directions (unknowns, several) that are not told, and the condition."""
    left, singular, across = np.linalg.svd(triangle)
    rank = int(np.count_nonzero(singular > singular[0] / largest_condition))
    inverse = across[:rank].T / singular[:rank]
    solved = inverse @ (left[:, :rank].T @ right)
    last = singular[int(np.count_nonzero(alive)) - 1]
    condition = float(singular[0] / last) if last > 0.0 else np.inf
    untold = across[rank:].T
    return solved, inverse @ inverse.T, untold[:, np.abs(untold[alive]).max(axis=0, initial=0.0) > 1e-6], condition


def _groups(linked: NDArray[np.float64], n_components: int) -> tuple[tuple[tuple[int, ...], ...], NDArray[np.bool_]]:
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


def _errors(
    sums: _Products, found: NDArray[np.float64], inverse: NDArray[np.float64], n_components: int, degree: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
        cosine = 2 * (degree + 1) * component
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


def _turned(
    turn: NDArray[np.complex128], sums: _Products, cosine: int
) -> tuple[NDArray[np.float64], tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]]:
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
