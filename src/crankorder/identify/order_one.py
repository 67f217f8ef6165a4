"""What makes order 1: unbalance, where it grows with the speed as one does, and what else it may be."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from crankorder.findings import Balance
from crankorder.identify.found import Mode, OrderLine
from crankorder.identify.intervals import Z95
from crankorder.identify.lines.growth import NUMBERS as GROWTH
from crankorder.identify.lines.growth import Growth, growth
from crankorder.identify.said import IF_UNBALANCE, LIKE_UNBALANCE, NOT_AS_UNBALANCE, ONE_SPEED
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="order_one"):
    slower_exponent: float
    little_slower_exponent: float


NUMBERS = _Numbers.load()

UNBALANCE_EXPONENT = {"displacement": 0.0, "velocity": 1.0}
"""Least exponent of speed with which an unbalance shows far above a resonance, where its mass moves by its own
eccentricity at any speed; 2 in acceleration, and in all other quantities that of the force."""

NO_MOTION = ("pressure", "voltage", "current", "temperature")
"""In these quantities order 1 is no motion, and no sign of an unbalance."""

Floats = NDArray[np.float64]


def is_motion(quantity: str) -> bool:
    """Whether order 1 in that ``quantity`` is a motion or a force, which an unbalance may make."""
    return not any(word in quantity for word in NO_MOTION)


def order_one(line: OrderLine, quantity: str, modes: Sequence[Mode]) -> tuple[str | None, str]:
    """What the growth of order 1, the ``line``, says of it in that ``quantity``, and why.

    "unbalance" where it grows as one does; LIKE_UNBALANCE where nothing tells it from a bent shaft or misalignment;
    None where it surely grows more slowly, which a natural frequency of ``modes`` does not explain.
    """
    grown, least = growth(line), UNBALANCE_EXPONENT.get(quantity, 2.0)
    if grown is None:
        return LIKE_UNBALANCE, f"{ONE_SPEED}{_between_few(line, least, modes)}"
    low, high = grown.ci95
    if len(grown.deviating_rpm) > GROWTH.largest_deviating_share * np.count_nonzero(line.amplitude > 0.0):
        return LIKE_UNBALANCE, "no power of the speed describes how it grows"
    grows = f"goes with speed to the {grown.exponent:.2f} ({low:.2f} to {high:.2f})"
    would = f"which alone would with {least:g} or more"
    lowest = _least_beside(line.speed_rpm, least, modes, grown)
    if high < lowest - NUMBERS.slower_exponent:
        return None, f"{grows}: it {NOT_AS_UNBALANCE}, {would}"
    if high < lowest - NUMBERS.little_slower_exponent:
        return LIKE_UNBALANCE, f"{grows}, more slowly than unbalance, {would}, far from natural frequencies"
    if grown.law == "follows no power law":
        return LIKE_UNBALANCE, f"{grows}, and no power of the speed describes it"
    return "unbalance", grows


def if_unbalance(balance: Balance, causes: Collection[tuple[str, str]]) -> tuple[Balance | None, str]:
    """The ``balance`` as far as order 1 may be unbalance; None and why where it surely is none.

    ``causes``: text and evidence of every line of the test.
    """
    texts = {text for text, _ in causes}
    beside = [why for text, why in causes if NOT_AS_UNBALANCE in why and text != LIKE_UNBALANCE]
    if beside and not {"unbalance", LIKE_UNBALANCE} & texts:
        return None, f"order 1 is no unbalance, or not alone: {beside[0]}"
    if beside or LIKE_UNBALANCE in texts:
        told = f"{IF_UNBALANCE}, which nothing tells from a bent shaft or misalignment"
        return replace(balance, evidence=f"{balance.evidence}; {told}"), ""
    return balance, ""


def _least_beside(speed_rpm: Floats, least: float, modes: Sequence[Mode], grown: Growth) -> float:
    """Least exponent that an unbalance shows at those speeds where one of the ``modes`` bears it, or none."""
    rpm = np.setdiff1d(speed_rpm[np.isfinite(speed_rpm)], np.asarray(grown.deviating_rpm))
    slopes = [_slope(rpm, mode.frequency_hz, mode.damping_ratio) for mode in modes if np.ptp(rpm) > 0.0]
    return least + min([0.0, *slopes])


def _slope(rpm: Floats, natural_hz: float, damping_ratio: float) -> float:
    """Exponent of speed over ``rpm`` with which a mass on a spring moves under an unbalance, in displacement."""
    ratio = rpm / 60.0 / natural_hz
    moves = ratio**2 / np.abs(1.0 - ratio**2 + 2j * damping_ratio * ratio)
    return float(np.polyfit(np.log(rpm), np.log(moves), 1)[0])


def _between_few(line: OrderLine, least: float, modes: Sequence[Mode]) -> str:
    """That even two or three speeds contradict an unbalance, within the intervals at the slowest and the fastest."""
    known = (line.amplitude > 0.0) & np.isfinite(line.amplitude_error) & np.isfinite(line.speed_rpm)
    rpm, amplitude, error = line.speed_rpm[known], line.amplitude[known], line.amplitude_error[known]
    if len(rpm) < 2 or rpm.max() < GROWTH.least_range * rpm.min():
        return ""
    slow, fast = int(np.argmin(rpm)), int(np.argmax(rpm))
    error = Z95 * error
    if amplitude[slow] <= error[slow]:
        return ""
    high = np.log((amplitude[fast] + error[fast]) / (amplitude[slow] - error[slow])) / np.log(rpm[fast] / rpm[slow])
    slopes = [_slope(rpm[[slow, fast]], mode.frequency_hz, mode.damping_ratio) for mode in modes]
    if high >= least + min([0.0, *slopes]) - NUMBERS.slower_exponent:
        return ""
    return (
        f"; from {rpm[slow]:.0f} to {rpm[fast]:.0f} rpm it {NOT_AS_UNBALANCE}, unless a natural frequency is near one"
    )
