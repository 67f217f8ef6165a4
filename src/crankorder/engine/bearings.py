"""Orders at which a rolling bearing makes itself heard."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]


class Bearing(BaseModel):
    """A rolling bearing: its shaft's speed over the crank's, rolling elements, and geometry or published orders.

    ``ball_over_pitch`` is the diameter of a rolling element over the pitch diameter. ``bpfo``, ``bpfi``, ``bsf`` and
    ``ftf`` are orders of the bearing's own shaft, as makers publish them; they win over the geometry.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    name: Annotated[str, Field(min_length=1)]
    shaft_ratio: Positive = 1.0
    rolling_elements: Annotated[int, Field(ge=1)] | None = None
    ball_over_pitch: Annotated[float, Field(gt=0, lt=1)] | None = None
    contact_angle_deg: Annotated[float, Field(ge=0, lt=90)] = 0.0
    bpfo: Positive | None = None
    bpfi: Positive | None = None
    bsf: Positive | None = None
    ftf: Positive | None = None


def bearing_orders(bearing: Bearing) -> dict[str, float]:
    """Crank orders of the lines of ``bearing``: ``N*fs``, BPFO, BPFI, BSF, FTF as far as its data tell them.

    ``N*fs`` (rolling elements times shaft speed) equals BPFO + BPFI for every geometry and contact angle.
    Source: the kinematics of pure rolling with a fixed outer ring; truth sheet section 2.9.
    """
    ratio, elements = bearing.shaft_ratio, bearing.rolling_elements
    orders: dict[str, float] = {}
    if elements is not None:
        orders["N*fs"] = elements * ratio
    if elements is not None and bearing.ball_over_pitch is not None:
        lean = bearing.ball_over_pitch * math.cos(math.radians(bearing.contact_angle_deg))
        orders |= {
            "BPFO": elements * ratio / 2 * (1 - lean),
            "BPFI": elements * ratio / 2 * (1 + lean),
            "BSF": ratio / 2 * (1 - lean) * (1 + lean) / bearing.ball_over_pitch,
            "FTF": ratio / 2 * (1 - lean),
        }
    published = {"BPFO": bearing.bpfo, "BPFI": bearing.bpfi, "BSF": bearing.bsf, "FTF": bearing.ftf}
    return orders | {line: order * ratio for line, order in published.items() if order is not None}
