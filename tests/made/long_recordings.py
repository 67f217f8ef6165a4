"""Recordings of any length, written in blocks: three channels of known orders, an encoder and an index, in HDF5.

``tests/hard`` analyses them in less memory than they are large; ``benchmarks/long_recordings.py`` measures how much.
"""

from pathlib import Path

import h5py
import numpy as np

from made.recordings import write_manifest

NAMES = ("x", "y", "z", "encoder", "index")
AMPLITUDES = {1.0: 1.0, 2.0: 0.5, 4.5: 0.2}
"""Peak amplitude of each order in the first channel; the second has twice, the third three times as much."""
MEAN_RPM, SWING_RPM, SWING_S = 1000.0, 100.0, 60.0
BLOCK = 1 << 20


def turns(time_s: np.ndarray) -> np.ndarray:
    """Crank angle [rev] at ``time_s``: the speed swings slowly about its mean, so that a long record has few speeds."""
    swing = 2.0 * np.pi / SWING_S
    return MEAN_RPM / 60.0 * time_s + SWING_RPM / 60.0 / swing * (1.0 - np.cos(swing * time_s))


def write_long(
    folder: Path, seconds: float, *, rate_hz: float = 50_000.0, pulses_per_rev: int = 60, chunks: tuple | None = None
) -> Path:
    """A test-run folder with one recording of ``seconds``; never more than a block of it is in memory."""
    sampling = {"domain": "time", "rate_hz": rate_hz}
    encoder = {"source": "encoder", "kind": "square", "pulses_per_rev": pulses_per_rev, "index": "index"}
    channels = {name.upper(): {"source": name, "quantity": "acceleration"} for name in NAMES[:3]}
    stated = {"channels": channels, "sampling": sampling, "encoder": encoder | {"index_to_tdc_deg": 0.0}}
    write_manifest(folder, "*.h5", name="long", cycle="four-stroke", **stated)
    n_samples = round(seconds * rate_hz)
    with h5py.File(folder / "long.h5", "w") as file:
        file.attrs["rate_hz"] = rate_hz
        columns = [file.create_dataset(name, (n_samples,), np.float32, chunks=chunks) for name in NAMES]
        for first in range(0, n_samples, BLOCK):
            part = slice(first, min(first + BLOCK, n_samples))
            angle = turns(np.arange(part.start, part.stop) / rate_hz)
            noise = np.random.default_rng(first)
            tone = sum(size * np.cos(2.0 * np.pi * order * angle) for order, size in AMPLITUDES.items())
            for number in range(3):
                columns[number][part] = (number + 1) * tone + 0.05 * noise.standard_normal(angle.size)
            columns[3][part] = 5.0 * ((angle * pulses_per_rev + 0.25) % 1.0 < 0.5)
            columns[4][part] = 5.0 * ((angle + 0.25 / pulses_per_rev) % 1.0 < 0.5 / pulses_per_rev)
    return folder
