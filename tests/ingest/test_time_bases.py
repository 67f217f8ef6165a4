"""Columns of one file with rates and starts of their own: angle, speed and signals at one time belong together."""

import numpy as np
import pytest

from crankorder.errors import InputError
from crankorder.ingest import recording as recording_module
from crankorder.ingest.check import check_folder
from crankorder.ingest.draft import draft_manifest
from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_parts, read_recording
from crankorder.ingest.roles import read_checked
from crankorder.quantities import flags_of
from crankorder.shaft.angle import angle_at
from crankorder.shaft.decode import shaft_angle
from made.command import analysed
from made.time_bases import WRITERS, Sampled, as_hdf5, as_lvm_of_one_segment, as_tdms

FORMATS = pytest.mark.parametrize("form", WRITERS)
HEAD = 'schema_version = 1\n[test]\ncycle = "rotor"\n[recordings]\nfiles = ["a.*"]\n'


def turns(time_s):
    """Revolutions of a run-up from 20 to 24 revolutions a second in 8 s."""
    return 20.0 * time_s + 0.25 * time_s**2


def times(rate_hz, seconds, start_s=0.0):
    return start_s + np.arange(round(rate_hz * seconds)) / rate_hz


def vibration(name, rate_hz, seconds, start_s=0.0, amplitude=1.0):
    values = amplitude * np.cos(2 * np.pi * turns(times(rate_hz, seconds, start_s)) - np.radians(40.0))
    return Sampled(name, "m/s2", values, rate_hz, start_s)


def tacho(rate_hz, seconds, start_s=0.0, name="tacho"):
    return Sampled(name, "V", 5.0 * (turns(times(rate_hz, seconds, start_s)) % 1.0 < 0.3), rate_hz, start_s)


def speed(rate_hz, seconds, start_s=0.0):
    rpm = 60.0 * (20.0 + 0.5 * times(rate_hz, seconds, start_s))
    return Sampled("speed", "rpm", rpm, rate_hz, start_s)


def manifest_in(folder, sources, channels, kind):
    rows = [f'[[channels]]\nname = "{name}"\nsource = "{sources[name]}"\nunit = "m/s2"\n' for name in channels]
    shaft = sources["speed" if kind == "speed" else "tacho"]
    encoder = f'[encoder]\nsource = "{shaft}"\nkind = "{kind}"\n'
    if kind != "speed":
        encoder += f'pulses_per_rev = 1\nindex = "{shaft}"\nindex_to_tdc_deg = 0.0\n'
    (folder / "run.toml").write_text(HEAD + "".join(rows) + encoder)


def joined(folder, settings, columns, *, channels=("acc",), kind="square", write=as_hdf5, **how):
    """Recording of ``columns`` in one file, and its quality flags by name."""
    sources = write(folder / "a", list(columns), **how)
    manifest_in(folder, sources, channels, kind)
    (path,) = folder.glob("a.*")
    recording = read_recording(path, load_manifest(folder), settings=settings.ingest, shaft=settings.shaft)
    return recording, {told["flag"]: told for told in flags_of(recording)}


def phase_error_deg(recording, settings, start_s, channel=0, lag_rev=40.0 / 360.0):
    """Largest error of the angle of the shaft at the samples, from ``start_s`` on, by what the signal shows."""
    shaft = shaft_angle(recording, settings=settings.shaft)
    knots = [shaft[name].values for name in ("time", "crank_angle", "speed")]
    signal = recording["signal"].values[channel]
    at = np.arange(signal.size) / recording.attrs["rate_hz"]
    inside = (at >= knots[0][2]) & (at <= knots[0][-3])
    off = np.mod(angle_at(at[inside], *knots) - turns(start_s + at[inside]) + 0.5, 1.0) - 0.5
    assert np.abs(signal - signal.max() * np.cos(2 * np.pi * (turns(start_s + at) - lag_rev))).max() < 2e-3
    return 360.0 * (np.ptp(off) if shaft.attrs["phase_reference"] == "none" else np.abs(off).max())


@FORMATS
def test_columns_that_start_at_different_times_are_laid_on_one_clock(tmp_path, settings, form):
    for seed, late_s in enumerate((0.004, 0.25)):
        lag = {"tacho": late_s, "acc": 0.0} if seed % 2 else {"tacho": 0.0, "acc": late_s}
        columns = [vibration("acc", 2000.0, 6.0, lag["acc"]), tacho(2000.0, 6.0, lag["tacho"])]
        recording, flags = joined(tmp_path, settings, columns, write=WRITERS[form])
        start_s = max(lag.values()) if lag["acc"] else max(0.0, late_s - 1.0 / 2000.0)
        assert phase_error_deg(recording, settings, start_s) < 5.0
        assert f"by {late_s:g} s" in flags["start_times"]["detail"]
        assert check_folder(tmp_path, settings=settings.ingest) == []


@pytest.mark.parametrize(
    ("write", "how"),
    [
        (as_tdms, {"by_date": False}),
        (as_hdf5, {"key": "wf_start_time"}),
        (as_hdf5, {"key": "t0"}),
        (as_hdf5, {"key": "start_time"}),
        (as_lvm_of_one_segment, {}),
    ],
)
def test_a_start_is_read_wherever_the_format_states_it(tmp_path, settings, write, how):
    columns = [vibration("acc", 2000.0, 6.0), tacho(2000.0, 6.0, 0.02)]
    recording, flags = joined(tmp_path, settings, columns, write=write, **how)
    assert phase_error_deg(recording, settings, 0.0195) < 5.0
    assert "by 0.02 s" in flags["start_times"]["detail"]


def test_starts_count_beside_a_column_of_times_too(tmp_path, settings):
    columns = [vibration("acc", 2000.0, 6.0), tacho(2000.0, 6.0, 0.02)]
    sources = WRITERS["MDF4"](tmp_path / "a", columns)
    manifest_in(tmp_path, sources, ("acc",), "square")
    text = (tmp_path / "run.toml").read_text() + '\n[sampling]\ntime_source = "time"\n'
    (tmp_path / "run.toml").write_text(text)
    manifest = load_manifest(tmp_path)
    recording = read_recording(tmp_path / "a.mf4", manifest, settings=settings.ingest, shaft=settings.shaft)
    assert phase_error_deg(recording, settings, 0.0195) < 5.0


@FORMATS
def test_an_encoder_is_decoded_and_a_speed_followed_at_its_own_rate(tmp_path, settings, form):
    for shaft, kind, within_deg in (
        (tacho(20_000.0, 5.0, 0.1), "square", 0.5),
        (tacho(800.0, 6.0), "square", 12.0),
        (speed(50.0, 6.0), "speed", 0.1),
        (speed(1.0, 6.0), "speed", 3.0),
        (speed(10_000.0, 6.0), "speed", 0.1),
    ):
        columns = [vibration("acc", 2000.0, 6.0), shaft]
        recording, flags = joined(tmp_path, settings, columns, kind=kind, write=WRITERS[form])
        start_s = 0.0995 if shaft.start_s else 0.0
        assert phase_error_deg(recording, settings, start_s) < within_deg, shaft[3:]
        assert recording.attrs["rate_hz"] == pytest.approx(2000.0)
        assert ("start_times" in flags) == (shaft.start_s > 0.0)
        assert check_folder(tmp_path, settings=settings.ingest) == []


@FORMATS
def test_accelerometers_of_two_rates_meet_at_the_lower_within_its_band(tmp_path, settings, form):
    late_s = 0.01237  # no whole number of samples of either
    columns = [vibration("acc", 1000.0, 6.0), vibration("b", 800.0, 6.0, late_s, 0.5), speed(50.0, 6.0)]
    high = 0.3 * np.cos(2 * np.pi * 450.0 * times(1000.0, 6.0))  # folds to 350 Hz where it is only thinned out
    columns[0] = columns[0]._replace(values=columns[0].values + high)
    recording, flags = joined(tmp_path, settings, columns, channels=("acc", "b"), kind="speed", write=WRITERS[form])
    assert recording.attrs["rate_hz"] == pytest.approx(800.0)
    assert "acc" in flags["channels_resampled"]["detail"] and "368 Hz" in flags["channels_resampled"]["detail"]
    cut = np.argmin(np.abs(columns[1].values[:400] - recording["signal"].values[1, 0]))
    start_s = late_s + cut / 800.0
    for channel in (0, 1):
        assert phase_error_deg(recording, settings, start_s, channel) < 0.1


def test_channels_a_fraction_of_a_sample_apart_meet_at_the_times_of_the_first(tmp_path, settings):
    columns = [vibration("acc", 2000.0, 6.0), vibration("b", 2000.0, 6.0, 0.00123), speed(2000.0, 6.0)]
    columns[0].values[5000:5010] = np.nan
    recording, flags = joined(tmp_path, settings, columns, channels=("acc", "b"), kind="speed")
    signal = recording["signal"].values
    known = np.isfinite(signal).all(axis=0)
    assert 0.98 < known.mean() < 1.0
    np.testing.assert_allclose(signal[0][known], signal[1][known], atol=2e-6)
    assert "b of 2000 Hz" in flags["channels_resampled"]["detail"] and "start_times" in flags


@FORMATS
def test_a_file_of_two_rates_is_drafted_so_that_it_runs(tmp_path, settings, form):
    for shaft in (speed(50.0, 6.0), tacho(10_000.0, 6.0, name="tacho_pulses")):
        for old in tmp_path.glob("a.*"):
            old.unlink()
        columns = [vibration("acc", 2000.0, 6.0), vibration("acc_b", 2000.0, 6.0), shaft]
        if form == "UFF":  # names of points say nothing of a tacho
            columns[2] = speed(50.0, 6.0)
        WRITERS[form](tmp_path / "a", columns)
        (tmp_path / "run.toml").unlink(missing_ok=True)
        (tmp_path / "run.toml").write_text(draft_manifest(tmp_path))
        manifest = load_manifest(tmp_path)
        kind = "speed" if shaft.unit == "rpm" or form == "UFF" else "square"
        assert (len(manifest.channels), manifest.encoder.kind) == (2, kind), (tmp_path / "run.toml").read_text()
        assert check_folder(tmp_path, settings=settings.ingest) == []


def test_what_was_recorded_at_another_time_is_refused_with_the_numbers(tmp_path, settings):
    for columns in (
        [vibration("acc", 2000.0, 6.0), tacho(2000.0, 6.0, 3600.0)],
        [vibration("acc", 2000.0, 6.0, 9.0), speed(50.0, 6.0)],
    ):
        kind = "speed" if columns[1].name == "speed" else "square"
        with pytest.raises(
            InputError, match=r"at the same time.*(acc from 9 to 14\.9995|encoder from 3600 to 3605\.9995) s"
        ):
            joined(tmp_path, settings, columns, kind=kind)


def test_a_date_that_was_never_set_moves_nothing_and_is_told(tmp_path, settings):
    columns = [vibration("acc", 2000.0, 6.0), tacho(2000.0, 6.0)]
    zero = np.datetime64("1904-01-01T00:00:00", "us")
    recording, flags = joined(tmp_path, settings, columns, write=as_tdms, dates={"tacho": zero})
    assert phase_error_deg(recording, settings, 0.0) < 5.0
    assert flags["start_unknown"]["severity"] == "suspect" and "tacho" in flags["start_unknown"]["detail"]
    late = {"acc": zero, "tacho": zero + np.timedelta64(50, "ms")}
    columns[1] = tacho(2000.0, 6.0, 0.05)._replace(start_s=0.0)
    recording, flags = joined(tmp_path, settings, columns, write=as_tdms, dates=late)
    assert phase_error_deg(recording, settings, 0.0495) < 5.0 and "start_times" in flags


def test_a_recording_is_cut_to_the_time_of_its_speed(tmp_path, settings):
    columns = [vibration("acc", 2000.0, 8.0), speed(10.0, 3.0, 2.0)]
    recording, flags = joined(tmp_path, settings, columns, kind="speed")
    assert recording.sizes["time"] == pytest.approx(2000 * 3.1, abs=2)
    assert phase_error_deg(recording, settings, 1.9) < 2.0
    assert flags["recording_cut"]["severity"] == "suspect"


def test_channels_of_one_base_stay_where_the_reader_laid_them(tmp_path, settings, monkeypatch):
    columns = [vibration("acc", 2000.0, 6.0), vibration("b", 2000.0, 6.0), tacho(2000.0, 6.0)]
    read = []
    monkeypatch.setattr(
        recording_module, "read_checked", lambda *args, **how: read.append(read_checked(*args, **how)) or read[0]
    )
    recording, flags = joined(tmp_path, settings, columns, channels=("acc", "b"))
    assert np.shares_memory(recording["signal"].values, read[0].columns["acc"])
    assert not {"start_times", "channels_resampled", "recording_cut"} & set(flags)


def test_parts_of_a_file_of_several_rates_are_the_whole_of_it(tmp_path, settings):
    how = {"settings": settings.ingest, "shaft": settings.shaft, "most_bytes": 60_000}
    for shaft, n_parts in ((tacho(2000.0, 8.0, 0.25), 3), (tacho(10_000.0, 8.0), 1)):
        joined(tmp_path, settings, [vibration("acc", 2000.0, 8.0), shaft])
        parts, _ = read_parts(tmp_path / "a.h5", load_manifest(tmp_path), **how)
        assert len(parts) == n_parts


def test_order_and_phase_of_a_late_tacho_and_a_fast_encoder(tmp_path):
    for shaft in (tacho(2000.0, 7.9, 0.1), tacho(24_000.0, 8.0)):
        (tmp_path / "in").mkdir(exist_ok=True)
        sources = as_hdf5(tmp_path / "in" / "a", [vibration("acc", 2000.0, 8.0), shaft])
        manifest_in(tmp_path / "in", sources, ("acc",), "square")
        orders = analysed(tmp_path / "in", tmp_path / "out", "--fresh")["orders"]
        (order,) = [record for record in orders if round(record["order"]) == 1]
        assert order["amplitude"] == pytest.approx(1.0, abs=0.01)
        assert order["phase_deg"] == pytest.approx(-40.0, abs=1.0)
