"""What orders say of a natural frequency, in words: which ones prove it, and what doubt is left."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from crankorder.identify.found import Mode, Tone
from crankorder.identify.intervals import Z95
from crankorder.identify.modal.order_proof import OrderPole, Proof
from crankorder.identify.modal.surface_fit import Poles
from crankorder.settings import IdentifySettings

ROWS_OF_TURN = 5
"""Rows of one order near a resonance that show its phase turn."""

ROWS_OF_TWO = 3
"""Rows near a resonance that several orders must have together."""

KNOWN = 1.0 / 3.0
"""Standard error of the damping, as a share of it, beyond which a pole is but a part of the shape."""

KNOWN_ALONE = 0.1
"""The same of a pole that one order alone shows: a force that peaks fits a resonance less well."""

UNCERTAIN = 0.01
"""Standard error of the frequency, as a share of it, beyond which a pole is none for certain."""

WIDER = 2.0
"""Times its damping from which another mode is much wider."""

Array = NDArray[np.float64]


def proven_by(proof: Proof) -> str:
    """What says that a mode is there, in words; empty where no order does.

    ``proof``: the orders that show it.
    """
    if not proof.orders:
        return ""
    names = ", ".join(f"{order:g}" for order in proof.passed)
    if not names:
        return f"no order passes it; it shapes orders {', '.join(f'{order:g}' for order in proof.orders)} from afar"
    if len(proof.passed) > 1:
        return f"orders {names} peak there, each at its own speed, with the phase of a resonance"
    near = f"at {proof.most_rows} speeds around it" if proof.most_rows else "seen on its flanks"
    return f"order {names} has amplitude and phase of a resonance there, {near}"


def is_proven(proof: Proof) -> bool:
    """Whether two orders sweep through the mode, at several speeds, or each alone at one place: one is evidence.

    ``proof``: the orders that show it.
    """
    return len(proof.passed) > 1 and (proof.rows >= ROWS_OF_TWO or proof.located > 1)


def mode_of(pole: OrderPole, covariance: Array, every: Poles, *, settings: IdentifySettings) -> Mode | None:
    """Mode of a ``pole`` that only orders show, with its ``covariance`` (2, 2); None where it is a part of the shape.

    So is one of unknown damping that lies no further from another pole than it is known: both are one.
    ``every``: all poles of the test, this one among them; ``settings``: the largest damping that a mode may have.
    """
    error, zeta_error = (float(np.sqrt(max(covariance[k, k], 0.0))) for k in (0, 1))
    f, zeta, proof = pole.frequency_hz, pole.damping, pole.proof
    others = every.frequency_hz[every.frequency_hz != f]
    is_another = zeta_error > KNOWN * zeta and bool((np.abs(others - f) <= Z95 * error).any())
    if not proof.orders or zeta > settings.max_damping_ratio or is_another:
        return None
    return Mode(
        f,
        error,
        zeta,
        zeta_error,
        pole.channels,
        0.0,
        proven_by(proof),
        proof.orders,
        _doubt(pole, error, zeta_error, every),
    )


def tone_as_mode(tone: Tone, orders: tuple[float, ...], *, settings: IdentifySettings) -> tuple[Mode, Array]:
    """A ``tone`` at which ``orders`` rise as an undecided mode, with its covariance (2, 2).

    ``settings``: the least damping that a mode is reckoned with, which stands for one that nobody saw.
    """
    names = ", ".join(f"{order:g}" for order in orders)
    word = "orders" if len(orders) > 1 else "order"
    zeta = settings.least_damping_ratio
    doubt = f"tone or mode: {word} {names} {'rise' if len(orders) > 1 else 'rises'} there"
    covariance = np.diag([tone.frequency_error_hz**2, zeta**2])
    channels = tuple(tone.amplitude)
    mode = Mode(tone.frequency_hz, tone.frequency_error_hz, zeta, zeta, channels, 0.0, tone.evidence, orders, doubt)
    return mode, covariance


def _doubt(pole: OrderPole, error: float, zeta_error: float, every: Poles) -> str:
    """Why a pole that only orders show may be none."""
    f, zeta, proof = pole.frequency_hz, pole.damping, pole.proof
    low, high = proof.span_hz
    said = []
    if not proof.passed:
        said.append("no order passes it: something else beyond what was swept may look the same")
    elif len(proof.passed) == 1 and (proof.most_rows < ROWS_OF_TURN or zeta_error > KNOWN_ALONE * zeta):
        name = f"{proof.passed[0]:g}"
        said.append(f"passed by order {name} alone, at {proof.most_rows} speeds: its force may peak there")
    elif len(proof.passed) == 1 and proof.rung_by:
        before = ", ".join(f"{order:g}" for order in proof.rung_by)
        said.append(f"passed by order {proof.passed[0]:g} alone, while it would still ring from order {before}")
    elif len(proof.passed) > 1 and not is_proven(proof):
        said.append("too few speeds lie near it: a force that differs at one of them looks the same")
    if error > UNCERTAIN * f:
        said.append(f"its frequency is known to {100.0 * error / f:.1f} % only")
    if zeta_error > KNOWN * zeta:
        said.append("its damping is not determined")
    if f + 2.0 * zeta * f > high or f - 2.0 * zeta * f < low:
        said.append(f"lies at the end of what was swept, {low:.1f} to {high:.1f} Hz")
    apart = np.abs(every.frequency_hz / f - 1.0)
    within = (apart > 0.0) & (apart < every.damping)
    wider = every.frequency_hz[within & ((every.damping > WIDER * zeta) | (apart < every.damping / WIDER))]
    if len(wider):
        said.append(f"within the width of {wider[0]:.1f} Hz: what that one's model leaves may look the same")
    return "; ".join(said)
