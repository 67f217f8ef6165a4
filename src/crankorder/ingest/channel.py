"""A channel of the manifest: what it is called, how its values in the file become its analysed unit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pydantic import Field, ValidationInfo
from pydantic import field_validator as field_check

from crankorder.errors import InputError, RequestError
from crankorder.ingest.encoder_table import Name, Positive, Source, Table
from crankorder.ingest.units import (
    Unit,
    base_unit,
    conversion_factor,
    known_unit,
    parse_quantity,
    parse_sensitivity,
    unit_of,
)
from crankorder.settings import DERIVATIVE

# what programs write where no unit was set
STATES_NO_UNIT = ("", "1", "-", "EU", "n/a", "none")


class Channel(Table):
    """``[[channels]]``: one analysed signal."""

    name: Name = Field(description="What results and pictures call the channel.", examples=["Z"])
    unit: str = Field(
        description="Unit of the analysed signal: m/s2, g, mm/s, um, Pa, bar, N, Nm, V, 1 and others.",
        examples=["m/s2"],
    )
    source: Source | None = Field(
        default=None,
        description="Dataset, column name, pattern with * or column number from 0; the name where left out.",
        examples=["acc_z"],
    )
    quantity: str = Field(
        default="",
        description="What is analysed, where the unit does not tell; it must agree with the unit. A pressure in Pa is "
        "that of a microphone, in bar or kPa a cylinder's, where none is stated. A velocity or a "
        "displacement is integrated from an acceleration that the file's unit, sensitivity or measured_unit states.",
        examples=["cylinder pressure"],
    )
    measured_unit: str | None = Field(
        default=None,
        description="Unit of what the file holds, where it does not say: of a quantity that is to be integrated.",
        examples=["g"],
    )
    highpass_hz: Positive | None = Field(
        default=None,
        description="Frequency below which an integrated channel holds nothing: half of the power passes there.",
        examples=[2.0],
    )
    sensitivity: str | None = Field(
        default=None,
        description="Output of the sensor per unit, where the file holds volts or the like.",
        examples=["100 mV/g"],
    )
    full_scale_v: Positive | None = Field(
        default=None, description="Volts at full scale of a file that holds shares of it (WAV).", examples=[10.0]
    )
    offset: str | None = Field(
        default=None,
        description="What is taken off the file's values before they are scaled, with its unit.",
        examples=["2.5 V"],
    )
    direction: str = Field(
        default="",
        description="Axis that the sensor looks along: X across the crankshaft, Y along it, Z along the cylinder.",
        examples=["+Z"],
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
        """Unit of what the sensor measures by the manifest alone, None where it does not say."""
        if self.sensitivity is not None:
            return parse_sensitivity(self.sensitivity).measured
        return None if self.measured_unit is None else unit_of(self.measured_unit)

    def integrals_from(self, source: Unit | None) -> int:
        """How often what is measured in ``source`` is integrated: 0 unless ``quantity`` asks for it by name."""
        wanted = self.analysed_unit.quantity
        if source is None or not self.quantity or wanted not in DERIVATIVE or source.quantity not in DERIVATIVE:
            return 0
        return max(0, DERIVATIVE[source.quantity] - DERIVATIVE[wanted])


@dataclass(frozen=True, slots=True)
class Scaling:
    """Offset in the file's unit and factor to ``unit``; ``remark`` tells of a unit that was not understood.

    ``unit`` is the analysed one; where the channel is to be integrated ``integrals`` times, that of what is measured.
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
    stated = None if file_unit in STATES_NO_UNIT else known_unit(file_unit)
    source = channel.stated_source_unit or stated
    integrals = channel.integrals_from(source)
    target = channel.analysed_unit if source is None or not integrals else base_unit(source)
    before, factor = target, 1.0
    if channel.sensitivity is not None:
        sensitivity = parse_sensitivity(channel.sensitivity)
        before, factor = base_unit(sensitivity.output), sensitivity.measured_per_output(target)
    elif channel.measured_unit is not None and stated is None:
        before = unit_of(channel.measured_unit)
        factor = conversion_factor(before, target)
    remark = ""
    if stated is not None and stated.quantity == "full scale" and before.quantity == "voltage":
        if channel.full_scale_v is None:
            scale = "the unit V" if channel.sensitivity is None else f"the sensitivity {channel.sensitivity!r}"
            raise InputError(
                f"channel {channel.name}: the file holds fractions of full scale, for which {scale} does not do",
                file=path,
                place=f"source {channel.file_source}",
                remedy="State full_scale_v, the volts at full scale of the recorder, for this channel",
            )
        factor *= channel.full_scale_v / before.factor
        before = stated
    elif stated is not None:
        try:
            factor *= conversion_factor(stated, before)
        except RequestError as error:
            raise InputError(
                f"channel {channel.name}: {error.problem}",
                file=path,
                place=f"source {channel.file_source}",
                found=f"unit {file_unit!r} in the file",
                remedy=error.remedy,
            ) from None
        before = stated
    elif file_unit not in STATES_NO_UNIT:
        remark = f"channel {channel.name}: the file states the unit {file_unit!r}; {before.name} is taken"
    offset = 0.0
    if channel.offset is not None:
        value, unit = parse_quantity(channel.offset)
        offset = value * conversion_factor(unit, before)
    return Scaling(offset, factor, target, integrals, remark)


_UNIT_OF_RESULT = (
    'State the unit of the result, such as unit = "mm/s"; what the sensor measures is told by the file, by sensitivity '
    "or by measured_unit"
)


def channel_faults(channel: Channel, place: str) -> list[RequestError]:
    """What is wrong with the units of ``channel``, at ``place`` in the manifest."""
    faults: list[RequestError] = []
    unit = channel.analysed_unit
    expected = unit
    if channel.sensitivity is not None:
        sensitivity = parse_sensitivity(channel.sensitivity)
        expected = sensitivity.output
        if not channel.integrals_from(sensitivity.measured):
            faults += _unit_clash(sensitivity.measured, unit, f"{place}.sensitivity")
    elif channel.stated_source_unit is not None:
        expected = channel.stated_source_unit
        if not channel.integrals_from(expected):
            faults += _unit_clash(expected, unit, f"{place}.measured_unit")
    if channel.offset is not None:
        faults += _unit_clash(parse_quantity(channel.offset)[1], expected, f"{place}.offset")
    known = ("acceleration", "velocity", "displacement", "pressure", "force", "torque", "voltage")
    stated = next((quantity for quantity in known if channel.quantity.casefold().endswith(quantity)), unit.quantity)
    if stated != unit.quantity:
        problem = f"quantity and unit disagree: {unit.name} is a unit of {unit.quantity}"
        remedy = _UNIT_OF_RESULT if stated in DERIVATIVE and unit.quantity in DERIVATIVE else ""
        faults.append(RequestError(problem, place=f"{place}.quantity", found=channel.quantity, remedy=remedy))
    return faults


def _unit_clash(source: Unit, target: Unit, place: str) -> list[RequestError]:
    try:
        conversion_factor(source, target)
    except RequestError as error:
        return [RequestError(error.problem, place=place, remedy=error.remedy)]
    return []
