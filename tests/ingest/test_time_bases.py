"""Columns of one file with rates and starts of their own: angle, speed and signals at one time belong together."""

import re
from functools import partial

import numpy as np
import pytest

from crankorder.errors import InputError
from crankorder.ingest.check import check_folder
from crankorder.ingest.draft import draft_manifests
from crankorder.ingest.manifest import load_manifest
from crankorder.ingest.recording import read_parts, read_recording
from crankorder.quantities import flags_of
from crankorder.shaft.angle import angle_at
from crankorder.shaft.decode import shaft_angle
from made.command import analysed, crankorder
from made.recordings import write_hdf5, write_manifest, write_table
from made.time_bases import WRITERS, Sampled, as_hdf5, as_lvm_of_one_segment, as_tdms

FORMATS = pytest.mark.parametrize("form", WRITERS)


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
    shaft = sources["speed" if kind == "speed" else "tacho"]
    marks = {} if kind == "speed" else {"pulses_per_rev": 1, "index": shaft, "index_to_tdc_deg": 0.0}
    encoder = {"source": shaft, "kind": kind, **marks}
    write_manifest(folder, "a.*", channels={name: {"source": sources[name]} for name in channels}, encoder=encoder)


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


STARTS = [
    *((write, {}) for write in WRITERS.values()), (as_lvm_of_one_segment, {}), (as_tdms, {"by_date": False}),
    *((as_hdf5, {"key": key}) for key in ("wf_start_time", "t0", "start_time")),
]  # fmt: skip


@pytest.mark.cases(6)
@pytest.mark.parametrize(("write", "how"), STARTS)
def test_columns_that_start_at_different_times_are_laid_on_one_clock(tmp_path, settings, write, how):
    for late_s, acc_s, tacho_s in ((0.004, 0.004, 0.0), (0.25, 0.0, 0.25)):
        columns = [vibration("acc", 2000.0, 6.0, acc_s), tacho(2000.0, 6.0, tacho_s)]
        recording, flags = joined(tmp_path, settings, columns, write=write, **how)
        assert phase_error_deg(recording, settings, late_s - 0.0005 * (tacho_s > 0.0)) < 5.0
        assert f"by {late_s:g} s" in flags["start_times"]["detail"]
        assert check_folder(tmp_path, settings=settings.ingest) == []


def test_starts_count_beside_a_column_of_times_too(tmp_path, settings, read_in):
    columns = [vibration("acc", 2000.0, 6.0), tacho(2000.0, 6.0, 0.02)]
    sources = WRITERS["MDF4"](tmp_path / "a", columns)
    manifest_in(tmp_path, sources, ("acc",), "square")
    text = (tmp_path / "run.toml").read_text() + '\n[sampling]\ntime_source = "time"\n'
    (tmp_path / "run.toml").write_text(text)
    assert phase_error_deg(read_in(tmp_path / "a.mf4"), settings, 0.0195) < 5.0


@FORMATS
def test_an_encoder_is_decoded_and_a_speed_followed_at_its_own_rate(tmp_path, settings, form):
    for shaft, kind, within_deg in (
        (tacho(20_000.0, 5.0, 0.1), "square", 0.5), (tacho(800.0, 6.0), "square", 12.0),
        (speed(50.0, 6.0), "speed", 0.1), (speed(1.0, 6.0), "speed", 3.0), (speed(10_000.0, 6.0), "speed", 0.1),
    ):  # fmt: skip
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
@pytest.mark.parametrize("kind", ["speed", "square"])
def test_a_file_of_two_rates_is_drafted_so_that_it_runs(tmp_path, settings, kind, form):
    if form == "UFF":  # names of points say nothing of a tacho
        kind = "speed"
    shaft = speed(50.0, 6.0) if kind == "speed" else tacho(10_000.0, 6.0, name="tacho_pulses")
    WRITERS[form](tmp_path / "a", [vibration("acc", 2000.0, 6.0), vibration("acc_b", 2000.0, 6.0), shaft])
    (tmp_path / "run.toml").write_text(draft_manifests(tmp_path).text)
    drafted = load_manifest(tmp_path)
    assert (len(drafted.channels), drafted.encoder.kind) == (2, kind), (tmp_path / "run.toml").read_text()
    assert check_folder(tmp_path, settings=settings.ingest) == []


def test_what_was_recorded_at_another_time_is_refused_with_the_numbers(tmp_path, settings):
    for columns in (
        [vibration("acc", 2000.0, 6.0), tacho(2000.0, 6.0, 3600.0)],
        [vibration("acc", 2000.0, 6.0, 9.0), speed(50.0, 6.0)],
    ):
        kind = "speed" if columns[1].name == "speed" else "square"
        words = r"at the same time.*(acc from 9 to 14\.9995|encoder from 3600 to 3605\.9995) s"
        with pytest.raises(InputError, match=words):
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


def test_parts_of_a_file_of_several_rates_are_the_whole_of_it(tmp_path, settings):
    how = {"settings": settings.ingest, "shaft": settings.shaft, "most_bytes": 60_000}
    for shaft, n_parts in ((tacho(2000.0, 8.0, 0.25), 3), (tacho(10_000.0, 8.0), 1)):
        joined(tmp_path, settings, [vibration("acc", 2000.0, 8.0), shaft])
        parts, _ = read_parts(tmp_path / "a.h5", load_manifest(tmp_path), **how)
        assert len(parts) == n_parts


# Recordings in pieces: a logger that stops for a while and says so, and buffers joined with turns lost between.


def in_pieces(folder, suffix, sampling, signal, tacho, **more):
    """``folder`` with a recording of ``signal``, ``tacho`` and columns ``more``, and its manifest."""
    encoder = {"kind": "square", "source": "tacho", "pulses_per_rev": 1}
    write_manifest(folder, "a.*", name="pieces", channels={"k": {"source": "k"}}, sampling=sampling, encoder=encoder)
    columns = more | {"k": signal, "tacho": tacho}
    (write_hdf5 if suffix == "h5" else partial(write_table, fmt="%.6f"))(folder / f"a.{suffix}", columns)
    return folder


def turning(turns, seed):
    """A signal of orders 1, 2 and 2.5 (1.0, 0.5 and 0.4) and a mark once a turn."""
    noise = 0.02 * np.random.default_rng(seed).standard_normal(turns.size)
    signal = np.cos(2 * np.pi * turns) + 0.5 * np.cos(4 * np.pi * turns + 1.0) + 0.4 * np.cos(5 * np.pi * turns)
    return signal + noise, np.where(turns % 1.0 < 0.2, 3.3, 0.0)


def seen(findings):
    return {round(order["order"], 1): order["amplitude"] for order in findings["orders"]}


def flagged(findings):
    return {one["flag"]: one["detail"] for one in findings["quality"]}


def polled(seed):
    """Times of a logger at 615 Hz that stops by some samples and a part of one, another part each time; the speed."""
    rng = np.random.default_rng(seed)
    steps = np.full(9000, 1.0)
    steps[1500::1500] = rng.uniform(1.2, 14.0, 5)
    return np.cumsum(steps) / 615.0, float(rng.uniform(1200.0, 1600.0))


def test_stretches_shorter_than_a_frame_are_refused_with_the_frames_that_would_do(tmp_path):
    times = np.arange(20_000)[np.arange(20_000) % 600 < 540] / 1000.0
    signal, tacho = turning(25.0 * times, 1)
    folder = in_pieces(tmp_path / "in", "csv", {"time_source": "time_s"}, signal, tacho, time_s=times)
    refused = crankorder("run", folder, "--out", tmp_path / "out")
    assert refused.exit_code == 4, refused.output
    assert "revs_per_frame = 6" in refused.output and "13.5 between gaps" in refused.output


def test_stretches_between_gaps_of_parts_of_a_sample_come_at_their_true_times(tmp_path):
    times, rpm = polled(3)
    signal, tacho = turning(rpm / 60.0 * times, 3)
    folder = in_pieces(tmp_path / "in", "csv", {"time_source": "time_s"}, signal, tacho, time_s=times)
    found = analysed(folder, tmp_path / "out", "--no-pictures")
    assert seen(found) == pytest.approx({1: 1.0, 2: 0.5, 2.5: 0.4}, rel=0.015)
    assert found["orders"][0]["speed_rpm_at_max"] == pytest.approx(rpm, rel=1e-3)
    assert "in 5 gaps" in flagged(found)["time_gap"] and "after 1499" in flagged(found)["time_gap"]


def test_a_draft_takes_times_with_gaps_for_times_and_no_wheel_from_them(tmp_path):
    times, rpm = polled(5)
    signal, tacho = turning(rpm / 60.0 * times, 5)
    columns = {"time_s": times, "acc (m/s2)": signal, "tacho (V)": tacho}
    draft = draft_manifests(write_table(tmp_path / "a.csv", columns, fmt="%.6f").parent).text
    assert 'time_source = "time_s"' in draft and 'source = "acc (m/s2)"' in draft and 'kind = "square"' in draft
    assert not any(line.startswith(("pulses_per_rev", "pattern", "tooth_angles")) for line in draft.splitlines())


@pytest.mark.parametrize("seed", range(4))
def test_times_that_nothing_asks_for_agree_with_the_stated_rate_or_the_file_is_refused(tmp_path, read_in, seed):
    rng = np.random.default_rng(seed)
    rate_hz, n = float(rng.integers(500, 50_000)), int(rng.integers(500, 3000))
    name, unit = [("Time [s]", 1.0), ("t_ms", 1e-3), ("time", 1e-3), ("Zeit [ms]", 1e-3)][seed]
    for off in (1.0, float(rng.choice([0.5, 0.99, 1.01, 2.0]))):
        for jitter in (0.0, 0.3):
            times = (np.arange(n) + jitter * rng.uniform(-1.0, 1.0, n)) / rate_hz / unit
            write_table(tmp_path / "a.csv", {name: times, "acc": rng.standard_normal(n)}, fmt="%.12g")
            more = {"sampling": {"rate_hz": off * rate_hz}, "encoder": {"kind": "constant", "speed_rpm": 900.0}}
            write_manifest(tmp_path, "a.csv", channels={"acc": {"source": "acc"}}, **more)
            if off == 1.0 or jitter:
                assert read_in(tmp_path / "a.csv").attrs["rate_hz"] == off * rate_hz
                continue
            said = rf"a\.csv: the sampling rate is \S+ Hz in the file, {off * rate_hz:.12g} Hz in the manifest"
            with pytest.raises(InputError, match=said):
                read_in(tmp_path / "a.csv")
            assert re.search(said, crankorder("check", tmp_path).output)


def turns_of_buffers(seed, blocks):
    """Turns at the samples (2560 Hz) of buffers of 1.6 s, parts of a turn lost between them."""
    rng = np.random.default_rng(seed)
    lost = np.cumsum(np.append(0.0, rng.uniform(3.2, 3.8, blocks - 1)))
    samples = np.arange(4096 * blocks)
    return 1160.0 / 60.0 * samples / 2560.0 + lost[samples // 4096]


@pytest.mark.parametrize(("suffix", "blocks"), [("csv", 2), ("h5", 6)])
def test_buffers_that_were_joined_are_told_by_shaft_and_channel_and_made_whole(tmp_path, read_in, suffix, blocks):
    signal, tacho = turning(turns_of_buffers(2, blocks), 2)
    folder = in_pieces(tmp_path / "in", suffix, {"rate_hz": 2560.0}, signal, tacho)
    found = analysed(folder, tmp_path / "out", "--no-pictures")
    amplitudes = seen(found)
    # which of two turns goes on behind a break is not known
    assert amplitudes.pop(2.5) == pytest.approx(0.4, rel=0.05)
    assert amplitudes == pytest.approx({1: 1.0, 2: 0.5}, rel=0.01)
    assert found["orders"][0]["speed_range_rpm"] == pytest.approx([1160.0, 1160.0], rel=2e-3)
    assert "sample 4096 " in flagged(found)["buffers_joined"]
    assert len(read_in(next(folder.glob(f"*.{suffix}"))).attrs["gap_starts_s"]) == blocks - 1


@pytest.mark.parametrize("fault", ["lost pulse", "false pulse", "moved pulse and knock", "tacho alone", "misfire"])
def test_what_shaft_or_channel_shows_alone_is_no_break(tmp_path, read_in, fault):
    rng = np.random.default_rng(7)
    speed = np.full(20_000, 20.0 / 2560.0)
    if fault == "misfire":
        speed[9000:] *= 1.0 - 0.1 * np.exp(-np.arange(11_000) / 200.0)
    turns = np.cumsum(speed)
    signal, tacho = turning(turns, 7)
    at = int(np.flatnonzero((tacho[1:] > 1) & (tacho[:-1] < 1))[40])
    if fault == "lost pulse":
        tacho[at : at + 40] = 0.0
    if fault == "false pulse":
        tacho[at + 60 : at + 70] = 3.3
    if fault == "moved pulse and knock":
        tacho[at - 20 : at + 40] = np.roll(tacho[at - 20 : at + 40], -18)
        signal[at : at + 200] += 4.0 * np.exp(-np.arange(200) / 30.0) * rng.standard_normal(200)
    if fault == "tacho alone":
        tacho = np.append(tacho[: at + 60], tacho[at + 20 : -40])
    folder = in_pieces(tmp_path, "h5", {"rate_hz": 2560.0}, signal, tacho)
    assert "buffers_joined" not in {one["flag"] for one in flags_of(read_in(folder / "a.h5"))}
