"""A useless channel is left out alone, a lost stretch alone: the rest of the recording stays in the averages."""

import numpy as np
import pytest
import xarray as xr

from made.command import crankorder, findings_in
from made.recordings import write_hdf5, write_manifest

RATE, SECONDS = 5000.0, 10.0
RECORDINGS = {"files": ["*.h5"], "speed_rpm": {"a.h5": 1500.0, "b.h5": 1800.0}}
TABLES = {"recordings": RECORDINGS, "sampling": {"rate_hz": RATE}, "encoder": {"kind": "constant"}}


def signals(rpm, seed):
    time = np.arange(round(RATE * SECONDS)) / RATE
    rng = np.random.default_rng(seed)
    tones = [a * np.cos(2 * np.pi * k * rpm / 60.0 * time + k) for k, a in ((1, 3.0), (2, 1.0))]
    return np.stack([np.sum(tones, axis=0), 0.5 * np.sum(tones, axis=0)]) + 0.05 * rng.normal(size=(2, time.size))


def run(place, spoil):
    """Exit status, findings and order map of two recordings in the new folder ``place``, of the first some spoilt."""
    folder, out = write_manifest(place / "in", channels={"X": {}, "Y": {}}, **TABLES), place / "out"
    for name, rpm, seed in (("a", 1500.0, 1), ("b", 1800.0, 2)):
        columns = dict(zip("XY", signals(rpm, seed), strict=True)) | (spoil if name == "a" else {})
        write_hdf5(folder / f"{name}.h5", {channel: row.astype(np.float32) for channel, row in columns.items()})
    outcome = crankorder("run", folder, "--out", out, "-q", "--recipe", "maps", "--no-pictures")
    order_map = xr.load_dataset(next(out.glob("*/results.nc")), group="order_map", engine="h5netcdf")
    return outcome.exit_code, findings_in(out), order_map


STILL = np.full(round(RATE * SECONDS), 1.5)


def spoilt(begin, end, value):
    """Channel X of the first recording, its samples from ``begin`` to ``end`` lost to a ``value``."""
    row = signals(1500.0, 1)[0]
    row[begin:end] = value
    return row


def amplitude(order_map, rpm, channel):
    return float(order_map["amplitude"].sel(channel=channel).sel(order=1.0, speed=rpm, method="nearest"))


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
    status, findings, order_map = run(tmp_path, {"X": row})
    [flag] = [flag for flag in findings["quality"] if flag["flag"] == kind]
    assert (status, flag["recording"], flag["channel"]) == (0, "a.h5", "X")
    assert (flag["left_out"], flag["severity"]) == (left_out, severity)
    if stretch is not None:
        assert [flag["begin"], flag["end"]] == [pytest.approx(at_s, abs=within_s) for at_s, within_s in stretch]
    assert kind != "few_levels" or "-3, 0, 3 alone" in flag["detail"]
    x = amplitude(order_map, 1500.0, "X")
    assert np.isnan(x) if left_out == "channel" else x == pytest.approx(3.0, rel=0.01)
    assert amplitude(order_map, 1500.0, "Y") == pytest.approx(1.5, rel=0.01)
    assert amplitude(order_map, 1800.0, "X") == pytest.approx(3.0, rel=0.01)


def test_a_recording_without_a_sound_channel_is_left_out_as_a_whole(tmp_path):
    status, findings, order_map = run(tmp_path, {"X": STILL, "Y": STILL})
    assert status == 3
    assert not [flag for flag in findings["quality"] if "left_out" in flag]
    assert order_map["speed"].values.min() > 1700.0
