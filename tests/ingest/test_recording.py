"""One file becomes one Recording: right units, right times, every fault named or flagged."""

import h5py
import numpy as np
import pytest
from scipy.io import wavfile

from crankorder.errors import InputError
from crankorder.quantities import check_dataset, flags_of
from made.recordings import write_hdf5

RATE = 10_000.0
N = 20_000
TIME = np.arange(N) / RATE
TONE = np.sin(300 * TIME)
CHANNEL = '[[channels]]\nname = "Z"\nsource = "acc"\nunit = "m/s2"\n'
ENCODER = '[encoder]\nkind = "square"\nsource = "enc"\npulses_per_rev = 36\nindex = "idx"\n'


def turned(rpm, per_rev):
    """A square trace of ``per_rev`` pulses per revolution."""
    return ((TIME * rpm / 60 * per_rev + 0.25) % 1.0 < 0.5).astype(np.float32) * 5


@pytest.fixture
def write(tmp_path):
    def make(rate=RATE, name="a.h5", unit=None, **columns):
        return write_hdf5(tmp_path / name, columns, unit=unit, **({} if rate is None else {"rate_hz": rate}))

    return make


@pytest.fixture
def read(manifest_of, read_in):
    def read_it(path, tables=CHANNEL):
        recording = read_in(path, manifest_of(tables))
        check_dataset(recording, "recording")
        return recording

    return read_it


def flagged(recording):
    return [(flag["flag"], flag["severity"]) for flag in flags_of(recording)]


def test_a_recording_has_signals_pulses_and_everything_that_later_stages_need(write, read):
    tone = np.sin(2 * np.pi * 50 * TIME).astype(np.float32)
    path = write(acc=tone, enc=turned(1000, 36), idx=turned(1000, 1))
    recording = read(path, CHANNEL + 'direction = "+Z"\n' + ENCODER)
    np.testing.assert_array_equal(recording["signal"].values[0], tone)
    assert recording["signal"].dtype == np.float32
    assert recording["signal"].dims == ("channel", "time")
    said = [str(recording[name].values[0]) for name in ("channel", "unit", "quantity", "direction")]
    assert said == ["Z", "m/s2", "acceleration", "+Z"]
    attrs = recording.attrs
    assert (attrs["recording"], attrs["domain"], attrs["rate_hz"], attrs["revs_per_cycle"]) == ("a.h5", "time", RATE, 2)
    assert (attrs["encoder_kind"], attrs["pulses_per_rev"], attrs["ratio"]) == ("square", 36, 1.0)
    np.testing.assert_allclose(np.diff(recording["pulse_time"]), 60 / 1000 / 36, atol=1.01 / RATE)
    np.testing.assert_allclose(np.diff(recording["index_time"]), 60 / 1000, atol=1.01 / RATE)
    assert attrs["pulse_noise_s"] == pytest.approx(1 / RATE / np.sqrt(12), rel=0.2)


def test_values_are_turned_into_the_analysed_unit(write, read):
    rows = [
        ('unit = "m/s2"\nsensitivity = "100 mV/g"\n', None, 98.0665, 0.0),
        ('unit = "m/s2"\nsensitivity = "100 mV/g"\n', "mV", 0.0980665, 0.0),
        ('unit = "bar"\nsensitivity = "0.077 V/bar"\noffset = "0.575 V"\n', "V", 1 / 0.077, 0.575),
        ('unit = "bar"\nsensitivity = "0.077 V/bar"\noffset = "575 mV"\n', None, 1 / 0.077, 0.575),
        ('unit = "m/s2"\n', "g", 9.80665, 0.0), ('unit = "Pa"\noffset = "1 bar"\n', "bar", 1e5, 1.0),
        ('unit = "m/s²"\n', "m s-2", 1.0, 0.0), ('unit = "V"\n', "EU", 1.0, 0.0),
    ]  # fmt: skip
    for tables, unit, factor, offset in rows:
        values = np.random.default_rng(2).standard_normal(100)
        recording = read(write(acc=values, unit=unit), '[[channels]]\nname = "c"\nsource = "acc"\n' + tables)
        np.testing.assert_allclose(recording["signal"].values[0], (values - offset) * factor, rtol=1e-12, atol=1e-12)
        assert flagged(recording) == []


PULSES = CHANNEL + '[encoder]\nkind = "pulse_times"\nsource = "enc"\npulses_per_rev = 36\n'
SPEED = CHANNEL + '[encoder]\nkind = "speed"\nsource = "rpm"\n'
TIMED = '[sampling]\ntime_source = "t"\n' + CHANNEL
NUMBERS = np.arange(1000)


def timed(times):
    return {"acc": TIME[:1000], "t": times, "rate": None}


REFUSED = [
    ({"acc": TIME, "unit": "Pa"}, CHANNEL, r"Z: Pa \(pressure\) cannot become m/s2.*found unit 'Pa' in the file"),
    ({"acc": TIME, "unit": "Pa"}, CHANNEL + 'sensitivity = "100 mV/g"\n', r"Z: Pa \(pressure\) cannot become V"),
    ({"acc": TIME, "rate": None}, CHANNEL, r"the sampling rate is not known. State .sampling. rate_hz"),
    ({"acc": TIME, "enc": np.array([0.0, 2.0, 1.0])}, PULSES, "pulse times must be finite and must not go back"),
    ({"acc": TIME, "rpm": TIME, "unit": {"rpm": "V"}}, SPEED, "the speed signal has no unit of speed; found 'V'"),
    ({"acc": TIME, "enc": np.zeros(N), "idx": turned(1000, 1)}, CHANNEL + ENCODER,
     r"a.h5.*no rising encoder edge found.*found a constant"),
    ({"acc": TIME[:9], "rate": 51_200.0}, "[sampling]\nrate_hz = 50000\n" + CHANNEL,
     "the sampling rate is 51200 Hz in the file, 50000 Hz in the manifest"),
    ({"acc": NUMBERS, "t": NUMBERS / 51_200, "rate": 50_000.0}, TIMED,
     "51200 Hz in the time column, 50000 Hz in the file"),
    (timed(np.where(TIME[:1000] >= 0.05, TIME[:1000] + 0.1, TIME[:1000])), TIMED,
     r"1000 samples are missing; found a step of 0\.1001 s"),
    (timed(np.where(NUMBERS == 70, TIME[69], TIME[:1000])), TIMED, "sample 70: time does not grow"),
    (timed(np.where(NUMBERS == 70, np.nan, TIME[:1000])), TIMED, "sample 70: a time is missing"),
    (timed(TIME[:1000] + 4e-5 * np.sin(NUMBERS / 50)), TIMED, "the time column is not uniform: off by 0"),
    *(({"acc": np.ones(n)}, CHANNEL, words) for n, words in ((0, "no samples"), (2, "too short: 2 samples"))),
    ({"acc": np.ones(100), "enc": np.ones(90), "idx": np.ones(100)}, CHANNEL + ENCODER,
     "lengths differ: Z has 100 samples, the encoder has 90"),
]  # fmt: skip


@pytest.mark.cases(len(REFUSED))
@pytest.mark.parametrize(("columns", "tables", "words"), REFUSED)
def test_what_contradicts_the_manifest_or_is_no_signal_is_refused_by_name(write, read, columns, tables, words):
    with pytest.raises(InputError, match=words):
        read(write(**columns), tables)


def test_a_time_column_gives_the_rate_and_a_manifest_that_rounds_agrees(write, read):
    recording = read(write(rate=None, acc=np.sin(NUMBERS), t=5 + NUMBERS / 51_200), TIMED)
    assert recording.attrs["rate_hz"] == pytest.approx(51_200.0, rel=1e-9)
    assert flagged(recording) == []
    path = write(rate=51_200.0, acc=np.sin(NUMBERS))
    assert read(path, "[sampling]\nrate_hz = 51200.01\n" + CHANNEL).attrs["rate_hz"] == 51200.01
    times = np.round(np.arange(14_000) * 1.388e-5, 6)  # rounded: it still gives the rate
    recording = read(write(rate=None, acc=TONE[:14_000], t=times), TIMED)
    assert recording.attrs["rate_hz"] == pytest.approx(1 / 1.388e-5, rel=1e-5)
    assert flagged(recording) == [("time_jitter", "info")]


def test_rows_missing_in_a_table_are_a_gap_of_all_channels(write, read):
    kept = np.concatenate([np.arange(6000), np.arange(6040, 9000), np.arange(9100, N)])
    times = np.round(TIME[kept] + 1.0, 6)
    recording = read(write(rate=None, acc=TONE[kept], t=times), TIMED)
    assert recording.attrs["rate_hz"] == pytest.approx(10_000.0, rel=1e-9)
    assert recording["signal"].shape == (1, N)
    lost = np.flatnonzero(np.isnan(recording["signal"].values[0]))
    np.testing.assert_array_equal(lost, [*range(6000, 6040), *range(9000, 9100)])
    np.testing.assert_array_equal(np.delete(recording["signal"].values[0], lost), TONE[kept])
    told = {flag["flag"]: flag["detail"] for flag in flags_of(recording)}
    assert set(told) == {"time_gap", "gap"}
    assert "140 samples are missing in 2 gaps, the longest after sample 8959 (1.8999 s)" in told["time_gap"]


def test_rows_of_zeros_that_a_logger_adds_at_the_end_are_left_out(write, read):
    times, values = np.append(TIME[:1000], [0.0, 0.0]), np.append(TONE[:1000], [0.0, 0.0])
    recording = read(write(rate=None, acc=values, t=times), TIMED)
    np.testing.assert_array_equal(recording["signal"].values[0], TONE[:1000])
    assert flagged(recording) == [("rows_of_zeros", "info")]


def test_a_few_missing_samples_are_bridged_and_a_longer_gap_stays_missing(write, read):
    tone = np.sin(2 * np.pi * 5 * TIME)
    for bad in [np.nan, -np.inf, 9.96921e36, -9999.0]:
        for first, n in [(500, 3), (0, 4), (500, 4), (7000, 4900), (N - 4, 4)]:
            values, expected = tone.astype(np.float32 if first else np.float64), tone.copy()
            values[first : first + n], expected[first : first + n] = bad, np.nan if n > 3 else tone[first : first + n]
            recording = read(write(acc=values))
            np.testing.assert_allclose(recording["signal"].values[0], expected, atol=1e-4)
            assert flagged(recording) == [("gap" if n > 3 else "non_finite_interpolated", "suspect")]

    values = np.round(2000 * tone)
    values[100] = -999.0  # among values like it: a value
    assert flagged(read(write(acc=values))) == [("counts_without_unit", "suspect")]


def test_a_gap_a_few_lost_samples_and_a_dropout_are_told_apart(write, read):
    values = np.sin(2 * np.pi * 5 * TIME)
    values[100:102], values[3000:3010], values[9000:9100], values[12_000:12_300] = np.nan, np.nan, -9999.0, 0.5
    recording = read(write(acc=values))
    assert flagged(recording) == [("gap", "suspect"), ("non_finite_interpolated", "suspect"), ("dropout", "bad")]
    details = [flag["detail"] for flag in flags_of(recording)]
    assert "110 samples (0.55%) missing in 2 gaps, the longest of 100 from sample 9000" in details[0]
    assert "2 missing samples bridged, first at sample 100" in details[1]
    assert "the same value for 300 samples (1.5%) from sample 12000" in details[2]
    missing = np.isnan(recording["signal"].values[0])
    assert missing[12_000:12_300].all() and 410 <= missing.sum() < 410 + 0.05 * missing.size


def test_of_a_channel_with_gaps_of_more_than_a_quarter_nothing_is_kept(write, read):
    values = np.sin(2 * np.pi * 5 * TIME)
    values[: N // 4] = np.nan
    assert flagged(read(write(acc=values))) == [("gap", "suspect")]
    values[N // 4] = np.inf
    (told,) = flags_of(read(write(acc=values, name="b.h5")))
    assert (told["flag"], told["severity"]) == ("gap", "bad")
    assert "5001 samples are missing" in told["detail"] and "25.005% in all, allowed 25.0%" in told["detail"]
    values = np.where(np.arange(N) % 100, TONE, np.nan)  # single gaps, too many to be bridged
    (told,) = flags_of(read(write(acc=values, name="c.h5")))
    assert (told["flag"], told["severity"]) == ("gap", "bad") and "1.000% to bridge" in told["detail"]


def test_clipping_is_flagged_with_its_share(write, read):
    for sides in ["both", "one"]:
        values = np.clip(np.sin(2 * np.pi * 50 * TIME), -1 if sides == "one" else -0.6, 0.6)
        recording = read(write(acc=values))
        assert flagged(recording) == [("clipped", "bad")]
        share = np.mean(np.abs(values) == 0.6)
        assert f"{share:.3%} of its samples" in flags_of(recording)[0]["detail"]


def test_a_constant_signal_and_an_unknown_unit_are_flagged(write, read):
    assert flagged(read(write(acc=np.full(100, 2.5)))) == [("constant_signal", "bad")]
    assert flagged(read(write(acc=np.arange(10.0), unit="furlong"))) == [("unit_unknown", "info")]


@pytest.mark.slow
def test_a_channel_that_is_also_the_encoder_is_not_spoilt_by_its_unit(write, read):
    trace = turned(1000, 36)
    tables = '[[channels]]\nname = "Z"\nsource = "enc"\nunit = "mV"\n' + ENCODER.replace('index = "idx"\n', "")
    recording = read(write(enc=trace, unit="V"), tables)
    assert recording["signal"].values.max() == 5000.0
    assert recording.sizes["pulse"] == pytest.approx(1000 / 60 * 36 * N / RATE, abs=2)


WHEELS = [
    ('pattern = "36-2-1"', {"tooth_angles_deg": [*range(0, 170, 10), *range(180, 340, 10)]}),
    ('pattern = "60-2"', {"pulses_per_rev": 60, "missing_teeth": 2}),
    ('pattern = "120"', {"pulses_per_rev": 120, "missing_teeth": 0}),
    ("tooth_angles_deg = [0, 10.5, 200]", {"tooth_angles_deg": [0.0, 10.5, 200.0]}),
    ("", {}),
]


def test_a_wheel_stated_one_way_or_left_to_the_pulses_and_a_cam_mark_reach_the_recording(write, read):
    for wheel, attrs in WHEELS:
        encoder = f'[encoder]\nkind = "square"\nsource = "enc"\n{wheel}\ncam = "cam"\ncam_to_tdc_deg = 77\n'
        recording = read(write(acc=TIME, enc=turned(1000, 36), cam=turned(500, 1)), CHANNEL + encoder)
        keys = ("pulses_per_rev", "missing_teeth", "tooth_angles_deg")
        assert {key: recording.attrs[key] for key in keys if key in recording.attrs} == attrs
        assert recording.attrs["cam_to_tdc_deg"] == 77.0
        np.testing.assert_allclose(np.diff(recording["cam_time"]), 60 / 500, atol=1.01 / RATE)


def test_times_of_pulses_are_taken_as_they_are(write, read):
    for kind in ["pulse_times", "edge_list"]:
        times = np.arange(1, 700) * 60 / 1000 / 36
        recording = read(write(acc=TONE, enc=times, idx=times[::36]), TIMES.replace("pulse_times", kind))
        np.testing.assert_array_equal(recording["pulse_time"], times)
        np.testing.assert_array_equal(recording["index_time"], times[::36])
        assert recording["signal"].sizes["time"] == N


def test_a_speed_signal_is_given_in_revolutions_per_minute(write, read):
    for unit, factor in [("rpm", 1.0), ("tr/min", 1.0), ("Hz", 60.0), (None, 1.0)]:
        path = write(acc=TIME, rpm=1000 + TIME, unit={"rpm": unit})
        recording = read(path, SPEED)
        np.testing.assert_allclose(recording["speed_signal"], (1000 + TIME) * factor, rtol=1e-12)


def test_a_stated_speed_goes_with_its_recording(write, read):
    tables = '[recordings.speed_rpm]\n"a.h5" = 1234\n' + CHANNEL + '[encoder]\nkind = "constant"\n'
    assert read(write(acc=TIME), tables).attrs["speed_rpm"] == 1234.0
    with pytest.raises(InputError, match=r"b\.h5: .*the manifest states no speed for this recording; allowed: a\.h5"):
        read(write(name="b.h5", acc=TIME), tables)
    assert np.isnan(read(write(acc=TIME)).attrs["speed_rpm"])


def test_a_silent_index_or_cam_is_flagged_and_the_rest_is_read(write, read):
    for role, flag in [("index", "no_index"), ("cam", "no_cam")]:
        for level in [0.0, 4.9, np.nan]:
            tables = CHANNEL + ENCODER.replace("index =", f"{role} =")
            recording = read(write(acc=TIME, enc=turned(1000, 36), idx=np.full(N, level)), tables)
            assert (flag, "suspect") in flagged(recording)
            assert recording[f"{role}_time"].size == 0
            assert recording["pulse_time"].size > 1000


TIMES = PULSES + 'index = "idx"\n'


@pytest.mark.slow
def test_pulse_times_in_float32_say_how_coarse_they_are(write, read):
    for duration_s, severity in [(2.0, "info"), (200.0, "suspect")]:
        times = (np.arange(1, 700) * duration_s / 700).astype(np.float32)
        recording = read(write(acc=TONE, enc=times), PULSES)
        assert flagged(recording) == [("pulse_times_single_precision", severity)]
        assert recording.attrs["pulse_noise_s"] == pytest.approx(np.spacing(times[-1]) / np.sqrt(12.0))
    fine = read(write(acc=TONE, enc=times.astype(np.float64)), PULSES)
    assert (flagged(fine), fine.attrs["pulse_noise_s"]) == ([], 0.0)


@pytest.mark.slow
def test_a_clock_at_a_billion_seconds_leaves_times_from_the_first_sample_on(write, read):
    exact = np.arange(1, 700) * 60 / 1000 / 36
    path = write(acc=TIME, enc=exact + 1e9)
    with h5py.File(path, "a") as file:
        for name in file:
            file[name].attrs["start_s"] = 1e9
    np.testing.assert_allclose(read(path, PULSES)["pulse_time"], exact, rtol=0, atol=0.505 * np.spacing(1e9))


def test_a_sensitivity_needs_the_volts_at_full_scale_of_a_wav(tmp_path, read):
    samples = np.round(8192 * np.sin(2 * np.pi * 5 * TIME)).astype("<i2")
    wavfile.write(tmp_path / "a.wav", 10_000, samples)
    table = '[[channels]]\nname = "Z"\nsource = 0\nunit = "m/s2"\nsensitivity = "100 mV/g"\n'
    with pytest.raises(InputError, match=r"fractions of full scale, for which the sensitivity '100 mV/g' does not do"):
        read(tmp_path / "a.wav", table)
    recording = read(tmp_path / "a.wav", table + "full_scale_v = 5.0\n")
    expected = samples / 32768 * 5.0 / 0.1 * 9.80665
    np.testing.assert_allclose(recording["signal"].values[0], expected, rtol=1e-6, atol=1e-5)
    volts = read(tmp_path / "a.wav", '[[channels]]\nname = "Z"\nsource = 0\nunit = "V"\nfull_scale_v = 5.0\n')
    np.testing.assert_allclose(volts["signal"].values[0], samples / 32768 * 5.0, rtol=1e-6, atol=1e-6)
