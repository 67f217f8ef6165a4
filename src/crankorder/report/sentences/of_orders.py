"""What is said of the orders of a test: how they grow with speed, what shapes them, whether they are locked."""

from __future__ import annotations

from crankorder.findings import Findings, OrderFinding
from crankorder.plot.fixed_lines import hertz_of_order
from crankorder.report.notation import (
    at_one_speed,
    estimate_text,
    frequency_text,
    interval_of,
    is_in_doubt,
    is_number,
    listed,
    nominal_order,
    order_name,
    strongest_by,
)

_CLEAR_EXPONENT = 1.5  # an interval of the speed exponent wider than this tells nothing
_SHOWN = 8  # orders that a sentence names
_STEADY_CAUSES = ("unexplained", "bearing", "gear mesh")  # what may keep its size


def law_sentences(findings: Findings) -> list[str]:
    """How the orders of ``findings`` change with speed, each judged in the channel where it is strongest."""
    strongest = strongest_by(findings.orders, nominal_order)
    square: list[str] = []
    steady: list[str] = []
    met: dict[float, list[str]] = {}
    for order, record in sorted(strongest.items()):
        law, name = str(record.speed_law or ""), order_name(record, findings)
        if order in (1.0, 2.0) and _is_square(record) and (law.startswith("grows") or not law):
            square.append(name)
        if law == "keeps its size" and record.kinds[0] in _STEADY_CAUSES:
            steady.append(name)
        if is_number(record.meets_hz) and not is_in_doubt(record.meets_hz, findings):
            met.setdefault(record.meets_hz, []).append(name)
    sentences = []
    if square:
        verb = "grow" if len(square) > 1 else "grows"
        sentences.append(
            f"{_orders(square)} {verb} with the square of the speed, as the force of an unbalanced mass does."
        )
    if steady:
        verb = "keep their" if len(steady) > 1 else "keeps its"
        where = "where seen" if at_one_speed(findings) else "at all tested speeds"
        sentences.append(f"{_orders(steady)} {verb} size {where}: not an unbalance, rather a bearing or a gear.")
    sentences += _unlike_unbalance(strongest)
    if met:
        said = [f"{frequency_text(mode_hz)} Hz shapes order {listed(names)}" for mode_hz, names in sorted(met.items())]
        more = " and others" if len(said) > _SHOWN else ""
        sentences.append(f"Natural frequencies shape orders: {', '.join(said[:_SHOWN])}{more}.")
    return [*sentences, *_half_orders(strongest, findings)]


def _unlike_unbalance(strongest: dict[float, OrderFinding]) -> list[str]:
    """That order 1 surely grows more slowly than an unbalance, by the exponent of its record."""
    record = strongest.get(1.0)
    if record is None or "slower than unbalance" not in record.doubts or not is_number(record.speed_exponent):
        return []
    exponent = estimate_text(record, "speed_exponent")
    return [f"Order 1 does not grow as unbalance does: it goes with speed to the {exponent}."]


def _is_square(record: OrderFinding) -> bool:
    ends = interval_of(record, "speed_exponent")
    return ends is not None and ends[1] - ends[0] < _CLEAR_EXPONENT and ends[0] <= 2 <= ends[1]


def _half_orders(strongest: dict[float, OrderFinding], findings: Findings) -> list[str]:
    """Half orders that the findings explain by the engine's cycle: other sources may lie on them too."""
    names = [
        order_name(record, findings)
        for _, record in sorted(strongest.items())
        if "half order of the four-stroke cycle" in record.kinds
    ]
    if not names:
        return []
    more = " and more" if len(names) > _SHOWN else ""
    verb = "repeat" if len(names) > 1 else "repeats"
    return [f"{_orders(names[:_SHOWN])}{more} {verb} every second revolution, as a four-stroke cycle does."]


def _orders(names: list[str]) -> str:
    return f"Order{'s' if len(names) > 1 else ''} {listed(names)}"


def lock_sentences(findings: Findings) -> list[str]:
    """Orders of ``findings`` that slip, and those of which it cannot be told, with the record length that would do."""
    slips, open_, longest, swept = [], [], 0.0, False
    loose = []
    for _, record in sorted(strongest_by(findings.orders, nominal_order).items()):
        name, hertz = order_name(record, findings), hertz_of_order(record, findings)
        if record.electric:
            continue
        if hertz is not None and record.lock == "undecided":
            continue  # it speaks for another speed than the one that was stated
        if hertz is not None:
            loose.append(f"{hertz:.2f} Hz (order {estimate_text(record, 'order')})")
        elif record.lock == "slips":
            slips.append(f"{estimate_text(record, 'order')}")
        elif record.lock == "undecided":
            open_.append(name)
            needed = record.revs_to_decide
            longest = max(longest, float(needed)) if is_number(needed) else longest
            swept = swept or "in a sweep" in record.doubts
    sentences = []
    if slips:
        several = len(slips) > 1
        are, them = ("are no exact multiples", "them") if several else ("is no exact multiple", "it")
        why = f"what makes {them} slips, or turns in a ratio of its own"
        sentences.append(f"{_orders(slips[:_SHOWN])} {are} of the half revolution: {why}.")
    if loose:
        are, it = ("are", "they follow") if len(loose) > 1 else ("is", "it follows")
        sentences.append(
            f"{listed(loose[:_SHOWN])} {are} no exact multiple of the half revolution; at one speed nothing tells "
            f"whether {it} the shaft."
        )
    if open_:
        which = "they are" if len(open_) > 1 else "it is"
        more = " and more" if len(open_) > _SHOWN else ""
        text = f"{_orders(open_[:_SHOWN])}{more}: whether {which} locked to the shaft cannot be told yet"
        would = f"; recordings of {longest:.0f} revolutions would tell" if longest else ""
        sentences.append(f"{text}; a recording at one held speed would tell." if swept else f"{text}{would}.")
    return sentences
