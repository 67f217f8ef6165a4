"""Joint fit of orders whose forces are known and orders whose masses are sought, through one path with known modes.

Kinematic orders of known force shake the machine as a calibrated exciter would; masses that make the other orders act
through the same path at the same frequencies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from crankorder.engine.definition import Engine
from crankorder.engine.forces import DIRECTIONS, X, Y, Z, crankcase_forces, crankcase_moments
from crankorder.identify.balance.transfer_path import MeasuredOrders, whitening
from crankorder.identify.found import ModalFit
from crankorder.identify.modes.order_responses import resonance, resonance_slopes
from crankorder.quantities import Complexes, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-balance.toml", "order_shaker")

STEPS, SHRUNK, MOST_DAMPED, MOST_ODD = 25, 1e-6, 1e4, 4
"""Steps of the fit at most, the relative fall of its sum of squares at which it ends, the damping beyond which none
falls, and speeds that are left out at most: in a sweep each row has its own."""
LEAST_PIVOT = 1e-5
"""Smallest pivot of a normal matrix's factor of which two rounds leave rounding alone."""
BINS_WORTH = 0.5
"""Independent bins that a bin of a Hann window's spectrum is worth beside its neighbours."""


class OrderForces(NamedTuple):
    """Forces and moments of the orders over ω²: ``known`` (axis, order) in kg·m (kg·m²), and per kg sought ``unit``.

    ``unit``: (mass, axis, order).
    """

    axes: tuple[str, ...]
    known: Complexes
    unit: Complexes

    @property
    def alone(self) -> OrderForces:
        """The forces without the rolling moment."""
        return self.on(tuple(axis for axis in self.axes if axis != "RY"))

    def on(self, axes: tuple[str, ...]) -> OrderForces:
        """Those along some of the ``axes``."""
        picked = [self.axes.index(axis) for axis in axes]
        return OrderForces(axes=axes, known=self.known[picked], unit=self.unit[:, picked])


@dataclass(frozen=True, eq=False)
class KnownForcesFit:
    """Masses sought and the path.

    ``mass_kg`` (mass,) complex, ``covariance`` (2 mass, 2 mass) of real and imaginary part in turn, with
    ``freedom``. ``quiet``: the fit as the orders' own errors have it; ``by_order``: mean square of the errors of each
    order over what these allow. ``misfit``: share of the response that the path misses, 0 where errors explain it all.
    ``residue`` (channel, axis, term) in 1/kg (axis RY: 1/(kg·m)), with ``natural_hz`` and ``damping_ratio`` of the
    modes; the last term is (f / top)².
    """

    quiet: QuietFit
    axes: tuple[str, ...]
    mass_kg: Complexes
    covariance: Floats
    freedom: float
    by_order: dict[int, float]
    misfit: float
    residue: Complexes
    natural_hz: Floats
    damping_ratio: Floats

    def path(self, frequency_hz: Floats) -> Complexes:
        """Accelerance (channel, axis, frequency) at ``frequency_hz`` (frequency,)."""
        terms = _steady_terms(frequency_hz, self.natural_hz, self.damping_ratio, self.quiet.problem.top_hz)
        path: Complexes = np.einsum("cab,fb->caf", self.residue, terms)
        return path


@dataclass(frozen=True, eq=False)
class _Problem:
    measured: MeasuredOrders
    forces: OrderForces
    natural: Floats
    damping: Floats
    pole_root: Floats
    top_hz: float
    white: Complexes
    alike: Complexes


def modes_with_room(modal: ModalFit, *, axes: int, top_hz: float, rows: int) -> int | None:
    """How many modes of ``modal``, lowest first, a path may have; None where ``rows`` of known force do not suffice.

    ``axes``: directions of the forces. ``top_hz``: highest frequency. Modes up to ``near_ratio`` times that must have a
    term, those up to ``far_ratio`` times have one while each term stands on two rows.
    """
    least = sum(mode.frequency_hz < NUMBERS.near_ratio * top_hz for mode in modal.modes)
    most = sum(mode.frequency_hz < NUMBERS.far_ratio * top_hz for mode in modal.modes)
    return None if rows < rows_needed(least, axes=axes) else int(max(least, min(most, rows // (2 * axes) - 2)))


def rows_needed(n_modes: int, *, axes: int) -> int:
    """Rows of known force that a path with ``n_modes`` and so many ``axes`` needs at least."""
    return axes * (2 + n_modes) + 2


def quiet_fit(measured: MeasuredOrders, forces: OrderForces, modal: ModalFit, *, n_modes: int) -> QuietFit:
    """Masses and path that fit ``measured`` under ``forces`` best, with the lowest ``n_modes`` of ``modal``.

    Poles float within their covariance; residues and rigid part are complex and free, per channel and axis. Errors
    count channels as going together as the noise beside the orders does. Speeds that do not belong are left out (one
    in ten at most).
    Source: separable least squares (Golub and Pereyra 1973, in Kaufman's form 1975); covariance of an estimator whose
    weights are not those of its errors (White 1980).
    """
    problem = _problem(measured, forces, modal, n_modes)
    # from no mass, where the rows of known force alone tell the path, the first step takes the masses through it
    theta, fit = _solved(problem, np.zeros(2 * len(forces.unit) + problem.pole_root.shape[1]))
    odd: list[float] = []
    n_speeds = np.unique(measured.rpm_of_row).size
    while len(odd) < min(max(1, n_speeds // 10), MOST_ODD) and n_speeds >= 8:
        worst = _worst_speed(problem, fit)
        if worst is None:
            break
        odd.append(worst)
        problem = _problem(problem.measured.without(problem.measured.rpm_of_row == worst), forces, modal, n_modes)
        theta, fit = _solved(problem, theta, fit)
    return QuietFit(problem, theta, fit, tuple(sorted(odd)))


class _Fit(NamedTuple):
    """Left-over errors (channel, row) and their slopes (channel, row, parameter) over the errors; model; residues.

    ``path``: what :func:`_terms` made.
    """

    error: Complexes
    slope: Complexes
    model: Complexes
    residue: Complexes
    prior: Floats
    path: tuple[Complexes, Complexes]


class QuietFit(NamedTuple):
    """Masses and path as the orders' own errors have them, without ``odd_speeds_rpm``, before a misfit widens them."""

    problem: _Problem
    theta: Floats
    fit: _Fit
    odd_speeds_rpm: tuple[float, ...]

    @property
    def chi_square(self) -> float:
        """Mean square of the errors over what the orders' own errors allow."""
        return _chi_square(self.problem, self.fit)

    def gain_by(self, more: QuietFit) -> tuple[float, int]:
        """Squares that each number saves which ``more`` has, over what noise would; and how many these are."""
        measured, (own, other) = self.problem.measured, (self.fit, more.fit)
        numbers = 2 * (other.residue.size - own.residue.size)
        allowed = _variances(self.problem, power=1).sum() / max(1, np.count_nonzero(np.isfinite(measured.error)))
        fall = np.vdot(own.error, own.error).real - np.vdot(other.error, other.error).real
        return float(fall / numbers / (max(1.0, more.chi_square) * allowed)), numbers

    @property
    def is_sound(self) -> bool:
        """Whether errors explain all that is left."""
        # against the standard deviation of the mean square error, channels counted as telling the same
        return not self.chi_square > 1 + 2 * float(1.5 / np.sqrt(max(1.0, _free_rows(self.problem))))

    def widened(self) -> KnownForcesFit:
        """With the errors that the misfit of the path asks for."""
        sound = (0.0, self.problem, self.theta, self.fit)
        return _result(self, *(sound if self.is_sound else _with_misfit(*sound[1:])))


def _problem(measured: MeasuredOrders, forces: OrderForces, modal: ModalFit, n_modes: int) -> _Problem:
    top_hz = float(measured.frequency_hz.max())
    near = np.arange(len(modal.modes)) < n_modes  # they stand lowest first
    natural = np.array([mode.frequency_hz for mode in modal.modes])[near]
    damping = np.array([mode.damping_ratio for mode in modal.modes])[near]
    covariance = NUMBERS.pole_error_ratio**2 * modal.covariance[np.ix_(*2 * [np.repeat(near, 2)])]
    size, vectors = np.linalg.eigh(covariance) if near.any() else (np.zeros(0), np.zeros((0, 0)))
    root = vectors * np.sqrt(np.maximum(size, 0.0))
    alike = np.where((measured.noise_bins > 0)[:, None, None], np.eye(len(measured.channels)), measured.correlation)
    of_rows = OrderForces(forces.axes, forces.known[:, measured.place_of_row], forces.unit[..., measured.place_of_row])
    white = whitening(measured.noise, error=measured.error)
    return _Problem(measured, of_rows, natural, damping, root, top_hz, white, alike)


def _terms(problem: _Problem, natural: Floats, damping: Floats) -> tuple[Complexes, Complexes]:
    """What a force of ω² makes through the path in each row (row, term), and slopes by the poles (row, mode, 2)."""
    measured, top_hz = problem.measured, problem.top_hz
    grown = (measured.rpm_of_row * np.pi / 30)[:, None] ** 2
    terms = grown * _steady_terms(measured.frequency_hz, natural, damping, top_hz)
    resonant: Complexes = np.stack(resonance_slopes(measured.frequency_hz, natural, damping), axis=2)
    slopes: Complexes = np.multiply(grown[:, :, None], resonant, dtype=np.complex128)
    return terms, slopes / np.stack([natural, damping], axis=1)


def _steady_terms(frequency_hz: Floats, natural: Floats, damping: Floats, top_hz: float) -> Complexes:
    """Shape functions of a path (frequency, term): rigid body, the modes, and what lies above."""
    rigid, bent = np.ones((frequency_hz.size, 1)), (frequency_hz / top_hz)[:, None] ** 2
    return np.concatenate([rigid, resonance(frequency_hz, natural, damping), bent], axis=1, dtype=np.complex128)


def _poles(problem: _Problem, theta: Floats) -> tuple[Floats, Floats]:
    shift = problem.pole_root @ theta[2 * len(problem.forces.unit) :]
    natural = np.clip(problem.natural + shift[0::2], 0.5 * problem.natural, 2.0 * problem.natural)
    return natural, np.clip(problem.damping + shift[1::2], 0.1 * problem.damping, 0.99)


def _evaluated(problem: _Problem, theta: Floats, like: _Fit | None = None) -> _Fit:
    """Fit of ``problem`` where masses and poles are ``theta``; ``like``: one with these poles, whose path it has."""
    n_masses, n_rows = len(problem.forces.unit), problem.measured.rpm_of_row.size
    mass = theta[0 : 2 * n_masses : 2] + 1j * theta[1 : 2 * n_masses : 2]
    terms, bends = _terms(problem, *_poles(problem, theta)) if like is None else like.path
    acting = problem.forces.known + np.einsum("m,mar->ar", mass, problem.forces.unit)
    design = np.einsum("ar,rb->rab", acting, terms)
    n_channels = len(problem.measured.channels)
    columns = design.reshape(n_rows, -1)
    fitted = _fitting(columns, problem.white)
    terms_of, error = fitted(problem.white @ problem.measured.amplitude.T[..., None])
    residue = terms_of.reshape(n_channels, *design.shape[1:])
    by_mass = np.einsum("mar,rb,cab->rcm", problem.forces.unit, terms, residue)
    by_pole = np.einsum("ar,rjp,caj->rcjp", acting, bends, residue[:, :, 1:-1]).reshape(n_rows, n_channels, -1)
    turned = np.stack([by_mass, 1j * by_mass], axis=3).reshape(n_rows, n_channels, -1)
    free = np.concatenate([turned, by_pole @ problem.pole_root], axis=2)
    slope, model = fitted(problem.white @ free)[1].transpose(1, 0, 2), residue.reshape(n_channels, -1) @ columns.T
    return _Fit(error[..., 0].T, slope, model, residue, theta[2 * n_masses :], (terms, bends))


def _fitting(columns: Complexes, white: Complexes) -> Callable[[Complexes], tuple[Complexes, Complexes]]:
    """Least-squares fit of ``columns`` (row, term), with coefficients for each channel, to ``white`` sums of channels.

    ``white`` is (row, combination, channel). The function that is returned takes values (row, combination, any) and
    gives coefficients (channel, term, any) and residuals. The normal matrix, on an orthogonal basis of the columns of
    one channel, is factored once; a second fit, to the residuals, leaves rounding alone (iterative refinement). Where
    the matrix is nearly singular the whole design is solved by singular values instead.
    """
    from scipy.linalg import lapack

    shape = (white.shape[2], columns.shape[1], -1)
    size, weight = np.maximum(np.linalg.norm(columns, axis=0), 1e-300), np.linalg.norm(white, axis=(1, 2))[:, None]
    basis, triangle = np.linalg.qr(columns / size * weight)
    white_of = white / np.maximum(weight, 1e-300)[..., None]
    back = np.swapaxes(white_of.conj(), 1, 2)
    products = (basis.conj()[:, :, None] * basis[:, None]).reshape(len(basis), -1)
    normal = ((back @ white_of).reshape(len(basis), -1).T @ products).reshape(2 * shape[:1] + 2 * basis.shape[1:])
    root, failed = lapack.zpotrf(normal.swapaxes(1, 2).reshape(2 * (shape[0] * basis.shape[1],)), lower=1)
    ranks = [(np.abs(np.diag(root)), LEAST_PIVOT), (np.abs(np.diag(triangle)), 1e-9)]
    sound = not failed and len(basis) >= len(size) and all(p.min() > least * p.max() for p, least in ranks)

    def fitted(values: Complexes) -> tuple[Complexes, Complexes]:
        if not sound:
            every = np.einsum("rcd,rb->rcdb", white, columns / size).reshape(-1, shape[0] * shape[1])
            shares = np.linalg.lstsq(every, values.reshape(len(every), -1), rcond=1e-9)[0]
            return shares.reshape(shape) / size[:, None], values - (every @ shares).reshape(values.shape)
        shares, left = np.zeros((*shape[:2], values.shape[2]), dtype=np.complex128), values
        for _ in range(2):
            pulled = np.tensordot(back @ left, basis.conj(), (0, 0)).swapaxes(1, 2)
            more = lapack.zpotrs(root, pulled.reshape(len(root), -1), lower=1)[0].reshape(shape)
            shares, left = shares + more, left - white_of @ np.tensordot(basis, more, (1, 1))
        return np.linalg.solve(triangle, shares) / size[:, None], left

    return fitted


def _cost(fit: _Fit) -> float:
    """Sum of squares that the fit minimises: errors over theirs, and the poles' distance from where they were found."""
    return float((np.abs(fit.error) ** 2).sum() + (fit.prior**2).sum())


def _normal_matrix(problem: _Problem, slope: Complexes) -> Floats:
    """Normal matrix of the parameters, with the poles' own covariance as a unit prior."""
    matrix: Floats = np.einsum("crp,crq->pq", slope.conj(), slope, optimize=True).real
    n_masses = 2 * len(problem.forces.unit)
    matrix[np.arange(n_masses, len(matrix)), np.arange(n_masses, len(matrix))] += 1.0
    return matrix


def _solved(problem: _Problem, theta: Floats, like: _Fit | None = None) -> tuple[Floats, _Fit]:
    """Levenberg–Marquardt from ``theta``, where ``like`` is the fit to the same rows otherwise weighted."""
    fit, damped = _evaluated(problem, theta, like), 1e-3
    for _ in range(STEPS):
        matrix = _normal_matrix(problem, fit.slope)
        pull = np.einsum("crp,cr->p", fit.slope.conj(), fit.error).real
        pull[2 * len(problem.forces.unit) :] -= fit.prior
        step = np.linalg.lstsq(matrix + damped * np.diag(np.diag(matrix)), pull, rcond=None)[0]
        tried = _evaluated(problem, theta + step)
        fall = _cost(fit) - _cost(tried)
        if fall > 0:
            done = fall < SHRUNK * _cost(fit)
            theta, fit, damped = theta + step, tried, max(damped / 10, 1e-12)
            if done:
                break
        elif damped > MOST_DAMPED:
            break
        else:
            damped *= 10
    return theta, fit


def _variances(problem: _Problem, *, power: int) -> Floats:
    """Expected square of the real part of an error in each combination, (channel, row); 0 where nothing was measured.

    A weight that is made of the error itself is large where that was underestimated: what the error allows is larger
    on average, the more so where the weight enters in a higher ``power``, 1 for squares and 2 for covariance; likewise
    where the combination was chosen by few bins (mean of an inverse Wishart matrix).
    """
    measured = problem.measured
    known, freedom = np.isfinite(measured.error), measured.freedom
    own = np.where(known, np.where(known, measured.error, 1.0) / np.where(known, measured.steady_error, 1.0), 0.0) ** 2
    lucky = freedom / (freedom - 2 * power * measured.own_share)
    n_channels = len(known)
    bins = measured.noise_bins * BINS_WORTH
    chosen = np.where(bins > 0, (bins + 1.0 - n_channels) / np.maximum(bins - power * n_channels, 1.0), 1.0)
    both = (own * lucky).mean(axis=0)
    return np.asarray(np.where(measured.noise_bins > 0, both * chosen * known, own * lucky))


def _free_share(problem: _Problem) -> float:
    """Share of the squares that the fit leaves: measured numbers less those fitted, over those measured."""
    known = np.isfinite(problem.measured.error)
    measured = 2 * np.count_nonzero(known)
    n_terms = len(problem.forces.known) * (problem.natural.size + 2)
    fitted = 2 * n_terms * np.count_nonzero(known.any(axis=1)) + 2 * len(problem.forces.unit)
    return max(1e-3, 1.0 - float(fitted) / max(1.0, float(measured)))


def _free_rows(problem: _Problem) -> float:
    """Rows that are measured, less what the fit takes of them."""
    return np.count_nonzero(np.isfinite(problem.measured.error).any(axis=0)) * _free_share(problem)


def _chi_square(problem: _Problem, fit: _Fit) -> float:
    """Mean square of the errors of ``fit`` over what the orders' own errors allow."""
    allowed = 2 * _variances(problem, power=1).sum() * _free_share(problem)
    return float((np.abs(fit.error) ** 2).sum() / max(allowed, 1e-30))


def _worst_speed(problem: _Problem, fit: _Fit) -> float | None:
    """Speed in rpm whose rows fit worst; None where they fit no worse than chance and the other rows allow."""
    speeds, of = np.unique(problem.measured.rpm_of_row, return_inverse=True)
    allowed, squares = _variances(problem, power=1).sum(axis=0), np.square(np.abs(fit.error)).sum(axis=0)
    each = np.bincount(of, squares) / np.maximum(2.0 * np.bincount(of, allowed), 1e-30)
    worst = int(np.argmax(each))
    typical = max(1.0, float(np.median(each)))
    return float(speeds[worst]) if each[worst] > NUMBERS.odd_speed_ratio * typical else None


def _with_misfit(problem: _Problem, theta: Floats, fit: _Fit) -> tuple[float, _Problem, Floats, _Fit]:
    """Share of the response that must count as error for the fit to be as good as it should, and the fit with it."""
    low, high, widened, solved = 0.0, NUMBERS.largest_misfit_share, problem, (theta, fit)
    share = high
    for step in range(6):
        white = whitening(problem.measured.noise, error=problem.measured.error, missed=share * np.abs(fit.model))
        widened = replace(problem, white=white)
        solved = _solved(widened, theta, fit)
        too_little = _chi_square(widened, solved[1]) > 1
        if step == 0 and too_little:
            break
        low, high = (share, high) if too_little else (low, share)
        share = 0.5 * (low + high)
    return high, widened, *solved


def _result(quiet: QuietFit, misfit: float, problem: _Problem, theta: Floats, fit: _Fit) -> KnownForcesFit:
    measured, n_masses = problem.measured, 2 * len(problem.forces.unit)
    inverse = np.linalg.pinv(_normal_matrix(problem, fit.slope))
    swayed = fit.slope * np.sqrt(_variances(problem, power=2))[:, :, None]
    together = np.einsum("crp,rcd,drq->pq", swayed.conj(), problem.alike, swayed, optimize=True).real
    poles = np.diag((np.arange(theta.size) >= n_masses).astype(np.float64))
    covariance = inverse @ (max(1.0, _chi_square(problem, fit)) * together + poles) @ inverse
    mass = theta[0:n_masses:2] + 1j * theta[1:n_masses:2]
    squares = np.abs(fit.error) ** 2
    allowed = 2 * _variances(problem, power=1)
    of = measured.order_of_row
    natural, damping = _poles(problem, theta)
    # degrees of freedom of the first mass' variance, which rows of few have a share in (Satterthwaite 1946)
    pulls = swayed @ inverse[0]
    shares = np.einsum("cr,rcd,dr->r", pulls.conj(), problem.alike, pulls).real
    of_rows = np.min(np.where(np.isfinite(measured.error), measured.freedom, np.inf), axis=0)
    freedom = float(shares.sum() ** 2 / max((shares**2 / np.maximum(of_rows, 1.0)).sum(), 1e-300))
    return KnownForcesFit(
        quiet=quiet,
        axes=problem.forces.axes,
        mass_kg=mass,
        covariance=covariance[:n_masses, :n_masses] + np.diag(misfit**2 * np.repeat(np.abs(mass) ** 2, 2)),
        freedom=max(1.0, min(2.0 * _free_rows(problem), freedom)),
        by_order={k: float(squares[:, of == k].sum() / max(allowed[:, of == k].sum(), 1e-30)) for k in measured.orders},
        misfit=misfit,
        residue=fit.residue,
        natural_hz=natural,
        damping_ratio=damping,
    )


FORCE_NUMBERS = MethodNumbers("5-identify-balance.toml", "shaker_forces")

NONE_LEFT = 1e-9
"""Of one cylinder's force: what is left of several is rounding."""
UNIT_RPM = 30.0 / np.pi
"""Speed at which ω is 1: forces there are forces over ω²."""


class KnownForces(NamedTuple):
    """Orders of known force and orders whose masses are sought, with their forces.

    ``orders``: lowest first. ``sought``: (order, axis) of each mass sought; 1 kg of it makes the force
    ``per_kg`` (mass,) · r ω².
    """

    orders: tuple[int, ...]
    known_orders: tuple[int, ...]
    sought: tuple[tuple[int, str], ...]
    per_kg: Complexes
    forces: OrderForces


def known_forces(engine: Engine, *, seen: set[int], highest: int) -> KnownForces | str:
    """Forces of the orders of ``engine``; or, in words, why no order of it is of known force.

    ``seen``: orders above the floor. ``highest``: last order of the map. An order is of known force where pistons make
    it, no balance shaft takes it away, and it is not the first: what of that is left depends on counterweights.
    """
    if highest < 2:
        return "the order map ends below order 2"
    bare = engine.pistons_alone
    forces = crankcase_forces(bare, UNIT_RPM, max_order=highest)
    moments = crankcase_moments(bare, UNIT_RPM, max_order=highest)
    size = np.abs(forces).max(axis=0)
    alone = bare.model_copy(update={"cylinders": bare.cylinders[:1]})
    each = float(np.abs(crankcase_forces(alone, UNIT_RPM, max_order=1)).max())
    candidates = [k for k in range(2, highest + 1) if k not in engine.shafts.every_order and size[k] > NONE_LEFT * each]
    driven = [k for k in candidates if size[k] >= FORCE_NUMBERS.known_share * max(size[candidates])]
    if not driven:
        return "the pistons make no order that shafts do not take away, so no force is known"
    known = tuple(k for k in driven if k in seen)
    if not known:
        names = ", ".join(map(str, driven[:4]))
        return f"the orders of known force ({names}) do not stand above the floor, so the path is not identified"
    span = max(c.position_m for c in engine.cylinders) - min(c.position_m for c in engine.cylinders)
    rocking = np.abs(moments[[X, Z]][:, list(known)]).max(axis=0)
    allowed = FORCE_NUMBERS.rocking_share * span * np.abs(forces[:, list(known)]).max(axis=0)
    if span > 0 and (rocking > allowed).any():
        return (
            f"orders {known} rock the crankcase too, for the cylinders stand side by side, and that path is not known"
        )
    axes = [d for d in (X, Z) if np.abs(forces[d, list(known)]).max() > NONE_LEFT * np.abs(forces).max()]
    sought = [(1, d) for d in axes] + [(2, d) for d in axes if 2 in engine.shafts.every_order and d == Z]
    orders = (*sorted({order for order, _ in sought}), *known)
    along = np.where(np.isin(orders, known), forces[np.ix_(axes, orders)], 0)
    acting = np.concatenate([along, moments[[Y]][:, orders]])
    unit = np.zeros((len(sought), *acting.shape), dtype=np.complex128)
    per_kg = np.array([force_per_kg(bare, k, d, along_only=axes == [Z]) for k, d in sought])
    for m, (k, d) in enumerate(sought):
        unit[m, axes.index(d), orders.index(k)] = per_kg[m] * bare.crank_radius_m
    directions = tuple(DIRECTIONS[d] for d in axes)
    of_orders = OrderForces(axes=(*directions, "RY"), known=acting, unit=unit)
    return KnownForces(
        orders=orders,
        known_orders=known,
        sought=tuple((k, DIRECTIONS[d]) for k, d in sought),
        per_kg=per_kg,
        forces=of_orders if acting[-1].any() else of_orders.on(directions),
    )


def force_per_kg(bare: Engine, order: int, axis: int, *, along_only: bool) -> complex:
    """Force over r ω² of 1 kg: on every piston of ``bare``, or at the crank radius where that makes none.

    ``bare``: engine without shafts. ``order``: 1 or more. ``axis``: direction, 0 X, 1 Y, 2 Z. ``along_only``: forces
    act along Z alone; else 1 kg is one at the crank radius.
    """
    at_rpm = 1000.0
    scale = bare.reciprocating_mass_kg * bare.crank_radius_m * (at_rpm * np.pi / 30) ** 2
    force = complex(crankcase_forces(bare, at_rpm, max_order=order)[axis, order]) / scale
    return force if along_only and abs(force) > NONE_LEFT else 1.0 + 0.0j
