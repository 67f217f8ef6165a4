"""What a comparison says, and its page: what changed, why, how sure, what to do; tables with intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from crankorder.channel_units import unit_text
from crankorder.comparison import (
    FIRING,
    PROGRAM,
    REPEATS,
    Cause,
    Comparison,
    ModeShift,
    OrderChangeRecord,
    Trend,
    UnbalanceRecord,
)
from crankorder.identify.compared import NUMBERS as MODE_SHIFTS
from crankorder.identify.mass_change import NUMBERS as MASS_CHANGE
from crankorder.identify.order_changes import TREND_NUMBERS as TREND
from crankorder.plot.reading import (
    at_speed,
    estimate_text,
    frequency_text,
    is_number,
    listed,
    named,
    number_text,
    order_text,
    short,
    with_interval,
)
from crankorder.records import known
from crankorder.report.sentences.story import INTERVALS, Answer, Story
from crankorder.report.tables import Table, table_of
from crankorder.settings import ReportSettings

_MAKER = 120
_MANY = 6
_FEW = 3
_QUANTITY = {
    "residual_reciprocating_g": ("reciprocating mass", "g"),
    "residual_second_order_g": ("second-order mass", "g"),
    "residual_rotating_gmm": ("rotating unbalance", "g·mm"),
    "forward_gmm": ("forward-turning unbalance", "g·mm"),
    "reverse_gmm": ("reverse-turning unbalance", "g·mm"),
    "along_g": ("unbalance along the cylinder", "g"),
    "across_g": ("unbalance across it", "g"),
}


def with_sentences(comparison: Comparison) -> Comparison:
    """The ``comparison`` with its headline and the verdict on each line over the runs."""
    trends = tuple(replace(trend, verdict=trend_verdict(trend)) for trend in comparison.trend)
    return replace(comparison, headline=tuple(_headline(comparison)), trend=trends)


def trend_verdict(trend: Trend) -> str:
    """What a ``trend`` means: that the line grows, shrinks, or that nothing is decided; of bearings with the reason."""
    growth, (low, high) = trend.growth_per_run, trend.growth_per_run_ci95
    interval = f"{low:+.1%} to {high:+.1%} a run with 95 % certainty, {len(trend.amplitude)} runs"
    if low > 0:
        failing = low >= TREND.least_growth_share
        verdict = f"grows by {growth:.1%} a run ({interval})"
        meaning = "the bearing is failing" if failing else "too little to tell a damage from load or temperature"
    elif high < 0:
        verdict, meaning = f"shrinks by {-growth:.1%} a run ({interval})", "no sign of a failing bearing"
    else:
        verdict, meaning = "not decided", f"{growth:+.1%} a run ({interval}); run it again"
    return verdict if trend.kind == "order" else f"{verdict}: {meaning}"


def _headline(comparison: Comparison) -> list[str]:
    """The few sentences that matter most, the cause first."""
    sentences = _cause_sentences(comparison)
    build = "what combustion changes is no change of the build"
    fired = [confound for confound in comparison.confounds if confound.what == FIRING]
    sentences += [f"The first test was {confound.base}, the second {confound.new}: {build}." for confound in fired]
    left_out = [short(channel.name) for channel in comparison.channels if not channel.compared]
    if 0 < len(left_out) < len(comparison.channels):
        shown = left_out[:_MANY] + [f"{len(left_out) - _MANY} more"] * (len(left_out) > _MANY)
        sentences.append(f"Not compared: {listed(shown)}; the confounds say why.")
    return list(dict.fromkeys([
        *sentences, *_mass_sentences(comparison), *_growth_sentences(comparison)[:1], *_undecided_sentences(comparison),
        *_kept_sentences(comparison),
    ]))  # fmt: skip


def builds_headline(tests: Mapping[str, Comparison], alone: Sequence[str]) -> list[str]:
    """The conclusion over ``tests``, by name, of two builds: each thing that changed once, and where it was seen.

    ``alone`` are the names of tests without a partner.
    """
    seen = dict[str, list[tuple[float, str, str]]]()
    both = [(mode, name) for name, test in tests.items() for mode in test.modes if mode.only_in is None]
    last, key = 0.0, ""
    for mode, name in sorted(both, key=lambda pair: pair[0].frequency_hz):
        if mode.frequency_hz > (1.0 + MODE_SHIFTS.least_reach) * last:  # else the same as the one before
            key = f"mode {mode.frequency_hz}"
        last, (low, high) = mode.frequency_hz, known(mode.shift_hz_ci95) or (-math.inf, math.inf)
        seen.setdefault(key, []).append((high - low, name, _mode_sentence(mode) if mode.changed else ""))
    for name, test in tests.items():
        cause = test.cause.besides or test.cause.cause
        if cause not in ("natural frequencies", "nothing changed", "not comparable") and test.cause.besides != "orders":
            best = _best_unbalance(test) if cause == "unbalance" else None
            width = best.factor_ci95[1] - best.factor_ci95[0] if best else 1e3 / max(len(test.speeds), 1)
            seen.setdefault(cause, []).append((width, name, _cause_sentence(test, cause)))
    sentences, undecided = list[str](), list[str]()
    for claims in seen.values():
        (_, best_test, best_sentence), claimed = min(claims), [claim for claim in claims if claim[2]]
        names = list(dict.fromkeys(name for _, name, _ in claimed))
        every = f"all {len(tests)} tests" if len(tests) > 2 else "both tests"
        where = f"seen in {every if len(names) == len(tests) > 1 else listed(names, most=_MANY)}"
        if best_sentence:
            sentences.append(f"{best_sentence.rstrip('.')} ({where}).")
        elif claimed:
            said = min(claimed)[2].rstrip(".")
            undecided.append(
                f"Not decided: {said} ({where}), but {best_test}, which tells it best, does not show that."
            )
    whole = [name for name, test in tests.items() if test.comparable]
    if whole and not sentences:
        certain = "No change is certain" if undecided else "Nothing that was compared changed by more than chance"
        sentences.append(f"{certain} in {listed(whole, most=_MANY)}.")
    sentences += undecided
    if refused := [name for name in tests if name not in whole]:
        sentences.append(f"Not comparable: {listed(refused, most=_MANY)}.")
    if alone:
        sentences.append(f"Without a partner, and not compared: {listed(list(alone), most=_MANY)}.")
    return sentences


def comparison_story(comparison: Comparison) -> Story:
    """What changed, why, how sure and what to do, from a ``comparison``; the cause itself stands in the headline."""
    return {answer: [text for say in parts for text in say(comparison)] for answer, (_, parts) in _ANSWERS.items()}


def _best_unbalance(comparison: Comparison) -> UnbalanceRecord | None:
    """The record of order 1 whose factor is known best, of those that explain its change."""
    explaining = [record for record in comparison.unbalance if record.order == 1.0 and record.explains]
    return min(explaining, key=lambda record: record.factor_ci95[1] - record.factor_ci95[0], default=None)


def _cause_sentences(comparison: Comparison) -> list[str]:
    """What explains the changes: natural frequencies that moved first, what orders follow from them, and what else."""
    cause = comparison.cause
    if cause.cause != "natural frequencies":
        return [_cause_sentence(comparison, cause.cause)]
    followed = sorted({record.order for record in comparison.orders if record.by_modes_hz} - {*cause.orders})
    sentences = _mode_sentences(comparison)[:2]
    if followed:
        sentences.append(f"The change of {_orders_text(followed)} follows from the shift.")
    if cause.besides == "orders":
        return [*sentences, f"Not decided: whether {_orders_text(cause.orders)} changed beyond what the shift makes."]
    if cause.besides:
        besides = _cause_sentence(comparison, cause.besides)
        return [*sentences, f"Beyond that, {besides[:1].lower()}{besides[1:]}"]
    return sentences + ["No order changed beyond that."] * bool(comparison.orders)


def _undecided_sentences(comparison: Comparison) -> list[str]:
    """At which speeds lines of one frequency may hide a change of which orders."""
    hidden = dict[tuple[str, float], set[float]]()
    for record in comparison.orders:
        if record.undecided_rpm:
            hidden.setdefault((record.hidden_by or "lines close by", record.order), set()).update(record.undecided_rpm)
    by_name = dict[str, list[str]]()
    for (name, order), speeds in sorted(hidden.items()):
        places = listed([f"{rpm:.0f}" for rpm in sorted(speeds)], most=_FEW)
        by_name.setdefault(short(name), []).append(f"order {order_text(order)} at {places} rpm")
    return [f"Not decided ({name}): {listed(texts, most=_MANY)}." for name, texts in by_name.items()]


def _kept_sentences(comparison: Comparison) -> list[str]:
    """What was compared and did not change, beside something that did."""
    changed = {record.order for record in comparison.orders if record.changed}
    orders = sorted({record.order for record in comparison.orders} - changed)
    modes = [mode for mode in comparison.modes if mode.only_in is None]
    kept = [mode.frequency_hz for mode in modes if not mode.changed]
    if not changed and len(kept) == len(modes):
        return []
    shown = f"{len(orders)} orders" if len(orders) > _MANY else _orders_text(orders) if orders else ""
    others = "1 natural frequency" if len(kept) == 1 else f"{len(kept)} natural frequencies" if kept else ""
    texts = [text for text in (shown, others) if text]
    return [f"No change beyond chance: {listed(texts)}."] if texts else []


def _cause_sentence(comparison: Comparison, cause: Cause) -> str:
    """What ``cause`` explains of the changes."""
    orders = comparison.cause.orders
    best = _best_unbalance(comparison)
    if cause == "not comparable":
        return (
            "The two tests cannot be compared: they have no order in a channel and at a speed of both, and no natural "
            "frequency that both show. Run both at the same speeds, with channels of the same names and units, or "
            "analyse a band that holds a natural frequency of both."
        )
    if cause == "nothing changed":
        return _unchanged(comparison)
    if cause == "growing line":
        return _growth_sentences(comparison)[0]
    if cause == "gain":
        return _gain_sentence(comparison)
    if cause == "unbalance" and best is not None:
        became, explains = f"The unbalance {_became(best)}", "a balance weight explains it"
        if best.n_speeds == 1:
            return f"{became}. Only order 1 changed: {explains}."
        return f"{became}: {explains}, for only order 1 changed, and by one factor at all {best.n_speeds} speeds."
    if cause == "moving masses":
        return _moving_masses(comparison)
    between = f"{order_text(min(orders))} to {order_text(max(orders))}"
    if _turned(comparison):
        few = _orders_text(orders) if len(orders) <= _MANY else f"orders {between}"
        mark = ": a mark of the shaft that was moved does that" if len(orders) > 1 else ""
        return f"The phase of {few} turned, and no amplitude changed by more than chance alone would change it{mark}."
    unexplained = " A change of unbalance alone does not explain all of it." if {1.0, 2.0} & set(orders) else ""
    if len(orders) > _FEW:
        few = _orders_text(orders).partition(" ")[2] if len(orders) <= _MANY else between
        return f"{len(orders)} orders changed ({few}).{unexplained}"
    ratios = [(order_text(order), *_ratio_of(comparison, order)) for order in orders]
    parts = [f"order {order} {verb}" + (f" to {_times(record)}" if record else "") for order, verb, record in ratios]
    return f"{_capital(listed(parts))}; no other order changed.{unexplained}"


def _gain_sentence(comparison: Comparison) -> str:
    """Sentence on the channel whose orders all changed by one factor."""
    channel = next(channel for channel in comparison.channels if channel.gain)
    change = 100.0 * ((channel.gain or 1.0) - 1.0)
    low, high = (abs(100.0 * (end - 1.0)) for end in known(channel.gain_ci95) or (math.nan, math.nan))
    percent = with_interval(abs(change), sorted((low, high)), unit="%")
    more = "more" if change > 0 else "less"
    return f"{short(channel.name)} reads {percent} {more} at all orders and speeds: sensor or gain, not the machine."


def _unchanged(comparison: Comparison) -> str:
    """Sentence on what was compared without a significant change, and what was not compared."""
    of_both = any(mode.only_in is None for mode in comparison.modes)
    none = ["no order"] * bool(comparison.orders) + ["no natural frequency that both tests show"] * of_both
    unchanged = [f"{listed(none)} changed"]
    unchanged += ["no bearing line grew"] * any(trend.kind != "order" for trend in comparison.trend)
    left = listed(["orders"] * (not comparison.orders) + ["natural frequencies"] * (not of_both))
    rest = "other lines, tones and noise"
    rest = f"{left} could not be compared, nor are {rest}" if left else f"{rest} are not compared"
    return f"{_capital(listed(unchanged))} by more than chance alone would change it; {rest}."


def _turned(comparison: Comparison) -> bool:
    """Whether orders changed, all of them by their phases alone, with no unbalance that explains it."""
    own = [record for record in comparison.orders if record.order in comparison.cause.orders]
    return comparison.cause.cause == "orders" and all(record.phase_only for record in own if record.changed)


def _moving_masses(comparison: Comparison) -> str:
    """Sentence on the change of orders 1 and 2 by moving masses, in grams where the balance was closed."""
    orders = comparison.cause.orders
    verbs = {_ratio_of(comparison, order)[0] for order in orders}
    verb = verbs.pop() if len(verbs) == 1 else "changed"
    went = f"{_capital(_orders_text(orders))} {verb}, and no other"
    changed = {mass.quantity: mass for mass in comparison.balance if mass.changed}
    for quantity in ("residual_reciprocating_g", "along_g", "residual_second_order_g"):
        if mass := changed.get(quantity):
            sign, more = (1, "more") if mass.change > 0 else (-1, "less")
            mass_g = estimate_text(mass, "change", unit="g", factor=sign)
            return f"{went}: {mass_g} {more} unbalanced mass along the cylinder explains it."
    return f"{went}: a change of the moving masses explains it."


def _ratio_of(comparison: Comparison, order: float) -> tuple[str, OrderChangeRecord | None]:
    """Verb for the change of an order, and its record with the narrowest interval among significant ones."""
    clear = [
        (ends[1] - ends[0], record)
        for record in comparison.orders
        if record.changed and record.order == order and _is_alike(record)
        and (ends := known(record.ratio_db_ci95)) and not ends[0] <= 0 <= ends[1]
    ]  # fmt: skip
    verbs = {_verb(record) for _, record in clear}
    return (verbs.pop(), min(clear, key=lambda pair: pair[0])[1]) if len(verbs) == 1 else ("changed", None)


def _is_alike(record: OrderChangeRecord) -> bool:
    """Whether one factor holds at all speeds."""
    return record.alike_p is None or record.alike_p >= MASS_CHANGE.fit_chance


def _verb(record: OrderChangeRecord) -> str:
    return "rose" if (record.ratio or 0.0) > 1 else "fell"


def _orders_text(orders: Sequence[float]) -> str:
    """``"order 1"`` or ``"orders 1 and 2"``."""
    return f"order{'s' * (len(orders) > 1)} {listed([order_text(order) for order in orders])}"


def _became(unbalance: UnbalanceRecord) -> str:
    (low, high), ends = unbalance.factor_ci95, known(unbalance.turned_deg_ci95)
    verb = "fell to" if high < 1 else "rose to" if low > 1 else "kept its size but turned:"
    turned = f", turned by {estimate_text(unbalance, 'turned_deg')}°" if ends and not ends[0] <= 0 <= ends[1] else ""
    return f"{verb} {estimate_text(unbalance, 'factor')} times what it was{turned}"


def _order_sentences(comparison: Comparison) -> list[str]:
    """One sentence per order that changed, in the channel where its change is clearest."""
    best = dict[float, OrderChangeRecord]()
    for record in sorted(comparison.orders, key=lambda record: record.p_value):
        if record.changed:
            best.setdefault(record.order, record)
    more = [f"{len(best) - _MANY} more orders changed: see the table."] * (len(best) > _MANY)
    return [_order_sentence(record) for record in best.values()][:_MANY] + more


def _order_sentence(record: OrderChangeRecord) -> str:
    unit, maker = unit_text(record.unit), record.explained_by or "unexplained"
    by = "" if maker == "unexplained" else f" ({named(maker, limit=_MAKER)})"
    name = f"Order {order_text(record.order)}{by} in {short(record.channel)}"
    from_to = f"from {number_text(record.base_amplitude)} to {number_text(record.new_amplitude)} {unit}".rstrip()
    from_to += at_speed(record.speed_rpm)
    if record.phase_only:
        return f"{name} turned its phase; its amplitude went {from_to}."
    ends = known(record.ratio_ci95)
    if record.by_modes_hz:
        shifted = listed([frequency_text(hertz) for hertz in record.by_modes_hz])
        return f"{name} changed {from_to}, which the shift of {shifted} Hz explains."
    if record.ratio is None or not _is_alike(record) or (ends and ends[0] <= 1 <= ends[1]):
        return f"{name} changed {from_to}: by {estimate_text(record, 'difference', unit=unit)}."
    return f"{name} {_verb(record)} to {_times(record)} (mean of the speeds; {from_to})."


def _times(record: OrderChangeRecord) -> str:
    return f"{estimate_text(record, 'ratio')} times its amplitude"


def _mode_sentences(comparison: Comparison) -> list[str]:
    changed = [mode for mode in comparison.modes if mode.changed]
    sentences = [_mode_sentence(mode) for mode in changed[:_MANY]]
    return sentences + ([f"{len(changed) - _MANY} more natural frequencies changed."] if len(changed) > _MANY else [])


def _mode_sentence(mode: ModeShift) -> str:
    place = f"{frequency_text(mode.frequency_hz)} Hz natural frequency"
    if not mode.moved:
        return f"The damping ratio of the {place} changed by {estimate_text(mode, 'damping_change')}."
    value, _, ends = estimate_text(mode, "shift_hz", factor=100.0 / mode.frequency_hz).partition(" ")
    sign = "+" if (mode.shift_hz or 0.0) > 0 else ""
    new = number_text(mode.new_frequency_hz, digits=4)
    return f"The {place} moved to {new} Hz ({sign}{value} % {ends}): stiffness or mass changed."


def alike(trends: Sequence[Trend]) -> list[list[Trend]]:
    """The ``trends`` in groups of one order and channel, which only their names tell apart."""
    groups = dict[tuple[str, str, float], list[Trend]]()
    for trend in trends:
        groups.setdefault((trend.kind, trend.channel, round(trend.order, 2)), []).append(trend)
    return list(groups.values())


def _growth_sentences(comparison: Comparison) -> list[str]:
    """One sentence per line that grows; lines at one order, that only their names tell apart, share theirs."""
    sentences = []
    for lines in alike([trend for trend in comparison.trend if trend.grows]):
        first = lines[0]
        growth = estimate_text(first, "growth_per_run", factor=100)
        rule = "" if first.kind == "order" else " A growing amplitude of a bearing line means a failing bearing."
        where = short(first.channel) if first.channel else "the envelope"
        names = " or ".join(dict.fromkeys(short(trend.line) for trend in lines))
        sentences.append(f"{_capital(names)} in {where} grows from run to run, by {growth} % each.{rule}")
    return sentences


def _law_sentences(comparison: Comparison) -> list[str]:
    """Whether the change of order 1 grows with the square of speed."""
    best = _best_unbalance(comparison)
    if best is None or best.n_speeds < 2 or _turned(comparison):
        return []
    if (best.square_law_p or 0.0) >= 1e-3:
        law = "grows with the square of speed at one phase, as the force of a mass on a stiff path does."
    else:
        law = "does not grow with the square of speed: a resonance lies between the force and the sensor. Its ratio "
        law += "does not depend on that, for both tests went through the same path."
    return [f"The change of order 1 {law}"]


def _mass_sentences(comparison: Comparison) -> list[str]:
    """Unbalance before and after a stated change of mass, none where that tells no residual."""
    trial = comparison.trial_mass
    if trial is None:
        return []
    if not is_number(trial.residual_after_gmm):
        before, after = (estimate_text(trial, key, unit="g") for key in ("along_g", "along_after_g"))
        return [f"The residual along the cylinder was {before} before and is {after} now, by the stated mass."]
    # grams where all stated masses sit at one radius
    per_gmm, unit = (1.0 / trial.radius_mm, "g") if trial.radius_mm else (1.0, "g·mm")
    angles = {"residual_rotating_gmm": trial.angle_deg, "residual_after_gmm": trial.angle_after_deg}
    before, after = (
        estimate_text(trial, size, unit=unit, factor=per_gmm) + (f" at {angle:.0f}°" if is_number(angle) else "")
        for size, angle in angles.items()
    )
    return [f"The unbalance was {before} before and is {after} now, by the stated mass."]


def _balance_sentences(comparison: Comparison) -> list[str]:
    """Why a stated mass tells nothing, and how the masses of the closed balance changed."""
    untold, sentences = comparison.trial_mass_reason, list[str]()
    for mass in comparison.balance:
        # of masses that were told by a ratio the first stands for the others
        if mass.changed and not (sentences and mass.by_ratio_of_orders):
            name, unit = _QUANTITY.get(mass.quantity, (mass.quantity, ""))
            orders = mass.by_ratio_of_orders
            how = f" (by the ratio of {_orders_text(orders)} in the two tests)" if orders else ""
            sentences.append(
                f"The closed balance says: {name} changed by {estimate_text(mass, 'change', unit=unit)}, from "
                f"{number_text(mass.base)} to {number_text(mass.new)} {unit}{how}."
            )
    if comparison.cause.cause == "moving masses" and not sentences and comparison.balance_reason:
        sentences.append(f"How many grams is not known: {comparison.balance_reason}.")
    return [f"The stated change of mass tells no residual: {untold}."] * bool(untold) + sentences


def _how_sure(comparison: Comparison) -> list[str]:
    q = number_text(100 * comparison.false_discovery_rate, digits=2)
    claims = f"Of all changes that are claimed at most {q} % are chance, on average"
    weights, doubts = {"invalid": "not compared", "weakens": "weakens the comparison"}, []
    for confound in comparison.confounds:  # the worst first
        if weight := weights.get(confound.severity):
            what = f"{_capital(confound.what)} {short(confound.channel)}".strip()
            values = f"{short(confound.base)} / {short(confound.new)}"
            doubts.append(f"{what} ({values}): {weight}. {_capital(confound.words)}.")
    sure = f"{INTERVALS} {claims}; where nothing changed, so often anything is claimed at all."
    return [sure, *_undecided_sentences(comparison), *doubts[: _MANY + 1]]


def _capital(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"


def _what_to_do(comparison: Comparison) -> list[str]:
    orders, differing = comparison.cause.orders, {confound.what for confound in comparison.confounds}
    fails = any(trend.grows and trend.kind != "order" for trend in comparison.trend)
    advice = {
        "Repeat one of the tests without a change: what differs then is the set-up, not the build.":
            REPEATS in differing and orders and len(comparison.runs) < 3,
        "Analyse both again with one version of the program.": PROGRAM in differing,
        "If the mark was moved, state its angle (index_to_tdc_deg) in the manifests: amplitudes alone are compared.":
            _turned(comparison) and len(orders) > 1,
        "Replace the bearing whose line grows, or watch it in shorter intervals.": fails,
    }  # fmt: skip
    return [text for text, holds in advice.items() if holds]


_ANSWERS: dict[Answer, tuple[str, tuple[Callable[[Comparison], list[str]], ...]]] = {
    "what": ("What changed", (_mode_sentences, _order_sentences, _growth_sentences, _kept_sentences)),
    "why": ("Why", (_cause_sentences, _law_sentences, _mass_sentences, _balance_sentences)),
    "how_sure": ("How sure", (_how_sure,)),
    "what_to_do": ("What to do", (_what_to_do,)),
}
"""Title of each answer of the page, and what is said there."""

_MARKED = frozenset({"yes", "invalid", "weakens"})
_TABLES = ("orders", "modes", "unbalance", "masses", "balance", "trend", "confounds")  # as they stand on the page


def comparison_page(comparison: Comparison, *, pictures: list[tuple[str, str]], settings: ReportSettings) -> str:
    """HTML page of a ``comparison`` with its sentences, with no script and no network; all text is escaped.

    ``pictures`` are pairs of a file name (beside the page) and a caption; ``settings`` are those of the report.
    """
    from crankorder.report.page import rendered_page  # loads jinja, which the numbers do not need

    limit = settings.max_name_characters
    story, lead = comparison_story(comparison), comparison.headline[0]
    shorten = partial(named, limit=limit)
    tables = _tables_of_orders(comparison, shorten) | _other_tables(comparison, shorten)
    return rendered_page(
        "comparison.html",
        base=named(comparison.base, limit=limit),
        new=named(comparison.new, limit=limit),
        lead=lead,
        story=[(_ANSWERS[key][0], [text for text in texts if text != lead]) for key, texts in story.items()],
        pictures=[(f"./{file}", named(caption, limit=4 * limit)) for file, caption in pictures],
        tables=[(name, tables[name]) for name in _TABLES if tables[name].rows or tables[name].empty],
        marked=_MARKED,
    )


Shorten = Callable[[str], str]


_YES = {True: "yes", False: "no"}
_chance = partial(number_text, digits=2)


def _tables_of_orders(comparison: Comparison, short: Shorten) -> dict[str, Table]:
    """Tables by name of what became of orders and of the unbalance that they show."""
    unbalance, trial = comparison.unbalance, comparison.trial_mass
    at = f"{unbalance[0].reference_rpm if unbalance else 0.0:.0f} rpm"
    return {
        "orders": table_of(
            "Orders", "Channel|Order#|Made by|Changed|Ratio#|Ratio, dB#|Speed of the clearest change, rpm#|First#|"
            "Second#|Difference#|Unit|Speeds changed#|p#",
            [[short(r.channel), order_text(r.order), short(r.explained_by or "–"), _YES[r.changed],
              estimate_text(r, "ratio"), estimate_text(r, "ratio_db"), number_text(r.speed_rpm, digits=4),
              number_text(r.base_amplitude), number_text(r.new_amplitude), estimate_text(r, "difference"),
              unit_text(r.unit), f"{r.n_changed} of {r.n_speeds}", _chance(r.p_value)]
             for r in sorted(comparison.orders, key=lambda record: (not record.changed, record.channel, record.order))],
            empty="No order could be compared.",
            note="Ratio: second test over first, mean of the speeds at which both show the order clearly. p: chance of "
            "so large a change where nothing changed.",
        ),
        "unbalance": table_of(
            "Change of unbalance", "Channel|Order#|Explains the change|After over before#|Turned by, °#|Chance of a "
            f"worse fit: one factor#|Change at {at}, as speed²#|Unit|Chance of a worse fit: speed²#",
            [[short(r.channel), order_text(r.order), _YES[r.explains], estimate_text(r, "factor"),
              estimate_text(r, "turned_deg"), _chance(r.one_factor_p), estimate_text(r, "square_law_amplitude"),
              unit_text(r.unit), _chance(r.square_law_p)] for r in unbalance],
            note="One factor at all speeds: the same path led from another unbalance to the sensor. A change that "
            "grows as speed² besides: that path is stiff.",
        ),
        "masses": table_of(
            "Influence of the added mass", "Channel|Speed, rpm#|Response#|Phase, °#",
            [[short(of.channel), number_text(of.speed_rpm, digits=4), number_text(of.response_per_unit),
              number_text(of.phase_deg)] for of in (trial.influence if trial else ())],
            note="Response to one g (on a piston) or g·mm (on the crank) of the mass that the manifests state.",
        ),
        "balance": table_of(
            "Balance closed with the engine model", "Quantity|Changed|First#|Second#|Change#",
            [[mass.quantity.replace("_", " "), _YES[mass.changed], number_text(mass.base), number_text(mass.new),
              estimate_text(mass, "change")] for mass in comparison.balance],
        ),
    }  # fmt: skip


def _other_tables(comparison: Comparison, short: Shorten) -> dict[str, Table]:
    """Tables by name of natural frequencies, of lines over the runs and of what else differs."""
    return {
        "modes": table_of(
            "Natural frequencies", "Natural frequency, Hz#|Changed|Shift, Hz#|Change of damping ratio#|p#",
            [[frequency_text(mode.frequency_hz), _YES[mode.changed] if mode.only_in is None else
              "seen in one test only", estimate_text(mode, "shift_hz"), estimate_text(mode, "damping_change"),
              _chance(mode.p_value)] for mode in comparison.modes],
            empty="None could be compared.", note="That only one test shows a natural frequency is no claim: the other "
            "may have hidden it." if comparison.modes else "",
        ),
        "trend": table_of(
            "Trend over the runs", "Line|Kind|Channel|Changed|Growth per run, %#|Amplitude by run#|p#|Verdict",
            [[short(t.line), t.kind, short(t.channel), _YES[t.changed], estimate_text(t, "growth_per_run", factor=100),
              ", ".join(map(number_text, t.amplitude)), _chance(t.p_value), t.verdict]
             for t in sorted(comparison.trend, key=lambda trend: (not trend.changed, trend.kind, trend.line))],
            note=f"Runs: {', '.join(comparison.runs)}.",
        ),
        "confounds": table_of(
            "What else differs (confounds)", "Weight|What differs|First|Second|What it does",
            [[c.severity, f"{c.what} {short(c.channel)}".strip(), short(c.base), short(c.new), c.words]
             for c in comparison.confounds], empty="Both tests were made and analysed alike.",
        ),
    }  # fmt: skip
