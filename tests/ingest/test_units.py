"""Units come from a closed table, and nothing that a file says can hang it."""

import math

import pytest

from crankorder.errors import RequestError
from crankorder.ingest.units import (
    conversion_factor,
    known_unit,
    parse_quantity,
    parse_sensitivity,
    unit_in_label,
    unit_of,
)


def test_spellings_of_one_unit_are_one_unit():
    for spelling in ["m/s2", "m/s^2", "m/s²", "m s-2", " m/s2 "]:
        assert unit_of(spelling).name == "m/s2"
    for spelling in ["µm", "μm", "um"]:
        assert conversion_factor(unit_of(spelling), unit_of("mm")) == pytest.approx(1e-3, rel=1e-15)


def test_factors_are_those_of_the_definitions():
    pound, inch = 0.45359237 * 9.80665, 0.0254  # newtons, metres: the international pound and inch, standard gravity
    rows = [
        ("lbf", "N", pound), ("psi", "Pa", pound / inch**2), ("mil", "m", inch / 1000.0),
        ("in/s", "mm/s", inch * 1000.0), ("g", "m/s2", 9.80665), ("bar", "kPa", 100.0), ("hPa", "MPa", 1e-4),
        ("kN", "N", 1000.0), ("mA", "A", 1e-3), ("mV", "V", 1e-3), ("deg", "rad", math.pi / 180.0),
        ("µstrain", "strain", 1e-6), ("µs", "ms", 1e-3), ("%", "1", 0.01), ("Hz", "rpm", 60.0),
        ("rad/s", "tr/min", 30.0 / math.pi),
    ]  # fmt: skip
    for unit, other, factor in rows:
        assert conversion_factor(unit_of(unit), unit_of(other)) == pytest.approx(factor, rel=1e-12), unit


def test_an_unknown_unit_is_refused_at_once_with_the_accepted_ones(refused_s):
    short_s = refused_s(lambda: unit_of("x"))
    for text in ["9**9**9", "G", "mg", "grms", "EU", "", "m/s2" * 100_000, "\0", "ｘ" * 50]:
        with pytest.raises(RequestError, match=r"unknown unit.*allowed: m/s2, mm/s2, g,") as caught:
            unit_of(text)
        assert refused_s(lambda text=text: unit_of(text)) < 1000.0 * short_s  # of 400,000 times the characters
        assert len(str(caught.value)) < 1000


def test_a_sensitivity_turns_volts_into_the_analysed_unit():
    rows = [
        ("100 mV/g", "m/s2", 98.0665), ("100 mV/g", "g", 10.0), ("0.077 V/bar", "bar", 1 / 0.077),
        ("0.077 V/bar", "Pa", 1e5 / 0.077), ("10.2 mV/(m/s2)", "m/s2", 1 / 0.0102),
        ("10.2 mV/m/s²", "m/s2", 1 / 0.0102), ("1e-3 V / Pa", "Pa", 1000.0),
    ]  # fmt: skip
    for text, unit, per_volt in rows:
        assert parse_sensitivity(text).measured_per_output(unit_of(unit)) == pytest.approx(per_volt, rel=1e-14)


def test_what_is_no_sensitivity_is_refused_with_what_one_is():
    wrong = ["100", "mV/g", "100 mV", "nan mV/g", "inf mV/g", "1" * 500 + " mV/g", "100 mV/", ""]
    said = dict.fromkeys(wrong, r'not a sensitivity.*such as "100 mV/g"')
    said |= dict.fromkeys(["-100 mV/g", "0 mV/g"], r"must be above 0.*direction")
    for text, match in {**said, "1 bar/V": "does not start with an electrical unit"}.items():
        with pytest.raises(RequestError, match=match):
            parse_sensitivity(text)


def test_an_offset_is_a_number_with_a_unit():
    assert parse_quantity("0.575 V") == (0.575, unit_of("V"))
    for bare in ("4.5", "45", "4.5e3", " 12 ", "1.", "-3"):
        with pytest.raises(RequestError, match=r'without its unit.*as in "4.5 mm/s"'):
            parse_quantity(bare, such_as='"4.5 mm/s"')
    with pytest.raises(RequestError, match="not a number with a unit"):
        parse_quantity("half a volt")


def test_labels_state_units_in_brackets():
    assert unit_in_label("Time [s]") == "s"
    assert unit_in_label("Pressure (bar)") == "bar"
    assert unit_in_label("Crank position") == ""
    assert known_unit("nonsense") is None
