"""Findings with every key that identification may give, and an envelope map to go with them."""

import json
from typing import Any

import numpy as np
import xarray as xr

from made.recordings import named


def full_findings(plain: dict[str, Any]) -> dict[str, Any]:
    """``plain`` findings of a drawn test with every key that identification may give."""
    findings: dict[str, Any] = json.loads(json.dumps(plain))
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


def envelope_map(channels: tuple[str, ...], *, speeds: int = 3, fault: float = 3.556) -> xr.Dataset:
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
