"""The lines that a drawn machine really makes, which of them a record is of, and whether its cause is so."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from machines.folder import Take
from machines.machine import Machine

NEAR_ORDER, NEAR_SHARE = 0.03, 0.004
"""A record is of the nearest line within so much of it, in orders or as a share; the larger counts."""
SWING_SHARE = 0.1
"""A line that the swing of the shaft makes is real where it has this share of the size that is said."""
RESOLVED_CYCLES = 1.5
"""Two lines are told apart where they beat so often within a recording."""
NEAR_TONE_HZ = 0.2
"""A line so near to the mains, or within the resolution of the recording, may be that of the mains."""
ON_A_MODE = 0.01
"""Share of a frequency within which an order passes it."""
PARTS = ("bearing", "gear mesh", "blade", "second shaft", "motor,", "mains", "half order")
"""Words of a cause that name a part of a machine, or the mains."""
OF_THE_SHAFT = ("order", "harmonic", "unbalance", "misalignment", "sideband")
"""Words of a cause that name the shaft itself."""


@dataclass(frozen=True)
class TrueLine:
    """A line at the ``order`` that it has at a speed; ``place`` among the machine's orders, None: no order of it."""

    order: float
    place: int | None = None
    is_tone: bool = False

    @property
    def lock(self) -> str:
        """What it is called: "locked" to the cycle of two revolutions, or "slips"."""
        return "locked" if not self.is_tone and float(2.0 * self.order).is_integer() else "slips"


def line_of(machine: Machine, takes: tuple[Take, ...], record: dict[str, Any]) -> TrueLine | None:
    """The line of ``machine`` that ``record``, an order of the findings, is of; None: there is none.

    The nearest one; an order of the shaft first where it lies within the record's own interval. A tone of the mains is
    a line of a certain order at a steady speed only, and the swing's are those that ``takes`` really hold.
    """
    number, rpm = float(record["order"]), float(record["speed_rpm_at_max"])
    lines = [TrueLine(order.order, place) for place, order in enumerate(machine.orders)]
    if machine.steady:
        lines += [TrueLine(60.0 * tone.frequency_hz / rpm, is_tone=True) for tone in machine.tones]
    reach = max(NEAR_ORDER, NEAR_SHARE * number)
    own = {round(order.order, 9) for order in machine.orders}
    signals = [take.swung for take in takes if take.swung is not None]
    sidebands = {line for signal in signals for line in signal.numbers} - own
    channel, least = machine.channels.index(record["channel"]), SWING_SHARE * record["amplitude"]
    for line in (line for line in sidebands if abs(line - number) <= reach):
        if max(float(signal.amplitude(line)[channel]) for signal in signals) >= least:
            lines.append(TrueLine(line))
    low, high = record.get("order_ci95") or (number, number)
    inside = [line for line in lines if line.place is not None and low <= line.order <= high]
    nearest = min(inside or lines, key=lambda line: abs(line.order - number))
    return nearest if abs(nearest.order - number) <= reach else None


def is_resolved(machine: Machine, tone: TrueLine, rpm: float) -> bool:
    """Whether the recordings at ``rpm`` tell a ``tone`` from the half order next to it."""
    shortest = min(p.duration_s for p in machine.profiles if abs(np.mean(p.rpm) / rpm - 1.0) <= ON_A_MODE)
    return abs(2.0 * tone.order - round(2.0 * tone.order)) / 2.0 * rpm / 60.0 * shortest >= RESOLVED_CYCLES


@dataclass(frozen=True)
class _Named:
    """A line as the findings name it: its ``cause``, where it lies, and the true ``line`` that it is of."""

    cause: str
    low_hz: float
    high_hz: float
    line: TrueLine | None
    may_be_half: bool = False

    def holds(self, hertz: float, reach_hz: float) -> bool:
        """Whether it may lie at ``hertz``."""
        return self.low_hz - reach_hz <= hertz <= self.high_hz + reach_hz


def causes(machine: Machine, takes: tuple[Take, ...], findings: dict[str, Any]) -> list[tuple[bool, str]]:
    """Whether each cause that names a part of a machine is so, and words: one of those that it names must be there."""
    named = [_named_order(machine, takes, record) for record in findings["orders"]]
    for mode in findings["modes"]:
        low, high = mode["frequency_hz_ci95"] or (mode["frequency_hz"], mode["frequency_hz"])
        named.append(_Named(str(mode["explained_by"]), low, high, _passing(machine, mode["frequency_hz"])))
    named += [_Named(f"bearing {bearing['name']}", np.nan, np.nan, None) for bearing in findings.get("bearings", ())]
    return [
        (any(_is_so(machine, part, one) for part in one.cause.split(" or ")), f"{one.cause}, {one.low_hz:.5g} Hz")
        for one in named
        if any(part in one.cause for part in PARTS)
    ]


def _named_order(machine: Machine, takes: tuple[Take, ...], record: dict[str, Any]) -> _Named:
    """The order of ``record`` at its speed; where no line follows the shaft there, at every speed of the test."""
    number, rpm = float(record["order"]), float(record["speed_rpm_at_max"])
    low, high = record.get("order_ci95") or (number, number)
    line, speeds = line_of(machine, takes, record), (rpm, rpm)
    if line is None:
        low, high, speeds = number, number, (machine.tested_rpm[0], machine.tested_rpm[-1])
    undecided = record["lock"] == "undecided" and low <= round(2.0 * number) / 2.0 <= high
    return _Named(str(record.get("explained_by")), low * speeds[0] / 60.0, high * speeds[1] / 60.0, line, undecided)


def _passing(machine: Machine, hertz: float) -> TrueLine | None:
    """The first order of ``machine`` that a recording has at ``hertz``."""
    for place, order in enumerate(machine.orders):
        rpm = 60.0 * hertz / order.order
        for profile in machine.profiles:
            if min(profile.rpm) * (1.0 - ON_A_MODE) <= rpm <= max(profile.rpm) * (1.0 + ON_A_MODE):
                return TrueLine(order.order, place)
    return None


def _is_so(machine: Machine, cause: str, named: _Named) -> bool:
    """Whether ``cause``, one of those that are ``named`` for a line, is there."""
    line = named.line
    if "mains" in cause:
        resolution = 1.0 / min(profile.duration_s for profile in machine.profiles)
        # beside an order that is told from it the mains are not what stands there
        reach = resolution if line is not None else max(resolution, NEAR_TONE_HZ)
        near = any(named.holds(tone.frequency_hz, reach) for tone in machine.tones)
        return near or (line is not None and line.is_tone)
    if "natural frequency" in cause:
        return any(named.holds(mode.frequency_hz, ON_A_MODE * mode.frequency_hz) for mode in machine.modes)
    if line is None or line.is_tone:
        return False
    if "gear mesh" in cause:
        beside = line.order - machine.gear_teeth * max(1, round(line.order / max(1, machine.gear_teeth)))
        return machine.gear_teeth > 0 and abs(beside) <= 1.0
    if "half order" in cause:
        return line.order % 1.0 == 0.5 or named.may_be_half
    return any(words in cause for words in OF_THE_SHAFT) and not any(part in cause for part in PARTS)
