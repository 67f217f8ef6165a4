"""OrderFrames of lines and noise made by crank angle: what identification of orders is tried on, cheaply."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from crankorder.identify.found import AgreedOrder
from crankorder.identify.lines.agreed_orders import orders_agreed
from crankorder.identify.lines.known_lines import held_recordings
from crankorder.identify.lines.line_phasors import recordings_of
from crankorder.identify.lines.order_lines import order_lines
from crankorder.orders.frames import spectra_by_angle
from crankorder.orders.joint_lines import HeldFrames, Place
from crankorder.orders.map import order_map
from crankorder.orders.method import FrameLayout
from made import recordings
from made.shipped import SETTINGS

PER_REV, REVS, HOP, START_REV = 48, 16, 8, 3.25


def frames_of(
    signals: Sequence[np.ndarray], *, speed_rpm: float | np.ndarray = 1500.0, pulses: bool = True
) -> xr.Dataset:
    """OrderFrames, orders 0 to 20, of ``signals`` (samples,) of each channel, PER_REV samples per revolution."""
    values = np.stack(signals)
    count = (values.shape[1] // PER_REV - REVS) // HOP + 1
    begin = START_REV + HOP * np.arange(count, dtype=np.float64)
    spectrum = spectra_by_angle(values, None, PER_REV, FrameLayout(None, 0.5, 20.0, REVS, HOP, begin))
    flag = {"recording": "made", "flag": "no_index", "severity": "suspect", "detail": "no encoder pulses: made so"}
    quality = json.dumps([] if pulses else [flag])
    return recordings.frames_of(spectrum, speed_rpm=speed_rpm, revs=REVS, start_rev=START_REV, quality=quality)


def angle_of(revs: int) -> np.ndarray:
    """Crank angle [rev] of the samples of ``revs`` revolutions."""
    return START_REV + np.arange(revs * PER_REV) / PER_REV


def wave(angle_rev: np.ndarray, order: float, amplitude: float, phase_rad: float = 0.0) -> np.ndarray:
    """A line of ``order`` at ``angle_rev``."""
    return amplitude * np.cos(2 * np.pi * order * angle_rev + phase_rad)


def waves(rng: np.random.Generator, angle_rev: np.ndarray, lines: Iterable[tuple[float, float]]) -> np.ndarray:
    """Sum of ``lines`` (order, amplitude) of drawn phases at ``angle_rev``."""
    return sum(wave(angle_rev, order, size, rng.uniform(0.0, 6.0)) for order, size in lines) + np.zeros(len(angle_rev))


def rung(noise: np.ndarray, order: float, damping: float) -> np.ndarray:
    """``noise`` (samples,) and the same through the acceleration response of a mode at ``order``."""
    at = np.fft.rfftfreq(len(noise), 1 / PER_REV)
    response = -(at**2) / (order**2 - at**2 + 2j * damping * order * at)
    return np.fft.irfft(np.fft.rfft(noise) * (1.0 + response), len(noise))


def held_at(
    rng: np.random.Generator, rpm: float, lines: Iterable[tuple[float, float]], *, noise: float = 0.3
) -> list[HeldFrames]:
    """A recording of 20 s at ``rpm`` with ``lines`` (Hz, amplitude) of drawn phases in noise of that size."""
    angle = angle_of(round(20.0 * rpm / 60.0))
    orders = [(60.0 * hertz / rpm, size) for hertz, size in lines]
    frames = frames_of([noise * rng.standard_normal(len(angle)) + waves(rng, angle, orders)], speed_rpm=rpm)
    return held_recordings(recordings_of([frames]), ["A"])


def agreed_in(frames: Sequence[xr.Dataset], *, followed: Sequence[xr.Dataset] = ()) -> tuple[AgreedOrder, ...]:
    """Orders that the channels and recordings of ``frames`` agree on; ``followed``: OrderTracks of their sweeps."""
    made = order_map(frames, settings=SETTINGS.orders)
    lines = order_lines(made, settings=SETTINGS.identify, orders=SETTINGS.orders, frames=frames)
    return orders_agreed(lines, frames=frames, order_map=made, settings=SETTINGS.identify, followed=followed)


@dataclass(frozen=True, eq=False)
class LineScene:
    """Lines of a drawn recording: ``signal`` (samples,) at ``angle`` [rev] and ``time_s``, with noise.

    ``places`` are where the lines are, ``starts`` where a search begins, ``free`` whether numbers are searched for at
    all; ``phasors`` (lines,) their true ones. ``noise`` (lines,) is that per sample at each line.
    """

    signal: np.ndarray
    angle: np.ndarray
    time_s: np.ndarray
    places: list[Place]
    starts: list[Place]
    free: bool
    phasors: np.ndarray
    noise: np.ndarray

    @classmethod
    def drawn(cls, kind: str, rng: np.random.Generator) -> "LineScene":
        """A ``kind`` of scene: "pair", "triple", "meets mains" (at a speed that wanders) or "flank" of a mode."""
        revs = int(rng.choice([152, 304, 600]))  # whole frames
        angle, count = angle_of(revs), {"pair": 2, "triple": 3, "meets mains": 2, "flank": 1}[kind]
        turned = angle - angle[0]
        wander = 0.002 * np.sin(2.0 * np.pi * turned * rng.uniform(1.0, 3.0) / revs + rng.uniform(0.0, 6.0))
        pace = (1.0 + wander * (kind == "meets mains")) / 25.0
        time_s = np.concatenate([[0.0], np.cumsum(0.5 * (pace[1:] + pace[:-1]) * np.diff(angle))])
        orders = rng.uniform(3.0, 9.0) + np.cumsum([0.0, *rng.uniform(2.0, 5.0, count - 1)]) / revs
        phasors = np.exp(rng.uniform(np.log(0.2), np.log(2.0), count) + 2j * np.pi * rng.uniform(0.0, 1.0, count))
        noise, places = 0.2 * rng.standard_normal(len(angle)), [Place(turns=order) for order in orders.tolist()]
        level = np.full(count, 0.2)
        if kind == "meets mains":
            places[1] = Place(float(orders[1]) * 25.0)
        if kind == "flank":
            mode, damping = float(orders[0]) * rng.uniform(1.01, 1.03), rng.uniform(0.01, 0.03)
            noise = rung(noise, mode, damping)
            response = -(orders**2) / (mode**2 - orders**2 + 2j * damping * mode * orders)
            level = level * np.abs(1.0 + response)
        signal = noise + sum(
            (phasor * np.exp(2j * np.pi * (place.turns * angle + place.hertz * time_s))).real
            for place, phasor in zip(places, phasors, strict=True)
        )
        off = (kind != "meets mains") * rng.uniform(-0.2, 0.2, count) / revs
        starts = [place._replace(turns=place.turns + step) for place, step in zip(places, off.tolist(), strict=True)]
        return cls(signal, angle, time_s, places, starts, kind != "meets mains", phasors, level)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Cramér-Rao bounds (lines,) of amplitudes and of orders, by the samples themselves (Kay 1993, eq. 3.31)."""
        columns = []
        for place, phasor in zip(self.places, self.phasors, strict=True):
            turned = np.exp(2j * np.pi * (place.turns * self.angle + place.hertz * self.time_s))
            unit = phasor / abs(phasor)
            columns += [(unit * turned).real, (1j * unit * turned).real]
            columns += [(2j * np.pi * self.angle * phasor * turned).real] * self.free
        slopes = np.array(columns) / np.repeat(self.noise, len(columns) // len(self.noise))[:, None]
        error = np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T))).reshape(len(self.noise), -1)
        return error[:, 0], error[:, -1]

    def frames(self) -> xr.Dataset:
        """OrderFrames of the recording."""
        begin = np.arange((len(self.angle) // PER_REV - REVS) // HOP + 1) * HOP * PER_REV
        time_s = np.append(self.time_s, 2.0 * self.time_s[-1] - self.time_s[-2])
        seconds = time_s[begin + REVS * PER_REV] - time_s[begin]
        return frames_of([self.signal], speed_rpm=60.0 * REVS / seconds)
