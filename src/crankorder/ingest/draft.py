"""A first ``run.toml`` from what the files of a folder say; what they leave out is marked for the engineer."""

from __future__ import annotations

import fnmatch
import itertools
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crankorder.errors import CrankorderError, NoUsableRecordingError, RequestError, printable
from crankorder.ingest.encoder_table import POSITION_KINDS
from crankorder.ingest.folder import collected, is_companion, is_leftover, natural_key
from crankorder.ingest.formats import FORMATS, contents_of, read_file
from crankorder.ingest.manifest import MANIFEST_NAME, manifest_head, manifest_of, parts_of
from crankorder.ingest.rawfile import Contents, Source, listed
from crankorder.ingest.recording import recording_of
from crankorder.ingest.roles import MOST_SAMPLES, Column, Columns, PulseFiles, Role, angle_step, columns_of, pulse_files
from crankorder.quantities import Floats
from crankorder.settings import load_settings
from crankorder.shaft.pattern import known_names
from crankorder.shaft.pulses import COUNTER_BITS
from crankorder.shaft.speeds import speed_in_name
from crankorder.shaft.uneven_wheel import FoundPattern, find_pattern

MOTOR = """
# [motor]                         # where an induction motor drives: its slip and its lines are then named
# supply_hz = 50.0                # leave it out for a motor on a variable-speed drive
# poles = 4                       # poles, not pairs
# rotor_bars = 44
# shaft_ratio = 1.0               # turns of the motor per crank revolution
"""
"""What a draft proposes that no file tells, as comments."""

NO_ENCODER = (
    "# [encoder]                       # ? no column looks like an encoder: one of",
    '# kind = "analogue"               #   with source, the column of a pickup, and pulses_per_rev or pattern',
    '# kind = "constant"               #   with speed_rpm = 1500.0',
    '# kind = "vibration"              #   the speed is then read off the signals, with expected_rpm = [600, 3000]',
)
"""What a draft says of the shaft where no file tells it."""

_SPECTRUM = re.compile(r"(^|[^a-z])(fft|spectrum|spectra|psd|frf)([^a-z]|$)", re.I)

# Rate of a file that states none: the pattern of a wheel needs no rate, but a wheel turns faster than standstill.
_NOMINAL_HZ = 1e4
_MARK_COLUMN = 34
_RECIPROCATING = re.compile(
    r"crank|cyl|engine|kurbel|tdc|ignition|knock|piston|firing|(^|[^a-z])(ice|diesel)([^a-z]|$)", re.I
)
# pulses per revolution that encoders and tachometers have
_COMMON_PULSES = (
    *range(1, 17), 18, 20, 24, 30, 32, 36, 40, 45, 48, 50, 60, 64, 72, 80, 90, 100, 120, 125, 128, 144, 150, 180, 200,
    240, 250, 256, 300, 360, 400, 500, 512, 600, 720, 900, 1000, 1024, 1200, 1250, 1440, 1500, 1800, 2000, 2048, 2500,
    3600, 4096,
)  # fmt: skip
# bytes of files, beside the first, whose wheels are looked at
_MOST_LOOKED = 500_000_000
# of the counts after which a count starts anew, as far as those that were seen may lie off
_SAME_COUNT = 0.005
# of a speed that a name states, as far as the true one may lie off
_NOMINAL = 0.03


File = tuple[Contents, Path]


class Wheel(NamedTuple):
    """Result of a look at an encoder's pulses: the best edge, the wheel or None, pulses and marks per second."""

    edge: str
    found: FoundPattern | None
    pulses_hz: float
    marks_hz: float


def wheel_of(columns: Columns, contents: Contents, path: Path) -> Wheel | None:
    """Wheel of the encoder among ``columns`` of the recording at ``path``, decoded as a run would decode it.

    ``contents`` are those of the file. None where no column is an encoder, or its pulses cannot be decoded. A mark that
    was recognised by the number of its edges counts only where the pulses alone show no wheel; without an encoder it is
    taken for one.
    """
    encoder, mark, time = (columns.of(role) for role in ("encoder", "index", "time"))
    encoder = mark.used_as("encoder") if encoder is None and mark is not None else encoder
    if encoder is None or not encoder.kind or encoder.kind in POSITION_KINDS:
        return None
    table = {"source": encoder.source, "kind": encoder.kind} | ({} if mark is None else {"index": mark.source})
    stated = {"time_source": time.source} if time is not None else {"rate_hz": _NOMINAL_HZ}
    stated = {} if time is None and encoder.name in contents.rates_hz else stated
    told: list[Wheel] = []
    try:
        sources = [column.source for column in (encoder, mark, time) if column is not None]
        raw = read_file(path, sources=sources, settings=load_settings().ingest)
        raw = replace(raw, columns={source: column[:MOST_SAMPLES] for source, column in raw.columns.items()})
        for edge in ("rising", "falling"):
            head = manifest_head(path.name, "rotor", ())
            manifest = manifest_of(head | {"sampling": stated, "encoder": table | {"edge": edge}}, path)
            recording = recording_of(raw, path, manifest, settings=load_settings().ingest, shaft=load_settings().shaft)
            gaps_s = np.atleast_1d(recording.attrs.get("gap_starts_s", ()))
            # a gap hides pulses, again and again: between gaps the wheel shows itself
            pulse_s = recording["pulse_time"].values
            pulse_s = max(np.split(pulse_s, np.searchsorted(pulse_s, gaps_s)), key=len)
            mark_s = recording["index_time"].values if mark is not None else np.empty(0)
            found = find_pattern(pulse_s, index_time_s=None if mark is None or mark.doubt else mark_s)
            found = found or (find_pattern(pulse_s, index_time_s=mark_s) if mark is not None else None)
            told.append(Wheel(edge, found, _per_second(pulse_s), _per_second(mark_s)))
    except (CrankorderError, OSError, ValueError):
        return None
    short_dips = encoder.is_mostly_high and encoder.kind in ("square", "analogue")  # they begin where they fall
    first = "falling" if short_dips else "rising"
    return max(told, key=lambda wheel: (_likely(wheel.found), wheel.edge == first))


def _per_second(time_s: Floats) -> float:
    return (time_s.size - 1) / float(np.ptp(time_s)) if time_s.size > 2 and np.ptp(time_s) > 0.0 else 0.0


def _likely(found: FoundPattern | None) -> tuple[int, float]:
    """How good a finding is: a wheel that is known before one that is not, then the share of revolutions."""
    if found is None:
        return 0, 0.0
    known = found.pattern.even is not None or found.pattern.name in known_names()
    return 2 if known else 1, found.agreement


class Draft(NamedTuple):
    """A draft manifest: its TOML ``text``, the ``path`` that it is meant for, patterns of the ``files`` it takes."""

    path: Path
    text: str
    files: list[str]


class Drafts(NamedTuple):
    """The drafts of a folder, and the files in it that none of them takes, each with the reason."""

    all: tuple[Draft, ...]
    passed: tuple[str, ...]

    @property
    def text(self) -> str:
        """All drafts, one below the other."""
        return "\n".join(draft.text for draft in self.all)


class Group(NamedTuple):
    """Recordings that are alike: contents and path of each, their columns, the wheel of the first, and their pulses.

    ``doubt`` says what was not looked at.
    """

    files: list[File]
    columns: Columns
    wheel: Wheel | None = None
    doubt: str = ""
    pulses: PulseFiles | None = None

    @property
    def n_bytes(self) -> int:
        """Size of the largest file."""
        return max(path.stat().st_size for _, path in self.files)

    @property
    def tells_time(self) -> bool:
        """Whether rate, time or angle of the samples is told."""
        return bool(self.files[0][0].rates_hz) or any(c.role in ("time", "angle", "encoder") for c in self.columns.all)


def draft_manifests(folder: Path) -> Drafts:
    """Draft manifests for the recordings in ``folder`` from what their files say: ``run.toml`` where all are alike.

    Files that differ in format, columns, units or wheel have manifests of their own, ``run-1-csv.toml`` and so on, each
    with the names of its files. A draft can be run as it is wherever files say enough; what a person should decide
    stands behind ``# ?``. Raises RequestError where ``folder`` is no folder or holds tests in folders of their own, and
    NoUsableRecordingError, naming what each file is, where none can be read.
    """
    groups, faults = _groups(folder)
    main = max(groups, key=lambda group: group.n_bytes)
    # notes beside the recordings may read as tables too
    notes = [g for g in groups if g is not main and not g.tells_time and g.n_bytes < main.n_bytes]
    groups = [group for group in groups if group not in notes]
    why = "a table without time, angle or rate, taken for notes: draft it in a folder of its own"
    passed = [*map(str, faults), *(f"{path}: {why}" for group in notes for _, path in group.files)]
    drafts = []
    for number, group in enumerate(groups, start=1):
        kind = re.sub(r"\W", "", group.files[0][1].suffix) or "file"
        part = f"{number}-{kind}" if len(groups) > 1 else ""
        path = folder / (f"run-{part}.toml" if part else MANIFEST_NAME)
        others = [path.name for other in (*groups, *notes) if other is not group for _, path in other.files]
        patterns = [group.pulses.recordings] if group.pulses else _patterns(group.files, others)
        drafts.append(Draft(path, _drafted(folder, group, patterns, part), patterns))
    return Drafts(tuple(drafts), tuple(passed))


def _drafted(folder: Path, group: Group, patterns: list[str], part: str) -> str:
    """Text of the draft for a ``group`` in ``folder``, whose files have the ``patterns``; ``part`` may name it."""
    columns, wheel, pulses, speeds = group.columns, group.wheel, group.pulses, _speeds(group.files)
    contents, path = group.files[0]
    if pulses is None:
        columns = _marks_by_wheel(columns, wheel)
        encoder = _encoder(columns, wheel, speeds.get(path.name))
    else:
        own, doubt = ("encoder", "index", "cam"), "the pulses stand in files of their own"
        beside = (column.used_as("unused", doubt) if column.role in own else column for column in columns.all)
        columns = replace(columns, all=tuple(beside))
        encoder = _pulse_file(pulses, speeds.get(path.name))
    how = f"# Some of the recordings: `crankorder run FOLDER --manifest FOLDER/run-{part}.toml --out OUT`.\n"
    lines = [
        "# Draft by `crankorder init`: decide what stands behind `# ?`.",
        f"{how if part else ''}schema_version = 1\n\n[test]",
        f"name = {_text(' '.join([folder.resolve().name, *part.split()]))}",
        *_cycle(columns, path, knows_shaft=encoder is not NO_ENCODER),
        '# engine = "…"                    # a shipped engine, or a TOML file here: its forces are then known',
        f"\n[recordings]\n{_files(folder, patterns, group.doubt)}\n",
        *_sampling(columns, contents),
        *_channels(columns),
        *encoder,
        *(_stated_speeds(speeds) if 'kind = "constant"' in encoder and speeds else []),
        MOTOR,
    ]
    scalars = [printable(name, 40) for name in contents.names if contents.samples.get(name) == 1]
    if scalars:
        lines.append(f"# Single numbers in the file, such as a speed: {listed(scalars, 20)}")
    return "\n".join(lines) + "\n"


def _patterns(files: Sequence[File], others: Sequence[str]) -> list[str]:
    """Patterns that the names of ``files`` fit and no name of the ``others`` does; the names where there is none."""
    patterns: list[str] = []
    for suffix in dict.fromkeys(path.suffix for _, path in files):
        paths = [path for _, path in files if path.suffix == suffix]
        wide = ["", *([os.path.commonprefix([path.stem for path in paths])] if len(paths) > 1 else [])]  # noqa: RUF071
        fitting = [f"{head}*{suffix}" for head in wide if not re.search(r"[*?\[\]{}]", head)]
        own = (pattern for pattern in fitting if not fnmatch.filter(others, pattern))
        patterns += [pattern] if (pattern := next(own, None)) else [path.name for path in paths]
    return patterns


def _files(folder: Path, patterns: Sequence[str], doubt: str) -> str:
    """The line that names the recordings; a ``doubt``, and what folders in ``folder`` hold of them, is asked about."""
    inside = [
        printable(path.name, 40)
        for path in sorted(folder.iterdir(), key=natural_key)
        if path.is_dir() and not is_leftover(path.name) and not (path / MANIFEST_NAME).exists()
        if any(not is_leftover(file.name) and file.is_file() for file in path.glob(patterns[0]))
    ]
    more = f"there are more in {listed(inside, 3)}: {_text(f'*/{patterns[0]}')} beside it takes them too"
    doubts = [doubt, more if inside else ""]
    return _asked(f"files = [{', '.join(map(_text, patterns))}]", "; ".join(filter(None, doubts)))


def save_drafts(folder: Path) -> Drafts:
    """Write the drafts of ``folder`` there, or those of each folder in it that holds recordings, and return them.

    A manifest that is there already stays as it is. Raises what :func:`draft_manifests` raises, and RequestError where
    there is nothing left to write.
    """
    homes = [folder] if not folder.is_dir() or _is_test(folder) else _tests_in(folder) or [folder]
    every = [draft_manifests(home) for home in homes if not (home / MANIFEST_NAME).exists()]
    new = tuple(draft for drafts in every for draft in drafts.all if not draft.path.exists())
    for draft in new:
        draft.path.write_text(draft.text, encoding="utf-8")
    if not new:
        there = next((draft.path for drafts in every for draft in drafts.all), homes[0] / MANIFEST_NAME)
        raise RequestError("there is a manifest already", file=there, remedy="Edit it, or remove it")
    return Drafts(new, tuple(reason for drafts in every for reason in drafts.passed))


def _is_test(folder: Path) -> bool:
    return (folder / MANIFEST_NAME).exists() or bool(_read_all(folder)[0])


def _tests_in(folder: Path) -> list[Path]:
    """Folders in ``folder`` that hold recordings."""
    return [path for path in sorted(folder.iterdir(), key=natural_key) if path.is_dir() and _is_test(path)]


def _read_all(folder: Path) -> tuple[list[File], list[CrankorderError]]:
    """Contents and paths of the readable files of ``folder``, and the faults of the others."""
    settings = load_settings().ingest
    files: list[File] = []
    faults: list[CrankorderError] = []
    for path in sorted(folder.iterdir(), key=natural_key):
        is_note = path.suffix.lower() in (".toml", ".md", ".json")
        if is_note or is_leftover(path.name) or is_companion(path.name) or path.is_dir():
            continue
        with collected(faults):
            files.append((contents_of(path, settings=settings), path))
    return files, faults


def _groups(folder: Path) -> tuple[list[Group], list[CrankorderError]]:
    """The recordings of ``folder`` in groups that are alike, and the faults of files that cannot be read."""
    if not folder.is_dir():
        raise RequestError("there is no such folder", file=folder)
    files, faults = _read_all(folder)
    if not files:
        inside = [] if faults else _tests_in(folder)
        if inside:
            names = listed([printable(path.name, 40) for path in inside], 5)
            problem = f"the recordings lie in {len(inside)} folders of this one: {names}"
            remedy = (
                "Draft each as a test of its own (`crankorder init FOLDER --save` does them all), or write one "
                'run.toml here that takes them together: files = ["*/*"]'
            )
            raise RequestError(problem, file=folder, remedy=remedy)
        problem = f"no recording found; looked for {', '.join(known.name for known in FORMATS)} and text files"
        found = "; ".join(map(str, faults[:3])) or "an empty folder"
        raise NoUsableRecordingError(problem, file=folder, found=found)
    groups: list[Group] = []
    if (pairs := pulse_files(files)) is not None:
        groups = [Group(pairs.group, _columns(pairs.group), pulses=pairs)]
        files = [file for file in files if file not in pairs.group and parts_of(pairs.pulses, file[1].name) is None]
    alike: dict[tuple[object, ...], list[File]] = {}
    for contents, path in files:
        like = ((re.sub(r"[0-9]+", "#", name), contents.units.get(name)) for name in contents.names)
        alike.setdefault((contents.format, *like), []).append((contents, path))
    return [*groups, *(group for files in alike.values() for group in _by_wheel(files))], faults


def _by_wheel(files: list[File]) -> list[Group]:
    """Groups of ``files`` with the same columns by the wheel that each shows; those that show none join the first."""
    columns, speeds = _columns(files), _speeds(files)
    sizes = itertools.accumulate(path.stat().st_size for _, path in files[1:])
    looked = [files[0], *(file for file, size in zip(files[1:], sizes, strict=True) if size <= _MOST_LOOKED)]
    wheels = {path: wheel_of(columns, contents, path) for contents, path in looked}
    doubt = f"the pulses of {len(looked)} of {len(files)} files were looked at" if len(looked) < len(files) else ""
    shown = {path: wheel.found for path, wheel in wheels.items() if wheel and wheel.found}
    known = {path: found.pattern for path, found in shown.items() if _likely(found)[0] == 2}
    teeth: dict[Path, object] = {path: pattern.even or pattern.name for path, pattern in known.items()}
    if not teeth:
        stated = {path: (wheel.pulses_hz, speeds.get(path.name)) for path, wheel in wheels.items() if wheel}
        teeth = {path: told for path, pulses in stated.items() if (told := _pulses_per_rev(*pulses))}
    parts: dict[object, list[File]] = {kind: [] for kind in teeth.values()} or {None: []}
    for file in sorted(files, key=lambda file: file[1] not in teeth):
        parts[teeth.get(file[1], next(iter(parts)))].append(file)
    return [Group(part, columns, wheels.get(part[0][1]), doubt) for part in parts.values()]


def _columns(files: Sequence[File]) -> Columns:
    """Columns of the first of ``files``, with the sources by which all of these have them."""
    contents, path = files[0]
    columns = columns_of(path, contents, settings=load_settings().ingest)
    return replace(columns, all=tuple(_bound(column, files) for column in columns.all))


def _bound(column: Column, files: Sequence[File]) -> Column:
    """``column`` with its source in all ``files``: its name, or where one calls it otherwise a pattern or its place."""
    every, name = [contents.names for contents, _ in files], column.name
    if all(name in names for names in every):
        return column
    word = re.split(r"[0-9]+", name)[-1]
    if word and all(len(fnmatch.filter(names, f"*{word}")) == 1 for names in every):
        return replace(column, source=f"*{word}")
    place = every[0].index(name)
    called = {contents.names[place]: path.name for contents, path in reversed(files)}
    shown = listed([f"{_text(name)} in {file}" for name, file in reversed(called.items())], 3)
    return replace(column, source=place, elsewhere=f"column {place}: {shown}")


def _speeds(group: Sequence[File]) -> dict[str, tuple[float, str]]:
    """Speed in rpm of each file by its name, as the file or its name states it, and which of them; {} unless all do."""
    speeds = {}
    for contents, path in group:
        stated = contents.speed_rpm is not None and contents.speed_rpm > 0
        rpm = contents.speed_rpm if stated else speed_in_name(path.stem)
        if rpm is None:
            return {}
        speeds[path.name] = rpm, "as the file states" if stated else "from the name of the file"
    return speeds


def _cycle(columns: Columns, path: Path, *, knows_shaft: bool) -> list[str]:
    if not knows_shaft:
        speeds = (column for column in columns.all if column.quantity == "rotational speed")
        told = next((f"{column.name} tells a speed, but: {column.doubt or 'no signal'}" for column in speeds), "")
        return [
            _asked('cycle = "none"', told or "nothing in the files tells a speed"),
            _asked("", "where a shaft turns: four-stroke, two-stroke or rotor, and an [encoder] below"),
        ]
    if columns.of("cam") is not None or columns.four_stroke:
        why = "a cam mark" if columns.of("cam") is not None else "the angle runs over two revolutions"
        return [_asked('cycle = "four-stroke"', f"{why}; four-stroke, two-stroke or rotor")]
    named = " ".join([path.resolve().parent.name, path.stem, *(column.name for column in columns.all)])
    if _RECIPROCATING.search(named):
        return [_asked('cycle = "four-stroke"', "as the names sound: four-stroke, two-stroke or rotor")]
    return [_asked('cycle = "rotor"', "four-stroke or two-stroke for an engine, rotor for anything else that turns")]


def _sampling(columns: Columns, contents: Contents) -> list[str]:
    angle, time = columns.of("angle"), columns.of("time")
    lines = ["[sampling]"]
    if angle is not None and (step_deg := angle_step(angle.values)):
        lines += ['domain = "crank_angle"', f"samples_per_rev = {round(360.0 / step_deg)}"]
        lines += [f"start_deg = {angle.values[0]:.9g}"] if angle.values[0] else []
    elif time is not None:
        lines.append(_bound_to("time_source", time, time.doubt if isinstance(time.source, int) else ""))
    elif not contents.rates_hz and columns.channels():
        lines.append(_asked("# rate_hz =", "samples per second, which the file does not say"))
    return [*lines, ""] if len(lines) > 1 else []


def _channels(columns: Columns) -> list[str]:
    lines, labels = [], [column.label for column in columns.channels()]
    for number, column in enumerate(columns.channels()):
        name = column.label if labels.count(column.label) == 1 else column.name
        is_spectrum = _SPECTRUM.search(f"{name} {column.name}")
        doubt = "its name speaks of a spectrum: signals by time are read, no spectra" if is_spectrum else ""
        lines += ["[[channels]]", _asked(f"name = {_text(name)}", doubt)]
        lines += [_bound_to("source", column)] if column.source != name else []
        lines += _unit(column, first=number == 0)
        if number == 0:
            lines.append(_asked('# direction = "+Z"', "the axis that the sensor looks along; for each channel"))
        lines.append("")
    for column in columns.all:
        if column.role == "unused":
            lines.append(f"# column {_text(column.name)} is left out: {column.doubt or 'no use was found for it'}")
    return lines + ([""] if lines and lines[-1] else [])


def _unit(column: Column, *, first: bool) -> list[str]:
    if column.unit is not None:
        lines = [_asked(f"unit = {_text(column.unit.name)}", column.doubt)]
    else:
        lines = [_asked('unit = "1"', column.doubt or "the file states no unit: m/s2, g, V, bar, …")]
    if first and column.quantity in ("", "voltage", "full scale"):
        lines.append(_asked('# sensitivity = "100 mV/g"', "where the file holds volts; the unit above is then m/s2"))
    if first and column.quantity == "full scale":
        lines.append(_asked("# full_scale_v = 10.0", "volts at full scale, which a sensitivity needs"))
    return lines


def _encoder(columns: Columns, wheel: Wheel | None, stated: tuple[float, str] | None) -> Sequence[str]:
    """Lines of the encoder, whose pulses show a ``wheel``; NO_ENCODER where nothing tells speed or angle of a shaft.

    ``stated`` is the speed of the recording, where it and all others have one.
    """
    encoder, index, speed, constant = (columns.of(role) for role in ("encoder", "index", "speed", "constant"))
    constant_speed = ["[encoder]", 'kind = "constant"']
    if columns.of("angle") is not None:
        return constant_speed if stated else []
    if encoder is not None:
        source, *marks = (
            _bound_to(key, column, column.doubt)
            for key, column in (("source", encoder), ("index", index), ("cam", columns.of("cam")))
            if column is not None
        )
        told = _position(encoder) if encoder.kind in POSITION_KINDS else _wheel(encoder, wheel, stated)
        return ["[encoder]", source, *told, *marks]
    if index is not None:
        return ["[encoder]", _bound_to("source", index), *_kind(index, wheel), "pulses_per_rev = 1"]
    if speed is not None:
        return ["[encoder]", _bound_to("source", speed), 'kind = "speed"']
    if constant is not None:
        return [*constant_speed, _bound_to("source", constant, "a number, taken as rpm")]
    return constant_speed if stated else NO_ENCODER


def _pulse_file(pulses: PulseFiles, stated: tuple[float, str] | None) -> list[str]:
    """Lines of an encoder whose pulses stand in files of their own."""
    per_rev = _pulses_per_rev(pulses.pulses_hz, stated)
    where = "at the stated speed" if per_rev else "how many of them make a revolution?"
    source = f"file = {_text(pulses.pulses)}\nsource = {_shown(pulses.source)}"
    told = _asked(f"pulses_per_rev = {per_rev or 1}", f"{pulses.pulses_hz:.4g} pulses/s {where}")
    return ["[encoder]", source, 'kind = "pulse_times"', told]


def _marks_by_wheel(columns: Columns, wheel: Wheel | None) -> Columns:
    """``columns`` with a mark that its edges told as index or cam mark, where the ``wheel`` itself tells a turn."""
    mark = columns.of("index")
    if mark is None or not mark.doubt or columns.of("encoder") is None:
        return columns
    if wheel is None or wheel.found is None or not wheel.pulses_hz > 0.0:
        return columns
    per_rev = wheel.marks_hz / (wheel.pulses_hz / len(wheel.found.pattern.angles_deg))
    role: Role = "index" if abs(per_rev - 1.0) < 0.1 else "cam" if abs(per_rev - 0.5) < 0.1 else "unused"
    own = mark.used_as(role, f"{per_rev:.2g} edges per turn of the wheel")
    return replace(columns, all=tuple(own if column is mark else column for column in columns.all))


def _stated_speeds(speeds: Mapping[str, tuple[float, str]]) -> list[str]:
    lines = ["\n[recordings.speed_rpm]"]
    for name, (rpm, whence) in speeds.items():
        line = f"{_text(name)} = {rpm:.9g}"
        lines.append(_asked(line, whence) if whence.startswith("from") else f"{line.ljust(_MARK_COLUMN)}# {whence}")
    return lines


def _kind(encoder: Column, wheel: Wheel | None) -> list[str]:
    """Kind and edge of the ``encoder``, whose pulses show the ``wheel``."""
    if not encoder.kind:
        return [_asked('kind = "square"', "square, analogue, pulse_times or edge_list")]
    kind = f'kind = "{encoder.kind}"'.ljust(_MARK_COLUMN) + "# as its values look"
    return [kind] if wheel is None else [kind, f'edge = "{wheel.edge}"']


def _wheel(encoder: Column, wheel: Wheel | None, stated: tuple[float, str] | None) -> list[str]:
    """Kind, edge and wheel of the ``encoder`` as its pulses tell them, or the ``stated`` speed, else to be stated."""
    lines = _kind(encoder, wheel)
    if wheel is None or wheel.found is None:
        pulses_hz = 0.0 if wheel is None else wheel.pulses_hz
        if (told := _pulses_per_rev(pulses_hz, stated)) is not None:
            return [*lines, _asked(f"pulses_per_rev = {told}", f"{pulses_hz:.4g} pulses/s at the stated speed")]
        wheels = ", ".join(known_names())
        return [
            *lines,
            _asked("# pulses_per_rev = 60", "pulses per revolution; they are even, or too few to tell"),
            _asked('# pattern = "60-2"', f"or a wheel with a gap, or one of the trade: {wheels}"),
        ]
    pattern, told_by = wheel.found.pattern, wheel.found.told
    if pattern.even is not None:
        teeth, missing = pattern.even
        return [*lines, _asked(f"pulses_per_rev = {teeth}", told_by), f"missing_teeth = {missing}"]
    if pattern.name in known_names():
        return [*lines, _asked(f'pattern = "{pattern.name}"', told_by)]
    angles = ", ".join(f"{angle:.4g}" for angle in pattern.angles_deg)
    return [*lines, _asked("", told_by), f"tooth_angles_deg = [{angles}]"]


def _position(encoder: Column) -> list[str]:
    """Kind of an ``encoder`` whose samples are angles or counts, and the counts of a turn as its wraps tell them."""
    lines = [f'kind = "{encoder.kind}"'.ljust(_MARK_COLUMN) + "# as its values look"]
    if encoder.kind == "angle":
        return lines
    if not encoder.wrap or min(abs(encoder.wrap / 2.0**bits - 1.0) for bits in COUNTER_BITS) < _SAME_COUNT:
        return [*lines, _asked("# pulses_per_rev = 4096", "counts of a turn: four for each line of most encoders")]
    usual = min((each * number for each in (1, 4) for number in _COMMON_PULSES), key=lambda n: abs(n - encoder.wrap))
    counts = usual if abs(usual - encoder.wrap) < _SAME_COUNT * usual else round(encoder.wrap)
    return [*lines, _asked(f"pulses_per_rev = {counts}", "it starts anew after so many: once a turn, by an index?")]


def _pulses_per_rev(pulses_hz: float, stated: tuple[float, str] | None) -> int | None:
    """Pulses per revolution that ``pulses_hz`` and a stated speed in rpm mean, where one usual number fits alone."""
    if stated is None or not pulses_hz > 0.0:
        return None
    ratio = pulses_hz / (stated[0] / 60.0)
    near = [number for number in _COMMON_PULSES if abs(ratio / number - 1.0) < _NOMINAL]
    return near[0] if len(near) == 1 else None


def _asked(line: str, doubt: str) -> str:
    """``line`` of a draft, with what a person should decide about it, as it is where there is no ``doubt``."""
    return f"{line.ljust(_MARK_COLUMN)}# ? {printable(doubt, 200)}" if doubt else line


def _bound_to(key: str, column: Column, doubt: str = "") -> str:
    """The line that binds ``key`` to a ``column``, with what other files call that, and its ``doubt``."""
    return _asked(f"{key} = {_shown(column.source)}", "; ".join(filter(None, (column.elsewhere, doubt))))


def _shown(source: Source) -> str:
    return str(source) if isinstance(source, int) else _text(source)


def _text(value: str) -> str:
    """``value`` as a TOML basic string, in which nothing but printable characters stands."""
    safe = value.encode("utf-8", "backslashreplace").decode("utf-8")
    return f'"{"".join(map(_character, safe))}"'


def _character(char: str) -> str:
    if char in '"\\':
        return f"\\{char}"
    return char if char.isprintable() else f"\\U{ord(char):08X}" if ord(char) > 0xFFFF else f"\\u{ord(char):04X}"
