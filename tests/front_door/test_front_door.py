"""The front door: what it gives of arrays is what a run gives of files, and of signals whose truth is known."""

import doctest
import importlib
import json
import pkgutil
import shutil
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import crankorder as co
from crankorder import front_door
from crankorder.errors import CrankorderError, InputError, ManyErrors, RequestError
from crankorder.settings import load_settings
from made.recordings import write_manifest

RATE_HZ, SPEED_RPM = 8192.0, 1470.0
TIME = np.arange(int(6.0 * RATE_HZ)) / RATE_HZ
TURNS = TIME * SPEED_RPM / 60.0


def line(order, amplitude, phase_deg=0.0):
    """Signal of a line, its phase from top dead centre at the first sample."""
    return amplitude * np.cos(2.0 * np.pi * order * TURNS + np.radians(phase_deg))


def square(per_rev):
    """Voltage of an encoder with ``per_rev`` pulses, one of which begins at top dead centre."""
    return np.where((TURNS * per_rev + 0.25) % 1.0 < 0.5, 5.0, 0.0)


def made_of(signals, **options):
    """A Recording at the speed and rate of this file."""
    return co.recording(signals, **{"rate_hz": RATE_HZ, "speed_rpm": SPEED_RPM, **options})


def test_every_example_is_executed_and_holds(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    faulty = []
    for name in (*co.__all__, "plot", *(f"plot.{one}" for one in co.plot.__all__)):
        found = doctest.DocTestFinder(recurse=False).find(attrgetter(name)(co), name)
        outcomes = [doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(one) for one in found if one.examples]
        if len(outcomes) != 1 or outcomes[0].failed:
            faulty.append(name)
    assert faulty == []


def test_no_room_takes_the_place_of_a_function():
    for room in pkgutil.iter_modules(co.__path__):
        if room.name != "__main__":
            importlib.import_module(f"crankorder.{room.name}")
    for name in co.__all__:
        assert getattr(co, name) is getattr(front_door, name)
    assert set(co.__all__) < set(dir(co))
    assert co.__version__.count(".") >= 1


def test_a_name_that_is_not_there_is_told_with_those_that_are():
    with pytest.raises(AttributeError, match=r"no attribute 'ordermap'.*order_map"):
        getattr(co, "ordermap")  # noqa: B009


TOLD = {
    "constant": {"speed_rpm": SPEED_RPM},
    "speed signal": {"speed_rpm": np.full(len(TIME), SPEED_RPM)},
    "pulse times": {"pulse_times_s": np.arange(0.0, 6.0, 60.0 / SPEED_RPM / 60), "pulses_per_rev": 60},
    "encoder": {"encoder": square(60), "pulses_per_rev": 60},
    "ratio": {"encoder": square(30), "pulses_per_rev": 60, "ratio": 0.5},
}


@pytest.mark.parametrize("told", TOLD)
def test_lines_have_their_amplitude_however_the_shaft_is_told(told):
    signals = {"a": line(2.0, 3.0) + line(5.0, 0.5), "b": line(2.0, 0.25)}
    made = co.recording(signals, rate_hz=RATE_HZ, **TOLD[told])
    shown = co.order_map(made, max_order=8.0)["amplitude"].squeeze("speed")
    for channel, order, amplitude in (("a", 2.0, 3.0), ("a", 5.0, 0.5), ("b", 2.0, 0.25)):
        assert float(shown.sel(channel=channel, order=order)) == pytest.approx(amplitude, rel=2e-3)


def test_phases_count_from_the_mark_and_its_angle_to_top_dead_centre():
    marks = np.arange(0.0, 6.0, 60.0 / SPEED_RPM)
    for to_tdc_deg in (0.0, 30.0):
        told = TOLD["pulse times"] | {"index": marks, "index_to_tdc_deg": to_tdc_deg}
        made = co.recording(line(2.0, 1.0, 40.0), rate_hz=RATE_HZ, **told)
        tracks = co.order_tracks(made, orders=[2.0])
        assert float(tracks["phase"].item()) == pytest.approx(40.0 + 2.0 * to_tdc_deg, abs=0.3)


def test_pulses_that_change_are_worked_out_anew():
    made = co.recording(line(2.0, 1.0), rate_hz=RATE_HZ, **TOLD["pulse times"])
    first = float(co.order_map(made)["speed"].mean())
    made["pulse_time"].values[:] *= 1.25
    assert float(co.order_map(made)["speed"].mean()) == pytest.approx(first / 1.25)


def test_samples_by_crank_angle_need_no_speed():
    turns = np.arange(360 * 40) / 360.0
    made = co.recording(np.cos(2 * np.pi * 3.5 * turns), samples_per_rev=360, cycle="four-stroke")
    assert float(co.order_map(made)["amplitude"].sel(order=3.5).item()) == pytest.approx(1.0, rel=1e-3)


def test_the_arrays_of_the_caller_stay_as_they_are():
    signal = line(1.0, 1.0)
    signal[1000:1003] = np.nan
    kept = signal.copy()
    made_of(signal)
    np.testing.assert_array_equal(signal, kept)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A test-run folder with two recordings of a rotor at two speeds, an order that slips, and a manifest."""
    made, rng = tmp_path_factory.mktemp("rotor"), np.random.default_rng(4)
    for rpm in (1200, 1800):
        turns, noise = TIME * rpm / 60.0, 0.05 * rng.standard_normal(len(TIME))
        signal = np.cos(2 * np.pi * turns) + 0.2 * np.cos(2 * np.pi * 3.58 * turns) + noise
        np.savetxt(made / f"{rpm}.csv", np.column_stack([TIME, signal]), delimiter=",", header="time,a", comments="")
    recordings = {"files": ["*.csv"], "speed_rpm": {"1200.csv": 1200.0, "1800.csv": 1800.0}}
    tables = {"recordings": recordings, "sampling": {"time_source": "time"}, "encoder": {"kind": "constant"}}
    return write_manifest(made, name="rotor", channels={"a": {}}, **tables)


def test_recordings_in_memory_give_what_their_files_give(folder, tmp_path):
    on_disk = co.run(folder, out=tmp_path / "out", jobs=1)
    recordings = co.read(folder)
    assert [one.attrs["recording"] for one in recordings] == ["1200.csv", "1800.csv"]
    in_memory = co.run(recordings, test="rotor")
    for group in ("order_map", "campbell_map", "order_tracks"):
        for name, variable in on_disk[group].data_vars.items():
            given = in_memory[group][name].values
            if variable.dtype.kind == "f":
                largest = float(np.nanmax(np.abs(given), initial=0.0))
                np.testing.assert_allclose(variable.values, given, rtol=0.0, atol=1e-6 * largest + 1e-300)
    found = co.diagnose(recordings, test="rotor")
    table = on_disk["findings/orders"]
    assert [record.order for record in found.orders] == pytest.approx(table["order"].values, rel=1e-9)
    assert [record.amplitude for record in found.orders] == pytest.approx(table["amplitude"].values, rel=1e-9)
    again = co.run(folder, out=tmp_path / "out", jobs=1)
    xr.testing.assert_identical(again["order_map"].to_dataset(), on_disk["order_map"].to_dataset())


def test_a_damaged_file_is_left_out_with_a_warning(folder, tmp_path):
    bad = shutil.copytree(folder, tmp_path / "with a bad one")
    (bad / "1200.csv").write_text("time,b\n0,1\n")
    with pytest.warns(UserWarning, match=r"1200\.csv"):
        (one,) = co.read(bad)
    assert one.attrs["recording"] == "1800.csv"
    with pytest.warns(UserWarning, match=r"1200\.csv"):
        tree = co.run(bad, out=tmp_path / "out", recipe="maps", jobs=1)
    assert tree["order_map"].sizes["speed"] == 1


def test_what_a_bearing_is_made_of_is_said_as_in_a_manifest():
    made = made_of(line(1.0, 1.0))
    with pytest.raises(ManyErrors, match=r"bearings\.0"):
        co.diagnose(made, bearings=[{"name": "front", "balls": 9}])
    with pytest.raises(RequestError, match="no bearing is named"):
        co.envelope(made)


def test_channels_are_joined_by_their_names_and_those_of_others_are_refused():
    x, z = line(1.0, 1.0), line(1.0, 2.0)
    first, turned = made_of({"X": x, "Z": z}), made_of({"Z": z, "X": x}, speed_rpm=1800.0)
    shown = co.order_map([first, turned])["amplitude"].sel(order=1.0, method="nearest")
    np.testing.assert_allclose(shown.sel(channel="X") / shown.sel(channel="Z"), 0.5, rtol=1e-6)
    for other in (
        made_of({"X": x, "Y": z}), made_of({"X": x}), made_of({"X": x, "Z": z}, unit={"X": "g", "Z": "m/s2"}),
        made_of({"X": x, "Z": z}, cycle="four-stroke"),
    ):  # fmt: skip
        with pytest.raises(RequestError, match="same channels, units and cycle"):
            co.order_map([first, other])


def test_results_in_memory_are_saved_and_opened_as_any_tree(tmp_path):
    tree = co.run(made_of(line(1.0, 1.0) + 0.01 * np.random.default_rng(1).standard_normal(len(TIME))))
    tree.to_netcdf(tmp_path / "saved.nc", engine="h5netcdf")
    again = co.open(tmp_path / "saved.nc")
    assert set(again.children) == set(tree.children)
    np.testing.assert_array_equal(again["order_map/amplitude"].values, tree["order_map/amplitude"].values)


def test_numbers_of_any_type_are_numbers():
    told = {"pulse_times_s": TOLD["pulse times"]["pulse_times_s"].astype(np.float32), "pulses_per_rev": np.int64(60)}
    made = co.recording(line(3.0, 1.0).astype(np.float32), rate_hz=np.array(RATE_HZ), **told)
    shown = [co.order_map(made, **one) for one in ({"max_order": np.int64(8)}, {"max_order": 8, "revs_per_frame": 8.0})]
    shown += [co.order_tracks(made, orders=orders) for orders in (3.0, np.array([1.0, 3.0]), (3,))]
    for one in shown:
        assert float(one["amplitude"].sel(order=3.0).item()) == pytest.approx(1.0, rel=2e-3)


def test_tables_and_named_arrays_keep_their_names_and_masks_are_gaps():
    array = xr.DataArray(np.stack([line(1.0, 1.0), line(1.0, 2.0)], axis=1), dims=("time", "channel"))
    assert made_of(array.assign_coords(channel=["a", "b"]))["channel"].values.tolist() == ["a", "b"]
    assert made_of(xr.DataArray(line(1.0, 1.0), dims="time", name="housing"))["channel"].values.tolist() == ["housing"]
    masked = np.ma.masked_where((TIME > 2.0) & (TIME < 2.2), line(1.0, 1.0))
    assert "gap" in made_of(masked).attrs["quality"] or "missing" in made_of(masked).attrs["quality"]


def test_time_series_of_sdypy_say_their_rate_and_units():
    one = {"name": "a", "data": line(3.0, 1.0), "unit_str": "g", "fs": RATE_HZ, "quantity": "acc"}
    other = {"name": "b", "data": line(1.0, 2.0), "unit_str": "", "time": TIME + 5.0}
    made = co.recording([one, other], speed_rpm=SPEED_RPM)
    expected = made_of({"a": line(3.0, 1.0), "b": line(1.0, 2.0)}, unit={"a": "g", "b": "m/s2"})
    xr.testing.assert_identical(made, expected)
    assert co.recording([one], unit="V", speed_rpm=SPEED_RPM)["unit"].values.tolist() == ["V"]
    for wrong, match in (
        ([one, other | {"time": 2.0 * TIME}], "fs of a is .* time of b says"),
        ([one | {"fs": None}], "state fs, or time"),
        ([one, one], "two channels have one name"),
        ([one, other | {"data": TIME[:-1]}], "lengths differ"),
    ):
        with pytest.raises((RequestError, InputError), match=match):
            co.recording(wrong, speed_rpm=SPEED_RPM)
    with pytest.raises(RequestError, match="rate_hz is 50 Hz, fs of a says"):
        co.recording([one], rate_hz=50.0, speed_rpm=SPEED_RPM)


def test_what_is_suspect_is_warned_of():
    pulses = np.arange(0.0, 6.0, 60.0 / SPEED_RPM / 60)
    gapped = pulses[(np.arange(len(pulses)) % 60) < 58]
    made = co.recording(line(3.0, 1.0), rate_hz=RATE_HZ, pulse_times_s=gapped, pulses_per_rev=58)
    for _ in range(2):  # once more: a warning of a line inside the package would be shown once
        with pytest.warns(UserWarning, match="encoder_missing_pulse") as told:
            co.order_map(made)
        assert {Path(one.filename) for one in told} == {Path(__file__)}


def test_what_is_no_results_file_is_told(folder, tmp_path):
    (tmp_path / "results.nc").write_bytes(b"no netcdf")
    for path in (tmp_path, folder / "run.toml"):
        with pytest.raises(InputError, match="results"):
            co.open(path)


REFUSED = {
    "sample numbers": ({"pulse_times_s": np.arange(100, 40_000, 5), "pulses_per_rev": 60}, "outside the recording"),
    "nothing told": ({"speed_rpm": None}, 'cycle="none"'),
    "a mark of a speed": ({"speed_rpm": 1500.0, "index": [0.1, 0.2]}, "goes with pulse_times_s or encoder"),
    "units in a list": ({"unit": ["g"]}, "must be a unit"),
    "a unit of another": ({"unit": {"x": "g"}}, "each channel has a unit"),
    "a rate in words": ({"rate_hz": "10 kHz"}, "must be a finite number"),
    "half a pulse": ({"encoder": square(60), "pulses_per_rev": 60.5}, "must be a whole number"),
    "two ways": ({"speed_rpm": 1500.0, "encoder": square(60)}, "more than one way"),
    "no rate": ({"rate_hz": None}, "state rate_hz"),
    "no shaft by crank angle": ({"cycle": "none", "speed_rpm": 1500.0}, "structure without a shaft"),
    "a matrix": ({"pulse_times_s": np.zeros((2, 2))}, "pulse_times_s: must be real numbers"),
    "a backward list": ({"pulse_times_s": [1.0, 0.5, 2.0], "pulses_per_rev": 1}, "must not go back"),
    "another length": ({"encoder": square(60)[:-5], "pulses_per_rev": 60}, "lengths differ"),
    "an unknown unit": ({"unit": "furlong"}, "furlong"),
    "a negative rate": ({"rate_hz": -1.0}, "rate_hz"),
}


def test_arguments_that_cannot_be_are_refused_with_what_they_are():
    for options, said in REFUSED.values():
        speed = {} if {"speed_rpm", "encoder", "pulse_times_s"} & set(options) else {"speed_rpm": 1500.0}
        with pytest.raises((RequestError, ManyErrors, InputError), match=said):
            co.recording(line(1.0, 1.0), **{"rate_hz": RATE_HZ, **speed, **options})


def test_signals_and_recordings_that_are_none_are_refused():
    for signals in ([[1.0j] * 9], np.zeros((2, 3, 4)), ["a", "b"], [], {}, np.zeros((40, 3)), [[1.0, 2.0], [3.0]]):
        with pytest.raises((RequestError, InputError)):
            made_of(signals)
    for given, said in (("a folder", "not a Recording"), ([], "no recording"), (xr.Dataset(), "missing")):
        with pytest.raises(CrankorderError, match=said):
            co.order_map(given)
    with pytest.raises(RequestError, match="not a Recording"):
        co.crank_angle([made_of(line(1.0, 1.0))])
    for options in ({"recipe": 5}, {"recipe": "nope"}, {"max_order": "20"}, {"tol": 5.0}):
        with pytest.raises((RequestError, ManyErrors)):
            co.order_map(made_of(line(1.0, 1.0)), **options)


def test_a_second_estimate_of_tracks_is_refused_and_its_settings_with_it():
    for method in ("least_squares", "vold_kalman"):
        with pytest.raises(ManyErrors, match=rf'orders\.track_method: no such .* set "auto".* found {method}'):
            co.order_tracks(made_of(line(1.0, 1.0)), orders=[2.0], method=method)
    with pytest.raises(ManyErrors, match=r"orders\.track_bandwidth: no setting any more\. Remove it"):
        load_settings(asked={"orders": {"track_bandwidth": 0.2}})


def test_recordings_of_one_name_stay_apart():
    made = [made_of(line(1.0, 1.0), speed_rpm=rpm) for rpm in (1200.0, 1500.0)]
    assert co.run(made, recipe="maps")["shaft"]["recording"].values.tolist() == ["recording", "recording (2)"]


def test_folders_need_a_place_for_results_and_recordings_none(folder, tmp_path):
    for call, said in (
        (lambda: co.run(folder), "out"),
        (lambda: co.run(co.read(folder), out=tmp_path), "write no file"),
        (lambda: co.run(folder, out=tmp_path / "out", bearings=[{"name": "front"}]), "stands in their manifests"),
        (lambda: co.open(tmp_path), "no finished results"),
        (lambda: co.compare(tmp_path), "name the results"),
        (lambda: co.compare(tmp_path, tmp_path, fdr=2.0), "out of range"),
    ):
        with pytest.raises(RequestError, match=said):
            call()


def test_a_notebook_shows_what_matters_and_escapes_what_files_say():
    hostile = "<script>alert(1)</script>"
    signal = line(3.0, 2.0) + 0.1 * np.random.default_rng(3).standard_normal(TIME.size)
    found = co.diagnose(made_of({hostile: signal}), test=hostile)
    shown = found._repr_html_()
    assert "<script" not in shown
    assert all(words in shown for words in ("&lt;script&gt;", "Order 3", "<table>"))
    assert type(found).from_dict(found.as_dict()) == found
    sheet = co.balance("msu-standard")
    assert sheet["sentences"][0] in sheet._repr_html_()


@pytest.mark.slow
def test_a_folder_of_tests_opens_as_a_table_of_them(recordings_of, tmp_path):
    co.run([recordings_of(name) for name in ("hard-two-revolutions", "hard-close-orders")], out=tmp_path / "out")
    tree = co.open(tmp_path / "out")
    table = tree.to_dataset().to_dataframe().set_index("folder")
    assert set(table.index) == set(tree.children)
    for folder, row in table.iterrows():
        said = json.loads((tmp_path / "out" / str(folder) / "findings.json").read_text(encoding="utf-8"))
        assert row["name"] == said["test"]
        assert [row["speed_low_rpm"], row["speed_high_rpm"]] == said["speed_range_rpm"]
        largest = max(said["orders"], key=lambda one: one["amplitude"])
        assert (row["strongest_order"], row["amplitude"]) == (largest["order"], largest["amplitude"])
        assert row["natural_frequencies"] == sum(mode["explained_by"] == "mode" for mode in said["modes"])
    (tmp_path / "out" / str(table.index[0]) / "findings.json").write_text("{}", encoding="utf-8")
    with pytest.warns(UserWarning, match="findings.json"):
        again = co.open(tmp_path / "out")
    assert again["name"].values[0] == ""
