"""The balance of an engine file: one document, its text, and a folder with pictures and NetCDF.

Pictures and NetCDF are imported where they are made: a look at the numbers needs neither.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crankorder.batch.result_folder import publish
from crankorder.batch.store import text_sha256
from crankorder.engine.balance_data import BalancedEngine, load_balanced_engine
from crankorder.engine.balance_sheet import balance_sheet
from crankorder.engine.hinge_sheet import hinge_sheet
from crankorder.engine.hinged_crank import HingedEngine, load_hinged_engine
from crankorder.errors import RequestError
from crankorder.report.balance.text import balance_text, hinge_text
from crankorder.settings import ReportSettings, load_settings, toml_table

if TYPE_CHECKING:
    import xarray as xr

HINGED = "elastic-hinge"
"""``kind`` of an engine file that describes mechanisms with elastic hinges."""


@dataclass(frozen=True, kw_only=True)
class Balance:
    """An engine, what was asked of it, and the document that answers."""

    subject: BalancedEngine | HingedEngine
    max_order: int
    speeds_rpm: tuple[float, ...] | None
    document: dict[str, Any]


def balance_of(engine: str, *, max_order: int, speeds_rpm: Sequence[float] = ()) -> Balance:
    """Balance of an engine file: counterweights and shafts, or the hinges of a file of that kind.

    ``engine``: a shipped file's name or the path of a TOML file. ``max_order``: highest order, ≥ 4. ``speeds_rpm``:
    crank speeds, > 0; the file's where empty.
    Raises RequestError where there is no such file, ManyErrors with every fault of its content.
    """
    speeds = tuple(speeds_rpm) or None
    table, source = toml_table(engine, "engines")
    if table.get("kind") == HINGED:
        hinged = load_hinged_engine(engine)
        with np.errstate(over="ignore", invalid="ignore"):
            document = hinge_sheet(hinged, max_order=max_order, speeds_rpm=speeds)
        return Balance(subject=hinged, max_order=max_order, speeds_rpm=speeds, document=_finite(document, source))
    subject = load_balanced_engine(engine)
    with np.errstate(over="ignore", invalid="ignore"):  # told once, and by name of the file
        try:
            document = balance_sheet(subject, max_order=max_order, speeds_rpm=speeds)
        except RequestError as error:  # of the engine, whose file the sheet does not know
            told = {key: getattr(error, key) for key in ("place", "found", "allowed", "remedy")}
            raise RequestError(error.problem, file=error.file or source, **told) from None
    speeds = speeds or subject.balance.speeds_rpm
    return Balance(subject=subject, max_order=max_order, speeds_rpm=speeds, document=_finite(document, source))


def _finite(document: dict[str, Any], source: str) -> dict[str, Any]:
    """The ``document``; RequestError where a mass or length of the file is so large that a number of it overflows."""
    try:
        json.dumps(document, allow_nan=False)
    except ValueError:
        remedy = "Look for masses, lengths or speeds with a wrong unit"
        raise RequestError("its numbers are too large to be computed with", file=source, remedy=remedy) from None
    return document


def document_text(balance: Balance) -> str:
    """The document of ``balance`` as JSON: every digit of a number, so that it can be compared with other programs."""
    return json.dumps(balance.document, ensure_ascii=False, allow_nan=False, indent=2)


def table_text(balance: Balance) -> str:
    """Tables and sentences of ``balance`` for a terminal."""
    text = hinge_text if isinstance(balance.subject, HingedEngine) else balance_text
    return text(balance.document)


def publish_balance(balance: Balance, out: Path, *, report: dict[str, Any] | None = None) -> list[Path]:
    """Paths of the files written into ``out``: balance.json, pictures, balance.nc; whole or not at all.

    ``balance`` as :func:`balance_of` makes it; ``report``: settings of the report by key, before the defaults. Raises
    EnvironmentFailure where the folder cannot be written.
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
    attrs = {"title": str(balance.document["engine"]), "source": f"crankorder {version('crankorder')}"}
    files["balance.nc"] = results_bytes(groups, attrs=attrs)
    publish(out, files, key=text_sha256(version("crankorder"), document))
    return [out / name for name in files]


Parts = tuple[dict[str, "xr.Dataset"], dict[str, Callable[[], Any]]]
"""Datasets by group, and by name what makes each picture."""


def _of_engine(balance: Balance, settings: ReportSettings) -> Parts:
    from crankorder.report.balance.bars_figure import order_bars_figure
    from crankorder.report.balance.cycle_figures import cycle_dataset, loads_figure, torque_figure
    from crankorder.report.balance.dataset import balance_dataset
    from crankorder.report.balance.figures import force_figure
    from crankorder.report.balance.polar_figure import harmonics_figure, polar_figure
    from crankorder.report.netcdf import as_stored

    subject, document, speeds = balance.subject, balance.document, balance.speeds_rpm
    assert isinstance(subject, BalancedEngine)
    assert speeds is not None
    groups = {"balance": balance_dataset(subject, document, max_order=balance.max_order, speeds_rpm=speeds)}
    cycle = document["cycle"]
    if cycle is not None:
        groups["cycle"] = cycle_dataset(subject.engine, speeds)
    shown = as_stored(groups)
    asked: dict[str, Any] = {"title": str(document["engine"]), "settings": settings}
    figures: dict[str, Callable[[], Any]] = {
        "polar": partial(polar_figure, shown["balance"], **asked),
        "force": partial(force_figure, shown["balance"], **asked),
        "orders": partial(order_bars_figure, shown["balance"], **asked),
        "harmonics": partial(harmonics_figure, shown["balance"], **asked),
    }
    if cycle is not None:
        figures["torque"] = partial(torque_figure, shown["cycle"], cycle["turning"], **asked)
    if cycle is not None and cycle["loads"] is not None:
        figures["loads"] = partial(loads_figure, shown["cycle"], **asked)
    return groups, figures


def _of_hinges(balance: Balance, settings: ReportSettings) -> Parts:
    from crankorder.batch.plan import folder_name
    from crankorder.report.balance.hinge_figure import guide_figure, hinge_figure

    engine = balance.subject
    assert isinstance(engine, HingedEngine)
    figures: dict[str, Callable[[], Any]] = {}
    groups: dict[str, xr.Dataset] = {}
    taken: set[str] = set()
    for mechanism, found in zip(engine.mechanisms, balance.document["mechanisms"], strict=True):
        speeds = balance.speeds_rpm or mechanism.speeds_rpm
        name = folder_name(mechanism.name, taken)
        figures[f"hinges_{name}"] = partial(hinge_figure, engine, mechanism, speeds, settings=settings)
        if mechanism.pin_guides is not None or mechanism.strut_guides is not None:
            figures[f"guides_{name}"] = partial(guide_figure, engine, mechanism, max(speeds), settings=settings)
        groups |= {f"{joint}_{name}": _characteristic(table) for joint, table in found["characteristic"].items()}
    return groups, figures


def _characteristic(table: dict[str, Any]) -> xr.Dataset:
    import xarray as xr

    units = {"crank_angle_deg": "degree", "moment_nm": "N m", "work_j": "J"}
    return xr.Dataset(
        {key: ("hinge_angle_deg", table[key], {"units": unit}) for key, unit in units.items()},
        coords={"hinge_angle_deg": ("hinge_angle_deg", table["hinge_angle_deg"], {"units": "degree"})},
        attrs={"speed_rpm": table["speed_rpm"]},
    )
