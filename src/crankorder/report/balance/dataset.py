"""Forces and moments of an engine by order, before and after each balance, as one dataset: what the pictures show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from crankorder.engine.balance_data import BalancedEngine
from crankorder.engine.balancing import (
    MOMENT_AXES,
    ONE_RADIAN_PER_S_RPM,
    POSSIBILITIES,
    STRATEGIES,
    forces_of,
    moments_of,
    polar_diagram,
    systems,
)
from crankorder.engine.definition import Engine
from crankorder.engine.forces import DIRECTIONS, crankcase_moments, unbalance_force_n
from crankorder.quantities import Complexes, Floats
from crankorder.report.balance.sentences import plain_state

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
    subject: BalancedEngine, sheet: dict[str, Any], *, max_order: int, speeds_rpm: Sequence[float]
) -> xr.Dataset:
    """Force by system, axis and order over ω², in N by speed, and as the curve that it draws during a revolution.

    ``subject``: engine with its balance data. ``sheet``: its balance sheet. ``max_order``: highest order, that of the
    sheet. ``speeds_rpm``: crank speeds, > 0, those of the sheet.
    Returns dims system, axis ("x" along the cylinder, "y" across), order, speed, crank_angle; complex amplitudes a mean
    Re(a exp(i order φ)). Engines of several cylinders also have ``moment`` over moment_axis.
    """
    orders, angles = np.arange(1, max_order + 1), np.linspace(0, 1, max(_POINTS, 16 * max_order) + 1)
    ways = systems(subject)
    by_system = [forces_of(engine, max_order) for engine in ways.values()]
    force = np.array([[[f.x_g_mm for f in forces], [f.y_g_mm for f in forces]] for forces in by_system])
    diagrams = np.stack([polar_diagram(forces, angles) for forces in by_system])
    curves = np.stack([diagrams.real, diagrams.imag], axis=1)
    rotations = [max(forces, key=lambda force: force.largest_g_mm).rotation for forces in by_system]
    speeds, harmonics = np.asarray(speeds_rpm, dtype=np.float64), sheet["harmonics"]
    newtons = unbalance_force_n(np.abs(force)[..., None], speeds)
    on_crankcase = _about("amplitude of the force on the crankcase", "N")
    of_piston = _about("amplitude of the piston's acceleration over that of order 1", "1")
    dataset = xr.Dataset(
        {
            "force": (("system", "axis", "order"), force, _about("amplitude over squared crank speed", "g mm")),
            "phase": (("system", "axis", "order"), _phase_deg(force), _about("of the force; " + _PHASE, "degree")),
            "force_at_speed": (("system", "axis", "order", "speed"), newtons, on_crankcase),
            "curve": (("system", "axis", "crank_angle"), curves, _about("force over squared crank speed", "g mm")),
            "rotation": ("system", rotations, _about("of its largest order")),
            "harmonic": ("harmonic_order", np.array(list(harmonics.values())), of_piston),
        },
        coords={
            "system": ("system", list(ways), _about("what is balanced and how")),
            "axis": ("axis", ["x", "y"], _about("x along the cylinder, y across it")),
            "order": ("order", orders.astype(np.float64), _about("cycles per crank revolution", "1")),
            "speed": ("speed", speeds, _about("crank speed", "min-1")),
            "crank_angle": ("crank_angle", angles, _about("from top dead centre", "rev")),
            "harmonic_order": ("harmonic_order", np.array(list(map(float, harmonics))), _about("order", "1")),
        },
    )
    dataset.attrs[PLAIN] = plain_state(sheet) if sheet["counterweights_in_file"] else SYSTEMS["none"]
    return dataset if subject.is_single else _with_moments(dataset, list(ways.values()), max_order)


def _with_moments(dataset: xr.Dataset, engines: Sequence[Engine], max_order: int) -> xr.Dataset:
    """The dataset with the moments of several cylinders: of the engine without its shafts, and of every system."""
    moment = np.zeros((len(engines), len(MOMENT_AXES), max_order), dtype=complex)
    for number, engine in enumerate(engines):
        amplitudes = crankcase_moments(engine, ONE_RADIAN_PER_S_RPM, max_order=max_order) * 1e9
        for row, (name, kept) in enumerate(moments_of(engine, max_order).items()):
            for order in map(int, kept or {}):
                moment[number, row, order - 1] = amplitudes[DIRECTIONS.index(MOMENT_AXES[name]), order]
    about = _about("amplitude over squared crank speed", "g mm2")
    phase = _about("of the moment; " + _PHASE, "degree")
    return dataset.assign_coords(moment_axis=list(MOMENT_AXES)).assign(
        moment=(("moment_axis", "order"), moment[0], about),
        moment_phase=(("moment_axis", "order"), _phase_deg(moment[0]), phase),
        moment_by_system=(("system", "moment_axis", "order"), moment, about),
    )


def _phase_deg(amplitudes: Complexes) -> Floats:
    """Phases (degrees, above −180 and up to 180) of complex ``amplitudes`` of any shape; NaN where there is nothing."""
    phases = np.degrees(np.angle(amplitudes))
    phases[phases < -180 + 1e-9] = 180.0
    return np.where(np.abs(amplitudes) > 0, phases, np.nan)


def order_sum(amplitudes: Complexes, crank_angle_rev: Floats) -> Floats:
    """Sum over the orders 1, 2, …: shape (…, angle).

    ``amplitudes`` complex, shape (…, order); ``crank_angle_rev`` revolutions, shape (angle,).
    """
    orders = np.arange(1, amplitudes.shape[-1] + 1)
    turn = np.exp(2j * np.pi * orders[:, None] * crank_angle_rev)
    return np.asarray((amplitudes @ turn).real)


def _about(long_name: str, units: str = "") -> dict[str, str]:
    return {"long_name": long_name, **({"units": units} if units else {})}
