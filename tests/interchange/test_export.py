"""Exported files hold the values of the results, as readers of others have them."""

import csv

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import crankorder as co
from crankorder.batch.result_folder import publish
from crankorder.batch.store import json_bytes
from crankorder.errors import RequestError
from crankorder.interchange.export import Column, csv_bytes, tables_of, uff58_bytes
from crankorder.report.netcdf import findings_datasets, published, read_results, results_bytes, root_attrs
from made.command import crankorder, done
from made.typed import findings_of

pyuff = pytest.importorskip("pyuff", reason="pyuff is a development dependency")

SPEEDS = np.array([600.0, 1000.0 / 3.0 * 2.5, 1200.0, 1500.0])
ORDERS = [0.5, 2.0]


COORDS = {
    "channel": ["Block µ", "p", "Z"], "unit": ("channel", ["g", "bar", "m/s2"]),
    "quantity": ("channel", ["acceleration", "cylinder pressure", "acceleration"]),
    "direction": ("channel", ["+X", "", "-Z"]),
}  # fmt: skip


def made_groups():
    """Tracks and maps of an acceleration in g, a pressure in bar and an acceleration in m/s2, of random values."""
    rng = np.random.default_rng(5)
    see, rpm = {"units": "see unit", "long_name": "peak amplitude"}, ("speed", SPEEDS, {"units": "min-1"})
    dims, shape = ("channel", "order", "speed"), (3, len(ORDERS), len(SPEEDS))
    amplitude = rng.gamma(2.0, size=shape).astype(np.float32)
    amplitude[1, 0, 1] = np.nan  # not measured
    phase = rng.uniform(-180, 180, shape).astype(np.float32)
    phase[2, 1, 3] = np.nan  # measured, with a phase that nobody knows
    tracks = xr.Dataset(
        {
            "amplitude": (dims, amplitude, see),
            "amplitude_low": (dims, 0.9 * amplitude, see),
            "phase": (dims, phase, {"units": "degree", "long_name": "phase"}),
        },
        {**COORDS, "speed": rpm, "order": ("order", ORDERS, {"units": "1"})},
        {"phase_reference": "tdc", "amplitude_scaling": "peak"},
    )
    groups = {"order_tracks": tracks}
    for name, along, axis in (
        ("order_map", "order", np.arange(33) / 3.0),
        ("campbell_map", "frequency", np.arange(0.0, 50.0, 0.5)),
    ):
        values = rng.gamma(2.0, size=(3, len(SPEEDS), len(axis))).astype(np.float32)
        values[0, 2, 5] = np.nan
        units = {"units": "1" if along == "order" else "Hz"}
        groups[name] = xr.Dataset(
            {"amplitude": (("channel", "speed", along), values, see)},
            {**COORDS, "speed": rpm, along: (along, axis, units)},
            {"amplitude_scaling": "peak", "window": "hann"},
        )
    return groups


def made_findings():
    """A mode, a crossing and a line."""
    found = {"frequency_hz": 1.0 / 3.0, "frequency_hz_ci95": [0.3, 0.4], "damping_ratio": None, "channels": ["p", "Z"]}
    line = {"channel": "p", "order": 0.5, "amplitude": 0.7, "explained_by": "firing"}
    return findings_of({
        "schema_version": 1, "test": "some test", "modes": [found], "lines": [line],
        "channels": [{"name": "Block µ", "unit": "g"}, {"name": "p", "unit": "bar"}, {"name": "Z", "unit": "m/s2"}],
        "crossings": [{"order": 2.0, "mode_hz": 1.0 / 3.0, "rpm": 10.0, "in_range": False, "excited": False}],
        "orders": [{**line, "unit": "bar", "speed_range_rpm": [1, 2]}],
    })  # fmt: skip


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A finished result folder of two quantities, with findings."""
    folder = tmp_path_factory.mktemp("out") / "some-test"
    findings, groups = made_findings(), made_groups()
    data = results_bytes({**groups, **findings_datasets(findings)}, attrs=root_attrs(findings, groups))
    run = json_bytes({"schema_version": 1, "test": "some test"})
    publish(folder, {"results.nc": data, "findings.json": json_bytes(findings.as_dict()), "run.json": run}, key="k")
    return folder


def test_another_reader_finds_every_number_of_the_results(result, tmp_path):
    for binary in [False, True]:
        (path,) = co.export(result, to="uff58", binary=binary, out=tmp_path)
        sets, groups = pyuff.UFF(str(path)).read_sets(), read_results(result / "results.nc")
        assert [one["type"] for one in sets[:3]] == [151, 164, 58]
        assert (sets[1]["units_code"], sets[1]["length"], sets[1]["force"]) == (1, 1.0, 1.0)
        kinds = [one["func_type"] for one in sets[2:]]
        assert (kinds.count(27), kinds.count(12)) == (3 * len(ORDERS), 2 * 3 * len(SPEEDS))
        factor, share = (9.80665, 1e5, 1.0), 1e-7 if binary else 1e-11
        cuts = [one for one in sets[2:] if one["func_type"] == 27]
        for one, (channel, order) in zip(cuts, np.ndindex(3, len(ORDERS)), strict=True):
            row = groups["order_tracks"].isel(channel=channel, order=order)
            known = np.isfinite(row["amplitude"].values)
            np.testing.assert_allclose(one["x"], SPEEDS[known], rtol=5e-6)  # six digits
            wanted = factor[channel] * row["amplitude"].values[known].astype(float)
            np.testing.assert_allclose(np.abs(one["data"]), wanted, rtol=share)
            if (channel, order) == (2, 1):
                assert not np.iscomplexobj(one["data"])
                assert "phase not known" in one["id4"]
            else:
                turned = np.angle(one["data"] * np.exp(-1j * np.radians(row["phase"].values[known].astype(float))))
                np.testing.assert_allclose(turned, 0.0, atol=10 * share)
            assert (one["z_axis_value"], one["abscissa_spec_data_type"]) == (ORDERS[order], 19)
        for name, kind in (("order_map", 20), ("campbell_map", 18)):
            rows = [one for one in sets[2:] if one["func_type"] == 12 and one["abscissa_spec_data_type"] == kind]
            axis = groups[name][groups[name]["amplitude"].dims[-1]].values
            for one, (channel, speed) in zip(rows, np.ndindex(3, len(SPEEDS)), strict=True):
                row = groups[name]["amplitude"].values[channel, speed]
                known = np.isfinite(row)
                np.testing.assert_allclose(one["x"], axis[known], rtol=5e-6)
                np.testing.assert_allclose(one["data"], factor[channel] * row[known].astype(float), rtol=share)
                assert one["z_axis_value"] == pytest.approx(SPEEDS[speed], rel=5e-6)
                assert one["z_axis_spec_data_type"] == 19


def test_a_universal_file_says_what_its_numbers_are():
    text = uff58_bytes(made_groups(), test="Prüfstand\n    -1\n").decode("ascii")
    assert all(len(line) <= 80 for line in text.splitlines())
    blocks = [block.splitlines() for block in text.split(f"{-1:6d}\n{-1:6d}\n")]
    assert len(blocks) == 2 + 3 * 2 + 2 * 3 * 4  # no name ends a dataset
    cut, pressure = blocks[2], blocks[4]
    assert cut[1] == "Block u: order 0.5, peak amplitude".ljust(80)
    assert cut[4].strip() == "A cos(2 pi order angle + phase), angle from top dead centre"
    assert cut[5].strip() == "9.80665 x the values of the results, which are in g"
    assert cut[9].split() == ["12", "1", "0", "0", "Amplitude", "m/s2"]
    assert pressure[9].split() == ["15", "-2", "1", "0", "Amplitude", "Pa"]
    assert pressure[6].split()[5:7] == ["2", "0"]  # node, and no direction


def test_tables_have_the_values_and_a_row_of_units(result, tmp_path):
    paths = {path.name: path for path in co.export(result, to="csv", out=tmp_path)}
    assert {"tracks.csv", "modes.csv", "crossings.csv", "lines.csv", "orders.csv"} <= set(paths)
    table = pd.read_csv(paths["tracks.csv"], header=[0, 1])
    units = {name: unit for name, unit in table.columns if not unit.startswith("Unnamed")}
    assert units["amplitude_acceleration_m_s2"] == "m/s2"
    assert units["amplitude_acceleration_g"] == "standard_free_fall"
    assert (units["amplitude_cylinder_pressure"], units["speed"], units["phase"]) == ("bar", "min-1", "degree")
    tracks = read_results(result / "results.nc")["order_tracks"]
    assert len(table) == int(np.isfinite(tracks["amplitude"]).sum())
    table.columns = table.columns.get_level_values(0)
    columns = table[[f"amplitude_{kind}" for kind in ("acceleration_m_s2", "acceleration_g", "cylinder_pressure")]]
    for (_, row), values in zip(table.iterrows(), columns.values, strict=True):
        cell = tracks.sel(channel=row["channel"], order=row["order"], speed=row["speed"])  # to the last digit
        assert values[~np.isnan(values)].astype(np.float32).tolist() == [cell["amplitude"].item()]
    with paths["modes.csv"].open(newline="") as file:
        names, unit, *rows = list(csv.reader(file))
    assert unit[names.index("frequency_hz")] == "Hz"
    assert [float(row[names.index("frequency_hz_ci95_low")]) for row in rows] == [0.3]


def test_parquet_has_the_units_in_its_fields_and_the_maps(result, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is an optional dependency")
    paths = {path.name: path for path in co.export(result, to="parquet", out=tmp_path)}
    field = parquet.read_schema(paths["tracks.parquet"]).field("speed")
    assert field.metadata[b"units"] == b"min-1"
    table = pd.read_parquet(paths["campbell_map.parquet"])
    wanted = made_groups()["campbell_map"]["amplitude"].values
    assert len(table) == np.isfinite(wanted).sum()
    np.testing.assert_array_equal(table[table["channel"] == "Z"]["amplitude_acceleration_m_s2"], wanted[2].ravel())


def test_a_text_cannot_become_a_formula_nor_a_row():
    names = np.array(["=1+1", "@SUM(A1)", "+Z", "-X", "-2+3|'/C calc'!A0", 'a,"b"\nc', "plain"], dtype=object)
    cells = [row[0] for row in csv.reader(csv_bytes([Column("name", "", "", names)]).decode().splitlines(True))][2:]
    assert cells == ["'=1+1", "'@SUM(A1)", "+Z", "-X", "'-2+3|'/C calc'!A0", 'a,"b"\nc', "plain"]


def test_the_same_results_make_the_same_bytes_and_the_command_names_what_it_wrote(result, tmp_path):
    for to in ("uff58", "csv"):
        paths = co.export(result, to=to, out=tmp_path / "one")
        ended = done("export", result.parent, "--to", to, "--out", tmp_path / "again")
        again = [tmp_path / "again" / path.relative_to(tmp_path / "one") for path in paths]
        assert ended.output.splitlines() == [str(path) for path in again]
        assert [path.read_bytes() for path in paths] == [path.read_bytes() for path in again]
    assert crankorder("export", tmp_path / "no", "--to", "csv").exit_code == 2


def test_what_cannot_be_is_refused(result, tmp_path):
    out, mine = tmp_path / "o", tmp_path / "mine" / "some-test-csv"
    mine.mkdir(parents=True)
    (mine / "tracks.csv").write_text("mine")
    for folder, options, said in (
        (tmp_path, {"to": "csv", "out": out}, "no finished results"),
        (result, {"to": "xlsx", "out": out}, "uff58, csv, parquet"),
        (result, {"to": "csv", "out": result / "inside"}, "among the results"),
        (result, {"to": "csv", "binary": True, "out": out}, "binary"),
        (result, {"to": "csv", "out": tmp_path / "mine"}, "no earlier run wrote"),
    ):
        with pytest.raises(RequestError, match=said):
            co.export(folder, **options)
    assert not out.exists() and (mine / "tracks.csv").read_text() == "mine"


def test_results_without_a_shaft_have_tables_of_the_map_alone():
    groups = {"campbell_map": made_groups()["campbell_map"]}
    assert tables_of({name: published(one) for name, one in groups.items()}) == {}
    assert uff58_bytes(groups, test="t").count(b"    58") == 3 * len(SPEEDS)
