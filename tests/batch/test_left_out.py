"""A useless channel is left out alone, a lost stretch alone: the rest of the recording stays in the averages."""

import h5py
import numpy as np
import pytest
import xarray as xr

from made.command import analysed, crankorder, findings_in
from made.contradictions import contradictions
from made.recordings import manifest

RATE, SECONDS = 5000.0, 10.0
MANIFEST = manifest(
    channels={"X": {}, "Y": {}}, recordings={"files": ["*.h5"], "speed_rpm": {"a.h5": 1500.0, "b.h5": 1800.0}},
    sampling={"rate_hz": RATE}, encoder={"kind": "constant"},
)  # fmt: skip


def signals(rpm, seed):
    time = np.arange(round(RATE * SECONDS)) / RATE
    rng = np.random.default_rng(seed)
    tones = [a * np.cos(2 * np.pi * k * rpm / 60.0 * time + k) for k, a in ((1, 3.0), (2, 1.0))]
    return np.stack([np.sum(tones, axis=0), 0.5 * np.sum(tones, axis=0)]) + 0.05 * rng.normal(size=(2, time.size))


def run(place, spoil):
    """Exit status, findings and order map of two recordings in the new folder ``place``, of the first some spoilt."""
    folder, out = place / "in", place / "out"
    folder.mkdir(parents=True)
    (folder / "run.toml").write_text(MANIFEST)
    for name, rpm, seed in (("a", 1500.0, 1), ("b", 1800.0, 2)):
        columns = dict(zip("XY", signals(rpm, seed), strict=True)) | (spoil if name == "a" else {})
        with h5py.File(folder / f"{name}.h5", "w") as file:
            for channel, row in columns.items():
                file[channel] = row.astype(np.float32)
    outcome = crankorder("run", folder, "--out", out, "-q", "--recipe", "maps", "--no-pictures")
    order_map = xr.load_dataset(next(out.glob("*/results.nc")), group="order_map", engine="h5netcdf")
    return outcome.exit_code, findings_in(out), order_map


def flag_of(place, kind, row):
    """The one flag of a ``kind`` and the order map where ``row`` is channel X of the first recording."""
    status, findings, order_map = run(place, {"X": row})
    [flag] = [flag for flag in findings["quality"] if flag["flag"] == kind]
    assert (status, flag["recording"], flag["channel"]) == (0, "a.h5", "X")
    return flag, order_map


STILL = np.full(round(RATE * SECONDS), 1.5)


def spoilt(begin, end, value):
    """Channel X of the first recording, its samples from ``begin`` to ``end`` lost to a ``value``."""
    row = signals(1500.0, 1)[0]
    row[begin:end] = value
    return row


def amplitude(order_map, rpm, channel):
    rows = order_map["amplitude"].sel(channel=channel).sel(order=1.0, method="nearest")
    return float(rows.values[np.argmin(np.abs(order_map["speed"].values - rpm))])


SINCE_OVERLOAD = np.arange(round(RATE * SECONDS)) / RATE - 3.0
OVERLOAD = np.where(SINCE_OVERLOAD < 0.0, 0.0, 100.0 * np.exp(-np.maximum(SINCE_OVERLOAD, 0.0) / 0.06))
LEFT_OUT = {
    "a dead channel": ("constant_signal", STILL, "channel", "bad", None),
    "an overload with its way back": (
        "iepe_overload", signals(1500.0, 1)[0] + OVERLOAD, "stretch", "bad", ((3.0, 0.05), (3.35, 0.25)),
    ),
    "a lost stretch": ("dropout", spoilt(20_000, 22_000, 0.0), "stretch", "bad", ((4.0, 4e-6), (4.4, 4e-6))),
    "much between sound stretches": ("dropout", spoilt(20_000, 23_000, 0.7), "channel", "bad", None),
    "much at the end": ("dropout", spoilt(35_000, 50_000, 0.7), "stretch", "bad", None),
    "silence at the beginning": ("silence", spoilt(0, 15_000, 0.0), "stretch", "suspect", None),
    "few levels": ("few_levels", np.round(signals(1500.0, 1)[0] / 3.0) * 3.0, "channel", "bad", None),
    "samples missing": ("gap", spoilt(10_000, 30_000, np.nan), "channel", "bad", None),
}  # fmt: skip
"""Flag, channel X of the first recording, what of it is left out, how bad that is, begin and end in s, each within."""


@pytest.mark.cases(4)
@pytest.mark.parametrize("what", LEFT_OUT)
def test_a_channel_goes_or_a_stretch_of_it_and_all_else_stays(tmp_path, what):
    kind, row, left_out, severity, stretch = LEFT_OUT[what]
    flag, order_map = flag_of(tmp_path, kind, row)
    assert (flag["left_out"], flag["severity"]) == (left_out, severity)
    if stretch is not None:
        assert [flag["begin"], flag["end"]] == [pytest.approx(at_s, abs=within_s) for at_s, within_s in stretch]
    assert kind != "few_levels" or "-3, 0, 3 alone" in flag["detail"]
    x = amplitude(order_map, 1500.0, "X")
    assert np.isnan(x) if left_out == "channel" else x == pytest.approx(3.0, rel=0.01)
    assert amplitude(order_map, 1500.0, "Y") == pytest.approx(1.5, rel=0.01)
    assert amplitude(order_map, 1800.0, "X") == pytest.approx(3.0, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("row", [STILL, LEFT_OUT["samples missing"][1]])
def test_a_recording_without_a_sound_channel_is_left_out_as_a_whole(tmp_path, row):
    status, findings, order_map = run(tmp_path, {"X": row, "Y": row})
    assert status == 3
    assert not [flag for flag in findings["quality"] if "left_out" in flag]
    assert order_map["speed"].values.min() > 1700.0


# A channel whose gain changed in one recording makes no natural frequency: it takes no part in what is said.


ROTOR_RATE, ROTOR_SECONDS = 2048.0, 8.0
SPEEDS = np.linspace(800.0, 2600.0, 8)
NATURAL_HZ, DAMPING = 90.0, 0.02
ROTOR = manifest(
    "rec_*.h5", channels={"X": {}, "Y": {}, "Z": {}}, sampling={"rate_hz": ROTOR_RATE},
    encoder={"source": "mark", "kind": "pulse_times", "pulses_per_rev": 1},
)  # fmt: skip


def findings_of(folder, changed):
    """Findings of a rotor that passes its natural frequency; the gain of Y in each recording ``changed`` is another."""
    rng = np.random.default_rng(5)
    folder.mkdir()
    time_s = np.arange(round(ROTOR_RATE * ROTOR_SECONDS)) / ROTOR_RATE
    for number, rpm in enumerate(SPEEDS):
        rows = 0.05 * rng.standard_normal((3, time_s.size))
        for order, force in ((1, 1.0), (2, 0.6), (3, 0.4)):
            ratio = order * rpm / 60.0 / NATURAL_HZ
            through = ratio**2 / (1.0 - ratio**2 + 2j * DAMPING * ratio)
            wave = force * (rpm / 1500.0) ** 2 * np.exp(2j * np.pi * order * rpm / 60.0 * time_s)
            rows += np.array([[1.0], [0.7], [0.4]]) * np.real((0.5 + through) * wave)
        rows[1] *= changed.get(number, 1.0)
        with h5py.File(folder / f"rec_{number:03d}.h5", "w") as file:
            for name, row in zip("XYZ", rows, strict=True):
                file[name] = row.astype(np.float32)
            file["mark"] = np.arange(1, int(rpm / 60.0 * ROTOR_SECONDS)) * 60.0 / rpm
    (folder / "run.toml").write_text(ROTOR)
    recipe = folder.parent / "findings-alone.toml"
    recipe.write_text('title = "Findings"\ndescription = "Nothing else."\n[report]\nresults = ["findings"]\n')
    return analysed(folder, folder.parent / "out", "--recipe", recipe)


@pytest.mark.cases(1)
@pytest.mark.parametrize("factor", [2.0, 10.0, 0.1])
def test_a_changed_gain_makes_no_natural_frequency(tmp_path, factor):
    findings = findings_of(tmp_path / "test", {5: factor})
    [flag] = [flag for flag in findings["quality"] if flag["flag"] == "level_jump"]
    assert (flag["recording"], flag["channel"], flag["left_out"]) == ("rec_005.h5", "Y", "channel")
    assert [round(mode["frequency_hz"]) for mode in findings["modes"]] == [NATURAL_HZ]
    met = {round(one["rpm"] * one["order"] / 60.0) for one in findings["crossings"] if one["excited"]}
    assert met == {NATURAL_HZ}
    sizes = {one["channel"]: one["amplitude"] for one in findings["orders"] if round(one["order"], 2) == 1.0}
    assert sizes["Y"] == pytest.approx(0.7 * sizes["X"], rel=0.05)
    assert not contradictions(findings)
