"""What findings say that pages read again: apart from what finds it, so that pages are written without loading that."""

from __future__ import annotations

from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-explain.toml", table="said"):
    alike_speeds_ratio: float
    clearly_excited_ratio: float


NUMBERS = _Numbers.load()

ONE_SPEED = "too few speeds to tell how it grows"
"""What is said of an order of which nothing tells whether it grows as an unbalance does."""

LIKE_UNBALANCE = "unbalance, bent shaft or misalignment"
"""What order 1 is called where nothing tells these apart."""

OR_OWN = "sideband by a swing of the angle or a line of its own"
"""Words for a line that the swing of the shaft or an error of its encoder may make, which nothing proves."""

NOT_AS_UNBALANCE = "does not grow as unbalance does"
"""What is said of an order 1 that surely grows more slowly."""

IF_UNBALANCE = "if order 1 is unbalance"
"""What is said of a residual unbalance where nothing tells order 1 from a bent shaft or misalignment."""

UNRESOLVED = (
    "stronger than all that is told in this channel, but not resolved: lines too close to be parted, or a resonance"
)
"""What is said of a peak that no rule names and beside which all that is named is weaker."""

MAY_BE_ALL = "stands there, and may be all of it"
"""What is said of a natural frequency at which a line stands that something else makes."""

IF_WRONG = "this one if that is wrong"
"""Words of a shaft that may be the one whose speed was stated."""

AMPLIFIED = "is amplified more than"
"""Words of an open band in which a mode is seen to amplify an order."""

_LOW_WORDS = {1: "mains", 2: "twice mains"}
_OF_THE_FIELD = (*_LOW_WORDS.values(), "motor, pole-pass", "motor, sideband")


def mains_words(multiple: int) -> str:
    """What a line at ``multiple`` times the mains frequency is called: "mains", "twice mains", "3 x mains"."""
    return _LOW_WORDS.get(multiple, f"{multiple} x mains")


def is_electric(text: str) -> bool:
    """Whether the words ``text`` of a cause name the mains or the field of a motor, and no order of the shaft."""
    return (text.startswith(_OF_THE_FIELD) or " x mains" in text) and " or order" not in text
