"""A drawn machine's test as a folder that the program reads: HDF5 recordings and ``run.toml``."""

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from machines.machine import ComplexArray, Encoder, FloatArray, Machine, Profile
from machines.signals import SwungSignal, as_read_by_angle, recorded, sample_times, swung_signal

INDEX_WIDTH_REV = 0.02
NEWTON_STEPS = 8
"""Of the times of the teeth: within the cycle the mean speed is off by the swing, a tenth at most."""


@dataclass(frozen=True)
class Take:
    """What a recording really holds: speed, rpm, and complex envelopes of the orders, (channel, row), at ``time_s``.

    ``swung``: their signal, where the shaft swings within the cycle.
    """

    profile: Profile
    time_s: FloatArray
    speed_rpm: FloatArray
    envelopes: tuple[ComplexArray, ...]
    swung: SwungSignal | None = None


TAKE_RATE_HZ = 250.0
"""Rows per second that are kept of the envelopes: they change no faster than a mode's beat with an order."""


def write_folder(machine: Machine, folder: Path) -> tuple[Take, ...]:
    """Write the test of ``machine`` into the new ``folder``; returns what each recording really holds."""
    folder.mkdir(parents=True)
    takes = []
    for number, profile in enumerate(machine.profiles):
        rng = np.random.default_rng([machine.seed, 7, number])
        samples, envelopes = recorded(machine, profile, rng)
        time_s = sample_times(machine, profile)
        with h5py.File(folder / f"rec_{number:03d}.h5", "w", libver=("v110", "v110")) as file:
            file.attrs["rate_hz"] = machine.rate_hz
            for name, row in zip(machine.channels, samples, strict=True):
                file.create_dataset(f"acc_{name.lower()}", data=row.astype(np.float32)).attrs["unit"] = "m/s2"
            _write_encoder(file, machine, profile, time_s, rng)
        swung = swung_signal(machine, profile, envelopes)
        envelopes = as_read_by_angle(machine, profile, envelopes, swung)
        keep = slice(None, None, max(1, int(machine.rate_hz / TAKE_RATE_HZ)))
        speed = profile.speed(time_s[keep])
        kept = tuple(envelope[:, keep] for envelope in envelopes)
        takes.append(Take(profile, time_s[keep], speed, kept, swung))
    (folder / "run.toml").write_text(manifest(machine), encoding="utf-8")
    return tuple(takes)


def _write_encoder(
    file: h5py.File, machine: Machine, profile: Profile, time_s: FloatArray, rng: np.random.Generator
) -> None:
    encoder = machine.encoder
    angle = profile.angle(time_s) + encoder.index_to_tdc_deg / 360.0
    if encoder.form == "speed":
        # what a tachometer's output holds: the speed with 0.02 % of white noise
        speed = profile.speed(time_s) + 2e-4 * max(profile.rpm) * rng.standard_normal(time_s.size)
        file.create_dataset("speed", data=speed.astype(np.float32)).attrs["unit"] = "rpm"
        return
    if encoder.form == "trace":
        file.create_dataset("encoder", data=_trace(encoder, machine.seed, angle)).attrs["unit"] = "V"
        if encoder.index:
            pulse = np.mod(angle, 1.0) < _index_width(machine, profile)
            file.create_dataset("index", data=(5.0 * pulse).astype(np.float32)).attrs["unit"] = "V"
        return
    times, tooth = _crossings(machine, profile, time_s)
    _write_times(file, "pulse_time", times[tooth < encoder.pulses_per_rev - encoder.missing_teeth], encoder.clock_hz)
    if encoder.index:
        _write_times(file, "index_time", times[tooth == 0], encoder.clock_hz)


def _write_times(file: h5py.File, name: str, times: FloatArray, clock_hz: float) -> None:
    file.create_dataset(name, data=np.round(times * clock_hz) / clock_hz).attrs["unit"] = "s"


def _index_width(machine: Machine, profile: Profile) -> float:
    """At least three samples wide at the highest speed."""
    return max(INDEX_WIDTH_REV, 3.0 * max(profile.rpm) / 60.0 / machine.rate_hz)


def _trace(encoder: Encoder, seed: int, angle: FloatArray) -> FloatArray:
    """Sampled square wave of the wheel that ``seed`` gives: 5 V over half a tooth, which starts at its angle."""
    teeth, turned = encoder.teeth_rev(seed), np.mod(angle, 1.0)
    tooth = np.searchsorted(teeth, turned, side="right") - 1
    width = (0.5 if encoder.pulses_per_rev > 1 else 0.1) / encoder.pulses_per_rev
    high = (turned - teeth[tooth] < width) & (tooth < encoder.pulses_per_rev - encoder.missing_teeth)
    return np.asarray(5.0 * high, dtype=np.float32)


def _crossings(machine: Machine, profile: Profile, time_s: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Exact times, s, at which a tooth passes, and its number: Newton from a table of the angle."""
    teeth, offset_rev = machine.encoder.teeth_rev(machine.seed), machine.encoder.index_to_tdc_deg / 360.0
    turn = profile.angle(time_s) + offset_rev
    turns = np.arange(np.floor(turn[0]), np.floor(turn[-1]) + 1)
    wanted = (turns[:, None] + teeth).ravel()
    tooth = np.tile(np.arange(teeth.size), turns.size)
    passed = (wanted >= turn[0]) & (wanted <= turn[-1])
    wanted, tooth = wanted[passed], tooth[passed]
    moving = np.append(True, np.diff(turn) > 0.0)
    times = np.interp(wanted, turn[moving], time_s[moving])
    for _ in range(NEWTON_STEPS):
        speed = np.maximum(profile.speed(times), 1.0) / 60.0
        times = np.clip(times - (profile.angle(times) + offset_rev - wanted) / speed, time_s[0], time_s[-1])
    return times, tooth


def manifest(machine: Machine) -> str:
    """Text of ``run.toml`` for the test of ``machine``."""
    encoder = machine.encoder
    lines = [
        "schema_version = 1", f'[test]\nname = "{machine.class_name} {machine.seed}"\ncycle = "four-stroke"',
        '[recordings]\nfiles = ["rec_*.h5"]', f'[sampling]\ndomain = "time"\nrate_hz = {machine.rate_hz!r}',
    ]  # fmt: skip
    lines += [
        f'[[channels]]\nname = "{name}"\nsource = "acc_{name.lower()}"\nquantity = "acceleration"\nunit = "m/s2"'
        f'\ndirection = "+{name}"'
        for name in machine.channels
    ]
    if machine.gear_teeth:
        lines.append(f'[[gears]]\nname = "pump drive"\nteeth = {machine.gear_teeth}')
    source, kind = {
        "speed": ("speed", "speed"), "trace": ("encoder", "square"), "times": ("pulse_time", "pulse_times"),
    }[encoder.form]  # fmt: skip
    table = [f'[encoder]\nsource = "{source}"\nkind = "{kind}"']
    if encoder.form != "speed":
        table += [f"pulses_per_rev = {encoder.pulses_per_rev}", f"index_to_tdc_deg = {encoder.index_to_tdc_deg!r}"]
        table += [f"missing_teeth = {encoder.missing_teeth}"] if encoder.missing_teeth else []
        table += ['edge = "rising"'] if encoder.form == "trace" else []
        table += [f'index = "{"index" if encoder.form == "trace" else "index_time"}"'] if encoder.index else []
    return "\n".join([*lines, "\n".join(table)]) + "\n"
