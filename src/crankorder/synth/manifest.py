"""The manifest of a synthetic test run, as text."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from crankorder.synth.effects import Encoder
from crankorder.synth.faults import WrongLabels
from crankorder.synth.parts import Channel, TimeSampling
from crankorder.synth.scene import Scene
from crankorder.synth.truth import name_of_test

TRACE, INDEX, PULSE_TIME, INDEX_TIME = "encoder", "index", "pulse_time", "index_time"
"""Datasets of the encoder in a file."""


def manifest_text(scene: Scene, engine_name: str, repeat: int = 0) -> str:
    """Text of ``run.toml`` for the folder of one ``repeat`` of ``scene``, wrong labels included.

    ``engine_name``: a shipped engine or a file in the folder.
    """
    files = ["rpm_*.h5"] if scene.speeds is not None else [f"{run.name}.h5" for run in scene.runs]
    labels = scene.wrong_labels or WrongLabels()
    table: dict[str, Any] = {
        "schema_version": 1,
        "test": {"name": name_of_test(scene, repeat), "engine": engine_name, "cycle": scene.engine.cycle},
        "recordings": {"files": files},
    }
    if isinstance(scene.sampling, TimeSampling):
        table["sampling"] = {"domain": "time", "rate_hz": scene.sampling.rate_hz * labels.rate_factor}
    else:
        sampling = {"samples_per_rev": scene.sampling.samples_per_rev, "start_deg": 0.0}
        table["sampling"] = {"domain": "crank_angle", **sampling}
        stated = {f"{run.name}.h5": run.speed_rpm * labels.speed_factor for run in scene.runs}
        table["recordings"]["speed_rpm"] = stated
    table["channels"] = [_channel(scene, channel) for channel in scene.channels]
    if scene.encoder is not None:
        table["encoder"] = _encoder(scene.encoder, labels)
    table["bearings"] = [
        bearing.model_dump(exclude_none=True, exclude_defaults=True) for bearing in scene.engine.bearings
    ]
    return toml_text(table)


def labelled_unit(scene: Scene, channel: str) -> str:
    """Unit of what the file holds for ``channel``, as ``scene`` labels it."""
    if scene.wrong_labels is not None and channel in scene.wrong_labels.units:
        return scene.wrong_labels.units[channel]
    return "V" if scene.acquisition.sensitivity_mv_per_g is not None else "m/s2"


def _channel(scene: Scene, channel: Channel) -> dict[str, Any]:
    swapped = scene.wrong_labels.swapped if scene.wrong_labels else None
    source = channel.source
    if swapped is not None and channel.name in swapped:
        other = swapped[1 - swapped.index(channel.name)]
        source = next(entry.source for entry in scene.channels if entry.name == other)
    entry = {"name": channel.name, "source": source, "quantity": "acceleration", "unit": "m/s2"}
    if scene.acquisition.sensitivity_mv_per_g is not None:
        entry["sensitivity"] = f"{scene.acquisition.sensitivity_mv_per_g:.12g} mV/g"
    return entry | {"direction": channel.direction}


def _encoder(encoder: Encoder, labels: WrongLabels) -> dict[str, Any]:
    counted = encoder.delivered_as == "pulse_times"
    table: dict[str, Any] = {
        "source": PULSE_TIME if counted else TRACE,
        "kind": encoder.delivered_as,
        "pulses_per_rev": labels.pulses_per_rev or encoder.pulses_per_rev,
        "missing_teeth": encoder.missing_teeth,
        "ratio": encoder.ratio,
    }
    if encoder.tooth_angles_deg is not None:
        del table["missing_teeth"]
        table["tooth_angles_deg"] = list(encoder.tooth_angles_deg)
    if encoder.index:
        table["index"] = INDEX_TIME if counted else INDEX
    if encoder.index or encoder.missing_teeth or encoder.tooth_angles_deg or encoder.pulses_per_rev == 1:
        table["index_to_tdc_deg"] = encoder.index_to_tdc_deg
    return table if counted else table | {"edge": "rising"}


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
