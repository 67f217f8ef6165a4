"""What a test says, in plain sentences made from its findings: what shakes, why, how sure, what to do."""

from __future__ import annotations

from collections import Counter
from typing import TypedDict

from crankorder.findings import Findings
from crankorder.plot.fixed_lines import fixed_tones
from crankorder.quantities import WHICH_IS_RIGHT
from crankorder.report.notation import NAME_CHARACTERS, is_number, listed, named, percent_text, strongest_by
from crankorder.report.sentences.of_balance import balance_sentences
from crankorder.report.sentences.of_bearings import RE_RUN_RULE, asks_re_run, bearing_lines, bearing_sentences
from crankorder.report.sentences.of_levels import level_sentences, limit_sentences, share_sentences, undecided_limits
from crankorder.report.sentences.of_lines import (
    LIKE_UNBALANCE,
    above_asks,
    lies_above,
    line_sentences,
    mode_sentences,
    motor_sentences,
    nothing_proven,
    slow_sentences,
    strongest_sentence,
    tone_sentences,
)
from crankorder.report.sentences.of_orders import law_sentences, lock_sentences
from crankorder.report.sentences.of_speeds import (
    all_judged,
    avoid_sentences,
    doubt_sentences,
    free_sentences,
    shaft_sentences,
    swing_sentences,
)

__all__ = [
    "ALL_CLEAR", "NAME_CHARACTERS", "RE_RUN_RULE", "Story", "avoid_sentences", "bearing_sentences",
    "energy_sentence", "headline", "story_of", "strongest_sentence",
]  # fmt: skip

ALL_CLEAR = (
    "Nothing that was looked for asks for action: orders, natural frequencies and their crossings. Strikes in "
    "bearings, which ring above the frequencies analysed, are not looked for."
)
ALL_CLEAR_WITH_ENVELOPE = (
    "Nothing that was looked for asks for action: orders, natural frequencies, their crossings, and the lines of the "
    "bearings that were named, in the vibration and in its envelope."
)
STILL_CLEAR = "Nothing asks for action: natural frequencies are no fault by themselves."
INTERVALS = "Numbers in brackets are 95 % intervals."
BALANCE = "Balance it: the strongest order is that of an unbalanced mass."
BALANCE_IN = "Balance it: the strongest order in {channels} is that of an unbalanced mass."
MORE_SPEEDS = (
    "Record four speeds or more, the fastest twice the slowest: what does not grow with the square of the speed is no "
    "unbalance."
)
TOO_SHORT = "Record more revolutions at each speed: what was recorded proves neither a fault nor that there is none."
_MANY = 3  # speeds to avoid that a summary names one by one
_MUCH_UNKNOWN = 0.05  # of the energy: more than this asks for a look


class Story(TypedDict):
    """The four answers that a page gives first, each a list of sentences."""

    what: list[str]
    why: list[str]
    how_sure: list[str]
    what_to_do: list[str]


def headline(findings: Findings) -> list[str]:
    """The few sentences that matter most, the strongest line first; for the command line and the head of the page.

    A limit that is passed, and those that are not decided; the strongest line with its cause, the first bearing's
    verdict (first where a bearing strikes), the worst speed, the residual unbalance (or why it is not known), the share
    of energy that nothing explains; that something stands below the lowest order that is told; of what does not turn
    its natural frequencies. ``findings`` as in ``data_schema/findings.json``. Never empty.
    """
    if findings.not_asked_for:
        return [*shaft_sentences(findings), f"Findings were {named(findings.not_asked_for, limit=400)}."]
    energy = energy_sentence(findings)
    limits = [*limit_sentences(findings, above=True)[:1], *undecided_limits(findings)]
    if stands_still(findings):
        return [*limits, *mode_sentences(findings)[:1], *([energy] if energy else [])]
    lines = line_sentences(findings)[: 1 + lies_above(findings)]
    bearings = bearing_sentences(findings)[:1]
    return [
        *doubt_sentences(findings),
        *limits,
        *(bearings + lines if strikes(findings) else lines + bearings),
        *slow_sentences(findings),
        *(avoid_sentences(findings) or free_sentences(findings))[:1],
        *balance_sentences(findings)[:1],
        *([energy] if energy else []),
    ]


def story_of(findings: Findings) -> Story:
    """What shakes, why, how sure and what to do, from ``findings``; unasked for, only what the data are worth."""
    if findings.not_asked_for:
        what, doubts = shaft_sentences(findings), _quality_sentences(findings)
        return Story(what=what, why=[], how_sure=doubts, what_to_do=_repeat_sentences(findings))
    energy = energy_sentence(findings)
    if stands_still(findings):
        return Story(
            what=[*mode_sentences(findings), *level_sentences(findings), *limit_sentences(findings)],
            why=tone_sentences(findings),
            how_sure=[
                INTERVALS,
                *([energy] if energy else []),
                *share_sentences(findings),
                *_quality_sentences(findings),
            ],
            what_to_do=[*_repeat_sentences(findings)] or [STILL_CLEAR],
        )
    return Story(
        what=[*line_sentences(findings), *level_sentences(findings), *limit_sentences(findings)],
        why=[
            *law_sentences(findings),
            *swing_sentences(findings),
            *mode_sentences(findings),
            *tone_sentences(findings),
            *motor_sentences(findings),
            *bearing_sentences(findings, with_rule=False),
            *balance_sentences(findings),
        ],
        how_sure=[
            INTERVALS,
            *doubt_sentences(findings),
            *([energy] if energy else []),
            *share_sentences(findings),
            *lock_sentences(findings),
            *_quality_sentences(findings),
        ],
        what_to_do=_what_to_do(findings),
    )


def stands_still(findings: Findings) -> bool:
    """Whether nothing turned, as far as ``findings`` tell: no speed, no order, but natural frequencies."""
    speeds = findings.speed_range_rpm or []
    return bool(findings.modes) and not findings.orders and not any(is_number(one) for one in speeds)


def strikes(findings: Findings) -> bool:
    """Whether a bearing of ``findings`` strikes: a line of its envelope is called damage."""
    return any(record.damage for record in findings.bearings)


def energy_sentence(findings: Findings) -> str:
    """Share of the energy of ``findings`` that nothing explains, as a number, and of what; empty where not known."""
    fraction, energy = findings.unexplained_energy_fraction, findings.energy
    if not is_number(fraction):
        return ""
    whole = energy is not None and bool(energy.channels)
    if not whole and not findings.lines and not findings.orders:
        return ""  # no line, no energy of lines
    what = "the energy that is not broadband" if whole else "the energy of the lines that were found"
    if findings.speed_doubt:
        return ""  # what orders explain is as good as the speed
    judged = not whole or energy is None or energy.cells_judged is not False
    but = "" if judged else " What lies between the lines could not be judged."
    if float(fraction) == 0 and whole and not has_lines(findings):
        return f"In the band that was looked at no order and no tone holds energy that would need a cause.{but}"
    much_above = any(is_number(one.share_above) and one.share_above > _MUCH_UNKNOWN for one in findings.levels)
    if float(fraction) == 0 and (_has_unexplained(findings) or much_above):
        return f"Less than 0.1 % of {what} in the band that was looked at has no known cause.{but}"
    if float(fraction) == 0:
        by = "orders and tones with a known cause" if whole else "what the tables name"
        return f"All of {what} is explained by {by}: 0 % is unexplained.{but}"
    return f"{percent_text(float(fraction))} of {what} has no known cause.{but}"


def has_lines(findings: Findings) -> bool:
    """Whether ``findings`` hold an order or a tone."""
    return bool(findings.orders) or bool(fixed_tones(findings))


def _quality_sentences(findings: Findings) -> list[str]:
    sentences = []
    count = Counter(flag.severity for flag in findings.quality)
    if count["bad"]:
        sentences.append(f"{_remarks(count['bad'])} bad: those data took no part in the averages.")
    if count["suspect"]:
        sentences.append(
            f"{_remarks(count['suspect'])} suspect: see the table of quality before relying on the numbers."
        )
    sentences += _gain_sentences(findings)
    if not count["bad"] and not count["suspect"]:
        sentences.append("No recording was found faulty or suspect.")
    return sentences


def _gain_sentences(findings: Findings) -> list[str]:
    """Which channels of which recordings were left out for a gain that was changed, by whether it is known which."""
    jumps = [flag for flag in findings.quality if flag.flag == "level_jump" and flag.left_out]
    sentences = []
    for open_, why in ((False, "its gain was changed"), (True, f"gains differ, and nothing tells {WHICH_IS_RIGHT}")):
        own = [flag for flag in jumps if (WHICH_IS_RIGHT in flag.detail) == open_]
        said = [
            f"{named(flag.channel, limit=NAME_CHARACTERS)} of {named(flag.recording, limit=NAME_CHARACTERS)}"
            for flag in own[:_MANY]
        ]
        if own:
            more = f" and {len(own) - _MANY} more" if len(own) > _MANY else ""
            sentences.append(f"Left out of everything that is said: {', '.join(said)}{more} ({why}).")
    return sentences


def _remarks(number: int) -> str:
    return "1 quality remark is" if number == 1 else f"{number} quality remarks are"


def _what_to_do(findings: Findings) -> list[str]:
    avoid = avoid_sentences(findings)
    sentences = avoid[:_MANY]
    if len(avoid) > _MANY:
        sentences.append(f"The table of speeds to avoid names all {len(avoid)} of them.")
    asks = [*sentences]
    if any(asks_re_run(record) for _, record in bearing_lines(findings)):
        asks.append(RE_RUN_RULE)
    asks += above_asks(findings)
    asks += _balance_asks(findings)
    if _leads(findings, LIKE_UNBALANCE):
        asks.append(MORE_SPEEDS)
    fraction = findings.unexplained_energy_fraction
    if is_number(fraction) and fraction > _MUCH_UNKNOWN and _has_unexplained(findings):
        asks.append("Look for the cause of the lines that the tables call unexplained.")
    asks += _repeat_sentences(findings)
    if not asks and nothing_proven(findings):
        asks = [TOO_SHORT]
    if not asks and all_judged(findings):
        asks = [ALL_CLEAR_WITH_ENVELOPE if "envelope" in findings.looked_for else ALL_CLEAR]
    return [*asks[: len(sentences)], *free_sentences(findings), *asks[len(sentences) :]]


def _has_unexplained(findings: Findings) -> bool:
    """Whether any line of ``findings`` is called unexplained."""
    return any(record.kinds == ("unexplained",) for record in findings.lines)


def _balance_asks(findings: Findings) -> list[str]:
    """That an unbalanced mass asks for balancing: in the channels in which its order is the strongest."""
    strongest = strongest_by(findings.orders, lambda one: one.channel)
    leads = [name for name, record in strongest.items() if record.kinds == ("unbalance",)]
    if not leads or not _leads(findings, "unbalance"):
        return []
    if len(leads) == len(strongest):
        return [BALANCE]
    return [BALANCE_IN.format(channels=listed([named(name, limit=NAME_CHARACTERS) for name in sorted(leads)]))]


def _leads(findings: Findings, cause: str) -> bool:
    """Whether the strongest order of any channel of ``findings`` has that ``cause``, or may for want of speeds."""
    if findings.speed_doubt or lies_above(findings):
        return False
    strongest = strongest_by(findings.orders, lambda one: one.channel).values()
    leading = [record for record in strongest if record.kinds == (cause,)]
    return any(cause != LIKE_UNBALANCE or "few speeds" in record.doubts for record in leading)


def _repeat_sentences(findings: Findings) -> list[str]:
    return ["Repeat the recordings that are marked bad."] * any(flag.severity == "bad" for flag in findings.quality)
