"""What leaves the program: real units, linked intervals, words that travel; read by the CF compliance checker."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import crankorder as co
from crankorder.channel_units import by_channel, with_real_units
from crankorder.findings import Findings
from crankorder.report.netcdf import findings_datasets, published, read_results, results_bytes

_CHECK = """
import json, sys
from pathlib import Path
import netCDF4
from compliance_checker.runner import ComplianceChecker, CheckSuite
CheckSuite.load_all_available_checkers()

def groups(group):
    yield group
    for inner in group.groups.values():
        yield from groups(inner)

with netCDF4.Dataset(sys.argv[1]) as file:
    said = {}
    for group in groups(file):  # the checker looks at the root alone: each group becomes a file of its own
        flat = Path(sys.argv[2]) / "flat.nc"
        with netCDF4.Dataset(flat, "w") as made:
            made.setncatts({k: owner.getncattr(k) for owner in (file, group) for k in owner.ncattrs()})
            for dim in group.dimensions.values():
                made.createDimension(dim.name, len(dim))
            for one in group.variables.values():
                kind = str if one.dtype == str else one.dtype
                new = made.createVariable(one.name, kind, one.dimensions)
                new.setncatts({k: one.getncattr(k) for k in one.ncattrs()})
                if one.size:
                    new[...] = one[...]
        out = Path(sys.argv[2]) / "said.json"
        ComplianceChecker.run_checker(
            str(flat), ["cf:1.11"], 0, "strict", output_filename=str(out), output_format="json")
        found = json.loads(out.read_text())["cf:1.11"]
        problems = [m for key in ("high_priorities", "medium_priorities", "low_priorities")
                    for one in found[key] for m in one["msgs"]]
        said[group.path] = problems
print(json.dumps(said))
"""


def mixed(*channels: tuple[str, str, str]) -> xr.Dataset:
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


def test_channels_of_one_unit_keep_the_name_and_get_the_unit() -> None:
    made = with_real_units(mixed(("X", "acceleration", "m/s2"), ("Z", "acceleration", "m/s2")))
    assert made["amplitude"].attrs["units"] == "m/s2"
    assert made["psd"].attrs["units"] == "(m/s2)2 Hz-1"


def test_channels_of_several_quantities_have_a_variable_for_each() -> None:
    given = mixed(("X", "acceleration", "m/s2"), ("p", "cylinder pressure", "bar"), ("Z", "acceleration", "m/s2"))
    made = with_real_units(given)
    assert {str(name) for name in made if "ampl" in str(name)} == {
        "amplitude_acceleration", "amplitude_cylinder_pressure",
        "amplitude_low_acceleration", "amplitude_low_cylinder_pressure",
    }  # fmt: skip
    assert made["amplitude_cylinder_pressure"].attrs["units"] == "bar"
    assert np.isnan(made["amplitude_acceleration"].sel(channel="p")).all()
    assert (made["amplitude_acceleration"].sel(channel="Z") == 3.0).all()
    assert published(given)["amplitude_acceleration"].attrs["ancillary_variables"] == "amplitude_low_acceleration"


def test_two_units_of_one_quantity_are_told_apart_and_the_gram_is_no_acceleration() -> None:
    made = with_real_units(mixed(("X", "acceleration", "g"), ("Z", "acceleration", "m/s2"), ("W", "", "µm")))
    units = {str(name): made[name].attrs["units"] for name in made if str(name).startswith("psd")}
    assert units == {
        "psd_acceleration_g": "(standard_free_fall)2 Hz-1", "psd_acceleration_m_s2": "(m/s2)2 Hz-1",
        "psd_um": "(um)2 Hz-1",
    }  # fmt: skip


@pytest.mark.cases(1)
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
def test_what_was_parted_is_joined_again(channels: list[tuple[str, str, str]], tmp_path: Path) -> None:
    given = mixed(*channels)
    xr.testing.assert_identical(by_channel(with_real_units(given)), given)
    (tmp_path / "r.nc").write_bytes(results_bytes({"campbell_map": given}, attrs={}))
    again = read_results(tmp_path / "r.nc")["campbell_map"]
    for name in ("amplitude", "psd"):
        np.testing.assert_array_equal(again[name].values, given[name].values)
        assert again[name].attrs["units"] == given[name].attrs["units"]
    part = with_real_units(given).isel(channel=[0])  # what a notebook selects can still be drawn
    np.testing.assert_array_equal(by_channel(part)["amplitude"].values, given["amplitude"].values[:1])


def test_tables_say_what_a_column_is_and_a_missing_number_is_no_text(campaign: Any) -> None:
    tables = findings_datasets(Findings.from_dict(campaign.findings))
    for name, table in tables.items():
        for key, column in table.variables.items():
            assert column.attrs.get("long_name"), f"{name}/{key}"
    orders = published(tables["findings/orders"])
    assert orders["amplitude"].attrs["units"] == "m/s2"
    assert orders["amplitude"].attrs["ancillary_variables"] == "amplitude_ci95"
    assert orders["amplitude_held"].dtype == np.float64
    assert orders["speed_rpm_at_max"].attrs["units"] == "min-1"


def test_every_ancillary_variable_is_there(campaign: Any) -> None:
    tables = findings_datasets(Findings.from_dict(campaign.findings))
    links = 0
    for dataset in (campaign.order_map, campaign.tracks, campaign.campbell, *tables.values()):
        made = published(dataset)
        for variable in made.variables.values():
            for name in variable.attrs.get("ancillary_variables", "").split():
                assert name in made
                links += 1
    assert links > 20


def test_conventions_stand_beside_the_numbers(campaign: Any) -> None:
    made = published(campaign.order_map.assign_attrs(phase_reference="index", window="hann"))
    assert made["phase"].attrs["phase_convention"].endswith("crank_angle in revolutions from the index mark")
    assert made["amplitude"].attrs["window"] == "hann"


def checked(file: Path, work: Path) -> dict[str, list[str]]:
    """What the checker says of each group of ``file``."""
    command = [sys.executable, "-W", "ignore", "-c", _CHECK, str(file), str(work)]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr[-2000:]
    said: dict[str, list[str]] = json.loads(ended.stdout.splitlines()[-1])
    return said


@pytest.mark.slow
@pytest.mark.skipif(find_spec("compliance_checker") is None, reason="compliance-checker is a development dependency")
def test_the_compliance_checker_finds_nothing_in_results(tmp_path: Path) -> None:
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


@pytest.mark.slow
@pytest.mark.skipif(find_spec("compliance_checker") is None, reason="compliance-checker is a development dependency")
def test_the_compliance_checker_would_find_a_unit_that_is_none(tmp_path: Path) -> None:
    file = tmp_path / "results.nc"
    wrong = xr.Dataset({"amplitude": ("speed", [1.0], {"units": "see unit", "long_name": "a"})})
    file.write_bytes(results_bytes({"order_map": wrong}, attrs={"title": "t", "history": "h"}))
    assert any("see unit" in text for text in checked(file, tmp_path)["/order_map"])
