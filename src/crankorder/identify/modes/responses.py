"""What fitted responses of orders say of any speed: their amplitude, and what a mode that nobody saw could add."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, ndtri

from crankorder.identify.found import ModalFit, OrderResponse, UnseenBound
from crankorder.identify.lines.growth import Largest
from crankorder.identify.modes.order_blocks import NUMBERS as ORDER_BLOCKS
from crankorder.identify.modes.order_responses import NUMBERS as ORDER_RESPONSES
from crankorder.identify.modes.order_responses import (
    UNTOLD_HZ,
    Block,
    Projected,
    force_slopes,
    resonance,
    resonance_slopes,
    with_scatter,
)
from crankorder.identify.modes.order_search import ORDER_MODES
from crankorder.identify.modes.surface_fit import Poles, Problem, parameters_of
from crankorder.orders.intervals import half_width, positive_interval
from crankorder.quantities import Complexes, Floats
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-explain.toml", "responses")

SPEEDS = 800
"""Speeds over the range of a response at which its steady amplitude is looked at …"""

ABOUT_MODE, PER_MODE = 4.0, 81
"""… and those within so many half-power widths of each mode."""


def responses_of(blocks: Sequence[Block], modes: Poles) -> Iterator[OrderResponse]:
    """OrderResponse of each channel of ``blocks`` that have phases, for the ``modes``."""
    for block, part in (with_scatter(block, modes) for block in blocks if not block.rows.power):
        rows, first = block.rows, block.degree + 1
        covariance, slopes = part.covariance * part.beyond_errors, _terms_by_poles(block, modes, part)
        for number, channel in enumerate(rows.channels):
            residue = np.zeros(len(modes), dtype=complex)
            residue[part.reached] = part.linear[number, first:]
            known = rows.error[number][np.isfinite(rows.error[number])]
            yield OrderResponse(
                order=rows.order,
                channel=channel,
                force=block.force,
                smooth=part.linear[number, :first],
                residue=residue,
                reached=part.reached,
                covariance=covariance[number],
                degrees_of_freedom=part.degrees_of_freedom // len(rows.channels),
                error=block.noise * float(np.median(known)),
                fits=block.tells and part.degrees_of_freedom > 0 and rows.blur_hz < UNTOLD_HZ,
                recording=rows.recording,
                slopes=slopes[number],
            )


def _terms_by_poles(block: Block, poles: Poles, part: Projected) -> Complexes:
    """Derivatives (C, terms, 2 reached) of the linear terms by (ln f, ln ζ) of each of the ``poles`` reached.

    The terms are those that explain best what was measured, wherever the poles are. ``part``: the block as projected.
    """
    reached = part.reached
    bent = np.zeros((*part.linear.shape, 2 * len(reached)), dtype=np.complex128)
    residue = part.linear[:, None, block.degree + 1 :]
    adjoint = np.swapaxes(part.basis, 1, 2).conj()
    for offset, slope in enumerate(block.modal_slopes(poles.frequency_hz[reached], poles.damping[reached])):
        turned = slope[None] * residue * block.weight[..., None]
        bent[..., offset::2] = -(part.solve @ (adjoint @ turned)) / part.scale[..., None]
    return bent


@dataclass(frozen=True, eq=False)
class WithAndWithout:
    """Amplitude of an order ``with_mode`` and ``without`` it, and the standard error of both, each (channels, G).

    ``least`` (channels,) is what could be seen.
    """

    with_mode: Floats
    without: Floats
    with_error: Floats
    without_error: Floats
    least: Floats

    @property
    def ratio(self) -> Floats:
        """Amplification (G,) as fitted: the largest amplitude of any channel over the largest without the mode."""
        return np.asarray(self.with_mode.max(axis=0) / self._at_least(self.without))

    def ends(self, sigmas: float, *, matters: float = 0.0) -> tuple[Floats, Floats]:
        """Least and largest amplification (G,) within so many ``sigmas``.

        ``matters``: an amplitude below which none matters; the largest amplification is over no less.
        """
        low = np.maximum(self.with_mode - sigmas * self.with_error, 0.0).max(axis=0)
        high = (self.with_mode + sigmas * self.with_error).max(axis=0)
        below, above = self.without - sigmas * self.without_error, self.without + sigmas * self.without_error
        return low / self._at_least(above), high / np.maximum(self._at_least(below), matters)

    def _at_least(self, amplitude: Floats) -> Floats:
        return np.asarray(np.maximum(amplitude, self.least[:, None]).max(axis=0))


def together(parts: Sequence[WithAndWithout]) -> WithAndWithout:
    """``parts`` of several channels of one unit as one."""
    joined = (np.concatenate([getattr(part, attribute.name) for part in parts]) for attribute in fields(WithAndWithout))
    return WithAndWithout(*joined)


def shapes(frequency_hz: Floats, modal: ModalFit) -> Complexes:
    """Response (frequencies, modes) of each mode of ``modal`` at ``frequency_hz``: −x² / (1 − x² + 2iζx), x = f/f_j."""
    natural = np.array([mode.frequency_hz for mode in modal.modes])
    return resonance(frequency_hz, natural, np.array([mode.damping_ratio for mode in modal.modes]))


def held_amplitudes(response: OrderResponse, rpm: Floats, modal: ModalFit) -> tuple[Floats, Floats]:
    """Peak amplitude (G,) of ``response`` at ``rpm`` (G,) by the fit ``modal`` if each were held, and its error.

    That is the error of the linear terms and that of the poles of the modes, with which the terms move.
    """
    smooth, parts, columns = _parts(response, rpm, modal)
    whole = smooth + parts.sum(axis=1)
    return np.abs(whole), _errors(response, rpm, modal, whole[None], columns[None])[0]


def with_and_without(response: OrderResponse, number: int, rpm: Floats, modal: ModalFit) -> WithAndWithout:
    """Amplitude of ``response`` at ``rpm`` (G,) with mode ``number`` of ``modal`` and without it."""
    smooth, parts, columns = _parts(response, rpm, modal)
    whole = smooth + parts.sum(axis=1)
    without = whole - parts[:, number]
    both = np.stack([columns, columns])
    both[1, :, len(response.smooth) + np.flatnonzero(response.reached == number)] = 0.0
    error, error_without = _errors(response, rpm, modal, np.stack([whole, without]), both, but=number)
    ambiguous = NUMBERS.shape_error_share * np.sqrt(len(response.smooth) - 1) * np.abs(without)
    rows = (np.abs(whole)[None], np.abs(without)[None], error[None], np.hypot(error_without, ambiguous)[None])
    return WithAndWithout(*rows, np.array([EXCLUSION.noise_sigmas * response.error]))


def _errors(
    response: OrderResponse, rpm: Floats, modal: ModalFit, values: Complexes, columns: Complexes, *, but: int = -1
) -> Floats:
    """Standard errors (V, G) of the amplitudes of ``values`` at ``rpm`` (G,), the second of them without mode ``but``.

    ``columns`` (V, G, terms) make them of the linear terms, which move with the poles.
    """
    squared = np.maximum(((columns @ response.covariance) * columns.conj()).sum(axis=2).real, 0.0)
    reached = response.reached
    at = parameters_of(reached)
    if not len(at) or int(at.max()) >= len(modal.covariance):
        return np.asarray(np.sqrt(squared))
    poles = np.array([(modal.modes[k].frequency_hz, modal.modes[k].damping_ratio) for k in reached.tolist()])
    spread = modal.covariance[np.ix_(at, at)] / np.outer(poles.ravel(), poles.ravel())
    # of a pole that is not determined a derivative says nothing: that it is not decided is said elsewhere
    known = np.repeat(np.diag(spread)[1::2] <= ORDER_MODES.known_share**2, 2)
    spread = np.where(known[:, None] & known, spread, 0.0)
    grown = response.force.at(rpm)[:, None]
    residues = np.array([response.residue[reached], np.where(reached == but, 0.0, response.residue[reached])])
    by_poles = np.zeros((*values.shape, len(at)), dtype=np.complex128)  # derivatives by (ln f, ln ζ) of the modes
    for offset, slope in enumerate(resonance_slopes(response.order * rpm / 60.0, *poles.T)):
        by_poles[..., offset::2] = grown * slope * residues[: len(values), None]
    if response.slopes is not None:
        by_poles += columns @ response.slopes
    along = (by_poles * (values.conj() / np.maximum(np.abs(values), 1e-300))[..., None]).real
    return np.asarray(np.sqrt(squared + np.maximum(((along @ spread) * along).sum(axis=2), 0.0)))


def _parts(response: OrderResponse, rpm: Floats, modal: ModalFit) -> tuple[Complexes, Complexes, Complexes]:
    """Smooth part (G,), that of each mode (G, M), and the columns (G, terms) behind the linear terms."""
    grown = response.force.at(rpm)[:, None]
    smooth = grown * response.force.shapes(rpm, len(response.smooth) - 1)
    modes = grown * shapes(response.order * rpm / 60.0, modal)
    columns = np.concatenate([smooth, modes[:, response.reached]], axis=1)
    return smooth @ response.smooth, modes * response.residue, columns


class HeldPeak(NamedTuple):
    """Largest steady peak ``amplitude`` of an order in a channel, at ``rpm``.

    ``error`` is the standard error of the amplitude, with ``freedom`` degrees of freedom.
    """

    rpm: float
    amplitude: float
    error: float
    freedom: float

    @property
    def share(self) -> float:
        """Error as a share of the amplitude."""
        return self.error / max(self.amplitude, 1e-300)

    @property
    def ends(self) -> tuple[float, float]:
        """95 % interval of the amplitude."""
        return positive_interval(self.amplitude, half_width(self.freedom) * self.error)


def held_peak(modal: ModalFit, order: float, channel: str, *, seen: Largest) -> HeldPeak | None:
    """Amplitude that ``order`` would reach in ``channel`` at the worst speed of its sweeps, held, by the fit ``modal``.

    None where no response fits its sweeps over the speed at which its largest amplitude was ``seen``, or where it would
    be less: no sweep makes an order larger. Of several recordings that pass the worst speed that counts which knows it
    best.
    """
    own = [response for response in modal.responses if response.fits and response.recording]
    own = [response for response in own if response.channel == channel]
    near = [response for response in own if abs(response.order - order) <= ORDER_BLOCKS.same_order_share * order]
    if not any(response.passes(seen.speed_rpm) for response in near):
        return None
    peaks = [peak_of(response, modal) for response in near]
    worst = max(peaks, key=lambda peak: peak.amplitude)
    passing = [peak for peak, response in zip(peaks, near, strict=True) if response.passes(worst.rpm)]
    best = min(passing, key=lambda peak: peak.share)
    return None if best.ends[1] < seen.amplitude else best


def peak_of(response: OrderResponse, modal: ModalFit, ends: tuple[float, float] = (0.0, np.inf)) -> HeldPeak:
    """Largest steady amplitude of ``response`` by the fit ``modal``, of it what lies between ``ends`` [rpm]."""
    rpm = np.clip(_speeds(response, modal), *np.clip(ends, *response.force.span_rpm))
    smooth, parts, _ = _parts(response, rpm, modal)
    at = int(np.argmax(np.abs(smooth + parts.sum(axis=1))))
    amplitude, error = held_amplitudes(response, rpm[at : at + 1], modal)
    return HeldPeak(float(rpm[at]), float(amplitude[0]), float(error[0]), float(max(response.degrees_of_freedom, 1)))


def _speeds(response: OrderResponse, modal: ModalFit) -> Floats:
    """Speeds [rpm] at which ``response`` is looked at: over its range, and closer about the modes of ``modal``."""
    low, high = response.force.span_rpm
    reach = ABOUT_MODE * np.linspace(-1.0, 1.0, PER_MODE)
    near = [60.0 * mode.frequency_hz / response.order * (1.0 + mode.damping_ratio * reach) for mode in modal.modes]
    rpm = np.concatenate([np.linspace(low, high, SPEEDS), *near])
    return rpm[(rpm >= low) & (rpm <= high)]


EXCLUSION = MethodNumbers("5-identify-modal.toml", "exclusion")

BETWEEN_ROWS = 4
"""Speeds that are asked about between two tested ones."""

ALONG_SWEEP = 160
"""Speeds that are asked about along a sweep."""

SAME_ORDER = 1e-3
"""Share of an order within which another number stands for it."""


def least_seen(
    blocks: Sequence[Block],
    poles: Poles,
    *,
    unit: Mapping[str, str],
    settings: IdentifySettings,
    floors: Sequence[FloorBound] = (),
    sweeps: Sequence[Hiding] = (),
) -> tuple[UnseenBound, ...]:
    """For each of ``blocks``, how much a mode beside the ``poles`` could amplify its order without being seen.

    At speeds between the tested ones a mode is imagined on the order, damped by the least ratio of the
    ``settings`` or some times that; its residue is what the data give it, and as much more as they leave open at the
    confidence with which a speed is called free. What it
    adds at its peak, over what is there without it, is the amplification, in the channel that has most of each
    ``unit``. Amplitudes below the noise, or below a small share of the largest of any order, count as so large. An
    order of which the poles leave too much excludes nothing.

    A mode is the structure's: other orders pass it at their own speeds, and what excites the floor does too. It is
    reckoned with that it amplifies one order ``selective_ratio`` times as much as another, or as the ``floors``,
    and no more: what one of them excludes by far is excluded for all. What the signals of ``sweeps`` leave open counts
    where it is less, and of orders that they alone show.
    """
    reach = float(np.sqrt(chdtri(2.0, 1.0 - settings.free_confidence)))
    largest = dict.fromkeys(unit.values(), 0.0)
    for block in blocks:
        for name, most in zip(block.rows.channels, block.rows.linear_size.max(axis=1).tolist(), strict=True):
            largest[unit[name]] = max(EXCLUSION.matters_share * most, largest[unit[name]])
    along = [(unseen.order, FloorBound(unseen.frequency_hz, unseen.amplification(unit, largest))) for unseen in sweeps]
    alone = [_less(_bound(block, poles, settings.least_damping_ratio, reach, unit, largest), along) for block in blocks]
    have = {block.rows.order for block in blocks}
    more = {order for order, _ in along if all(abs(order - other) >= SAME_ORDER * other for other in have)}
    alone += [_less(UnseenBound(order, np.empty(0), np.empty(0)), along) for order in sorted(more)]
    known = [FloorBound(unseen.order * unseen.speed_rpm / 60.0, unseen.amplification) for unseen in alone]
    bounds = []
    for unseen in alone:
        others = [bound for bound, other in zip(known, alone, strict=True) if other.order != unseen.order]
        hz = unseen.order * unseen.speed_rpm / 60.0
        shared = np.min([bound.at(hz) for bound in (*others, *floors)], axis=0, initial=np.inf)
        allowed = 1.0 + EXCLUSION.selective_ratio * (shared - 1.0)
        bounds.append(replace(unseen, amplification=np.minimum(unseen.amplification, allowed)))
    return tuple(bounds)


class Hiding(NamedTuple):
    """What a mode that nobody saw could add to ``order`` in its ``channels``, at ``frequency_hz`` (G,), rising.

    ``base`` (C, G) is the amplitude there without it, ``added`` (C, G) the most that it adds unseen, ``noise`` (C, G)
    what is too small to be seen.
    """

    order: float
    frequency_hz: Floats
    channels: tuple[str, ...]
    base: Floats
    added: Floats
    noise: Floats

    def amplification(self, unit: Mapping[str, str], matters: Mapping[str, float]) -> Floats:
        """Largest amplification (G,), in the channel that has most of each ``unit``.

        ``matters``: amplitude, by unit, below which none counts; any does of a unit without one.
        """
        most = np.zeros(self.base.shape[1])
        for name in dict.fromkeys(unit[channel] for channel in self.channels):
            own = np.array([unit[channel] == name for channel in self.channels])
            least = np.maximum(self.noise[own].max(axis=0), matters.get(name, 0.0))
            without, whole = (np.maximum(of[own].max(axis=0), least) for of in (self.base, self.base + self.added))
            most = np.maximum(most, whole / np.maximum(without, 1e-300))
        return most


class FloorBound(NamedTuple):
    """Largest ``amplification`` (F,) that a mode at ``frequency_hz`` (F,), rising, could have without being seen."""

    frequency_hz: Floats
    amplification: Floats

    def at(self, hz: Floats) -> Floats:
        """Bound at ``hz`` (G,) by interpolation; infinite outside."""
        return np.asarray(np.interp(hz, self.frequency_hz, self.amplification, left=np.inf, right=np.inf))

    def worst_about(self, hz: Floats) -> Floats:
        """The largest nearer to each of ``hz`` (G,), rising, than to its neighbours."""
        worst = self.at(hz)
        inside = (self.frequency_hz >= hz[0]) & (self.frequency_hz <= hz[-1])
        nearest = np.searchsorted(0.5 * (hz[1:] + hz[:-1]), self.frequency_hz[inside])
        np.maximum.at(worst, nearest, self.amplification[inside])
        return worst


def floor_bound(problem: Problem, model: Floats, *, poles: Poles, settings: IdentifySettings) -> FloorBound | None:
    """What the floor of a band (``problem``, as fitted by ``model`` (C, F)) excludes; None where nothing shakes it.

    Only where a mode among the ``poles`` stands clear of it does what is broadband excite the structure, and would show
    others. A resonance of the least damping of the ``settings`` fills a share of a bin; what stands over the model, and
    as much more as its scatter hides at their confidence, is its power.
    """
    at = np.abs(problem.frequency_hz - poles.frequency_hz[:, None]).argmin(axis=1)
    if (model[:, at] / np.median(model, axis=1)[:, None]).max(initial=0.0) < EXCLUSION.shaken_ratio:
        return None
    used = problem.averages > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        over = np.where(used, np.nan_to_num(problem.psd) / model - 1.0, np.inf)
        hidden = np.where(used, float(ndtri(settings.free_confidence)) / np.sqrt(problem.averages), np.inf)
    best = np.min(np.maximum(over, 0.0) + hidden, axis=0)
    filled = np.minimum(np.pi * settings.least_damping_ratio * problem.frequency_hz / problem.seen.bin_hz, 1.0)
    return FloorBound(problem.frequency_hz, np.sqrt(1.0 + best / filled))


def _less(unseen: UnseenBound, along: Sequence[tuple[float, FloorBound]]) -> UnseenBound:
    """``unseen``, or what sweeps leave open of its order where that is less: ``along`` holds (order, bound) of each.

    Sweeps tell of speeds too that no row of the order reaches.
    """
    own = [bound for order, bound in along if abs(order - unseen.order) < SAME_ORDER * unseen.order]
    speed = unseen.speed_rpm
    more = np.unique(np.concatenate([60.0 / unseen.order * bound.frequency_hz for bound in own] or [np.empty(0)]))
    below, above = (more[more < speed[0]], more[more > speed[-1]]) if len(speed) else (more, more[:0])
    speed = np.concatenate([below, speed, above])
    least = np.pad(unseen.amplification, (len(below), len(above)), constant_values=np.inf)
    for bound in own:
        least = np.minimum(least, bound.worst_about(unseen.order * speed / 60.0))
    return replace(unseen, speed_rpm=speed, amplification=least)


def _bound(
    block: Block, poles: Poles, damping: float, reach: float, unit: Mapping[str, str], matters: Mapping[str, float]
) -> UnseenBound:
    """What the rows of ``block`` leave open of modes of ``damping`` and some times that, ``reach`` errors away."""
    block, part = with_scatter(block, poles)
    rows, speed = block.rows, _speeds_between(block)
    if part.degrees_of_freedom < len(rows.channels) * rows.parts or not block.tells:
        return UnseenBound(rows.order, speed, np.full(len(speed), np.inf))
    spread = float(np.sqrt(part.beyond_errors))
    added = np.zeros((len(rows.channels), len(speed)))
    for times in EXCLUSION.tried_damping_ratios:
        added = np.maximum(added, _added(block, part, speed, damping * times, reach * spread))
    # the noise of the nearest row hides what is smaller
    near = np.abs(np.log(speed[:, None] / rows.speed_rpm)).argmin(axis=1)
    noise = EXCLUSION.noise_sigmas * block.noise * np.where(np.isfinite(rows.error), rows.error, 0.0)[:, near]
    base = _fitted(block, part, poles, speed)
    if rows.power:
        base, added, noise = np.sqrt(np.maximum(base, 0.0)), np.sqrt(added), np.sqrt(noise)
    hiding = Hiding(rows.order, rows.order * speed / 60.0, rows.channels, base, added, noise)
    return UnseenBound(rows.order, speed, hiding.amplification(unit, matters))


def _speeds_between(block: Block) -> Floats:
    """Speeds (G,) in rpm at and between the rows of ``block``, or along its sweep, at which bounds are computed."""
    if block.rows.recording:
        return np.geomspace(*block.force.span_rpm, ALONG_SWEEP)
    rows = np.unique(block.rows.speed_rpm)
    share = np.arange(BETWEEN_ROWS + 1) / (BETWEEN_ROWS + 1.0)
    between = rows[:-1, None] + np.diff(rows)[:, None] * share
    return np.append(between.ravel(), rows[-1])


def _fitted(block: Block, part: Projected, poles: Poles, speed: Floats) -> Floats:
    """Amplitude (C, G) of the fit at ``speed``; of squares their square."""
    fitted = part.linear @ held_at(block, speed).design(*poles.values[part.reached].T).T
    return np.asarray(fitted.real if block.rows.power else np.abs(fitted))


def held_at(block: Block, speed_rpm: Floats) -> Block:
    """``block`` as if its order were held at ``speed_rpm`` (G,); it holds no amplitudes."""
    nothing = np.zeros((len(block.rows.channels), len(speed_rpm)))
    hertz, none = block.rows.order * speed_rpm / 60.0, nothing.astype(np.complex128)
    rows = replace(block.rows, speed_rpm=speed_rpm, frequency_hz=hertz, amplitude=none, error=nothing + np.inf)
    return replace(block, rows=rows)


def _added(block: Block, part: Projected, speed: Floats, damping: float, reach: float) -> Floats:
    """Largest amplitude (C, G) that a mode on the order at ``speed`` adds there unseen; of squares their square."""
    rows, natural = block.rows, block.rows.order * speed / 60.0
    # a sweep makes any resonance look like one that is damped by as much
    columns = block.modal(natural, np.maximum(damping, rows.blur_hz / natural))
    at_peak = np.abs(held_at(block, speed).growth) / (2.0 * damping)
    added = np.empty((len(rows.channels), len(speed)))
    # any law may have taken it in
    bends = force_slopes(block, part, max(1, min(ORDER_RESPONSES.most_degree, rows.fewest // 4 - 1)))
    for number, (weight, basis, left) in enumerate(zip(block.weight, part.basis, part.left, strict=True)):
        shown = columns * weight[:, None]
        shown -= basis @ (basis.conj().T @ shown)
        taken = np.linalg.qr(bends[number])[0]
        shown -= taken @ (taken.conj().T @ shown)
        norm = np.maximum(np.sum(np.abs(shown) ** 2, axis=0), 1e-300)
        along = np.abs(left.conj() @ shown) / norm + reach / np.sqrt(norm)
        if rows.power:  # the real part is half as high as the imaginary one
            along = along.reshape(-1, 2) @ np.array([0.5, 1.0])
        added[number] = along * at_peak
    return added
