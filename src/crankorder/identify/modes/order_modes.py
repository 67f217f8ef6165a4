"""What orders say of a natural frequency: what proves it, what doubt is left, and what of it rings on in others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from crankorder.identify.found import HiddenSpeeds, Mode, Swing, Tone
from crankorder.identify.intervals import Z95
from crankorder.identify.modes.order_responses import NUMBERS as ORDER_RESPONSES
from crankorder.identify.modes.order_responses import Block, Projected, as_real, jacobian, project
from crankorder.identify.modes.surface_fit import Poles
from crankorder.quantities import Bools, Complexes, Floats
from crankorder.settings import IdentifySettings, MethodNumbers

RINGING = MethodNumbers("5-identify-modal.toml", "ringing")

MOST_KEPT = 256
"""Passages that are kept."""


def without_ringing(blocks: Sequence[Block], parts: Sequence[Projected], poles: Poles) -> tuple[Block, ...]:
    """``blocks`` less what the other orders of the same recording leave in their filters behind ``poles``.

    ``parts`` are the blocks as projected with them. A mode that one order has passed rings on at its own frequency,
    where a lower order finds it later (a higher one where the speed falls). What is taken away is known as well as the
    residue of the other order, and by as much as that one scatters: the errors of the rows grow by it.
    """
    return tuple(
        block if block.passage is None else _without(block, _others(block, blocks, parts), poles) for block in blocks
    )


def _others(block: Block, blocks: Sequence[Block], parts: Sequence[Projected]) -> list[tuple[Block, Projected]]:
    """The other orders among ``blocks`` that sweep in the recording of ``block``, and their ``parts``."""
    return [
        (other, part)
        for other, part in zip(blocks, parts, strict=True)
        if other is not block and other.passage is not None and other.recording == block.recording
    ]


def swings_of(blocks: Sequence[Block], parts: Sequence[Projected], poles: Poles) -> tuple[Swing, ...]:
    """What the orders of ``blocks`` leave in one another's filters behind ``poles``, all along their recordings.

    ``parts`` are the blocks as projected with the poles. Empty for orders that hold nothing of others.
    """
    swings = []
    for block in blocks:
        if block.passage is None or block.as_read is None:
            continue
        every = np.arange(len(block.passage.time_s), dtype=np.float64)
        along = replace(block, passage=replace(block.passage, place=every))
        total, variance = _rung(along, _others(block, blocks, parts), poles)
        swings += [
            Swing(block.order, name, block.recording, block.passage.time_s, taken, np.sqrt(spread))
            for name, taken, spread in zip(block.channels, total, variance, strict=True)
        ]
    return tuple(swings)


def without_swings(followed: Sequence[xr.Dataset], swings: Sequence[Swing]) -> tuple[xr.Dataset, ...]:
    """``followed`` (RecordingTracks) less the ``swings`` of their orders, whose errors theirs grow by."""
    cleaned = []
    for tracks in followed:
        own = [swing for swing in swings if swing.recording == tracks.attrs.get("recording")]
        if own:
            tracks = tracks.copy(deep=True)
        for swing in own:
            names = tracks["order"].values
            row = int(np.argmin(np.abs(names - swing.order)))
            channel = tracks["channel"].values.tolist().index(swing.channel)
            time = tracks["time"].values
            taken, error = (np.interp(time, swing.time_s, values) for values in (swing.taken, swing.error))
            tracks["amplitude"].values[channel, row] -= taken
            tracks["standard_error"].values[channel, row] = np.hypot(
                tracks["standard_error"].values[channel, row], error
            )
        cleaned.append(tracks)
    return tuple(cleaned)


def _without(block: Block, others: Sequence[tuple[Block, Projected]], poles: Poles) -> Block:
    """``block`` as it was measured, less what the ``others`` leave of ``poles``."""
    total, variance = _rung(block, others, poles)
    amplitude, error = block.as_read or (block.amplitude, block.error)
    if not total.any():
        return block if block.as_read is None else replace(block, amplitude=amplitude, error=error, as_read=None)
    return replace(
        block, amplitude=amplitude - total, error=np.hypot(error, np.sqrt(variance)), as_read=(amplitude, error)
    )


def _rung(block: Block, others: Sequence[tuple[Block, Projected]], poles: Poles) -> tuple[Complexes, Floats]:
    """What the ``others`` leave of ``poles`` in ``block``, and its variance (C, K), at the places of its passage."""
    rows = 0 if block.passage is None else len(block.passage.place)
    total, variance = np.zeros((len(block.channels), rows), dtype=np.complex128), np.zeros((len(block.channels), rows))
    for other, part in others:
        shared = [block.channels.index(name) for name in other.channels if name in block.channels]
        from_rows = [other.channels.index(block.channels[row]) for row in shared]
        for place, pole in enumerate(part.reached.tolist()):
            f, zeta = float(poles.frequency_hz[pole]), float(poles.damping[pole])
            if not shared or not rings_into(block, other, f, zeta):
                continue
            took = _taken(block, other, f, zeta)
            column = other.degree + 1 + place
            residue = part.linear[from_rows, column]
            spread = part.covariance[from_rows, column, column].real * part.beyond_errors
            total[shared] += residue[:, None] * took
            variance[shared] += (spread + np.square(other.scatter * np.abs(residue)))[:, None] * np.abs(took) ** 2
    return total, variance


def rings_into(block: Block, other: Block, natural_hz: float, damping: float) -> bool:
    """Whether a mode that the ``other`` order has passed still rings when ``block`` passes it.

    ``natural_hz`` and ``damping``: of the mode.
    """
    if not block.ends_hz[0] < natural_hz < block.ends_hz[1]:
        return False
    return _rings(other, block.order, natural_hz, damping, RINGING.rings_share)


def _rings(block: Block, later: float, natural_hz: float, damping: float, share: float) -> bool:
    """Whether more than a ``share`` of what ``block`` left of a mode still rings when the order ``later`` passes it."""
    passage = block.passage
    assert passage is not None
    if not passage.ends_hz[0] < natural_hz < passage.ends_hz[1]:
        return False
    slowest, fastest = passage.rates_rpm_per_s
    if (slowest > 0.0 and block.order < later) or (fastest < 0.0 and block.order > later):
        return False
    rate = max(abs(slowest), abs(fastest)) / 60.0
    delay = natural_hz * abs(1.0 / later - 1.0 / block.order) / max(rate, 1e-12)
    return bool(2.0 * np.pi * damping * natural_hz * delay < -np.log(share))


def hidden_speeds(
    blocks: Sequence[Block],
    modes: Sequence[Mode],
    *,
    revs_per_cycle: int,
    least_damping: float,
    looked_hz: Sequence[tuple[float, float]] = (),
) -> tuple[HiddenSpeeds, ...]:
    """Speeds at which orders that nobody found could meet ``modes`` that still ring from the orders of ``blocks``.

    Every multiple of the cycle's frequency (``revs_per_cycle`` 1 or 2) may be such an order, if it is none of
    ``blocks``. No mode is taken to be damped by less than ``least_damping``. At ``looked_hz``, from … to, all of them
    were looked for beside what rings.
    """
    swept = [block for block in blocks if block.passage is not None]
    if not swept:
        return ()
    have = np.array(sorted({block.order for block in swept}))
    multiples = np.arange(1, int(revs_per_cycle * (have.max() + 1.0)) + 1) / revs_per_cycle
    unknown = multiples[np.abs(multiples[:, None] - have).min(axis=1) > 0.25 / revs_per_cycle]
    hidden: list[HiddenSpeeds] = []
    for mode in modes:
        f, zeta = mode.frequency_hz, max(mode.damping_ratio, least_damping)
        if any(low <= f <= high for low, high in looked_hz):
            continue
        reach = mode.frequency_half_hz + RINGING.near_share * f
        for number in unknown.tolist():
            rung = [block for block in swept if _rings(block, number, f, zeta, RINGING.hides_share)]
            if rung:
                loudest = max(rung, key=lambda block: float(block.size.max()))
                ends = 60.0 * (f - reach) / number, 60.0 * (f + reach) / number
                hidden.append(HiddenSpeeds(ends[0], ends[1], f, loudest.order))
    return tuple(hidden)


def _taken(block: Block, other: Block, natural_hz: float, damping: float) -> Complexes:
    """What the filter of ``block`` takes (K,) of a mode behind the force of the ``other``, of unit residue."""
    assert block.passage is not None
    key = (block.order, len(block.passage.place), natural_hz, damping, other.exponent, other.law)
    if key not in other.rung:
        assert other.passage is not None
        if len(other.rung) >= MOST_KEPT:
            other.rung.pop(next(iter(other.rung)))
        left = other.passage.left_over(other.driven, natural_hz, damping)
        other.rung[key] = block.passage.taken_from(other.passage, left, natural_hz)
    return other.rung[key]


NUMBERS = MethodNumbers("5-identify-modal.toml", "order_modes")


@dataclass(frozen=True)
class Proof:
    """The ``orders`` that by themselves prove a mode, by amplitude and phase.

    ``most_rows`` is the largest number of rows of one of them within some widths of it, ``rows`` that of all of them,
    ``span_hz`` the lowest and highest frequency that they reached; ``located`` is how many of them find it at the same
    place, each alone, within a part of its width; ``passed`` are those that sweep through it: what is told from afar
    may be another mode. ``rung_by`` are other orders that passed it so shortly before one of these that it still rang.
    ``flanked`` are those whose rows on both sides, without the ones at the peak, ask for the mode where these show it.
    """

    orders: tuple[float, ...] = ()
    most_rows: int = 0
    rows: int = 0
    span_hz: tuple[float, float] = (0.0, 0.0)
    located: int = 0
    passed: tuple[float, ...] = ()
    rung_by: tuple[float, ...] = ()
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
    located, passed, rung_by, flanked = set[float](), set[float](), set[float](), set[float]()
    for block, part in zip(blocks, projected, strict=True):
        shows = residue_chances(block, part, number) <= NUMBERS.proof_chance
        if shows.any():
            shows &= _explains(block, part, poles, number)
        if block.scatter > ORDER_RESPONSES.most_scatter or not shows.any():
            continue
        shown += [name for name, yes in zip(block.channels, shows, strict=True) if yes]
        rows[block.order] = max(_rows_within(block, f, zeta), rows.get(block.order, 0))
        ends += block.ends_hz
        if (1.0 - reach) * block.ends_hz[0] <= f <= (1.0 + reach) * block.ends_hz[1]:
            passed.add(block.order)
            rung_by |= {
                other.order
                for other, _ in _others(block, blocks, projected)
                if block.passage is not None and rings_into(block, other, f, zeta)
            }
            # the block alone finds the pole where it is: one step from there is small, and its error too
            step, error = _step(block, part, poles, number)
            if error <= NUMBERS.located_widths * zeta and abs(step) <= NUMBERS.agrees_sigmas * error:
                located.add(block.order)
            if flanks_show(block, poles, number):
                flanked.add(block.order)
    if not rows:
        return OrderPole(f, zeta, (), Proof())
    proof = Proof(
        tuple(sorted(rows)),
        max(rows.values()),
        sum(rows.values()),
        (min(ends), max(ends)),
        located=len(located),
        passed=tuple(sorted(passed)),
        rung_by=tuple(sorted(rung_by)),
        flanked=tuple(sorted(flanked)),
    )
    return OrderPole(f, zeta, tuple(dict.fromkeys(shown)), proof)


def _explains(block: Block, part: Projected, poles: Poles, number: int) -> Bools:
    """Whether pole ``number``, with its neighbours, is what a sweep of ``block`` shows there, in each channel (C,).

    What the other poles leave there is felt, and with it most of that is gone, beyond the noise. Where the swing of
    another order was taken away, what that one's model does not know stays, and a pole that is none takes a part of it.
    """
    if block.passage is None:
        return np.ones(len(block.channels), dtype=np.bool_)
    f, zeta = poles.values[number].tolist()
    away = np.abs(block.frequency_hz / f - 1.0)
    reach = max(
        NUMBERS.within_widths * zeta,
        block.passage.blurred_hz / f,
        float(np.sort(away)[NUMBERS.fewest_beside - 1 : NUMBERS.fewest_beside].sum()),
    )
    near = away <= reach
    weight = block.weight[:, near]
    used = weight > 0.0
    error = (block.error if block.as_read is None else block.as_read[1])[:, near]
    noise = np.where(used, 2.0 * np.square(block.noise * error), 0.0).sum(axis=1)
    size = np.where(used, np.square(block.size[:, near]), 0.0).sum(axis=1)
    beside = np.abs(np.log(poles.frequency_hz / f)) <= NUMBERS.side_by_side_share
    left, without = (
        np.where(used, np.abs(each.left[:, near]) ** 2 / np.where(used, weight, 1.0) ** 2, 0.0).sum(axis=1)
        for each in (part, project(block, poles.chosen(~beside)))
    )
    felt = without - left > NUMBERS.felt_share**2 * size * (4.0 if block.power else 1.0)
    return np.asarray(felt & (without - left >= (1.0 - NUMBERS.unexplained_share) * np.maximum(without - noise, noise)))


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
    if block.passage is not None or block.power:
        return False
    apart = block.frequency_hz / float(poles.frequency_hz[number]) - 1.0
    away = np.abs(apart)
    nearest = float(np.sort(away)[NUMBERS.peak_rows - 1 : NUMBERS.peak_rows].sum())
    reach = max(NUMBERS.within_widths * float(poles.damping[number]), nearest)
    at_peak = away <= reach
    if min(np.count_nonzero(~at_peak & side) for side in (apart < 0.0, apart > 0.0)) < NUMBERS.fewest_flank:
        return False
    flanks = replace(block, error=np.where(at_peak, np.inf, block.error))
    part = project(flanks, poles)
    if not (residue_chances(flanks, part, number) <= NUMBERS.proof_chance).any():
        return False
    step, error = _step(flanks, part, poles, number)
    return bool(Z95 * error <= reach and abs(step) <= NUMBERS.agrees_sigmas * error)


def _rows_within(block: Block, f: float, zeta: float) -> int:
    """How many rows of ``block`` lie within some widths of a pole; a sweep through both its flanks has enough."""
    reach, (low, high) = NUMBERS.within_widths * zeta, block.ends_hz
    rows = int(np.count_nonzero(np.abs(block.frequency_hz / f - 1.0) <= reach))
    whole = block.passage is not None and low < f * (1.0 - reach) and high > f * (1.0 + reach)
    return max(rows, NUMBERS.rows_of_sweep) if whole else rows


def residue_chances(block: Block, part: Projected, number: int) -> Floats:
    """Chances (C,) that the residue of pole ``number`` in ``block`` is so large without the mode (F test).

    ``part``: the block as projected.
    """
    from scipy.special import fdtrc

    place = np.flatnonzero(part.reached == number)
    if not len(place) or part.degrees_of_freedom < len(block.channels):
        return np.ones(len(block.channels))
    at = block.degree + 1 + block.columns_per_mode * int(place[0]) + np.arange(block.columns_per_mode)
    value, spread = part.linear[:, at], part.covariance[:, at[:, None], at]
    squared = np.einsum("ci,cij,cj->c", value.conj(), np.linalg.pinv(spread, hermitian=True), value).real
    scale = max(part.chi2 / part.degrees_of_freedom, 1.0)
    return np.asarray(fdtrc(2.0, part.degrees_of_freedom / len(block.channels), squared / 2.0 / scale))


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
    elif len(proof.passed) == 1 and proof.rung_by:
        before = _listed(proof.rung_by)
        said.append(f"passed by order {proof.passed[0]:g} alone, while it would still ring from order {before}")
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
