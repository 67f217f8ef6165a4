"""A first ``run.toml`` from what the files of a folder say; what they leave out is marked for the engineer to state."""

from __future__ import annotations

import fnmatch
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crankorder.errors import CrankorderError, NoUsableRecordingError, RequestError, printable
from crankorder.ingest.folder import is_leftover, natural_key
from crankorder.ingest.formats import contents_of, read_file
from crankorder.ingest.rawfile import Contents, RawFile
from crankorder.ingest.units import known_unit
from crankorder.settings import load_settings
from crankorder.shaft.pattern import known_names
from crankorder.shaft.pulses import FloatArray, find_pulses
from crankorder.shaft.uneven_wheel import FoundPattern, find_pattern

# Samples that are enough to see a wheel.
MOST_SAMPLES = 4_000_000
# A trace with this share of its samples at its two levels is a square wave; a sine has 0.51.
SQUARE_SHARE = 0.75

_TIME = re.compile(r"(time|zeit|t)\b.*", re.IGNORECASE)

_INDEX = re.compile(r"\b(index|tdc|trigger|z.?pulse|once.?per.?rev|ref)\b", re.IGNORECASE)

_ENCODER = re.compile(r"enc|tach|pulse|crank|tooth|teeth|\bir\b|kurbel", re.IGNORECASE)

_CAM = re.compile(r"\bcam(shaft)?\b|nockenwelle", re.IGNORECASE)

_SPEED = re.compile(r"rpm|speed|drehzahl", re.IGNORECASE)

MOTOR = (
    "",
    "# [motor]                         # where an induction motor drives: its slip and its lines are then named",
    "# supply_hz = 50.0                # leave it out for a motor on a variable-speed drive",
    "# poles = 4                       # poles, not pairs",
    "# rotor_bars = 44",
    "# shaft_ratio = 1.0               # turns of the motor per crank revolution",
    "",
)
"""What a draft proposes that no file tells, as comments."""


@dataclass(frozen=True)
class EncoderGuess:
    """Kind and edge of an encoder as its values look, and the wheel that was found, if any."""

    kind: str
    edge: str
    found: FoundPattern | None


def encoder_guess(
    path: Path, source: str, *, index: str | None, time: str | None, rate_hz: float | None
) -> EncoderGuess | None:
    """What the encoder of a recording seems to be, or None where it cannot be read as one.

    Parameters
    ----------
    path : the recording
    source : its encoder column
    index : its column of a once-per-revolution mark, or None
    time : its column of times, or None
    rate_hz : samples per second that the file states, or None
    """
    settings = load_settings()
    try:
        sources = [name for name in (source, index, time) if name is not None]
        raw = read_file(path, sources=list(sources), settings=settings.ingest)
        pulses = _edges(raw, source, time, rate_hz)
        marks = _edges(raw, index, time, rate_hz)[2] if index is not None else {}
    except (CrankorderError, OSError, ValueError):
        return None
    kind, first, by_edge = pulses
    mark_s = next(iter(marks.values()), None)
    found = {edge: find_pattern(time_s, index_time_s=mark_s) for edge, time_s in by_edge.items()}
    best = max(found, key=lambda edge: (_likely(found[edge]), edge == first))
    return EncoderGuess(kind, best, found[best])


def _likely(found: FoundPattern | None) -> tuple[int, float]:
    """How good a finding is: a wheel that is known before one that is not, then the share of revolutions."""
    if found is None:
        return 0, 0.0
    known = found.pattern.even is not None or found.pattern.name in known_names()
    return 2 if known else 1, found.agreement


def _edges(
    raw: RawFile, source: str, time: str | None, rate_hz: float | None
) -> tuple[str, str, dict[str, FloatArray]]:
    """Kind of a column, the edge to prefer, and the pulse times of each edge."""
    values = raw.columns[source][:MOST_SAMPLES].astype(np.float64)
    if values.size > 3 and np.isfinite(values).all() and (np.diff(values) >= 0.0).all() and np.ptp(values) > 0.0:
        return "pulse_times", "rising", {"rising": values}
    times = None if time is None else raw.columns[time][:MOST_SAMPLES].astype(np.float64)
    if times is not None and not _uniform(times):
        high = values > 0.5 * (values.min() + values.max())
        turns = {"rising": high[1:] & ~high[:-1], "falling": ~high[1:] & high[:-1]}
        return "edge_list", "rising", {edge: times[1:][turned] for edge, turned in turns.items()}
    rate = rate_hz if times is None else float((times.size - 1) / np.ptp(times))
    kind = "square" if _is_square(values) else "analogue"
    shaft = load_settings().shaft
    by_edge = {
        edge: find_pulses(
            values,
            rate_hz=rate or 1.0,
            kind="square" if kind == "square" else "analogue",
            edge="rising" if edge == "rising" else "falling",
            pulses_per_rev=1,
            settings=shaft,
        ).time_s
        for edge in ("rising", "falling")
    }
    return kind, "rising", by_edge


def _uniform(times: FloatArray) -> bool:
    step = np.diff(times)
    return times.size > 2 and bool(np.ptp(step) < 0.5 * np.median(step))


def _is_square(values: npt.NDArray[Any]) -> bool:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    near = 0.15 * (high - low)
    return float(np.mean((values < low + near) | (values > high - near))) >= SQUARE_SHARE


def draft_manifest(folder: Path) -> str:
    """TOML text of a draft manifest for the recordings in ``folder``, taken from what their headers state.

    Lines that end in ``# state: …`` hold guesses to be checked. Raises RequestError where ``folder`` is no folder, and
    NoUsableRecordingError, naming what each file is, where none can be read.
    """
    pattern, group = _recordings(folder)
    contents, path = group[0]
    roles = _roles(contents)
    sources = {name: _source(name, [other for other, _ in group]) for name in roles}
    lines = [
        "# Draft by `crankorder init`: check every line that says `state`.",
        "schema_version = 1",
        "",
        "[test]",
        f"name = {_text(folder.resolve().name)}",
        'cycle = "four-stroke"             # state: four-stroke, two-stroke or rotor; none where nothing turns',
        '# engine = "…"                    # state: a shipped engine, or a TOML file in this folder',
        "",
        "[recordings]",
        f"files = [{_text(pattern)}]",
        "",
        *_sampling(contents, roles),
    ]
    for name, role in roles.items():
        if role == "channel":
            lines += _channel(name, contents.units.get(name, ""), sources[name])
    lines += _encoder(roles, contents, path, sources)
    lines += MOTOR
    scalars = [name for name in contents.names if contents.samples.get(name) == 1]
    if scalars:
        shown = ", ".join(printable(name, 40) for name in scalars[:20]) + (", …" if len(scalars) > 20 else "")
        lines.append(f"# Single numbers in the file, such as a speed: {shown}")
    return "\n".join(lines) + "\n"


def _recordings(folder: Path) -> tuple[str, list[tuple[Contents, Path]]]:
    """Pattern of the largest group of readable files with one suffix, and the contents and path of each."""
    if not folder.is_dir():
        raise RequestError("there is no such folder", file=folder)
    settings = load_settings().ingest
    groups: dict[str, list[tuple[Contents, Path]]] = {}
    faults: list[CrankorderError] = []
    for path in sorted(folder.iterdir(), key=natural_key):
        if is_leftover(path.name) or path.suffix.lower() in (".toml", ".md", ".json") or path.is_dir():
            continue
        try:
            contents = contents_of(path, settings=settings)
            groups.setdefault(path.suffix, []).append((contents, path))
        except CrankorderError as error:
            faults.append(error)
    if not groups:
        raise NoUsableRecordingError(
            "no recording found; looked for HDF5, WAV, XLSX, MATLAB, NumPy, LVM and text files",
            file=folder,
            found="; ".join(str(fault) for fault in faults[:3]) or "an empty folder",
        )
    # notes beside the recordings may read as tables too: those hold most
    suffix = max(groups, key=lambda name: sum(path.stat().st_size for _, path in groups[name]))
    return f"*{suffix}", groups[suffix]


def _source(name: str, files: list[Contents]) -> str | int:
    """Source of a column: its name, or where another file calls it otherwise a pattern or its position."""
    if all(name in contents.names for contents in files):
        return name
    word = re.split(r"[0-9]+", name)[-1]
    if word and all(len(fnmatch.filter(contents.names, f"*{word}")) == 1 for contents in files):
        return f"*{word}"
    return files[0].names.index(name)


def _roles(contents: Contents) -> dict[str, str]:
    """What each column is likely for: time, index, cam, encoder, speed or channel; each but the last once."""
    roles: dict[str, str] = {}
    longest = max(contents.samples.values(), default=0)
    for name in contents.names:
        n_samples = contents.samples.get(name)
        # a MATLAB file may hold much besides: single numbers, spectra
        if contents.format == "MATLAB" and n_samples != longest:
            if n_samples == 1 and _SPEED.search(name) and "constant" not in roles.values():
                roles[name] = "constant"
            continue
        unit = known_unit(contents.units.get(name, ""))
        quantity = "" if unit is None else unit.quantity
        guess = "channel"
        if quantity == "time" or _TIME.fullmatch(name):
            guess = "time"
        elif quantity == "rotational speed" or (not quantity and _SPEED.search(name)):
            guess = "speed"
        elif quantity not in ("", "voltage", "counts", "full scale"):
            guess = "channel"
        elif _INDEX.search(name):
            guess = "index"
        elif _CAM.search(name):
            guess = "cam"
        elif _ENCODER.search(name):
            guess = "encoder"
        roles[name] = "channel" if guess in roles.values() else guess
    if "channel" not in roles.values():
        # a manifest needs one; a file of an encoder alone is rare
        last = next(reversed(roles))
        roles[last] = "channel"
    return roles


def _sampling(contents: Contents, roles: dict[str, str]) -> list[str]:
    time = next((name for name, role in roles.items() if role == "time"), None)
    lines = ["[sampling]", 'domain = "time"                   # state: time or crank_angle']
    if time is not None:
        lines.append(f"time_source = {_text(time)}")
    elif not contents.rates_hz:
        lines.append("rate_hz = 0.0                     # state: samples per second, which the file does not say")
    return [*lines, ""]


def _channel(name: str, file_unit: str, source: str | int) -> list[str]:
    unit = known_unit(file_unit)
    lines = [
        "[[channels]]",
        f"name = {_text(name)}",
        f"source = {source if isinstance(source, int) else _text(source)}",
    ]
    if unit is None:
        lines.append('unit = "V"                        # state: unit of the analysed signal')
    else:
        lines.append(f"unit = {_text(unit.name)}")
    if unit is None or unit.quantity == "voltage":
        lines.append(
            '# sensitivity = "100 mV/g"        # state: where the file holds volts (and the unit above is then m/s2)'
        )
    return [*lines, 'direction = ""                    # state: such as +Z', ""]


def _encoder(roles: dict[str, str], contents: Contents, path: Path, sources: dict[str, str | int]) -> list[str]:
    by_role = {role: name for name, role in roles.items()}
    if "encoder" in by_role:
        marks = [f"{role} = {_text(by_role[role])}" for role in ("index", "cam") if role in by_role]
        return ["[encoder]", f"source = {_text(by_role['encoder'])}", *_wheel(by_role, contents, path), *marks]
    if "index" in by_role:
        return ["[encoder]", f"source = {_text(by_role['index'])}", 'kind = "square"', "pulses_per_rev = 1"]
    if "speed" in by_role:
        return ["[encoder]", f"source = {_text(by_role['speed'])}", 'kind = "speed"']
    if "constant" in by_role:
        source = sources[by_role["constant"]]
        shown = source if isinstance(source, int) else _text(source)
        return ["[encoder]", 'kind = "constant"', f"source = {shown}".ljust(34) + "# state: a number, taken as rpm"]
    return ["[encoder]", 'kind = "none"                     # state: no column looks like an encoder']


def _wheel(by_role: dict[str, str], contents: Contents, path: Path) -> list[str]:
    """Kind, edge and wheel of the encoder as its pulses in the file at ``path`` tell them, else to be stated."""
    from crankorder.ingest.draft import encoder_guess

    guess = encoder_guess(
        path,
        by_role["encoder"],
        index=by_role.get("index"),
        time=by_role.get("time"),
        rate_hz=contents.rates_hz.get(by_role["encoder"]),
    )
    if guess is None:
        return [
            'kind = "square"                   # state: square, analogue, pulse_times or edge_list',
            "# pulses_per_rev = 60             # state: pulses of the full wheel per revolution; they do not tell",
            "# missing_teeth = 2               # state: or pattern, or tooth_angles_deg",
        ]
    lines = [f'kind = "{guess.kind}"'.ljust(34) + "# state: as its values look", f'edge = "{guess.edge}"']
    if guess.found is None:
        return [
            *lines,
            "# pulses_per_rev = 60             # state: pulses per revolution; they are even, or too few to tell",
        ]
    even, angles = guess.found.pattern.even, guess.found.pattern.angles_deg
    told = f"# state: {guess.found.told}"
    if even is not None:
        return [*lines, f"pulses_per_rev = {even[0]}".ljust(34) + told, f"missing_teeth = {even[1]}"]
    if guess.found.pattern.name in known_names():
        return [*lines, f'pattern = "{guess.found.pattern.name}"'.ljust(34) + told]
    return [*lines, told, f"tooth_angles_deg = [{', '.join(f'{angle:.4g}' for angle in angles)}]"]


def _text(value: str) -> str:
    """``value`` as a TOML basic string."""
    safe = value.encode("utf-8", "backslashreplace").decode("utf-8")
    return json.dumps(safe, ensure_ascii=False).replace("\x7f", "\\u007f")
