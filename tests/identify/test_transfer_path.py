"""Stated paths turn amplitudes into masses; what channels measure is read as it is."""

import numpy as np
import pytest

from crankorder.engine.definition import BalanceShafts
from crankorder.engine.forces import crankcase_forces
from crankorder.engine.machine_parts import PathMode, StatedPath
from crankorder.identify.balance.transfer_path import accelerance_of, measured_orders
from crankorder.identify.balance.unbalance_fit import unbalance_fit
from crankorder.identify.machine_model import MachineModel
from made.order_amplitudes import Structure, engine_of, made_orders, modal_of, order_map_of
from made.typed import as_dicts

unbalance_fit = as_dicts(unbalance_fit)

RPM = np.arange(300.0, 2001.0, 50.0)
ORDER = np.arange(8, 49) / 16
ENGINE = engine_of(shafts=BalanceShafts(orders=(1, 2), unbalanced_mass_kg=0.116))
NOTHING = modal_of(np.random.default_rng(0), Structure(np.random.default_rng(0), n_modes=0))


def stated(channel, direction, **form):
    return StatedPath(channel=channel, direction=direction, **({"frequency_range_hz": (1.0, 100.0)} | form))


def order_map(engine, path, *, noise=1e-4, seed=0, reference="tdc"):
    """Orders 1 and 2 of ``engine`` through ``path`` (channel, direction X or Z) in 1/kg."""
    rng = np.random.default_rng(seed)
    path = np.asarray(path, dtype=complex)
    force = crankcase_forces(engine, RPM, max_order=2)[:, [0, 2]]
    parts = rng.normal(size=(2, 3, RPM.size, ORDER.size))[:, : len(path)]
    amplitude = noise * (parts[0] + 1j * parts[1])
    for k in (1, 2):
        amplitude[:, :, int(np.argmin(abs(ORDER - k)))] += np.einsum("cd,sd->cs", path, force[:, :, k])
    error = noise * np.sqrt(rng.chisquare(16.0, amplitude.shape) / 16.0)
    return order_map_of(amplitude, error, np.full(error.shape, 16.0), RPM, ORDER, reference=reference)


def closed(item, paths, engine):
    record, reason = unbalance_fit(item, (), NOTHING, sources=MachineModel(2, engine=engine, paths=tuple(paths)))
    assert record is not None, reason
    return record


def test_a_rigid_body_gives_the_force_of_its_mass():
    record = closed(order_map(ENGINE, [[0.0, 1 / 330]]), [stated("X", "Z", apparent_mass_kg=330.0)], ENGINE)
    assert record["source"] == "stated path"
    assert record["residual_reciprocating_g"] == pytest.approx(116, rel=1e-3)
    assert record["residual_second_order_g"] == pytest.approx(116, rel=1e-2)
    low, high = record["along_g_ci95"]
    assert low < 116 * 1.002325 < high


def test_the_uncertainty_of_a_path_is_that_of_the_mass():
    path = stated("X", "Z", apparent_mass_kg=330.0, uncertainty_percent=10.0)
    low, high = closed(order_map(ENGINE, [[0.0, 1 / 330]]), [path], ENGINE)["along_g_ci95"]
    assert (high - low) / 2 == pytest.approx(11.6, rel=0.1)


def test_paths_along_and_across_part_rotating_from_reciprocating():
    engine = ENGINE.model_copy(update={"rotating_unbalance_kg_m": 0.002, "rotating_unbalance_deg": 70.0})
    matrix = np.array([[1 / 400, 1 / 2000], [1 / 3000, 1 / 300]])
    places = [(name, direction, matrix[c, d]) for c, name in enumerate("XY") for d, direction in enumerate("XZ")]
    paths = [stated(name, direction, apparent_mass_kg=1 / share) for name, direction, share in places]
    record = closed(order_map(engine, matrix), paths, engine)
    assert record["residual_rotating_gmm"] == pytest.approx(2000, rel=2e-3)
    assert record["angle_deg"] == pytest.approx(70, abs=0.2)
    assert record["residual_reciprocating_g"] == pytest.approx(116, rel=5e-3)
    # reciprocating mass is half forward, half reverse (direct and reverse cranks, seed 002)
    assert record["reverse_gmm"] == pytest.approx(0.5 * 116 * 1.002325 * 44.9, rel=5e-3)
    low, high = record["residual_rotating_gmm_ci95"]
    assert low < 2000 < high


def test_a_rotor_is_told_in_g_mm_at_its_angle():
    engine = engine_of(cycle="rotor", reciprocating_mass_kg=0.0, shafts=BalanceShafts(), offset_m=0.0)
    rotor = engine.model_copy(update={"rotating_unbalance_kg_m": 5e-4, "rotating_unbalance_deg": -120.0})
    for paths, matrix in (
        ([stated("X", "Z", apparent_mass_kg=50.0)], [[0.0, 0.02]]),
        ([stated("X", "X", apparent_mass_kg=50.0)], [[0.02, 0.0]]),
        ([stated("X", "X", apparent_mass_kg=50.0), stated("Y", "Z", apparent_mass_kg=40.0)], [[0.02, 0], [0, 0.025]]),
    ):
        for engine in (None, rotor):
            record = closed(order_map(rotor, matrix, reference="index"), paths, engine)
            assert record["residual_rotating_gmm"] == pytest.approx(500, rel=2e-3)
            assert record["angle_deg"] == pytest.approx(-120, abs=0.2)


def test_wrong_paths_are_refused():
    item = order_map(ENGINE, [[0.0, 1 / 330], [0.0, 1 / 330]])
    for paths, words in (
        ([stated("X", "Z", apparent_mass_kg=330.0), stated("Y", "Z", apparent_mass_kg=20.0)], "miss"),
        ([stated("X", "Z", apparent_mass_kg=330.0, frequency_range_hz=(200.0, 300.0))], "range"),
        ([stated("W", "Z", apparent_mass_kg=330.0)], "W"),
        ([stated("X", "Y", apparent_mass_kg=330.0)], "direction X or Z"),
        ([stated("X", "Z", apparent_mass_kg=330.0), stated("X", "X", apparent_mass_kg=330.0)], "apart"),
    ):
        record, reason = unbalance_fit(item, (), NOTHING, sources=MachineModel(2, engine=ENGINE, paths=tuple(paths)))
        assert record is None and words in reason


def test_the_forms_of_a_path_agree_with_one_another():
    f = np.linspace(5.0, 50.0, 91)
    modal = stated(
        "Z", "Z", modes=(PathMode(frequency_hz=60.0, damping_ratio=0.02, residue_per_kg=0.01),), rigid_per_kg=0.003
    )
    value = accelerance_of(modal, f)
    x = f / 60.0
    assert value == pytest.approx(0.003 - 0.01 * x**2 / (1 - x**2 + 0.04j * x), rel=1e-12)
    table = stated("Z", "Z", points=tuple(zip(f.tolist(), value.real.tolist(), value.imag.tolist(), strict=True)))
    assert accelerance_of(table, f) == pytest.approx(value, rel=1e-12)
    assert np.isnan(accelerance_of(table, np.array([4.9, 50.1]))).all()


def test_only_accelerometers_are_read_and_missing_values_count_for_nothing():
    item = made_orders(np.random.default_rng(0), residual_kg=0.1).order_map
    item["quantity"] = ("channel", ["acceleration", "pressure", "acceleration"])
    item["coherent_amplitude"][0, 3, :] = np.nan
    found = measured_orders(item, (1, 2, 3))
    assert found.channels == ("X", "Z")
    assert np.isinf(found.error[0, 3]) and np.isfinite(found.error[1, 3])
    assert np.isfinite(found.amplitude).all()
