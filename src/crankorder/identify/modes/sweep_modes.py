"""Modes of a test whose speed sweeps, as its signals tell them, and the rows of orders near these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from crankorder.identify.found import ModalFit, Mode, SweepFits
from crankorder.identify.modes.order_blocks import TURNS_SURELY
from crankorder.identify.modes.surface_fit import Poles, covariance_among, poles_at, poles_of_modes, side_by_side
from crankorder.identify.modes.sweep_fit import MOST_VALUES
from crankorder.identify.modes.sweep_poles import GroupFit, SweepPole, sweep_fits
from crankorder.identify.modes.sweep_window import Solved, spectra_of
from crankorder.identify.modes.tones import is_shown
from crankorder.orders.swept_tracks import SMOOTHING, followed_error
from crankorder.quantities import Bools, Complexes, Floats
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "sweep_modes")


def poles_of(swept: Sequence[SweepPole]) -> tuple[Poles, Floats]:
    """Poles of ``swept`` and their covariance (of f_1, ζ_1, f_2, …)."""
    poles = poles_at((pole.frequency_hz, pole.damping) for pole in swept)
    values = poles.values.ravel()
    return poles, np.asarray(side_by_side([pole.covariance for pole in swept]) * values * values[:, None])


def unlike(poles: Poles, covariance: Floats, swept: Sequence[SweepPole]) -> Bools:
    """Which (M,) of the ``poles`` that the floor shows, with ``covariance``, are none of ``swept``: sweeps smear it.

    ``covariance``: (2M, 2M).
    """
    errors, widths = np.sqrt(np.maximum(np.diag(covariance)[::2], 0.0)), poles.damping * poles.frequency_hz
    own = np.ones(len(poles), dtype=np.bool_)
    for pole in swept:
        wide = np.maximum(widths, pole.damping * poles.frequency_hz)
        near = np.maximum(3.0 * np.hypot(errors, pole.frequency_error_hz), wide)
        own &= np.abs(poles.frequency_hz - pole.frequency_hz) > near
    return own


def with_sweep_modes(fit: ModalFit, swept: Sequence[SweepPole], settings: IdentifySettings) -> ModalFit:
    """``fit`` with the modes of ``swept`` in place of those that are the same.

    ``settings``: the least damping of a mode.
    """
    modes, (_, covariance) = [_mode_of(pole, settings=settings) for pole in swept], poles_of(swept)
    own = np.flatnonzero(unlike(poles_of_modes(fit.modes), fit.covariance, swept))
    tones = tuple(tone for tone in fit.tones if not any(is_shown(tone, mode) for mode in modes))
    both = side_by_side([covariance_among(fit.covariance, own), covariance])
    return replace(fit, modes=(*(fit.modes[k] for k in own), *modes), tones=tones, covariance=both)


def _mode_of(pole: SweepPole, *, settings: IdentifySettings) -> Mode:
    """Mode of a ``pole`` that the signals of sweeps tell; ``settings``: the least damping that a mode may have."""
    names = ", ".join(f"{order:g}" for order in pole.orders)
    many = len(pole.orders) > 1
    words = f"order{'s' if many else ''} {names} {'pass' if many else 'passes'} it, "
    words += f"{'each ' if many else ''}with amplitude and phase of a resonance, in the spectrum of the whole sweep"
    known = pole.frequency_hz, pole.frequency_error_hz, pole.damping, pole.damping_error
    return Mode(*known, pole.channels, 0.0, words, pole.orders, _doubt(pole, settings))


def _doubt(pole: SweepPole, settings: IdentifySettings) -> str:
    """Why a pole that the signals of sweeps tell may be no mode; empty where nothing speaks against it."""
    f, share, (low, high) = pole.frequency_hz, pole.damping_error / pole.damping, pole.span_hz
    alone = len(pole.orders) == 1 and pole.share < NUMBERS.alone_share
    at_end = f * (1.0 + pole.damping) > high or f * (1.0 - pole.damping) < low
    by_f = 100.0 * pole.frequency_error_hz / f
    reasons = (
        ("its damping is not determined", share > NUMBERS.known_share),
        (f"its frequency is known to {by_f:.1f} % only", by_f > 100.0 * NUMBERS.uncertain_share),
        ("hardly damped: a tone or a mode", pole.damping < 0.5 * settings.least_damping_ratio),
        (f"lies at the end of what was swept, {low:.1f} to {high:.1f} Hz", at_end),
        (f"passed by order {pole.orders[0]:g} alone, of which it is a small part", alone),
    )
    return "; ".join(reason for reason, given in reasons if given)


ROW_NUMBERS = MethodNumbers("5-identify-modal.toml", "sweep_rows")


def fits_of_sweeps(followed: Sequence[xr.Dataset], *, settings: IdentifySettings) -> SweepFits:
    """Poles that the signals in ``followed`` (RecordingTracks) of sweeps tell, behind the orders that were followed.

    ``settings``: the false-alarm level, the dampings of modes, and the confidence with which one is excluded.
    """
    sure = [tracks for tracks in followed if _turns_surely(tracks)]
    spectra = tuple(spectra_of(sure, fewest=ROW_NUMBERS.fewest_samples))
    highest = max((order for sweep in spectra for order in sweep.orders), default=0.0)
    if not highest:
        return SweepFits()
    cycle = spectra[0].cycle_rev
    return sweep_fits(spectra, others=(np.arange(1, cycle * highest + 1) / cycle).tolist(), settings=settings)


def _turns_surely(tracks: xr.Dataset) -> bool:
    """Whether the shaft's angle in ``tracks`` is known so well that its highest order keeps its phase.

    What a strong order is off by has amplitude and phase over the whole sweep, and would be taken for many light modes.
    """
    error = 2.0 * np.pi * float(tracks.attrs.get("crank_angle_error_rev", 0.0))
    return "waveform" in tracks and error * float(tracks["order"].values.max(initial=0.0)) <= ROW_NUMBERS.most_angle_rad


def with_rows_of_fits(followed: Sequence[xr.Dataset], fits: SweepFits) -> list[xr.Dataset]:
    """``followed`` (RecordingTracks) whose rows near the modes of ``fits`` are theirs, with one more at each peak.

    What each row would be if its speed were held is their ``held_amplitude`` (channel, order, frame): the steady answer
    of the fit near a mode, elsewhere what the filter tells with what it took put back, NaN beyond a gap of the signals.
    The attribute ``turns_surely`` says whether the angle is so sure that the signals were asked for modes at all.
    """
    replaced = []
    for tracks in followed:
        if "smoothing" in tracks:
            changed = ("amplitude", "standard_error", "degrees_of_freedom", *SMOOTHING)
            own = {name: tracks[name].copy() for name in changed}
            own["held_amplitude"] = (tracks["amplitude"] + tracks["smoothing"]).where(_asked(tracks))
            own["held_amplitude"].attrs = dict(tracks["amplitude"].attrs)
            tracks = tracks.assign(own).assign_attrs({TURNS_SURELY: int(_turns_surely(tracks))})
        for group in fits.groups if "waveform" in tracks else ():
            numbers = tracks["order"].values.tolist()
            proven = {order for pole in group.poles for order in pole.orders}
            for fit, less in zip(group.fit.bare.solved, group.less.bare.solved, strict=True):
                of_item = fit.window.sweep.recording == tracks.attrs["recording"]
                for order in fit.window.orders if of_item else ():
                    if order in numbers and order in less.window.orders:
                        place, alone = numbers.index(order), order not in proven
                        tracks = _with_order(tracks, place, group, (fit, less), alone=alone)
        replaced.append(tracks)
    return replaced


def _asked(tracks: xr.Dataset) -> xr.DataArray:
    """Which rows (frame,) of ``tracks`` the waveform reaches: nothing tells what a mode kept from the others."""
    if "waveform" not in tracks:
        return xr.ones_like(tracks["time"], dtype=bool)
    start, rate = (float(tracks.attrs[f"waveform_{name}"]) for name in ("start_s", "rate_hz"))
    return (tracks["time"] >= start) & (tracks["time"] <= start + tracks.sizes["sample"] / rate)


def _with_order(
    tracks: xr.Dataset, place: int, group: GroupFit, solved: tuple[Solved, Solved], *, alone: bool
) -> xr.Dataset:
    """``tracks`` with the rows of its order number ``place`` from a window ``solved`` twice, and one at its peak.

    Of an order that stands ``alone``, as no mode is proved by it, only those that others ring into the filter of, or
    that the fit knows better.
    """
    fit, less = solved
    window, order = fit.window, float(tracks["order"].values[place])
    half = 0.5 * ROW_NUMBERS.inner_share * (window.high_hz - window.low_hz)
    near = np.abs(order * tracks["speed"].values / 60.0 - 0.5 * (window.high_hz + window.low_hz)) <= half
    since = tracks["time"].values - window.sweep.start_s
    near &= (since >= 0.0) & (since <= window.sweep.length_s)
    if not near.any():
        return tracks
    value, error = _values(group, fit, less, order, tracks, near)
    if alone:
        better = _rung(tracks, place, near, fit) | (error < followed_error(tracks, place)[:, near].T).all(axis=1)
        near[near], value, error = better, value[better], error[better]
        if not better.any():
            return tracks
    peak = None if alone else _peak(fit, order, tracks["time"].values[near], np.abs(value).max(axis=1))
    if peak is not None:
        tracks, at = _with_row(tracks, peak, fit)
        near = np.insert(near, at, True)
        value, error = _values(group, fit, less, order, tracks, near)
    held = fit.held(order, order * tracks["speed"].values[near] / 60.0) - value
    value, error = _with_witness(tracks, place, near, value, error, rung=_rung(tracks, place, near, fit))
    usable = np.isfinite(tracks["amplitude"].values[:, place][:, near].real).any(axis=1)
    rows = np.ix_(np.flatnonzero(usable), np.array([place]), np.flatnonzero(near))
    for name, given in (("amplitude", value), ("held_amplitude", held + value), ("standard_error", error)):
        tracks[name].values[rows] = given.T[usable][:, None]
    for name in SMOOTHING:
        tracks[name].values[rows] = 0.0
    freedom = tracks["degrees_of_freedom"].values
    freedom[rows] = np.nanmax(freedom[:, place], initial=1.0)
    return tracks


def _with_witness(
    tracks: xr.Dataset, place: int, near: Bools, value: Complexes, error: Floats, *, rung: Bools
) -> tuple[Complexes, Floats]:
    """``value`` (T, C) of a fit and its ``error`` beside what the filter of ``tracks`` took in the rows ``near``.

    Where the filter takes little off and says surely something else, the model of the fit is off there by as much: the
    error grows by that, and the two are averaged by their errors (DerSimonian and Laird 1986). Not where what is
    ``rung`` (T,) reaches into the filter.
    """
    taken = tracks["smoothing"].values[:, place][:, near].T
    seen = tracks["amplitude"].values[:, place][:, near].T + taken
    own = np.hypot(followed_error(tracks, place), tracks["smoothing_more"].values[:, place])[:, near].T
    apart = np.square(np.abs(value - seen))
    with np.errstate(invalid="ignore", divide="ignore"):
        knows = (own < ROW_NUMBERS.witness_share * np.abs(seen)) & (own > 0.0) & ~rung[:, None]
        doubted = knows & (apart > ROW_NUMBERS.witness_sigmas**2 * (np.square(error) + np.square(own)))
        spread = np.maximum(0.5 * apart - np.square(own), np.square(error))
        weight = np.square(own) / (np.square(own) + spread)
        mixed = weight * value + (1.0 - weight) * seen
        mixed_error = np.sqrt(spread * np.square(own) / (np.square(own) + spread))
    return np.where(doubted, mixed, value), np.where(doubted, mixed_error, error)


def _rung(tracks: xr.Dataset, place: int, near: Bools, solved: Solved) -> Bools:
    """In which rows (T,), of those ``near``, a mode that another order has passed still rings in the filter."""
    order, sweep = float(tracks["order"].values[place]), solved.window.sweep
    time, width = tracks["time"].values[near], tracks["bandwidth_hz"].values[place, near]
    hz = order * tracks["speed"].values[near] / 60.0
    rung = np.zeros(len(time), dtype=bool)
    for f, zeta in zip(solved.natural_hz.tolist(), solved.damping.tolist(), strict=True):
        inside = np.abs(hz - f) < ROW_NUMBERS.witness_widths * width
        for other in solved.window.orders if inside.any() else ():
            over = other * sweep.speed_rpm > 60.0 * f
            passed = sweep.start_s + np.flatnonzero(over[1:] != over[:-1]) / sweep.rate_hz
            since = 2.0 * np.pi * zeta * f * (time[:, None] - passed)
            rung |= inside & (other != order) & ((since > 0.0) & (since < ROW_NUMBERS.witness_memory)).any(axis=1)
    return rung


def _values(
    group: GroupFit, solved: Solved, less: Solved, order: float, tracks: xr.Dataset, near: Bools
) -> tuple[Complexes, Floats]:
    """Amplitudes (T, C) of ``order`` in the rows ``near`` of ``tracks`` and their standard errors by part.

    So many are told at a time that the memory does not grow with the recording.
    """
    every, values, errors = np.flatnonzero(near), list[Complexes](), list[Floats]()
    for some in np.array_split(every, min(1 + len(every) * len(solved.left) // MOST_VALUES, len(every))):
        at = tracks["time"].values[some], tracks["crank_angle"].values[some]
        variance = solved.envelope_variance(order, solved.window.turn(order, *at), group.covariance)
        value, other = (_amplitude(fit, order, *at) for fit in (solved, less))
        error = 0.5 * variance + np.square(np.abs(value - other))
        error += np.square(ROW_NUMBERS.least_error_share * np.abs(value))
        error += np.square(ROW_NUMBERS.begun_share * np.abs(solved.as_started(order, *at)))
        values.append(value)
        errors.append(np.sqrt(error))
    return np.concatenate(values), np.concatenate(errors)


def _amplitude(solved: Solved, order: float, time_s: Floats, angle_rev: Floats) -> Complexes:
    """Amplitudes (T, C) of ``order`` by ``solved`` fit at ``time_s``, where the shaft stands at ``angle_rev``."""
    if order * solved.window.sweep.swing_rev > ROW_NUMBERS.swing_rev:
        value = solved.line(order, angle_rev)
    else:
        value = solved.envelope(order, solved.window.turn(order, time_s, angle_rev))
    return value + solved.as_started(order, time_s, angle_rev)


def _peak(solved: Solved, order: float, time_s: Floats, size: Floats) -> float | None:
    """Time between the rows ``time_s`` at which ``order`` is clearly larger than their largest ``size``; or None."""
    best = int(np.argmax(size))
    low, high = time_s[max(best - 1, 0)], time_s[min(best + 1, len(time_s) - 1)]
    if high <= low:
        return None
    fine = np.linspace(low, high, ROW_NUMBERS.between)
    sweep = solved.window.sweep
    between = np.abs(_amplitude(solved, order, fine, np.interp(fine, sweep.time_s, sweep.angle_rev))).max(axis=1)
    top = int(np.argmax(between))
    return float(fine[top]) if between[top] > ROW_NUMBERS.higher_ratio * size[best] else None


def _with_row(tracks: xr.Dataset, time_s: float, solved: Solved) -> tuple[xr.Dataset, int]:
    """``tracks`` with one row more at ``time_s``, in which nothing is known yet, and its number."""
    time = tracks["time"].values
    at = int(np.searchsorted(time, time_s))
    longer = tracks.isel(frame=np.insert(np.arange(len(time)), at, min(at, len(time) - 1)))
    sweep = solved.window.sweep
    longer.coords["time"].values[at] = time_s
    longer.coords["speed"].values[at] = np.interp(time_s, sweep.time_s, sweep.speed_rpm)
    longer.coords["crank_angle"].values[at] = np.interp(time_s, sweep.time_s, sweep.angle_rev)
    for name in ("amplitude", "held_amplitude", "standard_error"):
        longer[name].values[:, :, at] = np.nan
    for name in ("degrees_of_freedom", *SMOOTHING):
        longer[name].values[:, :, at] = 0.0
    return longer, at
