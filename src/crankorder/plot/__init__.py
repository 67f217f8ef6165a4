"""Pictures for notebooks: each is one function of data and, where given, of the axes to draw on, which it returns.

``co.plot.campbell``, ``order_map``, ``orders``, ``envelope``, ``spectra`` and ``speed`` draw what the functions of the
front door make, ``order_spectra``, ``cycle`` and ``shapes`` whole figures of all channels. From samples to a picture:

>>> import numpy as np, crankorder as co
>>> time = np.arange(40_000) / 10_000.0
>>> recording = co.recording({"housing": 2.0 * np.cos(2 * np.pi * 75.0 * time)}, rate_hz=1e4, speed_rpm=1500.0)
>>> axes = co.plot.order_map(co.order_map(recording))
>>> axes.get_xlabel(), axes.get_title(loc="left")
('Order (cycles per crank revolution)', 'housing')

Without ``ax`` the figure is pyplot's, so that a notebook shows it; with ``ax`` pyplot is not even loaded. matplotlib is
loaded when the first picture is drawn, and its settings (``rcParams``) stay as they are. Labels stand beyond the edges
and are laid out anew with every drawing: a figure of several axes makes room for them by ``layout="constrained"``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from crankorder.plot.campbell_figure import campbell, order_map
    from crankorder.plot.cycle_figure import cycle, shapes
    from crankorder.plot.orders_figure import order_spectra, orders, speed
    from crankorder.plot.spectra_figure import envelope, spectra

__all__ = ["campbell", "cycle", "envelope", "order_map", "order_spectra", "orders", "shapes", "spectra", "speed"]
_HOMES = {
    "order_map": "campbell", "envelope": "spectra", "order_spectra": "orders", "speed": "orders", "shapes": "cycle",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'crankorder.plot' has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(f"crankorder.plot.{_HOMES.get(name, name)}_figure"), name)


def __dir__() -> list[str]:
    return list(__all__)
