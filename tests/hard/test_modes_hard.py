"""Hard cases of natural frequencies, each with its truth."""

from dataclasses import replace

import pytest
from tests.made.floors import Made, campbell_of, inside, no_orders

from crankorder.identify.found import AgreedOrder
from crankorder.identify.modes.joint_fit import modal_fit
from crankorder.settings import load_settings

ONE = Made(natural_hz=(115.0,), damping=(0.016,), sensor=((0.008, 0.010),), drive=((0.5, -0.7),), rate_hz=640.0)


def _fit(made, orders=()):
    campbell = campbell_of(made, 3)
    agreed = tuple(AgreedOrder(order, 1e-5, 30.0, "locked", None, ()) for order in orders)
    return modal_fit(campbell, no_orders(campbell), agreed, settings=load_settings().identify)


OCTAVE = {"natural_hz": (115.0, 230.0), "damping": (0.016, 0.014), "drive": ((0.5, -0.7), (0.6, 0.9))}
CASES = {
    "two one hertz apart": (
        {"natural_hz": (172.0, 173.0), "damping": (0.002, 0.002), "sensor": ((0.008, 0.006), (0.004, -0.006)),
         "drive": ((0.8, 0.7), (-0.6, -0.9))}, (), None,
    ),
    "damping of a thousandth and of a fifth": (
        {"natural_hz": (60.0, 150.0), "damping": (0.001, 0.2), "sensor": ((0.006, 0.010), (0.006, 0.007)),
         "drive": ((0.2, 1.7), (-0.8, 0.8)), "duration_s": 30.0}, (), [],
    ),
    "three speeds and a harmonic of an unknown order": (
        {"speed_rpm": (900.0, 1400.0, 2000.0), "duration_s": 30.0, "lines": ((2.0, 1.0), (4.0, 0.5))}, (2.0,), [],
    ),
    "harmonics of a tone": ({"tones": ((71.3, 0.5), (142.6, 0.05), (213.9, 0.01))}, (), [71.3, 142.6, 213.9]),
    "orders that cross it and a tone": (
        {"lines": ((4.0, 1.0), (5.5, 1.0), (3.0, 1.0)), "tones": ((90.0, 0.3),)}, (3.0, 4.0, 5.5), [90.0],
    ),
    "exactly on an order at constant speed": (
        {"speed_rpm": (1725.0,), "duration_s": 120.0, "lines": ((4.0, 2.0),)}, (4.0,), None,
    ),
    "an octave apart": (OCTAVE | {"sensor": ((0.008, 0.010), (0.006, 0.012))}, (), []),
    "an octave in one channel": (OCTAVE | {"sensor": ((0.008,), (0.006,))}, (), []),
}  # fmt: skip
"""What differs from ONE, the orders that are known, and the tones to be found (None: not asked)."""


@pytest.mark.cases(len(CASES))
@pytest.mark.parametrize("case", CASES)
def test_the_modes_that_were_put_in_are_found_and_tones_apart(case):
    changes, orders, tones_hz = CASES[case]
    made = replace(ONE, **changes)
    fit = _fit(made, orders)
    assert inside(fit, made)
    assert "octave" not in case or not any(mode.undecided for mode in fit.modes)
    assert tones_hz is None or [round(tone.frequency_hz, 1) for tone in fit.tones] == tones_hz
