"""Rows of tracks near a resonance that a sweep passes, as the fit of the signals has them: no filter lowers a peak."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.modal.sweep_poles import GroupFit, SweepFits, sweep_fits
from crankorder.identify.modal.sweep_window import Solved, spectra_of
from crankorder.orders.swept_tracks import SMOOTHING, followed_error
from crankorder.settings import IdentifySettings, MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-modal.toml", table="sweep_rows"):
    fewest_samples: int
    most_angle_rad: float
    inner_share: float
    least_error_share: float
    speed_error_share: float
    most_off_share: float
    between: int
    higher_ratio: float
    begun_share: float
    witness_share: float
    witness_sigmas: float
    witness_widths: float
    witness_memory: float


NUMBERS = _Numbers.load()

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]


def fits_of_sweeps(followed: Sequence[xr.Dataset], *, settings: IdentifySettings) -> SweepFits:
    """Poles that the signals in ``followed`` (RecordingTracks) of sweeps tell, behind the orders that were followed.

    ``settings``: the false-alarm level, the dampings of modes, and the confidence with which one is excluded.
    """
    spectra = spectra_of([item for item in followed if _turns_surely(item)], fewest=NUMBERS.fewest_samples)
    highest = max((order for one in spectra for order in one.orders), default=0.0)
    if not highest:
        return SweepFits()
    cycle = int(followed[0].attrs["revs_per_cycle"])
    return sweep_fits(
        spectra,
        others=(np.arange(1, cycle * highest + 1) / cycle).tolist(),
        settings=settings,
    )


def _turns_surely(item: xr.Dataset) -> bool:
    """Whether the shaft's angle in ``item`` is known so well that its highest order keeps its phase.

    What a strong order is off by has amplitude and phase over the whole sweep, and would be taken for many light modes.
    """
    error = 2.0 * np.pi * float(item.attrs.get("crank_angle_error_rev", 0.0))
    return "waveform" in item and error * float(item["order"].values.max(initial=0.0)) <= NUMBERS.most_angle_rad


def with_rows_of_fits(followed: Sequence[xr.Dataset], fits: SweepFits) -> list[xr.Dataset]:
    """``followed`` (RecordingTracks) whose rows near the modes of ``fits`` are theirs, with one more at each peak."""
    made = []
    for item in followed:
        for group in fits.groups if "waveform" in item else ():
            for one, less in zip(group.fit.solved, group.less.solved, strict=True):
                if one.window.sweep.recording == item.attrs["recording"]:
                    item = _with_group(item, group, one, less)
        made.append(item)
    return made


def _with_group(item: xr.Dataset, group: GroupFit, one: Solved, less: Solved) -> xr.Dataset:
    """``item`` with the rows of one window of a ``group``; ``less`` is that with one degree less."""
    proven = {order for pole in group.poles for order in pole.orders}
    numbers = item["order"].values.tolist()
    for order in one.window.orders:
        if order in numbers and order in less.window.orders:
            item = _with_order(item, numbers.index(order), group, (one, less), alone=order not in proven)
    return item


def _with_order(
    item: xr.Dataset, place: int, group: GroupFit, solved: tuple[Solved, Solved], *, alone: bool
) -> xr.Dataset:
    """``item`` with the rows of its order number ``place`` from a window ``solved`` twice, and one at its peak.

    Of an order that stands ``alone``, as no mode is proved by it, only those that others ring into the filter of, or
    that the fit knows better.
    """
    one, less = solved
    window, order = one.window, float(item["order"].values[place])
    half = 0.5 * NUMBERS.inner_share * (window.high_hz - window.low_hz)
    middle = 0.5 * (window.high_hz + window.low_hz)
    near = np.abs(order * item["speed"].values / 60.0 - middle) <= half
    last = window.sweep.start_s + len(window.sweep.angle_rev) / window.sweep.rate_hz
    near &= (item["time"].values >= window.sweep.start_s) & (item["time"].values <= last)
    if not near.any():
        return item
    value, error = _values(group, one, less, order, item["time"].values[near], item["crank_angle"].values[near])
    if alone:
        better = _rung(item, place, near, one) | (error < followed_error(item, place)[:, near].T).all(axis=1)
        near[near], value, error = better, value[better], error[better]
        if not better.any():
            return item
    peak = None if alone else _peak(one, order, item["time"].values[near], np.abs(value).max(axis=1))
    if peak is not None:
        item, at = _with_row(item, peak, one)
        near = np.insert(near, at, True)
        value, error = _values(group, one, less, order, item["time"].values[near], item["crank_angle"].values[near])
    else:
        item = item.copy(deep=True)
    value, error = _with_witness(item, place, near, value, error, rung=_rung(item, place, near, one))
    usable = np.isfinite(item["amplitude"].values[:, place][:, near].real).any(axis=1)
    rows = np.ix_(np.flatnonzero(usable), np.array([place]), np.flatnonzero(near))
    for name, given in (("amplitude", value), ("standard_error", error)):
        item[name].values[rows] = given.T[usable][:, None]
    for name in SMOOTHING:
        item[name].values[rows] = 0.0
    freedom = item["degrees_of_freedom"].values
    freedom[rows] = np.nanmax(freedom[:, place], initial=1.0)
    return item


def _with_witness(
    item: xr.Dataset, place: int, near: NDArray[np.bool_], value: Complex, error: Array, *, rung: NDArray[np.bool_]
) -> tuple[Complex, Array]:
    """``value`` (T, C) of a fit and its ``error`` beside what the filter of ``item`` took in the rows ``near``.

    Where the filter takes little off and says surely something else, the model of the fit is off there by as much: the
    error grows by that, and the two are averaged by their errors (DerSimonian and Laird 1986). Not where what is
    ``rung`` (T,) reaches into the filter.
    """
    taken = item["smoothing"].values[:, place][:, near].T
    seen = item["amplitude"].values[:, place][:, near].T + taken
    own = np.hypot(followed_error(item, place), item["smoothing_more"].values[:, place])[:, near].T
    apart = np.square(np.abs(value - seen))
    with np.errstate(invalid="ignore", divide="ignore"):
        knows = (own < NUMBERS.witness_share * np.abs(seen)) & (own > 0.0) & ~rung[:, None]
        doubted = knows & (apart > NUMBERS.witness_sigmas**2 * (np.square(error) + np.square(own)))
        spread = np.maximum(0.5 * apart - np.square(own), np.square(error))
        weight = np.square(own) / (np.square(own) + spread)
        mixed = weight * value + (1.0 - weight) * seen
        mixed_error = np.sqrt(spread * np.square(own) / (np.square(own) + spread))
    return np.where(doubted, mixed, value), np.where(doubted, mixed_error, error)


def _rung(item: xr.Dataset, place: int, near: NDArray[np.bool_], one: Solved) -> NDArray[np.bool_]:
    """In which rows (T,), of those ``near``, a mode that another order has passed still rings in the filter."""
    order, sweep = float(item["order"].values[place]), one.window.sweep
    time, width = item["time"].values[near], item["bandwidth_hz"].values[place, near]
    hz = order * item["speed"].values[near] / 60.0
    rung = np.zeros(len(time), dtype=bool)
    for f, zeta in zip(one.natural_hz.tolist(), one.damping.tolist(), strict=True):
        inside = np.abs(hz - f) < NUMBERS.witness_widths * width
        for other in one.window.orders if inside.any() else ():
            over = other * sweep.speed_rpm > 60.0 * f
            passed = sweep.start_s + np.flatnonzero(over[1:] != over[:-1]) / sweep.rate_hz
            since = 2.0 * np.pi * zeta * f * (time[:, None] - passed)
            rung |= inside & (other != order) & ((since > 0.0) & (since < NUMBERS.witness_memory)).any(axis=1)
    return rung


def _values(
    group: GroupFit, one: Solved, less: Solved, order: float, time_s: Array, angle_rev: Array
) -> tuple[Complex, Array]:
    """Amplitudes (T, C) of ``order`` at ``time_s`` and their standard errors by part."""
    window, sweep = one.window, one.window.sweep
    turn = window.turn(order, time_s, angle_rev)
    value, variance = one.envelope(order, turn, group.covariance)
    other, _ = less.envelope(order, turn, None)
    begun = one.as_started(order, time_s, angle_rev)
    value, other = value + begun, other + less.as_started(order, time_s, angle_rev)
    # where a row stands is known as well as its speed is: on a flank the phase turns in no time
    at = np.clip(((time_s - sweep.start_s) * sweep.rate_hz).astype(np.int64), 0, len(sweep.speed_rpm) - 1)
    off = NUMBERS.speed_error_share * sweep.speed_rpm[at] / np.maximum(sweep.rate_rpm_per_s[at], 1e-9)
    off = np.minimum(off, NUMBERS.most_off_share / max(float(one.damping.min(initial=1.0)) * window.high_hz, 1e-9))
    moved = one.envelope_rate(order, turn, value, sweep.speed_rpm[at] / 60.0) * off[:, None]
    error = 0.5 * variance + np.square(np.abs(value - other)) + np.square(NUMBERS.least_error_share * np.abs(value))
    error += np.square(NUMBERS.begun_share * np.abs(begun))
    return value, np.asarray(np.sqrt(error + np.square(np.abs(moved))))


def _peak(one: Solved, order: float, time_s: Array, size: Array) -> float | None:
    """Time between the rows ``time_s`` at which ``order`` is clearly larger than their largest ``size``; or None."""
    best = int(np.argmax(size))
    low, high = time_s[max(best - 1, 0)], time_s[min(best + 1, len(time_s) - 1)]
    if high <= low:
        return None
    fine = np.linspace(low, high, NUMBERS.between)
    sweep = one.window.sweep
    angle = np.interp(fine, sweep.start_s + np.arange(len(sweep.angle_rev)) / sweep.rate_hz, sweep.angle_rev)
    found = one.envelope(order, one.window.turn(order, fine, angle), None)[0] + one.as_started(order, fine, angle)
    found = np.abs(found).max(axis=1)
    top = int(np.argmax(found))
    return float(fine[top]) if found[top] > NUMBERS.higher_ratio * size[best] else None


def _with_row(item: xr.Dataset, time_s: float, one: Solved) -> tuple[xr.Dataset, int]:
    """``item`` with one row more at ``time_s``, in which nothing is known yet, and its number."""
    time = item["time"].values
    at = int(np.searchsorted(time, time_s))
    beside = min(at, len(time) - 1)
    made = item.isel(frame=np.insert(np.arange(len(time)), at, beside)).copy(deep=True)
    sweep = one.window.sweep
    sampled = sweep.start_s + np.arange(len(sweep.angle_rev)) / sweep.rate_hz
    for name, value in (
        ("time", time_s),
        ("speed", np.interp(time_s, sampled, sweep.speed_rpm)),
        ("crank_angle", np.interp(time_s, sampled, sweep.angle_rev)),
    ):
        made.coords[name].values[at] = value
    for name, nothing in (("amplitude", np.nan), ("standard_error", np.nan), ("degrees_of_freedom", 0.0)):
        made[name].values[:, :, at] = nothing
    for name in SMOOTHING:
        made[name].values[:, :, at] = 0.0
    return made, at
