"""Orders through random structures, as complex amplitudes over the speeds: an exactly known truth for modal fits."""

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.identify.crossings import crossings
from crankorder.identify.found import AgreedOrder, Crossing, ModalFit, SpeedVerdicts
from crankorder.identify.modes.joint_fit import modal_fit
from crankorder.identify.modes.order_responses import Block, Rows
from crankorder.identify.speeds_to_avoid import speeds_to_avoid
from crankorder.settings import load_settings
from made.found_lines import line
from made.order_amplitudes import modal_responses, order_map_of

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

CHANNELS = ("X", "Y", "Z")


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnOrder:
    """An order whose force is (``still`` + (s / s_max)^``power``) e^{i ``turn`` s / s_max}, direct and by the modes.

    ``rigid`` (channels,) is what it adds beside the modes, ``residue`` (channels, modes) what each mode makes of it.
    """

    order: float
    still: float
    power: float
    turn: float
    rigid: Complex
    residue: Complex


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnMachine:
    """Modes of ``natural_hz`` and ``damping`` (M,), held at ``speed_rpm`` (K,), driven by ``orders``.

    Every complex amplitude errs by ``error`` per part; the force of an order varies from speed to speed by ``scatter``.
    """

    natural_hz: Array
    damping: Array
    speed_rpm: Array
    orders: tuple[DrawnOrder, ...]
    error: float
    scatter: float

    def amplitude(self, number: int, speed_rpm: Array, *, without: int | None = None) -> Complex:
        """Complex amplitude (channels, speeds) of order ``number``, one mode left out if asked."""
        item = self.orders[number]
        share = np.asarray(speed_rpm) / self.speed_rpm.max()
        force = (item.still + share**item.power) * np.exp(1j * item.turn * share)
        modal = modal_responses(self.natural_hz, self.damping, item.order * np.asarray(speed_rpm) / 60.0)
        kept = np.arange(len(modal)) != (-1 if without is None else without)
        return np.asarray(force * (item.rigid[:, None] + item.residue[:, kept] @ modal[kept]))

    def amplification(self, number: int, mode: int, speed_rpm: Array) -> Array:
        """How many times larger (speeds,) order ``number`` is by ``mode``, the largest of all channels."""
        whole = np.abs(self.amplitude(number, speed_rpm)).max(axis=0)
        return np.asarray(whole / np.abs(self.amplitude(number, speed_rpm, without=mode)).max(axis=0))

    def rows_within(self, mode: int, halves: float) -> int:
        """Most speeds of one order within so many half-power half widths of ``mode``."""
        f, zeta = self.natural_hz[mode], self.damping[mode]
        off = [np.abs(item.order * self.speed_rpm / 60.0 / f - 1.0) for item in self.orders]
        return int(np.count_nonzero(np.array(off) < halves * zeta, axis=1).max())

    def dangerous(self, factor: float) -> list[tuple[float, float, int, int]]:
        """Least and greatest speed of each range that one mode makes dangerous, with its order and mode."""
        low, high = float(self.speed_rpm.min()), float(self.speed_rpm.max())
        found = []
        for number, item in enumerate(self.orders):
            for mode, hz in enumerate(self.natural_hz.tolist()):
                at = 60.0 * hz / item.order * (1.0 + 0.03 * np.linspace(-1.0, 1.0, 1201))
                at = at[(at >= low) & (at <= high)]
                over = at[self.amplification(number, mode, at) > factor] if len(at) else at
                if len(over):
                    found.append((float(over[0]), float(over[-1]), number, mode))
        return found

    def measured(self, seed: int) -> list[Complex]:
        """Complex amplitudes (channels, speeds) of each order as they are measured, with the noise of ``seed``."""
        random = np.random.default_rng((seed, 1))

        def drawn(*shape: int) -> Complex:
            return random.standard_normal(shape) + 1j * random.standard_normal(shape)

        n = len(self.speed_rpm)
        return [
            self.amplitude(k, self.speed_rpm) * (1.0 + self.scatter * drawn(n)) + self.error * drawn(len(CHANNELS), n)
            for k in range(len(self.orders))
        ]


def drawn_machine(
    seed: int, *, n_speeds: tuple[int, int] = (30, 60), span_rpm: tuple[float, float] = (2000.0, 4000.0),
    n_orders: tuple[int, int] = (2, 7), n_modes: tuple[int, int] = (1, 5), damping: tuple[float, float] = (0.003, 0.05),
    scatter: tuple[float, ...] = (0.0005, 0.005, 0.02), error: float = 0.003, even: bool = True, smooth: bool = True,
) -> DrawnMachine:  # fmt: skip
    """A machine of ``seed``: its numbers drawn between the given ends; speeds ``even``, or anywhere.

    Forces follow some smooth law of the speed, or (``smooth`` false) its square.
    """
    r = np.random.default_rng(seed)
    modes = int(r.integers(n_modes[0], n_modes[1] + 1))
    natural = np.sort(r.uniform(30.0, 300.0, modes))
    zeta = np.exp(r.uniform(np.log(damping[0]), np.log(damping[1]), modes))
    top, count = r.uniform(*span_rpm), int(r.integers(n_speeds[0], n_speeds[1] + 1))
    speed = np.linspace(600.0, top, count) if even else np.sort(r.uniform(600.0, top, count))
    chosen = np.sort(r.choice(np.arange(1, 21) / 2, int(r.integers(n_orders[0], n_orders[1] + 1)), replace=False))
    shape = r.normal(size=(len(CHANNELS), modes))
    orders = []
    for order in chosen.tolist():
        drive = 0.5 * r.normal(size=modes) * np.exp(0.1j * r.normal(size=modes)) * np.exp(2j * np.pi * r.random())
        orders.append(
            DrawnOrder(
                order=order, still=0.3 if smooth else 0.0, power=float(r.uniform(0.0, 2.5)) if smooth else 2.0,
                turn=float(0.3 * r.normal()) if smooth else 0.0,
                rigid=0.5 * r.normal(size=len(CHANNELS)) * np.exp(2j * np.pi * r.random()), residue=shape * drive,
            )
        )  # fmt: skip
    return DrawnMachine(
        natural_hz=natural, damping=zeta, speed_rpm=speed, orders=tuple(orders), error=error,
        scatter=float(r.choice(scatter)),
    )  # fmt: skip


def blocks_from(machine: DrawnMachine, seed: int, *, power: bool = False) -> list[Block]:
    """Blocks of ``machine`` with the noise of ``seed``; of squares where the phases say nothing (``power``)."""
    speed, error = machine.speed_rpm, machine.error
    blocks = []
    for item, amplitude in zip(machine.orders, machine.measured(seed), strict=True):
        errors = np.full(amplitude.shape, error)
        if power:
            errors = 2.0 * error * np.maximum(np.abs(amplitude), error)
            amplitude = np.abs(amplitude) ** 2 - 2.0 * error**2 + 0j
        rows = Rows(item.order, CHANNELS, item.order * speed / 60.0, speed, amplitude, errors, power=power)
        blocks.append(Block.of(rows))
    return blocks


def orders_and_map(machine: DrawnMachine, seed: int) -> tuple[tuple[AgreedOrder, ...], xr.Dataset]:
    """AgreedOrders of ``machine`` and its OrderMap, as the identification gets them."""
    measured = np.stack(machine.measured(seed), axis=2)
    speed = machine.speed_rpm
    error, freedom = np.full(measured.shape, machine.error), np.full(measured.shape, 400.0)
    numbers = np.array([item.order for item in machine.orders])
    order_map = order_map_of(measured, error, freedom, speed, numbers)
    agreed = []
    for column, number in enumerate(numbers.tolist()):
        lines = []
        for name, row in zip(CHANNELS, measured[:, :, column], strict=True):
            seen = np.flatnonzero(np.abs(row) > 6.0 * machine.error)
            made = line(number, np.abs(row[seen]), channel=name, speed_rpm=speed[seen], error=machine.error)
            own = {"seen": seen, "order_error": 1e-6, "degrees_of_freedom": np.full(len(seen), 400.0)}
            lines += [replace(made, **own, phase_deg=np.degrees(np.angle(row[seen])))] * bool(len(seen))
        if lines:
            agreed.append(AgreedOrder(number, 1e-6, 30.0, "locked", None, tuple(lines)))
    return tuple(agreed), order_map


def judged(machine: DrawnMachine, seed: int) -> tuple[ModalFit, tuple[Crossing, ...], SpeedVerdicts]:
    """What the identification says of ``machine`` by its orders alone: modes, crossings and speeds."""
    settings = load_settings().identify
    agreed, order_map = orders_and_map(machine, seed)
    coords = {"channel": list(CHANNELS), "speed": np.zeros(0), "frequency": np.zeros(0)}
    nothing = xr.Dataset({"psd": (("channel", "speed", "frequency"), np.zeros((len(CHANNELS), 0, 0)))}, coords)
    modal = modal_fit(nothing, order_map, agreed, settings=settings)
    tested = (float(machine.speed_rpm.min()), float(machine.speed_rpm.max()))
    found = crossings(agreed, modal, speed_rpm=tested, settings=settings)
    unit = dict.fromkeys(CHANNELS, "m/s2")
    return modal, found, speeds_to_avoid(found, agreed, modal, speed_rpm=tested, unit=unit, settings=settings)
