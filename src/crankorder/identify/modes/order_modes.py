"""What orders say of a natural frequency: what proves it, and what doubt is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crankorder.identify.found import Mode, Tone
from crankorder.identify.modes.order_responses import NUMBERS as ORDER_RESPONSES
from crankorder.identify.modes.order_responses import Block, Projected, as_real, jacobian, project
from crankorder.identify.modes.surface_fit import Poles
from crankorder.orders.intervals import Z95
from crankorder.quantities import Floats
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "order_modes")


@dataclass(frozen=True)
class Proof:
    """The ``orders`` that by themselves prove a mode, by amplitude and phase.

    ``most_rows`` is the largest number of rows of one of them within some widths of it, ``rows`` that of all of them,
    ``span_hz`` the lowest and highest frequency that they reached; ``located`` is how many of them find it at the same
    place, each alone, within a part of its width; ``passed`` are those that sweep through it: what is told from afar
    may be another mode. ``flanked`` are those whose rows on both sides, without the ones at the peak, ask for the mode
    where these show it.
    """

    orders: tuple[float, ...] = ()
    most_rows: int = 0
    rows: int = 0
    span_hz: tuple[float, float] = (0.0, 0.0)
    located: int = 0
    passed: tuple[float, ...] = ()
    flanked: tuple[float, ...] = ()


@dataclass(frozen=True)
class OrderPole:
    """A pole that orders ask for: ``frequency_hz``, ``damping``, the ``channels`` that show it and its ``proof``."""

    frequency_hz: float
    damping: float
    channels: tuple[str, ...]
    proof: Proof


def named(blocks: Sequence[Block], projected: Sequence[Projected], poles: Poles, number: int) -> OrderPole:
    """Pole ``number`` of ``poles`` with the orders that prove it; ``blocks`` as ``projected`` with all poles."""
    f, zeta = poles.values[number].tolist()
    reach = NUMBERS.within_widths * zeta
    rows: dict[float, int] = {}
    ends: list[float] = []
    shown: list[str] = []
    located, passed, flanked = set[float](), set[float](), set[float]()
    for block, part in zip(blocks, projected, strict=True):
        seen, shows = block.rows, residue_chances(block, part, number) <= NUMBERS.proof_chance
        if block.scatter > ORDER_RESPONSES.most_scatter or not shows.any():
            continue
        shown += [name for name, yes in zip(seen.channels, shows, strict=True) if yes]
        within = int(np.count_nonzero(np.abs(seen.frequency_hz / f - 1.0) <= reach))
        rows[seen.order] = max(within, rows.get(seen.order, 0))
        ends += seen.ends_hz
        if (1.0 - reach) * seen.ends_hz[0] <= f <= (1.0 + reach) * seen.ends_hz[1]:
            passed.add(seen.order)
            # the block alone finds the pole where it is: one step from there is small, and its error too
            step, error = _step(block, part, poles, number)
            if error <= NUMBERS.located_widths * zeta and abs(step) <= NUMBERS.agrees_sigmas * error:
                located.add(seen.order)
            if flanks_show(block, poles, number):
                flanked.add(seen.order)
    if not rows:
        return OrderPole(f, zeta, (), Proof())
    proof = Proof(
        tuple(sorted(rows)),
        max(rows.values()),
        sum(rows.values()),
        (min(ends), max(ends)),
        located=len(located),
        passed=tuple(sorted(passed)),
        flanked=tuple(sorted(flanked)),
    )
    return OrderPole(f, zeta, tuple(dict.fromkeys(shown)), proof)


def _step(block: Block, part: Projected, poles: Poles, number: int) -> tuple[float, float]:
    """Step in ln f by which ``block`` alone would move pole ``number``, and its error; infinite where it cannot say."""
    if part.degrees_of_freedom < 2 or number not in part.reached:
        return np.inf, np.inf
    slopes = jacobian(block, poles, part)[:, 2 * number : 2 * number + 2]
    information = slopes.T @ slopes
    if np.linalg.cond(information) > 1e12:
        return np.inf, np.inf
    inverse = np.linalg.inv(information)
    step = float((inverse @ slopes.T @ as_real(part.left, block))[0])
    return step, float(np.sqrt(inverse[0, 0] * max(part.chi2 / part.degrees_of_freedom, 1.0)))


def flanks_show(block: Block, poles: Poles, number: int) -> bool:
    """Whether at held speeds the flanks of pole ``number`` of ``poles`` in ``block`` prove it without its peak.

    A force that differs at one speed or two makes a peak, but no flanks: a resonance adds 1 / (f² − ν²) to an order on
    both sides, far beyond its width, with the other sign above it (Ewins 2000, §2.4). Rows within some widths, and the
    nearest ones, are left out; what is left must ask for the mode, and place it among those. Squares have
    no sign and prove nothing so.
    """
    if block.rows.power:
        return False
    apart = block.rows.frequency_hz / float(poles.frequency_hz[number]) - 1.0
    away = np.abs(apart)
    nearest = float(np.sort(away)[NUMBERS.peak_rows - 1 : NUMBERS.peak_rows].sum())
    reach = max(NUMBERS.within_widths * float(poles.damping[number]), nearest)
    at_peak = away <= reach
    if min(np.count_nonzero(~at_peak & side) for side in (apart < 0.0, apart > 0.0)) < NUMBERS.fewest_flank:
        return False
    flanks = replace(block, rows=replace(block.rows, error=np.where(at_peak, np.inf, block.rows.error)))
    part = project(flanks, poles)
    if not (residue_chances(flanks, part, number) <= NUMBERS.proof_chance).any():
        return False
    step, error = _step(flanks, part, poles, number)
    return bool(Z95 * error <= reach and abs(step) <= NUMBERS.agrees_sigmas * error)


def residue_chances(block: Block, part: Projected, number: int) -> Floats:
    """Chances (C,) that the residue of pole ``number`` in ``block`` is so large without the mode (F test).

    ``part``: the block as projected.
    """
    from scipy.special import fdtrc

    place = np.flatnonzero(part.reached == number)
    size, per = len(block.rows.channels), block.rows.columns_per_mode
    if not len(place) or part.degrees_of_freedom < size:
        return np.ones(size)
    at = block.degree + 1 + per * int(place[0]) + np.arange(per)
    value, spread = part.linear[:, at], part.covariance[:, at[:, None], at]
    squared = np.einsum("ci,cij,cj->c", value.conj(), np.linalg.pinv(spread, hermitian=True), value).real
    scale = max(part.chi2 / part.degrees_of_freedom, 1.0)
    return np.asarray(fdtrc(2.0, part.degrees_of_freedom / size, squared / 2.0 / scale))


def proven_by(proof: Proof) -> str:
    """What says that a mode is there, in words; empty where no order does.

    ``proof``: the orders that show it.
    """
    if not proof.orders:
        return ""
    if not proof.passed:
        return f"no order passes it; it shapes orders {_listed(proof.orders)} from afar"
    names = _listed(proof.passed)
    if len(proof.passed) > 1:
        words = f"orders {names} peak there, each at its own speed, with the phase of a resonance"
    else:
        near = f"at {proof.most_rows} speeds around it" if proof.most_rows else "seen on its flanks"
        words = f"order {names} has amplitude and phase of a resonance there, {near}"
    if proof.flanked and proof.most_rows < NUMBERS.rows_of_turn and not _peaks_prove(proof):
        words += f"; the flanks of order {_listed(proof.flanked)}, without the rows at its peak, place it there"
    return words


def is_proven(proof: Proof) -> bool:
    """Whether two orders sweep through the mode, at several speeds, or each alone at one place: one is evidence.

    One is proof too where it shows the mode at its peak and by its flanks alone.
    ``proof``: the orders that show it.
    """
    return bool(proof.flanked) or _peaks_prove(proof)


def _peaks_prove(proof: Proof) -> bool:
    return len(proof.passed) > 1 and (proof.rows >= NUMBERS.rows_of_two or proof.located > 1)


def mode_of(pole: OrderPole, covariance: Floats, every: Poles, *, settings: IdentifySettings) -> Mode | None:
    """Mode of a ``pole`` that only orders show, with its ``covariance`` (2, 2); None where it is a part of the shape.

    So is one of unknown damping that lies no further from another pole than it is known: both are one.
    ``every``: all poles of the test, this one among them; ``settings``: the largest damping that a mode may have.
    """
    error, zeta_error = (float(np.sqrt(max(covariance[k, k], 0.0))) for k in (0, 1))
    f, zeta, proof = pole.frequency_hz, pole.damping, pole.proof
    others = every.frequency_hz[every.frequency_hz != f]
    is_another = zeta_error > NUMBERS.known_share * zeta and bool((np.abs(others - f) <= Z95 * error).any())
    if not proof.orders or zeta > settings.max_damping_ratio or is_another:
        return None
    doubt = _doubt(pole, error, zeta_error, every)
    return Mode(f, error, zeta, zeta_error, pole.channels, 0.0, proven_by(proof), proof.orders, doubt)


def tone_as_mode(tone: Tone, orders: tuple[float, ...], *, settings: IdentifySettings) -> tuple[Mode, Floats]:
    """A ``tone`` at which ``orders`` rise as an undecided mode, with its covariance (2, 2).

    ``settings``: the least damping that a mode is reckoned with, which stands for one that nobody saw.
    """
    f, error, zeta = tone.frequency_hz, tone.frequency_error_hz, settings.least_damping_ratio
    rise = f"orders {_listed(orders)} rise" if len(orders) > 1 else f"order {_listed(orders)} rises"
    doubt = f"tone or mode: {rise} there"
    mode = Mode(f, error, zeta, zeta, tuple(tone.amplitude), 0.0, tone.evidence, orders, doubt)
    return mode, np.diag([error**2, zeta**2])


def _listed(orders: Sequence[float]) -> str:
    return ", ".join(f"{order:g}" for order in orders)


def _doubt(pole: OrderPole, error: float, zeta_error: float, every: Poles) -> str:
    """Why a pole that only orders show may be none."""
    f, zeta, proof = pole.frequency_hz, pole.damping, pole.proof
    low, high = proof.span_hz
    said = []
    if not proof.passed:
        said.append("no order passes it: something else beyond what was swept may look the same")
    elif (
        len(proof.passed) == 1
        and not proof.flanked
        and (proof.most_rows < NUMBERS.rows_of_turn or zeta_error > NUMBERS.known_alone_share * zeta)
    ):
        said.append(f"passed by order {proof.passed[0]:g} alone, at {proof.most_rows} speeds: its force may peak there")
    elif len(proof.passed) > 1 and not is_proven(proof):
        said.append("too few speeds lie near it: a force that differs at one of them looks the same")
    if error > NUMBERS.uncertain_share * f:
        said.append(f"its frequency is known to {100.0 * error / f:.1f} % only")
    if zeta_error > NUMBERS.known_share * zeta:
        said.append("its damping is not determined")
    if f + 2.0 * zeta * f > high or f - 2.0 * zeta * f < low:
        said.append(f"lies at the end of what was swept, {low:.1f} to {high:.1f} Hz")
    apart = np.abs(every.frequency_hz / f - 1.0)
    within = (apart > 0.0) & (apart < every.damping)
    wider = every.frequency_hz[
        within & ((every.damping > NUMBERS.wider_ratio * zeta) | (apart < every.damping / NUMBERS.wider_ratio))
    ]
    if len(wider):
        said.append(f"within the width of {wider[0]:.1f} Hz: what that one's model leaves may look the same")
    return "; ".join(said)


def is_shown(tone: Tone, mode: Mode) -> bool:
    """Whether ``tone`` is what the floor shows of a ``mode`` that orders raise."""
    near = max(mode.damping_ratio * mode.frequency_hz, 3.0 * np.hypot(mode.frequency_error_hz, tone.frequency_error_hz))
    return tone.kind == "tone" and abs(tone.frequency_hz - mode.frequency_hz) <= near
