"""The page of a comparison: what changed, why, how sure, what to do; pictures; tables with intervals."""

from __future__ import annotations

from typing import Any, Literal

from markupsafe import Markup

from crankorder.channel_units import unit_text
from crankorder.report.comparison.sentences import comparison_story, estimate, scaled
from crankorder.report.notation import frequency_text, is_number, named, number_text, order_text
from crankorder.report.page import page_policy, page_style, page_template
from crankorder.report.rows import Table, table_of
from crankorder.settings import ReportSettings

_ANSWERS: tuple[tuple[Literal["what", "why", "how_sure", "what_to_do"], str], ...] = (
    ("what", "What changed"),
    ("why", "Why"),
    ("how_sure", "How sure"),
    ("what_to_do", "What to do"),
)
_MARKED = frozenset({"yes", "invalid", "weakens"})


def comparison_page(document: dict[str, Any], *, pictures: list[tuple[str, str]], settings: ReportSettings) -> str:
    """HTML page of a comparison, with no script and no network; all text is escaped.

    ``document`` as in ``data_schema/comparison.json``; ``pictures`` pairs of file name (beside the page) and caption;
    ``settings`` of the report.
    """
    limit = settings.max_name_characters
    story, lead = comparison_story(document), document["headline"][0]
    return page_template("comparison.html").render(
        policy=page_policy(),
        style=Markup(page_style()),  # our own file, never text from data
        base=named(document["base"], limit=limit),
        new=named(document["new"], limit=limit),
        lead=lead,
        story=[(title, [one for one in story[key] if one != lead]) for key, title in _ANSWERS],
        pictures=[(f"./{file}", named(caption, limit=4 * limit)) for file, caption in pictures],
        tables=_tables(document, limit),
        marked=_MARKED,
    )


def _tables(document: dict[str, Any], limit: int) -> list[tuple[str, Table]]:
    made = [("orders", _orders(document, limit)), ("modes", _modes(document))]
    if document["unbalance"]:
        made.append(("unbalance", _unbalance(document, limit)))
    if document["masses"]:
        made.append(("masses", _masses(document, limit)))
    if document["balance"]:
        made.append(("balance", _balance(document)))
    if document["trend"]:
        made.append(("trend", _trend(document, limit)))
    return [*made, ("confounds", _confounds(document, limit))]


def _yes(record: dict[str, Any]) -> str:
    return "yes" if record["changed"] else "no"


def _chance(value: Any) -> str:
    return number_text(float(value), digits=2) if is_number(value) else "–"


def _orders(document: dict[str, Any], limit: int) -> Table:
    rows = [
        [
            named(one["channel"], limit=limit), order_text(one["order"]),
            named(one["explained_by"] or "–", limit=limit),
            _yes(one), estimate(one, "ratio"),
            estimate(one, "ratio_db"), number_text(one["speed_rpm"] or float("nan"), digits=4),
            number_text(one["base_amplitude"]), number_text(one["new_amplitude"]), estimate(one, "difference"),
            unit_text(one["unit"]), f"{one['n_changed']} of {one['n_speeds']}", _chance(one["p_value"]),
        ]
        for one in sorted(document["orders"], key=lambda one: (not one["changed"], one["channel"], one["order"]))
    ]  # fmt: skip
    return table_of(
        "Orders",
        "Channel|Order#|Made by|Changed|Ratio#|Ratio, dB#|Speed of the clearest change, rpm#|First#|Second#"
        "|Difference#|Unit|Speeds changed#|p#",
        rows,
        empty="No order could be compared.",
        note="Ratio: second test over first, mean of the speeds at which both show the order clearly. p: chance of so "
        "large a change where nothing changed.",
    )


def _modes(document: dict[str, Any]) -> Table:
    rows = [
        [
            frequency_text(one["frequency_hz"]),
            _yes(one) if one["only_in"] is None else "seen in one test only",
            estimate(one, "shift_hz"), estimate(one, "damping_change"), _chance(one["p_value"]),
        ]
        for one in document["modes"]
    ]  # fmt: skip
    note = "That only one test shows a natural frequency is no claim: the other may have hidden it."
    heads = "Natural frequency, Hz#|Changed|Shift, Hz#|Change of damping ratio#|p#"
    return table_of("Natural frequencies", heads, rows, empty="None could be compared.", note=note if rows else "")


def _unbalance(document: dict[str, Any], limit: int) -> Table:
    rows = [
        [
            named(one["channel"], limit=limit), order_text(one["order"]), "yes" if one["explains"] else "no",
            estimate(one, "factor"), estimate(one, "turned_deg"), _chance(one["one_factor_p"]),
            estimate(one, "square_law_amplitude"), unit_text(one["unit"]), _chance(one["square_law_p"]),
        ]
        for one in document["unbalance"]
    ]  # fmt: skip
    return table_of(
        "Change of unbalance",
        "Channel|Order#|Explains the change|After over before#|Turned by, °#|Chance of a worse fit: one factor#"
        f"|Change at {document['unbalance'][0]['reference_rpm']:.0f} rpm, as speed²#|Unit"
        "|Chance of a worse fit: speed²#",
        rows,
        empty="",
        note="One factor at all speeds: the same path led from another unbalance to the sensor. A change that grows as "
        "speed² besides: that path is stiff.",
    )


def _masses(document: dict[str, Any], limit: int) -> Table:
    rows = [
        [
            named(one["channel"], limit=limit), f"{number_text(one['added'])} {one['unit']}",
            estimate(one, "before", unit=one["unit"]), number_text(one["before_angle_deg"] or float("nan")),
            estimate(one, "after", unit=one["unit"]), number_text(one["after_angle_deg"] or float("nan")),
            f"{number_text(per['speed_rpm'], digits=4)}", estimate(per, "response"),
            f"{unit_text(one['response_unit'])} per {one['unit']}",
        ]
        for one in document["masses"]
        for per in one["response_per_unit"]
    ]  # fmt: skip
    return table_of(
        "Masses",
        "Channel|Put on#|Unbalance before#|at, °#|Unbalance after#|at, °#|Speed, rpm#|Response#|Unit",
        rows,
        empty="",
        note="From the mass that the manifests state. Angles from where it was put, turning with the crank.",
    )


def _balance(document: dict[str, Any]) -> Table:
    rows = [
        [
            one["quantity"].replace("_", " "), _yes(one), number_text(one["base"]), number_text(one["new"]),
            estimate(one, "change"),
        ]
        for one in document["balance"]
    ]  # fmt: skip
    return table_of("Balance closed with the engine model", "Quantity|Changed|First#|Second#|Change#", rows, empty="")


def _trend(document: dict[str, Any], limit: int) -> Table:
    rows = [
        [
            named(one["line"], limit=limit), one["kind"], named(one["channel"], limit=limit), _yes(one),
            estimate(scaled(one, "growth_per_run", 100), "growth_per_run"),
            ", ".join(number_text(value) for value in one["amplitude"]),
            _chance(one["p_value"]), named(one["verdict"], limit=4 * limit),
        ]
        for one in sorted(document["trend"], key=lambda one: (not one["changed"], one["kind"], one["line"]))
    ]  # fmt: skip
    heads = "Line|Kind|Channel|Changed|Growth per run, %#|Amplitude by run#|p#|Verdict"
    return table_of("Trend over the runs", heads, rows, empty="", note="Runs: " + ", ".join(document["runs"]) + ".")


def _confounds(document: dict[str, Any], limit: int) -> Table:
    rows = [
        [
            one["severity"], f"{one['what']} {named(one['channel'], limit=limit)}".strip(),
            named(one["base"], limit=limit), named(one["new"], limit=limit), one["words"],
        ]
        for one in document["confounds"]
    ]  # fmt: skip
    heads = "Weight|What differs|First|Second|What it does"
    empty = "Both tests were made and analysed alike."
    return table_of("What else differs (confounds)", heads, rows, empty=empty)
