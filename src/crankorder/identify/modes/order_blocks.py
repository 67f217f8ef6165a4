"""What the orders of a test give to a modal fit along speeds and sweeps, and whether its modes leave them locked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from crankorder.identify.found import AgreedOrder, AgreedOrders, ModalFit, OrderLine, OrderResponse
from crankorder.identify.lines.agreed_orders import IN_SWEEP
from crankorder.identify.lines.line_phasors import lock_of, nearest_multiple, proves_speed, speed_source
from crankorder.identify.modes.order_responses import NUMBERS as ORDER_RESPONSES
from crankorder.identify.modes.order_responses import UNTOLD_HZ, Block, Rows
from crankorder.orders.filter_bandwidth import NOISE_BANDWIDTH
from crankorder.orders.intervals import WHOLE, one_phase_reference, phases_compare
from crankorder.quantities import Complexes, Floats
from crankorder.settings import MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "order_blocks")

TURNS_SURELY = "turns_surely"
"""Attribute of the tracks of a sweep: whether its angle is so sure that its signals were asked for modes."""


def blocks_of(order_map: xr.Dataset, orders: AgreedOrders, followed: Sequence[xr.Dataset] = ()) -> tuple[Block, ...]:
    """Blocks of the ``orders`` with every channel in which they stand out anywhere.

    Along sweeps they are those of ``followed`` (RecordingTracks), one for each recording; at held speeds those of the
    OrderMap ``order_map``. Where the phases say nothing, as of a line that slips or where recordings have no common
    mark, squares stand for them. Orders at fewer speeds than the model has unknowns have none.
    """
    blocks: list[Block | None] = []
    for agreed in orders:
        swept = [block for tracks in followed if (block := _swept_block(agreed, tracks)) is not None]
        blocks += swept or _held_blocks(agreed, order_map)
    return tuple(block for block in blocks if block is not None)


def _held_blocks(agreed: AgreedOrder, order_map: xr.Dataset) -> list[Block | None]:
    grid = order_map["order"].values
    if not len(grid):
        return []
    column = int(np.argmin(np.abs(grid - agreed.order)))
    if agreed.lock == "slips" or abs(grid[column] - agreed.order) > NUMBERS.on_bin_share * max(1.0, agreed.order):
        return [_of_sizes(agreed.order, line) for line in agreed.lines]
    size, phase, error, degrees_of_freedom = (
        order_map[variable].values[:, :, column].astype(np.float64)
        for variable in ("coherent_amplitude", "phase", "standard_error", "degrees_of_freedom")
    )
    speed = order_map["speed"].values
    known = np.isfinite(size) & (error > 0.0) & (degrees_of_freedom >= NUMBERS.least_degrees_of_freedom) & (speed > 0.0)
    wide = np.where(known, error * np.sqrt(degrees_of_freedom / np.maximum(degrees_of_freedom - 2.0, 1.0)), np.inf)
    names = tuple(str(name) for name in order_map["channel"].values)
    phasor = np.asarray(size * np.exp(1j * np.radians(np.nan_to_num(phase))), dtype=np.complex128)
    rows = Rows(agreed.order, names, agreed.order * speed / 60.0, speed, phasor, wide)
    has_phase = bool(np.isfinite(phase[known]).all())
    if has_phase and phases_compare([order_map], np.array([agreed.order]))[0]:
        return [_block(rows)]
    half = abs(2.0 * agreed.order - round(2.0 * agreed.order)) < 2.0 * WHOLE  # after a turn as it was, or of other sign
    if has_phase and one_phase_reference([order_map]) and half:
        block = _block(replace(rows, sign_free=True))
        if block is None:
            return []
        # signs by which each row turns least from the one before
        amplitude = block.rows.amplitude
        beside = np.sum((amplitude[:, :-1].conj() * amplitude[:, 1:]).real, axis=0)
        return [block.turned(np.cumprod(np.append(1.0, np.where(beside < 0.0, -1.0, 1.0))))]
    block = _block(rows, parts=2)
    return [block and block.squared]


def _of_sizes(order: float, line: OrderLine) -> Block | None:
    """Block of the squares of ``line``, whose phase is none of the shaft's."""
    error = line.amplitude_error[None]
    error = np.where(np.isfinite(error) & (error > 0.0) & (line.speed_rpm > 0.0), error, np.inf)
    speed, size = line.speed_rpm, line.amplitude[None].astype(np.complex128)
    block = _block(Rows(order, (line.channel,), order * speed / 60.0, speed, size, error), parts=2)
    return block and block.squared


def _block(rows: Rows, *, parts: int = 1) -> Block | None:
    """Block of those channels of ``rows`` that stand out at enough speeds; None where none does.

    ``parts``: amplitudes that an unknown takes, 2 where they are squares or neighbours tell the same.
    """
    known = np.isfinite(rows.error)
    held = np.where(known, rows.amplitude, 0.0)
    clear = (np.abs(held) > NUMBERS.clear_sigmas * np.where(known, rows.error, np.inf)).any(axis=1)
    clear &= np.count_nonzero(known, axis=1) >= parts * ORDER_RESPONSES.spare_amplitudes + 1
    if not clear.any():
        return None
    at = known[clear].any(axis=0)
    kept = np.ix_(clear, at)
    names = tuple(name for name, is_clear in zip(rows.channels, clear.tolist(), strict=True) if is_clear)
    hertz, speed, amplitude = rows.frequency_hz[at], rows.speed_rpm[at], np.asarray(held[kept], dtype=np.complex128)
    return Block.of(
        replace(rows, channels=names, frequency_hz=hertz, speed_rpm=speed, amplitude=amplitude, error=rows.error[kept])
    )


def _swept_block(agreed: AgreedOrder, tracks: xr.Dataset) -> Block | None:
    """Block of one recording whose speed sweeps; None where the order was not followed there.

    The number under which it was followed says the frequency.
    """
    swept = swept_rows(agreed.order, tracks)
    if swept is None:
        return None
    amplitude, error = swept["held_amplitude"].values, swept["standard_error"].values
    speed, hertz = swept["speed"].values, float(swept["order"]) * tracks["speed"].values / 60.0
    rate = float(np.median(np.abs(np.gradient(hertz, tracks["time"].values))))
    blur_hz = 0.5 * float(np.sqrt(rate)) if tracks.attrs.get(TURNS_SURELY, 1) else UNTOLD_HZ
    rows = Rows(
        agreed.order,
        tuple(str(name) for name in tracks["channel"].values),
        float(swept["order"]) * speed / 60.0,
        speed,
        np.nan_to_num(amplitude),
        np.where(np.isfinite(amplitude.real) & (error > 0.0), error, np.inf),
        recording=str(tracks.attrs["recording"]),
        blur_hz=blur_hz,
    )
    return _block(rows, parts=2)


def swept_rows(order: float, tracks: xr.Dataset) -> xr.Dataset | None:
    """Rows (channel, frame) of ``order`` in the RecordingTracks ``tracks``, apart in noise.

    None where the speed does not sweep or the order was not followed.
    """
    if not tracks.attrs.get("swept", 0) or "held_amplitude" not in tracks or not tracks["time"].size:
        return None
    names = tracks["order"].values
    near = np.flatnonzero(np.abs(names - order) <= NUMBERS.same_order_share * order)
    if not len(near):
        return None
    row = int(near[np.argmin(np.abs(names[near] - order))])
    time, speed = (tracks[name].values.astype(np.float64) for name in ("time", "speed"))
    bandwidth = tracks["bandwidth_hz"].values[row].astype(np.float64)
    inside = (time - time[0] >= NUMBERS.from_ends_bandwidths / bandwidth[0]) & (
        time[-1] - time >= NUMBERS.from_ends_bandwidths / bandwidth[-1]
    )
    amplitude, error = tracks["held_amplitude"].values[:, row], tracks["standard_error"].values[:, row]
    known = inside & np.isfinite(amplitude.real) & (error > 0.0) & (speed > 0.0)
    # hardly any row shares its noise with the one before: one in a reciprocal bandwidth
    passed = np.cumsum(NOISE_BANDWIDTH * bandwidth * np.gradient(time))
    rows = known.any(axis=0) & (np.diff(np.floor(passed), prepend=-1.0) > 0.0)
    if np.count_nonzero(rows) < 2 * ORDER_RESPONSES.spare_amplitudes:
        return None
    return tracks.isel(order=row, frame=np.flatnonzero(rows))


LOCK_NUMBERS = MethodNumbers("5-identify-lines.toml", "lock_through_modes")


@dataclass(frozen=True)
class _Left:
    """Slip [turns per revolution] of an order beside the phase of the modes; standard error and degrees of freedom."""

    turn: float
    error: float
    degrees_of_freedom: float


def with_locks_through_modes(
    orders: Sequence[AgreedOrder], modal: ModalFit, followed: Sequence[xr.Dataset], order_map: xr.Dataset
) -> tuple[AgreedOrders, ModalFit]:
    """``orders`` of which some that were undecided are proven locked by the fit ``modal`` of their sweeps, and the fit
    by their numbers.

    ``followed`` (RecordingTracks) hold them along their sweeps, ``order_map`` says what they may be locked to. The
    slope of the phase over the crank angle is fitted beside all that modes and forces may turn; where the 99.9 %
    interval of it leaves out a slip of 0.1 % of the order, it is locked. Nothing is called slipping by this. Without
    pulses the orders must prove the speed first (:func:`proves_speed`).
    """
    sweeps = [tracks for tracks in followed if tracks.attrs.get("swept", 0)]
    source = speed_source([*sweeps, order_map])
    if not sweeps or source == "vibration":
        return tuple(orders), modal
    cycle = int(order_map.attrs["revs_per_cycle"])
    open_ones = [one.lock == "undecided" and not one.of_angle for one in orders]  # an error of the angle is locked too
    measured = [
        _measured(one, modal, sweeps, order_map, cycle) if is_open else None
        for one, is_open in zip(orders, open_ones, strict=True)
    ]
    if source == "stated" and not any(one.lock == "locked" for one in orders):
        numbers = [
            (nearest_multiple(one.order, revs_per_cycle=cycle) + left.turn, left.error, left.degrees_of_freedom)
            for one, left in zip(orders, measured, strict=True)
            if left is not None
        ]
        if not proves_speed(numbers, revs_per_cycle=cycle):
            return tuple(orders), modal
    decided = tuple(
        one if left is None else _locked_where_proven(one, left, cycle)
        for one, left in zip(orders, measured, strict=True)
    )
    moved = {old.order: new.order for old, new in zip(orders, decided, strict=True) if old.order != new.order}
    if not moved:
        return decided, modal

    def number(order: float) -> float:
        return moved.get(order, order)

    return decided, replace(
        modal,
        modes=tuple(replace(one, reached_by=tuple(map(number, one.reached_by))) for one in modal.modes),
        responses=tuple(replace(one, order=number(one.order)) for one in modal.responses),
        unseen=tuple(replace(one, order=number(one.order)) for one in modal.unseen),
    )


def _measured(
    agreed: AgreedOrder, modal: ModalFit, sweeps: Sequence[xr.Dataset], order_map: xr.Dataset, cycle: int
) -> _Left | None:
    """What all ``sweeps`` tell of how ``agreed`` turns from the nearest multiple; None where none tells anything.

    The mean over the recordings by their errors, widened where they scatter more.
    """
    multiple = nearest_multiple(agreed.order, revs_per_cycle=cycle)
    seen = [
        left
        for tracks in sweeps
        for block in blocks_of(order_map, (agreed,), [tracks])
        if block.rows.recording and (left := _left_of(block, modal, tracks, multiple)) is not None
    ]
    if not seen:
        return None
    turns: Floats = np.array([left.turn for left in seen])
    weight: Floats = np.array([1.0 / left.error**2 for left in seen])
    mean, information = float(np.average(turns, weights=weight)), float(weight.sum())
    scatter = max(1.0, float(weight @ np.square(turns - mean)) / max(len(seen) - 1, 1))
    return _Left(mean, float(np.sqrt(scatter / information)), min(left.degrees_of_freedom for left in seen))


def _locked_where_proven(agreed: AgreedOrder, left: _Left, cycle: int) -> AgreedOrder:
    """``agreed``, which is locked where what is ``left`` proves it."""
    multiple = nearest_multiple(agreed.order, revs_per_cycle=cycle)
    lock = lock_of(multiple + left.turn, left.error, left.degrees_of_freedom, revs_per_cycle=cycle, by_phase=True)
    if lock != "locked":
        return agreed
    return replace(
        agreed,
        order=multiple,
        order_error=left.error,
        degrees_of_freedom=left.degrees_of_freedom,
        lock=lock,
        needed_revs=None,
        doubts=tuple(doubt for doubt in agreed.doubts if doubt != IN_SWEEP),
    )


def _left_of(block: Block, modal: ModalFit, tracks: xr.Dataset, multiple: float) -> _Left | None:
    """What turns the phase of ``block`` along ``tracks`` beside the modes, from ``multiple``; None: not fitted."""
    fits = {
        response.channel: response
        for response in modal.responses
        if response.fits
        and response.recording == block.rows.recording
        and abs(response.order - block.rows.order) <= NUMBERS.same_order_share * block.rows.order
    }
    channels = [name for name in block.rows.channels if name in fits]
    if not channels:
        return None
    speed, angle = (tracks[name].values.astype(np.float64) for name in ("speed", "crank_angle"))
    rows = np.flatnonzero(np.isin(speed, block.rows.speed_rpm))  # those of the block, at their speeds
    if len(rows) != len(block.rows.speed_rpm) or block.rows.speed_rpm[0] not in speed:
        return None
    angle = np.asarray(angle[rows] - angle[rows].mean())
    followed = tracks["order"].values
    off = float(followed[np.abs(followed - block.rows.order).argmin()]) - multiple
    # the channels see one force and the same modes: what turns one turns them all
    left = _solved(_together([_channel_part(block, fits[name], modal, angle) for name in channels]))
    if left is None:
        return None
    by_angle = block.rows.order * float(tracks.attrs.get("crank_angle_error_rev", 0.0)) / float(np.ptp(angle))
    return replace(left, turn=left.turn + off, error=float(np.hypot(left.error, by_angle)))


@dataclass(frozen=True)
class _Part:
    """One channel, or all, in standard errors: what is left of what was seen (R,), columns of slip (R,), of turns and
    poles (R, T), of each channel's own linear terms (R, P), and the rows that say how large these may be."""

    left: Floats
    seen: Floats
    slip: Floats
    shared: Floats
    own: Floats
    shared_now: Floats
    shared_spread: Floats
    own_prior: Floats
    own_prior_left: Floats
    n_laws: int


def _prior_of(response: OrderResponse, n_linear: int) -> tuple[Floats, Floats]:
    """Rows (S, 2 ``n_linear``) by which the smooth terms of ``response`` turn the first one, and what is left of 0.

    What is across the first term turns the phase, what is along it does not.
    """
    first = complex(response.smooth[0])
    size, count = max(abs(first), 1e-300), len(response.smooth) - 1
    across = 1j * first / size
    rows, left = np.zeros((count, 2 * n_linear)), np.zeros(count)
    for k in range(count):
        rows[k, 1 + k], rows[k, n_linear + 1 + k] = np.array([across.real, across.imag]) / (
            LOCK_NUMBERS.force_turn_rad * size
        )
        left[k] = -(complex(response.smooth[1 + k]) * across.conjugate()).real / (LOCK_NUMBERS.force_turn_rad * size)
    return rows, left


def _channel_part(block: Block, response: OrderResponse, modal: ModalFit, angle: Floats) -> _Part:
    row = [block.rows.channels.index(response.channel)]
    channels, amplitude, error = (response.channel,), block.rows.amplitude[row], block.rows.error[row]
    seen = replace(block.rows, channels=channels, amplitude=amplitude, error=error)
    degree, law = len(response.smooth) - 1, response.force.law
    alone = replace(block, rows=seen, force=response.force, degree=degree)
    hz = np.array([mode.frequency_hz for mode in modal.modes])
    damping = np.array([mode.damping_ratio for mode in modal.modes])
    smooth, modes = alone.smooth(), alone.modal(hz, damping)
    fitted = smooth @ response.smooth + modes @ response.residue
    weight = alone.weight[0]
    by_f, by_zeta = (slope * response.residue for slope in alone.modal_slopes(hz, damping))
    shapes = alone.shapes_to(max(len(law), LOCK_NUMBERS.force_terms))[:, 1:]
    laws = np.zeros(shapes.shape[1], dtype=complex)
    laws[: len(law)] = law
    grown = fitted[:, None] * shapes
    shared = [grown * 1j, grown, by_f[:, response.reached], by_zeta[:, response.reached]]
    reached = [modal.modes[number] for number in response.reached]
    spread = [
        LOCK_NUMBERS.force_turn_rad * LOCK_NUMBERS.smoother_ratio ** np.arange(len(laws)),
        np.full(len(laws), 10.0),
        np.array([mode.frequency_error_hz / mode.frequency_hz for mode in reached]),
        np.array([mode.damping_error / mode.damping_ratio for mode in reached]),
    ]
    now = np.concatenate([laws.imag, laws.real * 0.0, np.zeros(2 * len(reached))])
    linear = np.concatenate([smooth, modes[:, response.reached]], axis=1)
    own = np.concatenate([linear, 1j * linear], axis=1)
    prior, prior_left = _prior_of(response, linear.shape[1])
    return _Part(
        _parts((alone.rows.amplitude[0] - fitted) * weight),
        _parts(alone.rows.amplitude[0] * weight),
        _parts(2j * np.pi * angle * fitted * weight),
        _parts(np.concatenate(shared, axis=1) * weight[:, None]),
        _parts(own * weight[:, None]),
        now,
        np.concatenate(spread),
        prior,
        prior_left,
        len(laws),
    )


def _together(parts: Sequence[_Part]) -> _Part:
    """Channels of one block, which share the slip, the turns of the force and the poles."""
    from scipy.linalg import block_diag

    return replace(
        parts[0],
        left=np.concatenate([part.left for part in parts]),
        seen=np.concatenate([part.seen for part in parts]),
        slip=np.concatenate([part.slip for part in parts]),
        shared=np.concatenate([part.shared for part in parts]),
        own=block_diag(*(part.own for part in parts)),
        own_prior=block_diag(*(part.own_prior for part in parts)),
        own_prior_left=np.concatenate([part.own_prior_left for part in parts]),
    )


def _parts(values: Complexes) -> Floats:
    """Real parts of the rows of ``values``, then the imaginary ones."""
    return np.concatenate([values.real, values.imag])


def _solved(part: _Part) -> _Left | None:
    """Slip of a channel beside all else that turns it; None where the fit is not near enough to tell."""
    spread = np.maximum(part.shared_spread, 1e-12)
    n_own, n_shared = part.own.shape[1], len(spread)
    held = np.concatenate([np.zeros((n_shared, 1)), np.diag(1.0 / spread), np.zeros((n_shared, n_own))], axis=1)
    prior = np.concatenate([np.zeros((len(part.own_prior), 1 + n_shared)), part.own_prior], axis=1)
    matrix = np.concatenate([np.concatenate([part.slip[:, None], part.shared, part.own], axis=1), held, prior])
    wanted = np.concatenate([part.left, -part.shared_now / spread, part.own_prior_left])
    scale = np.sqrt(np.square(matrix).sum(axis=0))
    scaled = matrix / np.where(scale > 0.0, scale, 1.0)
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-13, hermitian=True)
    solution = np.linalg.lstsq(scaled, wanted, rcond=1e-12)[0]
    unknowns, left = solution / np.where(scale > 0.0, scale, 1.0), wanted - scaled @ solution
    free = len(part.left) - matrix.shape[1]
    bent = np.abs(unknowns[1 : 1 + part.n_laws] + part.shared_now[: part.n_laws]).max()
    if free < LOCK_NUMBERS.fewest_free or bent > LOCK_NUMBERS.far_turn_rad or not scale[0] > 0.0:
        return None
    beyond = max(0.0, float(np.square(left[: len(part.left)]).sum()) - free) / float(np.square(part.seen).sum())
    if beyond > LOCK_NUMBERS.most_left_share:
        return None
    worse = max(1.0, float(left @ left) / free)
    error = np.hypot(np.sqrt(inverse[0, 0] * worse), np.sqrt(beyond) * np.linalg.norm(part.seen) / scale[0])
    return _Left(float(unknowns[0]), float(error / scale[0]), float(free))
