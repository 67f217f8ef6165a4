"""What speaks against a mode is said: pressure alone, a grid of tones, one speed."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.made.floors import Made, campbell_of, no_orders

from crankorder.identify.found import ModalFit
from crankorder.identify.modes.joint_fit import modal_fit
from crankorder.settings import load_settings

ONE = Made(natural_hz=(115.0,), damping=(0.016,), sensor=((0.008, 0.010),), drive=((0.5, -0.7),), rate_hz=640.0)


def _fit(made: Made, quantity: tuple[str, ...] = ()) -> ModalFit:
    campbell = campbell_of(made, 3)
    if quantity:
        campbell = campbell.assign_coords(quantity=("channel", list(quantity)))
    return modal_fit(campbell, no_orders(campbell), (), settings=load_settings().identify)


def test_a_hump_in_sound_pressure_alone_is_undecided() -> None:
    (mode,) = _fit(ONE, ("sound pressure", "sound pressure")).modes
    assert "pressure alone" in mode.undecided
    (mode,) = _fit(ONE, ("acceleration", "sound pressure")).modes
    assert mode.undecided == ""


def test_a_mode_as_narrow_as_an_order_wanders_is_undecided_at_one_speed_and_a_mode_at_many() -> None:
    narrow = replace(ONE, damping=(0.0008,), duration_s=120.0, resolution_hz=0.05)
    (mode,) = _fit(replace(narrow, speed_rpm=(1010.0,))).modes
    assert "at one speed a modulated order looks so" in mode.undecided
    (mode,) = _fit(replace(narrow, speed_rpm=(1010.0, 1300.0, 1800.0))).modes
    assert mode.undecided == ""


@pytest.mark.slow
def test_a_well_damped_mode_at_one_speed_is_a_mode() -> None:
    (mode,) = _fit(replace(ONE, speed_rpm=(1010.0,), duration_s=120.0)).modes
    assert mode.undecided == ""
