"""The balance of an engine file: one document, its text, and a folder with pictures and NetCDF.

Pictures and NetCDF are imported where they are made: a look at the numbers needs neither.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
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
            raise _in_file(error, source) from None
    speeds = speeds or subject.balance.speeds_rpm
    return Balance(subject=subject, max_order=max_order, speeds_rpm=speeds, document=_finite(document, source))


def _in_file(error: RequestError, source: str) -> RequestError:
    told = {key: getattr(error, key) for key in ("place", "found", "allowed", "remedy")}
    return RequestError(error.problem, file=error.file or source, **told)


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
    settings = load_settings(asked={"report": report or {}}).report
    draw = _hinge_files if isinstance(balance.subject, HingedEngine) else _engine_files
    document = document_text(balance)
    files = {"balance.json": f"{document}\n".encode("utf-8", "backslashreplace"), **draw(balance, settings)}
    publish(out, files, key=text_sha256(version("crankorder"), document))
    return [out / name for name in files]


def _engine_files(balance: Balance, settings: ReportSettings) -> dict[str, bytes]:
    from crankorder.plot.drawing import picture_bytes
    from crankorder.report.balance.bars_figure import order_bars_figure
    from crankorder.report.balance.dataset import balance_dataset
    from crankorder.report.balance.figures import force_figure
    from crankorder.report.balance.polar_figure import harmonics_figure, polar_figure
    from crankorder.report.netcdf import as_stored, results_bytes

    subject = balance.subject
    assert isinstance(subject, BalancedEngine)
    assert balance.speeds_rpm is not None
    title = str(balance.document["engine"])
    dataset = balance_dataset(subject, balance.document, max_order=balance.max_order, speeds_rpm=balance.speeds_rpm)
    groups = {"balance": dataset}
    shown = as_stored(groups)["balance"]
    pictures = {
        "polar": polar_figure,
        "force": force_figure,
        "orders": order_bars_figure,
        "harmonics": harmonics_figure,
    }
    kind = settings.picture_format
    made = {
        f"{name}.{kind}": picture_bytes(draw(shown, title=title, settings=settings), dpi=settings.dpi, kind=kind)
        for name, draw in pictures.items()
        if settings.pictures
    }
    if balance.document["cycle"] is not None:
        groups["cycle"], of_cycle = _cycle(balance, subject, settings)
        made |= of_cycle
    return {**made, "balance.nc": results_bytes(groups, attrs=_attrs(balance))}


def _cycle(balance: Balance, subject: BalancedEngine, settings: ReportSettings) -> tuple[xr.Dataset, dict[str, bytes]]:
    """Torques and loads of an engine over its cycle, and their pictures by file name."""
    from crankorder.plot.drawing import picture_bytes
    from crankorder.report.balance.cycle_figures import cycle_dataset, loads_figure, torque_figure
    from crankorder.report.netcdf import as_stored

    assert balance.speeds_rpm is not None
    cycle, title, kind = balance.document["cycle"], str(balance.document["engine"]), settings.picture_format
    dataset = cycle_dataset(subject.engine, balance.speeds_rpm)
    if not settings.pictures:
        return dataset, {}
    shown = as_stored({"cycle": dataset})["cycle"]
    figures = {"torque": torque_figure(shown, cycle["turning"], title=title, settings=settings)}
    if cycle["loads"] is not None:
        figures["loads"] = loads_figure(shown, title=title, settings=settings)
    return dataset, {f"{name}.{kind}": picture_bytes(one, dpi=settings.dpi, kind=kind) for name, one in figures.items()}


def _hinge_files(balance: Balance, settings: ReportSettings) -> dict[str, bytes]:
    from crankorder.batch.plan import folder_name
    from crankorder.plot.drawing import picture_bytes
    from crankorder.report.balance.hinge_figure import guide_figure, hinge_figure
    from crankorder.report.netcdf import results_bytes

    engine = balance.subject
    assert isinstance(engine, HingedEngine)
    made: dict[str, bytes] = {}
    groups: dict[str, xr.Dataset] = {}
    taken: set[str] = set()
    for mechanism, found in zip(engine.mechanisms, balance.document["mechanisms"], strict=True):
        speeds = balance.speeds_rpm or mechanism.speeds_rpm
        name = folder_name(mechanism.name, taken)
        if settings.pictures:
            figure, kind = hinge_figure(engine, mechanism, speeds, settings=settings), settings.picture_format
            made[f"hinges_{name}.{kind}"] = picture_bytes(figure, dpi=settings.dpi, kind=kind)
            if mechanism.pin_guides is not None or mechanism.strut_guides is not None:
                cut = guide_figure(engine, mechanism, max(speeds), settings=settings)
                made[f"guides_{name}.{kind}"] = picture_bytes(cut, dpi=settings.dpi, kind=kind)
        groups |= {f"{joint}_{name}": _characteristic(table) for joint, table in found["characteristic"].items()}
    return {**made, "balance.nc": results_bytes(groups, attrs=_attrs(balance))}


def _characteristic(table: dict[str, Any]) -> xr.Dataset:
    import xarray as xr

    units = {"crank_angle_deg": "degree", "moment_nm": "N m", "work_j": "J"}
    return xr.Dataset(
        {key: ("hinge_angle_deg", table[key], {"units": unit}) for key, unit in units.items()},
        coords={"hinge_angle_deg": ("hinge_angle_deg", table["hinge_angle_deg"], {"units": "degree"})},
        attrs={"speed_rpm": table["speed_rpm"]},
    )


def _attrs(balance: Balance) -> dict[str, str]:
    return {"title": str(balance.document["engine"]), "source": f"crankorder {version('crankorder')}"}
