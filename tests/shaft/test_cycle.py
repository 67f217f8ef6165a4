"""A mark on the camshaft tells which top dead centre fires, by the majority of the cycles."""

import numpy as np

from crankorder.quantities import flags_of
from crankorder.settings import load_settings
from crankorder.shaft.angle import angle_at
from crankorder.shaft.decode import shaft_angle

SETTINGS = load_settings().shaft
CAM_REV = 0.8  # the mark comes so long after every other crank revolution is complete


def trains(known_shaft, *, start_rev=0.3217):
    """Pulses, index and cam marks of a shaft: the cam mark comes CAM_REV after every even revolution."""
    shaft = known_shaft(900.0, start_rev=start_rev, duration_s=4.0)
    pulse_s, index_s = shaft.pulse_time_s(60), shaft.pulse_time_s(1)
    time_s = shaft.time_s
    cam_s = np.interp(np.arange(CAM_REV, shaft.angle_rev()[-1], 2.0), shaft.angle_rev(), time_s)
    return shaft, pulse_s, index_s, cam_s[cam_s > 0.0]


def decoded(recording_of, pulse_s, cam_s, **attrs):
    made = recording_of(pulse_s, pulses_per_rev=60, revs_per_cycle=2, pulse_noise_s=1e-7, **attrs)
    made["cam_time"] = ("cycle", cam_s, {"units": "s"})
    return shaft_angle(made, settings=SETTINGS)


def angle_of(angle, time_s):
    return angle_at(time_s, angle["time"].values, angle["crank_angle"].values, angle["speed"].values)


def names(angle):
    return {flag["flag"] for flag in flags_of(angle)}


def test_the_cam_tells_the_firing_dead_centre_wherever_the_record_starts(known_shaft, recording_of):
    for start_rev in [0.0, 0.3217, 0.9, 1.4, 1.95]:
        shaft, pulse_s, index_s, cam_s = trains(known_shaft, start_rev=start_rev)
        to_tdc = 360.0 * (2.0 - CAM_REV) + 30.0
        angle = decoded(
            recording_of, pulse_s, cam_s, index_time_s=index_s, index_to_tdc_deg=30.0, cam_to_tdc_deg=to_tdc
        )
        assert angle.attrs["cycle_known"] == 1
        assert angle.attrs["phase_reference"] == "tdc"
        assert "cycle_phase_unknown" not in names(angle)
        away = (angle_of(angle, pulse_s) - (shaft.angle_rev(pulse_s) - 30.0 / 360.0)) / 2.0
        np.testing.assert_allclose(away, np.round(away), atol=1e-5)
        assert -2.0 < angle_of(angle, pulse_s[:1])[0] <= 1e-6


def test_a_cam_alone_gives_dead_centre_and_cycle(known_shaft, recording_of):
    shaft, pulse_s, _, cam_s = trains(known_shaft)
    angle = decoded(recording_of, pulse_s, cam_s, cam_to_tdc_deg=360.0 * (2.0 - CAM_REV))
    assert (angle.attrs["cycle_known"], angle.attrs["phase_reference"]) == (1, "tdc")
    away = (angle_of(angle, pulse_s) - shaft.angle_rev(pulse_s)) / 2.0
    np.testing.assert_allclose(away, np.round(away), atol=1e-4)


def test_without_its_angle_the_cycle_starts_at_the_next_dead_centre_and_says_so(known_shaft, recording_of):
    shaft, pulse_s, index_s, cam_s = trains(known_shaft)
    angle = decoded(recording_of, pulse_s, cam_s, index_time_s=index_s)
    assert angle.attrs["cycle_known"] == 1
    assert "cycle_from_cam" in names(angle)
    away = (angle_of(angle, pulse_s) - (shaft.angle_rev(pulse_s) - 1.0)) / 2.0
    np.testing.assert_allclose(away, np.round(away), atol=1e-5)


def test_cam_faults_are_counted_and_located_and_do_no_harm(known_shaft, recording_of):
    for fault in ["lost", "extra", "doubled"]:
        shaft, pulse_s, index_s, cam_s = trains(known_shaft)
        marks = {
            "lost": np.delete(cam_s, 5),
            "extra": np.sort(np.append(cam_s, cam_s[5] + 0.05)),
            "doubled": np.sort(np.append(cam_s, cam_s[5] + 1e-4)),
        }[fault]
        angle = decoded(recording_of, pulse_s, marks, index_time_s=index_s)
        (flag,) = [flag for flag in flags_of(angle) if flag["flag"] == ("cam_lost" if fault == "lost" else "cam_extra")]
        assert flag["detail"].startswith("1 cam marks")
        where = {"lost": cam_s[4], "extra": cam_s[5] + 0.05, "doubled": cam_s[5] + 1e-4}[fault]
        assert f"at {where:.6g} s" in flag["detail"]
        away = (angle_of(angle, pulse_s) - (shaft.angle_rev(pulse_s) - 1.0)) / 2.0
        np.testing.assert_allclose(away, np.round(away), atol=1e-5)


def test_a_mark_that_comes_every_revolution_tells_no_cycle(known_shaft, recording_of):
    _, pulse_s, index_s, _ = trains(known_shaft)
    angle = decoded(recording_of, pulse_s, index_s + 0.01, index_time_s=index_s)
    assert angle.attrs["cycle_known"] == 0
    assert {"cam_unclear", "cycle_phase_unknown"} <= names(angle)


def test_a_cam_angle_that_misses_every_dead_centre_is_flagged(known_shaft, recording_of):
    _, pulse_s, index_s, cam_s = trains(known_shaft)
    angle = decoded(recording_of, pulse_s, cam_s, index_time_s=index_s, cam_to_tdc_deg=360.0 * (2.0 - CAM_REV) + 90.0)
    (flag,) = [flag for flag in flags_of(angle) if flag["flag"] == "cam_off"]
    assert "+90 degrees" in flag["detail"]


def test_an_encoder_on_the_camshaft_knows_the_cycle_by_its_own_mark(known_shaft, recording_of):
    shaft, pulse_s, _, cam_s = trains(known_shaft)
    made = recording_of(
        pulse_s, index_time_s=cam_s, pulses_per_rev=120, ratio=0.5, revs_per_cycle=2, pulse_noise_s=1e-7
    )
    angle = shaft_angle(made, settings=SETTINGS)
    assert angle.attrs["cycle_known"] == 1
    away = (angle_of(angle, pulse_s) - shaft.angle_rev(pulse_s) + CAM_REV) / 2.0
    np.testing.assert_allclose(away, np.round(away), atol=1e-4)
