"""What the recordings of a test gave, and doubts about them: gains, speeds, lengths, and what is left out for them."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from crankorder.checks.gains import RecordedLevel, level_jumps
from crankorder.errors import InputError, printable
from crankorder.orders.averages import cycle_bins, median_beside
from crankorder.orders.intervals import Z95
from crankorder.quantities import (
    Bools,
    Complexes,
    Floats,
    Ints,
    OrderFrames,
    QualityFlag,
    ShaftAngle,
    flags_of,
    remark,
    with_flags,
)
from crankorder.settings import IngestSettings, MethodNumbers
from crankorder.shaft.speeds import named_speed

LENGTHS = MethodNumbers("1-ingest-faults.toml", "short_recordings")
NAMES = MethodNumbers("1-ingest-faults.toml", "named_speeds")

_NOTHING_IS_ZERO = ("degrees_of_freedom", "n_independent", "n_cycles", "peak_above")
"""Variables in which a channel without data has 0; in all others NaN."""


@dataclass(frozen=True)
class Doubts:
    """Doubts about recordings and channels, and which of them take no part in averages.

    By name of the recording, ``gains`` are flags on channels of another gain or unit than in the other recordings, to
    be left out where the flag says so, ``speeds`` are flags on its speed: the clock of its pulses against that of its
    samples, and speeds that names state and no recording has; ``left_out`` says why it is left out. ``lengths`` are
    flags on files that may have lost their end, ``channels_left_out`` are sentences on channels that are left out of
    recordings that stay.
    """

    gains: Mapping[str, list[QualityFlag]] = field(default_factory=dict)
    speeds: Mapping[str, list[QualityFlag]] = field(default_factory=dict)
    lengths: tuple[QualityFlag, ...] = ()
    left_out: Mapping[str, InputError] = field(default_factory=dict)
    channels_left_out: tuple[str, ...] = ()


def doubts_of(
    shafts: Iterable[xr.Dataset],
    levels: Iterable[xr.Dataset],
    frames: Iterable[xr.Dataset],
    told: Mapping[str, Sequence[QualityFlag]],
    *,
    strict: bool,
    settings: IngestSettings,
) -> Doubts:
    """Doubts about recordings from their ``shafts`` (ShaftAngle), ``levels`` (RecordingLevels) and order ``frames``.

    Levels are (channel), frames (channel, frame, order). ``told`` has the flags of each recording by name; the level of
    one with a bad flag is compared with no other. ``strict`` also leaves out recordings with "suspect" flags.
    ``settings`` say by how much a level must jump to be doubted, and by how much where floors and orders together prove
    it.
    """
    ends_rpm, lengths_s = dict[str, tuple[float, float]](), dict[str, float]()
    for shaft in shafts:
        name, time_s, speed = str(shaft.attrs["recording"]), shaft["time"].values, shaft["speed"].values
        lengths_s[name] = float(time_s[-1] - time_s[0]) if len(time_s) else 0.0
        if fault_of(name, told[name]) is None and np.isfinite(speed).any():
            # of the means of tenths: what a shaft does within a turn, and an encoder's edges, is no other speed
            means = [float(np.nanmean(part)) for part in np.array_split(speed, 10) if np.isfinite(part).any()]
            ends_rpm[name] = min(means), max(means)
    recorded = {level.recording: level for level in _recorded_levels(levels, ends_rpm)}
    speeds, gains = defaultdict[str, list[QualityFlag]](list), defaultdict[str, list[QualityFlag]](list)
    for flag in scaled_speeds(ends_rpm):
        speeds[flag["recording"]].append(flag)
    for item in frames:
        name = str(item.attrs["recording"])
        if name in recorded and recorded[name].is_steady:
            for channel, (power, stands) in standing_orders(item)[1].items():
                recorded[name].lines[channel] = np.where(stands, np.sqrt(power), np.nan)
        if (drift := clock_drift(item)) is not None:
            speeds[name].append(drift)
    ratio, proven_ratio = settings.level_jump_ratio, settings.gain_step_ratio
    for flag in level_jumps(list(recorded.values()), ratio=ratio, proven_ratio=proven_ratio):
        gains[flag["recording"]].append(flag)
    flags = {name: [*own, *speeds.get(name, ()), *gains.get(name, ())] for name, own in told.items()}
    left_out = {name: fault for name, own in flags.items() if (fault := fault_of(name, own, strict=strict)) is not None}
    said = defaultdict[tuple[str, str], list[str]](list)
    for flag in [flag for name, own in flags.items() if name not in left_out for flag in own]:
        if flag.get("left_out") == "channel" and flag["severity"] == "bad":
            said[flag["recording"], flag["channel"]].append(f"{flag['flag']} ({flag['detail']})")
    sentences = (
        f"{printable(name)}: channel {printable(channel)} left out of all averages: {'; '.join(why)}"
        for (name, channel), why in said.items()
    )
    return Doubts(dict(gains), dict(speeds), tuple(short_recordings(lengths_s)), left_out, tuple(sentences))


def _recorded_levels(
    levels: Iterable[xr.Dataset], speeds: Mapping[str, tuple[float, float]]
) -> Iterator[RecordedLevel]:
    """Speed and level of every recording in ``levels`` with one of ``speeds`` (lowest and highest, rpm, by name)."""
    places: Floats | None = None
    for item in levels:
        name, channels, here = str(item.attrs["recording"]), item["channel"].values.tolist(), item["block"].values
        if name not in speeds:
            continue
        rms, floor = (dict(zip(channels, item[key].values.tolist(), strict=True)) for key in ("rms", "floor"))
        places = here if places is None else places
        # the floors of recordings at another rate are those of other frequencies
        alike = np.array_equal(here, places)
        blocks = dict(zip(channels, item["block_floor"].values, strict=True)) if alike else {}
        yield RecordedLevel(name, speeds[name], rms, floor, blocks)


def emptied(frame: xr.Dataset, flags: Sequence[QualityFlag]) -> xr.Dataset:
    """``frame`` (dims of ``data_schema/``) of a recording, without data in the channels that ``flags`` leave out.

    Their estimates are NaN, or 0 such as degrees of freedom, as if nothing had been recorded; ``frame`` itself stays as
    it is.
    """
    names = [flag["channel"] for flag in flags if flag.get("left_out") == "channel"]
    if not names or "channel" not in frame.dims:
        return frame
    out = np.isin(frame["channel"].values.astype(str), names)
    changed = {}
    for name, variable in frame.data_vars.items():
        if "channel" in variable.dims and variable.dtype.kind in "fc":
            values = variable.values.copy()
            np.moveaxis(values, variable.dims.index("channel"), 0)[out] = 0.0 if name in _NOTHING_IS_ZERO else np.nan
            changed[str(name)] = variable.copy(data=values)
    return frame.assign(changed)


def short_recordings(lengths_s: Mapping[str, float]) -> list[QualityFlag]:
    """A remark on each recording that is shorter than the others, where nearly all of these last equally long.

    ``lengths_s`` are the lengths [s] by name over which the shaft is known: recordings whose shaft stood still for a
    while may be named.
    """
    lengths = np.array(list(lengths_s.values()))
    if len(lengths) < LENGTHS.fewest_recordings:
        return []
    usual = float(np.median(lengths))
    alike = np.abs(lengths - usual) <= LENGTHS.alike_share * usual
    if not usual > 0.0 or np.mean(alike) < LENGTHS.alike_recordings:
        return []
    beside = f"where the other recordings of the test last {usual:.3g} s: if it was not stopped early its file has lost"
    short = {name: length for name, length in lengths_s.items() if length < (1.0 - LENGTHS.shorter_share) * usual}
    return [remark(name, "shorter_than_others", f"{length:.3g} s, {beside} its end") for name, length in short.items()]


def scaled_speeds(ends_rpm: Mapping[str, tuple[float, float]]) -> list[QualityFlag]:
    """A remark on each recording where the speeds of all are off those in their names by one factor.

    ``ends_rpm`` are the lowest and highest speed [rpm] by name of the recording; where it is not held, or the name
    states none, a recording tells nothing.
    """
    alike = 1.0 + NAMES.alike_share
    held = {name: (low + high) / 2.0 for name, (low, high) in ends_rpm.items() if 0.0 < high <= alike * low}
    off = {name: rpm / stated for name, rpm in held.items() if (stated := named_speed(name)) is not None}
    ratios = np.array(list(off.values()))
    factor = float(np.median(ratios)) if len(off) >= NAMES.fewest_recordings else 1.0
    if max(factor, 1.0 / factor) < 1.0 + NAMES.least_share or np.ptp(ratios) > NAMES.alike_share * factor:
        return []
    detail = (
        f"all {len(off)} recordings whose names state a speed turn at {factor:.3g} times it: look at [encoder], its "
        "pulses_per_rev and ratio"
    )
    return [remark(name, "speeds_not_as_named", detail, "suspect") for name in off]


def fault_of(name: str, flags: Sequence[QualityFlag], *, strict: bool = False) -> InputError | None:
    """Why the recording ``name`` takes no part, by its ``flags``; None where it takes part.

    "bad" flags count, and "suspect" ones where ``strict``. A flag on a channel or stretch that was left out already
    counts only where ``strict``.
    """

    def counts(flag: QualityFlag) -> bool:
        return flag["severity"] != "info" if strict else flag["severity"] == "bad" and "left_out" not in flag

    doubts = [f"{flag['flag']} ({flag['detail']})" for flag in flags if counts(flag)]
    if not doubts:
        return None
    problem = "refused by --strict" if strict else "left out of all averages"
    return InputError(problem, file=name, found="; ".join(doubts))


DRIFT = MethodNumbers("3-orders-recordings.toml", "clock_drift")

NOT_COMPARED = "clocks_not_compared"
"""Flag of recordings whose pulses were stamped by another device than their samples."""


def clock_drift(frames: xr.Dataset) -> QualityFlag | None:
    """Flag where the clocks of pulses and samples of ``frames`` (OrderFrames) differ; None where one clock made both.

    None too where too few lines stand out, where these disagree by more than their noise, and where the speed is not
    held: in a sweep modes turn the phases of lines.
    """
    speed = frames["speed"].values
    if not any(flag["flag"] == NOT_COMPARED for flag in flags_of(frames)) or bool(frames.attrs.get("swept", 0)):
        return None
    few = np.isfinite(speed).sum() < DRIFT.fewest_frames
    if few or np.nanmax(speed) > np.nanmin(speed) * (1.0 + DRIFT.held_share):
        return None
    order, lines = _lines(frames)
    if len(order) < DRIFT.fewest_lines or len(np.unique(order)) < 2:
        return None
    angle = frames["crank_angle"].values.astype(np.float64)
    begin = angle - angle.mean()
    coarse = _coarse(order, lines, begin)
    slope, error = _slopes(lines * np.exp(-2j * np.pi * coarse * np.outer(order, begin)), begin)
    weight = np.square(order / error)
    apart = slope / order
    rest = float(np.sum(weight * apart) / np.sum(weight))
    misfit = float(np.sum(weight * np.square(apart - rest))) / (len(order) - 1)
    if not misfit < DRIFT.least_sigmas**2:
        return None
    scale = math.sqrt(max(misfit, 1.0))
    ppm, error_ppm = 1e6 * (coarse + rest), 1e6 * scale / math.sqrt(float(np.sum(weight)))
    half = Z95 * error_ppm
    said = f"{len(order)} lines of the vibration drift by {ppm:.3g} ± {half:.2g} ppm of their order"
    if not abs(ppm) > max(DRIFT.least_sigmas * error_ppm, DRIFT.least_ppm):
        detail = f"{said}: the clock of the pulses and that of the samples agree so far"
        return remark(str(frames.attrs["recording"]), "clocks_agree", detail)
    way = "fast" if ppm > 0.0 else "slow"
    detail = (
        f"{said}: the clock of the pulses runs {way} beside that of the samples, or what shakes slips "
        "against the shaft that has the pulses; phases of averages turn by it and high orders fade"
    )
    return remark(str(frames.attrs["recording"]), "clocks_differ", detail, "suspect")


def standing_orders(frames: xr.Dataset) -> tuple[Ints, dict[str, tuple[Floats, Bools]]]:
    """Bins (orders,) of the cycle's orders in OrderFrames ``frames``, and their mean power and prominence by channel.

    Of each channel, by name, these are the mean power (orders,) and which orders (orders,) stand out; both results are
    empty where the bins are too few to tell.
    """
    half, told = DRIFT.beside_bins, dict[str, tuple[Floats, Bools]]()
    if "spectrum" not in frames or frames.sizes["order"] <= 2 * half:
        return np.empty(0, dtype=np.int64), told
    at = cycle_bins(frames)
    for name, spectrum in zip(frames["channel"].values.tolist(), frames["spectrum"].values, strict=True):
        power = np.abs(spectrum) ** 2
        known = np.isfinite(power)
        mean = np.where(known, power, 0.0).sum(axis=0) / np.maximum(1, known.sum(axis=0))
        told[name] = mean[at], mean[at] > DRIFT.stands_out * median_beside(mean, half)[at]
    return at, told


def _lines(frames: xr.Dataset) -> tuple[Floats, Complexes]:
    """Orders (lines,) of the cycle that stand out in a channel, and their amplitudes (lines, frames)."""
    at, told = standing_orders(frames)
    orders, rows = [np.empty(0)], [np.empty((0, frames.sizes["frame"]), dtype=np.complex128)]
    for channel, (_, stands) in zip(frames["spectrum"].values, told.values(), strict=False):
        if np.isfinite(channel.real).all():
            orders.append(frames["order"].values[at[stands]])
            rows.append(channel[:, at[stands]].T)
    return np.concatenate(orders), np.concatenate(rows)


def _coarse(order: Floats, lines: Complexes, begin: Floats) -> float:
    """Drift [1] at which all lines together keep their phase best: the highest point of their joint periodogram."""
    reach = 1e-6 * DRIFT.largest_ppm
    step = 0.25 / max(float(order.max()) * float(np.ptp(begin)), 1.0)
    grid = np.arange(-math.ceil(reach / step), math.ceil(reach / step) + 1) * step
    power = np.square(np.abs(lines)).sum(axis=1)
    total = np.zeros(len(grid))
    for own, row, size in zip(order, lines, power, strict=True):
        total += np.square(np.abs(np.exp(-2j * np.pi * own * np.outer(grid, begin)) @ row)) / max(size, 1e-300)
    return float(grid[int(np.argmax(total))])


def _slopes(lines: Complexes, begin: Floats) -> tuple[Floats, Floats]:
    """Slope (lines,) of the phase of each of ``lines`` (lines, frames) [rev per rev], and its standard error."""
    mean = lines.mean(axis=1, keepdims=True)
    turned = lines / np.where(np.abs(mean) > 0.0, mean, 1.0)
    phase = turned.imag / (2.0 * np.pi)  # of small angles, which noise does not wrap
    square = float(np.sum(np.square(begin)))
    slope = phase @ begin / square
    left = phase - np.outer(slope, begin) - phase.mean(axis=1, keepdims=True)
    # frames overlap by half: each second one is new
    freedom = max(len(begin) / 2.0 - 2.0, 1.0)
    error = np.sqrt(np.square(left).sum(axis=1) / freedom / (square / 2.0) / 2.0)
    return slope, np.maximum(error, 1e-12)


def flags_of_all(datasets: Iterable[xr.Dataset]) -> list[QualityFlag]:
    """Quality flags of the ``datasets`` (any dims), each once, in the order in which they were raised."""
    flags: list[QualityFlag] = []
    for dataset in datasets:
        flags += [flag for flag in flags_of(dataset) if flag not in flags]
    return flags


@dataclass(frozen=True)
class RecordingResult:
    """What one recording gives to its test: its ``shaft`` (time), and the ``frames`` that the wanted results need.

    The frames go by noun, with the dims of the schema of each in ``data_schema/``.
    """

    shaft: ShaftAngle
    frames: Mapping[Any, xr.Dataset]

    @property
    def name(self) -> str:
        """Name of the recording: its path inside the folder of the test."""
        return str(self.shaft.attrs["recording"])

    @property
    def flags(self) -> list[QualityFlag]:
        """Quality flags of shaft and frames, each once, in the order in which they were raised."""
        return flags_of_all((*self.frames.values(), self.shaft))

    def doubted(self, doubts: Doubts) -> RecordingResult:
        """This result with its flags of ``doubts``, without data in the channels that these leave out."""
        gains, speeds = doubts.gains.get(self.name, []), doubts.speeds.get(self.name, [])
        if not gains and not speeds:
            return self
        frames = {noun: emptied(frame, gains) for noun, frame in self.frames.items()}
        if OrderFrames in frames:
            frames[OrderFrames] = with_flags(frames[OrderFrames].copy(), speeds)
        return RecordingResult(ShaftAngle(with_flags(self.shaft.copy(), [*gains, *speeds])), frames)

    def history_of(self, noun: Any) -> str:
        """History of the frames of this ``noun``, or of the shaft."""
        return str((self.shaft if noun is ShaftAngle else self.frames[noun]).attrs.get("history", ""))


class Gathered(Sequence[xr.Dataset]):
    """Frames of one noun of all ``recordings`` that have it, taken from each as they are asked for."""

    def __init__(self, recordings: Sequence[RecordingResult], noun: Any) -> None:
        """Those of the ``noun``, ShaftAngle or one of the frames."""
        self._noun = noun
        self._of = [item for item in recordings if noun is ShaftAngle or noun in item.frames]

    def __len__(self) -> int:
        """Number of recordings."""
        return len(self._of)

    def __getitem__(self, number: Any) -> Any:
        """Dataset of the recording ``number``; a list for a slice."""
        if isinstance(number, slice):
            return [self[k] for k in range(*number.indices(len(self)))]
        one = self._of[number]
        return one.shaft if self._noun is ShaftAngle else one.frames[self._noun]

    @property
    def histories(self) -> list[str]:
        """History of each dataset."""
        return [one.history_of(self._noun) for one in self._of]
