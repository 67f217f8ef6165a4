"""The engine as data: lengths, masses, cylinders, balance shafts, gas and bearings, read from a TOML file."""

from __future__ import annotations

import csv
from collections.abc import Collection, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import ConfigDict, Field, ValidationError, ValidationInfo, field_validator

from crankorder.engine.machine_parts import ASCENDING, NOT_EMPTY, Bearing, EngineData, NonNegative, Positive
from crankorder.engine.slider_crank import SliderCrank
from crankorder.errors import CrankorderError, ManyErrors, RequestError
from crankorder.settings import extremes, toml_path, toml_table, validation_fault

GAS_COLUMNS = ("crank_angle_deg", "pressure_pa", "torque_n_m")
"""Columns that the CSV file of a gas curve may have: the first and one of the others."""
ShaftOrder = Annotated[int, Field(ge=1, le=1000)]
REVS_PER_CYCLE = {"four-stroke": 2, "two-stroke": 1, "rotor": 1}


class StatedPair(EngineData):
    """A counter-rotating pair at ``order`` times crank speed; ``unbalance_g_mm``: of its two shafts together.

    Turning that fast it makes order² · ``unbalance_g_mm`` of force over ω² of the crank.
    """

    order: ShaftOrder
    unbalance_g_mm: Positive


class Weight(EngineData):
    """An unbalance of a shaft or a crank web: mass times radius, where it points, and its place along the crankshaft.

    ``angle_deg``: of its heavy side when the engine's crank angle is zero, from Z towards X, the crank's way.
    ``position_m``: along Y.
    """

    unbalance_g_mm: NonNegative
    angle_deg: float = 0.0
    position_m: float = 0.0


class SingleShaft(EngineData):
    """One balance shaft parallel to the crankshaft, with weights at places of their own: for force, couple or both.

    ``speed_ratio``: its speed over the crank's, a whole number, below zero against the crank; a weight makes its square
    times the unbalance of force over ω² of the crank. ``x_m``, ``z_m``: its axis from the crankshaft, for the moment
    that its force has about that.
    """

    speed_ratio: Annotated[int, Field(ge=-20, le=20)]
    weights: Annotated[tuple[Weight, ...], NOT_EMPTY] = Field(strict=False)
    x_m: float = 0.0
    z_m: float = 0.0

    @field_validator("speed_ratio")
    @classmethod
    def _turns(cls, value: int) -> int:
        if value == 0:
            raise ValueError("must not be 0: a shaft that stands balances nothing")
        return value


class BalanceShafts(EngineData):
    """Balance shafts: pairs that act along Z, by the orders that they cancel or by their unbalance, and single ones.

    ``orders``: of them the force of the pistons is cancelled but for ``unbalanced_mass_kg``, the reciprocating mass of
    each cylinder that is left; what turns with the crank is for its webs, and stays. A
    pair of ``pairs`` stands against the force of its order with what unbalance it has: too little leaves force, too
    much reverses it. ``timed_to = "force"``: each pair stands against the whole force of its order, the quadrature part
    that an offset makes included. ``"crank"``: the pair is timed to the crank and leaves that part. ``position_m``:
    their middle, along the crankshaft. Each of ``single`` acts as it stands there, in any direction.
    """

    orders: tuple[ShaftOrder, ...] = Field(default=(), strict=False)
    pairs: tuple[StatedPair, ...] = Field(default=(), strict=False)
    unbalanced_mass_kg: float = 0.0
    timed_to: Literal["force", "crank"] = "force"
    position_m: float = 0.0
    single: tuple[SingleShaft, ...] = Field(default=(), strict=False)

    @field_validator("pairs")
    @classmethod
    def _one_pair_an_order(cls, value: tuple[StatedPair, ...], info: ValidationInfo) -> tuple[StatedPair, ...]:
        taken = [*info.data.get("orders", ()), *(pair.order for pair in value)]
        twice = sorted({pair.order for pair in value if taken.count(pair.order) > 1})
        if twice:
            raise ValueError(f"more than one pair for order {', '.join(map(str, twice))}")
        return value

    @property
    def every_order(self) -> tuple[int, ...]:
        """Orders of all shafts, ascending."""
        stated = {*(pair.order for pair in self.pairs), *(abs(shaft.speed_ratio) for shaft in self.single)}
        return tuple(sorted({*self.orders, *stated}))


class Rod(EngineData):
    """The connecting rod of each cylinder. Its masses are part of the engine's reciprocating and rotating ones.

    ``centre_from_big_end_m``: its centre of gravity; ``inertia_kg_m2``: about that, left out where two masses are to
    stand for the rod.
    """

    mass_kg: Positive
    centre_from_big_end_m: NonNegative
    inertia_kg_m2: Positive | None = None


class Cylinder(EngineData):
    """Where a cylinder is: angle of its crank pin, lean of its axis, place along the crankshaft, firing dead centre.

    ``crank_deg``: of its pin, in the sense of rotation, when the engine's crank angle is zero; 0 is along Z.
    ``bank_deg``: of its axis from Z towards X. ``position_m``: along Y. ``firing_deg``: engine crank angle within the
    cycle at which its pin stands along its axis and it fires; needed for gas forces only. The masses and the offset are
    those of the engine where the cylinder has none of its own.
    """

    crank_deg: float = 0.0
    bank_deg: float = 0.0
    position_m: float = 0.0
    firing_deg: float | None = None
    reciprocating_mass_kg: NonNegative | None = None
    rotating_unbalance_kg_m: NonNegative | None = None
    rotating_unbalance_deg: float | None = None
    offset_m: float | None = None


class IdealCycle(EngineData):
    """An air-standard cycle: compression from the lower dead centre, heat at once or over some angle, expansion.

    ``intake_pa``: absolute, at the start of compression and during intake. ``heat_j``: taken up by the gas of one
    cylinder in a cycle. ``burn_start_deg``: from the piston's upper dead centre; the heat comes from there on over
    ``burn_duration_deg``, first slowly, then fast, then slowly, ½ (1 − cos); 0: at once. ``exponent``: ratio of
    specific heats. ``exhaust_pa``: absolute, of the exhaust stroke; that of the surroundings where left out.
    """

    compression_ratio: Annotated[float, Field(gt=1)]
    intake_pa: Positive
    heat_j: NonNegative
    burn_start_deg: Annotated[float, Field(gt=-180, lt=180)] = 0.0
    burn_duration_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    exponent: Annotated[float, Field(gt=1, lt=2)] = 1.4
    exhaust_pa: NonNegative | None = None

    @field_validator("burn_duration_deg")
    @classmethod
    def _burns_before_it_opens(cls, value: float, info: ValidationInfo) -> float:
        if "burn_start_deg" in info.data and info.data["burn_start_deg"] + value >= 180:
            raise ValueError("the heat must have come 180° after the upper dead centre, before the gas is let out")
        return value


class GasCurve(EngineData):
    """Gas of one cylinder over a cycle: its pressure, an ideal cycle, or the torque that it makes.

    ``crank_angle_deg``: ascending, from the firing dead centre, less than one cycle long; the curve is straight between
    the angles and closes on itself. ``pressure_pa``: absolute, with ``surroundings_pa`` below the piston; or
    ``torque_n_m`` in the sense of rotation. ``file``: a CSV file beside the engine file whose columns crank_angle_deg
    and pressure_pa or torque_n_m take their place. ``ideal``: in place of any curve.
    """

    crank_angle_deg: Annotated[tuple[float, ...] | None, ASCENDING] = Field(default=None, strict=False)
    pressure_pa: tuple[float, ...] | None = Field(default=None, strict=False)
    torque_n_m: tuple[float, ...] | None = Field(default=None, strict=False)
    ideal: IdealCycle | None = None
    file: str | None = None
    surroundings_pa: NonNegative = 101325.0

    @field_validator("crank_angle_deg")
    @classmethod
    def _two_angles(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if value is not None and len(value) < 2:
            raise ValueError("must have at least 2 entries")
        return value

    @field_validator("pressure_pa", "torque_n_m")
    @classmethod
    def _as_many_as_angles(cls, value: tuple[float, ...] | None, info: ValidationInfo) -> tuple[float, ...] | None:
        angles = info.data.get("crank_angle_deg")
        if value is not None and angles is not None and len(value) != len(angles):
            raise ValueError(f"must have one value for each of the {len(angles)} crank angles")
        return value

    @field_validator("ideal")
    @classmethod
    def _one_curve(cls, value: IdealCycle | None, info: ValidationInfo) -> IdealCycle | None:
        # a faulty curve counts as given: that it is faulty is told already, and nothing else may hide
        given = {name for name in ("pressure_pa", "torque_n_m") if info.data.get(name, ()) is not None}
        if len(given) + (value is not None) != 1:
            raise ValueError("a gas curve is either pressure_pa or torque_n_m, or else an ideal cycle")
        if (info.data.get("crank_angle_deg", ()) is None) != (value is not None):
            raise ValueError("crank_angle_deg belongs to pressure_pa and torque_n_m, and to them alone")
        return value

    model_config = ConfigDict(validate_default=True)


class Engine(EngineData):
    """An engine as the model needs it; lengths in m, masses in kg, angles in degrees of crank.

    Masses are those of each cylinder. ``reciprocating_mass_kg`` includes the rod's share. ``rotating_unbalance_kg_m``
    includes the rod's other share and the counterweights: what is left of a throw, its angle counted from the pin.
    ``webs``: counterweights beside those that ``rotating_unbalance_kg_m`` holds already, each on a web of its own.
    ``main_bearings_m``: along the crankshaft, ascending; between two of them the shaft is a beam on two supports.
    ``flywheel_inertia_kg_m2``: of all that turns with the crank; needed for its speed within the cycle only.
    """

    title: str = ""
    cycle: Literal["four-stroke", "two-stroke", "rotor"] = "four-stroke"
    crank_radius_m: Positive
    offset_m: float = 0.0
    rod_length_m: Positive
    reciprocating_mass_kg: NonNegative
    rotating_unbalance_kg_m: NonNegative = 0.0
    rotating_unbalance_deg: float = 0.0
    rod: Rod | None = None
    cylinders: Annotated[tuple[Cylinder, ...], NOT_EMPTY] = Field(default=(Cylinder(),), strict=False)
    webs: tuple[Weight, ...] = Field(default=(), strict=False)
    main_bearings_m: tuple[float, ...] = Field(default=(), strict=False)
    bore_m: Positive | None = None
    gas: GasCurve | None = None
    flywheel_inertia_kg_m2: Positive | None = None
    shafts: BalanceShafts = BalanceShafts()
    bearings: tuple[Bearing, ...] = Field(default=(), strict=False)

    # One check a field, on what comes before it: a fault elsewhere then hides none of them.

    @field_validator("rod_length_m")
    @classmethod
    def _rod_reaches(cls, value: float, info: ValidationInfo) -> float:
        # a faulty offset counts as none: a rod too short without it is too short with any
        radius, offset = info.data.get("crank_radius_m"), info.data.get("offset_m", 0.0)
        if radius is not None and value <= radius + abs(offset):
            raise ValueError("rod_length_m must exceed crank_radius_m and offset_m together: the crank could not turn")
        return value

    @field_validator("rod")
    @classmethod
    def _rod_is_a_part(cls, value: Rod | None, info: ValidationInfo) -> Rod | None:
        length, mass = info.data.get("rod_length_m"), info.data.get("reciprocating_mass_kg")
        if value is None or length is None:
            return value
        if value.centre_from_big_end_m > length:
            raise ValueError("centre_from_big_end_m must lie between the ends of the rod")
        if mass is not None and value.mass_kg * value.centre_from_big_end_m / length > mass:
            raise ValueError("the rod's share exceeds reciprocating_mass_kg, which includes it")
        return value

    @field_validator("cylinders")
    @classmethod
    def _fires_at_dead_centre(cls, value: tuple[Cylinder, ...]) -> tuple[Cylinder, ...]:
        astray = [
            f"cylinder {number} by {beside:g}°"
            for number, cylinder in enumerate(value)
            if cylinder.firing_deg is not None
            if abs(beside := (cylinder.firing_deg + cylinder.crank_deg - cylinder.bank_deg + 180) % 360 - 180) > 1e-6
        ]
        if astray:
            raise ValueError(f"firing_deg is off the dead centre, bank_deg - crank_deg: {', '.join(astray)}")
        return value

    @field_validator("cylinders")
    @classmethod
    def _each_crank_turns(cls, value: tuple[Cylinder, ...], info: ValidationInfo) -> tuple[Cylinder, ...]:
        radius, length, rod = (info.data.get(key) for key in ("crank_radius_m", "rod_length_m", "rod"))
        if radius is None or length is None:
            return value
        share = 0.0 if rod is None else rod.mass_kg * rod.centre_from_big_end_m / length
        for number, cylinder in enumerate(value):
            if cylinder.offset_m is not None and length <= radius + abs(cylinder.offset_m):
                raise ValueError(f"offset_m of cylinder {number} is so large that its crank could not turn")
            if cylinder.reciprocating_mass_kg is not None and cylinder.reciprocating_mass_kg < share:
                raise ValueError(f"the rod's share exceeds reciprocating_mass_kg of cylinder {number}")
        return value

    @field_validator("main_bearings_m")
    @classmethod
    def _carries_every_cylinder(cls, value: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        if not value:
            return value
        if len(value) < 2 or any(after <= before for before, after in pairwise(value)):
            raise ValueError("must be two or more ascending positions")
        places = [cylinder.position_m for cylinder in info.data.get("cylinders", ())]
        if any(not value[0] <= place <= value[-1] for place in places):
            raise ValueError("every cylinder must stand between the first and the last main bearing")
        return value

    @field_validator("gas")
    @classmethod
    def _gas_fits(cls, value: GasCurve | None, info: ValidationInfo) -> GasCurve | None:
        cycle = info.data.get("cycle")
        if value is None or cycle is None:
            return value
        angles = value.crank_angle_deg
        if angles is not None and angles[-1] - angles[0] >= 360 * REVS_PER_CYCLE[cycle]:
            raise ValueError(f"crank_angle_deg must span less than one cycle, {360 * REVS_PER_CYCLE[cycle]}°")
        if value.ideal is not None and cycle == "rotor":
            raise ValueError("an ideal cycle needs a piston")
        if value.ideal is not None and cycle == "two-stroke" and value.ideal.exhaust_pa is not None:
            raise ValueError("a two-stroke cycle has no exhaust stroke: leave exhaust_pa out")
        if value.torque_n_m is None and "bore_m" in info.data and info.data["bore_m"] is None:
            raise ValueError("a pressure needs bore_m")
        return value

    @property
    def mechanism(self) -> SliderCrank:
        """Lengths of the crank mechanism alone."""
        return SliderCrank(crank_radius_m=self.crank_radius_m, rod_length_m=self.rod_length_m, offset_m=self.offset_m)

    @property
    def revs_per_cycle(self) -> int:
        """Crank revolutions of an engine cycle."""
        return REVS_PER_CYCLE[self.cycle]

    # no cached property: a copy with other values would take the old one along

    @property
    def each(self) -> tuple[Engine, ...]:
        """An engine for each cylinder alone, without shafts and webs, its masses and offset those of the cylinder."""
        own = ("reciprocating_mass_kg", "rotating_unbalance_kg_m", "rotating_unbalance_deg", "offset_m")
        none: dict[str, None] = dict.fromkeys(own)
        singles = []
        for cylinder in self.cylinders:
            alone = {"shafts": BalanceShafts(), "webs": (), "cylinders": (cylinder.model_copy(update=none),)}
            stated = {key: value for key in own if (value := getattr(cylinder, key)) is not None}
            singles.append(self.model_copy(update={**alone, **stated}))
        return tuple(singles)

    @property
    def pistons_alone(self) -> Engine:
        """The engine without balance shafts, webs and whatever unbalance turns with its crank."""
        bare = {"rotating_unbalance_kg_m": None, "rotating_unbalance_deg": None}
        cylinders = tuple(cylinder.model_copy(update=bare) for cylinder in self.cylinders)
        alone = {"shafts": BalanceShafts(), "webs": (), "rotating_unbalance_kg_m": 0.0, "cylinders": cylinders}
        return self.model_copy(update=alone)

    @property
    def bare(self) -> Engine:
        """The engine without balance shafts."""
        return self.model_copy(update={"shafts": BalanceShafts()})

    @property
    def largest_piston_kg(self) -> float:
        """Reciprocating mass of the heaviest cylinder."""
        return max(single.reciprocating_mass_kg for single in self.each)

    @property
    def sliding_g_mm(self) -> float:
        """Reciprocating mass times crank radius: force over ω² of order 1 of a piston, g·mm."""
        return 1e6 * self.reciprocating_mass_kg * self.crank_radius_m


def with_gas_file(
    table: Mapping[str, object], name: str, beside: Path | None
) -> tuple[Mapping[str, object], list[CrankorderError]]:
    """``table`` of an engine file with the curve of its gas read from the CSV file that ``[gas] file`` names.

    ``name`` and ``beside``: as the engine was asked for; the CSV file is looked for beside the engine file.
    The second is the fault of that file, told with those of the engine: it is missing, lacks a column, has a value that
    is no number, or stands beside a curve. The table then has a curve in its place, so that its other faults are told.
    """
    gas = table.get("gas")
    if not isinstance(gas, dict) or not isinstance(gas.get("file"), str):
        return table, []
    try:
        return {**table, "gas": {**gas, **_gas_of_file(gas["file"], gas, name, beside)}}, []
    except RequestError as error:
        in_its_place = {} if {*GAS_COLUMNS} & gas.keys() else {"crank_angle_deg": [0, 180], "pressure_pa": [1e5, 1e5]}
        return {**table, "gas": {**gas, **in_its_place}}, [error]


def _gas_of_file(file: str, gas: Collection[str], name: str, beside: Path | None) -> dict[str, list[float]]:
    path = (toml_path(name, beside) or Path()).parent / file
    taken = {key for key in GAS_COLUMNS if key in gas}
    if taken:
        found = ", ".join(sorted(taken))
        raise RequestError("a gas file takes the place of the curve", file=name, place="gas", found=found)
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            rows = list(csv.DictReader(line for line in stream if line.strip() and not line.startswith("#")))
    except (OSError, UnicodeDecodeError) as error:
        raise RequestError("no such gas file", file=str(path), place="gas.file", found=type(error).__name__) from None
    columns = [key for key in GAS_COLUMNS if rows and key in rows[0]]
    if len(columns) != 2 or columns[0] != GAS_COLUMNS[0]:
        found = ", ".join(map(str, rows[0])) if rows else "no rows"
        allowed = "crank_angle_deg and pressure_pa or torque_n_m"
        raise RequestError("not the columns of a gas file", file=str(path), found=found, allowed=allowed)
    try:
        curve = {key: [float(row[key]) for row in rows] for key in columns}
    except (TypeError, ValueError) as error:
        raise RequestError("a value is no number", file=str(path), found=error) from None
    for fault in extremes(curve, str(path)):
        raise fault
    return curve


Model = TypeVar("Model", bound=EngineData)


def validated(
    model: type[Model], table: object, source: str, faults: list[CrankorderError], place: tuple[str, ...] = ()
) -> Model | None:
    """The ``model`` of a ``table``; None where it has faults, which are then added to ``faults``.

    ``source``: what errors call the file. ``place``: of the table in that file.
    """
    try:
        return model.model_validate(table)
    except ValidationError as error:
        faults += [validation_fault({**fault, "loc": (*place, *fault["loc"])}, source) for fault in error.errors()]
        return None


def engine_table(name: str, beside: Path | None = None) -> tuple[Mapping[str, object], str, list[CrankorderError]]:
    """Content of the file of a crank engine, what errors call that file, and the fault of its gas file.

    ``name`` and ``beside`` as in :func:`load_engine`. Raises RequestError where there is no such file or it holds
    another kind of engine.
    """
    stated, source = toml_table(name, "engines", beside=beside)
    table, faults = with_gas_file(stated, name, beside)
    if "kind" in table:
        problem, remedy = "not an engine of cranks, rods and cylinders", "Name one with crank radius, rod and masses"
        raise RequestError(problem, file=source, place="kind", found=table["kind"], remedy=remedy)
    return table, source, faults


def load_engine(name: str, beside: Path | None = None) -> Engine:
    """Engine from a shipped file of ``pipeline/engines`` or a user's TOML file.

    ``name``: a shipped file's stem or the path of a TOML file. ``beside``: folder in which that path is tried first.
    Raises RequestError where there is no such file or it holds another kind of engine, ManyErrors with every fault of
    its content. A table ``[balance]`` is left to ``crankorder.engine.balance_data``.
    """
    table, source, faults = engine_table(name, beside)
    engine = validated(Engine, {key: value for key, value in table.items() if key != "balance"}, source, faults)
    if faults or engine is None:
        raise ManyErrors(faults)
    return engine
