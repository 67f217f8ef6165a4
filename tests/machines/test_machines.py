"""The drawn machines obey physics that is known otherwise: closed forms, an ODE solver, a hand calculation."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import csd, hilbert, welch

from machines.draw import CLASSES, draw_machine
from machines.folder import write_folder
from machines.machine import Encoder, Machine, Mode, Order, Profile, Swing
from machines.signals import as_read_by_angle, broadband, order_envelope, ringing, sample_times, swung_signal

STILL = Encoder("speed", "speed")


def one_mode(*, damping=0.02, profile=None, force_density=0.0):
    """A 60 Hz mode met by order 2 at 1800 rpm, one channel, no noise."""
    return Machine(
        class_name="run-up", seed=0, rate_hz=2000.0, channels=("X",), tones=(), mains_hz=50.0, steady=False,
        modes=(Mode(60.0, damping, (0.02 + 0j,), (1.0 + 0j,), (1.0,) if force_density else ()),),
        orders=(Order(2.0, 1.0, 0.5, 2.0, 30.0, 5.0, (0.01 + 0j,)),), encoder=STILL, noise_density=(0.0,),
        profiles=(profile or Profile((0.0, 4.0), (1500.0, 2100.0), 0.3),),
        force_density=(force_density,) if force_density else (),
    )  # fmt: skip


@pytest.mark.parametrize("rpm", [600.0, 1790.0, 1800.0, 4000.0])
def test_at_constant_speed_the_envelope_is_the_steady_response(rpm):
    machine = one_mode(profile=Profile((0.0, 2.0), (rpm, rpm), 0.7))
    envelope, _ = order_envelope(machine, machine.profiles[0], 0)
    np.testing.assert_allclose(envelope[0], machine.steady_response(0, rpm)[0, 0], rtol=1e-9)


@pytest.mark.cases(1)
@pytest.mark.parametrize(("rpm", "damping"), [((2600.0, 900.0), 0.03), ((900.0, 0.0), 0.01)])
def test_a_sweep_is_what_an_ode_solver_makes_of_it(rpm, damping):
    machine = one_mode(damping=damping, profile=Profile((0.0, 2.0), rpm, 0.3, 4.0, 0.7, 1.0))
    profile, mode, order = machine.profiles[0], machine.modes[0], machine.orders[0]
    natural = 2 * np.pi * mode.frequency_hz

    def force(t):
        at = np.array([t])
        size = order.force(np.maximum(profile.speed(at), 0.0))
        return float((size * np.exp(2j * np.pi * order.order * profile.angle(at)))[0].real)

    def moved(t, state):
        return [state[1], force(t) - 2 * damping * natural * state[1] - natural**2 * state[0]]

    # both start as if the first speed had always been
    jw = 2j * np.pi * order.order * profile.speed(np.zeros(1))[0] / 60.0
    turn = np.exp(2j * np.pi * order.order * profile.angle(np.zeros(1))[0])
    first = order.force(profile.speed(np.zeros(1)))[0] * turn
    place = first / (natural**2 + jw**2 + 2 * damping * natural * jw)
    time_s = sample_times(machine, profile)
    accuracy = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-13}
    solved = solve_ivp(moved, (0.0, 2.0), [place.real, (jw * place).real], t_eval=time_s, **accuracy)
    driven = np.array([force(t) for t in time_s])
    bent = driven - 2 * damping * natural * solved.y[1] - natural**2 * solved.y[0]
    envelope, carrier = order_envelope(machine, profile, 0)
    ours = (envelope[0] * carrier).real
    assert np.abs(ours - (0.02 * bent + 0.01 * driven)).max() < 1e-6 * np.abs(ours).max()


def test_what_rings_at_the_start_decays_as_the_mode_does():
    machine = replace(one_mode(damping=0.01), ring=(2.0,), rate_hz=4000.0)
    time_s = np.arange(8000) / machine.rate_hz
    size = np.abs(hilbert(ringing(machine, time_s, np.random.default_rng(3))[0]))
    inside = (time_s > 0.1) & (time_s < 1.0)
    slope, level = np.polyfit(time_s[inside], np.log(size[inside]), 1)
    assert slope == pytest.approx(machine.modes[0].pole.real, rel=0.01)
    assert np.exp(level) == pytest.approx(2.0, rel=0.02)


def test_the_angle_is_the_integral_of_the_speed():
    profile = Profile((0.0, 1.0, 1.5, 4.0), (900.0, 1500.0, 1200.0, 3000.0), 0.25, 7.0, 0.9, 0.4)
    time_s = np.linspace(0.0, 4.0, 400_001)
    speed = profile.speed(time_s) / 60.0
    summed = 0.25 + np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time_s))))
    np.testing.assert_allclose(profile.angle(time_s), summed, atol=1e-8)


SWUNG = Profile((0.0, 4.0), (1200.0, 1200.0), 0.3, swing=Swing(1.5, 0.01, 1200.0, 0.7))


def test_a_recording_of_a_swinging_shaft_starts_in_steady_running():
    """Amplitude and phase repeat from cycle to cycle: nothing rings from a start at rest."""
    machine = one_mode(damping=0.002, profile=SWUNG)
    envelope, _ = order_envelope(machine, SWUNG, 0)
    cycle = round(2.0 * 60.0 / 1200.0 * machine.rate_hz)
    assert np.ptp(np.abs(envelope[0, :cycle])) > 0.01 * np.abs(envelope[0, 0])
    for later in (1, 20):
        again = envelope[0, later * cycle : (later + 1) * cycle]
        np.testing.assert_allclose(again, envelope[0, :cycle], atol=1e-7 * np.abs(envelope).max())


def test_the_lines_of_a_swinging_shaft_are_those_of_its_signal_by_angle():
    """Against a Fourier series over whole cycles, on an even grid of angle that cubic splines give."""
    machine = replace(one_mode(profile=SWUNG), rate_hz=20000.0)
    envelope, carrier = order_envelope(machine, SWUNG, 0)
    swung = swung_signal(machine, SWUNG, [envelope])
    assert swung is not None
    (read,) = as_read_by_angle(machine, SWUNG, [envelope], swung)
    angle = SWUNG.angle(sample_times(machine, SWUNG))
    signal = CubicSpline(angle, (envelope[0] * carrier).real)
    grid = np.arange(39 * 2 * 512) / 512 + 1.0
    for order in (0.5, 2.0, 3.5):
        series = 2.0 * np.mean(signal(grid) * np.exp(-2j * np.pi * order * grid))
        assert swung.amplitude(order)[0] == pytest.approx(abs(series), abs=1e-6 * np.abs(envelope).max())
        if order == 2.0:
            assert read[0, 0] == pytest.approx(series, abs=1e-6 * np.abs(envelope).max())


@pytest.mark.parametrize("form", ["trace", "times"])
@pytest.mark.parametrize(
    ("wheel", "profile", "tick_s"),
    [
        (("36-1", "", 36, 1, False, 0.0, 1e7, 1e-3), replace(SWUNG, rpm=(900.0, 900.0)), 1e-7),
        (("60-2", "", 60, 2, False, 40.0, 1e6), Profile((0.0, 3.0), (600.0, 900.0), 0.41), 1e-6),
    ],
    ids=["uneven", "even"],
)
def test_a_wheel_shows_each_tooth_where_it_stands(form, wheel, profile, tick_s, tmp_path):
    encoder = replace(Encoder(*wheel), form=form)
    machine = replace(one_mode(profile=profile), rate_hz=50000.0, encoder=encoder)
    write_folder(machine, tmp_path / "m")
    with h5py.File(tmp_path / "m" / "rec_000.h5") as file:
        if form == "times":
            times = np.asarray(file["pulse_time"][...])
        else:
            times = (np.nonzero(np.diff(file["encoder"][...]) > 0)[0] + 1) / machine.rate_hz
    present, teeth, angle = wheel[2] - wheel[3], encoder.teeth_rev(machine.seed), machine.profiles[0].angle
    turned = np.mod(angle(times) + wheel[5] / 360.0, 1.0)
    late = (turned[:, None] - teeth[:present] + 0.5) % 1.0 - 0.5
    turns_per_s = (angle(times + 1e-6) - angle(times - 1e-6)) / 2e-6
    nearest = late[np.arange(len(late)), np.abs(late).argmin(axis=1)] / turns_per_s
    # a trace shows an edge at the first sample behind it; a counter gives the nearest tick of its clock
    earliest, latest = (0.0, 1.0 / machine.rate_hz) if form == "trace" else (-0.5 * tick_s, 0.5 * tick_s)
    assert nearest.min() > earliest - 1e-8 and nearest.max() < 1.02 * latest + 1e-8
    assert set(np.abs(late).argmin(axis=1)) == set(range(present))
    assert len(wheel) == 7 or 5e-4 < np.std(np.diff(teeth) - 1.0 / 36.0) < 3e-3


def test_the_new_classes_are_what_their_names_say():
    for seed in range(10):
        held, swept = draw_machine("swing, held", seed), draw_machine("swing, swept", seed)
        assert held.steady and not swept.steady and not draw_machine("two speeds", seed).steady
        for machine in (held, swept):
            swing = machine.profiles[0].swing
            assert swing is not None and 0.002 <= 2.0 * np.pi * swing.order * swing.size_rev <= 0.1001
            assert any(order.order == 1.0 for order in machine.orders) and machine.encoder.pulses_per_rev >= 36
        assert draw_machine("one pulse", seed).encoder.pulses_per_rev == 1
        hummed = draw_machine("twice mains", seed)
        assert [tone.frequency_hz for tone in hummed.tones] == pytest.approx([2.0 * hummed.mains_hz], rel=1e-3)
        toothed = draw_machine("up and down, toothed wheel", seed)
        ways = {np.sign(step) for profile in toothed.profiles for step in np.diff(profile.rpm)} - {0.0}
        assert ways == {1.0, -1.0} and toothed.encoder.pulses_per_rev >= 36


def test_noise_is_120_db_below_order_1_in_half_of_the_swinging_machines():
    levels = []
    for seed in range(30):
        machine = draw_machine("swing, held", seed)
        first = [order.order for order in machine.orders].index(1.0)
        rms = np.abs(machine.steady_response(first, machine.tested_rpm)).max() / np.sqrt(2.0)
        noise = max(machine.noise_density) * np.sqrt(machine.rate_hz / 2.0)
        levels.append(20.0 * np.log10(rms / noise))
    assert 8 <= sum(level > 110.0 for level in levels) <= 22


def test_the_floors_of_two_channels_have_the_density_and_the_coherence_that_are_stated():
    mode = Mode(60.0, 0.02, (0.02 + 0j, -0.01 + 0.003j), (1.0 + 0j,), (1.0,))
    order = Order(2.0, 1.0, 0.5, 2.0, 30.0, 5.0, (0.01 + 0j, 0j))
    machine = replace(
        one_mode(force_density=1.0), modes=(mode,), orders=(order,), channels=("X", "Y"), noise_density=(0.01, 0.01)
    )
    samples = broadband(machine, 800_000, np.random.default_rng(2))
    frequency, crossed = csd(samples[1], samples[0], machine.rate_hz, nperseg=8192)
    density, wanted = welch(samples[0], machine.rate_hz, nperseg=8192)[1], machine.floor_psd(frequency)
    seen, at = (frequency > 5) & (frequency < 900), int(np.argmin(np.abs(frequency - 60.0)))
    assert abs(np.mean(density[seen] / wanted[seen, 0, 0].real) - 1.0) < 0.02
    assert abs(crossed[at] / wanted[at, 0, 1] - 1.0) < 0.2


@pytest.mark.cases(1)
@pytest.mark.parametrize("class_name", CLASSES)
def test_a_drawn_test_is_written_whole_and_the_same_again(class_name, tmp_path):
    machine = draw_machine(class_name, 11)
    assert machine == draw_machine(class_name, 11)
    machine = replace(machine, profiles=machine.profiles[:2])
    takes = write_folder(machine, tmp_path / "a")
    files = sorted((tmp_path / "a").glob("rec_*.h5"))
    assert len(files) == len(takes) == len(machine.profiles)
    write_folder(machine, tmp_path / "b")
    with h5py.File(files[0]) as one, h5py.File(tmp_path / "b" / files[0].name) as two:
        for name in one:
            np.testing.assert_array_equal(one[name][...], two[name][...])
        assert np.isfinite(one["acc_x"][...]).all()


def test_orders_stay_below_half_the_sampling_rate_in_every_class():
    for class_name in CLASSES:
        for seed in range(3):
            machine = draw_machine(class_name, seed)
            fastest = max(rpm for profile in machine.profiles for rpm in profile.rpm)
            assert max(order.order for order in machine.orders) * fastest / 60.0 < 0.45 * machine.rate_hz
            assert all(25.0 * 0.9 < mode.frequency_hz < 0.45 * machine.rate_hz for mode in machine.modes)
