"""Speeds at which a test should not dwell, worst first; the speeds that are free, and those of which nobody knows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np
from scipy.special import ndtri

from crankorder.findings import AvoidedSpeed, CrossingFinding, FreeBand, OpenBand
from crankorder.identify.crossings import NUMBERS as CROSSINGS
from crankorder.identify.crossings import fitted_excess, higher, responses_to, width_rpm
from crankorder.identify.found import (
    AgreedOrder,
    AgreedOrders,
    Crossing,
    ModalFit,
    Mode,
    OrderLine,
    OrderResponse,
    SpeedVerdicts,
    UnseenBound,
)
from crankorder.identify.lines.growth import largest, reported_within
from crankorder.identify.modes.order_search import ORDER_MODES
from crankorder.identify.modes.responses import EXCLUSION, HeldPeak, peak_of, together, with_and_without
from crankorder.orders.intervals import Z95, half_width
from crankorder.quantities import Bools
from crankorder.records import Ends, known
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-explain.toml", "speeds_to_avoid")

FLANKS = 120
"""Speeds over the whole span, in equal ratios, at which the flanks of a mode are looked at."""


def _open(low: float, high: float, why: str, *, amplified: bool = False) -> OpenBand:
    """Speeds ``low`` to ``high`` (rpm) that are not free, and ``why``."""
    return OpenBand(low_rpm=low, high_rpm=high, remark=why, amplified=amplified)


class _Peak(NamedTuple):
    """Peak ``amplitude`` of an order in a channel with its 95 % interval: as recorded, or what it would be if held.

    ``response`` is the fit that knows the peak, if any does; its number is told where ``by_fit``.
    """

    amplitude: float
    ends: tuple[float, float]
    response: OrderResponse | None = None
    by_fit: bool = False


class Sizes(NamedTuple):
    """Largest amplitude of any order ``of_channel``, with the ``unit`` of each channel: those of one unit compare."""

    of_channel: Mapping[str, float]
    unit: Mapping[str, str]

    @classmethod
    def of(cls, orders: Sequence[AgreedOrder], unit: Mapping[str, str]) -> Sizes:
        """Of the ``orders`` of a test; ``unit`` is that of each channel."""
        largest: dict[str, float] = {}
        for line in (line for agreed in orders for line in agreed.lines):
            largest[line.channel] = max(largest.get(line.channel, 0.0), float(line.amplitude.max()))
        return cls(largest, unit)

    def in_unit(self, channel: str) -> float:
        """The largest in all channels of the unit of ``channel``; 0 where there is none."""
        alike = (size for name, size in self.of_channel.items() if self.unit[name] == self.unit[channel])
        return max(alike, default=0.0)


def speeds_to_avoid(
    found: Sequence[Crossing],
    orders: AgreedOrders,
    modal: ModalFit,
    *,
    speed_rpm: tuple[float, float],
    unit: Mapping[str, str],
    settings: IdentifySettings,
    sweep_rpm_per_s: float = 0.0,
) -> SpeedVerdicts:
    """Speeds to avoid, worst first, the free bands of the tested range, and those that are open.

    To be avoided is an excited crossing by which the order may be twice as large, and a speed at which an order towers
    over those beside it without one (:func:`lone_peaks`). What it costs is its peak amplitude
    there (:func:`_peaks`), in the
    channel where it is largest, as a share of the largest amplitude that any order has in a channel of that unit: what
    the reader sees is what ranks. It takes its half-power width, ± ζ of the speed, and the interval of its speed;
    crossings whose ranges overlap are one speed to avoid, named and ranked after the costliest.

    A speed is free only where the data exclude, with ``settings.free_confidence``, that any order that was found is
    amplified by more than ``settings.free_amplification`` times: by a mode that was found, or by one that stands
    between the tested speeds and was not seen; and where no mode rings on that could hide an order. What is neither
    free nor to be avoided is open, with the reason.

    Parameters
    ----------
    found : the crossings of the test
    orders : the orders of the test
    modal : the modes, the responses of the orders, and what could have stayed unseen
    speed_rpm : slowest and fastest speed of the test, rpm
    unit : of each channel: the largest amplitude counts of those that have the same
    settings : ``crossing_band_rpm`` is the least width of a free band
    sweep_rpm_per_s : rate at which the fastest sweep changes the speed, 0 where none does
    """
    sizes = Sizes.of(orders, unit)
    met = [_cost(crossing, orders, modal, sizes, settings) for crossing in found if _counts(crossing)]
    lone = lone_peaks(orders, modal, met, sizes, factor=settings.free_amplification, sweep_rpm_per_s=sweep_rpm_per_s)
    findings = [crossing.finding for crossing in found]
    numbered = {(finding.order, finding.mode_hz) for finding in findings if finding.amplification is not None}
    # a meeting that has a number of its own keeps that one: the reason says how the peak stands over its neighbours
    met += [replace(peak, amplification=None) if (peak.order, peak.mode_hz) in numbered else peak for peak in lone]
    by_cost = sorted(_joined(met), key=lambda peak: (-(peak.cost or 0.0), peak.rpm))
    avoid = tuple(replace(peak, rank=rank) for rank, peak in enumerate(by_cost, start=1))
    low, high = speed_rpm
    if not (np.isfinite(low) and np.isfinite(high)):
        return SpeedVerdicts(avoid, (), ())
    least, most = 1.0 - NUMBERS.beside_share, 1.0 + NUMBERS.beside_share
    opened = [  # what speeds to avoid take is not open, but neither is it free
        *(_open(min(_range(a)[0], a.rpm * least), max(_range(a)[1], a.rpm * most), "") for a in avoid),
        *_by_modes(found, modal, sizes, settings),
        *_by_unseen(orders, modal, speed_rpm, settings),
    ]
    free, rest = _split(opened, speed_rpm, settings)
    return SpeedVerdicts(avoid, free, rest)


def as_avoided(found: Sequence[Crossing], avoid: Sequence[AvoidedSpeed]) -> Iterator[CrossingFinding]:
    """Findings of ``found`` with the amplification that the speed to ``avoid`` states of the same meeting: its peak's.

    One meeting has one number, in the channel in which it is worst.
    """
    peaks = {(peak.order, peak.mode_hz): peak for peak in avoid if peak.amplification_ci95 and peak.amplification}
    for finding in (crossing.finding for crossing in found):
        peak = peaks.get((finding.order, finding.mode_hz))
        if peak is not None and peak.amplification_ci95 is not None:
            bounded = known(peak.amplification_ci95) is not None
            times = f"{peak.amplification:.2g} times" if bounded else f"at least {peak.amplification_ci95[0]:.2g} times"
            words = f"in {peak.channel}, where it is largest, {times} what it is without the mode"
            if finding.chance is not None:
                words += f"; chance without the mode {finding.chance:.1g}"
            finding = replace(
                finding,
                amplification=peak.amplification,
                amplification_ci95=peak.amplification_ci95,
                channels=tuple(sorted({*finding.channels, peak.channel})),
                evidence=words,
            )
        yield finding


def _range(peak: AvoidedSpeed) -> Ends:
    """Speeds to stay out of around ``peak``."""
    return cast("Ends", peak.rpm_range)


def _is_vague(crossing: Crossing) -> bool:
    """Whether the natural frequency of ``crossing`` is undecided, and nobody knows where to stay away."""
    low, high = crossing.ends_rpm
    return bool(crossing.finding.remark) and high - low > NUMBERS.vague_share * crossing.finding.rpm


def _counts(crossing: Crossing) -> bool:
    """Whether ``crossing`` is excited in the tested range, its speed known, and may double the amplitude."""
    finding = crossing.finding
    if not (finding.excited and finding.in_range) or _is_vague(crossing):
        return False
    numbers = (finding.amplification_ci95 or (0.0, 0.0))[1], finding.amplification_predicted
    return bool(max(number or 0.0 for number in numbers) >= CROSSINGS.clearly_excited_ratio)


def _cost(
    crossing: Crossing, orders: AgreedOrders, modal: ModalFit, largest: Sizes, settings: IdentifySettings
) -> AvoidedSpeed:
    """Range, amplitude and cost of an excited crossing, beside the ``largest`` amplitudes."""
    mode, finding = crossing.mode, crossing.finding
    agreed = min(orders, key=lambda agreed: abs(agreed.order - finding.order))
    half = mode.damping_ratio * finding.rpm
    rpm_range = (crossing.ends_rpm[0] - half, crossing.ends_rpm[1] + half)
    peaks = _peaks(crossing, rpm_range, agreed, modal, settings)
    costs = [(channel, peak.amplitude, largest.in_unit(channel)) for channel, peak in peaks.items()]
    shares = {channel: size / most for channel, size, most in costs if most > 0.0}
    channel = max(shares, key=lambda name: shares[name], default=agreed.lines[0].channel)
    # how many times what it is without the mode: by the fit, unless the amplitudes stand higher over their trend
    trends = [excess for excess in crossing.trends if excess.channel == channel]
    times = trend = min(trends, key=lambda excess: excess.chance, default=None)
    peak = peaks.get(channel)
    if peak is not None and peak.response is not None:
        by_fit = fitted_excess(peak.response, modal.modes.index(mode), modal)
        times = trend if by_fit is None else by_fit if trend is None else higher(by_fit, [trend])
    # less than that makes no speed one to avoid
    if times is not None and not (times.ratio or 0.0) >= CROSSINGS.clearly_excited_ratio:
        times = None
    of_whirl = "" if crossing.whirl is None else f" of a whirl that moves by {crossing.whirl.slope:.3g} orders"
    undecided = ", which may be a natural frequency" if mode.undecided else ""
    return AvoidedSpeed(
        rank=1,
        order=finding.order,
        orders=(finding.order,),
        mode_hz=finding.mode_hz,
        modes_hz=(finding.mode_hz,),
        rpm=finding.rpm,
        rpm_range=rpm_range,
        channel=channel,
        amplitude=None if peak is None else peak.amplitude,
        amplitude_ci95=None if peak is None else peak.ends,
        by_fit=peak is not None and peak.by_fit,
        at_least=peak is not None and peak.response is None,
        amplification=None if times is None else times.ratio,
        amplification_ci95=None if times is None else (times.ratio_low, times.ratio_high),
        cost=shares.get(channel, 0.0),
        reason=f"order {finding.order:.4g} meets {finding.mode_hz:.4g} Hz{of_whirl}{undecided}",
    )


def _peaks(
    crossing: Crossing, rpm_range: Ends, agreed: AgreedOrder, modal: ModalFit, settings: IdentifySettings
) -> dict[str, _Peak]:
    """Peak by channel of the order ``agreed`` at the ``crossing``, within ``rpm_range`` where a fit knows it.

    The fit of all speeds knows a peak best, and alone what a sweep would reach if held. Yet one amplitude has one
    number: the largest that is told of an order, recorded at held speeds, stays that unless the fit is surely above.
    """
    mode, rpm, peaks = crossing.mode, crossing.finding.rpm, dict[str, _Peak]()
    fits = responses_to(agreed.order, modal) if crossing.whirl is None else []
    of_fits = [(fit, peak) for fit in fits if (peak := _fitted_peak(fit, rpm, rpm_range, modal, mode)) is not None]
    for response, peak in sorted(of_fits, key=lambda pair: -pair[1].share):  # the best known is the last
        peaks[response.channel] = _Peak(peak.amplitude, peak.ends, response, by_fit=True)
    near = width_rpm(rpm, mode, settings)
    for line in agreed.lines:
        fitted = peaks.get(line.channel, _Peak(0.0, (0.0, 0.0)))
        by_fit = fitted.response
        seen = reported_within(line, *((rpm - near, rpm + near) if by_fit is None else rpm_range))
        if seen is None or fitted.amplitude > seen.high:
            continue
        if by_fit is None or (not by_fit.recording and seen.at == largest(line).at):
            peaks[line.channel] = _Peak(seen.amplitude, (seen.low, seen.high), by_fit)
    return peaks


def _fitted_peak(response: OrderResponse, rpm: float, rpm_range: Ends, modal: ModalFit, mode: Mode) -> HeldPeak | None:
    """Peak that ``mode`` makes at ``rpm`` by the fit ``response``; None where that does not know it."""
    is_known = response.fits and mode.damping_error <= ORDER_MODES.known_share * mode.damping_ratio
    if not is_known or not response.passes(rpm):
        return None
    peak = peak_of(response, modal, rpm_range)
    if peak.rpm in rpm_range:  # the flank of another mode, which is larger than this peak
        peak = peak_of(response, modal, (rpm, rpm))
    return peak if half_width(peak.freedom) * peak.share <= 1.0 - 1.0 / NUMBERS.peak_within_ratio else None


def _joined(met: list[AvoidedSpeed]) -> Iterator[AvoidedSpeed]:
    """One speed to avoid of all crossings whose ranges overlap, named and ranked after the costliest."""
    met = sorted(met, key=lambda peak: _range(peak)[0])
    begins, ends = np.array([_range(peak) for peak in met]).reshape(-1, 2).T
    first = np.flatnonzero(begins > np.append(-np.inf, np.maximum.accumulate(ends))[:-1]).tolist()
    for begin, end in pairwise([*first, len(met)]):
        by_cost = sorted(met[begin:end], key=lambda peak: -(peak.cost or 0.0))
        orders, modes_hz = zip(*((peak.order, peak.mode_hz) for peak in by_cost), strict=True)
        rpm_range = float(begins[begin]), float(ends[begin:end].max())
        reason = " and ".join(peak.reason for peak in by_cost)
        yield replace(by_cost[0], rpm_range=rpm_range, orders=orders, modes_hz=modes_hz, reason=reason)


def _by_modes(
    found: Sequence[Crossing], modal: ModalFit, largest: Sizes, settings: IdentifySettings
) -> Iterator[OpenBand]:
    """Speeds at which a known mode amplifies an order by more than is free, or may."""
    for crossing in found:
        finding, number, slower, named = crossing.finding, -1, 1.0, ""
        if crossing.whirl is None:
            number = modal.modes.index(crossing.mode)
        else:  # no fit holds a whirl, on which the order gains slower
            slower, named = crossing.whirl.slower(finding.order), "a whirl of "
        what = f"order {finding.order:.4g} with {named}{finding.mode_hz:.4g} Hz"
        fits = [fit for fit in responses_to(finding.order, modal) if fit.fits and number in fit.reached]
        if (not fits and finding.verdict != "not excited") or (finding.excited and _is_vague(crossing)):
            low, high = _amplifying(crossing.ends_rpm, settings.free_amplification)
            low, high = finding.rpm - slower * (finding.rpm - low), finding.rpm + slower * (high - finding.rpm)
            says = finding.verdict if finding.in_range else "beside the tested range, so that its flank may reach in"
            yield _open(low, high, f"{what}: {says}")
        alike = [(fit.recording, largest.unit[fit.channel], fit.force.span_rpm) for fit in fits]
        for key in sorted(set(alike)):
            group = [fit for fit, its_key in zip(fits, alike, strict=True) if its_key == key]
            matters = EXCLUSION.matters_share * max(largest.of_channel.get(fit.channel, 0.0) for fit in group)
            yield from _amplified(group, number, modal, what, matters=matters, settings=settings)


def _amplified(
    group: list[OrderResponse], number: int, modal: ModalFit, what: str, *, matters: float, settings: IdentifySettings
) -> Iterator[OpenBand]:
    """Speeds around the crossing at which mode ``number`` may amplify an order by more than is free.

    Amplitudes below ``matters`` do not count.
    """
    mode, factor = modal.modes[number], settings.free_amplification
    sigmas = float(ndtri(0.5 + 0.5 * settings.free_confidence))
    rpm = 60.0 * mode.frequency_hz / group[0].order
    beside = NUMBERS.beside_share + sigmas * mode.frequency_error_hz / mode.frequency_hz
    near = max(NUMBERS.near_dampings * mode.damping_ratio, beside)
    # all of it: what a flank adds to little is more than a resonance alone would make
    low, high = group[0].force.span_rpm
    turn = np.sinh(np.linspace(-3.0, 3.0, 41)) / np.sinh(3.0)
    grid = np.unique(np.clip(np.append(rpm * (1.0 + near * turn), np.geomspace(low, high, FLANKS)), low, high))
    both = together([with_and_without(fit, number, grid, modal) for fit in group])
    least, most = both.ends(sigmas, matters=matters)
    # where the mode itself is amplified less it carries the order without resonance: only what is sure counts there
    first, last = _amplifying((rpm * (1.0 - beside), rpm * (1.0 + beside)), factor)
    over = (least > factor) | ((most > factor) & (grid >= first) & (grid <= last))
    amplified = bool((least > factor).any())
    what += f": {'is' if amplified else 'may be'} amplified more than {factor:g} times"
    for place, end_place in _runs(over):
        begin, end = float(grid[max(place - 1, 0)]), float(grid[min(end_place + 1, len(grid) - 1)])
        if begin <= rpm * (1.0 + beside) and end >= rpm * (1.0 - beside):
            begin, end = min(begin, rpm * (1.0 - beside)), max(end, rpm * (1.0 + beside))
        yield _open(begin, end, what, amplified=amplified)


def _amplifying(rpm: tuple[float, float], factor: float) -> tuple[float, float]:
    """Speeds between which a resonance that is met somewhere in ``rpm`` amplifies ``factor`` times or more."""
    return rpm[0] * np.sqrt(factor / (factor + 1.0)), rpm[1] * np.sqrt(factor / (factor - 1.0))


def _by_unseen(
    orders: AgreedOrders, modal: ModalFit, speed_rpm: tuple[float, float], settings: IdentifySettings
) -> Iterator[OpenBand]:
    """Speeds at which an order could be amplified by more than is free and nobody saw it.

    By a mode that was not seen; an order that only the spectra of sweeps show also where it meets one of ``modal``.
    """
    (low, high), factor = speed_rpm, settings.free_amplification
    if not orders:
        yield _open(low, high, "no order stands out")
    measured = [agreed.order for agreed in orders]
    shown = [order for order in modal.shown_orders if not any(_is_order(order, other) for other in measured)]
    for order in (*measured, *shown):
        name, bounds = f"order {order:.4g}", [bound for bound in modal.unseen if _is_order(order, bound.order)]
        if order in shown:
            name += ", which only the spectrum of the sweep shows,"
            for mode in modal.modes:
                begin, end = (60.0 * hertz / order for hertz in mode.frequency_ends)
                yield _open(*_amplifying((begin, end), factor), f"{name} meets {mode.frequency_hz:.4g} Hz")
        elif bounds:
            speeds = [float(bound.speed_rpm[at]) for bound in bounds for at in (0, -1)]
            ends = (low, min(speeds)), (max(speeds), high)
            beside = [(begin, end) for begin, end in ends if end > begin * (1.0 + NUMBERS.same_speed_share)]
            yield from (_open(begin, end, f"{name} was not measured there") for begin, end in beside)
        else:
            yield _open(low, high, f"{name}: measured at too few speeds to tell a resonance between them")
        yield from (band for bound in bounds for band in _between(bound, factor, name))


def _is_order(order: float, other: float) -> bool:
    """Whether both numbers stand for one order."""
    return abs(order - other) < 1e-3 * max(1.0, order)


def _between(bound: UnseenBound, factor: float, name: str) -> list[OpenBand]:
    rpm, why = bound.speed_rpm, f"not tested between: {name} could be amplified more than {factor:g} times unseen"
    return [
        _open(float(rpm[max(first - 1, 0)]), float(rpm[min(last + 1, len(rpm) - 1)]), why)
        for first, last in _runs(~(bound.amplification <= factor))
    ]


def _runs(marked: Bools) -> list[tuple[int, int]]:
    """First and last places of the runs of what is ``marked``."""
    edges = np.diff(np.concatenate([[False], marked, [False]]).astype(np.int64))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))


def _split(
    opened: list[OpenBand], speed_rpm: tuple[float, float], settings: IdentifySettings
) -> tuple[tuple[FreeBand, ...], tuple[OpenBand, ...]]:
    """Free and open bands of the tested range: what nothing of ``opened`` touches, and what is not to be avoided."""
    low, high = speed_rpm
    free: list[FreeBand] = []
    excludes = (
        f"the data exclude that an order is amplified more than {settings.free_amplification:g} times "
        f"({100.0 * settings.free_confidence:g} %)"
    )
    start, narrowest = low, min(settings.crossing_band_rpm, high - low) if high > low else np.inf
    for band in [*sorted(opened, key=lambda band: band.low_rpm), _open(high, high, "")]:
        if min(band.low_rpm, high) - start >= narrowest:
            free.append(FreeBand(low_rpm=start, high_rpm=min(band.low_rpm, high), remark=excludes))
        start = max(start, band.high_rpm)
    ends = [low, *(end for band in free for end in (band.low_rpm, band.high_rpm)), high]
    rest = []
    for begin, end in zip(ends[::2], ends[1::2], strict=True):
        within = [band for band in opened if band.remark and band.low_rpm < end and band.high_rpm > begin]
        if end > begin and within:
            surest = sorted(within, key=lambda band: not band.amplified)
            reasons = "; ".join(dict.fromkeys(band.remark for band in surest))
            rest.append(_open(begin, end, reasons, amplified=any(band.amplified for band in within)))
    return tuple(free), tuple(rest)


LONE_NUMBERS = MethodNumbers("5-identify-explain.toml", "lone_peaks")


def lone_peaks(
    orders: Sequence[AgreedOrder],
    modal: ModalFit,
    avoided: Sequence[AvoidedSpeed],
    largest: Sizes,
    *,
    factor: float,
    sweep_rpm_per_s: float = 0.0,
) -> list[AvoidedSpeed]:
    """Speeds to avoid that no crossing accounts for: an order is there ``factor`` times what it is on both sides.

    Of each channel of each of the ``orders`` the largest amplitude of its neighbourhood, by the lower end of its
    interval, over the middling ones of the speeds on either side. Those that the speeds ``avoided`` of the same
    order hold are left out, and what is small beside the ``largest`` amplitude of its channel. The amplitude is the
    largest there of all channels of the same unit; its share of the largest of any order there ranks it. Its range
    ends half way to the speeds beside, in a sweep where a mode that it passes may have left it: so
    many hertz beside as the root of the hertz per second that ``sweep_rpm_per_s`` makes of it (Lewis 1932). The natural
    frequency is that of the ``modal`` fit between the neighbouring speeds; where there is none, that at which the order
    peaks.
    """
    lone: list[AvoidedSpeed] = []
    for agreed in orders:
        peaks = [
            (line, place, ratio)
            for line in agreed.lines
            for place, ratio in _lone_peaks_of(line, factor)
            if line.amplitude[place] >= EXCLUSION.matters_share * largest.of_channel[line.channel]
        ]
        for line, place, ratio in sorted(peaks, key=lambda peak: -peak[2]):
            order, rpm = agreed.order, float(line.speed_rpm[place])
            low, high = rpm - LONE_NUMBERS.same_row_share * rpm, rpm + LONE_NUMBERS.same_row_share * rpm
            alike = [other for other in agreed.lines if largest.unit[other.channel] == largest.unit[line.channel]]
            there = [(other.channel, seen) for other in alike if (seen := reported_within(other, low, high))]
            channel, worst = max(there, key=lambda of_channel: of_channel[1].amplitude)
            below = float(line.speed_rpm[line.speed_rpm < rpm].max())
            above = float(line.speed_rpm[line.speed_rpm > rpm].min())
            # a sweep rings behind a resonance
            is_swept = line.n_independent is not None and bool(line.n_independent[place] < 1.0)
            late = 60.0 / order * np.sqrt(order * sweep_rpm_per_s / 60.0) if is_swept else 0.0
            hz = order * rpm / 60.0
            near = [mode.frequency_hz for mode in modal.modes if below < 60.0 * mode.frequency_hz / order < above]
            mode_hz = min(near, key=lambda mode_hz: abs(mode_hz - hz), default=hz)
            where = f"near {mode_hz:.4g} Hz" if near else f"at {hz:.4g} Hz, which may be a natural frequency"
            peak = AvoidedSpeed(
                rank=1,
                order=order,
                orders=(order,),
                mode_hz=mode_hz,
                modes_hz=(mode_hz,),
                rpm=rpm,
                rpm_range=(min(0.5 * (below + rpm), rpm - late), max(0.5 * (rpm + above), rpm + late)),
                channel=channel,
                amplitude=worst.amplitude,
                amplitude_ci95=(worst.low, worst.high),
                at_least=True,
                amplification=ratio,
                cost=worst.amplitude / max(largest.in_unit(channel), worst.amplitude),
                reason=f"order {order:.4g} peaks {where}: {ratio:.2g} times what it is at the speeds beside",
            )
            # one peak of an order is told once: where its range, or one beside it, is told already
            (begin, end), reach = _range(peak), 1.0
            if line.n_independent is not None:
                reach += LONE_NUMBERS.around_share
            same = [other for other in (*avoided, *lone) if any(_is_order(order, mine) for mine in other.orders)]
            if not any(_range(other)[0] <= reach * end and begin <= reach * _range(other)[1] for other in same):
                lone.append(peak)
    return lone


def _lone_peaks_of(line: OrderLine, factor: float) -> Iterator[tuple[int, float]]:
    """Places of ``line`` that tower over both sides, and how many times."""
    rank = np.argsort(line.speed_rpm, kind="stable")
    speed, size = line.speed_rpm[rank], line.amplitude[rank]
    least = size - Z95 * line.amplitude_error[rank] if line.ends is None else line.ends[rank, 0]
    for place in range(1, len(rank) - 1):
        first = min(int(np.searchsorted(speed, speed[place] * (1.0 - LONE_NUMBERS.around_share))), place - 1)
        end = np.searchsorted(speed, speed[place] * (1.0 + LONE_NUMBERS.around_share), side="right")
        last = max(int(end), place + 2)
        if size[place] < size[first:last].max():
            continue
        beside = max(float(np.median(size[first:place])), float(np.median(size[place + 1 : last])))
        if beside > 0.0 and least[place] >= factor * beside:
            yield int(rank[place]), float(size[place]) / beside
