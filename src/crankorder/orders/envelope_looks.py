"""What the bands of an envelope show where strikes are looked for, and which band of a test serves each train best.

A train of strikes rings where its own path leads it, so that one band does not serve all. Which one serves a comb is
found from all recordings of a test together: many weak ones show in sum what none shows alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.orders.envelope_band import Band
from crankorder.orders.envelope_combs import Comb, comb_nats, look_nats, looked_at
from crankorder.orders.envelope_lines import floor_worth, free_of_others

Array = NDArray[np.float64]

WIDER_SHARE = 0.9
"""Share of the best band's evidence, in logarithms, that a wider band must show to be taken instead."""

_UNITS = {"ratio": "1", "level": "1", "floor": "see unit"}
"""Units of what is kept of a spectrum: power over the skirts of other lines, that over the floor, root of the floor."""

_OF_COMB = {"units": "1", "long_name": "strikes that are looked for"}


def looks_of(
    combs: tuple[Comb, ...], bands: tuple[Band, ...], *, order: Array, looks: NDArray[np.float32]
) -> dict[str, Any]:
    """Variables of a RecordingEnvelope: what each of ``bands`` shows where lines of ``combs`` may be.

    ``looks`` (channel, 3, bands, looks): the power over the skirts of other lines, that over the local floor, and the
    root of this floor; ``order`` (orders,) is that of a whole spectrum.
    """
    bins = looked_at(combs, step=float(order[1]), n_orders=len(order))
    made = comb_variables(combs) | {
        "look": (("look",), order[bins], {"units": "1", "long_name": "order of the envelope"}),
        "look_band_low": (("speed", "band"), np.array([[band.low_hz for band in bands]]), {"units": "Hz"}),
        "look_band_high": (("speed", "band"), np.array([[band.high_hz for band in bands]]), {"units": "Hz"}),
    }
    for number, (name, units) in enumerate(_UNITS.items()):
        dims = ("channel", "speed", "band", "look")
        made[f"look_{name}"] = (dims, looks[:, number][:, None], {"units": units})
    return made


def comb_variables(combs: tuple[Comb, ...]) -> dict[str, Any]:
    """``combs`` as variables of a dataset."""
    columns = np.array(combs, dtype=np.float64).reshape(-1, len(Comb._fields)).T
    return {f"comb_{name}": (("comb",), column, _OF_COMB) for name, column in zip(Comb._fields, columns, strict=True)}


def combs_in(dataset: xr.Dataset) -> tuple[Comb, ...]:
    """Combs that ``dataset`` holds; none where it has none."""
    if "comb_low" not in dataset:
        return ()
    columns = [dataset[f"comb_{name}"].values.tolist() for name in Comb._fields]
    return tuple(Comb(*row) for row in zip(*columns, strict=True))


def joined_looks(groups: list[list[xr.Dataset]]) -> dict[str, Any]:
    """Variables of an EnvelopeMap: for each comb its lines in the one band that serves it best in the whole test.

    ``groups`` are the RecordingEnvelopes of like speed; empty where one of them was made without combs, or with
    others. Bands of other recordings are those nearest to the bands of the first one of the most.
    """
    items = [item for group in groups for item in group]
    combs = combs_in(items[0])
    if not combs or any(not _alike(item, items[0]) for item in items):
        return {}
    like = max(items, key=lambda item: item.sizes["band"])
    kept = np.stack([_averaged(group, like) for group in groups], axis=2)
    chosen = _bands_of(kept[0], groups, combs, items[0])
    made = comb_variables(combs) | {"look": (("look",), items[0]["look"].values, dict(items[0]["look"].attrs))}
    for number, (name, units) in enumerate(_UNITS.items()):
        values = np.stack([kept[number][:, :, at] for at in chosen])
        made[f"comb_{name}"] = (("comb", "channel", "speed", "look"), values, {"units": units})
    for end in ("low", "high"):
        edges = np.array([group[0][f"look_band_{end}"].values[0, _nearest(group[0], like)] for group in groups])
        made[f"comb_band_{end}"] = (("comb", "speed"), edges[:, chosen].T, {"units": "Hz"})
    return made


def _alike(item: xr.Dataset, other: xr.Dataset) -> bool:
    return combs_in(item) == combs_in(other) and np.array_equal(item["look"].values, other["look"].values)


def _nearest(item: xr.Dataset, like: xr.Dataset) -> NDArray[np.int64]:
    """Which band of ``item`` is nearest to each of the bands of ``like``, by both ends in Hz."""
    away = np.zeros((like.sizes["band"], item.sizes["band"]))
    for end in ("look_band_low", "look_band_high"):
        away += np.abs(like[end].values[0][:, None] - item[end].values[0])
    return np.asarray(np.argmin(away, axis=1), dtype=np.int64)


def _averaged(group: list[xr.Dataset], like: xr.Dataset) -> NDArray[np.float32]:
    """Means (3, channel, band, look) of what is kept of the recordings of a ``group``, as often as each counts."""
    total, made = 0.0, 0.0
    for item in group:
        count = np.nan_to_num(item["n_independent"].values[:, 0])[:, None, None]
        at = _nearest(item, like)
        made = made + count * np.nan_to_num(np.stack([item[f"look_{name}"].values[:, 0][:, at] for name in _UNITS]))
        total = total + count
    return np.asarray(made / np.maximum(total, 1e-9), dtype=np.float32)


def _bands_of(
    ratio: NDArray[np.float32], groups: list[list[xr.Dataset]], combs: tuple[Comb, ...], first: xr.Dataset
) -> list[int]:
    """For each comb the band of ``ratio`` (channel, speed, band, look) that serves it best: in a spectrum or in all."""
    order = first["order"].values
    step, bins = float(order[1]), np.round(first["look"].values / order[1]).astype(np.int64)
    count = np.array([sum(np.nan_to_num(item["n_independent"].values[:, 0]) for item in group) for group in groups]).T
    revs = [min(int(item["revs_per_frame"].values[0]) for item in group) for group in groups]
    speed_hz = [float(np.mean([item["speed"].values[0] for item in group])) / 60.0 for group in groups]
    cycle = int(first.attrs["revs_per_cycle"])
    free = np.array(
        [
            free_of_others(order, revs_per_cycle=cycle, speed_hz=hz, cell=1.0 / each)
            for hz, each in zip(speed_hz, revs, strict=True)
        ]
    )
    best = np.zeros((len(combs), ratio.shape[2]))
    several = np.log(max(count.size, 1))
    if count.size > 1:
        weight = count[:, :, None, None] * free[None, :, None, bins]
        own = weight.sum(axis=(0, 1))
        mean = (weight * ratio).sum(axis=(0, 1)) / np.maximum(own, 1e-9)
        counts = np.zeros(len(order), dtype=np.bool_)
        counts[bins] = own[0] >= 0.5 * count.sum()
        worth = floor_worth(step, 1.0 / max(revs))
        total = np.array([float(count.sum())])
        best = served(mean[None], combs, bins, step=step, count=total, worth=worth, free=counts)[:, 0]
    for speed in range(ratio.shape[1]):
        worth = floor_worth(step, 1.0 / revs[speed])
        shown = served(ratio[:, speed], combs, bins, step=step, count=count[:, speed], worth=worth, free=free[speed])
        best = np.maximum(best, shown.max(axis=1) - several)
    # bands come widest first, level by level: a wider one that shows it as well holds more of the resonance
    return [int(np.flatnonzero(each >= WIDER_SHARE * each.max())[0]) for each in best]


def served(
    ratio: NDArray[np.floating],
    combs: tuple[Comb, ...],
    bins: NDArray[np.int64],
    *,
    step: float,
    count: Array,
    worth: float,
    free: NDArray[np.bool_],
) -> Array:
    """Nats (combs, rows, bands) of the best trial of each of ``combs`` in each of ``ratio`` (rows, bands, looks).

    Parameters
    ----------
    ratio : power over the floor at the ``bins`` (looks,) of spectra with bins ``step`` orders apart
    count : (rows,), independent spectra that each is the mean of
    worth : independent bins that its floor is worth
    free : (orders,), bins off the multiples of the cycle's order and of mains
    """
    nats = np.concatenate(
        [
            look_nats(row, bins, count=float(own), floor_worth=worth, free=free[bins])
            for row, own in zip(ratio, count, strict=True)
        ]
    )
    best = [comb_nats(nats, bins, comb, step=step, free=free[bins]).max(axis=1, initial=0.0) for comb in combs]
    return np.array(best).reshape(len(combs), *ratio.shape[:2])
