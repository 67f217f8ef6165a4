"""Tones of the map beside what the longest recording parts: flanks of stronger ones, and several lines told as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crankorder.identify.found import ModalFit, Tone
from crankorder.identify.intervals import Z95
from crankorder.identify.known_lines import LOBE_BINS, Held, found_near
from crankorder.identify.known_lines import NUMBERS as KNOWN_LINES
from crankorder.identify.lines.several_orders import several_lines, unparted_reach
from crankorder.identify.mains import NUMBERS as MAINS
from crankorder.identify.mains import multiples_near
from crankorder.identify.modal.tones import NEAR_BINS
from crankorder.settings import IdentifySettings

UNPARTED = "several lines that the recordings are too short to part, or one that swells"
"""What is said of a tone that is no single steady line."""


def with_tones_parted(modal: ModalFit, held: Sequence[Held]) -> ModalFit:
    """``modal`` without tones that are the flank of a stronger one, and with intervals that hold all lines of a tone.

    Lines closer than the main lobe of the map's window are one there; what the fit of the stronger leaves beside it is
    a tone only where the longest of the recordings ``held`` shows a line. Where that shows several within a bin of a
    tone, its interval holds all of them and its evidence names them; where it shows that the tone is no single line and
    does not part it, the intervals of frequency and amplitude are as wide as that leaves open.
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
        held_of_it = _holding(tone, own) if len(own) > 1 else tone
        made.append(held_of_it if near else _unless_several(held_of_it, centres, longest, NEAR_BINS * step))
    return replace(modal, tones=tuple(made))


def without_absent_mains(modal: ModalFit, held: Sequence[Held], *, settings: IdentifySettings) -> ModalFit:
    """``modal`` with higher multiples of the mains called tones where one of the recordings ``held`` has none there.

    A supply is there at every speed; what stands near one of its many multiples at some speeds is something else, but
    where it is the exact multiple of a supply that the test shows: a weak one is not seen in every recording.
    ``settings``: the mains frequencies and how far they wander.
    """
    if len(modal.frequency_hz) < 2:
        return modal
    step = float(modal.frequency_hz[1] - modal.frequency_hz[0])
    mains = [tone for tone in modal.tones if tone.kind == "mains"]
    supplies = [tone for tone in mains if not _is_high(tone, settings)]
    high = [tone for tone in mains if tone not in supplies]
    doubted = [tone for tone in high if not any(_is_multiple(tone, one, settings) for one in supplies)]
    tones = [_unless_absent(tone, held, step) if tone in doubted else tone for tone in modal.tones]
    return replace(modal, tones=tuple(tones))


def _is_high(tone: Tone, settings: IdentifySettings) -> bool:
    """Whether a ``tone`` lies far above the multiples of the mains that may stand alone."""
    return tone.frequency_hz > MAINS.alone_multiples * max(settings.mains_hz) + 2.0 * settings.mains_tolerance_hz


def _is_multiple(tone: Tone, supply: Tone, settings: IdentifySettings) -> bool:
    """Whether ``tone`` is, within the errors of both, a whole multiple of what ``supply`` is one of."""
    for own, _ in multiples_near(supply.frequency_hz, supply.frequency_error_hz, settings=settings):
        times = round(tone.frequency_hz / supply.frequency_hz * own) / own
        error = np.hypot(tone.frequency_error_hz, times * supply.frequency_error_hz)
        if abs(tone.frequency_hz - times * supply.frequency_hz) <= Z95 * error:
            return True
    return False


def _unless_absent(tone: Tone, held: Sequence[Held], reach_hz: float) -> Tone:
    """``tone``, or no mains where a recording has none there although no order of its shaft hides the place."""
    place = tone.frequency_hz
    inside = [one for one in held if one.order_of((place + reach_hz, 0.0)) + LOBE_BINS / one.revs < one.axis[-1]]
    inside = [one for one in inside if not _is_hidden(one, place)]
    shown = sum(found_near(one, place - reach_hz, place + reach_hz) is not None for one in inside)
    if not inside or shown == len(inside):
        return tone
    return replace(tone, kind="tone", evidence=f"no damping; {shown} of {len(inside)} recordings show it")


def _is_hidden(held: Held, hertz: float) -> bool:
    """Whether a whole or half order of the shaft stands at ``hertz`` in a recording, so that nothing else is seen."""
    order = held.order_of((hertz, 0.0))
    return abs(2.0 * order - round(2.0 * order)) * 0.5 * held.span_rev < KNOWN_LINES.apart_cycles


def _is_flank(tone: Tone, other: Tone, reach_hz: float) -> bool:
    size, more = (max(value for value, _ in one.amplitude.values()) for one in (tone, other))
    return size < more and abs(tone.frequency_hz - other.frequency_hz) < reach_hz


def _unless_several(tone: Tone, centres_hz: Sequence[float], held: Held | None, reach_hz: float) -> Tone:
    """``tone``, or with wide intervals where ``held`` shows several lines there that it does not part.

    ``centres_hz``: all tones, which take part where they are within ``reach_hz``.
    """
    if held is None:
        return tone
    turn_hz, beyond = held.rpm / 60.0, LOBE_BINS / held.revs
    low, high = (tone.frequency_hz - reach_hz) / turn_hz, (tone.frequency_hz + reach_hz) / turn_hz
    if low - beyond <= 0.0 or high + beyond >= held.axis[-1] or several_lines(held, low, high, beyond=beyond):
        return tone
    orders = [hertz / turn_hz for hertz in centres_hz if abs(hertz - tone.frequency_hz) <= reach_hz]
    halves = 0.5 * np.arange(np.ceil(2.0 * low), np.floor(2.0 * high) + 1.0)
    orders += [half for half in halves.tolist() if _beside(half, orders) * held.span_rev > KNOWN_LINES.apart_cycles]
    ends = unparted_reach(held, low, high, orders)
    if ends is None:
        return tone
    far = max(abs(end * turn_hz - tone.frequency_hz) for end in ends)
    words = f"{tone.evidence}; {UNPARTED}"
    amplitude = {name: (size, max(error, size / Z95)) for name, (size, error) in tone.amplitude.items()}
    error = max(tone.frequency_error_hz, far / Z95)
    return replace(tone, frequency_error_hz=error, amplitude=amplitude, evidence=words)


def _beside(order: float, orders: Sequence[float]) -> float:
    return min(abs(order - other) for other in orders)


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
