"""Envelope spectrum of a recording by order: strikes that ring a resonance far above the orders of the shaft."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from crankorder.fft.transforms import FrameTransform
from crankorder.fft.windows import hann
from crankorder.orders.envelope_band import (
    GUARD_SAMPLES,
    HIGHEST_SHARE,
    Band,
    Bands,
    Blocks,
    band_tree,
    block_spectra,
    envelopes_of,
)
from crankorder.orders.envelope_combs import (
    LOWEST_ORDER,
    WIDER_EVIDENCE,
    Combs,
    best_band,
    floor_worth,
    free_of_others,
    joined_looks,
    line_floor,
    looked_at,
    looks_of,
    over_skirts,
    served,
)
from crankorder.quantities import Floats, Ints, Variables, channel_coords, described, flags_of, remark, with_flags
from crankorder.settings import OrderSettings
from crankorder.shaft.angle import angle_at, knots_of, time_at
from crankorder.shaft.speeds import speed_groups

LEAST_REVS = 8
"""Revolutions of a frame below which no envelope spectrum is made: bearing lines could not be told from each other."""

PIECES = 4
"""Pieces, spread evenly, of a recording that is longer than what is analysed of it, at most."""

FRAMES_PER_PIECE = 2
"""Frames that a piece holds at least, where that is not more than is analysed: cut pieces lose what overlaps."""

SEARCH_REACH = 1.25
"""Multiple of the highest order looked at to which the spectra of all bands go: what folds at their end is far away."""

SURE_OF_COMB = 0.01
"""Chance that noise makes a comb in any band of a channel below which the band that shows it best is taken."""

SPECTRA = ("amplitude", "floor")
"""Variables (channel, speed, order) whose fourth powers, the powers of a squared envelope's lines, are averaged."""

_WORDS = {
    "amplitude": {"units": "see unit", "long_name": "root of the squared envelope's line"},
    "floor": {"units": "see unit", "long_name": "what noise alone has there"},
    "level": {"units": "see unit", "long_name": "root mean square in the band"},
    "band_low": {"units": "Hz", "long_name": "lower end of the band"},
    "band_high": {"units": "Hz", "long_name": "upper end of the band"},
    "n_independent": {"units": "1", "long_name": "independent power spectra"},
    "revs_per_frame": {"units": "1", "long_name": "revolutions of a frame"},
}
_OF_CHANNEL = ("level", "band_low", "band_high", "n_independent")


class Stretch(NamedTuple):
    """Steps of crank angle of a piece: ``edges`` (steps + 1,) in samples, with fractions, and ``begins`` (frames,).

    ``begins`` are the numbers of the steps at which the frames begin.
    """

    edges: Floats
    begins: Ints


class Grid(NamedTuple):
    """Frames of envelopes, ``revs`` long with ``steps`` per revolution, where they lie in each piece, their transform.

    ``reach_hz`` is the highest frequency of the highest order, ``n_independent`` the number of independent power
    spectra that all frames are worth; ``rate_hz`` and ``mean_hz`` are samples and revolutions per second,
    ``revs_per_cycle`` revolutions per engine cycle.
    """

    revs: int
    steps: int
    stretches: list[Stretch]
    reach_hz: float
    transform: FrameTransform
    n_independent: float
    rate_hz: float
    mean_hz: float
    revs_per_cycle: int

    @property
    def order(self) -> Floats:
        """Orders (orders,) of a spectrum."""
        return np.arange(self.transform.n_bins) * self.steps / self.transform.n_fft


class Spectra(NamedTuple):
    """Spectra of envelopes: ``power`` (bands, orders) of their lines, ``level`` of the first, ``used`` frames.

    ``level`` is the mean square of the envelope in the first band.
    """

    power: Floats
    level: float
    used: int


class Choice(NamedTuple):
    """The ``band`` chosen for a channel: ``power`` (orders,) of its envelope's lines and the ``floor`` (orders,).

    ``mean_square`` is that of the envelope. ``looks`` (3, bands, looks) are, in every band and at the bins where
    strikes are looked for, the power over the skirts of other lines, that over the local floor, and the root of this
    floor. ``share`` is the share of the frames that were used, 0 to 1.
    """

    band: Band
    power: Floats
    floor: Floats
    mean_square: float
    share: float
    looks: NDArray[np.float32]


def recording_envelope(
    recording: xr.Dataset, shaft: xr.Dataset, *, settings: OrderSettings, combs: Combs = ()
) -> xr.Dataset:
    """RecordingEnvelope: order spectrum (channel, speed, order) of the squared envelope in the band that shows most.

    ``recording`` is the full-band Recording by time, which may lie on disk; ``shaft`` its ShaftAngle. Of a tree of
    bands above order ``settings.max_order`` (so that order lines are not taken for strikes) that one is taken, channel
    by channel, which shows the harmonics of one of ``combs`` best, where one band shows any for certain; else that in
    whose envelope an order that is no multiple of the cycle's stands highest above the floor. The squared envelope is
    averaged over even steps of crank angle, and its power spectra over frames of ``settings.envelope_revs_per_frame``
    (fewer where the recording is shorter; the orders' spacing stays). ``amplitude`` is the root of the squared
    envelope's line: of strikes it grows as they do, whatever noise they stand in. At most
    ``settings.envelope_longest_s`` are analysed, in pieces spread over the recording (``analysed_s``).

    The result has no orders, and the flag "no_envelope_band", where the sampling leaves no room above ``max_order``,
    the speed is not known, fewer than eight revolutions were recorded or the recording is by crank angle.
    """
    bands, pieces, reason = _bands_and_pieces(recording, shaft, settings)
    if reason:
        n = recording.sizes["channel"]
        nothing = {name: np.zeros((n, 0, 0)) for name in SPECTRA} | {name: np.zeros((n, 0)) for name in _OF_CHANNEL}
        made = _dataset(recording, shaft, settings, nothing, revs=0, speed_rpm=np.zeros(0), order=np.zeros(0))
        return with_flags(made, [remark(str(recording.attrs["recording"]), "no_envelope_band", reason)])
    shown = _grid(recording, shaft, pieces, settings, settings.envelope_max_order)
    order = shown.order
    bins = looked_at(combs, step=float(order[1]), n_orders=len(order))
    farthest = min(SEARCH_REACH * order[bins[-1]], order[-1]) if len(bins) else order[-1]
    searched = _grid(recording, shaft, pieces, settings, float(farthest))
    chosen = [_choose(row, bands, shown, searched, combs, bins) for row in recording["signal"].values]
    seconds = [float(np.diff(time_at(np.array(piece), **knots_of(shaft)))[0]) for piece in pieces]
    speed = np.array([60.0 * sum(last - first for first, last in pieces) / sum(seconds)])
    values = {
        "amplitude": np.array([[choice.power**0.25] for choice in chosen]),
        "floor": np.array([[choice.floor**0.25] for choice in chosen]),
        "level": np.sqrt([[choice.mean_square / 2.0] for choice in chosen]),
        "band_low": np.array([[choice.band.low_hz] for choice in chosen]),
        "band_high": np.array([[choice.band.high_hz] for choice in chosen]),
        "n_independent": np.array([[shown.n_independent * choice.share] for choice in chosen]),
    }
    made = _dataset(recording, shaft, settings, values, revs=shown.revs, speed_rpm=speed, order=order)
    if combs:
        made = made.assign(looks_of(combs, bands, order=order, looks=np.stack([choice.looks for choice in chosen])))
    return made.assign_attrs(bands_tried=len(bands), analysed_s=sum(seconds))


def _grid(
    recording: xr.Dataset, shaft: xr.Dataset, pieces: list[tuple[float, float]], settings: OrderSettings, highest: float
) -> Grid:
    """Frames for orders up to the ``highest`` in the ``pieces``, and where the steps of crank angle of these end.

    Frames are whole cycles and overlap by one half or a little more, so that each piece is used to its end.
    """
    from scipy.fft import next_fast_len

    cycle, shortest = int(shaft.attrs["revs_per_cycle"]), min(last - first for first, last in pieces)
    revs = max(int(min(settings.envelope_revs_per_frame, shortest)) // cycle * cycle, 1)
    steps = next_fast_len(math.ceil(2.0 * highest + 4.0), real=True)
    n_fft = max(settings.envelope_revs_per_frame, revs) * steps
    rate, start = float(recording.attrs["rate_hz"]), float(recording.attrs.get("start_s", 0.0))
    stretches, n_independent = [], 0.0
    for first, last in pieces:
        spare = int(last - first) - revs
        begin_rev = np.linspace(0, spare, 1 + math.ceil(spare / max(revs // 2, 1))).round().astype(np.int64)
        hop = int(np.diff(begin_rev).min()) if len(begin_rev) > 1 else revs
        n_independent += hann(revs * 16).independent_frames(16 * hop, len(begin_rev), power=True)
        angle = first + np.arange(int(last - first) * steps + 1) / steps
        edges = (time_at(np.minimum(angle, last), **knots_of(shaft)) - start) * rate
        stretches.append(Stretch(edges, begin_rev * steps))
    reach_hz = highest * float(shaft["speed"].values.max()) / 60.0
    transform = FrameTransform(hann(revs * steps), n_fft=n_fft, n_bins=math.floor(highest * n_fft / steps) + 1)
    mean_hz = float(shaft["speed"].values.mean()) / 60.0
    return Grid(revs, steps, stretches, reach_hz, transform, n_independent, rate, mean_hz, cycle)


def _bands_and_pieces(
    recording: xr.Dataset, shaft: xr.Dataset, settings: OrderSettings
) -> tuple[Bands, list[tuple[float, float]], str]:
    """Bands to try, crank angles [rev] from and to which, and why there are none of either."""
    speed = shaft["speed"].values
    if not recording["signal"].shape[1]:
        return (), [], "no bearing is named, so no strikes are looked for"
    if recording.attrs["domain"] != "time":
        return (), [], "recorded by crank angle: a resonance stays at no order"
    if not len(speed) or not np.isfinite(speed).all() or not float(speed.max()) > 0.0:
        return (), [], "the speed is not known"
    rate, fastest_hz = float(recording.attrs["rate_hz"]), float(speed.max()) / 60.0
    low_hz, width_hz = settings.max_order * fastest_hz, settings.envelope_max_order * fastest_hz
    bands = band_tree(low_hz, HIGHEST_SHARE * rate, least_width_hz=width_hz)
    if not bands:
        reason = f"at {rate:g} samples/s no band above order {settings.max_order:g} is wide enough for envelope orders "
        return (), [], f"{reason}up to {settings.envelope_max_order:g} at {60.0 * fastest_hz:.0f} min-1"
    pieces = _pieces(recording, shaft, settings)
    return bands, pieces, "" if pieces else f"fewer than {LEAST_REVS} revolutions were recorded"


def _pieces(recording: xr.Dataset, shaft: xr.Dataset, settings: OrderSettings) -> list[tuple[float, float]]:
    """Crank angles [rev] from and to which the envelope is made; none where too little was recorded."""
    rate, start = float(recording.attrs["rate_hz"]), float(recording.attrs.get("start_s", 0.0))
    knots = knots_of(shaft)
    n_samples = recording["signal"].shape[1]
    inside = start + np.array([GUARD_SAMPLES, n_samples - 1 - GUARD_SAMPLES]) / rate
    begin, end = max(inside[0], knots["knot_time_s"][0]), min(inside[1], knots["knot_time_s"][-1])
    if end <= begin:
        return []
    spans = [(begin, end)]
    if end - begin > settings.envelope_longest_s:
        turns_hz = float(knots["knot_speed_rpm"].mean()) / 60.0
        frames = settings.envelope_longest_s * turns_hz / settings.envelope_revs_per_frame
        count = min(max(int(frames / FRAMES_PER_PIECE), 1), PIECES)
        long = settings.envelope_longest_s / count
        spans = [(at, at + long) for at in np.linspace(begin, end - long, count)]
    angles = [tuple(float(value) for value in angle_at(np.array(span), **knots)) for span in spans]
    return [(first, last) for first, last in angles if last - first >= LEAST_REVS]


def _choose(
    signal: NDArray[np.floating], bands: Bands, shown: Grid, searched: Grid, combs: Combs, bins: Ints
) -> Choice:
    """The band of one channel in whose envelope ``combs`` or, failing these, most stands out, with its spectrum.

    The choice and what is seen in the other bands are made without the tones of the signal, up to the order at which
    ``searched`` ends; the spectrum is that of all of it, as far as ``shown`` goes.
    """
    ends = [stretch.edges[[0, -1]].tolist() for stretch in shown.stretches]
    blocks = [block_spectra(signal, begin=begin, end=end) for begin, end in ends]
    finest = tuple(band for band in bands if band.level == bands[-1].level)
    screened = _spectra(blocks, finest, searched, toneless=True)
    if not screened.used:
        missing = np.full(shown.transform.n_bins, np.nan)
        nothing = np.full((3, len(bands), len(bins)), np.nan, dtype=np.float32)
        return Choice(bands[0], missing, missing, math.nan, 0.0, nothing)
    order, cell = searched.order, 1.0 / searched.revs
    share = screened.used / sum(len(stretch.begins) for stretch in searched.stretches)
    n_independent = searched.n_independent * share
    unit = float(screened.power.mean()) or 1.0
    power = (screened.power / unit).astype(np.float32)
    floor = line_floor(power, order, n_independent)
    height = power / np.maximum(floor, np.finfo(np.float32).tiny)
    free = free_of_others(order, revs_per_cycle=shown.revs_per_cycle, speed_hz=shown.mean_hz, cell=cell)
    free &= order > LOWEST_ORDER
    seen = over_skirts(height)[:, bins]
    best = best_band(np.where(free, height, 0.0).max(axis=1))
    if len(bins):
        step, count = float(order[1]), np.array([n_independent])
        worth = floor_worth(step, cell)
        evidence = served(seen[None], combs, bins, step=step, count=count, worth=worth, free=free)[:, 0].max(axis=0)
        if evidence.max() >= np.log(seen.size / SURE_OF_COMB):
            # a wider band that shows it as well holds more of the resonance
            best = int(np.flatnonzero(evidence >= WIDER_EVIDENCE * evidence.max())[0])
    exact = _spectra(blocks, (bands[best],), shown, toneless=False)
    looks = np.stack([seen, height[:, bins], np.sqrt(np.sqrt(floor[:, bins])) * np.float32(unit**0.25)])
    floor = line_floor(exact.power, shown.order, n_independent)
    return Choice(bands[best], exact.power[0], floor[0], exact.level, share, looks)


def _spectra(blocks: list[Blocks], bands: Bands, grid: Grid, *, toneless: bool) -> Spectra:
    """Power of the envelopes' lines of ``bands`` on ``grid``, after those of the sums of every second one.

    The squared envelope of a wide band is nearly the sum of those of its parts: of a line at the frequency f the share
    of f in the width of a part is lost, in lines and noise alike.
    """
    long = grid.revs * grid.steps
    power, mean_square, used = np.zeros(1), 0.0, 0
    for of_piece, (edges, begins) in zip(blocks, grid.stretches, strict=True):
        squared, rate_hz, unit, bad = envelopes_of(
            of_piece, rate_hz=grid.rate_hz, bands=bands, edges=edges, reach_hz=grid.reach_hz, toneless=toneless
        )
        touched = (bad[:, 1] > edges[begins, None]) & (bad[:, 0] < edges[begins + long, None])
        good = begins[~touched.any(axis=1)]
        if not len(good):
            continue
        used += len(good)
        mean_square += unit * sum(float(squared[0, k : k + long].mean(dtype=np.float64)) for k in good)
        squared -= squared.mean(axis=1, keepdims=True)
        lines = np.concatenate([grid.transform.power(sums, good).sum(axis=1) for sums in _tree_of(squared)])
        # what the mean over each step and the staircase of the envelope take from a line
        lost = np.sinc(grid.order / grid.steps) * np.sinc(grid.order * grid.mean_hz / rate_hz)
        power = power + lines * np.square(unit / lost)
    return Spectra(power / max(used, 1), mean_square / max(used, 1), used)


def _tree_of(parts: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Sums of every second one of ``parts`` (bands, angles), which meet, widest first, and all of them."""
    made, sums = [parts], parts[::2]
    while len(sums) > 1:
        sums = sums[::2] + sums[1::2]
        made.insert(0, sums)
    return made


def _dataset(
    recording: xr.Dataset,
    shaft: xr.Dataset,
    settings: OrderSettings,
    values: dict[str, Floats],
    *,
    revs: int,
    speed_rpm: Floats,
    order: Floats,
) -> xr.Dataset:
    """RecordingEnvelope of ``values`` (channel, speed[, order]) by name, with frames of ``revs`` revolutions."""
    dims = ("channel", "speed", "order")
    reference = {"units": "1", "long_name": "order of the envelope", "order_reference": "crankshaft"}
    variables: Variables = {name: (dims[: array.ndim], array, _WORDS[name]) for name, array in values.items()}
    variables["revs_per_frame"] = (("speed",), np.full(len(speed_rpm), revs), _WORDS["revs_per_frame"])
    speed = described("speed", speed_rpm, "min-1", "mean speed")
    made = xr.Dataset(variables, channel_coords(recording) | {"speed": speed, "order": ("order", order, reference)})
    made.attrs = {key: recording.attrs[key] for key in ("recording", "history", "quality") if key in recording.attrs}
    made.attrs |= {
        "revs_per_cycle": int(shaft.attrs["revs_per_cycle"]),
        "lowest_order": settings.max_order,
        "speed_basis": "nominal" if recording.attrs.get("encoder_kind") == "constant" else "measured",
        "bands_tried": 0,
        "analysed_s": 0.0,
        "recorded_s": recording["signal"].shape[1] / float(recording.attrs.get("rate_hz", math.nan)),
    }
    return made


def envelope_map(items: list[xr.Dataset], *, speed_bin_rpm: float) -> xr.Dataset:
    """EnvelopeMap (channel, speed, order) of a test from the RecordingEnvelopes ``items`` of its recordings.

    Recordings whose mean speeds differ by less than ``speed_bin_rpm`` are averaged by power, each as often as its
    independent spectra count; ``band_low`` and ``band_high`` are then the lowest and the highest of their bands. Items
    without orders only give their flags; with other channels or orders than the first of the rest they are left out
    and flagged "bad".
    """
    full = [item for item in items if item.sizes["order"]]
    axes = [[item.variables[name].values for name in ("channel", "unit", "order")] for item in full]
    alike = [all(map(np.array_equal, of_item, axes[0])) for of_item in axes]
    used = [item for item, is_alike in zip(full, alike, strict=True) if is_alike]
    detail = "envelope with other channels or orders than the test's first"
    left_out = [str(item.attrs["recording"]) for item, is_alike in zip(full, alike, strict=True) if not is_alike]
    remarks = [remark(name, "left_out", detail, "bad") for name in left_out]
    made = _averaged(used, speed_bin_rpm) if used else items[0].copy()
    sources = used or items
    nominal = any(item.attrs["speed_basis"] == "nominal" for item in sources)
    # what holds for all recordings, the widest of what was tried, sums of times
    made.attrs = {
        "revs_per_cycle": int(sources[0].attrs["revs_per_cycle"]),
        "lowest_order": float(sources[0].attrs["lowest_order"]),
        "speed_basis": "nominal" if nominal else "measured",
        "bands_tried": max(int(item.attrs["bands_tried"]) for item in sources),
        "analysed_s": float(sum(item.attrs["analysed_s"] for item in sources)),
        "recorded_s": float(np.nansum([item.attrs["recorded_s"] for item in sources])),
        "history": str(sources[0].attrs.get("history", "")),
        "speed_bin_rpm": speed_bin_rpm,
    }
    return with_flags(made, [flag for item in items for flag in flags_of(item)] + remarks)


def _averaged(used: list[xr.Dataset], speed_bin_rpm: float) -> xr.Dataset:
    """Average of ``used`` recordings by group of like speed."""
    speed = np.array([float(item.variables["speed"].values[0]) for item in used])
    groups = [group for group in speed_groups(speed, width_rpm=speed_bin_rpm) if len(group)]
    first = used[0]

    def stacked(name: str, group: Ints) -> Floats:
        return np.array([used[k].variables[name].values[:, 0] for k in group])

    columns: dict[str, list[Floats]] = {name: [] for name in (*SPECTRA, *_OF_CHANNEL)}
    revs = []
    for group in groups:
        count = stacked("n_independent", group)
        for name, power in (*((name, 4) for name in SPECTRA), ("level", 2)):
            total = np.einsum("kc,kc...->c...", count, np.nan_to_num(stacked(name, group)) ** power)
            mean = (total.T / np.maximum(count.sum(axis=0), 1e-300)).T
            columns[name].append(np.where(mean > 0.0, mean, np.nan) ** (1.0 / power))
        columns["n_independent"].append(count.sum(axis=0))
        columns["band_low"].append(stacked("band_low", group).min(axis=0))
        columns["band_high"].append(stacked("band_high", group).max(axis=0))
        revs.append(min(int(used[k].variables["revs_per_frame"].values[0]) for k in group))
    like = {name: (np.stack(values, axis=1), first.variables[name]) for name, values in columns.items()}
    variables: Variables = {name: (one.dims, values, dict(one.attrs)) for name, (values, one) in like.items()}
    variables |= joined_looks([[used[k] for k in group] for group in groups])
    variables["revs_per_frame"] = (("speed",), np.array(revs), dict(first["revs_per_frame"].attrs))
    mean_speed = np.array([speed[group].mean() for group in groups])
    coords = {"speed": ("speed", mean_speed, dict(first["speed"].attrs)), "order": first["order"]}
    return xr.Dataset(variables, coords=channel_coords(first) | coords)
