"""Lines of rolling bearings: where they are looked for, and the search of the envelope map at a false-alarm level."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import fdtrc

from crankorder.engine.machine_parts import Bearing, bearing_orders
from crankorder.orders.envelope_combs import (
    TRIALS_PER_BIN,
    Comb,
    comb_nats,
    combs_in,
    floor_worth,
    free_of_others,
    look_nats,
    looked_at,
    over_skirts,
)
from crankorder.orders.intervals import half_width
from crankorder.quantities import Bools, Floats
from crankorder.settings import MethodNumbers

PLACE_NUMBERS = MethodNumbers("5-identify-bearings.toml", "places")

SHOWN_AT = {"BSF": 2.0}
"""Multiple of a line at which its damage shows, where not once: a rolling element strikes both races in a turn."""


class Place(NamedTuple):
    """One line of one bearing: its order in pure rolling as it shows, and from which to which order it is looked for.

    ``shaft_order`` and ``cage_order`` (None where the cage's is not known) are what its sidebands are apart by.
    """

    name: str
    line: str
    expected: float
    low: float
    high: float
    elements: int | None
    shaft_order: float
    cage_order: float | None

    @property
    def title(self) -> str:
        """What the line is called in a sentence: "2 x BSF" where the damage shows at twice the line."""
        times = SHOWN_AT.get(self.line, 1.0)
        return self.line if times == 1.0 else f"{times:g} x {self.line}"

    def slip_percent(self, order: float) -> float:
        """How much slower than in pure rolling ``order`` is, in percent."""
        return 100.0 * (1.0 - order / self.expected)

    def cage_at(self, order: Floats) -> Floats | None:
        """Order of the cage where the line is at ``order`` (any shape); None where the bearing's data do not tell.

        The outer race is struck as often as elements pass, the inner one and an element as often as the shaft turns
        against the cage.
        """
        if self.line == "FTF":
            return order
        if self.cage_order is None:
            return None
        if self.line == "BPFO":
            return np.asarray(self.cage_order * order / self.expected)
        return np.asarray(self.shaft_order - (self.shaft_order - self.cage_order) * order / self.expected)

    @property
    def comb(self) -> Comb:
        """The train of strikes that damage at this place makes."""
        return Comb(self.low, self.high, self.spacing or 0.0)

    @property
    def spacing(self) -> float | None:
        """How far apart in orders the sidebands are that damage at this place makes by coming and going with the load.

        Source: P. D. McFadden and J. D. Smith (1984), Journal of Sound and Vibration 96, p. 69.
        """
        return {"BPFI": self.shaft_order, "BSF": self.cage_order}.get(self.line)


def bearing_places(bearings: tuple[Bearing, ...], *, slip_percent: tuple[float, float]) -> list[Place]:
    """Every line of ``bearings`` that their data tell, from the least to the most slip of ``slip_percent``."""
    places = []
    least, most = slip_percent
    for bearing in bearings:
        orders, shaft = bearing_orders(bearing), bearing.shaft_ratio
        elements = bearing.rolling_elements or round(orders["N*fs"] / shaft) if "N*fs" in orders else None
        for line, order in orders.items():
            expected = order * SHOWN_AT.get(line, 1.0)
            low, high = expected * (1.0 - most / 100.0), expected * (1.0 - least / 100.0)
            places.append(Place(bearing.name, line, expected, low, high, elements, shaft, orders.get("FTF")))
    return places


def bearing_combs(bearings: tuple[Bearing, ...], *, slip_percent: tuple[float, float]) -> tuple[Comb, ...]:
    """Trains of strikes of ``bearings``, each once, at any slip of ``slip_percent``; N*fs keeps step and is none."""
    places = bearing_places(bearings, slip_percent=slip_percent)
    return tuple(dict.fromkeys(place.comb for place in places if place.line != "N*fs"))


def made_by(order: float, stronger: Place, stronger_order: float, *, within: float) -> str:
    """How the line ``stronger`` (found at ``stronger_order``) makes one at ``order`` too; empty where it does not.

    Its multiples and their sidebands by turns of the shaft and of the cage come as near as ``within``: "2 x BPFO - 1 x
    shaft". A modulated train of strikes has all of them.
    """
    cages = (0,) if stronger.cage_order is None else (0, -1, 1)
    for times in range(1, PLACE_NUMBERS.multiples + 1):
        for turns in sorted(range(-PLACE_NUMBERS.sideband_turns, PLACE_NUMBERS.sideband_turns + 1), key=abs):
            for cage in cages:
                if turns and cage:
                    continue
                at = times * stronger_order + turns * stronger.shaft_order + cage * (stronger.cage_order or 0.0)
                if abs(at - order) <= within:
                    shown = times * SHOWN_AT.get(stronger.line, 1.0)
                    parts = [f"{shown:g} x {stronger.line}" if shown > 1.0 else stronger.line]
                    sides = [(count, of) for count, of in ((turns, "shaft"), (cage, "cage")) if count]
                    parts += [f"{'+' if count > 0 else '-'} {abs(count)} x {of}" for count, of in sides]
                    return " ".join(parts)
    return ""


NUMBERS = MethodNumbers("5-identify-bearings.toml", "envelope_lines")

PLACE_ERROR = (0.42, 0.40)
"""Standard error of a line's place in cells of resolution, times the root of its power ratio and of the independent
spectra: of many frames, and what is added (in squares) for one; measured on tones in noise."""

PARABOLA_POWER = 0.1154
"""Power to which the power ratios are raised before a parabola is laid through them."""

WAYS = 2.0
"""Ways in which a line is looked for: in single spectra and in the mean of all."""


class Look(NamedTuple):
    """Power ratios and amplitudes (channel, speed, order) in one band, the ends of which in Hz are ``band_hz``.

    ``ratio`` is the power over the floor or, where they are higher, over the skirts of other lines, ``raw`` that over
    the floor alone; 0 in bins that tell nothing of the strikes that are looked for there. The ends are (speed, 2), NaN
    where the band is that of the spectrum that is drawn, channel by channel.
    """

    ratio: Floats
    raw: Floats
    amplitude: Floats
    band_hz: Floats


@dataclass(frozen=True, eq=False)
class Spectra:
    """Power ratios (channel, speed, order) of line to floor, as :func:`spectra_of` reads them from an EnvelopeMap."""

    ratio: Floats
    amplitude: Floats
    order: Floats
    count: Floats
    cell: Floats
    speed_rpm: Floats
    revs_per_cycle: int
    bands_tried: int
    looks: Mapping[Comb, Look] = field(default_factory=dict)

    def serving(self, place: Place) -> Look:
        """What the band that serves strikes at ``place`` best shows of them; the band drawn where none was chosen."""
        if place.comb in self.looks:
            return self.looks[place.comb]
        rows = over_skirts(self.ratio.reshape(-1, len(self.order)))
        drawn = np.broadcast_to(np.nan, (len(self.speed_rpm), 2))
        return Look(rows.reshape(self.ratio.shape), self.ratio, self.amplitude, drawn)

    @property
    def floor_worth(self) -> Floats:
        """Independent bins (speed,) that the floor is worth."""
        return np.array([floor_worth(float(self.order[1]), float(cell)) for cell in self.cell])

    def free(self) -> Bools:
        """Bins (speed, order) at which strikes can be told from what is locked to the engine's cycle and from mains."""
        return np.array(
            [
                free_of_others(self.order, revs_per_cycle=self.revs_per_cycle, speed_hz=rpm / 60.0, cell=float(cell))
                for rpm, cell in zip(self.speed_rpm, self.cell, strict=True)
            ]
        )

    def mean(self, ratio: Floats) -> tuple[Floats, float, Bools]:
        """Mean ``ratio`` of all channels and speeds (orders,) where free, spectra it is worth, and bins that count."""
        weight = self.count[:, :, None] * self.free()[None]
        own = weight.sum(axis=(0, 1))
        counts = own >= NUMBERS.least_free_share * max(float(self.count.sum()), 1e-9)
        mean = (weight * ratio).sum(axis=(0, 1)) / np.where(counts, own, 1.0)
        worth = float(own[counts].min()) if counts.any() else 0.0
        return np.where(counts, mean, 0.0), worth, np.asarray(counts)

    def near(self, order: float) -> slice:
        """Bins within one cell of ``order``, of the coarsest resolution there is."""
        step = self.order[1]
        reach = max(1, round(float(self.cell.max()) / step))
        middle = round(order / step)
        return slice(max(middle - reach, 0), max(min(middle + reach + 1, len(self.order)), 0))


@dataclass(frozen=True, eq=False)
class EnvelopeLine:
    """A bearing line in the envelope: its order with standard error and degrees of freedom, and where it is strongest.

    ``seen`` (channel, speed) says where it stands over the level by itself; ``chance`` is that of noise making it
    anywhere in the test, ``ranking`` how the parts of its bearing compare there, ``also`` what else of the list it
    makes.
    """

    place: Place
    order: float
    order_error: float
    freedom: float
    channel: int
    speed: int
    ratio: float
    amplitude: float
    amplitude_error: float
    chance: float
    seen: Bools
    harmonics: int
    sidebands: float | None
    band_hz: tuple[float, float]
    ranking: Ranking
    also: list[str] = field(default_factory=list)

    def may_slip_so(self, cell: float) -> bool:
        """Whether its order lies in its place, within its own interval and a ``cell`` of the spectrum, in orders.

        A peak just beyond the allowed slip is another line's, however little a cell is at the orders of a race: at that
        of a cage it is 4 %, and no cage runs so much faster than in pure rolling.
        """
        reach = min(cell, half_width(self.freedom) * self.order_error)
        return self.place.low - reach <= self.order <= self.place.high + reach

    @property
    def level_db(self) -> float:
        """Mean level of the lines that damage there makes; that of the line where it is no part's."""
        own = self.ranking.of(self.place.line)
        return own.level_db if own is not None else 0.0


def spectra_of(envelope: xr.Dataset) -> Spectra:
    """Spectra of the EnvelopeMap ``envelope``; 0 where a channel has none."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.nan_to_num((envelope["amplitude"].values / envelope["floor"].values) ** 4, posinf=0.0)
    return Spectra(
        ratio=ratio,
        amplitude=envelope["amplitude"].values,
        order=envelope["order"].values,
        count=np.nan_to_num(envelope["n_independent"].values),
        cell=1.0 / envelope["revs_per_frame"].values,
        speed_rpm=envelope["speed"].values,
        revs_per_cycle=int(envelope.attrs["revs_per_cycle"]),
        bands_tried=max(int(envelope.attrs["bands_tried"]), 1),
        looks=_looks_in(envelope),
    )


def _looks_in(envelope: xr.Dataset) -> dict[Comb, Look]:
    """What ``envelope`` holds of the bands that serve its combs; nothing where none were looked for."""
    if "comb_ratio" not in envelope:
        return {}
    bins = np.round(envelope["look"].values / envelope["order"].values[1]).astype(np.int64)
    looks = {}
    for number, comb in enumerate(combs_in(envelope)):
        ratio, raw, amplitude = (np.zeros(envelope["amplitude"].shape) for _ in range(3))
        ratio[:, :, bins] = envelope["comb_ratio"].values[number]
        raw[:, :, bins] = envelope["comb_level"].values[number]
        amplitude[:, :, bins] = raw[:, :, bins] ** 0.25 * envelope["comb_floor"].values[number]
        ends = [envelope[f"comb_band_{end}"].values[number] for end in ("low", "high")]
        looks[comb] = Look(ratio, raw, amplitude, np.stack(ends, axis=1))
    return looks


def envelope_lines(spectra: Spectra, places: list[Place], *, false_alarm_probability: float) -> list[EnvelopeLine]:
    """Lines of ``places`` that stand over the level in ``spectra``, strongest first, each once.

    ``false_alarm_probability`` is the chance that noise alone makes any line in the whole test: it is shared out over
    all bins of all places in all channels, speeds and bands tried, half of it to single spectra, half to the mean of
    all. A line that a stronger one makes by itself (its multiples and sidebands) is told in that one's ``also``.
    """
    inside = [place for place in places if place.low > spectra.order[1] and place.high < spectra.order[-1]]
    bins = sum(int((place.high - place.low) / spectra.order[1]) + 1 for place in inside)
    cell = float(spectra.cell.max())
    standing = [
        line
        for place in inside
        if (line := _line(spectra, place, places, bins, false_alarm_probability)) is not None and line.may_slip_so(cell)
    ]
    kept: list[EnvelopeLine] = []
    within = 1.5 * cell
    for line in sorted(standing, key=lambda line: (-line.level_db, -line.ratio)):
        first = all(other.place.name != line.place.name for other in kept)
        ratio = spectra.serving(line.place).ratio
        if not first and not _stands(spectra, ratio, line.order, line.channel, line.speed):
            continue  # the harmonics are another's: its own line is not there
        for other in kept:
            alike = line.place.line == other.place.line and abs(line.order - other.order) <= within
            if not alike and (how := made_by(line.order, other.place, other.order, within=within)):
                other.also.append(f"{line.place.name} {line.place.title} would be at {line.order:.4g}: {how}")
                break
        else:
            kept.append(line)
    return kept


def _line(
    spectra: Spectra, place: Place, places: list[Place], bins: int, false_alarm_probability: float
) -> EnvelopeLine | None:
    """The line of ``place``, one of the ``places``; None where nothing stands over the level."""
    step = spectra.order[1]
    span = slice(math.ceil(place.low / step), math.floor(place.high / step) + 1)
    alone, together = line_chances(spectra, place, span, bins)
    if not alone.size or min(float(alone.min()), float(together.min())) > false_alarm_probability:
        return None
    look = spectra.serving(place)
    mean, total, _ = spectra.mean(look.ratio)
    stands = alone <= false_alarm_probability
    seen: Bools = np.asarray(alone.min(axis=2) <= false_alarm_probability)
    if seen.any():
        channel, speed, at = map(int, np.unravel_index(np.argmax(look.ratio[:, :, span] * stands), alone.shape))
    else:
        at = int(np.argmin(together))
        channel, speed = map(int, np.unravel_index(np.argmax(look.ratio[:, :, span.start + at]), seen.shape))
    peak = span.start + at
    order, error, freedom = _order(spectra, look.ratio, seen, mean, peak, total)
    strength, size = (float(values[channel, speed, peak]) for values in (look.ratio, look.amplitude))
    own = [other for other in places if other.name == place.name]
    shown = look.raw[channel, speed] if seen.any() else spectra.mean(look.raw)[0]
    stands_at = partial(_stands, spectra, look.ratio, channel=channel, speed=speed)
    spacing = place.spacing
    if spacing is not None:
        sides = [stands_at(times * order + side * spacing) for times in (1, 2) for side in (-1, 1)]
        told = spacing >= 3.0 * float(spectra.cell[speed]) and (any(sides[:2]) or all(sides[2:]))
        spacing = spacing if told else None
    return EnvelopeLine(
        place=place,
        order=order,
        order_error=error,
        freedom=freedom,
        channel=channel,
        speed=speed,
        ratio=strength,
        amplitude=size,
        amplitude_error=0.25 * size * math.sqrt(2.0 / max(strength * spectra.count[channel, speed], 1e-9)),
        chance=min(float(alone.min()), float(together.min())),
        seen=seen,
        harmonics=sum(stands_at(times * order) for times in range(1, NUMBERS.harmonics + 1)),
        sidebands=spacing,
        band_hz=(float(look.band_hz[speed, 0]), float(look.band_hz[speed, 1])),
        ranking=ranking(shown, float(step), spectra.free()[speed], own),
    )


def line_chances(spectra: Spectra, place: Place, span: slice, bins: int) -> tuple[Floats, Floats]:
    """Chances (channel, speed, bins of ``span``) and, in the mean of all, (bins of ``span``) of noise anywhere.

    That is of so high a line at ``place`` as ``spectra`` show in the band that serves it. They are those of a line's
    first harmonics together: two tones beat at one frequency, strikes have harmonics. All ``bins`` of all places and
    all bands count as trials, as far as these are independent.
    """
    if span.stop <= span.start:
        return np.zeros((*spectra.count.shape, 0)), np.zeros(0)
    ratio, free = spectra.serving(place).ratio, spectra.free()
    trials = NUMBERS.trials_share * spectra.bands_tried * bins * WAYS
    alone = np.stack(
        [
            _comb_chances(spectra, ratio[:, s], place, span, spectra.count[:, s], worth, free[s])
            for s, worth in enumerate(spectra.floor_worth)
        ],
        axis=1,
    )
    mean, total, counts = spectra.mean(ratio)
    own = float((spectra.count * spectra.floor_worth[None]).sum()) / max(float(spectra.count.sum()), 1e-9)
    together = _comb_chances(spectra, mean[None], place, span, np.array([total]), own, counts)[0]
    return alone * spectra.count.size * trials, together * trials


def _comb_chances(
    spectra: Spectra, ratio: Floats, place: Place, span: slice, count: Floats, worth: float, free: Bools
) -> Floats:
    """Chances (rows, bins of ``span``) of the harmonics in ``ratio`` (rows, orders) whose first is nearest to each bin.

    Each row is the mean of ``count`` (rows,) spectra with a floor of ``worth``; the bins ``free`` count.
    """
    step, comb = float(spectra.order[1]), place.comb
    looks = looked_at((comb,), step=step, n_orders=ratio.shape[1])
    nats = np.empty((len(ratio), len(looks)))
    for own in np.unique(count):
        rows = count == own
        part = ratio[np.ix_(rows, looks)]
        nats[rows] = look_nats(part, looks, count=float(own), floor_worth=worth, free=free[looks])
    chance = np.exp(-comb_nats(nats, looks, comb, step=step, free=free[looks]))
    nearest = np.clip(np.round(comb.trials(step) / step).astype(int), span.start, span.stop - 1)
    chances = np.ones((len(ratio), span.stop - span.start))
    np.minimum.at(chances.T, nearest - span.start, chance.T)
    return chances * TRIALS_PER_BIN


def parabola(ratio: Floats, at: int) -> float:
    """Where, in bins from ``at``, a parabola through a power of three of ``ratio`` has its top: right to 0.001 bins.

    ``ratio``: (bins,). Source: K. J. Werner and F. G. Germain (2016), Applied Sciences 6, 306: the power that suits a
    Hann window.
    """
    if not 0 < at < len(ratio) - 1:
        return 0.0
    left, middle, right = np.maximum(ratio[at - 1 : at + 2], 0.0) ** PARABOLA_POWER
    bend = left - 2.0 * middle + right
    return float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0


def place_error(ratio: float, cell: float) -> float:
    """Standard error of the place of a line of power ``ratio`` in spectra of the resolution ``cell``."""
    return cell * math.hypot(*PLACE_ERROR) / math.sqrt(ratio)


def _order(
    spectra: Spectra, ratio: Floats, seen: Bools, mean: Floats, peak: int, total: float
) -> tuple[float, float, float]:
    """Order of a line near bin ``peak`` with its standard error and the degrees of freedom of that.

    Each speed is a measurement of its own, for slip varies; channels of one recording share it.
    """
    step, speeds = float(spectra.order[1]), np.flatnonzero(seen.any(axis=0))
    # revolutions that were recorded at each speed, over which random slips make a line wander
    revs = 0.5 * (spectra.count.max(axis=0) + 1.0) / spectra.cell
    if not len(speeds):
        noise = float(spectra.cell.max()) * PLACE_ERROR[0] / math.sqrt(max(float(mean[peak]), 1.0) * total)
        order = (peak + parabola(mean, peak)) * step
        wander = NUMBERS.wander_share * math.sqrt(order / max(float(revs.sum()), 1.0))
        return order, math.hypot(noise, wander), math.inf
    places, noises = np.array([_at_speed(spectra, ratio, seen, int(speed), peak) for speed in speeds]).T
    wanders = NUMBERS.wander_share * np.sqrt(peak * step / np.maximum(revs[speeds], 1.0))
    weight = 1.0 / (noises**2 + wanders**2)
    order = float((weight * places).sum() / weight.sum())
    if len(speeds) < NUMBERS.least_speeds:
        return order, float(weight.sum() ** -0.5), math.inf
    freedom = len(speeds) - 1.0
    spread = float((weight * (places - order) ** 2).sum()) / freedom
    least = float((weight**2 * noises**2).sum()) / float(weight.sum())
    return order, math.sqrt(max(spread, least) / float(weight.sum())), freedom


def _at_speed(spectra: Spectra, ratios: Floats, seen: Bools, speed: int, peak: int) -> tuple[float, float]:
    """Order of a line near bin ``peak`` at one speed, and its error by noise: of all channels that show it."""
    step, cell = float(spectra.order[1]), float(spectra.cell[speed])
    reach = max(2, round(2.0 * cell / step))
    places, weights = [], []
    for channel in np.flatnonzero(seen[:, speed]):
        ratio = ratios[channel, speed]
        first = max(peak - reach, 0)
        at = first + int(np.argmax(ratio[first : peak + reach + 1]))
        places.append((at + parabola(ratio, at)) * step)
        weights.append(float(ratio[at] * spectra.count[channel, speed]))
    frames = max(float(spectra.count[:, speed].max()), 1.0)
    error = cell * math.hypot(PLACE_ERROR[0], PLACE_ERROR[1] / math.sqrt(frames)) / math.sqrt(sum(weights))
    return float(np.average(places, weights=weights)), error


def _stands(spectra: Spectra, ratio: Floats, order: float, channel: int, speed: int) -> bool:
    """Whether something stands over the level at ``order`` of ``ratio`` (channel, speed, order)."""
    near = spectra.near(order)
    if near.stop <= near.start or order > spectra.order[-1]:
        return False
    count, worth = max(float(spectra.count[channel, speed]), 1e-3), float(spectra.floor_worth[speed])
    chance = float(fdtrc(2.0 * count, 2.0 * worth * count, ratio[channel, speed, near].max()))
    return bool(chance * (near.stop - near.start) <= NUMBERS.harmonic_chance)


CANDIDATE_NUMBERS = MethodNumbers("5-identify-bearings.toml", "candidates")


class Candidate(NamedTuple):
    """A part that may be struck: at which ``order``, and the mean level in dB of the lines it would make there."""

    place: Place
    order: float
    level_db: float


class Ranking(NamedTuple):
    """Parts of one bearing by level, highest first."""

    candidates: tuple[Candidate, ...]

    def of(self, line: str) -> Candidate | None:
        """The candidate of that ``line``."""
        return next((candidate for candidate in self.candidates if candidate.place.line == line), None)

    def rivals(self) -> tuple[Candidate, ...]:
        """The parts that the first is not told from."""
        first = self.candidates[0]
        clear = max(CANDIDATE_NUMBERS.clear_db, CANDIDATE_NUMBERS.clear_share * first.level_db)
        return tuple(candidate for candidate in self.candidates[1:] if first.level_db - candidate.level_db < clear)


def ranking(ratio: Floats, step: float, free: Bools, places: list[Place]) -> Ranking:
    """Ranking of the ``places`` of one bearing by ``ratio`` (orders,), power over the floor in bins ``step`` apart.

    It is that of one band, in which one of them was found: in the best of many bands noise lifts each of the others.

    The level of a part is the mean of those of its first harmonics, three of a race or a rolling element and the third
    to the sixth of a cage, each at the place that suits it best. Half of that of an inner race or a rolling element is
    in the sidebands that its way through the load zone makes. What stands one turn of the cage beside is taken from the
    level of a race, for a damaged cage or rolling element has lines there too; from that of a rolling element the
    multiple of the cage's order half way between its harmonics, where only a cage has one. What a rolling element makes
    off the multiples of the cage's order speaks against the cage, for the element comes and goes with it. Bins that are
    not ``free`` (orders,) do not count.
    """
    level = np.clip(10.0 * np.log10(np.maximum(ratio, 1e-12)), 0.0, CANDIDATE_NUMBERS.highest_db)
    level = np.where(free, level, np.nan)
    candidates = []
    for place in places:
        trials, mean = _course(level, step, place)
        if place.line != "N*fs" and np.isfinite(mean).any():
            best = int(np.nanargmax(mean))
            order, level_db = float(trials[best]), float(mean[best])
            if place.line == "FTF":
                # beyond what noise reaches, a rolling element's level off the multiples of the cage's order
                noise_db, reach, balls = CANDIDATE_NUMBERS.noise_db, CANDIDATE_NUMBERS.off_bins * step, [0.0]
                for ball in (other for other in places if other.line == "BSF"):
                    at, levels = _course(level, step, ball)
                    off = np.abs(at - order * np.round(at / order)) > reach
                    balls.append(float(np.nanmax(np.where(off, levels, np.nan), initial=noise_db)) - noise_db)
                level_db = max(level_db - 2.0 * max(balls), 0.0)
            candidates.append(Candidate(place, order, level_db))
    return Ranking(tuple(sorted(candidates, key=lambda candidate: -candidate.level_db)))


def _course(level: Floats, step: float, place: Place) -> tuple[Floats, Floats]:
    """Orders (trials,) at which ``place`` may be, and its level at each; NaN beyond the spectrum."""
    comb = place.comb
    trials = comb.trials(step)
    harmonic = np.arange(CANDIDATE_NUMBERS.cage_from_harmonic if place.line == "FTF" else 1, comb.teeth + 1)[:, None]
    teeth = harmonic * trials
    levels = _levels(level, step, teeth)
    cage = place.cage_at(trials)
    if place.spacing is not None:
        spacing = cage if place.line == "BSF" and cage is not None else place.spacing
        sides = 0.5 * (_levels(level, step, teeth - spacing) + _levels(level, step, teeth + spacing))
        share = CANDIDATE_NUMBERS.side_share
        levels = np.where(np.isfinite(sides), (1.0 - share) * levels + share * sides, levels)
    if place.line != "FTF" and cage is not None:
        if place.line == "BSF":
            beside = _levels(level, step, cage * np.round((teeth - 0.5 * trials) / cage), reach=2)
        else:
            low, high = (_levels(level, step, teeth + side * cage, reach=2) for side in (-1, 1))
            beside = 0.5 * (low + high)
        levels = np.maximum(levels - np.nan_to_num(beside), 0.0)
    known = np.isfinite(levels)
    total = np.where(known, levels, 0.0).sum(axis=0)
    return trials, np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)


def _levels(level: Floats, step: float, orders: Floats, *, reach: int = 1) -> Floats:
    """Largest level within ``reach`` bins of each of ``orders``, NaN where the spectrum ends or does not count."""
    at = np.round(orders / step).astype(np.int64)
    inside = (at >= reach) & (at < len(level) - reach)
    near = np.clip(at, reach, len(level) - 1 - reach)
    beside = np.fmax.reduce([level[near + away] for away in range(-reach, reach + 1)])
    return np.where(inside & np.isfinite(level[near]), beside, np.nan)
