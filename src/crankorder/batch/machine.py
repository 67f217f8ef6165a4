"""What a test says of its machine: its engine, and what may excite it."""

from __future__ import annotations

from crankorder.batch.plan import CampaignPlan
from crankorder.engine.definition import Engine, load_engine
from crankorder.engine.forces import orders_made
from crankorder.identify.machine_model import Limit, MachineModel, StatedPart
from crankorder.ingest.manifest import Manifest
from crankorder.settings import Settings

KINEMATIC_SHARE = 1e-3
"""An order with less than this share of the largest inertia force is not called engine kinematics."""


def engine_of_test(plan: CampaignPlan) -> Engine | None:
    """The engine that the manifest of the ``plan`` names, if any."""
    name = plan.manifest.test.engine
    return None if name is None else load_engine(name, beside=plan.folder)


def sources_of(manifest: Manifest, engine: Engine | None, settings: Settings) -> MachineModel:
    """What ``manifest`` and ``engine`` say of the machine; less where ``settings`` ask for no findings that need it."""
    orders: tuple[float, ...] = ()
    bearings = manifest.bearings
    if engine is not None and "findings" in settings.report.results:
        orders = orders_made(engine, share=KINEMATIC_SHARE, max_order=int(settings.orders.max_order))
        named = {bearing.name for bearing in bearings}
        bearings += tuple(bearing for bearing in engine.bearings if bearing.name not in named)
    return MachineModel(
        revs_per_cycle=manifest.revs_per_cycle,
        engine_orders=orders,
        bearings=bearings,
        firing=engine is not None and engine.gas is not None,
        gears=tuple(
            StatedPart("gear mesh", gear.name, gear.mesh_order, gear.ratio_share * gear.mesh_order, gear.ratio)
            for gear in manifest.gears
        ),
        engine=engine,
        paths=manifest.transfer_paths,
        added=manifest.added_masses,
        motor=manifest.motor,
        limits=tuple(
            Limit(limit.quantity, *limit.band_hz, limit.value_si, limit.source, limit.channels)
            for limit in manifest.limits
        ),
        rotor_kg=None if manifest.rotor is None else manifest.rotor.mass_kg,
        service_rpm=None if manifest.rotor is None else manifest.rotor.service_rpm,
        two_stroke=manifest.test.cycle == "two-stroke",
    )
