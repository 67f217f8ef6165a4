"""What the orders of a test give to a modal fit: their amplitudes over held speeds and along sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.found import AgreedOrder, OrderLine
from crankorder.identify.modes.order_responses import NUMBERS as ORDER_RESPONSES
from crankorder.identify.modes.order_responses import Block
from crankorder.identify.modes.passage import Passage, passage_of
from crankorder.orders.between_recordings import WHOLE, one_phase_reference, phases_compare
from crankorder.orders.vold_kalman.bandwidth import noise_bandwidth_share
from crankorder.quantities import Bools, Complexes, Floats
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-modal.toml", table="order_blocks"):
    on_bin_share: float
    clear_sigmas: float
    least_degrees_of_freedom: float
    from_ends_bandwidths: float
    same_order_share: float


NUMBERS = _Numbers.load()


def blocks_of(
    order_map: xr.Dataset, orders: tuple[AgreedOrder, ...], followed: Sequence[xr.Dataset] = ()
) -> tuple[Block, ...]:
    """Blocks of the ``orders`` with every channel in which they stand out anywhere.

    Along sweeps they are those of ``followed`` (RecordingTracks), one for each recording; at held speeds those of the
    OrderMap ``order_map``. Where the phases say nothing, as of a line that slips or where recordings have no common
    mark, squares stand for them. Orders at fewer speeds than the model has unknowns have none.
    """
    made: list[Block | None] = []
    for agreed in orders:
        swept = [block for item in followed if (block := _swept_block(agreed, item)) is not None]
        made += swept or _held_blocks(agreed, order_map)
    return tuple(block for block in made if block is not None)


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
    names = [str(name) for name in order_map["channel"].values]
    phasor = size * np.exp(1j * np.radians(np.nan_to_num(phase)))
    told = bool(np.isfinite(phase[known]).all())
    if told and phases_compare([order_map], np.array([agreed.order]))[0]:
        return [_block(agreed.order, names, speed, phasor, wide)]
    half = abs(2.0 * agreed.order - round(2.0 * agreed.order)) < 2.0 * WHOLE  # after a turn as it was, or of other sign
    if told and one_phase_reference([order_map]) and half:
        made = _block(agreed.order, names, speed, phasor, wide)
        return [made and replace(made, amplitude=_without_turns(made.amplitude), sign_free=True)]
    made = _block(agreed.order, names, speed, phasor, wide, power=True)
    return [made and made.squared]


def _without_turns(amplitude: Complexes) -> Complexes:
    """``amplitude`` (C, K) with the signs of its rows by which each turns least from the one before."""
    beside = np.sum((amplitude[:, :-1].conj() * amplitude[:, 1:]).real, axis=0)
    return np.asarray(amplitude * np.cumprod(np.append(1.0, np.where(beside < 0.0, -1.0, 1.0))))


def _of_sizes(order: float, line: OrderLine) -> Block | None:
    """Block of the squares of ``line``, whose phase is none of the shaft's."""
    error = line.amplitude_error[None]
    error = np.where(np.isfinite(error) & (error > 0.0) & (line.speed_rpm > 0.0), error, np.inf)
    made = _block(order, [line.channel], line.speed_rpm, line.amplitude[None], error, power=True)
    return made and made.squared


def _block(
    order: float,
    names: list[str],
    speed: Floats,
    amplitude: NDArray[np.inexact[Any]],
    error: Floats,
    *,
    power: bool = False,
    followed: float | None = None,
    **along: Any,
) -> Block | None:
    """Block of the channels that stand out at enough speeds; None where none does.

    ``followed`` is the number under which the order was followed, if not ``order``: it says the frequency.
    """
    known = np.isfinite(error)
    held = np.where(known, amplitude, 0.0)
    clear = (np.abs(held) > NUMBERS.clear_sigmas * np.where(known, error, np.inf)).any(axis=1)
    clear &= np.count_nonzero(known, axis=1) >= (2 if power or along else 1) * ORDER_RESPONSES.spare_amplitudes + 1
    if not clear.any():
        return None
    rows = known[clear].any(axis=0) | bool(along)  # a passage knows all of its rows
    kept = np.ix_(clear, rows)
    return Block(
        order,
        tuple(name for name, is_clear in zip(names, clear.tolist(), strict=True) if is_clear),
        (followed or order) * speed[rows] / 60.0,
        speed[rows],
        np.asarray(held[kept], dtype=np.complex128),
        error[kept],
        float(speed[rows].max()),
        power=power,
        **along,
    )


def _swept_block(agreed: AgreedOrder, item: xr.Dataset) -> Block | None:
    """Block of one recording whose speed sweeps; None where the order was not followed there."""
    found = swept_rows(agreed.order, item)
    if found is None:
        return None
    rows, passage = found
    amplitude, error = rows["amplitude"].values, rows["standard_error"].values
    return _block(
        agreed.order,
        [str(name) for name in item["channel"].values],
        rows["speed"].values,
        np.nan_to_num(amplitude),
        np.where(np.isfinite(amplitude.real) & (error > 0.0), error, np.inf),
        followed=float(rows["order"]),
        passage=passage,
        recording=str(item.attrs["recording"]),
    )


def swept_rows(order: float, item: xr.Dataset) -> tuple[xr.Dataset, Passage] | None:
    """Rows (channel, frame) of ``order`` in the RecordingTracks ``item``, apart in noise, and how it passed them.

    None where the speed does not sweep or the order was not followed.
    """
    if not item.attrs.get("swept", 0) or "amplitude" not in item or not item["time"].size:
        return None
    names = item["order"].values
    found = np.flatnonzero(np.abs(names - order) <= NUMBERS.same_order_share * order)
    if not len(found):
        return None
    row = int(found[np.argmin(np.abs(names[found] - order))])
    time, speed, angle = (item[name].values.astype(np.float64) for name in ("time", "speed", "crank_angle"))
    bandwidth = item["bandwidth_hz"].values[row].astype(np.float64)
    inside = (time - time[0] >= NUMBERS.from_ends_bandwidths / bandwidth[0]) & (
        time[-1] - time >= NUMBERS.from_ends_bandwidths / bandwidth[-1]
    )
    amplitude, error = item["amplitude"].values[:, row], item["standard_error"].values[:, row]
    poles = int(item.attrs["poles"])
    known = inside & np.isfinite(amplitude.real) & (error > 0.0) & (speed > 0.0)
    # hardly any row shares its noise with the one before: one in a reciprocal bandwidth
    passed = np.cumsum(noise_bandwidth_share(poles) * bandwidth * np.gradient(time))
    rows = known.any(axis=0) & (np.diff(np.floor(passed), prepend=-1.0) > 0.0)
    if np.count_nonzero(rows) < 2 * ORDER_RESPONSES.spare_amplitudes:
        return None
    first = 0.5 / float(item["bandwidth_hz"].values[:, 0].max())
    passage = _passage(float(names[row]), np.stack([time, speed, angle, bandwidth]), rows, poles=poles, first_s=first)
    return item.isel(order=row, frame=np.flatnonzero(rows)), passage


def _passage(number: float, along: Floats, rows: Bools, *, poles: int, first_s: float) -> Passage:
    """Passage of order ``number`` with time, speed, angle and bandwidth ``along`` (4, N), of which ``rows`` are read.

    It begins ``first_s`` before the first row, with the recording, as the speed runs there: what the order passed then
    may ring on.
    """
    moving = along[1] > 0.0
    along, rows = along[:, moving], rows[moving]
    time, speed, _, _ = along
    rate = (speed[1] - speed[0]) / (time[1] - time[0])
    before = along[:, 0].copy()
    before[0] -= first_s
    before[1] = max(speed[0] - rate * first_s, 0.5 * speed[0])
    before[2] -= 0.5 * (before[1] + speed[0]) / 60.0 * first_s
    whole = np.concatenate([before[:, None], along], axis=1)
    return passage_of(number, *whole, poles=poles, rows=np.append(False, rows))
