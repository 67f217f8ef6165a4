"""Findings that speak of speeds: crossings and speeds to avoid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

from crankorder.findings import AvoidedSpeed, CrossingFinding, FreeBand, OpenBand
from crankorder.identify.found import Crossing, SpeedBand, SpeedVerdicts


def crossing_records(found: Sequence[Crossing]) -> tuple[CrossingFinding, ...]:
    """Findings of the crossings ``found``."""
    told = [one.name for one in fields(Crossing) if one.name != "whirl"]
    return tuple(
        CrossingFinding(**{name: getattr(item, name) for name in told}, excited=item.excited) for item in found
    )


def avoided_records(verdicts: SpeedVerdicts) -> tuple[AvoidedSpeed, ...]:
    """Findings of the speeds of ``verdicts`` that are to be avoided, the worst first."""
    return tuple(
        AvoidedSpeed(
            rank=rank,
            order=item.orders[0],
            mode_hz=item.modes_hz[0],
            **{one.name: getattr(item, one.name) for one in fields(item)},
        )
        for rank, item in enumerate(verdicts.avoid, start=1)
    )


def free_records(bands: Sequence[SpeedBand]) -> tuple[FreeBand, ...]:
    """Findings of ``bands`` of speed that are free."""
    return tuple(FreeBand(low_rpm=one.low_rpm, high_rpm=one.high_rpm, remark=one.remark) for one in bands)


def open_records(bands: Sequence[SpeedBand]) -> tuple[OpenBand, ...]:
    """Findings of ``bands`` of speed that are neither free nor to be avoided."""
    return tuple(OpenBand(low_rpm=one.low_rpm, high_rpm=one.high_rpm, remark=one.remark) for one in bands)
