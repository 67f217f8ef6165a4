"""Orders followed jointly through a recording whose speed sweeps, each row at a speed of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.errors import RequestError
from crankorder.fft.decimation import band_limited, sound_samples
from crankorder.fft.transforms import counted
from crankorder.orders.averages import median_of_known
from crankorder.orders.fixed_lines import steady_flag, without_steady_lines
from crankorder.orders.intervals import Z95, amplitude_interval, phase_interval_deg
from crankorder.orders.true_angle import AngleErrors, errors_along
from crankorder.orders.vold_kalman import (
    FLANK,
    HALF_POWER,
    LEVEL_DOF,
    LOWER,
    POLES,
    WIDEST,
    impulse_response,
    student_factor,
    taken_in_truth,
    vold_kalman,
)
from crankorder.quantities import (
    Bools,
    Complexes,
    Floats,
    Ints,
    QualityFlag,
    channel_coords,
    described,
    flags_of,
    remark,
    with_flags,
)
from crankorder.settings import OrderSettings
from crankorder.shaft.angle import SpeedCourse, angle_at, knots_of, smoothed_speed, speed_course, time_at

SAME_ORDER = 1e-9
"""Orders closer than this are one."""

RESOLVED_DAMPING = 0.01
"""Damping ratio of a mode that a sweep passes whose peak the filter lowers by 1 %."""

PASSED = 1.8
"""Bandwidth [Hz] over (rate of the speed / (damping · speed)) for that: the spectrum of the envelope that a mode leaves
falls by e in rate / (2π damping · speed), and 159 / (2π bandwidth / that)^4 of the peak lies beyond two poles."""

LEAST_ORDER, MOST_ORDER = 0.05, 0.4
"""Bandwidths in orders below which noise is little already, and above which orders that nobody follows leak in."""

OF_DISTANCE = 0.5
"""Bandwidth of an order over its distance from the nearest that is followed with it."""

LONGEST_PIECE_S, PIECES, FEWEST_PIECES, NEAR_BINS, BAND_OVER = 4.0, 16, 4, 3.0, 1.5
"""Of the spectrum of the noise: length of a piece at most, pieces of a recording, those without an order that tell a
bin, bins beside an order that hold something of it, and its band over the highest frequency of an order."""

FEWEST_OF_PIECE = 16
"""Samples of a piece below which it is no spectrum."""

KNOTS = 8
"""Knots of the envelopes in a reciprocal bandwidth: right to 1e-5."""

FEWEST_SAMPLES = 64
"""Usable samples of a channel below which nothing is followed in it."""

MOST_VALUES = 1 << 20
"""Samples, times orders and channels, that are followed at a time: the memory does not grow with the recording."""

MOST_CHANGE = 1.0
"""Change of the speed within a reciprocal bandwidth, as a share of it, from which a row stands for no speed."""

SPEED_SHARE = 1e-3
"""Share of the speed to which that of a row is told, however few pulses pass in a reciprocal bandwidth."""

MEMORY = 4.0
"""Reciprocal bandwidths after which the filter has all but forgotten."""

LIGHTEST_DAMPING = 0.002
"""Damping ratio of the lightest mode that is reckoned with: welded steel has so much and more."""

REACH = 2.0
"""Half reciprocal bandwidths beside a row within which a peak stands for it."""

SURE_SIGMAS = 1.0
"""Standard errors of a row from which what the filter takes of it is no noise."""

PARTED_SHARE = 1e-4
"""Standard error of a row, beside its noise, over the strongest order followed there: knots, angle and speed."""

SMOOTHING = ("smoothing", "smoothing_more", "smoothing_error")
"""Variables that say what the filter took."""

MARGIN = 6.0
"""Reciprocal bandwidths that a piece overlaps into the next: the filter's memory."""

WAVEFORM_BAND, WAVEFORM_ORDER = 1.1, 10.0
"""Band [Hz] in which the waveform is kept over the highest frequency of what is followed, and of this order."""

MOST_WAVEFORM = 1 << 18
"""Samples of a channel that are kept of the waveform at most: a longer recording keeps a narrower band."""

RATE_PER_BAND = 2.6
"""Samples per second that a hertz of band takes, about."""

RATE_PER_BANDWIDTH = 24.0
"""Band [Hz] kept over the widest bandwidth, so that knots are several samples apart."""

_VARIABLES = (
    ("amplitude", "see unit", "complex peak amplitude about top dead centre"),
    ("standard_error", "see unit", "standard error of the magnitude of amplitude"),
    ("degrees_of_freedom", "1", "degrees of freedom of standard_error"),
    ("amplitude_low", "see unit", "lower end of the 95 % interval of the magnitude"),
    ("amplitude_high", "see unit", "upper end of the 95 % interval of the magnitude"),
    ("phase_ci95", "degree", "half width of the 95 % interval of the phase; 180: unknown"),
)


class _Plan(NamedTuple):
    """What is followed: ``orders``, bandwidths [Hz] (orders, times) over the ``course``, and rows [s] of one part."""

    orders: Floats
    course: SpeedCourse
    bandwidth_hz: Floats
    span_s: tuple[float, float]
    rows_s: Floats

    def widths(self, time_s: Floats) -> Floats:
        """Bandwidth [Hz] (orders, times) at ``time_s``."""
        return np.array([np.interp(time_s, self.course.time_s, width) for width in self.bandwidth_hz])


_Part = tuple[_Plan, Complexes, Floats]
"""Plan, amplitudes and their standard errors (channels, orders, rows) of a part of a recording."""


class NoiseSpectrum(NamedTuple):
    """Spectrum ``power`` (channels, bins) of the noise between the orders of a whole recording.

    It is at ``frequency_hz`` (bins,), and NaN where there was an order at all times.
    """

    frequency_hz: Floats
    power: Floats

    @classmethod
    def of(cls, band: xr.Dataset, course: SpeedCourse, orders: Floats) -> NoiseSpectrum:
        """Noise spectrum of the BandRecording ``band``: the median of the pieces without an order nearby.

        ``course`` is the speed of its shaft, ``orders`` (orders,) are in cycles per revolution. One bin of NaN where
        the recording is too short.
        """
        from scipy.fft import rfft, rfftfreq

        top = BAND_OVER * float(orders.max(initial=1.0) * course.speed_rpm.max()) / 60.0
        if top < float(band.attrs.get("band_hz", np.inf)):
            band = band_limited(band, band_hz=top, grid_hz=1.0)
        rate, signals = float(band.attrs["rate_hz"]), np.nan_to_num(band["signal"].values)
        length = min(LONGEST_PIECE_S, signals.shape[1] / rate / PIECES)
        size, apart = int(length * rate), int(0.5 * length * rate) or 1
        if length * rate < FEWEST_OF_PIECE:
            return cls(np.zeros(1), np.full((len(signals), 1), np.nan))
        first = range(0, signals.shape[1] - size + 1, apart)
        window = np.sin(np.pi / size * np.arange(size)) ** 2  # Hann
        power = [np.square(np.abs(rfft(signals[:, at : at + size] * window))).astype(np.float32) for at in first]
        hertz, middle = rfftfreq(size, 1.0 / rate), np.array(first) / rate + 0.5 * size / rate
        middle += float(band.attrs.get("start_s", 0.0))
        speed = [np.interp(middle + way * length, course.time_s, course.speed_rpm) for way in (-0.5, 0.0, 0.5)]
        slowest, fastest = np.min(speed, axis=0) / 60.0, np.max(speed, axis=0) / 60.0
        near = np.zeros((len(hertz), len(first)), dtype=bool)
        for order in orders.tolist():
            off = hertz[:, None] - np.clip(hertz[:, None], order * slowest, order * fastest)
            near |= np.abs(off) < NEAR_BINS / length
        free = np.count_nonzero(~near, axis=1) >= FEWEST_PIECES
        typical = np.full((len(signals), len(hertz)), np.nan)
        for channel, row in enumerate(typical):
            seen = np.stack([piece[channel] for piece in power], axis=1)
            seen[near] = np.nan
            row[free] = median_of_known(seen[free], axis=1)
        return cls(hertz, typical)

    def under_over_beside(self, hertz: Floats, width_hz: Floats) -> Floats:
        """Root of the noise that passes the filters over that beside them (channels, orders, rows), 1 if not known.

        ``hertz`` and ``width_hz`` (orders, rows): frequencies and bandwidths. Beside is where the filters read it.
        """
        inside = np.linspace(-1.5, 1.5, 25)
        weight = (1.0 / (1.0 + HALF_POWER * (2.0 * inside) ** (2 * POLES))) ** 2
        outside = np.linspace(FLANK[0], min(FLANK[1], WIDEST * KNOTS), 16)
        both = []
        for offset in (inside, np.concatenate([-outside, outside])):
            at = hertz[..., None] + offset * width_hz[..., None]
            both.append(np.array([np.interp(at, self.frequency_hz, row) for row in self.power]))
        lowest = np.sort(both[1].reshape(*both[1].shape[:-1], 2, -1), axis=-1)[..., : int(LOWER * len(outside))]
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = (both[0] @ weight) / weight.sum() / lowest.mean(axis=(-1, -2))
        return np.sqrt(np.where(np.isfinite(ratio) & (ratio > 0.0), ratio, 1.0))


def followed_tracks(
    band: xr.Dataset,
    shaft: xr.Dataset,
    *,
    settings: OrderSettings,
    swept: bool = False,
    standing_out: Sequence[float] = (),
    mains_hz: Sequence[float] = (),
) -> xr.Dataset:
    """RecordingTracks (channel, order, frame) of one recording where its speed is ``swept``, else an empty dataset.

    ``band`` is the BandRecording, ``shaft`` its ShaftAngle; tracks are those of :func:`swept_tracks`. With
    ``settings.track_method`` "auto" those orders of ``settings.track_orders`` and ``standing_out`` are followed jointly
    through a sweep, beside mains of ``mains_hz``; with "frames" none are. An order that is not followed is read in the
    order map and its frames. The attribute ``swept`` says whether rows are those of a sweep, ``standing_out`` which
    orders stood out in it.
    """
    orders = [*settings.track_orders, *standing_out]
    if settings.track_method == "auto" and swept and orders:
        return swept_tracks(band, shaft, orders, mains_hz=mains_hz).assign_attrs(standing_out=list(standing_out))
    return xr.Dataset(attrs={"recording": band.attrs["recording"], "track_method": "frames", "swept": 0})


def swept_tracks(
    band: xr.Dataset, shaft: xr.Dataset, orders: Sequence[float], *, mains_hz: Sequence[float] = ()
) -> xr.Dataset:
    """Complex amplitudes (channel, order, frame) of ``orders`` in one recording whose speed sweeps, with intervals.

    ``band`` is the BandRecording by time, ``shaft`` its ShaftAngle, ``orders`` cycles per crank revolution, above 0;
    those named twice are one. All are followed jointly by a Vold–Kalman filter of two poles; the bandwidth (order,
    frame) widens with the rate of the sweep over the speed, so that a mode of 1 % damping keeps 99 % of its peak, up to
    half the distance of the nearest order. Rows are half a reciprocal bandwidth apart; ``speed`` is the slope of the
    angle over one. Where the shaft stands there are no rows; lines of one frequency, multiples of ``mains_hz`` among
    them, are taken out first; orders beyond half the sample rate, channels and rows of too few usable samples are NaN.
    """
    named = np.sort(np.asarray(orders, dtype=np.float64))
    named = named[np.diff(named, prepend=-np.inf) > SAME_ORDER]
    course = speed_course(shaft)
    band, lines = without_steady_lines(band, course, named, mains_hz=mains_hz)
    spectrum = NoiseSpectrum.of(band, course, named)
    width = bandwidths_hz(named, course)
    first, last = _covered(band, shaft)
    parts: list[_Part] = []
    notes: list[str] = []
    for begin, end in course.parts():
        span = (max(begin, first), min(end, last))
        rows = _rows(course, width.max(axis=0), span)
        if len(rows):
            plan = _Plan(named, course, width, span, rows)
            try:
                amplitude, beside = _followed(band, shaft, plan)
                hertz = named[:, None] * np.interp(rows, course.time_s, course.speed_rpm) / 60.0
                parts.append((plan, amplitude, beside * spectrum.under_over_beside(hertz, plan.widths(rows))))
            except RequestError as error:
                notes.append(f"{span[0]:.3g} to {span[1]:.3g} s: {error}")
    tracks = _dataset(band, shaft, named, course, parts)
    taken_out = [steady_flag(str(band.attrs["recording"]), lines)] if lines else []
    return with_flags(tracks, [*flags_of(shaft), *_flags(tracks, notes), *taken_out])


def bandwidths_hz(orders: Floats, course: SpeedCourse) -> Floats:
    """Bandwidth [Hz] (orders, times) with which ``orders`` (orders,) are followed along the SpeedCourse ``course``."""
    speed_hz = course.speed_rpm / 60.0
    wanted = PASSED * course.rate_rpm_per_s / 60.0 / (RESOLVED_DAMPING * speed_hz)
    wanted = np.hypot(wanted, LEAST_ORDER * speed_hz)
    apart = np.abs(orders[:, None] - orders) + np.where(np.eye(len(orders)) > 0, np.inf, 0.0)
    most = np.minimum(MOST_ORDER, OF_DISTANCE * apart.min(axis=1, initial=np.inf))
    # a soft minimum: a kink of the bandwidth would be one of the filter
    return np.asarray((wanted**-4.0 + (most[:, None] * speed_hz) ** -4.0) ** -0.25)


def followed_error(tracks: xr.Dataset, place: int) -> Floats:
    """Standard error (channels, frames) of order number ``place`` of ``tracks``, with what the filter took put back.

    However little noise there is, angle, speed and filter part orders no better than by :data:`PARTED_SHARE`.
    """
    taken = np.abs(tracks["smoothing"].values[:, place]) + tracks["smoothing_error"].values[:, place]
    strongest = np.abs(np.nan_to_num(tracks["amplitude"].values)).max(axis=1)
    return np.asarray(np.hypot(np.hypot(tracks["standard_error"].values[:, place], taken), PARTED_SHARE * strongest))


def _covered(band: xr.Dataset, shaft: xr.Dataset) -> tuple[float, float]:
    """First and last time [s] that samples and angle both know, without the tooth beyond the first and last pulse."""
    start, rate = float(band.attrs.get("start_s", 0.0)), float(band.attrs["rate_hz"])
    knots = knots_of(shaft)
    teeth = float(shaft.attrs.get("teeth_per_rev", 0.0))
    beyond = 1.0 / teeth if teeth > 0.0 else 0.0
    ends = knots["knot_angle_rev"][[0, -1]] + np.array([beyond, -beyond])
    first, last = time_at(ends, **knots) if ends[1] > ends[0] else knots["knot_time_s"][[0, -1]]
    return max(start, float(first)), min(start + (band["signal"].shape[1] - 1) / rate, float(last))


def _rows(course: SpeedCourse, width_hz: Floats, span_s: tuple[float, float]) -> Floats:
    """Times [s] of rows, half a reciprocal bandwidth apart, from half of one after the begin to as much before the end.

    None where the shaft starts or stops so fast that a row would stand for no speed (:data:`MOST_CHANGE`).
    ``width_hz`` (times,) is the widest bandwidth at the times of ``course``.
    """
    step = np.diff(course.time_s) * (width_hz[1:] + width_hz[:-1])
    count = np.concatenate([[0.0], np.cumsum(step)])
    first, last = np.interp(span_s, course.time_s, count)
    rows = np.interp(np.arange(first + 1.0, last - 1.0 + 1e-9), count, course.time_s)
    change = course.rate_rpm_per_s / (width_hz * course.speed_rpm)
    return np.asarray(rows[np.interp(rows, course.time_s, change) < MOST_CHANGE])


def _followed(band: xr.Dataset, shaft: xr.Dataset, plan: _Plan) -> tuple[Complexes, Floats]:
    """Amplitudes (channels, orders, rows) and their standard errors, piece by piece of the part that ``plan`` is of."""
    inside = (plan.course.time_s >= plan.span_s[0]) & (plan.course.time_s <= plan.span_s[1])
    fastest_hz = float(plan.course.speed_rpm[inside].max()) / 60.0
    widest_hz = float(plan.bandwidth_hz[:, inside].max())
    needed_hz = max((float(plan.orders[-1]) + 1.0) * fastest_hz, RATE_PER_BANDWIDTH * widest_hz)
    if needed_hz < float(band.attrs.get("band_hz", np.inf)):
        band = band_limited(band, band_hz=needed_hz, grid_hz=1.0)
    rate, start = float(band.attrs["rate_hz"]), float(band.attrs.get("start_s", 0.0))
    shape = (band.sizes["channel"], len(plan.orders), len(plan.rows_s))
    amplitude, error = np.full(shape, np.nan, dtype=np.complex128), np.full(shape, np.nan)
    carried = np.flatnonzero(plan.orders * fastest_hz < 0.5 * rate)
    margin = MARGIN / float(plan.bandwidth_hz[:, inside].max(axis=0).min())
    count = -(-round((plan.span_s[1] - plan.span_s[0]) * rate) * shape[0] * shape[1] // MOST_VALUES)
    for rows in np.array_split(np.arange(len(plan.rows_s)), max(1, count)):
        if not len(rows) or not len(carried):
            continue
        near = (plan.rows_s[rows[0]] - margin, plan.rows_s[rows[-1]] + margin)
        low, high = max(plan.span_s[0], near[0]), min(plan.span_s[1], near[1])
        last = band["signal"].shape[1]
        piece = slice(max(0, int(np.ceil((low - start) * rate))), min(last, int((high - start) * rate) + 1))
        channels, *tracks = _piece(band, shaft, plan, piece, carried, plan.rows_s[rows])
        if len(channels):
            at = np.ix_(channels, carried, rows)
            amplitude[at], error[at] = tracks
    hidden = np.broadcast_to(~_usable_rows(band, plan)[:, None], shape)
    amplitude[hidden], error[hidden] = np.nan, np.nan
    return amplitude, error


def _smoothing(amplitude: Complexes, plan: _Plan) -> Complexes:
    """What the filter would take of ``amplitude`` (channels, orders, rows) once more: nearly what it took at first."""
    width = plan.widths(plan.rows_s)
    # rows are half a reciprocal of the widest bandwidth apart
    step = 0.5 * width / width.max(axis=0)
    place = np.cumsum(step, axis=1)
    reach = min(amplitude.shape[2] - 1, int(np.ceil(MEMORY / step.min())))
    known = np.isfinite(amplitude)
    filled, held = np.where(known, amplitude, 0.0), known.astype(np.float64)
    total, weight = np.zeros_like(filled), np.zeros(filled.shape)
    for lag in range(-reach, reach + 1):
        here = slice(max(0, -lag), amplitude.shape[2] - max(0, lag))
        there = slice(max(0, lag), amplitude.shape[2] - max(0, -lag))
        gain = impulse_response(place[:, there] - place[:, here]) * step[:, there]
        total[..., here] += gain * filled[..., there]
        weight[..., here] += gain * held[..., there]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(amplitude - total / weight)


def _left_taken(amplitude: Complexes, taken: Complexes, error: Floats, plan: _Plan) -> tuple[Floats, Floats]:
    """What the filter of ``plan`` may have taken of ``amplitude`` beyond ``taken``, and let in of others.

    Both (channels, orders, rows), as standard errors. What is taken of a peak by much more than the filter's width
    cannot be told from what it would take once more. It reaches the rows beside the peak, and orders so near that its
    spectrum lies in their bands. ``error`` is that of the amplitude.
    """
    from scipy.ndimage import maximum_filter1d

    if not amplitude.shape[2]:
        return np.zeros(amplitude.shape), np.zeros(amplitude.shape)
    width = plan.widths(plan.rows_s)
    course = plan.course
    speed, rate = (np.interp(plan.rows_s, course.time_s, row) for row in (course.speed_rpm, course.rate_rpm_per_s))
    # over so many hertz the spectrum of what the lightest mode leaves falls by e
    widest = 2.0 * rate / (2.0 * np.pi * LIGHTEST_DAMPING * speed) / width
    sure = np.abs(taken) > SURE_SIGMAS * np.nan_to_num(error, nan=np.inf)
    lost, size = np.where(sure, np.abs(taken), 0.0), np.abs(np.nan_to_num(amplitude))
    made = np.empty(lost.shape)
    # rows that half a reciprocal bandwidth of an order takes
    for place, rows in enumerate(np.median(width.max(axis=0) / width, axis=1).tolist()):
        near = 2 * int(np.ceil(REACH * rows)) + 1
        largest, most = (maximum_filter1d(one[:, place], near, axis=1) for one in (size, lost))
        times = taken_in_truth(most / np.maximum(largest, 1e-300), widest[place])
        made[:, place] = np.maximum((times - 1.0) / Z95 * most - np.abs(np.nan_to_num(taken[:, place])), 0.0)
    apart = np.abs(plan.orders[:, None] - plan.orders)[:, :, None] * speed / 60.0
    shared = np.maximum(1.0 - apart / np.maximum(widest * width, 1e-300)[None], 0.0)
    shared[np.arange(len(shared)), np.arange(len(shared))] = 0.0
    return made, np.sqrt(np.einsum("ijr,cjr->cir", np.square(shared), np.square(made)))


def _piece(
    band: xr.Dataset, shaft: xr.Dataset, plan: _Plan, piece: slice, carried: Ints, rows_s: Floats
) -> tuple[Ints, Complexes, Floats]:
    """Channels whose samples ``piece`` suffice, amplitudes and errors (channels, orders, rows) of orders ``carried``.

    ``rows_s`` [s] are the times of the rows.
    """
    rate, start = float(band.attrs["rate_hz"]), float(band.attrs.get("start_s", 0.0))
    time_s = start + np.arange(piece.start, piece.stop) / rate
    angle = angle_at(time_s, **knots_of(shaft))
    signals = band["signal"].values[:, piece]
    usable = sound_samples(band)[:, piece] & np.isfinite(angle)
    channels = np.flatnonzero(usable.sum(axis=1) >= FEWEST_SAMPLES)
    if not len(channels):
        return channels, np.empty(0, dtype=np.complex128), np.empty(0)
    known = np.isfinite(angle)
    angle = np.interp(time_s, time_s[known], angle[known])
    points = np.linspace(time_s[0], time_s[-1], max(2, len(time_s) // 64))
    tracks = vold_kalman(
        signals[channels],
        plan.orders[carried, None] * angle,
        np.clip(np.round((rows_s - time_s[0]) * rate).astype(int), 0, len(time_s) - 1),
        usable=usable[channels],
        rate_hz=rate,
        bandwidth_hz=plan.widths(points)[carried],
        names=[f"order {order:g}" for order in plan.orders[carried]],
        knots_per_bandwidth=KNOTS,
    )
    return channels, *tracks


def _usable_rows(band: xr.Dataset, plan: _Plan) -> Bools:
    """Whether most samples (channels, rows) within a reciprocal bandwidth about each row are usable."""
    usable = sound_samples(band)
    if usable.all():
        return np.ones((len(usable), len(plan.rows_s)), dtype=bool)
    rate, start = float(band.attrs["rate_hz"]), float(band.attrs.get("start_s", 0.0))
    half = 0.5 / plan.widths(plan.rows_s).max(axis=0)
    ends = np.round((plan.rows_s + np.array([[-1], [1]]) * half - start) * rate).astype(int)
    first, last = np.clip(ends, 0, usable.shape[1])
    return np.asarray(counted(usable, first, last) >= 0.5 * (last - first))


def _dataset(
    band: xr.Dataset, shaft: xr.Dataset, orders: Floats, course: SpeedCourse, parts: list[_Part]
) -> xr.Dataset:
    """RecordingTracks of the ``parts`` of a recording: plan, amplitudes and standard errors of each."""
    shape = (band.sizes["channel"], len(orders), 0)
    taken = [_smoothing(amplitude, plan) for plan, amplitude, _ in parts]
    beyond = [_left_taken(part[1], own, part[2], part[0]) for part, own in zip(parts, taken, strict=True)]

    def joined(values: Sequence[NDArray[Any]], kind: type = float) -> NDArray[Any]:
        return np.concatenate([*values] or [np.empty(shape, dtype=kind)], axis=-1)

    time_s = np.concatenate([plan.rows_s for plan, _, _ in parts] or [np.empty(0)])
    width = np.concatenate([plan.widths(plan.rows_s) for plan, _, _ in parts] or [np.empty((len(orders), 0))], axis=1)
    amplitude, error = joined([part[1] for part in parts], complex), joined([part[2] for part in parts])
    known = np.where(np.isfinite(error), LEVEL_DOF, 0.0)
    # the filter's errors are enlarged as Student's t asks for; the interval does that again
    error = error / student_factor(np.array(LEVEL_DOF))
    magnitude, power = np.abs(amplitude), 2.0 * np.square(error)
    half = phase_interval_deg(magnitude, power, known)
    given = (amplitude, error, known, *amplitude_interval(magnitude, power, known), half)
    dims, told = ("channel", "order", "frame"), zip(_VARIABLES, given, strict=True)
    variables = {name: described(dims, values, units, text) for (name, units, text), values in told}
    coords = {**channel_coords(band), "order": described("order", orders, "1", "order")}
    attrs = {"recording": band.attrs["recording"], "amplitude_scaling": "peak", "track_method": "vold_kalman"}
    attrs |= {key: shaft.attrs[key] for key in ("phase_reference", "cycle_known", "revs_per_cycle")}
    tracks = xr.Dataset(variables, coords=coords, attrs=attrs)
    _put_places(tracks, shaft, time_s, width)
    more = "standard error of what the filter"
    for name, values, text in (
        ("smoothing", joined(taken, complex), "what the filter takes of amplitude once more: nearly its bias"),
        ("smoothing_more", joined([own for own, _ in beyond]), f"{more} took beyond that"),
        ("smoothing_error", joined([others for _, others in beyond]), f"{more} of other orders may have left here"),
    ):
        tracks[name] = described(dims, values, "see unit", text)
    usual_rate = float(np.median(course.rate_rpm_per_s[course.runs])) if course.runs.any() else 0.0
    tracks.attrs |= {"swept": 1, "sweep_rpm_per_s": usual_rate}
    angle_error = shaft["standard_error"].values
    angle_error = angle_error[np.isfinite(angle_error)]
    tracks.attrs["crank_angle_error_rev"] = float(np.median(angle_error)) if len(angle_error) else 0.0
    _put_waveform(tracks, band, shaft, course)
    return tracks


def _put_waveform(tracks: xr.Dataset, band: xr.Dataset, shaft: xr.Dataset, course: SpeedCourse) -> None:
    """Put the longest sound stretch of the signals into ``tracks``, in the band of its orders, with angle and speed.

    What rings of a mode while the next order passes it is told in the signals only, not in any one track.
    """
    fastest_hz = float(course.speed_rpm.max()) / 60.0
    top = WAVEFORM_BAND * float(tracks["order"].values.max(initial=WAVEFORM_ORDER)) * fastest_hz
    seconds = band.sizes["time"] / float(band.attrs["rate_hz"])
    top = min(top, MOST_WAVEFORM / seconds / RATE_PER_BAND)
    if top < 0.8 * float(band.attrs.get("band_hz", np.inf)):
        band = band_limited(band, band_hz=top, grid_hz=1.0)
    rate, start = float(band.attrs["rate_hz"]), float(band.attrs.get("start_s", 0.0))
    time_s = start + np.arange(band.sizes["time"]) / rate
    angle = angle_at(time_s, **knots_of(shaft))
    sound = np.isfinite(angle) & sound_samples(band).all(axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], sound, [False]]))).reshape(-1, 2)
    first, last = edges[np.argmax(edges[:, 1] - edges[:, 0])] if len(edges) else (0, 0)
    speed = np.interp(time_s[first:last], course.time_s, course.speed_rpm)
    values = band["signal"].values[:, first:last].astype(np.float32)
    tracks["waveform"] = described(("channel", "sample"), values, "see unit", "signal in the band of the orders")
    tracks["waveform_angle"] = described("sample", angle[first:last], "rev", "angle of the shaft at a sample")
    tracks["waveform_speed"] = described("sample", speed, "min-1", "speed of the shaft at a sample")
    tracks.attrs |= {"waveform_rate_hz": rate, "waveform_start_s": float(time_s[first]) if len(time_s) else start}
    tracks.attrs["waveform_band_hz"] = min(top, float(band.attrs.get("band_hz", 0.5 * rate)))


def _speed_of_rows(shaft: xr.Dataset, time_s: Floats, stretch_s: Floats) -> tuple[Floats, Floats]:
    """Speed [rpm] at ``time_s`` (rows,) over ``stretch_s`` (rows,), or so long as its pulses need to tell it.

    N pulses over a length of L revolutions, each off by e, tell the slope of their parabola to e √(12/N) / L. Second,
    its standard error: half of what half the stretch tells otherwise, which errs by √8 as much in jitter and leaves a
    quarter of what a bend of the speed makes.
    """
    near = smoothed_speed(shaft, time_s, stretch_s)
    of_one = errors_along(shaft, time_s, np.ones(len(time_s))).mean
    revs = np.cbrt(12.0 * np.square(of_one / SPEED_SHARE))
    needed = revs * 60.0 / np.maximum(near, 1e-9)
    longer = np.maximum(stretch_s, needed)
    speed = smoothed_speed(shaft, time_s, longer) if (needed > stretch_s).any() else near
    apart = np.square(0.5 * (speed - smoothed_speed(shaft, time_s, 0.5 * longer)))
    return speed, np.sqrt(np.convolve(np.pad(apart, 2, mode="edge"), np.full(5, 0.2), mode="valid"))


def _put_places(tracks: xr.Dataset, shaft: xr.Dataset, time_s: Floats, width_hz: Floats) -> None:
    """Put time, speed and crank angle of each row into ``tracks``, and the bandwidths (orders, rows) that made them."""
    errors, angle, speed, speed_error = AngleErrors(time_s, time_s), time_s, time_s, time_s
    if len(time_s):
        speed, speed_error = _speed_of_rows(shaft, time_s, 1.0 / width_hz.max(axis=0))
        errors = errors_along(shaft, time_s, speed / 60.0 / width_hz.max(axis=0))
        angle = angle_at(time_s, **knots_of(shaft))
    for name, given, units, text in (
        ("time", time_s, "s", "time of the row"),
        ("speed", speed, "min-1", "speed at the row, over a reciprocal bandwidth"),
        ("speed_error", speed_error, "min-1", "standard error of the speed"),
        ("crank_angle", angle, "rev", "crank angle of the row"),
        ("angle_scatter", errors.random, "rev", "standard error of the crank angle, beside that of its mean"),
        ("angle_error", errors.mean, "rev", "standard error of the crank angle's mean over a reciprocal bandwidth"),
    ):
        tracks.coords[name] = described("frame", given, units, text)
    between = "bandwidth of the filter, between its half-power points"
    tracks.coords["bandwidth_hz"] = described(("order", "frame"), width_hz, "Hz", between)


def _flags(tracks: xr.Dataset, notes: list[str]) -> list[QualityFlag]:
    """How the orders were followed, and which were not."""
    recording, order = str(tracks.attrs["recording"]), tracks["order"].values
    if not tracks.sizes["frame"]:
        notes = notes or ["too short to follow orders through its sweep"]
        return [remark(recording, "order_not_tracked", note, "suspect") for note in notes]
    width, speed_hz = tracks["bandwidth_hz"].values, tracks["speed"].values / 60.0
    detail = (
        f"the speed sweeps by {tracks.attrs['sweep_rpm_per_s']:.3g} rpm/s in the middle: orders "
        f"{', '.join(f'{one:g}' for one in order)} are followed jointly by Vold–Kalman with {POLES} poles and a "
        f"bandwidth of {width.min():.2g} to {width.max():.2g} Hz, {(width / speed_hz).min():.2g} to "
        f"{(width / speed_hz).max():.2g} orders"
    )
    nowhere = ~np.isfinite(tracks["standard_error"].values).any(axis=(0, 2))
    beyond = [f"order {one:g} is beyond half the sample rate at the highest speed" for one in order[nowhere]]
    not_tracked = [remark(recording, "order_not_tracked", note, "suspect") for note in (*notes, *beyond)]
    return [remark(recording, "followed_in_sweep", detail), *not_tracked]
