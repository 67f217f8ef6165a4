"""Natural frequencies that the floor does not show but the first order does, whose response they shape."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.found import AgreedOrder, ModalFit, Mode
from crankorder.identify.modal.order_responses import MODEL_ERROR, Complex, response
from crankorder.settings import IdentifySettings

FEWEST = 30
"""Speeds at which the order must be measured."""

MOST_POLES = 2
"""Poles that are looked for at most."""

FEWER_LEFT = 0.5
"""Share of the misfit that one more pole must take away at least, besides what the information criterion asks."""

NEAR_ONE = 0.005
"""Distance from 1 within which an order is the first."""

KNOWN = 1.0 / 3.0
"""Standard error of the damping, as a share of it, beyond which a pole is but a part of the shape."""

TRIED_HZ = 16
"""Frequencies that are tried as a start."""

TRIED_DAMPING = (0.02, 0.08)
"""Damping ratios that are tried as a start."""

STARTS = 4
"""Best starts that are followed."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sweep:
    """The first order of one channel: ``amplitude`` (K,) with ``error`` (K,) per part at ``frequency_hz`` (K,) rising.

    ``others`` are the frequencies and damping ratios (2, M) of modes that are known already.
    """

    order: float
    channel: str
    frequency_hz: Array
    amplitude: Complex
    error: Array
    others: Array

    def residual(self, poles: Array) -> Array:
        """What the best linear terms leave with ``poles`` (ln f_1, …, ln ζ_1, …), in standard errors.

        Behind a force that grows with the square of speed: a rigid body's share and that of the modes; beside it one
        share that does not grow with speed, for forces that do not.
        """
        natural, damping = np.exp(poles).reshape(2, -1)
        natural, damping = np.append(natural, self.others[0]), np.append(damping, self.others[1])
        growth = (self.frequency_hz / self.frequency_hz[-1]) ** 2
        ones = np.ones((len(growth), 1))
        columns = [ones, 1.0 / growth[:, None], response(self.frequency_hz, natural, damping)[0]]
        design = np.concatenate(columns, axis=1) * (growth / self.error)[:, None]
        q, _ = np.linalg.qr(design / np.linalg.norm(design, axis=0))
        left = self.amplitude / self.error
        left = left - q @ (q.conj().T @ left)
        return np.concatenate([left.real, left.imag])

    def unknowns(self, n_poles: int) -> int:
        """Real numbers that a fit of ``n_poles`` determines."""
        return 4 * n_poles + 4 + 2 * len(self.others[0])


@dataclass(frozen=True, eq=False)
class Shape:
    """Poles of a fit to a sweep as in `Sweep.residual`, the sum of squares they leave, and their covariance."""

    poles: Array
    left: float
    covariance: Array


def with_modes_of_first_order(
    fit: ModalFit, order_map: xr.Dataset, orders: tuple[AgreedOrder, ...], *, settings: IdentifySettings
) -> ModalFit:
    """``fit`` with the natural frequencies that only the response of order 1 shows, all of them undecided.

    They are looked for where order 1 of ``orders`` does not slip, ``order_map`` (OrderMap) holds it at 30 speeds or
    more, and no mode of the fit lies within what it sweeps: no, one or two poles, by the Bayesian information
    criterion with the measured scatter, where each pole must also halve the misfit. The force is taken to grow with
    the square of speed, which the order alone cannot prove: so they are undecided. ``settings``: the largest damping.
    """
    for sweep in _sweeps(fit, order_map, orders):
        low, high = sweep.frequency_hz[0], sweep.frequency_hz[-1]
        if any(low <= mode.frequency_hz <= high for mode in fit.modes):
            continue
        shape = _best(sweep)
        n_poles = len(shape.poles) // 2
        natural, damping = np.exp(shape.poles).reshape(2, -1)
        error = np.sqrt(np.diag(shape.covariance))
        sure = (error[n_poles:] <= KNOWN) & (damping <= settings.max_damping_ratio)
        sure &= (natural >= low) & (natural <= high)
        kept = np.flatnonzero(sure)
        at = np.stack([kept, kept + n_poles], axis=1).ravel()
        scale = np.stack([natural, damping], axis=1)[kept].ravel()
        covariance = shape.covariance[np.ix_(at, at)] * np.outer(scale, scale)
        spread = np.sqrt(np.diag(covariance)).reshape(-1, 2)
        pairs = zip(natural[kept], damping[kept], spread, strict=True)
        modes = tuple(_mode(sweep, float(f), float(z), s, n_poles) for f, z, s in pairs)
        fit = _joined(fit, modes, covariance)
    return fit


def _sweeps(fit: ModalFit, order_map: xr.Dataset, orders: tuple[AgreedOrder, ...]) -> list[Sweep]:
    """The first order in the channels that show it, its strongest channel first."""
    grid, speed = order_map["order"].values, order_map["speed"].values
    names = [str(name) for name in order_map["channel"].values]
    made: list[Sweep] = []
    for agreed in orders:
        if agreed.lock == "slips" or abs(agreed.order - 1.0) > NEAR_ONE or not len(grid):
            continue
        column = int(np.argmin(np.abs(grid - 1.0)))
        for line in agreed.lines if abs(grid[column] - 1.0) < 1e-6 else ():
            at = (names.index(line.channel), slice(None), column)
            size, phase, error, freedom = (
                order_map[name].values[at].astype(np.float64)
                for name in ("coherent_amplitude", "phase", "standard_error", "degrees_of_freedom")
            )
            used = np.isfinite(size * phase * error * speed) & (error > 0.0) & (freedom >= 1.0) & (speed > 0.0)
            used[used] = size[used] > 3.0 * error[used]  # the floor has no phase
            used = np.flatnonzero(used)[np.argsort(speed[used], kind="stable")]
            if len(used) < FEWEST:
                continue
            wide = error[used] * np.sqrt((freedom[used] + 2.0) / freedom[used])
            amplitude = np.asarray(size[used] * np.exp(1j * np.radians(phase[used])), dtype=np.complex128)
            error = np.hypot(wide, 10.0 * MODEL_ERROR * size[used])
            hz = speed[used] / 60.0
            known = [
                (m.frequency_hz, m.damping_ratio) for m in fit.modes if hz[0] / 4.0 < m.frequency_hz < 4.0 * hz[-1]
            ]
            others = np.array(known).reshape(-1, 2).T
            made.append(Sweep(agreed.order, line.channel, hz, amplitude, error, others))
    return sorted(made, key=lambda item: -float(np.median(np.abs(item.amplitude) / item.error)))


def _best(sweep: Sweep) -> Shape:
    """Fit of ``sweep`` with as many poles as it asks for."""
    residual = sweep.residual(np.zeros(0))
    best = Shape(np.zeros(0), float(residual @ residual), np.zeros((0, 0)))
    n = 2 * len(sweep.frequency_hz)
    for n_poles in range(1, MOST_POLES + 1):
        freedom = n - sweep.unknowns(n_poles)
        if freedom < n // 2 or best.left < n - sweep.unknowns(n_poles - 1) + 4.0 * np.sqrt(2.0 * n):
            break  # the fit holds as it is
        trial = _with_one_more(sweep, best.poles)
        more = 4.0 * np.log(n)  # two numbers of the pole and two of its share
        if trial.left > (1.0 - FEWER_LEFT) * best.left or n * np.log(best.left / trial.left) < more:
            break
        best = trial
    return best


def _with_one_more(sweep: Sweep, poles: Array) -> Shape:
    """Best fit with one pole more than ``poles``."""
    from scipy.optimize import least_squares

    natural, damping = poles.reshape(2, -1)
    low, high = sweep.frequency_hz[0], sweep.frequency_hz[-1]
    starts = [
        np.concatenate([natural, [np.log(f)], damping, [np.log(zeta)]])
        for f in np.linspace(0.9 * low, 1.1 * high, TRIED_HZ)
        for zeta in TRIED_DAMPING
    ]
    left = [float(np.sum(sweep.residual(start) ** 2)) for start in starts]
    first = [starts[k] for k in np.argsort(left, kind="stable")[:STARTS]]
    n_poles = len(natural) + 1
    lowest = np.repeat([np.log(0.5 * low), np.log(1e-3)], n_poles)
    highest = np.repeat([np.log(2.0 * high), np.log(0.5)], n_poles)
    fits = [
        least_squares(sweep.residual, start, bounds=(lowest, highest), x_scale=0.05, max_nfev=60) for start in first
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    return Shape(best.x, 2.0 * float(best.cost), _covariance(sweep, best.jac, best.fun))


def _covariance(sweep: Sweep, jacobian: Array, residual: Array) -> Array:
    """Covariance of the poles from the scatter that is left, neighbours being as alike as they are."""
    n = len(sweep.frequency_hz)
    freedom = 2 * n - sweep.unknowns(jacobian.shape[1] // 2)
    both = residual.reshape(2, n)
    alike = float(np.sum(both[:, 1:] * both[:, :-1]) / max(float(np.sum(both**2)), 1e-300))
    alike = min(max(alike, 0.0), 0.95)
    scatter = float(residual @ residual) / freedom * (1.0 + alike) / (1.0 - alike)
    return np.asarray(np.linalg.pinv(jacobian.T @ jacobian, hermitian=True) * max(scatter, 1.0))


def _mode(sweep: Sweep, f: float, zeta: float, spread: Array, n_poles: int) -> Mode:
    """What is said of a pole, always with its doubt."""
    low, high = sweep.frequency_hz[0], sweep.frequency_hz[-1]
    words = f"amplitude and phase of order 1 at {len(sweep.frequency_hz)} speeds ask for {n_poles} poles"
    doubt = "told by order 1 alone, whose force is taken to grow with the square of speed; the floor does not show it"
    width = 2.0 * zeta * f
    if f + width > high or f - width < low:
        doubt += f"; lies at the end of what was swept, {low:.1f} to {high:.1f} Hz"
    return Mode(f, float(spread[0]), zeta, float(spread[1]), (sweep.channel,), 0.0, words, (sweep.order,), doubt)


def _joined(fit: ModalFit, modes: tuple[Mode, ...], covariance: Array) -> ModalFit:
    """``fit`` with further ``modes`` and their ``covariance``, lowest first."""
    if not modes:
        return fit
    every = fit.modes + modes
    n, m = 2 * len(fit.modes), 2 * len(modes)
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[n:, n:] = fit.covariance, covariance
    rank = sorted(range(len(every)), key=lambda k: every[k].frequency_hz)
    at = np.array([[2 * k, 2 * k + 1] for k in rank]).ravel()
    responses = tuple(
        replace(item, residue=np.append(item.residue, np.zeros(len(modes), dtype=complex))[rank])
        for item in fit.responses
    )
    return replace(fit, modes=tuple(every[k] for k in rank), covariance=whole[np.ix_(at, at)], responses=responses)
