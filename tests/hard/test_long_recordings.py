"""A recording larger than memory is analysed in blocks; what comes out is what comes out of memory."""

import gc
import os
import resource
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest
import xarray as xr

from crankorder.batch.plan import plan_tests
from crankorder.checks.doubts import Doubts
from crankorder.fft.decimation import band_limited
from crankorder.identify.machine_model import MachineModel
from crankorder.ingest.recording import read_recording
from crankorder.scratch import is_on_disk
from crankorder.stages import analyse_recording, analyse_test
from made.long_recordings import AMPLITUDES, write_long


def analysed(folder, recipe, max_memory_mb):
    plan = plan_tests([folder], folder.parent / "out", recipe=recipe, max_memory_mb=max_memory_mb).tests[0]
    made = analyse_recording(plan.recordings[0], plan.manifest, plan.settings)
    return analyse_test([made], Doubts(), test="long", sources=MachineModel(revs_per_cycle=2), settings=plan.settings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("recipe", "record"), [(None, {"pulses_per_rev": 360}), ("maps-full-band", {"chunks": (30_011,)})]
)
def test_blocks_on_disk_give_what_memory_gives(tmp_path, recipe, record):
    recorded = write_long(tmp_path / "data", 24.0, **record)
    whole, blocks = analysed(recorded, recipe, 8000), analysed(recorded, recipe, 0)
    assert whole.datasets.keys() == blocks.datasets.keys()
    for name, expected in whole.datasets.items():
        for variable in expected.variables:
            found, wanted = blocks.datasets[name][variable].values, expected[variable].values
            if wanted.dtype.kind in "fc":
                np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12, err_msg=f"{name}.{variable}")
            else:
                np.testing.assert_array_equal(found, wanted)
    assert whole.findings == blocks.findings


@pytest.mark.skipif(sys.platform != "linux", reason="the limit on memory without a file is Linux's")
@pytest.mark.slow
def test_a_recording_three_times_larger_than_memory_is_analysed(tmp_path):
    folder = write_long(tmp_path / "data", 900.0, rate_hz=100_000.0, pulses_per_rev=24)
    memory = 600_000_000
    assert (folder / "long.h5").stat().st_size >= 3 * memory
    done = subprocess.run(
        [
            sys.executable, "-m", "crankorder", "run", folder, "--out", tmp_path / "out", "--recipe", "maps",
            "--jobs", "1", "--max-memory", "50",
        ],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_DATA, (memory, memory)),
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    (folder / "long.h5").unlink()
    assert done.returncode == 0, done.stderr
    with xr.open_dataset(tmp_path / "out" / "long" / "results.nc", group="order_map", engine="h5netcdf") as order_map:
        for order, size in AMPLITUDES.items():
            found = order_map["amplitude"].sel(order=order, method="nearest")
            np.testing.assert_allclose(found.isel(channel=0), size, rtol=2e-3)


def peak_of_reading(folder):
    """Bytes that reading a recording and limiting its band hold at most."""
    plan = plan_tests([folder], folder.parent / "out", max_memory_mb=0).tests[0]
    gc.collect()
    tracemalloc.start()
    try:
        recording = read_recording(
            plan.recordings[0], plan.manifest, settings=plan.settings.ingest, shaft=plan.settings.shaft
        )
        band = band_limited(recording, band_hz=1250.0, grid_hz=1.0)
        assert is_on_disk(recording["signal"].values)
        assert is_on_disk(band["signal"].values)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_reading_three_times_as_long_a_record_takes_no_more_memory(tmp_path):
    peak_of_reading(write_long(tmp_path / "first" / "data", 3.0))  # filters are designed and kept
    short, long = (peak_of_reading(write_long(tmp_path / str(s) / "data", s)) for s in (48.0, 144.0))
    assert short < 10_000_000  # of 48 MB of samples
    assert long < short + 100_000
