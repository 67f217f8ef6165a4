"""One place in the spectrum has one story: what is found twice there is told once, or each with the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crankorder.identify.explain import NOT_KNOWN, Causes
from crankorder.identify.found import AgreedOrder, ModalFit, Mode
from crankorder.identify.modal.tones import NEAR_BINS
from crankorder.identify.said import MAY_BE_ALL
from crankorder.identify.said import NUMBERS as SAID
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="one_cause"):
    too_near_hz: float
    near_share: float
    most_named: int


NUMBERS = _Numbers.load()

_CALLED = {"tone": "a fixed tone", "order": "an order or a tone"}
_AT_ONE_SPEED = {"tone": "a line without width", "order": "an order or a tone"}


def without_doubles(modal: ModalFit) -> ModalFit:
    """``modal`` without tones that may be orders and stand on the flank of a stronger tone.

    Lines closer than the main lobe of the window are one in the map; such a one is what the fit of the stronger left.
    """
    if len(modal.frequency_hz) < 2:
        return modal
    reach = NEAR_BINS * float(modal.frequency_hz[1] - modal.frequency_hz[0])
    sizes = [max(size for size, _ in tone.amplitude.values()) for tone in modal.tones]
    kept = tuple(
        tone
        for tone, size in zip(modal.tones, sizes, strict=True)
        if tone.kind != "order"
        or not any(
            abs(tone.frequency_hz - other.frequency_hz) < reach and size < more
            for other, more in zip(modal.tones, sizes, strict=True)
        )
    )
    return replace(modal, tones=kept)


def with_neighbours_named(modal: ModalFit, orders: Sequence[AgreedOrder], causes: Causes) -> ModalFit:
    """``modal`` in which a natural frequency that is not decided names the known lines that stand where it would.

    Tones, and of a test at one speed the ``orders``, as ``causes`` explain them.
    """
    called = _AT_ONE_SPEED if _one_speed(orders) is not None else _CALLED
    lines = [
        (tone.frequency_hz, called.get(cause.text, cause.text))
        for tone, cause in zip(modal.tones, causes.tones, strict=True)
    ]
    lines += _at_one_speed(orders, causes)
    modes = tuple(_beside(mode, lines) if mode.undecided else mode for mode in modal.modes)
    return replace(modal, modes=modes)


def _beside(mode: Mode, lines: Sequence[tuple[float, str]]) -> Mode:
    low, high = mode.frequency_ends
    reach = max(NUMBERS.too_near_hz, min(0.5 * (high - low), NUMBERS.near_share * mode.frequency_hz))
    near = sorted(
        (abs(hertz - mode.frequency_hz), hertz, text)
        for hertz, text in lines
        if abs(hertz - mode.frequency_hz) <= reach
    )
    if not near:
        return mode
    said = " and ".join(f"{text} at {hertz:.5g} Hz" for _, hertz, text in near[: NUMBERS.most_named])
    return replace(mode, undecided=f"{mode.undecided}; {said} {MAY_BE_ALL}")


def _at_one_speed(orders: Sequence[AgreedOrder], causes: Causes) -> list[tuple[float, str]]:
    """Frequency in Hz and cause of each of ``orders``, where all were seen at one speed; else none."""
    rpm = _one_speed(orders)
    if rpm is None:
        return []
    found = [(one.order * rpm / 60.0, causes.orders[one.lines[0].channel, one.order].text) for one in orders]
    return [(hertz, text) for hertz, text in found if text not in NOT_KNOWN]


def _one_speed(orders: Sequence[AgreedOrder]) -> float | None:
    """The one speed in rpm at which all ``orders`` were seen; None where there are several, or none is known."""
    speeds = np.array([rpm for one in orders for line in one.lines for rpm in line.speed_rpm])
    alike = (
        len(speeds) > 0 and bool(np.isfinite(speeds).all()) and speeds.max() <= SAID.alike_speeds_ratio * speeds.min()
    )
    return float(speeds.mean()) if alike else None
