"""What an order that a sweep took through a resonance would reach if the speed were held there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.found import ModalFit, OrderResponse
from crankorder.identify.modal.order_blocks import NUMBERS as ORDER_BLOCKS
from crankorder.identify.responses import held_amplitudes

SPEEDS = 800
"""Speeds over the range of a response at which its steady amplitude is looked at …"""

ABOUT_MODE, PER_MODE = 4.0, 81
"""… and those within so many half-power widths of each mode."""


@dataclass(frozen=True)
class HeldPeak:
    """Largest steady peak ``amplitude`` of an order in a channel, at ``rpm``.

    ``error`` is the standard error of the amplitude, with ``freedom`` degrees of freedom.
    """

    rpm: float
    amplitude: float
    error: float
    freedom: float


def held_peak(modal: ModalFit, order: float, channel: str) -> HeldPeak | None:
    """What ``order`` would reach in ``channel`` at the worst speed of its sweeps, held, by the fit ``modal``.

    None where no response fits its sweeps. Of several recordings that counts which knows it best.
    """
    peaks = [
        _peak_of(one, modal)
        for one in modal.responses
        if one.fits
        and one.recording
        and one.channel == channel
        and abs(one.order - order) <= ORDER_BLOCKS.same_order_share * order
    ]
    return min(peaks, key=lambda one: one.error / max(one.amplitude, 1e-300), default=None)


def _peak_of(response: OrderResponse, modal: ModalFit) -> HeldPeak:
    rpm = _speeds(response, modal)
    amplitude, error = held_amplitudes(response, rpm, modal)
    at = int(np.argmax(amplitude))
    return HeldPeak(float(rpm[at]), float(amplitude[at]), float(error[at]), float(max(response.degrees_of_freedom, 1)))


def _speeds(response: OrderResponse, modal: ModalFit) -> NDArray[np.float64]:
    """Speeds [rpm] at which ``response`` is looked at: over its range, and closer about the modes of ``modal``."""
    low, high = response.span_rpm
    reach = ABOUT_MODE * np.linspace(-1.0, 1.0, PER_MODE)
    near = [60.0 * mode.frequency_hz / response.order * (1.0 + mode.damping_ratio * reach) for mode in modal.modes]
    rpm = np.concatenate([np.linspace(low, high, SPEEDS), *near])
    return rpm[(rpm >= low) & (rpm <= high)]
