"""WAV files: all sample formats, the calibration chunk, and every way to be cut short."""

import struct

import numpy as np
import pytest
from scipy.io import wavfile

from crankorder.errors import InputError, UnsafeInputError
from crankorder.ingest.formats import contents_of, read_file

RNG = np.random.default_rng(21)


@pytest.fixture
def read(tmp_path, limits):
    """What is read of the bytes of a file from its ``sources``."""

    def read_bytes(content, *sources):
        (tmp_path / "a.wav").write_bytes(content)
        return read_file(tmp_path / "a.wav", sources=sources, settings=limits)

    return read_bytes


def packed(name, data):
    return name + struct.pack("<I", len(data)) + data


def riff(*chunks):
    body = b"".join(packed(name, data) + b"\0" * (len(data) % 2) for name, data in chunks)
    return b"RIFF" + struct.pack("<I", len(body) + 4) + b"WAVE" + body


def layout(code, n_channels, bits, rate=44_100):
    frame = n_channels * bits // 8
    return b"fmt ", struct.pack("<HHIIHH", code, n_channels, rate, rate * frame, frame, bits)


def calibration(*channels):
    chunk = b""
    for number, (full_scale, name, unit, offset, factor) in enumerate(channels):
        record = struct.pack("<fH", full_scale, len(name)) + name.encode()
        record += struct.pack("<H", len(unit)) + unit.encode() + struct.pack("<ff", offset, factor)
        chunk += packed(f"le{number:02d}".encode(), record)
    return b"LEA ", chunk


MIC = calibration((1.0, "mic", "Pa", 0.0, 1.0))
LEA = calibration((1.0, "mic", "Pa", 0.0, 1.0), (2.0, "b", "Pa", 0.0, 1.0))
STEREO = RNG.integers(-32768, 32767, (1000, 2)).astype("<i2")


def test_every_sample_format_gives_fractions_of_full_scale_and_another_is_named(read):
    rows = [
        (1, 8, lambda x: np.round(x * 128 + 128).astype("u1").tobytes()),
        (1, 16, lambda x: np.round(x * 32768).astype("<i2").tobytes()),
        (1, 24, lambda x: np.round(x * 2**23).astype("<i4").view("u1").reshape(-1, 4)[:, :3].tobytes()),
        (1, 32, lambda x: np.round(x * 2.0**31).astype("<i4").tobytes()),
        (3, 32, lambda x: x.astype("<f4").tobytes()),
        (3, 64, lambda x: x.astype("<f8").tobytes()),
    ]
    for code, bits, pack in rows:
        values = RNG.uniform(-0.99, 0.99, (500, 2))
        raw = read(riff(layout(code, 2, bits), (b"data", pack(values))), 0, "1")
        step = 2.0 ** (1 - bits) if code == 1 else 2.0**-24
        made = np.stack([raw.columns[0], raw.columns["1"]], axis=1)
        np.testing.assert_allclose(made, values, rtol=0, atol=max(step, 2.0**-24))
        assert raw.rates_hz == {0: 44_100.0, "1": 44_100.0}
        assert raw.units[0] == "FS"
        assert not raw.flags
    with pytest.raises(InputError, match="sample format is not supported; found format code 2 with 4 bits"):
        read(riff(layout(2, 1, 4), (b"data", b"\0" * 100)), 0)


DATA = (b"data", STEREO.tobytes())


def test_a_calibration_that_is_not_understood_is_told(read):
    rows = [
        (calibration((1.0, "mic", "Pa", 3.0, 1.0), (1.0, "b", "Pa", 0.0, 1.0)), "offset 3"),
        (MIC, "for 1 channels, the samples have 2"),
        ((b"LEA ", b"LE01" + bytes(40)), "begins with 'LE01"),
        ((b"LEA ", b""), "begins with ''"),
        ((b"LEA ", MIC[1][:-3]), "cut short"),
        ((b"iXML", b"<BWFXML><SENSITIVITY>49.8 mV/Pa</SENSITIVITY></BWFXML>"), "iXML speaks of a calibration"),
        ((b"LIST", b"INFOICMT" + struct.pack("<I", 24) + b"calibrated at 94 dB SPL\0"), "speaks of a calibration"),
        ((b"cals", "Full-Scale: 10 V".encode("utf-16-le")), "speaks of a calibration"),
    ]
    for chunk, said in rows:
        whole, bare = riff(layout(1, 2, 16), DATA, chunk), riff(layout(1, 2, 16), DATA)
        # behind the end that the file declares a calibration of that family alone is a chunk
        for content in (whole, bare + packed(*chunk)) if chunk[0] == b"LEA " else (whole,):
            raw = read(content, 0)
            (told,) = raw.flags
            assert (told["flag"], told["severity"]) == ("calibration_unknown", "suspect") and said in told["detail"]
            assert raw.units[0] == "FS"
    note = (b"LIST", b"INFOISFT" + struct.pack("<I", 14) + b"Lavf58.29.100\0")  # speaks of none
    assert not read(riff(layout(1, 2, 16), note, (b"bext", bytes(602)), DATA), 0).flags


def test_samples_of_a_program_that_streams_are_read_to_the_end(read):
    for riff_bytes in [0, 36, 0xFFFFFFFF, 0x7FFFF024]:
        for data_bytes in [0, 0xFFFFFFFF, 0xFFFFFFDB, 0x7FFFF000]:
            for with_lea in [False, True]:
                content = bytearray(riff(layout(1, 2, 16), DATA))
                struct.pack_into("<I", content, 4, riff_bytes)
                struct.pack_into("<I", content, 40, data_bytes)
                content += packed(*LEA) * with_lea
                raw = read(content, 1)
                np.testing.assert_allclose(raw.columns[1], STEREO[:, 1] / 32768 * (2.0 if with_lea else 1.0), rtol=1e-6)
                assert raw.units[1] == ("Pa" if with_lea else "FS")
                (told,) = raw.flags
                assert told["flag"] == "missing_data" and "did not fill in" in told["detail"]
        struct.pack_into("<I", content, 40, len(DATA[1]))  # whole, but for the length of the file itself
        raw = read(content[: 44 + len(DATA[1])], 0)
        assert raw.columns[0].size == 1000 and (riff_bytes == 0x7FFFF024 or not raw.flags)


def test_lengths_of_64_bits_are_read(read):
    for name in [b"RF64", b"BW64"]:
        for cut in [0, 100, 2400]:
            ds64 = struct.pack("<QQQI", 0, len(DATA[1]), 1000, 1) + struct.pack("<4sQ", b"LEA ", len(LEA[1]))
            content = bytearray(riff((b"ds64", ds64), layout(1, 2, 16), LEA, DATA))
            content[:8] = name + b"\xff" * 4
            for chunk in (b"data", b"LEA "):
                struct.pack_into("<I", content, content.rindex(chunk) + 4, 0xFFFFFFFF)
            if cut > 1000:
                with pytest.raises(InputError, match=r"truncated: 400 of 1000 samples"):
                    read(content[:-cut], 1)
                continue
            raw = read(content[: len(content) - cut], 1)
            np.testing.assert_allclose(raw.columns[1], STEREO[: 1000 - cut // 4, 1] / 16384, rtol=1e-6)
            assert raw.units[1] == "Pa" and [one["flag"] for one in raw.flags] == ["missing_data"] * (cut > 0)


def test_a_rate_that_the_byte_rate_contradicts_is_told(read):
    head = bytearray(layout(1, 2, 16, 48_000)[1])
    struct.pack_into("<I", head, 8, 44_100 * 4)
    raw = read(riff((b"fmt ", bytes(head)), DATA), 0)
    (told,) = raw.flags
    assert told["flag"] == "header_rate_disagrees" and "48000 Hz" in told["detail"] and "44100 Hz" in told["detail"]


def test_a_chunk_of_which_one_is_allowed_may_not_come_again(read):
    chunks = [layout(1, 2, 16), DATA, LEA]
    for again in (layout(1, 2, 16, 48_000), *chunks):
        for place in range(len(chunks) + 1):
            name, both = again[0].decode(), [*chunks[:place], again, *chunks[place:]]
            with pytest.raises(InputError, match=rf"a\.wav: byte [0-9]+: holds two chunks '{name}'"):
                read(riff(*both), 0)


def test_millions_of_chunks_are_refused_at_once(tmp_path, limits, refused_s):
    seconds = []
    for n_chunks in (20_000, 8_000_000):
        (tmp_path / "a.wav").write_bytes(riff(layout(1, 2, 16)) + b"junk\0\0\0\0" * n_chunks)
        with pytest.raises(UnsafeInputError, match=r"a\.wav: holds more than 10000 chunks"):
            contents_of(tmp_path / "a.wav", settings=limits)
        seconds.append(refused_s(lambda: contents_of(tmp_path / "a.wav", settings=limits)))
    assert seconds[1] < 10.0 * seconds[0]


def test_a_lost_calibration_is_not_taken_for_none(read):
    data = riff(layout(1, 2, 16), DATA)
    whole = riff(layout(1, 2, 16), DATA, MIC)
    with pytest.raises(InputError, match=f"truncated after the samples: {len(data)} of {len(whole)} bytes"):
        read(whole[: len(data)], 0)


@pytest.mark.filterwarnings("ignore:Chunk .non-data.:scipy.io.wavfile.WavFileWarning")
def test_scipy_agrees_on_real_files_of_all_sample_formats(shared_data, limits):
    for path in (shared_data / "formats" / "wav").glob("flute*.wav"):  # one with bytes behind its end
        rate, samples = wavfile.read(path)
        raw = read_file(path, sources=[0], settings=limits)
        assert raw.rates_hz == {0: rate}
        full_scale = 1.0 if samples.dtype.kind == "f" else 2.0 ** (8 * samples.itemsize - 1)
        expected = (samples.astype(float) - 128.0 * (samples.dtype == np.uint8)) / full_scale
        np.testing.assert_array_equal(raw.columns[0], expected)


def as_its_makers_write(samples, odd, lea, *, beyond):
    """A file with an odd chunk that nothing fills up, and its calibration behind the samples or behind its own end."""
    body, tail = packed(*layout(1, 2, 16)) + packed(b"data", samples), packed(b"NOTE", odd) + packed(*lea)
    inside = len(body) + (0 if beyond else len(tail))
    return b"RIFF" + struct.pack("<I", inside + 4) + b"WAVE" + body + tail


def test_a_calibration_is_read_wherever_its_maker_leaves_it(read):
    for beyond in [False, True]:
        for odd in [b"", b"abc", b"\0" * 17, b"LIST?" * 5]:
            lea = calibration((2.0, "mic", "Pa", 0.0, 0.99655), (4821.43, "speed", "rpm", 0.0, 1.0))
            raw = read(as_its_makers_write(STEREO.tobytes(), odd, lea, beyond=beyond), "mic", "speed")
            assert raw.units == {"mic": "Pa", "speed": "rpm"} and not raw.flags
            made = np.stack([raw.columns["mic"] / (2.0 * 0.99655), raw.columns["speed"] / 4821.43], axis=1)
            np.testing.assert_allclose(made, STEREO / 32768, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
def test_odd_samples_may_be_filled_up_or_not(read):
    samples = RNG.integers(0, 255, 1001).astype("u1").tobytes()
    padded = riff(layout(1, 1, 8), (b"data", samples), MIC)
    for data in (padded, padded.replace(samples + b"\0LEA ", samples + b"LEA ")):
        raw = read(data, "mic")
        assert raw.units["mic"] == "Pa" and raw.columns["mic"].size == 1001
