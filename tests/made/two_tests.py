"""Results of made tests, as a run leaves them: maps from analytic recordings, findings that name what was put in."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from crankorder.batch.result_folder import publish
from crankorder.batch.store import json_bytes
from crankorder.identify.order_changes import Tested
from crankorder.orders.fixed_lines import lines_of_findings
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.orders.track_rows import order_tracks
from crankorder.report.netcdf import results_bytes
from crankorder.settings import load_settings
from made.recordings import line, steady, total
from made.typed import findings_of

SETTINGS = load_settings(asked={"orders": {"max_order": 12.0}})
SPEEDS_RPM = (900.0, 1200.0, 1500.0, 1800.0)
RATE_HZ = 1000.0

Phasor = Callable[[float], complex]
"""Complex amplitude of a line at a speed in rpm."""


def made_test(
    lines: Mapping[float, Phasor], *, name: str = "made", seed: int = 0, speeds: Sequence[float] = SPEEDS_RPM,
    duration_s: float = 16.0, run: Mapping[str, Any] | None = None, modes: Sequence[dict[str, Any]] = (),
    channels: Sequence[str] = ("A",), mains: float = 0.0, gains: Sequence[float] = (),
) -> Tested:  # fmt: skip
    """A test with ``lines`` (by order) in white noise; ``run`` is merged into what run.json states.

    ``mains`` is the amplitude of a line of 50 Hz whose phase is by chance, ``gains`` those of the channels, else 1.
    """
    orders = []
    for number, rpm in enumerate(speeds):
        phasors = {order: complex(phasor(rpm)) for order, phasor in lines.items()}
        tones = [line(order, abs(value), float(np.angle(value))) for order, value in phasors.items()]
        tones = [_scaled(total(*tones, _mains(mains, 1000 * seed + number)), gain) for gain in gains or [1.0] * 9]
        signals = [total(tones[row], _noise(1000 * seed + 10 * number + row)) for row in range(len(channels))]
        recording = steady(signals, speed_rpm=rpm, duration_s=duration_s, rate_hz=RATE_HZ)
        orders.append(order_frames(*recording, settings=SETTINGS.orders))
    by_order = order_map(orders, settings=SETTINGS.orders).assign_coords(channel=list(channels))
    shaft = xr.Dataset({"speed_mean": ("recording", np.array(speeds), {"units": "min-1"})})
    document, statement = findings(lines, channels, name, modes), {**stated(name, channels), **(run or {})}
    fixed = {"frequency_hz": 50.0, "frequency_hz_ci95": [49.98, 50.02], "explained_by": "mains", "amplitude": mains}
    fixed["amplitude_ci95"] = [0.9 * mains, 1.1 * mains]
    told = findings_of(document | {"lines": [fixed | {"channel": channel} for channel in channels if mains]})
    known = {"settings": SETTINGS.orders, "frames": orders, "fixed": lines_of_findings(told)}
    tracks = order_tracks(by_order.drop_vars("frames_used", errors="ignore"), list(lines), **known)
    return Tested(name, told, statement, {"order_map": by_order, "order_tracks": tracks, "shaft": shaft})


def _mains(amplitude: float, seed: int) -> Any:
    phase = 2.0 * np.pi * np.random.default_rng([seed, 50]).random()
    return lambda time_s, _: amplitude * np.cos(2.0 * np.pi * 50.0 * time_s + phase)


def _scaled(signal: Any, gain: float) -> Any:
    return lambda *at: gain * signal(*at)


def _noise(seed: int) -> Any:
    return lambda time_s, _: 0.3 * np.random.default_rng(seed).standard_normal(len(time_s))


def findings(
    lines: Mapping[float, Phasor], channels: Sequence[str], name: str, modes: Sequence[dict[str, Any]] = ()
) -> dict[str, Any]:
    """Findings that name the ``lines``, with the keys that a comparison reads."""
    records = [
        {
            "channel": channel, "order": order, "order_ci95": [order - 0.003, order + 0.003], "amplitude": 1.0,
            "amplitude_ci95": [0.9, 1.1], "locked": True, "explained_by": "shaft harmonic",
        }
        for channel in channels for order in lines
    ]  # fmt: skip
    return {
        "schema_version": 1,
        "test": name,
        "channels": [{"name": channel, "unit": "m/s2", "quantity": "acceleration"} for channel in channels],
        "orders": records, "modes": list(modes), "looked_for": ["modes"] if modes else [], "bearings": [],
        "balance": None, "quality": [],
    }  # fmt: skip


def stated(name: str, channels: Sequence[str] = ("A",)) -> dict[str, Any]:
    """What run.json states of a made test."""
    columns = [{"name": c, "unit": "m/s2", "quantity": "acceleration", "sensitivity": None} for c in channels]
    return {
        "schema_version": 1, "test": name, "code_sha256": "0" * 64,
        "versions": {"crankorder": "0.1.0", "numpy": "2.4.6"},
        "inputs": [{"name": f"{name}.h5", "sha256": name.encode().hex().rjust(64, "0")[-64:], "bytes": 1}],
        "manifest": {
            "test": {"cycle": "rotor", "name": name, "engine": None},
            "sampling": {"domain": "time", "rate_hz": RATE_HZ}, "channels": columns,
            "encoder": {"kind": "square", "pulses_per_rev": 60}, "bearings": [],
        },
        "engine": None, "settings": json.loads(SETTINGS.model_dump_json()), "quality": [],
    }  # fmt: skip


def written(test: Tested, out: Path) -> Path:
    """The folder of ``test`` below ``out``, with the files that a comparison reads and the done marker."""
    folder = out / test.name.replace(" ", "-")
    files = {
        "results.nc": results_bytes(dict(test.maps), attrs={"title": test.name}),
        "findings.json": json_bytes(test.findings.as_dict()),
        "run.json": json_bytes({**test.run, "test": test.name}),
    }
    publish(folder, files, key="made")
    return folder
