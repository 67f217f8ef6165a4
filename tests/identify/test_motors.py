"""The slip of a motor whose speed was only stated: by the one line just below its field, and by nothing else."""

import numpy as np
import pytest

from crankorder.engine.machine_parts import Motor
from crankorder.identify.lines.mains import motor_seen
from made.line_frames import held_at
from made.shipped import IDENTIFY


def recorded(stated_rpm, *lines, noise=0.3, seed=0):
    """A recording in frames of the ``stated_rpm``, with ``lines`` (Hz, amplitude) in noise."""
    return held_at(np.random.default_rng(seed), stated_rpm, lines, noise=noise)


@pytest.mark.parametrize("seed", range(2))
def test_where_the_speed_is_only_stated_the_line_below_the_field_tells_the_slip(seed):
    rng = np.random.default_rng([seed, 5])
    nominal, poles, slip = float(rng.choice([50.0, 60.0])), int(rng.choice([2, 4, 6])), float(rng.uniform(0.006, 0.06))
    supply = nominal * (1.0 + float(rng.uniform(-1e-3, 1e-3)))
    shaft_hz, stated = 2.0 * supply / poles * (1.0 - slip), 120.0 * nominal / poles * float(rng.choice([1.0, 0.97]))
    sizes = rng.uniform(0.3, 1.0, 3)
    places = (shaft_hz, 2.0 * shaft_hz, 2.0 * supply)
    held = recorded(stated, *zip(places, sizes.tolist(), strict=True), noise=float(rng.uniform(0.05, 0.3)), seed=seed)
    found = motor_seen(Motor(supply_hz=nominal, poles=poles), held, by_shaft=False, settings=IDENTIFY)
    motor, (speed,) = found.record, found.record.speeds
    assert motor.supply_measured and motor.supply_hz == pytest.approx(supply, abs=2e-3)
    assert speed.slip == pytest.approx(slip, abs=2e-4)
    assert speed.speed_rpm == pytest.approx(60.0 * shaft_hz, rel=2e-4)
    assert speed.pole_pass_hz == pytest.approx(2.0 * slip * supply, abs=0.02)
    assert {one.line.name for one in found.lines} == {"twice mains"}
    (line,) = motor.lines
    assert line.amplitude == pytest.approx(sizes[2], rel=0.05)
    assert bool(found.speed_doubt) == (abs(60.0 * shaft_hz / stated - 1.0) > 0.0039)


@pytest.mark.parametrize("seed", range(2))
def test_noise_mains_and_two_lines_alike_tell_no_slip(seed):
    rng, motor = np.random.default_rng([seed, 6]), Motor(supply_hz=50.0, poles=int(2 + 2 * (seed % 2)))
    field_hz = 100.0 / float(motor.poles or 2)
    mains = [(50.0 * multiple, 1.0) for multiple in (1, 2, 3)]
    low, high = field_hz * rng.uniform(0.93, 0.95), field_hz * rng.uniform(0.96, 0.985)
    alike = [(low, 1.0), (high, float(rng.uniform(0.6, 1.0)))]
    for lines in ([], mains, alike, [*mains, *alike]):
        held = recorded(60.0 * field_hz, *lines, seed=seed)
        found = motor_seen(motor, held, by_shaft=False, settings=IDENTIFY)
        assert found.record.speeds == () and not found.record.misfit and not found.speed_doubt, lines


@pytest.mark.parametrize("seed", range(2))
def test_a_line_at_the_stated_speed_is_the_shafts_beside_a_stronger_one_of_another_motor(seed):
    rng = np.random.default_rng([seed, 7])
    own, other = 25.0 * (1.0 - rng.uniform(0.005, 0.02)), 25.0 * (1.0 - rng.uniform(0.035, 0.06))
    held = recorded(60.0 * own * (1.0 + rng.uniform(-2e-3, 2e-3)), (own, 0.5), (other, 2.0), (100.0, 0.5), seed=seed)
    found = motor_seen(Motor(supply_hz=50.0, poles=4), held, by_shaft=False, settings=IDENTIFY)
    assert found.record.speeds[0].speed_rpm == pytest.approx(60.0 * own, rel=2e-4) and found.speed_doubt is None


def test_a_speed_of_the_shaft_tells_the_slip_by_itself():
    held = recorded(1470.0, (24.5, 1.0), (100.0, 1.0))
    found = motor_seen(Motor(supply_hz=50.0, poles=4), held, by_shaft=True, settings=IDENTIFY)
    assert [one.slip for one in found.record.speeds] == [pytest.approx(0.02, abs=1e-4)]
    wrong = motor_seen(Motor(supply_hz=50.0, poles=6), held, by_shaft=True, settings=IDENTIFY)
    assert "faster than the 1000 rpm of 6 poles" in wrong.record.misfit and not wrong.lines and not wrong.record.lines
