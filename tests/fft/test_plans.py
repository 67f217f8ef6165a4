"""FFTW and scipy carry out the same plans; without FFTW nothing of it is loaded."""

import os
import subprocess
import sys

import numpy as np
import pytest

from crankorder.errors import RequestError
from crankorder.fft import plans
from crankorder.fft.plans import VARIABLE, fft_library, forward, inverse

_WITHOUT_FFTW = """
import sys
sys.modules["pyfftw"] = None
import importlib.util
real = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == "pyfftw" else real(name, *rest)
import numpy as np
import crankorder as co
from crankorder.batch.store import library_versions
made = co.recording(2.0 * np.cos(2 * np.pi * 75.0 * np.arange(80_000) / 10_000.0), rate_hz=1e4, speed_rpm=1500.0)
peak = float(co.order_map(made)["amplitude"].sel(order=3.0).item())
co.campbell_map(made, max_frequency_hz=200.0)
assert abs(peak - 2.0) < 1e-5, peak
assert not any(name.split(".")[0] == "pyfftw" and one for name, one in sys.modules.items())
assert library_versions()["pyfftw"] == "not used"
"""


@pytest.fixture(params=["fftw", "scipy"])
def library(request, monkeypatch):
    if request.param == "fftw":
        pytest.importorskip("pyfftw", reason="pyfftw is not installed here")
    monkeypatch.setenv(VARIABLE, request.param)
    yield request.param


def test_a_spectrum_is_the_sum_that_defines_it(library):
    matrix = np.exp(-2j * np.pi * (np.outer(np.arange(60), np.arange(31)) % 60) / 60)
    for kind, error in ((np.float32, 2e-7), (np.float64, 1e-15)):
        plan = forward((3, 60), kind)
        plan.input_array[...] = np.random.default_rng(1).standard_normal((3, 60))
        wanted = plan.input_array.astype(float) @ matrix
        plan.execute()
        assert fft_library() == library
        assert np.abs(plan.output_array - wanted).max() < error * 60
        assert plan.output_array.dtype == (np.complex64 if kind is np.float32 else np.complex128)


def test_an_inverse_is_a_plain_sum(library):
    plan = inverse((2, 48), np.complex64)
    plan.input_array[...] = 0.0
    plan.input_array[1, 5] = 1.0
    plan.execute()
    np.testing.assert_allclose(plan.output_array[1], np.exp(2j * np.pi * 5 * np.arange(48) / 48), atol=1e-6)


def test_without_fftw_nothing_of_it_is_loaded():
    environment = {"PATH": "/usr/bin:/bin", "HOME": "/tmp"}
    environment |= {name: os.environ[name] for name in ("NUMBA_CACHE_DIR", "PYTHONPATH") if name in os.environ}
    ended = subprocess.run([sys.executable, "-c", _WITHOUT_FFTW], env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr[-2000:]


def test_a_library_that_is_none_is_refused(monkeypatch):
    monkeypatch.setenv(VARIABLE, "mkl")
    with pytest.raises(RequestError, match=r"CRANKORDER_FFT.*mkl.*fftw, scipy"):
        fft_library()
    monkeypatch.setattr(plans, "find_spec", lambda name: None)
    plans._library.cache_clear()
    monkeypatch.setenv(VARIABLE, "fftw")
    with pytest.raises(RequestError, match="not installed"):
        fft_library()
    monkeypatch.delenv(VARIABLE)
    assert fft_library() == "scipy"
    plans._library.cache_clear()
