"""Datasets of a balance: forces and moments by order before and after each balance, and loads over the cycle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import xarray as xr

from crankorder.engine.balance_data import BalancedEngine
from crankorder.engine.balancing import forces_of, moments_g_mm2, polar_diagram, systems
from crankorder.engine.cycle_tables import PARTS, CycleCurves, MomentByOrder, crank_torque, cycle_curves, roll_moment
from crankorder.engine.definition import Engine
from crankorder.engine.forces import AXES, DIRECTIONS, FRAME, unbalance_force_n
from crankorder.plot.reading import listed
from crankorder.quantities import Complexes, Floats
from crankorder.report.balance_sentences import CYLINDER, SEVERAL, plain_state

SYSTEMS: dict[str, tuple[str, str]] = {
    "none": ("no balancing", "no counterweight, no shaft"),
    "a": ("strategy a", "order 1 along cancelled"),
    "b": ("strategy b", "order 1 across cancelled"),
    "c": ("strategy c", "equal along and across"),
    "d": ("strategy d", "counterweight on the rod too"),
    "1": ("shafts 1", "pair at crank speed"),
    "2": ("shafts 2", "pair at twice crank speed"),
    "3": ("shafts 3", "both pairs"),
    "4": ("shafts 4", "one, against the crank"),
    "4+2": ("shafts 4+2", "one, and pair at twice speed"),
    "webs": ("crank webs", "weights on the crank"),
    **{f"order {order}": (f"shafts up to order {order}", "webs and shafts") for order in range(1, 13)},
    "own": ("its own shafts", "as the engine file has them"),
}
"""What each system is called, and what it is: the plain engine, strategies of counterweights, sets of shafts."""

COUNTERWEIGHTS = ("none", "a", "b", "c", "d")
SHAFT_SETS = tuple(name for name in SYSTEMS if name not in COUNTERWEIGHTS[1:])
NO_FORCE = 1e-9
"""A force below this share of the largest is nothing."""

PLAIN = "plain_engine"
"""Attribute of the dataset that says what the plain engine is called: counterweights of its file make it "as built"."""

_PHASE = "largest where order · crank angle is minus this"
_POINTS = 720  # half a degree; at high orders 16 points a cycle


def balance_dataset(
    subject: BalancedEngine, sheet: dict[str, Any], *, max_order: int, speeds_rpm: Sequence[float]
) -> xr.Dataset:
    """Force by system, axis and order over ω², in N by speed, and as the curve that it draws during a revolution.

    ``force`` (system, axis, order) is in g mm, ``force_at_speed`` (system, axis, order, speed) in N, ``curve`` (system,
    axis, crank_angle) in g mm; axes are those of ``FRAME``, which the attributes state. A complex amplitude a means
    Re(a exp(i order φ)). ``roll_moment`` on the block and ``crank_torque`` (part, speed, gas_order) are in N m, of
    masses, gas and both. Engines of several cylinders also have ``moment`` (moment_axis, order) in g mm².

    Parameters
    ----------
    subject : engine with its balance data
    sheet : its balance sheet
    max_order : highest order, that of the sheet
    speeds_rpm : crank speeds of the sheet, rpm, above 0
    """
    orders, angles = np.arange(1, max_order + 1), np.linspace(0, 1, max(_POINTS, 16 * max_order) + 1)
    ways = systems(subject)
    by_system = [forces_of(engine, max_order) for engine in ways.values()]
    force = np.array([[[f.along_g_mm for f in forces], [f.across_g_mm for f in forces]] for forces in by_system])
    diagrams = np.stack([polar_diagram(forces, angles) for forces in by_system])
    curves = np.stack([diagrams.real, diagrams.imag], axis=1)
    rotations = [max(forces, key=lambda force: force.largest_g_mm).rotation for forces in by_system]
    speeds, harmonics = np.asarray(speeds_rpm, dtype=np.float64), sheet["harmonics"]
    newtons = unbalance_force_n(np.abs(force)[..., None], speeds)
    on_crankcase = _about("amplitude of the force on the crankcase", "N")
    roll, torque = (moment(subject.engine, max_order) for moment in (roll_moment, crank_torque))
    parted = ("part", "speed", "gas_order")
    of_piston = _about("amplitude of the piston's acceleration over that of order 1", "1")
    dataset = xr.Dataset(
        {
            "force": (("system", "axis", "order"), force, _about("amplitude over squared crank speed", "g mm")),
            "phase": (("system", "axis", "order"), _phase_deg(force), _about("of the force; " + _PHASE, "degree")),
            "force_at_speed": (("system", "axis", "order", "speed"), newtons, on_crankcase),
            "curve": (("system", "axis", "crank_angle"), curves, _about("force over squared crank speed", "g mm")),
            "roll_moment": (
                parted,
                _parts(roll, speeds),
                _about("amplitude of the moment on the block about Y", "N m"),
            ),
            "crank_torque": (parted, _parts(torque, speeds), _about("amplitude of the torque on the crank", "N m")),
            "rotation": ("system", rotations, _about("of its largest order")),
            "harmonic": ("harmonic_order", np.array(list(harmonics.values())), of_piston),
        },
        coords={
            "system": ("system", list(ways), _about("what is balanced and how")),
            "axis": ("axis", list(AXES), _about("of the engine: attributes X, Y, Z")),
            "part": ("part", list(PARTS), _about("of the moving masses, of the gas, and both together")),
            "gas_order": ("gas_order", roll.order, _about("cycles per crank revolution; 0: the mean", "1")),
            "order": ("order", orders.astype(np.float64), _about("cycles per crank revolution", "1")),
            "speed": ("speed", speeds, _about("crank speed", "min-1")),
            "crank_angle": ("crank_angle", angles, _about("from top dead centre", "rev")),
            "harmonic_order": ("harmonic_order", np.array(list(map(float, harmonics))), _about("order", "1")),
        },
    )
    dataset.attrs |= asdict(FRAME)
    dataset.attrs[PLAIN] = plain_state(sheet) if sheet["counterweights_in_file"] else SYSTEMS["none"][0]
    return dataset if subject.is_single else _with_moments(dataset, list(ways.values()), max_order)


def _with_moments(dataset: xr.Dataset, engines: Sequence[Engine], max_order: int) -> xr.Dataset:
    """The dataset with the moments of several cylinders: of the engine without its shafts, and of every system."""
    moment = np.stack([moments_g_mm2(engine, max_order)[:, 1:] for engine in engines])
    about = _about("amplitude over squared crank speed", "g mm2")
    phase = _about("of the moment; " + _PHASE, "degree")
    return dataset.assign_coords(moment_axis=list(DIRECTIONS)).assign(
        moment=(("moment_axis", "order"), moment[0], about),
        moment_phase=(("moment_axis", "order"), _phase_deg(moment[0]), phase),
        moment_by_system=(("system", "moment_axis", "order"), moment, about),
    )


def cycle_dataset(engine: Engine, speeds_rpm: Sequence[float]) -> xr.Dataset:
    """Torques of gas and masses [N m], and loads [N], of ``engine`` over its cycle at ``speeds_rpm`` [rpm], above 0.

    Torques are (speed, crank_angle), the angle in degrees, loads of walls (speed, cylinder, crank_angle), of pins
    (speed, cylinder, direction, crank_angle) with the directions "along" and "across" the cylinder, of main bearings
    (speed, bearing, axis, crank_angle) with the axes X and Z.
    """
    by_speed = cycle_curves(engine, speeds_rpm)
    angle, first = 360 * by_speed[0].crank_angle_rev, by_speed[0]
    speed = ("speed", np.asarray(speeds_rpm, dtype=np.float64), {"units": "min-1"})
    dataset = xr.Dataset(coords={"speed": speed, "crank_angle": ("crank_angle", angle, {"units": "degree"})})

    def add(name: str, dims: Sequence[str], of: Callable[[CycleCurves], Any], about: dict[str, str]) -> None:
        dataset[name] = (("speed", *dims, "crank_angle"), np.stack([of(curves) for curves in by_speed]), about)

    add("gas_torque", (), lambda curves: curves.gas_n_m, {"units": "N m"})
    add("inertia_torque", (), lambda curves: curves.inertia_n_m, {"units": "N m"})
    if first.loads:
        dataset["direction"] = ["along", "across"]
        across, about = ("cylinder", "direction"), _about("rod on pin", "N")
        walls = _about("piston on its wall", "N")
        add("wall_load", ("cylinder",), lambda curves: [load.side_thrust_n for load in curves.loads], walls)
        add("piston_pin_load", across, lambda curves: [load.piston_pin_n for load in curves.loads], about)
        add("crank_pin_load", across, lambda curves: [load.crank_pin_n for load in curves.loads], about)
    if first.bearings_n is not None:
        dataset["axis"], dataset["bearing"] = (
            ["X", "Z"],
            ("bearing", np.asarray(engine.main_bearings_m), {"units": "m"}),
        )
        about = _about("crankshaft on main bearing", "N")
        add("main_bearing_load", ("bearing", "axis"), lambda curves: np.asarray(curves.bearings_n)[:, [0, 2]], about)
    return dataset


def _parts(moment: MomentByOrder, speeds: Floats) -> Complexes:
    """Parts of a moment, (part, speed, order), at ``speeds`` (rpm)."""
    return np.stack([moment.at(float(speed)) for speed in speeds], axis=1)


def _phase_deg(amplitudes: Complexes) -> Floats:
    """Phases (degrees, above −180 and up to 180) of complex ``amplitudes`` of any shape; NaN where there is nothing."""
    phases = np.degrees(np.angle(amplitudes))
    phases[phases < -180 + 1e-9] = 180.0
    return np.where(np.abs(amplitudes) > 0, phases, np.nan)


def order_sum(amplitudes: Complexes, crank_angle_rev: Floats) -> Floats:
    """Sum (…, angles) over the orders 1, 2, …, in the unit of ``amplitudes``.

    ``amplitudes`` (…, orders) are complex, ``crank_angle_rev`` (angles,) are in revolutions.
    """
    orders = np.arange(1, amplitudes.shape[-1] + 1)
    turn = np.exp(2j * np.pi * orders[:, None] * crank_angle_rev)
    return np.asarray((amplitudes @ turn).real)


def _about(long_name: str, units: str = "") -> dict[str, str]:
    return {"long_name": long_name, **({"units": units} if units else {})}


def axis_names(balance: xr.Dataset) -> tuple[str, str]:
    """Names of the axes Z and X of the balance dataset ``balance`` (system, axis, …).

    An engine of several cylinders, whose dataset has ``moment`` (moment_axis, order), has Z and X; a single cylinder
    has its own directions.
    """
    along, across = (SEVERAL if "moment" in balance else CYLINDER).values()
    return along, across


def alike(curves: xr.DataArray) -> list[list[str]]:
    """Names of the systems, grouped where their ``curves`` (system, …) are the same, in the order of ``curves``."""
    limit = NO_FORCE * float(np.abs(curves.values).max())
    groups: dict[str, list[str]] = {}
    for name in map(str, curves["system"].values):
        apart = {first: float(np.abs(curves.sel(system=name) - curves.sel(system=first)).max()) for first in groups}
        first = next((first for first, most in apart.items() if most <= limit), name)
        groups.setdefault(first, []).append(name)
    return list(groups.values())


def words_of(name: str, balance: xr.Dataset) -> tuple[str, str]:
    """Label of the system ``name`` of the balance dataset ``balance`` (system, axis, order), and what it is made of."""
    plain = str(balance.attrs[PLAIN])
    built = name == "none" and plain != SYSTEMS["none"][0]
    return (plain, "counterweights of its file, no shaft") if built else SYSTEMS[name]


def called(names: Sequence[str], balance: xr.Dataset) -> str:
    """``names`` of systems of ``balance`` (system, …) in one text that says common words once: "shafts 1 and 4"."""
    kinds: dict[str, list[str]] = {}
    for name in sorted(names, key=list(SYSTEMS).index):
        kind, _, mark = words_of(name, balance)[0].rpartition(" ")
        kinds.setdefault(kind, []).append(mark)
    return ", ".join(f"{kind} {listed(marks)}" for kind, marks in kinds.items())


def present(balance: xr.Dataset, names: Sequence[str]) -> list[str]:
    """Those of the ``names`` of systems that the dataset ``balance`` (system, …) has."""
    return [name for name in names if name in balance["system"].values]
