"""Lines of a recording at held speed, solved together: amplitudes, phases, numbers, and how sure each of them is.

A line is a sinusoid whose phase runs by a known *course*: an order times the crank angle, a frequency times the time,
or the sum of both. The frames about a set of lines are joined to the decimated signal that they were made of, in which
noise is white near the lines; there amplitudes follow by linear least squares, and numbers that are free by
Gauss-Newton steps with the amplitudes eliminated (Golub and Pereyra 1973). Errors are those of the Cramér-Rao bound
(Rife and Boorstyn 1974; Stoica and Moses 2005, section 4.3) in the noise that stands beside each line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from crankorder.fft.windows import power_of_two
from crankorder.orders.intervals import LARGEST_DOF
from crankorder.quantities import Bools, Complexes, Floats, Ints
from crankorder.settings import MethodNumbers

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

NUMBERS = MethodNumbers("3-orders-lines.toml", "joint_lines")

LOBE_BINS = 2.0
"""Reciprocal frame lengths on each side of a line that the main lobe of a Hann window covers."""

REACH_BINS = 4
"""Bins on each side of lines that are joined: two hold their lobes, the others the noise beside."""

LEAST_WINDOW = 0.2
"""Share of a window's height below which the ends of frames say too little of the signal."""

BESIDE_CYCLES = tuple(range(2, 10))
"""Where the noise beside a line is looked at, on both sides, in cycles per recording."""

FEWEST_BESIDE = 6
"""Places beside a line whose mean says more of the noise there than all that is left of the band."""

STEPS = 15
"""Gauss-Newton steps: a start within a quarter of a cycle of the recording needs five."""

SETTLED, LONGEST_STEP = 1e-7, 0.25
"""Cycles over the recording by which a step moves lines that are found, and by which it moves a line at most."""

SLOPE_CYCLES = 1e-3
"""Cycles over the recording by which a line is moved to see how it changes."""

PADDED = 4
"""Trial orders per reciprocal length of the recording: a line between two of them loses 10 % at most."""

LEAST_NOISE = 1e-12
"""Noise amplitude over that of all in the band, at least: rounding leaves as much."""


class Place(NamedTuple):
    """Course of a line: its constant frequency ``hertz`` [Hz] plus ``turns`` times the frequency of the shaft."""

    hertz: float = 0.0
    turns: float = 0.0


Spectrum = NDArray[np.complexfloating]


@dataclass(frozen=True, eq=False)
class HeldFrames:
    """Frames of a recording at one speed: ``spectrum`` (channels, frames, bins) of the orders ``axis`` (bins,).

    ``turn`` (frames,) is the crank angle in rev of the middle of each, ``clock`` the time [s] by crank angle; ``revs``
    their length; ``rpm`` the mean speed; ``channels`` names.
    """

    spectrum: Spectrum
    axis: Floats
    turn: Floats
    clock: PPoly
    revs: float
    rpm: float
    channels: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, spectrum: Spectrum, turn: Floats, speed_rpm: Floats, *, revs: float, channels: Sequence[str] = ()
    ) -> HeldFrames:
        """Frames with the middles ``turn`` [rev], rising, at ``speed_rpm``; both (frames,), finite, one frame or more.

        ``spectrum`` (channels, frames, bins), ``revs`` and ``channels`` are those of the class.

        A speed is the mean over a frame: that of its middle differs by how it bends (to the fourth order).
        """
        from scipy.interpolate import CubicSpline, PPoly  # with much that maps alone need not wait for

        pace, axis = 60.0 / speed_rpm, np.arange(spectrum.shape[2]) / revs
        if len(turn) < 2:
            clock = PPoly(np.array([[pace[0]], [0.0]]), np.array([turn[0], turn[0] + revs]))
            return cls(spectrum, axis, turn, clock, revs, float(speed_rpm[0]), tuple(channels))
        pace = pace - revs**2 / 24.0 * CubicSpline(turn, pace)(turn, 2)
        clock = CubicSpline(turn, pace).antiderivative()
        rpm = 60.0 * float(np.ptp(turn)) / float(clock(turn[-1]) - clock(turn[0]))
        return cls(spectrum, axis, turn, clock, revs, rpm, tuple(channels))

    @cached_property
    def time_s(self) -> Floats:
        """Time [s] (frames,) of the middle of each frame from that of the first."""
        return np.asarray(self.clock(self.turn) - self.clock(self.turn[0]))

    @cached_property
    def pace_s(self) -> Floats:
        """Seconds that a revolution takes in the middle of each frame (frames,)."""
        return np.asarray(self.clock(self.turn, 1))

    @cached_property
    def span_rev(self) -> float:
        """Revolutions from the middle of the first frame to that of the last, and a frame more."""
        return float(np.ptp(self.turn)) + self.revs

    def order_of(self, place: Place) -> float:
        """Order at the mean speed of a line at ``place``."""
        return place.turns + place.hertz * 60.0 / self.rpm

    def parts(self, order: float, other: float) -> bool:
        """Whether lines at ``order`` and the ``other`` beat often enough within the recording to be told apart."""
        return bool(abs(order - other) * self.span_rev >= NUMBERS.apart_cycles)

    def is_half(self, order: float) -> bool:
        """Whether a line at ``order`` lies so near a half or whole order of the shaft that the two are not parted."""
        return not self.parts(order, 0.5 * round(2.0 * order))

    def reaches(self, low: float, high: float) -> bool:
        """Whether the spectra hold the main lobes of lines at the orders ``low`` and ``high``."""
        return low - LOBE_BINS / self.revs > 0.0 and high + LOBE_BINS / self.revs < float(self.axis[-1])


@dataclass(frozen=True, eq=False)
class Sighting:
    """A line at ``order`` of a recording: complex ``phasor`` (channels,) at crank angle and time 0, and its ``error``.

    ``error`` (channels,) is the standard error along one axis, of ``degrees_of_freedom``; ``order_error`` that of the
    order (at the mean speed), 0 where the place was known.
    """

    order: float
    phasor: Complexes
    error: Floats
    order_error: float = 0.0
    degrees_of_freedom: float = LARGEST_DOF

    @property
    def amplitude(self) -> Floats:
        """Peak amplitude (channels,)."""
        return np.abs(self.phasor)

    @property
    def sigmas(self) -> float:
        """Largest ratio over the channels of the amplitude to its standard error."""
        return float(np.max(self.amplitude / np.maximum(self.error, 1e-300)))

    @property
    def seen(self) -> bool:
        """Whether the line is too large for noise."""
        return bool(self.sigmas > NUMBERS.seen_sigmas)


@dataclass(frozen=True, eq=False)
class Band:
    """The decimated signal of frames about some orders: ``data`` (samples, channels) in the ``unit`` (channels,).

    ``bins`` (bins,) are the bins of the spectra that were joined, ``sample`` (samples,) the numbers of the samples, of
    which a frame has as many as there are bins. White noise of a recording is white in ``data``, except in the
    outermost two bins.
    """

    held: HeldFrames
    bins: Ints
    sample: Ints
    data: Complexes
    unit: Floats
    _table: Complexes
    _residue: Ints
    _window: Floats
    _column: Ints
    _gather: csr_array

    @classmethod
    def about(cls, held: HeldFrames, low: float, high: float) -> Band | None:
        """The band of ``held`` that holds lines from the order ``low`` to ``high``; None where no bin is there."""
        first = max(int(np.floor(low * held.revs)) - REACH_BINS, 0)
        last = min(int(np.ceil(high * held.revs)) + REACH_BINS, held.spectrum.shape[2] - 1)
        known = np.isfinite(held.spectrum[:, :, first : last + 1]).all(axis=(0, 1))
        bins = first + np.flatnonzero(known)
        count = len(bins)
        if count <= 2 * LOBE_BINS or count <= bins[-1] - bins[0] or not len(held.turn):
            return None
        begin = (held.turn - 0.5 * held.revs) * count / held.revs
        sample = np.ceil(begin - 1e-9).astype(np.int64)[:, None] + np.arange(count)
        window = 2.0 * np.square(np.sin(np.pi * (sample - begin[:, None]) / count))
        numbers, column = np.unique(sample.ravel(), return_inverse=True)
        weight = np.bincount(column.ravel(), window.ravel())
        kept = weight >= 2.0 * LEAST_WINDOW
        place = np.where(kept, np.cumsum(kept) - 1, -1)[column.ravel()]
        used = np.flatnonzero(place >= 0)
        shape = int(np.count_nonzero(kept)), sample.size
        gather = csr_array((1.0 / weight[column.ravel()][used], (place[used], used)), shape=shape)
        table = np.exp(2j * np.pi * (np.outer(bins, np.arange(count)) % count) / count)
        chosen = held.spectrum[:, :, bins]
        unit = power_of_two(chosen)[:, 0, 0]
        parts = table, sample % count, window, place.reshape(sample.shape), gather
        band = cls(held, bins, numbers[kept], np.zeros((0, 0), dtype=np.complex128), unit, *parts)
        return replace(band, data=band._joined(np.moveaxis(chosen.astype(np.complex128), 0, 2) / unit))

    def _joined(self, values: Complexes) -> Complexes:
        """Samples (samples, several) of what has the ``values`` (frames, bins, several) in the frames."""
        samples = np.einsum("fbx,br->frx", values, self._table, optimize=True)
        samples = np.take_along_axis(samples, self._residue[:, :, None], axis=1)
        return np.asarray(self._gather @ samples.reshape(-1, values.shape[2]))

    def waves(self, places: Sequence[Place]) -> Complexes:
        """Samples (samples, places) in the band of lines of amplitude 1 at ``places``.

        A line x reciprocal frame lengths from a bin is seen there by the response of the Hann window,
        sinc x / (1 - x²), and turns from frame to frame with its own phase less that of the bin.
        """
        held, axis = self.held, self.bins / self.held.revs
        hertz, turns = np.array(places, dtype=np.float64).reshape(-1, 2).T
        away = ((turns + hertz * held.pace_s[:, None])[:, None] - axis[:, None]) * held.revs
        phase, of_bin = turns * held.turn[:, None] + hertz * held.time_s[:, None], axis * held.turn[:, None]
        waves, back = (np.exp(2j * np.pi * (turned % 1.0)) for turned in (phase, of_bin))
        return self._joined(hann_lobe(away) * (waves[:, None] * back.conj()[..., None])) * self._late(hertz)

    def _late(self, hertz: Floats) -> Complexes:
        """How what stays at ``hertz`` (places,) turns (samples, places) as the speed changes within frames."""
        held, turn = self.held, self.sample * self.held.revs / len(self.bins)
        away = np.where(self._column >= 0, turn[self._column] - held.turn[:, None], 0.0)
        even = self._gather @ (self._window * (held.time_s[:, None] + held.pace_s[:, None] * away)).ravel()
        seconds = held.clock(turn) - held.clock(held.turn[0]) - even
        return np.asarray(np.exp(2j * np.pi * np.outer(seconds, hertz)))

    def holds(self, order: float) -> bool:
        """Whether noise is white about ``order``."""
        place = order * self.held.revs
        return bool(self.bins[0] + LOBE_BINS <= place <= self.bins[-1] - LOBE_BINS)

    def spectra(self, left: Complexes) -> Complexes:
        """Spectra (frames, bins, channels) of what is ``left`` (samples, channels), as the recording's are made."""
        padded = np.concatenate([left, np.zeros((1, left.shape[1]))])[self._column] * self._window[:, :, None]
        padded = np.take_along_axis(padded, np.argsort(self._residue, axis=1)[:, :, None], axis=1)
        return np.asarray(np.einsum("frx,br->fbx", padded, self._table.conj(), optimize=True) / len(self.bins))

    def periodogram(self, left: Complexes, low: float, high: float, *, hertz: float = 0.0) -> tuple[Floats, Floats]:
        """Trial orders (trials,) from ``low`` to ``high``, and the share (trials,) of ``left`` that each explains.

        Shares are summed over the channels of ``left`` (samples, channels). With a frequency ``hertz`` [Hz] above 0,
        lines near it are taken to stay at one frequency as the speed changes.
        """
        held, slot, count = self.held, self.sample - self.sample[0], len(self.bins)
        n = PADDED * (int(slot[-1]) + 1)
        series = np.zeros((n, left.shape[1]), dtype=np.complex128)
        turn = self.sample * held.revs / count
        late = held.clock(turn) - held.clock(held.turn[0]) - (turn - held.turn[0]) * 60.0 / held.rpm
        series[slot] = left * np.exp(-2j * np.pi * hertz * late)[:, None] if hertz else left
        per_order = n * held.revs / count
        number = np.arange(np.ceil(low * per_order), np.floor(high * per_order) + 1.0)
        power = np.square(np.abs(np.fft.fft(series, axis=0)))[number.astype(np.int64) % n] / len(slot)
        share = power / np.maximum(np.square(np.abs(left)).sum(axis=0), 1e-300)
        return number / per_order, np.asarray(share.sum(axis=1))


@dataclass(frozen=True, eq=False)
class JointLines:
    """Lines at ``places`` of a ``band``: ``phasor`` (lines, channels) and the residual ``left`` (samples, channels).

    Both are in the unit of the band's data. ``own`` (lines, channels) is the variance of a phasor in noise of power 1
    in each sample, ``free`` (lines,) says which numbers (orders or frequencies) were solved for. ``follows`` (lines,
    free, channels) is the change of the phasors with these numbers, ``moved`` (samples, free, channels) the change of
    the data that the phasors do not take up.
    """

    band: Band
    places: tuple[Place, ...]
    phasor: Complexes
    left: Complexes
    own: Floats
    free: Bools
    moved: Complexes
    follows: Complexes

    @cached_property
    def orders(self) -> Floats:
        """Orders (lines,) at the mean speed."""
        return np.array([self.band.held.order_of(place) for place in self.places])

    @cached_property
    def white(self) -> Floats:
        """Power (channels,) of the residual per sample."""
        n, lines = len(self.left), len(self.places)
        least = np.square(LEAST_NOISE * np.abs(self.band.data)).mean(axis=0) + 1e-300
        return np.asarray(np.maximum(np.square(np.abs(self.left)).sum(axis=0) / max(n - lines, 1), least))

    def noise(self, line: int) -> tuple[Floats, float]:
        """Power (channels,) of noise per sample at the line number ``line``, and its degrees of freedom.

        It is that of the residual at places beside the line that are free of lines, or of the whole band where these
        are few.
        """
        band, held = self.band, self.band.held
        seconds, place = held.span_rev * 60.0 / held.rpm, self.places[line]
        steps = np.concatenate([BESIDE_CYCLES, np.negative(BESIDE_CYCLES)]) / seconds
        beside = [Place(place.hertz + step, place.turns) for step in steps.tolist()]
        orders = [held.order_of(other) for other in beside]
        apart = [np.abs(order - self.orders).min() * held.span_rev >= NUMBERS.apart_cycles for order in orders]
        told = zip(beside, orders, apart, strict=True)
        clear = [other for other, order, is_apart in told if is_apart and band.holds(order)]
        if len(clear) < FEWEST_BESIDE:
            return self.white, max(2.0 * (len(self.left) - len(self.places)) - float(self.free.sum()), 1.0)
        shapes = band.waves(clear)
        power = np.square(np.abs(shapes.conj().T @ self.left)) / np.square(np.abs(shapes)).sum(axis=0)[:, None]
        least = np.square(LEAST_NOISE * np.abs(band.data)).mean(axis=0) + 1e-300
        return np.maximum(power.mean(axis=0), least), 2.0 * len(clear)

    @cached_property
    def number_covariance(self) -> Floats:
        """Covariance (free, free) of the orders that were solved for; channels may share noise."""
        noise = np.array([self.noise(line)[0] for line in np.flatnonzero(self.free).tolist()])
        weight, normal = 1.0 / noise.mean(axis=0), self._scores(1.0 / noise.mean(axis=0))[0]
        scale = np.sqrt(1.0 / (weight * self.white))
        shared = (self.left.conj().T @ self.left) / max(len(self.left) - len(self.places), 1) * np.outer(scale, scale)
        weighed = self.moved * weight
        score = 0.5 * np.einsum("nlc,nmd,dc->lm", weighed.conj(), weighed, shared, optimize=True).real
        inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
        ratio = np.sqrt(np.median(noise * weight, axis=1))
        return np.asarray(inverse @ score @ inverse * np.outer(ratio, ratio))

    @cached_property
    def information(self) -> tuple[Floats, Floats]:
        """Fisher's information (free, free) of the numbers that were solved for, and the score (free,).

        Both are for the noise beside the first line.
        """
        return self._scores(2.0 / self.noise(0)[0])

    def _scores(self, weight: Floats) -> tuple[Floats, Floats]:
        """Normal matrix (free, free) and score (free,) of the numbers, channels by ``weight`` (channels,)."""
        normal = np.einsum("nlc,nmc,c->lm", self.moved.conj(), self.moved, weight, optimize=True).real
        score = np.einsum("nlc,nc,c->l", self.moved.conj(), self.left, weight, optimize=True).real
        return np.asarray(normal), np.asarray(score)

    def step(self) -> Floats:
        """Gauss-Newton step (free,) of the orders."""
        normal, score = self._scores(1.0 / self.white)
        return np.asarray(np.linalg.pinv(normal + 1e-9 * np.trace(normal) * np.eye(len(score)), hermitian=True) @ score)

    def doubt(self, line: int, covariance: Floats) -> tuple[Floats, Floats]:
        """Variances (channels,) of the phasor of ``line`` along and across it from those of the free numbers.

        ``covariance`` (free, free) is that of the numbers, orders squared.
        """
        unit = (self.phasor[line] / np.maximum(np.abs(self.phasor[line]), 1e-300)).conj()
        turned = self.follows[line] * unit
        along, across = (np.einsum("lc,mc,lm->c", part, part, covariance) for part in (turned.real, turned.imag))
        return np.asarray(along), np.asarray(across)

    def sighting(self, line: int) -> Sighting:
        """The line number ``line`` with its errors."""
        noise, freedom = self.noise(line)
        variance, order_error = 0.5 * self.own[line] * noise, 0.0
        if self.free.any():
            variance = variance + self.doubt(line, self.number_covariance)[0]
        if self.free[line]:
            at = int(np.count_nonzero(self.free[:line]))
            order_error = float(np.sqrt(self.number_covariance[at, at]))
        unit = self.band.unit
        phasor, error = self.phasor[line] * unit, np.sqrt(variance) * unit
        return Sighting(float(self.orders[line]), phasor, error, order_error, freedom)


def joint_lines(
    band: Band,
    places: Sequence[Place],
    *,
    free: bool | Sequence[bool] = False,
    power: Floats | None = None,
    settled: bool = True,
) -> JointLines:
    """Least-squares fit of all lines at ``places`` to the ``band`` together.

    Parameters
    ----------
    band : neighbourhood of some orders in one recording
    places : courses of the lines; for those whose numbers are ``free`` the search begins here, to be within half a
        cycle over the recording
    free : which numbers (orders or frequencies) are solved for, by line; a single value counts for all
    power : (lines, channels), known mean squared amplitude of each line, infinite where it is not known; a line of
        known power and unknown phase takes no more of the data than that
    settled : whether free numbers are moved to the least residual; else only the information on them is computed
    """
    places, span = tuple(places), band.held.span_rev
    is_free = np.full(len(places), free) if isinstance(free, bool) else np.asarray(free, dtype=np.bool_)
    lines = _solved(band, places, is_free, power)
    for _ in range(STEPS if settled and is_free.any() else 0):
        moves = lines.step()
        if np.abs(moves).max() * span < SETTLED:
            break
        moves = np.clip(moves, -LONGEST_STEP / span, LONGEST_STEP / span)
        lines = _solved(band, _moved(band.held, lines.places, is_free, moves), is_free, power)
    return lines


def _moved(held: HeldFrames, places: tuple[Place, ...], free: Bools, orders: Floats) -> tuple[Place, ...]:
    """``places``, those that are ``free`` each moved by so many ``orders`` (free,)."""
    by = np.zeros(len(places))
    by[free] = orders
    return tuple(
        Place(place.hertz + step * held.rpm / 60.0, place.turns) if place.hertz else Place(0.0, place.turns + step)
        for place, step in zip(places, by.tolist(), strict=True)
    )


def _solved(band: Band, places: tuple[Place, ...], free: Bools, power: Floats | None) -> JointLines:
    """Lines at ``places``, as they are, by linear least squares."""
    waves, data, span = band.waves(places), band.data, band.held.span_rev
    gram, score = waves.conj().T @ waves, waves.conj().T @ data
    if power is None:
        inverse = np.linalg.pinv(gram, rcond=1e-10, hermitian=True)[None]
    else:
        inverse = _of_known_power(gram, score, data, power / np.square(band.unit))
    phasor, at = _phasors(inverse, score), np.flatnonzero(free)
    own = np.broadcast_to(np.diagonal(inverse, axis1=1, axis2=2).real.T, phasor.shape)
    nudged = _moved(band.held, places, free, np.full(len(at), SLOPE_CYCLES / span))
    slopes = (band.waves(nudged)[:, at] - waves[:, at]) * (span / SLOPE_CYCLES) if len(at) else waves[:, at]
    taken = inverse @ (waves.conj().T @ slopes)
    moved = np.moveaxis(slopes - waves @ taken, 0, 2) * phasor[at]
    follows = -np.moveaxis(taken, 0, 2) * phasor[at]
    return JointLines(band, places, phasor, data - waves @ phasor, own, free, moved, follows)


def _of_known_power(gram: Complexes, score: Complexes, data: Complexes, power: Floats) -> Complexes:
    """Inverse normal matrices (channels, lines, lines) of lines of known ``power`` (lines, channels).

    By the normal matrix ``gram`` and the ``score`` of the ``data``, in the noise that is left.
    """
    n, total = len(data), np.square(np.abs(data)).sum(axis=0)
    inverse = np.linalg.pinv(gram, rcond=1e-6, hermitian=True)[None]
    for _ in range(3):
        phasor = _phasors(inverse, score)
        taken = (2.0 * (phasor.conj() * score).real - (phasor.conj() * (gram @ phasor)).real).sum(axis=0)
        noise = np.maximum((total - taken) / max(n - 1, 1), 1e-24 * total / n + 1e-300)
        tied = np.minimum(noise / np.maximum(power, 1e-300), 1e12 * n).T
        inverse = np.linalg.inv(gram + tied[:, :, None] * np.eye(len(gram)))
    return np.asarray(inverse)


def _phasors(inverse: NDArray[np.complexfloating], score: Complexes) -> Complexes:
    """Phasors (lines, channels) by the ``inverse`` (channels or 1, lines, lines) of normal matrices and the score."""
    return np.asarray((inverse @ score.T[:, :, None])[:, :, 0].T)


def hann_lobe(off_bins: Floats) -> Floats:
    """Response of a Hann window, of any shape, ``off_bins`` (of that shape) beside a line of amplitude 1.

    It is sinc x / (1 - x²) of the distance x in bins, real as phases count from the middle of the window.
    """
    edge = np.abs(np.abs(off_bins) - 1.0) < 1e-9
    with np.errstate(divide="ignore", invalid="ignore"):
        lobe = np.sinc(off_bins) / (1.0 - off_bins**2)
    return np.asarray(np.where(edge, 0.5, lobe))
