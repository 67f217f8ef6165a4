"""Natural frequencies that only the first order shows: found within their errors, and never without their doubt."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from tests.made.floors import Made, orders_of

from crankorder.identify.found import AgreedOrder, Lock, ModalFit, Mode, OrderLine
from crankorder.identify.modal.order_search import with_modes_of_first_order
from crankorder.settings import load_settings

SPEED_RPM = tuple(np.arange(1800.0, 5701.0, 60.0))  # 30 to 95 Hz


def _made(natural_hz: tuple[float, ...], damping: tuple[float, ...]) -> Made:
    n = len(natural_hz)
    return Made(natural_hz=natural_hz, damping=damping, sensor=((0.01,),) * n, drive=((0.6,),) * n, speed_rpm=SPEED_RPM)


def _order_one(lock: Lock = "undecided") -> tuple[AgreedOrder, ...]:
    speed = np.array(SPEED_RPM)
    blank = np.zeros(len(speed))
    line = OrderLine(
        "X", 1.0, 1e-4, np.arange(len(speed)), speed, blank, blank, blank, blank, "steady, not locked", 9.0
    )
    return (AgreedOrder(1.0, 1e-4, 30.0, lock, None, (line,)),)


def _searched(order_map: xr.Dataset, modes: tuple[Mode, ...] = (), lock: Lock = "undecided") -> ModalFit:
    start = ModalFit(modes, (), np.eye(2 * len(modes)))
    return with_modes_of_first_order(start, order_map, _order_one(lock), settings=load_settings().identify)


def _map(made: Made, seed: int, error: float = 1e-4) -> xr.Dataset:
    return orders_of(made, ((1.0, 5.0),), error=error, seed=seed)


@pytest.mark.parametrize("seed", range(5))
def test_two_modes_that_order_one_sweeps_through_are_found_within_their_errors_and_undecided(seed: int) -> None:
    made = _made((61.0, 91.0), (0.08, 0.025))
    found = _searched(_map(made, seed)).modes
    assert len(found) == 2
    for mode, f, zeta in zip(found, made.natural_hz, made.damping, strict=True):
        assert abs(mode.frequency_hz - f) <= 4.0 * mode.frequency_error_hz
        assert abs(mode.damping_ratio - zeta) <= 4.0 * mode.damping_error
        assert mode.frequency_error_hz < 0.02 * f
        assert "order 1 alone" in mode.undecided
    assert "at the end of what was swept" in found[1].undecided
    assert "at the end" not in found[0].undecided


@pytest.mark.parametrize("power", [0.0, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_first_order_that_follows_a_power_of_the_speed_has_no_mode(power: float, seed: int) -> None:
    made = _map(_made((500.0,), (0.02,)), seed)
    random = np.random.default_rng(seed)
    plain = 0.02 * (made["speed"].values / 5700.0) ** power * np.exp(0.4j)
    scatter = random.standard_normal((2, plain.size)) * 0.01 * np.abs(plain)
    plain = plain + scatter[0] + 1j * scatter[1]
    made["coherent_amplitude"][0, :, 0] = np.abs(plain)
    made["phase"][0, :, 0] = np.degrees(np.angle(plain))
    assert _searched(made).modes == ()


def test_noise_in_place_of_the_first_order_has_no_mode() -> None:
    for seed in range(10):
        made = _map(_made((61.0,), (0.08,)), seed)
        random = np.random.default_rng(seed)
        noise = random.standard_normal((2, len(SPEED_RPM)))
        made["coherent_amplitude"][0, :, 0] = np.hypot(*noise)
        made["phase"][0, :, 0] = np.degrees(np.arctan2(*noise))
        made["standard_error"][:] = 1.0
        assert _searched(made).modes == ()


def test_a_mode_far_above_what_is_swept_invents_none_within() -> None:
    for natural_hz in (110.0, 150.0, 300.0):
        assert _searched(_map(_made((natural_hz,), (0.02,)), 1)).modes == ()


def test_an_order_that_slips_or_a_mode_that_is_known_stops_the_search() -> None:
    order_map = _map(_made((61.0,), (0.08,)), 1)
    assert _searched(order_map, lock="slips").modes == ()
    known = Mode(61.2, 0.1, 0.08, 0.01, ("X",), 9.0, "")
    assert _searched(order_map, (known,)).modes == (known,)


def test_found_modes_stand_in_order_with_their_covariance_beside_the_known_ones() -> None:
    known = Mode(20.0, 1.0, 0.05, 1.0, ("X",), 9.0, ""), Mode(400.0, 1.0, 0.05, 1.0, ("X",), 9.0, "")
    fit = _searched(_map(_made((61.0,), (0.08,)), 1), known)
    assert [round(mode.frequency_hz / 10.0) for mode in fit.modes] == [2, 6, 40]
    errors = np.sqrt(np.diag(fit.covariance)).reshape(-1, 2)
    for mode, (by_f, by_zeta) in zip(fit.modes, errors, strict=True):
        assert by_f == pytest.approx(mode.frequency_error_hz)
        assert by_zeta == pytest.approx(mode.damping_error)
