"""Speeds of recordings: groups of like speed, the swing within the cycle, and a row for each recording of a test."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import PurePath
from typing import NamedTuple

import numpy as np
import xarray as xr

from crankorder.errors import printable
from crankorder.findings import SpeedSwing as SpeedSwingFinding
from crankorder.quantities import Bools, Complexes, Floats, Ints, Variables, described
from crankorder.settings import ShaftSettings
from crankorder.shaft.pulses import Remark
from crankorder.shaft.tooth_errors import HIGHEST_MOTION, TOOTH_DOUBT, TOOTH_ORDER

SAME_SPEED = 0.001
"""Speeds that differ by less than this share are one: a quarter of the width of a resonance damped by 0.2 %."""

GAP_RATIO = 8.0
"""A gap between speeds that is so many times the usual one parts two steps of one recording …"""

FEWEST_HELD = 3
"""… where so many frames lie on each side."""

Indices = Ints


def speed_groups(speed_rpm: Floats, *, width_rpm: float, owner: Ints | None = None) -> list[Indices]:
    """Indices of ``speed_rpm`` (frames,) in groups that span at most ``width_rpm``, slowest group first.

    A group begins at the slowest frame that none has taken, so that the steps of a stepped test stay whole wherever
    they lie and a run-up falls into bins of ``width_rpm``. Where ``owner`` (frames,) numbers the recordings, a speed
    that is held falls into one group even where others lie just below. Frames of unknown speed (NaN) form one group,
    the last.
    """
    order = np.argsort(speed_rpm, kind="stable")
    known = order[: np.count_nonzero(~np.isnan(speed_rpm))]
    held = [] if owner is None else held_speeds(speed_rpm, owner, width_rpm=width_rpm)
    swept = np.setdiff1d(known, np.concatenate([*held, np.empty(0, dtype=np.int64)]))
    pieces = sorted([*held, *swept[:, None]], key=lambda piece: (float(speed_rpm[piece].min()), int(piece[0])))
    groups: list[list[Indices]] = []
    limit = -np.inf
    for piece in pieces:
        if float(speed_rpm[piece].max()) > limit:
            groups.append([])
            limit = float(speed_rpm[piece].min()) + width_rpm
        groups[-1].append(piece)
    unknown = order[len(known) :]
    return [np.sort(np.concatenate(group)) for group in [*groups, [unknown]] if len(group[0])]


def held_speeds(speed_rpm: Floats, owner: Indices, *, width_rpm: float) -> list[Indices]:
    """Indices of the frames of each speed that recordings hold, slowest first; frames of sweeps are in none.

    Parameters
    ----------
    speed_rpm : (frames,), rpm; NaN is held by none
    owner : (frames,), number of the recording of each
    width_rpm : rpm; what changes by more is no held speed. Speeds within SAME_SPEED, or that overlap, are one.
    """
    steps: list[Indices] = []
    for name in np.unique(owner):
        mine = np.flatnonzero((owner == name) & np.isfinite(speed_rpm))
        steps += [part for part in _steps(speed_rpm, mine) if np.ptp(speed_rpm[part]) <= width_rpm]
    steps.sort(key=lambda part: float(speed_rpm[part].min()))
    held: list[Indices] = []
    for part in steps:
        both = np.concatenate([held[-1], part]) if held else part
        last = float(speed_rpm[held[-1]].max()) if held else -np.inf
        near = float(speed_rpm[part].min()) <= last * (1.0 + SAME_SPEED)
        if held and near and np.ptp(speed_rpm[both]) <= width_rpm:
            held[-1] = np.sort(both)
        else:
            held.append(part)
    return held


def _steps(speed_rpm: Floats, mine: Indices) -> list[Indices]:
    """The frames ``mine`` of one recording, parted where their speeds leave a gap as between two steps."""
    if len(mine) < 2 * FEWEST_HELD:
        return [mine] if len(mine) else []
    ordered = mine[np.argsort(speed_rpm[mine], kind="stable")]
    speed = speed_rpm[ordered]
    gap = np.diff(speed)
    least = np.maximum(GAP_RATIO * float(np.median(gap)), SAME_SPEED * speed[1:])
    cuts = [int(k) + 1 for k in np.flatnonzero(gap > least)]
    inside = [k for k in cuts if FEWEST_HELD <= k <= len(ordered) - FEWEST_HELD]
    return [np.sort(part) for part in np.split(ordered, inside)]


HIGHEST = 12.0
"""Order up to which the swing is told: gas and inertia of a few cylinders lie below."""

KNOTS_PER_PERIOD = 2.5
"""An order is told where angle and speed are known so many times a period of it, or more often."""

SURE = 5.0
"""Standard errors of the mean cycle that a swing must exceed: a test has many orders and recordings."""

LEAST_SHARE = 0.0005
"""Of the mean speed: a smaller swing is not worth mention, and within what encoders err."""

BETWEEN = 8
"""Places at which the speed is taken from one knot to the next."""

FEWEST_CYCLES = 2
"""Whole cycles of a recording from which on its swing is told."""


class SpeedSwing(NamedTuple):
    """Peak amplitudes [rpm] of a speed at ``orders`` (orders,) about its mean ``speed_rpm``, over ``cycles`` cycles.

    ``amplitude_rpm`` (orders,) is the root of the mean square over the whole cycles, differences between cycles
    included; ``steady_rpm`` (orders,) is that of the mean cycle; ``doubt_rpm`` (orders,) is how much the teeth of the
    wheel may add to it.
    """

    speed_rpm: float
    cycles: int
    orders: Floats
    amplitude_rpm: Floats
    steady_rpm: Floats
    doubt_rpm: Floats

    @property
    def told(self) -> Bools:
        """Which ``orders`` (orders,) swing for certain: far above the cycles' scatter and the teeth, worth mention."""
        scatter = np.sqrt(np.maximum(self.amplitude_rpm**2 - self.steady_rpm**2, 0.0) / self.cycles)
        sure = (self.steady_rpm > SURE * scatter) & (self.steady_rpm > self.doubt_rpm)
        return sure & (self.steady_rpm > LEAST_SHARE * self.speed_rpm)

    @property
    def is_high(self) -> Bools:
        """Which ``orders`` (orders,) lie above those of a shaft's motion."""
        return self.orders > HIGHEST_MOTION

    def percent(self, kept: Bools) -> float:
        """Steady swing of the orders that are ``kept`` (orders,) together, in per cent of the speed."""
        return 100.0 * float(np.sqrt(np.sum(np.square(self.steady_rpm[kept])))) / self.speed_rpm


MOST_VALUES = 1 << 18
"""Speeds within cycles that are told at a time: the memory does not grow with the recording."""

WHOLE = 1e-6
"""An order of the encoder this close to a whole number is one."""


def speed_swing(shaft: xr.Dataset) -> SpeedSwing | None:
    """Swing of the speed of the ShaftAngle ``shaft`` (time) at multiples of its cycle's order; None where not known."""
    known = swing_of_cycles(shaft)
    if known is None:
        return None
    orders, means, lines = known
    mean = float(means.mean())
    size, steady = np.sqrt((np.abs(lines) ** 2).mean(axis=0)), np.abs(lines.mean(axis=0))
    return SpeedSwing(mean, len(means), orders, size, steady, doubt_rpm=_of_teeth(shaft, orders) * mean)


def speed_swings(
    shafts: Iterable[xr.Dataset],
    *,
    of_encoder: Collection[float],
    encoder_deg: Mapping[float, float],
    settings: ShaftSettings,
) -> tuple[SpeedSwingFinding, ...]:
    """Swings of the speed within the cycle that are certain, recording by recording, the largest first.

    Parameters
    ----------
    shafts : ShaftAngles (time) of the recordings
    of_encoder : orders at which the encoder itself swings: that is no motion of the shaft
    encoder_deg : by order, largest amplitude of the angle [deg] that an encoder could show; a swing no larger is marked
        ``may_be_encoder``
    settings : of what swing is more than a shaft can, at high orders: where one is, these are of the teeth
    """
    records = []
    for shaft in shafts:
        swing = speed_swing(shaft)
        if swing is None:
            continue
        sure = swing.told & ~np.isin(swing.orders, list(of_encoder))
        if swing.percent(swing.told & swing.is_high) > settings.largest_swing_percent:
            sure &= ~swing.is_high
        for place in sorted(np.flatnonzero(sure).tolist(), key=lambda at: -swing.amplitude_rpm[at]):
            order, amplitude_rpm = float(swing.orders[place]), float(swing.amplitude_rpm[place])
            off_deg = np.degrees(amplitude_rpm / swing.speed_rpm / order)
            record = SpeedSwingFinding(
                recording=printable(shaft.attrs["recording"]),
                speed_rpm=swing.speed_rpm,
                order=order,
                amplitude_rpm=amplitude_rpm,
                may_be_encoder=bool(off_deg <= encoder_deg.get(order, -np.inf)),
                steady_rpm=float(swing.steady_rpm[place]),
            )
            records.append(record)
    return tuple(records)


def swing_of_cycles(shaft: xr.Dataset) -> tuple[Floats, Floats, Complexes] | None:
    """Orders (orders,), mean speed [rpm] (cycles,) and complex amplitude [rpm] (cycles, orders) in each whole cycle.

    ``shaft`` is the ShaftAngle. None without pulses, in fewer than FEWEST_CYCLES, and where a standstill or a reversal
    leaves no angle that grows. Phases are from angle 0. The trend over each cycle is taken out, so that a run-up is no
    swing. Orders reach to HIGHEST, to those that the knots resolve, and to the cut-off of the smoother where it says
    one.
    """
    time, angle, speed = (shaft.variables[name].values for name in ("time", "crank_angle", "speed"))
    known = np.isfinite(time) & np.isfinite(angle) & np.isfinite(speed)
    if not known.all():
        time, angle, speed = time[known], angle[known], speed[known]
    revs = int(shaft.attrs.get("revs_per_cycle", 1))
    if float(shaft.attrs.get("n_pulses", 0)) <= 0 or len(angle) < 3 or not (np.diff(angle) > 0.0).all():
        return None
    cut_off = float(shaft.attrs.get("cut_off_order", np.inf))
    cycles = int((angle[-1] - angle[0]) / revs + 1e-9)
    per_rev = (len(angle) - 1) / (angle[-1] - angle[0])
    highest = min(HIGHEST, per_rev / KNOTS_PER_PERIOD, cut_off if cut_off > 0.0 else np.inf)
    orders = np.arange(1, int(highest * revs + 1e-9) + 1) / revs
    if cycles < FEWEST_CYCLES or not orders.size:
        return None
    steps = int(np.ceil(2.0 * max(per_rev, 2.0 * HIGHEST) * revs))
    place = (np.arange(steps) + 0.5) / steps * revs
    turn = 2.0 / steps * np.exp(-2j * np.pi * np.outer(angle[0] + place, orders))
    means, lines = np.empty(cycles), np.empty((cycles, len(orders)), dtype=np.complex128)
    for part in np.array_split(np.arange(cycles), 1 + cycles * steps // MOST_VALUES):
        begin = angle[0] + revs * part
        near = slice(*(np.searchsorted(angle, [begin[0], begin[-1] + revs]) + np.array([-1, 1])).clip(0))
        value = np.interp(begin[:, None] + place, *_between(time[near], angle[near], speed[near]))
        means[part] = value.mean(axis=1)
        lines[part] = (value - means[part, None]) @ turn
    # from cycle to cycle: a slope fitted within one would take the swing at its own order along
    return orders, means, lines - np.gradient(means)[:, None] * ((place / revs - 0.5) @ turn)


def swing_remarks(shaft: xr.Dataset, settings: ShaftSettings) -> list[Remark]:
    """Remark where the speed of the ShaftAngle ``shaft`` (time) swings at high orders by more than a shaft can.

    The limit is ``settings.largest_swing_percent``, in per cent of the mean speed; at most one remark is returned.
    """
    swing = speed_swing(shaft)
    if swing is None:
        return []
    total, beyond, low = map(swing.percent, (swing.told, swing.told & swing.is_high, swing.told & ~swing.is_high))
    if not beyond > settings.largest_swing_percent:
        return []
    detail = (
        f"the speed within the revolution swings by {total:.2g} %, of that {beyond:.2g} % above order "
        f"{HIGHEST_MOTION:g}: more than a shaft can; teeth of the wheel that sit wrongly, or too few samples for each? "
        f"What the shaft itself swings is {f'at most {low:.2g} %' if low else 'too little to be seen'}; orders beside "
        "strong ones may be made by it. Record more revolutions to tell"
    )
    return [("encoder_tooth_errors_likely", "suspect", detail)]


def _of_teeth(shaft: xr.Dataset, orders: Floats) -> Floats:
    """Share of the speed that the teeth of the wheel of ``shaft`` may make swing at each of ``orders``, at most."""
    doubt, every = float(shaft.attrs.get(TOOTH_DOUBT, 0.0)), float(shaft.attrs.get(TOOTH_ORDER, 0.0))
    if not every > 0.0:
        return np.zeros(len(orders))
    of_wheel = np.abs(orders / every - np.round(orders / every)) < WHOLE
    return np.where(of_wheel, 2.0 * np.pi * orders * doubt, 0.0)


def _between(time: Floats, angle: Floats, speed: Floats) -> tuple[Floats, Floats]:
    """Angle (rev) and speed (rpm) also between the knots, by the cubics that the angle follows there."""
    step, turned, hertz = np.diff(time)[:, None], np.diff(angle)[:, None], speed / 60.0
    at, first, last = np.arange(BETWEEN) / BETWEEN, hertz[:-1, None], hertz[1:, None]
    moved = turned * (3 * at**2 - 2 * at**3) + step * (first * at * (1 - at) ** 2 - last * at**2 * (1 - at))
    rate = turned / step * 6 * at * (1 - at) + first * (1 - at) * (1 - 3 * at) - last * at * (2 - 3 * at)
    return np.append((angle[:-1, None] + moved).ravel(), angle[-1]), np.append(60.0 * rate.ravel(), speed[-1])


KNOTS = 500
"""Knots of a trace: two pixels each where it is drawn across a page."""

_TRACES = {
    "trace_time": ("s", "middle of the piece of time"),
    "speed_trace": ("min-1", "mean speed in the piece of time"),
    "speed_trace_low": ("min-1", "lowest speed in the piece of time"),
    "speed_trace_high": ("min-1", "highest speed in the piece of time"),
}


def speed_trace(time_s: Floats, speed_rpm: Floats) -> tuple[Floats, ...]:
    """Time [s], mean, lowest and highest speed [rpm], each (KNOTS,), of equal pieces of time; NaN where one is empty.

    ``time_s`` (knots,) [s], rising, and ``speed_rpm`` (knots,) are the knots of the speed. The mean is that over time
    (trapezoidal rule), so that dense knots in a fast part of a revolution count no more than others. Recordings of
    fewer knots are kept as they are, with NaN behind them.
    """
    known = np.isfinite(time_s) & np.isfinite(speed_rpm)
    time, speed = np.asarray(time_s, dtype=float)[known], np.asarray(speed_rpm, dtype=float)[known]
    trace = np.full((4, KNOTS), np.nan)
    if len(time) <= KNOTS:
        trace[:, : len(time)] = time, speed, speed, speed
        return tuple(trace)
    ends = np.linspace(time[0], time[-1], KNOTS + 1)
    turned = np.concatenate([[0.0], np.cumsum(np.diff(time) * (speed[1:] + speed[:-1]) / 2)])
    trace[0] = (ends[:-1] + ends[1:]) / 2
    trace[1] = np.diff(np.interp(ends, time, turned)) / np.diff(ends)
    first = np.searchsorted(time, ends[:-1])
    held = np.diff(np.append(first, len(time))) > 0
    for row, extreme in ((2, np.minimum), (3, np.maximum)):
        trace[row] = np.where(held, extreme.reduceat(speed, np.minimum(first, len(speed) - 1)), trace[1])
    return tuple(trace)


def trace_variables(shafts: Sequence[xr.Dataset]) -> Variables:
    """Variables (recording, knot) of the group ``shaft`` of the results: the traces of ``shafts``.

    ``trace_time`` [s], ``speed_trace``, ``speed_trace_low`` and ``speed_trace_high`` [rpm]; ``shafts`` are ShaftAngles
    in the order of the recordings.
    """
    traces = np.empty((len(_TRACES), len(shafts), KNOTS), dtype=np.float32)  # of thousands of recordings: held once
    for number, shaft in enumerate(shafts):
        traces[:, number] = speed_trace(shaft["time"].values, shaft["speed"].values)
    dims, rows = ("recording", "knot"), zip(_TRACES.items(), traces, strict=True)
    return {name: described(dims, trace, unit, text) for (name, (unit, text)), trace in rows}


def shaft_summary(shafts: Sequence[xr.Dataset]) -> xr.Dataset:
    """Speed, pulses used, angle error and speed traces of every recording: one row each, in the order of ``shafts``.

    ``shafts`` are ShaftAngles; ``speed_mean``, ``speed_min``, ``speed_max`` [rpm], ``standard_error`` [rev] and
    ``n_pulses`` are (recording,), the traces of :func:`trace_variables` (recording, knot).
    """
    speeds, errors = ([shaft[name].values for shaft in shafts] for name in ("speed", "standard_error"))
    names = np.array([printable(shaft.attrs["recording"]) for shaft in shafts])
    pulses = np.array([float(shaft.attrs["n_pulses"]) for shaft in shafts])
    mean_error = described("recording", _known(np.mean, errors), "rev", "mean standard error of the crank angle")
    variables = {
        "speed_mean": described("recording", _known(np.mean, speeds), "min-1", "mean speed"),
        "speed_min": described("recording", _known(np.min, speeds), "min-1", "lowest speed"),
        "speed_max": described("recording", _known(np.max, speeds), "min-1", "highest speed"),
        "standard_error": mean_error,
        "n_pulses": described("recording", pulses, "1", "encoder pulses used"),
    }
    coords = {"recording": described("recording", names, "1", "file name")}
    return xr.Dataset(variables | trace_variables(shafts), coords=coords)


def _known(statistic: Callable[[Floats], float], recordings: list[Floats]) -> Floats:
    """The ``statistic`` of those values of each of ``recordings`` that are numbers; NaN where none is."""
    known = [values[~np.isnan(values)] for values in recordings]
    return np.array([float(statistic(values)) if values.size else np.nan for values in known])


_SPEED_IN_NAME = (
    re.compile(r"(?<![0-9.])(\d{2,6}(?:[.,]\d+)?)[ _-]?(?:rpm|u_?min|upm|min-?1|r_?min)", re.I),
    re.compile(r"(?:rpm|speed|drehzahl|(?<![a-z])n)[ _=-]?(\d{2,6}(?:\.\d+)?)(?![0-9])", re.I),
)
# A run-up from one speed to another.
_SPEED_RANGE = re.compile(r"(?<!\d)\d{3,5} ?(?:-|_?to_?|\.\.+) ?\d{3,5}[ _-]?(?:rpm|u_?min|upm|min-?1|r_?min)", re.I)
# Words that make a number a speed; "n12" may be the twelfth measurement.
_SPEED_WORD = re.compile(r"rpm|min|upm|speed|drehzahl", re.I)
# Names state nominal speeds, and a motor's slip or a governor's droop lies within this share of them.
_NOMINAL_SHARE = 0.2
# Share of the knots at either end of the speeds that may be those of a start or of noise.
_ENDS = 0.02


def speed_in_name(name: str) -> float | None:
    """Speed [rpm] that the ``name`` of a file states, such as 800 in "800rpm" or "idle_n800"; None where none."""
    for sign in () if _SPEED_RANGE.search(name) else _SPEED_IN_NAME:
        match = sign.search(name)
        if match and float(match[1].replace(",", ".")) > 0:
            return float(match[1].replace(",", "."))
    return None


def named_speed(recording: str) -> float | None:
    """Speed [rpm] that the name of a ``recording`` states in words that make a number a speed; None where none."""
    return speed_in_name(PurePath(recording).stem) if _SPEED_WORD.search(recording) else None


def named_speed_remarks(shaft: xr.Dataset) -> list[Remark]:
    """Remark where the name of a recording states a speed [rpm] far from all speeds in its ShaftAngle ``shaft`` (time).

    At most one remark is returned.
    """
    named = named_speed(str(shaft.attrs["recording"]))
    speed = shaft["speed"].values[np.isfinite(shaft["speed"].values)]
    if named is None or not speed.size:
        return []
    low, high = (float(value) for value in np.quantile(speed, (_ENDS, 1.0 - _ENDS)))
    if low * (1.0 - _NOMINAL_SHARE) <= named <= high * (1.0 + _NOMINAL_SHARE):
        return []
    seen = f"{low:.4g} rpm is" if high - low < 0.01 * high else f"{low:.4g} to {high:.4g} rpm are"
    detail = f"the name states {named:g} rpm, {seen} found: look at [encoder], its source, pulses_per_rev and ratio"
    return [("speed_not_as_named", "suspect", detail)]
