"""How orders drive the channels through the modes: complex amplitudes over the speeds, fitted with the same poles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.found import AgreedOrder, OrderResponse
from crankorder.identify.modal.surface_fit import NO_POLES, Poles, Problem, SurfaceFit, fit_surface

MODEL_ERROR = 1e-3
"""Relative error of an order's amplitude that the power law and the tracking are granted."""

EXPONENTS = (0.0, 1.0, 2.0, 3.0)
"""Powers of the speed that forces grow with: steady, …, inertia, and one more."""

WORST_CHANCE = 1e-3
"""Chance of a worse fit below which the model does not hold."""

REACH = (0.6, 2.0)
"""Share of the lowest and of the highest frequency swept within which a mode takes part in an order's response."""

INERTIA = 2.0
"""Power of the speed that needs no proof."""

CLEARLY = 9.0
"""Sum of squares by which another power must be better."""

HOPELESS = 100.0
"""Mean square misfit beyond which no small move of the poles helps."""

SPARE = 3
"""Complex amplitudes that an order must have over its unknowns."""

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]


@dataclass(frozen=True, eq=False)
class Block:
    """One order in one channel: ``amplitude`` (K,) complex with ``error`` (K,) per part at ``frequency_hz`` (K,).

    ``growth`` (K,) is (speed / ``reference_rpm``)**``exponent``.
    """

    order: float
    channel: str
    number: int
    frequency_hz: Array
    speed_rpm: Array
    amplitude: Complex
    error: Array
    reference_rpm: float
    exponent: float

    @property
    def growth(self) -> Array:
        """What the force's law makes of the speeds."""
        return np.asarray((self.speed_rpm / self.reference_rpm) ** self.exponent)

    def reached(self, poles: Poles) -> NDArray[np.int64]:
        """Numbers of the modes that the order sweeps through or near.

        ``poles``: those of the fit.
        """
        low, high = REACH[0] * self.frequency_hz.min(), REACH[1] * self.frequency_hz.max()
        return np.flatnonzero((poles.frequency_hz >= low) & (poles.frequency_hz <= high) & ~poles.tone)


@dataclass(frozen=True, eq=False)
class Blocks:
    """Orders that take part in a joint fit; ``fixed`` are further poles behind them, which other bands tell."""

    items: tuple[Block, ...]
    fixed: Poles = NO_POLES

    def evaluate(self, poles: Poles) -> tuple[list[Array], list[Array], float]:
        """Jacobians by (ln f, ln ζ), residuals (both in standard errors, real parts first) and their squares' sum.

        ``poles``: those of the fit.
        """
        parts = [project(block, poles.joined(self.fixed)) for block in self.items]
        chi2 = float(sum(part.chi2 for part in parts))
        return [part.jacobian[:, : 2 * len(poles)] for part in parts], [part.residual for part in parts], chi2


@dataclass(frozen=True, eq=False)
class Projected:
    """Linear terms (rigid, residues of ``reached`` modes) of a block and what they leave of it."""

    linear: Complex
    reached: NDArray[np.int64]
    jacobian: Array
    residual: Array
    chi2: float
    freedom: int

    @property
    def holds(self) -> bool:
        """Whether chance makes such a misfit at least once in a thousand."""
        from scipy.special import chdtrc

        return self.freedom > 0 and float(chdtrc(self.freedom, self.chi2)) >= WORST_CHANCE


def blocks_of(order_map: xr.Dataset, orders: tuple[AgreedOrder, ...]) -> tuple[Block, ...]:
    """Blocks of the locked ``orders`` in the channels that show them, from the OrderMap ``order_map``.

    Orders without a phase, or at fewer speeds than the model has unknowns, have none.
    """
    grid, speed = order_map["order"].values, order_map["speed"].values
    names = [str(name) for name in order_map["channel"].values]
    made: list[Block] = []
    if not len(grid):
        return ()
    for agreed in orders:
        column = int(np.argmin(np.abs(grid - agreed.order)))
        if agreed.lock != "locked" or abs(grid[column] - agreed.order) > 1e-3 * max(1.0, agreed.order):
            continue
        for line in agreed.lines:
            channel = names.index(line.channel)
            at = (channel, slice(None), column)
            size = order_map["coherent_amplitude"].values[at].astype(np.float64)
            phase, error = order_map["phase"].values[at], order_map["standard_error"].values[at].astype(np.float64)
            freedom = order_map["degrees_of_freedom"].values[at]
            used = np.isfinite(size) & np.isfinite(phase) & np.isfinite(error) & (freedom >= 3) & (error > 0.0)
            used &= np.isfinite(speed) & (speed > 0.0)
            if np.count_nonzero(used) < SPARE + 1:
                continue
            wide = error[used] * np.sqrt(freedom[used] / np.maximum(freedom[used] - 2.0, 1.0))
            made.append(
                Block(
                    agreed.order,
                    line.channel,
                    channel,
                    agreed.order * speed[used] / 60.0,
                    speed[used],
                    size[used] * np.exp(1j * np.radians(phase[used])),
                    np.hypot(wide, MODEL_ERROR * size[used]),
                    float(speed[used].max()),
                    2.0,
                )
            )
    return tuple(made)


def response(frequency_hz: Array, natural_hz: Array, damping: Array) -> tuple[Complex, ...]:
    """h_j (K, M) = −x² / (1 − x² + 2iζx), x = f / f_j, and its derivatives by ln f_j and by ln ζ_j.

    ``frequency_hz``: in Hz; ``natural_hz``: of the modes in Hz; ``damping``: their ratios.
    """
    x = frequency_hz[:, None] / natural_hz
    under = 1.0 - x**2 + 2j * damping * x
    over = 1.0 / under
    by_x = -2.0 * x * over + x**2 * (-2.0 * x + 2j * damping) * over**2
    by_damping = 2j * damping * x**3 * over**2
    return tuple(np.asarray(part, dtype=np.complex128) for part in (-(x**2) * over, -x * by_x, by_damping))


def project(block: Block, poles: Poles) -> Projected:
    """``block`` with its linear terms eliminated for given ``poles`` (Golub and Pereyra 1973)."""
    reached = block.reached(poles)
    if len(block.amplitude) < 1 + len(reached) + SPARE:
        reached = reached[np.argsort(np.abs(np.log(poles.frequency_hz[reached] / block.frequency_hz.max())))]
        reached = np.sort(reached[: max(0, len(block.amplitude) - 1 - SPARE)])
    h, by_f, by_zeta = response(block.frequency_hz, poles.frequency_hz[reached], poles.damping[reached])
    weight = (block.growth / block.error)[:, None]
    design = np.concatenate([np.ones((len(h), 1)), h], axis=1) * weight
    scale = np.linalg.norm(design, axis=0)
    q, r = np.linalg.qr(design / scale)
    measured = block.amplitude / block.error
    along = q.conj().T @ measured
    linear = np.linalg.lstsq(r, along, rcond=1e-10)[0] / scale
    left = measured - q @ along
    jacobian = np.zeros((len(h), 2 * len(poles)), dtype=complex)
    jacobian[:, 2 * reached] = by_f * linear[1:] * weight
    jacobian[:, 2 * reached + 1] = by_zeta * linear[1:] * weight
    jacobian -= q @ (q.conj().T @ jacobian)
    chi2 = float(np.sum(np.abs(left) ** 2))
    freedom = 2 * (len(h) - 1 - len(reached))
    parts = [np.concatenate([part.real, part.imag]) for part in (jacobian, left)]
    return Projected(linear, reached, parts[0], parts[1], chi2, freedom)


def with_best_exponents(blocks: tuple[Block, ...], poles: Poles) -> tuple[Block, ...]:
    """``blocks`` with the power of the speed, common to an order's channels, by which the ``poles`` explain them best.

    Inertia (2) is believed unless another power explains clearly more.
    """
    made: list[Block] = []
    for order in sorted({block.order for block in blocks}):
        mine = [block for block in blocks if block.order == order]
        missed = {
            n: sum(project(replace(block, exponent=n), poles).chi2 for block in mine) + (n != INERTIA) * CLEARLY
            for n in EXPONENTS
        }
        best = min(missed, key=missed.__getitem__)
        made += [replace(block, exponent=best) for block in mine]
    return tuple(made)


def fitting(
    problem: Problem, fit: SurfaceFit, blocks: tuple[Block, ...], *, fixed: Poles = NO_POLES
) -> tuple[Problem, SurfaceFit]:
    """Joint fit of ``problem`` with those of ``blocks`` that the same poles, and the ``fixed`` ones, explain.

    Orders that the ``fit`` of the floor explains as it stands take part; each other one is tried, and kept where it
    is explained after the joint fit without spoiling the rest.
    """
    blocks = with_best_exponents(blocks, fit.poles.joined(fixed))
    blocks = tuple(block for block in blocks if len(block.reached(fit.poles)) or not len(fixed))
    good = tuple(block for block in blocks if project(block, fit.poles.joined(fixed)).holds)
    rest = sorted({block.order for block in blocks} - {block.order for block in good})
    if good:
        problem = replace(problem, others=Blocks(good, fixed))
        fit = fit_surface(problem, fit.poles, start=fit.model, steps=10)
    for order in rest:
        more = tuple(block for block in blocks if block.order == order and len(block.reached(fit.poles)))
        if not more or min(_misfit(block, fit.poles.joined(fixed)) for block in more) > HOPELESS:
            continue
        trial_problem = replace(problem, others=Blocks(good + more, fixed))
        trial = fit_surface(trial_problem, fit.poles, start=fit.model, steps=10)
        if all(project(block, trial.poles.joined(fixed)).holds for block in good + more):
            problem, fit, good = trial_problem, trial, good + more
    return problem, fit


def _misfit(block: Block, poles: Poles) -> float:
    part = project(block, poles)
    return part.chi2 / max(part.freedom, 1)


def responses_of(used: tuple[Block, ...], blocks: tuple[Block, ...], modes: Poles) -> tuple[OrderResponse, ...]:
    """OrderResponse of each of ``blocks`` for the ``modes``; those of ``used`` as they took part in the fit."""
    exponent = {(block.order, block.channel): block.exponent for block in used}
    best = with_best_exponents(blocks, modes)
    made = []
    for block in best:
        item = replace(block, exponent=exponent.get((block.order, block.channel), block.exponent))
        part = project(item, modes)
        residue = np.zeros(len(modes), dtype=complex)
        residue[part.reached] = part.linear[1:]
        made.append(
            OrderResponse(
                item.order,
                item.channel,
                item.exponent,
                item.reference_rpm,
                complex(part.linear[0]),
                residue,
                part.holds,
            )
        )
    return tuple(made)
