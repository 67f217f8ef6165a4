"""Two tests that differ by a known mass tell what was there before."""

import numpy as np
import pytest

from crankorder.engine.definition import BalanceShafts
from crankorder.engine.transfer_paths import AddedMass
from crankorder.identify.balance.trial_mass import trial_mass
from made.order_amplitudes import Structure, engine_of, made_orders
from made.typed import as_dicts

trial_mass = as_dicts(trial_mass)

ROTOR = engine_of(cycle="rotor", reciprocating_mass_kg=0.0, shafts=BalanceShafts(), offset_m=0.0)


def two_maps(seed, unbalances, *, engine=ROTOR, residuals=(0.0, 0.0), noise=0.02, speeds=(1000.0, 1500.0, 2000.0)):
    """Order maps of one structure with two unbalances (g·mm as complex numbers) or residual masses (kg)."""
    rng = np.random.default_rng(seed)
    structure = Structure(rng)
    return [
        made_orders(
            rng,
            residual_kg=residual,
            engine=engine,
            structure=structure,
            noise=noise,
            speeds=speeds,
            rotating_kg_m=1e-6 * abs(unbalance),
            rotating_deg=float(np.degrees(np.angle(unbalance))),
        ).order_map
        for unbalance, residual in zip(unbalances, residuals, strict=True)
    ]


@pytest.mark.parametrize(("mass_g", "engine"), [(20.0, None), (-20.0, ROTOR)])
def test_a_mass_put_on_or_taken_from_the_rotor_tells_size_and_angle_of_the_residual(mass_g, engine):
    before, trial = 800 * np.exp(1j * np.radians(35)), 50 * mass_g * np.exp(1j * np.radians(100))
    base, new = two_maps(1, (before, before + trial))
    added = (AddedMass(mass_g=mass_g, radius_mm=50.0, angle_deg=100.0),)
    record, reason = trial_mass(base, new, added=added, engine=engine)
    assert record is not None, reason
    low, high = record["residual_rotating_gmm_ci95"]
    assert low <= 800 <= high and high - low < 200
    assert record["angle_deg"] == pytest.approx(35, abs=6)
    assert record["source"] == "trial mass"
    assert len(record["influence"]) == 9


def test_a_mass_on_the_piston_tells_grams_along_the_cylinder():
    engine = engine_of()
    base, new = two_maps(2, (0.0, 0.0), engine=engine, residuals=(0.116, 0.166), speeds=np.arange(500.0, 2001.0, 100.0))
    added = (AddedMass(mass_g=50.0, on="piston"),)
    record, reason = trial_mass(base, new, added=added, engine=engine)
    assert record is not None, reason
    for key in ("residual_reciprocating_g", "residual_second_order_g"):
        low, high = record[f"{key}_ci95"]
        assert low <= 116 <= high
    assert record["along_g"] == pytest.approx(1.002325 * record["residual_reciprocating_g"], rel=1e-6)


@pytest.mark.slow
def test_converter_counts_weigh_as_well_as_m_s2():
    before, trial = 800 * np.exp(1j * np.radians(35)), 1000 * np.exp(1j * np.radians(100))
    maps = two_maps(1, (before, before + trial))
    added = (AddedMass(mass_g=20.0, radius_mm=50.0, angle_deg=100.0),)
    scaled, _ = trial_mass(*maps, added=added, engine=None)
    n = maps[0].sizes["channel"]
    counts = [item.assign_coords(unit=("channel", ["counts"] * n)) for item in maps]
    record, reason = trial_mass(*counts, added=added, engine=None)
    assert record is not None, reason
    assert record["residual_rotating_gmm"] == pytest.approx(scaled["residual_rotating_gmm"], rel=1e-9)
    after = abs(before + trial)
    low, high = record["residual_after_gmm_ci95"]
    assert low <= after <= high and high - low < 0.3 * after
    assert record["angle_after_deg"] == pytest.approx(np.degrees(np.angle(before + trial)), abs=6)


@pytest.mark.slow
def test_maps_without_a_vibration_channel_are_refused():
    maps = [item.isel(channel=slice(0, 0)) for item in two_maps(1, (500.0, 1500.0))]
    added = (AddedMass(mass_g=20.0, radius_mm=50.0),)
    record, reason = trial_mass(*maps, added=added, engine=None)
    assert record is None and "no vibration channel" in reason


def test_a_residual_that_acts_elsewhere_is_refused():
    engine = engine_of()
    base, new = two_maps(3, (0.0, 20_000.0), engine=engine, residuals=(0.3, 0.3))
    added = (AddedMass(mass_g=400.0, radius_mm=50.0),)
    record, reason = trial_mass(base, new, added=added, engine=engine)
    assert record is None and "does not act where the mass was added" in reason


def test_what_tells_nothing_is_refused():
    base, new = two_maps(4, (500.0, 500.0))
    heavy = (AddedMass(mass_g=1.0, radius_mm=10.0),)
    twice = (AddedMass(mass_g=1.0, radius_mm=10.0), AddedMass(mass_g=1.0, radius_mm=10.0, angle_deg=180.0))
    mixed = (*heavy, AddedMass(mass_g=1.0, on="piston"))
    elsewhere = new.assign_coords(speed=new["speed"] * 1.1)
    unmarked = new.assign_attrs(phase_reference="none")
    for maps, added, words in (
        ((base, new), (), "no mass"),
        ((base, new), heavy, "heavier"),
        ((base, new), twice, "cancel"),
        ((base, new), mixed, "at once"),
        ((base, new), mixed[1:], "one cylinder"),
        ((base, elsewhere), heavy, "no speed in common"),
        ((base, unmarked), heavy, "mark of the shaft"),
    ):
        record, reason = trial_mass(*maps, added=added, engine=None)
        assert record is None and words in reason


@pytest.mark.accuracy
def test_the_interval_of_the_unbalance_covers_it_in_95_of_100_scenes():
    held = []
    for seed in range(400):
        rng = np.random.default_rng(1000 + seed)
        before = rng.uniform(300, 2000) * np.exp(2j * np.pi * rng.random())
        base, new = two_maps(seed, (before, before + 1000), noise=10 ** rng.uniform(-2.5, -1.5))
        added = (AddedMass(mass_g=20.0, radius_mm=50.0),)
        record, _ = trial_mass(base, new, added=added, engine=None)
        if record is not None:
            low, high = record["residual_rotating_gmm_ci95"]
            held.append(low <= abs(before) <= high)
    assert len(held) >= 300
    assert 0.93 <= np.mean(held) <= 0.97
