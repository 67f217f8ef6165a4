"""Times of edges are a test of the shaft by themselves, and give the angle of signals that another file holds."""

import json
from functools import partial

import h5py
import numpy as np
import pytest
import xarray as xr

from crankorder.errors import InputError
from crankorder.ingest.draft import draft_manifests
from crankorder.ingest.manifest import load_manifest, parts_of
from crankorder.quantities import flags_of
from made.command import analysed, crankorder, done, findings_in
from made.recordings import write_hdf5, write_manifest, write_table

TEETH, MISSING, MEAN_RPM, SWING_RPM, LENGTH_S = 36, 1, 1400.0, 12.0, 6.0
RATE_HZ = 5000

WHEEL = {"pulses_per_rev": TEETH, "missing_teeth": MISSING}


def angle_of(time_s):
    """Turns of a shaft of MEAN_RPM whose speed swings by SWING_RPM twice per revolution, to first order."""
    hertz = MEAN_RPM / 60.0
    turns = hertz * time_s
    return turns - SWING_RPM / MEAN_RPM / (4.0 * np.pi) * np.cos(4.0 * np.pi * turns)


def edges_of(seed):
    """Times of the rising and falling edges of the wheel, with 2 µs of jitter."""
    rng = np.random.default_rng(seed)
    fine_s = np.linspace(0.0, LENGTH_S, 2_000_001)
    turns = angle_of(fine_s)
    tooth = np.arange(int(turns[-1] * TEETH) - 1)
    tooth = tooth[tooth % TEETH < TEETH - MISSING] + 0.25
    rising, falling = (np.interp((tooth + part) / TEETH, turns, fine_s) for part in (0.0, 0.45))
    return rising + 2e-6 * rng.standard_normal(rising.size), falling + 2e-6 * rng.standard_normal(falling.size)


def rows_of(rising, falling):
    """Edge list of a logic analyser: one line for each change of level."""
    return [f"{at:.9f},{level}" for at, level in sorted([(at, 1) for at in rising] + [(at, 0) for at in falling])]


def write_edges(path, rows):
    path.write_text("\n".join(["Time [s],crank", *rows]) + "\n", encoding="utf-8")


def write_signal(path, *, pulses=None):
    """Acceleration of order 2, peak 3 m/s2, that follows the shaft, and noise."""
    time_s = np.arange(int(LENGTH_S * RATE_HZ)) / RATE_HZ
    noise = 0.05 * np.random.default_rng(5).standard_normal(time_s.size)
    columns = {"a": 3.0 * np.cos(4.0 * np.pi * angle_of(time_s)) + noise}
    write_hdf5(path, columns if pulses is None else columns | {"pulses": pulses}, rate_hz=RATE_HZ)


def flags_in(findings):
    """What is flagged of the quality of the recordings, by flag."""
    return {flag["flag"]: flag for flag in findings["quality"]}


def test_edges_alone_are_a_test_of_the_shaft(tmp_path):
    tables = {"sampling": {"time_source": "Time [s]"}, "encoder": {"kind": "edge_list", "source": "crank", **WHEEL}}
    folder = write_manifest(tmp_path / "edges", "a.csv", name="edges", cycle="four-stroke", channels={}, **tables)
    write_edges(folder / "a.csv", rows_of(*edges_of(1)))
    done("check", folder)
    assert "The shaft turned at 13" in done("run", folder, "--out", tmp_path / "out").output
    found = findings_in(tmp_path / "out")
    assert found["orders"] == [] and found["channels"] == [] and "shaft alone" in found["not_asked_for"]
    assert found["speed_range_rpm"] == pytest.approx([MEAN_RPM - SWING_RPM, MEAN_RPM + SWING_RPM], abs=6.0)
    (swing,) = [one for one in found["speed_swing"] if one["order"] == 2.0]
    assert swing["amplitude_rpm"] == pytest.approx(SWING_RPM, rel=0.03)
    others = [one["amplitude_rpm"] for one in found["speed_swing"] if one["order"] != 2.0]
    assert max(others, default=0.0) < 0.05 * SWING_RPM
    with xr.open_dataset(tmp_path / "out" / "edges" / "results.nc", group="shaft", engine="h5netcdf") as shaft:
        assert float(shaft["speed_mean"][0]) == pytest.approx(MEAN_RPM, rel=1e-3)
    assert (tmp_path / "out" / "edges" / "speed.png").is_file()


def test_a_test_without_channels_needs_pulses(tmp_path):
    (tmp_path / "a.csv").write_text("1,2\n3,4\n", encoding="utf-8")
    write_manifest(tmp_path, "a.csv", cycle="four-stroke", channels={})
    checked = crankorder("check", tmp_path)
    assert checked.exit_code != 0
    assert "no channel is named" in checked.output and "edge_list" in checked.output


def joined(folder, *, offset_s=0.0):
    """A folder with a signal and beside it the edges of its crank on a clock that starts ``offset_s`` later."""
    encoder = {"file": "*.edges.csv", "kind": "edge_list", "source": "crank", "time_source": "Time [s]"}
    encoder |= {"offset_s": offset_s, **WHEEL}
    write_manifest(folder, "*", name="joined", cycle="four-stroke", channels={"A": {"source": "a"}}, encoder=encoder)
    write_signal(folder / "a.h5")
    write_edges(folder / "a.edges.csv", rows_of(*(edges - offset_s for edges in edges_of(0))))
    return folder


def test_edges_in_a_file_of_their_own_read_as_pulses_in_the_recording(tmp_path):
    folder = joined(tmp_path / "joined", offset_s=2.5)
    done("check", folder)
    (order,) = analysed(folder, tmp_path / "out", "--no-pictures")["orders"]
    assert order["order"] == 2.0 and order["lock"] == "locked"
    assert order["amplitude"] == pytest.approx(3.0, rel=0.003)
    stated = json.loads((tmp_path / "out" / "joined" / "run.json").read_bytes())
    assert [one["name"] for one in stated["inputs"]] == ["a.h5", "a.edges.csv"]


@pytest.mark.slow
def test_d13_clocks_of_two_devices_are_said_not_to_be_compared_and_those_of_one_are_not(tmp_path):
    told = flags_in(analysed(joined(tmp_path / "joined"), tmp_path / "out", "--no-pictures"))["clocks_not_compared"]
    pulses = edges_of(0)[0]
    assert told["severity"] == "info"
    assert f"in {1e-5 * (pulses[-1] - pulses[0]) * 1e3:.2g} ms" in told["detail"]
    tables = {"channels": {"A": {"source": "a"}}, "encoder": {"kind": "pulse_times", "source": "pulses", **WHEEL}}
    folder = write_manifest(tmp_path / "alone", "*.h5", name="alone", cycle="four-stroke", **tables)
    write_signal(folder / "a.h5", pulses=pulses)
    assert "clocks_not_compared" not in flags_in(analysed(folder, tmp_path / "alone-out", "--no-pictures"))


@pytest.mark.cases(2)
@pytest.mark.parametrize("ppm", [-100.0, 500.0, 20.0, 0.0])
def test_d13_a_drift_between_the_clocks_of_two_devices_is_told_by_the_orders(tmp_path, ppm):
    folder = joined(tmp_path / "joined")
    write_edges(folder / "a.edges.csv", rows_of(*(edges * (1.0 + 1e-6 * ppm) for edges in edges_of(3))))
    time_s = np.arange(int(LENGTH_S * RATE_HZ)) / RATE_HZ
    turns = angle_of(time_s)
    signal = sum(np.cos(2.0 * np.pi * order * turns + order) for order in (1.0, 2.0, 3.0, 5.5))
    with h5py.File(folder / "a.h5", "r+") as file:
        file["a"][:] = signal + 0.05 * np.random.default_rng(9).standard_normal(time_s.size)
    told = flags_in(analysed(folder, tmp_path / "out", "--no-pictures"))
    flag = "clocks_differ" if ppm else "clocks_agree"
    assert {"clocks_differ", "clocks_agree"} & set(told) == {flag}
    found, half = (float(text.split()[0]) for text in told[flag]["detail"].split(" by ", 1)[1].split(" ± "))
    assert abs(found - ppm) < 2.0 * half < 10.0
    assert not ppm or ("fast" if ppm > 0.0 else "slow") in told[flag]["detail"]


@pytest.mark.parametrize(
    ("kind", "edge"), [("edge_list", "rising"), ("edge_list", "falling"), ("pulse_times", "rising")]
)
def test_zeros_behind_the_last_edge_are_left_out_and_other_bad_rows_named(tmp_path, read_in, kind, edge):
    folder = joined(tmp_path / "joined")
    rising, falling = edges_of(0)
    rows = rows_of(rising, falling if kind == "edge_list" else ())
    text = (folder / "run.toml").read_text(encoding="utf-8")
    text = text.replace('kind = "edge_list"', f'kind = "{kind}"\nedge = "{edge}"')
    if kind == "pulse_times":
        text = text.replace('source = "crank"', 'source = "Time [s]"').replace('time_source = "Time [s]"\n', "")
    (folder / "run.toml").write_text(text, encoding="utf-8")
    table = folder / "a.edges.csv"
    write_edges(table, [*rows, "0,0", "0,0"])
    recording = read_in(folder / "a.h5")
    expected = falling if edge == "falling" else rising[1:] if kind == "edge_list" else rising
    np.testing.assert_allclose(recording["pulse_time"], expected, atol=1e-8)
    (zeros,) = [flag for flag in flags_of(recording) if flag["flag"] == "rows_of_zeros"]
    assert "2 rows at the end" in zeros["detail"]
    for bad, at in (("0,0", 100), ("nan,nan", len(rows))):
        write_edges(table, [*rows[:at], bad, *rows[at:]])
        with pytest.raises(InputError, match=rf"a\.edges\.csv: .*row {at + 1} of"):
            read_in(folder / "a.h5")


# Recordings and the files of their pulses, paired by a part of their names, as a manifest says or a draft finds.


RPM = {f"step_{step:02d}_{rpm:.0f}rpm": rpm for step, rpm in enumerate((900.0, 1010.0, 1150.0, 1310.0), 1)}


def columns_of(rpm, seed):
    """Samples and events on one clock of whole microseconds; order 1 of 0.02 (rpm/1000)² g at -75°."""
    rng, hz = np.random.default_rng(seed), rpm / 60.0
    us = 1_700_000_123 + seed * 31_000_000 + 1000 * np.arange(6000)
    at = 0.013 + np.arange(int(5.9 * hz)) / hz + rng.uniform(-1e-5, 1e-5, int(5.9 * hz))
    y = 0.02 * (rpm / 1000.0) ** 2 * np.cos(2.0 * np.pi * hz * (1e-3 * np.arange(6000) - 0.013) - np.deg2rad(75.0))
    samples = {"timestamp_us": us, "y_g": y + 0.002 * rng.standard_normal(6000)}
    events = {"timestamp_us": us[0] + np.rint(at * 1e6).astype(np.int64), "rotation_num": np.arange(at.size)}
    return samples, events


def folder_of(folder, samples, events):
    for seed, (run, rpm) in enumerate(RPM.items(), 1):
        for pattern, columns in zip((samples, events), columns_of(rpm, seed), strict=True):
            path = folder / pattern.format(run=run)
            path.parent.mkdir(parents=True, exist_ok=True)
            (write_hdf5 if path.suffix == ".h5" else partial(write_table, fmt="%.16g"))(path, columns)
    return folder


NAMES = [
    ("MSG_ACCEL_SAMPLES_{run}.csv", "MSG_HALL_EVENT_{run}.csv"), ("{run}_acc.csv", "{run}_hall.csv"),
    ("{run}.h5", "{run}.hall"), ("acc {run} y.csv", "tacho {run} z.csv"),
]  # fmt: skip


@pytest.mark.parametrize(("samples", "events"), NAMES)
def test_a_draft_pairs_recordings_with_the_files_of_their_pulses(tmp_path, samples, events):
    folder = folder_of(tmp_path / "hall", samples, events)
    text = draft_manifests(folder).text
    (folder / "run.toml").write_text(text, encoding="utf-8")
    drafted = load_manifest(folder)
    assert drafted.encoder.kind == "pulse_times" and drafted.encoder.source == "timestamp_us"
    for run in RPM:
        assert drafted.pulses_of(folder / samples.format(run=run)) == folder / events.format(run=run)
    assert "1                # ? 15 pulses/s at the stated speed" in text
    if (samples, events) == NAMES[0]:
        (order,) = analysed(folder, tmp_path / "out", "--no-pictures")["orders"]
        assert order["amplitude"] == pytest.approx(0.02 * 1.31**2, rel=0.02)
        assert order["phase_deg"] == pytest.approx(-75.0, abs=1.0)
        assert order["speed_exponent"] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("other", ["temperature", "speed", "later"])
def test_a_draft_takes_no_slow_recording_for_pulses(tmp_path, other):
    folder = folder_of(tmp_path / "hall", "acc_{run}.csv", "slow_{run}.csv")
    for seed, (run, rpm) in enumerate(RPM.items(), 1):
        samples, _ = columns_of(rpm, seed)
        us = samples["timestamp_us"][::100] + (0 if other != "later" else 10**9)
        slow = 85.0 + 0.1 * np.random.default_rng(seed).standard_normal(us.size)
        columns = {"temperature": {"oil": slow}, "speed": {"rpm": rpm + slow}, "later": {"turns": np.arange(us.size)}}
        write_table(folder / f"slow_{run}.csv", {"timestamp_us": us} | columns[other], fmt="%.16g")
    assert "file = " not in draft_manifests(folder).text


def test_parts_of_names_are_any_number_and_may_come_again():
    rows = [
        ("ACC_{a}_{b}.csv", "ACC_1_x2.csv", {"a": "1", "b": "x2"}), ("{a}/ACC_{a}.csv", "q/ACC_q.csv", {"a": "q"}),
        ("{a}/ACC_{a}.csv", "q/ACC_r.csv", None), ("**/M_{s}[12].csv", "u/v/M_52.csv", {"s": "5"}),
        ("**/M_{s}.csv", "M_5.csv", {"s": "5"}), ("*_{a}_*.csv", "x_y_z.csv", {"a": "y"}),
    ]  # fmt: skip
    for pattern, name, parts in rows:
        assert parts_of(pattern, name) == parts


def test_parts_that_do_not_pair_are_refused(tmp_path):
    folder = folder_of(tmp_path / "hall", "ACC_{run}.csv", "HALL_{run}.csv")
    (folder / "HALL_step_03_5rpm.csv").write_text("left alone\n")
    rows = [
        ("ACC_{run}.csv", "HALL_{run}.csv", ""),
        ("ACC_step_{number}_{rpm}rpm.csv", "HALL_step_{number}_{rpm}rpm.csv", ""),
        ("ACC_{run}.csv", "HALL_{step}.csv", "found {step}; allowed: {run}. Write {step} in each pattern"),
        ("ACC_*.csv", "HALL_{step}.csv", "found {step}; allowed: * alone"),
        ("ACC_{run}.csv", "HALL_step_01_900rpm.csv", "HALL_step_01_900rpm.csv for ACC_step_01_900rpm.csv, ACC_step_02"),
        ("ACC_{run}.csv", "PULSE_{run}.csv", "PULSE_step_01_900rpm.csv: no such file"),
        ("ACCEL_{run}.csv", "HALL_{run}.csv", "no recording found; looked for ACCEL_{run}.csv"),
    ]
    for files, pulses, words in rows:
        encoder = {"file": pulses, "source": "timestamp_us", "kind": "pulse_times", "pulses_per_rev": 1}
        tables = {"channels": {"y_g": {"unit": "g"}}, "sampling": {"time_source": "timestamp_us"}, "encoder": encoder}
        write_manifest(folder, files, **tables)
        checked = crankorder("check", folder)
        assert bool(checked.exit_code) == bool(words), checked.output
        assert words in checked.output
