"""Where orders meet natural frequencies, and whether the order grows there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, stdtr

from crankorder.identify.false_discovery import claimed, simes
from crankorder.identify.found import AgreedOrder, Crossing, ModalFit, Mode, OrderLine, OrderResponse, Verdict
from crankorder.identify.intervals import ENDLESS_FREEDOM, Z95, half_width
from crankorder.identify.order_trend import PowerLaw, power_law
from crankorder.identify.responses import with_and_without
from crankorder.settings import IdentifySettings

Floats = NDArray[np.float64]

FALSE_DISCOVERY_RATE = 0.05
"""Of the crossings that are called excited so many may be called so by chance (Benjamini and Hochberg 1995)."""

NEIGHBOURHOOD_DAMPINGS = 4.0
"""Speeds within so many damping ratios of a crossing take no part in the trend beside it."""

BESIDE = 0.5
"""Natural logarithm of the ratio of speeds up to which the trend beside a crossing is taken, where enough are there."""

ENOUGH_BESIDE = 6
"""Speeds that are enough for a trend."""

LEAST_BESIDE = 3
"""Fewer speeds make no trend: a power law has two parameters."""

SAME_RESPONSE = 1e-3
"""Distance within which two numbers are one order."""

SAME_STATED = 0.01
"""Share of a stated order within which a found one is that."""

CLEARLY_EXCITED = 2.0
"""An order that cannot be so many times what it would be without the mode is not excited."""

MOSTLY_SEEN = 0.8
"""Share of the tested speeds around a crossing at which an order must be seen before it is called not excited."""

MEANINGLESS = 1e6
"""A trend that lets an amplification be as large as this is none."""


@dataclass(frozen=True)
class _Seen:
    """What one channel says of one crossing: ``chance`` that an order without the mode looks like that.

    ``ratio`` with its interval is that of the amplitude at ``at_rpm`` to the trend beside; None where there is none.
    """

    channel: str
    chance: float
    at_rpm: float | None = None
    ratio: float | None = None
    ratio_low: float = 0.0
    ratio_high: float = np.inf


def crossings(
    orders: tuple[AgreedOrder, ...],
    modal: ModalFit,
    *,
    speed_rpm: tuple[float, float],
    settings: IdentifySettings,
    stated: Sequence[float] = (),
) -> tuple[Crossing, ...]:
    """Meetings of every order with every natural frequency, by speed.

    An order is excited where its amplitude stands above the trend beside the crossing: a power law of the speeds
    outside the neighbourhood, with scatter of its own (DerSimonian and Laird 1986; Knapp and Hartung 2003), so that
    the excess is Student's t; or where the fit of the modes gives it a residue that noise would not (F test), by which
    the order is larger with the mode than without. Both tests of all channels are joined (Simes 1986), and of all
    crossings tested the false discovery rate is held at 5 % (Benjamini and Hochberg 1995). That an order rises is told
    of an undecided mode too: its ``remark`` stays beside it.

    ``verdict`` is "excited", "not excited" (in no channel can it be twice what it would be without the mode), "not
    decided", "not measured" (no speed within the resonance), "outside the tested range" or "undecided mode".
    ``amplification`` is the amplitude over the trend in the channel that shows it best, ``amplification_predicted``
    that of the fit at the natural frequency.

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
    tested = tested_speeds(orders)
    found: list[Crossing] = []
    seen_of: list[list[_Seen]] = []
    for agreed in orders:
        for number in range(len(modal.modes)):
            seen = _seen_of(agreed, number, modal, settings)
            found.append(_crossing(agreed, number, seen, modal, tested, speed_rpm, settings))
            seen_of.append(seen)
    missing = [order for order in stated if all(abs(order - item.order) > SAME_STATED * order for item in orders)]
    made = _decided(found, seen_of)
    made += [_unmeasured(order, mode, speed_rpm, settings) for order in missing for mode in modal.modes]
    return tuple(sorted(made, key=lambda item: (item.rpm, item.order)))


def tested_speeds(orders: tuple[AgreedOrder, ...]) -> Floats:
    """Speeds (n,) in rpm, ascending, at which any of ``orders`` was seen."""
    speeds = [line.speed_rpm for agreed in orders for line in agreed.lines]
    return np.unique(np.concatenate(speeds)) if speeds else np.zeros(0)


def width_rpm(rpm: float, mode: Mode, settings: IdentifySettings) -> float:
    """How far (rpm) from a crossing at ``rpm`` a speed still feels ``mode``.

    Its half-power width, and no less than ``settings.crossing_band_rpm``.
    """
    return max(2.0 * mode.damping_ratio * rpm, settings.crossing_band_rpm * (1.0 + 1e-6))


def _in_range(rpm: float, speed_rpm: tuple[float, float], settings: IdentifySettings) -> bool:
    return bool(speed_rpm[0] - settings.crossing_band_rpm <= rpm <= speed_rpm[1] + settings.crossing_band_rpm)


def _unmeasured(order: float, mode: Mode, speed_rpm: tuple[float, float], settings: IdentifySettings) -> Crossing:
    """Crossing of an order that was stated and not seen."""
    rpm, half = 60.0 * mode.frequency_hz / order, Z95 * mode.frequency_error_hz
    inside = _in_range(rpm, speed_rpm, settings)
    return Crossing(
        order=order,
        mode_hz=mode.frequency_hz,
        mode_hz_ci95=(mode.frequency_hz - half, mode.frequency_hz + half),
        rpm=rpm,
        rpm_ci95=(rpm * (1.0 - half / mode.frequency_hz), rpm * (1.0 + half / mode.frequency_hz)),
        in_range=inside,
        amplification_predicted=1.0 / (2.0 * max(mode.damping_ratio, 1e-6)),
        predicted_from="damping",
        remark=mode.undecided,
        channels=(),
        amplification=None,
        amplification_ci95=None,
        evidence="the order was stated, and does not stand out of the data" if inside else "",
        verdict="not measured" if inside else "outside the tested range",
    )


def _seen_of(agreed: AgreedOrder, number: int, modal: ModalFit, settings: IdentifySettings) -> list[_Seen]:
    """What each channel says of the crossing of ``agreed`` with mode ``number``."""
    mode = modal.modes[number]
    rpm = 60.0 * mode.frequency_hz / agreed.order
    others = [(60.0 * m.frequency_hz / agreed.order, m.damping_ratio) for m in modal.modes]
    seen: list[_Seen] = []
    for line in agreed.lines:
        seen += _above_trend(line, rpm, width_rpm(rpm, mode, settings), others)
    for response in responses_to(agreed.order, modal):
        seen += _by_residue(response, number, modal)
    return seen


def responses_to(order: float, modal: ModalFit) -> list[OrderResponse]:
    """Responses of ``modal`` to ``order``, of all channels and recordings."""
    return [item for item in modal.responses if abs(item.order - order) < SAME_RESPONSE]


def _crossing(
    agreed: AgreedOrder,
    number: int,
    seen: list[_Seen],
    modal: ModalFit,
    tested: Floats,
    speed_rpm: tuple[float, float],
    settings: IdentifySettings,
) -> Crossing:
    """One crossing with the verdict that it has where it is not excited."""
    mode = modal.modes[number]
    rpm = 60.0 * mode.frequency_hz / agreed.order
    relative = [mode.frequency_error_hz / mode.frequency_hz, agreed.order_error / agreed.order]
    error = float(np.hypot(relative[0], relative[1]))
    # the order's error has few degrees of freedom, the mode's many (Welch and Satterthwaite)
    freedom = ENDLESS_FREEDOM
    if relative[1] > 0.0 and agreed.degrees_of_freedom > 0.0:
        freedom = min(freedom, agreed.degrees_of_freedom * (error / relative[1]) ** 4)
    half, mode_half = rpm * error * half_width(freedom), Z95 * mode.frequency_error_hz
    inside = _in_range(rpm, speed_rpm, settings)
    fitted = [item for item in responses_to(agreed.order, modal) if item.fits]
    trends = [item for item in seen if item.ratio is not None] if inside else []
    best = min(trends, key=lambda item: item.chance, default=None)
    return Crossing(
        order=agreed.order,
        mode_hz=mode.frequency_hz,
        mode_hz_ci95=(mode.frequency_hz - mode_half, mode.frequency_hz + mode_half),
        rpm=rpm,
        rpm_ci95=(rpm - half, rpm + half),
        in_range=inside,
        amplification_predicted=_predicted(fitted, number, modal),
        predicted_from="fit" if fitted else "damping",
        remark=mode.undecided,
        channels=tuple([item.channel for item in trends] or [line.channel for line in agreed.lines]),
        amplification=None if best is None else best.ratio,
        amplification_ci95=None if best is None else (best.ratio_low, best.ratio_high),
        evidence=_evidence(agreed, rpm, mode, best, tested, settings) if inside else "",
        verdict=_unless_excited(agreed, number, trends, fitted, modal, tested, inside=inside),
    )


def _unless_excited(
    agreed: AgreedOrder,
    number: int,
    trends: list[_Seen],
    fitted: list[OrderResponse],
    modal: ModalFit,
    tested: Floats,
    *,
    inside: bool,
) -> Verdict:
    """What is said of a crossing at which no order was seen to rise."""
    mode = modal.modes[number]
    rpm = 60.0 * mode.frequency_hz / agreed.order
    if not inside:
        return "outside the tested range"
    resolved = bool(len(tested)) and bool(np.abs(tested - rpm).min() <= 2.0 * mode.damping_ratio * rpm)
    quiet = resolved and bool(trends) and max(item.ratio_high for item in trends) < CLEARLY_EXCITED
    quiet &= all(_seen_all_around(line, rpm, tested) for line in agreed.lines)
    near = rpm * (1.0 + mode.damping_ratio * np.linspace(-1.0, 1.0, 5))
    known = [item for item in fitted if number in item.reached and item.span_rpm[0] <= rpm <= item.span_rpm[1]]
    if {item.channel for item in known} >= {line.channel for line in agreed.lines} and known:
        ends = [with_and_without(item, number, near, modal).ends(half_width(float(item.freedom)))[1] for item in known]
        quiet |= max(float(high.max()) for high in ends) < CLEARLY_EXCITED
    if mode.undecided:
        return "undecided mode"
    if quiet:
        return "not excited"
    return "not decided" if resolved or known else "not measured"


def _evidence(
    agreed: AgreedOrder, rpm: float, mode: Mode, best: _Seen | None, tested: Floats, settings: IdentifySettings
) -> str:
    """What the amplitudes around a crossing inside the tested range show."""
    near = width_rpm(rpm, mode, settings)
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


def _predicted(fitted: list[OrderResponse], number: int, modal: ModalFit) -> float:
    """Largest ratio, of all channels, of the response with the mode to that without it, at its natural frequency.

    1 / (2 ζ) where nothing was ``fitted``, and at most: what a mode makes of a force, seen against its own stiffness.
    """
    ratios = [amplification(item, number, modal) for item in fitted]
    quality = float(1.0 / (2.0 * max(modal.modes[number].damping_ratio, 1e-6)))
    # beyond that the fit says that hardly anything is left without the mode, which is no amplification
    return min([max(ratios), quality]) if ratios else quality


def amplification(response: OrderResponse, number: int, modal: ModalFit) -> float:
    """How much larger ``response`` is at the natural frequency of mode ``number`` of ``modal`` than without that mode.

    Over the noise of a row where less would be left without it.
    """
    rpm = np.array([60.0 * modal.modes[number].frequency_hz / response.order])
    return float(with_and_without(response, number, rpm, modal).ratio[0])


def _above_trend(line: OrderLine, rpm: float, near_rpm: float, others: list[tuple[float, float]]) -> list[_Seen]:
    """How far the amplitude of ``line`` near ``rpm`` stands above the trend of the speeds beside; [] where unknown."""
    speed = line.speed_rpm
    at = np.flatnonzero(np.abs(speed - rpm) <= near_rpm)
    law = _trend_beside(line, rpm, near_rpm, others)
    at = at[(line.amplitude[at] > 0.0) & np.isfinite(line.amplitude_error[at])]
    if not at.size or law is None:
        return []
    excess, error = law.excess(speed[at], line.amplitude[at], line.amplitude_error[at])
    best = int(np.argmax(excess / error))
    chance = min(1.0, at.size * float(stdtr(law.freedom, -excess[best] / error[best])))
    half = half_width(law.freedom, level=1.0 - 0.05 / at.size) * error[best]
    ratio = float(np.exp(excess[best]))
    with np.errstate(over="ignore"):
        low, high = ratio * np.exp(-half), ratio * np.exp(half)
    if not high < MEANINGLESS:
        return []
    return [_Seen(line.channel, chance, float(speed[at[best]]), ratio, float(low), float(high))]


def _trend_beside(line: OrderLine, rpm: float, near_rpm: float, others: list[tuple[float, float]]) -> PowerLaw | None:
    """Power law of ``line`` beside ``rpm``; the crossings with ``others`` (rpm, damping) are left out if it can be."""
    speed = line.speed_rpm
    damping = min(others, key=lambda item: abs(item[0] - rpm))[1]
    free = np.abs(speed - rpm) > max(near_rpm, NEIGHBOURHOOD_DAMPINGS * damping * rpm)
    clear = free.copy()
    for other, its_damping in others:
        clear &= np.abs(speed - other) > max(0.5 * near_rpm, 2.0 * its_damping * other)
    close = np.abs(np.log(speed / rpm)) < BESIDE
    for chosen in (clear & close, clear, free & close, free):
        if np.count_nonzero(chosen) >= ENOUGH_BESIDE:
            return power_law(speed[chosen], line.amplitude[chosen], line.amplitude_error[chosen])
    if np.count_nonzero(free) < LEAST_BESIDE:
        return None
    return power_law(speed[free], line.amplitude[free], line.amplitude_error[free])


def _by_residue(response: OrderResponse, number: int, modal: ModalFit) -> list[_Seen]:
    """What the residue of mode ``number`` says: its F test against none; [] where the fit does not hold the mode."""
    place = np.flatnonzero(response.reached == number)
    if not response.fits or not len(place) or response.freedom < 1 or amplification(response, number, modal) <= 1.0:
        return []
    at = len(response.smooth) + int(place[0])
    squared = abs(response.residue[number]) ** 2 / max(float(response.covariance[at, at].real), 1e-300)
    return [_Seen(response.channel, float(fdtrc(2.0, float(response.freedom), 0.5 * squared)))]


def _seen_all_around(line: OrderLine, rpm: float, tested: Floats) -> bool:
    """Whether ``line`` stands out at most speeds around ``rpm``: where it hides in the floor, its trend is too high."""
    around = np.abs(np.log(tested / rpm)) < BESIDE
    seen = np.abs(np.log(line.speed_rpm / rpm)) < BESIDE
    return bool(np.count_nonzero(seen) >= MOSTLY_SEEN * np.count_nonzero(around))


def _decided(found: list[Crossing], seen_of: list[list[_Seen]]) -> list[Crossing]:
    """``found`` with those called excited of which ``seen_of``, one list for each, says so."""
    chances = np.full(len(found), np.nan)
    for number, (item, seen) in enumerate(zip(found, seen_of, strict=True)):
        if item.in_range and seen:
            chances[number] = simes(np.array([one.chance for one in seen]))
    excited = claimed(chances, q=FALSE_DISCOVERY_RATE)
    made = []
    for item, seen, chance, sure in zip(found, seen_of, chances.tolist(), excited.tolist(), strict=True):
        if np.isfinite(chance):
            item = replace(item, chance=chance)
        if sure:
            shows = {one.channel for one in seen if len(seen) * one.chance <= FALSE_DISCOVERY_RATE}
            shows |= {min(seen, key=lambda one: one.chance).channel}
            evidence = f"{item.evidence}; chance without the mode {chance:.1g}"
            item = replace(item, verdict="excited", channels=tuple(sorted(shows)), evidence=evidence)
        made.append(item)
    return made
