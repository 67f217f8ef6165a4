"""What of a test rests on a speed that is itself in doubt: then nothing that needs the speed is decided."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from crankorder.identify.found import AgreedOrder, SpeedVerdicts
from crankorder.quantities import QualityFlag

DOUBTS = ("speed_tie", "speed_doubtful")
"""Flags of recordings whose speed was read from the vibration and may be another."""

IN_DOUBT = "the speed is in doubt"


def speed_doubt(flags: Iterable[QualityFlag]) -> str | None:
    """Why the speed of a test is in doubt, by the ``flags`` of its recordings; None where none says so."""
    told = [flag for flag in flags if flag["flag"] in DOUBTS]
    if not told:
        return None
    names = list(dict.fromkeys(flag["recording"] for flag in told))
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f"{told[0]['detail']} ({names[0]}{more})"


def undecided_orders(orders: tuple[AgreedOrder, ...]) -> tuple[AgreedOrder, ...]:
    """``orders`` of which none is said to be locked or to slip, for the speed that they count by is in doubt."""
    return tuple(
        replace(
            one,
            lock="undecided",
            needed_revs=None,
            reservation="; ".join(part for part in (one.reservation, IN_DOUBT) if part),
        )
        for one in orders
    )


def without_free(verdicts: SpeedVerdicts) -> SpeedVerdicts:
    """``verdicts`` in which no speed is free: what was is open, for another speed may have been meant."""
    opened = tuple(replace(band, remark=IN_DOUBT) for band in verdicts.free)
    merged = sorted((*verdicts.open, *opened), key=lambda band: band.low_rpm)
    return replace(verdicts, free=(), open=tuple(merged))
