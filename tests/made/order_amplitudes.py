"""Order maps made at the level of complex amplitudes: an engine's orders through a random structure, with noise."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import xarray as xr

from crankorder.engine.definition import BalanceShafts, Cylinder, Engine
from crankorder.engine.forces import crankcase_forces, crankcase_moments
from crankorder.identify.found import ModalFit, Mode
from crankorder.orders.vold_kalman import NOISE_BANDWIDTH
from made.recordings import named

AXES = ("X", "Z", "RY")
MAP_HZ = 1.5 / 16 * 5.0  # bandwidth of a bin at 300 rpm


@dataclass
class MadeOrders:
    """An order map, the engine file that the analysis gets, the modes that it gets and the orders that it was told."""

    order_map: xr.Dataset
    engine: Engine
    modal: ModalFit
    orders: tuple
    path: object


def engine_of(**changes) -> Engine:
    """A single-cylinder engine with offset whose shafts take orders 1 and 2 away."""
    data = {
        "crank_radius_m": 0.0449, "rod_length_m": 0.152, "offset_m": 0.010, "reciprocating_mass_kg": 4.304,
        "cylinders": (Cylinder(),), "shafts": BalanceShafts(orders=(1, 2)),
    }  # fmt: skip
    return Engine(**(data | changes))


def modal_responses(natural_hz, damping, frequency_hz) -> np.ndarray:
    """Acceleration of modes of unit mass per force (modes, frequencies)."""
    x = np.asarray(frequency_hz) / np.asarray(natural_hz)[:, None]
    return -(x**2) / (1.0 - x**2 + 2j * np.asarray(damping)[:, None] * x)


class Structure:
    """Random modes and rigid-body part from forces on the axes to the channels."""

    def __init__(self, rng, *, n_channels=3, n_modes=5, complexity=0.05):
        self.natural = np.sort(rng.uniform(30.0, 260.0, n_modes))
        while np.any(np.diff(self.natural) < 0.06 * self.natural[1:]):
            self.natural = np.sort(rng.uniform(30.0, 260.0, n_modes))
        self.damping = rng.uniform(0.005, 0.04, n_modes)
        size = (n_channels, n_modes)
        shape = rng.normal(size=size) * np.exp(1j * complexity * rng.normal(size=size))
        drive = rng.normal(size=(n_modes, 5))
        drive[:, :3] += np.sign(drive[:, :3])
        self.residue = 0.002 * shape[:, None, :] * drive.T[None]  # (channel, axis or noise source, mode)
        self.rigid = 0.003 * rng.normal(size=(n_channels, 5))

    def path(self, frequency_hz):
        """Accelerance (channel, axis or noise source, frequency)."""
        modal = modal_responses(self.natural, self.damping, frequency_hz)
        return self.residue @ modal + self.rigid[:, :, None]


def made_orders(
    rng, *, residual_kg, engine=None, n_channels=3, speeds=None, noise=1.0, freedom=(8.0, 24.0), moments=False,
    rotating_kg_m=0.0, rotating_deg=0.0, extra=None, structure=None, rpm_error=None, seen=(1, 2, 3, 4),
) -> MadeOrders:  # fmt: skip
    """Orders of ``engine`` with ``residual_kg`` left by its shafts; ``extra``: {order: (axis, newtons at 1000 rpm)}."""
    engine = engine_of() if engine is None else engine
    structure = Structure(rng, n_channels=n_channels) if structure is None else structure
    rpm = np.arange(300.0, 2001.0, 50.0) if speeds is None else np.asarray(speeds, dtype=float)
    shafts = engine.shafts.model_copy(update={"unbalanced_mass_kg": residual_kg})
    rotating = {"rotating_unbalance_kg_m": rotating_kg_m, "rotating_unbalance_deg": rotating_deg}
    real = engine.model_copy(update={"shafts": shafts, **rotating})
    order = np.arange(8, 6 * 16 + 1) / 16
    turned = rpm.copy()
    for which, factor in (rpm_error or {}).items():
        turned[which] *= factor
    force = crankcase_forces(real, turned, max_order=6)[:, [0, 2]]
    force = np.concatenate([force, crankcase_moments(real, turned, max_order=6)[:, 1:2] * moments], axis=1)
    for k, (axis, newtons) in (extra or {}).items():
        force[:, AXES.index(axis), k] += newtons * (turned / 1000.0) ** 2
    f = turned[:, None] * order / 60
    path = structure.path(f.ravel()).reshape(n_channels, 5, *f.shape)
    amplitude = np.zeros((n_channels, *f.shape), dtype=complex)
    for k in range(1, 7):
        at = int(np.argmin(abs(order - k)))
        amplitude[:, :, at] = np.einsum("cas,sa->cs", path[:, :3, :, at], force[:, :, k])
    length = 1 / np.sqrt(rpm / 300.0)[:, None]  # longer records in revolutions average more
    drawn = lambda *shape: rng.normal(size=shape) + 1j * rng.normal(size=shape)  # noqa: E731
    broad = noise * length * drawn(2, *f.shape)
    sensor = 0.0005 * noise * length * drawn(n_channels, *f.shape)
    amplitude += np.einsum("cdso,dso->cso", path[:, 3:], broad) + sensor
    frames = np.maximum(2, np.rint(np.linspace(*freedom, rpm.size) / 2).astype(int))
    error = np.empty((n_channels, *f.shape))
    for at, count in enumerate(frames):  # errors of channels go together as their noise does
        each = np.einsum("cdo,kdo->kco", path[:, 3:, at], drawn(count, 2, order.size))
        each = (each + 0.0005 * drawn(count, n_channels, order.size)) * noise * length[at]
        error[:, at] = np.sqrt((np.abs(each) ** 2).mean(axis=0) / 2)
    nu = np.broadcast_to(2.0 * frames[None, :, None], error.shape)
    seen_orders = tuple(SimpleNamespace(order=float(k), lock="locked", lines=(1,)) for k in seen)
    return MadeOrders(
        order_map_of(amplitude, error, nu, rpm, order), engine, modal_of(rng, structure), seen_orders, structure
    )


def swept(item: MadeOrders, rng, *, residual_kg, rpm=(300.0, 2000.0)) -> xr.Dataset:
    """RecordingTracks of orders 1 to 4 of ``item``, as if held, while its speed sweeps among the noise of the map."""
    time, path = np.arange(0.0, 20.0, 0.08), item.path
    speed, width = np.interp(time, [0.0, 20.0], rpm), np.full(time.size, 4.0)
    angle, orders = np.cumsum(speed) * 0.08 / 60.0, range(1, 5)
    shafts = item.engine.shafts.model_copy(update={"unbalanced_mass_kg": residual_kg})
    force = crankcase_forces(item.engine.model_copy(update={"shafts": shafts}), 30.0 / np.pi, max_order=4)[2]
    omega, spread = speed * np.pi / 30.0, np.sqrt(NOISE_BANDWIDTH * width[0] / MAP_HZ)
    amplitude = np.zeros((len(path.rigid), 4, time.size), dtype=complex)
    for k in orders:
        noise = spread * rng.normal(size=(5, time.size, 2)) @ [1.0, 1.0j]
        pushed = np.stack([force[k] * omega**2, noise[3], noise[4]])
        answers = path.path(k * speed / 60.0).reshape(len(amplitude), 5, -1)[:, [1, 3, 4]]
        amplitude[:, k - 1] = np.einsum("cat,at->ct", answers, pushed) + 0.0005 * noise[: len(amplitude)]
    item.order_map.attrs["enbw_bins"] = 1.5
    item.order_map["n_independent"] = "speed", (item.order_map["speed"].values / 300.0) ** 2
    rows = ("channel", "order", "frame")
    tracks = {"held_amplitude": (rows, amplitude), "standard_error": (rows, np.ones(amplitude.shape))}
    tracks["bandwidth_hz"] = rows[1:], np.tile(width, (4, 1))
    named_rows = {name: ("frame", of) for name, of in (("time", time), ("speed", speed), ("crank_angle", angle))}
    coords = {**named("XYZ"[: len(amplitude)]), "order": [float(k) for k in orders], **named_rows}
    return xr.Dataset(tracks, coords, {"swept": 1, "recording": "run-up"})


def order_map_of(amplitude, error, freedom, rpm, order, *, reference="tdc") -> xr.Dataset:
    """OrderMap with what closure reads of it."""
    dims = ("channel", "speed", "order")
    return xr.Dataset(
        {
            "coherent_amplitude": (dims, np.abs(amplitude)), "phase": (dims, np.degrees(np.angle(amplitude))),
            "standard_error": (dims, error), "degrees_of_freedom": (dims, np.array(freedom)),
        },
        coords={**named("XYZ"[: len(amplitude)]), "speed": rpm, "order": order},
        attrs={"phase_reference": reference, "cycle_known": 1, "revs_per_cycle": 2},
    )  # fmt: skip


def modal_of(rng, structure, *, frequency_error=3e-4, damping_error=0.03) -> ModalFit:
    """Modes of ``structure`` as an identification with relative standard errors would have them."""
    modes, covariance = [], []
    for natural, damping in zip(structure.natural, structure.damping, strict=True):
        errors = frequency_error * natural, damping_error * damping
        modes.append(
            Mode(
                frequency_hz=natural + errors[0] * rng.normal(), frequency_error_hz=errors[0],
                damping_ratio=damping + errors[1] * rng.normal(), damping_error=errors[1], channels=("X",),
                prominence_db=20.0, evidence="made",
            )
        )  # fmt: skip
        covariance += [errors[0] ** 2, errors[1] ** 2]
    return ModalFit(modes=tuple(modes), tones=(), covariance=np.diag(covariance))
