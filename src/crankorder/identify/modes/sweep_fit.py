"""All recordings at one place of frequency behind common poles: how these are moved to where they fit best."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from crankorder.identify.modes.order_responses import resonance
from crankorder.identify.modes.surface_fit import neighbours_together
from crankorder.identify.modes.sweep_window import BEND_SPREAD, Solved, Window
from crankorder.quantities import Complexes, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "sweep_fit")

LIGHTEST, HEAVIEST = 1e-4, 0.5
"""Damping ratios that a fit may come to."""

LARGEST_STEP = 0.4
"""Largest step of a fit: of a frequency as a share of its half width, of the logarithm of a damping. That of a bend is
its spread: over a window's logarithms of the speed it turns the force by as little."""

SETTLED = 0.1
"""Square of the standard errors, those of the model among them, that a step must move the poles to be followed."""

TRIES = 5
"""Times that a step is tried, each ten times more damped than the one before."""
NOISE_ROUNDS = 4
"""Rounds in which the shape of the noise settles."""

LEAST_REACHED = 1e-6
"""Share of a column's square beyond all others from which one pole more is told by it."""

TRIED_DAMPING = (0.003, 0.015, 0.06)
"""Damping ratios that are tried as a start; frequencies lie as far apart as each is wide."""

ROUNDED = 1.0 + 1e-9
"""Ratio up to which a start at the end of a tile is none beyond it."""

LAGS = 3
"""Bins beside one another whose errors may go together."""

MOST_VALUES = 1 << 20
"""Bins, times places of one pole more, that are told at a time."""


@dataclass(frozen=True, eq=False)
class LocalFit:
    """``windows`` of all recordings at one place of frequency behind common poles ``natural_hz``, ``damping`` (M,)."""

    windows: tuple[Window, ...]
    natural_hz: Floats
    damping: Floats

    @cached_property
    def solved(self) -> tuple[Solved, ...]:
        """Each window with its amplitudes."""
        return tuple(window.solved(self.natural_hz, self.damping) for window in self.windows)

    @property
    def bare(self) -> LocalFit:
        """The fit without what was reckoned of it: columns and forces of a long recording are large."""
        windows = tuple(replace(window, _made={}, _unbent={}, _passages={}) for window in self.windows)
        return LocalFit(windows, self.natural_hz, self.damping)

    @property
    def poles(self) -> list[tuple[float, float]]:
        """Natural frequency and damping ratio of each pole."""
        return list(zip(self.natural_hz.tolist(), self.damping.tolist(), strict=True))

    @cached_property
    def orders(self) -> tuple[float, ...]:
        """Orders that pass any of the windows."""
        return tuple(sorted({order for window in self.windows for order in window.orders}))

    @cached_property
    def bends(self) -> Complexes:
        """Bend (orders,) of the force of each of the orders."""
        every = {order: bend for window in self.windows for order, bend in window.bends.items()}
        return np.array([every.get(order, 0j) for order in self.orders], dtype=np.complex128)

    @cached_property
    def misfit(self) -> float:
        """Squares that are left, and those by which the forces differ from what is usual."""
        left = sum(solved.misfit for solved in self.solved)
        return float(left + np.sum(np.abs(self.bends) ** 2) / (2.0 * BEND_SPREAD**2))

    @cached_property
    def freedom(self) -> int:
        """Complex numbers beyond the amplitudes."""
        return sum(solved.freedom for solved in self.solved)

    def normal(self) -> tuple[Floats, Floats]:
        """Normal matrix (P, P) and right side (P,) of poles, then bends (real, imaginary)."""
        parts = [solved.normal(self.orders) for solved in self.solved]
        matrix, side = (np.sum(part, axis=0) for part in zip(*parts, strict=True))
        place = np.arange(2 * len(self.natural_hz), len(side))
        matrix[place, place] += 1.0 / (2.0 * BEND_SPREAD**2)
        side[place] -= np.stack([self.bends.real, self.bends.imag], axis=1).ravel() / (2.0 * BEND_SPREAD**2)
        return matrix, side

    def moved(self, step: Floats) -> LocalFit:
        """The fit after ``step`` (P,) of the poles and bends."""
        count = 2 * len(self.natural_hz)
        by_f = np.clip(step[:count:2], -LARGEST_STEP * self.damping, LARGEST_STEP * self.damping)
        by_zeta = np.clip(step[1:count:2], -LARGEST_STEP, LARGEST_STEP)
        turned = np.clip(step[count:], -BEND_SPREAD, BEND_SPREAD).reshape(-1, 2)
        bends = dict(zip(self.orders, (self.bends + turned[:, 0] + 1j * turned[:, 1]).tolist(), strict=True))
        windows = tuple(replace(window, bends=bends) for window in self.windows)
        damping = np.clip(self.damping * np.exp(by_zeta), LIGHTEST, HEAVIEST)
        return LocalFit(windows, self.natural_hz * np.exp(by_f), damping)

    def settled(self, *, rounds: int, steps: int) -> LocalFit:
        """Where the misfit is smallest near by (Levenberg and Marquardt).

        The noise is told anew ``rounds`` times, with ``steps`` between at most.
        """
        fit = self.with_noise()
        for _ in range(rounds if len(self.natural_hz) else 1):
            fit = fit.descended(steps).with_noise()
        return fit

    def descended(self, steps: int) -> LocalFit:
        """After ``steps`` downhill at most, the noise being as it is.

        None follows one that moved the poles by little of what noise and model let be known of them: better data ask
        for no more work.
        """
        fit, damped, count = self, 1e-3, 2 * len(self.natural_hz)
        for _ in range(steps if count else 0):
            matrix, side = fit.normal()
            diagonal = np.diag(np.diag(matrix) + 1e-12)
            for _ in range(TRIES):
                step = np.asarray(np.linalg.solve(matrix + damped * diagonal, side), dtype=np.float64)
                trial = fit.moved(step)
                if trial.misfit < fit.misfit:
                    break
                damped *= 10.0
            else:
                break
            known = 0.5 * np.linalg.inv(matrix + damped * diagonal)[:count, :count] + fit.model_variance
            moved = step[:count] @ np.linalg.solve(known, step[:count])
            fit, damped = trial, max(0.1 * damped, 1e-6)
            if moved < SETTLED:
                break
        return fit

    @property
    def model_variance(self) -> Floats:
        """Model-error variance (2 M, 2 M) of (ln f, ln ζ) of the poles."""
        shares = NUMBERS.frequency_model_share * self.damping, np.full(len(self.damping), NUMBERS.damping_model_share)
        return np.diag(np.square(np.stack(shares, axis=1)).ravel())

    def with_noise(self) -> LocalFit:
        """The fit with shape and level of the noise estimated from the residuals, and the model error."""
        windows = []
        for solved in self.solved:
            window = solved.window
            left = np.square(np.abs(solved.left) * window.shape[:, None] * window.level)
            left *= len(left) / max(len(left) - len(solved.scale), 1)
            left += np.square(NUMBERS.bin_model_share * np.abs(window.measured.T))
            level = np.sqrt(np.maximum(left.mean(axis=0), 1e-300))
            power = (left / np.maximum(left.mean(axis=0), 1e-300)).mean(axis=1)
            shape = np.sqrt(_noise_power(power, window.frequency_hz, self.natural_hz, self.damping))
            windows.append(replace(window, shape=shape, level=level))
        return LocalFit(tuple(windows), self.natural_hz, self.damping)

    def with_pole(self, natural_hz: float, damping: float) -> LocalFit:
        """With one pole more, of ``natural_hz`` and ``damping``."""
        return LocalFit(self.windows, np.append(self.natural_hz, natural_hz), np.append(self.damping, damping))

    def covariance(self) -> Floats:
        """Covariance (2 M, 2 M) of (ln f, ln ζ) of the poles: what the scores of the bins really scatter by.

        Channels share what excites the structure beside the orders, and neighbouring bins what no model knows.
        """
        matrix, _ = self.normal()
        scatter = np.zeros_like(matrix)
        for solved in self.solved:
            scatter += neighbours_together(solved.scores(self.orders), LAGS)
        inverse = np.linalg.pinv(matrix, hermitian=True)
        robust = inverse @ scatter @ inverse
        plain = 0.5 * inverse * max(1.0, sum(solved.misfit for solved in self.solved) / max(self.freedom, 1))
        count = 2 * len(self.natural_hz)
        # the larger of both: few bins scatter by chance less than they may
        wide = np.sqrt(np.maximum(np.diag(robust), np.diag(plain)) / np.maximum(np.diag(robust), 1e-300))
        return np.asarray((robust * wide * wide[:, None])[:count, :count])

    def gain(self, number: int) -> float:
        """What the pole ``number`` saves of twice the negative log likelihood, the others staying where they are."""
        kept = np.arange(len(self.natural_hz)) != number
        return 2.0 * (LocalFit(self.windows, self.natural_hz[kept], self.damping[kept]).misfit - self.misfit)

    def share(self, number: int) -> float:
        """Largest part of the amplitude of an order, in any channel, that pole ``number`` makes at its peak."""
        return max(float(shares_of(solved, number).max()) for solved in self.solved)


class OnePoleMore(NamedTuple):
    """One pole more at each of S places: ``residues`` (S, orders, C), their ``variance``, what it ``saves`` (S,).

    The residues have the unit of the window's amplitudes; a variance is a complex number's whole one, infinite where
    the order does not reach the place. What is saved is of twice the negative log likelihood.
    """

    residues: Complexes
    variance: Floats
    saves: Floats

    @classmethod
    def of(cls, solved: Solved, natural_hz: Floats, damping: Floats) -> OnePoleMore:
        """In ``solved`` window at ``natural_hz``, ``damping`` (S,), with amplitudes of its own in each channel.

        So many places are told at a time that the memory does not grow with the recording.
        """
        parts = min(1 + len(solved.left) * len(natural_hz) // MOST_VALUES, len(natural_hz))
        if parts > 1:
            places = zip(np.array_split(natural_hz, parts), np.array_split(damping, parts), strict=True)
            pieces = (cls.of(solved, *some) for some in places)
            return cls(*(np.concatenate(each) for each in zip(*pieces, strict=True)))
        window = solved.window
        answers = resonance(window.frequency_hz, natural_hz, damping)
        power = np.square(np.abs(answers))
        # what rings is, but for a smooth factor, a response to a force that falls with the square of the frequency
        rung = np.full(len(window.frequency_hz), 1.0 + 0j) / np.square(window.frequency_hz / window.frequency_hz.mean())
        forces = [window.force(order) / window.shape for order in window.orders] + [rung / window.shape]
        matrix = _shared(solved, forces, answers, power)
        side = np.stack([(solved.left.T * force.conj()) @ answers.conj() for force in forces])  # (orders, C, S)
        own = np.einsum("sii->si", matrix).real
        whole = np.stack([np.square(np.abs(force)) @ power for force in forces], axis=1)
        reached = own > LEAST_REACHED * whole
        scale = np.where(reached, 1.0 / np.sqrt(np.maximum(own, 1e-300)), 0.0)
        matrix = matrix * scale[:, :, None] * scale[:, None, :] + LEAST_REACHED * np.eye(len(forces))
        inverse = np.linalg.inv(matrix)
        wanted = np.moveaxis(side, 2, 0) * scale[:, :, None]
        residues = inverse @ wanted
        saves = 2.0 * np.sum(wanted.conj() * residues, axis=(1, 2)).real
        spread = np.einsum("sii->si", inverse).real * np.square(scale)
        variance = np.where(reached, spread, np.inf)[:, :-1, None] * np.square(window.level)
        return cls((residues * scale[:, :, None])[:, :-1] * window.level, np.asarray(variance), np.asarray(saves))


@dataclass(frozen=True, eq=False)
class Starts:
    """Places ``natural_hz`` and ``damping`` (S,) for one pole more: ``low_hz`` to ``high_hz``, one beyond each end.

    ``saves`` (S,) is what each would save, ``unknowns`` how many numbers it would take for that.
    """

    low_hz: float
    high_hz: float
    natural_hz: Floats
    damping: Floats
    saves: Floats
    unknowns: int

    @classmethod
    def of(cls, fit: LocalFit, low_hz: float, high_hz: float) -> Starts:
        """Starts from ``low_hz`` to ``high_hz`` beside the poles of ``fit``."""
        step, wide = 1.0 / max(window.sweep.length_s for window in fit.windows) / low_hz, np.log(high_hz / low_hz)
        counts = [max(2, int(np.ceil(wide / max(zeta, step)))) for zeta in TRIED_DAMPING]
        places = [np.arange(-1, count + 1) / (count - 1) for count in counts]
        natural = low_hz * np.exp(wide * np.concatenate(places))
        damping = np.repeat(TRIED_DAMPING, np.array(counts) + 2)
        saves, unknowns = np.zeros(len(natural)), 2
        for solved in fit.solved:
            saves += OnePoleMore.of(solved, natural, damping).saves
            unknowns += 2 * (len(solved.window.orders) + 1) * solved.left.shape[1]
        return cls(low_hz, high_hz, natural, damping, saves, unknowns)

    @property
    def best(self) -> tuple[float, float]:
        """Natural frequency and damping ratio of the start that saves most."""
        at = int(np.argmax(self.saves))
        return float(self.natural_hz[at]), float(self.damping[at])

    @property
    def beyond(self) -> int:
        """-1 or 1 where the best one lies below or above the ends: what it saves is a pole's of the tile there."""
        return int(self.best[0] > self.high_hz * ROUNDED) - int(self.best[0] < self.low_hz / ROUNDED)

    @property
    def inside(self) -> Starts:
        """Those that lie between the ends."""
        inner = (self.natural_hz >= self.low_hz / ROUNDED) & (self.natural_hz <= self.high_hz * ROUNDED)
        return replace(self, saves=np.where(inner, self.saves, 0.0))

    def limit(self, chance: float) -> float:
        """What noise saves at the best of them by ``chance``."""
        return float(chdtri(self.unknowns, chance / len(self.saves)))


def _shared(solved: Solved, forces: list[Complexes], answers: Complexes, power: Floats) -> Complexes:
    """Gram matrices (S, orders, orders) of ``forces`` (each (B,)) times ``answers`` (B, S), beyond the columns.

    ``power`` (B, S): squares of the answers.
    """
    basis, count = (solved.columns @ solved.inverse).conj().T, len(forces)
    within = np.stack([(basis * force) @ answers for force in forces])
    first, second = np.triu_indices(count)
    pairs = np.stack(forces)[first].conj() * np.stack(forces)[second]
    shared = pairs.real @ power + 1j * (pairs.imag @ power)
    matrix = np.empty((answers.shape[1], count, count), dtype=np.complex128)
    matrix[:, first, second] = shared.T
    matrix[:, second, first] = shared.T.conj()
    within = np.moveaxis(within, 2, 0)
    return np.asarray(matrix - within.conj() @ np.swapaxes(within, 1, 2))


def _noise_power(power: Floats, frequency_hz: Floats, natural_hz: Floats, damping: Floats) -> Floats:
    """Power (B,) of the noise at ``frequency_hz`` (B,), of which ``power`` (B,) is a sample.

    What excites the modes beside the orders peaks where they answer, in fewer bins than smoothing leaves apart.
    ``natural_hz`` and ``damping`` (M,): of the modes.
    """
    if not len(natural_hz):
        return _smoothed(power)
    from scipy.optimize import nnls

    place = np.linspace(0.0, 1.0, len(power))[:, None]
    answers = np.square(np.abs(resonance(frequency_hz, natural_hz, damping)))
    basis = np.concatenate([place, 1.0 - place, answers / np.maximum(answers.max(axis=0), 1e-300)], axis=1)
    peaked = np.full(len(power), power.mean())
    for _ in range(NOISE_ROUNDS):
        # a power scatters by itself
        peaked = np.maximum(basis @ nnls(basis / peaked[:, None], power / peaked)[0], 1e-3 * power.mean())
    return np.asarray(_smoothed(power / peaked) * peaked)


def _smoothed(power: Floats) -> Floats:
    """``power`` (B,) over the bins, smoothed; no less anywhere than a share of its mean."""
    half = int(np.clip(NUMBERS.smoothed_share * len(power), 12, len(power) - 1))
    window = np.hanning(2 * half + 3)[1:-1]
    padded = np.pad(power, half, mode="reflect" if half < len(power) - 1 else "edge")
    smooth = np.convolve(padded, window / window.sum(), mode="valid")
    return np.asarray(np.maximum(smooth, NUMBERS.least_noise_share * power.mean()))


def shares_of(solved: Solved, number: int) -> Floats:
    """Part (orders, C) of each order's amplitude in ``solved`` window that pole ``number`` makes at its peak.

    It is 0 of those that miss it.
    """
    window = solved.window
    peak, zeta = solved.natural_hz[number], solved.damping[number]
    basis = window.paths(solved.natural_hz, solved.damping, np.array([peak]))[0]
    shares = np.zeros((len(window.orders), solved.left.shape[1]))
    for row, order in enumerate(window.orders):
        if window.sweep.passes(order, (1.0 - zeta) * peak, (1.0 + zeta) * peak):
            parts = basis[:, None] * solved.by_order[row]
            own = parts[window.degree + 1 + number]
            shares[row] = np.abs(own) / np.maximum(np.abs(own) + np.abs(parts.sum(axis=0) - own), 1e-300)
    return shares
