"""What an order's response is made of: its force, a smooth part, its scatter, and a mode that it sweeps through."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crankorder.orders.vold_kalman.bandwidth import structural_weight
from crankorder.quantities import Bools, Complexes, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "order_terms")


def smooth_shapes(speed_rpm: Floats, span_rpm: tuple[float, float], degree: int) -> Floats:
    """Legendre polynomials (K, degree + 1) of ln ``speed_rpm`` (K,), which runs from -1 to 1 over ``span_rpm``.

    ``degree``: the highest, 0 or more.
    """
    low, high = np.log(span_rpm[0]), np.log(span_rpm[1])
    x = 2.0 * (np.log(speed_rpm) - low) / max(float(high - low), 1e-12) - 1.0
    return np.asarray(np.polynomial.legendre.legvander(x, degree))


def force(
    speed_rpm: Floats, span_rpm: tuple[float, float], reference_rpm: float, exponent: float, law: tuple[complex, ...]
) -> Complexes:
    """Force (K,) at ``speed_rpm`` (K,) by the law of a block: 1 at ``reference_rpm`` where ``law`` is empty.

    ``span_rpm``, ``exponent`` and ``law`` are those of :class:`Block`.
    """
    return grown_by(speed_rpm / reference_rpm, smooth_shapes(speed_rpm, span_rpm, len(law)), exponent, law)


def grown_by(ratio: Floats, shapes: Floats, exponent: float, law: tuple[complex, ...]) -> Complexes:
    """Force (K,) by ``exponent`` and ``law`` at speeds ``ratio`` (K,) times that of reference.

    ``shapes`` (K, law + 1): the polynomials of these speeds.
    """
    grown: Complexes = np.asarray(ratio**exponent, dtype=np.complex128)
    if law:
        grown *= np.exp(shapes[:, 1:] @ np.array(law))
    return grown


def resonance(frequency_hz: Floats, natural_hz: Floats, damping_ratio: Floats) -> Complexes:
    """Acceleration −x² / (1 − x² + 2iζx), x = f / f_j, of modes of unit residue, shape (…, mode).

    ``frequency_hz``: f, any shape (…). ``natural_hz`` and ``damping_ratio``: f_j (Hz) and ζ_j, (mode,).
    """
    x = np.asarray(frequency_hz)[..., None] / natural_hz
    return np.asarray(-(x**2) / (1 - x**2 + 2j * damping_ratio * x), dtype=np.complex128)


def resonance_slopes(frequency_hz: Floats, natural_hz: Floats, damping: Floats) -> tuple[Complexes, Complexes]:
    """Derivatives of h_j (K, M) = −x² / (1 − x² + 2iζx), x = f / f_j, by ln f_j and by ln ζ_j.

    ``frequency_hz``: in Hz; ``natural_hz``: of the modes in Hz; ``damping``: their ratios.
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

    As :func:`numpy.linalg.qr` does it, whose stacking takes longer than the factors of matrices as small as these. What
    is below the diagonal of a triangle counts for nothing.
    """
    from scipy.linalg import lapack

    count, rows, terms = columns.shape
    if rows < terms:
        basis, triangle = np.linalg.qr(columns)
        return np.asarray(basis, dtype=np.complex128), np.asarray(triangle, dtype=np.complex128)
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

    That is the ``degrees_of_freedom``. n is one as long as s is more than the least.
    """
    known = np.isfinite(error)
    squared, error, size = squared[known], error[known], size[known]

    def above(scatter: Floats, noise: Floats) -> Bools:
        sizes = np.square(noise)[:, None] * error + np.square(scatter)[:, None] * size
        return np.asarray(np.sum(squared / sizes, axis=1) > degrees_of_freedom)

    least, whole = np.array([NUMBERS.least_scatter]), np.ones(1)
    if above(least, whole)[0]:
        return _halved(lambda scatter: above(scatter, whole), NUMBERS.least_scatter, 1e3), 1.0
    if degrees_of_freedom < NUMBERS.enough_degrees_of_freedom:
        return NUMBERS.least_scatter, 1.0
    return NUMBERS.least_scatter, _halved(lambda noise: above(least, noise), NUMBERS.least_noise_share, 1.0)


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


MOST_TURN = 0.02
"""Largest product of the rate of the angular frequency and the square of a step: an error of 1e-3 of the response."""

STEPS_PER_ROW = 2
"""Steps of the grid from row to row at least."""

STEPS_PER_BANDWIDTH = 6.0
"""Steps of the grid in a reciprocal bandwidth of the filter at least."""

MOST_STEPS = 200_000
"""Steps of the grid at most."""

NEAR_ENOUGH, FARTHEST = 0.25, 0.45
"""Cycles in a step of the grid up to which an envelope is told by it, and beyond which it is another one's alias."""


@dataclass(frozen=True, eq=False)
class Passage:
    """How one order passed through the frequencies of one recording, and by what filter it was followed.

    ``step_s`` is that of an even grid of times from ``start_s``, on which ``frequency_hz`` and ``speed_rpm`` (T,) are
    those of the order and of the shaft, whose angle is ``angle_rev`` (T,); ``place`` (K,) says at which step of it each
    row stands; ``bandwidth_hz`` (T,) is that of the Vold–Kalman filter of ``poles``.
    """

    start_s: float
    step_s: float
    frequency_hz: Floats
    speed_rpm: Floats
    angle_rev: Floats
    place: Floats
    bandwidth_hz: Floats
    poles: int

    @property
    def order(self) -> float:
        """The order that passed."""
        return float(60.0 * self.frequency_hz[0] / self.speed_rpm[0])

    @cached_property
    def time_s(self) -> Floats:
        """Times (T,) of the grid."""
        return np.asarray(self.start_s + self.step_s * np.arange(len(self.frequency_hz)))

    @cached_property
    def ends_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that the order passed."""
        return float(self.frequency_hz.min()), float(self.frequency_hz.max())

    @cached_property
    def rates_rpm_per_s(self) -> tuple[float, float]:
        """Least and largest rate of the speed; below zero where it falls."""
        rates = np.diff(self.speed_rpm) / self.step_s
        return float(rates.min()), float(rates.max())

    @cached_property
    def blurred_hz(self) -> float:
        """Half width over which the sweep spreads a resonance without damping, about: the root of its rate."""
        rate = float(np.median(np.abs(np.diff(self.frequency_hz)))) / self.step_s
        return 0.5 * float(np.sqrt(rate))

    def response(
        self, growth: Complexes, natural_hz: float, damping: float, *, slopes: bool = True
    ) -> tuple[Complexes, ...]:
        """Acceleration (K,) of a mode of unit residue behind a force ``growth`` (T,), and its slopes by ln f and ln ζ.

        ``natural_hz`` and ``damping``: of the mode; ``slopes``: whether these are asked for.
        The envelope a of the response relative to the order's phase obeys
        a' = (λ − iω(t)) a + growth, whose steps are solved as if ω were steady within each (Lewis 1932 has the solution
        for a steady rate); so does its slope by λ, with a in place of the force. The counter-rotating part is that of
        steady running. All is then smoothed as the tracking filter smooths it.
        """
        natural, turned = 2.0 * np.pi * natural_hz, np.sqrt(max(1.0 - damping**2, 1e-12))
        pole = natural * complex(-damping, turned)
        # of ln ζ, natural held: the real part grows with ζ, the imaginary one falls
        by_damping = natural * complex(-damping, -(damping**2) / turned)
        weight = -(pole**2) / (2j * pole.imag)
        back = 1.0 / (2j * np.pi * self.frequency_hz - np.conj(pole))
        own, slope = self._envelopes(growth, pole, slopes=slopes)
        driven = growth - weight * own - np.conj(weight) * growth * back
        parts = [driven]
        for step in (pole, by_damping) if slopes else ():
            bend = weight * (2.0 * step / pole - step.imag / pole.imag)
            counter = np.conj(bend) * back + np.conj(weight * step) * back**2
            parts.append(-bend * own - weight * step * slope - growth * counter)
        return tuple(self.smoothed(np.stack(parts, axis=1)).T)

    def left_over(self, growth: Complexes, natural_hz: float, damping: float) -> Complexes:
        """What the filter does not take (T,) of the :meth:`response` of a mode, on the grid: it rings on beside it.

        ``growth`` (T,), ``natural_hz`` and ``damping`` are those of the response.
        """
        natural = 2.0 * np.pi * natural_hz
        pole = natural * complex(-damping, np.sqrt(max(1.0 - damping**2, 1e-12)))
        rung = (pole**2) / (2j * pole.imag) * self._envelopes(growth, pole, slopes=False)[0]
        return np.asarray(rung - _filtered(rung, self._filter))

    def taken_from(self, other: Passage, left: Complexes, natural_hz: float) -> Complexes:
        """What this order's filter takes (K,) for its own of ``left`` (T',) over the passage of an ``other`` order.

        Both are of one recording; ``left`` is the envelope of what the other order's filter leaves of the mode
        ``natural_hz``, which rings at that frequency: only where this order is near it does the grid tell it.
        """
        time = other.time_s
        turned = left * np.exp(2j * np.pi * (other.order - self.order) * other.angle_rev)
        off = np.abs(np.interp(time, self.time_s, self.frequency_hz) - natural_hz) * other.step_s
        turned *= np.clip((FARTHEST - off) / (FARTHEST - NEAR_ENOUGH), 0.0, 1.0)
        width = np.interp(time, self.time_s, self.bandwidth_hz)
        through = _filtered(turned, _factor(width, other.step_s, self.poles))
        rows = self.start_s + self.step_s * self.place
        return np.asarray(np.interp(rows, time, through, left=0.0, right=0.0))

    def smoothed(self, envelope: Complexes) -> Complexes:
        """``envelope`` (T, M) of the grid as the filter lets it through, at the rows (K, M)."""
        through = _filtered(envelope, self._filter)
        low = np.clip(np.floor(self.place).astype(np.int64), 0, len(through) - 2)
        share = (self.place - low)[:, None]
        return np.asarray((1.0 - share) * through[low] + share * through[low + 1])

    @cached_property
    def _filter(self) -> Floats:
        return _factor(self.bandwidth_hz, self.step_s, self.poles)

    @cached_property
    def _turn(self) -> tuple[Floats, Complexes, Complexes]:
        """Angular frequency (T - 1,) in the middle of the steps, the order's turn (T,) since the first, and in each."""
        middle = np.pi * (self.frequency_hz[1:] + self.frequency_hz[:-1])
        turned = np.exp(-1j * self.step_s * np.append(0.0, np.cumsum(middle)))
        return middle, turned, turned[1:] * turned[:-1].conj()

    def _envelopes(self, growth: Complexes, pole: complex, *, slopes: bool) -> tuple[Complexes, Complexes]:
        """Solution (T,) of a' = (λ − iω) a + ``growth`` from a steady start, λ the ``pole``, and its slope by λ.

        Without ``slopes`` the latter is not reckoned. On axes that turn with the order each step decays alike.
        """
        from scipy.linalg.blas import ztbsv

        (middle, turned, turn), step = self._turn, self.step_s
        z = 1.0 / ((pole - 1j * middle) * step)
        grown = turn * np.exp(pole * step)
        over = (grown - 1.0) * z
        slope = (over - 1.0) * z  # the force is linear within a step: exact for a steady frequency
        start = 1.0 / (2j * np.pi * self.frequency_hz[0] - pole)
        steps = np.full((2, len(turned)), -np.exp(pole * step), order="F")  # each is the one before times that, pushed

        def along(first: complex, pushed: Complexes) -> Complexes:
            return np.asarray(turned * ztbsv(1, steps, np.append(first, pushed * turned[1:].conj()), lower=1, diag=1))

        force, rise = step * growth[:-1], step * np.diff(growth)
        own = along(growth[0] * start, force * over + rise * slope)
        if not slopes:
            return own, own
        # the slope of each step by λ, the step itself being exact
        by_over = step * (grown - over) * z
        by_slope = (by_over - step * slope) * z
        pushed = step * grown * own[:-1] + force * by_over + rise * by_slope
        return own, along(growth[0] * start**2, pushed)


def passage_of(
    order: float,
    time_s: Floats,
    speed_rpm: Floats,
    angle_rev: Floats,
    bandwidth_hz: Floats,
    *,
    poles: int,
    rows: Bools | None = None,
) -> Passage:
    """Passage of ``order`` through a recording at the times ``time_s`` (N,), rising, of which ``rows`` (N,) are read.

    ``speed_rpm`` and ``angle_rev`` (N,) are the shaft's there and ``bandwidth_hz`` (N,) that of the filter of
    ``poles``. The grid between is so fine that the response of any mode follows.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator

    rate = float(np.abs(np.gradient(speed_rpm, time_s)).max()) * order / 60.0 * 2.0 * np.pi
    spacing = float(np.median(np.diff(time_s)))
    fine = 1.0 / (STEPS_PER_BANDWIDTH * float(bandwidth_hz.max()))
    step = min(spacing / STEPS_PER_ROW, float(np.sqrt(MOST_TURN / max(rate, 1e-9))), fine)
    span = float(time_s[-1] - time_s[0])
    count = int(min(max(np.ceil(span / step), 8), MOST_STEPS))
    at = np.linspace(time_s[0], time_s[-1], count + 1)
    speed = np.asarray(PchipInterpolator(time_s, speed_rpm)(at))
    step = span / count
    angle = np.asarray(CubicSpline(time_s, angle_rev)(at))
    place = ((time_s if rows is None else time_s[rows]) - time_s[0]) / step
    width = np.interp(at, time_s, bandwidth_hz)
    return Passage(float(time_s[0]), step, order * speed / 60.0, speed, angle, place, width, poles)


def _factor(bandwidth_hz: Floats, step_s: float, poles: int) -> Floats:
    """Cholesky factor of a filter's normal equations on a grid of ``step_s``, its ``bandwidth_hz`` (T,) there."""
    from scipy.linalg import cholesky_banded

    rate = 1.0 / step_s
    weight = 2.0 * structural_weight(np.minimum(bandwidth_hz, 0.9 * rate), rate_hz=rate, poles=poles)
    steps = np.array([1.0])
    for _ in range(poles):
        steps = np.convolve(steps, [1.0, -1.0])
    # lower band (poles + 1, T) of 1 + Dᵀ r² D for differences of that many poles, the weight being r²
    n = len(weight)
    band = np.zeros((poles + 1, n))
    band[0] = 1.0
    pulled = weight[poles // 2 : n - (poles - poles // 2)]
    for lag in range(poles + 1):
        for k in range(poles + 1 - lag):
            band[lag, k : n - poles + k] += steps[k] * steps[k + lag] * pulled
    return np.asarray(cholesky_banded(band, lower=True, check_finite=False))


def _filtered(envelope: Complexes, factor: Floats) -> Complexes:
    """``envelope`` (T, …) of a grid as the filter of the ``factor`` lets it through."""
    from scipy.linalg import cho_solve_banded

    return np.asarray(cho_solve_banded((factor, True), envelope, check_finite=False))
