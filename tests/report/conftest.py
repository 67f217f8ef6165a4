"""Synthetic maps, tracks and findings to draw: what a report must show is put in here, so that the tests know it."""

import functools
import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import xarray as xr

from crankorder.quantities import check_dataset, schema_of
from crankorder.settings import load_settings
from made.recordings import named


def envelope_map(channels, *, speeds=3, fault=3.556):
    """An envelope map whose last channel shows a fault's line and its multiples over a sloping floor."""
    order = np.arange(0, 20.01, 1 / 32)
    rng = np.random.default_rng(9)
    floor = np.tile(0.02 / np.sqrt(1 + order), (len(channels), speeds, 1))
    amplitude = floor * rng.gamma(12, 1 / 12, floor.shape)
    for multiple in range(1, 5):
        amplitude[-1, :, np.argmin(np.abs(order - multiple * fault))] += 0.3 / multiple
    dims, unit = ("channel", "speed", "order"), {"units": "see unit"}
    band = {"units": "Hz"}
    variables = {"amplitude": (dims, amplitude, unit), "floor": (dims, floor, unit)}
    for name, value in (("band_low", 2000.0), ("band_high", 4000.0)):
        variables[name] = (dims[:2], np.full((len(channels), speeds), value), band)
    axes = {"order": ("order", order, {"units": "1"}), "speed": ("speed", 600.0 * np.arange(1, speeds + 1))}
    return xr.Dataset(variables, named(channels) | axes)


ORDERS = (1.0, 2.0, 3.0, 4.0, 5.5, 8.0, 10.0)
MODES_HZ = (60.0, 115.0, 172.0, 187.0, 230.0, 350.0, 457.0, 470.0)
STRENGTH = {1.0: 0.10, 2.0: 0.22, 3.0: 0.05, 4.0: 0.06, 5.5: 0.08, 8.0: 0.03, 10.0: 0.02}
DAMPING = 0.012


@dataclass(frozen=True)
class DrawnTest:
    """One test as the report gets it."""

    campbell: xr.Dataset
    order_map: xr.Dataset
    tracks: xr.Dataset
    findings: dict[str, Any]


def _response(frequency_hz):
    """Magnitude of a sum of lightly damped modes, about 1 between them."""
    total = np.full(frequency_hz.shape, 0.3)
    for number, mode_hz in enumerate(MODES_HZ):
        ratio = frequency_hz / mode_hz
        peak = 1 / np.sqrt((1 - ratio**2) ** 2 + (2 * DAMPING * ratio) ** 2)
        total += (0.25 + 0.05 * number) * ratio**2 * peak * np.exp(-np.abs(np.log(ratio + 1e-9)) * 4)
    return total


def _line(order, speeds):
    """Peak amplitude of one order over speed: a square law for all but 5.5, which keeps its size."""
    frequency = order * speeds / 60
    law = np.ones_like(speeds) if order == 5.5 else (speeds / 2000) ** 2
    late = np.where(speeds > 1500, 1.0, 0.02) if order in (3.0, 4.0, 8.0, 10.0) else 1.0
    return STRENGTH.get(order, 0.02 / order) * law * late * _response(frequency)


def _dataset(noun, coords, axes, values, attrs):
    """A dataset with the dims and units that its schema states, of ``values`` by variable and its two ``axes``."""
    rules = schema_of(noun)["properties"]["variables"]["properties"]
    stated = {
        name: (rule["properties"]["dims"]["enum"][0], rule["properties"]["units"]) for name, rule in rules.items()
    }
    made = {name: (dims, values[name], units) for name, (dims, units) in stated.items() if name in values}
    made = {name: (dims, data, {"units": units.get("const", "1")}) for name, (dims, data, units) in made.items()}
    units = {name: {"units": stated[name][1]["const"]} for name in axes}
    dataset = xr.Dataset(made, coords | {name: (name, data, units[name]) for name, data in axes.items()}, attrs)
    check_dataset(dataset, noun)
    return dataset


def _campbell(speeds, coords, orders, gains):
    frequency = np.arange(0, 500.25, 0.5)
    shape = (len(gains), len(speeds), len(frequency))
    floor = 4e-4 * _response(frequency) * (0.4 + speeds[:, None] / 2000)
    power = floor**2 * np.random.default_rng(2).gamma(8, 1 / 8, shape)
    for order in orders:
        apart_hz = frequency - order * speeds[:, None] / 60
        lobe = np.where(np.abs(apart_hz) > 0.9, 0.0, np.sinc(apart_hz / 0.9) ** 4)
        power = power + lobe * _line(order, speeds)[:, None] ** 2
    power = gains[:, None, None] ** 2 * power
    values = {"amplitude": np.sqrt(power), "psd": power / 1.5, "n_frames": np.full(len(speeds), 14)}
    attrs = {"window": "hann", "enbw_hz": 0.75, "resolution_hz": 0.5, "amplitude_scaling": "peak"}
    return _dataset("campbell_map", coords, {"speed": speeds, "frequency": frequency}, values, attrs)


def _tracks(speeds, coords, orders, gains):
    rng = np.random.default_rng(3)
    lines = np.stack([_line(order, speeds) for order in orders])
    amplitude, error = gains[:, None, None] * lines, gains[:, None, None] * (4e-4 + 0.01 * lines)
    phase = np.degrees(np.cumsum(rng.normal(0, 0.25, amplitude.shape), axis=-1)) - 60 * np.array(orders)[:, None]
    values = {
        "amplitude": np.abs(amplitude + error * rng.normal(0, 1, amplitude.shape)),
        "phase": np.where(amplitude > 3 * error, (phase + 180) % 360 - 180, np.nan),
        "standard_error": error, "band_rms": amplitude,
        "degrees_of_freedom": np.full(amplitude.shape, 200.0), "phase_ci95": np.full(amplitude.shape, 5.0),
        "amplitude_low": np.maximum(amplitude - 1.96 * error, 0), "amplitude_high": amplitude + 1.96 * error,
    }  # fmt: skip
    attrs = {"band_width_orders": 0.5, "amplitude_scaling": "peak", "phase_reference": "tdc"}
    return _dataset("order_tracks", coords, {"order": list(orders), "speed": speeds}, values, attrs)


def _order_map(speeds, coords, gains):
    """Every variable and attribute that the schema asks for: the report stores an order map and draws none."""
    axes = {"speed": speeds, "order": np.arange(0, 20.03, 1 / 16)}
    size = {"channel": len(gains)} | {name: len(axis) for name, axis in axes.items()}
    rng, schema = np.random.default_rng(4), schema_of("order_map")["properties"]
    dims = {name: rule["properties"]["dims"]["enum"][0] for name, rule in schema["variables"]["properties"].items()}
    values = {
        name: rng.gamma(8, 1e-4, [size[dim] for dim in own])
        for name, own in dims.items()
        if name not in {*coords, *axes}
    }
    return _dataset("order_map", coords, axes, values, dict.fromkeys(schema["attrs"]["required"], "stated"))


def _met_hz(order, rpm):
    """Natural frequency within 3 % of the order's line at that speed."""
    line_hz = order * rpm / 60
    near = [mode_hz for mode_hz in MODES_HZ if abs(mode_hz - line_hz) <= 0.03 * mode_hz]
    return min(near, key=lambda mode_hz: abs(mode_hz - line_hz), default=None)


def _within(key, value, half):
    """An estimate with an interval of so much on either side."""
    return {key: value, f"{key}_ci95": [value - half, value + half]}


def _order_records(tracks, unit):
    records = []
    for channel in tracks.channel.values.tolist():
        for order in tracks.order.values.tolist():
            track = tracks.sel(channel=channel, order=order)
            peak = int(np.argmax(track.amplitude.values))
            value, error = float(track.amplitude[peak]), float(track.standard_error[peak])
            exponent = 0.0 if order == 5.5 else 2.0
            records.append(
                {
                    "channel": channel, **_within("order", order, 0.003), **_within("amplitude", value, 1.96 * error),
                    **_within("phase_deg", -42.0, 2.0), "unit": unit, "speed_rpm_at_max": float(track.speed[peak]),
                    **_within("speed_exponent", exponent, 0.2), "meets_hz": _met_hz(order, float(track.speed[peak])),
                    "speed_range_rpm": [float(track.speed[0]), float(track.speed[-1])],
                    "explained_by": "bearing jack shaft N*fs" if order == 5.5 else "engine order",
                    "causes": ["bearing"] if order == 5.5 else [],
                }
            )  # fmt: skip
    return records


def _mode_records(channels):
    modes = [
        {
            **_within("frequency_hz", mode_hz, 0.3), **_within("damping_ratio", DAMPING, 0.003),
            "channels": list(channels), "evidence": "stands 9.1 dB above the broadband floor at every speed",
            "explained_by": "mode",
        }
        for mode_hz in MODES_HZ
    ]  # fmt: skip
    mains = {**modes[0], "frequency_hz": 300.0, "frequency_hz_ci95": [299.9, 300.1], "damping_ratio": None}
    mains |= {"damping_ratio_ci95": None, "explained_by": "mains", "evidence": "5 x 60 Hz, a pure tone"}
    return [*modes, mains]


def _findings(tracks, channels, unit, quantity, name):
    speeds = tracks.speed.values
    crossings = [
        {
            "order": order, "mode_hz": mode_hz, "rpm": 60 * mode_hz / order,
            "in_range": bool(speeds[0] - 25 <= 60 * mode_hz / order <= speeds[-1] + 25),
            "excited": (order, mode_hz) in {(4.0, 115.0), (8.0, 230.0), (2.0, 60.0), (5.5, 172.0), (10.0, 187.0)},
        }
        for order in tracks.order.values.tolist()
        for mode_hz in MODES_HZ
    ]  # fmt: skip
    bearing = {
        "name": "jack shaft", "line": "N*fs", **_within("order", 5.5, 0.002), "order_expected": 5.5,
        **_within("amplitude", 0.12, 0.01), "channel": channels[-1], "unit": unit,
        "verdict": "present, the same at all speeds",
    }  # fmt: skip
    return {
        "schema_version": 1, "test": name,
        "channels": [{"name": channel, "unit": unit, "quantity": quantity} for channel in channels],
        "orders": _order_records(tracks, unit), "modes": _mode_records(channels), "crossings": crossings,
        "bearings": [bearing] if 5.5 in tracks.order.values else [],
        "lines": [
            {"channel": channels[0], "frequency_hz": 300.0, "explained_by": "mains", "amplitude": 0.01, "unit": unit},
            {"channel": channels[0], "order": 2.0, "explained_by": "engine order", "amplitude": 0.8, "unit": unit},
        ],
        "unexplained_energy_fraction": 0.031,
        "balance": {
            **_within("residual_reciprocating_g", 116.0, 6.0),
            **_within("residual_rotating_gmm", 420.0, 210.0),
            **_within("angle_deg", 12.0, 32.0),
        },
        "quality": [
            {"recording": "rpm_0450.h5", "flag": "clipped", "severity": "suspect", "detail": "0.4 % of channel X"},
            {"recording": "rpm_0900.h5", "flag": "encoder_missing_pulse", "severity": "info", "detail": "1 repaired"},
        ],
    }  # fmt: skip


STEPS = np.arange(300.0, 2001.0, 50.0)


def drawn_test(
    speeds=STEPS, *, channels=("X", "Y", "Z"), orders=ORDERS, unit="m/s2", quantity="acceleration",
    name="second configuration, motoring", gains=(0.25, 0.5, 1.0),
):  # fmt: skip
    """A test with the given lines and the modes above; gains scale the channels (0 makes an all-zero one)."""
    gain = np.resize(np.array(gains), len(channels))
    coords = named(channels, unit, quantity)
    tracks = _tracks(speeds, coords, orders, gain)
    return DrawnTest(
        _campbell(speeds, coords, orders, gain), _order_map(speeds, coords, gain), tracks,
        _findings(tracks, channels, unit, quantity, name),
    )  # fmt: skip


HOSTILE = "Ba$$in <script>alert(1)</script>"
RUN_UP = np.sort(np.random.default_rng(7).uniform([900.0] * 110 + [4000.0] * 40, [2600.0] * 110 + [4900.0] * 40))
DRAWN: dict[str, dict[str, Any]] = {
    "campaign": {},
    "one speed": {"speeds": np.array([1800.0]), "orders": (1.0, 2.0, 5.5)},
    "run-up": {
        "speeds": RUN_UP, "orders": (2.0, 4.0, 10.0, 15.0), "unit": "Pa", "quantity": "sound_pressure",
        "channels": ("mic",),
    },
    "hostile": {"channels": (HOSTILE,), "name": "$\\frac{ </title><script>" + "x" * 10_000},
    "all zero": {"speeds": STEPS[:5], "gains": (0.0,)},
    "sixty orders": {"orders": tuple(np.arange(1, 61) / 2.0)},
    "eight channels": {"channels": tuple(f"acc_{k}" for k in range(1, 9)), "gains": (1.0, 0.3, 3.0)},
    "counts": {"channels": ("raw",), "unit": "counts", "quantity": "other", "orders": (1.0,)},
}  # fmt: skip
"""The reference campaign, 35 steps of three accelerometers, and awkward tests: what is drawn of each."""


@pytest.fixture(scope="session")
def drawn_of():
    """Maker of the test of a name in ``DRAWN``, each made once."""
    return functools.cache(lambda name: drawn_test(**DRAWN[name]))


@pytest.fixture(scope="session")
def campaign(drawn_of):
    """The reference campaign."""
    return drawn_of("campaign")


@pytest.fixture(scope="session")
def settings():
    """The shipped settings of the report."""
    return load_settings().report


@pytest.fixture
def full(campaign):
    """Findings of the campaign with every key that identification may give; a copy of its own."""
    findings: dict[str, Any] = json.loads(json.dumps(campaign.findings))
    channels = [str(one["name"]) for one in findings["channels"]]
    met = {2.0: 60.0, 4.0: 115.0, 8.0: 230.0}
    for record in findings["orders"]:
        order = record["order"]
        steady = order == 5.5
        record |= {"lock": "undecided" if steady else "locked", "revs_to_decide": 420.0 if steady else None}
        record |= {"half_order": order % 1 == 0.5, "meets_hz": met.get(order), "n_speeds": 35, "evidence": "20 dB"}
        record["speed_law"] = "keeps its size" if steady else "meets a mode" if order in met else "grows with speed^2.0"
    for mode in findings["modes"]:
        own = [order for order in (1.0, 2.0, 4.0, 8.0) if met.get(order) == mode["frequency_hz"]]
        mode |= {"reached_by_orders": own, "undecided": ""}
    doubt = {"explained_by": "undecided", "undecided": "order 10 lies on it at every speed"}
    findings["modes"].insert(5, {**findings["modes"][0], "frequency_hz": 265.0, "frequency_hz_ci95": None, **doubt})
    mains = {"frequency_hz": 300.0, "frequency_hz_ci95": [299.9, 300.1], "explained_by": "mains"}
    pump = {"frequency_hz": 58.3, "frequency_hz_ci95": [58.29, 58.31], "explained_by": "tone"}
    loud = {"channel": channels[-1], "amplitude": 5.0, "amplitude_ci95": [4.9, 5.1], "unit": "m/s2"}
    findings["lines"] = [{**loud, **pump}, {**loud, **mains, "amplitude": 0.02, "amplitude_ci95": [0.018, 0.022]}]
    for record in findings["crossings"]:
        excited = record["excited"] = (record["order"], record["mode_hz"]) in {(4.0, 115.0), (8.0, 230.0), (2.0, 60.0)}
        record |= {"rpm_ci95": [record["rpm"] - 5, record["rpm"] + 5], "amplification_predicted": 41.7}
        record |= {"amplification": 12.0, "amplification_ci95": [10.0, 14.0]} if excited else {"amplification": None}
        record |= {"channels": channels[-1:], "evidence": "rises 12 times over its trend" if excited else "no rise"}
    avoid = {"channel": channels[-1], "unit": "m/s2", "amplification": 12.0, "reason": "the order rises there"}
    avoid |= {"by_fit": True, "rank": 1, "rpm": 1800.0, "rpm_range": [1755.0, 1850.0], "amplitude": 3.7}
    avoid |= {"orders": [2.0], "order": 2.0, "modes_hz": [60.0], "mode_hz": 60.0}
    second = {"rank": 2, "rpm": 1725.0, "rpm_range": [1690.0, 1760.0], "amplitude": 3.4}
    second |= {"orders": [4.0, 8.0], "order": 4.0, "modes_hz": [115.0, 230.0], "mode_hz": 115.0}
    findings["speeds_to_avoid"] = [avoid, avoid | second]
    excluded = "the data exclude that an order is amplified more than 3 times (99 %)"
    free = {"low_rpm": 300.0, "high_rpm": 1690.0, "remark": excluded}
    findings["free_bands"] = [free, {**free, "low_rpm": 1850.0, "high_rpm": 2000.0}]
    why = {"remark": "order 2 with 60 Hz: is amplified more than 3 times"}
    findings["open_bands"] = [{"low_rpm": 1690.0, "high_rpm": 1850.0, **why}]
    race = {"seen_in": "envelope", "is_mean": False, "band_hz": [2000.0, 4000.0], "slip_percent": -0.8}
    race |= {"slip_percent_ci95": [-0.9, -0.7], "line": "BPFO", "order": 3.556, "order_ci95": [3.553, 3.559]}
    race |= {"order_expected": 3.585, "harmonics": 4, "sidebands": 1.0, "lock": "slips"}
    verdict = "Damage of the outer race: strikes at its own rate. Re-run the same test: it grows"
    race |= {"verdict": verdict, "damage": True, "re_run": True}
    for record in findings["bearings"]:
        record |= {"seen_in": "vibration", "is_mean": True, "lock": "undecided", "slip_percent": 0.0, "harmonics": 1}
    findings["bearings"] += [{**one, **race} for one in findings["bearings"]]
    share = {"orders": 0.22, "tones": 0.05, "modes_and_floor": 0.7, "unexplained": 0.03, "total": 1.4}
    findings["energy"] = {"channels": [{"channel": channel, **share, "unit": "(m/s2)2"} for channel in channels]}
    balance = {"source": "engine orders", "orders_used": [1.0, 2.0], "along_g": 9.3, "along_g_ci95": [8.0, 10.6]}
    findings["balance"] |= {**balance, "not_decided": {"across_g": "the horizontal path is not stated"}}
    findings["looked_for"] = ["orders", "modes", "bearings", "envelope"]
    return findings


def overlaps(drawing):
    """Pairs of texts whose boxes overlap by more than a hair, and texts that leave the sheet."""
    shown, boxes = drawing.words, np.array([words.box for words in drawing.words])
    low, high = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
    beyond = np.any((low < 0) | (high > [drawing.width_in, drawing.height_in]), axis=1)
    low, high = low + 0.03 * boxes[:, 2:], high - 0.03 * boxes[:, 2:]
    meet = np.argwhere(np.all((low[:, None] < high) & (low < high[:, None]), axis=2))
    pairs = [(shown[one].text, shown[other].text) for one, other in meet if one < other]
    return [(shown[number].text, "edge of the sheet") for number in np.flatnonzero(beyond)] + pairs


def texts(drawing):
    """All texts."""
    return [part.text for part in drawing.words]
