"""One recording of a scene, sample by sample: the sum of its effects, then what stands between sensor and file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crankorder.synth.acquisition import Recorded, recorded
from crankorder.synth.crank import crank_motion
from crankorder.synth.encoder import EncoderSignals, encoder_signals
from crankorder.synth.floor import Floor, noise_signal
from crankorder.synth.scene import Run, Scene
from crankorder.synth.sensed import bearing_signal, impact_signal, order_signal, tone_signal
from crankorder.synth.signal_faults import converter_records, stand_ins, with_signal_faults

Signal = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class SyntheticRecording:
    """What one file holds: the recorded channels, the encoder or None, and what was made faulty where."""

    recorded: Recorded
    encoder: EncoderSignals | None
    faults: list[dict[str, Any]]


def sensed(scene: Scene, run: Run, floor: Floor) -> Signal:
    """What the sensors of ``scene`` give in ``run``, filtered, neither faulty nor converted: (channel, sample), m/s².

    ``floor``: of :func:`crankorder.synth.floor.floor_of` at the rate of the run. An effect that is not named is not
    looked at; the effects add up.
    """
    motion = crank_motion(scene, run)
    signal = order_signal(scene, run, motion)
    if scene.bearing_lines:
        signal += bearing_signal(scene, run, motion)
    if scene.tones:
        signal += tone_signal(scene, run, motion)
    if scene.bearing_impacts:
        signal += impact_signal(scene, run, motion)
    if scene.broadband or scene.sensor_noise or scene.coloured_noise:
        signal += noise_signal(scene, run, floor)
    return signal


def synthesise(scene: Scene, run: Run, floor: Floor) -> SyntheticRecording:
    """One recording as a file holds it.

    ``scene``: what to make. ``run``: which recording. ``floor``: of :func:`crankorder.synth.floor.floor_of` at the rate
    of the run.
    """
    signal, rate_hz = sensed(scene, run, floor), scene.rate_hz(run.speed_rpm)
    faults: list[dict[str, Any]] = []
    if scene.signal_faults:
        signal, faults = with_signal_faults(
            signal,
            scene.signal_faults,
            names=scene.channel_names,
            recording=run.name,
            stream=run.stream,
            rate_hz=rate_hz,
            seed=scene.seed,
        )
    encoder = None
    if scene.encoder is not None:
        encoder = encoder_signals(
            crank_motion(scene, run),
            scene.encoder,
            scene.encoder_faults,
            seed=scene.seed,
            recording=run.name,
            stream=run.stream,
            rate_hz=rate_hz,
            n_samples=scene.n_samples,
        )
        faults += encoder.records
    made = recorded(signal, scene.acquisition, stand_ins=stand_ins(faults, names=scene.channel_names))
    faults += converter_records(made.clipped_share, names=scene.channel_names, recording=run.name)
    named = [{**fault, "recording": f"{run.name}.h5"} for fault in faults]
    return SyntheticRecording(recorded=made, encoder=encoder, faults=named)
