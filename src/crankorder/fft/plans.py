"""Plans of discrete Fourier transforms that own their buffers: by FFTW, else by scipy.

``CRANKORDER_FFT=scipy`` does without FFTW (pyfftw), whose licence is the GPL: see NOTICE.
"""

from __future__ import annotations

import os
from functools import cache, partial
from importlib.util import find_spec
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from crankorder.errors import RequestError

VARIABLE = "CRANKORDER_FFT"
"""Of the environment: "fftw" or "scipy"; without it FFTW is taken where it is installed."""

Library = Literal["fftw", "scipy"]


class Plan(Protocol):
    """A planned transform: fill ``input_array``, ``execute``, read ``output_array``; the input may be overwritten.

    The arrays have the shapes (…, samples or bins) for which :func:`forward` or :func:`inverse` planned it.
    """

    input_array: NDArray[Any]
    output_array: NDArray[Any]

    def execute(self) -> None:
        """Transform what ``input_array`` holds into ``output_array``."""


def fft_library() -> Library:
    """The library that transforms: "fftw" or "scipy".

    Raises RequestError where ``CRANKORDER_FFT`` names another, or FFTW where pyfftw is not installed.
    """
    return _library(os.environ.get(VARIABLE, ""))


@cache
def _library(asked: str) -> Library:
    there = find_spec("pyfftw") is not None
    if asked not in ("", "fftw", "scipy"):
        raise RequestError("no such library", file=VARIABLE, found=asked, allowed="fftw, scipy, or not set")
    if asked == "fftw" and not there:
        remedy = "pip install pyfftw, or unset it"
        raise RequestError("pyfftw is not installed", file=VARIABLE, found=asked, remedy=remedy)
    return "fftw" if there and asked != "scipy" else "scipy"


def forward(shape: tuple[int, ...], kind: Any) -> Plan:
    """Plan of the spectra (…, n // 2 + 1) of real rows (…, n) of that ``shape``, float32 or float64 by ``kind``."""
    complex_kind = np.complex64 if np.dtype(kind) == np.float32 else np.complex128
    return _planned(shape, kind, (*shape[:-1], shape[-1] // 2 + 1), complex_kind, "forward")


def inverse(shape: tuple[int, ...], kind: Any) -> Plan:
    """Plan of the plain sums (…, n) of spectra (…, n) of that ``shape``, complex ``kind``: no 1/n."""
    return _planned(shape, kind, shape, kind, "inverse")


def _planned(shape: tuple[int, ...], kind: Any, out_shape: tuple[int, ...], out_kind: Any, way: str) -> Plan:
    if fft_library() == "scipy":
        return _ByScipy(np.zeros(shape, dtype=kind), np.zeros(out_shape, dtype=out_kind), way)
    import pyfftw

    into, out = pyfftw.zeros_aligned(shape, dtype=kind), pyfftw.zeros_aligned(out_shape, dtype=out_kind)
    flags = ("FFTW_ESTIMATE",) if way == "forward" else ("FFTW_ESTIMATE", "FFTW_DESTROY_INPUT")
    direction = "FFTW_FORWARD" if way == "forward" else "FFTW_BACKWARD"
    plan: Plan = pyfftw.FFTW(into, out, axes=(-1,), direction=direction, flags=flags)
    return plan


class _ByScipy:
    """A plan that scipy carries out."""

    def __init__(self, into: NDArray[Any], out: NDArray[Any], way: str) -> None:
        from scipy import fft

        self.input_array, self.output_array = into, out
        self._transform = fft.rfft if way == "forward" else partial(fft.ifft, norm="forward")

    def execute(self) -> None:
        """Transform what ``input_array`` holds into ``output_array``."""
        self.output_array[...] = self._transform(self.input_array)
