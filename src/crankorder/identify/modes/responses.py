"""What a fitted response of an order says of any speed: its amplitude, and what one mode adds to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from crankorder.identify.found import ModalFit, OrderResponse
from crankorder.identify.intervals import half_width, positive_interval
from crankorder.identify.modes.exclusion import NUMBERS as EXCLUSION
from crankorder.identify.modes.order_blocks import NUMBERS as ORDER_BLOCKS
from crankorder.identify.modes.order_modes import NUMBERS as ORDER_MODES
from crankorder.identify.modes.order_terms import force, resonance, resonance_slopes, smooth_shapes
from crankorder.quantities import Complexes, Floats
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="responses"):
    shape_error_share: float


NUMBERS = _Numbers.load()

SPEEDS = 800
"""Speeds over the range of a response at which its steady amplitude is looked at …"""

ABOUT_MODE, PER_MODE = 4.0, 81
"""… and those within so many half-power widths of each mode."""


@dataclass(frozen=True, eq=False)
class WithAndWithout:
    """Amplitude of an order ``with_mode`` and ``without`` it, and the standard error of both, each (channels, G).

    ``least`` (channels,) is what could be seen.
    """

    with_mode: Floats
    without: Floats
    with_error: Floats
    without_error: Floats
    least: Floats

    @property
    def ratio(self) -> Floats:
        """Amplification (G,) as fitted: the largest amplitude of any channel over the largest without the mode."""
        return np.asarray(self.with_mode.max(axis=0) / self._at_least(self.without))

    def ends(self, sigmas: float, *, matters: float = 0.0) -> tuple[Floats, Floats]:
        """Least and largest amplification (G,) within so many ``sigmas``.

        ``matters``: an amplitude below which none matters; the largest amplification is over no less.
        """
        low = np.maximum(self.with_mode - sigmas * self.with_error, 0.0).max(axis=0)
        high = (self.with_mode + sigmas * self.with_error).max(axis=0)
        below, above = self.without - sigmas * self.without_error, self.without + sigmas * self.without_error
        return low / self._at_least(above), high / np.maximum(self._at_least(below), matters)

    def _at_least(self, amplitude: Floats) -> Floats:
        return np.asarray(np.maximum(amplitude, self.least[:, None]).max(axis=0))


def together(parts: Sequence[WithAndWithout]) -> WithAndWithout:
    """``parts`` of several channels of one unit as one."""
    joined = (np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(WithAndWithout))
    return WithAndWithout(*joined)


def shapes(frequency_hz: Floats, modal: ModalFit) -> Complexes:
    """Response (frequencies, modes) of each mode of ``modal`` at ``frequency_hz``: −x² / (1 − x² + 2iζx), x = f/f_j."""
    natural = np.array([mode.frequency_hz for mode in modal.modes])
    damping = np.array([mode.damping_ratio for mode in modal.modes])
    return resonance(frequency_hz, natural, damping)


def held_amplitudes(response: OrderResponse, rpm: Floats, modal: ModalFit) -> tuple[Floats, Floats]:
    """Peak amplitude (G,) of ``response`` at ``rpm`` (G,) by the fit ``modal`` if each were held, and its error.

    That is the error of the linear terms and that of the poles of the modes, with which the terms move.
    """
    smooth, parts, columns = _parts(response, rpm, modal)
    whole = smooth + parts.sum(axis=1)
    return np.abs(whole), _errors(response, rpm, modal, whole[None], columns[None])[0]


def with_and_without(response: OrderResponse, number: int, rpm: Floats, modal: ModalFit) -> WithAndWithout:
    """Amplitude of ``response`` at ``rpm`` (G,) with mode ``number`` of ``modal`` and without it."""
    smooth, parts, columns = _parts(response, rpm, modal)
    whole = smooth + parts.sum(axis=1)
    without = whole - parts[:, number]
    both = np.stack([columns, columns])
    both[1, :, len(response.smooth) + np.flatnonzero(response.reached == number)] = 0.0
    errors = _errors(response, rpm, modal, np.stack([whole, without]), both, but=number)
    ambiguous = NUMBERS.shape_error_share * np.sqrt(len(response.smooth) - 1) * np.abs(without)
    rows = (np.abs(whole)[None], np.abs(without)[None], errors[:1], np.hypot(errors[1], ambiguous)[None])
    return WithAndWithout(*rows, np.array([EXCLUSION.noise_sigmas * response.error]))


def _errors(
    response: OrderResponse, rpm: Floats, modal: ModalFit, values: Complexes, columns: Complexes, *, but: int = -1
) -> Floats:
    """Standard errors (V, G) of the amplitudes of ``values`` at ``rpm`` (G,), the second of them without mode ``but``.

    ``columns`` (V, G, terms) make them of the linear terms, which move with the poles.
    """
    squared = np.maximum(((columns @ response.covariance) * columns.conj()).sum(axis=2).real, 0.0)
    reached = response.reached
    at = np.stack([2 * reached, 2 * reached + 1], axis=1).ravel()
    if not len(at) or int(at.max()) >= len(modal.covariance):
        return np.asarray(np.sqrt(squared))
    poles = np.array([(modal.modes[k].frequency_hz, modal.modes[k].damping_ratio) for k in reached.tolist()])
    spread = modal.covariance[np.ix_(at, at)] / np.outer(poles.ravel(), poles.ravel())
    # of a pole that is not determined a derivative says nothing: that it is not decided is said elsewhere
    told = np.repeat(np.diag(spread)[1::2] <= ORDER_MODES.known_share**2, 2)
    spread = np.where(told[:, None] & told, spread, 0.0)
    grown = _force_of(response, rpm)[:, None]
    residues = np.array([response.residue[reached], np.where(reached == but, 0.0, response.residue[reached])])
    by_poles = np.zeros((*values.shape, len(at)), dtype=np.complex128)  # derivatives by (ln f, ln ζ) of the modes
    for offset, slope in enumerate(resonance_slopes(response.order * rpm / 60.0, *poles.T)):
        by_poles[..., offset::2] = grown * slope * residues[: len(values), None]
    if response.slopes is not None:
        by_poles += columns @ response.slopes
    along = (by_poles * (values.conj() / np.maximum(np.abs(values), 1e-300))[..., None]).real
    return np.asarray(np.sqrt(squared + np.maximum(((along @ spread) * along).sum(axis=2), 0.0)))


def _force_of(response: OrderResponse, rpm: Floats) -> Complexes:
    """Force (G,) of ``response`` at ``rpm``."""
    grown = force(rpm, response.span_rpm, response.reference_rpm, response.exponent, response.law)
    return np.asarray(grown, dtype=np.complex128)


def _parts(response: OrderResponse, rpm: Floats, modal: ModalFit) -> tuple[Complexes, Complexes, Complexes]:
    """Smooth part (G,), that of each mode (G, M), and the columns (G, terms) behind the linear terms."""
    grown = _force_of(response, rpm)[:, None]
    smooth = grown * smooth_shapes(rpm, response.span_rpm, len(response.smooth) - 1)
    modes = grown * shapes(response.order * rpm / 60.0, modal)
    columns = np.concatenate([smooth, modes[:, response.reached]], axis=1)
    return smooth @ response.smooth, modes * response.residue, columns


@dataclass(frozen=True)
class HeldPeak:
    """Largest steady peak ``amplitude`` of an order in a channel, at ``rpm``.

    ``error`` is the standard error of the amplitude, with ``freedom`` degrees of freedom.
    """

    rpm: float
    amplitude: float
    error: float
    freedom: float

    @property
    def share(self) -> float:
        """Error as a share of the amplitude."""
        return self.error / max(self.amplitude, 1e-300)

    @property
    def ends(self) -> tuple[float, float]:
        """95 % interval of the amplitude."""
        return positive_interval(self.amplitude, half_width(self.freedom) * self.error)


def held_peak(modal: ModalFit, order: float, channel: str, *, largest_rpm: float) -> HeldPeak | None:
    """Amplitude that ``order`` would reach in ``channel`` at the worst speed of its sweeps, held, by the fit ``modal``.

    None where no response fits its sweeps over the speed ``largest_rpm`` at which it was seen largest. Of several
    recordings that pass the worst speed that counts which knows it best.
    """
    near = [
        response
        for response in modal.responses
        if response.fits
        and response.recording
        and response.channel == channel
        and abs(response.order - order) <= ORDER_BLOCKS.same_order_share * order
    ]
    peaks = [peak_of(response, modal) for response in near]
    spans = [response.span_rpm for response in near]
    if not any(low <= largest_rpm <= high for low, high in spans):
        return None
    worst = max(peaks, key=lambda peak: peak.amplitude)
    passing = [peak for peak, (low, high) in zip(peaks, spans, strict=True) if low <= worst.rpm <= high]
    return min(passing, key=lambda peak: peak.share)


def peak_of(response: OrderResponse, modal: ModalFit, ends: tuple[float, float] = (0.0, np.inf)) -> HeldPeak:
    """Largest steady amplitude of ``response`` by the fit ``modal``, of it what lies between ``ends`` [rpm]."""
    rpm = np.clip(_speeds(response, modal), *np.clip(ends, *response.span_rpm))
    smooth, parts, _ = _parts(response, rpm, modal)
    at = int(np.argmax(np.abs(smooth + parts.sum(axis=1))))
    amplitude, error = held_amplitudes(response, rpm[at : at + 1], modal)
    return HeldPeak(float(rpm[at]), float(amplitude[0]), float(error[0]), float(max(response.degrees_of_freedom, 1)))


def _speeds(response: OrderResponse, modal: ModalFit) -> Floats:
    """Speeds [rpm] at which ``response`` is looked at: over its range, and closer about the modes of ``modal``."""
    low, high = response.span_rpm
    reach = ABOUT_MODE * np.linspace(-1.0, 1.0, PER_MODE)
    near = [60.0 * mode.frequency_hz / response.order * (1.0 + mode.damping_ratio * reach) for mode in modal.modes]
    rpm = np.concatenate([np.linspace(low, high, SPEEDS), *near])
    return rpm[(rpm >= low) & (rpm <= high)]
