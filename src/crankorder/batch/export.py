"""Export: results that exist as files of other programs, whole or not at all."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

from crankorder.batch.compare import refuse_results
from crankorder.batch.result_folder import publish, read_document, result_folders
from crankorder.batch.store import file_sha256, text_sha256
from crankorder.errors import RequestError
from crankorder.interchange.export import csv_bytes, parquet_bytes, tables_of, uff58_bytes
from crankorder.report.netcdf import published, read_results

FORMATS = ("uff58", "csv", "parquet")


def export_results(result: Path, out: Path, *, to: str, binary: bool = False) -> list[Path]:
    """Paths of the files written into ``out``, a folder ``<test>-<format>`` for each test of ``result``.

    ``result``: a ``results.nc``, the folder of a test, or the whole ``--out`` of a run. ``to``: "uff58" makes
    ``results.uff`` (``binary``: 58b), "csv" and "parquet" a file for each table (Parquet also of the maps).
    Raises RequestError where there are no results, where ``to`` is none of these or ``out`` holds results of a run;
    InputError where results are damaged.
    """
    if to not in FORMATS:
        raise RequestError("no such format", file="export", place="to", found=to, allowed=", ".join(FORMATS))
    if binary and to != "uff58":
        raise RequestError("only universal files have a binary form", file="export", place="binary", found=to)
    folders = result_folders(result)
    refuse_results(out, folders)
    written: list[Path] = []
    for folder in folders:
        files = _files(folder, to, binary)
        key = text_sha256(version("crankorder"), to, str(binary), file_sha256(folder / "results.nc"))
        publish(out / f"{folder.name}-{to}", files, key=key)
        written += [out / f"{folder.name}-{to}" / name for name in files]
    return written


def _files(folder: Path, to: str, binary: bool) -> dict[str, bytes]:
    test = str(read_document(folder / "run.json").get("test", folder.name))
    groups = read_results(folder / "results.nc")
    if to == "uff58":
        if not {"order_tracks", "order_map", "campbell_map"} & set(groups):
            found = ", ".join(sorted(groups)) or "no group"
            raise RequestError("holds no orders and no map", file=folder / "results.nc", found=found)
        return {"results.uff": uff58_bytes(groups, test=test, binary=binary)}
    tables = tables_of({name: published(dataset) for name, dataset in groups.items()}, maps=to == "parquet")
    if not tables:
        raise RequestError("holds nothing to put into a table", file=folder / "results.nc")
    written = csv_bytes if to == "csv" else parquet_bytes
    return {f"{name}.{to}": written(columns) for name, columns in tables.items()}
