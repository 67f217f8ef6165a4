"""A supply has one frequency: of lines that are called the same multiple of the mains one at most is that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crankorder.identify.found import AgreedOrder, Tone
from crankorder.identify.mains import multiple_in
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="one_mains"):
    same_sigmas: float
    least_apart_hz: float


NUMBERS = _Numbers.load()

OR_ANOTHER = "another tone"
"""What a line may be as well beside which a second one has as good a claim to be the mains."""


@dataclass(frozen=True)
class Claim:
    """A line that is called ``multiple`` times the mains: frequency and standard error in Hz, the speeds it is seen at.

    ``order`` is its AgreedOrder.order, ``tone`` the place of its tone; the other one is None.
    """

    multiple: int
    hertz: float
    error_hz: float
    speeds_rpm: tuple[float, ...]
    order: float | None = None
    tone: int | None = None

    def rivals(self, other: Claim) -> bool:
        """Whether this and the ``other`` cannot both be mains: in one recording, and at two frequencies."""
        apart = abs(self.hertz - other.hertz)
        reach = max(NUMBERS.same_sigmas * float(np.hypot(self.error_hz, other.error_hz)), NUMBERS.least_apart_hz)
        together = not self.speeds_rpm or not other.speeds_rpm or bool(set(self.speeds_rpm) & set(other.speeds_rpm))
        return self.multiple == other.multiple and together and apart > reach

    def fits(self, base_hz: float, error_hz: float) -> bool:
        """Whether it is a multiple of a supply that other lines put at ``base_hz``, within ``error_hz``."""
        reach = NUMBERS.same_sigmas * float(np.hypot(self.error_hz, self.multiple * error_hz))
        return abs(self.hertz - self.multiple * base_hz) <= max(reach, NUMBERS.least_apart_hz)


def claims_of(
    orders: Sequence[AgreedOrder], tones: Sequence[Tone], order_words: Mapping[float, str], tone_words: Sequence[str]
) -> list[Claim]:
    """Those of ``orders`` and ``tones`` that their words call a multiple of the mains, and nothing else.

    ``order_words`` by order, ``tone_words`` one for each tone.
    """
    made = []
    for one in orders:
        multiple = multiple_in(order_words.get(one.order, ""))
        if multiple is None:
            continue
        speeds = np.concatenate([line.speed_rpm for line in one.lines])
        rpm = float(speeds.mean())
        error = float(np.hypot(one.line_error * rpm, one.order * np.ptp(speeds) / 4.0)) / 60.0
        made.append(Claim(multiple, one.order * rpm / 60.0, error, tuple(np.unique(speeds)), order=one.order))
    for number, (tone, words) in enumerate(zip(tones, tone_words, strict=True)):
        if (multiple := multiple_in(words)) is not None:
            made.append(Claim(multiple, tone.frequency_hz, tone.frequency_error_hz, (), tone=number))
    return made


def doubtful(claims: Sequence[Claim]) -> dict[Claim, tuple[Claim, bool]]:
    """Those of ``claims`` that have a rival, with it; and whether the rival is known to be the mains by other lines.

    What is the mains by another multiple of the supply, where that fits one of the rivals alone, is not among them.
    """
    rivals = {one: [other for other in claims if one.rivals(other)] for one in claims}
    sure = [one for one in claims if not rivals[one]]
    made: dict[Claim, tuple[Claim, bool]] = {}
    for one, others in rivals.items():
        if not others:
            continue
        beside = [item for item in sure if item.multiple != one.multiple]
        fitting = [item for item in (one, *others) if _fits_any(item, beside)]
        if fitting == [one]:
            continue
        winner = fitting[0] if len(fitting) == 1 else None
        made[one] = (winner or others[0], winner is not None)
    return made


def _fits_any(claim: Claim, sure: Sequence[Claim]) -> bool:
    return any(claim.fits(item.hertz / item.multiple, item.error_hz / item.multiple) for item in sure)
