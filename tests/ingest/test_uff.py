"""Universal files: text and binary histories as written by hand, and what is none."""

import numpy as np
import pytest

from crankorder.errors import InputError
from crankorder.ingest.formats import contents_of, read_file
from made.time_bases import uff_binary, uff_header, uff_text


def as_text(name, values, *, form=2, **more):
    written, per_line = ("13.5E", 6) if form == 2 else ("20.12E", 4)
    head = uff_header(name, len(values), form=form, **more)
    return uff_text(head, [f"{value:{written}}" for value in values], per_line)


def as_binary(name, values, *, form=2, order=1):
    data = values.astype(("<" if order == 1 else ">") + ("f4" if form == 2 else "f8")).tobytes()
    return uff_binary(uff_header(name, len(values), form=form), data, order)


@pytest.fixture
def read(tmp_path, limits):
    def read(*sets, sources=(0,)):
        path = tmp_path / "a.uff"
        path.write_bytes(b"".join(sets))
        return read_file(path, sources=list(sources), settings=limits), contents_of(path, settings=limits)

    return read


def test_text_of_any_length_reads_to_its_digits(read):
    for form in [2, 4]:
        for n in [1, 5, 6, 7, 100, 1001]:
            values = np.random.default_rng(n).normal(scale=100.0, size=n)  # signs touch the numbers before them
            raw, contents = read(as_text("one", values, form=form))
            np.testing.assert_allclose(raw.columns[0], values, rtol=1e-5 if form == 2 else 1e-12)
            assert raw.rates_hz[0] == pytest.approx(2560.0)
            assert raw.starts_s[0] == 0.5
            assert contents.names == ("3-Y",)
            assert contents.units == {"3-Y": "m/s^2"}


def test_binary_of_either_byte_order_reads_exactly_whatever_its_bytes_are(read):
    for order in [1, 2]:
        for form in [2, 4]:
            values = np.frombuffer(b"\n    -1\n" * 500, dtype="<f4").astype(float)  # samples that look like a delimiter
            values[~np.isfinite(values)] = 0.0
            raw, contents = read(
                as_binary("one", values, form=form, order=order), as_text("two", np.ones(9), node=4), sources=(0, 1)
            )
            np.testing.assert_array_equal(raw.columns[0], values.astype("f4" if form == 2 else "f8"))
            assert contents.names == ("3-Y", "4-Y")
            assert raw.columns[1].tolist() == [1.0] * 9


PAIRS = [
    *(("13.5E", "13.5E", per_line) for per_line in (1, 3)),
    *((first, "20.12E", per_line) for first in ("13.5E", "20.12E") for per_line in (1, 2)),
    *((*letters, order) for letters in (("f4", "f4"), ("f4", "f8"), ("f8", "f8")) for order in (1, 2)),
]


def paired(form, times, values, time="s"):
    """A general function (type 0) with the time of each sample before it, in text or binary, as ``PAIRS`` has it."""
    first, second, number = form
    text = uff_header("one", len(values), form=2 if second in ("13.5E", "f4") else 4, function=0, spacing=0, time=time)
    if first in ("f4", "f8"):
        sign = "<" if number == 1 else ">"
        points = np.empty(len(times), dtype=[("time", sign + first), ("value", sign + second)])
        points["time"], points["value"] = times, values
        return uff_binary(text, points.tobytes(), number)
    cells = [f"{at:{first}}{value:{second}}" for at, value in zip(times, values, strict=True)]
    return uff_text(text, cells, number)


@pytest.mark.parametrize("form", PAIRS)
def test_histories_with_a_time_for_each_sample_are_read_where_these_are_even(read, form):
    for n, start, rate_hz, time in [(50, 0.0, 20.0, "ms"), (3001, 0.5, 256.0, "s"), (40000, 12.25, 25600.0, "s")]:
        times, values = start + np.arange(n) / rate_hz, np.random.default_rng(n).normal(size=n)
        raw, contents = read(paired(form, times * {"s": 1.0, "ms": 1e3}[time], values, time))
        np.testing.assert_allclose(raw.columns[0], values, rtol=1e-5)
        doubt = max(1e-6, raw.rate_uncertainty)
        assert doubt < 1e-4
        assert (raw.rates_hz[0], contents.rates_hz["3-Y"]) == pytest.approx((rate_hz, rate_hz), rel=3 * doubt)
        assert raw.starts_s[0] == pytest.approx(start, abs=1.0 / rate_hz)


@pytest.mark.parametrize("form", PAIRS)
def test_missing_samples_are_left_open_and_uneven_times_are_refused(read, form):
    times, values = np.arange(2000) / 256.0, np.random.default_rng(1).normal(size=2000)
    there = (times < 2.0) | (times > 2.03)
    raw, _ = read(paired(form, times[there], values[there]))
    np.testing.assert_allclose(raw.columns[0], np.where(there, values, np.nan), rtol=1e-5)
    assert [flag["flag"] for flag in raw.flags if flag["severity"] != "info"] == ["time_gap"]
    for uneven in (times + np.random.default_rng(2).uniform(0.0, 1e-3, 2000), times * (1.0 + 0.01 * times)):
        with pytest.raises(InputError, match=r"not uniform: off by .* samples|samples are missing"):
            read(paired(form, uneven, values))


def test_other_sets_are_passed_over_and_a_file_without_histories_says_what_it_holds(read):
    spectrum = as_text("frf", np.ones(8), function=4)
    units = b"    -1\n   164\n         1  SI units            2\n    -1\n"
    _, contents = read(units, spectrum, as_text("one", np.ones(8)), as_text("again", np.ones(8)))
    assert contents.names == ("3-Y", "3-Y (2)")
    with pytest.raises(InputError, match=r"no time histories.*data set 164, function type 4 \(frequency"):
        read(units, spectrum)


def test_damage_is_named(read):
    rows = [
        ("         2", "         5", "are complex or unknown"),
        ("  3.90625E-04", "  0.00000E+00", "uneven steps of time"),
        ("1.00000E+00", "1.0000OE+00", "not a number"),
        ("    1         1    0", "    x         1    0", "the header of a data set is wrong"),
    ]
    for old, new, words in rows:
        data = as_text("one", np.ones(7)).decode()
        assert old in data
        with pytest.raises(InputError, match=words):
            read(data.replace(old, new, 1).encode())
    data = as_binary("one", np.ones(7))
    with pytest.raises(InputError, match="of a kind that is not read"):
        read(data.replace(b"     1     2          11", b"     1     3          11"))


def test_what_the_reference_reader_reads_is_read_the_same(shared_data, limits):
    pyuff = pytest.importorskip("pyuff", reason="pyuff, the reference, is not installed")
    for path in sorted((shared_data / "formats" / "uff").glob("*.uff")):
        sets = pyuff.UFF(str(path)).read_sets()
        sets = sets if isinstance(sets, list) else [sets]
        histories = [one for one in sets if one["type"] == 58 and one["func_type"] == 1]
        if not histories:
            with pytest.raises(InputError, match="no time histories"):
                contents_of(path, settings=limits)
            continue
        raw = read_file(path, sources=list(range(len(histories))), settings=limits)
        for number, one in enumerate(histories):
            np.testing.assert_allclose(raw.columns[number], np.real(one["data"])[: raw.columns[number].size], rtol=1e-6)
            assert raw.rates_hz[number] == pytest.approx(1.0 / one["abscissa_inc"], rel=1e-6)
