"""The front door: what notebooks call. ``import crankorder as co`` loads each function when it is touched.

A Recording (``data_schema/recording.json``) comes from :func:`recording` or :func:`read`; every map, track and finding
is made from one or more of them, as ``crankorder run`` makes it from files.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from crankorder.batch.ahead import Helper
from crankorder.batch.balance import balance_of, publish_balance
from crankorder.batch.balance import document_text as balance_text
from crankorder.batch.campaign import run_plans
from crankorder.batch.changed_gains import without_changed_gains
from crankorder.batch.compare import compare_results, publish_comparison
from crankorder.batch.compare import document_text as comparison_text
from crankorder.batch.execute import Outcome, Progress, left_out_of, results_of_test, sources_of
from crankorder.batch.plan import plan_tests, up_to_stated
from crankorder.batch.store import DONE, json_bytes
from crankorder.engine.definition import Engine, load_engine
from crankorder.errors import CrankorderError, InputError, NoUsableRecordingError, RequestError
from crankorder.ingest.folder import recordings_of
from crankorder.ingest.manifest import Manifest, load_manifest, manifest_of
from crankorder.ingest.rawfile import RawFile, Source
from crankorder.ingest.recording import read_recording, recording_of
from crankorder.quantities import check_dataset
from crankorder.report.netcdf import findings_datasets
from crankorder.settings import Settings, load_settings
from crankorder.shaft.knowledge import ShaftKnowledge
from crankorder.stages import RecordingResult, analyse_recording, analyse_shaft
from crankorder.synth.write import write_scene

Recordings = xr.Dataset | Sequence[xr.Dataset]
"""One Recording, or several of one test."""

Tables = Sequence[Mapping[str, Any]]
"""Tables of a manifest, such as its ``[[bearings]]``, with the manifest's keys."""

CALL = "crankorder.recording"


def recording(
    signals: ArrayLike | Mapping[str, ArrayLike],
    *,
    rate_hz: float | None = None,
    samples_per_rev: int | None = None,
    unit: str | Mapping[str, str] = "m/s2",
    pulse_times_s: ArrayLike | None = None,
    encoder: ArrayLike | None = None,
    speed_rpm: float | ArrayLike | None = None,
    pulses_per_rev: int | None = None,
    missing_teeth: int = 0,
    index: ArrayLike | None = None,
    index_to_tdc_deg: float | None = None,
    ratio: float = 1.0,
    cycle: str = "rotor",
    start_s: float = 0.0,
    start_deg: float = 0.0,
    name: str = "recording",
) -> xr.Dataset:
    """A Recording of arrays, checked as one of a file is: faults of the signals are mended, flagged or refused.

    Parameters
    ----------
    signals : channels by name, each (samples,); or an array (samples,) or (channels, samples)
    rate_hz : samples per second of signals, encoder and index; > 0
    samples_per_rev : samples per crank revolution instead, where they were taken by crank angle
    unit : of all channels, or of each by name: "m/s2", "g", "mm/s", "Pa", "bar", "N", "V" …
    pulse_times_s : times of the encoder's pulses, s, ascending
    encoder : the encoder's voltage, (samples,), instead
    speed_rpm : speed of the crank instead, a number or (samples,)
    pulses_per_rev : pulses per revolution of the whole wheel, missing teeth included
    missing_teeth : teeth that the wheel lacks in one gap
    index : the once-per-revolution mark: its times in s beside ``pulse_times_s``, its voltage beside ``encoder``
    index_to_tdc_deg : angle from the mark to top dead centre; without it phases refer to the mark
    ratio : encoder revolutions per crank revolution
    cycle : "four-stroke", "two-stroke", "rotor", or "none" of a structure without a shaft
    start_s, start_deg : time or crank angle of the first sample
    name : what flags and errors call the recording

    Without pulses, encoder and speed the crank angle is not known: frequencies can be told, orders not.
    Raises RequestError or ManyErrors where the arguments contradict each other, InputError where the data are damaged.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording({"housing": np.cos(2 * np.pi * 75.0 * time)}, rate_hz=1e4, speed_rpm=1500.0)
    >>> made["signal"].sizes["time"], made.attrs["rate_hz"]
    (40000, 10000.0)
    """
    columns, names = _columns(signals)
    told = {"pulse_times_s": pulse_times_s, "encoder": encoder, "speed_rpm": speed_rpm}
    given = [key for key, value in told.items() if value is not None]
    if len(given) > 1:
        problem = "the shaft is told in more than one way"
        raise RequestError(problem, file=CALL, found=", ".join(given), allowed=f"one of {', '.join(told)}")
    if (rate_hz is None) == (samples_per_rev is None):
        raise RequestError("state rate_hz, or samples_per_rev of samples by crank angle", file=CALL)
    table: dict[str, Any] = {"ratio": float(ratio)}
    places: dict[str, ArrayLike] = {}
    if pulse_times_s is not None or encoder is not None:
        places["source"] = pulse_times_s if pulse_times_s is not None else encoder  # type: ignore[assignment]
        table |= {"kind": "square" if pulse_times_s is None else "pulse_times", "missing_teeth": missing_teeth}
        table |= {} if pulses_per_rev is None else {"pulses_per_rev": pulses_per_rev}
        table |= {} if index_to_tdc_deg is None else {"index_to_tdc_deg": float(index_to_tdc_deg)}
        if index is not None:
            places["index"] = index
    elif speed_rpm is not None and np.ndim(speed_rpm) == 0:
        table |= {"kind": "constant", "speed_rpm": float(np.asarray(speed_rpm))}
    elif speed_rpm is not None:
        table["kind"] = "speed"
        places["source"] = speed_rpm
    for role, values in places.items():
        table[role] = len(columns)
        columns[len(columns)] = _column(values, role if role == "index" else given[0])
    units = {key: unit if isinstance(unit, str) else unit.get(key, "") for key in names}
    channels = [{"name": key, "source": place, "unit": units[key]} for place, key in enumerate(names)]
    by_angle = {"domain": "crank_angle", "samples_per_rev": samples_per_rev, "start_deg": float(start_deg)}
    sampling = by_angle if rate_hz is None else {"rate_hz": float(rate_hz)}
    stated = {**_head(name, cycle, channels), "sampling": sampling, "encoder": table}
    manifest = manifest_of(stated, Path(CALL), {})
    raw = RawFile(columns, units=dict(enumerate(units.values())), attrs={"start_s": float(start_s)})
    settings = load_settings()
    return recording_of(raw, Path(name), manifest, settings=settings.ingest, shaft=settings.shaft)


def read(path: str | os.PathLike[str], *, manifest: str | os.PathLike[str] | None = None) -> Any:
    """The Recording in the file ``path``; of a test-run folder a list of all of them, in their order.

    ``manifest``: a ``run.toml`` that lives elsewhere than beside the data (``crankorder init`` drafts one).
    What cannot be used of a folder is left out with a warning. Raises RequestError or ManyErrors where the manifest is
    wrong, InputError where a file is damaged or lacks what the manifest names.

    >>> import crankorder as co, tempfile
    >>> with tempfile.TemporaryDirectory() as work:
    ...     (folder,) = co.synthesise("hard-two-revolutions", work + "/test", quick=True)
    ...     recordings = co.read(folder)
    >>> [str(name) for name in recordings[0]["channel"].values]
    ['X', 'Y', 'Z']
    """
    given, elsewhere = Path(path), None if manifest is None else Path(manifest)
    folder = given if given.is_dir() else given.parent
    stated, settings = load_manifest(folder, elsewhere), load_settings()
    if not given.is_dir():
        return read_recording(given, stated, settings=settings.ingest, shaft=settings.shaft)
    found = recordings_of(folder, stated)
    _warn(found.faults)
    made = []
    for file in found.paths:
        try:
            made.append(read_recording(file, stated, settings=settings.ingest, shaft=settings.shaft))
        except InputError as error:
            _warn([error])
    return made


def crank_angle(recording: xr.Dataset, *, engine: str | None = None) -> xr.Dataset:
    """Crank angle (rev), speed (rpm) and standard error (rev) of ``recording`` on time knots (ShaftAngle).

    ``engine``: a shipped engine or the path of a TOML file, whose masses tell the swing within a cycle where the
    encoder has one pulse per revolution. Raises InputError where the pulses tell no angle.

    >>> import numpy as np, crankorder as co
    >>> turns = np.arange(0.0, 4.0, 1 / (25.0 * 60))
    >>> made = co.recording(np.zeros(4000), rate_hz=1000.0, pulse_times_s=turns, pulses_per_rev=60)
    >>> round(float(co.crank_angle(made)["speed"].mean()), 3)
    1500.0
    """
    check_dataset(recording, "recording")
    return analyse_shaft(recording, load_settings(), ShaftKnowledge(_engine(engine)))


def order_map(
    recordings: Recordings,
    *,
    max_order: float | None = None,
    revs_per_frame: int | None = None,
    speed_bin_rpm: float | None = None,
    tol: float | None = None,
    recipe: str | None = None,
) -> xr.Dataset:
    """Order spectra of ``recordings`` against speed (OrderMap): peak amplitude and phase, (channel, speed, order).

    ``max_order``: highest order. ``revs_per_frame``: orders are 1 / this apart. ``speed_bin_rpm``: frames whose speeds
    differ by less are averaged. ``tol``: relative amplitude error that the numerics may add, 1e-12 to 0.1. ``recipe``:
    a shipped recipe or the path of one, for all that is not given. Raises InputError where no recording can be used.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> round(float(co.order_map(made)["amplitude"].sel(order=3.0).item()), 3)
    2.0
    """
    orders = {"max_order": max_order, "revs_per_frame": revs_per_frame, "speed_bin_rpm": speed_bin_rpm}
    settings = _settings("order_map", recipe=recipe, orders={**orders, "tolerance": tol})
    return _made(recordings, settings)[0]["order_map"]


def campbell_map(
    recordings: Recordings,
    *,
    max_frequency_hz: float | None = None,
    resolution_hz: float | None = None,
    speed_bin_rpm: float | None = None,
    recipe: str | None = None,
) -> xr.Dataset:
    """Spectra of ``recordings`` against speed (CampbellMap): amplitude of a tone, (channel, speed, frequency).

    ``max_frequency_hz``: highest frequency. ``resolution_hz``: distance of two lines. ``speed_bin_rpm`` and ``recipe``
    are those of :func:`order_map`. Raises InputError where no recording can be used.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> spectrum = co.campbell_map(made, max_frequency_hz=200.0)["amplitude"].squeeze()
    >>> round(float(spectrum.frequency[spectrum.argmax("frequency")]), 3)
    75.0
    """
    campbell = {"max_frequency_hz": max_frequency_hz, "resolution_hz": resolution_hz}
    settings = _settings("campbell_map", recipe=recipe, campbell=campbell, orders={"speed_bin_rpm": speed_bin_rpm})
    return _made(recordings, settings)[0]["campbell_map"]


def order_tracks(
    recordings: Recordings,
    *,
    orders: Sequence[float] | None = None,
    method: str | None = None,
    recipe: str | None = None,
) -> xr.Dataset:
    """Amplitude and phase of ``orders`` of ``recordings`` against speed (OrderTracks), (channel, order, speed).

    ``orders``: those to follow; without them, those that are found. ``method``: "auto" (sweeps jointly by Vold–Kalman,
    steady speeds off the map), "frames", "least_squares" or "vold_kalman". ``recipe`` is that of :func:`order_map`.
    Raises InputError where no recording can be used.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> round(float(co.order_tracks(made, orders=[3.0])["amplitude"].item()), 3)
    2.0
    """
    results = ("order_map", "order_tracks", *(() if orders else ("campbell_map", "findings")))
    asked = {"track_orders": tuple(float(order) for order in orders or ()) or None, "track_method": method}
    return _made(recordings, _settings(*results, recipe=recipe, orders=asked))[0]["order_tracks"]


def envelope(recordings: Recordings, *, bearings: Tables = (), recipe: str | None = None) -> xr.Dataset:
    """Order spectra of the squared envelope of ``recordings`` (EnvelopeMap), in the band that shows strikes most.

    ``bearings``: what strikes are looked for, with the keys of the manifest's ``[[bearings]]``; at least one.
    ``recipe`` is that of :func:`order_map`. Raises InputError where no recording can be used.

    >>> import numpy as np, crankorder as co
    >>> rng, ring = np.random.default_rng(1), np.exp(-np.arange(60) / 15) * np.cos(1.9 * np.arange(60))
    >>> signal = np.convolve(np.arange(80_000) % 112 == 0, ring, "same") + 0.1 * rng.standard_normal(80_000)
    >>> made = co.recording(signal, rate_hz=10_000, speed_rpm=1500.0)  # a strike every 112 samples: order 3.57
    >>> shown = co.envelope(made, bearings=[{"name": "drive end", "bpfo": 3.58, "bpfi": 5.42}])["amplitude"].squeeze()
    >>> round(float(shown.order[shown.argmax("order")]), 2)
    3.58
    """
    if not bearings:
        raise RequestError("no bearing is named", file="crankorder.envelope", allowed="bearings=[{...}], one or more")
    settings = _settings("envelope_map", recipe=recipe)
    return _made(recordings, settings, tables={"bearings": bearings})[0]["envelope_map"]


def diagnose(
    recordings: Recordings,
    *,
    engine: str | None = None,
    bearings: Tables = (),
    gears: Tables = (),
    motor: Mapping[str, Any] | None = None,
    test: str = "test",
    recipe: str | None = None,
) -> dict[str, Any]:
    """What ``recordings`` of one test say, with intervals and evidence (``data_schema/findings.json``).

    ``engine``: a shipped engine or the path of a TOML file. ``bearings``, ``gears``, ``motor``: tables of the manifest,
    with its keys. ``test``: its name. ``recipe`` is that of :func:`order_map`. Raises ManyErrors where a table is
    wrong, InputError where no recording can be used.

    >>> import numpy as np, crankorder as co
    >>> rng, time = np.random.default_rng(1), np.arange(80_000) / 10_000.0
    >>> signal = 2.0 * np.cos(2 * np.pi * 75.0 * time) + 0.1 * rng.standard_normal(80_000)
    >>> found = co.diagnose(co.recording(signal, rate_hz=1e4, speed_rpm=1500.0))
    >>> [round(line["order"], 2) for line in found["orders"]]
    [3.0]
    """
    tables = {"bearings": bearings, "gears": gears, "motor": motor}
    settings = _settings("order_map", "campbell_map", "findings", recipe=recipe)
    return _made(recordings, settings, tables=tables, engine=engine, test=test)[1]


def run(
    tests: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | Recordings,
    *,
    out: str | os.PathLike[str] | None = None,
    manifest: str | os.PathLike[str] | None = None,
    engine: str | None = None,
    bearings: Tables = (),
    gears: Tables = (),
    motor: Mapping[str, Any] | None = None,
    test: str = "test",
    recipe: str | None = None,
    tol: float | None = None,
    jobs: int | None = None,
    fresh: bool = False,
    strict: bool = False,
) -> xr.DataTree:
    """Analyse ``tests`` as ``crankorder run`` does: the groups of ``results.nc``, findings among them.

    Folders are analysed by their manifests, or by ``manifest``, and their results written into ``out``; what comes back
    is :func:`open` of it. Recordings are analysed in memory and nothing is written; ``engine``, ``bearings``,
    ``gears``, ``motor`` and ``test`` say then what a manifest would. ``recipe`` and ``tol`` are those of
    :func:`order_map`; ``jobs`` recordings are analysed at a time (all cores); ``fresh`` recomputes what is finished;
    ``strict`` leaves out recordings with flags of severity "suspect".
    What had to be left out is told by warnings. Raises RequestError or ManyErrors before work starts where the request
    is wrong, NoUsableRecordingError where nothing could be used.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> sorted(co.run(made, recipe="maps").children)
    ['campbell_map', 'findings', 'order_map', 'shaft']
    """
    paths = [tests] if isinstance(tests, str | os.PathLike) else list(tests) if isinstance(tests, list | tuple) else []
    if paths and all(isinstance(path, str | os.PathLike) for path in paths):
        if out is None:
            raise RequestError("folders are analysed into a folder", file="crankorder.run", place="out")
        folders = [Path(os.fspath(path)) for path in paths if isinstance(path, str | os.PathLike)]
        elsewhere = None if manifest is None else Path(manifest)
        plans = plan_tests(folders, Path(out), manifest=elsewhere, recipe=recipe, tolerance=tol)
        _run_folders(plans, Path(out), jobs or os.cpu_count() or 1, fresh=fresh, strict=strict)
        return open(out)
    if out is not None or manifest is not None:
        problem = "recordings in memory have no manifest and write no file"
        raise RequestError(problem, file="crankorder.run", found="out" if out is not None else "manifest")
    settings = load_settings(recipe, asked={"orders": {} if tol is None else {"tolerance": tol}})
    tables = {"bearings": bearings, "gears": gears, "motor": motor}
    groups, findings = _made(tests, settings, tables=tables, engine=engine, test=test, strict=strict)  # type: ignore[arg-type]
    return xr.DataTree.from_dict({**groups, **findings_datasets(findings)}, name=test)


def open(path: str | os.PathLike[str]) -> xr.DataTree:
    """Results at ``path`` as a tree, read as they are touched: a ``results.nc``, a test's folder, or a whole ``--out``.

    Of several tests each is a branch. Raises RequestError where there are none.

    >>> import crankorder as co, tempfile
    >>> with tempfile.TemporaryDirectory() as work:
    ...     folders = co.synthesise("hard-two-revolutions", work + "/test", quick=True)
    ...     tree = co.run(folders, out=work + "/out", recipe="maps")
    ...     sorted(co.open(work + "/out")["order_map"].sizes)
    ['channel', 'order', 'speed']
    """
    given = Path(path)
    files = [file for file in (given, given / "results.nc") if file.is_file()]
    files = files or sorted(file for file in given.glob("*/results.nc") if (file.parent / DONE).is_file())
    if not files:
        allowed = "a results.nc, the folder of a test, or the --out of a run"
        raise RequestError("no finished results here", file=given, allowed=allowed)
    if len(files) == 1:
        return xr.open_datatree(files[0], engine="h5netcdf")
    tree = xr.DataTree(name=given.name)
    for file in files:
        tree[file.parent.name] = xr.open_datatree(file, engine="h5netcdf")
    return tree


def compare(
    base: str | os.PathLike[str],
    *new: str | os.PathLike[str],
    fdr: float = 0.05,
    any_dependence: bool = False,
    out: str | os.PathLike[str] | None = None,
) -> dict[str, Any]:
    """What changed from the results in ``base`` to the last of ``new`` (``data_schema/comparison.json``).

    Several ``new`` in time order give the trend over all. ``fdr``: the share of the claimed changes that may be
    chance, 0 to 0.5. ``any_dependence`` claims fewer map cells, however they depend. ``out``: a folder for page,
    pictures and NetCDF. Raises RequestError where a folder holds no test's results, InputError where they are damaged.

    >>> import crankorder as co, tempfile
    >>> with tempfile.TemporaryDirectory() as work:
    ...     folders = co.synthesise("hard-two-revolutions", work + "/test", quick=True)
    ...     first = co.run(folders, out=work + "/first", recipe="maps")
    ...     again = co.run(folders, out=work + "/again", recipe="maps")
    ...     co.compare(work + "/first", work + "/again")["headline"]
    ['No difference: nothing changed by more than chance alone would change it.']
    """
    made = compare_results(Path(base), [Path(one) for one in new], q=fdr, correlated=any_dependence)
    if out is not None:
        publish_comparison(made, Path(out))
    return _document(comparison_text(made))


def balance(
    engine: str,
    *,
    max_order: int = 8,
    speeds_rpm: Sequence[float] = (),
    out: str | os.PathLike[str] | None = None,
) -> dict[str, Any]:
    """Forces by order, balance strategies, shafts and residuals of ``engine`` (``data_schema/balance.json``).

    ``engine``: a shipped engine or the path of a TOML file. ``max_order``: highest order in the tables, 4 to 1000.
    ``speeds_rpm``: crank speeds at which forces are given; those of the file where empty. ``out``: a folder for
    pictures and NetCDF. Raises RequestError where there is no such engine, ManyErrors with every fault of its file.

    >>> import crankorder as co
    >>> co.balance("msu-standard", speeds_rpm=[1500.0])["masses_g"]["reciprocating"] > 0.0
    True
    """
    made = balance_of(engine, max_order=max_order, speeds_rpm=speeds_rpm)
    if out is not None:
        publish_balance(made, Path(out))
    return _document(balance_text(made))


def synthesise(scene: str, out: str | os.PathLike[str], *, quick: bool = False) -> list[Path]:
    """Folders written below ``out`` for ``scene``: test runs with ``run.toml``, recordings and ``truth.json``.

    ``scene``: a shipped scene or the path of a TOML file; ``quick``: its short version. A scene of several repeats
    makes a folder for each. Raises ManyErrors for a bad scene, RequestError for a folder with other content.

    >>> import crankorder as co, tempfile
    >>> with tempfile.TemporaryDirectory() as work:
    ...     [folder.name for folder in co.synthesise("hard-two-revolutions", work + "/test", quick=True)]
    ['test']
    """
    return write_scene(scene, Path(out), quick=quick)


def _columns(signals: ArrayLike | Mapping[str, ArrayLike]) -> tuple[dict[Source, NDArray[Any]], list[str]]:
    """Copies of the signals by position, and their names."""
    if isinstance(signals, Mapping):
        return {place: _column(row, str(key)) for place, (key, row) in enumerate(signals.items())}, [*map(str, signals)]
    allowed = "(samples,) or (channels, samples)"
    try:
        rows = np.atleast_2d(np.asarray(signals))
    except ValueError as error:
        raise RequestError("the channels differ in length", file=CALL, found=error, allowed=allowed) from None
    if rows.ndim != 2:
        raise RequestError("the signals have the wrong shape", file=CALL, found=rows.shape, allowed=allowed)
    names = ["signal"] if len(rows) == 1 else [f"signal {place + 1}" for place in range(len(rows))]
    return {place: _column(row, name) for (place, row), name in zip(enumerate(rows), names, strict=True)}, names


def _column(values: ArrayLike, name: str) -> NDArray[Any]:
    """A copy of ``values`` as real numbers of one axis: what is mended later is not the caller's."""
    column = np.asarray(values)
    if column.ndim != 1 or column.dtype.kind not in "fiub":
        found = f"{column.dtype} of shape {column.shape}"
        raise RequestError("must be real numbers, one for each sample", file=CALL, place=name, found=found)
    return np.array(column, dtype=np.float32 if column.dtype == np.float32 else np.float64)


def _head(name: str, cycle: str, channels: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What every manifest states."""
    return {
        "schema_version": 1,
        "test": {"name": name, "cycle": cycle},
        "recordings": {"files": [name]},
        "channels": list(channels),
    }


def _engine(name: str | None) -> Engine | None:
    return None if name is None else load_engine(name)


def _settings(*results: str, recipe: str | None, **stages: Mapping[str, Any]) -> Settings:
    """Settings of ``recipe`` that ask for ``results``, with what was given (not None) of each of ``stages``."""
    asked = {
        stage: {key: value for key, value in table.items() if value is not None} for stage, table in stages.items()
    }
    return load_settings(recipe, asked={**asked, "report": {"results": results}})


def _made(
    recordings: Recordings,
    settings: Settings,
    *,
    tables: Mapping[str, Any] | None = None,
    engine: str | None = None,
    test: str = "test",
    strict: bool = False,
) -> tuple[dict[str, xr.Dataset], dict[str, Any]]:
    """Groups and findings of ``recordings``, as a run makes them of files."""
    given = _each(recordings)
    manifest = _machine(given, tables or {}, test)
    settings, known = up_to_stated(settings, manifest), _engine(engine)
    faults: list[CrankorderError] = []
    results: dict[Path, RecordingResult] = {}
    for name, one in given.items():
        try:
            results[Path(name)] = analyse_recording(one, manifest, settings, ShaftKnowledge(known))
        except InputError as error:
            faults.append(error)
    results = without_changed_gains(results, settings=settings.ingest)
    faults += left_out_of(results, ("bad", "suspect") if strict else ("bad",))
    if not results:
        raise faults[0] if len(faults) == 1 else NoUsableRecordingError("no recording could be used", found=faults[0])
    sources = sources_of(manifest, known, settings)
    groups, findings, left_out = results_of_test(
        results, test=test, sources=sources, settings=settings, flags=[], faults=faults
    )
    _warn([*faults, *left_out])
    return groups, _document(json_bytes(findings))


def _document(text: str | bytes) -> dict[str, Any]:
    """What a JSON file of that ``text`` holds, so that a notebook sees what is on disk."""
    document: dict[str, Any] = json.loads(text)
    return document


def _each(recordings: Recordings) -> dict[str, xr.Dataset]:
    """Recordings by names of their own: a name that comes again gets a number."""
    given = [recordings] if isinstance(recordings, xr.Dataset) else list(recordings)
    if not given:
        raise RequestError("no recording is given", file="recordings", allowed="a Recording, or several of one test")
    named: dict[str, xr.Dataset] = {}
    for one in given:
        if not isinstance(one, xr.Dataset):
            raise RequestError("not a Recording", file="recordings", found=type(one).__name__)
        check_dataset(one, "recording")
        stem = name = str(one.attrs["recording"])
        number = 2
        while name in named:
            name, number = f"{stem} ({number})", number + 1
        named[name] = one.assign_attrs(recording=name)
    return named


def _machine(given: Mapping[str, xr.Dataset], tables: Mapping[str, Any], test: str) -> Manifest:
    """Manifest of the recordings ``given`` with the ``tables`` that say what the machine is made of."""
    first = next(iter(given.values()))
    with_shaft = "four-stroke" if int(first.attrs["revs_per_cycle"]) == 2 else "rotor"
    cycle = with_shaft if first.attrs.get("has_shaft", 1) else "none"
    columns = (first[key].values.tolist() for key in ("channel", "unit"))
    channels = [dict(zip(("name", "unit"), row, strict=True)) for row in zip(*columns, strict=True)]
    stated = {key: dict(table) if isinstance(table, Mapping) else list(table) for key, table in tables.items() if table}
    return manifest_of({**_head(test, cycle, channels), **stated}, Path("machine"), {})


def _run_folders(plans: list[Any], out: Path, jobs: int, *, fresh: bool, strict: bool) -> None:
    """Run ``plans``; what was left out is warned of, and what nobody foresaw is raised."""

    @contextmanager
    def unwatched(_: str) -> Iterator[Progress]:
        yield lambda name, done, total: None

    outcomes: list[Outcome] = []
    helper = Helper(plans, jobs=jobs)
    try:
        outcomes = run_plans(
            plans, out, helper=helper, jobs=jobs, fresh=fresh, strict=strict, watched=unwatched, tell=_warn_of
        )
    finally:
        helper.close()
    if all(outcome.status == "failed" for outcome in outcomes):
        internal = [error for outcome in outcomes for error in outcome.internal]
        raise (internal or [fault for outcome in outcomes for fault in outcome.faults])[0]


def _warn_of(outcome: Outcome) -> None:
    _warn([*outcome.faults, *outcome.internal])


def _warn(faults: Sequence[BaseException]) -> None:
    for fault in faults:
        warnings.warn(str(fault), UserWarning, stacklevel=3)
