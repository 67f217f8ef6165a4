"""What a test says, in plain sentences made from its findings: what shakes, why, how sure, what to do."""

from __future__ import annotations

from collections import Counter
from typing import Any, TypedDict

from crankorder.report.notation import (
    estimate_text,
    frequency_text,
    interval_of,
    is_number,
    is_tone,
    listed,
    named,
    nominal_order,
    number_text,
    order_text,
    unit_of,
)

NAME_CHARACTERS = 60
RE_RUN_RULE = "Re-run the same test: a growing amplitude means a failing bearing."
_MEETING_SHARE = 0.03  # an order line this close to a natural frequency is said to meet it
_TOGETHER_RPM = 30.0  # crossings closer than this share one sentence
_CLEAR_EXPONENT = 1.5  # an interval of the speed exponent wider than this tells nothing
_MANY = 3  # channels, or speeds to avoid, that a summary names one by one


_LINE_NAMES = {
    "N*fs": "rolling-element count (N·fs)",
    "BPFO": "outer-race (BPFO)",
    "BPFI": "inner-race (BPFI)",
    "BSF": "ball-spin (BSF)",
    "FTF": "cage (FTF)",
}


NOT_ASKED_FOR = "not_asked_for"
"""Key of findings that were not sought: its text says why, and their empty lists mean nothing."""


class Story(TypedDict):
    """The four answers that a page gives first, each a list of sentences."""

    what: list[str]
    why: list[str]
    how_sure: list[str]
    what_to_do: list[str]


def headline(findings: dict[str, Any]) -> list[str]:
    """The few sentences that matter most, the strongest line first; for the command line and the head of the page.

    ``findings`` as in ``data_schema/findings.json``. Never empty.
    """
    if NOT_ASKED_FOR in findings:
        return [f"Findings were {named(findings[NOT_ASKED_FOR], limit=400)}."]
    story = story_of(findings)
    return [*story["what"][:1], *bearing_sentences(findings)[:1], *avoid_sentences(findings)[:1]]


ALL_CLEAR = (
    "Nothing that was looked for asks for action: orders, natural frequencies and their crossings. Strikes in "
    "bearings, which ring above the frequencies analysed, are not looked for."
)


def story_of(findings: dict[str, Any]) -> Story:
    """What shakes, why, how sure and what to do, from ``findings``; unasked for, only what the data are worth."""
    if NOT_ASKED_FOR in findings:
        return Story(what=[], why=[], how_sure=_quality_sentences(findings), what_to_do=_repeat_sentences(findings))
    return Story(
        what=_what(findings),
        why=[
            *_law_sentences(findings),
            *_mode_sentences(findings),
            *bearing_sentences(findings, with_rule=False),
            *_balance_sentences(findings),
        ],
        how_sure=_how_sure(findings),
        what_to_do=_what_to_do(findings),
    )


def strongest_sentence(findings: dict[str, Any], channel: str) -> str:
    """``"Order 2 is the strongest in Z: 0.83 m/s² (0.81…0.85) at 1800 rpm, where it meets the 60 Hz …"``

    ``findings`` of the test; ``channel`` whose strongest order is asked for; empty where it has none.
    """
    records = [
        record
        for record in findings.get("orders", [])
        if record.get("channel") == channel and is_number(record.get("amplitude"))
    ]
    record = max(records, key=lambda one: float(one["amplitude"]), default=None)
    if record is None or record["amplitude"] <= 0:
        return ""
    value, _, interval = estimate_text(record, "amplitude").partition(" ")
    text = f"Order {order_text(nominal_order(record))} is the strongest in {named(channel, limit=NAME_CHARACTERS)}: "
    text += " ".join(part for part in (value, unit_of(findings, record), interval) if part)
    rpm = record.get("speed_rpm_at_max")
    if is_number(rpm):
        text += f" at {rpm:.0f} rpm"
        mode_hz = _met_mode(findings, float(record["order"]), float(rpm))
        if mode_hz is not None:
            text += f", where it meets the {frequency_text(mode_hz)} Hz natural frequency"
    return f"{text}."


def _met_mode(findings: dict[str, Any], order: float, rpm: float) -> float | None:
    line_hz = order * rpm / 60
    modes = [
        float(mode["frequency_hz"])
        for mode in findings.get("modes", [])
        if is_number(mode.get("frequency_hz")) and not is_tone(mode)
    ]
    near = [mode_hz for mode_hz in modes if abs(mode_hz - line_hz) <= _MEETING_SHARE * mode_hz]
    return min(near, key=lambda mode_hz: abs(mode_hz - line_hz)) if near else None


def _what(findings: dict[str, Any]) -> list[str]:
    records = [
        record
        for record in findings.get("orders", [])
        if is_number(record.get("amplitude")) and record["amplitude"] > 0
    ]
    if not records:
        if any(flag.get("flag") == "short_recording" for flag in findings.get("quality", [])):
            return ["No order could be proven: the recordings hold too few revolutions."]
        return ["No order stands above the noise."]
    top: dict[str, float] = {}
    for record in records:
        channel = str(record.get("channel", ""))
        top[channel] = max(top.get(channel, 0.0), float(record["amplitude"]))
    names = sorted(top, key=lambda name: -top[name])
    sentences = [strongest_sentence(findings, name) for name in names[:_MANY]]
    if len(names) > _MANY:
        sentences.append("The table of orders holds the other channels.")
    orders = sorted({nominal_order(record) for record in records})
    shown = [order_text(order) for order in orders[:14]] + (["…"] if len(orders) > 14 else [])
    plural = "s" if len(orders) > 1 else ""
    return [*sentences, f"{len(orders)} order{plural} found: {', '.join(shown)}."]


def _law_sentences(findings: dict[str, Any]) -> list[str]:
    """How the orders grow with speed, each judged in the channel where it is strongest."""
    strongest: dict[float, dict[str, Any]] = {}
    for record in findings.get("orders", []):
        order = nominal_order(record)
        if float(record.get("amplitude") or 0) > float(strongest.get(order, {}).get("amplitude") or 0):
            strongest[order] = record
    intervals = {order: interval_of(record, "speed_exponent") for order, record in strongest.items()}
    known = {
        order: ends for order, ends in intervals.items() if ends is not None and ends[1] - ends[0] < _CLEAR_EXPONENT
    }
    square = {order for order, (low, high) in known.items() if low <= 2 <= high and order in (1.0, 2.0)}
    steady = {order for order, (low, high) in known.items() if low <= 0 <= high}
    sentences = []
    if square:
        verb = "grow" if len(square) > 1 else "grows"
        sentences.append(
            f"{_orders_text(square)} {verb} with the square of the speed, as the force of an unbalanced mass does."
        )
    if steady:
        verb = "keep their" if len(steady) > 1 else "keeps its"
        sentences.append(
            f"{_orders_text(steady)} {verb} size at all speeds: not an unbalance, rather a bearing or a gear."
        )
    return sentences


def _orders_text(orders: set[float]) -> str:
    return f"Order{'s' if len(orders) > 1 else ''} {listed([order_text(order) for order in sorted(orders)])}"


def _mode_sentences(findings: dict[str, Any]) -> list[str]:
    modes = [mode for mode in findings.get("modes", []) if is_number(mode.get("frequency_hz"))]
    own = [f"{frequency_text(mode['frequency_hz'])} Hz" for mode in modes if not is_tone(mode)]
    other = [
        f"{frequency_text(mode['frequency_hz'])} Hz ({named(mode['explained_by'], limit=NAME_CHARACTERS)})"
        for mode in modes
        if is_tone(mode)
    ]
    sentences = []
    if own:
        noun = "Natural frequencies" if len(own) > 1 else "Natural frequency"
        sentences.append(f"{noun}: {listed(own[:16])}{' and more' if len(own) > 16 else ''}.")
    if other:
        sentences.append(f"Tones that are no natural frequencies: {listed(other[:8])}.")
    return sentences


def bearing_sentences(findings: dict[str, Any], *, with_rule: bool = True) -> list[str]:
    """One sentence per bearing line of ``findings`` that was seen; ``with_rule`` adds when to worry."""
    groups: dict[tuple[float, str], list[dict[str, Any]]] = {}
    for record in findings.get("bearings", []):
        if is_number(record.get("amplitude")) and is_number(record.get("order")):
            groups.setdefault((nominal_order(record), str(record.get("line", ""))), []).append(record)
    sentences = []
    for (order, line), records in groups.items():
        best = max(records, key=lambda record: float(record["amplitude"]))
        names = list(dict.fromkeys(named(record.get("name", ""), limit=NAME_CHARACTERS) for record in records))
        value, _, interval = estimate_text(best, "amplitude").partition(" ")
        level = " ".join(part for part in (value, unit_of(findings, best), interval) if part)
        where = f" in {named(best['channel'], limit=NAME_CHARACTERS)}" if best.get("channel") else ""
        which = _LINE_NAMES.get(line, named(line, limit=NAME_CHARACTERS))
        plural = "s" if len(names) > 1 else ""
        text = (
            f"Order {order_text(order)} fits the {which} line of the {listed(names)} bearing{plural}: {level}{where}."
        )
        said = [part.strip().rstrip(".") for part in named(best.get("verdict", ""), limit=400).split(". ")]
        said = [f" {part[0].upper()}{part[1:]}." for part in said if part and "re-run" not in part.lower()]
        sentences.append(text + "".join(said) + (f" {RE_RUN_RULE}" if with_rule else ""))
    return sentences


def _balance_sentences(findings: dict[str, Any]) -> list[str]:
    balance = findings.get("balance")
    if not isinstance(balance, dict):
        return []
    sentences = []
    if is_number(balance.get("residual_reciprocating_g")):
        sentences.append(
            f"Unbalanced reciprocating mass: {estimate_text(balance, 'residual_reciprocating_g', unit='g')}."
        )
    if is_number(balance.get("residual_rotating_gmm")):
        text = f"Rotating unbalance: {estimate_text(balance, 'residual_rotating_gmm', unit='g·mm')}"
        if is_number(balance.get("angle_deg")):
            text += f" at {estimate_text(balance, 'angle_deg')}° from the crank"
        sentences.append(f"{text}.")
    return sentences


def _how_sure(findings: dict[str, Any]) -> list[str]:
    sentences = ["Numbers in brackets are 95 % intervals."]
    fraction = findings.get("unexplained_energy_fraction")
    if is_number(fraction):
        share = number_text(100 * float(fraction), digits=2)
        known = float(fraction) == 0
        text = "All the energy of the lines that were found has a known cause."
        sentences.append(text if known else f"{share} % of the energy of the lines that were found has no known cause.")
    return [*sentences, *_quality_sentences(findings)]


def _quality_sentences(findings: dict[str, Any]) -> list[str]:
    sentences = []
    count = Counter(str(flag.get("severity", "info")) for flag in findings.get("quality", []))
    if count["bad"]:
        sentences.append(f"{_remarks(count['bad'])} bad: those data took no part in the averages.")
    if count["suspect"]:
        sentences.append(
            f"{_remarks(count['suspect'])} suspect: see the table of quality before relying on the numbers."
        )
    if not count["bad"] and not count["suspect"]:
        sentences.append("No recording was found faulty or suspect.")
    return sentences


def _remarks(number: int) -> str:
    return "1 quality remark is" if number == 1 else f"{number} quality remarks are"


def avoid_sentences(findings: dict[str, Any]) -> list[str]:
    """Speeds to avoid: one sentence per group of excited crossings of ``findings`` inside the tested range."""
    wanted = [
        record
        for record in findings.get("crossings", [])
        if record.get("excited") and record.get("in_range") and is_number(record.get("rpm"))
    ]
    wanted.sort(key=lambda record: float(record["rpm"]))
    groups: list[list[dict[str, Any]]] = []
    for record in wanted:
        if groups and float(record["rpm"]) - float(groups[-1][0]["rpm"]) <= _TOGETHER_RPM:
            groups[-1].append(record)
        else:
            groups.append([record])
    sentences = []
    for group in sorted(groups, key=lambda group: (-len(group), float(group[0]["rpm"]))):
        rpm = sum(float(record["rpm"]) for record in group) / len(group)
        unique = dict.fromkeys((nominal_order(record), float(record["mode_hz"])) for record in group)
        pairs = [
            f"order {order_text(order)} excites the {frequency_text(mode_hz)} Hz natural frequency"
            for order, mode_hz in unique
        ]
        sentences.append(f"Avoid steady running near {rpm:.0f} rpm, where {listed(pairs)}.")
    return sentences


def _what_to_do(findings: dict[str, Any]) -> list[str]:
    avoid = avoid_sentences(findings)
    sentences = avoid[:_MANY]
    if len(avoid) > _MANY:
        sentences.append("The table of crossings names all speeds to avoid.")
    if bearing_sentences(findings):
        sentences.append(RE_RUN_RULE)
    return [*sentences, *_repeat_sentences(findings)] or [ALL_CLEAR]


def _repeat_sentences(findings: dict[str, Any]) -> list[str]:
    bad = any(flag.get("severity") == "bad" for flag in findings.get("quality", []))
    return ["Repeat the recordings that are marked bad."] if bad else []
