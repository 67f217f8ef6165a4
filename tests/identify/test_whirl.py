"""Whirl modes: resonances whose natural frequency moves with the speed, told from modes that stay and from orders."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter, welch

from crankorder.campbell.frames import frequency_frames
from crankorder.campbell.map import campbell_map
from crankorder.identify.crossings import crossings
from crankorder.identify.explain import Causes
from crankorder.identify.findings import Measured, find, mode_records
from crankorder.identify.found import Mode, UnseenBound, Whirl
from crankorder.identify.machine_model import MachineModel
from crankorder.identify.modes.floor import quiet_floor
from crankorder.identify.modes.joint_fit import modal_fit
from crankorder.identify.modes.whirl import whirls_of, without_remains
from crankorder.identify.speeds_to_avoid import speeds_to_avoid
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.report.sentences.of_lines import mode_sentences
from crankorder.settings import load_settings
from made.floors import campbell_map_of, no_orders
from made.found_lines import agreed, fit, line
from made.recordings import steady
from made.typed import as_dicts, from_dicts

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Moving:
    """A resonance at ``hz`` + ``slope`` × rev/s of ``damping``, by its ``gain`` in each channel."""

    hz: float
    slope: float
    damping: float
    gain: tuple[float, ...] = (1.0, 0.6)

    def at(self, rpm):
        """Natural frequency in Hz at ``rpm``."""
        return self.hz + self.slope * rpm / 60.0


@dataclass(frozen=True, kw_only=True)
class Rotor:
    """Modes under white forces of their own at steady speeds, over noise; ``growth``: force as speed to that power."""

    modes: tuple[Moving, ...]
    speed_rpm: tuple[float, ...] = tuple(np.linspace(1000.0, 4000.0, 16))
    duration_s: float = 15.0
    rate_hz: float = 512.0
    noise: float = 0.02
    growth: float = 0.0
    resolution_hz: float = 0.5


def _filtered(force, hz, damping, rate_hz):
    """Velocity of an oscillator of unit half-power height under ``force``, its impulse response sampled."""
    sigma, turn = damping * 2.0 * np.pi * hz / rate_hz, 2.0 * np.pi * hz * np.sqrt(1.0 - damping**2) / rate_hz
    keep = np.exp(-sigma)
    decay = keep * np.cos(turn)
    return np.asarray(lfilter([2.0 * sigma, -2.0 * sigma * decay], [1.0, -2.0 * decay, keep**2], force))


def signals(rotor, rpm, random):
    """Signals (channels, samples) at the steady speed ``rpm``."""
    n_samples = round(rotor.duration_s * rotor.rate_hz)
    n_channels = len(rotor.modes[0].gain) if rotor.modes else 2
    made = rotor.noise * random.standard_normal((n_channels, n_samples))
    lead = round(2.0 * rotor.rate_hz)
    for mode in rotor.modes:
        force = random.standard_normal(n_samples + lead) * (rpm / 2000.0) ** rotor.growth
        moved = _filtered(force, float(mode.at(rpm)), mode.damping, rotor.rate_hz)[lead:]
        made += np.array(mode.gain)[:, None] * moved
    return made


def whirling_campbell(rotor, seed):
    """CampbellMap of ``rotor`` behind the noise of ``seed``."""
    random = np.random.default_rng(seed)
    n_frame = round(rotor.rate_hz / rotor.resolution_hz)
    n_bins = round(0.45 * rotor.rate_hz / rotor.resolution_hz)
    rows = [signals(rotor, rpm, random) for rpm in rotor.speed_rpm]
    psd = [welch(row, rotor.rate_hz, "hann", n_frame, detrend=False)[1][:, :n_bins] for row in rows]
    n_frames = (rows[0].shape[1] - n_frame) // (n_frame // 2) + 1
    return campbell_map_of(np.stack(psd, axis=1), n_frames, rotor.speed_rpm, rotor.resolution_hz)


mode_records = as_dicts(mode_records)
find = as_dicts(find)

SETTINGS = load_settings().identify
FORWARD = Moving(hz=56.0, slope=0.12, damping=0.02)
BACKWARD = Moving(hz=56.0, slope=-0.1, damping=0.02)
STAYS = (Moving(hz=90.0, slope=0.0, damping=0.02), Moving(hz=61.0, slope=0.0, damping=0.01))


def _whirls(rotor, seed):
    floor = quiet_floor(whirling_campbell(rotor, seed), ())
    assert floor is not None
    return whirls_of(floor, settings=SETTINGS)[1]


def _fit(rotor, seed):
    campbell = whirling_campbell(rotor, seed)
    orders = no_orders(campbell)
    orders = orders.assign_coords(unit=("channel", ["m/s²"] * orders.sizes["channel"]))
    return modal_fit(campbell, orders, (), settings=SETTINGS)


def _drawn(seed):
    """A rotor with one whirl of random frequency, slope, damping and loudness, and a mode that stays."""
    random = np.random.default_rng([seed, 14])
    slope = float(random.choice([-1.0, 1.0]) * np.exp(random.uniform(np.log(0.1), np.log(0.6))))
    hz = float(random.uniform(70.0, 110.0)) - slope * 2500.0 / 60.0
    damping = float(np.exp(random.uniform(np.log(0.004), np.log(0.02))))
    whirl = Moving(hz=hz, slope=slope, damping=damping, gain=tuple(random.uniform(0.3, 1.0, 2)))
    fixed = Moving(hz=float(random.uniform(30.0, 180.0)), slope=0.0, damping=float(random.uniform(0.005, 0.03)))
    return Rotor(modes=(whirl, fixed), noise=float(random.uniform(0.02, 0.15)))


def _off(seed):
    """By how many of its errors the one whirl that is found of a drawn rotor is off: frequency, slope, damping."""
    rotor = _drawn(seed)
    found = _whirls(rotor, seed)
    assert len(found) == 1, (seed, rotor, found)
    true, one = rotor.modes[0], found[0]
    return [
        (one.frequency_hz - true.at(one.reference_rpm)) / one.frequency_error_hz,
        (one.slope - true.slope) / one.slope_error,
        (one.damping_ratio - true.damping) / one.damping_error,
    ]


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(6))
def test_the_whirl_of_a_drawn_rotor_is_found_and_none_else(seed):
    assert np.abs(_off(seed)).max() < 4.5


@pytest.mark.accuracy
def test_whirls_of_drawn_rotors_are_found_within_their_errors_and_none_else():
    off = [value for seed in range(24) for value in _off(seed)]
    assert np.abs(off).max() < 4.5
    assert np.mean(np.abs(off) < 1.96) > 0.86  # of 72: 95 % less three standard errors
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.35


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(3))
def test_forward_and_backward_whirl_of_one_mode_are_told_beside_modes_that_stay(seed):
    fit = _fit(Rotor(modes=(FORWARD, BACKWARD, *STAYS)), seed)
    assert len(fit.whirls) == 2
    for one, true in zip(fit.whirls, (BACKWARD, FORWARD), strict=True):
        assert abs(one.slope - true.slope) < 4.0 * one.slope_error < 0.03
        assert abs(one.frequency_hz - true.at(2500.0)) < 4.0 * one.frequency_error_hz < 0.5
    assert [round(mode.frequency_hz) for mode in fit.modes] == [61, 90]
    assert not any(mode.undecided for mode in fit.modes)


@pytest.mark.parametrize("seeds", [range(6), pytest.param(range(6, 60), marks=pytest.mark.slow)])
def test_drawn_modes_that_stay_while_their_levels_change_make_no_whirl(seeds):
    for seed in seeds:
        random = np.random.default_rng([seed, 77])
        modes = []
        for _ in range(int(random.integers(2, 6))):
            hz, damping = float(random.uniform(20.0, 190.0)), float(np.exp(random.uniform(np.log(0.002), np.log(0.08))))
            modes.append(Moving(hz=hz, slope=0.0, damping=damping, gain=tuple(random.uniform(0.2, 1.0, 2))))
        growth, noise = float(random.uniform(-1.0, 4.0)), float(random.uniform(0.02, 0.3))
        speeds = tuple(np.linspace(1000.0, 4000.0, int(random.integers(6, 30))))
        rotor = Rotor(modes=tuple(modes), growth=growth, noise=noise, speed_rpm=speeds, duration_s=8.0)
        assert not _whirls(rotor, seed), seed


AT = [(0.0, 0.73), (0.0, 0.48), (100.0, -1.0), (50.0, 1.0), (50.0, 0.5)]
LINES = [Moving(hz=hz, slope=slope, damping=1e-5) for hz, slope in AT]
NO_WHIRLS = {
    "noise": [Rotor(modes=(), duration_s=4.0 + seed) for seed in range(0, 12, 2)],
    "orders that nobody named, and sidebands": [Rotor(modes=(line, STAYS[0])) for line in LINES],
    "few speeds": [Rotor(modes=(FORWARD,), speed_rpm=tuple(np.linspace(1000.0, 4000.0, 5)))],
    "speeds close together": [Rotor(modes=(FORWARD,), speed_rpm=tuple(np.linspace(3600.0, 4000.0, 9)))],
}


@pytest.mark.cases(1)
@pytest.mark.parametrize("rotors", NO_WHIRLS.values(), ids=NO_WHIRLS)
def test_noise_orders_sidebands_and_too_few_speeds_make_no_whirl(rotors):
    assert [rotor for seed, rotor in enumerate(rotors) if _whirls(rotor, seed)] == []


def _known(slope, *, hz=60.0, damping=0.02):
    return Whirl(2500.0, hz + slope * 2500.0 / 60.0, 0.03, slope, 0.002, 0.0, damping, 0.001, ("A",), 20.0, "moves")


def _through(order, whirl):
    """Amplitude of an order whose force grows with speed squared, past a rigid body and ``whirl``."""
    x = order * TRACK / 60.0 / (whirl.frequency_hz + whirl.slope * (TRACK - whirl.reference_rpm) / 60.0)
    response = 1.0 + x**2 / (1.0 - x**2 + 2j * whirl.damping_ratio * x)
    return np.asarray((TRACK / 1000.0) ** 2 * np.abs(response))


TRACK = np.arange(1000.0, 4001.0, 50.0)
RANGE = (1000.0, 4000.0)


@pytest.mark.cases(2)
@pytest.mark.parametrize("slope", [0.12, -0.2, 0.35])
@pytest.mark.parametrize("order", [1.0, 2.0])
def test_an_order_meets_a_whirl_where_both_have_one_frequency_and_the_speed_is_not_free(slope, order):
    whirl = _known(slope, hz=40.0)
    rpm = 60.0 * 40.0 / (order - slope)
    assert whirl.line_at(rpm) == pytest.approx(order * rpm / 60.0)
    orders = (agreed(order, line(order, _through(order, whirl), speed_rpm=TRACK)),)
    modal = fit(whirls=(whirl,))
    (crossing,) = crossings(orders, modal, speed_rpm=RANGE, settings=SETTINGS)
    met = crossing.finding
    assert met.rpm == pytest.approx(rpm) and met.rpm_ci95[0] < rpm < met.rpm_ci95[1]
    assert met.mode_hz == pytest.approx(order * rpm / 60.0)
    assert met.evidence.startswith(f"a whirl that moves by {slope:.3g} orders")
    said = speeds_to_avoid([crossing], orders, modal, speed_rpm=RANGE, unit={"A": "g"}, settings=SETTINGS)
    if not RANGE[0] < rpm < RANGE[1]:
        assert met.verdict == "outside the tested range"
        return
    assert met.verdict == "excited"
    assert said.avoid[0].rpm == pytest.approx(rpm)
    amplified = _through(order, whirl) / (TRACK / 1000.0) ** 2 > 3.0
    dangerous = np.append(TRACK[amplified], rpm * np.array([0.97, 1.0, 1.03]))
    assert not any(band.low_rpm < one < band.high_rpm for band in said.free for one in dangerous)


@pytest.mark.slow
def test_an_undecided_crossing_of_a_whirl_is_open_and_never_free():
    whirl = _known(0.12, hz=40.0, damping=0.002)
    coarse = np.arange(1000.0, 4001.0, 400.0)
    orders = (agreed(1.0, line(1.0, (coarse / 1000.0) ** 2, speed_rpm=coarse)),)
    unseen = (UnseenBound(1.0, TRACK, np.ones(len(TRACK))),)
    modal = fit(whirls=(whirl,), unseen=unseen)
    (crossing,) = crossings(orders, modal, speed_rpm=RANGE, settings=SETTINGS)
    met = crossing.finding
    assert met.verdict in ("not measured", "not decided")
    said = speeds_to_avoid([crossing], orders, modal, speed_rpm=RANGE, unit={"A": "g"}, settings=SETTINGS)
    assert said.free, "far from the whirl the speeds are free"
    assert not any(band.low_rpm < met.rpm * 1.03 and band.high_rpm > met.rpm * 0.97 for band in said.free)
    assert any("whirl" in band.remark for band in said.open)


@pytest.mark.slow
def test_a_stated_order_that_was_not_seen_meets_the_whirl_too():
    (crossing,) = crossings((), fit(whirls=(_known(-0.1),)), speed_rpm=RANGE, settings=SETTINGS, stated=(2.0,))
    met = crossing.finding
    assert met.verdict == "not measured" and met.rpm == pytest.approx(60.0 * 60.0 / 2.1)


@pytest.mark.slow
def test_a_mode_that_orders_alone_show_where_they_meet_a_whirl_and_a_hump_on_its_path_are_that_whirl():
    whirl = _known(0.12, hz=40.0)
    rpm = whirl.meets(1.0)
    assert rpm is not None
    seen = Mode(rpm / 60.0 + 0.1, 0.05, 0.023, 0.001, ("A",), 9.0, "orders", reached_by=(1.0,))
    other = Mode(120.0, 0.05, 0.02, 0.001, ("A",), 9.0, "orders", reached_by=(2.0,))
    hump = Mode(45.0, 0.5, 0.06, 0.01, ("A",), 9.0, "the floor", undecided="wide")
    kept = without_remains(fit(seen, other, hump), (whirl,), TRACK)
    assert kept.modes == (other,) and kept.covariance.shape == (2, 2) and kept.whirls == (whirl,)
    doubted = without_remains(fit(replace(hump, undecided="")), (whirl,), TRACK)
    assert "may be what the whirl leaves" in doubted.modes[0].undecided


def test_records_and_sentences_tell_the_whirl():
    (record,) = mode_records(fit(whirls=(_known(-0.12),)), Causes({}, (), ()), [])
    assert record["explained_by"] == "whirl" and record["reference_rpm"] == 2500.0
    assert record["speed_slope_ci95"][0] < -0.12 < record["speed_slope_ci95"][1]
    sentence = "Backward whirl: 55 Hz at 2500 rpm, falling by 0.12 orders."
    assert from_dicts(mode_sentences)({"modes": [record]}) == [sentence]


def _rotor_test(seed):
    """Findings of a rotor whose unbalance drives its forward whirl at stepped speeds, by the program's own maps."""
    random = np.random.default_rng([seed, 99])
    speeds, whole = tuple(np.arange(1500.0, 5001.0, 250.0)), load_settings()
    rotor = Rotor(modes=(FORWARD, STAYS[0]), noise=0.1, duration_s=10.0, speed_rpm=speeds)
    by_order, by_frequency = [], []
    for rpm in rotor.speed_rpm:
        values = signals(rotor, rpm, random)
        u = rpm / 60.0 / float(FORWARD.at(rpm))
        through = 0.2 * (rpm / 3000.0) ** 2 * (1.0 + u**2 / (1.0 - u**2 + 2j * FORWARD.damping * u))
        rows = zip(values, through * np.array(FORWARD.gain), strict=True)
        names = [lambda t, a, row=row, c=c: row + np.real(c * np.exp(2j * np.pi * a)) for row, c in rows]
        band, shaft = steady(names, speed_rpm=rpm, duration_s=rotor.duration_s, rate_hz=rotor.rate_hz)
        by_frequency.append(frequency_frames(band, shaft, settings=whole.campbell))
        by_order.append(order_frames(band, shaft, settings=whole.orders))
    orders = order_map(by_order, settings=whole.orders)
    campbell = campbell_map(by_frequency, speed_bin_rpm=whole.orders.speed_bin_rpm)
    return find(
        Measured(orders, campbell, by_order), test="rotor", sources=MachineModel(revs_per_cycle=1), settings=whole
    )


def test_a_rotor_that_unbalance_drives_through_its_forward_whirl_is_told_to_avoid_that_speed():
    findings = _rotor_test(3)
    whirls = [mode for mode in findings["modes"] if mode["explained_by"] == "whirl"]
    assert len(whirls) == 1
    low, high = whirls[0]["speed_slope_ci95"]
    assert 0.1 < low < high < 0.14
    rpm = 60.0 * FORWARD.hz / (1.0 - FORWARD.slope)
    met = [one for one in findings["crossings"] if one["excited"] and one["order"] == pytest.approx(1.0, abs=1e-3)]
    assert any(one["rpm"] == pytest.approx(rpm, rel=3e-3) for one in met)
    assert any(low <= rpm <= high for low, high in (one["rpm_range"] for one in findings["speeds_to_avoid"]))
    free = [(one["low_rpm"], one["high_rpm"]) for one in findings["free_bands"]]
    assert not any(low < 1.03 * rpm and high > 0.97 * rpm for low, high in free)
