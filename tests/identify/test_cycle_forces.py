"""Gas or masses: the forces of the model against closed forms, and which of the two is said to make an order."""

import numpy as np
import pytest

from crankorder.engine.definition import Cylinder, Engine, GasCurve, load_engine
from crankorder.engine.slider_crank import piston_velocity
from crankorder.findings import OrderFinding
from crankorder.identify.machine_model import cycle_doubts, cycle_forces
from made.typed import record_of

FIRING = load_engine("msu-optical-second-firing")


def with_gas(engine, factor):
    """``engine`` with ``factor`` times the pressure above that of its surroundings."""
    gas = engine.gas
    assert gas is not None and gas.pressure_pa is not None
    pressure = tuple(gas.surroundings_pa + factor * (p - gas.surroundings_pa) for p in gas.pressure_pa)
    return engine.model_copy(update={"gas": gas.model_copy(update={"pressure_pa": pressure})})


def test_the_masses_torque_and_force_are_those_of_the_long_rod():
    """Order 2: torque ½ m r² ω², force m r ω² λ; order 1: force m r ω² (truth sheet 2.5 and 2.7)."""
    rng = np.random.default_rng(5)
    for _ in range(10):
        radius, mass, rpm = rng.uniform(0.03, 0.08), rng.uniform(0.2, 5.0), rng.uniform(600, 6000)
        engine = Engine(
            crank_radius_m=radius, rod_length_m=200 * radius, reciprocating_mass_kg=mass,
            gas=GasCurve(crank_angle_deg=(0.0, 180.0), torque_n_m=(10.0, 10.0)),
        )  # fmt: skip
        one, two = cycle_forces(engine, [(1.0, rpm), (2.0, rpm)])
        assert one is not None and two is not None
        along = mass * radius * (rpm * np.pi / 30) ** 2
        assert one.force == pytest.approx(along, rel=1e-4)
        assert two.force == pytest.approx(along / 200, rel=1e-3)
        assert two.torque == pytest.approx(0.5 * along * radius, rel=1e-4)


def test_the_gas_torque_is_the_fourier_line_of_force_times_piston_speed():
    rev = np.arange(1 << 15) / (1 << 14)
    gas, bore = FIRING.gas, FIRING.bore_m
    assert gas is not None and gas.pressure_pa is not None and bore is not None
    degrees = (360 * rev + 360) % 720 - 360
    pressure = np.interp(degrees, gas.crank_angle_deg, gas.pressure_pa, period=720)
    torque = -(pressure - gas.surroundings_pa) * np.pi / 4 * bore**2 * piston_velocity(rev, FIRING.mechanism)
    for order in (0.5, 2.0, 3.5):
        line = 2 * abs(np.mean(torque * np.exp(-2j * np.pi * order * rev)))
        (made,) = cycle_forces(FIRING, [(order, 1500.0)])
        assert made is not None and made.gas == pytest.approx(line, rel=1e-3)


def test_half_orders_are_the_gas_and_whole_ones_whichever_is_far_larger():
    strong, weak = with_gas(FIRING, 50.0), with_gas(FIRING, 0.02)
    for order in (1.0, 2.0, 3.0, 4.0):
        assert [made.maker for made in cycle_forces(strong, [(order, 1500.0)]) if made] == ["gas"]
        assert [made.maker for made in cycle_forces(weak, [(order, 1500.0)]) if made] == ["masses"]
    assert [made.maker for made in cycle_forces(weak, [(0.5, 1500.0), (3.5, 1500.0)]) if made] == ["gas", "gas"]
    between = [made.maker for made in cycle_forces(FIRING, [(2.0, rpm) for rpm in (300, 1500, 9000)]) if made]
    assert between == ["gas", "both", "masses"]


def test_without_gas_or_the_firing_angles_nothing_is_said():
    assert cycle_forces(load_engine("msu-optical-second"), [(2.0, 1500.0)]) == (None,)
    two = FIRING.model_copy(update={"cylinders": (Cylinder(), Cylinder(crank_deg=180.0, position_m=0.1))})
    assert cycle_forces(two, [(2.0, 1500.0), (0.5, 900.0)]) == (None, None)


FIRES = zip((0.0, 180.0, 180.0, 0.0), (0.0, 180.0, 540.0, 360.0), strict=True)
EVEN = tuple(Cylinder(crank_deg=crank, position_m=0.1, firing_deg=fires) for crank, fires in FIRES)
LOCKED_123 = {1.0: "locked", 2.0: "locked", 3.0: "locked"}
HALVES = {0.5: "locked", 1.0: "locked", 1.5: "locked"}
STATED = [
    (HALVES, True, None, True), (HALVES, False, None, False),  # a four-stroke engine, or a rotor that rubs
    ({0.5: "locked", 1.0: "locked", 2.0: "locked"}, True, None, False),
    ({0.5: "locked", 1.5: "slips"}, True, None, False), ({0.5: "undecided", 1.5: "undecided"}, True, None, False),
    ({}, True, None, False), (LOCKED_123, False, FIRING, True), ({0.5: "locked", **LOCKED_123}, False, FIRING, False),
    ({5.5: "locked", 1.0: "locked", 2.0: "locked"}, False, FIRING, False),
    ({1.0: "locked"}, False, FIRING, False),  # too little is seen for the lack to say anything
    ({1.0: "undecided", 2.0: "locked", 3.0: "slips"}, False, FIRING, False),
    (LOCKED_123, False, load_engine("msu-optical-second"), False),  # without gas
    (LOCKED_123, False, None, False),
    # four even cylinders make no half orders to miss
    ({2.0: "locked", 4.0: "locked", 6.0: "locked"}, False, FIRING.model_copy(update={"cylinders": EVEN}), False),
]  # fmt: skip


@pytest.mark.cases(len(STATED))
@pytest.mark.parametrize(("orders", "two_stroke", "engine", "doubted"), STATED)
def test_d16_half_orders_put_a_stated_two_stroke_cycle_in_doubt_and_their_lack_that_of_a_fired_engine(
    orders, two_stroke, engine, doubted
):
    found = [record_of(OrderFinding, {"order": order, "lock": lock}) for order, lock in orders.items()]
    flags = cycle_doubts([*found, *found], two_stroke=two_stroke, engine=engine)  # the same in a second channel
    assert [one.flag for one in flags] == (["cycle_doubted"] if doubted else [])
    other = "four-stroke" if two_stroke else "two-stroke"
    assert all("0.5, 1.5" in one.detail and other in one.detail for one in flags)
    assert two_stroke or cycle_doubts(found, two_stroke=False, engine=engine, max_order=1.0) == []
