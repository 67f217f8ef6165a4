"""Parts of a machine beside its cranks: rolling bearings, a motor, paths from force to acceleration, added masses.

Sources of the lines of a motor: ISO 20958:2013 (electrical signature analysis of induction motors); A. H. Bonnett and
G. C. Soukup (1992), IEEE Transactions on Industry Applications 28, p. 921.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sized
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import pairwise
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo, field_validator, model_validator

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Entries = TypeVar("Entries", bound=Sized)
Numbers = TypeVar("Numbers", bound=tuple[float, ...] | None)


def _not_empty(value: Entries) -> Entries:
    if not len(value):
        raise ValueError("must have at least 1 entry")
    return value


def _ascending(value: Numbers) -> Numbers:
    if value is not None and any(after <= before for before, after in pairwise(value)):
        raise ValueError("must ascend")
    return value


NOT_EMPTY = AfterValidator(_not_empty)
"""For lists; ``min_length`` counts the sound entries alone and so blames the list too for a fault of an entry."""
ASCENDING = AfterValidator(_ascending)
"""For lists of numbers, or None: each above the one before."""
CATALOGUE = "bearings.toml"
PUBLISHED_SUM_TOLERANCE = 0.01
"""Published BPFO and BPFI must add up to the number of rolling elements within this share: they do for any geometry."""

Count = Annotated[int, Field(gt=0)]
Direction = Literal["X", "Y", "Z"]

USUAL_SLIP = 0.1
"""Motors that run steadily slip no more: 1 to 5 % at rated load, small ones up to 10 %."""


def stated(description: str, *example: object, default: Any = ..., strict: bool | None = None) -> Any:
    """Field of an engine file or a manifest that the documentation explains.

    ``description``: what it means. ``example``: of its value, or none. ``default``: its value where it is left out;
    ``...`` where it must be stated. ``strict``: whether no value is converted; the model's own rule where None.
    """
    examples = list(example) or None
    return Field(default=default, description=description, examples=examples, strict=strict)


class EngineData(BaseModel):
    """Base of everything that an engine file may hold: frozen, and unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Bearing(EngineData):
    """A rolling bearing: its shaft's speed over the crank's, and a designation, its geometry or its published orders.

    ``designation`` names a bearing of the catalogue, which then fills whatever is not stated here.
    ``ball_over_pitch`` is the diameter of a rolling element over the pitch diameter. ``bpfo``, ``bpfi``, ``bsf`` and
    ``ftf`` are orders of the bearing's own shaft, as makers publish them; they win over the geometry.
    """

    name: Annotated[str, Field(min_length=1)] = stated("What results call it.", "jack shaft")
    designation: str | None = stated(
        "A bearing of the shipped catalogue, which fills what is not stated here.", "6205-2RS", default=None
    )
    shaft_ratio: Positive = stated("Turns of the bearing's shaft per crank revolution.", 0.5, default=1.0)
    rolling_elements: Annotated[int, Field(ge=1)] | None = stated("Number of balls or rollers.", 11, default=None)
    ball_over_pitch: Annotated[float, Field(gt=0, lt=1)] | None = stated(
        "Diameter of a rolling element over the pitch diameter.", 0.2032, default=None
    )
    contact_angle_deg: Annotated[float, Field(ge=0, lt=90)] | None = stated(
        "Contact angle; 0 of a deep-groove bearing.", 15.0, default=None
    )
    bpfo: Positive | None = stated(
        "Published order of the outer race, per turn of the bearing's shaft; it wins over the geometry.",
        3.58,
        default=None,
    )
    bpfi: Positive | None = stated("Published order of the inner race.", 5.42, default=None)
    bsf: Positive | None = stated(
        "Published order of the spin of a rolling element; a fault shows at twice it.", 2.36, default=None
    )
    ftf: Annotated[float, Field(gt=0, lt=1)] | None = stated("Published order of the cage.", 0.398, default=None)

    @field_validator("designation")
    @classmethod
    def _is_in_the_catalogue(cls, value: str | None) -> str | None:
        if value is not None and value not in bearing_catalogue():
            raise ValueError(f"no such bearing in the catalogue, which has {', '.join(bearing_catalogue())}")
        return value

    @field_validator("bpfi")
    @classmethod
    def _races_add_up(cls, value: float | None, info: ValidationInfo) -> float | None:
        outer, elements = info.data.get("bpfo"), info.data.get("rolling_elements")
        if value is None or outer is None:
            return value
        if outer >= value:
            raise ValueError("bpfi must exceed bpfo: the inner race turns, the outer one stands")
        if elements is not None and abs(outer + value - elements) > PUBLISHED_SUM_TOLERANCE * elements:
            raise ValueError(f"bpfo and bpfi must add up to the {elements} rolling elements, within 1 %")
        return value


class CatalogueBearing(Bearing):
    """A bearing of the catalogue: its geometry and published orders, in multiples of its own shaft's speed."""

    name: str = ""
    title: Annotated[str, Field(min_length=1)]
    source: Annotated[str, Field(min_length=1)]


@cache
def bearing_catalogue() -> dict[str, CatalogueBearing]:
    """Bearings by designation, from ``pipeline/bearings.toml``; each states its source."""
    text = files("crankorder.pipeline").joinpath(CATALOGUE).read_text(encoding="utf-8")
    return {name: CatalogueBearing.model_validate(table) for name, table in tomllib.loads(text).items()}


def bearing_orders(bearing: Bearing) -> dict[str, float]:
    """Crank orders of the lines of ``bearing``: ``N*fs``, BPFO, BPFI, BSF, FTF as far as its data tell them.

    ``N*fs`` (rolling elements times shaft speed) equals BPFO + BPFI for every geometry and contact angle. A fault on a
    rolling element strikes both races: it shows at twice BSF.
    Source: the kinematics of pure rolling with a fixed outer ring; truth sheet section 2.9.
    """
    data = _complete(bearing)
    ratio, elements, diameter = bearing.shaft_ratio, data["rolling_elements"], data["ball_over_pitch"]
    orders: dict[str, float] = {}
    if elements is not None:
        orders["N*fs"] = elements * ratio
    if elements is not None and diameter is not None:
        lean = diameter * math.cos(math.radians(data["contact_angle_deg"] or 0.0))
        orders |= {
            "BPFO": elements * ratio / 2 * (1 - lean),
            "BPFI": elements * ratio / 2 * (1 + lean),
            "BSF": ratio / 2 * (1 - lean) * (1 + lean) / diameter,
            "FTF": ratio / 2 * (1 - lean),
        }
    published = {line: data[line.lower()] for line in ("BPFO", "BPFI", "BSF", "FTF")}
    return orders | {line: order * ratio for line, order in published.items() if order is not None}


def _complete(bearing: Bearing) -> dict[str, float | None]:
    """Data of a bearing with those of its catalogue entry where it states none itself.

    A geometry of its own replaces the catalogue's published orders too: these belong to the other geometry.
    """
    geometry, published = ("rolling_elements", "ball_over_pitch", "contact_angle_deg"), ("bpfo", "bpfi", "bsf", "ftf")
    own = {key: getattr(bearing, key) for key in (*geometry, *published)}
    if bearing.designation is None:
        return own
    filled = geometry if any(own[key] is not None for key in geometry) else own
    listed = bearing_catalogue()[bearing.designation]
    return own | {key: getattr(listed, key) for key in filled if own[key] is None}


class Motor(EngineData):
    """``[motor]``: an induction motor, whose shaft turns ``shaft_ratio`` times per crank revolution.

    ``supply_hz`` is the frequency of its supply; left out for a motor on a variable-speed drive, of which then only the
    lines that go with the shaft are named. ``poles`` counts poles, not pairs: 4 turn at 1500 rpm on 50 Hz, less slip.
    """

    supply_hz: Positive | None = stated(
        "Frequency of the supply; left out for a motor on a variable-speed drive.", 50.0, default=None
    )
    poles: Count | None = stated("Poles, not pairs: 4 turn somewhat below 1500 rpm on 50 Hz.", 4, default=None)
    rotor_bars: Count | None = stated("Bars of the rotor.", 44, default=None)
    stator_slots: Count | None = stated("Slots of the stator.", 36, default=None)
    shaft_ratio: Positive = stated("Turns of the motor per crank revolution.", 1.0, default=1.0)

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
        """Speed of the field in rpm of the motor's shaft at a supply of ``supply_hz``: 120 f / poles.

        Raises ValueError where the motor states no poles.
        """
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
    ratio, with_supply = motor.shaft_ratio, motor.supply_hz is not None
    lines = [MotorLine("mains", 1, 0.0), MotorLine(TWICE_MAINS, 2, 0.0)] if with_supply else []

    def add_sidebands(text: str, of: str, mains: int, turns: float, *, apart: float) -> None:
        lines.append(MotorLine(text, mains - 2, turns + apart, of, "below"))
        lines.append(MotorLine(text, mains + 2, turns - apart, of, "above"))

    if with_supply and motor.poles is not None:
        for name, mains, turns in ((SHAFT, 0, ratio), (TWICE_MAINS, 2, 0.0)):
            add_sidebands(f"pole-pass sideband of {name}", name, mains, turns, apart=motor.poles * ratio)
    for name, count in ((BAR_PASS, motor.rotor_bars), (SLOT_PASS, motor.stator_slots)):
        if count is not None:
            lines.append(MotorLine(name, 0, count * ratio))
            if with_supply:
                add_sidebands(f"sideband of {name} at twice mains", name, 0, count * ratio, apart=0.0)
    return tuple(lines)


class PathMode(EngineData):
    """One mode of a stated path: its natural frequency, damping ratio and residue (1/kg) in h = −x²/(1 − x² + 2iζx)."""

    frequency_hz: Positive = stated("Natural frequency.", 60.0)
    damping_ratio: Annotated[float, Field(gt=0, lt=1)] = stated("Damping ratio.", 0.02)
    residue_per_kg: float = stated("Real part of the residue, in 1/kg.", 0.003)
    residue_imag_per_kg: float = stated("Imaginary part of the residue, in 1/kg.", 0.0001, default=0.0)


class StatedPath(EngineData):
    """``[[transfer_paths]]``: acceleration of a channel per force (accelerance, 1/kg) on the crankcase at the crank.

    ``channel`` is the channel's name; ``direction`` that of the force: X across the crankshaft, Y along it, Z along the
    cylinder. One of three forms: ``apparent_mass_kg``, a rigid body; ``modes`` with ``rigid_per_kg``; or ``table``, a
    CSV file beside the manifest with the columns frequency_hz, real, imag (1/kg), whose rows are ``points`` once it is
    read. It holds within ``frequency_range_hz`` (needed but for a table), to ``uncertainty_percent`` (95 %).
    """

    channel: Annotated[str, Field(min_length=1)] = stated("Name of a channel of acceleration.", "Z")
    direction: Direction = stated(
        "Direction of the force on the crankcase: X across, Y along the crankshaft, Z along the cylinder.", "Z"
    )
    apparent_mass_kg: Positive | None = stated(
        "Force per acceleration of a rigid body; one of three forms.", 330.0, default=None
    )
    table: Annotated[str, Field(min_length=1)] | None = stated(
        "CSV file beside the manifest, columns frequency_hz, real, imag (1/kg); one of three forms.",
        "path_z.csv",
        default=None,
    )
    points: tuple[tuple[float, float, float], ...] = stated(
        "Rows of that table once it is read; never stated.", default=(), strict=False
    )
    modes: tuple[PathMode, ...] = stated(
        "Modes of the path; one of three forms.",
        [{"frequency_hz": 60.0, "damping_ratio": 0.02, "residue_per_kg": 0.003}],
        default=(),
        strict=False,
    )
    rigid_per_kg: float = stated("What is added to the modes, in 1/kg.", 0.002, default=0.0)
    frequency_range_hz: tuple[NonNegative, Positive] | None = stated(
        "Where the path holds; needed but for a table.", [5.0, 40.0], default=None, strict=False
    )
    uncertainty_percent: NonNegative = stated(
        "Half width of the 95 % interval of the path, in % of it.", 3.0, default=0.0
    )

    @model_validator(mode="after")
    def _one_form(self) -> StatedPath:
        tabled = self.table is not None or bool(self.points)
        forms = [self.apparent_mass_kg is not None, tabled, bool(self.modes)]
        if sum(forms) != 1:
            raise ValueError("a path is one of apparent_mass_kg, table or modes")
        if self.rigid_per_kg and not self.modes:
            raise ValueError("rigid_per_kg goes with modes; a rigid body alone is apparent_mass_kg")
        if not tabled and self.frequency_range_hz is None:
            raise ValueError("frequency_range_hz must say where the path holds, such as [5.0, 50.0]")
        if self.frequency_range_hz is not None and self.frequency_range_hz[0] >= self.frequency_range_hz[1]:
            raise ValueError("frequency_range_hz must ascend")
        if any(after[0] <= before[0] for before, after in pairwise(self.points)) or len(self.points) == 1:
            raise ValueError("a table needs two or more rows with ascending frequency_hz")
        return self

    @property
    def holds_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency (Hz) at which the path may be used."""
        low, high = self.frequency_range_hz or (0.0, float("inf"))
        if self.points:
            return max(low, self.points[0][0]), min(high, self.points[-1][0])
        return low, high


class AddedMass(EngineData):
    """``[[added_masses]]``: a known mass that this test has and the test that it is compared with has not.

    ``on``: "crank", what turns with the shaft at ``radius_mm`` and ``angle_deg`` (from where the crank pin of cylinder
    0 points, in the sense of rotation), or "piston", what goes up and down with the piston of the cylinder numbered
    ``cylinder``. ``mass_g`` is below 0 where mass was taken away.
    """

    mass_g: float = stated("Mass in g; below 0 where some was taken away; not 0.", 100.0)
    on: Literal["crank", "piston"] = stated(
        "What carries it: the turning crank or the piston.", "piston", default="crank"
    )
    radius_mm: Positive | None = stated("Distance from the shaft's axis; needed on the crank.", 60.0, default=None)
    angle_deg: float = stated(
        "From where the crank pin of cylinder 0 points, in the sense of rotation.", 180.0, default=0.0
    )
    cylinder: Annotated[int, Field(ge=0)] = stated(
        "Number of the cylinder whose piston carries it, from 0.", 0, default=0
    )

    @model_validator(mode="after")
    def _has_a_radius(self) -> AddedMass:
        if self.mass_g == 0:
            raise ValueError("a mass of 0 g tells nothing")
        if self.on == "crank" and self.radius_mm is None:
            raise ValueError("a mass on the crank needs radius_mm")
        if self.on == "piston" and (self.radius_mm is not None or self.angle_deg):
            raise ValueError("a mass on the piston has neither radius_mm nor angle_deg")
        return self
