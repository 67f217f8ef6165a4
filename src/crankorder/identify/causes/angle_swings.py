"""Lines that a swing of the crank angle may make beside strong orders: of the shaft, or an error of its encoder."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from crankorder.cause import BY_A_SWING, Cause
from crankorder.identify.found import AgreedOrder, OrderLine
from crankorder.orders.swing_evidence import HARMONICS
from crankorder.orders.true_angle import LINES, LINES_PER_HARMONIC, TAKEN, left_of, swing_shown
from crankorder.quantities import Bools, Floats
from crankorder.settings import MethodNumbers

SWING_NUMBERS = MethodNumbers("5-identify-explain.toml", "swing_sidebands")

ENCODER_ERROR = "an error of the encoder that the data do not exclude"

WHOLE_HALVES = 0.05
"""An order this near, in half orders, to so many half orders from another is one."""

MOST_ROWS = 128
"""Speeds of a line that are looked at, evenly spread."""

MOST_TIMES = 4
"""Most turns of a swing by which a line lies beside its order: the n-th sideband is as large as the n-th power."""


@dataclass(frozen=True, eq=False)
class AngleSwings:
    """Swings of the crank angle: of the shaft, by speed, and what may be left of an encoder's error.

    ``shown`` (speeds, 1 + half orders) are the rising speed [rpm] and, behind it, peak amplitudes [rev] at 0.5, 1, 1.5
    … times a turn; ``unseen_rev`` (1 + half orders,) amplitudes of which too few pulses show nothing; ``left_rev`` by
    harmonic of the turn; ``proved`` says whether an encoder's error was taken out.
    """

    shown: Floats
    unseen_rev: Floats
    left_rev: dict[int, float]
    proved: bool

    @classmethod
    def of(cls, frames: Sequence[xr.Dataset], orders: Sequence[AgreedOrder]) -> AngleSwings:
        """What the ``frames`` (OrderFrames) of a test state of the angle by which its ``orders`` were found."""
        recordings, whole = [], [2 * harmonic for harmonic in HARMONICS]
        for spectra in frames:
            swing = np.abs(swing_shown([spectra]))
            swing[:, whole] -= np.minimum(swing[:, whole], spectra.attrs.get(TAKEN, 0.0))
            recordings.append(swing)
        shown = np.concatenate(recordings)
        shown = shown[np.argsort(shown[:, 0])]
        unseen, highest = np.zeros(shown.shape[1]), max(float(spectra["order"].max()) for spectra in frames)
        if any(0.0 < float(spectra.attrs.get(LINES, 0.0)) < LINES_PER_HARMONIC for spectra in frames):
            unseen = np.where(shown.any(axis=0), 0.0, _likely_swings(orders, len(unseen), highest))
        proved = any(float(np.max(spectra.attrs.get(TAKEN, [0.0]))) > 0.0 for spectra in frames)
        return cls(shown, unseen, left_of(frames), proved)

    def at(self, half_orders: int, rpm: Floats, *, unseen: bool) -> Floats:
        """Swing [rev] of the shaft at so many ``half_orders`` and at ``rpm`` (rows,), also where it is ``unseen``."""
        if not 0 < half_orders < len(self.unseen_rev):
            return np.zeros(len(rpm))
        seen = np.interp(rpm, self.shown[:, 0], self.shown[:, half_orders]) if len(self.shown) else 0.0
        return seen + np.full(len(rpm), unseen * self.unseen_rev[half_orders])


def _likely_swings(orders: Sequence[AgreedOrder], count: int, highest: float) -> Floats:
    """Swings [rev] (count,) by half order that the lines beside the order which they move most do not exclude.

    A swing of the angle moves each order by its number times its amplitude: where the order of which that is largest
    has no sidebands, one on either side up to the ``highest`` order looked at, no other has. No shaft swings by more
    than a share of the speed.
    """
    lines = [(agreed.order, line) for agreed in orders for line in agreed.lines]
    number, carrier = max(lines, key=lambda pair: pair[0] * float(pair[1].amplitude.max()))
    own = [(order, math.sqrt(np.mean(line.amplitude**2))) for order, line in lines if line.channel == carrier.channel]
    turned = np.pi * number * math.sqrt(np.mean(carrier.amplitude**2))
    likely = np.zeros(count)
    for at in range(1, SWING_NUMBERS.most_half_orders + 1):
        places = [place for place in (number - 0.5 * at, number + 0.5 * at) if 0.0 < place <= highest]
        sides = [
            max((size for order, size in own if abs(order - place) < 0.5 * WHOLE_HALVES), default=0.0)
            for place in places
        ]
        answered = SWING_NUMBERS.answer_ratio * min(sides, default=0.0) / turned
        likely[at] = min(answered, SWING_NUMBERS.most_share / (np.pi * at))
    return likely


def swing_sidebands(orders: Sequence[AgreedOrder], frames: Sequence[xr.Dataset]) -> dict[tuple[str, float], Cause]:
    """Causes of lines of ``orders`` that are no larger than swings of the angle may make them, by channel and order.

    A force at order n of a shaft that swings by ε sin(k θ) has sidebands π n ε at n ± k in time. The structure
    responds to each at its own frequency, so that π n ε (H(n ± k) / H(n) - 1) times the order is left of them in the
    angle of the shaft (H: the response), the first part alone where pulses do not show the swing; an error ε of the
    encoder leaves π n ε. What the order itself has where the speed brings it to the frequency of the sideband tells the
    response there. ``frames`` (OrderFrames) say how the angle swings.
    """
    causes: dict[tuple[str, float], Cause] = {}
    if not orders:
        return causes
    swings = AngleSwings.of(frames, orders)
    for agreed in orders:
        of_order: dict[tuple[str, float], Cause] = {}
        within = 0
        for line in agreed.lines:
            beside = [(other.order, item) for other in orders for item in other.lines if item.channel == line.channel]
            others = [pair for pair in beside if pair[1] is not line]
            given = [part for pair in others for part in _given(line, agreed.order, *pair, swings)]
            if not given:
                break
            within += _within(line, given, speeds=max(len(item.amplitude) for _, item in beside))
            most = max(given, key=lambda part: float(np.sum(part.amplitude)))
            maker = ENCODER_ERROR if most.by_encoder else "a swing of the shaft"
            evidence = f"no larger in most channels than what {maker} gives it beside order {most.carrier:g}"
            of_order[line.channel, agreed.order] = (
                Cause("sideband of an encoder", evidence, {"carrier": most.carrier})
                if most.by_encoder and swings.proved
                else replace(BY_A_SWING, evidence=evidence)
            )
        # an order is one thing in all channels
        causes |= of_order if 2 * within >= len(agreed.lines) else {}
    return causes


@dataclass(frozen=True, eq=False)
class _Given:
    """Largest ``amplitude`` (rows,) that the order ``carrier`` gives, by an encoder's error or a swing of the shaft.

    ``known`` (rows,): whether the speeds are close enough to tell how the structure responds.
    """

    carrier: float
    amplitude: Floats
    known: Bools
    by_encoder: bool


def _given(line: OrderLine, order: float, number: float, carrier: OrderLine, swings: AngleSwings) -> list[_Given]:
    """What ``swings`` give to ``line`` at ``order`` at most of its ``carrier`` at the order ``number``."""
    if carrier.amplitude.max() < line.amplitude.max():
        return []  # nothing is the sideband of what is weaker
    rpm, parts = line.speed_rpm[_rows(line)], []
    # what is not seen must not let two orders each be the sideband of the other
    unseen = number * float(carrier.amplitude.max()) > order * float(line.amplitude.max())
    for half_orders in (2.0 * abs(order - number), 2.0 * (order + number)):
        at = round(half_orders)
        if not at or abs(half_orders - at) > WHOLE_HALVES:
            continue
        divisors = [n for n in range(1, MOST_TIMES + 1) if at % n == 0]
        swing = np.sum([(np.pi * number * swings.at(at // n, rpm, unseen=unseen)) ** n for n in divisors], axis=0)
        left = swings.left_rev.get(at // 2, 0.0) if at % 2 == 0 else 0.0
        if not swing.any() and not left:
            continue
        here, largest, known = _amplitudes(carrier, rpm, order / number)
        parts.append(_Given(number, swing * (here + largest), known, by_encoder=False))
        parts.append(_Given(number, np.pi * number * left * here, known, by_encoder=True))
    return [part for part in parts if part.amplitude.any()]


def _amplitudes(carrier: OrderLine, rpm: Floats, ratio: float) -> tuple[Floats, Floats, Bools]:
    """Amplitude of ``carrier`` at ``rpm`` (rows,), the largest from there to ``ratio`` times that speed, if known.

    The force behind it is taken to grow with the square of the speed. Where speeds are too coarse to tell what is
    between them the largest of all stands for it; beyond their ends a natural frequency may lift it further.
    """
    rising = np.argsort(carrier.speed_rpm)
    speed, amplitude, sought = carrier.speed_rpm[rising], carrier.amplitude[rising], ratio * rpm
    gap = np.append(np.diff(speed), np.inf)[np.searchsorted(speed, sought, side="right") - 1]
    inside = (sought >= speed[0]) & (sought <= speed[-1])
    known = inside & (gap < SWING_NUMBERS.dense_share * sought)
    reach = 1.0 + SWING_NUMBERS.dense_share
    low, high = np.minimum(rpm, sought)[:, None] / reach, np.maximum(rpm, sought)[:, None] * reach
    counts = ~known[:, None] | ((speed >= low) & (speed <= high))
    scaled = amplitude * np.maximum(1.0, np.square(rpm[:, None] / speed))
    largest = np.where(counts, scaled, 0.0).max(axis=1) * np.where(inside, 1.0, SWING_NUMBERS.beyond_lift)
    return np.interp(rpm, speed, amplitude), largest, known


def _within(line: OrderLine, given: Sequence[_Given], *, speeds: int) -> bool:
    """Whether ``line`` is no larger than what is ``given`` to it where that is known, and at most of the ``speeds``.

    At one speed its own scatter may lift it; where speeds are coarse a natural frequency between them may.
    """
    allowed = np.sum([part.amplitude for part in given], axis=0)
    known = np.sum([part.amplitude * part.known for part in given], axis=0) >= 0.5 * allowed
    scatter = np.nan_to_num(line.amplitude_error) * SWING_NUMBERS.scatter_sigmas
    above = line.amplitude[_rows(line)] > (1.0 + SWING_NUMBERS.alike_share) * allowed + scatter[_rows(line)]
    return not (above & known).any() and bool(np.mean(above) * len(line.amplitude) <= 0.5 * speeds)


def _rows(line: OrderLine) -> slice:
    """Rows of a ``line`` that are looked at: those of a sweep are many, and alike."""
    return slice(None, None, -(-len(line.amplitude) // MOST_ROWS))
