"""A structure on which nothing turns: frequencies without speeds, and no orders."""

import numpy as np
import pytest

from crankorder.campbell.frames import frequency_frames
from crankorder.campbell.map import campbell_map
from crankorder.errors import ManyErrors
from crankorder.fft.decimation import band_limited
from crankorder.ingest.check import check_folder
from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_recording
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.shaft.decode import shaft_angle
from made.recordings import manifest
from made.shipped import SETTINGS


def write(folder, cycle="none", encoder=""):
    """Two recordings of a sine of 7 Hz and amplitude 3, as ``cycle`` and ``encoder`` describe them."""
    for name in ("a", "b"):
        np.save(folder / f"{name}.npy", 3.0 * np.sin(2 * np.pi * 7.0 * np.arange(256 * 20) / 256))
    text = manifest("*.npy", cycle=cycle, channels={"acc": {"source": 0}}, sampling={"rate_hz": 256})
    (folder / "run.toml").write_text(text + encoder)
    return folder


def test_all_its_frames_make_one_spectrum_of_unknown_speed_and_its_order_map_holds_nothing(tmp_path):
    by_time, by_angle, stated = [], [], load_manifest(write(tmp_path))
    for name in ("a.npy", "b.npy"):
        recording = read_recording(tmp_path / name, stated, settings=SETTINGS.ingest, shaft=SETTINGS.shaft)
        pair = band_limited(recording, band_hz=100.0, grid_hz=0.5), shaft_angle(recording, settings=SETTINGS.shaft)
        by_time.append(frequency_frames(*pair, settings=SETTINGS.campbell))
        by_angle.append(order_frames(*pair, settings=SETTINGS.orders))
    made = campbell_map(by_time, speed_bin_rpm=25.0)
    assert made.sizes["speed"] == 1
    assert np.isnan(made["speed"].item())
    assert made["n_frames"].item() == sum(item.sizes["frame"] for item in by_time)
    assert made["amplitude"].sel(frequency=7.0).item() == pytest.approx(3.0, rel=2e-3)
    orders = order_map(by_angle, settings=SETTINGS.orders)
    assert np.isnan(orders["amplitude"].values).all() and np.isnan(orders["speed"].values).all()


def test_it_passes_the_check_and_a_machine_without_a_speed_or_a_structure_with_an_encoder_does_not(tmp_path):
    assert check_folder(write(tmp_path), settings=SETTINGS.ingest) == []
    (fault,) = check_folder(write(tmp_path, cycle="rotor"), settings=SETTINGS.ingest)
    assert 'cycle = "none"' in str(fault)
    with pytest.raises(ManyErrors, match="a structure without a shaft has neither an encoder"):
        load_manifest(write(tmp_path, encoder='[encoder]\nkind = "constant"\nspeed_rpm = 1000'))
