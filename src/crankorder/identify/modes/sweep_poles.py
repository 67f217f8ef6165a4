"""Natural frequencies that sweeps tell: poles of the signals themselves, window by window of frequency."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, fdtrc

from crankorder.identify.found import SweepFits
from crankorder.identify.modes.responses import EXCLUSION, SAME_ORDER, Hiding
from crankorder.identify.modes.surface_fit import covariance_among
from crankorder.identify.modes.sweep_fit import LIGHTEST, LocalFit, OnePoleMore, Starts, shares_of
from crankorder.identify.modes.sweep_window import Solved, SweepSpectrum, Window
from crankorder.quantities import Floats
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "sweep_poles")

ROUGHLY = {"rounds": 1, "steps": 6}
EXACTLY = {"rounds": 2, "steps": 6}
"""Times that the noise is told anew, and steps between: while poles are looked for, and in the end."""


class SweepPole(NamedTuple):
    """A pole in the signals of sweeps: ``frequency_hz``, ``damping``, ``covariance`` (2, 2) of (ln f, ln ζ).

    ``channels`` show it; ``orders`` are those whose amplitudes prove it, by chance no more often than stated;
    ``span_hz`` is what they passed; ``share`` the largest part of an order's amplitude that it makes at its peak.
    """

    frequency_hz: float
    damping: float
    covariance: Floats
    channels: tuple[str, ...]
    orders: tuple[float, ...]
    span_hz: tuple[float, float]
    share: float

    @property
    def frequency_error_hz(self) -> float:
        """Standard error of the frequency."""
        return float(self.frequency_hz * np.sqrt(self.covariance[0, 0]))

    @property
    def damping_error(self) -> float:
        """Standard error of the damping ratio."""
        return float(self.damping * np.sqrt(self.covariance[1, 1]))


@dataclass(frozen=True, eq=False)
class TileLooked:
    """All poles ``found`` after a tile was looked at, and further orders that it has ``shown``.

    ``fit`` is what it ended with: None where no order passes, or the search stopped before its end. ``starts`` were
    looked at. ``sent`` is -1 or 1 where one below or above its ends saves more than any inside.
    """

    found: list[tuple[float, float]]
    shown: set[float] = field(default_factory=set)
    fit: LocalFit | None = None
    starts: int = 0
    sent: int = 0


class GroupFit(NamedTuple):
    """Poles that are told together: ``fit``, with one degree ``less``, and ``covariance`` (2 M, 2 M) of (ln f, ln ζ).

    ``poles`` are those of its poles that orders prove.
    """

    fit: LocalFit
    less: LocalFit
    covariance: Floats
    poles: tuple[SweepPole, ...]


def sweep_fits(
    spectra: Sequence[SweepSpectrum], *, others: Sequence[float] = (), settings: IdentifySettings
) -> SweepFits:
    """Poles that the signals ``spectra`` of sweeps show of modes which their orders pass, lowest first.

    Tile by tile of frequency one pole after the other is taken where it saves most, as long as noise alone would save
    so much no more often than ``chance``, and moved with all others near by. Then each is fitted once more in a window
    of its own, with one degree of the smooth part more and less: by what that moves, no model is known better.

    Parameters
    ----------
    spectra : those of the recordings that sweep
    others : further orders (cycles per crank revolution) that there may be: those that a tile shows take part from
        there on, for what they leave would be taken for modes
    settings : false-alarm probability, the dampings of modes, and the confidence with which one is excluded
    """
    orders = {order for sweep in spectra for order in sweep.orders}
    tiles = _tiles(spectra) if orders else []
    poles: list[tuple[float, float]] = []
    looked: dict[int, TileLooked] = {}
    every = set[float]()
    asked, starts = list(range(len(tiles)))[::-1], NUMBERS.most_starts
    while asked and starts > 0:
        number = asked.pop()
        known = np.array(sorted(orders | every))
        more = [order for order in others if (np.abs(order - known) > NUMBERS.apart_share * known).all()]
        search = _Search(tuple(spectra), tuple(sorted(every)), tuple(more), settings)
        back = {side for side in (-1, 1) if number + side in looked and looked[number + side].sent == -side}
        tile = looked[number] = search.in_tile(poles, *tiles[number], back=back, most_starts=starts)
        starts -= tile.starts
        every |= tile.shown
        if len(tile.found) > len(poles):
            asked += [at for at in (number - 1, number + 1) if at in looked and looked[at].sent]
        poles = tile.found
    groups = _groups(spectra, sorted(every), [pole for pole in poles if pole[1] <= settings.max_damping_ratio])
    refined = [_refined(spectra, sorted(every), group, poles, settings.max_damping_ratio) for group in groups]
    sure = tuple(group for group in refined if group is not None and group.poles)
    proven = [pole.frequency_hz for group in sure for pole in group.poles]
    hidden, left = list[Hiding](), list[tuple[float, float]]()
    for at, (low, high) in enumerate(tiles):
        fit = looked[at].fit if at in looked else None
        unseen = hidden_in(fit.bare, low, high, proven, settings=settings) if fit else []
        hidden += unseen
        # one that asks for more is not searched to its end: nothing is said to be free there
        if not unseen and (at not in looked or (fit is None and looked[at].starts)):
            left.append((low, high))
    return SweepFits(sure, tuple(hidden), tuple(sorted(every)), tuple(left))


def _tiles(spectra: Sequence[SweepSpectrum]) -> list[tuple[float, float]]:
    """Tiles of frequency that any order passes."""
    orders = [order for sweep in spectra for order in sweep.orders]
    top = min(NUMBERS.highest_hz, min(sweep.top_hz for sweep in spectra))
    turning = [sweep.speed_rpm[sweep.speed_rpm > 0.01 * sweep.speed_rpm.max()] for sweep in spectra]
    low = max(NUMBERS.lowest_hz, min(orders) * min(float(speed.min()) for speed in turning) / 60.0)
    high = min(top, max(orders) * max(float(speed.max()) for speed in turning) / 60.0)
    if high <= low:
        return []
    count = min(NUMBERS.most_tiles, max(1, int(np.ceil(np.log(high / low) / NUMBERS.tile_share))))
    return list(itertools.pairwise(np.geomspace(low, high, count + 1).tolist()))


def _blur_hz(spectra: Sequence[SweepSpectrum], more: Sequence[float], low_hz: float, high_hz: float) -> float:
    """Width over which the fastest passage from ``low_hz`` to ``high_hz`` spreads a resonance; 0 where none passes.

    ``more``: orders beside those of the recordings.
    """
    fastest = 0.0
    for sweep in spectra:
        for order in (*sweep.orders, *more):
            if sweep.passes(order, low_hz, high_hz):
                inside = sweep.passing(order, low_hz, high_hz)
                fastest = max(fastest, order / 60.0 * float(sweep.rate_rpm_per_s[inside].max(initial=0.0)))
    return float(np.sqrt(fastest))


def _windows(
    spectra: Sequence[SweepSpectrum], more: Sequence[float], low_hz: float, high_hz: float, degree: int
) -> tuple[Window, ...]:
    """Windows of all recordings in which any order, ``more`` among them, passes, cut at the ends of their bands."""
    low_hz = max(low_hz, 0.3 * NUMBERS.lowest_hz)
    windows = [Window.of(sweep, more, low_hz, min(high_hz, sweep.top_hz), degree=degree) for sweep in spectra]
    return tuple(window for window in windows if window is not None)


class _Search(NamedTuple):
    """Search of poles in ``spectra`` behind their orders, ``shown`` ones and ``more`` that may be, tile by tile."""

    spectra: tuple[SweepSpectrum, ...]
    shown: tuple[float, ...]
    more: tuple[float, ...]
    settings: IdentifySettings

    def in_tile(
        self, poles: list[tuple[float, float]], low: float, high: float, *, back: set[int], most_starts: int
    ) -> TileLooked:
        """The tile ``low`` to ``high`` Hz beside the poles ``poles``, in which ``most_starts`` are followed at most.

        None where a start beyond an end promises more, but if the tile there is one of those that send ``back``.
        """
        wide = NUMBERS.blurs * _blur_hz(self.spectra, self.shown, low, high)
        beside = NUMBERS.beside_share
        ends = min(low * (1.0 - beside), low - wide), max(high * (1.0 + beside), high + wide)
        windows = _windows(self.spectra, self.shown, *ends, NUMBERS.search_degree) if wide else ()
        if not windows:
            return TileLooked(poles)
        near = [pole for pole in poles if ends[0] < pole[0] < ends[1]]
        natural, damping = np.array(near).reshape(-1, 2).T
        fit, shown = _strong_fit(windows, natural, damping).settled(**ROUGHLY), set[float]()
        tried, most = 0, min(NUMBERS.most_poles, most_starts)
        while tried < most:
            starts = Starts.of(fit, low, high)
            if starts.saves.max() >= starts.limit(self.settings.false_alarm_probability):
                # what asks for a pole may be an order that nobody followed
                fit, again = self._with_orders(fit)
                starts, shown = Starts.of(fit, low, high) if again else starts, shown | again
            trial = None if starts.beyond and starts.beyond not in back else self._with_pole(fit, starts.inside)
            tried += 1
            if trial is None:
                break
            fit = trial
        poles = [pole for pole in poles if not ends[0] < pole[0] < ends[1]] + fit.poles
        return TileLooked(poles, shown, fit.bare if trial is None else None, tried, sent=starts.beyond)

    def _with_pole(self, fit: LocalFit, starts: Starts) -> LocalFit | None:
        """``fit`` with the best of ``starts``; None where that saves too little, or is not felt."""
        if starts.saves.max() < (limit := starts.limit(self.settings.false_alarm_probability)):
            return None
        trial = fit.with_pole(*starts.best).settled(**ROUGHLY)
        last, reach = len(trial.natural_hz) - 1, 1.0 + NUMBERS.beside_share
        inside = starts.low_hz / reach <= trial.natural_hz[last] <= starts.high_hz * reach
        if not inside or trial.damping[last] > 2.0 * self.settings.max_damping_ratio or trial.gain(last) < limit:
            return None
        felt = trial.share(last) >= NUMBERS.felt_share or trial.damping[last] <= 2.0 * LIGHTEST
        return trial if felt else None

    def _with_orders(self, fit: LocalFit) -> tuple[LocalFit, set[float]]:
        """``fit`` with those of the further orders that its windows show, one after the other, and which these are."""
        shown = set[float]()
        reached = [order for order in self.more if any(window.is_passed(order) for window in fit.windows)]
        while left := [order for order in reached if order not in fit.orders]:
            gains = [sum(solved.gain_of(order) for solved in fit.solved) for order in left]
            unknowns = 2.0 * sum(solved.left.shape[1] * solved.width for solved in fit.solved)
            best = int(np.argmax(gains))
            least = 2.0 * NUMBERS.order_share * sum(solved.misfit for solved in fit.solved)
            if gains[best] < max(least, float(chdtri(unknowns, self.settings.false_alarm_probability / len(left)))):
                break
            shown.add(left[best])
            windows = tuple(window.with_order(left[best]) for window in fit.windows)
            fit = LocalFit(windows, fit.natural_hz, fit.damping).settled(**ROUGHLY)
        return fit, shown


def _strong_fit(windows: Sequence[Window], natural_hz: Floats, damping: Floats) -> LocalFit:
    """Fit of ``windows``, each with its strong orders alone, behind ``natural_hz`` and ``damping`` (M,)."""
    limits = NUMBERS.strong_share, NUMBERS.most_orders
    return LocalFit(tuple(window.with_strong(natural_hz, damping, *limits) for window in windows), natural_hz, damping)


def _half_width(spectra: Sequence[SweepSpectrum], more: Sequence[float], pole: tuple[float, float]) -> float:
    """Half width, Hz, of the window in which a pole is told; ``more``: orders beside those of the recordings."""
    f, zeta = pole
    reach = max(zeta, 0.02)
    blur = _blur_hz(spectra, more, f * (1.0 - reach), f * (1.0 + reach))
    shortest = min(sweep.length_s for sweep in spectra)
    wide = min(NUMBERS.widths * zeta, NUMBERS.widest_share) * f
    return float(max(wide, NUMBERS.blurs * blur, NUMBERS.fewest_bins / shortest))


def _groups(
    spectra: Sequence[SweepSpectrum], more: Sequence[float], poles: Sequence[tuple[float, float]]
) -> list[list[tuple[float, float]]]:
    """``poles`` poles by those that are told together: whose windows reach to one another."""
    groups: list[list[tuple[float, float]]] = []
    reached = -np.inf
    for pole in sorted(poles):
        half = _half_width(spectra, more, pole)
        if groups and pole[0] - 0.5 * half < reached:
            groups[-1].append(pole)
        else:
            groups.append([pole])
        reached = max(reached, pole[0] + 0.5 * half) if len(groups[-1]) > 1 else pole[0] + 0.5 * half
    return [part for group in groups for part in _parted(group)]


def _parted(group: list[tuple[float, float]]) -> list[list[tuple[float, float]]]:
    """``group`` (by frequency), parted where its poles lie furthest apart until few enough are left in each."""
    if len(group) <= NUMBERS.most_together:
        return [group]
    at = 1 + int(np.argmax(np.diff(np.log([pole[0] for pole in group]))))
    return [*_parted(group[:at]), *_parted(group[at:])]


def _refined(
    spectra: Sequence[SweepSpectrum],
    shown: Sequence[float],
    group: Sequence[tuple[float, float]],
    known: Sequence[tuple[float, float]],
    most_damping: float,
) -> GroupFit | None:
    """The poles of a ``group`` fitted in a window of their own, with what the degree of the smooth part moves.

    Others of those ``known`` that lie in the window take part, but are told in a group of their own. ``shown``:
    orders beside those of the recordings; ``most_damping``: the largest damping ratio of a mode.
    """
    places, halves = np.array(group)[:, 0], np.array([_half_width(spectra, shown, pole) for pole in group])
    low, high = float((places - halves).min()), float((places + halves).max())
    held = [sweep for sweep in spectra if _windows([sweep], shown, low, high, max(NUMBERS.degrees))]
    fits: list[LocalFit] = []
    beside = [pole for pole in known if low < pole[0] < high and pole not in group]
    natural, damping = np.array([*group, *beside]).T
    for degree in NUMBERS.degrees:
        windows = _windows(held, shown, low, high, degree)
        if not windows:
            return None
        bends = {order: bend for fit in fits for window in fit.windows for order, bend in window.bends.items()}
        bent = [replace(window, bends=bends) for window in windows]
        fits.append(_strong_fit(bent, natural, damping).settled(**EXACTLY))
        natural, damping = fits[-1].natural_hz, fits[-1].damping
    less, more = fits
    moved = np.stack([np.log(more.natural_hz / less.natural_hz), np.log(more.damping / less.damping)], axis=1)
    covariance = np.asarray(more.covariance() + np.diag(np.square(moved).ravel()) + more.model_variance)
    poles = [_pole(more, number, covariance_among(covariance, [number])) for number in range(len(group))]
    sure = tuple(pole for pole in poles if _is_sure(pole, most_damping))
    return GroupFit(more.bare, less.bare, covariance, sure)


def _is_sure(pole: SweepPole, most_damping: float) -> bool:
    """Whether a ``pole`` is proven to be one of a mode, of ``most_damping`` at most: no line, and known well enough."""
    by_f, by_zeta = np.sqrt(np.diag(pole.covariance))
    vague = pole.damping < 10.0 * LIGHTEST and pole.damping_error > NUMBERS.known_share * pole.damping
    if not pole.orders or by_f > pole.damping or pole.damping < 2.0 * LIGHTEST or vague:
        return False
    known = by_f < NUMBERS.alone_frequency_share and by_zeta < NUMBERS.alone_damping_share
    # what a strong order leaves is taken for one close beside it: two witnesses lie further apart
    apart = any(high > (1.0 + NUMBERS.witness_share) * low for low, high in itertools.pairwise(pole.orders))
    return bool((apart or known) and pole.damping <= most_damping)


def _pole(fit: LocalFit, number: int, covariance: Floats) -> SweepPole:
    """Pole ``number`` of ``fit`` with the orders that prove it."""
    f, zeta = float(fit.natural_hz[number]), float(fit.damping[number])
    orders, channels, ends = set[float](), dict[str, None](), list[float]()
    for solved in fit.solved:
        shares, at = shares_of(solved, number), np.eye(solved.width, dtype=complex)[[solved.window.degree + 1 + number]]
        spread = np.stack([solved.spread(order, at) * solved.noise for order in solved.window.orders])
        ratio = np.square(np.abs(solved.residues[:, number])) / np.maximum(spread, 1e-300)
        dof = 2.0 * max(len(solved.left) - len(solved.scale), 1)
        shown = (fdtrc(2.0, dof, ratio) <= NUMBERS.proof_chance) & (shares >= NUMBERS.felt_share)
        for row, order in enumerate(solved.window.orders):
            if shown[row].any():
                if all(abs(order - other) > SAME_ORDER * order for other in orders):  # told by each recording
                    orders.add(order)
                hz = order * solved.window.sweep.speed_rpm / 60.0
                ends += [float(hz[hz > 0.0].min()), float(hz.max())]
                names = zip(solved.window.sweep.channels, shown[row], strict=True)
                channels |= {name: None for name, is_shown in names if is_shown}
    span = (min(ends), max(ends)) if ends else (0.0, 0.0)
    return SweepPole(f, zeta, covariance, tuple(channels), tuple(sorted(orders)), span, fit.share(number))


CELL = 0.005
"""Ratio less one of the frequencies that are asked about next to one another."""

STARTS_APART = 0.5
"""Distance of the poles that are imagined, in half-power widths of a mode or of a bin: hardly any is lower between."""


def hidden_in(
    fit: LocalFit, low_hz: float, high_hz: float, proven_hz: Sequence[float], *, settings: IdentifySettings
) -> list[Hiding]:
    """What each order of ``fit`` hides from ``low_hz`` to ``high_hz``, recording by recording.

    Poles of the least damping of the ``settings`` and some times that are imagined side by side, with an amplitude
    behind every order and one that rings: what the signals give them, and as much more as they leave open at the
    confidence with which a speed is called free. Of the fit's own poles those of ``proven_hz`` are known; any other may
    be a mode that is to come.
    """
    reach = float(np.sqrt(0.5 * chdtri(2.0, 1.0 - settings.free_confidence)))
    cells = np.geomspace(low_hz, high_hz, max(3, int(np.ceil(np.log(high_hz / low_hz) / CELL))))
    proven, hidden = np.array(proven_hz), list[Hiding]()
    known = [bool(np.any(np.abs(proven - f) <= zeta * f)) for f, zeta in fit.poles]
    for solved in fit.solved:
        spread = float(np.sqrt(max(1.0, solved.misfit / max(solved.freedom, 1))))
        added = np.zeros((len(solved.window.orders), solved.left.shape[1], len(cells)))
        for times in EXCLUSION.tried_damping_ratios:
            added = np.maximum(added, _added(solved, cells, settings.least_damping_ratio * times, reach * spread))
        hidden += [_of_order(solved, place, cells, added[place], known) for place in range(len(solved.window.orders))]
    return [hiding for hiding in hidden if len(hiding.frequency_hz) > 1]


def _added(solved: Solved, cells: Floats, damping: float, reach: float) -> Floats:
    """Largest amplitude (orders, C, G) that a mode about each of ``cells`` adds at its peak to an order held there.

    Per unit of the order's force. ``reach``: standard errors that count as unseen.
    """
    step = STARTS_APART * max(2.0 * damping, 1.0 / solved.window.sweep.length_s / cells[0])
    natural = np.geomspace(cells[0], cells[-1], max(2, int(np.ceil(np.log(cells[-1] / cells[0]) / step))))
    more = OnePoleMore.of(solved, natural, np.full(len(natural), damping))
    most = (np.abs(more.residues) + reach * np.sqrt(more.variance)) / (2.0 * damping)
    worst = np.stack([np.interp(cells, natural, values) for values in most.reshape(len(natural), -1).T])
    nearest = np.abs(np.log(natural[:, None] / cells)).argmin(axis=1)
    np.maximum.at(worst.T, nearest, most.reshape(len(natural), -1))
    return np.asarray(worst.reshape(*most.shape[1:], len(cells)))


def _of_order(solved: Solved, place: int, cells: Floats, added: Floats, known: Sequence[bool]) -> Hiding:
    """What order number ``place`` of ``solved`` window hides at those of ``cells`` (G,) that it passes.

    ``added`` (C, G): the most that a mode adds per unit of its force; ``known`` (M,): which poles are modes for sure.
    """
    window, order = solved.window, solved.window.orders[place]
    hz = order * window.sweep.speed_rpm / 60.0
    at = cells[(cells >= hz.min()) & (cells <= hz.max())]
    kept = np.searchsorted(cells, at)
    force, own = window.force_at(order, at), slice(place * solved.width, (place + 1) * solved.width)
    path = window.paths(solved.natural_hz, solved.damping, at) * force[:, None]
    amplitude, degree = solved.amplitude[own], window.degree + 1
    scatter = np.square(window.level) * solved.misfit / max(solved.freedom, 1)
    error = np.sqrt(solved.spread(order, path) * scatter[:, None])
    by_mode, is_known = np.einsum("gm,mc->mcg", path[:, degree:], amplitude[degree:]), np.array(known, dtype=np.bool_)
    base = np.abs((path[:, :degree] @ amplitude[:degree]).T + by_mode[is_known].sum(axis=0))
    most = added[:, kept] * np.abs(force) + np.abs(by_mode[~is_known]).sum(axis=0)
    return Hiding(order, at, window.sweep.channels, base, most, EXCLUSION.noise_sigmas * error)
