"""95 % intervals of amplitudes, phases and what was found, and which of many comparisons may be claimed.

They come from the noise of estimates and from what differs between recordings. Student's t holds wherever a standard
error has degrees of freedom of its own; of what is claimed of many comparisons at most a stated share is false.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.special import chndtr, ndtri, stdtrit

from crankorder.quantities import Bools, Complexes, Floats, Ints

LEVEL = 0.95
Z95 = float(ndtri(0.5 + 0.5 * LEVEL))
"""Half width of a 95 % interval in standard deviations of a normal distribution."""

LARGEST_DOF = 400
"""Student's t is the normal distribution to 0.3 % beyond."""

ENDLESS_FREEDOM = 1e6
"""Degrees of freedom from which on Student's t is a normal distribution."""

MOST_LOGARITHM = 50.0
"""Logarithm of a factor beyond which nothing is known."""


def t_quantile(dof: Floats) -> Floats:
    """Half width of a 95 % interval in standard errors, by Student's t, of the shape of ``dof``.

    ``dof`` (any shape) are the degrees of freedom of the standard error; infinite where they are not above 0.
    """
    dof = np.asarray(dof, dtype=np.float64)
    asked, where = np.unique(dof, return_inverse=True)
    with np.errstate(invalid="ignore"):
        found = np.where(asked > 0.0, stdtrit(np.minimum(asked, LARGEST_DOF), 0.5 + 0.5 * LEVEL), np.inf)
    return np.asarray(found[where].reshape(dof.shape))


def amplitude_interval(amplitude: Floats, noise_power: Floats, dof: Floats) -> tuple[Floats, Floats]:
    """Lower and upper end of the 95 % interval of the amplitude of a line in complex Gaussian noise.

    Far above the noise it is Student's t about the amplitude without what noise adds to it; near the noise the
    Rician distribution is inverted. The lower end leaves 0 exactly where the line is seen (:func:`is_seen`), and grows
    from there as the Rician distribution averaged over the noise powers that ``noise_power`` and ``dof`` allow (within
    0.1 standard errors from 4 degrees of freedom on); the upper end is at least what noise alone can hide.

    Parameters
    ----------
    amplitude : any shape, magnitude of the complex estimate; NaN gives NaN
    noise_power : any shape, mean square of its complex error; the standard error of the amplitude is the root of half
        of it
    dof : any shape, degrees of freedom of ``noise_power``; 0 or NaN gives 0 and infinity. All three broadcast to the
        shape of both results
    """
    amplitude, noise_power, dof = np.broadcast_arrays(amplitude, noise_power, dof)
    tail = 0.5 * (1.0 - LEVEL)
    with np.errstate(invalid="ignore", divide="ignore"):
        stretch = t_quantile(dof) / Z95
        widened = np.sqrt(noise_power) * stretch
        ratio = amplitude / widened
        least = beyond_chance(dof, tail) / stretch**2  # square of the ratio from which the line is seen
        shift = (least + np.log(tail)) * least / ratio**2
        low = _rician_ends(np.sqrt(np.maximum(ratio**2 - shift, 0.0)))[0]
        low = np.where(ratio**2 > least, low * widened, 0.0)
        high = _rician_ends(ratio)[1] * widened
    exact = noise_power == 0.0
    low, high = np.where(exact, amplitude, low), np.where(exact, amplitude, high)
    unknown = ~(dof > 0.0) | ~np.isfinite(noise_power)
    low, high = np.where(unknown, 0.0, low), np.where(unknown, np.inf, high)
    missing = np.isnan(amplitude)
    return np.where(missing, np.nan, low), np.where(missing, np.nan, high)


def energy_interval(
    power: Floats, *, noise: Floats, bias: Floats, noise_variance: Floats, dof: Floats
) -> tuple[Floats, Floats]:
    """Lower and upper end of the 95 % interval of an amplitude whose square was averaged without phase.

    All parameters broadcast to one shape, (…, orders), which both ends have.

    Parameters
    ----------
    power : (…, orders), squared amplitude, with noise
    noise : noise power with which the line beats: the variance of ``power`` is 2 line noise + noise_variance
    bias : what noise adds to ``power`` on average
    noise_variance : variance of ``power`` without a line
    dof : degrees of freedom of the noise power behind all three
    """
    line = np.maximum(power - bias, 0.0)
    reach = t_quantile(dof) * np.sqrt(2.0 * line * noise + noise_variance)
    return np.sqrt(np.maximum(line - reach, 0.0)), np.sqrt(line + reach)


def phase_interval_deg(amplitude: Floats, noise_power: Floats, dof: Floats) -> Floats:
    """Half width [degree] of the 95 % interval of the phase; 180, unknown, where noise alone could be as large.

    The part of the error across the line is normal whatever the amplitude (Fieller 1954): the true phase is within
    arcsin(t standard_error / amplitude).

    Parameters
    ----------
    amplitude : any shape, magnitude of the complex estimate; NaN gives NaN
    noise_power : mean square of its complex error, of a shape that broadcasts with it
    dof : degrees of freedom of ``noise_power``, of a shape that broadcasts with it
    """
    amplitude, noise_power, dof = np.broadcast_arrays(amplitude, noise_power, dof)
    clear = is_seen(amplitude, noise_power, dof)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = t_quantile(dof) * np.sqrt(0.5 * noise_power) / amplitude
        half = np.where(clear & (share < 1.0), np.degrees(np.arcsin(np.minimum(share, 1.0))), 180.0)
    return np.where(np.isnan(amplitude), np.nan, half)


def is_seen(amplitude: Floats, noise_power: Floats, dof: Floats) -> Bools:
    """Whether ``amplitude`` is larger than noise alone makes it once in forty times.

    ``amplitude`` (any shape) is the magnitude of the complex estimate, ``noise_power`` the mean square of its error,
    ``dof`` the degrees of freedom of that; all three broadcast to the shape of the result. NaN is not seen.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(np.square(amplitude) > noise_power * beyond_chance(dof, 0.5 * (1.0 - LEVEL)))


def beyond_chance(dof: Floats, chance: float) -> Floats:
    """Power over the noise power that noise alone exceeds with ``chance`` (0 to 1), of the shape of ``dof``.

    It is the quantile of the F distribution with 2 and ``dof`` (at least 0.1) degrees of freedom.
    """
    dof = np.maximum(dof, 0.1)
    return np.asarray(0.5 * dof * np.expm1(-2.0 / dof * np.log(chance)))


def _rician_ends(ratio: Floats) -> tuple[Floats, Floats]:
    """Ends of the interval of a line whose noisy amplitude is ``ratio``, both over the root of the noise power."""
    known, low, high = _rician_table()
    far = np.sqrt(np.maximum(ratio**2 - 0.5, 0.0))
    half = Z95 / np.sqrt(2.0)
    near = ratio < known[-1]
    ends = zip((low, high), (far - half, far + half), strict=True)
    lower, upper = (np.where(near, np.interp(ratio, known, end), beyond) for end, beyond in ends)
    return lower, upper


@functools.cache
def _rician_table() -> tuple[Floats, Floats, Floats]:
    """Noisy amplitudes and the true ones above and below which they are 1 in 40, all over the root noise power.

    Twice the square of the ratio is a noncentral chi-square variable with two degrees of freedom.
    """
    true = np.linspace(0.0, 10.0, 201)
    seen = np.linspace(0.0, 8.0, 161)
    below = chndtr(2.0 * seen[:, None] ** 2, 2.0, 2.0 * true**2)
    tail = 0.5 * (1.0 - LEVEL)
    low = np.array([np.interp(-(1.0 - tail), -row, true, left=0.0) for row in below])
    high = np.array([np.interp(-tail, -row, true, left=0.0) for row in below])
    return seen, low, np.maximum(high, Z95 / np.sqrt(2.0))


LOCATED = ("tdc", "index", "pulse")
"""Phase references that stand for a place on the crank, the same in every recording; a pulse is one per revolution."""

WHOLE = 1e-6
"""An order this close to a whole number is one: a crank mark tells its phase, whichever turn of the cycle it is."""


def one_phase_reference(used: Sequence[xr.Dataset]) -> bool:
    """Whether the OrderFrames ``used`` (channel, frame, order) share one ``phase_reference``, a place on the crank.

    The zero of a count that no index sets is one in a single recording.
    """
    marks = {str(item.attrs["phase_reference"]) for item in used}
    return len(marks) == 1 and marks <= {*LOCATED, *(("count",) if len(used) == 1 else ())}


def phase_reference_of(used: Sequence[xr.Dataset]) -> str:
    """The ``phase_reference`` attribute of the OrderFrames ``used`` (channel, frame, order); "mixed" if they differ."""
    marks = {str(item.attrs["phase_reference"]) for item in used}
    return marks.pop() if len(marks) == 1 else "mixed"


def phases_compare(used: Sequence[xr.Dataset], order: Floats) -> Bools:
    """Whether all OrderFrames ``used`` tell the phase of each ``order`` from one mark and in one turn of the cycle.

    ``order`` (orders,) is in cycles per revolution; the result has its shape.
    """
    order = np.asarray(order, dtype=np.float64)
    if not one_phase_reference(used):
        return np.zeros(order.shape, dtype=np.bool_)
    whole = np.abs(order - np.round(order)) < WHOLE
    return np.asarray(whole | all(int(item.attrs["cycle_known"]) for item in used))


@dataclass(frozen=True)
class BetweenRecordings:
    """Scatter of the recordings' means about the mean of all frames, each field (channels, orders).

    ``along`` and ``across`` are the scatter along and across the mean, as powers of a circular noise with that part on
    each axis; ``recordings`` is their number, below two where nothing can differ. ``share`` is the share of the scatter
    that is the variance of the mean, were all scatter between recordings: the sum of squared weights over one less that
    sum, so 1 / (recordings - 1) where all have as many frames.
    """

    along: Floats
    across: Floats
    recordings: Floats
    share: Floats

    @property
    def both(self) -> Floats:
        """Power (channels, orders) of the scatter: the mean of ``along`` and ``across``."""
        return 0.5 * (self.along + self.across)


def between_recordings(spectrum: Complexes, owner: Ints, mean: Complexes) -> BetweenRecordings:
    """Scatter of recordings about the ``mean`` (channels, orders) of all frames.

    Parameters
    ----------
    spectrum : (channels, frames, orders); NaN takes no part
    owner : (frames,), the number of the recording of each
    mean : (channels, orders), mean over the frames of ``spectrum``
    """
    names = np.unique(owner)
    zero = np.zeros(mean.shape)
    if len(names) < 2:
        return BetweenRecordings(zero, zero, zero + len(names), zero)
    length = np.abs(mean)
    back = np.where(length > 0.0, mean / np.where(length > 0.0, length, 1.0), 1.0).conj()
    counts, along, across = [], [], []
    for name in names:
        part = spectrum[:, owner == name]
        kept = np.isfinite(part.real)
        count = np.count_nonzero(kept, axis=1)
        apart = (np.where(kept, part, 0.0).sum(axis=1) / np.maximum(count, 1) - mean) * back
        counts.append(count)
        along.append(count * np.square(apart.real))
        across.append(count * np.square(apart.imag))
    weights, total = np.array(counts, dtype=np.float64), np.maximum(np.sum(counts, axis=0), 1)
    squares = np.square(weights / total).sum(axis=0)
    share = np.divide(squares, 1.0 - squares, out=np.zeros_like(squares), where=squares < 1.0)
    recordings = np.count_nonzero(weights, axis=0).astype(np.float64)
    power, turned = (2.0 * np.sum(part, axis=0) / total for part in (along, across))
    return BetweenRecordings(power, turned, recordings, share)


def wider_of(
    power: Floats, dof: Floats, scatter: Floats, between: BetweenRecordings, *, parts: int = 1
) -> tuple[Floats, Floats]:
    """Noise power and its degrees of freedom: those of the frames or of the recordings, whichever errs more.

    Student's t of the recordings' means covers the truth whatever there is between them, even nothing; a pooled
    variance (Birge 1932, with the degrees of freedom of Satterthwaite 1946) covers 0.83 where two recordings differ.

    Parameters
    ----------
    power, dof : (channels, orders), noise power of the mean over the frames and its degrees of freedom, by the frames'
        own scatter; NaN and 0 where they say nothing
    scatter : (channels, orders), ``along``, ``across`` or ``both`` of ``between``
    between : scatter of the recordings; nothing changes where they are fewer than two
    parts : number of real parts in ``scatter``: 2 for ``both``, else 1
    """
    freedom = np.maximum(between.recordings - 1.0, 0.0)
    within = np.nan_to_num(power)
    # were the frames all of the scatter it would be (recordings - 1) power; with unlike weights only more than that
    # is of the recordings
    apart = np.maximum(within + between.share * (scatter - freedom * within), 0.0)
    own = dof > 0.0
    reach = np.where(own, np.sqrt(within) * t_quantile(np.where(own, dof, 1.0)), 0.0)
    several = np.sqrt(apart) * t_quantile(np.maximum(parts * freedom, 1.0))
    wider = (freedom > 0.0) & (several > reach)
    return np.where(wider, apart, power), np.where(wider, parts * freedom, dof)


def ends_between(
    ends: tuple[Floats, Floats], amplitude: Floats, *, within: tuple[Floats, Floats], wider: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Interval of an amplitude whose recordings scatter more than their frames.

    From one recording to the next an amplitude changes by a factor, which makes no visible line vanish: the interval
    reaches from the amplitude divided by a factor, 1 + Student's t times the relative error, to the amplitude times it.

    Parameters
    ----------
    ends : lower and upper end by the frames alone, each (channels, orders)
    amplitude : (channels, orders), mean over the recordings
    within : noise power and degrees of freedom by the frames, each (channels, orders)
    wider : both, each (channels, orders), as :func:`wider_of` returns them; where they are no wider ``ends`` stay
    """
    is_wider = (wider[0] != within[0]) & np.isfinite(wider[0])
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = 1.0 + t_quantile(wider[1]) * np.sqrt(0.5 * wider[0]) / amplitude
        low, high = np.minimum(ends[0], amplitude / reach), np.maximum(ends[1], amplitude * reach)
    return np.where(is_wider, low, ends[0]), np.where(is_wider, high, ends[1])


def known_freedom(freedom: float) -> float:
    """Degrees of ``freedom`` of a standard error as Student's t takes them: from 1 to ENDLESS_FREEDOM; NaN is 1."""
    return ENDLESS_FREEDOM if freedom > ENDLESS_FREEDOM else freedom if freedom > 1.0 else 1.0


def half_width(freedom: float, *, level: float = 0.95) -> float:
    """Half width, in standard errors with ``freedom`` degrees of freedom, of the two-sided interval of a ``level``.

    ``freedom`` may be infinite and counts as 1 at least; ``level`` is 0 to 1.
    """
    return float(stdtrit(known_freedom(freedom), 0.5 + 0.5 * level))


def half_widths(freedom: Floats, *, level: float = 0.95) -> Floats:
    """Half widths as of :func:`half_width`, of the shape of ``freedom``, at one ``level`` of confidence, 0 to 1."""
    held = np.where(freedom > 1.0, np.minimum(freedom, ENDLESS_FREEDOM), 1.0)
    return np.asarray(stdtrit(held, 0.5 + 0.5 * level))


def error_of(value: float, ends: Sequence[float]) -> float:
    """Standard error of a stated ``value`` from the wider side of its 95 % interval with the ``ends`` (low, high).

    All are in one unit. The narrower side may be cut off at 0, as that of amplitudes and damping ratios is.
    """
    return max(float(ends[1]) - value, value - float(ends[0])) / Z95


def interval(value: float, error: float, *, freedom: float = np.inf) -> tuple[float, float]:
    """95 % interval of ``value`` with its standard ``error`` in the same unit, of ``freedom`` degrees of freedom."""
    half = error * half_width(freedom)
    return value - half, value + half


def positive_interval(value: float, half: float) -> tuple[float, float]:
    """Ends of the interval of half width ``half`` about a positive ``value``, in its unit; the lower end stays above 0.

    ``value`` is above 0 by nature, as a frequency is.
    """
    return max(value - half, value * float(np.exp(-MOST_LOGARITHM))), value + half


def size_interval(value: complex, half: float) -> tuple[float, float]:
    """Ends, from 0 on, of the interval of half width ``half`` about the magnitude of the phasor ``value``, in its unit.

    The lower end is 0 where ``half`` is larger than the magnitude.
    """
    return max(abs(value) - half, 0.0), abs(value) + half


def ratio_interval(value: float, error: float, *, most: float = np.inf) -> tuple[float, float]:
    """95 % interval of a positive ``value`` with its standard ``error``, symmetric in the logarithm, up to ``most``.

    All three have one unit. A quantity known by a product, such as a damping ratio, errs by a factor: its lower end is
    above 0.
    """
    half = Z95 * error / value if value > 0.0 else np.inf
    factor = float(np.exp(min(half, MOST_LOGARITHM)))
    return value / factor, max(min(value * factor, most), value)


def adjusted(p_values: Floats) -> Floats:
    """Smallest false-discovery rate at which each comparison would be claimed, of the shape of ``p_values``.

    ``p_values`` lie between 0 and 1; NaN, where nothing was compared, stays NaN and counts as no comparison. It holds
    for independent and positively dependent comparisons (Benjamini, Yekutieli 2001, theorem 1.2).
    Source: Benjamini, Hochberg (1995), J. R. Statist. Soc. B 57, 289, eq. 1.
    """
    flat = np.ravel(np.asarray(p_values, dtype=np.float64))
    rates = np.full(flat.shape, np.nan)
    known = np.flatnonzero(np.isfinite(flat))
    n = len(known)
    if n:
        rank = np.argsort(flat[known], kind="stable")
        factor = n / np.arange(1.0, n + 1.0)
        rates[known[rank]] = np.minimum(np.minimum.accumulate((flat[known][rank] * factor)[::-1])[::-1], 1.0)
    return rates.reshape(np.shape(p_values))


def claimed(p_values: Floats, *, q: float) -> Bools:
    """True (of the shape of ``p_values``) for comparisons that may be claimed with a false-discovery rate up to ``q``.

    Parameters
    ----------
    p_values : any shape, 0 to 1; NaN is never claimed
    q : share of the claims that may be false on average, 0 to 1; where nothing differs at all it is the chance that
        anything is claimed
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(adjusted(p_values) <= q)


def simes(p_values: Floats) -> float:
    """P-value of "none of these differs", from ``p_values`` of any shape; NaN takes no part, of none it is NaN.

    Source: Simes (1986), Biometrika 73, 751.
    """
    return float(np.nanmin(adjusted(p_values), initial=np.inf)) if np.isfinite(p_values).any() else np.nan


def excess_scatter(misfit: Callable[[float], float], freedom: float, *, most: float, within: float) -> float:
    """Scatter beyond the errors, 0 to ``most``, at which ``misfit`` equals its degrees of ``freedom``.

    ``misfit`` of a scatter is the sum of the squares of residuals over their variances, with that scatter in them. The
    result is exact to ``within``, in its unit; it is 0 where the errors alone explain the misfit.
    Source: Paule and Mandel (1982), J. Res. NBS 87, 377.
    """
    if misfit(0.0) <= freedom:
        return 0.0
    return root(lambda scatter: misfit(scatter) - freedom, 0.0, most, within=within)


def root(function: Callable[[float], float], low: float, high: float, *, within: float) -> float:
    """Root of ``function``, whose signs at ``low`` and ``high`` differ, exact to ``within`` or a billionth of the root.

    It is found by inverse parabolas where they help, else by bisection (Chandrupatla 1997). SciPy's own takes half a
    second to load.
    """
    a, b, share = high, low, 0.5
    f_a, f_b = function(a), function(b)
    c, f_c = a, f_a
    while f_a != 0.0 and abs(b - a) > 2.0 * (least := within + 1e-9 * min(abs(a), abs(b))):
        edge = least / abs(b - a)
        at = a + min(max(share, edge), 1.0 - edge) * (b - a)
        f_at = function(at)
        if (f_at > 0.0) == (f_a > 0.0):
            c, f_c = a, f_a
        else:
            c, f_c, b, f_b = b, f_b, a, f_a
        a, f_a, share = at, f_at, 0.5
        place, level = (a - b) / (c - b), (f_a - f_b) / (f_c - f_b)
        if level**2 < place and (1.0 - level) ** 2 < 1.0 - place:
            share = f_a / (f_b - f_a) * f_c / (f_b - f_c) + (c - a) / (b - a) * f_a / (f_c - f_a) * f_b / (f_c - f_b)
    return a if abs(f_a) < abs(f_b) else b
