"""Is this machine fit: versions, free space, a known answer."""

from __future__ import annotations

import platform
import shutil
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from crankorder.batch.store import library_versions
from crankorder.fft.plans import fft_library
from crankorder.fft.transforms import FrameTransform
from crankorder.fft.windows import hann


def examine(out: Path) -> tuple[list[str], bool]:
    """Lines that say what there is, and whether the self-test gave the known answer.

    ``out`` is the folder whose disk is asked for free space.
    """
    lines = [f"crankorder {version('crankorder')}, Python {platform.python_version()}"]
    lines += [f"{name} {number}" for name, number in library_versions().items() if name != "crankorder"]
    try:
        lines.append(f"openpyxl {version('openpyxl')}: XLSX recordings can be read")
    except PackageNotFoundError:
        lines.append("openpyxl is missing: for XLSX recordings `pip install crankorder[xlsx]`")
    existing = next(folder for folder in (out.resolve(), *out.resolve().parents) if folder.exists())
    lines.append(f"free space for results: {shutil.disk_usage(existing).free / 1e9:.1f} GB")
    # the spectrum of cos(2 pi 5 t + 1) at its bin is exp(1j)
    signal = np.cos(2.0 * np.pi * 5.0 * np.arange(64) / 64 + 1.0)[None, :]
    error = float(abs(FrameTransform(hann(64)).spectra(signal, np.array([0]))[0, 0, 5] - np.exp(1j)))
    healthy = error < 1e-12
    said = f"a cosine of amplitude 1 is found to {error:.1e}: {'good' if healthy else 'BAD'}"
    lines.append(f"known answer ({fft_library()}): {said}")
    return lines, healthy
