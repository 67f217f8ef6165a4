"""Velocity and displacement from an accelerometer, as the manifest asks for them."""

import numpy as np
import pytest

from crankorder.batch.look import look_at
from crankorder.errors import ManyErrors
from crankorder.ingest.manifest import load_manifest
from made.recordings import write_table

RATE_HZ = 2560.0
HEAD = (
    'schema_version = 1\n[test]\ncycle = "none"\n[recordings]\nfiles = ["a.csv"]\n'
    '[sampling]\nrate_hz = 2560.0\n[[channels]]\nname = "Z"\nsource = 0\n'
)


def folder_of(path, channel, *, head, values):
    write_table(path / "a.csv", {head: values})
    (path / "run.toml").write_text(HEAD + channel)
    return path


def tone(hertz):
    return 3.0 * np.cos(2 * np.pi * hertz * np.arange(int(20 * RATE_HZ)) / RATE_HZ)  # type: ignore[no-any-return]


def test_a_signal_is_integrated_from_what_the_file_or_the_sensor_states_once_or_twice(tmp_path, read_in):
    velocity, displacement = 'unit = "mm/s"\nquantity = "velocity"\n', 'unit = "um"\nquantity = "displacement"\n'
    rows = [
        (velocity + 'sensitivity = "100 mV/g"', "acc (mV)", 9.80665e-2),
        (velocity + 'measured_unit = "g"', "acc", 9.80665), (velocity, "acc (m/s2)", 1.0),
        (velocity + "highpass_hz = 10.0", "acc (g)", 9.80665),
        (displacement, "acc (m/s2)", 1e3 / (2 * np.pi * 40.0)), (displacement, "v (m/s)", 1e3),
    ]  # fmt: skip
    for channel, head, factor in rows:
        made = read_in(folder_of(tmp_path, channel, head=head, values=tone(40.0)) / "a.csv")
        signal = made["signal"].values[0]
        assert np.sqrt(2.0) * np.nanstd(signal) == pytest.approx(3.0e3 * factor / (2 * np.pi * 40.0), rel=1e-3)
        assert np.isnan(signal[0])
        assert "high-pass" in made.attrs["quality"]
        assert made["quantity"].item() in channel
    folder = folder_of(tmp_path, 'unit = "m/s2"\nhighpass_hz = 5.0', head="acc", values=tone(40.0))
    assert "highpass_unused" in read_in(folder / "a.csv").attrs["quality"]  # of what is not integrated


def test_what_is_not_asked_for_by_name_is_not_integrated(tmp_path):
    rows = [('"mm/s"\nsensitivity = "100 mV/g"', "acceleration"), ('"g"\nquantity = "velocity"', "unit of the result")]
    for channel, words in rows:
        with pytest.raises(ManyErrors, match=words):
            load_manifest(folder_of(tmp_path, f"unit = {channel}", head="acc", values=tone(40.0)))


def test_a_limit_that_cannot_be_is_refused_with_its_place(tmp_path):
    rows = [
        ('quantity = "velocity"\nvalue = "4.5 g"\nsource = "x"', "unit of it"),
        ('quantity = "velocity"\nvalue = "4.5 mm/s"\nsource = "x"\nchannels = ["Q"]', "no such channel"),
        ('quantity = "velocity"\nvalue = "4.5 mm/s"\nsource = "x"\nband_hz = [100.0, 10.0]', "lower end"),
        ('quantity = "balance grade"\nvalue = "6.3 mm/s"\nsource = "x"', "mass"),
        ('quantity = "velocity"\nvalue = "4.5 mm/s"', "source"),
        ('quantity = "velocity"\nvalue = "4.5 mm/s"\nsource = " "', "says nothing"),
        ('quantity = "velocity"\nvalue = "4.5 mm/s"\nsource = "x"\nchannels = []', "names no channel"),
        ('quantity = "velocity"\nvalue = 4.5\nsource = "x"', r'without its unit; found .*4.5.*as in "4.5 mm/s"'),
        ('quantity = "displacement"\nvalue = 60\nsource = "x"', r'without its unit.*as in "60 µm"'),
        ('quantity = "velocity"\nvalue = "G 6.3"\nsource = "x"', r'not a number with a unit.*"4.5 mm/s"'),
        ('quantity = "velocity"\nvalue = "-2 mm/s"\nsource = "x"', "above 0"),
        ('quantity = "velocity"\nvalue = "2 mm/s"\nsource = "x"\nband_hz = [900.0, 3000.0]', "up to 1280 Hz"),
    ]
    for limit, said in rows:
        channel = f'unit = "m/s2"\n[[limits]]\n{limit}'
        with pytest.raises(ManyErrors, match=said) as error:
            load_manifest(folder_of(tmp_path, channel, head="acc", values=np.zeros(5)))
        assert "run.toml:" in str(error.value)


def test_a_band_is_wide_enough_for_a_level_or_refused_with_what_is_allowed(tmp_path):
    for low, high in ((7.0, 7.000001), (40.0, 47.5), (7.0, 8.9), (380.0, 1100.0)):
        limit = f'quantity = "velocity"\nvalue = "1 mm/s"\nsource = "x"\nband_hz = [{low}, {high}]'
        folder = folder_of(tmp_path, f'unit = "m/s2"\n[[limits]]\n{limit}', head="acc", values=np.zeros(5))
        if high / low > 1.26:
            assert load_manifest(folder).limits[0].band_hz[0] == low
            continue
        with pytest.raises(ManyErrors, match=r"too narrow.*allowed: a high end of .* Hz or more.*Widen it"):
            load_manifest(folder)


def test_a_balance_grade_is_read_as_it_is_written(tmp_path):
    for value in ['"G 6.3"', '"G6.3"', '"g 6.3"', '"6.3 mm/s"', "6.3", '"6.3"']:
        limit = f'[[limits]]\nquantity = "balance grade"\nvalue = {value}\nsource = "x"\n[rotor]\nmass_kg = 12.0'
        (read,) = load_manifest(folder_of(tmp_path, f'unit = "m/s2"\n{limit}', head="acc", values=np.zeros(5))).limits
        assert read.value_si == pytest.approx(6.3e-3, rel=1e-12)


def test_what_lies_above_half_the_rate_of_the_file_is_refused(tmp_path):
    limit = 'quantity = "velocity"\nvalue = "1 mm/s"\nsource = "x"\nband_hz = [10.0, 2000.0]'
    rows = [
        ('unit = "mm/s"\nquantity = "velocity"\nmeasured_unit = "g"\nhighpass_hz = 9000.0', "below 905.1"),
        (f'unit = "m/s2"\n[[limits]]\n{limit}', "up to 1280 Hz"),
    ]
    for channel, said in rows:
        folder = folder_of(tmp_path, channel, head="time_s,acc", values=tone(40.0)[:100])
        write_table(folder / "a.csv", {"time_s": np.arange(5120) / 2560.0, "acc": tone(40.0)[:5120]})
        text = (folder / "run.toml").read_text().replace("rate_hz = 2560.0", 'time_source = "time_s"')
        (folder / "run.toml").write_text(text.replace("source = 0", 'source = "acc"'))
        (fault,) = look_at(folder, None, jobs=1).faults
        assert said in str(fault)
        assert "a.csv" in str(fault)
        assert "_hz" in fault.place
