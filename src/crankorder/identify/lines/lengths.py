"""Lengths of the frames in which close lines of a sweep are looked for."""

from __future__ import annotations

LONGEST_REVS, FEWEST_FRAMES = 128, 4
"""Longest frames in which lines are looked for, and how many lengths of them a recording must hold: short frames
show how a line changes, long ones which lines there are."""


def longer_frames(revs: float, span_rev: float) -> list[float]:
    """Lengths [rev] from ``revs`` on, each twice the one before, that a recording of ``span_rev`` holds."""
    made = [revs]
    while 2.0 * made[-1] <= LONGEST_REVS and span_rev >= FEWEST_FRAMES * 2.0 * made[-1]:
        made.append(2.0 * made[-1])
    return made


def longest_frame(revs: float, span_rev: float) -> float:
    """The last of :func:`longer_frames`, of ``revs`` and ``span_rev``."""
    return longer_frames(revs, span_rev)[-1]
