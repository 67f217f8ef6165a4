"""The front door: what notebooks call. ``import crankorder as co`` loads each function when it is touched.

A Recording (``data_schema/recording.json``) comes from :func:`recording` or :func:`read`; every map, track and finding
is made from one or more of them, as ``crankorder run`` makes it from files.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from crankorder.batch.balance import balance_of, publish_balance
from crankorder.batch.balance import document_text as balance_text
from crankorder.batch.compare import compare_results, publish_comparison
from crankorder.batch.compare import document_text as comparison_text
from crankorder.batch.execute import Progress, Recordings, analysed, run_plans
from crankorder.batch.plan import CampaignPlan, Outcome, RunOptions, plan_tests
from crankorder.batch.publish import ReportingProcess, export_results
from crankorder.batch.result_folder import RESULTS, read_findings, result_folders
from crankorder.batch.store import json_bytes
from crankorder.channel_units import with_real_units
from crankorder.errors import InputError, RequestError
from crankorder.findings import Findings
from crankorder.ingest import arrays
from crankorder.ingest.folder import recordings_of
from crankorder.ingest.manifest import load_manifest, manifest_head, manifest_of
from crankorder.ingest.rawfile import RawFile
from crankorder.ingest.recording import read_recording, recording_of
from crankorder.quantities import check_dataset
from crankorder.report.netcdf import findings_datasets, plain_attrs, published, root_attrs
from crankorder.report.notebook import Diagnosis, Sheet, tests_table
from crankorder.settings import Settings, load_settings
from crankorder.stages import analyse_shaft
from crankorder.synth.write import write_scene

MOST_FALSE = 0.5
"""Share of claims that may be false, at most: more is no claim."""

NO_MARK = "no_index"
"""Flag of recordings without a mark, of which nobody is warned: who gives none knows."""

Tables = Sequence[Mapping[str, Any]]
"""Tables of a manifest, such as its ``[[bearings]]``, with the manifest's keys."""


def recording(
    signals: arrays.Signals,
    *,
    rate_hz: float | None = None,
    samples_per_rev: int | None = None,
    unit: str | Mapping[str, str] = arrays.DEFAULT_UNIT,
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
    signals : channels by name (a dict, a DataFrame), each (samples,); an array (samples,) or (channels, samples); or a
        DataArray, of several channels with a dimension ``channel``; or time series of SDyPy (SEP 5: a list of dicts
        with ``data``, ``name``, ``unit_str`` and ``fs`` or ``time``), which say their rate and units themselves
    rate_hz : samples per second of signals, encoder and index; > 0
    samples_per_rev : samples per crank revolution instead, where they were taken by crank angle; > 0
    unit : unit of all channels, or of each by name: "m/s2", "g", "mm/s", "Pa", "bar", "N", "V" …
    pulse_times_s : (pulses,), s, times of the encoder's pulses, ascending, on the clock of the samples (``start_s``)
    encoder : the encoder's voltage, (samples,), instead
    speed_rpm : speed of the crank instead, rpm, a number or (samples,)
    pulses_per_rev : pulses per revolution of the whole wheel, missing teeth included: 60 of a 60-2 wheel
    missing_teeth : teeth that the wheel lacks in one gap: 2 of a 60-2 wheel
    index : the once-per-revolution mark: its times (marks,) in s beside ``pulse_times_s``, its voltage (samples,)
        beside ``encoder``
    index_to_tdc_deg : angle from the mark to top dead centre, degrees; without it phases refer to the mark
    ratio : encoder revolutions per crank revolution; > 0
    cycle : "four-stroke", "two-stroke", "rotor", or "none" of a structure without a shaft
    start_s, start_deg : time in s, or crank angle in degrees, of the first sample
    name : name of the recording in flags and errors

    Doubts and repairs stand in ``attrs["quality"]`` (JSON); "suspect" ones give a warning when it is analysed.
    Raises RequestError or ManyErrors where the arguments contradict each other, InputError where the data are damaged.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording({"housing": np.cos(2 * np.pi * 75.0 * time)}, rate_hz=1e4, speed_rpm=1500.0)
    >>> made["signal"].sizes["time"], made.attrs["rate_hz"]
    (40000, 10000.0)
    """
    channels, settings = arrays.columns_of(signals), load_settings()
    rate_hz, unit = arrays.told_by_timeseries(signals, rate_hz, unit, settings=settings.ingest)
    told = {"pulse_times_s": pulse_times_s, "encoder": encoder, "speed_rpm": speed_rpm}
    table, shaft = arrays.shaft_of(told, by_angle=rate_hz is None, without=cycle == "none")
    if "source" in shaft:
        wheel = {"pulses_per_rev": pulses_per_rev, "missing_teeth": missing_teeth or None}
        table |= {key: arrays.count(value, key) for key, value in wheel.items() if value is not None}
        if index_to_tdc_deg is not None:
            table["index_to_tdc_deg"] = arrays.number(index_to_tdc_deg, "index_to_tdc_deg")
        shaft |= {} if index is None else {"index": arrays.column(index, "index")}
    elif not (pulses_per_rev is None and index is None and index_to_tdc_deg is None and not missing_teeth):
        place = "pulses_per_rev, missing_teeth, index, index_to_tdc_deg"
        raise RequestError("goes with pulse_times_s or encoder", file=arrays.CALL, place=place)
    if (rate_hz is None) == (samples_per_rev is None):
        raise RequestError("state rate_hz, or samples_per_rev of samples by crank angle", file=arrays.CALL)
    by_angle = {"domain": "crank_angle", "start_deg": arrays.number(start_deg, "start_deg")}
    by_time = {"rate_hz": arrays.number(rate_hz, "rate_hz")} if samples_per_rev is None else {}
    sampling = by_time or by_angle | {"samples_per_rev": arrays.count(samples_per_rev, "samples_per_rev")}
    table |= {role: len(channels) + place for place, role in enumerate(shaft)}
    table["ratio"] = arrays.number(ratio, "ratio")
    units = arrays.units_of(unit, list(channels))
    named = [{"name": key, "source": place, "unit": units[key]} for place, key in enumerate(channels)]
    stated = {**manifest_head(name, cycle, named), "sampling": sampling, "encoder": table}
    manifest = manifest_of(stated, Path(arrays.CALL))
    start = arrays.number(start_s, "start_s")
    if pulse_times_s is not None:
        arrays.check_times(shaft["source"], start, len(next(iter(channels.values()))) / by_time["rate_hz"])
    raw = RawFile(
        dict(enumerate([*channels.values(), *shaft.values()])),
        units=dict(enumerate(units.values())),
        starts_s=dict.fromkeys(range(len(channels) + len(shaft)), start),
    )
    return recording_of(raw, Path(name), manifest, settings=settings.ingest, shaft=settings.shaft)


def read(path: str | os.PathLike[str], *, manifest: str | os.PathLike[str] | None = None) -> Any:
    """The Recording in the file ``path``; of a test-run folder a list of all of them, in their order.

    ``manifest`` is a ``run.toml`` that does not lie beside the data (``crankorder init`` drafts one). Recordings of a
    folder that cannot be used are left out with a warning. Raises RequestError or ManyErrors where the manifest is
    wrong, InputError where the one file is damaged or lacks what the manifest names.

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
    recordings = []
    for file in found.paths:
        try:
            recordings.append(read_recording(file, stated, settings=settings.ingest, shaft=settings.shaft))
        except InputError as error:
            _warn([error])
    return recordings


def crank_angle(recording: xr.Dataset) -> xr.Dataset:
    """Crank angle (rev), speed (rpm) and standard error (rev), each (time,), of ``recording`` on knots (ShaftAngle).

    Raises RequestError where ``recording`` is no dataset, SchemaError where it is no Recording, InputError where the
    pulses tell no angle.

    >>> import numpy as np, crankorder as co
    >>> turns = np.arange(0.0, 4.0, 1 / (25.0 * 60))
    >>> made = co.recording(np.zeros(4000), rate_hz=1000.0, pulse_times_s=turns, pulses_per_rev=60)
    >>> round(float(co.crank_angle(made)["speed"].mean()), 3)
    1500.0
    """
    if not isinstance(recording, xr.Dataset):
        raise RequestError("not a Recording", file="crankorder.crank_angle", found=type(recording).__name__)
    check_dataset(recording, "recording")
    return analyse_shaft(recording, load_settings())


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

    A line is ``amplitude * cos(2 pi order crank_angle + phase)``, the crank angle in revolutions from top dead centre
    or, where that is not stated, from the mark; ``phase`` is in degrees, NaN where recordings have no mark in common.

    Parameters
    ----------
    recordings : one Recording or several of one test
    max_order : highest order, cycles per crank revolution, above 0
    revs_per_frame : revolutions of a frame, 1 or more; orders are 1 / this apart
    speed_bin_rpm : rpm, above 0; frames whose speeds differ by less are averaged
    tol : relative amplitude error that the numerics may add, 1e-12 to 0.1
    recipe : a shipped recipe or the path of one, for all that is not given

    Raises RequestError or ManyErrors where a value or the recipe is wrong, InputError where no recording can be used.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> round(float(co.order_map(made)["amplitude"].sel(order=3.0).item()), 3)
    2.0
    """
    orders = {"max_order": max_order, "revs_per_frame": revs_per_frame, "speed_bin_rpm": speed_bin_rpm}
    settings = _settings("order_map", recipe=recipe, orders={**orders, "tolerance": tol})
    return with_real_units(_analysed(recordings, settings)[0]["order_map"])


def campbell_map(
    recordings: Recordings,
    *,
    max_frequency_hz: float | None = None,
    resolution_hz: float | None = None,
    speed_bin_rpm: float | None = None,
    recipe: str | None = None,
) -> xr.Dataset:
    """Spectra of ``recordings`` against speed (CampbellMap): amplitude of a tone, (channel, speed, frequency).

    ``max_frequency_hz`` is the highest frequency [Hz], ``resolution_hz`` the distance of two lines [Hz], both above 0.
    ``recordings``, ``speed_bin_rpm`` and ``recipe`` are those of :func:`order_map`.

    Raises RequestError or ManyErrors where a value or the recipe is wrong, InputError where no recording can be used.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> spectrum = co.campbell_map(made, max_frequency_hz=200.0)["amplitude"].squeeze()
    >>> round(float(spectrum.frequency[spectrum.argmax("frequency")]), 3)
    75.0
    """
    campbell = {"max_frequency_hz": max_frequency_hz, "resolution_hz": resolution_hz}
    settings = _settings("campbell_map", recipe=recipe, campbell=campbell, orders={"speed_bin_rpm": speed_bin_rpm})
    return with_real_units(_analysed(recordings, settings)[0]["campbell_map"])


def order_tracks(
    recordings: Recordings,
    *,
    orders: float | Sequence[float] | None = None,
    method: str | None = None,
    recipe: str | None = None,
) -> xr.Dataset:
    """Amplitude and phase of ``orders`` of ``recordings`` against speed (OrderTracks), (channel, order, speed).

    Parameters
    ----------
    recordings : one Recording or several of one test
    orders : orders to follow, cycles per crank revolution, above 0; without them, those that are found
    method : "auto" (sweeps jointly by Vold–Kalman, steady speeds from the map) or "frames" (all from the map)
    recipe : that of :func:`order_map`

    Raises RequestError or ManyErrors where a value or the recipe is wrong, InputError where no recording can be used.

    >>> import numpy as np, crankorder as co
    >>> time = np.arange(40_000) / 10_000.0
    >>> made = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * time), rate_hz=1e4, speed_rpm=1500.0)
    >>> round(float(co.order_tracks(made, orders=[3.0])["amplitude"].item()), 3)
    2.0
    """
    named = None if orders is None else tuple(np.atleast_1d(np.asarray(orders, dtype=np.float64)).tolist())
    results = ("order_tracks",) if named else ("order_tracks", "findings")
    asked = {"track_orders": named, "track_method": method}
    return with_real_units(_analysed(recordings, _settings(*results, recipe=recipe, orders=asked))[0]["order_tracks"])


def envelope(recordings: Recordings, *, bearings: Tables = (), recipe: str | None = None) -> xr.Dataset:
    """Order spectra of the squared envelope of ``recordings`` (EnvelopeMap), in the band that shows strikes most.

    Variables are (channel, speed, order). ``bearings`` say which strikes are looked for, with the keys of the
    manifest's ``[[bearings]]``; at least one. ``recipe`` is that of :func:`order_map`. Raises RequestError without
    bearings, InputError where no recording can be used.

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
    return with_real_units(_analysed(recordings, settings, tables={"bearings": bearings})[0]["envelope_map"])


def diagnose(
    recordings: Recordings,
    *,
    engine: str | None = None,
    bearings: Tables = (),
    gears: Tables = (),
    motor: Mapping[str, Any] | None = None,
    test: str = "test",
    recipe: str | None = None,
) -> Diagnosis:
    """What ``recordings`` of one test say, with intervals and evidence; ``as_dict`` is what ``findings.json`` holds.

    A notebook shows the headline and the tables of the report page.

    Parameters
    ----------
    recordings : one Recording or several of one test
    engine : a shipped engine or the path of a TOML file
    bearings, gears, motor : tables of the manifest, with its keys
    test : name of the test
    recipe : that of :func:`order_map`

    Raises ManyErrors where a table is wrong, RequestError where engine or recipe is, InputError where no recording can
    be used.

    >>> import numpy as np, crankorder as co
    >>> rng, time = np.random.default_rng(1), np.arange(80_000) / 10_000.0
    >>> signal = 2.0 * np.cos(2 * np.pi * 75.0 * time) + 0.1 * rng.standard_normal(80_000)
    >>> found = co.diagnose(co.recording(signal, rate_hz=1e4, speed_rpm=1500.0))
    >>> [round(line.order, 2) for line in found.orders]
    [3.0]
    """
    tables = {"bearings": bearings, "gears": gears, "motor": motor}
    settings = _settings("findings", recipe=recipe)
    return _diagnosis(_analysed(recordings, settings, tables=tables, engine=engine, test=test)[1])


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
    ``gears``, ``motor`` and ``test`` say then what a manifest would. ``recipe`` and ``tol`` (relative amplitude error)
    are those of :func:`order_map`; ``jobs`` recordings are analysed at a time (all cores); ``fresh`` recomputes what is
    finished; ``strict`` leaves out recordings with flags of severity "suspect". What had to be left out is told by
    warnings. Raises RequestError or ManyErrors before work starts where the request is wrong, NoUsableRecordingError
    where nothing could be used.

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
        if engine or bearings or gears or motor:
            problem = "what a machine of folders is made of stands in their manifests"
            raise RequestError(problem, file="crankorder.run", place="engine, bearings, gears, motor")
        folders = [Path(os.fspath(path)) for path in paths if isinstance(path, str | os.PathLike)]
        elsewhere = None if manifest is None else Path(manifest)
        planned = plan_tests(folders, Path(out), manifest=elsewhere, recipe=recipe, tolerance=tol)
        _warn(planned.refused)
        _run_folders(planned.tests, Path(out), RunOptions(jobs=jobs or os.cpu_count() or 1, fresh=fresh, strict=strict))
        return open(out)
    if out is not None or manifest is not None:
        problem = "recordings in memory have no manifest and write no file"
        raise RequestError(problem, file="crankorder.run", found="out" if out is not None else "manifest")
    settings = load_settings(_name(recipe), asked={"orders": {"tolerance": tol}})
    tables = {"bearings": bearings, "gears": gears, "motor": motor}
    recordings: Any = tests
    groups, findings = _analysed(recordings, settings, tables=tables, engine=engine, test=test, strict=strict)
    told = _diagnosis(findings)
    root = xr.Dataset(attrs=root_attrs(told, groups))
    made = {name: plain_attrs(published(one)) for name, one in {**groups, **findings_datasets(told)}.items()}
    return xr.DataTree.from_dict({"/": root, **made}, name=test)


def open(path: str | os.PathLike[str]) -> xr.DataTree:
    """Results at ``path`` as a tree, read as they are touched: a ``results.nc``, a test's folder, or a whole ``--out``.

    Of several tests each is a branch, and the root holds a table of them: ``co.open(OUT).to_dataset().to_dataframe()``.
    Raises RequestError where there are none.

    >>> import crankorder as co, tempfile
    >>> with tempfile.TemporaryDirectory() as work:
    ...     folders = co.synthesise("hard-two-revolutions", work + "/test", quick=True)
    ...     tree = co.run(folders, out=work + "/out", recipe="maps")
    ...     sorted(co.open(work + "/out")["order_map"].sizes)
    ['channel', 'order', 'speed']
    """
    given = Path(path)
    files = [given] if given.is_file() else [folder / RESULTS for folder in result_folders(given)]
    if len(files) == 1:
        return _tree(files[0])
    branches = {file.parent.name: _tree(file) for file in files}
    table = tests_table({file.parent.name: _findings(file.parent) for file in files})
    return xr.DataTree(table, name=given.name, children=branches)


def compare(
    base: str | os.PathLike[str],
    *new: str | os.PathLike[str],
    fdr: float = 0.05,
    out: str | os.PathLike[str] | None = None,
) -> Sheet:
    """What changed from the results in ``base`` to the last of ``new`` (``data_schema/comparison.json``).

    Several ``new`` in time order give the trend over all; two ``--out`` of several tests are compared test by test
    (``data_schema/builds.json``). ``fdr`` is the share of the claimed changes that may be chance, above 0, up to 0.5;
    ``out`` is a folder for page, pictures and NetCDF. Raises RequestError where a folder holds no test's results, where
    none is ``new`` or ``fdr`` is out of range, InputError where results are damaged or
    hold nothing that can be compared.

    >>> import crankorder as co, tempfile
    >>> with tempfile.TemporaryDirectory() as work:
    ...     folders = co.synthesise("hard-two-revolutions", work + "/test", quick=True)
    ...     first = co.run(folders, out=work + "/first", recipe="maps")
    ...     again = co.run(folders, out=work + "/again", recipe="maps")
    ...     co.compare(work + "/first", work + "/again")["headline"][0].partition(";")[0]
    'No order changed by more than chance alone would change it'
    """
    if not new:
        raise RequestError("name the results that are compared with base", file="crankorder.compare", place="new")
    if not 0.0 < fdr <= MOST_FALSE:
        allowed = f"above 0, to {MOST_FALSE}"
        raise RequestError("out of range", file="crankorder.compare", place="fdr", found=fdr, allowed=allowed)
    made = compare_results(Path(base), [Path(one) for one in new], q=fdr)
    if out is not None:
        publish_comparison(made, Path(out))
    return _document(comparison_text(made))


def export(result: str | os.PathLike[str], *, to: str, out: str | os.PathLike[str], binary: bool = False) -> list[Path]:
    """Paths of the files for other programs that ``result`` became, in a folder ``<test>-<to>`` of ``out`` per test.

    ``result`` is a ``results.nc``, a test's folder, or a whole ``--out``. ``to`` is "uff58" (a universal file of order
    cuts and waterfalls; 58b where ``binary``), "csv" or "parquet" (a table each of tracks, modes, crossings, lines and
    other findings, with units; Parquet also of the maps, by pyarrow). Raises RequestError where there are no results,
    ``to`` is none of these or ``out`` lies among results, InputError where results are damaged.

    >>> import crankorder as co, tempfile
    >>> with tempfile.TemporaryDirectory() as work:
    ...     folders = co.synthesise("hard-two-revolutions", work + "/test", quick=True)
    ...     tree = co.run(folders, out=work + "/out", recipe="maps")
    ...     [path.name for path in co.export(work + "/out", to="uff58", out=work + "/for-others")]
    ['results.uff']
    """
    return export_results(Path(result), Path(out), to=to, binary=binary)


def balance(
    engine: str, *, max_order: int = 8, speeds_rpm: Sequence[float] = (), out: str | os.PathLike[str] | None = None
) -> Sheet:
    """Forces by order, balance strategies, shafts and residuals of ``engine`` (``data_schema/balance.json``).

    ``engine`` is a shipped engine or the path of a TOML file, ``max_order`` the highest order in the tables, 4 to 1000.
    ``speeds_rpm`` are crank speeds [rpm], above 0, at which forces are given; those of the file where empty. ``out`` is
    a folder for pictures and NetCDF. Raises RequestError where there is no such engine, ManyErrors with every fault of
    its file.

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

    ``scene`` is a shipped scene or the path of a TOML file; ``quick`` asks for its short version. A scene of several
    repeats makes a folder for each. Raises ManyErrors for a wrong scene, RequestError for a folder with other content.

    >>> import crankorder as co, tempfile
    >>> with tempfile.TemporaryDirectory() as work:
    ...     [folder.name for folder in co.synthesise("hard-two-revolutions", work + "/test", quick=True)]
    ['test']
    """
    return write_scene(scene, Path(out), quick=quick)


def _settings(*results: str, recipe: str | None, **stages: Mapping[str, Any]) -> Settings:
    """Settings of ``recipe`` that ask for ``results``, with what was given (not None) of each of ``stages``."""
    asked = {stage: {key: _plain(value) for key, value in table.items()} for stage, table in stages.items()}
    return load_settings(_name(recipe), asked={**asked, "report": {"results": results}})


def _name(recipe: str | None) -> str | None:
    if recipe is not None and not isinstance(recipe, str):
        raise RequestError("a recipe is a shipped name or a path", file="recipe", found=repr(recipe))
    return recipe


def _plain(value: Any) -> Any:
    """``value`` of a setting as Python has it: a NumPy number is none to a file of settings."""
    made = value.item() if isinstance(value, np.generic) else value
    return round(made) if isinstance(made, float) and made.is_integer() else made


def _analysed(
    recordings: Recordings, settings: Settings, *, tables: Mapping[str, Any] | None = None, **options: Any
) -> tuple[dict[str, xr.Dataset], Findings]:
    """Groups and findings of ``recordings``; what was left out and what is suspect is warned of."""
    groups, findings, faults = analysed(recordings, settings, tables=tables or {}, **options)
    _warn(faults)
    suspect = [flag for flag in findings.quality if flag.severity == "suspect" and flag.flag != NO_MARK]
    _warn([f"{flag.recording}: {flag.flag}: {flag.detail}" for flag in suspect])
    return groups, findings


def _diagnosis(findings: Findings) -> Diagnosis:
    """``findings`` as the file of them holds them."""
    return Diagnosis.from_dict(_document(json_bytes(findings.as_dict())))


def _tree(file: Path) -> xr.DataTree:
    """The groups of the results ``file``, read as they are touched."""
    remedy = "Give a results.nc that crankorder wrote; a recording is read by crankorder.read"
    try:
        tree = xr.open_datatree(file, engine="h5netcdf")
    except (OSError, ValueError, KeyError) as error:
        raise InputError("cannot be read as results", file=file, found=error, remedy=remedy) from None
    if not tree.children:
        raise InputError("holds no results", file=file, remedy=remedy)
    return tree


def _findings(folder: Path) -> Findings | None:
    """Findings of the results in ``folder``; None, with a warning, where they cannot be read."""
    try:
        return read_findings(folder)
    except InputError as error:
        _warn([error])
        return None


def _document(text: str | bytes) -> Sheet:
    """What a JSON file of that ``text`` holds, so that a notebook sees what is on disk."""
    return Sheet(json.loads(text))


def _run_folders(plans: list[CampaignPlan], out: Path, options: RunOptions) -> None:
    """Run ``plans`` with ``options``; what was left out is warned of, and what nobody foresaw is raised."""

    def tell(outcome: Outcome) -> None:
        _warn([*outcome.faults, *outcome.notes, *outcome.internal])

    def unwatched(_: str) -> nullcontext[Progress]:
        return nullcontext(lambda name, done, total: None)

    reporting = ReportingProcess(plans, jobs=options.jobs)
    try:
        outcomes = run_plans(plans, out, options, reporting=reporting, watched=unwatched, tell=tell)
    finally:
        reporting.close()
    if all(outcome.status == "failed" for outcome in outcomes):
        internal = [error for outcome in outcomes for error in outcome.internal]
        raise (internal or [fault for outcome in outcomes for fault in outcome.faults])[0]


def _warn(faults: Sequence[BaseException | str]) -> None:
    """Warn of ``faults`` at the line that called the front door: Python shows a warning of a line once."""
    depth, frame = 1, sys._getframe()
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).startswith("crankorder."):
        depth, frame = depth + 1, frame.f_back
    for fault in faults:
        warnings.warn(str(fault), UserWarning, stacklevel=depth)
