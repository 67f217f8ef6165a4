"""A sweep in a window of frequency: all orders, what their modes answer and what rings, in one linear model.

The transform of a whole recording is taken without a window. In it the answer of a mode to an order is the transform of
that order's force times the mode's response, whatever the rate of the sweep; what rings at its ends is, at the bins of
the transform, one term 1 / (1 - exp((λ - iω) / rate)) of each mode (Pintelon and Schoukens, System Identification,
2012, section 6.3). So every order that passes a window, and every mode in it, is a column, and no filter comes between.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.fft import fft, ifft, irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline
from scipy.linalg.blas import zherk

from crankorder.identify.modes.order_responses import resonance
from crankorder.quantities import Bools, Complexes, Floats

FORCE_EXPONENT = 2.0
"""Power of the speed with which the force of an order grows in a window, before its bend is told."""

BEND_SPREAD = 1.5
"""Standard deviation of what is known beforehand of how the exponent of a force, or its phase per logarithm of the
speed, differs from that: forces are steady to cubic."""

SLOWEST_SHARE = 1e-2
"""Share of a window's speed below which the force of an order is taken to be that at this share."""

STEP = 1e-5
"""Relative step of the slopes of a column by frequency and damping."""

THINNED = 64
"""Samples of which the force of an order is reckoned at one at the most, where a window lies low."""

KEPT_OVER, DROPPED_OVER = 1.5, 2.0
"""An order's force is kept whole up to the first of these over a window's end, and dropped beyond the second: what it
leaves in the window from there is smooth."""

BESIDE_SHARE = 0.5
"""Bins on each side of a window with which the force of an order is kept, as a share of its own."""

TAPERED = 0.8
"""Share of a window's half width from which its ends are tapered where an envelope is made of it."""

FORGOTTEN = 12.0
"""Time constants of a mode after which nothing rings of it."""

SWING_POINTS = 32
"""Points of a cycle at which it is looked at whether the shaft swings within."""

WHOLE = 1e-6
"""Difference of two orders from a multiple of the cycle's frequency up to which their sidebands fall on one another."""

TURNED = 64
"""Bins whose turns are made at once."""

LEAST_NORM = 1e-12
"""Share of a column's square that is added to it: amplitudes of columns that others make are kept small."""


@dataclass(frozen=True, eq=False)
class SweepSpectrum:
    """Transform of one recording: ``spectrum`` (C, F) at ``frequency_hz`` (F,), ``angle_rev`` and ``speed_rpm`` (N,).

    ``channels`` name its rows, ``orders`` were followed through it, ``rate_hz`` is that of its samples, the first at
    ``start_s``, ``top_hz`` the end of its band. Each recording tells the number of an order by itself. ``cycle_rev`` is
    the length of the machine's cycle.
    """

    recording: str
    channels: tuple[str, ...]
    orders: tuple[float, ...]
    start_s: float
    rate_hz: float
    top_hz: float
    frequency_hz: Floats
    spectrum: Complexes
    angle_rev: Floats
    speed_rpm: Floats
    cycle_rev: int

    @cached_property
    def swing_rev(self) -> float:
        """Standard deviation by which the angle swings within the cycle: the median of all cycles."""
        angle = np.arange(self.angle_rev[0], self.angle_rev[-1], self.cycle_rev / SWING_POINTS)
        if len(angle) < 4 * SWING_POINTS:
            return 0.0
        time = np.interp(angle, self.angle_rev, np.arange(len(self.angle_rev)) / self.rate_hz)
        steady = CubicSpline(angle[::SWING_POINTS], time[::SWING_POINTS])
        off = (time - steady(angle)) / np.maximum(steady(angle, 1), 1e-9)
        cycles = off[: len(off) // SWING_POINTS * SWING_POINTS].reshape(-1, SWING_POINTS)
        return float(np.median(np.std(cycles, axis=1)))

    @property
    def length_s(self) -> float:
        """Length of the recording."""
        return len(self.angle_rev) / self.rate_hz

    @property
    def time_s(self) -> Floats:
        """Times (N,) of the samples."""
        return np.asarray(self.start_s + np.arange(len(self.angle_rev)) / self.rate_hz)

    @cached_property
    def logarithm(self) -> Floats:
        """Logarithm (N,) of the speed, as far as it turns."""
        return np.asarray(np.log(np.maximum(self.speed_rpm, SLOWEST_SHARE * self.speed_rpm.max())))

    @cached_property
    def rate_rpm_per_s(self) -> Floats:
        """Rate (N,) at which the speed changes, without sign."""
        return np.asarray(np.abs(np.gradient(self.speed_rpm)) * self.rate_hz)

    def passes(self, order: float, low_hz: float, high_hz: float) -> bool:
        """Whether the ``order`` lies from ``low_hz`` to ``high_hz`` at any time."""
        return bool(order * self.speed_rpm.min() <= 60.0 * high_hz and order * self.speed_rpm.max() >= 60.0 * low_hz)

    def passing(self, order: float, low_hz: float, high_hz: float) -> Bools:
        """At which samples (N,) the ``order`` lies from ``low_hz`` to ``high_hz``."""
        hz = order * self.speed_rpm / 60.0
        return np.asarray((hz >= low_hz) & (hz <= high_hz))


def spectra_of(followed: Sequence[xr.Dataset], *, fewest: int) -> Iterator[SweepSpectrum]:
    """SweepSpectrum of those ``followed`` (RecordingTracks) that hold ``fewest`` samples of a sweep or more."""
    for tracks in followed:
        if "waveform" not in tracks or tracks.sizes["sample"] < fewest:
            continue
        signals, rate = tracks["waveform"].values.astype(np.float64), float(tracks.attrs["waveform_rate_hz"])
        parts = signals.shape[1] // THINNED
        while parts > 1 and next_fast_len(parts) != parts:  # the largest length that a transform likes
            parts -= 1
        n = parts * THINNED
        signals = signals[:, :n]
        yield SweepSpectrum(
            recording=str(tracks.attrs["recording"]),
            channels=tuple(str(name) for name in tracks["channel"].values),
            orders=tuple(sorted(tracks["order"].values.tolist())),
            start_s=float(tracks.attrs["waveform_start_s"]),
            rate_hz=rate,
            top_hz=min(float(tracks.attrs["waveform_band_hz"]), 0.47 * rate),
            frequency_hz=np.arange(n // 2 + 1) * rate / n,
            spectrum=rfft(signals - signals.mean(axis=1, keepdims=True), axis=1),
            angle_rev=tracks["waveform_angle"].values[:n],
            speed_rpm=tracks["waveform_speed"].values[:n],
            cycle_rev=int(tracks.attrs["revs_per_cycle"]),
        )


@dataclass(eq=False)
class Window:
    """One recording from ``low_hz`` to ``high_hz`` with the ``orders`` that pass it, for poles to be told in.

    ``degree`` is that of the polynomial in frequency by which the channels answer an order beside the modes;
    ``shape`` (B,) is that of the noise over the bins, ``level`` (C,) its size: standard deviations of a bin. ``bends``
    is how the force of each order differs from a square of the speed, as exponent and phase per logarithm of speed.
    """

    sweep: SweepSpectrum
    low_hz: float
    high_hz: float
    orders: tuple[float, ...]
    degree: int
    shape: Floats
    level: Floats
    bends: dict[float, complex] = field(default_factory=dict)
    _made: dict[tuple[float, complex, bool], Complexes] = field(default_factory=dict, repr=False)
    _unbent: dict[float, tuple[Complexes, Floats]] = field(default_factory=dict, repr=False)
    _passages: dict[float, tuple[Floats, Complexes]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls, sweep: SweepSpectrum, more: Sequence[float], low_hz: float, high_hz: float, *, degree: int
    ) -> Window | None:
        """Window of ``sweep`` with those of its orders, and of ``more``, that pass it; None where it has few bins.

        ``low_hz``, ``high_hz`` and ``degree`` are those of the window.
        """
        passing = tuple(order for order in sorted({*sweep.orders, *more}) if sweep.passes(order, low_hz, high_hz))
        at = (sweep.frequency_hz >= low_hz) & (sweep.frequency_hz <= high_hz)
        if not passing or np.count_nonzero(at) < 4 * (len(passing) * (degree + 2) + 4):
            return None
        window = cls(sweep, low_hz, high_hz, passing, degree, np.ones(int(at.sum())), np.ones(len(sweep.channels)))
        window.level = np.sqrt(np.mean(np.abs(window.measured) ** 2, axis=1))
        return window

    def is_passed(self, order: float) -> bool:
        """Whether ``order`` passes the window at any time."""
        return self.sweep.passes(order, self.low_hz, self.high_hz)

    def with_order(self, order: float) -> Window:
        """The window with one more ``order``, if that passes it."""
        return replace(self, orders=tuple(sorted({*self.orders, order}))) if self.is_passed(order) else self

    @cached_property
    def bins(self) -> slice:
        """Bins of the transform that lie in the window."""
        at = np.flatnonzero((self.sweep.frequency_hz >= self.low_hz) & (self.sweep.frequency_hz <= self.high_hz))
        return slice(int(at[0]), int(at[-1]) + 1)

    @cached_property
    def frequency_hz(self) -> Floats:
        """Frequencies (B,) of the bins."""
        return self.sweep.frequency_hz[self.bins]

    @cached_property
    def measured(self) -> Complexes:
        """The transform (C, B)."""
        return self.sweep.spectrum[:, self.bins]

    @cached_property
    def powers(self) -> Floats:
        """Polynomials (B, degree + 1) of the frequency."""
        return self._powers_at(self.frequency_hz)

    def _powers_at(self, frequency_hz: Floats) -> Floats:
        """Polynomials (G, degree + 1) of ``frequency_hz`` (G,)."""
        place = (2.0 * frequency_hz - self.low_hz - self.high_hz) / (self.high_hz - self.low_hz)
        return np.asarray(legendre.legvander(place, self.degree))

    def force_at(self, order: float, frequency_hz: Floats) -> Complexes:
        """Force (G,) of ``order`` where it stands at ``frequency_hz`` (G,), in the unit of :meth:`force`."""
        logarithm = np.log(60.0 * frequency_hz / order) - self._middle_of(order)
        return np.asarray(np.exp((FORCE_EXPONENT + self.bends.get(order, 0j)) * logarithm))

    def _middle_of(self, order: float) -> float:
        """Mean logarithm of the speed while ``order`` passes the window."""
        return float(self.sweep.logarithm[self.sweep.passing(order, self.low_hz, self.high_hz)].mean())

    def force(self, order: float, *, sloped: bool = False) -> Complexes:
        """Transform (B,) of a force of unit size that turns by ``order``, or its slope by the bend (``sloped``)."""
        bend = self.bends.get(order, 0j)
        if (order, bend, sloped) not in self._made:
            inner = slice(self._beside, self._beside + len(self.frequency_hz))
            if bend or sloped:
                logarithm, carrier = self._passage(order)
                turned = carrier * np.exp(bend * logarithm)
                made = fft(turned * logarithm if sloped else turned)[inner]
            else:
                made = self._bins_of(order)[0][inner]
            self._made = {key: kept for key, kept in self._made.items() if key[0] != order or key[1] == bend}
            self._made[order, bend, sloped] = made
        return self._made[order, bend, sloped]

    @property
    def _beside(self) -> int:
        """Bins on each side of its own that a force has."""
        return int(BESIDE_SHARE * len(self.frequency_hz))

    def _bins_of(self, order: float) -> tuple[Complexes, Floats]:
        """Transform of the unbent force of ``order`` in the window's bins and those beside; the logarithm of the speed.

        With the neighbours a bend finds what it moves there.
        """
        if order not in self._unbent:
            logarithm, carrier = self._carrier(order)
            whole = fft(carrier * np.exp(FORCE_EXPONENT * logarithm)) * (0.5 * self.thinned)
            count = min(next_fast_len(len(self.frequency_hz) + 2 * self._beside), len(whole))
            first = self.bins.start - self._beside
            self._unbent[order] = whole.take(np.arange(first, first + count), mode="wrap"), logarithm
        return self._unbent[order]

    def _passage(self, order: float) -> tuple[Floats, Complexes]:
        """Logarithm of the speed and unbent force (T,) of ``order``, both as far as the window's bins tell them.

        The logarithm ends where the order has passed them: what it leaves from there is smooth.
        """
        if order not in self._passages:
            bins, logarithm = self._bins_of(order)
            ends = self.bins.start - self._beside + np.array([0, len(bins)])
            time = np.arange(len(bins)) * (len(logarithm) / len(bins))
            logarithm = np.interp(time, np.arange(len(logarithm)), logarithm)
            hz = np.maximum(ends, 1) * self.sweep.rate_hz / len(self.sweep.angle_rev)
            logarithm = np.clip(logarithm, *(np.log(60.0 * hz / order) - self._middle_of(order)))
            self._passages[order] = logarithm, ifft(bins)
        return self._passages[order]

    @cached_property
    def thinned(self) -> int:
        """One sample in so many tells the force of an order as far as the window needs it."""
        enough = self.sweep.rate_hz / (1.1 * DROPPED_OVER * self.high_hz)
        return int(2 ** np.clip(np.floor(np.log2(max(enough, 1.0))), 0, np.log2(THINNED)))

    def _carrier(self, order: float) -> tuple[Floats, Complexes]:
        """Logarithm of the speed over that at which ``order`` passes, and its carrier, (N / thinned,)."""
        sweep, part = self.sweep, slice(None, None, self.thinned)
        speed, hz = sweep.speed_rpm[part], order * sweep.speed_rpm[part] / 60.0
        whole = np.clip((DROPPED_OVER - hz / self.high_hz) / (DROPPED_OVER - KEPT_OVER), 0.0, 1.0)
        whole[speed <= SLOWEST_SHARE * sweep.speed_rpm.max()] = 0.0
        carrier = np.sin(0.5 * np.pi * whole) ** 2 * np.exp(2j * np.pi * order * sweep.angle_rev[part])
        return sweep.logarithm[part] - self._middle_of(order), carrier

    @cached_property
    def taper(self) -> Floats:
        """Weight (B,) that falls to nothing at both ends of the window."""
        place = np.abs(2.0 * self.frequency_hz - self.low_hz - self.high_hz) / (self.high_hz - self.low_hz)
        return np.asarray(np.cos(0.5 * np.pi * np.clip((place - TAPERED) / (1.0 - TAPERED), 0.0, 1.0)) ** 2)

    def turn(self, order: float, time_s: Floats, angle_rev: Floats) -> Complexes:
        """What makes the amplitude (T,) of ``order`` at ``time_s`` (T,) out of the window's bins: (T, B).

        ``angle_rev`` (T,) is that of the shaft there. The order must lie well within the window then: its ends are
        tapered. The bins lie evenly, so that a coarse and a fine turn make each.
        """
        since, step, bins = time_s - self.sweep.start_s, self.sweep.rate_hz / len(self.sweep.angle_rev), len(self.taper)
        fine = np.exp(2j * np.pi * np.outer(since, step * np.arange(TURNED)))
        first = self.frequency_hz[0] + step * TURNED * np.arange(-(-bins // TURNED))
        coarse = np.exp(2j * np.pi * (np.outer(since, first) - order * angle_rev[:, None]))
        every = (coarse[:, :, None] * fine[:, None, :]).reshape(len(since), -1)[:, :bins]
        return np.asarray(every * (self.taper * (2.0 / len(self.sweep.angle_rev))))

    def with_strong(self, natural_hz: Floats, damping: Floats, share: float, most: int) -> Window:
        """The window with ``most`` of its orders at most, those that make ``share`` of what the strongest does or more.

        In any channel, behind the modes ``natural_hz``, ``damping`` (M,) that are known.
        """
        solved, path = self.solved(natural_hz, damping), self.paths(natural_hz, damping)
        forces = np.stack([self.force(order) for order in self.orders])
        size = np.linalg.norm(forces[:, :, None] * (path @ solved.by_order), axis=1)
        size = (size / np.maximum(size.max(axis=0), 1e-300)).max(axis=1)
        least = max(share, float(np.sort(size)[-most:].min()))
        return replace(self, orders=tuple(np.array(self.orders)[size >= least].tolist()))

    def ringing(self, natural_hz: Floats, damping: Floats) -> Complexes:
        """What modes ring at the ends of the recording (B, M), of about the size of a bin.

        ``natural_hz`` and ``damping`` (M,): of the modes.
        """
        turn = np.exp((_pole(natural_hz, damping) - 2j * np.pi * self.frequency_hz[:, None]) / self.sweep.rate_hz)
        return np.asarray(1.0 / (1.0 - turn))

    def design(self, natural_hz: Floats, damping: Floats) -> Complexes:
        """Columns (B, K): of each order its polynomials and modes, what rings of each mode, and two of leakage.

        ``natural_hz`` and ``damping`` (M,): of the modes.
        """
        basis = self.paths(natural_hz, damping)
        columns = [self.force(order)[:, None] * basis for order in self.orders]
        return np.concatenate([*columns, self.ringing(natural_hz, damping), self.powers[:, :2] + 0j], axis=1)

    def paths(self, natural_hz: Floats, damping: Floats, frequency_hz: Floats | None = None) -> Complexes:
        """How the channels may answer an order: polynomials (G, degree + 1 + M), then the modes.

        ``natural_hz`` and ``damping`` (M,): of these; ``frequency_hz`` (G,): where, at the bins if left out.
        """
        at = self.frequency_hz if frequency_hz is None else frequency_hz
        powers = self.powers if frequency_hz is None else self._powers_at(frequency_hz)
        return np.concatenate([powers, resonance(at, natural_hz, damping)], axis=1)

    def solved(self, natural_hz: Floats, damping: Floats) -> Solved:
        """Least-squares amplitudes of all columns in all channels behind the modes ``natural_hz``, ``damping`` (M,)."""
        columns = self.design(natural_hz, damping) / self.shape[:, None]
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        columns /= scale
        # of the columns' conjugates, one half alone: an array in the other memory order is no copy
        gram: Complexes = zherk(1.0, columns.T, lower=True).conj() + LEAST_NORM * np.eye(len(scale))
        # upper: columns @ inverse are orthonormal
        inverse = np.asarray(np.linalg.inv(np.linalg.cholesky(gram)).conj().T, dtype=np.complex128)
        wanted = (self.measured / self.shape).T
        amplitude = inverse @ (inverse.conj().T @ _against(columns, wanted))
        left = (wanted - columns @ amplitude) / self.level
        return Solved(self, natural_hz, damping, amplitude / scale[:, None], left, columns, inverse, scale)


def _against(columns: Complexes, rows: Complexes) -> Complexes:
    """Products (K, …) of the conjugate ``columns`` (B, K) with ``rows`` (B, …), which are fewer: no copy is made."""
    return np.asarray((columns.T @ rows.conj()).conj())


def _pole(natural_hz: Floats, damping: Floats) -> Complexes:
    """Poles (M,) [rad/s] in the upper half plane of modes ``natural_hz``, ``damping`` (M,)."""
    return np.asarray(2.0 * np.pi * natural_hz * (-damping + 1j * np.sqrt(1.0 - damping**2)))


@dataclass(frozen=True, eq=False)
class Solved:
    """Least-squares fit of a ``window`` for given modes: ``amplitude`` (K, C), residual ``left`` (B, C) in sigmas.

    ``columns`` (B, K) are those over the noise's shape, each over its ``scale`` (K,); ``inverse`` (K, K) makes them
    orthonormal.
    """

    window: Window
    natural_hz: Floats
    damping: Floats
    amplitude: Complexes
    left: Complexes
    columns: Complexes
    inverse: Complexes
    scale: Floats

    @cached_property
    def misfit(self) -> float:
        """Sum of the squared residuals."""
        return float(np.sum(np.abs(self.left) ** 2))

    @property
    def noise(self) -> Floats:
        """Variance (C,) of a bin over the noise's shape, as the residuals tell it."""
        free = max(len(self.left) - len(self.scale), 1)
        return np.asarray(np.square(self.window.level) * np.sum(np.abs(self.left) ** 2, axis=0) / free)

    def spread(self, order: float, seen: Complexes) -> Floats:
        """Variance (T,), in noise of variance one, of what ``seen`` (T, width) makes of the amplitudes of ``order``."""
        own = self._columns_of(order)
        return np.asarray(np.sum(np.abs(seen @ (self.inverse[own] / self.scale[own, None])) ** 2, axis=1))

    @property
    def freedom(self) -> int:
        """Complex numbers beyond the unknowns."""
        return int((len(self.left) - len(self.scale)) * self.left.shape[1])

    @cached_property
    def residues(self) -> Complexes:
        """Amplitudes (orders, M, C) of the modes behind each order."""
        return self.by_order[:, self.window.degree + 1 :]

    @cached_property
    def by_order(self) -> Complexes:
        """Amplitudes (orders, degree + 1 + M, C) of what is smooth and of the modes behind each order."""
        size = len(self.window.orders)
        return self.amplitude[: size * self.width].reshape(size, self.width, -1)

    @property
    def width(self) -> int:
        """Columns of each order: its polynomials, then the modes."""
        return self.window.degree + 1 + len(self.natural_hz)

    def normal(self, orders: Sequence[float]) -> tuple[Floats, Floats]:
        """Normal matrix (P, P) and right side (P,) of what is left, the amplitudes as good as they get.

        By ln f and ln ζ of each mode, then by the bend (real, imaginary) of each of ``orders``; 0 of those elsewhere.
        """
        rows, turned = self._rows(orders)
        flat = rows.reshape(len(rows), -1)
        within = (self.inverse.conj().T @ _against(self.columns, flat)).reshape(-1, len(turned))
        flat = flat.reshape(-1, len(turned))
        gram = _against(flat, flat) - _against(within, within)
        return (turned.conj().T @ gram @ turned).real, (turned.conj().T @ _against(flat, self.left.ravel())).real

    def scores(self, orders: Sequence[float]) -> Floats:
        """Right side of :meth:`normal` of ``orders`` by bin (B, P)."""
        rows, turned = self._rows(orders)
        beyond = self._beyond(rows.reshape(len(rows), -1)).reshape(rows.shape)
        return np.asarray((np.einsum("bcq,bc->bq", beyond, self.left.conj()) @ turned).real)

    def _rows(self, orders: Sequence[float]) -> tuple[Complexes, Complexes]:
        """Derivatives (B, C, Q) of the columns, in standard deviations, by the modes and the bends of its own orders.

        And what (Q, P) makes of them those by the modes and the bends, real and imaginary, of all ``orders``.
        """
        window, modes = self.window, 2 * len(self.natural_hz)
        size, path = len(window.orders), window.paths(self.natural_hz, self.damping)
        turned = np.zeros((modes + size, modes + 2 * len(orders)), dtype=np.complex128)
        turned[:modes, :modes] = np.eye(modes)
        bent = np.empty((*self.left.shape, size), dtype=np.complex128)
        for at, order in enumerate(window.orders):
            bent[..., at] = window.force(order, sloped=True)[:, None] * (path @ self.by_order[at])
            place = modes + 2 * orders.index(order)
            turned[modes + at, place : place + 2] = 1.0, 1j
        every: Complexes = np.concatenate([self._bent, bent], axis=2)
        return every / (window.shape[:, None] * window.level)[:, :, None], turned

    @cached_property
    def _answers_bent(self) -> tuple[Complexes, Complexes]:
        """Derivatives (B, 2 M), by ln f and ln ζ in turns, of what each mode answers and of what it rings."""
        window = self.window
        slopes = np.empty((2, len(window.frequency_hz), 2 * len(self.natural_hz)), dtype=np.complex128)
        for which, (by_f, by_zeta) in enumerate(((STEP, 0.0), (0.0, STEP))):
            up = self.natural_hz * (1.0 + by_f), self.damping * (1.0 + by_zeta)
            down = self.natural_hz * (1.0 - by_f), self.damping * (1.0 - by_zeta)
            slopes[0, :, which::2] = resonance(window.frequency_hz, *up) - resonance(window.frequency_hz, *down)
            slopes[1, :, which::2] = window.ringing(*up) - window.ringing(*down)
        slopes /= 2.0 * STEP
        return slopes[0], slopes[1]

    @cached_property
    def _bent(self) -> Complexes:
        """Derivatives (B, C, 2 M) of the columns by ln f and ln ζ of each mode, with their amplitudes."""
        answered, rung = self._answers_bent
        forces = np.stack([self.window.force(order) for order in self.window.orders], axis=1)
        driven = np.tensordot(forces, self.residues, axes=1)  # (B, M, C)
        rings = self.amplitude[-2 - len(self.natural_hz) : -2]
        bent = np.repeat(driven, 2, axis=1) * answered[:, :, None] + rung[:, :, None] * np.repeat(rings, 2, axis=0)
        return np.asarray(np.swapaxes(bent, 1, 2))

    def envelope(self, order: float, turn: Complexes) -> Complexes:
        """Complex amplitude (T, C) of ``order`` where ``turn`` (T, B) says."""
        own = self._columns_of(order)
        return np.asarray(turn @ self._unscaled(own) @ self.amplitude[own])

    def envelope_variance(self, order: float, turn: Complexes, covariance: Floats) -> Floats:
        """Variance (T, C) of :meth:`envelope` by noise and poles, whose (ln f, ln ζ) have ``covariance`` (2 M, 2 M).

        ``order`` and ``turn`` (T, B): as there.
        """
        own, place = self._columns_of(order), self.window.orders.index(order)
        seen = turn @ self._unscaled(own)
        # derivatives (T, C, 2 M) by ln f and ln ζ of each mode
        slope = turn @ (self._answers_bent[0] * self.window.force(order)[:, None])
        slope = slope[:, None, :] * np.repeat(self.residues[place].T, 2, axis=1)
        slope -= (seen @ self._bent_amplitude[own]).reshape(slope.shape)
        by_poles = 2.0 * np.sum((slope @ covariance) * slope.conj(), axis=2).real
        return np.asarray(self.spread(order, seen)[:, None] * self.noise + by_poles)

    def held(self, order: float, frequency_hz: Floats) -> Complexes:
        """Complex amplitude (T, C) that ``order`` would have if it were held at ``frequency_hz`` (T,)."""
        path = self.window.paths(self.natural_hz, self.damping, frequency_hz)
        return np.asarray(
            self.window.force_at(order, frequency_hz)[:, None] * (path @ self.by_order[self.window.orders.index(order)])
        )

    def line(self, order: float, angle_rev: Floats) -> Complexes:
        """Amplitude (T, C) of ``order`` about each ``angle_rev`` (T,) as an analysis by crank angle reads it.

        Where the shaft swings within the cycle, modes answer an order with sidebands, and those of other orders fall on
        it: what counts is the mean over two cycles, weighted to their middle.
        """
        window, angle, cycle = self.window, self.window.sweep.angle_rev, self.window.sweep.cycle_rev
        apart = [(other, cycle * (other - order)) for other in window.orders]
        own = np.concatenate([self._columns_of(other) for other, off in apart if abs(off - round(off)) < WHOLE])
        spectrum = np.zeros((len(window.sweep.frequency_hz), self.left.shape[1]), dtype=np.complex128)
        spectrum[window.bins] = (self._unscaled(own) @ self.amplitude[own]) * window.taper[:, None]
        signal = irfft(spectrum, len(angle), axis=0)
        value = np.zeros((len(angle_rev), signal.shape[1]), dtype=np.complex128)
        for row, middle in enumerate(angle_rev.tolist()):
            first, last = np.searchsorted(angle, [middle - cycle, middle + cycle])
            weight = np.gradient(angle[first:last]) * (cycle - np.abs(angle[first:last] - middle))
            turned = weight * np.exp(-2j * np.pi * order * angle[first:last])
            value[row] = 2.0 * turned @ signal[first:last] / weight.sum()
        return value

    def as_started(self, order: float, time_s: Floats, angle_rev: Floats) -> Complexes:
        """What its amplitude (T, C) lacks at ``time_s`` (T,) of an ``order`` that ran before the recording began.

        ``angle_rev`` (T,) is that of the shaft there. The transform goes round: as if the force began with the
        recording, and what its end rings came before that. The modes answered it steadily then, and decay to that.
        """
        window, sweep = self.window, self.window.sweep
        logarithm, carrier = window._carrier(order)
        force = carrier * np.exp((FORCE_EXPONENT + window.bends.get(order, 0j)) * logarithm)
        pole, step = _pole(self.natural_hz, self.damping), window.thinned / sweep.rate_hz
        before = force[0] / (2j * np.pi * order * sweep.speed_rpm[0] / 60.0 - pole)
        back = step * (np.arange(len(force))[::-1] + 0.5)
        back = back[back < FORGOTTEN / float((-pole.real).min())]
        rung = (np.exp(np.outer(back, pole)).T @ force[len(force) - len(back) :]) * step
        lacking = pole**2 / (2j * pole.imag) * (before - rung)
        decay = np.exp(np.outer(time_s - sweep.start_s, pole) - 2j * np.pi * order * angle_rev[:, None])
        return np.asarray((decay * lacking) @ self.residues[window.orders.index(order)])

    def _columns_of(self, order: float) -> NDArray[np.intp]:
        """Numbers of the columns of ``order``."""
        return self.window.orders.index(order) * self.width + np.arange(self.width)

    def _unscaled(self, own: NDArray[np.intp]) -> Complexes:
        """The columns (B, own) in the unit of the transform."""
        return np.asarray(self.columns[:, own] * self.scale[own] * self.window.shape[:, None])

    @cached_property
    def _bent_amplitude(self) -> Complexes:
        """Derivatives (K, C 2 M), with the other sign, of the amplitudes by ln f and ln ζ of each mode."""
        full = (self._bent / self.window.shape[:, None, None]).reshape(len(self.left), -1)
        return (self.inverse @ (self.inverse.conj().T @ _against(self.columns, full))) / self.scale[:, None]

    def gain_of(self, order: float) -> float:
        """What one ``order`` more, answered smoothly and by the modes, saves of twice the negative log likelihood."""
        window = self.window
        if not window.is_passed(order):
            return 0.0
        path = window.paths(self.natural_hz, self.damping)
        columns = window.force(order)[:, None] * path / window.shape[:, None]
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        beyond = self._beyond(columns)
        gram = beyond.conj().T @ beyond + 1e-6 * np.eye(beyond.shape[1])
        seen = beyond.conj().T @ self.left
        return float(2.0 * np.sum(seen.conj() * np.linalg.solve(gram, seen)).real)

    def _beyond(self, rows: Complexes) -> Complexes:
        """``rows`` (B, P) without what the columns can make themselves."""
        return np.asarray(rows - self.columns @ (self.inverse @ (self.inverse.conj().T @ _against(self.columns, rows))))
