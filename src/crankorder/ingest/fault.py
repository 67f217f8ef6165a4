"""A fault of one signal: what it is, how bad, and which samples it concerns."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from crankorder.quantities import QualityFlag, Severity


@dataclass(frozen=True, slots=True)
class Runs:
    """Samples ``starts`` (runs,) to before ``ends`` (runs,), in order."""

    starts: npt.NDArray[np.int64]
    ends: npt.NDArray[np.int64]

    @property
    def lengths(self) -> npt.NDArray[np.int64]:
        """Samples of each run."""
        return self.ends - self.starts

    def where(self, chosen: npt.NDArray[np.bool_]) -> Runs:
        """The ``chosen`` (runs,) alone."""
        return Runs(self.starts[chosen], self.ends[chosen])

    def merged(self, *, within: int, n_samples: int) -> Runs:
        """Runs that reach ``within`` samples further to both sides, those joined that then touch, of ``n_samples``."""
        starts, ends = np.maximum(self.starts - within, 0), np.minimum(self.ends + within, n_samples)
        order = np.argsort(starts, kind="stable")
        starts, ends = starts[order], np.maximum.accumulate(ends[order]) if len(ends) else ends
        first = np.ones(len(starts), dtype=np.bool_)
        first[1:] = starts[1:] > ends[:-1]
        last = np.append(first[1:], True)[: len(starts)]
        return Runs(starts[first], ends[last])


def runs_of(*spans: tuple[int, int]) -> Runs:
    """Runs of ``spans``, the first sample of each and the one after its last."""
    pairs = np.array(spans, dtype=np.int64).reshape(-1, 2)
    return Runs(pairs[:, 0], pairs[:, 1])


@dataclass(frozen=True, slots=True)
class SignalFault:
    """``flag``, ``severity`` and ``detail`` as a quality flag has them; ``at`` the samples concerned, none: all.

    ``is_lost``: these samples say nothing of the machine and take no part in any average.
    """

    flag: str
    severity: Severity
    detail: str
    at: Runs = field(default_factory=runs_of)
    is_lost: bool = False

    def as_flag(self, name: str, path: Path) -> QualityFlag:
        """Quality flag for channel ``name`` of the recording at ``path``."""
        detail = f"channel {name}: {self.detail}"
        return QualityFlag(recording=path.name, flag=self.flag, severity=self.severity, detail=detail)
