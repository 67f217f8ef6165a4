"""The average engine cycle: every channel against crank angle, with its spread over the cycles, by speed."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.fft.transforms import counted
from crankorder.fft.windows import power_of_two
from crankorder.orders.intervals import one_phase_reference, phase_reference_of
from crankorder.orders.method import (
    MOST_CONTENT,
    SignalsByAngle,
    is_by_angle,
    less_than_a_cycle,
    rev_frequencies,
    signals_by_angle,
)
from crankorder.quantities import (
    Bools,
    Floats,
    Ints,
    QualityFlag,
    channel_coords,
    described,
    flags_of,
    remark,
    with_flags,
)
from crankorder.settings import OrderSettings
from crankorder.shaft.speeds import speed_groups

FADED_AT = 2.0
"""Orders up to max_order pass whole, those above fade until this multiple of it: a waveform does not ring."""

POINTS_PER_TURN = 8
"""Least points of the angle grid per turn of the highest order: straight lines between them err by 8 % of it."""

LEAST_POINTS_PER_REV = 180
"""However low the highest order, the grid is no coarser than two degrees."""

REACH_TURNS = 4.0
"""Turns of the highest order by which a gap spreads when orders above it fade: 4e-4 of it are left there."""

SWEPT_SHARE = 0.01
"""Change of speed from the first to the last cycle, as a share, from which a record counts as a run-up."""

LOW_FREQUENCIES = 4
"""Lowest frequencies, in turns per record of cycles, from which the error of a mean is taken."""

SPREAD = {
    "mean": "mean over the cycles, without the mean of the recording",
    "standard_deviation": "standard deviation over the cycles",
    "standard_error": "standard error of the mean",
    "minimum": "least value of any cycle",
    "maximum": "greatest value of any cycle",
}
"""Variables (channel, speed, cycle_angle) of a CycleAverage in the unit of the channel, and what they are."""

CycleStatistics = dict[str, Floats]
"""Variables of SPREAD and n_cycles of one group of cycles: (channels, angles) and (channels,)."""


class _Cycles(NamedTuple):
    """Cycles of one recording on the grid of angles."""

    values: Floats  # (channels, cycles, angles), the first angle wherever the recording begins
    whole: Bools  # (channels, cycles), False where a gap reaches into one
    speed_rpm: Floats  # (cycles,)
    first: int  # place of the first angle in a cycle that begins at top dead centre
    points_per_rev: int


def cycle_average(band: xr.Dataset, shaft: xr.Dataset, *, settings: OrderSettings) -> xr.Dataset:
    """CycleAverage of one recording: the mean cycle of each channel (channel, speed, cycle_angle) and its spread.

    Parameters
    ----------
    band : BandRecording (channel, time or crank_angle)
    shaft : its ShaftAngle (time); a cycle is its ``revs_per_cycle``: 720 degrees of a four-stroke engine
    settings : of orders. ``max_order`` is the highest order that the waveforms hold whole (above it they fade until
        twice that), ``speed_bin_rpm`` the width of a group of cycles, ``tolerance`` what resampling may add

    Returns ------- CycleAverage (channel, speed, cycle_angle). Only whole cycles count, in a run-up without the first
    and the last; a cycle that a gap reaches is left out of its channel and counted. Angle 0 is the (firing, where
    ``cycle_known``) top dead centre, or whatever ``phase_reference`` says. The standard error follows from the slow
    part of the cycles' scatter: cycles that resemble the next beyond the mean count for fewer.

    Raises InputError where not even one cycle was recorded.
    """
    cycles = _cycles(band, shaft, settings)
    groups = speed_groups(cycles.speed_rpm, width_rpm=settings.speed_bin_rpm)
    parts = [_statistics(cycles.values[:, group], cycles.whole[:, group]) for group in groups]
    for part in parts:
        for name in SPREAD:
            part[name] = np.roll(part[name], cycles.first, axis=-1)
    speed = np.array([cycles.speed_rpm[group].mean() for group in groups])
    excluded = np.stack([np.count_nonzero(~cycles.whole[:, group], axis=1) for group in groups], axis=1)
    fastest = np.array([cycles.speed_rpm[group].max() for group in groups])
    # orders that the band carries at the fastest cycle of each group
    if is_by_angle(band):
        carried = np.full(len(fastest), 0.5 * float(band.attrs["samples_per_rev"]))
    else:
        rate = float(band.attrs["rate_hz"])
        carried = min(float(band.attrs.get("band_hz", math.inf)), MOST_CONTENT * rate) * 60.0 / fastest
    highest = np.minimum(settings.max_order, carried)
    made = _dataset(parts, speed, excluded, highest, band, cycles.points_per_rev)
    made.attrs = {key: shaft.attrs[key] for key in ("phase_reference", "cycle_known", "revs_per_cycle")}
    made.attrs |= {key: band.attrs[key] for key in ("recording", "history", "quality") if key in band.attrs}
    made.attrs |= {"max_order": settings.max_order, "speed_bin_rpm": settings.speed_bin_rpm}
    return with_flags(made, [*flags_of(shaft), *_gap_flags(made)])


def _cycles(band: xr.Dataset, shaft: xr.Dataset, settings: OrderSettings) -> _Cycles:
    """Whole cycles of ``band``, as many as ``shaft`` covers, on the grid of angles."""
    from scipy.fft import next_fast_len

    revs = int(shaft.attrs["revs_per_cycle"])
    evenly = signals_by_angle(band, shaft, max_order=FADED_AT * settings.max_order, tolerance=settings.tolerance)
    count = len(evenly.angle_rev) // (revs * evenly.samples_per_rev)
    if count == 0:
        raise less_than_a_cycle(band, len(evenly.angle_rev) / evenly.samples_per_rev, revs)
    # points of the grid per revolution: enough for the highest order, and quick to transform
    points = next_fast_len(max(LEAST_POINTS_PER_REV, math.ceil(POINTS_PER_TURN * settings.max_order)), real=True)
    begin = float(evenly.angle_rev[0])
    first = math.ceil(begin * points - 1e-6)
    signals, usable = _sound(evenly, count * revs * evenly.samples_per_rev, settings.max_order)
    rates = (evenly.samples_per_rev, points)
    values = _on_grid(signals, rates, max_order=settings.max_order, advance_rev=first / points - begin)
    sound = np.ones(signals.shape, dtype=np.bool_) if usable is None else usable
    whole = np.asarray(np.all(_cycles_of(sound, revs * evenly.samples_per_rev), axis=2))
    if is_by_angle(band):
        speed = np.full(count, float(shaft["speed"].values.mean()))
    else:
        speed = 60.0 * rev_frequencies(shaft, begin + revs * np.arange(count + 1.0))
    # the filter works round the record: where its ends are not alike, the outer cycles hold something of both
    swept = count > 2 and abs(speed[-1] - speed[0]) > SWEPT_SHARE * speed[0]
    kept = slice(1, -1) if swept else slice(None)
    cycles = _cycles_of(values, revs * points)
    return _Cycles(cycles[:, kept], whole[:, kept], speed[kept], first % (revs * points), points)


def _cycles_of(values: NDArray, samples_per_cycle: int) -> NDArray:  # type: ignore[type-arg]  # of bool and of floats
    """Whole cycles (channels, cycles, samples_per_cycle) of ``values`` (channels, samples) from its first sample on."""
    count = values.shape[1] // samples_per_cycle
    return values[:, : count * samples_per_cycle].reshape(len(values), count, samples_per_cycle)


def _sound(evenly: SignalsByAngle, n_samples: int, max_order: float) -> tuple[Floats, Bools | None]:
    """First ``n_samples`` of the signals, finite, and which of them no gap reaches once the orders above fade."""
    signals = np.asarray(evenly.signals[:, :n_samples], dtype=np.float64)
    finite = np.isfinite(signals)
    usable = None if evenly.usable is None else evenly.usable[:, :n_samples]
    if not finite.all():
        signals = np.where(finite, signals, 0.0)
        usable = finite if usable is None else usable & finite
    if usable is None or usable.all():
        return signals, None
    reach = math.ceil(REACH_TURNS / max_order * evenly.samples_per_rev)
    at = np.arange(n_samples)
    return signals, counted(~usable, at - reach, at + reach + 1) == 0


def _on_grid(signals: Floats, per_rev: tuple[int, int], *, max_order: float, advance_rev: float) -> Floats:
    """``signals`` (channels, samples) of whole revolutions on a grid that begins ``advance_rev`` later.

    ``per_rev``: samples of the signals in a revolution, and points of the grid.

    One Fourier transform of them all: exact for what whole cycles repeat; what they do not repeat wraps within a few
    turns of the highest order at either end.
    """
    from scipy.fft import irfft, rfft

    samples_per_rev, points_per_rev = per_rev
    revs = signals.shape[1] // samples_per_rev
    scale = power_of_two(signals)
    spectrum = rfft(signals / scale, axis=1)
    last = min(FADED_AT * max_order, 0.5 * points_per_rev) * revs
    n_bins = min(math.ceil(last), math.ceil(0.5 * samples_per_rev * revs))
    order = np.arange(n_bins) / revs
    share = np.clip((order / max_order - 1.0) / (FADED_AT - 1.0), 0.0, 1.0)
    spectrum = spectrum[:, :n_bins] * (0.5 + 0.5 * np.cos(np.pi * share) + 0j)
    if advance_rev != 0.0:
        spectrum *= np.exp(2j * np.pi * order * advance_rev)
    values = irfft(spectrum, n=revs * points_per_rev, axis=1)
    values *= scale * (points_per_rev / samples_per_rev)
    return np.asarray(values)


def _statistics(values: Floats, whole: Bools) -> CycleStatistics:
    """Mean and spread of the ``whole`` (channels, cycles) of ``values`` (channels, cycles, angles)."""
    shape = (values.shape[0], values.shape[2])
    made = {name: np.full(shape, np.nan) for name in SPREAD} | {"n_cycles": np.count_nonzero(whole, axis=1)}
    for channel, kept in enumerate(whole):
        cycles = values[channel] if kept.all() else values[channel, kept]
        count = len(cycles)
        if count == 0:
            continue
        mean = cycles.mean(axis=0)
        made["mean"][channel] = mean
        made["minimum"][channel], made["maximum"][channel] = cycles.min(axis=0), cycles.max(axis=0)
        if count < 2:
            continue
        scale = float(power_of_two(cycles[None])[0, 0, 0])
        scatter = (cycles - mean) / scale
        deviation = np.sqrt((scatter**2).sum(axis=0) / (count - 1)) * scale
        made["standard_deviation"][channel] = deviation
        made["standard_error"][channel] = deviation * math.sqrt(_excess_at_rest(scatter) / count)
    return made


def _excess_at_rest(scatter: Floats) -> float:
    """How much more of ``scatter`` (cycles, angles) about its mean is slow than if no cycle resembled the next.

    The variance of a mean is the power density at frequency zero, per cycle, over the cycles; what is known of it are
    the frequencies just above: LOW_FREQUENCIES of them, pooled over the angles. 1 where the cycles are independent,
    more where they drift, less where they alternate.
    """
    count = len(scatter)
    total = float((scatter**2).sum())
    if count < 4 or total == 0.0:
        return 1.0
    frequency = np.arange(1, 1 + min(max(count // 8, 1), LOW_FREQUENCIES))
    turn = 2.0 * np.pi / count * np.outer(frequency, np.arange(count))
    low = float(sum(((wave @ scatter) ** 2).sum() for wave in (np.cos(turn), np.sin(turn)))) / len(frequency)
    return max(low * (count - 1) / (count * total), 1.0 / count)


def _dataset(
    parts: list[CycleStatistics], speed: Floats, excluded: Ints, highest: Floats, like: xr.Dataset, points_per_rev: int
) -> xr.Dataset:
    """CycleAverage without attributes from the groups' ``parts``, with the channels of ``like``."""
    angle = 360.0 * np.arange(parts[0]["mean"].shape[1]) / points_per_rev
    over = ("channel", "speed", "cycle_angle")
    values = {name: np.stack([part[name] for part in parts], axis=1) for name in SPREAD}
    count = np.stack([part["n_cycles"] for part in parts], axis=1).astype(np.int64)
    variables = {
        **{name: described(over, values[name], "see unit", text) for name, text in SPREAD.items()},
        "n_cycles": described(over[:2], count, "1", "cycles averaged"),
        "n_excluded": described(over[:2], excluded, "1", "cycles that a gap reaches"),
        "highest_order": described("speed", highest, "1", "highest order that is held whole"),
    }
    axes = {"speed": described("speed", speed, "min-1", "mean speed of the cycles")}
    axes["cycle_angle"] = described("cycle_angle", angle, "degree", "crank angle within the cycle")
    return xr.Dataset(variables, coords=channel_coords(like) | axes)


def _gap_flags(made: xr.Dataset) -> list[QualityFlag]:
    """One remark for each channel that lost cycles to gaps."""
    lost = made["n_excluded"].sum("speed").values
    kept = made["n_cycles"].sum("speed").values
    recording, hold = str(made.attrs["recording"]), "cycles hold a gap and are not averaged"
    names = made["channel"].values
    holed = [row for row in zip(names, lost, kept, strict=True) if row[1]]
    said = [(f"{name}: {n} of {n + rest} {hold}", rest) for name, n, rest in holed]
    return [remark(recording, "cycles_excluded", detail, "info" if rest else "bad") for detail, rest in said]


def cycle_averages(items: list[xr.Dataset], *, speed_bin_rpm: float) -> xr.Dataset:
    """CycleAverage of a test from those of its recordings, joined where their speeds are within ``speed_bin_rpm``.

    ``items`` are CycleAverages (channel, speed, cycle_angle) of :func:`cycle_average` with one list of channels and one
    grid of angles. Recordings count by their cycles; the standard error grows where recordings differ by more than
    their own errors say (Birge 1932). Recordings whose angle 0 is not known to be the same (no mark, or a four-stroke
    cycle that may begin at either top dead centre) are not joined: of those at like speed the one with most cycles is
    kept.
    """
    speed = np.concatenate([item["speed"].values for item in items])
    place = [(item, row) for item in items for row in range(item.sizes["speed"])]
    # the mark is passed in one turn of the cycle, or which one is known
    one_turn = [int(item.attrs["cycle_known"]) or int(item.attrs["revs_per_cycle"]) == 1 for item in items]
    comparable = len(items) == 1 or (one_phase_reference(items) and all(one_turn))
    groups = speed_groups(speed, width_rpm=speed_bin_rpm)
    if groups and np.isnan(speed[groups[-1][0]]):
        # nothing says that two unknown speeds are alike
        groups = [*groups[:-1], *(np.array([index]) for index in groups[-1])]
    parts, kept_speed, excluded, highest, left_out = [], [], [], [], 0
    for group in groups:
        rows = [place[index] for index in group]
        if not comparable and len(rows) > 1:
            most, _ = max(rows, key=lambda each: int(each[0]["n_cycles"].values[:, each[1]].max()))
            left_out += sum(item is not most for item, _ in rows)
            rows = [(item, row) for item, row in rows if item is most]
        weight = np.array([float(item["n_cycles"].values[:, row].max()) for item, row in rows])
        each = np.array([item["speed"].values[row] for item, row in rows])
        kept_speed.append(float(each @ weight / weight.sum()) if weight.sum() else float(each.mean()))
        excluded.append(sum(item["n_excluded"].values[:, row] for item, row in rows))
        highest.append(min(float(item["highest_order"].values[row]) for item, row in rows))
        told = ({name: item[name].values[:, row] for name in (*SPREAD, "n_cycles")} for item, row in rows)
        parts.append(_joined(list(told)))
    revs = int(items[0].attrs["revs_per_cycle"])
    points = items[0].sizes["cycle_angle"] // revs
    made = _dataset(parts, np.array(kept_speed), np.stack(excluded, axis=1), np.array(highest), items[0], points)
    kept = ("phase_reference", "cycle_known", "revs_per_cycle", "max_order")
    made.attrs = {key: items[0].attrs[key] for key in kept} | {"speed_bin_rpm": speed_bin_rpm}
    if not comparable:
        made.attrs |= {"phase_reference": phase_reference_of(items), "cycle_known": 0}
    flags = [flag for item in items for flag in flags_of(item)]
    if left_out:
        detail = f"angle 0 is not known to be the same in every recording: {left_out} at like speed left out"
        flags.append(remark("", "cycles_not_joined", detail))
    return with_flags(made, flags)


def _joined(parts: list[CycleStatistics]) -> CycleStatistics:
    """Statistics of all cycles of ``parts`` (Chan, Golub and LeVeque 1983, pairwise means and sums of squares)."""
    if len(parts) == 1:
        return parts[0]
    count = np.stack([part["n_cycles"] for part in parts]).astype(np.float64)[..., None]
    total = np.maximum(count.sum(axis=0), 1.0)
    means = np.stack([part["mean"] for part in parts])
    scale = power_of_two(means.swapaxes(0, 1))[:, 0]
    apart = np.nan_to_num(means / scale)
    mean = (count * apart).sum(axis=0) / total
    between = (count * (apart - mean) ** 2).sum(axis=0)
    spread = np.nan_to_num(np.stack([part["standard_deviation"] for part in parts]) / scale)
    squares = ((count - 1.0) * spread**2).clip(min=0.0).sum(axis=0) + between
    deviation = np.sqrt(squares / np.maximum(total - 1.0, 1.0))
    errors = np.stack([part["standard_error"] for part in parts]) / scale
    errors = np.where(count == 1.0, deviation, np.nan_to_num(errors))
    within = ((count / total) ** 2 * errors**2).sum(axis=0)
    used = np.count_nonzero(count, axis=0)  # where it is one there is nothing between
    excess = (between / np.maximum(used - 1.0, 1.0) / total).mean(axis=1, keepdims=True)
    expected = within.mean(axis=1, keepdims=True)
    ratio = np.divide(excess, expected, out=np.ones_like(excess), where=expected > 0.0)
    error = np.sqrt(np.where(expected > 0.0, within * np.maximum(ratio, 1.0), excess))
    none, single = count.sum(axis=0) == 0.0, count.sum(axis=0) < 2.0
    return {
        "mean": np.where(none, np.nan, mean * scale),
        "standard_deviation": np.where(single, np.nan, deviation * scale),
        "standard_error": np.where(single, np.nan, error * scale),
        "minimum": np.fmin.reduce([part["minimum"] for part in parts]),
        "maximum": np.fmax.reduce([part["maximum"] for part in parts]),
        "n_cycles": count.sum(axis=0)[:, 0],
    }
