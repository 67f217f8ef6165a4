"""Tones of the map beside what the longest recording parts: flanks of stronger ones, and several lines told as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from crankorder.identify.found import ModalFit, Tone
from crankorder.identify.intervals import Z95
from crankorder.identify.known_lines import LOBE_BINS, Held
from crankorder.identify.known_lines import NUMBERS as KNOWN_LINES
from crankorder.identify.lines.several_orders import several_lines
from crankorder.identify.modal.tones import NEAR_BINS


def with_tones_parted(modal: ModalFit, held: Sequence[Held]) -> ModalFit:
    """``modal`` without tones that are the flank of a stronger one, and with intervals that hold all lines of a tone.

    Lines closer than the main lobe of the map's window are one there; what the fit of the stronger leaves beside it is
    a tone only where the longest of the recordings ``held`` shows a line. Where that shows several within a bin of a
    tone, its interval holds all of them and its evidence names them.
    """
    if len(modal.frequency_hz) < 2 or not modal.tones:
        return modal
    step = float(modal.frequency_hz[1] - modal.frequency_hz[0])
    longest = max(held, key=lambda one: one.span_rev, default=None)
    lines = {tone.frequency_hz: _lines_near(longest, tone.frequency_hz, NEAR_BINS * step) for tone in modal.tones}
    kept = [
        tone
        for tone in modal.tones
        if any(abs(hertz - tone.frequency_hz) < 0.5 * step for hertz in lines[tone.frequency_hz])
        or not any(_is_flank(tone, other, NEAR_BINS * step) for other in modal.tones)
    ]
    centres = [tone.frequency_hz for tone in kept]
    made = []
    for tone in kept:
        near = [f for f in lines[tone.frequency_hz] if abs(f - tone.frequency_hz) <= step]
        own = [f for f in near if min(centres, key=lambda one: abs(one - f)) == tone.frequency_hz]
        made.append(_holding(tone, own) if len(own) > 1 else tone)
    return replace(modal, tones=tuple(made))


def _is_flank(tone: Tone, other: Tone, reach_hz: float) -> bool:
    size, more = (max(value for value, _ in one.amplitude.values()) for one in (tone, other))
    return size < more and abs(tone.frequency_hz - other.frequency_hz) < reach_hz


def _lines_near(held: Held | None, hertz: float, reach_hz: float) -> list[float]:
    """Frequencies in Hz of the lines of ``held`` within ``reach_hz`` that are no half orders of its shaft."""
    if held is None:
        return []
    turn_hz, beyond = held.rpm / 60.0, LOBE_BINS / held.revs
    low, high = (hertz - reach_hz) / turn_hz, (hertz + reach_hz) / turn_hz
    if low - beyond <= 0.0 or high + beyond >= held.axis[-1]:
        return []
    found = several_lines(held, low, high, beyond=beyond)
    free = [
        one.order
        for one in found
        if abs(2.0 * one.order - round(2.0 * one.order)) * held.span_rev > KNOWN_LINES.apart_cycles
    ]
    return [order * turn_hz for order in free]


def _holding(tone: Tone, hertz: Sequence[float]) -> Tone:
    """``tone`` with an interval that holds all lines at ``hertz``, of which it is made."""
    far = max(abs(one - tone.frequency_hz) for one in hertz)
    named = " and ".join(f"{one:.6g}" for one in sorted(hertz))
    words = f"{tone.evidence}; more than one line: the longest recording parts {named} Hz"
    error = max(tone.frequency_error_hz, 1.05 * far / Z95)
    return replace(tone, frequency_error_hz=error, evidence=words)
