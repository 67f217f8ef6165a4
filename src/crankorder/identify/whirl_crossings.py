"""Where orders meet whirls: natural frequencies that move with the speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.above_trend import Seen, above_trend, evidence_beside, in_range, seen_all_around, width_rpm
from crankorder.identify.found import AgreedOrder, Crossing, ModalFit, Mode, Verdict, Whirl
from crankorder.identify.intervals import Z95, half_width
from crankorder.identify.said import NUMBERS as SAID
from crankorder.settings import IdentifySettings

Floats = NDArray[np.float64]


def met_mode(order: float, whirl: Whirl) -> tuple[float, Mode] | None:
    """Speed in rpm at which ``order`` meets ``whirl``, and the fixed mode that the order passes through there.

    As the order gains on the whirl by but a part of its own motion, the mode is wider by that much. Of a damping that
    is no more than a bound the bound is taken. None where they never meet.
    """
    rpm = whirl.meets(order)
    if rpm is None:
        return None
    slower = order / (order - whirl.slope)
    damping = whirl.damping_ratio + (0.0 if whirl.damping_told else Z95 * whirl.damping_error)
    return rpm, Mode(
        frequency_hz=whirl.line_at(rpm),
        frequency_error_hz=whirl.error_at(rpm),
        damping_ratio=damping * slower,
        damping_error=whirl.damping_error * slower,
        channels=whirl.channels,
        prominence_db=whirl.prominence_db,
        evidence=f"a whirl that moves by {whirl.slope:.3g} orders",
    )


def whirl_crossing(
    agreed: AgreedOrder,
    whirl: Whirl,
    modal: ModalFit,
    tested: Floats,
    speed_rpm: tuple[float, float],
    settings: IdentifySettings,
) -> tuple[Crossing, list[Seen]] | None:
    """Crossing of an order with a whirl, and what each channel says of it; None where they never meet.

    ``agreed`` is the order, ``modal`` holds the modes that stay, whose crossings are left out of the trend;
    ``tested`` (n,) are all speeds in rpm, ``speed_rpm`` the slowest and the fastest; ``settings`` say how near counts.
    No fit of the orders holds a whirl: what is said comes from the amplitudes beside alone.
    """
    if (met := met_mode(agreed.order, whirl)) is None:
        return None
    rpm, mode = met
    inside = in_range(rpm, speed_rpm, settings)
    others = [(rpm, mode.damping_ratio)]
    others += [(60.0 * one.frequency_hz / agreed.order, one.damping_ratio) for one in modal.modes]
    seen = [one for line in agreed.lines for one in above_trend(line, rpm, width_rpm(rpm, mode, settings), others)]
    trends = seen if inside else []
    best = min(trends, key=lambda item: item.chance, default=None)
    quiet = bool(trends) and max(item.ratio_high for item in trends) < SAID.clearly_excited_ratio
    quiet &= all(seen_all_around(line, rpm, tested) for line in agreed.lines)
    near = bool(len(tested)) and bool(np.abs(tested - rpm).min() <= 2.0 * mode.damping_ratio * rpm)
    verdict: Verdict = "not excited" if quiet and near else "not decided" if near else "not measured"
    half = half_width(max(agreed.degrees_of_freedom, 1.0)) * rpm * agreed.order_error / (agreed.order - whirl.slope)
    unmeasured = _whirl_at(agreed.order, whirl, rpm, mode, half)
    said = f"{mode.evidence}; {evidence_beside(agreed, rpm, mode, best, tested, settings)}"
    return replace(
        unmeasured,
        in_range=inside,
        channels=tuple([item.channel for item in trends] or [line.channel for line in agreed.lines]),
        amplification=None if best is None else best.ratio,
        amplification_ci95=None if best is None else (best.ratio_low, best.ratio_high),
        evidence=said if inside else mode.evidence,
        verdict=verdict if inside else "outside the tested range",
    ), seen


def _whirl_at(order: float, whirl: Whirl, rpm: float, mode: Mode, half_by_order: float) -> Crossing:
    """Crossing of an order, whose error moves it by ``half_by_order`` rpm, with a whirl; nothing measured."""
    half_hz = Z95 * mode.frequency_error_hz
    half = float(np.hypot(60.0 * half_hz / abs(order - whirl.slope), half_by_order))
    return Crossing(
        order=order,
        mode_hz=mode.frequency_hz,
        mode_hz_ci95=(mode.frequency_hz - half_hz, mode.frequency_hz + half_hz),
        rpm=rpm,
        rpm_ci95=(rpm - half, rpm + half),
        in_range=False,
        amplification_predicted=1.0 / (2.0 * max(mode.damping_ratio, 1e-6)),
        predicted_from="damping",
        remark="",
        channels=(),
        amplification=None,
        amplification_ci95=None,
        evidence=mode.evidence,
        verdict="outside the tested range",
        whirl=whirl,
    )


def unmeasured_whirl(
    order: float, whirl: Whirl, speed_rpm: tuple[float, float], settings: IdentifySettings
) -> Crossing | None:
    """Crossing with ``whirl`` of an ``order`` that was stated and not seen; None where they never meet.

    ``speed_rpm``: slowest and fastest speed of the test; ``settings`` say how far beside counts as tested.
    """
    if (met := met_mode(order, whirl)) is None:
        return None
    made = _whirl_at(order, whirl, *met, 0.0)
    if not in_range(made.rpm, speed_rpm, settings):
        return made
    said = f"{made.evidence}; the order was stated, and does not stand out of the data"
    return replace(made, in_range=True, verdict="not measured", evidence=said)
