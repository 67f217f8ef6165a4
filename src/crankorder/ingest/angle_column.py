"""Reading samples by crank angle: a column in which the file states the angle must agree with the manifest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from crankorder.errors import InputError, printable
from crankorder.ingest.formats import contents_of, read_file
from crankorder.ingest.manifest import Manifest
from crankorder.ingest.rawfile import RawFile, Source, named
from crankorder.ingest.roles import MOST_SAMPLES, angle_columns, angle_step
from crankorder.quantities import Floats
from crankorder.settings import IngestSettings


def read_checked(
    path: Path, manifest: Manifest, *, sources: Sequence[Source], settings: IngestSettings, rows: slice | None = None
) -> RawFile:
    """Columns of the file at ``path`` that ``sources`` ask for, as ``formats.read_file`` reads them.

    By crank angle the columns of angle that the file holds beside them are held against ``manifest``; ``settings`` and
    ``rows`` are those of that function. Raises what it raises, and InputError where such a column contradicts.
    """
    if manifest.sampling.domain == "time":
        return read_file(path, sources=sources, settings=settings, rows=rows)
    contents = contents_of(path, settings=settings)
    asked = [named(source, contents.names, path) for source in sources]
    alike = {(contents.samples.get(name), contents.rates_hz.get(name)) for name in asked}
    degrees = {
        name: factor
        for name, factor in angle_columns(contents).items()
        if name not in asked and (contents.samples.get(name), contents.rates_hz.get(name)) in alike
    }
    raw = read_file(path, sources=[*sources, *degrees], settings=settings, rows=rows)
    for name, factor in degrees.items():
        _refuse_contradiction(
            name,
            raw.columns[name][:MOST_SAMPLES] * np.float64(factor),
            manifest,
            path,
            is_start=not (rows and rows.start),
        )
    return raw


def _refuse_contradiction(name: str, angle_deg: Floats, manifest: Manifest, path: Path, *, is_start: bool) -> None:
    """Refuse a manifest with another step or start than the column ``angle_deg`` (sample,), if it is one of angles."""
    step_deg = angle_step(angle_deg)
    if step_deg is None:
        return
    sampling, steps = manifest.sampling, angle_deg.size - 1
    wide = np.ptp(angle_deg) > 360.0 + 1.5 * step_deg  # else the column does not tell one turn of a cycle from another
    period_deg = 360.0 * (manifest.revs_per_cycle if wide else 1)
    first_deg, per_rev = float(angle_deg[0]), sampling.samples_per_rev or 0
    off_deg = (first_deg - sampling.start_deg + period_deg / 2.0) % period_deg - period_deg / 2.0
    if abs(per_rev * step_deg / 360.0 - 1.0) * steps > 0.5:  # half a sample by the end of the record
        key, stated, told = "samples_per_rev", float(per_rev), 360.0 / step_deg
    elif is_start and abs(off_deg) > 0.5 * step_deg:
        key, stated, told = "start_deg", sampling.start_deg, first_deg
    else:
        return
    raise InputError(
        f"the manifest contradicts the file's column of crank angles {printable(name, 60)}",
        file=path,
        place=f"sampling.{key}",
        found=f"{stated:.9g}",
        allowed=f"{told:.6g}, as the column says",
        remedy=f"Find out which is right: mend {key}, or export the column with angles from top dead centre",
    )
