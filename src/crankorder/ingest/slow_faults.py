"""What moves the mean of a signal and is no vibration: overload of a sensor's supply, settling at the start, drift."""

from __future__ import annotations

import math

import numpy as np

from crankorder.ingest.fault import SignalFault, runs_of
from crankorder.ingest.signal_survey import Floats, Survey, grouped
from crankorder.settings import IngestSettings

_GROUPS = 512
"""Pieces of a signal whose means are followed, at most …"""
_FEWEST = 48
"""… and at least: fewer show no decay."""
_DECAYS = 24
"""Time constants that are tried, evenly by ratio."""
_RISE = 3
"""Pieces within which an overload jumps to its peak."""
_LEFT = 0.1
"""What is left of a decay, over the vibration, from where on it takes no part."""
_MOST_EVENTS = 5


def find_slow_faults(survey: Survey, *, settings: IngestSettings) -> list[SignalFault]:
    """Overloads, a settling start and drift of the signal of ``survey`` by ``settings``, each with its samples."""
    group = max(len(survey.means) // _GROUPS, 1)
    means, step = grouped(survey.means, group), group * survey.size
    if len(means) < _FEWEST or not np.isfinite(means).all():
        return []
    spread = grouped(survey.means**2, group) - means**2 + grouped(survey.variances, group)
    vibration = math.sqrt(max(float(np.median(spread)), 0.0))
    if float(np.ptp(means)) <= settings.drift_ratio * vibration:
        return []
    found: list[SignalFault] = []
    free = np.ones(len(means), dtype=np.bool_)
    for _ in range(_MOST_EVENTS):
        event = _overload(means, free, vibration, step, survey.n_samples, settings)
        if event is None:
            break
        found.append(event)
        free[event.at.starts[0] // step : -(-event.at.ends[0] // step)] = False
    if not found:
        start = _settling(means, vibration, step, settings)
        found += [] if start is None else [start]
        free[: 0 if start is None else -(-int(start.at.ends[0]) // step)] = False
    drift = _drift(means, free, vibration, settings)
    return found if drift is None else [*found, drift]


def _decay(offsets: Floats) -> tuple[float, float, float]:
    """Size, time constant (pieces) and share of the variance that is told, of an exponential decay to nothing."""
    n = np.arange(len(offsets), dtype=np.float64)
    constants = np.geomspace(1.0, 2.0 * len(offsets), _DECAYS)
    shapes = np.exp(-n / constants[:, None])
    sizes = shapes @ offsets / np.square(shapes).sum(axis=1)
    left = np.square(offsets - sizes[:, None] * shapes).sum(axis=1)
    best = int(np.argmin(left))
    told = 1.0 - float(left[best]) / max(float(np.square(offsets).sum()), 1e-300)
    return float(sizes[best]), float(constants[best]), told


def _ends_after(size: float, constant: float, vibration: float) -> float:
    """Pieces after which a decay from ``size`` is small beside the ``vibration``."""
    return constant * math.log(max(abs(size) / max(_LEFT * vibration, 1e-6 * abs(size)), 1.0))


def _overload(
    means: Floats, free: np.ndarray, vibration: float, step: int, n_samples: int, settings: IngestSettings
) -> SignalFault | None:
    """The largest jump to a rail that decays to where it came from, if there is one where ``free``."""
    before = float(np.median(means[free]))
    apart = np.where(free, means - before, 0.0)
    top = int(np.argmax(np.abs(apart)))
    size = float(apart[top])
    if abs(size) < settings.overload_ratio * vibration:
        return None
    inside = np.abs(apart) > 0.5 * abs(size)
    jump = top
    while jump > 0 and inside[jump - 1] and apart[jump - 1] * size > 0.0:
        jump -= 1
    if jump < _RISE:
        return None
    ahead = apart[:jump][free[:jump]][-16:]
    rest = float(np.median(ahead))
    if abs(apart[max(jump - _RISE, 0)] - rest) > 0.2 * abs(size) or abs(rest) > 0.3 * abs(size):
        return None
    apart = apart - rest
    size = float(apart[top])
    at_rail = np.flatnonzero(np.abs(apart[top:]) > 0.9 * abs(size))
    gap = np.flatnonzero(np.diff(at_rail) > 1)
    begin = top + int(at_rail[gap[0]] if gap.size else at_rail[-1])
    following = np.flatnonzero(~free[begin:])
    end = begin + int(following[0]) if following.size else len(means)
    again = np.flatnonzero(np.diff(np.abs(apart[begin:end])) > 0.5 * abs(size))  # the next overload
    end = begin + int(again[0]) if again.size else end
    if end - begin < 4:
        return None
    height, constant, told = _decay(apart[begin:end])
    if told < settings.decay_share or constant < 1.5:
        return None
    last = min(end, begin + math.ceil(_ends_after(height, constant, vibration)) + 1)
    span = runs_of(((jump - 1) * step, n_samples if last >= len(means) else last * step))
    detail = (
        f"overload of the sensor's supply: a jump of {size:.4g} ({abs(size) / max(vibration, 1e-300):.3g} times the "
        "root mean square) that decays"
    )
    return SignalFault("iepe_overload", "bad", detail, span, is_lost=True)


def _settling(means: Floats, vibration: float, step: int, settings: IngestSettings) -> SignalFault | None:
    """A decay from the first sample on to where the signal then stays."""
    later = means[2 * len(means) // 3 :]
    rest = float(np.median(later))
    noise = 1.5 * float(np.median(np.abs(later - rest)))
    offsets = means - rest
    size, constant, told = _decay(offsets)
    is_settling = told > settings.decay_share and constant < 0.2 * len(means) and abs(size) > 6.0 * noise
    if not is_settling or abs(size) < settings.drift_ratio * vibration:
        return None
    end = min(math.ceil(_ends_after(size, constant, vibration)) + 1, len(means) // 2)
    detail = f"the signal settles from {size:.4g} ({abs(size) / max(vibration, 1e-300):.3g} times the root mean square)"
    return SignalFault("start_transient", "suspect", detail, runs_of((0, end * step)), is_lost=True)


def _drift(means: Floats, free: np.ndarray, vibration: float, settings: IngestSettings) -> SignalFault | None:
    """A slow trend larger than the vibration, in most of what is ``free``."""
    if np.count_nonzero(free) < _FEWEST // 2:
        return None
    place = np.linspace(-1.0, 1.0, len(means))[free]
    values = means[free]
    trend = np.polynomial.Polynomial.fit(place, values, 3)(place)
    told = 1.0 - float(np.var(values - trend)) / max(float(np.var(values)), 1e-300)
    size = float(np.ptp(trend))
    if told < settings.drift_share or size < settings.drift_ratio * vibration:
        return None
    detail = (
        f"the mean wanders by {size:.4g} ({size / max(vibration, 1e-300):.3g} times the root mean square): "
        "lines below a few hertz are in doubt"
    )
    return SignalFault("drift", "suspect", detail)
