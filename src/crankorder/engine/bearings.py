"""Orders at which a rolling bearing makes itself heard, from its geometry, published orders or the catalogue."""

from __future__ import annotations

import math
import tomllib
from functools import cache
from importlib.resources import files
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

Positive = Annotated[float, Field(gt=0)]

CATALOGUE = "bearings.toml"
PUBLISHED_SUM_TOLERANCE = 0.01
"""Published BPFO and BPFI must add up to the number of rolling elements within this share: they do for any geometry."""


class CatalogueBearing(BaseModel):
    """A bearing of the catalogue: its geometry and published orders, in multiples of its own shaft's speed."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    title: Annotated[str, Field(min_length=1)]
    source: Annotated[str, Field(min_length=1)]
    rolling_elements: Annotated[int, Field(ge=1)] | None = None
    ball_over_pitch: Annotated[float, Field(gt=0, lt=1)] | None = None
    contact_angle_deg: Annotated[float, Field(ge=0, lt=90)] | None = None
    bpfo: Positive | None = None
    bpfi: Positive | None = None
    bsf: Positive | None = None
    ftf: Positive | None = None


class Bearing(BaseModel):
    """A rolling bearing: its shaft's speed over the crank's, and a designation, its geometry or its published orders.

    ``designation`` names a bearing of the catalogue, which then fills whatever is not stated here.
    ``ball_over_pitch`` is the diameter of a rolling element over the pitch diameter. ``bpfo``, ``bpfi``, ``bsf`` and
    ``ftf`` are orders of the bearing's own shaft, as makers publish them; they win over the geometry.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    name: Annotated[str, Field(min_length=1)] = Field(description="What results call it.", examples=["jack shaft"])
    designation: str | None = Field(
        default=None,
        description="A bearing of the shipped catalogue, which fills what is not stated here.",
        examples=["6205-2RS"],
    )
    shaft_ratio: Positive = Field(
        default=1.0, description="Turns of the bearing's shaft per crank revolution.", examples=[0.5]
    )
    rolling_elements: Annotated[int, Field(ge=1)] | None = Field(
        default=None, description="Number of balls or rollers.", examples=[11]
    )
    ball_over_pitch: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        default=None, description="Diameter of a rolling element over the pitch diameter.", examples=[0.2032]
    )
    contact_angle_deg: Annotated[float, Field(ge=0, lt=90)] | None = Field(
        default=None, description="Contact angle; 0 of a deep-groove bearing.", examples=[15.0]
    )
    bpfo: Positive | None = Field(
        default=None,
        description="Published order of the outer race, per turn of the bearing's shaft; it wins over the geometry.",
        examples=[3.58],
    )
    bpfi: Positive | None = Field(default=None, description="Published order of the inner race.", examples=[5.42])
    bsf: Positive | None = Field(
        default=None,
        description="Published order of the spin of a rolling element; a fault shows at twice it.",
        examples=[2.36],
    )
    ftf: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        default=None, description="Published order of the cage.", examples=[0.398]
    )

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
    keys = ("rolling_elements", "ball_over_pitch", "contact_angle_deg", "bpfo", "bpfi", "bsf", "ftf")
    own = {key: getattr(bearing, key) for key in keys}
    if bearing.designation is None:
        return own
    listed = bearing_catalogue()[bearing.designation]
    filled = keys if all(own[key] is None for key in keys[:3]) else keys[:3]
    return own | {key: getattr(listed, key) for key in filled if own[key] is None}
