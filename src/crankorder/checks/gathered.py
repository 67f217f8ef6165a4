"""What the recordings of a test gave, each by itself and gathered by noun, with what is doubted of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import xarray as xr

from crankorder.checks.doubts import Doubts, emptied
from crankorder.quantities import OrderFrames, QualityFlag, ShaftAngle, flags_of, with_flags


def flags_of_all(datasets: Iterable[xr.Dataset]) -> list[QualityFlag]:
    """Quality flags of the ``datasets``, each once, in the order in which they were raised."""
    flags: list[QualityFlag] = []
    for dataset in datasets:
        flags += [flag for flag in flags_of(dataset) if flag not in flags]
    return flags


@dataclass(frozen=True)
class RecordingResult:
    """What one recording gives to its test: its shaft, and the frames by noun that the wanted results need."""

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
        """This result with its flags of ``doubts``, in which the channels that these leave out hold no data."""
        gains, clocks = doubts.gains.get(self.name, []), doubts.clocks.get(self.name, [])
        if not gains and not clocks:
            return self
        frames = {noun: emptied(frame, gains) for noun, frame in self.frames.items()}
        if clocks:
            frames[OrderFrames] = with_flags(frames[OrderFrames].copy(), clocks)
        return RecordingResult(ShaftAngle(with_flags(self.shaft.copy(), gains)), frames)

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
