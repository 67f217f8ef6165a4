"""Orders of a test with what was followed of them: their numbers, and the rows of their tracks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from crankorder.identify.found import UNRESOLVED, AgreedOrder, AgreedOrders, Doubt, OrderLine, Tone, ToneKind
from crankorder.identify.lines.agreed_orders import IN_SWEEP
from crankorder.identify.lines.agreed_orders import NUMBERS as AGREED_ORDERS
from crankorder.identify.lines.growth import remark_on
from crankorder.identify.lines.line_evidence import LOWEST_BINS, excess_over_noise, noise_level
from crankorder.identify.lines.line_phasors import (
    Followed,
    any_swept,
    lines_of,
    longest_rev,
    nearest_multiple,
    recordings_of,
    standing_out,
    sure_half_width,
)
from crankorder.identify.lines.order_lines import longer_frames
from crankorder.orders.fixed_lines import FixedLine, OrderRows, PartedRow
from crankorder.orders.intervals import half_width, interval
from crankorder.orders.track_rows import TrackReader, all_tracked, track_order
from crankorder.quantities import Bools, Floats, Ints, QualityFlag
from crankorder.settings import MethodNumbers, OrderSettings, Settings

NUMBERS = MethodNumbers("5-identify-lines.toml", "followed_orders")

ONLY_FOLLOWED = Doubt(
    "followed only", "seen along the sweep only, where it was followed: no frame of the map holds it for long"
)


def numbered_as_followed(orders: Sequence[AgreedOrder], followed: Sequence[xr.Dataset]) -> AgreedOrders:
    """``orders`` of which an undecided one has the number under which it was followed, where its interval holds that.

    A fast sweep turns the phase of a line by its modes in so few revolutions that its number is known to a percent
    only; the tracks of ``followed`` (RecordingTracks) stand at a multiple of the cycle's then, or at what long frames
    tell: that is told within the 99.9 % interval of the order, a multiple is but likely and lies within that of 95 %.
    A number that another of the orders has already is left to that; errors grow by what a number moves.
    """
    tracks = [np.zeros(0), *(sweep["order"].values for sweep in followed if sweep.attrs.get("swept", 0))]
    numbers = np.unique(np.concatenate(tracks))
    if not len(numbers):
        return tuple(orders)
    found = np.array([agreed.order for agreed in orders])
    taken = [number for number in numbers if (np.abs(found - number) <= NUMBERS.same_order * number).any()]
    renumbered = []
    for agreed in orders:
        number = float(numbers[np.abs(numbers - agreed.order).argmin()])
        off, sigmas = abs(number - agreed.order), half_width(agreed.degrees_of_freedom)
        reach = sigmas * agreed.order_error
        if not (2.0 * number).is_integer():
            reach = sure_half_width(agreed.order_error, agreed.degrees_of_freedom)
        within = NUMBERS.same_order * number < off <= reach
        if agreed.lock == "undecided" and within and number not in taken:
            taken.append(number)
            # what was told lies within
            agreed = replace(agreed, order=number, order_error=agreed.order_error + off / sigmas)
        renumbered.append(agreed)
    return tuple(sorted(renumbered, key=lambda agreed: agreed.order))


def with_followed(orders: Sequence[AgreedOrder], followed: Sequence[xr.Dataset], order_map: xr.Dataset) -> AgreedOrders:
    """``orders`` and, undecided, those that tracks of ``followed`` (RecordingTracks) alone show.

    A fast sweep lets a multiple of the cycle's order stand out for a moment only, as where it meets a mode: too few
    speeds of the OrderMap ``order_map`` hold it, but the frames of its recording told that it is worth following. And
    slow lines, of which the frames of the map hold too few periods, stand out in the longer ones that it was read in.
    """
    cycle = int(order_map.attrs["revs_per_cycle"])
    known_orders = list(orders)
    axis = order_map["order"].values
    if len(axis) < 2:
        return tuple(orders)
    step = float(axis[1] - axis[0])
    for sweep in followed:
        # within LOWEST_BINS of order 0, or of the one before that is: short frames hold these as one with the mean
        places = standing_out(sweep)
        numbers = [float(sweep["order"].values[place]) for place in places]
        slow = places[: int(np.cumprod(np.diff(numbers, prepend=0.0) < LOWEST_BINS * step).sum())]
        for place, number in zip(places, numbers, strict=True):
            beside = (abs(number - sweep["order"].values[other]) for other in slow if other != place)
            apart = 0.5 * min(step, min(beside, default=step)) if place in slow else 0.5 * step
            known = any(abs(kept.order - number) <= max(NUMBERS.same_order * number, apart) for kept in known_orders)
            off = 0.0 if place in slow else abs(nearest_multiple(number, revs_per_cycle=cycle) - number)
            if known or off > NUMBERS.same_order * number:
                continue
            with np.errstate(invalid="ignore", divide="ignore"):
                level = np.abs(sweep["amplitude"].values[:, place]) / sweep["standard_error"].values[:, place]
            clear = np.nan_to_num(level) > NUMBERS.clear_sigmas
            clear &= (np.count_nonzero(clear, axis=1) >= NUMBERS.clear_rows)[:, None]  # (channel, frame)
            if clear.any():
                span = float(np.ptp(sweep["crank_angle"].values[clear.any(axis=0)]))
                error = min(apart, AGREED_ORDERS.most_mode_turns / span) / half_width(np.inf)
                lines = _lines_along(sweep, place, clear, error, order_map)
                doubts = (ONLY_FOLLOWED, IN_SWEEP)
                known_orders.append(AgreedOrder(number, error, np.inf, "undecided", None, lines, doubts))
    return tuple(sorted(known_orders, key=lambda agreed: agreed.order))


def slow_flags(
    order_map: xr.Dataset, orders: Sequence[AgreedOrder], frames: Sequence[xr.Dataset], *, settings: Settings
) -> list[QualityFlag]:
    """That something stands below the lowest order that the OrderMap ``order_map`` tells, and none of ``orders`` does.

    At most of its speeds in a channel, above what noise reaches there by ``settings``: by the last bin below, which
    holds nothing of the mean. The length of the recordings of ``frames`` (OrderFrames) says what longer frames tell.
    """
    revs, at, amplitude = float(order_map.attrs["revs_per_frame"]), int(LOWEST_BINS), order_map["amplitude"].values
    if amplitude.shape[2] <= at + 1 or any(agreed.order * revs < LOWEST_BINS for agreed in orders):
        return []
    over = excess_over_noise(order_map, settings=settings.identify, orders=settings.orders)
    n, chance = order_map["n_independent"].values.astype(float), settings.identify.false_alarm_probability
    stands = over.ratio[..., at] > np.vectorize(noise_level)(n, over.floor_worth[..., at], chance)
    stands &= amplitude[..., at] > amplitude[..., at + 1]  # the skirt of a line that lies higher would rise
    if not (stands.mean(axis=1) > 0.5).any():
        return []
    recordings = recordings_of(frames)
    longest = longer_frames(revs, longest_rev(recordings))[-1]
    asks = "record longer at a held speed, for longer frames ([orders] revs_per_frame)"
    if longest > revs and not any_swept(recordings):
        asks = f"[orders] revs_per_frame = {longest:g} in a recipe tells those from {LOWEST_BINS / longest:.2g} on"
    short = f"frames of {revs:g} revolutions"
    what = f"below order {LOWEST_BINS / revs:.2g} stands a slow line or a drift, of which {short}"
    return [{"recording": "all", "flag": "slow_lines", "severity": "info", "detail": f"{what} tell no order: {asks}"}]


def _lines_along(
    sweep: xr.Dataset, place: int, clear: Bools, error: float, order_map: xr.Dataset
) -> tuple[OrderLine, ...]:
    """Lines of the order at ``place`` of the tracks of a ``sweep``, in rows of the map, where it is ``clear``."""
    number, none = float(sweep["order"].values[place]), np.zeros(0)
    stand_ins, seen = [], np.zeros(0, dtype=np.int64)
    amplitude, noise = (sweep[key].values[:, place] for key in ("amplitude", "standard_error"))
    for name, size, own, rows in zip(sweep["channel"].values.tolist(), np.abs(amplitude), noise, clear, strict=True):
        if rows.any():
            level = 20.0 * np.log10(float((size[rows] / own[rows]).max()))
            line = OrderLine(name, number, error, seen, none, none, none, none, none, "follows the speed", level)
            stand_ins.append(line)
    track = Followed(sweep, place, number, error**2, by_phase=False, course=None)
    speeds = order_map["speed"].values
    return tuple(lines_of(stand_ins, [track], speed_rpm=speeds, order=number, order_error=error))


FIXED_WORDS: dict[ToneKind, str] = {"mains": "mains", "tone": "a tone"}
"""Lines that stay where they are, in a sentence; what may be an order is none."""


def with_track_rows(
    orders: Sequence[AgreedOrder], reader: TrackReader, *, settings: OrderSettings
) -> Iterator[AgreedOrder]:
    """``orders`` whose lines hold the amplitudes, phases and intervals of the rows of their tracks, as ``reader`` has
    them for all orders of the test and those that ``settings`` ask for.

    At held speeds these are the rows at which a line was seen; of a sweep, those that surely hold something of it.
    """
    cycle = int(reader.order_map.attrs["revs_per_cycle"])
    numbers = [track_number(known, revs_per_cycle=cycle) for known in orders]
    tracked = all_tracked(numbers, settings)
    for agreed, number in zip(orders, numbers, strict=True):
        others = [other for other in tracked if other != number]
        of_track = reader.rows(number, others), reader.met(number, others), reader.worth(number), reader
        yield replace(agreed, lines=tuple(_read(line, *of_track) for line in agreed.lines), tracked=number)


def fixed_lines(tones: Sequence[Tone]) -> tuple[FixedLine, ...]:
    """Those of ``tones`` that stay where they are, as orders meet them."""
    return tuple(
        FixedLine(tone.frequency_hz, tone.frequency_error_hz, FIXED_WORDS[tone.kind], dict(tone.amplitude))
        for tone in tones
        if tone.kind in FIXED_WORDS
    )


def track_number(agreed: AgreedOrder, *, revs_per_cycle: int) -> float:
    """The number at which the track of ``agreed`` stands (``revs_per_cycle`` 1 or 2: what it may be locked to).

    What counts is where the line stands at the angle that was recorded: an error of the speed moves both alike.
    """
    ends = interval(agreed.order, agreed.line_error, freedom=agreed.degrees_of_freedom)
    return track_order(agreed.order, ends, agreed.lock, revs_per_cycle=revs_per_cycle)


def _read(line: OrderLine, rows: OrderRows, met: Sequence[PartedRow], worth: Floats, reader: TrackReader) -> OrderLine:
    """``line`` with what the ``rows`` of its track hold; as it was where they hold nothing, or it is none.

    Rows that ``met`` lines of one frequency are no longer what the frames showed there; ``worth`` (rows,) is how many
    independent values each stands for.
    """
    if line.doubts == (UNRESOLVED,):
        return line
    channel = reader.order_map["channel"].values.tolist().index(line.channel)
    amplitude, error = rows.amplitude[channel], rows.standard_error[channel]
    known = np.isfinite(amplitude) & np.isfinite(error) & (amplitude > 0.0)
    held = len(reader.map_rpm)
    chosen = known & (rows.amplitude_low[channel] > 0.0)
    chosen[:held] = known[:held] & np.isin(np.arange(held), line.seen)
    at = np.flatnonzero(chosen)
    if not len(at):
        return line
    ends = np.stack([rows.amplitude_low[channel, at], rows.amplitude_high[channel, at]], axis=1)
    made = replace(
        line,
        seen=reader.nearest_row_of_map(at),
        speed_rpm=reader.speed_rpm[at],
        amplitude=amplitude[at],
        amplitude_error=error[at],
        degrees_of_freedom=rows.degrees_of_freedom[channel, at].astype(np.float64),
        phase_deg=rows.phase[channel, at],
        ends=ends,
        phase_ci95_deg=rows.phase_ci95[channel, at],
        n_independent=worth[at],
    )
    apart = [row for row in met if row.matters[channel]]
    is_as_shown = (at < held) & ~np.isin(at, [row.row for row in apart])
    shown = bool(is_as_shown[int(np.argmax(made.amplitude))])
    remark = remark_on(made.amplitude, made.amplitude_error, made.degrees_of_freedom, ends) if shown else ""
    return replace(made, remark="; ".join(text for text in (remark, *_met_words(apart, made, at, channel)) if text))


def _met_words(met: Sequence[PartedRow], line: OrderLine, at: Ints, channel: int) -> Iterator[str]:
    """What is said of rows that ``met`` lines of one frequency, of those ``at`` which ``line`` was seen."""
    for row in met:
        place = np.flatnonzero(at == row.row)
        if not len(place) or line.ends is None:
            continue
        rpm, (low, high) = float(line.speed_rpm[place[0]]), line.ends[place[0]]
        what = " and ".join(line_met.text for line_met in row.lines)
        if row.is_parted[channel]:
            yield f"told apart from {what}"
        elif high - low > NUMBERS.told_share * line.amplitude[place[0]]:
            yield f"{what} meets it at {rpm:.5g} rpm, where its own share is {low:.3g}…{high:.3g}"
