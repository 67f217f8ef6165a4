"""The results file: the same bytes each time, checksummed, readable by others, and back without loss."""

import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr

from crankorder.errors import InputError, UnsafeInputError
from crankorder.quantities import check_dataset
from crankorder.report.netcdf import findings_datasets, read_results, results_bytes
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
        "filters": amplitude.filters(), "channel": campbell["channel"][:].tolist(),
        "speed": campbell["speed"][:].tolist(), "order": file["findings/orders/order"][:].tolist(),
        "explained": file["findings/orders/explained_by"][:].tolist(),
    }))
"""
_WRITE_AGAIN = """
import hashlib, sys
import numpy as np
sys.path.insert(0, sys.argv[1])
from report.conftest import drawn_test
from crankorder.findings import Findings
from crankorder.report.netcdf import findings_datasets, results_bytes
test = drawn_test(np.arange(300.0, 2001.0, 50.0))
groups = {"order_map": test.order_map, "campbell_map": test.campbell, "order_tracks": test.tracks}
findings = findings_datasets(Findings.from_dict(test.findings))
print(hashlib.sha256(results_bytes(groups | findings, attrs={"title": "t"})).hexdigest())
"""


@pytest.fixture(scope="module")
def groups(campaign: Any) -> dict[str, xr.Dataset]:
    maps = {"order_map": campaign.order_map, "campbell_map": campaign.campbell, "order_tracks": campaign.tracks}
    return maps | findings_datasets(campaign.findings)


@pytest.fixture
def file(groups: dict[str, xr.Dataset], tmp_path: Path) -> Path:
    path = tmp_path / "results.nc"
    path.write_bytes(results_bytes(groups, attrs={"title": "t"}))
    return path


def test_what_is_read_back_is_what_was_written_and_fits_its_schema(groups: dict[str, xr.Dataset], file: Path) -> None:
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


def test_values_beyond_single_precision_keep_64_bits(tmp_path: Path) -> None:
    values = np.array([[1e-300, 0.0], [1e300, 1.0]])
    path = tmp_path / "r.nc"
    path.write_bytes(results_bytes({"g": xr.Dataset({"amplitude": (("a", "b"), values)})}, attrs={}))
    np.testing.assert_array_equal(read_results(path)["g"]["amplitude"].values, values)


def test_the_bytes_are_the_same_in_another_process_and_in_any_order_of_groups(groups: dict[str, xr.Dataset]) -> None:
    command = [sys.executable, "-c", _WRITE_AGAIN, str(Path(__file__).parents[1])]
    other = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    assert hashlib.sha256(results_bytes(groups, attrs={"title": "t"})).hexdigest() == other
    turned = dict(reversed(groups.items()))
    assert results_bytes(groups, attrs={"a": 1, "b": 2}) == results_bytes(turned, attrs={"b": 2, "a": 1})


def test_netcdf4_reads_the_same_values_and_finds_the_checksums(file: Path, groups: dict[str, xr.Dataset]) -> None:
    pytest.importorskip("netCDF4", reason="netCDF4 is a development dependency")
    command = [sys.executable, "-c", _READ_BY_NETCDF4, str(file)]
    said = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    assert said["conventions"] == "CF-1.11, ACDD-1.3"
    assert said["groups"] == ["campbell_map", "findings", "order_map", "order_tracks"]
    assert {"orders", "modes", "crossings", "bearings", "quality"} <= set(said["findings"])
    assert said["dims"] == ["channel", "speed", "frequency"]
    assert said["sum"] == pytest.approx(float(groups["campbell_map"]["amplitude"].sum()), rel=1e-6)
    assert (said["units"], said["channel"]) == ("min-1", ["X", "Y", "Z"])
    assert said["speed"] == groups["campbell_map"]["speed"].values.tolist()
    assert (said["filters"]["zlib"], said["filters"]["shuffle"], said["filters"]["fletcher32"]) == (True, True, True)
    assert said["order"] == groups["findings/orders"]["order"].values.tolist()
    assert said["explained"] == groups["findings/orders"]["explained_by"].values.tolist()


@pytest.mark.slow
def test_complex_spectra_become_two_variables_and_one_again(tmp_path: Path) -> None:
    values = np.exp(1j * np.arange(6.0)).reshape(2, 3)
    dataset = xr.Dataset({"spectrum": (("frame", "order"), values, {"units": "see unit"})})
    path = tmp_path / "r.nc"
    path.write_bytes(results_bytes({"order_frames": dataset}, attrs={}))
    with h5py.File(path) as file:
        assert {"spectrum_real", "spectrum_imag"} <= set(file["order_frames"])
    again = read_results(path)["order_frames"]["spectrum"]
    np.testing.assert_allclose(again.values, values, rtol=1e-6)
    assert again.attrs == {"units": "see unit"}


def test_attributes_of_any_kind_can_be_written(tmp_path: Path) -> None:
    attrs = {"none": None, "yes": True, "table": {"a": [1]}, "path": Path("x"), "text": "a\x00b", "long": "é" * 100_000}
    path = tmp_path / "r.nc"
    path.write_bytes(results_bytes({"g": xr.Dataset()}, attrs=attrs | {"numbers": [1.5, 2.5]}))
    with h5py.File(path) as file:
        said = dict(file.attrs)
    assert "none" not in said
    assert (np.ravel(said["yes"]).tolist(), said["table"], said["path"]) == ([1], '{"a": [1]}', '"x"')
    assert (said["text"], len(said["long"]), said["numbers"].tolist()) == ("a\\x00b", 100_000, [1.5, 2.5])


def test_records_become_columns_with_units_and_missing_numbers_are_nan() -> None:
    findings = {
        "schema_version": 1,
        "test": "t",
        "unexplained_energy_fraction": None,
        "balance": None,
        "modes": [
            {"frequency_hz": 60.0, "frequency_hz_ci95": [59.9, 60.1], "damping_ratio": None, "channels": ["X", "Z"]},
            {"frequency_hz": 115.0, "frequency_hz_ci95": None, "damping_ratio": 0.01, "channels": []},
        ],
        "crossings": [{"order": 4.0, "excited": True}, {"order": 8.0, "excited": False}],
    }
    tables = findings_datasets(findings)
    assert sorted(tables) == ["findings", "findings/crossings", "findings/modes"]
    modes = tables["findings/modes"]
    assert modes["frequency_hz"].attrs["units"] == "Hz"
    assert modes["frequency_hz_ci95"].dims == ("record", "bound")
    assert np.isnan(modes["frequency_hz_ci95"].values[1]).all()
    assert np.isnan(modes["damping_ratio"].values[0])
    assert modes["channels"].values.tolist() == ["X, Z", ""]
    assert tables["findings/crossings"]["excited"].values.tolist() == [1, 0]


@pytest.mark.cases(1)
@pytest.mark.parametrize("share", [0.999, 0.0, 0.01, 0.5])
def test_a_cut_results_file_is_refused_by_name(file: Path, share: float) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=r"results\.nc"):
        read_results(file)


@pytest.mark.slow
def test_a_flipped_bit_in_the_data_never_comes_back_as_a_number(file: Path) -> None:
    whole, data = read_results(file), file.read_bytes()
    rng = np.random.default_rng(11)
    refused = 0
    for place in rng.integers(0, len(data), 40):
        damaged = bytearray(data)
        damaged[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(bytes(damaged))
        try:
            read = read_results(file)
        except InputError:
            refused += 1
            continue
        np.testing.assert_array_equal(read["campbell_map"]["amplitude"], whole["campbell_map"]["amplitude"])
    assert refused > 20


def test_a_file_that_reaches_outside_itself_is_refused(tmp_path: Path) -> None:
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


def test_a_false_size_and_a_foreign_file_are_refused_before_anything_is_allocated(tmp_path: Path) -> None:
    huge, foreign = tmp_path / "huge.nc", tmp_path / "foreign.nc"
    with h5py.File(huge, "w") as file:
        file.attrs["Conventions"] = "CF-1.11"
        file.create_group("order_map").create_dataset("amplitude", (10**12,), "f8", chunks=(1000,))
    with h5py.File(foreign, "w") as file:
        file["x"] = 1
    with pytest.raises(UnsafeInputError, match="too much"):
        read_results(huge)
    with pytest.raises(InputError, match="not a results file"):
        read_results(foreign)
    with pytest.raises(InputError, match=r"nothing\.nc"):
        read_results(tmp_path / "nothing.nc")
