"""Transfer paths of a manifest: what must fit the channels, and the CSV tables beside it."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

from pydantic import ValidationError

from crankorder.engine.transfer_paths import StatedPath
from crankorder.errors import RequestError
from crankorder.ingest.units import Unit

COLUMNS = ("frequency_hz", "real", "imag")
MOST_BYTES = 10_000_000


def path_faults(paths: tuple[StatedPath, ...], unit_of_channel: Mapping[str, Unit]) -> list[RequestError]:
    """What is wrong with ``paths`` beside the channels: ``unit_of_channel`` gives the unit of each by name."""
    faults: list[RequestError] = []
    seen: set[tuple[str, str]] = set()
    for number, path in enumerate(paths):
        place = f"transfer_paths.{number}"
        unit = unit_of_channel.get(path.channel)
        if unit is None:
            allowed = ", ".join(unit_of_channel)
            faults.append(
                RequestError("no such channel", place=f"{place}.channel", found=path.channel, allowed=allowed)
            )
        elif unit.quantity != "acceleration":
            problem = f"a path in 1/kg needs a channel of acceleration, not of {unit.quantity}"
            faults.append(RequestError(problem, place=f"{place}.channel", found=path.channel))
        if (path.channel, path.direction) in seen:
            problem = f"a second path from {path.direction} to {path.channel}"
            faults.append(RequestError(problem, place=place, remedy="State one path for each channel and direction"))
        seen.add((path.channel, path.direction))
        if path.points:
            faults.append(
                RequestError(
                    "points are read from the table", place=f"{place}.points", remedy="Name a CSV file as table"
                )
            )
    return faults


def with_tables(paths: tuple[StatedPath, ...], folder: Path) -> tuple[tuple[StatedPath, ...], list[RequestError]]:
    """``paths`` with the rows of their tables, read from CSV files in ``folder``, and the faults of those."""
    read: list[StatedPath] = []
    faults: list[RequestError] = []
    for number, path in enumerate(paths):
        if path.table is None:
            read.append(path)
            continue
        try:
            points = _points(folder, path.table)
            read.append(StatedPath.model_validate(path.model_dump() | {"points": points}))
        except RequestError as fault:
            problem, remedy = f"{path.table}: {fault.problem}", fault.remedy
            place = f"transfer_paths.{number}.table"
            faults.append(RequestError(problem, place=place, found=fault.found, allowed=fault.allowed, remedy=remedy))
        except ValidationError as error:
            problem = str(error.errors()[0]["msg"]).removeprefix("Value error, ")
            faults.append(RequestError(f"{path.table}: {problem}", place=f"transfer_paths.{number}.table"))
    return tuple(read), faults


def _points(folder: Path, name: str) -> list[tuple[float, float, float]]:
    file = folder / name
    if "\0" in name:
        raise RequestError("no file has such a name", found=name)
    if Path(name).is_absolute() or not file.resolve().is_relative_to(folder.resolve()):
        raise RequestError("a table must lie in the folder of the manifest", found=name)
    try:
        if not file.is_file():
            raise RequestError("there is no such table", remedy="Put the CSV file beside the manifest")
        if file.stat().st_size > MOST_BYTES:
            raise RequestError("too large for a table", allowed=f"{MOST_BYTES} bytes")
        rows = list(csv.reader(file.read_text(encoding="utf-8-sig").splitlines()))
    except (UnicodeDecodeError, csv.Error) as error:
        raise RequestError("not a CSV file", found=error) from None
    except OSError as error:
        raise RequestError("the table cannot be read", found=error) from None
    header = [cell.strip() for cell in rows[0]] if rows else []
    if tuple(header) != COLUMNS:
        raise RequestError("wrong columns", found=", ".join(header), allowed=", ".join(COLUMNS))
    points = []
    for line, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            hertz, real, imag = (float(cell) for cell in row)
        except ValueError:
            raise RequestError(f"line {line} is not three numbers", found=", ".join(row)) from None
        points.append((hertz, real, imag))
    if len(points) < 2:
        raise RequestError("a table needs two or more rows")
    return points
