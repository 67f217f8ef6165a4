"""Numbers of orders that a fast sweep tells roughly: those of their tracks."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from crankorder.identify.found import AgreedOrder
from crankorder.identify.lines.followed_orders import numbered_as_followed, with_followed


def _order(number: float, error: float, lock="undecided") -> AgreedOrder:
    return AgreedOrder(number, error, 1e6, lock, None, ())


def _tracks(*orders: float) -> list[xr.Dataset]:
    return [xr.Dataset(coords={"order": list(orders)}, attrs={"swept": 1})]


def test_an_undecided_order_takes_the_number_of_the_track_that_its_interval_holds() -> None:
    (told,) = numbered_as_followed([_order(4.00534, 0.0055)], _tracks(4.0, 10.5))
    assert told.order == 4.0 and told.lock == "undecided"
    assert abs(told.order - 4.00534) <= 1.96 * told.order_error


def test_orders_that_are_sure_or_elsewhere_stay_and_a_track_is_of_one_order_only() -> None:
    sure, far, own, beside = _order(4.01, 0.02, "slips"), _order(6.0, 0.001), _order(8.001, 0.01), _order(8.03, 0.02)
    given = (sure, far, own, beside)
    assert numbered_as_followed(given, _tracks(4.0, 6.3, 8.0)) == given
    assert numbered_as_followed(given, []) == given


def _along(number: float, level: float, *, rows: int = 40, asked_only: bool = False) -> list[xr.Dataset]:
    """Tracks of one order that stands ``level`` times over its error in eight rows, and is nothing elsewhere."""
    size = np.zeros((1, 1, rows))
    size[..., 10:18] = level
    speed = np.linspace(1000.0, 3000.0, rows)
    made = xr.Dataset(
        {
            "amplitude": (("channel", "order", "frame"), size.astype(complex)),
            "standard_error": (("channel", "order", "frame"), np.ones_like(size)),
            "degrees_of_freedom": (("channel", "order", "frame"), np.full(size.shape, 20.0)),
        },
        coords={
            "channel": ["X"],
            "order": [number],
            "speed": ("frame", speed),
            "crank_angle": ("frame", np.linspace(0.0, 400.0, rows)),
        },
        attrs={"swept": 1, "standing_out": [] if asked_only else [number]},
    )
    return [made]


def _map() -> xr.Dataset:
    coords = {"order": np.arange(0.0, 12.0, 0.25), "speed": np.linspace(1000.0, 3000.0, 60)}
    return xr.Dataset(coords=coords, attrs={"revs_per_cycle": 2})


def test_an_order_that_a_sweep_shows_for_a_moment_is_found_undecided() -> None:
    known = _order(4.0, 1e-4, "locked")
    below, found = with_followed([known], _along(3.0, 50.0), _map())[::-1]
    (line,) = found.lines
    assert below is known and (found.order, found.lock) == (3.0, "undecided")
    assert line.amplitude == pytest.approx(50.0) and ((line.speed_rpm > 1500.0) & (line.speed_rpm < 1900.0)).all()


@pytest.mark.parametrize(
    "tracks",
    [_along(3.0, 4.0), _along(3.1, 50.0), _along(4.0, 50.0), _along(3.0, 50.0, asked_only=True), []],
    ids=["noise", "no multiple", "known already", "only asked for", "no sweep"],
)
def test_what_is_followed_but_shows_nothing_new_is_no_order(tracks: list[xr.Dataset]) -> None:
    known = (_order(4.0, 1e-4, "locked"),)
    assert with_followed(known, tracks, _map()) == known
