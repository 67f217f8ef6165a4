"""Faults of all channels of a recording: what is lost is left out, the rest is flagged with when and how much."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from crankorder.ingest.channel_faults import find_copies, find_dead, find_mains_only
from crankorder.ingest.fault import Runs, SignalFault
from crankorder.ingest.level_steps import find_level_steps
from crankorder.ingest.rawfile import FloatArray
from crankorder.ingest.signal_survey import Survey, block_size, survey
from crankorder.ingest.slow_faults import find_slow_faults
from crankorder.ingest.smoothed_clipping import find_smoothed_clipping
from crankorder.ingest.spikes import find_spikes
from crankorder.quantities import QualityFlag
from crankorder.settings import IngestSettings

VIBRATION = frozenset({"acceleration", "velocity", "displacement"})
"""Quantities without a level or plateaus of their own: what shows either is a fault."""
_MAY_HAVE_LEVELS = frozenset(
    {"voltage", "current", "counts", "full scale", "ratio", "angle", "rotational speed", "strain", "torque"}
)
_IMPACTS = frozenset({"force"})


@dataclass(frozen=True, slots=True)
class Sampled:
    """What the samples of a recording are: names and quantities by channel, their axis, and the shaft's speed.

    ``rate`` samples per ``unit`` ("s", "rev"), the first at ``start``; ``rate_hz`` NaN by crank angle; ``shaft_hz`` 0
    where there is no shaft, NaN where its speed is unknown.
    """

    names: Sequence[str]
    quantities: Sequence[str]
    units: Sequence[str]
    rate: float
    start: float
    unit: str
    rate_hz: float
    shaft_hz: float

    def span(self, at: Runs, n_samples: int) -> tuple[float, float]:
        """From when to when ``at`` reaches, all of the ``n_samples`` where it names none."""
        first, last = (int(at.starts.min()), int(at.ends.max())) if at.starts.size else (0, n_samples)
        return self.start + first / self.rate, self.start + last / self.rate


def judged(
    signals: FloatArray, known: Sequence[list[SignalFault]], sampled: Sampled, path: Path, *, settings: IngestSettings
) -> list[QualityFlag]:
    """Flags of the ``signals`` (channel, sample), of which what is lost becomes NaN in place and spikes are bridged.

    ``known`` faults by channel were found before; the recording, ``sampled`` so, lies at ``path``; ``settings`` say
    what counts. A channel of which most is lost is left out alone; where that is so of all channels they stay as they
    are, for the recording is left out as a whole.
    """
    faults = [
        [fault for fault in own if not (fault.flag == "clipped" and _is_square(fault, quantity, signals.shape[1]))]
        for own, quantity in zip(known, sampled.quantities, strict=True)
    ]
    size = block_size(sampled.rate_hz)
    if signals.shape[1] >= settings.fewest_samples:
        surveys = [survey(row, size=size) for row in signals]
        for number, row in enumerate(signals):
            if not any(fault.is_lost and not fault.at.starts.size for fault in faults[number]):
                faults[number] += _of_one(row, surveys[number], sampled.quantities[number], faults[number], settings)
        _beside_each_other(signals, surveys, faults, sampled, settings)
    lost = [_lost(own, signals.shape[1], sampled, settings) for own in faults]
    is_out = [_share(runs, signals.shape[1]) > settings.max_lost_fraction for runs in lost]
    flags: list[QualityFlag] = []
    for number, own in enumerate(faults):
        if not all(is_out):
            _leave_out(signals[number], lost[number], whole=is_out[number])
        for fault in own:
            flags.append(_flag(fault, sampled, number, path, signals.shape[1]))
            if fault.is_lost and not all(is_out):
                flags[-1]["left_out"] = "channel" if is_out[number] else "stretch"
    return flags


def _of_one(
    row: FloatArray, seen: Survey, quantity: str, known: list[SignalFault], settings: IngestSettings
) -> list[SignalFault]:
    """Faults that a channel shows by itself; its spikes are bridged."""
    found: list[SignalFault] = []
    is_vibration = quantity in VIBRATION
    if quantity not in _IMPACTS and not any(fault.flag == "clipped" for fault in known):
        spikes = find_spikes(row, seen, settings=settings, may_pulse=not is_vibration)
        if spikes is not None:
            fault, runs, values = spikes
            _bridge(row, runs, values)
            found.append(fault)
    if is_vibration:
        found += find_slow_faults(seen, settings=settings)
    clipping = None
    told_already = any(fault.flag in ("clipped", "iepe_overload") for fault in (*known, *found))
    if not told_already and (is_vibration or quantity == "pressure"):
        clipping = find_smoothed_clipping(row, seen, settings=settings, without_doubt=is_vibration)
    return found if clipping is None else [*found, clipping]


def _bridge(row: FloatArray, runs: Runs, values: npt.NDArray[np.float64]) -> None:
    at = np.concatenate([np.arange(*ends) for ends in zip(runs.starts, runs.ends, strict=True)])
    row[at] = values


def _beside_each_other(
    signals: FloatArray,
    surveys: Sequence[Survey],
    faults: list[list[SignalFault]],
    sampled: Sampled,
    settings: IngestSettings,
) -> None:
    """Add what only a look at all channels together tells to their ``faults``."""
    alive = [k for k, own in enumerate(faults) if not any(f.is_lost and not f.at.starts.size for f in own)]
    vibrating = [k for k in alive if sampled.quantities[k] in VIBRATION]
    rows, units = [surveys[k] for k in vibrating], [sampled.units[k] for k in vibrating]
    told = [(list(range(len(signals))), find_copies(signals, sampled.names))]
    if len(vibrating) > 1:
        chosen = signals if len(vibrating) == len(signals) else signals[vibrating]
        told.append((vibrating, find_dead(chosen, rows, units, settings=settings)))
        told.append((vibrating, find_level_steps(rows, settings=settings)))
        if math.isfinite(sampled.rate_hz):
            told.append((vibrating, find_mains_only(rows, sampled.rate_hz, sampled.shaft_hz, settings=settings)))
    for numbers, found in told:
        for number, fault in found.items():
            faults[numbers[number]].append(fault)


def _is_square(fault: SignalFault, quantity: str, n_samples: int) -> bool:
    """Whether what looks clipped is a signal of two levels, such as that of a pickup."""
    return quantity in _MAY_HAVE_LEVELS and int(fault.at.lengths.sum()) > 0.5 * n_samples


def _lost(own: list[SignalFault], n_samples: int, sampled: Sampled, settings: IngestSettings) -> Runs:
    """Samples that take no part in averages, with a margin about each stretch."""
    margin = max(round(settings.lost_margin_s * sampled.rate_hz), 1) if math.isfinite(sampled.rate_hz) else 1
    starts, ends = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for fault in own:
        if fault.is_lost:
            starts.append(fault.at.starts if fault.at.starts.size else np.array([0]))
            ends.append(fault.at.ends if fault.at.starts.size else np.array([n_samples]))
    return Runs(np.concatenate(starts), np.concatenate(ends)).merged(within=margin, n_samples=n_samples)


def _share(runs: Runs, n_samples: int) -> float:
    return float(runs.lengths.sum()) / n_samples


def _leave_out(row: FloatArray, lost: Runs, *, whole: bool) -> None:
    if whole:
        row[:] = np.nan
        return
    for start, end in zip(lost.starts, lost.ends, strict=True):
        row[start:end] = np.nan


def _flag(fault: SignalFault, sampled: Sampled, number: int, path: Path, n_samples: int) -> QualityFlag:
    begin, end = sampled.span(fault.at, n_samples)
    flag = fault.as_flag(sampled.names[number], path)
    flag["channel"], flag["begin"], flag["end"] = sampled.names[number], begin, end
    flag["detail"] += f" ({begin:.4g} … {end:.4g} {sampled.unit})"
    return flag
