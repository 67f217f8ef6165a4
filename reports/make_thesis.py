"""Make `docs/thesis.md`, the tables of `docs/sources.md` and `reports/gallery/thesis/` from scenes and engine files.

Usage: python reports/make_thesis.py [--results FOLDER] [--tables-only]
Synthesises the four campaigns of the thesis in a temporary folder, analyses and compares them with the command line,
works out the balance of the engines, copies the pictures and writes the pages. ``--results`` keeps (and uses again)
what was analysed; ``--tables-only`` writes the tables of `docs/sources.md` alone, which need no campaign.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from make_gallery import copy_picture

ROOT = Path(__file__).resolve().parents[1]
GALLERY = ROOT / "reports" / "gallery" / "thesis"
SOURCES = ROOT / "docs" / "sources.md"
PAGE = ROOT / "docs" / "thesis.md"
ROWS = Path(__file__).with_name("sources.toml")
TEMPLATE = Path(__file__).with_name("thesis_template.md")
SCENES = {
    "second": "thesis-second-motoring",
    "firing": "thesis-second-firing",
    "first": "thesis-first-motoring",
    "compared": "thesis-second-compared",
}
MORE_LABELS = 'title = "firing"\n[report]\nmax_labelled_orders = 24\n'
"""Recipe of the firing campaign: its half orders are many, and the first of them is the weakest in two axes."""


def crankorder(*arguments: str) -> str:
    """What the command line prints; its faults are shown and end the making."""
    return subprocess.run(
        [sys.executable, "-m", "crankorder", *arguments], check=True, stdout=subprocess.PIPE, text=True
    ).stdout


# ---- tables of docs/sources.md


@cache
def balance_of(engine: str) -> dict[str, Any]:
    """The balance document of a shipped engine."""
    document: dict[str, Any] = json.loads(crankorder("balance", engine, "--json"))
    return document


def value_at(document: Any, path: str) -> float:
    """Number at a path of ``reports/sources.toml``: keys, places, names of entries; ``A over B``, ``A minus B``."""
    for word in (" over ", " minus "):
        first, found, second = path.partition(word)
        if found:
            left, right = value_at(document, first), value_at(document, second)
            return left / right if word == " over " else left - right
    here = document
    for part in path.split("/"):
        if isinstance(here, list):
            named = [one for one in here if isinstance(one, dict) and part == one.get("name")]
            here = named[0] if named else here[int(part)]
        elif part == "*":
            here = list(here.values())[-1]
        elif part in here:
            here = here[part]
        else:
            here = list(here.values())[int(part)]
    return float(here)


def half_step(number: str) -> float:
    """Half a unit of the last digit of ``number`` as it is written."""
    mantissa, _, exponent = number.lower().partition("e")
    after = len(mantissa.partition(".")[2])
    return 0.5 * 10.0 ** (int(exponent or 0) - after)


def shown(value: float, like: str = "") -> str:
    """``value`` as text: seven digits, without an exponent where that is short."""
    text = f"{value:.7g}"
    return "0" if float(text) == 0 else text.replace("-", "−")


def _minus(number: str) -> str:
    return number.replace("-", "−") or "–"


def agrees(value: float, number: str) -> bool:
    """Whether ``value`` rounds to ``number``, at the last digit that this is written with."""
    return abs(value - float(number)) <= 1.02 * half_step(number) + 1e-9 * abs(float(number))


def source_rows() -> list[tuple[str, list[str], float]]:
    """Document, row of ``reports/sources.toml`` and our number, for every row."""
    table = tomllib.loads(ROWS.read_text(encoding="utf-8"))
    return [(document, row, value_at(balance_of(row[3]), row[4])) for document, rows in table.items() for row in rows]


def _cells(row: list[str], ours: float) -> list[str]:
    place, what, unit, engine, path, printed, truth = row
    try:
        difference = shown(ours - float(printed)) if abs(ours - float(printed)) > half_step(printed) else "rounding"
    except ValueError:
        difference = ""
    met = "" if not truth else (" ✓" if agrees(ours, truth) else " ✗")
    return [
        place, what, f"`{engine}` `{path}`", f"{shown(ours)} {unit}".strip(), _minus(printed),
        _minus(truth) + met, difference or "–",
    ]  # fmt: skip


def tables() -> str:
    """The tables of numbers, one a document, as Markdown."""
    lines = []
    heads = ("place", "what", "engine, path in the JSON", "ours", "printed", "truth", "ours less printed")
    for document in ("000", "001", "002", "003"):
        lines += [f"### Document {document}: every number", "", _row(heads), _row(["---"] * len(heads))]
        lines += [_row(_cells(row, ours)) for name, row, ours in source_rows() if name == document]
        lines += [""]
    return "\n".join(lines)


def _row(cells: Any) -> str:
    return f"| {' | '.join(str(cell).replace('|', chr(92) + '|') for cell in cells)} |"


def with_tables(page: str, made: str) -> str:
    """``page`` with the part between its two marks made anew."""
    first, last = "<!-- tables by `python reports/make_thesis.py` -->", "<!-- end of tables -->"
    before, _, rest = page.partition(first)
    _, _, after = rest.partition(last)
    return f"{before}{first}\n\n{made}\n{last}{after}"


# ---- campaigns


def make_results(folder: Path) -> dict[str, Path]:
    """Result folder of each campaign of the thesis, and of the comparison, made where it is missing."""
    made = {}
    for key, scene in SCENES.items():
        out = folder / f"{key}-results"
        if not any(out.glob("*/done.json")):
            recordings = folder / key
            crankorder("synth", scene, "--out", str(recordings), "-q")
            asked = []
            if key == "firing":
                recipe = folder / "firing.toml"
                recipe.write_text(MORE_LABELS, encoding="utf-8")
                asked = ["--recipe", str(recipe)]
            crankorder("run", str(recordings), "--out", str(out), "-q", *asked)
            shutil.rmtree(recordings)
        made[key] = next(iter(sorted(out.glob("*/done.json")))).parent
    difference = folder / "first-to-second"
    if not (difference / "comparison.json").exists():
        crankorder("compare", str(made["first"]), str(made["compared"]), "--out", str(difference))
    return made | {"change": difference}


def findings(result: Path) -> dict[str, Any]:
    """``findings.json`` of a result folder."""
    found: dict[str, Any] = json.loads((result / "findings.json").read_bytes())
    return found


def amplitudes(result: Path, channel: str, speed_rpm: float) -> dict[float, float]:
    """Peak amplitude (m/s²) by tracked order of a channel at a speed."""
    import xarray as xr

    with xr.open_dataset(result / "results.nc", group="order_tracks", engine="h5netcdf") as tracks:
        name = "amplitude" if "amplitude" in tracks else "amplitude_acceleration"
        at = tracks[name].sel(channel=channel).sel(speed=speed_rpm, method="nearest")
        return dict(zip(at["order"].values.tolist(), at.values.tolist(), strict=True))


def shown_picture(source: Path, name: str) -> str:
    """Markdown that shows the picture ``source``, copied into the gallery."""
    copy_picture(source, GALLERY / name)
    return f"![{Path(name).stem}](../reports/gallery/thesis/{name})"


def pictures(results: dict[str, Path], scratch: Path) -> dict[str, str]:
    """Markdown of every picture by name, copied into the gallery."""
    shutil.rmtree(GALLERY, ignore_errors=True)
    found: dict[str, str] = {}
    for key in ("second", "first"):
        for channel in "XYZ":
            name = f"campbell_{key}_{channel}"
            found[name] = shown_picture(results[key] / f"campbell_{channel}.png", f"{name}.png")
    for key in ("second", "firing", "first"):
        found[f"spectra_{key}"] = shown_picture(results[key] / "spectra.png", f"spectra_{key}.png")
    found["envelope"] = shown_picture(results["second"] / "envelope.png", "envelope_second.png")
    found["orders_change"] = shown_picture(results["change"] / "orders_change.png", "orders_change.png")
    drawn = {"task5": ("polar",), "msu-standard": ("harmonics",), "reverse-cranks": ("force",)}
    hinges = ("hinges_fig3_ac", "hinges_fig3_bd", "hinges_fig5_bcd", "guides_fig5_bcd")
    for engine, names in {**drawn, "elastic-hinge": hinges}.items():
        crankorder("balance", engine, "--out", str(scratch / engine))
        for name in names:
            found[name] = shown_picture(scratch / engine / f"{name}.png", f"{name}.png")
    return found


# ---- the page

NATURAL_HZ = (60, 115, 172, 187, 230, 350, 457, 470)
"""Section 5.1 and conclusion 1: natural frequencies of the second configuration between 0 and 500 Hz."""
ORDERS = {0.5: 16, 1: 33, 2: 66, 3: 100, 4: 133, 5.5: 183, 8: 266, 10: 333}
"""Sections 5.1, 5.2 and conclusion 2: orders and their frequencies (Hz) at 2000 rpm as printed."""
RATIOS = {1: (0.0000846, 0.0000195), 2: (0.0000648, 0.0000174)}
"""Section 5.3: printed responses along Z at 2000 rpm (m/s²) of the first and the second configuration."""


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [_row(heads), _row(["---"] * len(heads)), *(_row(row) for row in rows), ""]


def _numbers(*places: str) -> list[str]:
    """Rows of ``reports/sources.toml`` of document 001 whose place begins with one of ``places``."""
    rows = []
    for document, (place, what, unit, _, _, printed, truth), ours in source_rows():
        if document == "001" and place.startswith(places):
            mark = "" if not truth else " ✓" if agrees(ours, truth) else " ✗"
            rows.append([place, what, f"{shown(ours)} {unit}".strip(), _minus(printed), _minus(truth) + mark])
    return _table(("place", "what", "ours", "printed", "truth"), rows)


def _modes(found: dict[str, Any]) -> list[str]:
    rows = []
    for printed in NATURAL_HZ:
        near = [mode for mode in found["modes"] if abs(mode["frequency_hz"] - printed) < 0.02 * printed]
        best = min(near, key=lambda mode: abs(mode["frequency_hz"] - printed), default=None)
        if best is None:
            rows.append([f"{printed} Hz", "not found", "", ""])
            continue
        low, high = best["frequency_hz_ci95"]
        damping = "–" if best["damping_ratio"] is None else f"{100 * best['damping_ratio']:.2f} %"
        what = best["undecided"] or best["explained_by"]
        rows.append([f"{printed} Hz", f"{best['frequency_hz']:.2f} Hz ({low:.2f}…{high:.2f})", damping, what])
    return _table(("printed, and truth of the scene", "ours (95 %)", "damping ratio", "taken for"), rows)


def _orders(found: dict[str, Any]) -> list[str]:
    rows = []
    for order, printed in ORDERS.items():
        lines = {
            one["channel"]: one
            for one in found["orders"]
            if one["order"] is not None and abs(one["order"] - order) < 0.02 and one["channel"] in "XYZ"
        }
        seen = "".join(sorted(lines))
        ranges = [one["speed_range_rpm"] for one in lines.values() if one["speed_range_rpm"]]
        where = f"{min(low for low, _ in ranges):.0f}…{max(high for _, high in ranges):.0f} rpm" if ranges else "–"
        causes = sorted({str(one["explained_by"]) for one in lines.values() if one["explained_by"]})
        rows.append(
            [f"{order:g}", f"{printed} Hz", f"{order * 2000 / 60:.2f} Hz", seen or "–", where, "; ".join(causes) or "–"]
        )
    heads = ("order", "printed at 2000 rpm", "true", "seen in", "seen at", "explained by")
    return _table(heads, rows)


def _first_to_second(results: Mapping[str, Path]) -> list[str]:
    first, second = (amplitudes(results[key], "Z", 2000.0) for key in ("first", "compared"))
    rows = []
    for order, (before, after) in RATIOS.items():
        ours = first[order] / second[order]
        rows.append(
            [f"{order}", f"{before:.3g} → {after:.3g}", f"{before / after:.2f}",
             f"{first[order]:.3g} → {second[order]:.3g}", f"{ours:.2f}"]
        )  # fmt: skip
    heads = ("order along Z, 2000 rpm", "printed, m/s²", "falls printed, times", "ours, m/s²", "falls ours, times")
    lines = _table(heads, rows)
    for name, values in (("first", first), ("second", second)):
        printed = RATIOS[2][name == "second"] / RATIOS[1][name == "second"]
        ours = values[2] / values[1]
        lines.append(f"* Second over first order in the {name} configuration: printed {printed:.2f}, ours {ours:.1f}.")
    return [*lines, ""]


def _firing(results: Mapping[str, Path]) -> list[str]:
    rows = []
    for channel in "XYZ":
        still, fires = (amplitudes(results[key], channel, 2000.0) for key in ("second", "firing"))
        both = sorted(set(still) & set(fires))
        half = f"{fires[0.5]:.3g} m/s²" if 0.5 in fires else "–"
        rows.append(
            [channel, half, *(f"{fires[k] / still[k]:.3g}" if k in both else "–" for k in (1.0, 2.0, 3.0, 4.0))]
        )
    heads = ("axis", "order 0.5 (16.67 Hz, printed 16)", *(f"order {k}: firing over motoring" for k in (1, 2, 3, 4)))
    halves = [one for one in findings(results["firing"])["orders"] if abs(one["order"] - 0.5) < 0.01]
    said = [f"> {one['channel']}, order {one['order']:.3f}: {one['explained_by']}; {one['evidence']}" for one in halves]
    return [*_table(heads, rows), "\n>\n".join(said), ""]


def _compare(result: Path) -> list[str]:
    said = json.loads((result / "comparison.json").read_bytes())
    confounds = [one for one in said["confounds"] if one["severity"] != "harmless"]
    rows = [[one["what"], str(one["base"]), str(one["new"]), one["words"]] for one in confounds]
    return [
        *[f"> {line}" for line in said["headline"]],
        "",
        'What else differed, and weakens it (the thesis: "this direct comparison should not be made"):',
        "",
        *_table(("what", "first", "second", "why it matters"), rows),
    ]


def _balance(found: dict[str, Any]) -> list[str]:
    told = found["balance"]
    if told is None:
        return [f"No grams are told: {'; '.join(found['balance_reason'])}.", ""]
    rows = []
    for key, what in (("residual_reciprocating_g", "reciprocating mass left, order 1"),
                      ("residual_second_order_g", "the same by order 2")):  # fmt: skip
        if told[key] is not None:
            low, high = told[f"{key}_ci95"]
            rows.append([what, f"{told[key]:.1f} g ({low:.1f}…{high:.1f})", "116 g"])
    return _table(("", "ours (95 %)", "printed, and truth of the scene"), rows)


def _speeds(found: dict[str, Any]) -> list[str]:
    rows = [
        [f"{one['rpm']:.0f} rpm ({one['rpm_range'][0]:.0f}…{one['rpm_range'][1]:.0f})", one["reason"],
         "–" if one["amplification"] is None else f"{one['amplification']:.0f}-fold"]
        for one in found["speeds_to_avoid"]
    ]  # fmt: skip
    return _table(("avoid", "why", "raised"), rows) if rows else ["None is named.", ""]


def _five_and_a_half(found: dict[str, Any]) -> list[str]:
    said = [one for one in found["bearings"] if abs((one.get("order") or 0) - 5.5) < 0.02]
    return [f"> {one['name']}, {one['line']}: {one['verdict']}" for one in said[:1]] + [""]


def page(results: Mapping[str, Path], shows: Mapping[str, str]) -> str:
    """The template, its fields filled. ``results``: folders by key; ``shows``: Markdown of each picture by name."""
    second = findings(results["second"])
    fields = {
        "table 1": _numbers("table 1"),
        "table 2": _numbers("table 2", "(5)", "(6)", "(7)", "(8)", "section 3.1.1", "figure 12"),
        "table 3": _numbers("table 3", "section 3.1.2", "figure 14"),
        "rod": _numbers("figure 15", "figures 8", "figure 20", "figures 15", "section 3.3.1"),
        "modes": _modes(second),
        "orders": _orders(second),
        "bearing": _five_and_a_half(second),
        "balance": _balance(second),
        "speeds": _speeds(second),
        "firing": _firing(results),
        "ratios": _first_to_second(results),
        "compare": _compare(results["change"]),
        **{f"picture {name}": [markdown] for name, markdown in shows.items()},
    }
    text = TEMPLATE.read_text(encoding="utf-8")
    for name, lines in fields.items():
        text = text.replace("{{" + name + "}}", "\n".join(lines))
    assert "{{" not in text, text[text.index("{{") :][:80]
    return text


def main() -> None:
    """Write what is asked for."""
    reader = argparse.ArgumentParser(description=__doc__)
    reader.add_argument("--results", type=Path, help="keep the campaigns here, and use them again")
    reader.add_argument("--tables-only", action="store_true", help="only the tables of docs/sources.md")
    asked = reader.parse_args()
    SOURCES.write_text(with_tables(SOURCES.read_text(encoding="utf-8"), tables()), encoding="utf-8")
    if asked.tables_only:
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = asked.results or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        results = make_results(folder)
        PAGE.write_text(page(results, pictures(results, Path(scratch))), encoding="utf-8")


if __name__ == "__main__":
    main()
