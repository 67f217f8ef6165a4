"""What is known of a shaft beside the pulses of one recording."""

from __future__ import annotations

from dataclasses import dataclass

from crankorder.engine.definition import Engine
from crankorder.shaft.calibration import Calibration


@dataclass(frozen=True, eq=False)
class ShaftKnowledge:
    """The engine that the shaft belongs to, and the errors of its encoder's lines; None where they are not known."""

    engine: Engine | None = None
    calibration: Calibration | None = None
