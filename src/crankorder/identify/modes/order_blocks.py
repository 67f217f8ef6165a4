"""What the orders of a test give to a modal fit along speeds and sweeps, and whether its modes leave them locked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from scipy.linalg import block_diag

from crankorder.identify.found import AgreedOrder, AgreedOrders, ModalFit, OrderLine, OrderResponse
from crankorder.identify.lines.agreed_orders import IN_SWEEP
from crankorder.identify.lines.line_phasors import lock_of, nearest_multiple, proves_speed, speed_source
from crankorder.identify.modes.order_responses import NUMBERS as ORDER_RESPONSES
from crankorder.identify.modes.order_responses import UNTOLD_HZ, Block, Rows
from crankorder.orders.intervals import WHOLE, one_phase_reference, phases_compare
from crankorder.orders.vold_kalman import NOISE_BANDWIDTH
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
        swept = [_swept_block(agreed, tracks) for tracks in followed]
        blocks += swept if any(swept) else _held_blocks(agreed, order_map)
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
    speed, number = swept["speed"].values, float(swept["order"])
    rate = float(np.median(np.abs(np.gradient(number * tracks["speed"].values / 60.0, tracks["time"].values))))
    blur_hz = 0.5 * float(np.sqrt(rate)) if tracks.attrs.get(TURNS_SURELY, 1) else UNTOLD_HZ
    names, recording = tuple(str(name) for name in tracks["channel"].values), str(tracks.attrs["recording"])
    error = np.where(np.isfinite(amplitude.real) & (error > 0.0), error, np.inf)
    phasor, hertz = np.nan_to_num(amplitude), number * speed / 60.0
    rows = Rows(agreed.order, names, hertz, speed, phasor, error, recording=recording, blur_hz=blur_hz)
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
    first, last = NUMBERS.from_ends_bandwidths / bandwidth[[0, -1]]
    inside = (time - time[0] >= first) & (time[-1] - time >= last)
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
    """Number of an order beside the phase of the modes, or its slip; standard error and degrees of freedom."""

    order: float
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
    measured = [_measured(agreed, modal, sweeps, order_map, cycle) for agreed in orders]
    if source == "stated" and not any(agreed.lock == "locked" for agreed in orders):
        numbers = [(left.order, left.error, left.degrees_of_freedom) for left in measured if left is not None]
        if not proves_speed(numbers, revs_per_cycle=cycle):
            return tuple(orders), modal
    pairs = zip(orders, measured, strict=True)
    decided = tuple(agreed if left is None else _locked_where_proven(agreed, left, cycle) for agreed, left in pairs)
    number = {old.order: new.order for old, new in zip(orders, decided, strict=True)}
    modes = [replace(mode, reached_by=tuple(number.get(k, k) for k in mode.reached_by)) for mode in modal.modes]
    responses = [replace(fit, order=number.get(fit.order, fit.order)) for fit in modal.responses]
    unseen = [replace(bound, order=number.get(bound.order, bound.order)) for bound in modal.unseen]
    return decided, replace(modal, modes=tuple(modes), responses=tuple(responses), unseen=tuple(unseen))


def _measured(
    agreed: AgreedOrder, modal: ModalFit, sweeps: Sequence[xr.Dataset], order_map: xr.Dataset, cycle: int
) -> _Left | None:
    """Number of ``agreed`` as all ``sweeps`` tell it beside the modes; None where it is decided or none tells anything.

    The mean over the recordings by their errors, widened where they scatter more.
    """
    if agreed.lock != "undecided" or agreed.of_angle:  # an error of the angle is locked too
        return None
    multiple = nearest_multiple(agreed.order, revs_per_cycle=cycle)
    blocks = [(block, tracks) for tracks in sweeps if (block := _swept_block(agreed, tracks)) is not None]
    lefts = (_left_of(block, modal, tracks, multiple) for block, tracks in blocks)
    seen = [left for left in lefts if left is not None]
    if not seen:
        return None
    turns, weight = np.array([(left.order, 1.0 / left.error**2) for left in seen]).T
    mean, information = float(np.average(turns, weights=weight)), float(weight.sum())
    scatter = max(1.0, float(weight @ np.square(turns - mean)) / max(len(seen) - 1, 1))
    return _Left(multiple + mean, float(np.sqrt(scatter / information)), min(left.degrees_of_freedom for left in seen))


def _locked_where_proven(agreed: AgreedOrder, left: _Left, cycle: int) -> AgreedOrder:
    """``agreed``, which is locked where what is ``left`` proves it."""
    lock = lock_of(left.order, left.error, left.degrees_of_freedom, revs_per_cycle=cycle, by_phase=True)
    if lock != "locked":
        return agreed
    order = nearest_multiple(agreed.order, revs_per_cycle=cycle)
    dof, doubts = left.degrees_of_freedom, tuple(doubt for doubt in agreed.doubts if doubt != IN_SWEEP)
    return replace(
        agreed, order=order, order_error=left.error, degrees_of_freedom=dof, lock=lock, needed_revs=None, doubts=doubts
    )


def _left_of(block: Block, modal: ModalFit, tracks: xr.Dataset, multiple: float) -> _Left | None:
    """What turns the phase of ``block`` along ``tracks`` beside the modes, from ``multiple``; None: not fitted."""
    order, near = block.rows.order, NUMBERS.same_order_share * block.rows.order
    own = [fit for fit in modal.responses if fit.fits and fit.recording == block.rows.recording]
    fits = {fit.channel: fit for fit in own if abs(fit.order - order) <= near}
    channels = [name for name in block.rows.channels if name in fits]
    if not channels:
        return None
    speed, angle = (tracks[name].values.astype(np.float64) for name in ("speed", "crank_angle"))
    rows = np.flatnonzero(np.isin(speed, block.rows.speed_rpm))  # those of the block, at their speeds
    if len(rows) != len(block.rows.speed_rpm):
        return None
    angle = np.asarray(angle[rows] - angle[rows].mean())
    followed = tracks["order"].values
    off = float(followed[np.abs(followed - order).argmin()]) - multiple
    # the channels see one force and the same modes: what turns one turns them all
    left = _slip_of(block, [fits[name] for name in channels], modal, angle)
    if left is None:
        return None
    by_angle = order * float(tracks.attrs.get("crank_angle_error_rev", 0.0)) / float(np.ptp(angle))
    return replace(left, order=left.order + off, error=float(np.hypot(left.error, by_angle)))


def _prior_of(response: OrderResponse) -> tuple[Floats, Floats]:
    """Rows (S, 2 terms) by which the smooth terms of ``response`` turn the first one, and what is left of 0.

    What is across the first term turns the phase, what is along it does not.
    """
    first, others = complex(response.smooth[0]), response.smooth[1:]
    size, count, n_linear = max(abs(first), 1e-300), len(others), len(response.smooth) + len(response.reached)
    across, number, spread = 1j * first / size, np.arange(count), LOCK_NUMBERS.force_turn_rad * size
    rows = np.zeros((count, 2 * n_linear))
    rows[number, 1 + number], rows[number, n_linear + 1 + number] = across.real / spread, across.imag / spread
    return rows, -(others * across.conjugate()).real / spread


def _real(values: Complexes, weight: Floats) -> Floats:
    """Real parts of the rows of ``values``, each times its ``weight``, then the imaginary ones."""
    weighted = (values.T * weight).T
    return np.concatenate([weighted.real, weighted.imag])


def _slip_of(block: Block, fits: Sequence[OrderResponse], modal: ModalFit, angle_rev: Floats) -> _Left | None:
    """Slip of ``block`` along ``angle_rev`` beside all else that turns it; None where its ``fits`` are too far off.

    Least squares in standard errors. The channels, one for each of ``fits``, share the slip, the turns of the force and
    the poles, all known as well as they were fitted; each has linear terms of its own.
    """
    hz, damping = np.array([(mode.frequency_hz, mode.damping_ratio) for mode in modal.modes]).reshape(-1, 2).T
    law, reached = fits[0].force.law, fits[0].reached
    n_laws, modes = max(len(law), LOCK_NUMBERS.force_terms), [modal.modes[number] for number in reached]
    parts = list[tuple[Floats, ...]]()
    for fit in fits:
        row = block.rows.channels.index(fit.channel)
        behind, measured = replace(block, force=fit.force, degree=len(fit.smooth) - 1), block.rows.amplitude[row]
        smooth, modal_columns = behind.smooth(), behind.modal(hz, damping)
        fitted = smooth @ fit.smooth + modal_columns @ fit.residue
        grown = fitted[:, None] * behind.shapes_to(n_laws)[:, 1:]
        slopes = [(slope * fit.residue)[:, reached] for slope in behind.modal_slopes(hz, damping)]
        shared = np.concatenate([2j * np.pi * (angle_rev * fitted)[:, None], 1j * grown, grown, *slopes], axis=1)
        linear = np.concatenate([smooth, modal_columns[:, reached]], axis=1)
        columns = measured - fitted, measured, shared, np.concatenate([linear, 1j * linear], axis=1)
        parts.append((*(_real(values, block.weight[row]) for values in columns), *_prior_of(fit)))
    left, seen, shared_rows, own_rows, prior_rows, prior_left = zip(*parts, strict=True)
    now = np.zeros(2 * n_laws + 2 * len(modes))
    now[: len(law)] = np.imag(law)
    spread = [
        LOCK_NUMBERS.force_turn_rad * LOCK_NUMBERS.smoother_ratio ** np.arange(n_laws),
        np.full(n_laws, 10.0),
        np.array([mode.frequency_error_hz / mode.frequency_hz for mode in modes]),
        np.array([mode.damping_error / mode.damping_ratio for mode in modes]),
    ]
    errors = np.maximum(np.concatenate(spread), 1e-12)
    held, own, prior = np.pad(np.diag(1.0 / errors), ((0, 0), (1, 0))), block_diag(*own_rows), block_diag(*prior_rows)
    no_own, no_shared = np.zeros((len(held), own.shape[1])), np.zeros((len(prior), held.shape[1]))
    matrix = np.block([[np.concatenate(shared_rows), own], [held, no_own], [no_shared, prior]])
    wanted, n_rows = np.concatenate([*left, -now / errors, *prior_left]), len(own)
    scale = np.sqrt(np.square(matrix).sum(axis=0))
    scaled = matrix / np.where(scale > 0.0, scale, 1.0)
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-13, hermitian=True)
    solution = np.linalg.lstsq(scaled, wanted, rcond=1e-12)[0]
    unknowns, rest = solution / np.where(scale > 0.0, scale, 1.0), wanted - scaled @ solution
    free, power = n_rows - matrix.shape[1], float(np.square(np.concatenate(seen)).sum())
    bent = np.abs(unknowns[1 : 1 + n_laws] + now[:n_laws]).max()
    if free < LOCK_NUMBERS.fewest_free or bent > LOCK_NUMBERS.far_turn_rad or not scale[0] > 0.0:
        return None
    beyond = max(0.0, float(np.square(rest[:n_rows]).sum()) - free) / power
    if beyond > LOCK_NUMBERS.most_left_share:
        return None
    worse = max(1.0, float(rest @ rest) / free)
    error = np.hypot(np.sqrt(inverse[0, 0] * worse), np.sqrt(beyond * power) / scale[0])
    return _Left(float(unknowns[0]), float(error / scale[0]), float(free))
