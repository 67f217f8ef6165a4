"""Order lines: none vanishes in silence, none of fixed frequency passes for an order, slipping ones are seen."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from crankorder.identify.found import AgreedOrder, ModalFit
from crankorder.identify.lines.followed_orders import track_number
from crankorder.identify.lines.growth import Largest
from crankorder.identify.lines.line_evidence import is_steady
from crankorder.identify.lines.order_lines import order_lines
from crankorder.identify.modes.order_responses import Force
from crankorder.identify.modes.responses import held_peak
from crankorder.orders.map import order_map
from crankorder.orders.track_rows import track_order
from made.found_lines import fit, made_response, mode
from made.line_frames import PER_REV, agreed_in, angle_of, frames_of, wave
from made.shipped import SETTINGS

SPEEDS = np.arange(600.0, 1800.0, 50.0)


def lines_of(signal, *, speeds=SPEEDS, revs=120):
    """Lines of a test whose signal at a speed is ``signal(angle, rpm)`` beside white noise of unit power."""
    rng, frames, angle = np.random.default_rng(7), [], angle_of(revs)
    for rpm in speeds:
        frames.append(frames_of([signal(angle, rpm) + rng.standard_normal(len(angle))], speed_rpm=rpm))
    made = order_map(frames, settings=SETTINGS.orders)
    return order_lines(made, settings=SETTINGS.identify, orders=SETTINGS.orders, frames=frames)


def test_a_line_at_one_speed_of_many_is_kept_with_its_doubt():
    (line,) = lines_of(lambda angle, rpm: wave(angle, 4.0, 1.0 if rpm == 1200.0 else 0.0))
    assert (len(line.seen), float(line.speed_rpm[0])) == (1, 1200.0)
    assert [doubt.words for doubt in line.doubts] == ["seen at 1 of 24 speeds only"]


def test_a_tone_of_fixed_frequency_is_no_order_though_it_meets_one():
    # 60 Hz is order 3 at 1200 rpm exactly, where it is as steady as an order
    assert lines_of(lambda angle, rpm: wave(angle, 3600.0 / rpm, 1.0)) == []


def one_speed(signal, *, channels=1):
    """Lines of a test at 2000 rpm, ten frames of which are worth no more than that, in so many ``channels``."""
    signals = [signal(angle_of(92), k) for k in range(channels)]
    frames = [frames_of(signals, speed_rpm=2000.0, pulses=False)]
    made = order_map(frames, settings=SETTINGS.orders)
    return made, order_lines(made, settings=SETTINGS.identify, orders=SETTINGS.orders, frames=frames)


def test_a_line_whose_speed_drifts_is_seen_in_ten_frames_by_its_steadiness_and_with_its_doubt():
    """As in a gearbox whose speed is nominal: the phase turns by 72 degrees to and fro, over ten frames."""

    def drifting(angle, channel):
        slow = 0.2 * np.sin(2 * np.pi * angle / 70.0)
        noise = np.random.default_rng(channel).standard_normal(len(angle))
        return wave(angle, 19.0, 3.0, 2 * np.pi * slow) + noise

    made, (line,) = one_speed(drifting)
    assert made.sizes["speed"] == 1 and made["n_independent"].item() < 12.0
    assert line.order == pytest.approx(19.0, abs=0.03)
    assert line.evidence == "steady, not locked"
    assert "one speed" in [doubt.kind for doubt in line.doubts]


def test_no_resonance_that_noise_excites_is_as_steady_as_a_line_at_one_speed():
    """A hundred channels of ten frames each, on order 15.06: a phasor that forgets itself as that damping makes it."""
    rng = np.random.default_rng(10)
    per_rev = np.exp(-2.0 * np.pi * 1e-4 * 15.06 / PER_REV)

    def ringing(angle, channel):
        steps = rng.standard_normal((2, len(angle)))
        drive = (steps[0] + 1j * steps[1]) * np.sqrt(0.5 * (1.0 - per_rev**2))
        drive[0] = complex(*rng.standard_normal(2)) * np.sqrt(0.5)
        phasor = lfilter([1.0], [1.0, -per_rev], drive)
        return (4.0 * phasor * np.exp(2j * np.pi * 15.06 * angle)).real + rng.standard_normal(len(angle))

    made, _ = one_speed(ringing, channels=100)
    peak = int(np.argmin(np.abs(made["order"].values - 15.0625)))
    steady = sum(is_steady(made, k, peak, np.array([0]), 1e-3) for k in range(100))
    assert steady <= 1


def test_an_order_that_stands_at_one_of_two_speeds_and_nearly_at_the_other_is_one_order_at_both():
    """At 1500 rpm order 8.5 stays just below the level, at 2000 rpm it is above: together noise does not make it."""
    found = 0
    for weak in (0.16, 0.2, 0.24, 0.28):
        lines = lines_of(
            lambda angle, rpm, weak=weak: wave(angle, 8.5, weak if rpm < 1600.0 else 0.5), speeds=[1500.0, 2000.0]
        )
        at = [line for line in lines if abs(line.order - 8.5) < 0.05]
        found += len(at) == 1 and len(at[0].seen) == 2
    assert found >= 3


def test_noise_at_few_speeds_makes_no_order_of_all_together():
    rng = np.random.default_rng(2)
    for _ in range(6):
        signal = [rng.standard_normal(120 * PER_REV) for _ in range(3)]
        noise = dict(zip((1500.0, 1750.0, 2000.0), signal, strict=True))
        assert lines_of(lambda angle, rpm, noise=noise: noise[rpm][: len(angle)], speeds=list(noise)) == []


def test_an_order_that_resonances_raise_at_some_speeds_is_none_of_all_together():
    """Noise excites modes: orders cross them at some of 35 speeds, and the last bin of the map sees flanks of them."""
    rng = np.random.default_rng(4)
    natural_hz, damping = np.exp(rng.uniform(np.log(50.0), np.log(500.0), 8)), rng.uniform(0.002, 0.012, 8)

    def ringing(angle, rpm):
        ratio = np.fft.rfftfreq(len(angle), 60.0 / (PER_REV * rpm))[:, None] / natural_hz
        path = 0.3 + (1.0 / (1.0 - ratio**2 + 2j * damping * ratio)).sum(axis=1)
        return np.fft.irfft(path * np.fft.rfft(rng.standard_normal(len(angle))), len(angle))

    assert lines_of(ringing, speeds=np.arange(300.0, 2001.0, 50.0), revs=300) == []


# Lines whose amplitude changes while it is measured are seen by the phase that they keep; noise is not.


ONE, SEVERAL = (1500.0,), (1500.0, 1530.0, 1560.0)
STEPS = [
    (1.0, 0.5, 1.2, ONE), (5.5, 0.5, 2.0, ONE), (1.0, 0.5, 2.0, SEVERAL), (5.5, 0.3, 3.0, SEVERAL),
    (5.467, 0.5, 10.0, SEVERAL),
]  # fmt: skip


@pytest.mark.cases(len(STEPS))
@pytest.mark.parametrize(("order", "share", "factor", "speeds"), STEPS)
def test_an_order_whose_amplitude_changes_is_found_and_its_interval_reaches_over_what_it_held(
    order, share, factor, speeds
):
    rng, angle, frames = np.random.default_rng(int(100 * factor)), angle_of(250), []
    size = np.where(angle - angle[0] > share * 250, 3.0 * factor, 3.0)
    for rpm in speeds:
        signals = [size * wave(angle, order, 1.0, rng.uniform(0, 6)) + rng.standard_normal(len(angle))]
        frames.append(frames_of(signals, speed_rpm=rpm))
    (agreed,) = agreed_in(frames)
    assert agreed.order == pytest.approx(order, abs=0.02)
    assert agreed.lock == "slips" if order == 5.467 else agreed.lock != "slips"
    if factor == 2.0:
        (line,) = agreed.lines
        assert (line.ends[:, 0] < 1.03 * 3.0).all() and (line.ends[:, 1] > 0.97 * 3.0 * factor).all()


# Where an order is tracked, and how large a held speed would make it.


def test_an_order_whose_number_is_not_known_has_its_track_where_it_was_found():
    assert track_order(2.001, (1.99, 2.01), "undecided", revs_per_cycle=2) == 2.0
    assert track_order(2.02, (2.01, 2.03), "undecided", revs_per_cycle=2) == 2.02
    assert track_order(2.76, (2.48, 3.04), "undecided", revs_per_cycle=2) == 2.76
    assert track_order(2.001, (1.99, 2.01), "slips", revs_per_cycle=2) == 2.001


def test_a_line_between_multiples_is_read_where_it_stands_however_little_is_known_of_the_speed():
    slow = AgreedOrder(2.54, 0.033, 1e6, "undecided", None, (), own_error=1e-5)
    assert track_number(slow, revs_per_cycle=2) == 2.54
    assert track_number(replace(slow, own_error=0.03), revs_per_cycle=2) == 2.5
    assert track_number(replace(slow, order=2.50001), revs_per_cycle=2) == 2.5


def _response(*, recording="r1", fits=True, error=0.01):
    made = made_response(2.0, fit(mode(60.0, 0.01)), smooth=0.0, residue=[1.0], channel="X")
    covariance, force = np.diag([error**2, error**2]).astype(complex), Force(1800.0, (900.0, 3000.0), 0.0)
    return replace(made, force=force, covariance=covariance, error=error, fits=fits, recording=recording)


def _held(*responses, error=0.0, order=2.0, channel="X", size=1.0):
    modal = ModalFit((mode(60.0, 0.01),), (), np.diag([0.0, error**2]), responses or (_response(),))
    return held_peak(modal, order, channel, seen=Largest(0, 1800.0, size, size, size))


def test_a_held_order_reaches_what_its_mode_amplifies():
    peak, wider = _held(), _held(error=0.001)
    assert peak is not None and wider is not None
    assert peak.amplitude == pytest.approx(50.0, rel=2e-3)  # 1 / (2 damping)
    assert peak.rpm == pytest.approx(1800.0, rel=2e-3)
    assert wider.error == pytest.approx(np.hypot(5.0, 0.5), rel=2e-2)


def test_no_response_beside_the_largest_amplitude_says_anything_of_held_speeds():
    beside = replace(_response(recording="b", error=1e-9), force=Force(1800.0, (2500.0, 3000.0), 0.0))
    assert _held(_response(), beside) == _held()
    for silent in (beside, _response(recording=""), _response(fits=False)):
        assert _held(silent) is None
    assert _held(channel="Y") is None and _held(order=2.5) is None
    assert _held(size=60.0) is None  # no sweep makes an order larger
