"""Real units in datasets whose channels may differ in unit: what leaves the program says m/s2, not "see unit".

Inside, a variable such as ``amplitude`` holds the values of all channels, each in the unit that the coordinate ``unit``
states, and its ``units`` are ``see unit`` (squared, per Hz). Outside every variable has one unit: where the channels
share it, ``amplitude`` keeps its name; where they differ there is a variable for each quantity, such as
``amplitude_acceleration`` and ``amplitude_pressure``, on the same dims, with NaN for the channels of the others.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from crankorder.errors import printable

if TYPE_CHECKING:  # a third of a second that the names of units need not wait for
    import xarray as xr

    from crankorder.quantities import Attribute

_TYPOGRAPHY = {
    "m/s2": "m/s²", "m s-2": "m/s²", "mm/s2": "mm/s²", "m/s^2": "m/s²", "um": "µm", "um/s": "µm/s", "deg": "°",
    "degree": "°", "1": "", "min-1": "rpm",
}  # fmt: skip

FORMS = {"see unit": "{}", "see unit, squared": "({})2", "see unit, squared per Hz": "({})2 Hz-1", "rev": "revolution"}
"""What ``units`` are inside, and outside with the unit of the channels in the braces."""

UDUNITS = {
    "g": "standard_free_fall", "N·m": "N m", "µm": "um", "µs": "us", "counts": "count", "FS": "1", "deg": "degree",
    "strain": "1", "µstrain": "1e-6", "%": "percent",
}  # fmt: skip
"""Units of channels that UDUNITS does not know by our spelling: its "g" is the gram."""

_INSIDE, PART_OF = "units_inside", "part_of"
"""Attributes of a variable outside: its ``units`` inside, and of which variable it is a part."""


def unit_text(unit: str) -> str:
    """Typographic form of a unit of a channel: ``"m/s²"`` for ``unit`` ``"m/s2"``; unknown ones as they are."""
    return _TYPOGRAPHY.get(unit, printable(unit, 24))


def with_real_units(dataset: xr.Dataset) -> xr.Dataset:
    """``dataset`` (channel, …) with its channels' unit in the ``units`` of every variable, parted by quantity.

    A variable is parted only where quantities differ: each part keeps the shape, with NaN in the channels of others. A
    dataset without the variable ``unit`` stays as it is. :func:`by_channel` is the inverse.
    """
    if not any(variable.attrs.get("units") in FORMS for variable in dataset.variables.values()):
        return dataset
    along, parts = _parts(dataset)
    whole, made = dataset.copy(), {}
    for key, variable in dataset.variables.items():
        name, inside = str(key), str(variable.attrs.get("units"))
        of_channel = "{}" in FORMS.get(inside, "")
        if inside not in FORMS or (of_channel and along not in variable.dims):
            continue
        if len(parts) == 1 or not of_channel:
            unit = next(iter(parts.values()))[0] if of_channel else "1"
            whole.variables[key].attrs = _outside(variable.attrs, unit)
        else:
            whole = whole.drop_vars(name)
            for part, (unit, of_part) in parts.items():
                values = _only(variable.values, of_part, variable.dims.index(along))
                if unit or not np.isnan(values).all():
                    about = {**_outside(variable.attrs, unit), PART_OF: name}
                    made[f"{name}_{part}"] = (variable.dims, values, about)
    return whole.assign(made) if made else whole


def by_channel(dataset: xr.Dataset) -> xr.Dataset:
    """``dataset`` (channel, …) as the program has it inside: one variable for all channels.

    It is the inverse of :func:`with_real_units`; a dataset that has no real units is returned as it is.
    """
    if not any(_INSIDE in variable.attrs for variable in dataset.variables.values()):
        return dataset
    import xarray as xr

    variables: dict[str, xr.Variable] = {}
    for key, variable in dataset.variables.items():
        name, about = str(key), dict(variable.attrs)
        units, whole = about.pop(_INSIDE, None), str(about.pop(PART_OF, ""))
        if units is None:
            variables[name] = variable
            continue
        values = variable.values
        if whole in variables:
            before = variables[whole].values
            values = np.where(np.isnan(before), values, before)
        variables[whole or name] = xr.Variable(variable.dims, values, {**about, "units": units})
    coords = [name for name in dataset.coords if name in variables]
    return xr.Dataset(variables, attrs=dataset.attrs).set_coords(coords)


def _parts(dataset: xr.Dataset) -> tuple[str, dict[str, tuple[str, NDArray[np.bool_]]]]:
    """The dimension that has units, then unit and places of each part, by the end of its variables' names.

    That end is the quantity, with the unit where one quantity has several. Without units there is no such dimension.
    """
    if "unit" not in dataset.variables or dataset["unit"].ndim != 1:
        return "", {}
    along = str(dataset["unit"].dims[0])
    units = dataset["unit"].values.astype(str)
    quantities = dataset["quantity"].values.astype(str) if "quantity" in dataset.variables else np.full(units.shape, "")
    known = list(dict.fromkeys(units[units != ""].tolist()))
    if len(known) < 2:
        return along, {"": ("".join(known), np.ones(units.shape, dtype=bool))}
    made: dict[str, tuple[str, NDArray[np.bool_]]] = {}
    for quantity, unit in dict.fromkeys(zip(quantities.tolist(), units.tolist(), strict=True)):
        alike = quantities == quantity
        one_unit = bool(quantity) and len(set(units[alike].tolist())) == 1
        name = plain = _word(quantity if one_unit else f"{quantity} {unit}" if unit else f"{quantity} of unknown unit")
        while name in made:  # names that differ in signs alone
            name = f"{plain}_{len(made)}"
        made[name] = (unit, alike & (units == unit))
    return along, made


def _word(text: str) -> str:
    return re.sub(r"\W+", "_", text.replace("µ", "u").replace("%", "percent")).strip("_").lower() or "other"


def _outside(attrs: Mapping[Hashable, Attribute], unit: str) -> dict[str, Attribute]:
    inside = str(attrs["units"])
    about = {str(key): value for key, value in attrs.items() if key != "units"}
    return {**about, **({"units": FORMS[inside].format(UDUNITS.get(unit, unit))} if unit else {}), _INSIDE: inside}


def _only(values: NDArray[Any], of_part: NDArray[np.bool_], axis: int) -> NDArray[Any]:
    along = of_part.reshape([-1 if place == axis else 1 for place in range(values.ndim)])
    return np.where(along, values, np.asarray(np.nan, dtype=values.dtype))
