"""Unit spellings, a closed table: no parser, so that no text from a file can hang it or be guessed wrong."""

from __future__ import annotations

import difflib
import math
import re
import unicodedata
from typing import NamedTuple

from crankorder.errors import RequestError
from crankorder.settings import STANDARD_GRAVITY_M_S2

_MAX_CHARACTERS = 60

# name, quantity, SI base units per unit, further spellings (after Unicode NFKC, which turns "²" into "2")
_TABLE: tuple[tuple[str, str, float, str], ...] = (
    ("m/s2", "acceleration", 1.0, "m/s^2, m/s**2, m s-2, m s^-2, m*s-2, m/s/s, ms-2, m/sec2, m/sec^2"),
    ("mm/s2", "acceleration", 1e-3, "mm/s^2, mm/s**2, mm s-2"),
    ("g", "acceleration", STANDARD_GRAVITY_M_S2, "gn, g_n, g0"),
    ("m/s", "velocity", 1.0, "m s-1, m s^-1, m/sec"),
    ("mm/s", "velocity", 1e-3, "mm s-1, mm s^-1, mm/sec"),
    ("in/s", "velocity", 0.0254, "ips, IPS, in/sec, inch/s"),
    ("m", "displacement", 1.0, ""),
    ("mm", "displacement", 1e-3, ""),
    ("µm", "displacement", 1e-6, "um, micron"),
    ("mil", "displacement", 2.54e-5, "mils"),
    ("Pa", "pressure", 1.0, "N/m2, N/m^2, pascal"),
    ("hPa", "pressure", 1e2, "mbar"),
    ("kPa", "pressure", 1e3, ""),
    ("MPa", "pressure", 1e6, ""),
    ("bar", "pressure", 1e5, ""),
    ("psi", "pressure", 6894.757293168, "PSI, lbf/in2, lbf/in^2"),
    ("N", "force", 1.0, "newton"),
    ("kN", "force", 1e3, ""),
    ("lbf", "force", 4.4482216152605, "lb, lbs, pound, pounds, Pounds"),
    ("N·m", "torque", 1.0, "N m, Nm, N*m, N.m, N-m"),
    ("V", "voltage", 1.0, "volt, volts, Volt, Volts"),
    ("mV", "voltage", 1e-3, ""),
    ("A", "current", 1.0, ""),
    ("mA", "current", 1e-3, ""),
    ("counts", "counts", 1.0, "count, cts, digits, LSB"),
    ("FS", "full scale", 1.0, "full scale"),
    ("min-1", "rotational speed", 1.0 / 60.0, "rpm, RPM, 1/min, r/min, rev/min, tr/min, U/min, min^-1"),
    ("Hz", "rotational speed", 1.0, "1/s, s-1, s^-1, rev/s, r/s"),
    ("rad/s", "rotational speed", 1.0 / (2.0 * math.pi), "rad s-1"),
    ("deg", "angle", math.pi / 180.0, "°, degree, degrees"),
    ("rad", "angle", 1.0, "radian, radians"),
    ("rev", "angle", 2.0 * math.pi, "revs, revolution, revolutions, turn, turns"),
    ("strain", "strain", 1.0, "m/m"),
    ("µstrain", "strain", 1e-6, "µε, um/m, µm/m, microstrain"),
    ("s", "time", 1.0, "sec, seconds, second"),
    ("ms", "time", 1e-3, ""),
    ("µs", "time", 1e-6, "us"),
    ("1", "ratio", 1.0, ""),
    ("%", "ratio", 1e-2, ""),
)

ACCEPTED = ", ".join(name for name, *_ in _TABLE)

# behind it no digit or point: "4.5" is no 4 with the unit ".5"
_NUMBER = r"([+-]?[0-9]{1,18}(?:\.[0-9]{0,18})?(?:[eE][+-]?[0-9]{1,3})?)(?![0-9.]|[eE][+-]?[0-9])"

_BARE = re.compile(rf"\s*{_NUMBER}\s*")

_QUANTITY = re.compile(rf"\s*{_NUMBER}\s*(\S.*)")

_SENSITIVITY = re.compile(rf"\s*{_NUMBER}\s*([^/\s]+)\s*/\s*(\S.*)")

_LABEL = re.compile(r"[\[(]([^\[\]()]{1,40})[\])]\s*$")

# spellings that are hardly anything else than a unit behind a name
_SUFFIX = re.compile(
    r"[A-Za-z0-9][ _.-]"
    r"(ms|us|µs|s|sec|seconds|rpm|deg|bar|mbar|kPa|MPa|Pa|Nm|kN|mV|V|Hz|g|mm|um|µm|mm/s|m/s|m/s2|m/s\^2)$"
)

_TIME_SUFFIX = re.compile(r"(?:time|zeit|t|timestamp|time[ _.-]stamp)[ _.-]*(ms|us|µs|sec|s|seconds)", re.IGNORECASE)


class Unit(NamedTuple):
    """One unit: its spelling in results, the quantity that it measures, and SI base units per one of it."""

    name: str
    quantity: str
    factor: float


class Sensitivity(NamedTuple):
    """Output of a sensor per unit of what it measures, both in SI base units."""

    output: Unit
    measured: Unit
    output_per_measured: float

    def measured_per_output(self, unit: Unit) -> float:
        """Factor from the sensor's output in its SI base unit (volts) to ``unit``."""
        return 1.0 / (self.output_per_measured * unit.factor)


def _key(text: str) -> str:
    return unicodedata.normalize("NFKC", text.strip()).replace("⋅", "·")


_UNITS: dict[str, Unit] = {
    _key(spelling): Unit(name, quantity, factor)
    for name, quantity, factor, others in _TABLE
    for spelling in (name, *filter(None, others.split(", ")))
}


def known_unit(text: str) -> Unit | None:
    """Unit that ``text`` spells, or None where the closed table does not have it."""
    return _UNITS.get(_key(text)) if 0 < len(text) <= _MAX_CHARACTERS else None


def unit_of(text: str) -> Unit:
    """Unit that ``text`` spells, such as ``"m/s²"`` or ``"mV"``.

    Raises RequestError that lists the accepted units where ``text`` is none of the table's spellings.
    """
    unit = known_unit(text)
    if unit is None:
        close = difflib.get_close_matches(text[:_MAX_CHARACTERS], [*_UNITS, "g"], n=1, cutoff=0.6)
        close = ["g"] if text.casefold() == "g" else close
        remedy = f"Did you mean {close[0]!r}?" if close else "Write one of these"
        raise RequestError("unknown unit", found=repr(text), allowed=ACCEPTED, remedy=remedy)
    return unit


def base_unit(unit: Unit) -> Unit:
    """SI base unit of the quantity that ``unit`` measures, such as V for mV."""
    return next(base for base in _UNITS.values() if base.quantity == unit.quantity and base.factor == 1.0)


def conversion_factor(source: Unit, target: Unit) -> float:
    """Factor from values in ``source`` to values in ``target``.

    Raises RequestError where the two measure different quantities.
    """
    if source.quantity != target.quantity:
        problem = f"{source.name} ({source.quantity}) cannot become {target.name} ({target.quantity})"
        raise RequestError(problem, remedy="Mend the unit, or give the sensitivity of the sensor")
    return 1.0 if source.name == target.name else source.factor / target.factor


def is_bare_number(text: str) -> bool:
    """Whether ``text`` is a number without a unit."""
    return len(text) <= _MAX_CHARACTERS and _BARE.fullmatch(text) is not None


def parse_quantity(text: str, *, such_as: str = '"2.5 V"') -> tuple[float, Unit]:
    """Number and unit of a text such as ``"2.5 V"``.

    Raises RequestError where ``text`` is not a number followed by a known unit, with the example ``such_as``.
    """
    match = _QUANTITY.fullmatch(text) if len(text) <= _MAX_CHARACTERS else None
    if match is None:
        bare = is_bare_number(text)
        problem = "a number without its unit" if bare else "not a number with a unit"
        remedy = f"Give the unit, as in {such_as}" if bare else ""
        raise RequestError(problem, found=repr(text), allowed=f"such as {such_as}", remedy=remedy)
    return float(match[1]), unit_of(match[2])


def parse_sensitivity(text: str) -> Sensitivity:
    """Sensitivity that a text such as ``"100 mV/g"`` or ``"10.2 mV/(m/s2)"`` states.

    Raises RequestError where ``text`` is not a positive number of volts (or counts) per unit of a known quantity.
    """
    match = _SENSITIVITY.fullmatch(text) if len(text) <= _MAX_CHARACTERS else None
    if match is None:
        raise RequestError("not a sensitivity", found=repr(text), allowed='such as "100 mV/g" or "0.077 V/bar"')
    value, measured = float(match[1]), match[3].strip()
    if measured.startswith("(") and measured.endswith(")"):
        measured = measured[1:-1]
    output, unit = unit_of(match[2]), unit_of(measured)
    if output.quantity not in ("voltage", "current", "counts", "full scale"):
        problem = "the sensitivity does not start with an electrical unit"
        raise RequestError(problem, found=repr(text), allowed="V, mV, A, mA, counts, FS")
    if not (value > 0 and math.isfinite(value)):
        remedy = 'A sensor mounted the other way round is told by direction = "-Z"'
        raise RequestError("the sensitivity must be above 0", found=repr(text), remedy=remedy)
    return Sensitivity(output=output, measured=unit, output_per_measured=value * output.factor / unit.factor)


def unit_in_label(label: str) -> str:
    """Unit that a column label states in brackets at its end, such as ``"s"`` in ``"Time [s]"``; empty where none.

    The unit of a time may stand there without brackets: ``"ms"`` in ``"time_ms"``.
    """
    match = _LABEL.search(label[-_MAX_CHARACTERS:]) or _TIME_SUFFIX.fullmatch(label[-_MAX_CHARACTERS:])
    return match[1].strip() if match else ""


def unit_in_suffix(label: str) -> str:
    """Unit that the end of a column label may mean, such as ``"bar"`` in ``"P_cyl_bar"``: a guess; empty where none."""
    match = _SUFFIX.search(label[-_MAX_CHARACTERS:])
    return match[1] if match else ""
