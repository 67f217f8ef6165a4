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
from crankorder.settings import load_settings
from crankorder.shaft.decode import shaft_angle
from made.recordings import manifest


@pytest.fixture
def folder(tmp_path):
    """Two recordings of a sine of 7 Hz and amplitude 3, as `cycle` and `encoder` describe them."""

    def write(cycle="none", encoder=""):
        for name in ("a", "b"):
            np.save(tmp_path / f"{name}.npy", 3.0 * np.sin(2 * np.pi * 7.0 * np.arange(256 * 20) / 256))
        text = manifest("*.npy", cycle=cycle, channels={"acc": {"source": 0}}, sampling={"rate_hz": 256})
        (tmp_path / "run.toml").write_text(text + encoder)
        return tmp_path

    return write


@pytest.fixture
def parts(folder):
    """Settings, band recordings and shafts of the folder."""
    settings, where = load_settings(), folder()
    manifest = load_manifest(where)
    recordings = [
        read_recording(where / f"{name}.npy", manifest, settings=settings.ingest, shaft=settings.shaft) for name in "ab"
    ]
    shafts = [shaft_angle(recording, settings=settings.shaft) for recording in recordings]
    return settings, [band_limited(item, band_hz=100.0, grid_hz=0.5) for item in recordings], shafts


def test_all_its_frames_make_one_spectrum_of_unknown_speed(parts):
    settings, bands, shafts = parts
    frames = [frequency_frames(*pair, settings=settings.campbell) for pair in zip(bands, shafts, strict=True)]
    made = campbell_map(frames, speed_bin_rpm=25.0)
    assert made.sizes["speed"] == 1
    assert np.isnan(made["speed"].item())
    assert made["n_frames"].item() == sum(item.sizes["frame"] for item in frames)
    assert made["amplitude"].sel(frequency=7.0).item() == pytest.approx(3.0, rel=2e-3)


def test_its_order_map_holds_nothing(parts):
    settings, bands, shafts = parts
    frames = [order_frames(*pair, settings=settings.orders) for pair in zip(bands, shafts, strict=True)]
    made = order_map(frames, settings=settings.orders)
    assert np.isnan(made["amplitude"].values).all()
    assert np.isnan(made["speed"].values).all()


def test_it_passes_the_check_and_a_machine_without_a_speed_does_not(folder):
    limits = load_settings().ingest
    assert check_folder(folder(), settings=limits) == []
    (fault,) = check_folder(folder(cycle="rotor"), settings=limits)
    assert 'cycle = "none"' in str(fault)


def test_what_does_not_turn_has_no_encoder(folder):
    with pytest.raises(ManyErrors, match="a structure without a shaft has neither an encoder"):
        load_manifest(folder(encoder='[encoder]\nkind = "constant"\nspeed_rpm = 1000'))
