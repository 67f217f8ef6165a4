"""What a test says of its machine: its engine, what is known of the shaft, and what may excite it."""

from __future__ import annotations

import contextlib
from pathlib import Path

from crankorder.batch.plan import CampaignPlan
from crankorder.batch.workers import WorkerDiedError, each
from crankorder.engine.definition import Engine, load_engine
from crankorder.engine.forces import orders_made
from crankorder.engine.in_cycle import Lag
from crankorder.errors import CrankorderError
from crankorder.identify.sources import Limit, Sources
from crankorder.ingest.manifest import Manifest
from crankorder.quantities import QualityFlag
from crankorder.settings import Settings
from crankorder.shaft.calibration import calibrate, mass_lag
from crankorder.shaft.decode import PULSE_KINDS, ShaftKnowledge, flags_named
from crankorder.shaft.line_pattern import LinePattern
from crankorder.stages import analyse_encoder

KINEMATIC_SHARE = 1e-3
"""An order with less than this share of the largest inertia force is not called engine kinematics."""


def engine_of_test(plan: CampaignPlan) -> Engine | None:
    """The engine that the manifest of the ``plan`` names, if any."""
    name = plan.manifest.test.engine
    return None if name is None else load_engine(name, beside=plan.folder)


def sources_of(manifest: Manifest, engine: Engine | None, settings: Settings) -> Sources:
    """What ``manifest`` and ``engine`` say of the machine; less where ``settings`` ask for no findings that need it."""
    orders: tuple[float, ...] = ()
    bearings = manifest.bearings
    if engine is not None and "findings" in settings.report.results:
        orders = orders_made(engine, share=KINEMATIC_SHARE, max_order=int(settings.orders.max_order))
        named = {bearing.name for bearing in bearings}
        bearings += tuple(bearing for bearing in engine.bearings if bearing.name not in named)
    return Sources(
        revs_per_cycle=manifest.revs_per_cycle,
        engine_orders=orders,
        bearings=bearings,
        firing=engine is not None and engine.gas is not None,
        gears=tuple((gear.name, gear.mesh_order) for gear in manifest.gears),
        engine=engine,
        paths=manifest.transfer_paths,
        added=manifest.added_masses,
        motor=manifest.motor,
        limits=tuple(
            Limit(one.quantity, *one.band_hz, one.value_si, one.source, one.channels) for one in manifest.limits
        ),
        rotor_kg=None if manifest.rotor is None else manifest.rotor.mass_kg,
        service_rpm=None if manifest.rotor is None else manifest.rotor.service_rpm,
        two_stroke=manifest.test.cycle == "two-stroke",
    )


def knowledge_of(
    plan: CampaignPlan, engine: Engine | None, recordings: list[Path], jobs: int
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
