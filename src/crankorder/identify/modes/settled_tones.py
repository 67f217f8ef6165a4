"""Tones of the map beside what single recordings show of them: mains, a tone, or an order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crankorder.identify.found import AgreedOrders, ModalFit, Tone
from crankorder.identify.lines.known_lines import LineSeen, found_near
from crankorder.identify.lines.mains import NUMBERS as MAINS
from crankorder.identify.lines.mains import multiples_near, with_mains_tones
from crankorder.identify.modes.tones import NEAR_BINS, with_one_mains
from crankorder.orders.intervals import Z95
from crankorder.orders.joint_lines import HeldFrames, Place
from crankorder.settings import IdentifySettings


def with_tones_settled(
    orders: AgreedOrders,
    modal: ModalFit,
    held: Sequence[HeldFrames],
    known: Sequence[LineSeen],
    *,
    settings: IdentifySettings,
) -> ModalFit:
    """``modal`` with each tone as the recordings hold it: mains, a tone, or one of the ``orders``.

    ``held`` are the recordings at held speeds; ``known`` lines of the mains; ``settings``: the mains frequencies and
    how far they wander.
    """
    modal = with_mains_tones(modal, known, orders)
    modal = without_absent_mains(modal, held, settings=settings)
    return without_doubles(replace(modal, tones=with_one_mains(list(modal.tones), settings=settings)))


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


def without_doubles(modal: ModalFit) -> ModalFit:
    """``modal`` without tones that may be orders and stand on the flank of a stronger tone.

    Lines closer than the main lobe of the window are one in the map; such a one is what the fit of the stronger left.
    """
    reach = NEAR_BINS * modal.step_hz
    flanks = [tone for tone in modal.tones if any(_is_flank(tone, other, reach) for other in modal.tones)]
    return replace(modal, tones=tuple(t for t in modal.tones if "order" not in t.kind or t not in flanks))
