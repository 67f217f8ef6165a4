"""Encoders that tell the angle with every sample, counters that tell none, and speeds that names of files state."""

import json
import re

import numpy as np
import pytest

from crankorder.errors import InputError
from crankorder.ingest.draft import draft_manifests
from crankorder.shaft.angle import angle_at, knots_of
from crankorder.shaft.decode import shaft_angle
from crankorder.stages import shaft as shaft_stage
from made.command import crankorder, done
from made.recordings import write_hdf5, write_manifest, write_table

RATE_HZ, LENGTH_S = 4000.0, 4.0
TIME_S = np.arange(int(RATE_HZ * LENGTH_S)) / RATE_HZ


def turns_of(first_hz, last_hz):
    return 0.3 + first_hz * TIME_S + 0.5 * (last_hz - first_hz) / LENGTH_S * TIME_S**2


def signal_of(turns):
    noise = 0.02 * np.random.default_rng(4).standard_normal(turns.size)
    return np.cos(2 * np.pi * turns - 0.5) + 0.4 * np.cos(5 * np.pi * turns) + noise


def written(folder, position, name, unit, signal):
    columns = {"time (s)": TIME_S, "acc (m/s2)": signal, f"{name} ({unit})" if unit else name: position}
    return write_table(folder / "a.csv", columns, fmt="%.6f")


def flags_in(dataset):
    return {one["flag"] for one in json.loads(dataset.attrs["quality"])}


COUNTS = {"wrapped": lambda c, n: c % n, "16 bit": lambda c, _: c % 65536, "growing": lambda c, _: c}


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(
    ("name", "unit", "counts", "speeds"),
    [
        ("angle", "deg", 4096, (15.0, 33.0)), ("angle 720", "deg", 360, (20.0, 20.0)),
        ("angle growing", "deg", 1000, (31.0, 17.0)), ("theta", "rad", 500, (15.0, 33.0)),
        ("position", "rev", 2048, (200.0, 400.0)), ("wrapped", "counts", 24, (15.0, 33.0)),
        ("wrapped", "counts", 4096, (25.0, 25.0)), ("16 bit", "counts", 1024, (15.0, 33.0)),
        ("growing", "counts", 60, (200.0, 300.0)),
    ],
)  # fmt: skip
def test_a_position_tells_the_angle_with_every_sample(tmp_path, settings, read_in, way, name, unit, counts, speeds):
    turns = turns_of(*speeds)
    count = np.floor(way * turns * counts)
    if unit == "counts":
        position, label = COUNTS[name](count, counts), "position"
    else:
        span = {"angle 720": 2 * counts, "angle growing": 1 << 40}.get(name, counts)
        position = (count % span if span < 1 << 40 else count) * {"deg": 360.0, "rad": 2 * np.pi, "rev": 1.0}[unit]
        position, label = position / counts, name.split()[0]
    wrong = np.random.default_rng(counts).integers(20, TIME_S.size - 20, 3)
    position[wrong] = [0.0, position.max(), np.floor(position.mean())]
    path = written(tmp_path, position, label, unit, signal_of(turns))
    text = draft_manifests(tmp_path).text.replace("# pulses_per_rev = 4096 ", f"pulses_per_rev = {counts}")
    (tmp_path / "run.toml").write_text(text)
    shaft = shaft_angle(read_in(path), settings=settings.shaft)
    at = TIME_S[20:-20]
    angle = angle_at(at, **knots_of(shaft))
    off = angle - turns[20:-20]
    off = np.abs(off - np.round(np.median(off)))
    assert np.quantile(off, 0.99) < max(0.005, 0.6 / counts)
    assert off.max() < 0.2  # a wrong sample makes no turn
    first = 2 * np.mean(signal_of(turns)[20:-20] * np.exp(-2j * np.pi * angle))
    assert abs(first) == pytest.approx(1.0, abs=0.02)
    assert np.degrees(np.angle(first)) == pytest.approx(-28.6, abs=2.0)
    counted = unit == "counts" and name != "wrapped"
    assert shaft.attrs["phase_reference"] == ("count" if counted else "index")
    assert ("no_index" in flags_in(shaft)) == counted


@pytest.mark.parametrize(
    ("position", "told"),
    [
        (np.floor(turns_of(15, 33) * 4096) % 4096, "starts anew after 4096"),  # lines stated, not counts
        (np.floor(turns_of(15, 33) * 1000) % 1000, "starts anew after 1000"),
        (np.floor(np.abs(TIME_S - 2.0) * 20 * 1024), "turns both ways"),
        (np.zeros(TIME_S.size), "does not change"),
    ],
)
def test_a_count_that_is_not_as_stated_is_refused(tmp_path, read_in, position, told):
    path = written(tmp_path, position, "position", "counts", signal_of(turns_of(15, 33)))
    encoder = {"kind": "count", "source": "position (counts)", "pulses_per_rev": 1024}
    sampling = {"time_source": "time (s)"}
    write_manifest(tmp_path, "*.csv", channels={"acc (m/s2)": {}}, sampling=sampling, encoder=encoder)
    with pytest.raises(InputError, match=told):
        read_in(path)


ROW = np.arange(TIME_S.size)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("sequence_num", ROW), ("index", 100 + 2 * ROW),
        ("sample", ROW + np.cumsum(np.random.default_rng(1).random(ROW.size) < 0.002)), ("counter", ROW % 256),
        ("rotation_num", ROW // 10),
    ],
)  # fmt: skip
def test_a_counter_of_samples_takes_no_part(tmp_path, name, values):
    written(tmp_path, values.astype(float), name, "", signal_of(turns_of(15, 33)))
    text = draft_manifests(tmp_path).text
    assert re.search(r"^\[encoder\]", text, re.M) is None
    assert f'column "{name}" is left out' in text
    assert text.count("[[channels]]") == 1


@pytest.mark.parametrize(("high", "low", "noise"), [(0.11, -0.55, 0.03), (5.0, 0.0, 0.1), (5.0, 0.0, 0.0)])
@pytest.mark.parametrize("name", ["ch2", "tacho", "keyphasor"])
def test_short_dips_are_pulses(tmp_path, high, low, noise, name):
    turns = turns_of(15, 33)
    trace = np.where(turns % 1.0 < 0.06, low, high) + noise * np.random.default_rng(3).standard_normal(turns.size)
    written(tmp_path, trace, name, "V", signal_of(turns))
    text = draft_manifests(tmp_path).text
    assert f'source = "{name} (V)"' in text[text.index("\n[encoder]") :]
    assert re.search(r'^kind = "square"', text, re.M)
    assert 'edge = "falling"' in text


@pytest.mark.parametrize("name", ["run_452rpm", "452 rpm", "speed=452", "n452"])
def test_a_speed_in_a_name_is_held_against_the_speed_found(tmp_path, settings, read_in, name):
    path = written(tmp_path, ROW.astype(float), "sequence_num", "", signal_of(turns_of(7.53, 7.53)))
    path = path.rename(tmp_path / f"{name}.csv")
    text = draft_manifests(tmp_path).text
    assert f'"{name}.csv" = 452' in text
    for rpm, told in ((60, not name.startswith("n")), (470, False)):
        (tmp_path / "run.toml").write_text(text.replace("= 452 ", f"= {rpm} "))
        assert ("speed_not_as_named" in flags_in(shaft_stage(read_in(path), settings))) == told
    assert "speed_not_as_named" not in done("check", tmp_path).output


# Files by crank angle that hold a column of angles: a manifest that contradicts it is refused, whatever the format.


def as_text(folder, angle, pressure):
    """With an angle of another thing beside it, which counts for nothing."""
    throttle = np.random.default_rng(3).normal(20.0, 1.0, angle.size)
    columns = {"CA (deg)": angle, "p_cyl (bar)": pressure, "throttle (deg)": throttle}
    write_table(folder / "a.txt", columns, separator="\t", fmt="%.5f")


def as_hdf5(folder, angle, pressure):
    columns = {"alpha": np.deg2rad(angle), "p": pressure.astype(np.float32)}
    write_hdf5(folder / "a.h5", columns, unit={"alpha": "rad", "p": "bar"})


def as_mdf4(folder, angle, pressure):
    asammdf = pytest.importorskip("asammdf", reason="the package asammdf (extra mdf) is not installed")
    growing = np.unwrap(angle, period=720.0)  # a master grows
    signal = asammdf.Signal(pressure, growing, unit="bar", name="p_cyl", master_metadata=("angle", 2))
    with asammdf.MDF(version="4.10") as file:
        file.append([signal])
        file.save(folder / "a.mf4", overwrite=True)


@pytest.mark.parametrize(("write", "seed"), [(as_text, 1), (as_hdf5, 1), (as_mdf4, 1), (as_text, 2)])
@pytest.mark.cases(4)
def test_a_manifest_that_contradicts_the_files_angles_is_refused_and_a_right_one_is_not(tmp_path, read_in, write, seed):
    rng = np.random.default_rng(seed)
    per_rev = int(rng.choice([180, 360, 1024]))
    start = -360.0 if seed == 1 else float(rng.integers(0, per_rev)) * 360.0 / per_rev
    angle = (start + np.arange(12 * per_rev) * 360.0 / per_rev + 360.0) % 720.0 - 360.0
    write(tmp_path, angle, 10.0 + np.cos(np.deg2rad(angle)) + 0.01 * rng.standard_normal(angle.size))
    text = draft_manifests(tmp_path).text.replace('cycle = "rotor"', 'cycle = "four-stroke"')
    assert ("the angle runs over two revolutions" in text) == (write is not as_mdf4)  # whose angle grows

    def read(text):
        (tmp_path / "run.toml").write_text(text, encoding="utf-8")
        return read_in(next(tmp_path.glob("a.*"))).attrs

    drafted = read(text)
    assert drafted["samples_per_rev"] == per_rev and "rate_hz" not in drafted
    assert drafted["start_deg"] == pytest.approx(start, abs=1e-3)
    base = "\n".join(line for line in text.splitlines() if not line.startswith("start_deg"))
    stated = f"samples_per_rev = {per_rev}"
    assert read(base.replace(stated, f"{stated}\nstart_deg = {start + 720.0}"))["start_deg"] == start + 720.0
    (tmp_path / "run.toml").write_text(text.replace(stated, f"samples_per_rev = {2 * per_rev}"), encoding="utf-8")
    for command in (("check", tmp_path), ("run", tmp_path, "--out", tmp_path.parent / f"{tmp_path.name}-out")):
        refused = crankorder(*command)
        assert refused.exit_code and f"found {2 * per_rev}; allowed: {per_rev}" in refused.output
    for wrong in (2 * per_rev, per_rev + 1):
        with pytest.raises(InputError, match=rf"found {wrong}; allowed: {per_rev}\b"):
            read(text.replace(stated, f"samples_per_rev = {wrong}"))
    for off in (360.0, 7.0, -90.0):
        with pytest.raises(InputError, match=r"sampling.start_deg: the manifest contradicts"):
            read(base.replace(stated, f"{stated}\nstart_deg = {start + off}"))
