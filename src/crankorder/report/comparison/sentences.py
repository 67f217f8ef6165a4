"""What a comparison says, in plain sentences made from its document: what changed, why, how sure, what to do."""

from __future__ import annotations

from typing import Any

from crankorder.channel_units import unit_text
from crankorder.report.notation import frequency_text, is_number, listed, named, number_text, order_text, with_interval
from crankorder.report.sentences.story import Story

_NAME = 60
_MAKER = 120
_MANY = 6
_FEW = 3
_BEFORE_AFTER = (("residual_rotating_gmm", "angle_deg"), ("residual_after_gmm", "angle_after_deg"))
_QUANTITY = {
    "residual_reciprocating_g": ("reciprocating mass", "g"),
    "residual_second_order_g": ("second-order mass", "g"),
    "residual_rotating_gmm": ("rotating unbalance", "g·mm"),
    "forward_gmm": ("forward-turning unbalance", "g·mm"),
    "reverse_gmm": ("reverse-turning unbalance", "g·mm"),
    "along_g": ("unbalance along the cylinder", "g"),
    "across_g": ("unbalance across it", "g"),
}


def comparison_headline(document: dict[str, Any]) -> list[str]:
    """The few sentences that matter most, the cause first, from a ``document`` of ``data_schema/comparison.json``."""
    cause = document["cause"]["cause"]
    said = _cause_sentences(document)[:1]
    if cause == "natural frequencies":
        said += _mode_sentences(document)[:2]
    said += [*_fired(document), *_left_out(document)]
    return list(dict.fromkeys([*said, *mass_sentences(document)[:1], *_grown(document)[:1]]))


def _left_out(document: dict[str, Any]) -> list[str]:
    """Channels that were not compared, where others were."""
    names = [named(one["name"], limit=_NAME) for one in document["channels"] if not one["compared"]]
    if not names or len(names) == len(document["channels"]):
        return []
    shown = [*names[:_MANY], f"{len(names) - _MANY} more"] if len(names) > _MANY else names
    return [f"Not compared: {listed(shown)}; the confounds say why."]


def _fired(document: dict[str, Any]) -> list[str]:
    """What stands beside every claim: that one test was fired and the other motored."""
    return [
        f"The first test was {one['base']}, the second {one['new']}: what combustion changes is no change of the build."
        for one in document["confounds"]
        if one["what"] == "firing or motoring"
    ]


def comparison_story(document: dict[str, Any]) -> Story:
    """What changed, why, how sure and what to do, from ``document``; the cause itself is the headline's."""
    return Story(
        what=[*order_sentences(document), *_mode_sentences(document), *_grown(document)],
        why=[
            *_cause_sentences(document),
            *_law_sentences(document),
            *mass_sentences(document),
            *_influence(document),
            *_balance(document),
        ],
        how_sure=_how_sure(document),
        what_to_do=_what_to_do(document),
    )


def _best(records: list[dict[str, Any]], order: float) -> dict[str, Any] | None:
    """The record of ``order`` whose factor is known best."""
    mine = [one for one in records if one["order"] == order and one["explains"]]
    return min(mine, key=lambda one: float(one["factor_ci95"][1] - one["factor_ci95"][0]), default=None)


def _cause_sentences(document: dict[str, Any]) -> list[str]:
    cause, orders = document["cause"]["cause"], document["cause"]["orders"]
    names = listed([order_text(order) for order in orders])
    if cause == "not comparable":
        return [
            "The two tests cannot be compared: they have no order in a channel and at a speed of both, and no natural "
            "frequency that both show. Run both at the same speeds, with channels of the same names and units, or "
            "analyse a band that holds a natural frequency of both."
        ]
    if cause == "nothing changed":
        return [_unchanged(document)]
    if cause == "growing line":
        return _grown(document)[:1]
    if cause == "natural frequencies":
        none = "No order changed; natural" if document["orders"] else "Natural"
        return [f"{none} frequencies or their damping changed: the structure or its mounting did."]
    best = _best(document["unbalance"], 1.0)
    if cause == "unbalance" and best is not None:
        return [
            f"The unbalance {_became(best)}: a balance weight explains it, for only order 1 changed, and by one factor "
            f"at all {best['n_speeds']} speeds."
            if best["n_speeds"] > 1
            else f"The unbalance {_became(best)}. Only order 1 changed: a balance weight explains it."
        ]
    if cause == "moving masses":
        return [_masses_cause(document)]
    between = names if len(orders) <= _MANY else f"{order_text(min(orders))} to {order_text(max(orders))}"
    if _turned(document):
        mark = ": a mark of the shaft that was moved does that" if len(orders) > 1 else ""
        return [
            f"The phase of {_noun(orders)} {between} turned, and no amplitude changed by more than chance alone would "
            f"change it{mark}."
        ]
    parts = [_went(document, order) for order in orders[:_FEW]]
    told = _capital(listed(parts)) if len(orders) <= _FEW else f"{len(orders)} orders changed ({between})"
    only = "; no other order changed" if len(orders) <= _FEW else ""
    return [
        f"{told}{only}."
        + (" A change of unbalance alone does not explain all of it." if {1.0, 2.0} & set(orders) else "")
    ]


def _unchanged(document: dict[str, Any]) -> str:
    """What was compared and did not change, and what was not compared."""
    shown = any(one["only_in"] is None for one in document["modes"])
    compared = {
        ("orders", "no order"): bool(document["orders"]),
        ("natural frequencies", "no natural frequency that both tests show"): shown,
    }
    says = [f"{listed([none for (_, none), yes in compared.items() if yes])} changed"]
    says += ["no bearing line grew"] if any(one["kind"] != "order" for one in document["trend"]) else []
    left = listed([many for (many, _), yes in compared.items() if not yes])
    rest = "other lines, tones and noise"
    rest = f"{left} could not be compared, nor are {rest}" if left else f"{rest} are not compared"
    return f"{_capital(listed(says))} by more than chance alone would change it; {rest}."


def _turned(document: dict[str, Any]) -> bool:
    """Whether orders changed, all of them by their phases alone, with no unbalance that explains it."""
    alone = [one["phase_only"] for one in document["orders"] if one["changed"]]
    return document["cause"]["cause"] == "orders" and all(alone)


def _masses_cause(document: dict[str, Any]) -> str:
    """Orders 1 and 2, how they went, and the grams that explain it where the balance was closed."""
    orders = document["cause"]["orders"]
    went = {_ratio_of(document, order)[0] for order in orders}
    verb = went.pop() if len(went) == 1 else "changed"
    told = f"{_noun(orders).capitalize()} {listed([order_text(order) for order in orders])} {verb}, and no other"
    for key in ("residual_reciprocating_g", "along_g", "residual_second_order_g"):
        for one in document["balance"]:
            if one["quantity"] == key and one["changed"]:
                size = one if one["change"] > 0 else scaled(one, "change", -1)
                more = "more" if one["change"] > 0 else "less"
                what = f"{estimate(size, 'change')} g {more} unbalanced mass along the cylinder"
                return f"{told}: {what} explains it."
    return f"{told}: a change of the moving masses explains it."


def _went(document: dict[str, Any], order: float) -> str:
    verb, best = _ratio_of(document, order)
    times = "" if best is None else f" to {estimate(best, 'ratio')} times its amplitude"
    return f"order {order_text(order)} {verb}{times}"


def _ratio_of(document: dict[str, Any], order: float) -> tuple[str, dict[str, Any] | None]:
    """How an order went, and the record of the channel where its ratio is known best, of those that claim it."""
    mine = [one for one in document["orders"] if one["changed"] and one["order"] == order and is_number(one["ratio"])]
    known = [one for one in mine if None not in one["ratio_ci95"]]
    clear = [one for one in known if not one["ratio_ci95"][0] <= 1 <= one["ratio_ci95"][1]]
    if not clear or len({one["ratio"] > 1 for one in clear}) > 1:
        return "changed", None
    best = min(clear, key=lambda one: float(one["ratio_db_ci95"][1] - one["ratio_db_ci95"][0]))
    return ("rose" if best["ratio"] > 1 else "fell"), best


def _noun(orders: list[float]) -> str:
    return "orders" if len(orders) > 1 else "order"


def _became(record: dict[str, Any]) -> str:
    low, high = record["factor_ci95"]
    text = estimate(record, "factor")
    verb = "fell to" if high < 1 else "rose to" if low > 1 else "kept its size but turned:"
    turned = ""
    if is_number(record.get("turned_deg")) and not (record["turned_deg_ci95"][0] <= 0 <= record["turned_deg_ci95"][1]):
        turned = f", turned by {estimate(record, 'turned_deg')}°"
    return f"{verb} {text} of what it was{turned}"


def order_sentences(document: dict[str, Any]) -> list[str]:
    """One sentence per order that changed, in the channel where its change is clearest, from ``document``."""
    orders = [one for one in document["orders"] if one["changed"]]
    best: dict[float, dict[str, Any]] = {}
    for one in orders:
        if one["order"] not in best or one["p_value"] < best[one["order"]]["p_value"]:
            best[one["order"]] = one
    said = [_order_sentence(one) for one in sorted(best.values(), key=lambda one: float(one["p_value"]))]
    more = [f"{len(said) - _MANY} more orders changed: see the table."] if len(said) > _MANY else []
    return [*said[:_MANY], *more]


def _order_sentence(one: dict[str, Any]) -> str:
    where = f"in {named(one['channel'], limit=_NAME)}"
    unit = unit_text(one["unit"])
    made_by = one.get("explained_by") or "unexplained"
    name = f"Order {order_text(one['order'])}"
    if made_by != "unexplained":
        name += f" ({named(made_by, limit=_MAKER)})"
    from_to = f"from {number_text(one['base_amplitude'])} to {number_text(one['new_amplitude'])} {unit}".rstrip()
    low, high = one["ratio_ci95"]
    if one["phase_only"]:
        return f"{name} {where} turned its phase; its amplitude went {from_to} at {one['speed_rpm'] or 0:.0f} rpm."
    if not is_number(one["ratio"]) or (low is not None and low <= 1 <= high):
        difference = estimate(one, "difference", unit=unit)
        return f"{name} {where} changed {from_to} at {one['speed_rpm'] or 0:.0f} rpm: by {difference}."
    verb = "rose" if one["ratio"] > 1 else "fell"
    return (
        f"{name} {where} {verb} to {estimate(one, 'ratio')} times its amplitude "
        f"(mean of the speeds; {from_to} at {one['speed_rpm'] or 0:.0f} rpm)."
    )


def _mode_sentences(document: dict[str, Any]) -> list[str]:
    moved = [one for one in document["modes"] if one["changed"]]
    said = [
        f"The {frequency_text(one['frequency_hz'])} Hz natural frequency moved by "
        f"{estimate(one, 'shift_hz', unit='Hz')}, "
        f"its damping ratio by {estimate(one, 'damping_change')}."
        for one in moved[:_MANY]
    ]
    return said + ([f"{len(moved) - _MANY} more natural frequencies moved."] if len(moved) > _MANY else [])


def _grown(document: dict[str, Any]) -> list[str]:
    """One sentence per line that grows; lines at one order, that only their names tell apart, share theirs."""
    alike: dict[tuple[str, str, float], list[dict[str, Any]]] = {}
    for one in document["trend"]:
        if one["changed"] and one["growth_per_run"] > 0:
            alike.setdefault((one["kind"], one["channel"], round(float(one["order"]), 2)), []).append(one)
    return [_growth_sentence(lines) for lines in alike.values()]


def _growth_sentence(lines: list[dict[str, Any]]) -> str:
    one = lines[0]
    growth = estimate(scaled(one, "growth_per_run", 100), "growth_per_run")
    rule = " A growing amplitude of a bearing line means a failing bearing." if "bearing" in one["kind"] else ""
    where = f" in {named(one['channel'], limit=_NAME)}" if one["channel"] else " in the envelope"
    names = " or ".join(dict.fromkeys(named(line["line"], limit=_NAME) for line in lines))
    return f"{_capital(names)}{where} grows from run to run, by {growth} % each.{rule}"


def _law_sentences(document: dict[str, Any]) -> list[str]:
    best = _best(document["unbalance"], 1.0)
    if best is None or best["n_speeds"] < 2 or _turned(document):
        return []
    if is_number(best["square_law_p"]) and best["square_law_p"] >= 1e-3:
        return [
            "The change of order 1 grows with the square of speed at one phase, as the force of a mass on a stiff path "
            "does."
        ]
    return [
        "The change of order 1 does not grow with the square of speed: a resonance lies between the force and the "
        "sensor. Its ratio does not depend on that, for both tests went through the same path."
    ]


def mass_sentences(document: dict[str, Any]) -> list[str]:
    """Unbalance before and after a stated change of mass, from ``document``: of all channels, else of each."""
    trial = document.get("trial_mass")
    if trial and is_number(trial.get("residual_after_gmm")):
        arm, unit = _arm(document)
        ends = [_at_angle(trial, size, angle, arm, unit) for size, angle in _BEFORE_AFTER]
        stated = f", by the stated {number_text(document['masses'][0]['added'])} {unit}" if document["masses"] else ""
        return [f"The unbalance was {ends[0]} before and is {ends[1]} now{stated}."]
    return [
        f"By the stated {number_text(one['added'])} {one['unit']} the unbalance in "
        f"{named(one['channel'], limit=_NAME)} was {estimate(one, 'before', unit=one['unit'])} before and is "
        f"{estimate(one, 'after', unit=one['unit'])} now."
        for one in document["masses"][:_MANY]
    ]


def _arm(document: dict[str, Any]) -> tuple[float, str]:
    """What divides g·mm, and the unit that this gives: grams where all stated masses sit at one radius."""
    radius = document["trial_mass"].get("radius_mm")
    return (float(radius), "g") if is_number(radius) and radius > 0 else (1.0, "g·mm")


def _at_angle(trial: dict[str, Any], size: str, angle: str, arm: float, unit: str) -> str:
    text = estimate({size: trial[size] / arm, f"{size}_ci95": [x / arm for x in trial[f"{size}_ci95"]]}, size)
    where = f" at {trial[angle]:.0f}°" if is_number(trial.get(angle)) else ""
    return f"{text} {unit}{where}"


def _influence(document: dict[str, Any]) -> list[str]:
    said = []
    for one in document["masses"][:_MANY]:
        per = one["response_per_unit"][-1]
        said.append(
            f"One {one['unit']} there makes {estimate(per, 'response')} {unit_text(one['response_unit'])} at "
            f"{per['speed_rpm']:.0f} rpm in {named(one['channel'], limit=_NAME)}."
        )
    if document.get("trial_mass_reason"):
        said.append(f"The stated change of mass tells no residual: {document['trial_mass_reason']}.")
    return said


def _balance(document: dict[str, Any]) -> list[str]:
    said: list[str] = []
    for one in document["balance"]:
        # of masses that were told by a ratio the first stands for the others
        if one["changed"] and not (said and one["by_ratio_of_orders"]):
            name, unit = _QUANTITY.get(one["quantity"], (one["quantity"], ""))
            by = listed([order_text(order) for order in one["by_ratio_of_orders"]])
            how = f" (by the ratio of {_noun(one['by_ratio_of_orders'])} {by} in the two tests)" if by else ""
            said.append(
                f"The closed balance says: {name} changed by {estimate(one, 'change', unit=unit)}, from "
                f"{number_text(one['base'])} to {number_text(one['new'])} {unit}{how}."
            )
    if document["cause"]["cause"] == "moving masses" and not said and document["balance_reason"]:
        said.append(f"How many grams is not known: {document['balance_reason']}.")
    return said


def _how_sure(document: dict[str, Any]) -> list[str]:
    q = number_text(100 * document["false_discovery_rate"], digits=2)
    said = [
        f"Numbers in brackets are 95 % intervals. Of all changes that are claimed at most {q} % are chance, on "
        "average; where nothing changed, so often anything is claimed at all."
    ]
    for severity, text in (("invalid", "not compared"), ("weakens", "weakens the comparison")):
        for one in document["confounds"]:
            if one["severity"] == severity:
                channel = f" {named(one['channel'], limit=_NAME)}" if one["channel"] else ""
                values = f"{named(one['base'], limit=_NAME)} / {named(one['new'], limit=_NAME)}"
                said.append(f"{_capital(one['what'])}{channel} ({values}): {text}. {_capital(one['words'])}.")
    return said[: _MANY + 2]


def _capital(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"


def _what_to_do(document: dict[str, Any]) -> list[str]:
    said, few = [], len(document["runs"]) < 3
    if any(one["what"] == "repeats" for one in document["confounds"]) and document["cause"]["orders"] and few:
        said.append("Repeat one of the tests without a change: what differs then is the set-up, not the build.")
    if any(one["what"] == "program" for one in document["confounds"]):
        said.append("Analyse both again with one version of the program.")
    if _turned(document) and len(document["cause"]["orders"]) > 1:
        said.append(
            "If the mark was moved, state its angle (index_to_tdc_deg) in the manifests: amplitudes alone are compared."
        )
    if any(one["changed"] and "bearing" in one["kind"] and one["growth_per_run"] > 0 for one in document["trend"]):
        said.append("Replace the bearing whose line grows, or watch it in shorter intervals.")
    return said


def scaled(record: dict[str, Any], key: str, factor: float) -> dict[str, Any]:
    """The estimate ``key`` of a ``record`` of a comparison with its interval, both times ``factor``."""
    return {key: factor * record[key], f"{key}_ci95": sorted(factor * end for end in record[f"{key}_ci95"])}


def estimate(record: dict[str, Any], key: str, *, unit: str = "") -> str:
    """Text of the estimate ``key`` of a ``record`` of a comparison with its interval, and its ``unit`` where given."""
    return with_interval(record.get(key), record.get(f"{key}_ci95"), unit=unit)
