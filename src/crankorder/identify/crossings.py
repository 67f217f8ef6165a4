"""Where orders meet natural frequencies, and whether the order grows there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from crankorder.identify.false_discovery import claimed, simes
from crankorder.identify.found import AgreedOrder, ModalFit, Mode, OrderLine, OrderResponse
from crankorder.identify.intervals import ENDLESS_FREEDOM, Z95, half_width
from crankorder.identify.order_trend import PowerLaw, power_law
from crankorder.identify.resonance import resonance
from crankorder.settings import IdentifySettings

Floats = NDArray[np.float64]

FALSE_DISCOVERY_RATE = 0.05
"""Of the crossings that are called excited so many may be called so by chance (Benjamini and Hochberg 1995)."""

HIGHEST_ORDER = 20.0
"""Orders above this are not listed."""

NEIGHBOURHOOD_DAMPINGS = 4.0
"""Speeds within so many damping ratios of a crossing take no part in the trend beside it."""

BESIDE = 0.5
"""Natural logarithm of the ratio of speeds up to which the trend beside a crossing is taken, where enough are there."""

ENOUGH_BESIDE = 6
"""Speeds that are enough for a trend."""

LEAST_BESIDE = 3
"""Fewer speeds make no trend: a power law has two parameters."""

CLEARLY_EXCITED = 2.0
"""An order that cannot be so many times its trend in any channel is not excited."""

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
    orders: tuple[AgreedOrder, ...], modal: ModalFit, *, speed_rpm: tuple[float, float], settings: IdentifySettings
) -> list[dict[str, Any]]:
    """Meetings of every order with every natural frequency, by speed, as records of ``findings.json``.

    An order is excited where its amplitude stands above the trend beside the crossing: a power law of the speeds
    outside the neighbourhood, with scatter of its own (DerSimonian and Laird 1986; Knapp and Hartung 2003), so that
    the excess is Student's t; or where the fit of the modes gives it a residue that noise would not (F test), by which
    the order is larger with the mode than without. Both tests of all channels are joined (Simes 1986), and of all
    crossings tested the false discovery rate is held at 5 % (Benjamini and Hochberg 1995).

    ``verdict`` is "excited", "not excited" (the order is seen all around, and in no channel can it be twice its trend),
    "not decided", "not measured" (no speed within the resonance), "outside the tested range" or "undecided mode".
    ``amplification`` is the amplitude over the trend in the channel that shows it best, ``amplification_predicted``
    that of the fit at the natural frequency.

    Parameters
    ----------
    orders : those of the test as all channels agree on them
    modal : the modes and, where it holds them, the responses of the orders. Modes that are undecided are listed with
        their ``remark`` and are excited by nothing
    speed_rpm : slowest and fastest speed of the test, rpm; NaN, and no records, where no speed is known
    settings : ``crossing_band_rpm`` says how near to a tested speed a crossing counts as tested
    """
    if not (np.isfinite(speed_rpm[0]) and np.isfinite(speed_rpm[1])):
        return []
    tested = tested_speeds(orders)
    records: list[dict[str, Any]] = []
    seen_of: list[list[_Seen]] = []
    for agreed in orders:
        if agreed.order > HIGHEST_ORDER:
            continue
        for number, mode in enumerate(modal.modes):
            record, seen = _crossing(agreed, number, modal, speed_rpm, settings)
            records.append(record | _measured(seen, mode, agreed, record, tested, settings))
            seen_of.append(seen)
    _decide(records, seen_of)
    return sorted(records, key=lambda record: (record["rpm"], record["order"]))


def tested_speeds(orders: tuple[AgreedOrder, ...]) -> Floats:
    """Speeds (n,) in rpm, ascending, at which any of ``orders`` was seen."""
    speeds = [line.speed_rpm for agreed in orders for line in agreed.lines]
    return np.unique(np.concatenate(speeds)) if speeds else np.zeros(0)


def width_rpm(record: dict[str, Any], mode: Mode, settings: IdentifySettings) -> float:
    """How far (rpm) from the crossing ``record`` a speed still feels ``mode``.

    Its half-power width, and no less than ``settings.crossing_band_rpm``.
    """
    return max(2.0 * mode.damping_ratio * float(record["rpm"]), settings.crossing_band_rpm * (1.0 + 1e-6))


def _crossing(
    agreed: AgreedOrder, number: int, modal: ModalFit, speed_rpm: tuple[float, float], settings: IdentifySettings
) -> tuple[dict[str, Any], list[_Seen]]:
    """Record of one crossing without its verdict, and what each channel says of it."""
    mode = modal.modes[number]
    rpm = 60.0 * mode.frequency_hz / agreed.order
    relative = [mode.frequency_error_hz / mode.frequency_hz, agreed.order_error / agreed.order]
    error = float(np.hypot(relative[0], relative[1]))
    # the order's error has few degrees of freedom, the mode's many (Welch and Satterthwaite)
    freedom = ENDLESS_FREEDOM
    if relative[1] > 0.0 and agreed.degrees_of_freedom > 0.0:
        freedom = min(freedom, agreed.degrees_of_freedom * (error / relative[1]) ** 4)
    half = rpm * error * half_width(freedom)
    mode_half = Z95 * mode.frequency_error_hz
    response = {item.channel: item for item in modal.responses if _same(item.order, agreed.order)}
    record = {
        "order": agreed.order,
        "mode_hz": mode.frequency_hz,
        "mode_hz_ci95": [mode.frequency_hz - mode_half, mode.frequency_hz + mode_half],
        "rpm": rpm,
        "rpm_ci95": [rpm - half, rpm + half],
        "in_range": bool(speed_rpm[0] - settings.crossing_band_rpm <= rpm <= speed_rpm[1] + settings.crossing_band_rpm),
        "amplification_predicted": _predicted(response, number, modal),
        "predicted_from": "fit" if any(item.fits for item in response.values()) else "damping",
        "remark": mode.undecided,
    }
    others = [(60.0 * m.frequency_hz / agreed.order, m.damping_ratio) for m in modal.modes]
    near = width_rpm(record, mode, settings)
    seen: list[_Seen] = []
    for line in agreed.lines:
        seen += _above_trend(line, rpm, near, others)
        if line.channel in response:
            seen += _by_residue(line, response[line.channel], number, modal)
    return record, seen


def _same(one: float, other: float) -> bool:
    return abs(one - other) < 1e-3


def _predicted(responses: dict[str, OrderResponse], number: int, modal: ModalFit) -> float:
    """Largest ratio, of all channels, of the response with the mode to that without it, at its natural frequency.

    1 / (2 ζ) where nothing was fitted, and at most: what a mode makes of a force, seen against its own stiffness.
    """
    fitted = [item for item in responses.values() if item.fits]
    ratios = [amplification(item, number, modal) for item in fitted]
    quality = float(1.0 / (2.0 * max(modal.modes[number].damping_ratio, 1e-6)))
    # beyond that the fit says that hardly anything is left without the mode, which is no amplification
    return min([max(ratios), quality]) if ratios else quality


def amplification(response: OrderResponse, number: int, modal: ModalFit) -> float:
    """How much larger ``response`` is at the natural frequency of mode ``number`` of ``modal`` than without that mode.

    Infinite where nothing would be left without it.
    """
    at = np.array([modal.modes[number].frequency_hz])
    parts = response.residue * shapes(at, modal)[0]
    with_mode = abs(response.rigid + parts.sum())
    without = abs(response.rigid + parts.sum() - parts[number])
    return float(with_mode / without) if without > 1e-9 * with_mode else np.inf


def amplitude_at(response: OrderResponse, rpm: float, modal: ModalFit) -> float:
    """Peak amplitude of ``response`` at ``rpm`` by the fit ``modal``, in the unit of its channel."""
    shape = shapes(np.array([response.order * rpm / 60.0]), modal)[0]
    size = abs(response.rigid + (response.residue * shape).sum())
    return float(size * (rpm / response.reference_rpm) ** response.exponent)


def shapes(frequency_hz: Floats, modal: ModalFit) -> NDArray[np.complex128]:
    """Response (frequencies, modes) of each mode of ``modal`` at ``frequency_hz``: −x² / (1 − x² + 2iζx), x = f/f_j."""
    natural = np.array([mode.frequency_hz for mode in modal.modes])
    damping = np.array([mode.damping_ratio for mode in modal.modes])
    return resonance(frequency_hz, natural, damping)


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


def _by_residue(line: OrderLine, response: OrderResponse, number: int, modal: ModalFit) -> list[_Seen]:
    """What the residue of mode ``number`` says: its F test against none; [] where the fit does not hold the mode.

    The fit is linear in rigid part and residues: their covariance follows from the errors of the amplitudes, widened
    where these scatter more than their errors say. Sizes are compared, not phases, which no reference may fix.
    """
    used = np.flatnonzero(response.residue != 0.0)
    if not response.fits or number not in used:
        return []
    scale = (line.speed_rpm / response.reference_rpm) ** response.exponent
    frequency = response.order * line.speed_rpm / 60.0
    model = np.concatenate([np.ones((len(scale), 1)), shapes(frequency, modal)[:, used]], axis=1) * scale[:, None]
    error = np.maximum(line.amplitude_error, 1e-6 * line.amplitude)
    freedom = len(scale) - model.shape[1]
    if freedom < 1 or amplification(response, number, modal) <= 1.0:
        return []
    weighted = model / error[:, None]
    covariance = np.linalg.pinv(weighted.conj().T @ weighted, hermitian=True)
    fitted = np.abs(model @ np.concatenate([[response.rigid], response.residue[used]]))
    misfit = max(1.0, float(np.sum(((line.amplitude - fitted) / error) ** 2)) / freedom)
    variance = float(covariance.real[1 + int(np.searchsorted(used, number)), 1 + int(np.searchsorted(used, number))])
    statistic = abs(response.residue[number]) ** 2 / max(variance * misfit, 1e-300)
    return [_Seen(line.channel, float((1.0 + statistic / (2.0 * freedom)) ** -freedom))]


def _measured(
    seen: list[_Seen],
    mode: Mode,
    agreed: AgreedOrder,
    record: dict[str, Any],
    tested: Floats,
    settings: IdentifySettings,
) -> dict[str, Any]:
    """Amplification in the channel that shows it best, what there is to say, and the verdict if it is not excited."""
    rpm, near = float(record["rpm"]), width_rpm(record, mode, settings)
    trends = [item for item in seen if item.ratio is not None] if record["in_range"] else []
    near_tested = tested[np.abs(tested - rpm) <= near]
    resolved = bool(near_tested.size and np.abs(tested - rpm).min() <= 2.0 * mode.damping_ratio * rpm)
    best = min(trends, key=lambda item: item.chance, default=None)
    if best is not None:
        evidence = (
            f"in {best.channel} {best.ratio:.2g} times the trend beside it at {best.at_rpm:.4g} rpm "
            f"({best.ratio_low:.2g} to {best.ratio_high:.2g})"
        )
        if not resolved:
            evidence += "; the tested speeds are further apart than the resonance is wide"
    elif any(np.any(np.abs(line.speed_rpm - rpm) <= near) for line in agreed.lines):
        evidence = "too few speeds beside it for a trend"
    elif near_tested.size:
        evidence = f"the order does not stand over the floor at {near_tested[0]:.4g} rpm"
    else:
        evidence = "no speed near enough was tested"
    quiet = bool(trends) and max(item.ratio_high for item in trends) < CLEARLY_EXCITED
    quiet &= all(_seen_all_around(line, rpm, tested) for line in agreed.lines)
    return {
        "channels": [item.channel for item in trends] or [line.channel for line in agreed.lines],
        "amplification": None if best is None else best.ratio,
        "amplification_ci95": None if best is None else [best.ratio_low, best.ratio_high],
        "evidence": evidence if record["in_range"] else "",
        "chance": None,
        "excited": False,
        "verdict": "not measured" if not resolved else "not excited" if quiet else "not decided",
    }


def _seen_all_around(line: OrderLine, rpm: float, tested: Floats) -> bool:
    """Whether ``line`` stands out at most speeds around ``rpm``: where it hides in the floor, its trend is too high."""
    around = np.abs(np.log(tested / rpm)) < BESIDE
    seen = np.abs(np.log(line.speed_rpm / rpm)) < BESIDE
    return bool(np.count_nonzero(seen) >= MOSTLY_SEEN * np.count_nonzero(around))


def _decide(records: list[dict[str, Any]], seen_of: list[list[_Seen]]) -> None:
    """Write the verdicts into ``records`` by what was seen of each: ``seen_of``, one list per record."""
    chances = np.full(len(records), np.nan)
    for number, (record, seen) in enumerate(zip(records, seen_of, strict=True)):
        if record["in_range"] and not record["remark"] and seen:
            chances[number] = simes(np.array([item.chance for item in seen]))
            record["chance"] = float(chances[number])
    excited = claimed(chances, q=FALSE_DISCOVERY_RATE)
    for record, seen, sure in zip(records, seen_of, excited.tolist(), strict=True):
        if not record["in_range"]:
            record["verdict"] = "outside the tested range"
        elif record["remark"]:
            record["verdict"] = "undecided mode"
        elif sure:
            shows = {item.channel for item in seen if len(seen) * item.chance <= FALSE_DISCOVERY_RATE}
            shows |= {min(seen, key=lambda item: item.chance).channel}
            record |= {"excited": True, "verdict": "excited", "channels": sorted(shows)}
            record["evidence"] += f"; chance without the mode {record['chance']:.1g}"
