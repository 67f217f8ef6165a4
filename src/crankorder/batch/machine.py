"""What a test says of its machine: its engine, what is known of the shaft, and what may excite it."""

from __future__ import annotations

import contextlib
from pathlib import Path

from crankorder.batch.plan import CampaignPlan
from crankorder.batch.workers import WorkerDiedError, each
from crankorder.engine.definition import Engine, load_engine
from crankorder.engine.forces import orders_made
from crankorder.errors import CrankorderError
from crankorder.identify.sources import Limit, Sources
from crankorder.ingest.manifest import Manifest
from crankorder.ingest.recording import read_recording
from crankorder.quantities import QualityFlag
from crankorder.settings import Settings
from crankorder.shaft.decode import ShaftKnowledge, flags_named
from crankorder.shaft.slip_speed import ReadSpeed, slip_speed, speeds_under_load

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
    """What is known of the shaft of a test, and flags of recordings whose stated speed is not theirs.

    Where ``recordings`` of a test of the ``plan`` that states their speeds have the same one, the slip of the motor
    tells them apart: they are read for it, ``jobs`` at a time. ``engine``: of the test, or None. A recording that
    cannot be read is left out here and told later, when it is analysed.
    """
    if plan.manifest.encoder.kind != "constant":
        return ShaftKnowledge(engine), []
    motor = plan.manifest.motor
    stated = {plan.name_of(path): plan.manifest.speed_of(path) for path in recordings}
    known = {name: rpm for name, rpm in stated.items() if rpm is not None}
    if motor is None or motor.poles is None or len(set(known.values())) == len(known):
        return ShaftKnowledge(engine), []

    def read(number: int) -> ReadSpeed | None:
        recording = read_recording(
            recordings[number], plan.manifest, settings=plan.settings.ingest, shaft=plan.settings.shaft
        )
        return slip_speed(recording["signal"].values, float(recording.attrs["rate_hz"]), motor)

    told: dict[str, ReadSpeed] = {}
    for number, made in each(read, len(recordings), jobs=jobs):
        with contextlib.suppress(CrankorderError, WorkerDiedError):
            if (speed := made()) is not None:
                told[plan.name_of(recordings[number])] = speed
    speeds, remarks = speeds_under_load(known, told)
    return ShaftKnowledge(engine, speeds_rpm=speeds), [
        flag for name, remark in remarks for flag in flags_named(name, [remark])
    ]
