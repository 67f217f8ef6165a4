"""Natural frequencies and damping of made structures, whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from tests.made.floors import Made, campbell_of, inside, no_orders, orders_of

from crankorder.fft.windows import window_named
from crankorder.identify.modes.floor import quiet_floor, spectral_window
from crankorder.identify.modes.joint_fit import modal_fit
from crankorder.identify.modes.surface_fit import pole_columns
from made.found_lines import agreed, line
from made.shipped import IDENTIFY

THREE = Made(
    natural_hz=(60.0, 172.0, 187.0), damping=(0.02, 0.01, 0.01),
    sensor=((0.006, 0.010), (0.008, 0.004), (0.004, 0.009)), drive=((0.2, 1.7), (0.8, 0.7), (-0.6, -0.9)), rate_hz=640.0
)  # fmt: skip


def _agreed(orders, made):
    speed, channels = np.array(made.speed_rpm), "XYZ"[: len(made.sensor[0])]
    lines = {order: [line(order, 0.0, channel=name, speed_rpm=speed) for name in channels] for order in orders}
    return tuple(agreed(order, *lines[order], error=1e-5) for order in orders)


def _fit(made, seed=1, orders=(), quantity=()):
    campbell = campbell_of(made, seed)
    if quantity:
        campbell = campbell.assign_coords(quantity=("channel", list(quantity)))
    return modal_fit(campbell, no_orders(campbell), _agreed(orders, made), settings=IDENTIFY)


def test_close_modes_are_told_apart_with_their_damping():
    fit = _fit(THREE)
    assert inside(fit, THREE)
    assert not any(mode.undecided for mode in fit.modes)
    assert not fit.tones
    for mode, f in zip(fit.modes, THREE.natural_hz, strict=True):
        assert mode.frequency_hz == pytest.approx(f, rel=2e-3)


BESIDE = [
    ({"gains": tuple(np.linspace(1.0, 4.0, len(THREE.speed_rpm)))}, ()),  # a floor that grows with speed
    ({"lines": ((1.0, 3.0), (2.0, 5.0), (5.5, 1.0))}, (1.0, 2.0, 5.5)),  # lines far above the floor
    ({"lines": ((2.5, 1.0),)}, ()),  # a line that nobody found
]


@pytest.mark.parametrize(("changes", "orders"), BESIDE)
def test_a_floor_that_grows_and_order_lines_leave_no_other_mode_behind(changes, orders):
    made = replace(THREE, **changes)
    assert inside(_fit(made, orders=orders), made)


def test_white_noise_has_neither_modes_nor_tones():
    made = replace(THREE, sensor=((0.0, 0.0),) * 3)
    for seed in range(5):
        fit = _fit(made, seed)
        assert not fit.modes and not fit.tones


def test_mains_and_a_pump_are_tones_with_their_amplitude_and_no_modes():
    made = replace(THREE, tones=((100.0, 0.05), (58.3, 0.5)))
    fit = _fit(made)
    assert inside(fit, made)
    pump, mains = fit.tones
    assert (pump.kind, mains.kind) == ("tone", "mains")
    for tone, (f, amplitude) in zip((pump, mains), ((58.3, 0.5), (100.0, 0.05)), strict=True):
        assert abs(tone.frequency_hz - f) < 0.02
        for found, error in tone.amplitude.values():
            assert found == pytest.approx(amplitude, abs=max(4.0 * error, 0.02 * amplitude))
        assert set(tone.amplitude) == {"X", "Y"}


def test_lines_of_two_mains_frequencies_are_no_mains():
    fit = _fit(replace(THREE, tones=((100.0, 0.2), (120.0, 0.2))))
    assert [tone.kind for tone in fit.tones] == ["tone", "tone"]


def test_orders_that_sweep_through_a_mode_tell_its_frequency_better_than_the_floor():
    campbell = campbell_of(THREE, 1)
    by_order = orders_of(THREE, ((4.0, 20.0), (6.0, 10.0)), error=0.002, seed=2)
    orders = _agreed((4.0, 6.0), THREE)
    alone = modal_fit(campbell, no_orders(campbell), orders, settings=IDENTIFY)
    both = modal_fit(campbell, by_order, orders, settings=IDENTIFY)
    assert both.modes[0].reached_by == (4.0, 6.0)
    assert both.modes[0].frequency_error_hz < 0.7 * alone.modes[0].frequency_error_hz
    assert inside(both, THREE)
    assert all(response.fits and response.force.exponent == 2.0 for response in both.responses)


def test_an_order_that_the_modes_do_not_explain_takes_no_part():
    campbell = campbell_of(THREE, 1)
    by_order = orders_of(THREE, ((4.0, 20.0),), error=0.002, seed=2)
    by_order["phase"] = by_order["phase"] + 90.0 * np.sin(np.arange(len(THREE.speed_rpm)))[None, :, None]
    fit = modal_fit(campbell, by_order, _agreed((4.0,), THREE), settings=IDENTIFY)
    assert not any(item.fits for item in fit.responses)
    assert all(mode.reached_by == () for mode in fit.modes)
    assert inside(fit, THREE)


def test_a_map_without_speeds_has_no_modes():
    campbell = campbell_of(THREE, 1).isel(speed=slice(0, 0))
    assert modal_fit(campbell, no_orders(campbell), (), settings=IDENTIFY).modes == ()


def test_a_channel_that_is_missing_at_all_speeds_takes_no_part():
    campbell = campbell_of(THREE, 1)
    campbell["psd"][1] = np.nan
    used = np.repeat(campbell["n_frames"].values[None], 2, axis=0)
    used[1] = 0
    campbell["n_frames_used"] = (("channel", "speed"), used)
    fit = modal_fit(campbell, no_orders(campbell), (), settings=IDENTIFY)
    assert [mode.channels for mode in fit.modes] == [("X",)] * 3
    assert inside(fit, THREE)


def test_bins_of_padded_frames_are_taken_no_closer_than_they_tell_of():
    campbell = campbell_of(replace(THREE, speed_rpm=(1000.0,)), 0)
    campbell["n_frames"][:] = 1  # of more than one spectrum the scatter is known bin by bin
    hz = campbell["frequency"].values
    padded = campbell.interp(frequency=np.linspace(hz[0], hz[-1], 16 * (len(hz) - 1) + 1))
    padded.attrs = campbell.attrs
    floor, wide = quiet_floor(campbell, ()), quiet_floor(padded, ())
    assert floor is not None and wide is not None
    assert floor.step_hz == pytest.approx(hz[1] - hz[0])
    assert wide.step_hz == pytest.approx(0.5 * wide.seen.bin_hz)


def test_more_poles_than_bins_are_no_fault():
    random, campbell = np.random.default_rng(0), campbell_of(replace(THREE, speed_rpm=(1000.0, 1010.0)), 0)
    for n_bins in (4, 7, 15):
        part = campbell.isel(frequency=slice(0, n_bins))
        bins = (part["psd"].dims, random.gamma(0.3, 1.0, part["psd"].shape))
        fit = modal_fit(part.assign(psd=bins), no_orders(part), (), settings=IDENTIFY)
        assert all(np.isfinite(mode.frequency_hz) for mode in fit.modes)


# What speaks against a mode is said: pressure alone, a grid of tones, one speed.


ONE = Made(natural_hz=(115.0,), damping=(0.016,), sensor=((0.008, 0.010),), drive=((0.5, -0.7),), rate_hz=640.0)


def test_a_hump_in_sound_pressure_alone_is_undecided():
    (mode,) = _fit(ONE, 3, quantity=("sound pressure", "sound pressure")).modes
    assert "pressure alone" in mode.undecided
    (mode,) = _fit(ONE, 3, quantity=("acceleration", "sound pressure")).modes
    assert mode.undecided == ""


def test_a_mode_as_narrow_as_an_order_wanders_is_undecided_at_one_speed_and_else_a_mode():
    narrow, one = replace(ONE, damping=(0.0008,), duration_s=120.0, resolution_hz=0.05), (1010.0,)
    (mode,) = _fit(replace(narrow, speed_rpm=one), 3).modes
    assert "at one speed a modulated order looks so" in mode.undecided
    for made in (replace(narrow, speed_rpm=(*one, 1300.0, 1800.0)), replace(ONE, speed_rpm=one, duration_s=120.0)):
        (mode,) = _fit(made, 3).modes
        assert mode.undecided == ""


# What a window makes of a resonance: against numerical convolution and differences.


BIN_HZ = 0.5


@pytest.mark.parametrize(("name", "damping"), [("hann", 0.0005), ("blackman-harris", 0.05)])
def test_a_resonance_is_seen_through_the_window_as_the_lags_that_the_window_lets_through(name, damping):
    """Wiener and Khinchin: the decaying autocorrelation of the mode times that of the window, transformed by sums."""
    window = window_named(name, 32768)
    seen = spectral_window(name, window.enbw_bins * BIN_HZ)
    at = np.array([50.0, 59.5, 60.0, 61.5])
    columns = pole_columns(at, np.array([60.0]), np.array([damping]), seen)[0]
    spectrum = np.fft.rfft(window.values, 65536)
    lagged = np.fft.irfft(np.abs(spectrum) ** 2)[:32768]  # zeros beyond the window's end: nothing wraps around
    lag_s = np.arange(32768) / 32768.0 / BIN_HZ
    sigma, damped = damping * 60.0, 60.0 * np.sqrt(1.0 - damping**2)
    weight = lagged / lagged[0] / 32768.0 / BIN_HZ
    weight[0] *= 0.5  # the trapezoid rule
    decay = 2.0 * np.pi * sigma * weight * np.exp(2j * np.pi * (damped + 1j * sigma) * lag_s)
    near = np.exp(-2j * np.pi * np.outer(at, lag_s)) @ decay
    far = np.exp(-2j * np.pi * np.outer(at, lag_s)) @ decay.conj()
    assert columns[0] == pytest.approx((near + far).real, abs=2e-5)
    assert columns[1] == pytest.approx((far - near).imag, abs=2e-5)
