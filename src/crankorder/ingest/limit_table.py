"""The tables ``[[limits]]`` and ``[rotor]`` of a manifest: levels that the user wants kept, and where they are written.

Imports nothing heavy, as all that a manifest is checked with.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, WithJsonSchema
from pydantic import field_validator as field_check

from crankorder.errors import InputError, RequestError
from crankorder.ingest.channel import Channel
from crankorder.ingest.encoder_table import Name, Positive, Table
from crankorder.ingest.units import is_bare_number, parse_quantity
from crankorder.settings import BANDS, DERIVATIVE

_GRADE = re.compile(r"\s*G?\s*([0-9]{1,6}(?:\.[0-9]{0,6})?)\s*", re.IGNORECASE)

_SUCH_AS = {"velocity": '"4.5 mm/s"', "displacement": '"60 µm"', "acceleration": '"0.5 g"', "balance grade": '"G 6.3"'}


class Limit(Table):
    """``[[limits]]``: a level that a channel is to stay within at every tested speed, and where that is written."""

    quantity: Literal["velocity", "displacement", "acceleration", "balance grade"] = Field(
        description="What is limited: the root mean square of a vibration, or the balance grade G (e · ω).",
        examples=["velocity"],
    )
    value: Annotated[str, WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "number"}]})] = Field(
        description='The limit with its unit; a grade as "G 6.3", "6.3 mm/s" or 6.3.', examples=["4.5 mm/s"]
    )
    source: Name = Field(
        description="Where the limit is written: nothing of a standard is known here.", examples=["contract 12, page 3"]
    )
    band_hz: Annotated[tuple[Positive, Positive], Field(strict=False)] = Field(
        default=(10.0, 1000.0),
        description="Band of the level, low and high end; the high one at least 1.25 times the low one.",
        examples=[[10.0, 1000.0]],
    )
    channels: Annotated[tuple[Name, ...], Field(strict=False)] = Field(
        default=(), description="Channels that it holds for; all that can tell the quantity where left out.",
        examples=[["Z"]],
    )  # fmt: skip

    @field_check("value", mode="before")
    @classmethod
    def _value_as_text(cls, found: object, info: ValidationInfo) -> object:
        quantity = info.data.get("quantity")
        text = f"{found:g}" if isinstance(found, (int, float)) and not isinstance(found, bool) else found
        if not isinstance(text, str):
            return found
        if quantity == "balance grade" and (grade := _GRADE.fullmatch(text)):
            return f"{grade[1]} mm/s"
        if is_bare_number(text):
            such = _SUCH_AS.get(str(quantity), '"4.5 mm/s"')
            remedy = f"Give the unit, as in {such.replace('4.5', text.strip()) if quantity == 'velocity' else such}"
            raise RequestError("a number without its unit", found=text, allowed=f"such as {such}", remedy=remedy)
        return text

    @field_check("value")
    @classmethod
    def _value_is_known(cls, text: str, info: ValidationInfo) -> str:
        value = parse_quantity(text, such_as=_SUCH_AS.get(str(info.data.get("quantity")), '"4.5 mm/s"'))[0]
        if not (value > 0.0 and math.isfinite(value)):
            raise ValueError("a limit is above 0")
        return text

    @field_check("source")
    @classmethod
    def _source_is_said(cls, text: str) -> str:
        if not text.strip():
            raise ValueError("says nothing: name the page, the contract or the person that the limit comes from")
        return text

    @field_check("channels")
    @classmethod
    def _channels_are_some(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if not names:
            raise ValueError("names no channel: name one or more, or leave the key out for all that tell the quantity")
        return names

    @property
    def of_vibration(self) -> bool:
        """Whether it limits a level of vibration, not the unbalance."""
        return self.quantity != "balance grade"

    @property
    def value_si(self) -> float:
        """The limit in SI units: m/s2, m/s or m."""
        value, unit = parse_quantity(self.value)
        return value * unit.factor

    def above_rate(self, rate_hz: float) -> str:
        """Why its band cannot be told of samples at ``rate_hz`` per second; empty where it can, or is cut as unstated.

        A band that the manifest states must lie below half of the rate; the usual one ends where the recorder ends.
        """
        end_hz = self.band_hz[1] if "band_hz" in self.model_fields_set else self.band_hz[0]
        return f"reaches above half of the {rate_hz:g} samples per second" if end_hz > 0.5 * rate_hz else ""


class Rotor(Table):
    """``[rotor]``: mass and speed by which an unbalance in g·mm becomes a balance grade."""

    mass_kg: Positive = Field(description="Mass of the rotor.", examples=[12.5])
    service_rpm: Positive | None = Field(
        default=None, description="Fastest speed in service; the fastest tested where left out.", examples=[3000.0]
    )


def check_bands(limits: tuple[Limit, ...], rate_hz: float, path: Path) -> None:
    """Nothing where samples at ``rate_hz`` per second hold the bands of all ``limits``, as far as they are stated.

    Raises InputError that names the first that the recording at ``path`` does not hold; none at an unknown rate (NaN).
    """
    for number, limit in enumerate(limits):
        if limit.of_vibration and (problem := limit.above_rate(rate_hz)):
            place, found = f"limits.{number}.band_hz", f"{limit.band_hz[0]:g} to {limit.band_hz[1]:g} Hz"
            allowed, remedy = f"up to {0.5 * rate_hz:.4g} Hz", "Mend the band of the limit in the manifest"
            raise InputError(problem, file=path, place=place, found=found, allowed=allowed, remedy=remedy)


def limit_faults(
    limits: tuple[Limit, ...], channels: Mapping[str, Channel], rotor: Rotor | None, rate_hz: float | None
) -> list[RequestError]:
    """What is wrong with ``limits`` beside the ``channels`` by name, the ``rotor`` and the stated rate ``rate_hz``."""
    faults: list[RequestError] = []
    for number, limit in enumerate(limits):
        place, wanted = f"limits.{number}", "velocity" if limit.quantity == "balance grade" else limit.quantity
        unit = parse_quantity(limit.value)[1]
        if unit.quantity != wanted:
            problem = f"a limit of {wanted} needs a unit of it"
            allowed = f"such as {_SUCH_AS[limit.quantity]}"
            faults.append(RequestError(problem, place=f"{place}.value", found=limit.value, allowed=allowed))
        faults += _band_faults(limit, f"{place}.band_hz", rate_hz)
        for name in limit.channels:
            if name not in channels:
                allowed = ", ".join(channels)
                faults.append(RequestError("no such channel", place=f"{place}.channels", found=name, allowed=allowed))
            elif limit.of_vibration and channels[name].analysed_unit.quantity not in DERIVATIVE:
                measured = channels[name].analysed_unit.quantity
                problem = f"{name} measures {measured}, of which no {limit.quantity} follows"
                faults.append(RequestError(problem, place=f"{place}.channels", found=name))
    if rotor is None and any(not limit.of_vibration for limit in limits):
        problem = "a balance grade needs the mass of the rotor"
        faults.append(RequestError(problem, place="limits", remedy="Add [rotor] with mass_kg"))
    return faults


def _band_faults(limit: Limit, place: str, rate_hz: float | None) -> list[RequestError]:
    (low_hz, high_hz), least = limit.band_hz, BANDS.narrowest_ratio
    found = f"{low_hz:.9g} to {high_hz:.9g} Hz"
    if low_hz >= high_hz:
        return [RequestError("the lower end comes first", place=place, found=found)]
    if high_hz < least * low_hz:
        problem = "too narrow a band for a level: the ends of a band are no walls, and would be all of it"
        allowed = f"a high end of {least * low_hz:.4g} Hz or more, {least:g} times the low one"
        remedy = "Widen it; the size of a single line stands among the orders and tones"
        return [RequestError(problem, place=place, found=found, allowed=allowed, remedy=remedy)]
    if rate_hz is not None and (problem := limit.above_rate(rate_hz)):
        return [RequestError(problem, place=place, found=found, allowed=f"up to {0.5 * rate_hz:.4g} Hz")]
    return []
