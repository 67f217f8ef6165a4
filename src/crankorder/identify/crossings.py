"""Where orders meet natural frequencies, and whether the order grows there."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import fdtrc, stdtr

from crankorder.findings import CrossingFinding, Verdict
from crankorder.identify.found import AgreedOrder, Crossing, ModalFit, Mode, OrderLine, OrderResponse, Seen, Whirl
from crankorder.identify.lines.growth import power_law
from crankorder.identify.modes.order_search import ORDER_MODES
from crankorder.identify.modes.responses import WithAndWithout, with_and_without
from crankorder.orders.intervals import ENDLESS_FREEDOM, claimed, half_width, positive_interval, simes
from crankorder.quantities import Bools, Floats
from crankorder.records import Ends, finite
from crankorder.settings import IdentifySettings, MethodNumbers

TREND_NUMBERS = MethodNumbers("5-identify-explain.toml", "above_trend")


def width_rpm(rpm: float, mode: Mode, settings: IdentifySettings) -> float:
    """How far (rpm) from a crossing at ``rpm`` a speed still feels ``mode``.

    Its half-power width, and no less than ``settings.crossing_band_rpm``.
    """
    return max(2.0 * mode.damping_ratio * rpm, settings.crossing_band_rpm * (1.0 + 1e-6))


def evidence_beside(agreed: AgreedOrder, rpm: float, mode: Mode, best: Seen | None, tested: Floats, near: float) -> str:
    """What the amplitudes of ``agreed`` around its crossing at ``rpm`` with ``mode``, inside the tested range, show.

    ``best`` is the channel that shows it best, None where no trend is known; ``tested`` (n,) are all speeds in rpm, of
    which those within ``near`` count.
    """
    near_tested = tested[np.abs(tested - rpm) <= near]
    if best is not None:
        said = (
            f"in {best.channel} {best.ratio:.2g} times the trend beside it at {best.at_rpm:.4g} rpm "
            f"({best.ratio_low:.2g} to {best.ratio_high:.2g})"
        )
        if np.abs(tested - rpm).min() > 2.0 * mode.damping_ratio * rpm:
            said += "; the tested speeds are further apart than the resonance is wide"
        return said
    if any(np.any(np.abs(line.speed_rpm - rpm) <= near) for line in agreed.lines):
        return "too few speeds beside it for a trend"
    if near_tested.size:
        return f"the order does not stand over the floor at {near_tested[0]:.4g} rpm"
    return "no speed near enough was tested"


def above_trend(line: OrderLine, rpm: float, near_rpm: float, others: list[tuple[float, float]]) -> list[Seen]:
    """How far the amplitude of ``line`` near ``rpm`` stands above the trend of the speeds beside; [] where unknown.

    Speeds within ``near_rpm`` are near; ``others`` are all crossings of the order (rpm, damping ratio).
    """
    speed, is_usable = line.speed_rpm, (line.amplitude > 0.0) & np.isfinite(line.amplitude_error)
    at = np.flatnonzero(is_usable & (np.abs(speed - rpm) <= near_rpm))
    beside = _beside(speed, rpm, near_rpm, others) & is_usable & np.isfinite(speed)
    if not at.size or np.count_nonzero(beside) < 3 or np.ptp(speed[beside]) <= 1e-6 * float(np.mean(speed[beside])):
        return []
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = np.clip(line.amplitude_error / line.amplitude, *_RELATIVE_ERRORS)
    law = power_law(np.log(speed[beside]), np.log(line.amplitude[beside]), relative[beside])
    excess, error = law.excess(np.log(speed[at]), np.log(line.amplitude[at]), relative[at])
    best = int(np.argmax(excess / error))
    chance = min(1.0, at.size * float(stdtr(law.freedom, -excess[best] / error[best])))
    half = half_width(law.freedom, level=1.0 - 0.05 / at.size) * error[best]
    ratio = float(np.exp(excess[best]))
    with np.errstate(over="ignore"):
        low, high = ratio * np.exp(-half), ratio * np.exp(half)
    if not high < TREND_NUMBERS.meaningless_amplification:
        return []
    return [Seen(line.channel, chance, float(speed[at[best]]), ratio, float(low), float(high))]


def _beside(speed: Floats, rpm: float, near_rpm: float, others: list[tuple[float, float]]) -> Bools:
    """Which of the ``speed`` (n,) beside ``rpm`` tell a trend; none where they are too few.

    The crossings with ``others`` (rpm, damping) are left out if enough stay.
    """
    damping = min(others, key=lambda crossing: abs(crossing[0] - rpm))[1]
    free = np.abs(speed - rpm) > max(near_rpm, TREND_NUMBERS.neighbourhood_dampings * damping * rpm)
    clear = free.copy()
    for other, its_damping in others:
        clear &= np.abs(speed - other) > max(0.5 * near_rpm, 2.0 * its_damping * other)
    close = np.abs(np.log(speed / rpm)) < TREND_NUMBERS.beside_log_ratio
    choices = (clear & close, clear, free & close)
    chosen = next((rows for rows in choices if np.count_nonzero(rows) >= TREND_NUMBERS.enough_beside), free)
    return np.asarray(chosen & (np.count_nonzero(chosen) >= TREND_NUMBERS.least_beside))


def _count_around(rpm: float, speeds_rpm: Floats) -> int:
    """How many of ``speeds_rpm`` (n,) are beside ``rpm``."""
    return int(np.count_nonzero(np.abs(np.log(speeds_rpm / rpm)) < TREND_NUMBERS.beside_log_ratio))


LAW_NUMBERS = MethodNumbers("5-identify-explain.toml", "order_trend")


_RELATIVE_ERRORS = LAW_NUMBERS.least_relative_error, LAW_NUMBERS.most_relative_error

NUMBERS = MethodNumbers("5-identify-explain.toml", "crossings")


EXTRAPOLATED = "extrapolated: no speed there was tested, and order and natural frequency are taken to stay as they are"
"""Evidence of a crossing outside the tested range."""

UNSEEN = "the order was stated, and does not stand out of the data"
"""Evidence of a crossing inside it at which nothing was measured."""


def crossings(
    orders: Sequence[AgreedOrder],
    modal: ModalFit,
    *,
    speed_rpm: tuple[float, float],
    settings: IdentifySettings,
    stated: Sequence[float] = (),
) -> tuple[Crossing, ...]:
    """Meetings of every order with every natural frequency, that of a whirl where it is at that speed, by speed.

    An order is excited where its amplitude stands above the trend beside the crossing: a power law of the speeds
    outside the neighbourhood, with scatter of its own (Paule and Mandel 1982; Knapp and Hartung 2003), so that
    the excess is Student's t; or where the fit of the modes gives it a residue that noise would not (F test), by which
    the order is larger with the mode than without. Both tests of all channels are joined (Simes 1986), and of all
    crossings tested the false discovery rate is held at 5 % (Benjamini and Hochberg 1995). That an order rises is told
    of an undecided mode too: its ``remark`` stays beside it.

    ``verdict`` is "excited", "not excited" (in no channel can it be twice what it would be without the mode), "not
    decided", "not measured" (no speed within the resonance), "outside the tested range" or "undecided mode".
    ``amplification`` is the amplitude over the trend in the channel that shows it best, or that of the fit
    (:func:`higher`): the trend tells of the speeds that were measured, in a sweep while it rings up, the fit of the
    peak. ``amplification_predicted`` is that of the fit at the natural frequency.

    Parameters
    ----------
    orders : those of the test as all channels agree on them
    modal : the modes and, where it holds them, the responses of the orders
    speed_rpm : slowest and fastest speed of the test, rpm; NaN, and nothing, where no speed is known
    settings : ``crossing_band_rpm`` says how near to a tested speed a crossing counts as tested
    stated : orders that the machine is said to have; where none of ``orders`` is one of them it was not measured
    """
    if not (np.isfinite(speed_rpm[0]) and np.isfinite(speed_rpm[1])):
        return ()
    tested = np.unique([rpm for agreed in orders for rpm in agreed.speed_rpm])  # at which any order was seen
    met: list[tuple[Crossing, list[Seen]]] = []
    for agreed in orders:
        for number, fit, whirl in _met_by(agreed.order, modal):
            crossing = _unmeasured(agreed.order, fit.modes[number], whirl, speed_rpm, settings)
            rpm, near = crossing.finding.rpm, width_rpm(crossing.finding.rpm, crossing.mode, settings)
            others = [(60.0 * mode.frequency_hz / agreed.order, mode.damping_ratio) for mode in fit.modes]
            trends = [excess for line in agreed.lines for excess in above_trend(line, rpm, near, others)]
            crossing = replace(crossing, trends=tuple(trends))
            seen = trends + [test for of in responses_to(agreed.order, fit) for test in _by_residue(of, number, fit)]
            met.append((_measured(crossing, agreed, number, fit, tested, near), seen))
    unmeasured = [
        _unmeasured(order, fit.modes[number], whirl, speed_rpm, settings)
        for order in stated
        if all(abs(order - own.order) > NUMBERS.same_stated_share * order for own in orders)
        for number, fit, whirl in _met_by(order, modal)
    ]
    return tuple(sorted([*_decided(met), *unmeasured], key=lambda met: (met.finding.rpm, met.finding.order)))


def _met_by(order: float, modal: ModalFit) -> list[tuple[int, ModalFit, Whirl | None]]:
    """Modes that ``order`` meets, by number in the fit that holds them, and the whirl that has each, where it moves."""
    passed = [(whirl, mode) for whirl in modal.whirls if (mode := whirl.met_by(order)) is not None]
    return [
        *((number, modal, None) for number in range(len(modal.modes))),
        # no fit of the orders holds a whirl
        *((0, ModalFit((mode, *modal.modes), (), np.zeros((0, 0))), whirl) for whirl, mode in passed),
    ]


def _unmeasured(
    order: float, mode: Mode, whirl: Whirl | None, speed_rpm: tuple[float, float], settings: IdentifySettings
) -> Crossing:
    """Crossing of an ``order`` that was stated and not seen, with the ``mode`` that stays or that a ``whirl`` has."""
    rpm, near = 60.0 * mode.frequency_hz / order, settings.crossing_band_rpm
    inside = bool(speed_rpm[0] - near <= rpm <= speed_rpm[1] + near)
    finding = CrossingFinding(
        order=order,
        mode_hz=mode.frequency_hz,
        mode_hz_ci95=mode.frequency_ends,
        rpm=rpm,
        rpm_ci95=_ends_rpm(rpm, 60.0 * mode.frequency_half_hz / order, order, whirl),
        in_range=inside,
        amplification_predicted=_quality_factor(mode),
        predicted_from="damping",
        remark=mode.undecided,
        evidence=_said(mode, whirl, UNSEEN) if inside else EXTRAPOLATED,
        verdict="not measured" if inside else "outside the tested range",
        excited=False,
    )
    return Crossing(finding, mode, whirl)


def _ends_rpm(rpm: float, half: float, order: float, whirl: Whirl | None) -> Ends:
    """Interval of a crossing's speed, ``half`` as wide; on a ``whirl`` the ``order`` gains slower and it errs more."""
    ends = positive_interval(rpm, half)
    return ends if whirl is None else positive_interval(rpm, (ends[1] - rpm) * whirl.slower(order))


def _said(mode: Mode, whirl: Whirl | None, evidence: str) -> str:
    """The ``evidence`` of a crossing, behind that of the ``mode`` if a ``whirl`` has it."""
    return evidence if whirl is None else "; ".join(filter(None, (mode.evidence, evidence)))


def _quality_factor(mode: Mode) -> float:
    """What ``mode`` makes of a force at its frequency, against its own stiffness: 1 / (2 ζ)."""
    return 1.0 / (2.0 * max(mode.damping_ratio, 1e-6))


def responses_to(order: float, modal: ModalFit) -> list[OrderResponse]:
    """Responses of ``modal`` to ``order``, of all channels and recordings."""
    return [response for response in modal.responses if abs(response.order - order) < NUMBERS.same_response_orders]


def _measured(
    crossing: Crossing, agreed: AgreedOrder, number: int, modal: ModalFit, tested: Floats, near: float
) -> Crossing:
    """``crossing`` as the amplitudes of ``agreed`` show it, with the verdict that it has where it is not excited.

    The mode is that of the ``number`` in ``modal``; ``tested`` are all speeds in rpm, of which those within ``near``
    count as at the crossing.
    """
    mode, whirl, finding = crossing.mode, crossing.whirl, crossing.finding
    of_order, freedom = agreed.order_error / agreed.order, ENDLESS_FREEDOM
    error = float(np.hypot(mode.frequency_error_hz / mode.frequency_hz, of_order))
    # the order's error has few degrees of freedom, the mode's many (Welch and Satterthwaite)
    if of_order > 0.0 and agreed.degrees_of_freedom > 0.0:
        freedom = min(freedom, agreed.degrees_of_freedom * (error / of_order) ** 4)
    half = finding.rpm * error * half_width(freedom)
    fitted = [response for response in responses_to(agreed.order, modal) if response.fits]
    ratios, quality = [amplification(response, number, modal) for response in fitted], _quality_factor(mode)
    finding = replace(
        finding,
        rpm_ci95=_ends_rpm(finding.rpm, half, agreed.order, whirl),
        # beyond that the fit says that hardly anything is left without the mode, which is no amplification
        amplification_predicted=min(max(ratios, default=quality), quality),
        predicted_from="fit" if fitted else "damping",
        channels=tuple(line.channel for line in agreed.lines),
    )
    if not finding.in_range:
        return replace(crossing, finding=finding)
    trends, rpm, least = crossing.trends, finding.rpm, NUMBERS.clearly_excited_ratio
    trend = min(trends, key=lambda excess: excess.chance, default=None)
    by_fit = [excess for fit in fitted if (excess := fitted_excess(fit, number, modal)) is not None]
    best = None if trend is None else higher(trend, by_fit)
    evidence = evidence_beside(agreed, rpm, mode, trend, tested, near)
    if best is not None and best is not trend:
        low, high = best.ratio_low, best.ratio_high
        times = f"{best.ratio:.2g} times" if np.isfinite(high) else f"at least {low:.2g} times"
        span = f" ({low:.2g} to {high:.2g})" if np.isfinite(high) else ""
        evidence = f"in {best.channel} {times} what it is without the mode, by the fit{span}"
    # a resonance that was measured through without the order rising is not excited
    resolved = bool(len(tested)) and bool(np.abs(tested - rpm).min() <= 2.0 * mode.damping_ratio * rpm)
    quiet = resolved and bool(trends) and max(excess.ratio_high for excess in trends) < least
    # where a line hides in the floor around the crossing, its trend is too high
    most, *counts = (_count_around(rpm, speeds) for speeds in (tested, *(line.speed_rpm for line in agreed.lines)))
    quiet &= min(counts, default=most) >= TREND_NUMBERS.mostly_seen_share * most
    known = [fit for fit in fitted if number in fit.reached and fit.passes(rpm)]
    if {fit.channel for fit in known} >= {line.channel for line in agreed.lines} and known:
        ends = [_beside_mode(fit, number, modal).ends(half_width(float(fit.degrees_of_freedom)))[1] for fit in known]
        quiet |= max(float(high.max()) for high in ends) < least
    quiet &= all(excess.ratio_low < least for excess in by_fit)
    otherwise: Verdict = "not decided" if resolved or known else "not measured"
    finding = replace(
        finding,
        channels=tuple(excess.channel for excess in trends) or finding.channels,
        amplification=None if best is None else best.ratio,
        amplification_ci95=None if best is None else (best.ratio_low, best.ratio_high),
        evidence=_said(mode, whirl, evidence),
        verdict="undecided mode" if mode.undecided else "not excited" if quiet else otherwise,
    )
    return replace(crossing, finding=finding)


def fitted_excess(response: OrderResponse, number: int, modal: ModalFit) -> Seen | None:
    """How many times what it is without mode ``number`` of ``modal`` the fit of ``response`` is at its frequency.

    With its 95 % interval, which leaves ``shape_share`` of the peak to what no noise tells; its upper end is endless
    where nothing may be left without the mode. The factor and its lower end are 1 / (2 ζ) at most. None where the fit
    does not hold the mode, or not that speed, or where its damping is not known.
    """
    mode = modal.modes[number]
    rpm, is_known = 60.0 * mode.frequency_hz / response.order, number in response.reached
    is_known &= mode.damping_error <= ORDER_MODES.known_share * mode.damping_ratio
    if not (is_known and response.fits and response.passes(rpm)):
        return None
    both = _beside_mode(response, number, modal)
    sigmas, least = half_width(float(response.degrees_of_freedom)), float(both.least[0])
    size, size_error, without, without_error = (
        float(size[0, AT_MODE]) for size in (both.with_mode, both.with_error, both.without, both.without_error)
    )
    unsure = sigmas * without_error + NUMBERS.shape_share * size
    low = max(size - sigmas * size_error, 0.0) / max(without + unsure, least, 1e-300)
    high = (size + sigmas * size_error) / (without - unsure) if without - unsure > least else np.inf
    quality = _quality_factor(mode)
    ratio = min(float(both.ratio[AT_MODE]), quality)
    return Seen(response.channel, np.nan, rpm, ratio, min(low, quality), high)


def higher(trend: Seen, by_fit: Sequence[Seen]) -> Seen:
    """The largest of the excesses ``by_fit`` where its interval lies above that of the ``trend``; else the trend's."""
    above = [excess for excess in by_fit if excess.ratio_low > trend.ratio_high]
    return max(above, key=lambda excess: excess.ratio_low, default=trend)


def amplification(response: OrderResponse, number: int, modal: ModalFit) -> float:
    """How much larger ``response`` is at the natural frequency of mode ``number`` of ``modal`` than without that mode.

    Over the noise of a row where less would be left without it.
    """
    return float(_beside_mode(response, number, modal).ratio[AT_MODE])


BESIDE = np.linspace(-1.0, 1.0, 5)
"""Distances from a natural frequency, in damping ratios of it, at which a response is looked at."""

AT_MODE = 2
"""Which of them is none."""


@functools.lru_cache(maxsize=1024)
def _beside_mode(response: OrderResponse, number: int, modal: ModalFit) -> WithAndWithout:
    """What ``response`` is with mode ``number`` of ``modal`` and without it, at its frequency and beside it."""
    mode = modal.modes[number]
    rpm = 60.0 * mode.frequency_hz / response.order * (1.0 + mode.damping_ratio * BESIDE)
    return with_and_without(response, number, rpm, modal)


def _by_residue(response: OrderResponse, number: int, modal: ModalFit) -> list[Seen]:
    """What the residue of mode ``number`` says: its F test against none; [] where the fit does not hold the mode."""
    place = np.flatnonzero(response.reached == number)
    holds = response.fits and len(place) > 0 and response.degrees_of_freedom >= 1
    if not holds or amplification(response, number, modal) <= 1.0:
        return []
    at = len(response.smooth) + int(place[0])
    squared = abs(response.residue[number]) ** 2 / max(float(response.covariance[at, at].real), 1e-300)
    return [Seen(response.channel, float(fdtrc(2.0, float(response.degrees_of_freedom), 0.5 * squared)))]


def _decided(met: list[tuple[Crossing, list[Seen]]]) -> Iterator[Crossing]:
    """Crossings of ``met``, those called excited of which what was seen there says so."""
    of_met = [[each.chance for each in seen] if crossing.finding.in_range else [] for crossing, seen in met]
    chances = np.array([simes(np.array(of_one)) if of_one else np.nan for of_one in of_met])
    excited = claimed(chances, q=NUMBERS.false_discovery_rate)
    for (crossing, seen), chance, sure in zip(met, chances.tolist(), excited.tolist(), strict=True):
        finding = replace(crossing.finding, chance=finite(chance))
        if sure:
            shows = {each.channel for each in seen if len(seen) * each.chance <= NUMBERS.false_discovery_rate}
            channels = tuple(sorted(shows | {min(seen, key=lambda each: each.chance).channel}))
            evidence = f"{finding.evidence}; chance without the mode {chance:.1g}"
            finding = replace(finding, verdict="excited", excited=True, channels=channels, evidence=evidence)
        yield replace(crossing, finding=finding)
