"""What pictures show of the findings of a channel: orders, frequencies that stay, crossings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeGuard

_LOCKED_WITHIN = 0.05  # an order further from a half order than this is not called by it
_SAME_SHARE = 0.002  # of its frequency: a line this close to a tone or a mode is that one
_MOST_ORDERS = 12
_DAMPED = ("mode", "undecided")


@dataclass(frozen=True)
class FoundOrder:
    """An order that was found in a channel, and what it is called."""

    order: float
    text: str
    amplitude: float


@dataclass(frozen=True)
class FixedLine:
    """What stays at its frequency: a natural frequency, decided or not, or a tone; ``slope`` [Hz/rpm] of a whirl."""

    frequency_hz: float
    tone: bool = False
    undecided: bool = False
    slope: float = 0.0
    reference_rpm: float = 0.0
    here: bool = True

    @property
    def text(self) -> str:
        """Frequency with its unit, and a question mark where it is not decided."""
        value = self.frequency_hz
        number = f"{value:.0f}" if abs(value) >= 99.95 else f"{value:.3g}"
        return f"{number}{'?' if self.undecided else ''} Hz"

    def at(self, speed_rpm: Any) -> Any:
        """Frequency in Hz at a ``speed_rpm``."""
        return self.frequency_hz + self.slope * (speed_rpm - self.reference_rpm) + 0.0 * speed_rpm


@dataclass(frozen=True)
class Found:
    """Orders, fixed lines and excited crossings (order, frequency [Hz], speed [rpm]) of one channel."""

    orders: list[FoundOrder] = field(default_factory=list)
    fixed: list[FixedLine] = field(default_factory=list)
    crossings: list[tuple[float, float, float]] = field(default_factory=list)


def found_in(findings: Mapping[str, Any], channel: str) -> Found:
    """What the ``findings`` (a document as findings.json) say of a ``channel``; empty where they say nothing."""
    return Found(_orders(findings, channel), _fixed(findings, channel), _crossings(findings, channel))


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def decimals_of(width: float, value: float) -> int:
    """Decimals that resolve a quarter of an interval of ``width``, and never more than six digits of ``value``."""
    size = math.floor(math.log10(max(abs(value), width, 1e-300)))
    wanted = -math.floor(math.log10(0.26 * width)) if width > 0 else 2 - size
    return min(wanted, 5 - size)


def called_order(order: float, ends: Sequence[Any] | None = None, lock: object = None) -> float:
    """Order by which a line is called: the half order that it agrees with, else its value to the decimals it earns.

    With the ``ends`` of a 95 % interval it agrees with the half order inside of it, or as its ``lock`` says, and keeps
    as many decimals as these resolve; without them with a half order within 0.005.
    """
    half, most = max(round(2 * order), 1) / 2, 4 - min(math.floor(math.log10(max(order, 1e-9))), 0)
    known = len(ends or ()) == 2 and all(map(_is_number, ends or ()))
    low, high = ends if known and ends else (order - 0.005, order + 0.005)
    if (low <= half <= high or lock == "locked") and abs(order - half) < _LOCKED_WITHIN:
        return half
    return round(order, min(max(decimals_of(high - low, order), 1), most) if known else most)


def order_text(order: float, decimals: int = 3) -> str:
    """Shortest text of an ``order`` to some ``decimals``, below 1 to as many digits: ``"5.5"``, ``"0.03093"``."""
    below = min(math.floor(math.log10(order)), 0) if order > 0 else 0
    return f"{order:.{decimals - below}f}".rstrip("0").rstrip(".")


def order_texts(orders: Sequence[float]) -> list[str]:
    """Texts of ``orders`` that tell different ones apart: as short as can be, up to nine decimals where close."""
    texts = {order: order_text(order) for order in orders}
    for decimals in range(4, 10):
        times = Counter(texts.values())
        close = [order for order, text in texts.items() if times[text] > 1]
        texts |= {order: order_text(order, decimals) for order in close}
    return [texts[order] for order in orders]


def _orders(findings: Mapping[str, Any], channel: str) -> list[FoundOrder]:
    records = [
        record
        for record in findings.get("orders") or []
        if record.get("channel") == channel and _is_number(record.get("order"))
    ]
    records.sort(key=lambda record: -float(record.get("amplitude") or 0))
    shown = sorted(records[:_MOST_ORDERS], key=lambda record: float(record["order"]))
    texts = order_texts(
        [called_order(float(record["order"]), record.get("order_ci95"), record.get("lock")) for record in shown]
    )
    return [
        FoundOrder(float(record["order"]), text, float(record.get("amplitude") or 0))
        for record, text in zip(shown, texts, strict=True)
    ]


def _fixed(findings: Mapping[str, Any], channel: str) -> list[FixedLine]:
    made = []
    for mode in findings.get("modes") or []:
        if not _is_number(mode.get("frequency_hz")):
            continue
        cause = str(mode.get("explained_by", "mode"))
        tone = cause not in ("mode", "whirl", "undecided")
        whirl = cause == "whirl" and _is_number(mode.get("speed_slope")) and _is_number(mode.get("reference_rpm"))
        undecided = not tone and (cause == "undecided" or bool(mode.get("undecided")))
        slope, reference = (float(mode["speed_slope"]) / 60.0, float(mode["reference_rpm"])) if whirl else (0.0, 0.0)
        here = channel in (mode.get("channels") or [channel])
        made.append(FixedLine(float(mode["frequency_hz"]), tone, undecided, slope, reference, here))
    for line in findings.get("lines") or []:
        hz, why = line.get("frequency_hz"), str(line.get("explained_by") or "")
        if not _is_number(hz) or line.get("channel") != channel or why in _DAMPED:
            continue
        if all(abs(other.frequency_hz - hz) > _SAME_SHARE * hz for other in made):
            made.append(FixedLine(float(hz), tone=True))
    return sorted(made, key=lambda one: one.frequency_hz)


def _crossings(findings: Mapping[str, Any], channel: str) -> list[tuple[float, float, float]]:
    return [
        (float(crossing["order"]), float(crossing["mode_hz"]), float(crossing["rpm"]))
        for crossing in findings.get("crossings") or []
        if crossing.get("excited") and crossing.get("in_range") and channel in (crossing.get("channels") or [channel])
    ]
