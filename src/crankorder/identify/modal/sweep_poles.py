"""Natural frequencies that sweeps tell: poles of the signals themselves, window by window of frequency."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.modal.sweep_window import BEND_SPREAD, Solved, SweepSpectrum, Window
from crankorder.identify.resonance import resonance
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-modal.toml", table="sweep_poles"):
    tile_share: float
    apart_share: float
    order_share: float
    beside_share: float
    blurs: float
    widths: float
    fewest_bins: int
    search_degree: int
    degrees: tuple[int, int]
    most_poles: int
    felt_share: float
    proof_chance: float
    frequency_model_share: float
    damping_model_share: float
    known_share: float
    smoothed_share: float
    least_noise_share: float
    lowest_hz: float
    highest_hz: float
    most_tiles: int


NUMBERS = _Numbers.load()

TRIED_DAMPING = (0.003, 0.015, 0.06)
"""Damping ratios that are tried as a start; frequencies lie as far apart as each is wide."""

LIGHTEST, HEAVIEST = 1e-4, 0.5
"""Damping ratios that a fit may come to."""

LARGEST_STEP = 0.4
"""Largest step of a fit: of a frequency as a share of its half width, of the logarithm of a damping, of a bend."""

SETTLED = 0.1
"""Misfit that a step must save to be followed by another."""

ROUGHLY = {"rounds": 1, "steps": 6}
EXACTLY = {"rounds": 2, "steps": 6}
"""Times that the noise is told anew, and steps between: while poles are looked for, and in the end."""

LAGS = 3
"""Bins beside one another whose errors may go together."""

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]


@dataclass(frozen=True, eq=False)
class SweepPole:
    """A pole in the signals of sweeps: ``frequency_hz``, ``damping``, ``covariance`` (2, 2) of (ln f, ln ζ).

    ``channels`` show it; ``orders`` are those whose amplitudes prove it, by chance no more often than stated;
    ``span_hz`` is what they passed; ``share`` the largest part of an order's amplitude that it makes at its peak.
    """

    frequency_hz: float
    damping: float
    covariance: Array
    channels: tuple[str, ...]
    orders: tuple[float, ...]
    span_hz: tuple[float, float]
    share: float

    @property
    def covariance_of_values(self) -> Array:
        """Covariance (2, 2) of frequency, Hz, and damping ratio."""
        values = np.array([self.frequency_hz, self.damping])
        return np.asarray(self.covariance * values * values[:, None])

    @property
    def frequency_error_hz(self) -> float:
        """Standard error of the frequency."""
        return float(self.frequency_hz * np.sqrt(self.covariance[0, 0]))

    @property
    def damping_error(self) -> float:
        """Standard error of the damping ratio."""
        return float(self.damping * np.sqrt(self.covariance[1, 1]))


@dataclass(frozen=True, eq=False)
class LocalFit:
    """``windows`` of all recordings at one place of frequency behind common poles ``natural_hz``, ``damping`` (M,)."""

    windows: tuple[Window, ...]
    natural_hz: Array
    damping: Array

    @cached_property
    def solved(self) -> tuple[Solved, ...]:
        """Each window with its amplitudes."""
        return tuple(window.solved(self.natural_hz, self.damping) for window in self.windows)

    @cached_property
    def orders(self) -> tuple[float, ...]:
        """Orders that pass any of the windows."""
        return tuple(sorted({order for window in self.windows for order in window.orders}))

    @cached_property
    def bends(self) -> Complex:
        """Bend of the force of each of the orders."""
        every = {order: bend for window in self.windows for order, bend in window.bends.items()}
        return np.array([every.get(order, 0j) for order in self.orders], dtype=np.complex128)

    @cached_property
    def misfit(self) -> float:
        """Squares that are left, and those by which the forces differ from what is usual."""
        left = sum(one.misfit for one in self.solved)
        return float(left + np.sum(np.abs(self.bends) ** 2) / (2.0 * BEND_SPREAD**2))

    @cached_property
    def freedom(self) -> int:
        """Complex numbers beyond the amplitudes."""
        return sum(one.freedom for one in self.solved)

    def normal(self) -> tuple[Array, Array, list[Array]]:
        """Normal matrix (P, P), right side (P,) and scores by bin (B, P) of poles, then bends (real, imaginary)."""
        orders = self.orders
        size = 2 * len(self.natural_hz) + 2 * len(orders)
        matrix, side = np.zeros((size, size)), np.zeros(size)
        scores = []
        for one in self.solved:
            bent = one.slopes_of_bends(orders)
            both = np.stack([bent, 1j * bent], axis=3).reshape(*bent.shape[:2], -1)
            rows = np.concatenate([one.slopes(), both], axis=2)
            flat, left = rows.reshape(-1, size), one.left.ravel()
            matrix += (flat.conj().T @ flat).real
            side += (flat.conj().T @ left).real
            scores.append(np.einsum("bcp,bc->bp", rows.conj(), one.left).real)
        place = np.arange(2 * len(self.natural_hz), size)
        matrix[place, place] += 1.0 / (2.0 * BEND_SPREAD**2)
        side[place] -= np.stack([self.bends.real, self.bends.imag], axis=1).ravel() / (2.0 * BEND_SPREAD**2)
        return matrix, side, scores

    def moved(self, step: Array) -> LocalFit:
        """The fit after ``step`` (P,) of the poles and bends."""
        count = 2 * len(self.natural_hz)
        by_f = np.clip(step[:count:2], -LARGEST_STEP * self.damping, LARGEST_STEP * self.damping)
        by_zeta = np.clip(step[1:count:2], -LARGEST_STEP, LARGEST_STEP)
        turned = np.clip(step[count:], -LARGEST_STEP, LARGEST_STEP).reshape(-1, 2)
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
        """After ``steps`` downhill at most, the noise being as it is."""
        fit, damped = self, 1e-3
        for _ in range(steps if len(self.natural_hz) else 0):
            matrix, side, _ = fit.normal()
            diagonal = np.diag(np.diag(matrix) + 1e-12)
            better = None
            for _ in range(5):
                trial = fit.moved(np.asarray(np.linalg.solve(matrix + damped * diagonal, side), dtype=np.float64))
                if trial.misfit < fit.misfit:
                    better = trial
                    break
                damped *= 10.0
            if better is None:
                break
            saved, fit, damped = fit.misfit - better.misfit, better, max(0.1 * damped, 1e-6)
            if saved < SETTLED:
                break
        return fit

    def with_noise(self) -> LocalFit:
        """With shape and level of the noise as what is left has them."""
        windows = []
        for one in self.solved:
            window = one.window
            left = np.square(np.abs(one.left)) * np.square(window.shape)[:, None]
            left *= len(left) / max(len(left) - len(one.scale), 1)
            level = np.sqrt(np.maximum(left.mean(axis=0), 1e-300)) * window.level
            shape = np.sqrt(_smoothed((left / np.maximum(left.mean(axis=0), 1e-300)).mean(axis=1)))
            windows.append(replace(window, shape=shape, level=level))
        return LocalFit(tuple(windows), self.natural_hz, self.damping)

    def with_pole(self, natural_hz: float, damping: float) -> LocalFit:
        """With one pole more, of ``natural_hz`` and ``damping``."""
        return LocalFit(self.windows, np.append(self.natural_hz, natural_hz), np.append(self.damping, damping))

    def without(self, number: int) -> LocalFit:
        """Without the pole ``number``, the noise being as it is."""
        kept = np.arange(len(self.natural_hz)) != number
        return LocalFit(self.windows, self.natural_hz[kept], self.damping[kept])

    def covariance(self) -> Array:
        """Covariance (2 M, 2 M) of (ln f, ln ζ) of the poles: what the scores of the bins really scatter by.

        Channels share what excites the structure beside the orders, and neighbouring bins what no model knows.
        """
        matrix, _, scores = self.normal()
        scatter = np.zeros_like(matrix)
        for score in scores:
            scatter += score.T @ score
            for lag in range(1, LAGS + 1):
                beside = score[lag:].T @ score[:-lag]
                scatter += (1.0 - lag / (LAGS + 1.0)) * (beside + beside.T)
        inverse = np.linalg.pinv(matrix, hermitian=True)
        robust = inverse @ scatter @ inverse
        plain = 0.5 * inverse * max(1.0, sum(one.misfit for one in self.solved) / max(self.freedom, 1))
        count = 2 * len(self.natural_hz)
        # the larger of both: few bins scatter by chance less than they may
        wide = np.sqrt(np.maximum(np.diag(robust), np.diag(plain)) / np.maximum(np.diag(robust), 1e-300))
        return np.asarray((robust * wide * wide[:, None])[:count, :count])

    def gain(self, number: int) -> float:
        """What the pole ``number`` saves of twice the negative log likelihood, the others staying where they are."""
        return 2.0 * (self.without(number).misfit - self.misfit)

    def share(self, number: int) -> float:
        """Largest part of the amplitude of an order, in any channel, that pole ``number`` makes at its peak."""
        return max((float(part.max()) for one in self.solved if (part := _shares(one, number)).size), default=0.0)


def _smoothed(power: Array) -> Array:
    """``power`` (B,) over the bins, smoothed; no less anywhere than a share of its mean."""
    half = int(np.clip(NUMBERS.smoothed_share * len(power), 12, len(power) - 1))
    window = np.hanning(2 * half + 3)[1:-1]
    padded = np.pad(power, half, mode="reflect" if half < len(power) - 1 else "edge")
    smooth = np.convolve(padded, window / window.sum(), mode="valid")
    return np.asarray(np.maximum(smooth, NUMBERS.least_noise_share * power.mean()))


def _shares(one: Solved, number: int) -> Array:
    """Part (orders, C) of each order's amplitude that pole ``number`` makes at its peak, 0 of those that miss it."""
    window = one.window
    peak = one.natural_hz[number]
    place = np.array([(2.0 * peak - window.low_hz - window.high_hz) / (window.high_hz - window.low_hz)])
    smooth = np.polynomial.legendre.legvander(place, window.degree)
    answers = resonance(np.array([peak]), one.natural_hz, one.damping)
    basis, width = np.concatenate([smooth, answers], axis=1)[0], window.order_columns(len(one.natural_hz))
    made = np.zeros((len(window.orders), one.left.shape[1]))
    for row, order in enumerate(window.orders):
        if window.sweep.passing(order, (1.0 - one.damping[number]) * peak, (1.0 + one.damping[number]) * peak).any():
            parts = basis[:, None] * one.amplitude[row * width : (row + 1) * width]
            own = parts[window.degree + 1 + number]
            made[row] = np.abs(own) / np.maximum(np.abs(own) + np.abs(parts.sum(axis=0) - own), 1e-300)
    return made


@dataclass(frozen=True, eq=False)
class Starts:
    """Places for one pole more: ``natural_hz`` and ``damping`` (S,), and what each would save (S,)."""

    natural_hz: Array
    damping: Array
    saves: Array
    unknowns: int

    @classmethod
    def of(cls, fit: LocalFit, low_hz: float, high_hz: float) -> Starts:
        """Starts from ``low_hz`` to ``high_hz`` beside the poles of ``fit``."""
        step = 1.0 / max(window.sweep.length_s for window in fit.windows) / low_hz
        counts = [max(2, int(np.ceil(np.log(high_hz / low_hz) / max(zeta, step)))) for zeta in TRIED_DAMPING]
        natural = np.concatenate([np.geomspace(low_hz, high_hz, count) for count in counts])
        damping = np.repeat(TRIED_DAMPING, counts)
        saves, unknowns = np.zeros(len(natural)), 2
        for one in fit.solved:
            saves += _saved(one, natural, damping)
            unknowns += 2 * (len(one.window.orders) + 1) * one.left.shape[1]
        return cls(natural, damping, saves, unknowns)


def _saved(one: Solved, natural_hz: Array, damping: Array) -> Array:
    """What one pole more at ``natural_hz``, ``damping`` (S,) would save, with amplitudes of its own in each channel."""
    window = one.window
    answers = resonance(window.frequency_hz, natural_hz, damping)
    power = np.square(np.abs(answers))
    # what rings is, but for a smooth factor, a response to a force that falls with the square of the frequency
    rung = np.full(len(window.frequency_hz), 1.0 + 0j) / np.square(window.frequency_hz / window.frequency_hz.mean())
    forces = [window.force(order)[0] / window.shape for order in window.orders] + [rung / window.shape]
    count = len(forces)
    basis = (one.columns @ one.inverse).conj().T
    within = np.stack([basis @ (force[:, None] * answers) for force in forces])
    matrix = np.empty((len(natural_hz), count, count), dtype=np.complex128)
    for i in range(count):
        for j in range(i, count):
            shared = (forces[i].conj() * forces[j]) @ power - np.sum(within[i].conj() * within[j], axis=0)
            matrix[:, i, j], matrix[:, j, i] = shared, shared.conj()
    side = np.stack([(one.left.T * force.conj()) @ answers.conj() for force in forces])  # (orders, C, S)
    own = np.einsum("sii->si", matrix).real
    whole = np.stack([np.square(np.abs(force)) @ power for force in forces], axis=1)
    scale = np.where(own > 1e-6 * whole, 1.0 / np.sqrt(np.maximum(own, 1e-300)), 0.0)
    matrix = matrix * scale[:, :, None] * scale[:, None, :] + 1e-6 * np.eye(count)
    wanted = np.moveaxis(side, 2, 0) * scale[:, :, None]
    return np.asarray(2.0 * np.sum(wanted.conj() * np.linalg.solve(matrix, wanted), axis=(1, 2)).real)


@dataclass(frozen=True, eq=False)
class GroupFit:
    """Poles that are told together: ``fit``, with one degree ``less``, and ``covariance`` (2 M, 2 M) of (ln f, ln ζ).

    ``poles`` are those of its poles that orders prove.
    """

    fit: LocalFit
    less: LocalFit
    covariance: Array
    poles: tuple[SweepPole, ...]


@dataclass(frozen=True, eq=False)
class SweepFits:
    """What the signals of all sweeps of a test tell of its modes, place by place of frequency."""

    groups: tuple[GroupFit, ...] = ()

    @property
    def poles(self) -> tuple[SweepPole, ...]:
        """All poles, lowest first."""
        return tuple(sorted((pole for group in self.groups for pole in group.poles), key=lambda one: one.frequency_hz))


NO_FITS = SweepFits()
"""What a test without sweeps tells."""


def sweep_fits(
    spectra: Sequence[SweepSpectrum],
    orders: Sequence[float],
    *,
    others: Sequence[float] = (),
    chance: float,
    most_damping: float,
) -> SweepFits:
    """Poles that the signals ``spectra`` of sweeps show of modes which ``orders`` pass, lowest first.

    Tile by tile of frequency one pole after the other is taken where it saves most, as long as noise alone would save
    so much no more often than ``chance``, and moved with all others near by. Then each is fitted once more in a window
    of its own, with one degree of the smooth part more and less: by what that moves, no model is known better.

    Parameters
    ----------
    spectra : those of the recordings that sweep
    orders : orders (cycles per crank revolution) that were followed through them
    others : further orders that there may be: those that a tile shows take part from there on, for what they leave
        would be taken for modes
    chance : false-alarm probability
    most_damping : largest damping ratio of a mode
    """
    if not spectra or not len(orders):
        return SweepFits()
    found: list[tuple[float, float]] = []
    every = set(orders)
    for low, high in _tiles(spectra, orders):
        more = [order for order in others if all(abs(order - one) > NUMBERS.apart_share * one for one in every)]
        search = _Search(tuple(spectra), tuple(sorted(every)), tuple(more), chance, most_damping)
        found, shown = search.in_tile(found, low, high)
        every |= shown
    groups = _groups(spectra, sorted(every), found)
    made = [_refined(spectra, sorted(every), group, most_damping=most_damping) for group in groups]
    return SweepFits(tuple(one for one in made if one is not None and one.poles))


def _tiles(spectra: Sequence[SweepSpectrum], orders: Sequence[float]) -> list[tuple[float, float]]:
    """Tiles of frequency that any order passes."""
    top = min(NUMBERS.highest_hz, min(one.top_hz for one in spectra))
    turning = [one.speed_rpm[one.speed_rpm > 0.01 * one.speed_rpm.max()] for one in spectra]
    low = max(NUMBERS.lowest_hz, min(orders) * min(float(speed.min()) for speed in turning) / 60.0)
    high = min(top, max(orders) * max(float(speed.max()) for speed in turning) / 60.0)
    if high <= low:
        return []
    count = min(NUMBERS.most_tiles, max(1, int(np.ceil(np.log(high / low) / NUMBERS.tile_share))))
    edges = np.geomspace(low, high, count + 1).tolist()
    return list(itertools.pairwise(edges))


def _blur_hz(spectra: Sequence[SweepSpectrum], orders: Sequence[float], low_hz: float, high_hz: float) -> float:
    """Width over which the fastest passage from ``low_hz`` to ``high_hz`` spreads a resonance; 0 where none passes."""
    fastest = 0.0
    for one in spectra:
        for order in orders:
            inside = one.passing(order, low_hz, high_hz)
            if inside.any():
                fastest = max(fastest, order / 60.0 * float(one.rate_rpm_per_s[inside].max()))
    return float(np.sqrt(fastest))


def _windows(
    spectra: Sequence[SweepSpectrum], orders: Sequence[float], low_hz: float, high_hz: float, degree: int
) -> tuple[Window, ...]:
    """Windows of all recordings in which any order passes, cut at the ends of their bands."""
    made = [
        Window.of(one, orders, max(low_hz, 0.3 * NUMBERS.lowest_hz), min(high_hz, one.top_hz), degree=degree)
        for one in spectra
    ]
    return tuple(window for window in made if window is not None)


@dataclass(frozen=True, eq=False)
class _Search:
    """Search of poles in ``spectra`` behind ``orders``, and ``more`` that there may be, tile by tile."""

    spectra: tuple[SweepSpectrum, ...]
    orders: tuple[float, ...]
    more: tuple[float, ...]
    chance: float
    most_damping: float

    def in_tile(
        self, found: list[tuple[float, float]], low: float, high: float
    ) -> tuple[list[tuple[float, float]], set[float]]:
        """``found`` poles with those of the tile ``low`` to ``high`` Hz, and further orders that it shows."""
        wide = NUMBERS.blurs * _blur_hz(self.spectra, self.orders, low, high)
        ends = (
            min(low * (1.0 - NUMBERS.beside_share), low - wide),
            max(high * (1.0 + NUMBERS.beside_share), high + wide),
        )
        windows = _windows(self.spectra, self.orders, *ends, NUMBERS.search_degree) if wide else ()
        if not windows:
            return found, set()
        near = [pole for pole in found if ends[0] < pole[0] < ends[1]]
        natural, damping = np.array(near).reshape(-1, 2).T
        fit, shown = self._with_orders(LocalFit(windows, natural, damping).settled(**ROUGHLY))
        for _ in range(NUMBERS.most_poles):
            trial = self._with_pole(fit, low, high)
            if trial is None:
                break
            fit, again = self._with_orders(trial)
            shown |= again
        others = [pole for pole in found if not ends[0] < pole[0] < ends[1]]
        return others + list(zip(fit.natural_hz.tolist(), fit.damping.tolist(), strict=True)), shown

    def _with_pole(self, fit: LocalFit, low: float, high: float) -> LocalFit | None:
        """``fit`` with the pole more that saves most in the tile; None where none saves enough, or is felt."""
        from scipy.special import chdtri

        starts = Starts.of(fit, low, high)
        limit = float(chdtri(starts.unknowns, self.chance / len(starts.saves)))
        best = int(np.argmax(starts.saves))
        if starts.saves[best] < limit:
            return None
        trial = fit.with_pole(float(starts.natural_hz[best]), float(starts.damping[best])).settled(**ROUGHLY)
        last = len(trial.natural_hz) - 1
        inside = low / (1.0 + NUMBERS.beside_share) <= trial.natural_hz[last] <= high * (1.0 + NUMBERS.beside_share)
        if not inside or trial.damping[last] > 2.0 * self.most_damping or trial.gain(last) < limit:
            return None
        felt = trial.share(last) >= NUMBERS.felt_share or trial.damping[last] <= 2.0 * LIGHTEST
        return trial if felt else None

    def _with_orders(self, fit: LocalFit) -> tuple[LocalFit, set[float]]:
        """``fit`` with those of the further orders that its windows show, one after the other, and which these are."""
        from scipy.special import chdtri

        shown = set[float]()
        reached = [order for order in self.more if any(window.is_passed(order) for window in fit.windows)]
        while left := [order for order in reached if order not in fit.orders]:
            inside = [[one for one in fit.solved if one.window.is_passed(order)] for order in left]
            gains = [sum(one.gain_of(order) for one in some) for order, some in zip(left, inside, strict=True)]
            columns = [one.left.shape[1] * one.window.order_columns(len(fit.natural_hz)) for one in fit.solved]
            unknowns = 2.0 * sum(columns)
            best = int(np.argmax(gains))
            least = 2.0 * NUMBERS.order_share * sum(one.misfit for one in fit.solved)
            if gains[best] < max(least, float(chdtri(unknowns, self.chance / len(left)))):
                break
            shown.add(left[best])
            joined = {id(one.window) for one in inside[best]}
            windows = tuple(one.with_order(left[best]) if id(one) in joined else one for one in fit.windows)
            fit = LocalFit(windows, fit.natural_hz, fit.damping).settled(**ROUGHLY)
        return fit, shown


def _half_width(spectra: Sequence[SweepSpectrum], orders: Sequence[float], pole: tuple[float, float]) -> float:
    """Half width, Hz, of the window in which a pole is told."""
    f, zeta = pole
    reach = max(zeta, 0.02)
    blur = _blur_hz(spectra, orders, f * (1.0 - reach), f * (1.0 + reach))
    shortest = min(one.length_s for one in spectra)
    return float(max(NUMBERS.widths * zeta * f, NUMBERS.blurs * blur, NUMBERS.fewest_bins / shortest))


def _groups(
    spectra: Sequence[SweepSpectrum], orders: Sequence[float], found: Sequence[tuple[float, float]]
) -> list[list[tuple[float, float]]]:
    """``found`` poles by those that are told together: whose windows reach to one another."""
    made: list[list[tuple[float, float]]] = []
    reached = -np.inf
    for pole in sorted(found):
        half = _half_width(spectra, orders, pole)
        if made and pole[0] - 0.5 * half < reached:
            made[-1].append(pole)
        else:
            made.append([pole])
        reached = max(reached, pole[0] + 0.5 * half) if len(made[-1]) > 1 else pole[0] + 0.5 * half
    return made


def _refined(
    spectra: Sequence[SweepSpectrum],
    orders: Sequence[float],
    group: Sequence[tuple[float, float]],
    *,
    most_damping: float,
) -> GroupFit | None:
    """The poles of a ``group`` fitted in a window of their own, with what the degree of the smooth part moves."""
    halves = [_half_width(spectra, orders, pole) for pole in group]
    low = min(pole[0] - half for pole, half in zip(group, halves, strict=True))
    high = max(pole[0] + half for pole, half in zip(group, halves, strict=True))
    fits: list[LocalFit] = []
    natural, damping = np.array(group).T
    for degree in NUMBERS.degrees:
        windows = _windows(spectra, orders, low, high, degree)
        if not windows:
            return None
        fits.append(LocalFit(windows, natural, damping).settled(**EXACTLY))
        natural, damping = fits[-1].natural_hz, fits[-1].damping
    less, more = fits
    moved = np.stack([np.log(more.natural_hz / less.natural_hz), np.log(more.damping / less.damping)], axis=1).ravel()
    model = np.stack(
        [NUMBERS.frequency_model_share * more.damping, np.full(len(group), NUMBERS.damping_model_share)], 1
    )
    covariance = more.covariance() + np.diag(np.square(moved) + np.square(model.ravel()))
    made = []
    for number in range(len(group)):
        at = slice(2 * number, 2 * number + 2)
        pole = _pole(more, number, covariance[at, at])
        lost = np.sqrt(covariance[at, at][0, 0]) > more.damping[number]
        is_line = pole.damping < 2.0 * LIGHTEST or (
            pole.damping < 10.0 * LIGHTEST and pole.damping_error > NUMBERS.known_share * pole.damping
        )
        sure = len(pole.orders) > 1 or (covariance[at, at][0, 0] < 1e-5 and covariance[at, at][1, 1] < 0.01)
        if pole.orders and sure and not lost and not is_line and pole.damping <= most_damping:
            made.append(pole)
    return GroupFit(more, less, covariance, tuple(made))


def _pole(fit: LocalFit, number: int, covariance: Array) -> SweepPole:
    """Pole ``number`` of ``fit`` with the orders that prove it."""
    from scipy.special import fdtrc

    f, zeta = float(fit.natural_hz[number]), float(fit.damping[number])
    orders, channels, ends = set[float](), dict[str, None](), list[float]()
    for one in fit.solved:
        shares, spread = _shares(one, number), _variance(one, number)
        ratio = np.square(np.abs(one.residue(number))) / np.maximum(spread, 1e-300)
        dof = 2.0 * max(len(one.left) - len(one.scale), 1)
        shown = (fdtrc(2.0, dof, ratio) <= NUMBERS.proof_chance) & (shares >= NUMBERS.felt_share)
        for row, order in enumerate(one.window.orders):
            if shown[row].any():
                orders.add(order)
                hz = order * one.window.sweep.speed_rpm / 60.0
                ends += [float(hz[hz > 0.0].min()), float(hz.max())]
                channels |= {name: None for name, yes in zip(one.window.sweep.channels, shown[row], strict=True) if yes}
    span = (min(ends), max(ends)) if ends else (0.0, 0.0)
    return SweepPole(f, zeta, covariance, tuple(channels), tuple(sorted(orders)), span, fit.share(number))


def _variance(one: Solved, number: int) -> Array:
    """Variance (orders, C) of the residues of mode ``number``, a complex number's whole one."""
    width = one.window.order_columns(len(one.natural_hz))
    at = np.arange(len(one.window.orders)) * width + one.window.degree + 1 + number
    inverse = one.inverse[at] / one.scale[at, None]
    scatter = (
        np.square(one.window.level) * np.sum(np.abs(one.left) ** 2, axis=0) / max(len(one.left) - len(one.scale), 1)
    )
    return np.asarray(np.sum(np.abs(inverse) ** 2, axis=1)[:, None] * scatter)
