"""From what the file holds to the analysed unit of a channel: (value - offset) * factor."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from crankorder.errors import InputError, RequestError
from crankorder.ingest.manifest import Channel
from crankorder.ingest.units import base_unit, conversion_factor, known_unit, parse_quantity, parse_sensitivity

# what programs write where no unit was set
STATES_NO_UNIT = ("", "1", "-", "EU", "n/a", "none")


@dataclass(frozen=True, slots=True)
class Scaling:
    """Offset in the file's unit and factor to the analysed unit; ``remark`` tells of a unit that was not understood."""

    offset: float
    factor: float
    remark: str = ""


def file_to_analysed(channel: Channel, file_unit: str, path: Path) -> Scaling:
    """Scaling of ``channel`` where the file at ``path`` states ``file_unit`` (empty where it states none).

    Raises InputError where the file's unit can become neither the sensitivity's output nor the analysed unit.
    """
    before, factor = channel.analysed_unit, 1.0
    if channel.sensitivity is not None:
        sensitivity = parse_sensitivity(channel.sensitivity)
        before, factor = base_unit(sensitivity.output), sensitivity.measured_per_output(channel.analysed_unit)
    stated = None if file_unit in STATES_NO_UNIT else known_unit(file_unit)
    remark = ""
    if stated is not None:
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
    return Scaling(offset, factor, remark)
