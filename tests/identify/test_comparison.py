"""Two made tests side by side: intervals that cover, claims that are true, and nothing where nothing changed."""

from dataclasses import replace

import numpy as np
import pytest

from crankorder.findings import BearingFinding, OrderFinding
from crankorder.identify.compared import compared
from crankorder.identify.order_changes import Line, OrderChange, like_speeds, orders_to_compare
from made.two_tests import SPEEDS_RPM, made_test
from made.typed import record_of

Q = 0.05
BASE = {1.0: lambda rpm: 0.5 * (rpm / 1000) ** 2, 2.0: lambda rpm: 0.3j, 5.5: lambda rpm: 0.4}


def measured(rng, true, *, frames=6, scatter=1.0):
    """Line whose phasors are means of ``frames``, with the error that their scatter says."""
    shape = (frames, *np.shape(true))
    each = true + scatter * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    mean = each.mean(axis=0)
    spread = np.sum(np.abs(each - mean) ** 2, axis=0) / (2 * (frames - 1))
    error = np.sqrt(spread / frames)
    freedom = np.full(np.shape(true), 2.0 * (frames - 1))
    return Line(np.abs(mean), error, freedom, mean, error, error)


def test_speeds_are_matched_nearest_first_and_none_is_used_twice():
    one, two = like_speeds(np.array([1000.0, 1010.0, 2000.0]), np.array([1012.0, 1500.0, np.nan]), within_rpm=25.0)
    assert (one.tolist(), two.tolist()) == ([1], [0])
    one, two = like_speeds(np.array([np.nan]), np.array([np.nan]), within_rpm=25.0)
    assert (one.tolist(), two.tolist()) == ([0], [0])


def test_orders_within_their_intervals_are_one_and_a_slipping_one_is_not_locked():
    def record(order, half, lock="locked"):
        return record_of(OrderFinding, {"order": order, "order_ci95": [order - half, order + half], "lock": lock})

    found = orders_to_compare([record(1.01, 0.02), record(5.47, 0.001, "slips")], [record(5.475, 0.001)], 20.0)
    assert found == [(1.0, True), (2.0, True), (5.47, False)]


def test_intervals_of_difference_and_ratio_cover_and_p_values_are_uniform_where_nothing_changed():
    rng, n = np.random.default_rng(1), 4000
    true = np.full(n, 12.0 + 5.0j)
    made = OrderChange(np.ones(n), np.ones(n), measured(rng, true), measured(rng, true, frames=9))
    for low, high in (made.difference_ci95.T, made.ratio_db_ci95.T):
        assert np.mean((low <= 0) & (high >= 0)) == pytest.approx(0.95, abs=0.012)
    for level in (0.05, 0.5):
        assert np.mean(made.p_value <= level) == pytest.approx(level, abs=3.5 * np.sqrt(level / n))


def test_the_mean_ratio_over_speeds_covers_the_truth_whatever_the_noise_of_each_speed():
    rng, n, inside = np.random.default_rng(2), 800, 0
    true = np.array([3.0, 6.0, 10.0, 20.0]) * np.exp(1j * np.arange(4))
    for _ in range(n):
        lines = measured(rng, true, scatter=0.8), measured(rng, 2.0 * true, scatter=0.8)
        low, high = OrderChange(np.ones(4), np.ones(4), *lines).mean.ci95_db
        inside += low <= 20 * np.log10(2.0) <= high
    assert inside / n == pytest.approx(0.95, abs=0.025)


def test_an_amplitude_that_drowns_has_an_interval_down_to_nothing():
    base, new = (Line(np.array([a]), np.array([1.0]), np.array([8.0]), *[np.array([np.nan])] * 2) for a in (20.0, 1.0))
    made = OrderChange(np.ones(1), np.ones(1), base, new)
    assert made.ratio_db_ci95[0, 0] == -np.inf and made.ratio_db_ci95[0, 1] < 0
    assert np.isnan(made.mean.ratio_db) and made.p_all < 1e-4


@pytest.fixture(scope="module")
def base():
    return made_test(BASE, name="base", seed=1)


def test_the_line_that_doubled_is_named_and_nothing_else(base):
    new = made_test({**BASE, 5.5: lambda rpm: 0.8}, name="doubled", seed=2)
    document = compared([base, new], q=Q).document
    (record,) = [record for record in document.orders if record.changed]
    assert record.order == 5.5 and record.ratio_ci95[0] < 2.0 < record.ratio_ci95[1]
    assert record.n_changed == len(SPEEDS_RPM)
    assert (document.cause.cause, document.cause.orders) == ("orders", (5.5,))


def test_a_test_beside_itself_differs_in_nothing(base):
    document = compared([base, base], q=Q).document
    assert document.cause.cause == "nothing changed"
    assert not any(record.changed or record.difference for record in document.orders)
    assert {record.p_value for record in document.orders} == {1.0}


def test_a_phasor_that_turned_is_a_change_though_its_amplitude_is_not(base):
    new = made_test({**BASE, 1.0: lambda rpm: 0.5j * (rpm / 1000) ** 2}, name="turned", seed=3)
    (changed,) = [record for record in compared([base, new], q=Q).document.orders if record.changed]
    assert changed.order == 1.0 and changed.ratio_ci95[0] < 1 < changed.ratio_ci95[1]


@pytest.mark.parametrize("seed", range(3))
def test_a_phase_alone_that_turned_at_one_speed_of_four_is_the_marks_of_that_recording(seed):
    at = np.random.default_rng(seed).choice(SPEEDS_RPM)
    turned = BASE | {2.0: lambda rpm: 0.3j * (np.exp(0.3j) if rpm == at else 1.0)}
    made = [made_test(lines, name=f"{at} {seed}", seed=2 * seed + new) for new, lines in enumerate((BASE, turned))]
    document, _ = compared(made, q=Q)
    assert document.cause.cause == "nothing changed" and min(record.p_value for record in document.orders) < 1e-4


def test_modes_that_moved_are_claimed_and_those_of_one_test_are_not(base):
    def modes(*places_hz, half=0.2):
        damping = {"damping_ratio": 0.01, "damping_ratio_ci95": [0.009, 0.011], "explained_by": "mode"}
        return [{"frequency_hz": hz, "frequency_hz_ci95": [hz - half, hz + half], **damping} for hz in places_hz]

    one = made_test(BASE, name="one", modes=modes(115.0, 172.0, 187.0))
    two = made_test(BASE, name="two", modes=modes(116.5, 172.1))
    records = {round(mode.frequency_hz): mode for mode in compared([one, two], q=Q).document.modes}
    assert records[115].changed and records[115].shift_hz == pytest.approx(1.5)
    assert records[115].shift_hz_ci95 == pytest.approx([1.5 - 0.2828, 1.5 + 0.2828], abs=0.01)
    assert not records[172].changed
    assert records[187].only_in == "base" and not records[187].changed
    for share in (-0.0015, 0.0015, 0.0025):  # what temperature moves is no other stiffness, however well it is known
        exact = [made_test(BASE, name=str(hz), modes=modes(hz, half=0.001)) for hz in (200.0, 200.0 * (1.0 + share))]
        assert compared(exact, q=Q).document.modes[0].changed == (share > 0.002)


@pytest.mark.parametrize("seed", range(6))
def test_mains_of_another_phase_are_no_change_and_a_change_at_other_speeds_is_found(seed):
    order, rpm = ((1.0, 3000.0), (2.0, 1500.0))[seed % 2]
    lines, other = (
        {1.0: BASE[1.0], 5.5: BASE[5.5], order: lambda rpm: 0.3j},
        {"mains": 0.4, "speeds": (900.0, 1200.0, rpm)},
    )
    base, same = (made_test(lines, seed=60 + 10 * seed + k, **other) for k in (0, 1))
    document = compared([base, same], q=0.01).document
    assert document.cause.cause == "nothing changed"
    (met,) = [record for record in document.orders if record.undecided_rpm]
    assert (met.order, met.hidden_by) == (order, "mains") and met.undecided_rpm == pytest.approx((rpm,), abs=1.0)
    more = made_test({**lines, order: lambda rpm: 0.5j}, seed=65 + 10 * seed, **other)
    (changed,) = [record for record in compared([base, more], q=0.01).document.orders if record.changed]
    assert changed.order == order and changed.ratio_ci95[0] < 0.5 / 0.3 < changed.ratio_ci95[1]


def on_a_mode(rng, hz, unbalance=1.0):
    """Lines of orders that a mode shapes, and what the findings say of it; the path is that of ``rng``."""
    phases, sizes = np.exp(2j * np.pi * rng.random(3)), 0.4 + 0.4 * rng.random(3)

    def response(order, k):
        def ratio(rpm):
            return order * rpm / 60 / hz

        size = sizes[k] * phases[k] * (unbalance if order == 1.0 else 1.0)
        return lambda rpm: size * (rpm / 1000) ** 2 / (1 - ratio(rpm) ** 2 + 0.04j * ratio(rpm))

    ends = {"frequency_hz_ci95": [hz - 0.2, hz + 0.2], "damping_ratio_ci95": [0.018, 0.022]}
    mode = {"frequency_hz": hz, "damping_ratio": 0.02, "explained_by": "mode", **ends}
    return {order: response(order, k) for k, order in enumerate((1.0, 3.0, 4.0))}, [mode]


@pytest.mark.parametrize("seed", range(5))
def test_what_orders_change_as_a_natural_frequency_moves_is_put_down_to_it_and_an_unbalance_is_not(seed):
    hz, share = np.random.default_rng(seed).uniform((55.0, 0.02), (130.0, 0.04)) * (1, (-1) ** seed)
    places = ((hz, 1.0), (hz * (1 + share), 1.0), (hz * (1 + share), 1.5))
    machines = [on_a_mode(np.random.default_rng(seed), *place) for place in places]
    base, moved, both = (made_test(of, modes=mode, seed=130 + 3 * seed + k) for k, (of, mode) in enumerate(machines))
    document = compared([base, moved], q=0.01).document
    assert (document.cause.cause, document.cause.orders) == ("natural frequencies", ())
    cause = compared([base, both], q=0.01).document.cause
    assert (cause.cause, cause.orders) == ("natural frequencies", (1.0,)) and cause.besides is not None


def test_a_gain_of_one_channel_is_told_from_the_machine_and_its_interval_covers():
    covered = []
    for seed in range(8):
        gain = float(np.random.default_rng(seed).choice([0.9, 1.06]))
        base, new = (
            made_test(BASE, channels="AB", seed=170 + 2 * seed + k, gains=(1.0, g)) for k, g in enumerate((1, gain))
        )
        document = compared([base, new], q=0.01).document
        told = {channel.name: channel.gain_ci95 for channel in document.channels if channel.gain}
        assert document.cause.cause == "gain" and set(told) == {"B"}
        covered.append(told["B"][0] < gain < told["B"][1])
    assert sum(covered) >= 6  # by 95 % each, in all but six of a thousand such tests


def test_a_bearing_line_that_grows_from_run_to_run_is_the_cause_where_no_order_changed():
    runs = []
    for number in range(4):
        test = made_test({1.0: lambda rpm: 0.5}, name=f"run {number}", seed=40 + number, speeds=SPEEDS_RPM[:2])
        size = 0.02 * 1.5**number
        told = {
            "name": "jack shaft", "line": "BPFO", "order": 2.183, "channel": "A", "seen_in": "vibration",
            "amplitude": size, "amplitude_ci95": [0.9 * size, 1.1 * size],
        }  # fmt: skip
        findings = replace(test.findings, bearings=(record_of(BearingFinding, told),))
        runs.append(replace(test, findings=findings))
    document = compared(runs, q=0.01).document
    assert (document.cause.cause, document.cause.orders) == ("growing line", (2.183,))
    (record,) = [trend for trend in document.trend if trend.changed]
    assert record.line == "jack shaft BPFO"
    assert record.growth_per_run_ci95[0] < 0.5 < record.growth_per_run_ci95[1]
    two = compared(runs[:2], q=0.01).document.trend  # of two runs only bearing lines: orders are compared already
    assert {trend.kind for trend in two} <= {"bearing", "bearing, envelope"}
