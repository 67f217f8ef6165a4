"""What is said of the residual unbalance: grams with their interval, what is not decided, or why there are none."""

from __future__ import annotations

from crankorder.findings import Balance, Findings
from crankorder.report.notation import NAME_CHARACTERS, estimate_text, is_number, listed, named, order_texts

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

_LETTERS = 4 * NAME_CHARACTERS


def balance_sentences(findings: Findings) -> list[str]:
    """Residual unbalance of ``findings`` in grams with intervals, the most telling first; or why it is not known."""
    balance = findings.balance
    if balance is None:
        reason = named(findings.balance_reason or "", limit=_LETTERS).rstrip(".")
        return [f"Residual unbalance in grams is not known: {reason}."] if reason else []
    sentences = []
    but = ", if order 1 is unbalance" if balance.if_unbalance else ""
    if is_number(balance.residual_reciprocating_g):
        text = f"Unbalanced reciprocating mass: {estimate_text(balance, 'residual_reciprocating_g', unit='g')}"
        sentences.append(f"{text}{source_text(balance)}.")
    if is_number(balance.residual_rotating_gmm):
        text = f"Rotating unbalance{but}: {estimate_text(balance, 'residual_rotating_gmm', unit='g·mm')}"
        if is_number(balance.angle_deg):
            text += f" at {estimate_text(balance, 'angle_deg')}° from the crank"
        sentences.append(f"{text}.")
    told, ways = told_quantities(balance), {"along_g": "along", "across_g": "across"}
    sides = [f"{estimate_text(balance, key, unit='g')} {way}" for key, way in ways.items() if key in told]
    if sides:
        sentences.append(f"Residual unbalance at the crank radius{but}: {listed(sides)} the cylinder.")
    if not sentences:
        sentences.append("Residual unbalance in grams is not decided.")
    return [*sentences, *_open(balance)]


def told_quantities(balance: Balance) -> dict[str, tuple[str, str]]:
    """Title and unit of each number of ``balance`` to tell: one mass once, as all of its orders tell it together."""
    one_mass = is_number(balance.residual_reciprocating_g) and not is_number(balance.across_g)
    again = OF_ONE_ORDER if one_mass else ()
    return {key: words for key, words in QUANTITIES.items() if is_number(getattr(balance, key)) and key not in again}


def source_text(balance: Balance) -> str:
    """Where the numbers of ``balance`` come from: ``", from engine orders 1 and 2"``; empty where not stated."""
    source = named(balance.source, limit=NAME_CHARACTERS)
    orders = [float(order) for order in balance.orders_used]
    which = f" {listed(order_texts(orders))}" if orders and source.endswith("orders") else ""
    return f", from {source}{which}" if source else ""


def undecided_quantities(balance: Balance) -> list[tuple[str, str]]:
    """Title and reason of every number of ``balance`` that is not decided."""
    reasons = balance.not_decided or {}
    titles = {key: QUANTITIES[key][0] if key in QUANTITIES else str(key).replace("_", " ") for key in reasons}
    return [(named(titles[key], limit=_LETTERS), named(reason, limit=_LETTERS)) for key, reason in reasons.items()]


def _open(balance: Balance) -> list[str]:
    """That parts are not decided; the table of balance says which and why."""
    titles = [title for title, _ in undecided_quantities(balance)]
    if not titles:
        return []
    rotating = any(key in (balance.not_decided or {}) for key in ("residual_rotating_gmm", "forward_gmm"))
    what = "how much of it turns with the crank" if rotating else titles[0][0].lower() + titles[0][1:]
    return [f"Not decided: {what}. The table Balance says why and what would tell."]
