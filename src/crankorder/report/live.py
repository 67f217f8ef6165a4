"""What the script of a report page draws: maps and tracks of a test with what is said of their cells."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.channel_units import unit_text
from crankorder.findings import CrossingFinding, Findings, ModeFinding
from crankorder.plot.cells import level_limits, speed_cells
from crankorder.plot.fixed_lines import fixed_frequencies
from crankorder.plot.orders_figure import shown_tracks
from crankorder.plot.palette import level_colours
from crankorder.quantities import Floats
from crankorder.records import known
from crankorder.report.notation import (
    estimate_text,
    frequency_text,
    interval_of,
    is_number,
    is_tone,
    is_undecided,
    is_whirl,
    level_reference,
    named,
    nominal_order,
    number_text,
    order_name,
    order_text,
    scaling_text,
    speeds_text,
)
from crankorder.settings import ReportSettings

_STEP_DB = 0.005
_TOP = 60_000  # code of the largest cell of a channel; 300 dB below it nothing is left
_MAP_CELLS = {"campbell_map": 525_000, "order_map": 75_000}  # 2.7 bytes each: 1.6 MB of a page of 5 MB
_TRACK_VALUES = 60_000  # 5.4 bytes each
_FEWEST_COLUMNS = 400  # of a map that is pooled to fit; less shows no lines
_MOST_CHANNELS = 64
_MOST_LINES = 400
_GUIDES = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0)

_TITLES = {"campbell_map": ("campbell", "Campbell diagram", "Frequency, Hz", "frequency"),
           "order_map": ("order", "Order map", "Order (cycles per crank revolution)", "order")}  # fmt: skip
HINT = "Point at a cell, or use the arrow keys: what is there, and what the findings say of it."


@dataclass(frozen=True)
class LiveChannel:
    """A channel: its name, unit, the reference of its level in that unit, and what the level is called."""

    name: str
    unit: str
    reference: float
    level: str


Record = dict[str, object]
"""A map, the tracks, or a thing that the findings name, as the script of the page reads it."""


def live_data(groups: Mapping[str, xr.Dataset], findings: Findings, *, settings: ReportSettings) -> str:
    """JSON for the script of the page, safe inside a script element; empty where there is neither map nor track.

    ``groups`` datasets of the results by name; ``findings`` of the test; ``settings`` of the report. Of maps with many
    cells neighbouring columns are pooled by their maximum, and the last channels left out, so that a page stays below
    5 MB whatever its test holds.
    """
    first = next((groups[name] for name in (*_TITLES, "order_tracks") if name in groups), None)
    if first is None:
        return ""
    channels = _channels(first, settings)
    maps = [made for name in _TITLES if name in groups and (made := _map(name, groups[name], channels, settings))]
    tracks = _tracks(groups.get("order_tracks"), len(channels), limit=settings.max_labelled_orders)
    if not maps and tracks is None:
        return ""
    document = {
        "hint": HINT, "freeText": "Free of resonances at this speed.", "unasked": bool(findings.not_asked_for),
        "colours": base64.b64encode(level_colours().tobytes()).decode("ascii"),
        "channels": [asdict(one) for one in channels],
        "maps": maps,
        "tracks": tracks,
        "guides": [{"order": order, "text": order_text(order)} for order in _GUIDES],
        **_said(findings, [str(name) for name in first["channel"].values[: len(channels)]], settings),
    }  # fmt: skip
    text = json.dumps(document, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _channels(dataset: xr.Dataset, settings: ReportSettings) -> list[LiveChannel]:
    made = []
    for name, unit, quantity in zip(
        dataset["channel"].values, dataset["unit"].values, dataset["quantity"].values, strict=True
    ):
        reference, level = level_reference(str(quantity), str(unit), settings=settings)
        text = named(str(name), limit=settings.max_name_characters)
        made.append(LiveChannel(text, unit_text(str(unit)), reference, level.replace("(peak)", scaling_text(dataset))))
    return made[:_MOST_CHANNELS]


def _map(name: str, dataset: xr.Dataset, channels: list[LiveChannel], settings: ReportSettings) -> Record | None:
    """A map: ``rows`` of speed [rpm], slowest first, with the ends of their cells; ``nx`` columns.

    The columns begin at ``x0`` and are ``dx`` apart; each is the largest of ``pooled``. ``cells`` per channel: base64
    of codes (rows, columns), 16 bits each; ``largest`` its largest amplitude, which has the code 60000, each 0.005 dB
    below one less; ``limits`` of the colours [dB].
    """
    kind, title, label, axis = _TITLES[name]
    x = np.asarray(dataset[axis].values, dtype=float)
    speed = np.asarray(dataset["speed"].values, dtype=float)
    amplitude = dataset["amplitude"].transpose("channel", "speed", axis).values[: len(channels)]
    kept = np.flatnonzero(np.isfinite(speed) & np.isfinite(amplitude).any(axis=(0, 2)))
    kept = kept[np.argsort(speed[kept], kind="stable")]
    even = len(x) > 1 and np.allclose(np.diff(x), x[1] - x[0], rtol=1e-6)
    if len(kept) < 2 or not even:
        return None
    pool, shown = _share_of_page(len(channels) * len(kept) * len(x), len(x), len(channels), _MAP_CELLS[name])
    if not shown:
        return None
    columns = -(-len(x) // pool)
    largest, limits, cells = [], [], []
    for values, channel in zip(amplitude[:shown, kept], channels, strict=False):
        values = np.nan_to_num(values.astype(np.float64), posinf=0.0)
        if pool > 1:
            padded = np.pad(values, ((0, 0), (0, columns * pool - len(x))))
            values = padded.reshape(len(kept), columns, pool).max(axis=2)
        top = float(values.max())
        largest.append(top)
        limits.append(level_limits(values, channel.reference, range_db=settings.dynamic_range_db))
        cells.append(base64.b64encode(_codes(values, top).tobytes()).decode("ascii"))
    step = float(x[-1] - x[0]) / (len(x) - 1)
    ends = speed_cells(speed[kept])
    rows = [(_short(one), _short(low), _short(high)) for one, (low, high) in zip(speed[kept], ends, strict=True)]
    return {
        "kind": kind, "title": title, "label": label, "x0": float(x[0]) + (pool - 1) / 2 * step, "dx": pool * step,
        "nx": columns, "pooled": pool, "rows": rows, "largest": largest, "limits": limits, "cells": cells,
    }  # fmt: skip


def _short(value: float) -> float:
    return float(f"{value:.8g}")


def _shortened(value: object) -> object:
    """``value`` with every number to eight digits: findings read back from their file have no more than ten."""
    if isinstance(value, float):
        return _short(value)
    if isinstance(value, dict):
        return {key: _shortened(item) for key, item in value.items()}
    return [_shortened(item) for item in value] if isinstance(value, list | tuple) else value


def _share_of_page(cells: int, columns: int, channels: int, most: int) -> tuple[int, int]:
    """Columns pooled into one, and channels shown, so that ``cells`` in all become ``most`` at the most."""
    pool = min(max(1, math.ceil(cells / most)), max(1, columns // _FEWEST_COLUMNS))
    each = cells / channels / pool
    return pool, min(channels, int(most / each)) if each else 0


def _codes(values: Floats, top: float) -> NDArray[np.uint16]:
    """Codes of the script: 0 for nothing, 60000 for ``top``, one less for every 0.005 dB below."""
    if top <= 0:
        return np.zeros(values.shape, dtype="<u2")
    share = np.divide(values, top)
    with np.errstate(divide="ignore"):
        code = np.rint(_TOP + 20 / _STEP_DB * np.log10(share))
    return np.asarray(np.where(share > 0, np.clip(code, 1, _TOP), 0).astype("<u2"))


def _tracks(tracks: xr.Dataset | None, channels: int, *, limit: int) -> Record | None:
    """Values (channel, order, speed) as base64 of 32-bit floats; an amplitude of -inf is not read."""
    if tracks is None or not tracks.sizes["order"]:
        return None
    if tracks.sizes["speed"] < 2 or not np.isfinite(tracks["speed"].values).all():
        return None
    shown = shown_tracks(tracks, limit=limit)
    kept = min(channels, int(_TRACK_VALUES / max(4 * shown.amplitude[0].size, 1)))
    if not kept:
        return None
    amplitude = np.where(shown.read, shown.amplitude, -np.inf)[:kept]
    largest = np.nan_to_num(np.where(np.isfinite(amplitude), amplitude, 0.0)).max(axis=(1, 2))

    def packed(values: Floats) -> str:
        with np.errstate(over="ignore"):
            return base64.b64encode(values[:kept].astype("<f4").tobytes()).decode("ascii")

    orders = [{"order": float(order), "text": text} for order, text in zip(shown.orders, shown.texts, strict=True)]
    return {
        "kind": "tracks", "title": "Orders against speed", "speed": [_short(one) for one in shown.speed],
        "orders": orders, "largest": largest.tolist(), "amplitude": packed(amplitude),
        "low": packed(shown.low), "high": packed(shown.high), "phase": packed(shown.phase),
    }  # fmt: skip


def _said(findings: Findings, names: list[str], settings: ReportSettings) -> dict[str, object]:
    """What the findings say, in the keys of the script; channels by their number among ``names``."""
    limit = settings.max_name_characters
    number = {name: place for place, name in enumerate(names)}
    modes = fixed_frequencies(findings)
    ranges = [ends for band in findings.speeds_to_avoid or [] if (ends := known(band.rpm_range)) is not None]
    bands = [(band.low_rpm, band.high_rpm) for band in findings.free_bands]
    said = {
        "orders": _orders(findings, number, limit),
        "fixed": [_fixed(mode, number, limit) for mode in modes],
        "crossings": [_crossing(one, findings, modes, number) for one in findings.crossings if one.in_range],
        "lines": _lines(findings, number, limit),
        "avoid": [{"low": low, "high": high, "text": f"Avoid {speeds_text((low, high))} rpm."} for low, high in ranges],
        "free": [ends for ends in bands if known(ends) is not None],
    }
    return {key: _shortened(one) for key, one in said.items()}


def _orders(findings: Findings, number: dict[str, int], limit: int) -> list[Record]:
    """Orders found in a channel (by number): what each is called, what makes it, where it is largest and was seen."""
    return [
        {
            "channel": number[one.channel], "order": one.order, "text": order_name(one, findings),
            "why": named(one.explained_by or "unexplained", limit=2 * limit), "size": float(one.amplitude),
            "at": one.speed_rpm_at_max if is_number(one.speed_rpm_at_max) else None,
            "seen": known(one.speed_range_rpm),
        }
        for one in findings.orders
        if one.channel in number
    ]  # fmt: skip


def _half_width(mode: ModeFinding) -> float:
    """Half the width [Hz] over which a mode is itself: its half-power band, at least its interval."""
    ends = interval_of(mode, "frequency_hz")
    damped = mode.frequency_hz * mode.damping_ratio if is_number(mode.damping_ratio) else 0.0
    return max(damped, 0.0 if ends is None else (ends[1] - ends[0]) / 2)


def _fixed(mode: ModeFinding, number: dict[str, int], limit: int) -> Record:
    """A frequency that stays, or a whirl's with its ``slope``; ``half`` its half width in Hz."""
    name = f"{frequency_text(mode.frequency_hz)}{'?' if is_undecided(mode) else ''} Hz"
    estimate = f"{estimate_text(mode, 'frequency_hz')} Hz"
    damping = f", damping {number_text(100 * mode.damping_ratio, digits=2)} %" if is_number(mode.damping_ratio) else ""
    if is_tone(mode):
        kind, text = "tone", f"{named(mode.explained_by, limit=limit).capitalize()} {estimate}"
    elif is_undecided(mode):
        kind, text = "doubt", f"Perhaps a natural frequency, not decided: {estimate}"
    else:
        kind = "whirl" if is_whirl(mode) else "mode"
        text = f"Natural frequency {estimate}{damping}"
    slope, rpm = (mode.speed_slope or 0.0, mode.reference_rpm or 0.0) if is_whirl(mode) else (0.0, 0.0)
    channels = [number[one] for one in mode.channels or () if one in number]
    return {
        "hz": mode.frequency_hz, "half": _half_width(mode), "slope": slope, "from_rpm": rpm, "kind": kind, "name": name,
        "text": text, "channels": channels,
    }  # fmt: skip


def _crossing(
    crossing: CrossingFinding, findings: Findings, modes: list[ModeFinding], number: dict[str, int]
) -> Record:
    """Meeting of an order with a natural frequency of half width ``half`` Hz, with what is said of it."""
    nearest = min(modes, key=lambda mode: abs(mode.frequency_hz - crossing.mode_hz), default=None)
    channels = crossing.channels or ((crossing.channel,) if crossing.channel else ())
    factor = crossing.amplification
    times = f", × {number_text(factor, digits=2)}" if crossing.excited and is_number(factor) and factor > 0 else ""
    verdict = crossing.verdict or ("excited" if crossing.excited else "not excited")
    where = f"order {order_name(crossing, findings)} meets {frequency_text(crossing.mode_hz)} Hz"
    return {
        "order": crossing.order, "hz": crossing.mode_hz, "half": 0.0 if nearest is None else _half_width(nearest),
        "rpm": crossing.rpm, "excited": crossing.excited,
        "text": f"Crossing: {where} near {crossing.rpm:.0f} rpm, {verdict}{times}.",
        "channels": [number[one] for one in channels if one in number],
    }  # fmt: skip


def _lines(findings: Findings, number: dict[str, int], limit: int) -> list[Record]:
    """The list of all lines, by ``order`` or by ``hz``, with what is said of each."""
    records = sorted((one for one in findings.lines if one.channel in number), key=lambda one: -one.size)[:_MOST_LINES]
    shown: list[Record] = []
    for one in records:
        place = f"{one.frequency_hz:.4g} Hz" if one.order is None else f"order {order_text(nominal_order(one))}"
        text = f"Line at {place}: {named(one.explained_by or 'unexplained', limit=2 * limit)}."
        shown.append({"channel": number[one.channel], "order": one.order, "hz": one.frequency_hz, "text": text})
    return shown
