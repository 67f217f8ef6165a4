"""Motion of modes in a run-up: error against time, by samples in a polynomial and samples of the forces.

Usage: python benchmarks/modal_integration.py [--repeats N]
Writes `reports/speed-error/modal-integration.{json,md,png}`. One core; machines are shared and noisy: read the ratios.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from published import publish, table
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete, lfilter, lsim

from crankorder.synth.driven import (
    STENCILS,
    ForceLines,
    Integration,
    advance,
    driven_signal,
    force_at,
    integration_for,
    interpolation_error,
    step_weights,
)
from crankorder.synth.motion import Motion
from crankorder.synth.poles import Poles, Structure, low_pass, poles_of

SUBSTEPS = (1, 2, 4, 8)
RATES_HZ = (51_200.0, 5_120.0)
DOP853 = (1e-3, 1e-6, 1e-9)
TOLERANCES = (1e-3, 1e-6, 1e-9, 1e-12)
SECONDS = 1.0
MODES_HZ = np.array([60.0, 115.0, 180.0, 240.0, 400.0, 700.0, 1200.0, 1900.0])
DAMPING = np.full(8, 0.03)
ORDERS = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 8.0, 10.0])
ROUND_OFF = 3e-14
"""Error over peak at which a curve ends: less is rounding."""
RNG = np.random.default_rng(1)
DRIVE = RNG.normal(size=(8, 6))
SENSOR = 0.01 * RNG.normal(size=(8, 1))
AMPLITUDE = np.zeros((6, 10), dtype=complex)
AMPLITUDE[:3] = RNG.normal(size=(3, 10)) * np.exp(2j * np.pi * RNG.random((3, 10))) / ORDERS
LINES = ForceLines(
    order=ORDERS,
    amplitude=AMPLITUDE,
    at_speed_rpm=np.full(10, 1000.0),
    exponent=np.full(10, 2.0),
    inertia=np.ones(10, dtype=bool),
    gas=np.zeros(10, dtype=bool),
    cause=("benchmark",) * 10,
)
STRUCTURE = Structure(
    frequency_hz=MODES_HZ, damping_ratio=DAMPING, sensor_per_kg=SENSOR, drive=DRIVE, rigid_body_per_kg=np.zeros((1, 6))
)
POLES = poles_of(STRUCTURE)
MOTION = Motion(start_rev=0.0, corners=((0.0, 300.0), (SECONDS, 6000.0)))


def forces(rate_hz: float, substeps: int, margin: int) -> np.ndarray:
    """Forces (axis, sample) of the run-up from ``margin`` samples before to ``margin`` behind it, none before it."""
    n = round(SECONDS * rate_hz) * substeps
    return force_at(LINES, *MOTION.at(np.arange(-margin, n + margin) / (rate_hz * substeps), piece=1))


def ours(rate_hz: float, integration: Integration, poles: Poles = POLES) -> np.ndarray:
    """The run-up from rest, forces included."""
    force = forces(rate_hz, integration.substeps, integration.stencil // 2)
    rest = np.zeros(poles.pole_per_s.size, dtype=complex)
    growth, taps = step_weights(poles.pole_per_s, 1 / (rate_hz * integration.substeps), integration)
    return advance(poles, force, growth=growth, taps=taps, integration=integration, state=rest)[0][0]


def stairs(rate_hz: float, substeps: int) -> np.ndarray:
    """The same by one recursive filter of SciPy for each mode, the force of a step being that of its first sample."""
    modal = DRIVE @ forces(rate_hz, substeps, 0)
    signal = np.zeros(modal.shape[1])
    for omega, damping, sensor, push in zip(2 * np.pi * MODES_HZ, DAMPING, SENSOR[:, 0], modal, strict=True):
        mode = ([sensor, 0.0, 0.0], [1.0, 2 * damping * omega, omega**2])
        above, below, _ = cont2discrete(mode, 1 / (rate_hz * substeps), "zoh")
        signal += lfilter(above[0], below, push)
    return signal[::substeps]


def straight(rate_hz: float, substeps: int) -> np.ndarray:
    """The same by SciPy's `lsim`, all modes one system, forces straight from sample to sample."""
    omega, no = 2 * np.pi * MODES_HZ, np.zeros((8, 8))
    a = np.block([[no, np.eye(8)], [-np.diag(omega**2), -2 * np.diag(DAMPING * omega)]])
    b = np.concatenate([np.zeros((8, 3)), DRIVE[:, :3]])
    c = SENSOR.T @ a[8:]
    force = forces(rate_hz, substeps, 0)[:3].T
    times = np.arange(force.shape[0]) / (rate_hz * substeps)
    return lsim((a, b, c, SENSOR.T @ DRIVE[:, :3]), force, times)[1][::substeps]


def stepped(rate_hz: float, tolerance: float) -> np.ndarray:
    """The same by `solve_ivp`, method DOP853, which knows nothing of modes."""
    omega = 2 * np.pi * MODES_HZ
    damping, stiffness = 2 * DAMPING * omega, omega**2

    def rates(now: float, state: np.ndarray) -> np.ndarray:
        speed = state[8:]
        return np.concatenate([speed, DRIVE @ at(now) - damping * speed - stiffness * state[:8]])

    def at(now: float) -> np.ndarray:
        return force_at(LINES, *MOTION.at(np.array([now]), piece=1))[:, 0]

    times = np.arange(round(SECONDS * rate_hz)) / rate_hz
    solved = solve_ivp(
        rates, (0, times[-1]), np.zeros(16), method="DOP853", t_eval=times, rtol=tolerance, atol=tolerance * 1e-6
    )
    q, speed = solved.y[:8], solved.y[8:]
    modal = DRIVE @ force_at(LINES, *MOTION.at(times, piece=1))
    return SENSOR[:, 0] @ (modal - damping[:, None] * speed - stiffness[:, None] * q)


def best_seconds(works: list[Callable[[], object]], repeats: int) -> list[float]:
    """Least time of each of ``works`` in ``repeats`` rounds, in turn: all meet the same neighbours."""
    best = [np.inf] * len(works)
    for _ in range(repeats):
        for number, work in enumerate(works):
            start = time.perf_counter()
            work()
            best[number] = min(best[number], time.perf_counter() - start)
    return best


def at_rate(rate_hz: float, repeats: int) -> dict[str, list[dict[str, float | str]]]:
    """Error and time of every way at one rate, by family."""
    exact = ours(rate_hz, Integration(12, 32))
    unit = 1e9 / (round(SECONDS * rate_hz) * MODES_HZ.size)
    ways: dict[str, list[tuple[str, Callable[[], np.ndarray]]]] = {
        f"ours, substeps {m}": [(str(s), lambda s=s, m=m: ours(rate_hz, Integration(s, m))) for s in STENCILS]
        for m in SUBSTEPS
    }
    ways["lfilter, stairs"] = [(str(m), lambda m=m: stairs(rate_hz, m)) for m in SUBSTEPS]
    ways["lsim, straight lines"] = [(str(m), lambda m=m: straight(rate_hz, m)) for m in SUBSTEPS]
    ways["solve_ivp, DOP853"] = [(f"{tolerance:g}", lambda t=tolerance: stepped(rate_hz, t)) for tolerance in DOP853]
    found = {}
    for family, members in ways.items():
        seconds = best_seconds(
            [work for _, work in members],
            1 if family.startswith("solve") else min(repeats, 3) if family.startswith("lsim") else repeats,
        )
        found[family] = [
            {
                "what": what,
                "error": float(np.abs(work() - exact).max() / np.abs(exact).max()),
                "ns_per_sample_and_mode": round(spent * unit, 2),
            }
            for (what, work), spent in zip(members, seconds, strict=True)
        ]
    return found


def whole(repeats: int) -> dict[str, float]:
    """Seconds for a whole run-up of 3 million samples, forces, three channels and eight modes, start included."""
    structure = Structure(
        frequency_hz=MODES_HZ,
        damping_ratio=DAMPING,
        sensor_per_kg=RNG.normal(size=(8, 3)),
        drive=DRIVE,
        rigid_body_per_kg=np.zeros((3, 6)),
    )
    motion = Motion(start_rev=0.0, corners=((0.0, 300.0), (58.0, 6000.0)))
    how = {"rate_hz": 51_200.0, "n_samples": 3_000_000}
    cases = {"no filter": poles_of(structure), "8-pole filter": poles_of(structure, low_pass(8, 20_000.0))}
    works = [lambda poles=poles: driven_signal(poles, [(LINES, motion)], **how) for poles in cases.values()]
    return {name: round(spent, 2) for name, spent in zip(cases, best_seconds(works, min(repeats, 3)), strict=True)}


def measured(repeats: int) -> dict[str, object]:
    """Errors and times at each rate, what a tolerance chooses, and whole runs."""
    chosen = []
    for rate_hz in RATES_HZ:
        for tolerance in TOLERANCES:
            way = integration_for(1000.0, rate_hz, tolerance)
            phase = 2 * np.pi * 1000.0 / (rate_hz * way.substeps)
            exact = ours(rate_hz, Integration(12, 32))
            error = float(np.abs(ours(rate_hz, way) - exact).max() / np.abs(exact).max())
            bound = interpolation_error(way.stencil, phase)
            row = {"stencil": way.stencil, "substeps": way.substeps, "bound": bound, "error_over_peak": error}
            chosen.append({"rate_hz": rate_hz, "tolerance": tolerance} | row)
    return {
        "what": f"a run-up from 300 to 6000 rpm in {SECONDS:g} s, ten orders up to 10 (1000 Hz at the end) along three "
        "axes, eight modes of 60 to 1900 Hz; times are for one core and include the forces",
        "by_rate_hz": {f"{rate_hz:g}": at_rate(rate_hz, repeats) for rate_hz in RATES_HZ},
        "chosen": chosen,
        "seconds_for_3_million_samples": whole(repeats),
    }


def drawn(found: dict) -> Figure:
    """Error against time at both rates, ours in colour, SciPy's in grey, what a tolerance of 1e-9 takes starred."""
    figure = Figure(figsize=(15, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, (rate, families) in zip(panels, found["by_rate_hz"].items(), strict=True):
        _families(axes, families)
        star = next(row for row in found["chosen"] if f"{row['rate_hz']:g}" == rate and row["tolerance"] == 1e-9)
        place = families[f"ours, substeps {star['substeps']}"] if star["substeps"] in SUBSTEPS else None
        if place is not None:
            point = place[STENCILS.index(star["stencil"])]
            at = (point["ns_per_sample_and_mode"], point["error"])
            axes.plot(*at, "*", color="C3", ms=20, mec="k", zorder=5)
        samples = float(rate) / 1000
        axes.set(xscale="log", yscale="log", xlabel="time per sample and mode [ns], one core, forces included")
        axes.set_title(f"{float(rate) / 1000:g} kHz: {samples:.0f} samples to a period of the fastest force")
        axes.axhline(1e-8, color="k", ls=":", lw=1)
        axes.grid(alpha=0.3)
    panels[0].set(ylabel="largest error / peak of the run-up", ylim=(3e-16, 1), xlim=(5, 1e6))
    panels[0].text(9e5, 1.3e-8, "asked for: 1e-8", fontsize=9, va="bottom", ha="right")
    panels[1].text(6.0, 1e-10, "2 … 12:\nsamples\nin the\npolynomial", color="C0", fontsize=9, va="top")
    figure.suptitle(
        "Down and left is better: modes taken exactly reach round-off for what a plain recursive filter costs"
    )
    lines, names = panels[0].get_legend_handles_labels()
    star = panels[0].plot([], [], "*", color="C3", ms=14, mec="k", ls="none")[0]
    panels[0].legend([*lines, star], [*names, "ours, chosen for a tolerance of 1e-9"], fontsize=9, loc="lower right")
    return figure


def _families(axes: Axes, families: dict) -> None:
    greys = iter(("s", "v", "D"))
    for number, (family, points) in enumerate(families.items()):
        above = 1 + int(np.argmax([*(point["error"] < ROUND_OFF for point in points), True]))  # ends at round-off
        spent = [point["ns_per_sample_and_mode"] for point in points][:above]
        error = [point["error"] for point in points][:above]
        if not family.startswith("ours"):
            axes.plot(spent, error, marker=next(greys), ms=5, label=f"SciPy {family}", color="0.45", ls="--")
            continue
        substeps = family.split()[-1]
        label = f"ours, {substeps} force sample{'s' * (substeps != '1')} per output sample"
        axes.plot(spent, error, "o-", ms=4.5, label=label, color=("C0", "C2", "C1", "C4")[number])
        if number == 0:
            for point, x, y in zip(points, spent, error, strict=False):
                axes.annotate(
                    point["what"], (x, y), (-11, 0), textcoords="offset points", ha="right", va="center", fontsize=8
                )


def page(found: dict) -> str:
    """The same numbers as a page of tables."""
    whole = found["seconds_for_3_million_samples"]
    lines = [
        "# Motion of modes under order forces: error against time",
        "Made by `python benchmarks/modal_integration.py`; do not edit.",
        "![error against time](modal-integration.png)",
        f"{found['what'][0].upper()}{found['what'][1:]}. Numbers at the first curve: samples in the polynomial "
        "(stencil).",
        f"A whole run-up of 3 million samples, three channels, takes **{whole['no filter']:g} s**, with an 8-pole "
        f"anti-alias filter {whole['8-pole filter']:g} s.",
        "A mode is taken exactly, only the forces are a polynomial between samples: more samples in the polynomial "
        "cost next to nothing, more samples of the forces cost what the forces cost. SciPy's filters stay at the first "
        "or second order in the step, and `solve_ivp` takes some thousand times as long.",
        "## What a tolerance takes (`integration_for`), and what it reaches",
        table(
            ["rate", "tolerance", "stencil", "substeps", "bound of the fastest force", "error over peak"],
            [
                [
                    f"{row['rate_hz']:g} Hz",
                    f"{row['tolerance']:g}",
                    row["stencil"],
                    row["substeps"],
                    f"{row['bound']:.0e}",
                    f"{row['error_over_peak']:.0e}",
                ]
                for row in found["chosen"]
            ],
        ),
    ]
    for rate, families in found["by_rate_hz"].items():
        lines.append(f"## Error over peak, and time per sample and mode [ns], at {rate} Hz")
        for heading, own in (("stencil", True), ("", False)):
            some = {name: points for name, points in families.items() if name.startswith("ours") == own}
            for group in [some] if own else [{name: points} for name, points in some.items()]:
                whats = [point["what"] for point in next(iter(group.values()))]
                lead = heading or ("tolerance" if "solve" in next(iter(group)) else "force samples per output sample")
                lines.append(table([lead, *whats], [[name, *map(_cell, points)] for name, points in group.items()]))
    return "\n\n".join(lines) + "\n"


def _cell(point: dict) -> str:
    return f"{point['error']:.0e}, {point['ns_per_sample_and_mode']:.3g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=40)
    found = measured(parser.parse_args().repeats)
    publish("modal-integration", found, page(found), drawn(found))


if __name__ == "__main__":
    main()
