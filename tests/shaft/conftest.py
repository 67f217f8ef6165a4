"""Shafts whose angle is known, the traces that encoders on them give, and measured traces read without the program."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from made.recordings import sampled


@dataclass(frozen=True)
class KnownShaft:
    """A shaft that turns ``speed_rpm`` with in-cycle speed irregularity ``{order: share of speed}``, sampled evenly."""

    speed_rpm: float
    rate_hz: float = 50_000.0
    duration_s: float = 3.0
    start_rev: float = 0.3217
    irregularity: dict[float, float] = field(default_factory=lambda: {1.0: 0.005, 2.0: 0.01, 4.0: 0.005})

    @property
    def time_s(self):
        return np.arange(round(self.duration_s * self.rate_hz)) / self.rate_hz

    def angle_rev(self, time_s=None):
        time_s = self.time_s if time_s is None else time_s
        steady = self.speed_rpm / 60.0 * time_s
        swing = sum(
            share / (2 * np.pi * order) * np.sin(2 * np.pi * order * steady + order)
            for order, share in self.irregularity.items()
        )
        return self.start_rev + steady + swing

    def square(self, pulses_per_rev, *, lost=None):
        """0/1 trace, high for the first half of each pulse; ``lost`` picks pulse numbers that do not come."""
        place = self.angle_rev() * pulses_per_rev
        high = place % 1.0 < 0.5
        if lost is not None:
            high &= ~lost(np.floor(place).astype(int))
        return high.astype(np.float32)

    def index(self, pulses_per_rev):
        """0/1 trace, high for the first pulse of each revolution."""
        return (self.angle_rev() % 1.0 < 1.0 / pulses_per_rev).astype(np.float32)

    def pulse_time_s(self, pulses_per_rev):
        """Exact times of the pulses, by Newton's method."""
        first, last = self.angle_rev(np.array([0.0, self.duration_s])) * pulses_per_rev
        angle = np.arange(np.ceil(first), np.floor(last) + 1) / pulses_per_rev
        time_s = (angle - self.start_rev) * 60.0 / self.speed_rpm
        for _ in range(50):
            time_s -= (self.angle_rev(time_s) - angle) * 60.0 / self.speed_rpm
        return time_s


@pytest.fixture(scope="session")
def known_shaft():
    return KnownShaft


@pytest.fixture(scope="session")
def recording_of():
    """Maker of Recording datasets with given pulse times."""

    def make(pulse_time_s, *, index_time_s=None, **attrs):
        defaults = {"rate_hz": 50_000.0, "encoder_kind": "pulse_times", "revs_per_cycle": 1}
        defaults |= {"pulses_per_rev": 360, "missing_teeth": 0, "ratio": 1.0}
        made = sampled(np.zeros((1, 5001)), **(defaults | attrs))
        if pulse_time_s is not None:
            made["pulse_time"] = ("pulse", pulse_time_s, {"units": "s"})
        if index_time_s is not None:
            made["index_time"] = ("revolution", index_time_s, {"units": "s"})
        return made

    return make
