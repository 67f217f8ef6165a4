"""LabVIEW measurement files: columns, decimals, segments, and a header that does not always tell the truth."""

import numpy as np
import pytest

from crankorder.errors import InputError
from crankorder.ingest.formats import contents_of, read_file
from crankorder.quantities import flags_of
from made.recordings import manifest

HEAD = "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\nMulti_Headings\tYes\n"
SEGMENT = (
    "Channels\t2\t\t\nSamples\t{n}\t{n}\t\nY_Unit_Label\tVolts\tg\t\nX_Dimension\tTime\tTime\t\n"
    "X0\t0\t0\t\nDelta_X\t{step}\t{step}\t\n***End_of_Header***\t\t\t\n"
)


def lvm(values, *, step="0.001", times=None, comment="", segments=1, head="\t", cells="\t"):
    """Text of a file with the columns ``values`` and, where given, their ``times``.

    ``head`` and ``cells`` are the separators of the headers and of the values.
    """
    text = HEAD + f"X_Columns\t{'No' if times is None else 'One'}\n***End_of_Header***\t\n\t\n"
    text = text.replace("\t", head)
    for _ in range(segments):
        text += SEGMENT.format(n=len(values), step=step).replace("\t", head)
        text += "X_Value\tdrive\tacc\tComment\n".replace("\t", head)
        for number, row in enumerate(values):
            time = "" if times is None else f"{times[number]:.6f}"
            text += cells.join([time, *(f"{value:.6f}" for value in row), *([comment] if comment else [])]) + "\n"
        text += "\n"
    return text


@pytest.fixture
def written(tmp_path):
    def write(text, *, encoding="utf-8"):
        (tmp_path / "a.lvm").write_text(text, encoding=encoding)
        return tmp_path / "a.lvm"

    return write


VALUES = np.round(np.random.default_rng(1).normal(size=(200, 2)), 6)


def test_headers_and_values_are_parted_by_tabs_commas_or_semicolons_alike(written, limits):
    for head in "\t,;":
        for comma, cells in [(".", "\t"), (".", ","), (".", ";"), (",", "\t"), (",", ";")][: 3 if head == "," else 5]:
            for times, comment, segments in [(None, "", 2), (np.arange(200) * 1e-3, "", 1), (None, "a remark", 1)]:
                text = lvm(VALUES, times=times, comment=comment, segments=segments, head=head, cells=cells)
                path = written(text.replace("Tab", {",": "Comma"}.get(cells, "Tab")).replace(".", comma))
                source = "acc" if segments == 1 else "1/acc"
                names = contents_of(path, settings=limits).names
                assert segments == 2 or names == ("drive", "acc", *([] if times is None else ["X_Value"]))
                raw = read_file(path, sources=[source], settings=limits)
                np.testing.assert_array_equal(raw.columns[source], VALUES[:, 1])
                assert (raw.units[source], raw.rates_hz[source]) == ("g", pytest.approx(1000.0, rel=1e-9))


def recording_of(path, read_in, rate_hz=None):
    rate = "" if rate_hz is None else f"[sampling]\nrate_hz = {rate_hz}\n"
    (path.parent / "run.toml").write_text(manifest("a.lvm", cycle="none", channels={"acc": {}}) + rate)
    recording = read_in(path)
    return recording, {flag["flag"]: flag["severity"] for flag in flags_of(recording)}


def test_times_go_before_a_stale_header_and_a_flag_tells(written, read_in):
    path = written(lvm(VALUES, step="1.953125E-5", times=np.arange(200) * 1e-3))
    with pytest.raises(InputError, match="the sampling rate is 1000 Hz in the file, 51200 Hz in the manifest"):
        recording_of(path, read_in, 51200)
    for stated, severity in [(None, "suspect"), (1000.0, "info")]:
        recording, flags = recording_of(path, read_in, stated)
        assert recording.attrs["rate_hz"] == pytest.approx(1000.0, rel=1e-9)
        assert flags["header_rate_disagrees"] == severity


def test_a_rounded_step_agrees_with_all_that_it_may_mean_and_with_nothing_else(written, read_in):
    path = written(lvm(VALUES, step="0.000977"))
    recording, flags = recording_of(path, read_in, 1024)
    assert recording.attrs["rate_hz"] == 1024.0
    assert "rate_rounded" not in flags
    recording, flags = recording_of(path, read_in)
    assert recording.attrs["rate_hz"] == pytest.approx(1 / 0.000977)
    assert flags["rate_rounded"] == "suspect"
    with pytest.raises(InputError, match="the sampling rate is"):
        recording_of(path, read_in, 1026)


def test_what_is_no_measurement_is_said_to_be_so(written, limits):
    rows = [
        (lambda text: text.replace("\t-", "\tOVER", 1), "a cell is no number"),
        (lambda text: text[: text.index("Delta_X")], "truncated: a header has no end"),
        (lambda text: text[: text.index("Channels")], "holds no segment of measured values"),
        (lambda text: text[: text.index("X_Value")], "no names of columns below a header"),
    ]
    for change, words in rows:
        with pytest.raises(InputError, match=words):
            read_file(written(change(lvm(VALUES))), sources=["acc", "drive"], settings=limits)


def test_real_files_of_old_and_new_writers_are_read(shared_data, limits):
    folder = shared_data / "formats" / "lvm"
    first = {
        "short.lvm": ("Excitation (Trigger)", [0.914018, 0.537321, 0.616905], 25600.0),
        "multi_time_column.lvm": ("Acceleration", [0.532608, 0.502991, 0.467541], 51200.0),
        "no_decimal_separator.lvm": ("ay", [-0.028189, -0.031060, -0.013517], 4000.0),
        "with_empty_fields.lvm": ("Dev0/Ai0 1", [-0.011923, -0.009206, -0.014640], 1000.0),
        "long_single_header_multi_ch.lvm": ("m_2", [0.244440, 0.247439, 0.246564], 1 / 0.000977),
    }
    for name, (source, values, rate_hz) in first.items():
        raw = read_file(folder / name, sources=[source], settings=limits)
        np.testing.assert_array_equal(raw.columns[source][:3], values)
        assert raw.rates_hz[source] == pytest.approx(rate_hz, rel=1e-9), name
    with pytest.raises(InputError, match="not even between gaps"):
        read_file(folder / "with_comments.lvm", sources=[0], settings=limits)
