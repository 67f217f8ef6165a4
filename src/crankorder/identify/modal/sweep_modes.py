"""Modes of a test whose speed sweeps: what its signals tell stands for what the floor shows of the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.found import ModalFit, Mode
from crankorder.identify.modal.order_modes import is_shown
from crankorder.identify.modal.pole_errors import side_by_side
from crankorder.identify.modal.surface_fit import NO_POLES, Poles
from crankorder.identify.modal.sweep_poles import SweepPole
from crankorder.settings import IdentifySettings, MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-modal.toml", table="sweep_modes"):
    known_share: float
    uncertain_share: float
    alone_share: float


NUMBERS = _Numbers.load()

Array = NDArray[np.float64]


def poles_of(swept: Sequence[SweepPole]) -> tuple[Poles, Array]:
    """Poles of ``swept`` and their covariance (of f_1, ζ_1, f_2, …)."""
    made = NO_POLES
    for pole in swept:
        made = made.with_pole(pole.frequency_hz, pole.damping)
    return made, side_by_side([pole.covariance_of_values for pole in swept])


def _is_one_of(frequency_hz: float, error_hz: float, damping: float, swept: Sequence[SweepPole]) -> bool:
    """Whether a pole that the floor shows is one of those of ``swept``: what sweeps smears the floor."""
    return any(
        abs(frequency_hz - pole.frequency_hz)
        <= max(3.0 * np.hypot(error_hz, pole.frequency_error_hz), damping * frequency_hz, pole.damping * frequency_hz)
        for pole in swept
    )


def poles_unlike(poles: Poles, covariance: Array, swept: Sequence[SweepPole]) -> tuple[Poles, Array]:
    """Those of ``poles`` with their ``covariance`` that are none of ``swept``."""
    errors = np.sqrt(np.maximum(np.diag(covariance)[::2], 0.0))
    own = np.array(
        [
            not _is_one_of(float(f), float(error), float(zeta), swept)
            for f, error, zeta in zip(poles.frequency_hz, errors, poles.damping, strict=True)
        ],
        dtype=np.bool_,
    )
    at = np.flatnonzero(np.repeat(own, 2))
    return poles.chosen(own), covariance[np.ix_(at, at)]


def modes_unlike(fit: ModalFit, kept: Poles, swept: Sequence[SweepPole]) -> tuple[ModalFit, Poles]:
    """``fit``, whose modes are the poles ``kept``, without those that are of ``swept``."""
    own = [
        k
        for k, mode in enumerate(fit.modes)
        if not _is_one_of(mode.frequency_hz, mode.frequency_error_hz, mode.damping_ratio, swept)
    ]
    at = np.array([[2 * k, 2 * k + 1] for k in own], dtype=np.int64).ravel()
    modes = tuple(fit.modes[k] for k in own)
    which = np.isin(np.arange(len(kept)), own)
    return replace(fit, modes=modes, covariance=fit.covariance[np.ix_(at, at)]), kept.chosen(which)


def with_sweep_modes(
    fit: ModalFit, kept: Poles, swept: Sequence[SweepPole], settings: IdentifySettings
) -> tuple[ModalFit, Poles]:
    """``fit`` and its poles ``kept`` with the modes of ``swept``; ``settings``: the least damping of a mode."""
    modes = [_mode_of(pole, settings=settings) for pole in swept]
    poles, covariance = poles_of(swept)
    tones = tuple(tone for tone in fit.tones if not any(is_shown(tone, mode) for mode in modes))
    joined = replace(
        fit, modes=(*fit.modes, *modes), tones=tones, covariance=side_by_side([fit.covariance, covariance])
    )
    return joined, kept.joined(poles)


def _mode_of(pole: SweepPole, *, settings: IdentifySettings) -> Mode:
    """Mode of a ``pole`` that the signals of sweeps tell; ``settings``: the least damping that a mode may have."""
    names = ", ".join(f"{order:g}" for order in pole.orders)
    many = len(pole.orders) > 1
    words = f"order{'s' if many else ''} {names} {'pass' if many else 'passes'} it, "
    words += f"{'each ' if many else ''}with amplitude and phase of a resonance, in the spectrum of the whole sweep"
    return Mode(
        pole.frequency_hz,
        pole.frequency_error_hz,
        pole.damping,
        pole.damping_error,
        pole.channels,
        0.0,
        words,
        pole.orders,
        _doubt(pole, settings),
    )


def _doubt(pole: SweepPole, settings: IdentifySettings) -> str:
    """Why a pole that the signals of sweeps tell may be no mode; empty where nothing speaks against it."""
    f, share = pole.frequency_hz, pole.damping_error / pole.damping
    said = []
    if share > NUMBERS.known_share:
        said.append("its damping is not determined")
    if pole.frequency_error_hz > NUMBERS.uncertain_share * f:
        said.append(f"its frequency is known to {100.0 * pole.frequency_error_hz / f:.1f} % only")
    if pole.damping < 0.5 * settings.least_damping_ratio:
        said.append("hardly damped: a tone or a mode")
    low, high = pole.span_hz
    if f * (1.0 + pole.damping) > high or f * (1.0 - pole.damping) < low:
        said.append(f"lies at the end of what was swept, {low:.1f} to {high:.1f} Hz")
    if len(pole.orders) == 1 and pole.share < NUMBERS.alone_share:
        said.append(f"passed by order {pole.orders[0]:g} alone, of which it is a small part")
    return "; ".join(said)
