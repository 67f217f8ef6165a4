"""README pages, the picture of the stages and schemas of what is written, made from what they describe.

Run ``python reports/make_readmes.py`` after a change there; a house test compares the pages with a fresh rendering.
"""

from __future__ import annotations

import json
import re
import textwrap
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, get_type_hints

from model_keys import Row, default_of, kind_of, tables_of, toml_of
from pydantic.fields import FieldInfo

from crankorder.checks.doubts import Doubts
from crankorder.comparison import BuildComparison, Comparison
from crankorder.engine.balance_data import BalanceData
from crankorder.engine.definition import Engine
from crankorder.findings import Findings
from crankorder.ingest.manifest import Manifest
from crankorder.stages import FRAMES_OF, STAGES
from crankorder.synth.scene import Scene

ROOT = Path(__file__).resolve().parents[1]
MARKER = "<!-- made by `python reports/make_readmes.py`: change the files that it describes, not this page -->"

NOUNS = ("recording", "shaft_angle", "order_frames", "order_map", "frequency_frames", "campbell_map", "order_tracks")
"""Datasets in the order in which they flow; schemas not named here follow by name."""

UNITS = (
    ("_rad_s", "rad/s"),
    ("_m_s2", "m/s²"),
    ("_hz", "Hz"),
    ("_s", "s"),
    ("_rpm", "rpm"),
    ("_deg", "°"),
    ("_rev", "rev"),
    ("_db", "dB"),
    ("_in", "in"),
    ("_pa", "Pa"),
    ("_bytes", "bytes"),
    ("_samples", "samples"),
    ("_rad", "rad"),
    ("_revs", "rev"),
    ("_sigmas", "standard errors"),
    ("_share", "share"),
    ("_chance", "share"),
    ("_cycles", "cycles"),
    ("_speeds", "speeds"),
    ("_frames", "frames"),
    ("_bins", "bins"),
    ("_teeth", "teeth"),
    ("_orders", "orders"),
    ("_order", "order"),
    ("_characters", "characters"),
    ("_fraction", "share"),
    ("_probability", "share"),
    ("_ratio", "ratio"),
    ("dpi", "dots per inch"),
)

SETTING = re.compile(r"^(?P<key>[a-z0-9_]+) = (?P<value>[^#]*?)\s*(?:#\s*(?P<reason>.*?)\s*)?$")


def unit_of(key: str) -> str:
    """Unit that the name ``key`` of a setting states, ``"Hz"`` for ``"max_frequency_hz"``; ``""`` for a pure number."""
    if "_per_" in key:
        return key.replace("_", " ")
    return next((unit for suffix, unit in UNITS if key.endswith(suffix)), "")


def settings_of(text: str) -> list[tuple[str, str, str]]:
    """Key, value and reason (the comment; "" where there is none) of each line of a stage's TOML ``text``."""
    matches = (SETTING.match(line) for line in text.splitlines())
    return [(match["key"], match["value"], match["reason"] or "") for match in matches if match]


def method_tables(text: str) -> Iterator[tuple[str, str, list[tuple[str, str, str]]]]:
    """Name, title (its comment) and settings of each table of a method's TOML ``text``."""
    for part in re.split(r"^(?=\[)", text, flags=re.MULTILINE)[1:]:
        head, _, rest = part.partition("\n")
        name, _, title = head.partition("]")
        yield name.removeprefix("["), title.strip(" #"), settings_of(rest)


def table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Markdown table with the cells of ``header`` and ``rows``; bars and line ends in a cell are escaped."""
    lines = [[cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows]
    titles = list(header)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [titles, ["---"] * len(titles), *lines])


def render_pipeline_readme(root: Path = ROOT) -> str:
    """Text of ``pipeline/README.md``: every setting by stage, then what is shipped, read from the tree at ``root``."""
    folder = root / "pipeline"
    files = sorted(folder.glob("[0-9]-*.toml"))
    stages = [path for path in files if path.stem.count("-") == 1]
    parts = [
        MARKER,
        "# Pipeline: what is done, in order, and every number that shapes a result",
        f"`{' → '.join(path.stem.partition('-')[2] for path in stages)}`",
        "One file per stage is the one home of each default. A recipe names only the settings in which it differs; "
        "an unknown name or a value out of range is refused. Units are part of the name.",
        "The numbers of a method, which no recipe changes, stand in files of their own: a table per module. "
        "They were chosen together, on data with a known answer.",
    ]
    for path in stages:
        text = path.read_text(encoding="utf-8")
        parts += [f"## {path.stem.replace('-', '. ', 1)}", _heading_comment(text)]
        rows = ((f"`{key}`", f"`{value}`", unit_of(key), reason) for key, value, reason in settings_of(text))
        parts += [table(("setting", "value", "unit", "reason"), rows)]
    for path in (path for path in files if path not in stages):
        text = path.read_text(encoding="utf-8")
        parts += [f"## {path.stem.replace('-', '. ', 1).replace('-', ': ')}", _heading_comment(text)]
        for name, title, settings in method_tables(text):
            rows = ((f"`{key}`", f"`{value}`", unit_of(key), reason) for key, value, reason in settings)
            parts += [f"### {name}", title, table(("number", "value", "unit", "reason"), rows)]
    for kind, what in (
        ("recipes", "An analysis: the settings that differ."),
        ("engines", "Engine data; a manifest names one. [Every key](engines/README.md)."),
        ("scenes", "Synthetic tests: an engine, its speeds, sensors and effects. [Every key](scenes/README.md)."),
    ):
        parts += [f"## {kind}", what, _shipped(folder / kind)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _heading_comment(text: str) -> str:
    first = text.partition("\n")[0]
    return first.removeprefix("#").strip() if first.startswith("#") else ""


def _shipped(folder: Path) -> str:
    rows = []
    for path in sorted(folder.glob("*.toml")):
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        about = content.get("description") or _heading_comment(path.read_text(encoding="utf-8"))
        rows.append((f"[`{path.stem}`]({folder.name}/{path.name})", str(content.get("title", "")), str(about)))
    return table(("name", "title", "what it is"), rows) if rows else "None is shipped yet."


def render_schema_readme(root: Path = ROOT) -> str:
    """Text of ``data_schema/README.md``: each dataset in flow order, then each file, read from the tree at ``root``."""
    schemas = {
        path.stem: json.loads(path.read_text(encoding="utf-8")) for path in (root / "data_schema").glob("*.json")
    }
    datasets = [name for name in sorted(schemas) if "variables" in schemas[name].get("properties", {})]
    datasets.sort(key=lambda name: NOUNS.index(name) if name in NOUNS else len(NOUNS))
    parts = [
        MARKER,
        "# Data schema: what each dataset and each file holds",
        "Each page is a JSON Schema. Datasets are checked by name, dims and units at the door of every stage. "
        "A unit of `see unit` is the one that the variable `unit` states for each channel.",
        "## Datasets, in flow order",
    ]
    for name in datasets:
        parts += _dataset(name, schemas[name])
    files = [name for name in sorted(schemas) if name not in datasets]
    if files:
        parts.append("## Files")
    for name in files:
        rows = list(_fields(schemas[name], schemas[name]))
        parts += [f"### {schemas[name].get('title', name)} (`{name}.json`)", schemas[name].get("description", "")]
        parts += [table(("field", "type", "required", "meaning"), rows)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _dataset(name: str, schema: dict[str, Any]) -> list[str]:
    variables, attrs = schema["properties"]["variables"], schema["properties"].get("attrs", {})
    rows = []
    for variable, rule in variables["properties"].items():
        dims = " or ".join(", ".join(choice) or "scalar" for choice in rule["properties"]["dims"]["enum"])
        optional = "" if variable in variables["required"] else " (optional)"
        unit = rule["properties"]["units"].get("const", "any, stated")
        rows.append((f"`{variable}`{optional}", dims, unit, rule.get("description", "")))
    parts = [f"### {schema['title']} (`{name}.json`), one per {schema['per']}", schema["description"]]
    parts += [table(("variable", "dims", "units", "meaning"), rows)]
    required = attrs.get("required", [])
    notes = [
        (f"`{attr}`{'' if attr in required else ' (optional)'}", rule.get("description", ""))
        for attr, rule in attrs.get("properties", {}).items()
    ]
    return [*parts, table(("attribute", "meaning"), notes)] if notes else parts


def _resolved(schema: dict[str, Any], whole: dict[str, Any]) -> dict[str, Any]:
    if "$ref" not in schema:
        return schema
    target: Any = whole
    for part in schema["$ref"].removeprefix("#/").split("/"):
        target = target[part]
    return {**_resolved(target, whole), **{key: value for key, value in schema.items() if key != "$ref"}}


def _fields(schema: dict[str, Any], whole: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, str, str, str]]:
    for name, rule in schema.get("properties", {}).items():
        field = _resolved(rule, whole)
        required = "yes" if name in schema.get("required", []) else ""
        yield f"`{prefix}{name}`", _type(field, whole), required, field.get("description", "")
        for inner, path in _inside(field, whole, f"{prefix}{name}"):
            yield from _fields(inner, whole, path)


def _inside(field: dict[str, Any], whole: dict[str, Any], path: str) -> Iterator[tuple[dict[str, Any], str]]:
    yield field, f"{path}."
    if isinstance(field.get("items"), dict):
        yield _resolved(field["items"], whole), f"{path}[]."
    if isinstance(field.get("additionalProperties"), dict):
        yield _resolved(field["additionalProperties"], whole), f"{path}.*."
    for choice in (*field.get("anyOf", ()), *field.get("oneOf", ())):
        yield from _inside(_resolved(choice, whole), whole, path)


def _type(field: dict[str, Any], whole: dict[str, Any]) -> str:
    choices = [_type(_resolved(choice, whole), whole) for choice in (*field.get("anyOf", ()), *field.get("oneOf", ()))]
    if choices:
        return " or ".join(dict.fromkeys(choices))
    if "const" in field:
        return f"`{json.dumps(field['const'], ensure_ascii=False)}`"
    if "enum" in field:
        return ", ".join(f"`{json.dumps(value, ensure_ascii=False)}`" for value in field["enum"])
    kinds = field.get("type", "any")
    text = kinds if isinstance(kinds, str) else " or ".join(kinds)
    if isinstance(field.get("items"), dict):
        return f"{text} of {_type(_resolved(field['items'], whole), whole)}"
    return text


def render_keys(title: str, model: type[Scene] | type[Engine], skip: tuple[str, ...], notes: str) -> str:
    """Page of every key that a file of ``model`` may hold but those in ``skip``; ``title`` and ``notes`` come first."""
    parts = [MARKER, f"# {title}", notes]
    for heading, about, rows in tables_of(model, skip):
        parts += [f"## `{heading}`" if heading else "", about, table(("key", "value", "default"), rows)]
    return "\n\n".join(part for part in parts if part) + "\n"


def render_balance_keys() -> str:
    """The part of that page on the table ``[balance]`` of an engine file."""
    parts = ["", "## `[balance]`", BALANCE_NOTES]
    for heading, about, rows in tables_of(BalanceData):
        inner = heading.lstrip("[").rstrip("]")
        named = heading.replace(inner, f"balance.{inner}")
        parts += [f"### `{named}`" if heading else "", about, table(("key", "value", "default"), rows)]
    return "\n\n".join(part for part in parts if part).join(("\n", "\n"))


STAGE_NOTES = (
    "Each row is a stage of `stages.py`; `●` is the noun that it makes, and each `○` below that a later stage that "
    "takes it. Settings and what the manifest states are not shown. Stages of a test take the nouns of all recordings, "
    "those below `doubts` without what that leaves out."
)


def render_stages() -> str:
    """Page with the picture of the stages: what each takes and makes, by its signature."""
    hints = [get_type_hints(stage) for stage in STAGES]
    makes = [types.pop("return") for types in hints]
    takes = [{FRAMES_OF.get(kind, kind) for kind in types.values()} for types in hints]
    first_of_test = makes.index(Doubts)
    for types, kinds in zip(hints[first_of_test + 1 :], takes[first_of_test + 1 :], strict=True):
        kinds |= {Doubts} if FRAMES_OF.keys() & set(types.values()) else set()
    rows = []
    for row, (stage, noun) in enumerate(zip(STAGES, makes, strict=True)):
        later = set().union(*takes[row:])
        cells = ["○" if above in takes[row] else "│" if above in later else " " for above in makes[:row]]
        rows.append(f"  {stage.__name__:26}{' '.join([*cells, '●'])}  {noun.__name__}")
    rows = ["of a recording", *rows[:first_of_test], "of a test", *rows[first_of_test:]]
    return "\n".join([MARKER, "", "# Stages", "", STAGE_NOTES, "", "```text", *rows, "```", ""])


SCENE_NOTES = (
    "A scene is a TOML file: `crankorder synth my-scene.toml --out FOLDER`. What it does not name is not there and "
    "costs nothing. Short lists can be written in one line: `by_order = [{ order = 2.0, percent = 1.0 }]`. `engine` is "
    'a shipped engine or the path of an engine file; it is required. With `based_on = "another-scene"` a scene has all '
    "keys of that one but those that it states itself (a table or list replaces the whole table or list) and those it "
    'lists in `without = ["encoder"]`. Where a table comes more than once below, it is one of several kinds.'
)
ENGINE_NOTES = (
    "An engine is a TOML file; a manifest, a scene or `crankorder balance` names it. Lengths are in metres, masses in "
    "kilograms, angles in degrees of crank. A table `[balance]` is for `crankorder balance` alone; its keys come last."
)
BALANCE_NOTES = (
    "A table of an engine file, all of it optional: what `crankorder balance` is to work out beside the forces. Masses "
    "are in grams, lengths in millimetres, as in drawings of parts; the crankshaft is in kilograms."
)


MANIFEST_NOTES = (
    "`run.toml` stands in the folder of the recordings; `crankorder init FOLDER --save` drafts it, `crankorder check "
    "FOLDER` says what is wrong with it. A key that is not listed here is refused. The schema for editors is "
    "`data_schema/manifest.json`; [a manifest for each format](../howto/formats.md) shows whole files."
)
MANIFEST_UNITS = (
    ("_per_kg", "1/kg"),
    ("_per_rev", "1/rev"),
    ("_kg", "kg"),
    ("_mm", "mm"),
    ("_g", "g"),
    ("_v", "V"),
    ("_percent", "%"),
)
NEVER_STATED = ("points",)
"""Keys of a manifest's models that are filled from elsewhere."""


def manifest_cells(name: str, field: FieldInfo) -> Row:
    """Key, meaning, kind of its values, unit, default and example of a key of a manifest."""
    unit = next((unit for suffix, unit in MANIFEST_UNITS if name.endswith(suffix)), "") or unit_of(name)
    example = f"`{toml_of(field.examples[0])}`" if field.examples else ""
    kind = re.sub(r" ?length ≥ 1(, length ≤ \d+)?", "", kind_of(field)).strip()
    return f"`{name}`", field.description or "", kind, unit, default_of(field), example


def render_manifest_keys() -> str:
    """Page of every key of a manifest: meaning, kind, unit, default and example, as its model states them."""
    parts = [MARKER, "# Manifest: every key of run.toml", MANIFEST_NOTES]
    for heading, about, rows in tables_of(Manifest, NEVER_STATED, manifest_cells):
        header = ("key", "meaning", "value", "unit", "default", "example")
        parts += [f"## `{heading}`" if heading else "", about, table(header, rows)]
    return "\n\n".join(part for part in parts if part) + "\n"


def manifest_schema() -> str:
    """The JSON Schema of ``run.toml``, as its model gives it."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **Manifest.model_json_schema()}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


WRITTEN = {
    "findings": (
        Findings,
        {
            "title": "Findings",
            "description": "What a test says (findings.json). Every estimate x may have x_ci95, its 95 % interval; "
            "null stands for not known. More keys are allowed.",
            "per": "test",
        },
    ),
    "comparison": (
        Comparison,
        {
            "title": "Comparison",
            "description": "What differs between two tests, or changes over the runs of one (comparison.json, and "
            "stdout of `crankorder compare --json`). The last run is compared with the first; x_ci95 is the 95 % "
            "interval of x; null where nothing can be said. More keys are allowed.",
            "per": "comparison",
        },
    ),
    "builds": (
        BuildComparison,
        {
            "title": "BuildComparison",
            "description": "What differs between two builds of several tests (builds.json, and stdout of `crankorder "
            "compare --json` with two --out of several tests): a comparison of each test with its partner. More keys "
            "are allowed.",
            "per": "comparison",
        },
    ),
}
"""Types of the files that are written, by name, with what heads their schema."""


def record_schema(name: str) -> str:
    """The JSON Schema of the file ``name`` of ``data_schema/`` that is written, as the types of its records give it."""
    kind, head = WRITTEN[name]
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **head, **kind.json_schema()}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


INTERVALS = ("amplitude", "phase", "frequency", "damping")
"""Kinds of judgement that are of a 95 % interval."""


def score_figures(root: Path) -> list[str]:
    """What the baseline of the score says of how often the program is right, as items of a list."""
    machines = [score for scores in _report(root, "score.json")["sets"].values() for score in scores]

    def share(*kinds: str, of_class: str | None = None) -> tuple[float, float]:
        own = [score["shares"] for score in machines if of_class in (None, score["class"])]
        pairs = [shares[kind] for shares in own for kind in kinds if kind in shares]
        return sum(good for good, _ in pairs), sum(of for _, of in pairs)

    def covered(of_class: str | None) -> float:
        good, of = share(*INTERVALS, of_class=of_class)
        return 100.0 * good / of

    def wrong(kind: str, what: str) -> str:
        good, of = share(kind)
        return f"{of - good:.0f} of {of:,.0f} {what}"

    def percent(*kinds: str) -> str:
        good, of = share(*kinds)
        return f"{100.0 * good / of:.0f} %"

    classes = {score["class"] for score in machines}
    failed = sum(bool(score["message"]) for score in machines)
    dangers = ", ".join(
        (
            wrong("dangerous not free", "dangerous speeds called free"),
            wrong("lock", "locks told wrong"),
            wrong("part real", "named parts not there"),
            wrong("mode real", "natural frequencies not there"),
        )
    )
    return [
        f"{len(machines)} drawn machines of {len(classes)} classes, analysed by the command as a user does "
        f"([score](reports/score.md), `make score`): {failed} failed; {dangers}; 95 % intervals hold the truth in "
        f"{covered(None):.0f} % ({min(map(covered, classes)):.0f} % in the worst class). Of what an estimator that "
        f"knows the model can decide, {percent('decided: lock')} of the locks, {percent('decided: mode')} of the "
        f"natural frequencies and {percent('decided: free')} of the free speeds are decided; the rest is called "
        "not decided;",
    ]


def identification_figures(root: Path) -> list[str]:
    """What the last report on identification says, as items of a list."""
    report = _report(root, "speed-error/identification.json")
    quantities, mass = report["quantities"], report["quantities"]["residual mass, order 1"]
    named = ("largest amplitude", "natural frequency", "damping", "residual mass")
    inside = [
        float(numbers["inside the 95 % interval"].removesuffix("%"))
        for name, numbers in quantities.items()
        if name.startswith(named) and "noise alone" not in name
    ]
    size = quantities["largest amplitude"]
    count = defaultdict(int, report["counts"])
    return [
        f"the reference campaign against its own truth, {report['scenes']} times, the shaft known exactly: "
        f"missed and made up: orders {count['missed orders']} and {count['false orders']}, natural frequencies "
        f"{count['missed modes']} and {count['false modes']}; not told: crossings at 1725 rpm "
        f"{count['missed 1725 rpm']}, unbalance {count['no mass']}; amplitudes in their noise have an RMS error of "
        f"{size['RMS error']}, unbalance of {mass['RMS error']}; 95 % intervals hold the truth in {min(inside):g} to "
        f"{max(inside):g} % ([numbers](reports/speed-error/identification.md)).",
    ]


def speed_figures(root: Path) -> list[str]:
    """What the last benchmark of the whole process says, as paragraphs."""
    bench = _report(root, "speed-error/campaign.json")
    rows, errors = bench["rows"], bench["error_of_amplitudes"]["programs"]
    maps, full = rows["crankorder, recipe maps"], rows["crankorder, with findings"]
    scipy, rota = rows["plain scipy"], rows.get("rota-order 0.3")
    first, warm = rows["crankorder, with findings, first run"], rows["crankorder, with findings, warm interpreter"]
    others = f"plain scipy takes {scipy['seconds']:g} s ({scipy['processor_seconds']:g} s of processor)"
    others += " for maps and pictures alone"
    if rota:
        others += f", rota-order {rota['seconds']:g} s (scaled from {rota['scaled_from_recordings']} recordings)"
    worst = {name: f"{100.0 * error['largest']:.2g} %" for name, error in errors.items()}
    return [
        f"Speed: the 35-speed campaign ({bench['megabytes']} MB) takes {full['seconds']:g} s as a whole process "
        f"({full['processor_seconds']:g} s of processor), with findings and pictures, on {bench['cores']} cores "
        f"({bench['machine']['processor']}); maps alone take {maps['seconds']:g} s. In the same run {others}. A first "
        f"run in a new environment takes {first['seconds']:g} s, a further one in the same interpreter "
        f"{warm['seconds']:g} s. Largest error of an order's amplitude, nearly without noise: "
        f"{worst['crankorder, with findings']} with findings, {worst['crankorder, recipe maps']} in the maps, "
        f"{worst['plain scipy']} by plain scipy "
        "([`make bench`](reports/speed-error/campaign.md)).",
    ]


def _report(root: Path, name: str) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((root / "reports" / name).read_text(encoding="utf-8"))
    return loaded


def render_readme(root: Path = ROOT) -> str:
    """Text of ``README.md`` with the figures between its marks as the last ``reports/`` have them."""
    items = [_wrapped(f"* {item}") for item in (*score_figures(root), *identification_figures(root))]
    figures = "\n".join(items) + "\n\n" + "\n\n".join(map(_wrapped, speed_figures(root)))
    first, last = "<!-- figures: made by `make readmes` -->", "<!-- figures: end -->"
    head, _, rest = (root / "README.md").read_text(encoding="utf-8").partition(first)
    return f"{head}{first}\n{figures}\n{last}{rest.partition(last)[2]}"


def _wrapped(text: str) -> str:
    return textwrap.fill(
        text,
        140,
        subsequent_indent="  " if text.startswith("*") else "",
        break_long_words=False,
        break_on_hyphens=False,
    )


def pages(root: Path = ROOT) -> dict[Path, str]:
    """Path and text of every generated page of the tree at ``root``."""
    return {
        root / "README.md": render_readme(root),
        **{root / "data_schema" / f"{name}.json": record_schema(name) for name in WRITTEN},
        root / "data_schema" / "manifest.json": manifest_schema(),
        root / "docs" / "reference" / "manifest.md": render_manifest_keys(),
        root / "docs" / "method" / "stages.md": render_stages(),
        root / "pipeline" / "README.md": render_pipeline_readme(root),
        root / "data_schema" / "README.md": render_schema_readme(root),
        root / "pipeline" / "scenes" / "README.md": render_keys(
            "Scenes: every key", Scene, ("engine", "engine_file"), SCENE_NOTES
        ),
        root / "pipeline" / "engines" / "README.md": render_keys("Engines: every key", Engine, (), ENGINE_NOTES)
        + render_balance_keys(),
    }


if __name__ == "__main__":
    schemas = {name: record_schema(name) for name in WRITTEN} | {"manifest": manifest_schema()}
    for name, text in schemas.items():  # a page is made of them
        (ROOT / "data_schema" / f"{name}.json").write_text(text, encoding="utf-8")
    for page, text in pages().items():
        page.write_text(text, encoding="utf-8")
        print(page.relative_to(ROOT))
