"""Reference scene with other seeds: what is found lies in its stated interval as often as stated, within the marks."""

import numpy as np
import pytest

from crankorder.campbell.map import campbell_map
from crankorder.engine.definition import load_engine
from crankorder.identify.findings import Measured, find
from crankorder.identify.machine_model import MachineModel
from crankorder.orders.map import order_map
from crankorder.settings import load_settings
from made.scenes import made_scene, scene_named, without_orders

pytestmark = pytest.mark.accuracy

SEEDS = range(9001, 9013)


def found(seed, orders=True):
    settings, engine = load_settings(), load_engine("msu-optical-second")
    speeds = [300.0 + 50.0 * k for k in range(35)]
    scene = scene_named("thesis-second-motoring", seed=seed, speeds_rpm=speeds, duration_s=15.0, rate_hz=1600.0)
    made = made_scene(scene if orders else without_orders(scene), settings)
    maps = (
        order_map(made.by_order, settings=settings.orders),
        campbell_map(made.by_frequency, speed_bin_rpm=settings.orders.speed_bin_rpm),
    )
    sources = MachineModel(revs_per_cycle=2, engine=engine, bearings=engine.bearings)
    findings = find(Measured(*maps, made.by_order), test="made", sources=sources, settings=settings)
    return findings.as_dict(), made.truth


def test_intervals_of_largest_amplitudes_hold_them():
    pairs = []
    for seed in SEEDS:
        record, truth = found(seed)
        lines = {(line["channel"], line["order"]): line for line in truth["orders"]}
        for order in record["orders"]:
            line = lines.get((order["channel"], round(2 * order["order"]) / 2))
            if line is not None and abs(order["order"] - line["order"]) < 0.02:
                at = int(np.argmin(np.abs(np.array(line["speed_rpm"]) - order["speed_rpm_at_max"])))
                pairs.append((line["amplitude_by_speed"][at], order["amplitude_ci95"]))
    held = [ends[0] <= value <= ends[1] for value, ends in pairs]
    # lines of one scene share their noise: a third of them count
    assert np.mean(held) > 0.95 - 3.1 * np.sqrt(0.95 * 0.05 / (len(held) / 3))


def test_structure_and_noise_alone_make_no_order_no_bearing_and_no_mass():
    for seed in range(9101, 9107):
        record, _ = found(seed, orders=False)
        assert record["orders"] == [] and record["bearings"] == [] and record["balance"] is None
        assert sum(mode["explained_by"] == "mode" for mode in record["modes"]) == 8
