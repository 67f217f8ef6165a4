"""Frequencies at which an induction motor makes itself heard, from its supply, poles, rotor bars and speed.

Sources: ISO 20958:2013 (electrical signature analysis of induction motors); A. H. Bonnett and G. C. Soukup (1992),
IEEE Transactions on Industry Applications 28, p. 921.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, field_validator

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(gt=0)]

USUAL_SLIP = 0.1
"""Motors that run steadily slip no more: 1 to 5 % at rated load, small ones up to 10 %."""


class Motor(BaseModel):
    """``[motor]``: an induction motor, whose shaft turns ``shaft_ratio`` times per crank revolution.

    ``supply_hz`` is the frequency of its supply; left out for a motor on a variable-speed drive, of which then only the
    lines that go with the shaft are named. ``poles`` counts poles, not pairs: 4 turn at 1500 rpm on 50 Hz, less slip.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    supply_hz: Positive | None = Field(
        default=None,
        description="Frequency of the supply; left out for a motor on a variable-speed drive.",
        examples=[50.0],
    )
    poles: Count | None = Field(
        default=None, description="Poles, not pairs: 4 turn somewhat below 1500 rpm on 50 Hz.", examples=[4]
    )
    rotor_bars: Count | None = Field(default=None, description="Bars of the rotor.", examples=[44])
    stator_slots: Count | None = Field(default=None, description="Slots of the stator.", examples=[36])
    shaft_ratio: Positive = Field(default=1.0, description="Turns of the motor per crank revolution.", examples=[1.0])

    @field_validator("poles")
    @classmethod
    def _poles_come_in_pairs(cls, value: int | None) -> int | None:
        if value is not None and value % 2:
            raise ValueError("poles come in pairs: 2, 4, 6, … (count poles, not pairs)")
        return value

    @property
    def highest_order(self) -> float:
        """Highest order of the crank at which it makes a line, at a usual slip; 0 where none goes with the shaft."""
        counts = [count for count in (self.rotor_bars, self.stator_slots) if count is not None]
        beside = (self.poles or 0) / (1.0 - USUAL_SLIP) if self.supply_hz is not None else 0.0
        return (max(counts) + beside) * self.shaft_ratio if counts else 0.0

    def synchronous_rpm(self, supply_hz: float) -> float:
        """Speed of the field in rpm of the motor's shaft at a supply of ``supply_hz``: 120 f / poles."""
        if self.poles is None:
            raise ValueError("the poles of the motor are not stated")
        return 120.0 * supply_hz / self.poles


@dataclass(frozen=True)
class MotorLine:
    """A line at ``mains`` times the supply frequency plus ``turns`` times the speed of the crank.

    ``name`` says what it is; ``of`` is the line beside which it stands and ``side`` where, "below" or "above";
    both are "" where it is no sideband.
    """

    name: str
    mains: int
    turns: float
    of: str = ""
    side: str = ""

    def hertz_at(self, supply_hz: float, rpm: float) -> float:
        """Frequency in Hz at a supply of ``supply_hz`` and a speed of ``rpm``."""
        return self.mains * supply_hz + self.turns * rpm / 60.0


TWICE_MAINS, SHAFT, BAR_PASS, SLOT_PASS = "twice mains", "order 1 of the motor", "bar pass", "slot pass"


def motor_lines(motor: Motor) -> tuple[MotorLine, ...]:
    """Lines of ``motor``: mains, twice mains and order 1 with their pole-pass sidebands, bar pass with those at 2 f.

    The pole-pass frequency is the poles times what the rotor lags behind the field: 2 f - poles x speed = 2 x slip x f.
    A broken bar sets its sidebands beside order 1, an air gap that changes sets them beside twice mains; bars passing
    an uneven gap make the bar pass, which the field's force modulates with twice mains. Without a supply frequency only
    what goes with the shaft is there.
    """
    ratio, made = motor.shaft_ratio, []
    if motor.supply_hz is not None:
        made += [MotorLine("mains", 1, 0.0), MotorLine(TWICE_MAINS, 2, 0.0)]
    if motor.supply_hz is not None and motor.poles is not None:
        turns = motor.poles * ratio
        for name, mains, own in ((SHAFT, 0, ratio), (TWICE_MAINS, 2, 0.0)):
            made += [
                MotorLine(f"pole-pass sideband of {name}", mains - 2, own + turns, name, "below"),
                MotorLine(f"pole-pass sideband of {name}", mains + 2, own - turns, name, "above"),
            ]
    for name, count in ((BAR_PASS, motor.rotor_bars), (SLOT_PASS, motor.stator_slots)):
        if count is None:
            continue
        made.append(MotorLine(name, 0, count * ratio))
        if motor.supply_hz is not None:
            text = f"sideband of {name} at twice mains"
            made += [
                MotorLine(text, -2, count * ratio, name, "below"),
                MotorLine(text, 2, count * ratio, name, "above"),
            ]
    return tuple(made)
