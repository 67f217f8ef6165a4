"""Lightly damped modes and tones: a tone only where the data exclude a width, and both side by side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from crankorder.identify.found import AgreedOrder, ModalFit
from crankorder.identify.modes.joint_fit import modal_fit
from crankorder.settings import load_settings
from made.floor_bound import whittle_bound
from made.floors import no_orders
from made.structures import RATE_HZ, Structure, drawn, recorded, swept_up, with_pair


def fitted(campbell: xr.Dataset, made: Structure) -> ModalFit:
    """Modal fit of the floor alone, the orders known."""
    orders = tuple(AgreedOrder(float(order), 1e-5, 30.0, "locked", None, ()) for order in made.order)
    return modal_fit(campbell, no_orders(campbell), orders, settings=load_settings().identify)


def with_light_mode(
    seed: int, *, n_speeds: int, near_hz: tuple[float, float], damping: tuple[float, float]
) -> Structure:
    """Structure of ``seed`` with a light mode, its lowest, somewhere in ``near_hz``."""
    random = np.random.default_rng([seed, 99])
    made = drawn(seed, n_speeds=n_speeds, n_modes=2, damping=(0.01, 0.04), lowest_hz=110.0)
    zeta = np.exp(random.uniform(*np.log(damping)))
    return replace(
        made,
        natural_hz=np.insert(made.natural_hz, 0, random.uniform(*near_hz)),
        damping=np.insert(made.damping, 0, zeta),
        shape=np.insert(made.shape, 0, 1.0, axis=0),
        drive=np.insert(made.drive, 0, [0.0, 0.0, random.uniform(1.0, 4.0)], axis=0),
        order_force=np.insert(made.order_force, 1, made.order_force[:, 1], axis=1),
    )


def with_tone(made: Structure, frequency_hz: float, over_db: float) -> Structure:
    """``made`` with a tone that in half a hertz has ``over_db`` more power than noise of 0.3 per sample."""
    size = np.sqrt(2.0 * 2.0 * 0.3**2 / RATE_HZ * 10.0 ** (over_db / 10.0))
    return replace(made, tones=((frequency_hz, float(size)),), wander_hz=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [30.0, 60.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_light_mode_in_a_run_up_is_never_a_tone(seed: int, seconds: float) -> None:
    made = with_light_mode(seed, n_speeds=2, near_hz=(30.0, 90.0), damping=(0.002, 0.01))
    fit = fitted(swept_up(made, seed, seconds=seconds), made)
    (mode,) = [mode for mode in fit.modes if abs(mode.frequency_hz - made.natural_hz[0]) < 1.0]
    assert mode.undecided == "" or mode.undecided.startswith("tone or mode")
    assert not [tone for tone in fit.tones if abs(tone.frequency_hz - made.natural_hz[0]) < 2.0]


@pytest.mark.cases(1)
@pytest.mark.parametrize("n_speeds", [3, 12])
@pytest.mark.parametrize("seed", range(5))
def test_a_light_mode_at_a_few_speeds_is_never_a_tone(seed: int, n_speeds: int) -> None:
    made = with_light_mode(seed + 50, n_speeds=n_speeds, near_hz=(40.0, 90.0), damping=(0.002, 0.01))
    fit = fitted(recorded(made, seed), made)
    assert not [tone for tone in fit.tones if abs(tone.frequency_hz - made.natural_hz[0]) < 2.0]
    for mode in fit.modes:
        if abs(mode.frequency_hz - made.natural_hz[0]) < 1.0:
            assert mode.undecided == "" or mode.undecided.startswith(("tone or mode", "its damping"))


@pytest.mark.cases(1)
@pytest.mark.parametrize("over_db", [15.0, 25.0, 40.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_steady_tone_at_twelve_speeds_is_a_tone_and_no_mode(seed: int, over_db: float) -> None:
    made = drawn(seed + 30, n_speeds=12, n_modes=2, damping=(0.01, 0.04), lowest_hz=110.0)
    frequency = float(np.random.default_rng([seed, 97]).uniform(30.0, 90.0))
    fit = fitted(recorded(with_tone(made, frequency, over_db), seed), made)
    assert len([tone for tone in fit.tones if abs(tone.frequency_hz - frequency) < 0.2]) == 1
    assert not [mode for mode in fit.modes if abs(mode.frequency_hz - frequency) < 3.0]


@pytest.mark.cases(1)
@pytest.mark.parametrize("over_db", [25.0, 32.0, 40.0])
@pytest.mark.parametrize("away", [-0.04, -0.03, 0.03, 0.04])
def test_a_mode_beside_mains_is_found_with_them(away: float, over_db: float) -> None:
    seed = round(1000.0 + 1000.0 * away + over_db)
    mains = 50.0 if seed % 2 else 60.0
    frequency = mains * (1.0 + away)
    made = with_light_mode(seed, n_speeds=12, near_hz=(frequency, frequency + 1e-6), damping=(0.006, 0.02))
    fit = fitted(recorded(with_tone(made, mains, over_db), seed), made)
    (tone,) = [tone for tone in fit.tones if abs(tone.frequency_hz - mains) < 0.1]
    assert tone.kind == "mains"
    (mode,) = [mode for mode in fit.modes if abs(mode.frequency_hz - mains) < 5.0]
    assert mode.undecided == ""
    assert abs(mode.frequency_hz - frequency) <= 4.0 * mode.frequency_error_hz
    assert abs(mode.damping_ratio - made.damping[0]) <= 4.0 * mode.damping_error


@pytest.mark.slow
def test_a_line_too_weak_to_show_its_width_is_tone_or_mode() -> None:
    """At three speeds neither its width nor its scatter tells: it says so, and the largest damping that it may have."""
    said = []
    for seed in range(6):
        made = drawn(seed + 80, n_speeds=3, n_modes=2, damping=(0.01, 0.04), lowest_hz=110.0)
        fit = fitted(recorded(with_tone(made, 57.3, 12.0), seed), made)
        said += [mode.undecided for mode in fit.modes if abs(mode.frequency_hz - 57.3) < 0.5]
        assert not [mode for mode in fit.modes if abs(mode.frequency_hz - 57.3) < 3.0 and not mode.undecided]
    assert said and all(words.startswith("tone or mode") for words in said)


@pytest.mark.accuracy
def test_two_modes_that_the_bound_tells_apart_are_two() -> None:
    told = []
    for seed in range(9):
        one = drawn(seed + 900, n_speeds=12, n_modes=1, damping=(0.004, 0.01), lowest_hz=60.0, highest_hz=200.0)
        made = with_pair(one, 3.0)
        error_hz = whittle_bound(made)[0] * made.natural_hz
        if np.diff(made.natural_hz)[0] > 8.0 * np.hypot(*error_hz):
            near = [m for m in fitted(recorded(made, seed), made).modes if abs(m.frequency_hz - made.natural_hz[0]) < 6]
            told.append(len(near) == 2)
    assert np.mean(told) >= 0.85
