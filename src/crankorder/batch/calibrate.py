"""What the recordings of a test say together of their shaft: its engine, and the errors of its encoder's lines."""

from __future__ import annotations

import contextlib
from pathlib import Path

from crankorder.batch.plan import TestPlan
from crankorder.batch.workers import WorkerDiedError, each
from crankorder.engine.definition import Engine
from crankorder.engine.in_cycle import Lag
from crankorder.errors import CrankorderError
from crankorder.quantities import QualityFlag
from crankorder.shaft.calibration import calibrate, mass_lag
from crankorder.shaft.decode import PULSE_KINDS, ShaftKnowledge, flags_named
from crankorder.shaft.line_pattern import LinePattern
from crankorder.stages import analyse_encoder


def knowledge_of(
    plan: TestPlan, engine: Engine | None, recordings: list[Path], jobs: int
) -> tuple[ShaftKnowledge, list[QualityFlag]]:
    """What is known of the shaft of a test, and flags for the whole test.

    Where the settings of ``plan`` ask for it the encoder is calibrated first: ``recordings`` are read ``jobs`` at a
    time for their pulses alone. ``engine``: of the test, or None. A recording that cannot be read is left out here and
    told later, when it is analysed.
    """
    if not plan.settings.shaft.calibrate_encoder or plan.manifest.encoder.kind not in PULSE_KINDS:
        return ShaftKnowledge(engine), []

    def pattern(number: int) -> LinePattern:
        return analyse_encoder(recordings[number], plan.manifest, plan.settings)

    found: dict[int, LinePattern] = {}
    for number, made in each(pattern, len(recordings), jobs=jobs):
        with contextlib.suppress(CrankorderError, WorkerDiedError):
            found[number] = made()
    patterns = [found[number] for number in sorted(found)]
    encoder = plan.manifest.encoder
    calibration = calibrate(
        patterns,
        ratio=encoder.ratio,
        engine_lag=_mass_lag(engine),
        index_to_tdc_deg=encoder.index_to_tdc_deg if "index_to_tdc_deg" in encoder.model_fields_set else None,
        least_speed_ratio=plan.settings.shaft.calibration_speed_ratio,
    )
    return ShaftKnowledge(engine, calibration if calibration.separated else None), flags_named(
        "all", calibration.remarks
    )


def _mass_lag(engine: Engine | None) -> Lag | None:
    return None if engine is None else mass_lag(engine)
