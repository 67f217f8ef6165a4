"""Which part of a bearing is struck: what each one would make, held against one spectrum of the envelope."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.bearings.places import Place
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-bearings.toml", table="candidates"):
    highest_db: float
    clear_db: float
    clear_share: float
    noise_db: float
    off_bins: float
    cage_from_harmonic: int
    side_share: float


NUMBERS = _Numbers.load()

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Candidate:
    """A part that may be struck: at which ``order``, and the mean level in dB of the lines it would make there."""

    place: Place
    order: float
    level_db: float


@dataclass(frozen=True)
class Ranking:
    """Parts of one bearing by level, highest first."""

    candidates: tuple[Candidate, ...]

    def of(self, line: str) -> Candidate | None:
        """The candidate of that ``line``."""
        return next((one for one in self.candidates if one.place.line == line), None)

    @property
    def margin_db(self) -> float:
        """By how much the first stands over the second."""
        first, *rest = self.candidates
        return first.level_db - rest[0].level_db if rest else first.level_db

    @property
    def others(self) -> tuple[Candidate, ...]:
        """All but the first."""
        return self.candidates[1:]

    def rivals(self) -> tuple[Candidate, ...]:
        """The parts that the first is not told from."""
        first = self.candidates[0]
        clear = max(NUMBERS.clear_db, NUMBERS.clear_share * first.level_db)
        return tuple(one for one in self.candidates[1:] if first.level_db - one.level_db < clear)


def ranking(ratio: Array, step: float, free: NDArray[np.bool_], places: list[Place]) -> Ranking:
    """Ranking of the ``places`` of one bearing by ``ratio`` (orders,), power over the floor in bins ``step`` apart.

    It is that of one band, in which one of them was found: in the best of many bands noise lifts each of the others.

    The level of a part is the mean of those of its first harmonics, three of a race or a rolling element and the third
    to the sixth of a cage, each at the place that suits it best. Half of that of an inner race or a rolling element is
    in the sidebands that its way through the load zone makes. What stands one turn of the cage beside is taken from the
    level of a race, for a damaged cage or rolling element has lines there too; from that of a rolling element the
    multiple of the cage's order half way between its harmonics, where only a cage has one. What a rolling element makes
    off the multiples of the cage's order speaks against the cage, for the element comes and goes with it. Bins that are
    not ``free`` do not count.
    """
    level = np.clip(10.0 * np.log10(np.maximum(ratio, 1e-12)), 0.0, NUMBERS.highest_db)
    level = np.where(free, level, np.nan)
    found = []
    for place in places:
        trials, mean = _course(level, step, place)
        if place.line != "N*fs" and np.isfinite(mean).any():
            best = int(np.nanargmax(mean))
            found.append(Candidate(place, float(trials[best]), float(mean[best])))
    for at, one in enumerate(found):
        if one.place.line == "FTF":
            balls = [_off_cage(level, step, place, one.order) for place in places if place.line == "BSF"]
            found[at] = replace(one, level_db=max(one.level_db - 2.0 * max(balls, default=0.0), 0.0))
    return Ranking(tuple(sorted(found, key=lambda one: -one.level_db)))


def _course(level: Array, step: float, place: Place) -> tuple[Array, Array]:
    """Orders (trials,) at which ``place`` may be, and its level at each; NaN beyond the spectrum."""
    comb = place.comb
    trials = comb.trials(step)
    harmonic = np.arange(NUMBERS.cage_from_harmonic if place.line == "FTF" else 1, comb.teeth + 1)[:, None]
    teeth = harmonic * trials
    made = _levels(level, step, teeth)
    cage = place.cage_at(trials)
    if place.spacing is not None:
        spacing = cage if place.line == "BSF" and cage is not None else place.spacing
        sides = 0.5 * (_levels(level, step, teeth - spacing) + _levels(level, step, teeth + spacing))
        made = np.where(np.isfinite(sides), (1.0 - NUMBERS.side_share) * made + NUMBERS.side_share * sides, made)
    if place.line != "FTF" and cage is not None:
        if place.line == "BSF":
            beside = _levels(level, step, cage * np.round((teeth - 0.5 * trials) / cage), reach=2)
        else:
            low, high = (_levels(level, step, teeth + side * cage, reach=2) for side in (-1, 1))
            beside = 0.5 * (low + high)
        made = np.maximum(made - np.nan_to_num(beside), 0.0)
    known = np.isfinite(made)
    total = np.where(known, made, 0.0).sum(axis=0)
    return trials, np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)


def _off_cage(level: Array, step: float, place: Place, cage: float) -> float:
    """Level in dB, beyond what noise reaches, of a rolling element ``place`` off the multiples of order ``cage``."""
    trials, mean = _course(level, step, place)
    off = np.abs(trials - cage * np.round(trials / cage)) > NUMBERS.off_bins * step
    return float(np.nanmax(np.where(off, mean, np.nan), initial=NUMBERS.noise_db)) - NUMBERS.noise_db


def _levels(level: Array, step: float, orders: Array, *, reach: int = 1) -> Array:
    """Largest level within ``reach`` bins of each of ``orders``, NaN where the spectrum ends or does not count."""
    at = np.round(orders / step).astype(np.int64)
    inside = (at >= reach) & (at < len(level) - reach)
    near = np.clip(at, reach, len(level) - 1 - reach)
    beside = level[near]
    for away in range(1, reach + 1):
        beside = np.fmax(beside, np.fmax(level[near - away], level[near + away]))
    return np.where(inside & np.isfinite(level[near]), beside, np.nan)
