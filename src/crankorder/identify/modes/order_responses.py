"""How orders drive the channels through the modes: complex amplitudes over the speeds, fitted with the same poles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.modes.surface_fit import NO_POLES, Poles, parameters_of
from crankorder.quantities import Bools, Complexes, Floats, Ints
from crankorder.settings import MethodNumbers

ORDER_TERMS = MethodNumbers("5-identify-modal.toml", "order_terms")


@dataclass(frozen=True)
class Force:
    """How the force of an order grows with the speed.

    (speed / ``reference_rpm``) to the power ``exponent`` times the exponential of Σ ``law``[k] P_k+1(x), P_k the
    Legendre polynomials of x, the logarithm of the speed, which runs from -1 to 1 over ``span_rpm``.
    """

    reference_rpm: float
    span_rpm: tuple[float, float]
    exponent: float = 2.0
    law: tuple[complex, ...] = ()

    def shapes(self, speed_rpm: Floats, degree: int) -> Floats:
        """The polynomials (K, ``degree`` + 1) at ``speed_rpm`` (K,); ``degree``: the highest, 0 or more."""
        low, high = np.log(self.span_rpm)
        x = 2.0 * (np.log(speed_rpm) - low) / max(float(high - low), 1e-12) - 1.0
        return np.asarray(np.polynomial.legendre.legvander(x, degree))

    def at(self, speed_rpm: Floats, shapes: Floats | None = None) -> Complexes:
        """Force (K,) at ``speed_rpm`` (K,); ``shapes`` (K, law + 1 or more): the polynomials there, where known."""
        grown: Complexes = np.asarray((speed_rpm / self.reference_rpm) ** self.exponent, dtype=np.complex128)
        if self.law:
            shapes = self.shapes(speed_rpm, len(self.law)) if shapes is None else shapes
            grown *= np.exp(shapes[:, 1 : len(self.law) + 1] @ np.array(self.law))
        return grown


def resonance(frequency_hz: Floats, natural_hz: Floats, damping_ratio: Floats) -> Complexes:
    """Acceleration −x² / (1 − x² + 2iζx), x = f / f_j, of modes of unit residue, shape (…, mode).

    ``frequency_hz``: f, any shape (…). ``natural_hz`` and ``damping_ratio``: f_j (Hz) and ζ_j, (mode,).
    """
    x = np.asarray(frequency_hz)[..., None] / natural_hz
    return np.asarray(-(x**2) / (1 - x**2 + 2j * damping_ratio * x), dtype=np.complex128)


def resonance_slopes(frequency_hz: Floats, natural_hz: Floats, damping: Floats) -> tuple[Complexes, Complexes]:
    """Derivatives of h_j (K, M) = −x² / (1 − x² + 2iζx), x = f / f_j, by ln f_j and by ln ζ_j.

    ``frequency_hz`` (K,): in Hz; ``natural_hz`` (M,): of the modes in Hz; ``damping`` (M,): their ratios.
    """
    x = frequency_hz[:, None] / natural_hz
    over = 1.0 / (1.0 - x**2 + 2j * damping * x)
    by_x = -2.0 * x * over + x**2 * (-2.0 * x + 2j * damping) * over**2
    return np.asarray(-x * by_x, dtype=np.complex128), np.asarray(2j * damping * x**3 * over**2, dtype=np.complex128)


def of_squares(columns: Complexes, ratio: Floats) -> Complexes:
    """Real part and imaginary part over ``ratio`` (K, 2 M) of ``columns`` (K, M), in turn.

    They span the square of any response with real residues, beside a constant.
    """
    both = np.empty((len(columns), 2 * columns.shape[1]), dtype=np.complex128)
    both[:, ::2], both[:, 1::2] = columns.real, columns.imag / ratio
    return both


def qr_by_channel(columns: Complexes) -> tuple[Complexes, Complexes]:
    """QR of each channel's ``columns`` (C, K, terms): bases (C, K, terms) and triangles (C, terms, terms).

    There are no more terms than rows. As :func:`numpy.linalg.qr` does it, whose stacking takes longer than the factors
    of matrices as small as these. What is below the diagonal of a triangle counts for nothing.
    """
    from scipy.linalg import lapack

    count, rows, terms = columns.shape
    turned = np.empty((count, terms, rows), dtype=np.complex128)
    triangle = np.empty((count, terms, terms), dtype=np.complex128)
    for number, channel in enumerate(columns):
        reflected, factor, _, _ = lapack.zgeqrf(channel)
        triangle[number] = reflected[:terms]
        turned[number] = lapack.zungqr(reflected, factor, overwrite_a=True)[0].T
    return np.swapaxes(turned, 1, 2), triangle


def beyond(basis: Complexes, values: Complexes) -> Complexes:
    """``values`` (C, K, M) less what lies along ``basis`` (C, K, terms)."""
    return np.asarray(values - basis @ (np.swapaxes(basis, 1, 2).conj() @ values))


def beyond_law(values: Complexes, bent: Complexes, *, power: bool) -> Complexes:
    """``values`` (C, K, M) less what a step of a law common to the channels makes up for.

    ``bent`` (C, K, degree) are the derivatives by its numbers. These are complex, and real behind squares (``power``),
    of which the real parts alone count.
    """
    flat, moved = values.reshape(-1, values.shape[2]), bent.reshape(-1, bent.shape[2])
    if power:
        flat, moved = flat.real.astype(np.complex128), moved.real.astype(np.complex128)
    unit = np.linalg.qr(moved / np.maximum(np.linalg.norm(moved, axis=0), 1e-300))[0]
    return np.asarray(beyond(unit[None], flat[None])[0].reshape(values.shape))


CUTS = 16
"""Parts into which a range is cut at once: as many as four halvings make."""

FRACTIONS = np.arange(CUTS + 1) / CUTS
"""Where those cuts lie, as shares of the range."""


def scatter_of(squared: Floats, error: Floats, size: Floats, degrees_of_freedom: int) -> tuple[float, float]:
    """Scatter s and share n of the errors for which Σ ``squared`` / (n² ``error`` + s² ``size``) is as expected.

    All three (rows,). That is the ``degrees_of_freedom``. n is one as long as s is more than the least.
    """
    known, least = np.isfinite(error), ORDER_TERMS.least_scatter
    squared, error, size = squared[known], error[known], size[known]

    def above(scatter: Floats | float, noise: Floats | float) -> Bools:
        sizes = np.square(noise)[..., None] * error + np.square(scatter)[..., None] * size
        return np.asarray(np.sum(squared / sizes, axis=-1) > degrees_of_freedom)

    if above(least, 1.0):
        return _halved(lambda scatter: above(scatter, 1.0), least, 1e3), 1.0
    if degrees_of_freedom < ORDER_TERMS.enough_degrees_of_freedom:
        return least, 1.0
    return least, _halved(lambda noise: above(least, noise), ORDER_TERMS.least_noise_share, 1.0)


def _halved(is_below: Callable[[Floats], Bools], low: float, high: float) -> float:
    """Where ``is_below`` turns false between ``low`` and ``high``, by halving the logarithm twenty times.

    Four halvings are one: all places that they could ask at are asked at once.
    """
    first, last = float(np.log(low)), float(np.log(high))
    for _ in range(5):
        cuts = first + (last - first) * FRACTIONS
        part = int(np.count_nonzero(is_below(np.exp(cuts[1:-1]))))
        first, last = float(cuts[part]), float(cuts[part + 1])
    return float(np.exp(0.5 * (first + last)))


NUMBERS = MethodNumbers("5-identify-modal.toml", "order_responses")

UNTOLD_HZ = 1e9
"""Blur of rows of a sweep whose signals were not asked: a mode may ring in them as it likes, and none is excluded."""

EXPONENTS = (2.0, 0.0, 1.0, 3.0)
"""Powers of the speed that forces grow with: that of inertia, which needs no proof, steady, …, and one more."""

LAW_STEPS, MOST_BEND = 2, 0.5
"""Steps by which the law of a force is told, and the largest of them, as a logarithm."""

MOST_ROUNDS, MOST_TURNS = 3, 8
"""Times that scatter and linear terms are told from one another, and that the signs of rows are told anew."""

Kept = TypeVar("Kept")


def _latest(owner: object, kind: str, arguments: tuple[NDArray[Any], ...], compute: Callable[[], Kept]) -> Kept:
    """What ``compute`` gives for these ``arguments``; the latest of each ``kind`` is kept with its ``owner``."""
    key = b"".join(values.tobytes() for values in arguments)
    if kind not in owner.__dict__ or owner.__dict__[kind][0] != key:
        owner.__dict__[kind] = key, compute()
    return cast(Kept, owner.__dict__[kind][1])


@dataclass(frozen=True, eq=False)
class Rows:
    """One order in its ``channels``: ``amplitude`` (C, K) with ``error`` (C, K) per part, infinite where unknown.

    Row k stands at ``frequency_hz`` and ``speed_rpm`` (K,), as if that were held. ``power``: whether the phases say
    nothing, so that ``amplitude`` holds squares. ``sign_free``: whether a row may as well have the other sign, for
    nothing says which turn of a cycle comes first. ``recording`` is that of a sweep, "" of a whole test; ``blur_hz``
    the half width over which the sweep spreads a resonance without damping, about.
    """

    order: float
    channels: tuple[str, ...]
    frequency_hz: Floats
    speed_rpm: Floats
    amplitude: Complexes
    error: Floats
    power: bool = False
    sign_free: bool = False
    recording: str = ""
    blur_hz: float = 0.0

    @cached_property
    def ends_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency of the rows."""
        return float(self.frequency_hz.min()), float(self.frequency_hz.max())

    @cached_property
    def size(self) -> Floats:
        """What the scatter is a share of (C, K): the amplitude, or half that of its neighbours where it vanishes."""
        beside = np.pad(np.abs(self.measured), ((0, 0), (2, 2)), mode="edge")
        around = np.sort(np.lib.stride_tricks.sliding_window_view(beside, 5, axis=1), axis=2)[..., 2]
        return np.asarray(np.maximum(np.abs(self.measured), 0.5 * around))

    @property
    def linear_size(self) -> Floats:
        """The size (C, K) as an amplitude, of squares too."""
        return np.sqrt(self.size) if self.power else self.size

    @cached_property
    def counts(self) -> Ints:
        """How many amplitudes each channel (C,) has."""
        return np.asarray(np.count_nonzero(np.isfinite(self.error), axis=1))

    @property
    def fewest(self) -> int:
        """How many amplitudes the channel with the fewest has."""
        return int(self.counts.min())

    @property
    def numbers(self) -> int:
        """How many real numbers the amplitudes hold."""
        return self.parts * int(self.counts.sum())

    @cached_property
    def measured(self) -> Complexes:
        """The amplitudes (C, K), 0 where unknown."""
        return np.asarray(np.where(np.isfinite(self.error), self.amplitude, 0.0))

    @property
    def parts(self) -> int:
        """Real numbers that each amplitude holds."""
        return 1 if self.power else 2

    @property
    def columns_per_mode(self) -> int:
        """Linear terms of each mode: a complex residue, or two real numbers behind squares."""
        return 2 if self.power else 1

    @cached_property
    def squared(self) -> Rows:
        """The rows as squares, which have no phase."""
        noise = np.where(np.isfinite(self.error), self.error, 0.0)
        size = np.abs(self.amplitude)
        beats = np.where(np.isfinite(self.error), 2.0 * np.maximum(size, noise) * noise, np.inf)
        square = np.asarray(size**2 - 2.0 * noise**2, dtype=np.complex128)
        return replace(self, amplitude=square, error=beats, power=True, sign_free=False)

    def modal(self, natural_hz: Floats, damping: Floats) -> Complexes:
        """Columns (K, M · columns per mode) of modes behind a steady force; those made last are kept.

        ``natural_hz`` and ``damping`` (M,): of the modes.
        """

        def columns() -> Complexes:
            h: Complexes = resonance(self.frequency_hz, natural_hz, damping)
            return of_squares(h, self.frequency_hz[:, None] / natural_hz) if self.power else h

        return _latest(self, "_modal", (natural_hz, damping), columns)

    def modal_slopes(self, natural_hz: Floats, damping: Floats) -> tuple[Complexes, Complexes]:
        """Derivatives of :meth:`modal` by ln f_j and by ln ζ_j.

        ``natural_hz`` and ``damping`` (M,): of the modes.
        """
        by_f, by_zeta = resonance_slopes(self.frequency_hz, natural_hz, damping)
        if not self.power:
            return by_f, by_zeta
        h: Complexes = resonance(self.frequency_hz, natural_hz, damping)
        x = self.frequency_hz[:, None] / natural_hz
        # the imaginary part is over x, which moves with f
        return of_squares(by_f + 1j * h.imag, x), of_squares(by_zeta, x)

    def shapes(self, force: Force, degree: int) -> Floats:
        """Polynomials (K, ``degree`` + 1) of the speeds over the span of ``force``; those made last are kept."""
        most = max(degree, NUMBERS.most_degree)
        key = (np.array([*force.span_rpm, most]),)
        return _latest(self, "_shapes", key, lambda: force.shapes(self.speed_rpm, most))[:, : degree + 1]


OF_LAW = ("growth", "_designs")
"""What a :class:`Block` works out of its rows and its law, whatever its scatter."""


@dataclass(frozen=True, eq=False)
class Block:
    """``rows`` of one order behind its ``force`` (of squares its square), common to the channels.

    Beside the modes stands a polynomial of ``degree`` in the logarithm of speed, times the force. ``scatter`` is what
    force and path vary by, as a share of the amplitude, beyond the rows' errors, of which the share ``noise`` is true.
    """

    rows: Rows
    force: Force
    degree: int = 0
    scatter: float = ORDER_TERMS.least_scatter
    noise: float = 1.0

    @classmethod
    def of(cls, rows: Rows) -> Block:
        """Block of ``rows`` before anything is known of its force."""
        span = float(rows.speed_rpm.min()), float(rows.speed_rpm.max())
        return cls(rows, Force(span[1], span))

    def varied(self, **changes: Any) -> Block:
        """The block with ``changes`` of its ``scatter`` or ``noise``: what is worked out of the rest is kept."""
        block = replace(self, **changes)
        block.__dict__.update({name: self.__dict__[name] for name in OF_LAW if name in self.__dict__})
        return block

    def turned(self, sign: Floats) -> Block:
        """The block whose rows have their ``sign`` (K,), 1 or -1."""
        return replace(self, rows=replace(self.rows, amplitude=self.rows.amplitude * sign))

    @property
    def tells(self) -> bool:
        """Whether it scatters so little that it says something of natural frequencies."""
        return bool(self.scatter <= NUMBERS.most_scatter)

    @property
    def squared(self) -> Block:
        """The block as squares, which have no phase."""
        return replace(self, rows=self.rows.squared, scatter=2.0 * self.scatter)

    @cached_property
    def growth(self) -> Complexes:
        """What the force's law makes of the speeds (K,); of squares its square."""
        grown = self.force.at(self.rows.speed_rpm, self.shapes_to(len(self.force.law)))
        return np.asarray(np.abs(grown) ** 2 if self.rows.power else grown)

    def shapes_to(self, degree: int) -> Floats:
        """Polynomials (K, ``degree`` + 1) of the speeds."""
        return self.rows.shapes(self.force, degree)

    @cached_property
    def weight(self) -> Floats:
        """Reciprocal standard error (C, K) of each part, the scatter of the force included; 0 where unknown."""
        return np.asarray(1.0 / np.hypot(self.noise * self.rows.error, self.scatter * self.rows.size))

    def reached(self, poles: Poles) -> Ints:
        """Numbers (n,) of the ``poles`` that the order sweeps through or near, the nearest where its rows are few."""
        rows = self.rows
        low, high = NUMBERS.reach_shares[0] * rows.ends_hz[0], NUMBERS.reach_shares[1] * rows.ends_hz[1]
        reached = np.flatnonzero((poles.frequency_hz >= low) & (poles.frequency_hz <= high) & ~poles.tone)
        room = max(0, (rows.fewest - 1 - self.degree - NUMBERS.spare_amplitudes) // rows.columns_per_mode)
        if len(reached) > room:
            away = np.abs(np.log(poles.frequency_hz[reached, None] / rows.frequency_hz)).min(axis=1)
            reached = np.sort(reached[np.argsort(away, kind="stable")[:room]])
        return reached

    def smooth(self) -> Complexes:
        """Columns (K, degree + 1) of what is smooth."""
        return self.growth[:, None] * self.shapes_to(self.degree)

    def design(self, natural_hz: Floats, damping: Floats) -> Complexes:
        """All columns (K, terms): those that are smooth, then those of :meth:`modal`; those made last are kept.

        ``natural_hz`` and ``damping`` (M,): of the modes.
        """

        def columns() -> Complexes:
            return np.concatenate([self.smooth(), self.modal(natural_hz, damping)], axis=1)

        return _latest(self, "_designs", (natural_hz, damping), columns)

    def modal(self, natural_hz: Floats, damping: Floats) -> Complexes:
        """Columns (K, M · columns per mode) of modes with ``natural_hz`` and ``damping`` (M,)."""
        return np.asarray(self.growth[:, None] * self.rows.modal(natural_hz, damping))

    def modal_slopes(self, natural_hz: Floats, damping: Floats) -> list[Complexes]:
        """Derivatives of :meth:`modal` by ln f_j and by ln ζ_j.

        ``natural_hz`` and ``damping`` (M,): of the modes.
        """
        return [self.growth[:, None] * slope for slope in self.rows.modal_slopes(natural_hz, damping)]


class Blocks(NamedTuple):
    """Orders that take part in a joint fit; ``fixed`` are further poles behind them, which other bands tell."""

    items: tuple[Block, ...]
    fixed: Poles = NO_POLES

    def misfit(self, poles: Poles) -> float:
        """Sum of the squared residuals in standard errors.

        ``poles``: those of the fit.
        """
        every = poles.joined(self.fixed)
        return float(sum(project(block, every).chi2 for block in self.items))

    def evaluate(self, poles: Poles) -> tuple[list[Floats], list[Floats]]:
        """Jacobians by (ln f, ln ζ) and residuals, both in standard errors, real parts first.

        ``poles``: those of the fit.
        """
        every = poles.joined(self.fixed)
        pairs = [(block, project(block, every)) for block in self.items]
        slopes = [jacobian(block, every, part)[:, : 2 * len(poles)] for block, part in pairs]
        return slopes, [as_real(part.left, block) for block, part in pairs]


@dataclass(frozen=True, eq=False)
class Projected:
    """A block with its linear terms (smooth ones, then those of the ``reached`` modes) eliminated.

    ``basis`` (C, K, terms) is an orthonormal basis of the weighted columns, ``triangle`` (C, terms, terms) takes the
    linear terms, each times its ``scale`` (C, terms), to it (what is below its diagonal counts for nothing), ``along``
    (C, terms) what was measured; ``left`` (C, K) is the weighted residual, ``chi2`` its square, with
    ``degrees_of_freedom``: the real numbers that it holds beyond the terms.
    """

    reached: Ints
    basis: Complexes
    triangle: Complexes
    scale: Floats
    along: Complexes
    left: Complexes
    chi2: float
    degrees_of_freedom: int

    @cached_property
    def linear(self) -> Complexes:
        """Linear terms (C, terms)."""
        return np.asarray((self.solve @ self.along[..., None])[..., 0] / self.scale)

    @property
    def covariance(self) -> Complexes:
        """Covariance (C, terms, terms) of the linear terms per real part, at the block's scatter."""
        inverse = self.solve
        outer = self.scale[:, :, None] * self.scale[:, None, :]
        return np.asarray(inverse @ np.swapaxes(inverse, 1, 2).conj() / outer)

    @property
    def beyond_errors(self) -> float:
        """What the squares that are left are over those expected; 1 or more."""
        return max(1.0, self.chi2 / max(self.degrees_of_freedom, 1))

    @cached_property
    def solve(self) -> Complexes:
        """Inverse (C, terms, terms) of the triangle: it takes what lies along the basis to the scaled linear terms."""
        return np.asarray(np.linalg.pinv(np.triu(self.triangle), rcond=1e-10))


def project(block: Block, poles: Poles) -> Projected:
    """``block`` with its linear terms eliminated for given ``poles`` (Golub and Pereyra 1973).

    That behind the poles that were asked for last is kept: the others may move.
    """
    reached = block.reached(poles)
    near = poles.chosen(reached)
    key = (reached, near.frequency_hz, near.damping)
    return _latest(block, "_projection", key, lambda: _eliminated(block, reached, near))


def _eliminated(block: Block, reached: Ints, near: Poles) -> Projected:
    """``block`` with its linear terms eliminated, those of the modes ``near``, which are number ``reached``, last."""
    weight, design = block.weight, block.design(near.frequency_hz, near.damping)
    weighted = design.T * weight[:, None]
    scale = np.maximum(np.linalg.norm(weighted, axis=2), 1e-300)
    weighted /= scale[..., None]
    basis, triangle = qr_by_channel(np.swapaxes(weighted, 1, 2))
    rows = block.rows
    measured = rows.measured * weight
    along = (np.swapaxes(basis, 1, 2).conj() @ measured[..., None])[..., 0]
    left = measured - (basis @ along[..., None])[..., 0]
    degrees_of_freedom = rows.numbers - rows.parts * len(rows.channels) * design.shape[1]
    return Projected(reached, basis, triangle, scale, along, left, float(np.vdot(left, left).real), degrees_of_freedom)


def jacobian(block: Block, poles: Poles, part: Projected) -> Floats:
    """Derivatives (rows, 2 poles) of the residual of ``block`` by (ln f, ln ζ) of ``poles``, its sign reversed.

    Linear terms make up for what they can, and so does the law of the force, to first order. ``part``: the block as
    projected with them.
    """
    reached, rows = part.reached, block.rows
    every = np.zeros((rows.parts * rows.amplitude.size, 2 * len(poles)))
    if not len(reached):
        return every
    linear = part.linear[:, block.degree + 1 :]
    turned: Complexes = np.empty((*rows.amplitude.shape, 2 * len(reached)), dtype=np.complex128)
    for offset, slope in enumerate(block.modal_slopes(poles.frequency_hz[reached], poles.damping[reached])):
        by_pole = slope[None] * linear[:, None]
        turned[..., offset::2] = by_pole.reshape(*by_pole.shape[:2], len(reached), rows.columns_per_mode).sum(axis=3)
    turned *= block.weight[..., None]
    turned = beyond(part.basis, turned)
    if part.degrees_of_freedom >= ORDER_TERMS.enough_degrees_of_freedom:
        turned = beyond_law(turned, force_slopes(block, part, max(len(block.force.law), 1)), power=rows.power)
    every[:, parameters_of(reached)] = as_real(turned, block)
    return every


def force_slopes(block: Block, part: Projected, degree: int) -> Complexes:
    """Derivatives (C, K, ``degree``) of ``block`` by the law of its force, beyond the linear terms of ``part``."""
    fitted = block.rows.measured * block.weight - part.left
    bends = fitted[..., None] * block.shapes_to(degree)[:, 1:] * (2.0 if block.rows.power else 1.0)
    return beyond(part.basis, bends)


def as_real(values: Complexes, block: Block) -> Floats:
    """``values`` (C, K, …) of ``block`` as rows of real numbers, real parts first; of squares these alone."""
    rows = values.reshape(values.shape[0] * values.shape[1], *values.shape[2:])
    return np.asarray(rows.real if block.rows.power else np.concatenate([rows.real, rows.imag]))


def deviance_of(block: Block, part: Projected) -> float:
    """Minus twice the log likelihood of ``block`` as projected (``part``), up to a constant."""
    weight = block.weight
    return block.rows.parts * -2.0 * float(np.log(weight[weight > 0.0]).sum()) + part.chi2


def with_scatter(block: Block, poles: Poles) -> tuple[Block, Projected]:
    """``block`` with the scatter by which its residuals behind ``poles`` are as large as expected (Paule and Mandel).

    Where they are smaller than the errors say even without scatter, and many, the errors are that share of what was
    stated. And the block as projected with that.
    """
    block, part = _with_signs(block, poles)
    rows = block.rows
    for _ in range(MOST_ROUNDS):
        if part.degrees_of_freedom < 1:
            break
        weight = block.weight
        squared = np.square(np.abs(part.left) / np.where(weight > 0.0, weight, np.inf))
        scatter, noise = scatter_of(
            squared.ravel(), np.square(rows.error).ravel(), np.square(rows.size).ravel(), part.degrees_of_freedom
        )
        settled = abs(scatter - block.scatter) <= 0.05 * scatter and abs(noise - block.noise) <= 0.05 * noise
        if scatter == block.scatter and noise == block.noise:
            break
        block = block.varied(scatter=scatter, noise=noise)
        part = project(block, poles)
        if settled:
            break
    return block, part


def _with_signs(block: Block, poles: Poles) -> tuple[Block, Projected]:
    """``block`` as projected, its rows with the signs by which the others foretell them best where these are free."""
    part = project(block, poles)
    for _ in range(MOST_TURNS if block.rows.sign_free else 0):
        measured = block.rows.amplitude * block.weight
        alone = 1.0 - np.sum(np.abs(part.basis) ** 2, axis=2)
        agrees = np.sum((measured.conj() * (alone * measured - part.left)).real, axis=0)
        if not (agrees < 0.0).any():
            break
        trial = block.turned(np.where(agrees < 0.0, -1.0, 1.0))
        tried = project(trial, poles)
        if tried.chi2 >= part.chi2:
            break
        block, part = trial, tried
    return block, part


def with_best_law(block: Block, poles: Poles) -> Block:
    """``block`` with the force's law, common to its channels, by which the ``poles`` explain it best.

    The power of the speed first, then the degree of what is smooth beside the modes, then a departure of the force from
    a power: each by the Bayesian information criterion with the scatter that it leaves.
    """
    best, cost, rows = block, np.inf, block.rows
    most = min(NUMBERS.most_degree, rows.fewest // 4 - 1)
    tried = [(exponent, 0, 0) for exponent in EXPONENTS]
    tried += [(np.nan, degree, 0) for degree in range(1, most + 1)]
    tried += [(np.nan, -1, degree) for degree in range(1, most + 1)]
    for exponent, degree, bends in tried:
        power = best.force.exponent if np.isnan(exponent) else exponent
        force = replace(block.force, exponent=power, law=(0.0,) * bends)
        trial = replace(block, force=force, degree=best.degree if degree < 0 else degree, scatter=best.scatter)
        for _ in range(LAW_STEPS if bends else 0):
            trial = with_bent_law(trial, poles)
        trial, part = with_scatter(trial, poles)
        terms = rows.parts * (len(rows.channels) * (trial.degree + 1) + bends)
        new = deviance_of(trial, part) + terms * float(np.log(rows.numbers))
        if new < cost:
            best, cost = trial, new
        if best.scatter <= ORDER_TERMS.least_scatter:
            break
    return best


def with_bent_law(block: Block, poles: Poles) -> Block:
    """``block`` after a Gauss–Newton step in its ``law`` behind ``poles``."""
    if not (law := block.force.law):
        return block
    part = project(block, poles)
    bends, left = force_slopes(block, part, len(law)).reshape(-1, len(law)), part.left.ravel()
    real = block.rows.power
    step = np.linalg.lstsq(bends.real if real else bends, left.real if real else left, rcond=1e-6)[0]
    step *= min(1.0, MOST_BEND / max(float(np.abs(step).max()), 1e-300))
    return replace(block, force=replace(block.force, law=tuple((np.array(law) + step).tolist())))
