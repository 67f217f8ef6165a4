"""Numbers of orders that a fast sweep tells roughly: those of their tracks."""

from __future__ import annotations

import xarray as xr

from crankorder.identify.found import AgreedOrder
from crankorder.identify.lines.followed_numbers import numbered_as_followed


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
