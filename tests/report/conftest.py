"""Synthetic maps, tracks and findings to draw: what a report must show is put in here, so that the tests know it."""

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
        total = total + (0.25 + 0.05 * number) * ratio**2 * peak * np.exp(-np.abs(np.log(ratio + 1e-9)) * 4)
    return np.asarray(total)


def _line(order, speeds, gain):
    """Peak amplitude of one order over speed: a square law for all but 5.5, which keeps its size."""
    frequency = order * speeds / 60
    law = np.ones_like(speeds) if order == 5.5 else (speeds / 2000) ** 2
    late = np.where(speeds > 1500, 1.0, 0.02) if order in (3.0, 4.0, 8.0, 10.0) else 1.0
    return np.asarray(gain * STRENGTH.get(order, 0.02 / order) * law * late * _response(frequency))


def _campbell(speeds, coords, orders, gains):
    frequency = np.arange(0, 500.25, 0.5)
    rng = np.random.default_rng(2)
    shape = (len(gains), len(speeds), len(frequency))
    floor = 4e-4 * _response(frequency) * (0.4 + speeds[:, None] / 2000)
    power = gains[:, None, None] ** 2 * floor**2 * rng.gamma(8, 1 / 8, shape)
    for order in orders:
        line = _line(order, speeds, 1.0)
        lobe = np.sinc((frequency[None, :] - order * speeds[:, None] / 60) / 0.9) ** 4
        lobe[np.abs(frequency[None, :] - order * speeds[:, None] / 60) > 0.9] = 0
        power = power + gains[:, None, None] ** 2 * (line[:, None] * np.sqrt(lobe)) ** 2
    dims = ("channel", "speed", "frequency")
    return xr.Dataset(
        {
            "amplitude": (dims, np.sqrt(power), {"units": "see unit", "long_name": "peak amplitude of a tone"}),
            "psd": (dims, power / 1.5, {"units": "see unit, squared per Hz", "long_name": "power spectral density"}),
            "n_frames": ("speed", np.full(len(speeds), 14), {"units": "1"}),
        },
        coords
        | {"speed": ("speed", speeds, {"units": "min-1"}), "frequency": ("frequency", frequency, {"units": "Hz"})},
        {"window": "hann", "enbw_hz": 0.75, "resolution_hz": 0.5, "amplitude_scaling": "peak"},
    )


def _tracks(speeds, coords, orders, gains):
    rng = np.random.default_rng(3)
    amplitude = gains[:, None, None] * np.stack([_line(order, speeds, 1.0) for order in orders])
    error = gains[:, None, None] * (4e-4 + 0.01 * np.stack([_line(order, speeds, 1.0) for order in orders]))
    phase = np.degrees(np.cumsum(rng.normal(0, 0.25, amplitude.shape), axis=-1)) - 60 * np.array(orders)[:, None]
    phase = (phase + 180) % 360 - 180
    phase = np.where(amplitude > 3 * error, phase, np.nan)
    dims = ("channel", "order", "speed")
    return xr.Dataset(
        {
            "amplitude": (dims, np.abs(amplitude + error * rng.normal(0, 1, amplitude.shape)), {"units": "see unit"}),
            "phase": (dims, phase, {"units": "degree"}),
            "standard_error": (dims, error, {"units": "see unit"}),
            "band_rms": (dims, amplitude, {"units": "see unit"}),
            "degrees_of_freedom": (dims, np.full(amplitude.shape, 200.0), {"units": "1"}),
            "amplitude_low": (dims, np.maximum(amplitude - 1.96 * error, 0), {"units": "see unit"}),
            "amplitude_high": (dims, amplitude + 1.96 * error, {"units": "see unit"}),
            "phase_ci95": (dims, np.full(amplitude.shape, 5.0), {"units": "degree"}),
        },
        coords | {"order": ("order", list(orders), {"units": "1"}), "speed": ("speed", speeds, {"units": "min-1"})},
        {"band_width_orders": 0.5, "amplitude_scaling": "peak", "phase_reference": "tdc"},
    )


def _order_map(speeds, coords, gains):
    """Every variable and attribute that the schema asks for: the report stores an order map and draws none."""
    order = np.arange(0, 20.03, 1 / 16)
    axes = {"speed": ("speed", speeds, {"units": "min-1"}), "order": ("order", order, {"units": "1"})}
    size = {"channel": len(gains), "speed": len(speeds), "order": len(order)}
    rng, schema = np.random.default_rng(4), schema_of("order_map")["properties"]
    variables = {}
    for name, rule in schema["variables"]["properties"].items():
        dims = rule["properties"]["dims"]["enum"][0]
        if name not in {*coords, *axes}:
            values = rng.gamma(8, 1e-4, [size[dim] for dim in dims])
            variables[name] = (dims, values, {"units": rule["properties"]["units"].get("const", "1")})
    return xr.Dataset(variables, coords | axes, dict.fromkeys(schema["attrs"]["required"], "stated"))


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


def drawn_test(
    speeds, *, channels = ("X", "Y", "Z"), orders = ORDERS,
    unit = "m/s2", quantity = "acceleration", name = "second configuration, motoring",
    gains = (0.25, 0.5, 1.0)
):  # fmt: skip
    """A test with the given lines and the modes above; gains scale the channels (0 makes an all-zero one)."""
    speeds = np.asarray(speeds, dtype=float)
    gain = np.resize(np.array(gains), len(channels))
    coords = named(channels, unit, quantity)
    tracks = _tracks(speeds, coords, orders, gain)
    drawn = DrawnTest(
        _campbell(speeds, coords, orders, gain), _order_map(speeds, coords, gain), tracks,
        _findings(tracks, channels, unit, quantity, name),
    )  # fmt: skip
    for dataset, noun in ((drawn.campbell, "campbell_map"), (drawn.order_map, "order_map"), (tracks, "order_tracks")):
        check_dataset(dataset, noun)
    return drawn


HOSTILE = "Ba$$in <script>alert(1)</script>"


@pytest.fixture(scope="session")
def hard():
    """The awkward tests, by name."""
    rng = np.random.default_rng(7)
    run_up = np.sort(np.concatenate([rng.uniform(900, 2600, 110), rng.uniform(4000, 4900, 40)]))
    steps = np.arange(300.0, 2001.0, 50.0)
    thirty, sixty = (tuple(float(k) for k in np.arange(0.5, last, 0.5)) for last in (15.1, 30.1))
    return {
        "one speed": drawn_test(np.array([1800.0]), orders=(1.0, 2.0, 5.5)),
        "two speeds": drawn_test(np.array([600.0, 1800.0]), orders=(1.0, 2.0, 4.0)),
        "run-up": drawn_test(
            run_up, orders=(2.0, 4.0, 10.0, 15.0), unit="Pa", quantity="sound_pressure", channels=("mic",)
        ),
        "hostile": drawn_test(steps, channels=(HOSTILE,), name="$\\frac{ </title><script>" + "x" * 10_000),
        "all zero": drawn_test(steps[:5], gains=(0.0,)),
        "sixty orders": drawn_test(steps, orders=sixty),
        "thirty orders": drawn_test(steps, orders=thirty),
        "eight channels": drawn_test(steps, channels=tuple(f"acc_{k}" for k in range(1, 9)), gains=(1.0, 0.3, 3.0)),
        "counts": drawn_test(steps, channels=("raw",), unit="counts", quantity="other", orders=(1.0,)),
    }


@pytest.fixture(scope="session")
def campaign():
    """The reference campaign: 35 steps, three accelerometers."""
    return drawn_test(np.arange(300.0, 2001.0, 50.0))


@pytest.fixture(scope="session")
def settings():
    """The shipped settings of the report."""
    return load_settings().report


@pytest.fixture(scope="session")
def make_test():
    """Maker of a drawn test from speeds, channels, orders, unit and gains."""
    return drawn_test


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
    told = ("rank", "rpm", "rpm_range", "orders", "modes_hz", "order", "mode_hz", "amplitude")
    worst = (
        (1, 1800.0, [1755.0, 1850.0], [2.0], [60.0], 2.0, 60.0, 3.7),
        (2, 1725.0, [1690.0, 1760.0], [4.0, 8.0], [115.0, 230.0], 4.0, 115.0, 3.4),
    )
    findings["speeds_to_avoid"] = [{**avoid, "by_fit": True, **dict(zip(told, one, strict=True))} for one in worst]
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


@pytest.fixture(scope="session")
def make_envelope():
    """Maker of an envelope map from channels, speeds and the order of a fault."""
    return envelope_map


def overlaps(drawing):
    """Pairs of texts whose boxes overlap by more than a hair, and texts that leave the sheet."""
    boxes = []
    for words in drawing.words:
        x, y, width, height = words.box
        if x < 0 or y < 0 or x + width > drawing.width_in or y + height > drawing.height_in:
            return [(words.text, "edge of the sheet")]
        boxes.append((words.text, x + 0.03 * width, y + 0.03 * height, x + 0.97 * width, y + 0.97 * height))
    return [
        (one[0], two[0])
        for number, one in enumerate(boxes)
        for two in boxes[number + 1 :]
        if one[1] < two[3] and two[1] < one[3] and one[2] < two[4] and two[2] < one[4]
    ]


def texts(drawing):
    """All texts."""
    return [part.text for part in drawing.words]
