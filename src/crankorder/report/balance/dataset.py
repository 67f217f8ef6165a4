"""Forces and moments of an engine by order, before and after each balance, as one dataset: what the pictures show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from crankorder.engine.balance_data import BalancedEngine, reduced_masses
from crankorder.engine.balance_sheet import POSSIBILITIES, STRATEGIES, BalanceSheet
from crankorder.engine.balancing import OrderForce, balanced, force_by_order, polar_diagram, unbalance_force_n
from crankorder.engine.definition import BalanceShafts, Engine
from crankorder.engine.forces import DIRECTIONS, crankcase_moments
from crankorder.engine.shaft_design import MOMENT_AXES, designs_for, whole_force, whole_moments
from crankorder.engine.shafts import ONE_RADIAN_PER_S_RPM, shaft_layout
from crankorder.quantities import Complexes, Floats

Forces = tuple[OrderForce, ...]

SYSTEMS: dict[str, str] = {
    "none": "no balancing",
    **{str(name): f"strategy {name}" for name in STRATEGIES},
    **{str(name): f"shafts {name}" for name in POSSIBILITIES},
    "webs": "crank webs",
    **{f"order {order}": f"shafts up to order {order}" for order in range(1, 13)},
    "own": "its own shafts",
}
"""What each system is called: the plain engine, counterweights, counterweights with additional shafts, as it is."""

PLAIN = "plain_engine"
"""Attribute of the dataset that says what the plain engine is called: counterweights of its file make it "as built"."""

_PHASE = "largest where order · crank angle is minus this"
_POINTS = 720  # half a degree; at high orders 16 points a cycle


def balance_dataset(
    subject: BalancedEngine, sheet: BalanceSheet, *, max_order: int, speeds_rpm: Sequence[float]
) -> xr.Dataset:
    """Force by system, axis and order over ω², in N by speed, and as the curve that it draws during a revolution.

    ``subject``: engine with its balance data. ``sheet``: its balance sheet; orders that it leaves out are zero here.
    ``max_order``: highest order, that of the sheet. ``speeds_rpm``: crank speeds, > 0, those of the sheet.
    Returns dims system, axis ("x" along the cylinder, "y" across), order, speed, crank_angle; complex amplitudes a mean
    Re(a exp(i order φ)). Engines of several cylinders also have ``moment`` over moment_axis.
    """
    orders, angles = np.arange(1, max_order + 1), np.linspace(0, 1, max(_POINTS, 16 * max_order) + 1)
    systems = forces_by_system(subject, sheet, max_order=max_order)
    force = np.zeros((len(systems), 2, max_order), dtype=complex)
    for number, forces in enumerate(systems.values()):
        for amplitude in forces:
            force[number, :, round(amplitude.order) - 1] = amplitude.x_g_mm, amplitude.y_g_mm
    diagrams = np.stack([polar_diagram(forces, angles) for forces in systems.values()])
    curves = np.stack([diagrams.real, diagrams.imag], axis=1)
    largest = [max(forces, key=lambda force: force.semi_axes_g_mm[0], default=None) for forces in systems.values()]
    rotations = ["none" if force is None else force.rotation for force in largest]
    speeds = np.asarray(speeds_rpm, dtype=np.float64)
    newtons = unbalance_force_n(np.abs(force)[..., None], speeds)
    shares = {int(order): share for order, share in sheet.harmonics.items()}
    on_crankcase = _about("amplitude of the force on the crankcase", "N")
    of_piston = _about("amplitude of the piston's acceleration over that of order 1", "1")
    dataset = xr.Dataset(
        {
            "force": (("system", "axis", "order"), force, _about("amplitude over squared crank speed", "g mm")),
            "phase": (("system", "axis", "order"), phase_deg(force), _about("of the force; " + _PHASE, "degree")),
            "force_at_speed": (("system", "axis", "order", "speed"), newtons, on_crankcase),
            "curve": (("system", "axis", "crank_angle"), curves, _about("force over squared crank speed", "g mm")),
            "rotation": ("system", rotations, _about("of its largest order")),
            "harmonic": ("harmonic_order", np.array(list(shares.values())), of_piston),
        },
        coords={
            "system": ("system", list(systems), _about("what is balanced and how")),
            "axis": ("axis", ["x", "y"], _about("x along the cylinder, y across it")),
            "order": ("order", orders.astype(np.float64), _about("cycles per crank revolution", "1")),
            "speed": ("speed", speeds, _about("crank speed", "min-1")),
            "crank_angle": ("crank_angle", angles, _about("from top dead centre", "rev")),
            "harmonic_order": ("harmonic_order", np.array(list(shares), dtype=np.float64), _about("order", "1")),
        },
    )
    dataset.attrs[PLAIN] = sheet.plain_state if sheet.counterweights_in_file else SYSTEMS["none"]
    return dataset if sheet.strategies is not None else _with_moments(dataset, subject, sheet, max_order)


def forces_by_system(subject: BalancedEngine, sheet: BalanceSheet, *, max_order: int) -> dict[str, Forces]:
    """Force by order that each system makes, by its name in :data:`SYSTEMS`, plain engine first.

    ``subject``: engine with its balance data. ``sheet``: its balance sheet, which says what systems it has.
    ``max_order``: highest order.
    """
    if sheet.strategies is None:
        systems = {name: whole_force(engine, max_order) for name, engine in _designed(subject, sheet).items()}
    else:
        masses = reduced_masses(subject)
        systems = {"none": force_by_order(masses, max_order=max_order)}
        for strategy in STRATEGIES:
            if sheet.strategies[strategy] is not None:
                systems[strategy] = force_by_order(balanced(masses, strategy), max_order=max_order)
        for possibility in POSSIBILITIES:
            if sheet.shafts.sets[possibility] is not None:
                systems[possibility] = shaft_layout(masses, possibility, max_order=max_order).residual
    if sheet.shafts.own is not None:
        systems["own"] = whole_force(subject.engine, max_order)
    return systems


def _designed(subject: BalancedEngine, sheet: BalanceSheet) -> dict[str, Engine]:
    """An engine of several cylinders by system: without shafts, with each design, as it is."""
    engine = subject.engine
    systems = {"none": engine.model_copy(update={"shafts": BalanceShafts()})}
    systems |= {design.name: design.on(engine) for design in designs_for(subject)}
    return systems if sheet.shafts.own is None else {**systems, "own": engine}


def _with_moments(dataset: xr.Dataset, subject: BalancedEngine, sheet: BalanceSheet, max_order: int) -> xr.Dataset:
    """The dataset with the moments of several cylinders: of the engine without its shafts, and of every system."""
    systems = _designed(subject, sheet)
    moment = np.zeros((len(systems), len(MOMENT_AXES), max_order), dtype=complex)
    for number, engine in enumerate(systems.values()):
        amplitudes = crankcase_moments(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order) * 1e9
        for row, (name, kept) in enumerate(whole_moments(engine, max_order).items()):
            for order in kept or {}:
                moment[number, row, int(order) - 1] = amplitudes[DIRECTIONS.index(MOMENT_AXES[name])][int(order)]
    about = _about("amplitude over squared crank speed", "g mm2")
    phase = _about("of the moment; " + _PHASE, "degree")
    return dataset.assign_coords(moment_axis=list(MOMENT_AXES)).assign(
        moment=(("moment_axis", "order"), moment[0], about),
        moment_phase=(("moment_axis", "order"), phase_deg(moment[0]), phase),
        moment_by_system=(("system", "moment_axis", "order"), moment, about),
    )


def phase_deg(amplitudes: Complexes) -> Floats:
    """Phases (degrees, −180 to 180) of complex ``amplitudes`` of any shape; NaN where there is nothing."""
    return np.where(np.abs(amplitudes) > 0, np.degrees(np.angle(amplitudes)), np.nan)


def order_sum(amplitudes: Complexes, crank_angle_rev: Floats) -> Floats:
    """Sum over the orders 1, 2, …: shape (…, angle).

    ``amplitudes`` complex, shape (…, order); ``crank_angle_rev`` revolutions, shape (angle,).
    """
    orders = np.arange(1, amplitudes.shape[-1] + 1)
    turn = np.exp(2j * np.pi * orders[:, None] * crank_angle_rev)
    return np.asarray((amplitudes @ turn).real)


def _about(long_name: str, units: str = "") -> dict[str, str]:
    return {"long_name": long_name, **({"units": units} if units else {})}
