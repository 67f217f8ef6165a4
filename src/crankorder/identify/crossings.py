"""Where orders meet natural frequencies."""

from __future__ import annotations

from typing import Any

import numpy as np

from crankorder.identify.order_lines import Z95, OrderLine, orders_agreed
from crankorder.settings import IdentifySettings

NEAR = 0.04
"""A speed within this share of the crossing belongs to it: the half-power width of a mode with 2 % damping."""

AWAY = 0.15
"""Speeds between NEAR and this share of the crossing say what the order does without the mode."""

EXCITED_RATIO = 1.5
"""An order this much larger at the crossing than beside it is excited by the mode."""


def crossings(
    lines: list[OrderLine],
    modes: list[tuple[float, float]],
    speed_rpm: tuple[float, float],
    *,
    settings: IdentifySettings,
) -> list[dict[str, Any]]:
    """Crossings of the found orders with the natural frequencies, by speed, as records of ``findings.json``.

    ``lines`` are the order lines of all channels, ``modes`` the natural frequencies in Hz with their standard errors,
    ``speed_rpm`` the slowest and the fastest tested speed; ``settings`` say how near to them counts as tested. A
    crossing is excited where the amplitude of the order, in at least one channel, stands 1.5 times above the trend
    beside the crossing.
    """
    low, high = speed_rpm[0] - settings.crossing_band_rpm, speed_rpm[1] + settings.crossing_band_rpm
    records = []
    for order, of_order in orders_agreed(lines):
        for frequency, error in modes:
            rpm = 60.0 * frequency / order
            inside = bool(low <= rpm <= high)
            half = 1.959964 * 60.0 * error / order
            ratios = {line.channel: _amplification(line, rpm) if inside else (0.0, 0.0) for line in of_order}
            excited = [channel for channel, (_, sure) in ratios.items() if sure >= EXCITED_RATIO]
            ratio = max((value for value, _ in ratios.values()), default=0.0)
            records.append(
                {
                    "order": order,
                    "mode_hz": frequency,
                    "rpm": rpm,
                    "rpm_ci95": [rpm - half, rpm + half],
                    "in_range": inside,
                    "excited": bool(excited),
                    "channels": excited or list(ratios),
                    "amplification": ratio,
                }
            )
    return sorted(records, key=lambda record: (record["rpm"], record["order"]))


def _amplification(line: OrderLine, rpm: float) -> tuple[float, float]:
    """Amplitude of ``line`` at ``rpm`` over the median of the speeds beside it, and the least that it surely is.

    Both are 0 where either amplitude is not known.
    """
    distance = np.abs(line.speed_rpm / rpm - 1.0)
    beside = (distance > NEAR) & (distance < AWAY)
    if not (distance <= NEAR).any() or np.count_nonzero(beside) < 2:
        return 0.0, 0.0
    at = int(np.argmax(np.where(distance <= NEAR, line.amplitude, 0.0)))
    trend = float(np.median(line.amplitude[beside]))
    least = line.amplitude[at] - Z95 * line.amplitude_error[at]
    return float(line.amplitude[at] / trend), float(least / trend)
