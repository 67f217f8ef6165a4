"""Lines of a test sampled by crank angle that are not where they seem: what folds about half the samples per turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from crankorder.identify.found import OrderLine
from crankorder.identify.lines.line_evidence import excess_over_noise
from crankorder.quantities import Floats, QualityFlag
from crankorder.settings import MethodNumbers, Settings
from crankorder.shaft.aliasing import Alias, AliasedLine, aliased_lines, find_aliases

NUMBERS = MethodNumbers("5-identify-explain.toml", "folds")


@dataclass(frozen=True, eq=False)
class ShownAlias:
    """A fold and where it shows: ``speed_rpm`` and ``order`` (points,), each order known within ``order_error``."""

    fold: Alias
    speed_rpm: Floats
    order: Floats
    order_error: float

    def is_line(self, line: OrderLine) -> bool:
        """Whether ``line`` is this fold, at more than half of the speeds at which it is seen."""
        reach = np.hypot(self.order_error / NUMBERS.order_error_bins, 2.0 * line.order_error)
        near = np.abs(self.order - line.order) <= reach
        same = np.isin(np.round(line.speed_rpm, 6), np.round(self.speed_rpm[near], 6))
        return bool(np.mean(same) > NUMBERS.of_line_share)


def shown_aliases(order_map: xr.Dataset, *, settings: Settings) -> tuple[ShownAlias, ...]:
    """What is found to fold in ``order_map``, the surest first; nothing where it was sampled by time or lacks a speed.

    ``settings``: those of identify (mains frequencies, highest frequency looked for) and of orders (the floor's width).
    """
    samples_per_rev = _samples_per_rev(order_map)
    if samples_per_rev is None:
        return ()
    speed, axis = order_map["speed"].values, order_map["order"].values
    excess = excess_over_noise(order_map, settings=settings.identify, orders=settings.orders).excess
    at_speed, at_order = np.nonzero((excess > 1.0).any(axis=0))
    order_error = NUMBERS.order_error_bins * float(axis[1] - axis[0])
    folds = find_aliases(
        speed[at_speed],
        axis[at_order],
        samples_per_rev=samples_per_rev,
        order_error=order_error,
        shown_to_order=float(axis[-1]),
        highest_hz=settings.identify.fold_search_hz,
        frequencies_hz=[line.frequency_hz for line in _aliased_mains(order_map, samples_per_rev, settings)],
    )
    return tuple(
        ShownAlias(fold, speed[at_speed][fold.points], axis[at_order][fold.points], order_error) for fold in folds
    )


def alias_flags(order_map: xr.Dataset, *, settings: Settings, folds: tuple[ShownAlias, ...]) -> list[QualityFlag]:
    """What may fold at the speeds of ``order_map``, and fixed frequencies above half the rate that show as lines in it.

    Nothing where the map is of recordings sampled by time, or of unknown speed. ``settings``: those of identify (mains
    frequencies, highest frequency looked for) and of orders (the floor's width). ``folds``: those of
    :func:`shown_aliases`.
    """
    samples_per_rev = _samples_per_rev(order_map)
    if samples_per_rev is None:
        return []
    speed = order_map["speed"].values
    low_hz, high_hz = samples_per_rev / 120 * speed.min(), samples_per_rev / 120 * speed.max()
    mains = _aliased_mains(order_map, samples_per_rev, settings)
    said = (
        f"sampled {samples_per_rev:g} times a revolution: unless a filter kept it out, what lies above "
        f"{low_hz:.4g} to {high_hz:.4g} Hz (by speed) shows at |order - {samples_per_rev:g} k|"
    )
    text = "; mains, ".join([said, *map(str, mains)])
    remarks = [("lines_may_fold", "info", text), *(shown.fold.remark for shown in folds)]
    return [
        {"recording": "all", "flag": flag, "severity": severity, "detail": detail} for flag, severity, detail in remarks
    ]


def _samples_per_rev(order_map: xr.Dataset) -> float | None:
    """Samples per revolution of a test sampled by crank angle whose speeds are known; else None."""
    samples_per_rev = float(order_map.attrs.get("samples_per_rev", 0.0))
    return samples_per_rev if samples_per_rev and np.isfinite(order_map["speed"].values).all() else None


def _aliased_mains(order_map: xr.Dataset, samples_per_rev: float, settings: Settings) -> list[AliasedLine]:
    """Multiples of mains that fold into the orders of the map."""
    multiples = np.multiply.outer(settings.identify.mains_hz, np.arange(1, NUMBERS.mains_harmonics + 1))
    return aliased_lines(
        samples_per_rev,
        order_map["speed"].values,
        frequencies_hz=np.unique(multiples[multiples <= settings.identify.fold_search_hz]).tolist(),
        shown_to_order=float(order_map["order"].values[-1]),
    )
