"""Channels of the manifest: how values in a file become the analysed unit, and which limits their levels have."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import ValidationInfo, WithJsonSchema
from pydantic import field_validator as field_check

from crankorder.engine.machine_parts import stated
from crankorder.errors import InputError, RequestError
from crankorder.ingest.encoder_table import Name, Positive, Source, Table, optional
from crankorder.ingest.units import (
    Unit,
    base_unit,
    conversion_factor,
    is_bare_number,
    known_unit,
    parse_quantity,
    parse_sensitivity,
    unit_of,
)
from crankorder.settings import BANDS, DERIVATIVE

# what programs write where no unit was set
STATES_NO_UNIT = ("", "1", "-", "EU", "n/a", "none")


class Channel(Table):
    """``[[channels]]``: one analysed signal."""

    name: Name = stated("What results and pictures call the channel.", "Z")
    unit: str = stated("Unit of the analysed signal: m/s2, g, mm/s, um, Pa, bar, N, Nm, V, 1 and others.", "m/s2")
    source: Source | None = optional(
        "Dataset, column name, pattern with * or column number from 0; the name where left out.", "acc_z"
    )
    quantity: str = stated(
        "What is analysed, where the unit does not tell; it must agree with the unit. A pressure in Pa is "
        "that of a microphone, in bar or kPa a cylinder's, where none is stated. A velocity or a "
        "displacement is integrated from an acceleration that the file's unit, sensitivity or measured_unit states.",
        "cylinder pressure",
        default="",
    )
    measured_unit: str | None = optional(
        "Unit of what the file holds, where it does not say: of a quantity that is to be integrated.", "g"
    )
    highpass_hz: Positive | None = optional(
        "Frequency below which an integrated channel holds nothing: half of the power passes there.", 2.0
    )
    sensitivity: str | None = optional(
        "Output of the sensor per unit, where the file holds volts or the like.", "100 mV/g"
    )
    full_scale_v: Positive | None = optional("Volts at full scale of a file that holds shares of it (WAV).", 10.0)
    offset: str | None = optional("What is taken off the file's values before they are scaled, with its unit.", "2.5 V")
    direction: str = stated(
        "Axis that the sensor looks along: X across the crankshaft, Y along it, Z along the cylinder.", "+Z", default=""
    )

    @field_check("unit", "measured_unit")
    @classmethod
    def _unit_is_known(cls, text: str | None) -> str | None:
        return None if text is None else unit_of(text).name

    @field_check("sensitivity", "offset")
    @classmethod
    def _text_is_known(cls, text: str | None, info: ValidationInfo) -> str | None:
        parse = parse_sensitivity if info.field_name == "sensitivity" else parse_quantity
        if text is not None:
            parse(text)
        return text

    @property
    def file_source(self) -> str | int:
        """Where the file holds the channel: ``source``, or ``name`` where no source is stated."""
        return self.name if self.source is None else self.source

    @property
    def analysed_unit(self) -> Unit:
        """Unit of the analysed signal."""
        return unit_of(self.unit)

    @property
    def measured_quantity(self) -> str:
        """``quantity``, or the quantity that the unit measures where none is stated."""
        return self.quantity or self.analysed_unit.quantity

    @property
    def stated_source_unit(self) -> Unit | None:
        """Unit of the quantity that the sensor measures, by the manifest alone; None where it does not say."""
        if self.sensitivity is not None:
            return parse_sensitivity(self.sensitivity).measured
        return None if self.measured_unit is None else unit_of(self.measured_unit)

    def integrals_from(self, source: Unit | None) -> int:
        """How many times a signal in the unit ``source`` is integrated: 0 unless ``quantity`` asks for it by name."""
        wanted = self.analysed_unit.quantity
        if source is None or not self.quantity or wanted not in DERIVATIVE or source.quantity not in DERIVATIVE:
            return 0
        return max(0, DERIVATIVE[source.quantity] - DERIVATIVE[wanted])


class Scaling(NamedTuple):
    """Offset in the file's unit and factor to ``unit``; ``remark`` tells of a unit that was not understood.

    ``unit`` is the analysed one, or the measured one where the channel is to be integrated ``integrals`` times.
    """

    offset: float
    factor: float
    unit: Unit
    integrals: int = 0
    remark: str = ""


def file_to_analysed(channel: Channel, file_unit: str, path: Path) -> Scaling:
    """Scaling of ``channel`` where the file at ``path`` states ``file_unit`` (empty where it states none).

    Raises InputError where the file's unit can become neither the sensitivity's output nor the analysed unit.
    """
    told = None if file_unit in STATES_NO_UNIT else known_unit(file_unit)
    source = channel.stated_source_unit or told
    integrals = channel.integrals_from(source)
    target = channel.analysed_unit if source is None or not integrals else base_unit(source)
    before, factor = target, 1.0
    if channel.sensitivity is not None:
        sensitivity = parse_sensitivity(channel.sensitivity)
        before, factor = base_unit(sensitivity.output), sensitivity.measured_per_output(target)
    elif channel.measured_unit is not None and told is None:
        before = unit_of(channel.measured_unit)
        factor = conversion_factor(before, target)
    remark, place = "", f"source {channel.file_source}"
    if told is not None and told.quantity == "full scale" and before.quantity == "voltage":
        if channel.full_scale_v is None:
            scale = "the unit V" if channel.sensitivity is None else f"the sensitivity {channel.sensitivity!r}"
            problem = f"channel {channel.name}: the file holds fractions of full scale, for which {scale} does not do"
            remedy = "State full_scale_v, the volts at full scale of the recorder, for this channel"
            raise InputError(problem, file=path, place=place, remedy=remedy)
        factor *= channel.full_scale_v / before.factor
    elif told is not None:
        try:
            factor *= conversion_factor(told, before)
        except RequestError as error:
            problem, found = f"channel {channel.name}: {error.problem}", f"unit {file_unit!r} in the file"
            allowed, remedy = f"a unit of {before.quantity}", error.remedy
            if channel.sensitivity is not None:
                problem += f", which the sensitivity {channel.sensitivity!r} is for"
                remedy = "Remove the sensitivity where the file holds the measured quantity already, else mend its unit"
            raise InputError(problem, file=path, place=place, found=found, allowed=allowed, remedy=remedy) from None
    elif file_unit not in STATES_NO_UNIT:
        remark = f"channel {channel.name}: the file states the unit {file_unit!r}; {before.name} is taken"
    offset = 0.0
    if channel.offset is not None:
        value, unit = parse_quantity(channel.offset)
        offset = value * conversion_factor(unit, told or before)
    return Scaling(offset, factor, target, integrals, remark)


_UNIT_OF_RESULT = (
    'State the unit of the result, such as unit = "mm/s"; what the sensor measures is told by the file, by sensitivity '
    "or by measured_unit"
)


def channel_faults(channel: Channel, place: str) -> Iterator[RequestError]:
    """Faults of the units of ``channel``, at ``place`` in the manifest, yielded as RequestErrors."""
    unit, source, output = channel.analysed_unit, channel.stated_source_unit, None
    if channel.sensitivity is not None:
        output = parse_sensitivity(channel.sensitivity).output
    if source is not None and not channel.integrals_from(source):
        yield from _unit_clash(source, unit, f"{place}.{'measured_unit' if output is None else 'sensitivity'}")
    if channel.offset is not None:
        yield from _unit_clash(parse_quantity(channel.offset)[1], output or source or unit, f"{place}.offset")
    known = ("acceleration", "velocity", "displacement", "pressure", "force", "torque", "voltage")
    named = next((quantity for quantity in known if channel.quantity.casefold().endswith(quantity)), unit.quantity)
    if named != unit.quantity:
        problem = f"quantity and unit disagree: {unit.name} is a unit of {unit.quantity}"
        remedy = _UNIT_OF_RESULT if named in DERIVATIVE and unit.quantity in DERIVATIVE else ""
        yield RequestError(problem, place=f"{place}.quantity", found=channel.quantity, remedy=remedy)


def _unit_clash(source: Unit, target: Unit, place: str) -> Iterator[RequestError]:
    try:
        conversion_factor(source, target)
    except RequestError as error:
        yield RequestError(error.problem, place=place, remedy=error.remedy)


_GRADE = re.compile(r"\s*G?\s*([0-9]{1,6}(?:\.[0-9]{0,6})?)\s*", re.IGNORECASE)

_SUCH_AS = {"velocity": '"4.5 mm/s"', "displacement": '"60 µm"', "acceleration": '"0.5 g"', "balance grade": '"G 6.3"'}


class Limit(Table):
    """``[[limits]]``: a level that a channel is to stay within at every tested speed, and where that is written."""

    quantity: Literal["velocity", "displacement", "acceleration", "balance grade"] = stated(
        "What is limited: the root mean square of a vibration, or the balance grade G (e · ω).", "velocity"
    )
    value: Annotated[str, WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "number"}]})] = stated(
        'The limit with its unit; a grade as "G 6.3", "6.3 mm/s" or 6.3.', "4.5 mm/s"
    )
    source: Name = stated("Where the limit is written: nothing of a standard is known here.", "contract 12, page 3")
    band_hz: tuple[Positive, Positive] = stated(
        "Band of the level, low and high end; the high one at least 1.25 times the low one.",
        [10.0, 1000.0],
        default=(10.0, 1000.0),
        strict=False,
    )
    channels: tuple[Name, ...] = stated(
        "Channels that it holds for; all that can tell the quantity where left out.", ["Z"], default=(), strict=False
    )

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
        """Why samples at ``rate_hz`` per second cannot tell its band; empty where they can or the band is not stated.

        A band that the manifest states must lie below half of the rate; the usual one ends where the recorder ends.
        """
        end_hz = self.band_hz[1] if "band_hz" in self.model_fields_set else self.band_hz[0]
        return f"reaches above half of the {rate_hz:g} samples per second" if end_hz > 0.5 * rate_hz else ""


class Rotor(Table):
    """``[rotor]``: mass and speed by which an unbalance in g·mm becomes a balance grade."""

    mass_kg: Positive = stated("Mass of the rotor.", 12.5)
    service_rpm: Positive | None = optional("Fastest speed in service; the fastest tested where left out.", 3000.0)


def check_bands(limits: tuple[Limit, ...], rate_hz: float, path: Path) -> None:
    """Refuse a recording whose samples at ``rate_hz`` per second do not hold the stated bands of all ``limits``.

    Raises InputError that names the first band that the recording at ``path`` does not hold; an unknown rate (NaN)
    passes.
    """
    for number, limit in enumerate(limits):
        if limit.of_vibration and (problem := limit.above_rate(rate_hz)):
            place, found = f"limits.{number}.band_hz", f"{limit.band_hz[0]:g} to {limit.band_hz[1]:g} Hz"
            allowed, remedy = f"up to {0.5 * rate_hz:.4g} Hz", "Mend the band of the limit in the manifest"
            raise InputError(problem, file=path, place=place, found=found, allowed=allowed, remedy=remedy)


def limit_faults(
    limits: tuple[Limit, ...], channels: Mapping[str, Channel], rotor: Rotor | None, rate_hz: float | None
) -> Iterator[RequestError]:
    """Faults of ``limits``, yielded as RequestErrors that name the place in the manifest.

    ``channels`` are those of the manifest by name, ``rotor`` its table or None, ``rate_hz`` the stated samples per
    second, None where nothing states them.
    """
    for number, limit in enumerate(limits):
        place, wanted = f"limits.{number}", "velocity" if limit.quantity == "balance grade" else limit.quantity
        if parse_quantity(limit.value)[1].quantity != wanted:
            problem, allowed = f"a limit of {wanted} needs a unit of it", f"such as {_SUCH_AS[limit.quantity]}"
            yield RequestError(problem, place=f"{place}.value", found=limit.value, allowed=allowed)
        yield from _band_faults(limit, f"{place}.band_hz", rate_hz)
        for name in limit.channels:
            if name not in channels:
                allowed = ", ".join(channels)
                yield RequestError("no such channel", place=f"{place}.channels", found=name, allowed=allowed)
            elif limit.of_vibration and (measured := channels[name].analysed_unit.quantity) not in DERIVATIVE:
                problem = f"{name} measures {measured}, of which no {limit.quantity} follows"
                yield RequestError(problem, place=f"{place}.channels", found=name)
    if rotor is None and not all(limit.of_vibration for limit in limits):
        problem = "a balance grade needs the mass of the rotor"
        yield RequestError(problem, place="limits", remedy="Add [rotor] with mass_kg")


def _band_faults(limit: Limit, place: str, rate_hz: float | None) -> Iterator[RequestError]:
    (low_hz, high_hz), least = limit.band_hz, BANDS.narrowest_ratio
    found = f"{low_hz:.9g} to {high_hz:.9g} Hz"
    if low_hz >= high_hz:
        yield RequestError("the lower end comes first", place=place, found=found)
    elif high_hz < least * low_hz:
        problem = "too narrow a band for a level: the ends of a band are no walls, and would be all of it"
        allowed = f"a high end of {least * low_hz:.4g} Hz or more, {least:g} times the low one"
        remedy = "Widen it; the size of a single line stands among the orders and tones"
        yield RequestError(problem, place=place, found=found, allowed=allowed, remedy=remedy)
    elif rate_hz is not None and (problem := limit.above_rate(rate_hz)):
        yield RequestError(problem, place=place, found=found, allowed=f"up to {0.5 * rate_hz:.4g} Hz")
