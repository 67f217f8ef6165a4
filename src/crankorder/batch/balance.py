"""The balance of an engine file: one document, its text, and a folder with pictures and NetCDF.

Pictures and NetCDF are imported where they are made: a look at the numbers needs neither.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crankorder.batch.result_folder import publish
from crankorder.batch.store import text_sha256
from crankorder.engine.balance_data import BalancedEngine, load_balanced_engine
from crankorder.engine.balance_sheet import balance_sheet
from crankorder.engine.elastic_hinge import hinge_sheet
from crankorder.engine.hinged_crank import HingedEngine, load_hinged_engine
from crankorder.errors import located
from crankorder.report.balance_sentences import balance_sentences, hinge_sentences
from crankorder.report.balance_text import balance_text, hinge_text
from crankorder.settings import ReportSettings, load_settings, toml_table

if TYPE_CHECKING:
    import xarray as xr

HINGED = "elastic-hinge"
"""``kind`` of an engine file that describes mechanisms with elastic hinges."""


@dataclass(frozen=True, kw_only=True)
class Balance:
    """An engine, what was asked of it, and the sheet that answers."""

    subject: BalancedEngine | HingedEngine
    max_order: int
    speeds_rpm: tuple[float, ...] | None
    sheet: dict[str, Any]


def balance_of(engine: str, *, max_order: int, speeds_rpm: Sequence[float] = ()) -> Balance:
    """Balance of an engine file: counterweights and shafts, or the hinges of a file of that kind.

    Parameters
    ----------
    engine : name of a shipped file, or path of a TOML file
    max_order : highest order, 4 or more
    speeds_rpm : crank speeds, rpm, above 0; those of the file where empty

    Raises RequestError where there is no such file, ManyErrors with every fault of its content.
    """
    speeds = tuple(speeds_rpm) or None
    table, source = toml_table(engine, "engines")
    subject: BalancedEngine | HingedEngine
    if table.get("kind") == HINGED:
        subject = load_hinged_engine(engine)
        sheet = hinge_sheet(subject, max_order=max_order, speeds_rpm=speeds)
        sheet["sentences"] = hinge_sentences(sheet)
    else:
        subject = load_balanced_engine(engine)
        with located(source):
            sheet = balance_sheet(subject, max_order=max_order, speeds_rpm=speeds)
            sheet["sentences"] = balance_sentences(sheet)
        speeds = speeds or subject.balance.speeds_rpm
    return Balance(subject=subject, max_order=max_order, speeds_rpm=speeds, sheet=sheet)


def document_text(balance: Balance) -> str:
    """The sheet of ``balance`` as ASCII JSON: every digit of a number, to be compared with other programs."""
    return json.dumps(balance.sheet, allow_nan=False, indent=2)


def table_text(balance: Balance, *, whole: bool = False) -> str:
    """Sentences of ``balance`` for a terminal, on one screen; ``whole``: all its tables too."""
    text = hinge_text if isinstance(balance.subject, HingedEngine) else balance_text
    return text(balance.sheet, whole=whole)


def publish_balance(balance: Balance, out: Path, *, report: Mapping[str, object] | None = None) -> list[Path]:
    """Paths of the files written into ``out``: balance.json, pictures, balance.nc; whole or not at all.

    ``balance`` is that of :func:`balance_of`, ``report`` has settings of the report by key, in place of the defaults.
    Raises EnvironmentFailure where the folder cannot be written.
    """
    from crankorder.plot.painter import picture_bytes
    from crankorder.report.netcdf import results_bytes

    settings = load_settings(asked={"report": report or {}}).report
    groups, figures = (_of_hinges if isinstance(balance.subject, HingedEngine) else _of_engine)(balance, settings)
    document, kind = document_text(balance), settings.picture_format
    files = {"balance.json": f"{document}\n".encode("utf-8", "backslashreplace")}
    if settings.pictures:
        for name, figure in figures.items():
            files[f"{name}.{kind}"] = picture_bytes(figure(), dpi=settings.dpi, kind=kind)
    attrs = {"title": balance.sheet["engine"], "source": f"crankorder {version('crankorder')}"}
    files["balance.nc"] = results_bytes(groups, attrs=attrs)
    publish(out, files, key=text_sha256(version("crankorder"), document))
    return [out / name for name in files]


Parts = tuple[dict[str, "xr.Dataset"], dict[str, Callable[[], Any]]]
"""Datasets by group, and by name what draws each picture."""


def _of_engine(balance: Balance, settings: ReportSettings) -> Parts:
    from crankorder.report import balance_figures as drawn
    from crankorder.report.balance_dataset import balance_dataset, cycle_dataset
    from crankorder.report.netcdf import as_stored

    subject, sheet, speeds = balance.subject, balance.sheet, balance.speeds_rpm
    cycle = sheet["cycle"]
    assert isinstance(subject, BalancedEngine)
    assert speeds is not None
    groups = {"balance": balance_dataset(subject, sheet, max_order=balance.max_order, speeds_rpm=speeds)}
    if cycle is not None:
        groups["cycle"] = cycle_dataset(subject.engine, speeds)
    shown = as_stored(groups)
    of_forces = {
        "polar": drawn.polar_figure,
        "force": drawn.force_figure,
        "orders": drawn.order_bars_figure,
        "harmonics": drawn.harmonics_figure,
    }
    figures = {name: partial(figure, shown["balance"]) for name, figure in of_forces.items()}
    if cycle is not None:
        figures["torque"] = partial(drawn.torque_figure, shown["cycle"], cycle["turning"])
        if cycle["loads"] is not None:
            figures["loads"] = partial(drawn.loads_figure, shown["cycle"])
    return groups, {name: partial(one, title=sheet["engine"], settings=settings) for name, one in figures.items()}


def _of_hinges(balance: Balance, settings: ReportSettings) -> Parts:
    import xarray as xr

    from crankorder.batch.plan import folder_name
    from crankorder.report.balance_figures import guide_figure, hinge_figure

    engine, sheet = balance.subject, balance.sheet
    assert isinstance(engine, HingedEngine)
    figures: dict[str, Callable[[], Any]] = {}
    groups: dict[str, xr.Dataset] = {}
    taken: set[str] = set()
    units = {"crank_angle_deg": "degree", "moment_nm": "N m", "work_j": "J"}
    for data, mechanism in zip(engine.mechanisms, sheet["mechanisms"], strict=True):
        speeds = balance.speeds_rpm or data.speeds_rpm
        name = folder_name(data.name, taken)
        figures[f"hinges_{name}"] = partial(hinge_figure, engine, data, speeds, settings=settings)
        if data.pin_guides is not None or data.strut_guides is not None:
            figures[f"guides_{name}"] = partial(guide_figure, engine, data, max(speeds), settings=settings)
        for joint, hinge in mechanism["characteristic"].items():
            variables = {key: ("hinge_angle_deg", hinge[key], {"units": unit}) for key, unit in units.items()}
            angle = {"hinge_angle_deg": ("hinge_angle_deg", hinge["hinge_angle_deg"], {"units": "degree"})}
            groups[f"{joint}_{name}"] = xr.Dataset(variables, coords=angle, attrs={"speed_rpm": hinge["speed_rpm"]})
    return groups, figures
