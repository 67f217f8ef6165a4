"""Pictures of an engine's balance: forces as they turn, against crank angle and by order; torque and loads; hinges."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import xarray as xr

from crankorder.engine import hinged_crank as hinged
from crankorder.engine.elastic_hinge import GUIDE_STEPS, Guides, Joint, hinge_guides, hinge_table
from crankorder.engine.forces import AXES, speed_key, unbalance_force_n
from crankorder.engine.hinged_crank import GuideData, HingedCrankData, HingedEngine
from crankorder.plot.drawing import Area, Box, Drawing, Panel, Stroke, Words
from crankorder.plot.palette import FAINT, GRID, INK, LINES, NORMAL, SMALL, WHITE, drawable, text_width_in
from crankorder.plot.reading import number_text, order_text
from crankorder.quantities import Complexes, Floats
from crankorder.report import balance_dataset as dataset
from crankorder.report import balance_panels as panels
from crankorder.report.balance_panels import LEFT, RIGHT, Chart, Curve, Polar
from crankorder.settings import ReportSettings

_ORDERS = "order, cycles per crank revolution"
_FROM_DEAD_CENTRE = "crank angle from top dead centre, °"


def system_color(name: str) -> str:
    """Colour of the system ``name`` in every picture; the plain engine is ink, and no two of one engine are alike."""
    if name in ("none", "own"):
        return INK if name == "none" else LINES[-1]
    return LINES[(list(dataset.SYSTEMS).index(name) - 1) % (len(LINES) - 1)]


def _at_highest_speed(balance: xr.Dataset) -> tuple[float, float]:
    """Highest speed (rpm), and newtons there of 1 g·mm over ω²."""
    speed = float(balance["speed"].values.max())
    return speed, float(unbalance_force_n(1.0, speed))


def force_figure(balance: xr.Dataset, *, title: str, settings: ReportSettings) -> Drawing:
    """Force along and across the cylinder against crank angle at the highest speed, before and after each balance.

    Below it the moments of several cylinders: rocking moments left, roll moment right. ``balance`` is the dataset
    (system, axis, order, crank_angle) of :func:`crankorder.report.balance_dataset.balance_dataset`, ``title`` that of
    the engine, ``settings`` are those of the report.
    """
    speed, per_omega = _at_highest_speed(balance)
    rows: list[list[Chart]] = []
    sets = {"Counterweights": dataset.COUNTERWEIGHTS, "Shafts": dataset.SHAFT_SETS}
    several = {text: names for text, every in sets.items() if len(names := dataset.present(balance, every)) > 1}
    for text, names in (several or {"Force": ["none"]}).items():
        newtons = per_omega * balance["curve"].sel(system=names)
        shown = {group[0]: dataset.called(group, balance) if several else "" for group in dataset.alike(newtons)}
        rows.append([])
        for axis, direction in zip(AXES, dataset.axis_names(balance), strict=True):
            curves = [
                Curve(values, system_color(name), shown[name], f"force-{axis}-{name}", 2.2 if name == "none" else 1.4)
                for name, values in zip(shown, newtons.sel(system=list(shown), axis=axis).values, strict=True)
            ]
            rows[-1].append(Chart(f"{text} · {direction}", "N", curves, _FROM_DEAD_CENTRE))
    if "moment" in balance:
        values = 1e-3 * per_omega * dataset.order_sum(balance["moment"].values, balance["crank_angle"].values)
        by_axis = dict(zip(balance["moment_axis"].values.tolist(), values, strict=True))
        moments = [
            Curve(by_axis[name], LINES[number], text, f"moment-{name}")
            for number, (name, text) in enumerate(
                (("Z", "about Z"), ("X", "about X"), ("Y", "about Y, the crankshaft"))
            )
        ]
        rocking = Chart("Rocking moments of the inertia forces", "N·m", moments[:2], _FROM_DEAD_CENTRE)
        roll = Chart("Roll moment of the masses on the engine block", "N·m", moments[2:], _FROM_DEAD_CENTRE)
        rows.append([rocking, roll])
    drawing = Drawing(settings.width_in, settings.height_in)
    for row, boxes in zip(rows, panels.boxes_of(drawing, len(rows), 2), strict=True):
        limit = 1.08 * max(float(np.abs(curve.values).max()) for chart in row for curve in chart.curves) or 1.0
        for chart, box in zip(row, boxes, strict=True):
            panels.draw_chart(drawing, box, chart, 360 * balance["crank_angle"].values, limit=limit)
    line = f"Force on the crankcase at {speed_key(speed)} rpm: {_in_words(balance, per_omega)}"
    return panels.headed(drawing, title, "force against crank angle", line, settings)


def _in_words(balance: xr.Dataset, per_omega: float) -> str:
    """Text with the peak force without balancing and the smallest residual with counterweights and with shafts."""
    along, across = (balance["curve"].sel(axis=axis).values for axis in AXES)
    most = per_omega * np.hypot(along, across).max(axis=1)
    newtons = dict(zip(map(str, balance["system"].values), most.tolist(), strict=True))
    if not newtons["none"]:
        return "none"
    plain = dataset.words_of("none", balance)[0].replace("no balancing", "without balancing")
    line = f"up to {number_text(newtons['none'])} N" + (f" {plain}" if len(newtons) > 1 else "")
    for kinds in (dataset.COUNTERWEIGHTS[1:4], dataset.SHAFT_SETS[1:]):
        if left := dataset.present(balance, kinds):
            best = min(left, key=lambda name: newtons[name])
            line += f", {number_text(newtons[best])} N with {dataset.called([best], balance)}"
    return line


def harmonics_figure(balance: xr.Dataset, *, title: str, settings: ReportSettings) -> Drawing:
    """Primary force, secondary force and their sum against crank angle at the highest speed, without any balancing.

    All orders together lie faintly behind them. Forces are positive away from the crankshaft: the piston pulls on its
    rod. ``balance`` is the dataset (system, axis, order, crank_angle) of
    :func:`crankorder.report.balance_dataset.balance_dataset`, ``title`` that of the engine, ``settings`` are those of
    the report. Source: Ruckle 2014, figure 7 (after Foale 2007).
    """
    speed, per_omega = _at_highest_speed(balance)
    plain, angle = balance.sel(system="none"), balance["crank_angle"].values
    shown = [axis for axis in AXES if np.abs(plain["force"].sel(axis=axis)).max() > 0] or ["Z"]
    drawing = Drawing(settings.width_in, 0.72 * settings.height_in)
    limit = 1.12 * per_omega * float(np.abs(plain["curve"]).max()) or 1.0
    parts = (("both", INK, 3.0, [1.0, 2.0]), ("primary", LINES[0], 1.3, [1.0]), ("secondary", LINES[1], 1.3, [2.0]))
    for axis, box in zip(shown, panels.boxes_of(drawing, 1, len(shown))[0], strict=True):
        every = per_omega * plain["curve"].sel(axis=axis).values
        curves = [Curve(every, FAINT, "all orders", f"all-{axis}", 5.5, 0.4)]
        for name, color, width, orders in parts:
            amplitudes = plain["force"].sel(axis=axis).where(balance["order"].isin(orders), 0).values
            curves.append(Curve(per_omega * dataset.order_sum(amplitudes, angle), color, name, f"{name}-{axis}", width))
        direction = dataset.axis_names(balance)[AXES.index(axis)]
        panels.draw_chart(drawing, box, Chart(direction, "N", curves, _FROM_DEAD_CENTRE), 360 * angle, limit=limit)
    first, second = (complex(plain["force"].sel(axis="Z", order=order).values) for order in (1.0, 2.0))
    ratio = "no secondary force." if first else "no primary force."
    if first and second:
        share = 100 * (second.real / first.real) if first.real else 0.0
        ratio = f"the secondary one adds {share:.3g} % at top dead centre and takes as much off at the bottom."
    line = f"Force of the moving masses at {speed_key(speed)} rpm, {dataset.words_of('none', balance)[0]}; {ratio}"
    return panels.headed(drawing, title, "primary and secondary", line, settings)


def order_bars_figure(balance: xr.Dataset, *, title: str, settings: ReportSettings) -> Drawing:
    """Amplitude of the force by order along and across the cylinder, and moments of several cylinders, as bars.

    Newtons (or N·m) at the highest speed at the left, the amount over squared crank speed at the right, both
    logarithmic. ``balance`` is the dataset (system, axis, order) of
    :func:`crankorder.report.balance_dataset.balance_dataset`, ``title`` that of the engine, ``settings`` are those of
    the report.
    """
    speed, per_omega = _at_highest_speed(balance)
    least = float(10 ** (-settings.dynamic_range_db / 20))  # of the largest, that a bar has
    tall = _tall_orders(balance, least)
    last = max([4.0, *tall[: settings.max_labelled_orders]])
    shown = balance.sel(order=slice(None, last))
    systems = [names for names in dataset.alike(balance["force"]) if balance["force"].sel(system=names[0]).any()]
    drawn = systems or [["none"]]
    forces = per_omega * np.abs(shown["force"].sel(system=[names[0] for names in drawn]).values)
    names = [name[0].upper() + name[1:] for name in dataset.axis_names(balance)]
    charts = [(name, "N", forces[:, row], drawn) for row, name in enumerate(names)]
    if "moment_by_system" in balance:
        rocking = dataset.alike(balance["moment_by_system"])
        moments = shown["moment_by_system"].sel(system=[names[0] for names in rocking]).values
        about_x, roll, about_z = 1e-3 * moments.swapaxes(0, 1)
        # the couple along Z and X as what turns with the crank and against it: the largest of the turn is their sum
        couple = (np.abs(about_x + 1j * about_z) + np.abs(about_x - 1j * about_z)) / 2
        charts.append(("Rocking couple, the most of a turn", "N·m", per_omega * couple, rocking))
        charts.append(("Roll moment of the masses", "N·m", per_omega * np.abs(roll), rocking))
    drawing = Drawing(settings.width_in, settings.height_in * (1.35 if len(charts) > 2 else 1.0))
    boxes = [box for (box,) in panels.boxes_of(drawing, len(charts), 1, right=1.0, gap=0.62)]
    orders = {float(order): order_text(order) for order in shown["order"].values}
    for number, ((name, unit, heights, groups), box) in enumerate(zip(charts, boxes, strict=True)):
        most = max(float(sizes.max()) for _, alike, sizes, _ in charts if alike == unit)
        low, high = (least * most, 4 * most) if most else (1e-3, 1.0)
        panel = Panel(drawing, box, (0.4, last + 0.6), (low, high), log_y=True)
        panel.y_axis(unit)
        factor, right = (per_omega, "g·mm") if unit == "N" else (1e-3 * per_omega, "g·mm²")
        over_omega = replace(panel, y=(low / factor, high / factor))
        over_omega.y_axis(f"over ω², {right}", grid=False, right=True)
        panels.draw_bars(panel, orders, list(heights), [system_color(names[0]) for names in groups], low)
        if not np.max(heights) > low:
            panel.note(f"no {'force' if unit == 'N' else 'moment'} of any order")
        drawing.add(Words(box[0], box[1] + box[3] + 0.08, name))
        if number in (0, 2) and len(groups) > 1:
            start = text_width_in(name, NORMAL) + 0.3
            key = [(dataset.called(names, balance), system_color(names[0])) for names in groups]
            panels.color_key(drawing, (box[0] + start, box[1], box[2] - start, box[3]), key)
    drawing.add(Words(boxes[-1][0] + boxes[-1][2] / 2, 0.2, _ORDERS, along="centre"))
    line = f"Amplitude at {speed_key(speed)} rpm. Bars below {100 * least:.1g} % of the largest are left out."
    line += f" So are orders above {last:g}." if tall and tall[-1] > last else ""
    idle = [str(name) for name in balance["system"].values if not any(name in names for names in systems)]
    line += f" No force: {dataset.called(idle, balance)}." if idle else ""
    return panels.headed(drawing, title, "force by order", line, settings)


def _tall_orders(balance: xr.Dataset, least: float) -> list[float]:
    """Orders at which a force or a moment is above its share ``least`` of the largest, ascending."""
    sizes = [abs(balance[name]) for name in ("force", "moment_by_system") if name in balance]
    high = [(size > least * size.max()).any(set(size.dims) - {"order"}).values for size in sizes]
    return [float(order) for order in balance["order"].values[np.any(high, axis=0)]]


_TURNS = {
    "with crank": "turns with the crank", "against crank": "turns against the crank", "line": "swings to and fro",
    "none": "",
}  # fmt: skip


def polar_figure(balance: xr.Dataset, *, title: str, settings: ReportSettings) -> Drawing:
    """Curve that the force draws during a revolution at the highest speed, for each way of balancing, to one scale.

    Counterweights come twice: by the first harmonic alone, whose curves are ellipses, and by all harmonics together.
    Up is along the cylinder, right is across it, to the side that the crank turns to; the crank turns clockwise.
    ``balance`` is the dataset (system, axis, order, crank_angle) of
    :func:`crankorder.report.balance_dataset.balance_dataset`, ``title`` that of the engine, ``settings`` are those of
    the report.
    """
    speed, per_omega = _at_highest_speed(balance)
    angle, system = balance["crank_angle"].values, balance["system"].values.tolist()
    along, across = dataset.order_sum(balance["force"].sel(order=[1.0]).values, angle).swapaxes(0, 1)
    first, whole = along + 1j * across, balance["curve"].sel(axis="Z") + 1j * balance["curve"].sel(axis="X")
    frame = panels.frame_around(max(float(np.abs(per_omega * curves).max()) for curves in (first, whole.values)))

    def diagrams(names: Sequence[str], curves: Complexes) -> list[Polar]:
        polars = []
        for name in dataset.present(balance, names):
            curve, turns = per_omega * curves[system.index(name)], balance["rotation"].sel(system=name).item()
            most = float(np.abs(curve).max())
            head = dataset.words_of(name, balance) if len(system) > 1 else ("force", "")
            reach = f"up to {number_text(most)} N" if most > dataset.NO_FORCE * frame else "no force"
            polars.append(Polar(curve, system_color(name), frame, (*head, reach, _TURNS[turns])))
        return polars

    rows = [("first harmonic alone", diagrams(dataset.COUNTERWEIGHTS, first))] if along.any() or across.any() else []
    rows.append(("all harmonics", diagrams(dataset.COUNTERWEIGHTS, whole.values)))
    rows.append(("shafts, all harmonics", diagrams(dataset.SHAFT_SETS[1:], whole.values)))
    if "moment" in balance:
        about_x, _, about_z = 1e-3 * per_omega * dataset.order_sum(balance["moment"].values, angle)
        moment = about_z + 1j * about_x
        most = float(np.abs(moment).max())
        limit = panels.frame_around(most)
        reach = [f"up to {number_text(most)} N·m", f"its axis; the frame is ±{number_text(limit)} N·m"]
        captions = ["rocking moment", "", *(reach if most else ("no moment", ""))]
        rows[-2][1].append(Polar(moment, LINES[1], limit, captions))
    rows = [row for row in rows if row[1]]
    drawing, boxes = panels.polar_grid([row for _, row in rows], settings, widest=4.4)
    for (text, _), row in zip(rows, boxes, strict=True):
        drawing.add(Words(0.42, row[0][1] + row[0][3] / 2, text, bold=True, along="centre", upward=True))
    _crank_sense(drawing, boxes[0][0])
    up, right = dataset.axis_names(balance)
    line = f"Up {up}, right {right}; dots mark top dead centre. {speed_key(speed)} rpm; the frame is "
    return panels.headed(drawing, title, "polar diagrams", f"{line}±{number_text(frame)} N.", settings)


def _crank_sense(drawing: Drawing, box: Box) -> None:
    """Arrow in the upper left corner of a polar diagram in the sense of rotation of the crank."""
    centre = np.array([box[0] + 0.29, box[1] + box[3] - 0.33])
    turn = np.radians(np.linspace(150, 30, 20))
    arc = centre + 0.2 * np.column_stack([np.cos(turn), np.sin(turn)])
    drawing.add(Stroke(arc[:-2], FAINT, 1.0))
    panels.arrow_head(drawing, arc[-4], arc[-1], FAINT)
    drawing.add(Words(float(centre[0]), float(centre[1]), "crank", SMALL - 1, FAINT, along="centre"))


def torque_figure(cycle: xr.Dataset, turning: Mapping[str, Any], *, title: str, settings: ReportSettings) -> Drawing:
    """Turning moment of gas and masses against crank angle at the highest speed, and both by order side by side.

    ``cycle`` is the dataset (speed, crank_angle) of :func:`crankorder.report.balance_dataset.cycle_dataset`,
    ``turning`` the part of the balance sheet by speed, ``title`` that of the engine, ``settings`` are those of the
    report.
    """
    drawing = Drawing(settings.width_in, settings.height_in)
    speed = float(cycle["speed"].values.max())
    moment, shown = turning[speed_key(speed)], cycle.sel(speed=speed)
    gas, masses = shown["gas_torque"].values, shown["inertia_torque"].values
    curves, kinds = [Curve(masses, LINES[0], "masses")], {"inertia_n_m": LINES[0]}
    if gas.any():  # the sum lies below the others: where it is alike with one of them both are seen
        curves = [Curve(gas + masses, INK, "together", width=3.0), Curve(gas, LINES[1], "gas"), *curves]
        kinds = {"gas_n_m": LINES[1], **kinds}
    (above,), (below,) = panels.boxes_of(drawing, 2, 1)
    panel = panels.draw_chart(drawing, above, Chart("", "N·m", curves), shown["crank_angle"].values)
    if moment["power_w"] is not None:
        panel.curve(np.array(panel.x), np.full(2, moment["mean_n_m"]), color=INK, width=0.9, dashes=(4.0, 3.0))
    heights = np.array([[of_order[kind] for of_order in moment["by_order"].values()] for kind in kinds])
    largest = float(heights.max(initial=0.0))
    tall = np.flatnonzero(heights.max(axis=0) > 1e-3 * largest)[:12]
    names = list(moment["by_order"])
    panel = Panel(drawing, below, (-0.6, max(len(tall), 6) - 0.4), (0.0, 1.15 * largest or 1.0))
    panel.y_axis("N·m, amplitude")
    orders = {float(place): names[at] for place, at in enumerate(tall)}
    panels.draw_bars(panel, orders, list(heights[:, tall]), list(kinds.values()), 0.0)
    drawing.add(Words(below[0] + below[2] / 2, below[1] - 0.36, _ORDERS, along="centre"))
    ends = f"{number_text(moment['least_n_m'])} to {number_text(moment['peak_n_m'])} N·m"
    mean = "" if moment["power_w"] is None else f"; mean {number_text(moment['mean_n_m'])} N·m (dashed)"
    swing = moment["speed_fluctuation"]
    swings = "" if swing is None else f"; the speed swings by {number_text(100 * swing)} %"
    line = f"Torque on the crank at {speed_key(speed)} rpm, {ends}{mean}{swings}."
    return panels.headed(drawing, title, "turning moment", line, settings)


def loads_figure(cycle: xr.Dataset, *, title: str, settings: ReportSettings) -> Drawing:
    """Loads at the highest speed: the first cylinder's against crank angle, and every main bearing's as polar diagrams.

    ``cycle`` is the dataset (speed, cylinder, direction, crank_angle), with loads, of
    :func:`crankorder.report.balance_dataset.cycle_dataset`, ``title`` that of the engine, ``settings`` are those of the
    report.
    """
    speed = float(cycle["speed"].values.max())
    shown = cycle.sel(speed=speed)
    first = shown.isel(cylinder=0)
    loads = {"crank pin of cylinder 0": first["crank_pin_load"].values}
    if "main_bearing_load" in shown:
        for place, (x, z) in zip(shown["bearing"].values, shown["main_bearing_load"].values, strict=True):
            loads[f"main bearing at {1e3 * float(place):.4g} mm".replace("-", "−")] = np.stack([z, x])
    peaks = [float(np.hypot(*load).max()) for load in loads.values()]
    of_pin, of_bearings = panels.frame_around(peaks[0]), panels.frame_around(max(peaks[1:], default=0.0))
    polars = []
    for number, ((name, load), peak) in enumerate(zip(loads.items(), peaks, strict=True)):
        closed = np.append(load, load[:, :1], axis=1)
        ways, limit = ("up: Z, right: X", of_bearings) if number else ("up: along the cylinder, right: across", of_pin)
        captions = (name, f"up to {number_text(peak)} N; {ways}")
        polars.append(Polar(closed[0] + 1j * closed[1], LINES[number % len(LINES)], limit, captions))
    rows = [polars[at : at + 3] for at in range(0, len(polars), 3)]
    above = 4.3  # for the curves
    drawing, _ = panels.polar_grid(rows, settings, widest=3.2, above=above)
    crank_pin, piston_pin = (np.hypot(*first[name].values) for name in ("crank_pin_load", "piston_pin_load"))
    pins = [Curve(crank_pin, LINES[0], "crank pin"), Curve(piston_pin, LINES[1], "piston pin")]
    if np.allclose(crank_pin, piston_pin, rtol=1e-6):  # the file gives the rod no mass of its own
        pins = [Curve(crank_pin, LINES[0], "crank pin and piston pin alike")]
    pins.append(Curve(first["wall_load"].values, LINES[len(pins)], "wall, in the crank's way"))
    box = (LEFT, drawing.height_in - above + 0.6, settings.width_in - LEFT - RIGHT, 2.6)
    panels.draw_chart(drawing, box, Chart("", "N, cylinder 0", pins), shown["crank_angle"].values)
    line = f"At {speed_key(speed)} rpm; dots mark crank angle 0; frames are ±{number_text(of_pin)} N for the pin"
    line += "." if len(peaks) == 1 else f", ±{number_text(of_bearings)} N for the main bearings."
    return panels.headed(drawing, title, "loads", line, settings)


_ANGLES = np.arange(361) / 360


def hinge_figure(
    engine: HingedEngine, mechanism: HingedCrankData, speeds_rpm: tuple[float, ...], *, settings: ReportSettings
) -> Drawing:
    """Crank torque, side force without and with hinge, M12, and the moments of both hinges, for one mechanism.

    ``engine`` is the engine whose torque drives it, ``mechanism`` one of its mechanisms; each of ``speeds_rpm``, crank
    speeds [rpm] above 0, has a line. ``settings`` are those of the report.
    """
    crank, curve = mechanism.crank, engine.curve

    def by_speed(name: str, values: Callable[..., Floats], **how: Any) -> list[Curve]:
        drawn = [values(_ANGLES, crank, curve, speed_rpm=speed, **how) for speed in speeds_rpm]
        looks = [(LINES[n % len(LINES)], f"{speed:.0f} rpm", f"{name}-{n}") for n, speed in enumerate(speeds_rpm)]
        return [Curve(line, *look) for line, look in zip(drawn, looks, strict=True)]

    def of_hinge(_: Floats, *torque: Any, **how: Any) -> Floats:
        return hinge_table(*torque, **how).moment_nm

    left, hinges = [], {"printed": ("after equation (6)", LINES[1]), "potential": ("of a spring, without work", INK)}
    for kind, (text, color) in hinges.items():
        force = hinged.side_force(_ANGLES, crank, curve, pin_hinge=kind)  # type: ignore[arg-type]  # a Literal, by its text
        most = f"{text}: up to {number_text(float(np.abs(force).max()))} N"
        left.append(Curve(force, color, most, f"side-force-{kind}"))
    torque = [
        Curve(hinged.crank_torque(_ANGLES, curve), INK, "whole", "torque"),
        Curve(hinged.potential_torque(_ANGLES, curve), LINES[0], "without its mean", "torque-potential", 0.9),
    ]
    between = by_speed("m12-full", hinged.hinge_moment, pin_hinge="full")
    for line in by_speed("m12-printed", hinged.hinge_moment, pin_hinge="printed"):
        between.append(line._replace(text="", width=2.2, alpha=0.6, dashes=(3.0, 2.0)))
    charts = (
        Chart("Crank torque, and its part without work", "N·m", torque),
        Chart("Side force without a hinge, R430 (5)", "N", by_speed("side-force", hinged.side_force_without_hinge)),
        Chart("Side force that a hinge leaves, R43 (7)", "N", left),
        Chart("Moment between crank and rod, M12 (4); dashed (6)", "N·m", between),
        Chart("Hinge at the crank pin (a spring)", "N·m", by_speed("pin", of_hinge, joint="pin"), "hinge angle, °"),
        Chart("Hinge between strut and crank (a spring)", "N·m", by_speed("strut", of_hinge, joint="strut")),
    )
    drawing = Drawing(settings.width_in, 1.38 * settings.height_in)
    boxes = [box for row in panels.boxes_of(drawing, 3, 2) for box in row]
    drawn = [panels.draw_chart(drawing, box, chart, 360 * _ANGLES) for chart, box in zip(charts, boxes, strict=True)]
    _mark_torque(drawn[0], curve.mean_nm, *hinged.torque_extrema(curve))
    subtitle = f"{drawable(engine.title, 2 * settings.max_name_characters)}. At a constant crank speed."
    return panels.headed(drawing, mechanism.name, "elastic hinges", subtitle, settings)


def _mark_torque(panel: Panel, mean_nm: float, angles_rev: Floats, torques_nm: Floats) -> None:
    """Mean and extrema of the crank torque."""
    panel.curve(np.array(panel.x), np.full(2, mean_nm), color=LINES[1], width=0.9)
    right, level = panel.at(356.0, mean_nm)[0]
    mean = f"mean {number_text(mean_nm)} N·m"
    panel.drawing.add(Words(right, level + 0.04, mean, SMALL, LINES[1], along="right"))
    panel.rings(360 * angles_rev, torques_nm, color=INK, radius=1.5)
    for (x, y), torque in zip(panel.at(360 * angles_rev, torques_nm), torques_nm, strict=True):
        shift = 0.07 if torque > mean_nm else -0.19
        panel.drawing.add(Words(x, y + shift, number_text(float(torque)), SMALL, along="centre"))


def guide_figure(
    engine: HingedEngine, mechanism: HingedCrankData, speed_rpm: float, *, settings: ReportSettings
) -> Drawing:
    """Guides of the hinges of a mechanism that has them, to scale, with spring and rollers (document 003, figure 7).

    ``engine`` is the engine whose torque drives it, ``mechanism`` one of its mechanisms, with guides; ``speed_rpm`` is
    the crank speed [rpm], above 0, for which they are designed. ``settings`` are those of the report.
    """
    side = (settings.width_in - 0.6) / 2 - 0.5
    drawing = Drawing(settings.width_in, side + 1.75)
    stated = zip(get_args(Joint), (mechanism.pin_guides, mechanism.strut_guides), strict=True)
    for number, (joint, data) in enumerate((joint, data) for joint, data in stated if data is not None):
        table = hinge_table(mechanism.crank, engine.curve, joint=joint, speed_rpm=speed_rpm, n_steps=GUIDE_STEPS)
        guides = hinge_guides(table, data)
        left = 0.3 + number * (side + 0.5)
        _draw_guides(drawing, (left, 0.2, side, side), guides, data)
        place = "at the crank pin" if joint == "pin" else "between strut and crank"
        drawing.add(Words(left + side / 2, side + 0.62, f"Hinge {place}", bold=True, along="centre"))
        cut = "sharper than the roller: it cannot be cut" if guides.undercut else "the roller reaches every point"
        text = f"spring {number_text(1e-3 * guides.stiffness_n_per_m)} N/mm, steepest {guides.steepest_deg:.0f}°; {cut}"
        drawing.add(Words(left + side / 2, side + 0.42, text, SMALL + 0.5, along="centre"))
    line = f"For {speed_rpm:.0f} rpm. Shaded: the guides, to scale; the spring between them is shown at four angles."
    return panels.headed(drawing, mechanism.name, "guides of the elastic hinges", line, settings)


def _draw_guides(drawing: Drawing, box: Box, guides: Guides, data: GuideData) -> None:
    """Both guides shaded, the rollers' paths faint, and the spring at four angles."""
    limit = 1.14 * float(np.abs(guides.outer_m).max())
    panel = Panel(drawing, box, (-limit, limit), (-limit, limit))
    turn = np.exp(2j * np.pi * guides.hinge_angle_rev)
    for outline in (np.concatenate([limit / 1.01 * turn, guides.outer_m[::-1]]), guides.inner_m):
        drawing.add(Area(panel.at(outline.real, outline.imag), GRID))
    for surface in (guides.outer_m, guides.inner_m):
        panel.curve(surface.real, surface.imag, color=INK, name="guide")
    paths = np.array([(data.middle_radius_m + sign * guides.length_m / 2) * turn for sign in (1, -1)])
    for path in paths:
        panel.curve(path.real, path.imag, color=FAINT, width=0.7, dashes=(4.0, 3.0))
    quarter, radius = len(turn) // 4, 72 * data.roller_radius_m * box[2] / (2 * limit)
    for ends in paths[:, quarter // 3 + quarter * np.arange(4)].T:
        spring = _spring(*ends)
        panel.curve(spring.real, spring.imag, color=LINES[1], width=1.0)
        panel.rings(ends.real, ends.imag, color=WHITE, radius=radius)
        panel.rings(ends.real, ends.imag, color=LINES[1], radius=radius, width=1.3)
    x, y = panel.at(0.0, 0.0)[0]
    drawing.add(Words(x, y, "+", NORMAL + 2, along="centre", across="centre"))
    dial = 0.93 * limit * np.exp(1j * np.radians(np.arange(0, 360, 30)))
    for number, (x, y) in enumerate(panel.at(dial.real, dial.imag)):
        drawing.add(Words(x, y, f"{30 * number}°", SMALL, FAINT, along="centre", across="centre"))


def _spring(outer: complex, inner: complex) -> Complexes:
    """Zigzag line of a spring from ``inner`` to ``outer``."""
    share = np.linspace(0, 1, 25)
    across = 1j * (outer - inner) / abs(outer - inner) * 0.011
    sway = np.where((share > 0.1) & (share < 0.9), np.where(np.arange(25) % 2, 1, -1), 0)
    return np.asarray(inner + share * (outer - inner) + sway * across)
