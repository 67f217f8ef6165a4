"""The results file: the same bytes each time, checksummed, readable by others, and back without loss."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

import crankorder as co
from crankorder.channel_units import by_channel, with_real_units
from crankorder.errors import InputError, UnsafeInputError
from crankorder.findings import Findings
from crankorder.quantities import check_dataset
from crankorder.report.netcdf import findings_datasets, published, read_results, results_bytes
from made.typed import from_dicts

findings_datasets = from_dicts(findings_datasets)

_READ_BY_NETCDF4 = """
import json, sys, netCDF4
with netCDF4.Dataset(sys.argv[1]) as file:
    campbell = file["campbell_map"]
    amplitude = campbell["amplitude"]
    print(json.dumps({
        "conventions": file.Conventions, "groups": sorted(file.groups), "findings": sorted(file["findings"].groups),
        "dims": amplitude.dimensions, "sum": float(amplitude[:].sum(dtype="f8")), "units": campbell["speed"].units,
        "filters": [amplitude.filters()[name] for name in ("zlib", "shuffle", "fletcher32")],
        "channel": campbell["channel"][:].tolist(),
        "speed": campbell["speed"][:].tolist(), "order": file["findings/orders/order"][:].tolist(),
        "explained": file["findings/orders/explained_by"][:].tolist(),
    }))
"""


@pytest.fixture(scope="module")
def groups(campaign):
    maps = {"order_map": campaign.order_map, "campbell_map": campaign.campbell, "order_tracks": campaign.tracks}
    return maps | findings_datasets(campaign.findings)


@pytest.fixture
def file(groups, tmp_path):
    path = tmp_path / "results.nc"
    path.write_bytes(results_bytes(groups, attrs={"title": "t"}))
    return path


def test_what_is_read_back_is_what_was_written_and_fits_its_schema(groups, file):
    read = read_results(file)
    assert sorted(read) == sorted(groups)
    for name, dataset in groups.items():
        again = read[name]
        assert sorted(map(str, again.variables)) == sorted(map(str, dataset.variables))
        assert set(map(str, again.coords)) == set(map(str, dataset.coords))
        for key, variable in dataset.variables.items():
            assert again[key].dims == variable.dims
            assert again[key].attrs.items() >= variable.attrs.items()
            if variable.dtype.kind == "f":
                np.testing.assert_allclose(again[key].values, variable.values, rtol=1e-7)
            else:
                np.testing.assert_array_equal(again[key].values, variable.values)
    for noun in ("order_map", "campbell_map", "order_tracks"):
        check_dataset(read[noun], noun)


def test_values_beyond_single_precision_keep_64_bits_and_complex_spectra_their_parts(tmp_path):
    values, spectrum = np.array([[1e-300, 0.0], [1e300, 1.0]]), np.exp(1j * np.arange(6.0)).reshape(2, 3)
    given = {"amplitude": (("a", "b"), values), "spectrum": (("frame", "order"), spectrum, {"units": "see unit"})}
    path = tmp_path / "r.nc"
    path.write_bytes(results_bytes({"g": xr.Dataset(given)}, attrs={}))
    again = read_results(path)["g"]
    np.testing.assert_array_equal(again["amplitude"].values, values)
    np.testing.assert_allclose(again["spectrum"].values, spectrum, rtol=1e-6)
    assert again["spectrum"].attrs == {"units": "see unit"}


def test_the_bytes_are_the_same_in_any_order_of_groups_and_attributes(groups):
    turned = dict(reversed(groups.items()))
    assert results_bytes(groups, attrs={"a": 1, "b": 2}) == results_bytes(turned, attrs={"b": 2, "a": 1})


def test_netcdf4_reads_the_same_values_and_finds_the_checksums(file, groups):
    pytest.importorskip("netCDF4", reason="netCDF4 is a development dependency")
    command = [sys.executable, "-c", _READ_BY_NETCDF4, str(file)]
    said = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    campbell, orders = groups["campbell_map"], groups["findings/orders"]
    assert said.pop("sum") == pytest.approx(float(campbell["amplitude"].sum()), rel=1e-6)
    assert {"orders", "modes", "crossings", "bearings", "quality"} <= set(said.pop("findings"))
    assert said == {
        "conventions": "CF-1.11, ACDD-1.3", "groups": ["campbell_map", "findings", "order_map", "order_tracks"],
        "dims": ["channel", "speed", "frequency"], "units": "min-1", "filters": [True, True, True],
        "channel": ["X", "Y", "Z"], "speed": campbell["speed"].values.tolist(),
        "order": orders["order"].values.tolist(), "explained": orders["explained_by"].values.tolist(),
    }  # fmt: skip


def test_attributes_of_any_kind_can_be_written(tmp_path):
    attrs = {"none": None, "yes": True, "table": {"a": [1]}, "path": Path("x"), "text": "a\x00b", "long": "é" * 100_000}
    path = tmp_path / "r.nc"
    path.write_bytes(results_bytes({"g": xr.Dataset()}, attrs=attrs | {"numbers": [1.5, 2.5]}))
    with h5py.File(path) as file:
        said = dict(file.attrs)
    assert "none" not in said
    assert (np.ravel(said["yes"]).tolist(), said["table"], said["path"]) == ([1], '{"a": [1]}', '"x"')
    assert (said["text"], len(said["long"]), said["numbers"].tolist()) == ("a\\x00b", 100_000, [1.5, 2.5])


def test_records_become_columns_with_units_and_missing_numbers_are_nan():
    findings = {
        "schema_version": 1, "test": "t", "unexplained_energy_fraction": None, "balance": None,
        "modes": [
            {"frequency_hz": 60.0, "frequency_hz_ci95": [59.9, 60.1], "damping_ratio": None, "channels": ["X", "Z"]},
            {"frequency_hz": 115.0, "frequency_hz_ci95": None, "damping_ratio": 0.01, "channels": []},
        ],
        "crossings": [{"order": 4.0, "excited": True}, {"order": 8.0, "excited": False}],
    }  # fmt: skip
    tables = findings_datasets(findings)
    assert sorted(tables) == ["findings", "findings/crossings", "findings/modes"]
    modes = tables["findings/modes"]
    assert modes["frequency_hz"].attrs["units"] == "Hz"
    assert modes["frequency_hz_ci95"].dims == ("record", "bound")
    assert np.isnan(modes["frequency_hz_ci95"].values[1]).all()
    assert np.isnan(modes["damping_ratio"].values[0])
    assert modes["channels"].values.tolist() == ["X, Z", ""]
    assert tables["findings/crossings"]["excited"].values.tolist() == [1, 0]


def test_a_cut_results_file_is_refused_by_name(file):
    data = file.read_bytes()
    for share in (0.999, 0.5, 0.0):
        file.write_bytes(data[: int(share * len(data))])
        with pytest.raises(InputError, match=r"results\.nc"):
            read_results(file)


def test_a_flipped_bit_in_the_data_never_comes_back_as_a_number(file):
    whole, data = read_results(file), file.read_bytes()
    rng = np.random.default_rng(11)
    refused = 0
    for place in rng.integers(0, len(data), 8):
        damaged = bytearray(data)
        damaged[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(bytes(damaged))
        try:
            read = read_results(file)
        except InputError:
            refused += 1
            continue
        np.testing.assert_array_equal(read["campbell_map"]["amplitude"], whole["campbell_map"]["amplitude"])
    assert refused > 3


def test_a_file_that_reaches_outside_itself_is_refused(tmp_path):
    secret = tmp_path / "secret.txt"
    secret.write_bytes(b"canary" * 10)
    for kind in ("external link", "external storage", "soft link"):
        path = tmp_path / f"{kind}.nc"
        with h5py.File(path, "w") as file:
            file.attrs["Conventions"] = "CF-1.11"
            group = file.create_group("order_map")
            if kind == "external link":
                group["amplitude"] = h5py.ExternalLink("other.h5", "/x")
            elif kind == "soft link":
                group["amplitude"] = h5py.SoftLink("/elsewhere")
            else:
                group.create_dataset("amplitude", (60,), "u1", external=[(str(secret), 0, 60)])
        with pytest.raises(UnsafeInputError):
            read_results(path)


def test_a_false_size_and_a_foreign_file_are_refused_before_anything_is_allocated(tmp_path):
    huge, foreign = tmp_path / "huge.nc", tmp_path / "foreign.nc"
    with h5py.File(huge, "w") as file:
        file.attrs["Conventions"] = "CF-1.11"
        file.create_group("order_map").create_dataset("amplitude", (10**12,), "f8", chunks=(1000,))
    with h5py.File(foreign, "w") as file:
        file["x"] = 1
    refused = ((huge, "too much"), (foreign, "not a results file"), (tmp_path / "nothing.nc", r"nothing\.nc"))
    for path, said in refused:
        with pytest.raises(UnsafeInputError if path == huge else InputError, match=said):
            read_results(path)


# What leaves the program: real units, linked intervals, words that travel; read by the CF compliance checker.


def mixed(*channels):
    """A map of ``channels`` (name, quantity, unit), with the values 1, 2, … of each."""
    values = np.arange(1.0, len(channels) + 1)[:, None, None] * np.ones((1, 3, 4))
    dims = ("channel", "speed", "frequency")
    columns = {
        key: ("channel", [one[place] for one in channels]) for place, key in enumerate(("channel", "quantity", "unit"))
    }
    return xr.Dataset(
        {
            "amplitude": (dims, values, {"units": "see unit", "long_name": "peak amplitude of a tone"}),
            "amplitude_low": (dims, 0.9 * values, {"units": "see unit", "long_name": "low"}),
            "psd": (dims, values**2, {"units": "see unit, squared per Hz", "long_name": "density"}),
            "n_frames": ("speed", [1, 2, 3], {"units": "1", "long_name": "frames"}),
        },
        coords={**columns, "speed": ("speed", [1.0, 2.0, 3.0], {"units": "min-1"})},
        attrs={"amplitude_scaling": "peak", "window": "hann", "quality": "[]"},
    )


UNITS = (
    ([("X", "acceleration", "m/s2"), ("Z", "acceleration", "m/s2")], {"psd": "(m/s2)2 Hz-1"}),
    (
        [("X", "acceleration", "m/s2"), ("p", "cylinder pressure", "bar")],
        {"psd_acceleration": "(m/s2)2 Hz-1", "psd_cylinder_pressure": "(bar)2 Hz-1"},
    ),
    (  # two units of one quantity are told apart, and the gram is no acceleration
        [("X", "acceleration", "g"), ("Z", "acceleration", "m/s2"), ("W", "", "µm")],
        {"psd_acceleration_g": "(standard_free_fall)2 Hz-1", "psd_acceleration_m_s2": "(m/s2)2 Hz-1",
         "psd_um": "(um)2 Hz-1"},
    ),
)  # fmt: skip


@pytest.mark.parametrize(("channels", "units"), UNITS)
def test_channels_of_several_units_have_a_variable_for_each(channels, units):
    made = with_real_units(mixed(*channels))
    assert {str(name): made[name].attrs["units"] for name in made if str(name).startswith("psd")} == units


def test_a_variable_of_one_quantity_holds_its_channels_alone_and_names_its_interval():
    given = mixed(("X", "acceleration", "m/s2"), ("p", "cylinder pressure", "bar"), ("Z", "acceleration", "m/s2"))
    made = published(given)["amplitude_acceleration"]
    assert np.isnan(made.sel(channel="p")).all() and (made.sel(channel="Z") == 3.0).all()
    assert made.attrs["ancillary_variables"] == "amplitude_low_acceleration"


@pytest.mark.parametrize(
    "channels",
    [
        [("X", "acceleration", "m/s2")],
        [("X", "acceleration", "g"), ("Z", "acceleration", "m/s2"), ("p", "pressure", "bar")],
        [("a", "x y", "V"), ("b", "x_y", "Pa"), ("c", "", "N")],  # names that differ in signs alone
        [("a", "", ""), ("b", "force", "N")],
        [("a", "force", "N"), ("b", "", ""), ("c", "pressure", "Pa")],
    ],
)
def test_what_was_parted_is_joined_again(channels, tmp_path):
    given = mixed(*channels)
    xr.testing.assert_identical(by_channel(with_real_units(given)), given)
    (tmp_path / "r.nc").write_bytes(results_bytes({"campbell_map": given}, attrs={}))
    again = read_results(tmp_path / "r.nc")["campbell_map"]
    for name in ("amplitude", "psd"):
        np.testing.assert_array_equal(again[name].values, given[name].values)
        assert again[name].attrs["units"] == given[name].attrs["units"]
    part = with_real_units(given).isel(channel=[0])  # what a notebook selects can still be drawn
    np.testing.assert_array_equal(by_channel(part)["amplitude"].values, given["amplitude"].values[:1])


def test_columns_say_what_they_are_and_every_ancillary_variable_is_there(campaign):
    tables = findings_datasets(Findings.from_dict(campaign.findings))
    assert all(column.attrs.get("long_name") for table in tables.values() for column in table.variables.values())
    orders = published(tables["findings/orders"])
    assert orders["amplitude_held"].dtype == np.float64  # a missing number is no text
    units = [orders[name].attrs["units"] for name in ("amplitude", "speed_rpm_at_max")]
    assert units == ["m/s2", "min-1"]
    phase = published(campaign.order_map.assign_attrs(phase_reference="index"))["phase"]
    assert phase.attrs["phase_convention"].endswith("crank_angle in revolutions from the index mark")
    links = 0
    for dataset in (campaign.order_map, campaign.tracks, campaign.campbell, *tables.values()):
        made = published(dataset)
        for variable in made.variables.values():
            for name in variable.attrs.get("ancillary_variables", "").split():
                assert name in made
                links += 1
    assert links > 20


def checked(file, work):
    """What the checker of the CF conventions says of each group: it looks at the root of a file alone."""
    flat = {}
    with xr.open_datatree(file, engine="h5netcdf", decode_cf=False) as tree:
        for number, node in enumerate(tree.subtree):
            flat[node.path] = str(work / f"{number}.nc")
            dataset = node.to_dataset(inherit=False).assign_attrs(tree.attrs | node.attrs)
            own = [name for name, one in dataset.variables.items() if "_FillValue" not in one.attrs]
            none = {name: {"_FillValue": None} for name in own}  # nothing is added to what the file holds
            dataset.to_netcdf(flat[node.path], engine="h5netcdf", encoding=none)
    command = [str(Path(sys.executable).with_name("compliance-checker")), "-t", "cf:1.11", "-c", "strict"]
    command += ["-f", "json_new", "-o", str(work / "said.json"), *flat.values()]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert (work / "said.json").exists(), ended.stderr[-2000:]
    found = json.loads((work / "said.json").read_text())
    said = {group: found[path]["cf:1.11"] for group, path in flat.items()}
    levels = ("high_priorities", "medium_priorities", "low_priorities")
    return {
        group: [text for level in levels for one in told[level] for text in one["msgs"]] for group, told in said.items()
    }


@pytest.mark.slow
@pytest.mark.skipif(find_spec("compliance_checker") is None, reason="compliance-checker is a development dependency")
def test_the_compliance_checker_finds_nothing_in_results_and_would_find_a_wrong_unit(tmp_path):
    time = np.arange(100_000) / 10_000.0
    noise = np.random.default_rng(1).standard_normal((4, len(time)))
    signals = dict(zip(("a", "b", "c", "d"), 2.0 * np.cos(2 * np.pi * 75.0 * time) + 0.1 * noise, strict=True))
    unit = {"a": "g", "b": "µstrain", "c": "counts", "d": "bar"}
    made = co.recording(signals, unit=unit, rate_hz=1e4, speed_rpm=1500.0, cycle="four-stroke")
    tree = co.run(made, bearings=[{"name": "drive end", "bpfo": 3.58, "bpfi": 5.42}])
    file = tmp_path / "results.nc"
    groups = {node.path.lstrip("/"): node.to_dataset() for node in tree.subtree if node.path != "/"}
    file.write_bytes(results_bytes(groups, attrs=tree.attrs))
    said = checked(file, tmp_path)
    assert {"/order_map", "/envelope_map", "/findings/orders", "/findings/quality", "/shaft"} <= set(said)
    assert {group: problems for group, problems in said.items() if problems} == {}
    wrong = xr.Dataset({"amplitude": ("speed", [1.0], {"units": "see unit", "long_name": "a"})})
    file.write_bytes(results_bytes({"order_map": wrong}, attrs={"title": "t", "history": "h"}))
    assert any("see unit" in text for text in checked(file, tmp_path)["/order_map"])
