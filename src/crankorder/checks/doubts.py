"""Doubts about the recordings of a test beside each other: gains, clocks, lengths, and what is left out for them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr

from crankorder.checks.clocks import clock_drift, standing_orders
from crankorder.checks.gains import RecordedLevel, level_jumps
from crankorder.errors import InputError, printable
from crankorder.quantities import Floats, QualityFlag, remark
from crankorder.settings import IngestSettings, MethodNumbers

NUMBERS = MethodNumbers("1-ingest-faults.toml", "short_recordings")

_NOTHING_IS_ZERO = ("degrees_of_freedom", "n_independent", "n_cycles", "peak_above")
"""Variables in which a channel without data has 0; in all others NaN."""


@dataclass(frozen=True)
class Doubts:
    """What is doubted of which recording and channel, and what takes no part in averages.

    By name of the recording, ``gains``: its channels of another gain or unit than beside it, to be left out where the
    flag says so; ``clocks``: how the clock of its pulses runs beside that of its samples; ``left_out``: why it is left
    out. ``lengths``: files that may have lost their end; ``channels_left_out``: a sentence on each channel that is left
    out of a recording that stays.
    """

    gains: Mapping[str, list[QualityFlag]] = field(default_factory=dict)
    clocks: Mapping[str, list[QualityFlag]] = field(default_factory=dict)
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

    ``told``: the flags of each recording by name; the level of one with a bad flag is compared with no other.
    ``strict`` leaves out what is "suspect" too. ``settings`` say by how much a level must jump to be doubted, and by
    how much where floors and orders together prove it.
    """
    speeds, lengths_s = dict[str, tuple[float, float]](), dict[str, float]()
    for shaft in shafts:
        name, time_s, speed = str(shaft.attrs["recording"]), shaft["time"].values, shaft["speed"].values
        lengths_s[name] = float(time_s[-1] - time_s[0]) if len(time_s) else 0.0
        if fault_of(name, told[name]) is None and np.isfinite(speed).any():
            # of the means of tenths: what a shaft does within a turn, and an encoder's edges, is no other speed
            means = [float(np.nanmean(part)) for part in np.array_split(speed, 10) if np.isfinite(part).any()]
            speeds[name] = min(means), max(means)
    recorded = {level.recording: level for level in _recorded_levels(levels, speeds)}
    clocks, gains = dict[str, list[QualityFlag]](), dict[str, list[QualityFlag]]()
    for item in frames:
        name = str(item.attrs["recording"])
        if name in recorded and recorded[name].is_steady:
            stands = standing_orders(item)[1]
            sizes = {channel: np.where(seen, np.sqrt(power), np.nan) for channel, (power, seen) in stands.items()}
            recorded[name].lines.update(sizes)
        drift = clock_drift(item)
        clocks |= {} if drift is None else {name: [drift]}
    ratios = {"ratio": settings.level_jump_ratio, "proven_ratio": settings.gain_step_ratio}
    for flag in level_jumps(list(recorded.values()), **ratios):
        gains.setdefault(flag["recording"], []).append(flag)
    flags = {name: [*own, *clocks.get(name, ()), *gains.get(name, ())] for name, own in told.items()}
    left_out = {name: fault for name, own in flags.items() if (fault := fault_of(name, own, strict=strict)) is not None}
    said = dict[tuple[str, str], list[str]]()
    for flag in [flag for name, own in flags.items() if name not in left_out for flag in own]:
        if flag.get("left_out") == "channel" and flag["severity"] == "bad":
            why = f"{flag['flag']} ({flag['detail']})"
            said.setdefault((flag["recording"], flag["channel"]), []).append(why)
    sentences = (
        f"{printable(name)}: channel {printable(channel)} left out of all averages: {'; '.join(why)}"
        for (name, channel), why in said.items()
    )
    return Doubts(gains, clocks, tuple(short_recordings(lengths_s)), left_out, tuple(sentences))


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
    """``frame`` of a recording, in which the channels that ``flags`` leave out look as if nothing had been recorded."""
    names = [flag["channel"] for flag in flags if flag.get("left_out") == "channel"]
    if not names or "channel" not in frame.dims:
        return frame
    out = np.isin(frame["channel"].values.astype(str), names)
    changed: dict[str, xr.DataArray] = {}
    for name, variable in frame.data_vars.items():
        if "channel" in variable.dims and variable.dtype.kind in "fc":
            values = variable.values.copy()
            np.moveaxis(values, variable.dims.index("channel"), 0)[out] = 0.0 if name in _NOTHING_IS_ZERO else np.nan
            changed[str(name)] = variable.copy(data=values)
    return frame.assign(changed)


def short_recordings(lengths_s: Mapping[str, float]) -> list[QualityFlag]:
    """A remark on each recording that is shorter than the others, where nearly all of these last equally long.

    ``lengths_s``, by name, are those over which the shaft is known: recordings whose shaft stood still for a while may
    be named.
    """
    lengths = np.array(list(lengths_s.values()))
    if len(lengths) < NUMBERS.fewest_recordings:
        return []
    usual = float(np.median(lengths))
    alike = np.abs(lengths - usual) <= NUMBERS.alike_share * usual
    if not usual > 0.0 or np.mean(alike) < NUMBERS.alike_recordings:
        return []
    beside = f"where the other recordings of the test last {usual:.3g} s: if it was not stopped early its file has lost"
    return [
        remark(name, "shorter_than_others", f"{length:.3g} s, {beside} its end")
        for name, length in lengths_s.items()
        if length < (1.0 - NUMBERS.shorter_share) * usual
    ]


def fault_of(name: str, flags: Sequence[QualityFlag], *, strict: bool = False) -> InputError | None:
    """Why the recording ``name`` takes no part, None where it does: its ``flags``, where ``strict`` "suspect" ones too.

    What a flag says was left out already, a channel or a stretch, takes the recording along only where ``strict``.
    """
    doubts = [
        f"{flag['flag']} ({flag['detail']})"
        for flag in flags
        if (flag["severity"] != "info" if strict else flag["severity"] == "bad" and "left_out" not in flag)
    ]
    if not doubts:
        return None
    problem = "refused by --strict" if strict else "left out of all averages"
    return InputError(problem, file=name, found="; ".join(doubts))
