"""Record of a motor in ``findings.json``: supply, slip at every speed, and its lines with their amplitudes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from crankorder.findings import Motor, MotorLine, MotorSpeed, UnseenLine
from crankorder.identify.intervals import Z95
from crankorder.identify.motors import LineSeen, MotorFound, words_of


def motor_record(found: MotorFound) -> Motor:
    """Record of the motor that was ``found``."""
    supply, half = found.supply_hz, found.supply_half_hz
    return Motor(
        supply_hz=supply,
        supply_hz_ci95=None if supply is None else (supply - half, supply + half),
        supply_measured=found.measured,
        poles=found.motor.poles,
        rotor_bars=found.motor.rotor_bars,
        misfit=found.misfit,
        speed_doubt=found.speed_doubt,
        bars_doubt=found.bars_doubt,
        speeds=tuple(
            MotorSpeed(
                speed_rpm=one.speed_rpm,
                synchronous_rpm=one.synchronous_rpm,
                slip=None if found.speed_doubt else one.slip,
                slip_ci95=None if found.speed_doubt else (one.slip - one.slip_half, one.slip + one.slip_half),
                pole_pass_hz=None if found.speed_doubt else one.pole_pass_hz,
                fits=one.fits,
            )
            for one in found.speeds
        ),
        lines=_lines(found.seen),
        not_seen=tuple(
            UnseenLine(name=f"motor, {name}", channel=channel, from_amplitude=limit)
            for name, channel, limit in found.least
        ),
    )


def _lines(seen: Sequence[LineSeen]) -> tuple[MotorLine, ...]:
    """One record per line and channel, of the recording in which it is largest."""
    largest: dict[tuple[str, int, float, str], tuple[float, MotorLine]] = {}
    count: dict[tuple[str, int, float, str], int] = {}
    for item in seen:
        for number, channel in enumerate(item.held.channels):
            size, error = float(item.sighting.amplitude[number]), float(item.sighting.error[number])
            if size < Z95 * error:
                continue
            key = item.line.name, item.line.mains, item.line.turns, channel
            count[key] = count.get(key, 0) + 1
            if key in largest and largest[key][0] >= size:
                continue
            largest[key] = (
                size,
                MotorLine(
                    name=words_of(item),
                    side=item.line.side,
                    channel=channel,
                    frequency_hz=item.hertz,
                    order=item.sighting.order,
                    speed_rpm=item.held.rpm,
                    amplitude=size,
                    amplitude_ci95=(max(0.0, size - Z95 * error), size + Z95 * error),
                    others=tuple(item.also),
                    n_recordings=1,
                ),
            )
    return tuple(replace(record, n_recordings=count[key]) for key, (_, record) in largest.items())
