"""The manifest of a synthetic test run, as text."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from crankorder.synth.effects import TimeSampling
from crankorder.synth.scene import Scene


def manifest_text(scene: Scene, engine_name: str) -> str:
    """Text of ``run.toml`` for the folder of ``scene``; ``engine_name`` is a shipped engine or a file in the folder."""
    timed = isinstance(scene.sampling, TimeSampling)
    table: dict[str, Any] = {
        "schema_version": 1,
        "test": {"name": scene.title, "engine": engine_name, "cycle": scene.engine.cycle},
        "recordings": {"files": ["rpm_*.h5"]},
    }
    if isinstance(scene.sampling, TimeSampling):
        table["sampling"] = {"domain": "time", "rate_hz": scene.sampling.rate_hz}
    else:
        sampling = {"samples_per_rev": scene.sampling.samples_per_rev, "start_deg": 0.0}
        table["sampling"] = {"domain": "crank_angle", **sampling}
        table["recordings"]["speed_rpm"] = {f"{run.name}.h5": run.speed_rpm for run in scene.runs}
    table["channels"] = [
        {
            "name": channel.name,
            "source": channel.source,
            "quantity": "acceleration",
            "unit": "m/s2",
            "direction": channel.direction,
        }
        for channel in scene.channels
    ]
    if timed and scene.encoder is not None:
        table["encoder"] = {
            "source": "encoder",
            "kind": "square",
            "pulses_per_rev": scene.encoder.pulses_per_rev,
            "missing_teeth": 0,
            "index": "index",
            "edge": "rising",
            "ratio": 1.0,
            "index_to_tdc_deg": 0.0,
        }
    table["bearings"] = [
        bearing.model_dump(exclude_none=True, exclude_defaults=True) for bearing in scene.engine.bearings
    ]
    return toml_text(table)


def toml_text(table: Mapping[str, Any], prefix: str = "") -> str:
    """TOML text of ``table``: plain values first, then its tables and lists of tables under ``prefix``."""
    tables = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    lists = {key: value for key, value in table.items() if _is_list_of_tables(value)}
    lines = [f"{_key(key)} = {_value(value)}" for key, value in table.items() if key not in tables and key not in lists]
    text = "".join(f"{line}\n" for line in lines)
    for key, inner in tables.items():
        path = f"{prefix}{_key(key)}"
        text += f"\n[{path}]\n{toml_text(inner, f'{path}.')}"
    for key, items in lists.items():
        path = f"{prefix}{_key(key)}"
        text += "".join(f"\n[[{path}]]\n{toml_text(item, f'{path}.')}" for item in items)
    return text


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _value(key)


def _is_list_of_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(item, Mapping) for item in value)


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(item) for item in value)}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace(
            "\x7f", "\\u007f"
        )  # the one character where TOML is stricter
    return json.dumps(value)
