"""Whirl modes: resonances whose natural frequency moves with the speed, told from modes that stay and from orders."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.signal import lfilter, welch

from crankorder.identify.crossings import crossings
from crankorder.identify.explain import Causes
from crankorder.identify.findings import mode_records
from crankorder.identify.found import Mode, UnseenBound, Whirl
from crankorder.identify.modes.floor import quiet_floor
from crankorder.identify.modes.joint_fit import modal_fit
from crankorder.identify.modes.whirl import whirls_of, without_remains
from crankorder.identify.speeds_to_avoid import speeds_to_avoid
from crankorder.report.sentences.of_lines import mode_sentences
from made.floors import campbell_map_of, no_orders
from made.found_lines import agreed, fit, line
from made.shipped import IDENTIFY
from made.typed import as_dicts, from_dicts

RATE_HZ, N_FRAME = 512.0, 1024


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
    noise: float = 0.02
    growth: float = 0.0


def _filtered(force, hz, damping):
    """Velocity of an oscillator of unit half-power height under ``force``, its impulse response sampled."""
    sigma, turn = damping * 2.0 * np.pi * hz / RATE_HZ, 2.0 * np.pi * hz * np.sqrt(1.0 - damping**2) / RATE_HZ
    keep = np.exp(-sigma)
    decay = keep * np.cos(turn)
    return np.asarray(lfilter([2.0 * sigma, -2.0 * sigma * decay], [1.0, -2.0 * decay, keep**2], force))


def whirling_campbell(rotor, seed):
    """CampbellMap of ``rotor`` behind the noise of ``seed``."""
    random, n_samples, lead = np.random.default_rng(seed), round(rotor.duration_s * RATE_HZ), round(2.0 * RATE_HZ)
    psd = []
    for rpm in rotor.speed_rpm:
        made = rotor.noise * random.standard_normal((len(rotor.modes[0].gain) if rotor.modes else 2, n_samples))
        for mode in rotor.modes:
            force = random.standard_normal(n_samples + lead) * (rpm / 2000.0) ** rotor.growth
            made += np.array(mode.gain)[:, None] * _filtered(force, float(mode.at(rpm)), mode.damping)[lead:]
        psd.append(welch(made, RATE_HZ, "hann", N_FRAME, detrend=False)[1][:, : round(0.45 * N_FRAME)])
    n_frames = (n_samples - N_FRAME) // (N_FRAME // 2) + 1
    return campbell_map_of(np.stack(psd, axis=1), n_frames, rotor.speed_rpm, RATE_HZ / N_FRAME)


mode_records = as_dicts(mode_records)

FORWARD = Moving(hz=56.0, slope=0.12, damping=0.02)
BACKWARD = Moving(hz=56.0, slope=-0.1, damping=0.02)
STAYS = (Moving(hz=90.0, slope=0.0, damping=0.02), Moving(hz=61.0, slope=0.0, damping=0.01))


def _whirls(rotor, seed):
    floor = quiet_floor(whirling_campbell(rotor, seed), ())
    return whirls_of(floor, settings=IDENTIFY)[1]


def _fit(rotor, seed):
    campbell = whirling_campbell(rotor, seed)
    orders = no_orders(campbell)
    orders = orders.assign_coords(unit=("channel", ["m/s²"] * orders.sizes["channel"]))
    return modal_fit(campbell, orders, (), settings=IDENTIFY)


def test_a_steep_whirl_in_noise_is_found_within_its_errors_and_none_else():
    true = Moving(hz=69.0, slope=0.5, damping=0.006, gain=(0.4, 0.9))
    (found,) = _whirls(Rotor(modes=(true, STAYS[1]), noise=0.12), 0)
    assert abs(found.frequency_hz - true.at(found.reference_rpm)) < 4.5 * found.frequency_error_hz
    assert abs(found.slope - true.slope) < 4.5 * found.slope_error
    assert abs(found.damping_ratio - true.damping) < 4.5 * found.damping_error


def test_forward_and_backward_whirl_of_one_mode_are_told_beside_modes_that_stay():
    fit = _fit(Rotor(modes=(FORWARD, BACKWARD, *STAYS)), 0)
    assert len(fit.whirls) == 2
    for one, true in zip(fit.whirls, (BACKWARD, FORWARD), strict=True):
        assert abs(one.slope - true.slope) < 4.0 * one.slope_error < 0.03
        assert abs(one.frequency_hz - true.at(2500.0)) < 4.0 * one.frequency_error_hz < 0.5
    assert [round(mode.frequency_hz) for mode in fit.modes] == [61, 90]
    assert not any(mode.undecided for mode in fit.modes)


def test_drawn_modes_that_stay_while_their_levels_change_make_no_whirl():
    for seed in range(6):
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


@pytest.mark.parametrize(("slope", "order"), [(0.12, 1.0), (-0.2, 1.0), (0.35, 2.0)])
def test_an_order_meets_a_whirl_where_both_have_one_frequency_and_the_speed_is_not_free(slope, order):
    whirl = _known(slope, hz=40.0)
    rpm = 60.0 * 40.0 / (order - slope)
    assert whirl.line_at(rpm) == pytest.approx(order * rpm / 60.0)
    orders = (agreed(order, line(order, _through(order, whirl), speed_rpm=TRACK)),)
    modal = fit(whirls=(whirl,))
    (crossing,) = crossings(orders, modal, speed_rpm=RANGE, settings=IDENTIFY)
    met = crossing.finding
    assert met.rpm == pytest.approx(rpm) and met.rpm_ci95[0] < rpm < met.rpm_ci95[1]
    assert met.mode_hz == pytest.approx(order * rpm / 60.0)
    assert met.evidence.startswith(f"a whirl that moves by {slope:.3g} orders")
    said = speeds_to_avoid([crossing], orders, modal, speed_rpm=RANGE, unit={"A": "g"}, settings=IDENTIFY)
    if not RANGE[0] < rpm < RANGE[1]:
        assert met.verdict == "outside the tested range"
        return
    assert met.verdict == "excited"
    assert said.avoid[0].rpm == pytest.approx(rpm)
    amplified = _through(order, whirl) / (TRACK / 1000.0) ** 2 > 3.0
    dangerous = np.append(TRACK[amplified], rpm * np.array([0.97, 1.0, 1.03]))
    assert not any(band.low_rpm < one < band.high_rpm for band in said.free for one in dangerous)


def test_an_undecided_crossing_of_a_whirl_is_open_and_never_free():
    whirl = _known(0.12, hz=40.0, damping=0.002)
    coarse = np.arange(1000.0, 4001.0, 400.0)
    orders = (agreed(1.0, line(1.0, (coarse / 1000.0) ** 2, speed_rpm=coarse)),)
    unseen = (UnseenBound(1.0, TRACK, np.ones(len(TRACK))),)
    modal = fit(whirls=(whirl,), unseen=unseen)
    (crossing,) = crossings(orders, modal, speed_rpm=RANGE, settings=IDENTIFY)
    met = crossing.finding
    assert met.verdict in ("not measured", "not decided")
    said = speeds_to_avoid([crossing], orders, modal, speed_rpm=RANGE, unit={"A": "g"}, settings=IDENTIFY)
    assert said.free, "far from the whirl the speeds are free"
    assert not any(band.low_rpm < met.rpm * 1.03 and band.high_rpm > met.rpm * 0.97 for band in said.free)
    assert any("whirl" in band.remark for band in said.open)


def test_a_stated_order_that_was_not_seen_meets_the_whirl_too():
    (crossing,) = crossings((), fit(whirls=(_known(-0.1),)), speed_rpm=RANGE, settings=IDENTIFY, stated=(2.0,))
    met = crossing.finding
    assert met.verdict == "not measured" and met.rpm == pytest.approx(60.0 * 60.0 / 2.1)


def test_a_mode_that_orders_alone_show_where_they_meet_a_whirl_and_a_hump_on_its_path_are_that_whirl():
    whirl = _known(0.12, hz=40.0)
    rpm = whirl.meets(1.0)
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
