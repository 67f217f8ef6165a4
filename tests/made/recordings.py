"""Recordings made from analytic signals, with the shaft angle known exactly."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr

from crankorder.ingest.manifest import Manifest, load_manifest
from crankorder.orders.vold_kalman import vold_kalman
from crankorder.quantities import check_dataset
from crankorder.synth.write import toml_text

Signal = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Signal from time [s] and crank angle [rev]."""


def manifest(
    files: str = "a.h5", *, name: str = "made", cycle: str = "rotor",
    channels: Mapping[str, Mapping[str, object]] = {"Z": {}}, **tables: object,
) -> str:  # fmt: skip
    """Text of a manifest: its ``channels`` by name, in m/s2 where nothing else is said, and its other ``tables``."""
    listed = [{"name": key, "unit": "m/s2", **more} for key, more in channels.items()]
    head = {"schema_version": 1, "test": {"name": name, "cycle": cycle}, "recordings": {"files": [files]}}
    return toml_text({**head, "channels": listed, **tables})


def write_manifest(folder: Path, files: str = "a.h5", **stated: Any) -> Path:
    """``folder``, made where there is none, with :func:`manifest` of what is ``stated`` in it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.toml").write_text(manifest(files, **stated), encoding="utf-8")
    return folder


def read_manifest(folder: Path, text: str, *, encoder: str = 'kind = "constant"\nspeed_rpm = 1000.0\n') -> Manifest:
    """The manifest of one channel and an ``encoder`` with the tables of ``text``, written to ``folder``."""
    (folder / "run.toml").write_text(f"{manifest()}[encoder]\n{encoder}{text}", encoding="utf-8")
    return load_manifest(folder)


def write_hdf5(path: Path, columns: Mapping[str, np.ndarray], *, unit: object = "", **attrs: object) -> Path:
    """HDF5 file of ``columns`` by name and of ``attrs``; ``unit``: that of all columns, or of each by its name."""
    units = unit if isinstance(unit, Mapping) else dict.fromkeys(columns, unit)
    with h5py.File(path, "w") as file:
        file.attrs.update(attrs)
        for name, values in columns.items():
            file[name] = values
            if units.get(name):
                file[name].attrs["units"] = units[name]
    return path


def write_table(path: Path, columns: Mapping[str, np.ndarray], *, separator: str = ",", fmt: str = "%.9g") -> Path:
    """Text table of ``columns`` by name."""
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, delimiter=separator, header=separator.join(columns), comments="", fmt=fmt)
    return path


def named(
    channels: int | Sequence[str], unit: str = "m/s2", quantity: str = "acceleration"
) -> dict[str, tuple[str, list[str], dict[str, str]]]:
    """Coordinates of channels of one unit, by their names, or so many that are called A, B, …"""
    names = [chr(ord("A") + k) for k in range(channels)] if isinstance(channels, int) else list(channels)
    columns = {"channel": names, "unit": [unit] * len(names), "quantity": [quantity] * len(names)}
    return {key: ("channel", values, {"units": "1", "long_name": "name"}) for key, values in columns.items()}


def shaft(time_s: np.ndarray, angle_rev: np.ndarray, speed_rpm: np.ndarray, *, revs_per_cycle: int = 2) -> xr.Dataset:
    """ShaftAngle with knots as given."""
    made = xr.Dataset(
        {
            "crank_angle": ("knot", angle_rev, {"units": "rev"}),
            "speed": ("knot", speed_rpm, {"units": "min-1"}),
            "standard_error": ("knot", np.zeros(len(time_s)), {"units": "rev"}),
            "time": ("knot", time_s, {"units": "s"}),
        },
        attrs={
            "recording": "made", "phase_reference": "tdc", "cycle_known": 1, "revs_per_cycle": revs_per_cycle,
            "n_pulses": 0,
        },
    )  # fmt: skip
    check_dataset(made, "shaft_angle")
    return made


def steady(
    signals: list[Signal], *, speed_rpm: float, duration_s: float, rate_hz: float, start_rev: float = -0.3
) -> tuple[xr.Dataset, xr.Dataset]:
    """BandRecording and ShaftAngle at constant speed; crank angle is ``start_rev`` at time 0."""
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    angle = start_rev + time_s * speed_rpm / 60.0
    band = sampled(np.stack([signal(time_s, angle) for signal in signals]), rate_hz=rate_hz)
    return band, held(speed_rpm, duration_s, start_rev=start_rev)


def run_up(
    signals: list[Signal], *, from_rpm: float, to_rpm: float, duration_s: float, rate_hz: float
) -> tuple[xr.Dataset, xr.Dataset]:
    """BandRecording and ShaftAngle of a linear run-up; the angle is quadratic in time, so its cubics are exact."""
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz

    def angle(t: np.ndarray) -> np.ndarray:
        return (from_rpm * t + 0.5 * (to_rpm - from_rpm) * t**2 / duration_s) / 60.0

    knots = np.linspace(0.0, duration_s, 200)
    speed = from_rpm + (to_rpm - from_rpm) * knots / duration_s
    band = sampled(np.stack([signal(time_s, angle(time_s)) for signal in signals]), rate_hz=rate_hz)
    return band, shaft(knots, angle(knots), speed)


def sampled(signals: np.ndarray, *, domain: str = "time", **attrs: object) -> xr.Dataset:
    """Recording of ``signals`` (channels, samples) in m/s2, sampled by ``domain``; ``attrs`` beside those of any."""
    made = xr.Dataset(
        {"signal": (("channel", domain), signals, {"units": "see unit"})},
        coords=named(len(signals)),
        attrs={"recording": "made", "domain": domain, "encoder_kind": "constant", "revs_per_cycle": 2, **attrs},
    )
    check_dataset(made, "recording")
    return made


def accelerometer(values: np.ndarray, rate_hz: float, name: str = "a") -> xr.Dataset:
    """Recording of one accelerometer in m/s2 without an encoder."""
    made = sampled(values[None], recording=name, rate_hz=rate_hz, encoder_kind="none")
    return made.assign(si_per_unit=("channel", [1.0], {"units": "1"}))


def held(speed_rpm: float, seconds: float, *, start_rev: float = 0.0, revs_per_cycle: int = 2) -> xr.Dataset:
    """ShaftAngle of so many ``seconds`` at one speed."""
    knots = np.linspace(0.0, seconds, 50)
    angle = start_rev + knots * speed_rpm / 60.0
    return shaft(knots, angle, np.full(50, speed_rpm), revs_per_cycle=revs_per_cycle)


def line(order: float, amplitude: float, phase_rad: float = 0.0) -> Signal:
    """A line at ``order`` of constant amplitude."""
    return lambda _, angle: amplitude * np.cos(2 * np.pi * order * angle + phase_rad)


def total(*parts: Signal) -> Signal:
    """Sum of signals."""
    return lambda time_s, angle: sum((part(time_s, angle) for part in parts), np.zeros_like(time_s))


def frames_of(
    spectrum: np.ndarray, *, speed_rpm: float | np.ndarray = 1000.0, revs: int = 2, overlap: float = 0.5,
    start_rev: float = 0.0, **attrs: object,
) -> xr.Dataset:  # fmt: skip
    """OrderFrames with the complex ``spectrum`` (channels, frames, orders) on bins from 0, ``revs`` bins an order."""
    n_frames = spectrum.shape[1]
    made = xr.Dataset(
        {"spectrum": (("channel", "frame", "order"), spectrum, {"units": "see unit"})},
        coords={
            **named(len(spectrum)),
            "order": ("order", np.arange(spectrum.shape[2]) / revs, {"units": "1"}),
            "speed": ("frame", np.broadcast_to(speed_rpm, n_frames).astype(float), {"units": "min-1"}),
            "crank_angle": ("frame", start_rev + np.arange(n_frames) * revs * (1.0 - overlap), {"units": "rev"}),
        },
        attrs={
            "recording": "made", "window": "hann", "enbw_bins": 1.5, "revs_per_frame": revs, "overlap": overlap,
            "amplitude_scaling": "peak", "phase_reference": "tdc", "cycle_known": 1, "revs_per_cycle": 2, **attrs,
        },
    )  # fmt: skip
    check_dataset(made, "order_frames")
    return made


def envelopes(
    signals: object, phase_rev: object, *, rate_hz: float, bandwidth_hz: float | np.ndarray, usable: object = True
) -> tuple[np.ndarray, np.ndarray]:
    """Complex amplitudes and standard errors (channels, orders, samples) of the Vold-Kalman filter at all samples."""
    values, phase = np.asarray(signals), np.asarray(phase_rev)
    width = np.broadcast_to(bandwidth_hz, (len(phase), max(2, np.size(bandwidth_hz))))
    settings = {"usable": np.broadcast_to(usable, values.shape), "rate_hz": rate_hz, "bandwidth_hz": width}
    names = [f"component {k}" for k in range(len(phase))]
    return vold_kalman(values, phase, np.arange(values.shape[1]), names=names, **settings)


def noisy_copy(path: Path, other: Path, seed: int) -> None:
    """Copy the recording at ``path`` with a little more noise, so that it is no duplicate."""
    shutil.copy(path, other)
    with h5py.File(other, "r+") as file:
        for item in (item for name, item in file.items() if name.startswith("acc")):
            item[...] += 0.01 * np.random.default_rng(seed).standard_normal(item.shape).astype(item.dtype)
