"""Order lines, modes and fits as identification would hand them on, made by hand."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from crankorder.findings import Lock
from crankorder.identify.found import AgreedOrder, ModalFit, Mode, OrderLine, OrderResponse
from crankorder.identify.modes.order_responses import Block, Force, Rows
from crankorder.identify.modes.responses import responses_of
from crankorder.identify.modes.surface_fit import NO_POLES, Poles

SPEEDS_RPM = np.arange(600.0, 2001.0, 50.0)


def line(
    order: float, amplitude: Any = 1.0, *, channel: str = "A", speed_rpm: Any = SPEEDS_RPM, error: float = 0.01,
    order_error: float = 1e-4,
) -> OrderLine:  # fmt: skip
    """An order line with the ``amplitude`` (one or one per speed) and its standard ``error``."""
    speed = np.asarray(speed_rpm, dtype=np.float64)
    n = speed.size
    return OrderLine(
        channel=channel, order=order, order_error=order_error, seen=np.arange(n), speed_rpm=speed,
        amplitude=np.broadcast_to(np.asarray(amplitude, dtype=np.float64), (n,)).copy(),
        amplitude_error=np.full(n, error), degrees_of_freedom=np.full(n, 1e6), phase_deg=np.full(n, np.nan),
        evidence="locked to the shaft", level_over_floor_db=30.0,
    )  # fmt: skip


def agreed(order: float, *lines: OrderLine, lock: Lock = "locked", error: float = 1e-4) -> AgreedOrder:
    """An order on which the ``lines`` agree; one line of amplitude 1 where none is given."""
    return AgreedOrder(order, error, 30.0, lock, None, lines or (line(order, order_error=error),))


def mode(frequency_hz: float, damping_ratio: float = 0.015, *, undecided: str = "") -> Mode:
    """A mode whose frequency is known to 0.02 Hz."""
    return Mode(frequency_hz, 0.02, damping_ratio, 1e-3, ("A",), 20.0, "stays", undecided=undecided)


def fit(*modes: Mode, **fields: Any) -> ModalFit:
    """A ModalFit of ``modes``, with whatever other ``fields``."""
    return ModalFit(modes, fields.pop("tones", ()), np.zeros((2 * len(modes), 2 * len(modes))), **fields)


def resonant(order: float, speed_rpm: np.ndarray, modes: Sequence[Mode], gain: float = 1.0) -> np.ndarray:
    """Size of an order whose force grows with speed squared, seen through a rigid body and ``modes``."""
    frequency = order * speed_rpm[:, None] / 60.0
    x = frequency / np.array([item.frequency_hz for item in modes])
    damping = np.array([item.damping_ratio for item in modes])
    response = 1.0 + gain * np.sum(x**2 / (1.0 - x**2 + 2j * damping * x), axis=1)
    return np.asarray((speed_rpm / 1000.0) ** 2 * np.abs(response))


def poles_of(modes: Sequence[Mode]) -> Poles:
    """The poles of ``modes``."""
    poles = NO_POLES
    for item in modes:
        poles = poles.with_pole(item.frequency_hz, item.damping_ratio)
    return poles


def made_response(
    order: float, modal: ModalFit, *, smooth: complex, residue: Sequence[complex], channel: str = "A"
) -> OrderResponse:
    """A response known without error: its force grows with speed squared and is one at 1000 rpm."""
    terms = 1 + len(residue)
    return OrderResponse(
        order=order, channel=channel, force=Force(1000.0, (float(SPEEDS_RPM[0]), float(SPEEDS_RPM[-1]))),
        smooth=np.array([smooth], dtype=complex), residue=np.array(residue, dtype=complex),
        reached=np.arange(len(modal.modes)), covariance=np.zeros((terms, terms), dtype=complex),
        degrees_of_freedom=2 * (len(SPEEDS_RPM) - terms), error=0.0, fits=True,
    )  # fmt: skip


def fitted_response(
    order: float, speed_rpm: Any, amplitude: Any, modal: ModalFit, *, error: float, channel: str = "A"
) -> OrderResponse:
    """Response of one channel by the fit of a block of the complex ``amplitude`` behind the modes of ``modal``."""
    speed = np.asarray(speed_rpm, dtype=np.float64)
    values, errors = np.asarray(amplitude, dtype=complex)[None], np.full((1, len(speed)), error)
    block = Block.of(Rows(order, (channel,), order * speed / 60.0, speed, values, errors))
    (response,) = responses_of([block], poles_of(modal.modes))
    return response
