"""Speeds at which an order towers over the speeds beside, whether or not a natural frequency was found there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.found import AgreedOrder, AvoidedSpeed, ModalFit, OrderLine
from crankorder.identify.intervals import Z95
from crankorder.identify.modal.exclusion import NUMBERS as EXCLUSION
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="lone_peaks"):
    around_share: float
    same_row_share: float


NUMBERS = _Numbers.load()

Floats = NDArray[np.float64]


def lone_peaks(
    orders: Sequence[AgreedOrder],
    modal: ModalFit,
    avoided: Sequence[AvoidedSpeed],
    *,
    largest: Mapping[str, float],
    in_unit: Mapping[str, float],
    unit: Mapping[str, str],
    factor: float,
) -> list[AvoidedSpeed]:
    """Speeds to avoid that no crossing accounts for: an order is there ``factor`` times what it is on both sides.

    Of each channel of each of the ``orders`` the largest amplitude of its neighbourhood, by the lower end of its
    interval, over the middling ones of the speeds on either side. Those that the speeds ``avoided`` of the same
    order hold are left out, and what is small beside the ``largest`` amplitude of its channel. The amplitude is the
    largest there of all channels of the same ``unit``; its share of the largest of any order there (``in_unit``)
    ranks it. The natural frequency is that of the ``modal`` fit between the neighbouring speeds; where there is
    none, that at which the order peaks.
    """
    made: list[AvoidedSpeed] = []
    for agreed in orders:
        peaks = [
            (line, place, ratio)
            for line in agreed.lines
            for place, ratio in _peaks(line, factor)
            if line.amplitude[place] >= EXCLUSION.matters_share * largest.get(line.channel, 0.0)
        ]
        for line, place, ratio in sorted(peaks, key=lambda peak: -peak[2]):
            worst = _largest_there(agreed, line, float(line.speed_rpm[place]), unit)
            item = _avoided(agreed.order, line, place, ratio, modal, worst, in_unit)
            reach = (
                1.0 if line.n_independent is None else 1.0 + NUMBERS.around_share
            )  # a sweep rings behind a resonance
            if not any(_holds(other, item, reach) for other in (*avoided, *made)):
                made.append(item)
    return made


def _peaks(line: OrderLine, factor: float) -> list[tuple[int, float]]:
    """Places of ``line`` that tower over both sides, and how many times."""
    rank = np.argsort(line.speed_rpm, kind="stable")
    speed, size = line.speed_rpm[rank], line.amplitude[rank]
    least = size - Z95 * line.amplitude_error[rank] if line.ends is None else line.ends[rank, 0]
    found = []
    for place in range(1, len(rank) - 1):
        first = min(int(np.searchsorted(speed, speed[place] * (1.0 - NUMBERS.around_share))), place - 1)
        last = max(int(np.searchsorted(speed, speed[place] * (1.0 + NUMBERS.around_share), side="right")), place + 2)
        if size[place] < size[first:last].max():
            continue
        beside = max(float(np.median(size[first:place])), float(np.median(size[place + 1 : last])))
        if beside > 0.0 and least[place] >= factor * beside:
            found.append((int(rank[place]), float(size[place]) / beside))
    return found


def _largest_there(agreed: AgreedOrder, shown: OrderLine, rpm: float, unit: Mapping[str, str]) -> tuple[str, float]:
    """Channel of the unit of ``shown`` in which the order is largest at ``rpm``, and how large."""
    there = [
        (
            line.channel,
            float(line.amplitude[np.abs(line.speed_rpm - rpm) <= NUMBERS.same_row_share * rpm].max(initial=0.0)),
        )
        for line in agreed.lines
        if unit[line.channel] == unit[shown.channel]
    ]
    return max(there, key=lambda one: one[1])


def _avoided(
    order: float,
    line: OrderLine,
    place: int,
    ratio: float,
    modal: ModalFit,
    worst: tuple[str, float],
    in_unit: Mapping[str, float],
) -> AvoidedSpeed:
    """Speed to avoid around row ``place`` of ``line``, half way to the rows beside, ``worst`` in a channel there."""
    rpm = float(line.speed_rpm[place])
    below = float(line.speed_rpm[line.speed_rpm < rpm].max())
    above = float(line.speed_rpm[line.speed_rpm > rpm].min())
    hz = order * rpm / 60.0
    near = [one.frequency_hz for one in modal.modes if below < 60.0 * one.frequency_hz / order < above]
    mode_hz = min(near, key=lambda one: abs(one - hz), default=hz)
    channel, size = worst
    where = f"near {mode_hz:.4g} Hz" if near else f"at {hz:.4g} Hz, which may be a natural frequency"
    return AvoidedSpeed(
        rpm=rpm,
        rpm_range=(0.5 * (below + rpm), 0.5 * (rpm + above)),
        orders=(order,),
        modes_hz=(mode_hz,),
        channel=channel,
        amplitude=size,
        at_least=True,
        amplification=ratio,
        cost=size / max(in_unit.get(channel, size), size),
        reason=f"order {order:.4g} peaks {where}: {ratio:.2g} times what it is at the speeds beside",
    )


def _holds(other: AvoidedSpeed, item: AvoidedSpeed, reach: float) -> bool:
    """Whether ``other`` speaks of the same order between the same speeds, or ``reach`` times beside."""
    alike = any(abs(one - item.orders[0]) <= 1e-3 * item.orders[0] for one in other.orders)
    (low, high), (least, most) = item.rpm_range, other.rpm_range
    return alike and least <= reach * high and low <= reach * most
