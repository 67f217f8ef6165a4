"""Tones as the recordings hold them: one line or several, mains, or none beside a stronger one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crankorder.identify.found import AgreedOrders, ModalFit, Tone
from crankorder.identify.lines.close_lines import (
    lines_within,
    several_lines,
    unparted_reach,
)
from crankorder.identify.lines.known_lines import LineSeen, found_near
from crankorder.identify.lines.mains import NUMBERS as MAINS
from crankorder.identify.lines.mains import multiples_near, with_mains_tones
from crankorder.identify.modes.tones import NEAR_BINS, with_one_mains
from crankorder.orders.intervals import Z95
from crankorder.orders.joint_lines import LOBE_BINS, HeldFrames, Place
from crankorder.orders.joint_lines import NUMBERS as JOINT_LINES
from crankorder.settings import IdentifySettings


def with_tones_settled(
    orders: AgreedOrders,
    modal: ModalFit,
    held: Sequence[HeldFrames],
    known: Sequence[LineSeen],
    *,
    settings: IdentifySettings,
) -> ModalFit:
    """``modal`` with each tone as the recordings hold it: one line or several, mains, or one of the ``orders``.

    ``held`` are the recordings at held speeds; ``known`` lines of the mains; ``settings``: the mains frequencies and
    how far they wander.
    """
    modal = with_mains_tones(with_tones_parted(modal, held), known, orders)
    modal = without_absent_mains(modal, held, settings=settings)
    return without_doubles(replace(modal, tones=with_one_mains(list(modal.tones), settings=settings)))


UNPARTED = "several lines that the recordings are too short to part, or one that swells"
"""What is said of a tone that is no single steady line."""


def with_tones_parted(modal: ModalFit, held: Sequence[HeldFrames]) -> ModalFit:
    """``modal`` without tones that are the flank of a stronger one, and with intervals that hold all lines of a tone.

    Lines closer than the main lobe of the map's window are one there; what the fit of the stronger leaves beside it is
    a tone only where the longest of the recordings ``held`` shows a line. Where that shows several within a bin of a
    tone, its interval holds all of them and its evidence names them; where it shows that the tone is no single line and
    does not part it, the intervals of frequency and amplitude are as wide as that leaves open.
    """
    step = modal.step_hz
    if not step or not modal.tones:
        return modal
    longest = max(held, key=lambda recording: recording.span_rev, default=None)
    lines = {tone.frequency_hz: _lines_near(longest, tone.frequency_hz, NEAR_BINS * step) for tone in modal.tones}
    kept = [
        tone
        for tone in modal.tones
        if any(abs(hertz - tone.frequency_hz) < 0.5 * step for hertz in lines[tone.frequency_hz])
        or not any(_is_flank(tone, other, NEAR_BINS * step) for other in modal.tones)
    ]
    centres = [tone.frequency_hz for tone in kept]
    tones = []
    for tone in kept:
        near = [f for f in lines[tone.frequency_hz] if abs(f - tone.frequency_hz) <= step]
        own = [f for f in near if min(centres, key=lambda centre: abs(centre - f)) == tone.frequency_hz]
        held_of_it = _holding(tone, own) if len(own) > 1 else tone
        tones.append(held_of_it if near else _unless_several(held_of_it, centres, longest, NEAR_BINS * step))
    return replace(modal, tones=tuple(tones))


def without_absent_mains(modal: ModalFit, held: Sequence[HeldFrames], *, settings: IdentifySettings) -> ModalFit:
    """``modal`` with higher multiples of the mains called tones where one of the recordings ``held`` has none there.

    A supply is there at every speed; what stands near one of its many multiples at some speeds is something else, but
    where it is the exact multiple of a supply that the test shows: a weak one is not seen in every recording. What may
    be mains or an order is an order where most recordings whose shaft has none there do not show it.
    ``settings``: the mains frequencies and how far they wander.
    """
    if not modal.step_hz:
        return modal
    mains = [tone for tone in modal.tones if tone.kind == "mains"]
    alone_hz = MAINS.alone_multiples * max(settings.mains_hz) + 2.0 * settings.mains_tolerance_hz
    supplies = [tone for tone in mains if not tone.frequency_hz > alone_hz]
    high = [tone for tone in mains if tone not in supplies]
    doubted = [tone for tone in high if not any(_is_multiple(tone, supply, settings) for supply in supplies)]
    doubted += [tone for tone in modal.tones if tone.kind == "mains or order"]
    tones = [_unless_absent(tone, held, modal.step_hz) if tone in doubted else tone for tone in modal.tones]
    return replace(modal, tones=tuple(tones))


def _is_multiple(tone: Tone, supply: Tone, settings: IdentifySettings) -> bool:
    """Whether ``tone`` is, within the errors of both, a whole multiple of what ``supply`` is one of."""
    for own, _ in multiples_near(supply.frequency_hz, supply.frequency_error_hz, settings=settings):
        times = round(tone.frequency_hz / supply.frequency_hz * own) / own
        error = np.hypot(tone.frequency_error_hz, times * supply.frequency_error_hz)
        if abs(tone.frequency_hz - times * supply.frequency_hz) <= Z95 * error:
            return True
    return False


def _unless_absent(tone: Tone, held: Sequence[HeldFrames], reach_hz: float) -> Tone:
    """``tone``, or no mains where a recording has none there although no order of its shaft hides the place.

    What may be an order as well is no mains where most of such recordings have none.
    """
    place = tone.frequency_hz
    inside = [run for run in held if run.reaches(1.0, run.order_of(Place(place + reach_hz)))]
    inside = [run for run in inside if not run.is_half(run.order_of(Place(place)))]
    shown = sum(found_near(run, place - reach_hz, place + reach_hz) is not None for run in inside)
    either = tone.kind == "mains or order"
    if not inside or shown >= (0.5 if either else 1.0) * len(inside):
        return tone
    words = f"{tone.evidence if either else 'no damping'}; {shown} of {len(inside)} recordings show it"
    return replace(tone, kind="order" if either else "tone", evidence=words)


def _is_flank(tone: Tone, other: Tone, reach_hz: float) -> bool:
    size, more = (max(value for value, _ in line.amplitude.values()) for line in (tone, other))
    return size < more and abs(tone.frequency_hz - other.frequency_hz) < reach_hz


def _unless_several(tone: Tone, centres_hz: Sequence[float], held: HeldFrames | None, reach_hz: float) -> Tone:
    """``tone``, or with wide intervals where ``held`` shows several lines there that it does not part.

    ``centres_hz``: all tones, which take part where they are within ``reach_hz``.
    """
    if held is None:
        return tone
    turn_hz = held.rpm / 60.0
    low, high = (tone.frequency_hz - reach_hz) / turn_hz, (tone.frequency_hz + reach_hz) / turn_hz
    if not held.reaches(low, high) or several_lines(held, low, high, beyond=LOBE_BINS / held.revs):
        return tone
    orders = [hertz / turn_hz for hertz in centres_hz if abs(hertz - tone.frequency_hz) <= reach_hz]
    halves = 0.5 * np.arange(np.ceil(2.0 * low), np.floor(2.0 * high) + 1.0)
    orders += [half for half in halves.tolist() if _beside(half, orders) * held.span_rev > JOINT_LINES.apart_cycles]
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


def _lines_near(held: HeldFrames | None, hertz: float, reach_hz: float) -> list[float]:
    """Frequencies in Hz of the lines of ``held`` within ``reach_hz`` that are no half orders of its shaft."""
    if held is None:
        return []
    turn_hz = held.rpm / 60.0
    orders = [line.order for line in lines_within(held, (hertz - reach_hz) / turn_hz, (hertz + reach_hz) / turn_hz)]
    return [order * turn_hz for order in orders if not held.is_half(order)]


def _holding(tone: Tone, hertz: Sequence[float]) -> Tone:
    """``tone`` with an interval that holds all lines at ``hertz``, of which it is made."""
    far = max(abs(hz - tone.frequency_hz) for hz in hertz)
    named = " and ".join(f"{hz:.6g}" for hz in sorted(hertz))
    words = f"{tone.evidence}; more than one line: the longest recording parts {named} Hz"
    error = max(tone.frequency_error_hz, 1.05 * far / Z95)
    return replace(tone, frequency_error_hz=error, evidence=words)


def without_doubles(modal: ModalFit) -> ModalFit:
    """``modal`` without tones that may be orders and stand on the flank of a stronger tone.

    Lines closer than the main lobe of the window are one in the map; such a one is what the fit of the stronger left.
    """
    reach = NEAR_BINS * modal.step_hz
    flanks = [tone for tone in modal.tones if any(_is_flank(tone, other, reach) for other in modal.tones)]
    return replace(modal, tones=tuple(t for t in modal.tones if "order" not in t.kind or t not in flanks))
