"""The true speed of an induction motor whose speed was only stated, by the lines just below its field."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from crankorder.engine.motor import Motor
from crankorder.findings import BearingFinding
from crankorder.identify.explain import Causes
from crankorder.identify.found import AgreedOrder, Lock, ModalFit
from crankorder.identify.intervals import Z95
from crankorder.identify.lines.order_lock import NUMBERS as ORDER_LOCK
from crankorder.identify.lines.order_lock import speed_source
from crankorder.identify.said import NUMBERS as SAID
from crankorder.identify.said import SPEAK_FOR
from crankorder.settings import IdentifySettings, MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="motor_speed"):
    most_slip_share: float
    same_sigmas: float
    same_share: float
    most_multiples: int
    stands_out_ratio: float
    rated_share: float


NUMBERS = _Numbers.load()


@dataclass(frozen=True)
class SpeedRead:
    """``rpm`` of the crank that the lines speak for, with its standard ``error_rpm``, where ``stated_rpm`` was stated.

    ``hertz`` is where the first order of the motor's shaft stands; ``supply`` its frequency in Hz and the error of that
    by a line of its own, None where none is there.
    """

    rpm: float
    error_rpm: float
    stated_rpm: float
    hertz: float
    supply: tuple[float, float] | None = None

    @property
    def ratio(self) -> float:
        """This speed over the stated one."""
        return self.rpm / self.stated_rpm

    @property
    def agrees(self) -> bool:
        """Whether it is the stated speed as well as one that is stated tells it."""
        return abs(self.ratio - 1.0) <= Z95 * ORDER_LOCK.stated_speed_error

    @property
    def words(self) -> str:
        """What is said of the two speeds."""
        return f"{SPEAK_FOR} {self.rpm:.5g} rpm, where {self.stated_rpm:.5g} was stated"

    def multiple(self, agreed: AgreedOrder) -> int | None:
        """Which multiple of the shaft's turns at this speed ``agreed`` is; None where it is none."""
        nearest = max(1, round(agreed.order / self.ratio))
        error = float(np.hypot(agreed.line_error, nearest * self.error_rpm / self.stated_rpm))
        near = abs(agreed.order - nearest * self.ratio) <= max(
            NUMBERS.same_sigmas * error, NUMBERS.same_share * agreed.order
        )
        return nearest if near else None


@dataclass(frozen=True)
class _Line:
    hertz: float
    error_hz: float
    size: float

    def is_multiple_of(self, other: _Line, multiple: int) -> bool:
        reach = NUMBERS.same_sigmas * float(np.hypot(self.error_hz, multiple * other.error_hz))
        return abs(self.hertz - multiple * other.hertz) <= max(reach, NUMBERS.same_share * self.hertz)


def speed_read(
    motor: Motor | None, orders: Sequence[AgreedOrder], order_map: xr.Dataset, *, settings: IdentifySettings
) -> SpeedRead | None:
    """Speed that the ``orders`` of the test of ``order_map`` speak for, if it was only stated; None: none, or several.

    The rotor of an induction motor lags behind its field by some percent at most: a line that stands there, stronger
    than others that do, or with multiples, is the first order of its shaft. What may be the mains itself, with which a
    motor of two poles nearly turns, is that only below another line that may be it. One stated speed alone is read.
    ``settings``: how far mains wander.
    """
    rpm = _stated_rpm(orders) if speed_source([order_map]) == "stated" else None
    if motor is None or motor.supply_hz is None or motor.poles is None or rpm is None:
        return None
    lines = [_line(one, rpm) for one in orders]
    field_hz = 2.0 * motor.supply_hz / motor.poles
    may_be = [
        line
        for line in lines
        if (1.0 - NUMBERS.most_slip_share) * field_hz
        <= line.hertz
        < _top_hz(line, lines, motor, settings) * 2.0 / motor.poles
    ]
    first = _first(may_be, lines)
    if first is None:
        return None
    turn_rpm = 60.0 / motor.shaft_ratio
    supply = _supply(first, lines, motor, settings)
    return SpeedRead(first.hertz * turn_rpm, first.error_hz * turn_rpm, rpm, first.hertz, supply)


def _line(agreed: AgreedOrder, rpm: float) -> _Line:
    size = max(float(line.amplitude.max()) for line in agreed.lines)
    return _Line(agreed.order * rpm / 60.0, agreed.line_error * rpm / 60.0, size)


def _supply(
    first: _Line, lines: Sequence[_Line], motor: Motor, settings: IdentifySettings
) -> tuple[float, float] | None:
    """Supply in Hz and its error by the one line that may be its double, or itself; None where none or several are."""
    for multiple in (2, 1):
        middle = multiple * float(motor.supply_hz or 0.0)
        reach = settings.mains_tolerance_hz * float(np.sqrt(multiple))
        near = [
            one
            for one in lines
            if abs(one.hertz - middle) <= reach and not any(one.is_multiple_of(first, k) for k in range(1, 9))
        ]
        if len(near) == 1:
            return near[0].hertz / multiple, near[0].error_hz / multiple
    return None


def _stated_rpm(orders: Sequence[AgreedOrder]) -> float | None:
    """The one speed in rpm at which ``orders`` were seen; None where there are several."""
    speeds = np.array([rpm for one in orders for line in one.lines for rpm in line.speed_rpm])
    alike = (
        len(speeds) > 0 and bool(np.isfinite(speeds).all()) and speeds.max() <= SAID.alike_speeds_ratio * speeds.min()
    )
    return float(speeds.mean()) if alike else None


def _top_hz(line: _Line, lines: Sequence[_Line], motor: Motor, settings: IdentifySettings) -> float:
    """Supply in Hz below whose field ``line`` must be: that of a line beside, or the highest that it may have."""
    supply, reach = float(motor.supply_hz or 0.0), settings.mains_tolerance_hz
    others = [
        one.hertz
        for one in lines
        if abs(one.hertz - supply) <= reach
        and not any(one.is_multiple_of(line, k) for k in range(1, NUMBERS.most_multiples + 1))
    ]
    if others:
        return max(others)
    return 0.0 if abs(line.hertz - supply) <= reach else supply + reach


def _first(may_be: Sequence[_Line], lines: Sequence[_Line]) -> _Line | None:
    """The one of ``may_be`` that is the shaft's: that with most multiples among ``lines``, and the largest of those."""

    def multiples(one: _Line) -> int:
        return sum(any(line.is_multiple_of(one, k) for line in lines) for k in range(2, NUMBERS.most_multiples + 1))

    if not may_be:
        return None
    best = max(may_be, key=lambda one: (multiples(one), one.size))
    if multiples(best):
        return best if all(one.size <= best.size or not multiples(one) for one in may_be) else None
    return best if all(NUMBERS.stands_out_ratio * one.size <= best.size for one in may_be if one is not best) else None


def with_speed_read(
    motor: Motor | None, orders: tuple[AgreedOrder, ...], order_map: xr.Dataset, *, settings: IdentifySettings
) -> tuple[tuple[AgreedOrder, ...], SpeedRead | None]:
    """``orders`` of which those of the shaft at the speed that is read say so, locked to no stated one; and that speed.

    ``motor``, ``order_map`` and ``settings`` as in :func:`speed_read`.
    """
    read = speed_read(motor, orders, order_map, settings=settings)
    return (orders if read is None else _saying_so(orders, read)), read


def _saying_so(orders: tuple[AgreedOrder, ...], read: SpeedRead) -> tuple[AgreedOrder, ...]:
    return tuple(
        one
        if read.multiple(one) is None
        else replace(
            one,
            lock="undecided",
            needed_revs=None,
            reservation="; ".join(part for part in (one.reservation, read.words) if part),
        )
        for one in orders
    )


def explained_at(
    read: SpeedRead | None,
    orders: tuple[AgreedOrder, ...],
    modal: ModalFit,
    bearings: Sequence[BearingFinding],
    *,
    explain: Callable[..., Causes],
) -> Causes:
    """What ``explain`` says of ``orders``, ``modal`` and ``bearings`` at the speed that was ``read``, if any.

    At that speed lines of the shaft stand on whole orders, and no other line that stands on one at the stated speed:
    what the recordings hold at places that the stated speed tells is not ``known``.
    """
    if read is None:
        return explain(orders, modal, bearings)
    scaled = [_at(read, one) for one in orders]
    causes = explain(tuple(scaled), modal, [_record_at(read, record) for record in bearings], known=(), of_encoder=None)
    texts = {
        (line.channel, old.order): causes.orders[line.channel, new.order]
        for old, new in zip(orders, scaled, strict=True)
        for line in old.lines
    }
    return replace(causes, orders=texts)


def _at(read: SpeedRead, agreed: AgreedOrder) -> AgreedOrder:
    """``agreed`` as it would be if the speed that was ``read`` had been stated."""
    multiple = read.multiple(agreed)
    lines = tuple(replace(line, speed_rpm=line.speed_rpm * read.ratio) for line in agreed.lines)
    if multiple is None:
        slips: Lock = "slips"
        error = agreed.line_error / read.ratio
        return replace(agreed, order=agreed.order / read.ratio, order_error=error, lock=slips, lines=lines)
    return replace(agreed, order=float(multiple), order_error=agreed.line_error, lock="undecided", lines=lines)


def _record_at(read: SpeedRead, record: BearingFinding) -> BearingFinding:
    """Record of a bearing's line with its orders at the speed that was ``read``."""
    low, high = record.order_ci95 or (None, None)
    ends = tuple(None if end is None else end / read.ratio for end in (low, high))
    shaft = None if record.shaft_order is None else record.shaft_order / read.ratio
    return replace(record, order=record.order / read.ratio, order_ci95=(ends[0], ends[1]), shaft_order=shaft)
