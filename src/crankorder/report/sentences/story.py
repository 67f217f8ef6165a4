"""What a test says, in plain sentences made from its findings: what shakes, why, how sure, what to do.

Here are those on how orders grow and whether they are locked, on the residual unbalance, the energy and the quality.
"""

from __future__ import annotations

from typing import Literal

from crankorder.findings import Balance, Findings, OrderFinding
from crankorder.plot.reading import (
    at_one_speed,
    estimate_text,
    fixed_tones,
    frequency_text,
    hertz_of_order,
    interval_of,
    is_in_doubt,
    is_number,
    listed,
    nominal_order,
    order_name,
    order_texts,
    percent_text,
    reason_text,
    short,
    strongest_by,
)
from crankorder.quantities import WHICH_IS_RIGHT
from crankorder.report.sentences import of_lines, of_speeds

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

QUANTITIES = {
    "residual_reciprocating_g": ("Unbalanced reciprocating mass (first order)", "g"),
    "residual_second_order_g": ("Unbalanced reciprocating mass (second order)", "g"),
    "residual_rotating_gmm": ("Rotating unbalance", "g·mm"),
    "angle_deg": ("Angle of the rotating unbalance from the crank", "°"),
    "forward_gmm": ("Forward (rotating) part", "g·mm"),
    "forward_angle_deg": ("Angle of the forward part from the crank", "°"),
    "reverse_gmm": ("Reverse part", "g·mm"),
    "reverse_angle_deg": ("Angle of the reverse part from the crank", "°"),
    "along_g": ("At the crank radius, along the cylinder", "g"),
    "along_quadrature_g": ("A quarter turn ahead of it", "g"),
    "across_g": ("At the crank radius, across the cylinder", "g"),
    "crank_radius_mm": ("Crank radius", "mm"),
}
"""Title and unit of each number of ``balance`` in the findings, in the order of the table."""

OF_ONE_ORDER = ("residual_second_order_g", "along_g", "along_quadrature_g")
"""What is the reciprocating mass again, by one of its orders alone, where nothing is known across the cylinder."""

_WEIGHTS: dict[Literal["bad", "suspect"], str] = {
    "bad": "those data took no part in the averages",
    "suspect": "see the table of quality before relying on the numbers",
}
_MANY = 3  # speeds to avoid that a summary names one by one
_MUCH_UNKNOWN = 0.05  # of the energy: more than this asks for a look
_CLEAR_EXPONENT = 1.5  # an interval of the speed exponent wider than this tells nothing
_SHOWN = 8  # orders that a sentence names
_STEADY_CAUSES = ("unexplained", "bearing", "gear mesh")  # what may keep its size

Answer = Literal["what", "why", "how_sure", "what_to_do"]


Story = dict[Answer, list[str]]
"""The four answers that a page gives first, each a list of sentences."""


def lead_of(findings: Findings) -> list[str]:
    """What a test engineer asks first: what shakes most, which speed to avoid, and whether anything is failing.

    What fails, a limit or a bearing, goes first of the three, and a doubt about the speed before them. A structure that
    does not turn has its natural frequencies and limits. ``findings`` are those of ``data_schema/findings.json``. Never
    empty.
    """
    if findings.not_asked_for:
        return [*of_speeds.shaft_sentences(findings), f"Findings were {reason_text(findings.not_asked_for)}."]
    still, limits = _stands_still(findings), of_speeds.limits_sentence(findings)
    lines = of_lines.mode_sentences(findings) if still else of_lines.line_sentences(findings)
    shakes = lines[: 1 + (not still and of_lines.lies_above(findings))]
    speed, bearing = ("", "") if still else (of_speeds.speed_sentence(findings), of_lines.bearing_sentence(findings))
    fails = any(record.damage for record in findings.bearings), any(one.verdict == "above" for one in findings.limits)
    answers = [limits, bearing, *shakes, speed] if any(fails) else [*shakes, speed, limits, bearing]
    return [*of_speeds.doubt_sentences(findings), *filter(None, answers)]


def headline(findings: Findings) -> list[str]:
    """The few sentences that matter most: those of :func:`lead_of`, then the residual unbalance and the energy.

    Also on lines below the lowest order that is resolved; ``findings`` are those of ``data_schema/findings.json``.
    """
    if findings.not_asked_for:
        return lead_of(findings)
    balance = balance_sentences(findings, brief=True)[:1]
    turns = [] if _stands_still(findings) else [*of_lines.slow_sentences(findings), *balance]
    return [*lead_of(findings), *turns, *filter(None, [energy_sentence(findings)])]


def story_of(findings: Findings) -> Story:
    """What shakes, why, how sure and what to do, from ``findings``.

    Where findings were not asked for, it says only how the shaft turned and what the data are worth.
    """
    quality, repeat = _quality_sentences(findings), _repeat_sentences(findings)
    if findings.not_asked_for:
        return {"what": of_speeds.shaft_sentences(findings), "why": [], "how_sure": quality, "what_to_do": repeat}
    levels = [*of_speeds.level_sentences(findings), *of_speeds.limit_sentences(findings)]
    shares = [*filter(None, [energy_sentence(findings)]), *of_speeds.share_sentences(findings)]
    modes, tones = of_lines.mode_sentences(findings), of_lines.tone_sentences(findings)
    if _stands_still(findings):
        sure = [INTERVALS, *shares, *quality]
        return {"what": modes + levels, "why": tones, "how_sure": sure, "what_to_do": repeat or [STILL_CLEAR]}
    return {
        "what": of_lines.line_sentences(findings) + levels,
        "why": [
            *law_sentences(findings), *of_speeds.swing_sentences(findings), *modes, *tones,
            *of_lines.motor_sentences(findings), *of_lines.bearing_sentences(findings),
            *balance_sentences(findings),
        ],
        "how_sure": [INTERVALS, *of_speeds.doubt_sentences(findings), *shares, *lock_sentences(findings), *quality],
        "what_to_do": _what_to_do(findings),
    }  # fmt: skip


def _stands_still(findings: Findings) -> bool:
    """Whether nothing turned, as far as ``findings`` tell: no speed, no order, but natural frequencies."""
    return bool(findings.modes) and not findings.orders and not any(map(is_number, findings.speed_range_rpm))


def energy_sentence(findings: Findings) -> str:
    """Sentence on the share of the energy of ``findings`` that nothing explains; empty where it is not known."""
    fraction, energy = findings.unexplained_energy_fraction, findings.energy
    whole = energy is not None and bool(energy.channels)
    # what orders explain is as good as the speed; without a line there is no energy of lines
    if not is_number(fraction) or findings.speed_doubt or not (whole or findings.lines or findings.orders):
        return ""
    what = "the energy that is not broadband" if whole else "the energy of the lines that were found"
    judged = not whole or energy is None or energy.cells_judged is not False
    but = "" if judged else " What lies between the lines could not be judged."
    if fraction != 0:
        return f"{percent_text(fraction)} of {what} has no known cause.{but}"
    if whole and not has_lines(findings):
        return f"In the band that was looked at no order and no tone holds energy that would need a cause.{but}"
    if _has_unexplained(findings) or any((level.share_above or 0.0) > _MUCH_UNKNOWN for level in findings.levels):
        return f"Less than 0.1 % of {what} in the band that was looked at has no known cause.{but}"
    by = "orders and tones with a known cause" if whole else "what the tables name"
    return f"All of {what} is explained by {by}: 0 % is unexplained.{but}"


def has_lines(findings: Findings) -> bool:
    """Whether ``findings`` hold an order or a tone."""
    return bool(findings.orders or fixed_tones(findings))


def _has_unexplained(findings: Findings) -> bool:
    """Whether any line of ``findings`` is called unexplained."""
    return any(record.kinds == ("unexplained",) for record in findings.lines)


def _quality_sentences(findings: Findings) -> list[str]:
    """How many recordings are bad or suspect, and what was left out for a gain that was changed."""
    sentences = []
    for severity, advice in _WEIGHTS.items():
        if count := sum(flag.severity == severity for flag in findings.quality):
            remarks = "1 quality remark is" if count == 1 else f"{count} quality remarks are"
            sentences.append(f"{remarks} {severity}: {advice}.")
    sentences = sentences or ["No recording was found faulty or suspect."]
    jumps = [flag for flag in findings.quality if flag.flag == "level_jump" and flag.left_out]
    for is_open, why in ((False, "its gain was changed"), (True, f"gains differ, and nothing tells {WHICH_IS_RIGHT}")):
        own = [jump for jump in jumps if (WHICH_IS_RIGHT in jump.detail) == is_open]
        if changed := [f"{short(jump.channel)} of {short(jump.recording)}" for jump in own]:
            more = f" and {len(changed) - _MANY} more" if len(changed) > _MANY else ""
            sentences.append(f"Left out of everything that is said: {', '.join(changed[:_MANY])}{more} ({why}).")
    return sentences


def _what_to_do(findings: Findings) -> list[str]:
    avoid = of_speeds.avoid_sentences(findings)
    if len(avoid) > _MANY:
        avoid = [*avoid[:_MANY], f"The table of speeds to avoid names all {len(avoid)} of them."]
    asks = of_lines.line_asks(findings) + _balance_asks(findings)
    fraction = findings.unexplained_energy_fraction
    if is_number(fraction) and fraction > _MUCH_UNKNOWN and _has_unexplained(findings):
        asks.append("Look for the cause of the lines that the tables call unexplained.")
    asks += _repeat_sentences(findings)
    if not avoid and not asks and of_lines.nothing_proven(findings):
        asks = [TOO_SHORT]
    elif not avoid and not asks and of_speeds.all_judged(findings):
        asks = [ALL_CLEAR_WITH_ENVELOPE if "envelope" in findings.looked_for else ALL_CLEAR]
    return [*avoid, *of_speeds.free_sentences(findings), *asks]


def _balance_asks(findings: Findings) -> list[str]:
    """To balance where an unbalanced mass makes the strongest order; for more speeds where it may for want of them."""
    if findings.speed_doubt or of_lines.lies_above(findings):
        return []
    strongest, asks = strongest_by(findings.orders, lambda record: record.channel), []
    leads = sorted(name for name, record in strongest.items() if record.kinds == ("unbalance",))
    if leads:
        channels = listed(list(map(short, leads)))
        asks.append(BALANCE if len(leads) == len(strongest) else BALANCE_IN.format(channels=channels))
    alike = [record for record in strongest.values() if record.kinds == (of_lines.LIKE_UNBALANCE,)]
    return asks + [MORE_SPEEDS] * any("few speeds" in record.doubts for record in alike)


def _repeat_sentences(findings: Findings) -> list[str]:
    return ["Repeat the recordings that are marked bad."] * any(flag.severity == "bad" for flag in findings.quality)


def law_sentences(findings: Findings) -> list[str]:
    """How the orders of ``findings`` change with speed, each judged in the channel where it is strongest."""
    square, steady, half = list[str](), list[str](), list[str]()
    met: dict[float, list[str]] = {}
    strongest = strongest_by(findings.orders, nominal_order)
    for order, record in sorted(strongest.items()):
        law, name = record.speed_law or "", order_name(record, findings)
        if order in (1.0, 2.0) and _is_square(record) and (law.startswith("grows") or not law):
            square.append(name)
        if law == "keeps its size" and record.kinds[0] in _STEADY_CAUSES:
            steady.append(name)
        if is_number(record.meets_hz) and not is_in_doubt(record.meets_hz, findings):
            met.setdefault(record.meets_hz, []).append(name)
        if "half order of the four-stroke cycle" in record.kinds:
            half.append(name)
    sentences = []
    if square:
        verb = _orders(square, "grows", "grow")
        sentences.append(f"{verb} with the square of the speed, as the force of an unbalanced mass does.")
    if steady:
        where = "where seen" if at_one_speed(findings) else "at all tested speeds"
        size = f"{_orders(steady, 'keeps its', 'keep their')} size {where}"
        sentences.append(f"{size}: not an unbalance, rather a bearing or a gear.")
    first = strongest.get(1.0)
    if first is not None and "slower than unbalance" in first.doubts and is_number(first.speed_exponent):
        exponent = estimate_text(first, "speed_exponent")
        sentences.append(f"Order 1 does not grow as unbalance does: it goes with speed to the {exponent}.")
    if met:
        shaped = [f"{frequency_text(hertz)} Hz shapes order {listed(names)}" for hertz, names in sorted(met.items())]
        more = " and others" * (len(shaped) > _SHOWN)
        sentences.append(f"Natural frequencies shape orders: {', '.join(shaped[:_SHOWN])}{more}.")
    if half:
        verb = _orders(half, "repeats", "repeat", most=_SHOWN)
        sentences.append(f"{verb} every second revolution, as a four-stroke cycle does.")
    return sentences


def _is_square(record: OrderFinding) -> bool:
    ends = interval_of(record, "speed_exponent")
    return ends is not None and ends[1] - ends[0] < _CLEAR_EXPONENT and ends[0] <= 2 <= ends[1]


def _orders(names: list[str], verb: str, plural: str, *, most: int | None = None) -> str:
    """Orders called ``names`` with the ``verb`` in the number that fits: ``"Orders 1 and 2 grow"``."""
    return f"Orders {listed(names, most=most)} {plural}" if len(names) > 1 else f"Order {names[0]} {verb}"


def lock_sentences(findings: Findings) -> list[str]:
    """Sentences on orders of ``findings`` that slip, and on undecided ones with the record length that would do."""
    slips, loose, undecided = list[str](), list[str](), list[OrderFinding]()
    for _, record in sorted(strongest_by(findings.orders, nominal_order).items()):
        hertz = hertz_of_order(record, findings)
        if record.electric or (hertz is not None and record.lock == "undecided"):
            continue  # such an undecided one speaks for another speed than the one that was stated
        if hertz is not None:
            loose.append(f"{hertz:.2f} Hz (order {estimate_text(record, 'order')})")
        elif record.lock == "slips":
            slips.append(estimate_text(record, "order"))
        elif record.lock == "undecided":
            undecided.append(record)
    sentences = []
    if slips:
        slip = _orders(slips[:_SHOWN], "is no exact multiple", "are no exact multiples")
        cause = f"what makes {'it' if len(slips) == 1 else 'them'} slips, or turns in a ratio of its own"
        sentences.append(f"{slip} of the half revolution: {cause}.")
    if loose:
        are, follow = ("is", "it follows") if len(loose) == 1 else ("are", "they follow")
        multiple = f"{listed(loose[:_SHOWN])} {are} no exact multiple of the half revolution"
        sentences.append(f"{multiple}; at one speed nothing tells whether {follow} the shaft.")
    if undecided:
        names = [order_name(record, findings) for record in undecided]
        longest = max((record.revs_to_decide or 0.0 for record in undecided), default=0.0)
        would = f"; recordings of {longest:.0f} revolutions would tell" if longest else ""
        if any("in a sweep" in record.doubts for record in undecided):
            would = "; a recording at one held speed would tell"
        are = _orders(names, "is", "are", most=_SHOWN)
        sentences.append(f"{are} not yet known to be locked to the shaft{would}.")
    return sentences


def balance_sentences(findings: Findings, *, brief: bool = False) -> list[str]:
    """Residual unbalance of ``findings`` in grams with intervals, the most telling first; or why it is not known.

    A ``brief`` reason does not say what would tell.
    """
    balance = findings.balance
    if balance is not None and findings.speed_doubt:
        return ["Residual unbalance in grams is not decided, for the speed is in doubt."]
    if balance is None:
        reason = reason_text(findings.balance_reason)
        reason = reason.partition("; ")[0].partition(". ")[0] if brief else reason
        return [f"Residual unbalance in grams is not known: {reason}."] if reason else []
    sentences = []
    but = ", if order 1 is unbalance" if balance.if_unbalance else ""
    if is_number(balance.residual_reciprocating_g):
        text = f"Unbalanced reciprocating mass: {estimate_text(balance, 'residual_reciprocating_g', unit='g')}"
        sentences.append(f"{text}{source_text(balance)}.")
    if is_number(balance.residual_rotating_gmm):
        text = f"Rotating unbalance{but}: {estimate_text(balance, 'residual_rotating_gmm', unit='g·mm')}"
        at = f" at {estimate_text(balance, 'angle_deg')}° from the crank" if is_number(balance.angle_deg) else ""
        sentences.append(f"{text}{at}.")
    stated, ways = stated_quantities(balance), {"along_g": "along", "across_g": "across"}
    sides = [f"{estimate_text(balance, key, unit='g')} {way}" for key, way in ways.items() if key in stated]
    if sides:
        sentences.append(f"Residual unbalance at the crank radius{but}: {listed(sides)} the cylinder.")
    if not sentences:
        sentences.append("Residual unbalance in grams is not decided.")
    titles = [title for title, _ in undecided_quantities(balance)]
    if titles:
        rotating = {"residual_rotating_gmm", "forward_gmm"} & {*(balance.not_decided or ())}
        what = "how much of it turns with the crank" if rotating else titles[0][0].lower() + titles[0][1:]
        sentences.append(f"Not decided: {what}. The table Balance says why and what would tell.")
    return sentences


def stated_quantities(balance: Balance) -> dict[str, tuple[str, str]]:
    """Title and unit of each number of ``balance`` to state: one mass once, as all of its orders give it together."""
    one_mass = is_number(balance.residual_reciprocating_g) and not is_number(balance.across_g)
    again = OF_ONE_ORDER if one_mass else ()
    return {key: words for key, words in QUANTITIES.items() if is_number(getattr(balance, key)) and key not in again}


def source_text(balance: Balance) -> str:
    """Where the numbers of ``balance`` come from: ``", from engine orders 1 and 2"``; empty where not stated."""
    source, orders = short(balance.source), balance.orders_used
    which = f" {listed(order_texts(orders))}" if orders and source.endswith("orders") else ""
    return f", from {source}{which}" if source else ""


def undecided_quantities(balance: Balance) -> list[tuple[str, str]]:
    """Title and reason of every number of ``balance`` that is not decided."""
    reasons = balance.not_decided or {}
    titles = {key: QUANTITIES[key][0] if key in QUANTITIES else key.replace("_", " ") for key in reasons}
    return [(reason_text(titles[key]), reason_text(reason)) for key, reason in reasons.items()]
