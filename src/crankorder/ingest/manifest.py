"""The manifest ``run.toml`` of a test-run folder: what was recorded, with which sensors, on what shaft.

This module imports nothing heavy: a wrong manifest is refused before numpy is ever loaded.
"""

from __future__ import annotations

import csv
import difflib
import fnmatch
import re
import stat
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, Field, PrivateAttr, ValidationError
from pydantic import field_validator as field_check

from crankorder.engine.machine_parts import AddedMass, Bearing, Motor, StatedPath, bearing_orders, stated
from crankorder.errors import MOST_TOLD, CrankorderError, ManyErrors, RequestError, located, told
from crankorder.ingest.channel import Channel, Limit, Rotor, channel_faults, limit_faults
from crankorder.ingest.encoder_table import (
    NAMED_PART,
    TIME_KINDS,
    TRACE_KINDS,
    Count,
    Encoder,
    Name,
    Positive,
    Ratio,
    Source,
    Table,
    Teeth,
    encoder_faults,
    optional,
)
from crankorder.ingest.units import Unit

_KEY = r"(?:[\w-]+|\"[^\"]*\"|'[^']*')"
_HEADER = re.compile(rf"\s*(\[\[?)\s*({_KEY}(?:\s*\.\s*{_KEY})*)\s*\]\]?\s*(?:#.*)?")
_ASSIGNMENT = re.compile(rf"\s*({_KEY}(?:\s*\.\s*{_KEY})*)\s*=")

_OUTSIDE = re.compile(r"\0|^[/\\~]|^[A-Za-z]:[/\\]|(^|[/\\])\.\.([/\\]|$)")

COLUMNS = ("frequency_hz", "real", "imag")

MOST_BYTES = 10_000_000

SCHEMA_VERSION = 1

MANIFEST_NAME = "run.toml"

STATED_DIGITS = 3
"""Significant digits that a stated ratio has at least: 0.01 may be 0.0100."""

_MAX_MANIFEST_BYTES = 4_000_000

_MOST_KEYS, _MOST_TABLES = 150_000, 10_000

_LONG_KEY = re.compile(r"^[^=\n\"'#\[]{1000,}=", re.MULTILINE)


def key_lines(text: str) -> dict[str, int]:
    """Line of every key and table of a valid TOML ``text``, by dotted key path with list positions from 0.

    What looks like a key inside a string or a list is none: the text has no such path.
    """
    lines: dict[str, int] = {}
    counts: dict[str, int] = {}
    table, known = "", set(_paths(tomllib.loads(text)))
    for number, line in enumerate(text.split("\n"), start=1):
        header, key = _HEADER.fullmatch(line), _ASSIGNMENT.match(line)
        if header and (name := _dotted(header[2])) in known:
            lines.setdefault(name, number)
            counts[name] = counts.get(name, -1) + 1
            table = f"{name}.{counts[name]}" if header[1] == "[[" else name
            lines[table] = number
        elif key and (path := f"{table}.{_dotted(key[1])}".lstrip(".")) in known:
            lines[path] = number
    return lines


def _paths(value: object, above: str = "") -> Iterator[str]:
    """Dotted paths of all that a table or list holds."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in parts:
        path = f"{above}.{key}".lstrip(".")
        yield path
        yield from _paths(inner, path)


def _dotted(key: str) -> str:
    return re.sub(r"\s*\.\s*", ".", key).replace('"', "").replace("'", "")


def path_faults(paths: tuple[StatedPath, ...], unit_of_channel: Mapping[str, Unit]) -> Iterator[RequestError]:
    """Faults of ``paths`` against the channels, yielded as RequestErrors.

    ``unit_of_channel`` has the unit of each channel by name.
    """
    seen: set[tuple[str, str]] = set()
    for number, path in enumerate(paths):
        place, unit = f"transfer_paths.{number}", unit_of_channel.get(path.channel)
        if unit is None:
            allowed = ", ".join(unit_of_channel)
            yield RequestError("no such channel", place=f"{place}.channel", found=path.channel, allowed=allowed)
        elif unit.quantity != "acceleration":
            problem = f"a path in 1/kg needs a channel of acceleration, not of {unit.quantity}"
            yield RequestError(problem, place=f"{place}.channel", found=path.channel)
        if (path.channel, path.direction) in seen:
            problem = f"a second path from {path.direction} to {path.channel}"
            yield RequestError(problem, place=place, remedy="State one path for each channel and direction")
        seen.add((path.channel, path.direction))
        if path.points:
            problem, remedy = "points are read from the table", "Name a CSV file as table"
            yield RequestError(problem, place=f"{place}.points", remedy=remedy)


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
        except (RequestError, ValidationError) as error:
            said = "" if isinstance(error, RequestError) else str(error.errors()[0]["msg"])
            fault = error if isinstance(error, RequestError) else RequestError(said.removeprefix("Value error, "))
            fault.problem, fault.place = f"{path.table}: {fault.problem}", f"transfer_paths.{number}.table"
            faults.append(fault)
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


def parts_of(pattern: str, name: str) -> dict[str, str] | None:
    """Named parts of ``pattern``, such as ``{step}``, in the ``name`` of a file; None where the name does not match."""
    seen: set[str] = set()

    def part(match: re.Match[str]) -> str:
        again = match[1] in seen
        seen.add(match[1])
        return f"(?P={match[1]})" if again else f"(?P<{match[1]}>[^/]+?)"

    # a name directly in the folder fits "**/" too
    match = re.fullmatch(re.sub(r"\\\{([A-Za-z_]\w*)\\\}", part, fnmatch.translate(pattern.replace("**/", "*"))), name)
    return None if match is None else match.groupdict()


class Test(Table):
    """``[test]``: what was tested."""

    __test__ = False  # not a pytest class, in spite of its name

    cycle: Literal["four-stroke", "two-stroke", "rotor", "none"] = stated(
        "A cycle of 720° (four-stroke), of 360° (two-stroke), no cycle (rotor), nothing that turns (none).",
        "four-stroke",
    )
    name: str = stated("Name of the test; the folder's where empty.", "second build", default="")
    engine: Name | None = optional("A shipped engine, or the path of an engine file.", "msu-optical-second")
    recipe: Name | None = optional("A shipped recipe, or the path of a recipe file.", "coast-down")


class Recordings(Table):
    """``[recordings]``: which files, relative to the folder, and their speeds where no file states them."""

    files: tuple[Name, ...] = stated(
        "Names or patterns of the recordings, relative to the folder; {step} is as *, and encoder.file may repeat it.",
        ["rpm_*.h5"],
        strict=False,
    )
    speed_rpm: dict[str, Positive] = stated(
        "Speed of each file in rpm, where no file states it.", {"idle.csv": 800.0}, default={}
    )

    @field_check("speed_rpm")
    @classmethod
    def _names_are_paths(cls, speeds: dict[str, float]) -> dict[str, float]:
        named: dict[str, float] = {}
        for name, speed_rpm in speeds.items():
            path = PurePosixPath(name.replace("\\", "/")).as_posix()
            if path in named:
                raise ValueError(f"two speeds are stated for {path}")
            named[path] = speed_rpm
        return named


class Sampling(Table):
    """``[sampling]``: the axis of the samples."""

    domain: Literal["time", "crank_angle"] = stated(
        "What the samples are evenly spaced in.", "crank_angle", default="time"
    )
    rate_hz: Positive | None = optional("Samples per second, where the file does not say.", 10000.0)
    time_source: Source | None = optional("Column of times in s, from which the rate is taken.", "time")
    samples_per_rev: Count | None = optional("Samples per crank revolution; needed with crank_angle.", 720)
    start_deg: float = stated("Crank angle of the first sample, from top dead centre.", -360.0, default=0.0)


class Gear(Table):
    """``[[gears]]``: a wheel whose teeth mesh, or a rotor whose blades pass, ``ratio`` turns per crank revolution."""

    name: Name = stated("What results call it.", "input stage")
    teeth: Teeth = stated("Teeth of the wheel, or blades of the rotor.", 23)
    ratio: Ratio = stated("Its turns per crank revolution, to the last digit.", 0.5, default=1.0)

    @property
    def mesh_order(self) -> float:
        """Order at which the teeth mesh."""
        return self.teeth * self.ratio

    @property
    def ratio_share(self) -> float:
        """Relative uncertainty of the ratio: half a unit of its last digit, of three at least; 0 for a ratio of 1."""
        if self.ratio == 1.0:
            return 0.0
        digits = "".join(map(str, Decimal(repr(self.ratio)).normalize().as_tuple().digits))
        return 0.5 / int(digits.ljust(STATED_DIGITS, "0"))


class Manifest(Table):
    """A test-run folder, as ``run.toml`` describes it."""

    schema_version: Literal[1] = stated("Version of this format.", 1)
    test: Test
    recordings: Recordings
    channels: Annotated[tuple[Channel, ...], Field(strict=False)] = ()
    sampling: Sampling = Sampling()
    encoder: Encoder = Encoder()
    bearings: Annotated[tuple[Bearing, ...], Field(strict=False)] = ()
    transfer_paths: Annotated[tuple[StatedPath, ...], Field(strict=False)] = ()
    added_masses: Annotated[tuple[AddedMass, ...], Field(strict=False)] = ()
    gears: Annotated[tuple[Gear, ...], Field(strict=False)] = ()
    motor: Motor | None = None
    limits: Annotated[tuple[Limit, ...], Field(strict=False)] = ()
    rotor: Rotor | None = None
    _folder: Path | None = PrivateAttr(default=None)

    def of_folder(self, folder: Path) -> Manifest:
        """This manifest for the recordings in ``folder``."""
        manifest = self.model_copy()
        manifest._folder = folder
        return manifest

    def name_of(self, path: Path) -> str:
        """Name of the recording at ``path``: its path inside the folder of the test, else the name of its file."""
        inside = self._folder is not None and path.is_relative_to(self._folder)
        return path.relative_to(self._folder).as_posix() if inside and self._folder is not None else path.name

    def pulses_of(self, recording: Path) -> Path | None:
        """The file that lists the pulses of ``recording``, where it is one of its own; None where it is not."""
        if self.encoder.file is None:
            return None
        name = self.encoder.file.replace("*", recording.stem)
        if NAMED_PART.search(name):
            parts = [parts_of(pattern, self.name_of(recording)) for pattern in self.recordings.files]
            told = next((values for values in parts if values), {})
            name = NAMED_PART.sub(lambda part: told.get(part[1], part[0]), name)
        return recording.with_name(name)

    @property
    def of_shaft_alone(self) -> bool:
        """Whether no signal was recorded beside the pulses of the shaft."""
        return not self.channels

    @property
    def sampled(self) -> dict[str, Source]:
        """Sources of the columns that were sampled by themselves, by role; channels come first."""
        encoder, roles = self.encoder, {channel.name: channel.file_source for channel in self.channels}
        marks = {"the second track": encoder.second_track, "the index": encoder.index, "the cam mark": encoder.cam}
        shaft = {"the encoder": encoder.source} if encoder.kind in (*TRACE_KINDS, "speed") else {}
        shaft |= marks if encoder.kind in TRACE_KINDS else {}
        return roles | {role: source for role, source in shaft.items() if source is not None}

    @property
    def has_samples(self) -> bool:
        """Whether anything was sampled at a rate: not where times of pulses are all there is."""
        return not (self.of_shaft_alone and self.encoder.kind in TIME_KINDS)

    @property
    def revs_per_cycle(self) -> int:
        """Crank revolutions per cycle: 2 for a four-stroke engine, else 1."""
        return 2 if self.test.cycle == "four-stroke" else 1

    def speed_of(self, path: Path) -> float | None:
        """Speed in rpm that the manifest states for the recording at ``path``, or None."""
        return self.recordings.speed_rpm.get(self.name_of(path), self.encoder.speed_rpm)


def load_manifest(folder: Path, manifest: Path | None = None) -> Manifest:
    """Manifest of the test-run folder ``folder``, read from its ``run.toml`` or from the file ``manifest``.

    Raises ManyErrors listing every fault with key and line, those of the engine's file too, or RequestError where there
    is no file or no valid TOML.
    """
    path = folder / MANIFEST_NAME if manifest is None else manifest
    text = _text_of(path, folder)
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        match = re.search(r"\(at line (\d+), column (\d+)\)", str(error))
        where = f":{match[1]}:{match[2]}" if match else f":{text.count(chr(10)) + 1}"
        problem = f"not valid TOML: {re.sub(r' .at .*.$', '', str(error))}"
        raise RequestError(problem, file=f"{path}{where}", remedy="Mend that line") from None
    except RecursionError:
        raise RequestError("not valid TOML: nested too deep", file=path) from None
    except ValueError as error:  # a number with thousands of digits
        raise RequestError("not valid TOML", file=path, found=error) from None
    version = table.get("schema_version")
    if isinstance(version, int) and version > SCHEMA_VERSION:
        problem, allowed, remedy = "written for a newer crankorder", str(SCHEMA_VERSION), "Update crankorder"
        raise RequestError(problem, file=path, place="schema_version", found=version, allowed=allowed, remedy=remedy)
    found = manifest_of(table, path, text)
    paths, unread = with_tables(found.transfer_paths, folder)
    if unread:
        raise _refusal(unread[:MOST_TOLD], len(unread), path, text)
    if found.test.engine is not None:
        from crankorder.engine.definition import load_engine  # heavy

        with located(f"{path}:{key_lines(text)['test.engine']}", "test.engine"):
            load_engine(found.test.engine, beside=folder)
    return found.model_copy(update={"transfer_paths": paths}).of_folder(folder)


def manifest_of(table: Mapping[str, object], path: Path, text: str = "") -> Manifest:
    """Manifest of the ``table`` that ``path`` holds as ``text``, or that errors call so.

    Raises ManyErrors listing every fault.
    """
    try:
        found = Manifest.model_validate(table)
    except ValidationError as error:
        several = error.errors(include_url=False)
        raise _refusal(map(_fault, several[:MOST_TOLD]), len(several), path, text) from None
    if crossed := list(_cross_faults(found)):
        raise _refusal(crossed[:MOST_TOLD], len(crossed), path, text)
    return found


def _refusal(faults: Iterable[RequestError], count: int, path: Path, text: str) -> ManyErrors:
    """The error of the first ``faults``, of ``count``, of a manifest, each with the line of ``text`` it is about."""
    lines, located = key_lines(text), list[CrankorderError]()
    for fault in faults:
        key = fault.place
        while key not in lines and "." in key:
            key = key.rpartition(".")[0]
        fault.file = f"{path}:{lines[key]}" if key in lines else str(path)
        located.append(fault)
    return ManyErrors(told(located, count, file=path))


def manifest_head(name: str, cycle: str, channels: Sequence[Mapping[str, object]]) -> dict[str, object]:
    """What every manifest states: the ``name`` of the test, its ``cycle`` and its ``channels``."""
    return {
        "schema_version": SCHEMA_VERSION,
        "test": {"name": name, "cycle": cycle},
        "recordings": {"files": [name]},
        "channels": list(channels),
    }


def _text_of(path: Path, folder: Path) -> str:
    """Text of the manifest at ``path``; one that would take minutes to look through is refused."""
    init = f"Run `crankorder init {folder}` for a draft, or give one with --manifest FILE"
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise RequestError("the manifest is not a regular file", file=path, remedy=init)
        if path.stat().st_size > _MAX_MANIFEST_BYTES:
            raise RequestError("too large for a manifest", file=path, allowed=f"{_MAX_MANIFEST_BYTES} bytes")
        text = path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n")
    except FileNotFoundError:
        problem = "there is no manifest" if folder.is_dir() else "there is no such folder"
        raise RequestError(problem, file=path, remedy=init) from None
    except UnicodeDecodeError as error:
        place, remedy = f"byte {error.start}", "Save it as UTF-8"
        raise RequestError("not UTF-8 text", file=path, place=place, remedy=remedy) from None
    except (OSError, ValueError) as error:
        if isinstance(error, CrankorderError):
            raise
        raise RequestError("the manifest cannot be read", file=path, found=error) from None
    for what, sign, most in (("keys", "=", _MOST_KEYS), ("tables", "[[", _MOST_TABLES)):
        if (found := text.count(sign)) > most:
            raise RequestError(f"too many {what} for a manifest", file=path, found=found, allowed=f"up to {most}")
    if _LONG_KEY.search(text):
        raise RequestError("too long a key", file=path, allowed="names of up to 1000 characters")
    return text


def _fault(fault: Any) -> RequestError:
    """One pydantic fault as a RequestError with key path."""
    place, cause = ".".join(map(str, fault["loc"])), fault.get("ctx", {}).get("error")
    if isinstance(cause, RequestError):
        cause.place = place
        return cause
    if fault["type"] == "extra_forbidden":
        known = _keys_of(Manifest, fault["loc"][:-1])
        close = difflib.get_close_matches(str(fault["loc"][-1]), known, n=1)
        remedy = f"Did you mean {close[0]!r}?" if close else "Remove it or mend its spelling"
        return RequestError("unknown key", place=place, allowed=", ".join(known), remedy=remedy)
    if fault["type"] == "missing":
        return RequestError("this key is missing", place=place, remedy="Add it")
    said = str(fault["msg"])
    problem = re.sub("^Input should be ", "must be ", said).removeprefix("Value error, ")
    return RequestError(said.lower() if problem == said else problem, place=place, found=repr(fault["input"]))


def _keys_of(model: type[BaseModel], location: tuple[str | int, ...]) -> list[str]:
    for part in location:
        if isinstance(part, str) and part in model.model_fields:
            kinds = [model.model_fields[part].annotation, *get_args(model.model_fields[part].annotation)]
            inner = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
            model = inner[0] if inner else model
    return list(model.model_fields)


def _cross_faults(manifest: Manifest) -> Iterator[RequestError]:
    """Faults that show only when several keys are seen together."""
    sampling, encoder, motor, test = manifest.sampling, manifest.encoder, manifest.motor, manifest.test
    if sampling.domain == "crank_angle" and sampling.samples_per_rev is None:
        problem = "samples by crank angle need samples_per_rev"
        yield RequestError(problem, place="sampling.samples_per_rev", remedy="Add it")
    # checked here and not by the model, which would count a channel with a fault as none
    if not manifest.recordings.files:
        yield RequestError("the list is empty", place="recordings.files", allowed="1 or more")
    for number, pattern in enumerate(manifest.recordings.files):
        if _OUTSIDE.search(pattern):
            problem, place = "files outside the folder of the test are not read", f"recordings.files.{number}"
            allowed, remedy = (
                "names and patterns inside the folder",
                "Give the folder that holds the files, and --manifest",
            )
            yield RequestError(problem, place=place, found=repr(pattern), allowed=allowed, remedy=remedy)
    if not manifest.channels and encoder.kind not in (*TRACE_KINDS, *TIME_KINDS):
        allowed = f"1 or more; none only beside an encoder of kind {', '.join((*TRACE_KINDS, *TIME_KINDS))}"
        yield RequestError("no channel is named", place="channels", allowed=allowed, remedy="Add [[channels]]")
    for part in NAMED_PART.findall(encoder.file or ""):
        common = set.intersection(*(set(NAMED_PART.findall(pattern)) for pattern in manifest.recordings.files))
        if part not in common:
            problem, shown = "a part of the name that recordings.files does not have", f"{{{part}}}"
            allowed = ", ".join(f"{{{name}}}" for name in sorted(common)) or "* alone"
            remedy = f"Write {shown} in each pattern of recordings.files where the names of recordings differ"
            yield RequestError(problem, place="encoder.file", found=shown, allowed=allowed, remedy=remedy)
    named: dict[str, Channel] = {}
    for number, channel in enumerate(manifest.channels):
        if channel.name in named:
            place = f"channels.{number}.name"
            yield RequestError("two channels have the same name", place=place, found=channel.name)
        named[channel.name] = channel
        yield from channel_faults(channel, f"channels.{number}")
    for number, bearing in enumerate(manifest.bearings):
        if bearing_orders(bearing).keys() <= {"N*fs"}:
            needs = "a designation, rolling_elements and ball_over_pitch, or published orders (bpfo, bpfi, bsf, ftf)"
            yield RequestError(f"a bearing needs {needs}", place=f"bearings.{number}")
    if motor is not None and motor.poles is None and motor.rotor_bars is None and motor.stator_slots is None:
        remedy = "Add poles, as the nameplate's speed tells (4 at 50 Hz: somewhat below 1500 rpm), or rotor_bars"
        yield RequestError("a motor needs poles, rotor_bars or stator_slots", place="motor", remedy=remedy)
    yield from limit_faults(manifest.limits, named, manifest.rotor, sampling.rate_hz)
    yield from path_faults(manifest.transfer_paths, {name: channel.analysed_unit for name, channel in named.items()})
    has_speeds = bool(manifest.recordings.speed_rpm)
    yield from encoder_faults(encoder, cycle=test.cycle, domain=sampling.domain, speeds_stated=has_speeds)
