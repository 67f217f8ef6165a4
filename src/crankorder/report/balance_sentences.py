"""What remains unbalanced of an engine, in sentences, from its balance sheet."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from crankorder.engine.cycle_tables import PARTS
from crankorder.engine.forces import AxisName, newton, speed_key
from crankorder.errors import plain_number
from crankorder.plot.reading import listed

Part = Mapping[str, Any]
"""A balance sheet or a part of it."""

NEARLY_STATIC = 0.01
"""Static unbalance below this share of a crankshaft's largest counterweight is named as balance."""
NO_FORCE_G_MM, NO_COUPLE_G_MM2 = 1e-6, 1e-3
"""What is smaller is rounding: at 10,000 rpm a millionth of a newton, and of a newton metre."""
NONE_SHARE = 1e-4
"""An amplitude below this share of the largest of its table is none in text; the document has its number."""
CYLINDER: dict[AxisName, str] = {"Z": "along the cylinder", "X": "across the cylinder"}
SEVERAL: dict[AxisName, str] = {"Z": "along Z", "X": "along X"}
"""Words for the axes of forces, for one cylinder and for several."""
COUPLES: dict[AxisName, str] = {"X": "about X", "Z": "about Z"}
_NO_FORCE = "no force"


def plain_state(sheet: Part) -> str:
    """Name of the engine of a balance ``sheet`` without its shafts; with counterweights if its file states them."""
    if not sheet["counterweights_in_file"]:
        return "with no balancing"
    return "as built" if sheet["shafts"]["own"] is None else "without its shafts"


def balance_sentences(sheet: Part) -> list[str]:
    """Sentences on what remains unbalanced, the plain engine first.

    ``sheet`` is the balance sheet of the engine; forces are named at the highest of its speeds.
    """
    speed_rpm = max(map(float, sheet["force_n"]))
    parts = {**sheet, "plain": sheet, "pairs": sheet["shafts"]["pairs"], "single_causes": sheet, "motion": sheet}
    told = (text for name, of_part in _OF_PARTS.items() if parts[name] for text in of_part(parts[name], speed_rpm))
    return [text[0].upper() + text[1:] for text in told]


def _of_plain(sheet: Part, speed_rpm: float) -> Iterator[str]:
    """Force and rocking couples of the engine without its shafts."""
    force = _amounts(sheet["force_g_mm"], speed_rpm, where=CYLINDER if sheet["strategies"] else SEVERAL)
    shakes = "no force shakes the engine" if force == _NO_FORCE else f"the engine shakes with {force}"
    yield f"{plain_state(sheet)} {shakes}."
    yield from _of_couples(sheet["moment_g_mm2"], speed_rpm)


def _newton(amount: float, speed_rpm: float, unit: str = "N") -> str:
    """Force of an ``amount`` (g·mm) over ω², or moment (``unit`` N·m) of one in g·mm², at a speed, as text."""
    scale = 1.0 if unit == "N" else 1e-3
    return f"{plain_number(scale * newton(amount, speed_rpm))} {unit}"


def _amount(amount_g_mm: float, speed_rpm: float) -> str:
    size = abs(amount_g_mm)
    return f"{size:.5g} g·mm ({_newton(size, speed_rpm)} at {speed_key(speed_rpm)} rpm)"


def told_orders(amounts: Mapping[str, float] | None, most: int, largest: float = 0.0) -> list[str]:
    """The ``most`` largest orders of ``amounts``, ascending, less what is nothing beside them or ``largest``."""
    least = NONE_SHARE * max(largest, *(amounts or {}).values(), 0.0)
    sizes = {order: size for order, size in (amounts or {}).items() if size > least}
    return sorted(sorted(sizes, key=lambda order: -sizes[order])[:most], key=float)


def _largest(axes: Mapping[Any, Mapping[str, float] | None], names: Iterable[AxisName]) -> float:
    return max((size for name in names for size in (axes[name] or {}).values()), default=0.0)


def _amounts(axes: Part, speed_rpm: float, most: int = 2, where: Mapping[AxisName, str] = CYLINDER) -> str:
    """The ``most`` largest orders in each direction, as one phrase with the speed at its end."""
    largest = _largest(axes, where)
    phrases = [
        f"{axes[axis][order]:.5g} g·mm ({_newton(axes[axis][order], speed_rpm)}) of order {order} {direction}"
        for axis, direction in where.items()
        for order in told_orders(axes[axis], most, largest)
    ]
    return f"{listed(phrases)} at {speed_key(speed_rpm)} rpm" if phrases else _NO_FORCE


def _of_couples(moments: Part, speed_rpm: float, *, state: str = "") -> Iterator[str]:
    """The three largest orders of each rocking couple; ``state``: words that come first."""
    largest = _largest(moments, COUPLES)
    for axis, about in COUPLES.items():
        sizes = moments[axis] or {}
        orders = [f"{_newton(sizes[k], speed_rpm, 'N·m')} of order {k}" for k in told_orders(sizes, 3, largest)]
        if orders:
            yield f"{state}a rocking couple {about} remains: {listed(orders)} at {speed_key(speed_rpm)} rpm."


def larger_parts(by_order: Part) -> dict[str, float]:
    """Amplitude (N·m) of the larger one of gas and masses, by order, from the parts ``by_order``."""
    return {order: max(parts["gas_n_m"], parts["inertia_n_m"]) for order, parts in by_order.items()}


def _side_by_side(by_order: Part, has_gas: bool, most: int) -> str:
    """Amplitudes of masses and gas, their sum, and which dominates, of the ``most`` largest orders."""
    larger, phrases = larger_parts(by_order), list[str]()
    for order in told_orders(larger, most):
        parts = by_order[order]
        masses, gas, both = (plain_number(parts[f"{part}_n_m"]) for part in PARTS)
        who = "gas dominates" if parts["dominates"] == "gas" else "masses dominate"
        of_both = f"order {order}: masses {masses}, gas {gas}, together {both} N·m ({who})"
        phrases.append(of_both if has_gas else f"{masses} N·m of order {order}")
    return "; ".join(phrases) if has_gas else listed(phrases)


def _of_roll(roll: Part, speed_rpm: float) -> Iterator[str]:
    """Roll moment on the block: masses, gas and both by order, and its mean."""
    mean, key = roll["mean_n_m"], speed_key(speed_rpm)
    orders = _side_by_side(roll["by_speed"][key], mean is not None, 3)
    if orders and mean is None:
        gas = "the part of the gas, which the file lacks, is not in it"
        yield f"roll moment of the masses on the block about Y: {orders} at {key} rpm; {gas}."
    elif orders:
        carried = f"the mean, {plain_number(mean)} N·m, is what mounts and driveline carry"
        yield f"roll moment on the block about Y at {key} rpm (amplitudes): {orders}; {carried}."


def _of_cycle(cycle: Part, speed_rpm: float) -> Iterator[str]:
    """What fires when, and whether gas or masses turn the crank unevenly."""
    at = f"at {speed_key(speed_rpm)} rpm"
    firing, turning = cycle["firing"], cycle["turning"][speed_key(speed_rpm)]
    power_w, swing = turning["power_w"], turning["speed_fluctuation"]
    swings = turning["peak_n_m"] - turning["least_n_m"]
    mean, least, peak, both = map(
        plain_number, (*(turning[f"{name}_n_m"] for name in ("mean", "least", "peak")), swings)
    )
    orders = _side_by_side(turning["by_order"], power_w is not None, 2)
    if orders:
        yield f"Torque on the crank {at}: {both} N·m peak to peak, from {least} to {peak} N·m; amplitudes: {orders}."
    if power_w is not None:
        power = plain_number(power_w / 1e3)
        yield f"The gas turns the crank with {mean} N·m in the mean, {power} kW {at} without friction."
    if swing is not None:
        yield f"Its speed swings by {100 * swing:.3g} % peak to peak within the cycle {at}."
    if firing is not None and len(firing["interval_deg"]) > 1:
        intervals = [f"{plain_number(interval)}°" for interval in firing["interval_deg"]]
        evenly = f"evenly, every {intervals[0]}" if firing["even"] else f"unevenly, at intervals of {listed(intervals)}"
        yield f"It fires {evenly}."


def _of_motion(sheet: Part, speed_rpm: float) -> Iterator[str]:
    """How fast pistons are, and what walls, pins and main bearings carry."""
    key, piston = speed_key(speed_rpm), sheet["piston"]
    mean, fastest = (plain_number(piston[name][key]) for name in ("mean_m_s", "fastest_m_s"))
    at = f"{piston['fastest_deg']:.4g}° after its dead centre"
    yield f"At {key} rpm a piston moves at {mean} m/s in the mean and {fastest} m/s at most, at {at}."
    if sheet["cycle"] is not None and sheet["cycle"]["loads"] is not None:
        yield f"At {key} rpm {_of_loads(sheet['cycle']['loads'][key])}."


def _of_loads(loads: Part) -> str:
    peaks = {name: max(one[name]["peak_n"] for one in loads["cylinders"]) for name in ("wall", "crank_pin")}
    wall, pin = map(plain_number, peaks.values())
    text = f"a piston presses on its wall with up to {wall} N and a rod on its crank pin with {pin} N"
    if loads["main_bearings"] is None:
        return text
    top = max(loads["main_bearings"], key=lambda bearing: bearing["peak_n"])
    place, peak, angle, mean = (plain_number(top[name]) for name in ("position_mm", "peak_n", "peak_deg", "mean_n"))
    return (
        f"{text}; the main bearing at {place} mm carries the most, up to {peak} N at {angle}° and {mean} N in the mean"
    )


def _of_strategies(strategies: Part, speed_rpm: float) -> Iterator[str]:
    for name, balance in strategies.items():
        if balance is None:
            continue
        total, couple, turning = balance["total_g"], balance["couple_g_mm2"], balance["rotation"]
        if name == "d":
            adds = f"{'takes off' if total < 0 else 'adds'} {abs(total):.5g} g"
            size = "" if couple is None else f" of up to {_newton(couple, speed_rpm, 'N·m')}"
            remains = f"a couple{size} at {speed_key(speed_rpm)} rpm remains"
            yield f"Strategy d {adds} and leaves no force of any order; {remains}."
            continue
        left = {"Z": balance["residual_along_g_mm"], "X": balance["residual_across_g_mm"]}
        first = _amounts({axis: {"1": size} for axis, size in left.items()}, speed_rpm)
        turns = f", turning {turning.replace('crank', 'the crank')}" if turning.endswith("crank") else ""
        higher = ", and every higher order along the cylinder" if balance["higher_orders_along_g_mm"] else ""
        yield f"Strategy {name} ({_on_crank(balance)}) leaves {first}{turns}{higher}."


def _on_crank(strategy: Part) -> str:
    """The counterweight of a strategy in words, its angle where it does not stand opposite to the pin."""
    grams, angle_deg = strategy["counterweight_g"], strategy["counterweight_deg"]
    if grams < 0:
        return f"{-grams:.5g} g off the crank opposite to its pin"
    return f"{grams:.5g} g on the crank" + (f", {angle_deg:.5g}° on from opposite to its pin" if angle_deg else "")


def shaft_sets(shafts: Part) -> dict[str, Part]:
    """Possibilities of additional shafts by name; none where the engine has several cylinders."""
    return {name: layout for name, layout in shafts.items() if layout and "strategy" in layout}


def layouts_of(sheet: Part) -> dict[str, Part]:
    """Every set or design of shafts of a ``sheet``, and the engine's own, by name: with what it leaves."""
    own, design = sheet["shafts"]["own"], sheet["design"] or {"layouts": {}}
    return {**shaft_sets(sheet["shafts"]), **design["layouts"], **({} if own is None else {"own": own})}


def _of_shafts(shafts: Part, speed_rpm: float) -> Iterator[str]:
    sets, own = shaft_sets(shafts), shafts["own"]
    for name, layout in sets.items():
        weights: dict[str, list[int]] = {}
        for shaft in layout["shafts"]:
            weights.setdefault(f"{shaft['unbalance_g_mm']:.5g} g·mm", []).append(shaft["speed_ratio"])
        carried = listed([f"{weight} each at {_speeds(ratios)}" for weight, ratios in weights.items()]) or "none"
        left = _amounts(layout["residual_g_mm"], speed_rpm, most=1)
        yield f"possibility {name} of shafts, on strategy {layout['strategy']}: {carried}; leaves {left} first of all."
    if own is not None:
        left = _amounts(own["residual_g_mm"], speed_rpm, most=4, where=CYLINDER if sets else SEVERAL)
        orders = " and ".join(map(str, own["orders"]))
        yield f"With its own shafts for order {orders} the engine still shakes with {left}."
        yield from _of_couples(own["residual_moment_g_mm2"], speed_rpm, state="With them ")


def _speeds(ratios: Sequence[int]) -> str:
    """Speeds of shafts in words, below 0 against the crank: "±2 times crank speed"."""
    both = sorted({abs(ratio) for ratio in ratios if -ratio in ratios})
    every = [f"±{ratio}" for ratio in both] + [f"{ratio:+d}" for ratio in ratios if abs(ratio) not in both]
    return f"{listed(every).replace('-', '−')} times crank speed"


def _of_designs(design: Part, speed_rpm: float) -> Iterator[str]:
    """What crank webs can take of an engine of several cylinders, what shafts it needs, and what these leave."""
    for kind, share in design["primary_share"].items():
        if share is not None:
            yield f"Crank webs can take {plain_number(100 * share)} % of the primary {kind} of the pistons."
    for name, layout in design["layouts"].items():
        weights = [weight["unbalance_g_mm"] for shaft in layout["shafts"] for weight in shaft["weights"]]
        ratios = [shaft["speed_ratio"] for shaft in layout["shafts"]]
        heavy = f" with up to {max(weights, default=0.0):.5g} g·mm in a plane leave{'s' * (len(ratios) == 1)}"
        carriers = "with those counterweights " if layout["webs"] else ""
        carriers += f"{'shafts' if len(ratios) > 1 else 'one shaft'} at {_speeds(ratios)}{heavy}"
        if name == "webs":
            carriers = "Counterweights on the crank webs alone leave"
        yield f"{carriers} {_largest_left(layout, speed_rpm)}."
    height = design["roll_height_mm"]
    if height is not None and abs(height) > 1e-9:
        where = f"{plain_number(abs(height))} mm {'above' if height > 0 else 'below'} the other"
        takes = "the pair takes the second-order roll moment of the masses too"
        yield f"Where the second-order shaft that turns with the crank sits {where}, {takes}."


def _largest_left(layout: Part, speed_rpm: float) -> str:
    """The largest force and the largest couple that a design leaves, in words."""
    phrases, nothing = [], [_NO_FORCE, "no rocking couple"]
    kinds = (("residual_g_mm", "N", SEVERAL), ("residual_moment_g_mm2", "N·m", COUPLES))
    for (key, unit, names), none in zip(kinds, nothing, strict=True):
        sizes = [(size, order, names[axis]) for axis in names for order, size in (layout[key][axis] or {}).items()]
        size, order, direction = max(sizes, default=(0.0, "", ""))
        phrases.append(f"at most {_newton(size, speed_rpm, unit)} of order {order} {direction}" if sizes else none)
    if phrases == nothing:
        return "neither force nor rocking couple"
    return f"{' and '.join(phrases)} at {speed_key(speed_rpm)} rpm"


def tolerance_sentences(study: Part, speed_rpm: float) -> Iterator[str]:
    """What a series leaves, and what one mistiming adds.

    ``study`` is that of the tolerances; ``speed_rpm`` is the crank speed [rpm], above 0, at which couples are named.
    """
    spread, rocking, late = study["force_g_mm"], study["couple_g_mm2"], study["mistiming"]
    largest, worst = (max(left, key=lambda order: left[order]["95 %"]) for left in (spread, rocking))
    widest = max(spread, key=lambda order: spread[order]["97.5 %"] - spread[order]["2.5 %"])

    def span(order: str) -> str:
        high, least, most = (plain_number(spread[order][share]) for share in ("95 %", "2.5 %", "97.5 %"))
        return f"less than {high} g·mm (the middle 95 % between {least} and {most} g·mm) of"

    def rocks(size: float, order: str) -> str:
        return f"{_newton(size, speed_rpm, 'N·m')} of order {order} at {speed_key(speed_rpm)} rpm"

    of_largest = "their largest and the one that errors spread most" if largest == widest else "their largest"
    some = spread[largest]["95 %"] > NO_FORCE_G_MM
    left = f"{span(largest)} order {largest}, {of_largest}" if some else "no force"
    yield f"Of {study['samples']} engines drawn within the tolerances 95 % leave {left}."
    if largest != widest and spread[widest]["95 %"] > NO_FORCE_G_MM:
        yield f"Errors spread order {widest} most: 95 % leave {span(widest)} it."
    couple = rocking[worst]["95 %"]
    if couple > NO_COUPLE_G_MM2:
        yield f"95 % rock with a couple of less than {rocks(couple, worst)}, their largest."
    if late is not None:
        force, order = max((late["force_g_mm"][order], order) for order in late["orders"])
        couple, rocked = max((late["couple_g_mm2"][order], order) for order in late["orders"])
        remains = [f"{plain_number(force)} g·mm of order {order}"] if force > NO_FORCE_G_MM else []
        remains += [f"a couple of {rocks(couple, rocked)}"] if couple > NO_COUPLE_G_MM2 else []
        yield f"All shafts late by {late['deg']:g}° leave {' and '.join(remains) or 'nothing of their orders'}."


def _of_pairs(pairs: Sequence[Part], speed_rpm: float) -> Iterator[str]:
    for pair in pairs:
        if pair["scenarios"] is None:
            continue
        literal, order = pair["scenarios"]["literal"], pair["order"]
        left, physical = (_amount(reading["residual_along_g_mm"], speed_rpm) for reading in pair["scenarios"].values())
        if order == 1:
            yield f"The pair of order 1 as printed leaves {left}, less than its rounding can tell."
            continue
        sense = "too much" if literal["residual_along_g_mm"] < 0 else "too little"
        makes = f"{literal['overbalance']:.3f} times the force needed, {left} {sense}"
        as_force = f"with that over {order**2} it leaves {physical}"
        yield f"The pair of order {order} with the printed unbalance makes {makes}; {as_force}."


def _of_crankshaft(crankshaft: Part, speed_rpm: float) -> Iterator[str]:
    def size(amount: Part) -> float:
        return abs(complex(amount["x"], amount["y"]))

    static, dynamic = size(crankshaft["static_kg_mm"]), size(crankshaft["dynamic_kg_mm2"])
    planes, key = crankshaft["planes"], speed_key(speed_rpm)
    nearly = static < NEARLY_STATIC * max(size(plane["has_kg_mm"]) for plane in planes)
    state = "is in static balance within" if nearly else "has a static unbalance of"
    needs = [f"{plain_number(size(plane['correction_kg_mm']))} kg·mm in {plane['name']}" for plane in planes]
    couple = f"{dynamic:.5g} kg·mm² ({plain_number(crankshaft['couple_Nm_at_rpm'][key])} N·m at {key} rpm)"
    turns = f"a rocking couple of {couple} turns with it, which corrections of {' and '.join(needs)} would end"
    yield f"The crankshaft {state} {static * 1e3:.3g} g·mm; {turns}."
    if crankshaft["overbalance_kg_mm"] is not None:
        (least, most), by = crankshaft["overbalance_kg_mm"], crankshaft["overbalanced_by_kg_mm"]
        over = f"{plain_number(abs(by))} kg·mm too {'much' if by >= 0 else 'little'}"
        wanted = f"{least:g} to {most:g} too much are wanted for the balancing machine"
        yield f"Its counterweights have {over}; {wanted}: {'met' if crankshaft['overbalance_met'] else 'not met'}."


def single_causes(sheet: Part) -> Iterator[tuple[str, str, str, float, str | None]]:
    """Cause, axis, order, amount (g·mm over ω²) and class of the unbalance that single causes leave in one cylinder.

    ``sheet`` is the balance sheet of the engine; causes without data in it are left out.
    """
    built, rod, added = sheet["shafts"]["second_order_built_for_lambda"], sheet["rod_split"], sheet["added_mass"]
    offset, cranks = sheet["offset"], sheet["reverse_cranks"]
    if built is not None:
        yield "second-order pair built for λ, not A2", "along", "2", built["residual_along_g_mm"], None
    if rod is not None:
        for axis, key in (("along", "residual_along_g_mm"), ("across", "residual_across_g_mm")):
            for order, amount in rod[key].items():
                yield "rod as weighed, balanced as cut", axis, order, amount, None
    if added is not None:
        cause = f"{added['mass_g']:g} g that no shaft knows"
        for order, amount in list(added["residual_along_g_mm"].items())[:3]:
            yield cause, "along", order, amount, (added["class"] or "beyond all named") if order == "1" else None
    if offset is not None:
        cause = f"offset of {offset['offset_mm']:g} mm, shafts timed to crank"
        yield cause, "along", "1", offset["quadrature_along_g_mm"], None
    if cranks is not None:
        for series, text in (("exact", "exact"), ("leading", "built for λ")):
            yield f"direct and reverse cranks, {text}", "along", "all", cranks["residual_along_g_mm"][series], None


def _of_single_causes(sheet: Part, speed_rpm: float) -> Iterator[str]:
    """A sentence for each single cause with all that it leaves."""
    left: dict[str, list[str]] = {}
    for cause, axis, order, amount, grade in single_causes(sheet):
        which = "of all orders" if order == "all" else f"of order {order}"
        kept = "" if grade is None else f" (class: {grade})"
        left.setdefault(cause, []).append(f"{_amount(amount, speed_rpm)} {which} {axis} the cylinder{kept}")
    yield from (f"{cause}: {listed(amounts)}." for cause, amounts in left.items())


def _of_offset(offset: Part, speed_rpm: float) -> Iterator[str]:
    first, second = (f"{offset['couple_Nm_at_rpm'][speed_key(speed_rpm)][order]:.3g}" for order in "12")
    rephased = f"balance its order 1 if re-phased by {abs(offset['rephasing_deg']):.2f}°"
    couples = f"the couples of {first} and {second} N·m of orders 1 and 2"
    yield f"The shafts of an offset cylinder {rephased}, but not {couples}."


def _of_reverse_cranks(cranks: Part, speed_rpm: float) -> Iterator[str]:
    yield "Direct and reverse cranks leave nothing across the cylinder at any angle."
    if cranks["couple_g_mm2"] > 0:
        couple = f"{_newton(cranks['couple_g_mm2'], speed_rpm, 'N·m')} at {speed_key(speed_rpm)} rpm"
        yield f"Their wheels stand unevenly and leave a couple of {couple}."
    errors = cranks["tolerances"]
    if errors is not None:
        along, across = (_amount(errors[key]["1"]["95 %"], speed_rpm) for key in ("along_g_mm", "across_g_mm"))
        left = f"less than {along} of order 1 along the cylinder and {across} across it"
        yield f"Of sampled gear trains 95 % leave {left}."


def hinge_sentences(sheet: Part) -> list[str]:
    """Sentences on the side force of each mechanism of a hinge ``sheet`` without a hinge and with one."""
    sentences = []
    for mechanism in sheet["mechanisms"]:
        speed, without = max(mechanism["side_force_without_hinge_n"].items(), key=lambda item: float(item[0]))
        left, printed = (mechanism["side_force_n"][kind] for kind in ("potential", "printed"))
        pressed = f"the piston is pressed against its wall with up to {without:.4g} N at {float(speed):.4g} rpm"
        spring = f"a hinge that can be a spring leaves {left:.4g} N at every speed"
        other = f"(one after equation (6), whose work is not zero, {printed:.4g} N)"
        sentences.append(f"{mechanism['name']}: without a hinge {pressed}; {spring} {other}.")
    return sentences


_OF_PARTS: dict[str, Callable[[Any, float], Iterable[str]]] = {
    "plain": _of_plain,
    "roll_moment": _of_roll,
    "cycle": _of_cycle,
    "strategies": _of_strategies,
    "shafts": _of_shafts,
    "design": _of_designs,
    "tolerance": tolerance_sentences,
    "pairs": _of_pairs,
    "crankshaft": _of_crankshaft,
    "single_causes": _of_single_causes,
    "offset": _of_offset,
    "reverse_cranks": _of_reverse_cranks,
    "motion": _of_motion,
}
"""Sentences of each part of a sheet, in this sequence."""
