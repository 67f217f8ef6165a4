"""What speaks against a mode is said: pressure alone, a grid of tones, one speed."""

from __future__ import annotations

from dataclasses import replace

import pytest
import xarray as xr
from tests.made.floors import Made, campbell_of, no_orders

from crankorder.identify.found import ModalFit, Mode
from crankorder.identify.modal.doubts import common_step, of_the_air, said_wide
from crankorder.identify.modal.joint_fit import modal_fit
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


def test_a_well_damped_mode_at_one_speed_is_a_mode() -> None:
    (mode,) = _fit(replace(ONE, speed_rpm=(1010.0,), duration_s=120.0)).modes
    assert mode.undecided == ""


@pytest.mark.parametrize("step_hz", [7.3, 10.0, 33.1])
def test_the_step_of_tones_on_a_grid_is_found_in_spite_of_strangers(step_hz: float) -> None:
    tones = tuple(step_hz * n for n in (3.61, 5, 7, 8, 10, 12, 15, 17, 22))
    assert common_step(tones, 0.05) == pytest.approx(step_hz, rel=1e-9)


def test_tones_of_no_common_step_have_none() -> None:
    assert common_step((31.7, 47.03, 88.91, 113.3, 171.17, 208.77, 301.93), 0.05) == 0.0
    assert common_step((10.0, 20.0, 30.0), 0.05) == 0.0


def test_the_evidence_says_when_the_frequency_is_known_badly() -> None:
    assert said_wide(100.0, 0.09) == ""
    assert "± 0.39 %" in said_wide(100.0, 0.2)


def test_what_is_heard_in_pressure_alone_is_not_called_a_mode() -> None:
    channels = {"channel": ["microphone", "mount"], "quantity": ("channel", ["sound pressure", "acceleration"])}
    heard = Mode(100.0, 0.1, 0.02, 0.001, ("microphone",), 10.0, "seen")
    felt = replace(heard, channels=("microphone", "mount"))
    doubted, kept = of_the_air((heard, felt), xr.Dataset(coords=channels))
    assert "pressure alone" in doubted.undecided
    assert kept.undecided == ""
    assert of_the_air((heard,), xr.Dataset()) == (heard,)
