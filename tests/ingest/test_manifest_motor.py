"""The motor of a manifest is checked, and its lines stand where supply, poles and speed put them."""

from pathlib import Path

import pytest

from crankorder.engine.motor import Motor, motor_lines
from crankorder.errors import ManyErrors
from made.recordings import read_manifest


def test_a_motor_is_read(tmp_path: Path) -> None:
    motor = read_manifest(tmp_path, "[motor]\nsupply_hz = 50.0\npoles = 4\nrotor_bars = 44\n").motor
    assert motor is not None and (motor.supply_hz, motor.poles, motor.rotor_bars, motor.shaft_ratio) == (50.0, 4, 44, 1)
    assert read_manifest(tmp_path, "").motor is None


def test_a_wrong_motor_is_refused_with_its_line(tmp_path: Path) -> None:
    rows = [
        ("supply_hz = 50.0\npoles = 3\n", "poles come in pairs"),
        ("supply_hz = 50.0\npoles = 0\n", "greater than 0"),
        ("supply_hz = -50.0\npoles = 4\n", "greater than 0"),
        ("supply_hz = 50.0\n", "a motor needs poles, rotor_bars or stator_slots"),
        ("poles = 4\nrotor_bar = 44\n", "Did you mean 'rotor_bars'?"),
        ('poles = "4"\n', "motor.poles"),
    ]
    for text, words in rows:
        with pytest.raises(ManyErrors) as caught:
            read_manifest(tmp_path, f"[motor]\n{text}")
        assert words in str(caught.value) and "run.toml:1" in str(caught.value)


def test_lines_of_a_four_pole_motor_at_2_percent_slip() -> None:
    """By hand: 1500 rpm less 2 % is 24.5 Hz; the pole pass is 4 x 0.5 = 2 Hz; 44 bars pass at 1078 Hz."""
    motor = Motor(supply_hz=50.0, poles=4, rotor_bars=44)
    found = {(line.name, line.side): line.hertz_at(50.0, 1470.0) for line in motor_lines(motor)}
    assert motor.synchronous_rpm(50.0) == 1500.0
    assert found == pytest.approx(
        {
            ("mains", ""): 50.0,
            ("twice mains", ""): 100.0,
            ("pole-pass sideband of order 1 of the motor", "below"): 22.5,
            ("pole-pass sideband of order 1 of the motor", "above"): 26.5,
            ("pole-pass sideband of twice mains", "below"): 98.0,
            ("pole-pass sideband of twice mains", "above"): 102.0,
            ("bar pass", ""): 1078.0,
            ("sideband of bar pass at twice mains", "below"): 978.0,
            ("sideband of bar pass at twice mains", "above"): 1178.0,
        }
    )
