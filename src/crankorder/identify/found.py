"""What identification finds: the nouns that its steps hand on to one another."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, NamedTuple, cast

import numpy as np

from crankorder.cause import DoubtKind
from crankorder.findings import AvoidedSpeed, CrossingFinding, FreeBand, Lock, OpenBand
from crankorder.orders.intervals import Z95, half_width, positive_interval, ratio_interval
from crankorder.quantities import Complexes, Floats, Ints
from crankorder.records import Ends

if TYPE_CHECKING:
    from crankorder.identify.modes.order_responses import Force
    from crankorder.identify.modes.responses import Hiding
    from crankorder.identify.modes.sweep_poles import GroupFit, SweepPole

Evidence = Literal[
    "locked to the shaft",
    "steady, not locked",
    "follows the speed",
    "stands out, too few revolutions for proof",
]

ToneKind = Literal["mains", "tone", "order", "mains or order"]
"""A line of fixed frequency without damping: mains, another tone, or an order that no speed tells from one."""


class Doubt(NamedTuple):
    """What speaks against a line, by its ``kind`` and in ``words``."""

    kind: DoubtKind
    words: str


UNRESOLVED = Doubt(
    "unresolved",
    "stronger than all that is told in this channel, but not resolved: lines too close to be parted, or a resonance",
)
"""Of a peak that no rule names and beside which all that is named is weaker."""


@dataclass(frozen=True, eq=False)
class OrderLine:
    """One order in one channel, over the speeds (``seen``) at which it stands above the false-alarm level.

    ``degrees_of_freedom`` are those of ``amplitude_error``; ``phase_deg`` is NaN where there is no phase reference.
    ``doubts`` are what speaks against the line. ``ends`` (speeds, 2) are those of the
    amplitude's 95 % intervals, over all values that it held, and ``phase_ci95_deg`` (speeds,) the half widths of those
    of the phase; None where ``amplitude_error`` says it all. ``remark`` is what else there is to say of this channel.
    ``n_independent`` (speeds,) is how many independent values each one stands for, None for 1: rows of an order that
    was followed through a sweep share their errors with their neighbours.
    """

    channel: str
    order: float
    order_error: float
    seen: Ints
    speed_rpm: Floats
    amplitude: Floats
    amplitude_error: Floats
    degrees_of_freedom: Floats
    phase_deg: Floats
    evidence: Evidence
    level_over_floor_db: float
    doubts: tuple[Doubt, ...] = ()
    ends: Floats | None = None
    phase_ci95_deg: Floats | None = None
    remark: str = ""
    n_independent: Floats | None = None

    @property
    def strongest(self) -> int:
        """Position, among the speeds seen, of the largest amplitude."""
        return int(np.argmax(self.amplitude))

    def read_again(
        self, number: tuple[float, float], seen: Ints, rpm: Floats, size: Floats, error: Floats, freedom: Floats
    ) -> OrderLine:
        """This line of another ``number`` (order and its standard error), with other amplitudes and without phases.

        All are (speeds,): the positions ``seen``, speeds ``rpm``, amplitudes ``size``, their standard ``error`` and
        degrees of ``freedom``.
        """
        again = replace(self, order=number[0], order_error=number[1], seen=seen, speed_rpm=rpm, amplitude=size)
        again = replace(again, amplitude_error=error, degrees_of_freedom=freedom, phase_deg=np.full(len(seen), np.nan))
        return replace(again, ends=None, phase_ci95_deg=None, remark="")


@dataclass(frozen=True, eq=False)
class AgreedOrder:
    """One order of the shaft as all channels and frames agree on it.

    ``order`` with its ``order_error`` (standard, with ``degrees_of_freedom``); ``lock`` says whether it is an exact
    multiple of the cycle's frequency; ``needed_revs`` are the revolutions of one recording after which that could be
    told, where it is undecided. ``lines`` holds one line per channel that shows it. ``doubts`` are what
    speaks against the number or against its being one line. ``own_error`` is the standard error but for
    that of the speed, which shifts all orders by one share; None where it is the whole one. ``tracked`` is the number
    at which its track stands, once that was read. ``of_angle``: errors of the crank angle may have made it of another.
    """

    order: float
    order_error: float
    degrees_of_freedom: float
    lock: Lock
    needed_revs: float | None
    lines: tuple[OrderLine, ...]
    doubts: tuple[Doubt, ...] = ()
    own_error: float | None = None
    tracked: float | None = None
    of_angle: bool = False

    @property
    def speed_rpm(self) -> Floats:
        """Speeds at which its lines are seen, one line after the other."""
        return np.concatenate([line.speed_rpm for line in self.lines]) if self.lines else np.zeros(0)

    @property
    def line_error(self) -> float:
        """Standard error beside the other orders of the test, and of the frequency at the speed that is counted by."""
        return self.order_error if self.own_error is None else self.own_error


AgreedOrders = tuple[AgreedOrder, ...]
"""The orders of a test, as all channels agree on them."""


@dataclass(frozen=True, eq=False)
class Mode:
    """A natural frequency in Hz and its damping ratio with standard errors; ``channels`` that show it.

    ``reached_by``: orders whose response took part in the fit; ``undecided`` says, where it is not empty, why the line
    may be something else than a mode, ``lines_there_hz`` which known lines may be all of it.
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
    lines_there_hz: tuple[float, ...] = ()

    @property
    def frequency_half_hz(self) -> float:
        """Half width of the 95 % interval of the frequency, Hz.

        A frequency errs by a share of the width of its mode, or of the root of it: where the damping is not known, its
        error is not. A variance that is known to the share r has 2 / r² degrees of freedom (Satterthwaite 1946).
        """
        share = self.damping_error / self.damping_ratio if self.damping_ratio > 0.0 else np.inf
        return self.frequency_error_hz * half_width(2.0 / max(share, 1e-3) ** 2)

    @property
    def frequency_ends(self) -> tuple[float, float]:
        """95 % interval of the frequency, Hz."""
        return positive_interval(self.frequency_hz, self.frequency_half_hz)

    @property
    def damping_ends(self) -> tuple[float, float]:
        """95 % interval of the damping ratio."""
        return ratio_interval(self.damping_ratio, self.damping_error, most=1.0)


@dataclass(frozen=True, eq=False)
class Whirl:
    """A natural frequency that moves with the speed: ``frequency_hz`` at ``reference_rpm``, by ``slope`` Hz per rev/s.

    Errors are standard, ``together`` is the covariance of frequency and slope; ``slope`` is in orders, rising of a
    forward whirl, falling of a backward one. ``channels`` show it, up to ``prominence_db`` over what stays.
    """

    reference_rpm: float
    frequency_hz: float
    frequency_error_hz: float
    slope: float
    slope_error: float
    together: float
    damping_ratio: float
    damping_error: float
    channels: tuple[str, ...]
    prominence_db: float
    evidence: str

    @property
    def damping_told(self) -> bool:
        """Whether the damping is more than a bound."""
        return self.damping_error < 0.5 * self.damping_ratio

    def line_at(self, rpm: float) -> float:
        """Natural frequency in Hz at the speed ``rpm``."""
        return self.frequency_hz + self.slope * (rpm - self.reference_rpm) / 60.0

    def meets(self, order: float) -> float | None:
        """Speed in rpm at which an ``order`` meets it; None where it never does."""
        at_rest = self.line_at(0.0)
        return 60.0 * at_rest / (order - self.slope) if (order - self.slope) * at_rest > 0.0 else None

    def slower(self, order: float) -> float:
        """How many times slower than on a mode that stays an ``order`` gains on it."""
        return order / (order - self.slope)

    def met_by(self, order: float) -> Mode | None:
        """The mode that stays of which an ``order`` would show the same where it meets this; None where it never does.

        The order gains on it by but a part of its own motion, so that the mode is wider by that much. Of a damping
        that is no more than a bound the bound is taken.
        """
        rpm = self.meets(order)
        if rpm is None:
            return None
        damping = self.damping_ratio + (0.0 if self.damping_told else Z95 * self.damping_error)
        return Mode(
            frequency_hz=self.line_at(rpm),
            frequency_error_hz=self.error_at(rpm),
            damping_ratio=damping * self.slower(order),
            damping_error=self.damping_error * self.slower(order),
            channels=self.channels,
            prominence_db=self.prominence_db,
            evidence=f"a whirl that moves by {self.slope:.3g} orders",
        )

    def error_at(self, rpm: float) -> float:
        """Standard error in Hz of the natural frequency at the speed ``rpm``."""
        off = (rpm - self.reference_rpm) / 60.0
        square = self.frequency_error_hz**2 + 2.0 * off * self.together + (off * self.slope_error) ** 2
        return float(np.sqrt(max(square, 0.0)))


@dataclass(frozen=True, eq=False)
class Tone:
    """A line of fixed frequency without damping; ``amplitude`` is its peak with its standard error, by channel."""

    frequency_hz: float
    frequency_error_hz: float
    kind: ToneKind
    amplitude: dict[str, tuple[float, float]]
    evidence: str

    @property
    def frequency_ends(self) -> Ends:
        """95 % interval of the frequency, Hz."""
        return positive_interval(self.frequency_hz, Z95 * self.frequency_error_hz)


@dataclass(frozen=True, eq=False)
class OrderResponse:
    """How one order drives one channel through the fitted modes.

    Its complex amplitude at a speed s that is held is the ``force`` there times Σ ``smooth``[k] P_k(x) + Σ
    ``residue``[j] h_j(order s / 60): P_k and x the polynomials and their place by the force's span, and
    h_j(f) = −u² / (1 − u² + 2iζu), u = f / f_j, over the modes of the fit.
    ``covariance`` (terms, terms) is that of the smooth terms and the residues of the modes ``reached``, per real part,
    with ``degrees_of_freedom``; ``error`` what a row errs by, per part. ``fits`` says whether the data agree.
    ``recording`` is that of a sweep, "" of a whole test. ``slopes`` (terms, 2 reached) are the derivatives of the terms
    by (ln f, ln ζ) of each mode reached, as the data ask for where it moves; None: not known, as if they stayed.
    """

    order: float
    channel: str
    force: Force
    smooth: Complexes
    residue: Complexes
    reached: Ints
    covariance: Complexes
    degrees_of_freedom: int
    error: float
    fits: bool
    recording: str = ""
    slopes: Complexes | None = None

    def passes(self, rpm: float) -> bool:
        """Whether ``rpm`` lies in its span."""
        return self.force.span_rpm[0] <= rpm <= self.force.span_rpm[1]


@dataclass(frozen=True, eq=False)
class UnseenBound:
    """How many times a mode that nobody saw could amplify one order: ``amplification`` (speeds,) at ``speed_rpm``."""

    order: float
    speed_rpm: Floats
    amplification: Floats


class Unsearched(NamedTuple):
    """Frequencies, from ``low_hz`` to ``high_hz``, at which a search ``by`` what tells modes stopped at its bound."""

    by: Literal["floor", "orders", "sweeps"]
    low_hz: float
    high_hz: float


@dataclass(frozen=True, eq=False)
class ModalFit:
    """Modes, lowest first, with the ``covariance`` of (f_1, ζ_1, f_2, ζ_2, …); tones; responses; the floor.

    ``responses`` say how the orders pass through the modes, ``unseen`` what they could do without being seen;
    ``shown_orders`` are orders that the spectra of sweeps show and no track does.

    ``frequency_hz`` (frequencies,), ``floor_psd`` and ``fitted_psd`` (channels, frequencies): what is left of the
    Campbell map without order lines, at unit gain, and the fit of it; NaN where orders cover a bin at all speeds.
    ``whirls`` are the natural frequencies that move with the speed, lowest first; ``left``: where modes may be missing.
    """

    modes: tuple[Mode, ...]
    tones: tuple[Tone, ...]
    covariance: Floats
    responses: tuple[OrderResponse, ...] = ()
    unseen: tuple[UnseenBound, ...] = ()
    shown_orders: tuple[float, ...] = ()
    frequency_hz: Floats = field(default_factory=lambda: np.zeros(0))
    floor_psd: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    fitted_psd: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    whirls: tuple[Whirl, ...] = ()
    left: tuple[Unsearched, ...] = ()

    @property
    def step_hz(self) -> float:
        """Distance of neighbouring bins of the floor; 0 where there are none."""
        return float(self.frequency_hz[1] - self.frequency_hz[0]) if len(self.frequency_hz) > 1 else 0.0


class Seen(NamedTuple):
    """What one channel says of one crossing: ``chance`` that an order without the mode looks like that.

    ``ratio`` with its interval is that of the amplitude at ``at_rpm`` to the trend beside; None where there is none.
    """

    channel: str
    chance: float
    at_rpm: float | None = None
    ratio: float | None = None
    ratio_low: float = 0.0
    ratio_high: float = np.inf


@dataclass(frozen=True, eq=False)
class Crossing:
    """The ``finding`` of an order that meets a ``mode``; the ``whirl`` that has it there, None of a mode that stays.

    ``trends``: how the order stands over its trend beside, in the channels that tell.
    """

    finding: CrossingFinding
    mode: Mode
    whirl: Whirl | None = None
    trends: tuple[Seen, ...] = ()

    @property
    def ends_rpm(self) -> Ends:
        """95 % interval of its speed."""
        return cast("Ends", self.finding.rpm_ci95)


@dataclass(frozen=True)
class SpeedVerdicts:
    """Speeds to ``avoid``, worst first; bands that are ``free``; and bands ``open``, of which the data cannot tell."""

    avoid: tuple[AvoidedSpeed, ...]
    free: tuple[FreeBand, ...]
    open: tuple[OpenBand, ...]


class SweepFits(NamedTuple):
    """What the signals of all sweeps of a test tell of its modes, place by place of frequency.

    ``hiding`` is what a mode that they do not show could add to each order; ``shown_orders`` are multiples of the cycle
    that nobody followed and that they show;
    ``left_hz`` are places at which the search stopped before its end.
    """

    groups: tuple[GroupFit, ...] = ()
    hiding: tuple[Hiding, ...] = ()
    shown_orders: tuple[float, ...] = ()
    left_hz: tuple[tuple[float, float], ...] = ()

    @property
    def poles(self) -> tuple[SweepPole, ...]:
        """All poles, lowest first."""
        return tuple(sorted((pole for group in self.groups for pole in group.poles), key=lambda one: one.frequency_hz))


NO_FITS = SweepFits()
"""What a test without sweeps tells."""
