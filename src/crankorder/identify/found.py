"""What identification finds: the nouns that its steps hand on to one another."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Evidence = Literal[
    "locked to the shaft",
    "steady, not locked",
    "follows the speed",
    "stands out, too few revolutions for proof",
]

Lock = Literal["locked", "slips", "undecided"]
"""Whether an order is an exact multiple of the cycle's: its phase stays, runs away, or cannot be told."""

ToneKind = Literal["mains", "tone", "order"]
"""A line of fixed frequency without damping: mains, another tone, or an order that no speed tells from one."""


@dataclass(frozen=True, eq=False)
class OrderLine:
    """One order in one channel, over the speeds (``seen``) at which it stands above the false-alarm level.

    ``degrees_of_freedom`` are those of ``amplitude_error``; ``phase_deg`` is NaN where there is no phase reference.
    ``reservation`` says, where it is not empty, what speaks against the line. ``ends`` (speeds, 2) are those of the
    amplitude's 95 % intervals, over all values that it held, and ``phase_ci95_deg`` (speeds,) the half widths of those
    of the phase; None where ``amplitude_error`` says it all. ``remark`` is what else there is to say of this channel.
    """

    channel: str
    order: float
    order_error: float
    seen: NDArray[np.int64]
    speed_rpm: NDArray[np.float64]
    amplitude: NDArray[np.float64]
    amplitude_error: NDArray[np.float64]
    degrees_of_freedom: NDArray[np.float64]
    phase_deg: NDArray[np.float64]
    evidence: Evidence
    level_over_floor_db: float
    reservation: str = ""
    ends: NDArray[np.float64] | None = None
    phase_ci95_deg: NDArray[np.float64] | None = None
    remark: str = ""

    @property
    def strongest(self) -> int:
        """Position, among the speeds seen, of the largest amplitude."""
        return int(np.argmax(self.amplitude))


@dataclass(frozen=True, eq=False)
class AgreedOrder:
    """One order of the shaft as all channels and frames agree on it.

    ``order`` with its ``order_error`` (standard, with ``degrees_of_freedom``); ``lock`` says whether it is an exact
    multiple of the cycle's frequency; ``needed_revs`` are the revolutions of one recording after which that could be
    told, where it is undecided. ``lines`` holds one line per channel that shows it. ``reservation`` says, where it is
    not empty, what speaks against the number or against its being one line.
    """

    order: float
    order_error: float
    degrees_of_freedom: float
    lock: Lock
    needed_revs: float | None
    lines: tuple[OrderLine, ...]
    reservation: str = ""


@dataclass(frozen=True, eq=False)
class Mode:
    """A natural frequency in Hz and its damping ratio with standard errors; ``channels`` that show it.

    ``reached_by``: orders whose response took part in the fit; ``undecided`` says, where it is not empty, why the line
    may be something else than a mode.
    """

    frequency_hz: float
    frequency_error_hz: float
    damping_ratio: float
    damping_error: float
    channels: tuple[str, ...]
    prominence_db: float
    evidence: str
    reached_by: tuple[float, ...] = ()
    undecided: str = ""


@dataclass(frozen=True, eq=False)
class Tone:
    """A line of fixed frequency without damping; ``amplitude`` is its peak with its standard error, by channel."""

    frequency_hz: float
    frequency_error_hz: float
    kind: ToneKind
    amplitude: dict[str, tuple[float, float]]
    evidence: str


@dataclass(frozen=True, eq=False)
class OrderResponse:
    """How one order drives one channel through the fitted modes.

    Its complex amplitude at ``speed_rpm`` is (speed / ``reference_rpm``)**``exponent`` times
    ``rigid`` + Σ ``residue``[j] · h_j(order · speed / 60), h_j(f) = −x² / (1 − x² + 2iζx), x = f / f_j, over the modes
    of the fit. ``fits`` says whether the data agree with that (chance of a worse fit ≥ 0.001).
    """

    order: float
    channel: str
    exponent: float
    reference_rpm: float
    rigid: complex
    residue: NDArray[np.complex128]
    fits: bool


@dataclass(frozen=True, eq=False)
class ModalFit:
    """Modes, lowest first, with the ``covariance`` of (f_1, ζ_1, f_2, ζ_2, …); tones; responses; the floor.

    ``frequency_hz`` (frequencies,), ``floor_psd`` and ``fitted_psd`` (channels, frequencies): what is left of the
    Campbell map without order lines, at unit gain, and the fit of it; NaN where orders cover a bin at all speeds.
    """

    modes: tuple[Mode, ...]
    tones: tuple[Tone, ...]
    covariance: NDArray[np.float64]
    responses: tuple[OrderResponse, ...] = ()
    frequency_hz: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    floor_psd: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))
    fitted_psd: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))
