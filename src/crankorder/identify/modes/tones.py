"""Lines without damping: mains, other tones, and lines that one speed cannot tell from an order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.special import chdtr, chdtri

from crankorder.campbell.map import HANN_CORRELATION
from crankorder.cause import alike_speeds
from crankorder.identify.found import AgreedOrders, ModalFit, Mode, Tone, ToneKind
from crankorder.identify.lines.known_lines import LineSeen, found_near
from crankorder.identify.lines.mains import NUMBERS as MAINS
from crankorder.identify.lines.mains import multiple_on, multiples_near, supply_told, with_mains_tones
from crankorder.identify.modes.floor import Floor
from crankorder.identify.modes.search import dispersion
from crankorder.identify.modes.surface_fit import NUMBERS as SURFACE_FIT
from crankorder.identify.modes.surface_fit import TONE_BINS as NO_WIDTH
from crankorder.identify.modes.surface_fit import Problem, SurfaceFit, evaluate, fit_surface
from crankorder.orders.intervals import Z95
from crankorder.orders.joint_lines import HeldFrames, Place
from crankorder.quantities import Bools, Floats
from crankorder.settings import IdentifySettings, MethodNumbers

NUMBERS = MethodNumbers("5-identify-modal.toml", "tones")

TWO_SIDED = 0.02
"""Chance of a width beyond either end of an interval whose upper end holds with 99 %."""

WIDER = 1.5
"""Ratio of the widths that are tried."""

MOST_WIDTHS = 16
"""Widths that are tried at most."""

NEAR_BINS = 2
"""Bins on each side that hold a tone's power in a spectrum seen through a Hann window."""


def with_tones(
    problem: Problem, fit: SurfaceFit, floor: Floor, *, own_hz: tuple[float, float], settings: IdentifySettings
) -> SurfaceFit:
    """``fit`` with the lines in ``own_hz`` made tones whose width is none for sure.

    A line is a tone if giving it none costs no more deviance than chance would, and if the data exclude the width of
    a mode, or its power varies from speed to speed less than noise does. What is neither a tone nor wide for sure
    stays a pole; `tone_or_mode` says so.
    ``problem``: the floors fitted; ``floor``: in all channels; ``settings``: those in use.
    """
    for number in range(len(fit.poles)):
        f = float(fit.poles.frequency_hz[number])
        if _is_wide(fit, number, problem, settings) or not fit.poles.within(own_hz)[number]:
            continue
        tone = with_tone(problem, fit, number)
        if not is_steady(floor, f):
            least = NUMBERS.least_damping_ratio * f
            if _width_is_seen(problem, tone, fit, f):
                continue
            if not _on_a_tone(f, fit, floor) and widest_hz(problem, fit, number, tone.deviance) >= least:
                continue
        fit = tone
    return fit


def tone_or_mode(problem: Problem, fit: SurfaceFit, number: int, *, settings: IdentifySettings) -> str:
    """Why pole ``number`` of ``fit`` may be a tone as well as a mode; empty where its width is seen.

    ``problem``: the floors that were fitted; ``settings``: those in use.
    """
    if _is_wide(fit, number, problem, settings):
        return ""
    tone, f = with_tone(problem, fit, number), float(fit.poles.frequency_hz[number])
    if _width_is_seen(problem, tone, fit, f):
        return ""
    most = widest_hz(problem, fit, number, min(tone.deviance, fit.deviance)) / f
    return f"tone or mode: narrower than the frames resolve, its damping is none or at most {100.0 * most:.2g} %"


def with_tone(problem: Problem, fit: SurfaceFit, number: int) -> SurfaceFit:
    """Fit with pole ``number`` of ``fit`` a tone.

    ``problem``: the floors that were fitted.
    """
    poles = fit.poles.with_width(number, NO_WIDTH * problem.seen.bin_hz, is_tone=True)
    return fit_surface(problem, poles, start=fit.model, steps=10)


def _on_a_tone(frequency_hz: float, fit: SurfaceFit, floor: Floor) -> bool:
    """Whether a narrow line lies on a multiple of a tone, and hardly by chance."""
    near = NUMBERS.multiple_bins * floor.seen.bin_hz
    tones = np.array([*(f for f, _ in floor.strong), *fit.poles.frequency_hz[fit.poles.tone].tolist()])
    multiple = np.rint(frequency_hz / tones)
    on = (multiple >= 2.0) & (np.abs(frequency_hz - multiple * tones) <= near)
    return bool((on & (near < NUMBERS.by_chance_share * tones)).any())


def _is_wide(fit: SurfaceFit, number: int, problem: Problem, settings: IdentifySettings) -> bool:
    width = float(fit.poles.damping[number] * fit.poles.frequency_hz[number])
    return 2.0 * width > settings.mode_min_width_bins * problem.seen.bin_hz


def _width_is_seen(problem: Problem, tone: SurfaceFit, mode: SurfaceFit, at_hz: float) -> bool:
    """Whether no width costs more deviance than chance would."""
    least = HANN_CORRELATION * float(chdtri(1.0, NUMBERS.width_chance))
    return tone.deviance - mode.deviance > least * dispersion(problem, mode, at_hz)


def widest_hz(problem: Problem, fit: SurfaceFit, number: int, least: float) -> float:
    """Half width in Hz up to which the data allow pole ``number`` of ``fit``, at 99 %.

    ``problem``: the floors that were fitted; ``least``: deviance of the best fit.
    """
    f = float(fit.poles.frequency_hz[number])
    allowed = HANN_CORRELATION * float(chdtri(1.0, TWO_SIDED)) * dispersion(problem, fit, f)
    width = max(float(fit.poles.damping[number]) * f, 0.5 * NUMBERS.least_damping_ratio * f)
    for _ in range(MOST_WIDTHS):
        if width >= SURFACE_FIT.widest_damping_ratio * f:
            return float(width)
        if evaluate(problem, fit.poles.with_width(number, width), fit.model).deviance > least + allowed:
            break
        width *= WIDER
    return float(width)


def is_steady(floor: Floor, frequency_hz: float) -> bool:
    """Whether the power at ``frequency_hz`` varies less over the speeds than that of noise would.

    Ordinates of noise averaged n times have the relative variance 1/n; a tone's has less.
    ``floor``: the floor in all channels.
    """
    at = int(np.argmin(np.abs(floor.frequency_hz - frequency_hz)))
    for channel in range(len(floor.channels)):
        power = floor.cells[channel, :, at] * floor.gain[channel]
        used = np.isfinite(power)
        if np.count_nonzero(used) < 5:
            continue
        share = power[used] / power[used].mean()
        spread = float(np.sum(floor.cell_averages[channel, used] * (share - 1.0) ** 2))
        if float(chdtr(np.count_nonzero(used) - 1.0, spread)) < NUMBERS.steady_chance:
            return True
    return False


def tone_of(frequency_hz: float, error_hz: float, floor: Floor, fitted: Floats, *, settings: IdentifySettings) -> Tone:
    """Tone at ``frequency_hz`` with its kind and its amplitude in every channel that shows it.

    ``fitted`` (C, F) is the power of the fit without the tone, which is taken off.
    ``error_hz``: standard error of the frequency; ``floor``: in all channels; ``settings``: those in use.
    """
    kind, words = kind_of(frequency_hz, error_hz, floor, settings=settings)
    return Tone(frequency_hz, error_hz, kind, amplitudes(frequency_hz, floor, fitted), words)


def amplitudes(frequency_hz: float, floor: Floor, fitted: Floats) -> dict[str, tuple[float, float]]:
    """Peak amplitude of a tone and its standard error in the channels where it stands out of the noise.

    The power within the main lobe, less the ``fitted`` floor's (C, F), is A²/2 times the share of it that the bins
    hold; over the speeds at which no order covers it. Noise beside a tone of power T scatters by √(2TN + N²) (Rice
    1944). ``frequency_hz``: in Hz.
    """
    near = np.flatnonzero(np.abs(floor.frequency_hz - frequency_hz) <= (NEAR_BINS + 0.5) * floor.seen.bin_hz)
    kernel = floor.seen.kernel(floor.frequency_hz[near] - frequency_hz)
    standing_out: dict[str, tuple[float, float]] = {}
    for channel, name in enumerate(floor.channels):
        cells = floor.cells[channel][:, near]
        whole = np.isfinite(cells).all(axis=1)
        if not whole.any():
            continue
        gain, averages = floor.gain[channel, whole], floor.cell_averages[channel, whole]
        noise = fitted[channel, near] * gain[:, None]
        power = cells[whole] * gain[:, None]
        # least squares of the kernel in the excess over the floor: A²/2 of each speed
        tone = (power - noise) @ kernel / float(kernel @ kernel)
        weight = averages / averages.sum()
        mean = float(weight @ tone)
        level = float(weight @ (noise @ kernel)) / float(kernel @ kernel)
        by_noise = np.sqrt((2.0 * max(mean, 0.0) * level + level**2) / averages.sum())
        between = float(np.sqrt(weight @ (tone - mean) ** 2 / (len(tone) - 1))) if len(tone) > 2 else 0.0
        error = max(float(by_noise), between)
        if mean > 4.0 * by_noise:
            amplitude = float(np.sqrt(2.0 * mean))
            standing_out[name] = (amplitude, error / amplitude)
    return standing_out


def kind_of(frequency_hz: float, error_hz: float, floor: Floor, *, settings: IdentifySettings) -> tuple[ToneKind, str]:
    """Kind of a line without damping at ``frequency_hz``, and what says so.

    ``error_hz``: standard error of the frequency; ``floor``: in all channels; ``settings``: those in use.
    """
    known = on_order(frequency_hz, error_hz, floor, settings=settings)
    rows = _rows_that_show(frequency_hz, floor)
    few = rows.any() and np.count_nonzero(rows) < NUMBERS.few_of_share * len(rows)
    if not known and few and _on_half_orders(frequency_hz, rows, floor):
        known = "seen only at speeds where it lies on an order of the cycle, so that a swing of the speed makes it"
    if known:
        alone = multiple_on(frequency_hz, error_hz, settings=settings)
        also = f"; it is {alone[0]} x {alone[1]:g} Hz as well" if alone else ""
        return "mains or order" if alone else "order", known + also
    for multiple, mains in multiples_near(frequency_hz, error_hz, settings=settings):
        same = ", the same at all speeds" if _moves(floor) else ""
        return "mains", f"no damping, {times_mains(multiple, mains)}{same}"
    stays = "stays at all speeds" if rows.all() else f"stands out at {np.count_nonzero(rows)} of {len(rows)} speeds"
    stays = f"; {stays}" if _moves(floor) else ""
    return "tone", f"no damping: as narrow as the window makes any tone{stays}"


def _moves(floor: Floor) -> bool:
    """Whether several speeds were tested, between which an order would have moved: one cannot tell what stays."""
    speed = floor.speed_rpm[np.isfinite(floor.speed_rpm)]
    return len(speed) > 1 and not alike_speeds(speed)


def _rows_that_show(frequency_hz: float, floor: Floor) -> Bools:
    """At which speeds the channel that shows a line at ``frequency_hz`` best has it: with a tenth of the most, or more.

    A tone of a source of its own is there at all speeds, as large as ever.
    """
    at = int(np.argmin(np.abs(floor.frequency_hz - frequency_hz)))
    inner = slice(max(0, at - NEAR_BINS), at + NEAR_BINS + 1)
    outer = np.r_[max(0, at - NUMBERS.beside_bins) : inner.start, inner.stop : at + NUMBERS.beside_bins]
    outer = outer[outer < floor.cells.shape[2]]
    cells = np.where(np.isfinite(floor.cells), floor.cells, 0.0) * floor.gain[:, :, None]
    level = np.median(cells[:, :, outer], axis=2)
    excess = cells[:, :, inner].max(axis=2) - level
    best = int(np.argmax((excess / np.maximum(level.max(axis=1, keepdims=True), 1e-300)).max(axis=1)))
    return np.asarray(excess[best] >= NUMBERS.shown_share * max(float(excess[best].max()), 1e-300))


def _on_half_orders(frequency_hz: float, rows: Bools, floor: Floor) -> bool:
    """Whether ``frequency_hz`` lies within a bin of a half order at every speed of ``rows``, and hardly by chance."""
    halves_hz = floor.speed_rpm[rows] / 120.0
    if not np.isfinite(halves_hz).all() or floor.seen.bin_hz > 0.1 * halves_hz.min():
        return False
    off = np.abs(frequency_hz - np.round(frequency_hz / halves_hz) * halves_hz)
    return bool((off <= floor.seen.bin_hz + NUMBERS.speed_spread_share * frequency_hz).all())


def with_one_mains(tones: list[Tone], *, settings: IdentifySettings) -> tuple[Tone, ...]:
    """``tones`` with "mains" taken back where lines of two mains frequencies stand side by side: no place has both.

    Where the first or second multiple of one of them alone is there, that is the supply.
    And with each multiple once: a second line on it is the first one's skirt within both errors, and a tone otherwise.
    ``settings`` name the mains frequencies.
    """
    tones = _each_multiple_once(tones, settings=settings)
    mains = [(tone.frequency_hz, 0.0) for tone in tones if tone.kind == "mains"]
    mains = [place for place in mains if multiples_near(*place, settings=settings)]
    supply = supply_told(mains, settings=settings)
    if supply is not None:
        return tuple(_of_supply(tone, supply, settings) for tone in tones)
    if not any(len(multiples_near(*place, settings=settings)) == 1 for place in mains):
        return tuple(tones)
    words = "no damping; a multiple of a mains frequency, but so are others of another one"
    return tuple(replace(tone, kind="tone", evidence=words) if tone.kind == "mains" else tone for tone in tones)


def _of_supply(tone: Tone, supply_hz: float, settings: IdentifySettings) -> Tone:
    """``tone`` as a multiple of the supply of the test, if it is one; a tone where it is that of another alone."""
    near = multiples_near(tone.frequency_hz, tone.frequency_error_hz, settings=settings)
    if tone.kind != "mains" or not near:
        return tone
    own = [multiple for multiple, mains in near if mains == supply_hz]
    if not own:
        words = f"no damping; a multiple of {near[0][1]:g} Hz, but the mains of this test are of {supply_hz:g} Hz"
        return replace(tone, kind="tone", evidence=words)
    if near[0][1] == supply_hz:
        return tone
    return replace(tone, evidence=tone.evidence.replace(times_mains(*near[0]), times_mains(own[0], supply_hz)))


def times_mains(multiple: int, mains_hz: float) -> str:
    """Words for the ``multiple`` of a supply of ``mains_hz``."""
    return f"{multiple} times the mains frequency of {mains_hz:g} Hz"


def _each_multiple_once(tones: list[Tone], *, settings: IdentifySettings) -> list[Tone]:
    kept = [tone for tone in tones if tone.kind != "mains"]
    first: dict[tuple[float, int], Tone] = {}
    near = partial(multiples_near, settings=settings)
    mains_tones = [tone for tone in tones if tone.kind == "mains"]
    places = [(tone, *[*near(tone.frequency_hz, tone.frequency_error_hz), (1, 0.0)][0]) for tone in mains_tones]
    # of two that claim one supply that of which the whole interval lies nearest to what the supply should have
    ends = [
        abs(tone.frequency_hz / n - hz) + NUMBERS.same_sigmas * tone.frequency_error_hz / n for tone, n, hz in places
    ]
    for tone, multiple, mains in (places[k] for k in np.argsort(ends)):
        others = [(multiple / n, other) for (m, n), other in first.items() if m == mains]
        beside = [other for ratio, other in others if _differ(tone, other, ratio)]
        if beside:
            words = f"no damping; beside the mains line of {beside[0].frequency_hz:.6g} Hz, which has one frequency"
            kept.append(replace(tone, kind="tone", evidence=words))
        elif (mains, multiple) not in first:
            kept.append(tone)
            first |= {(mains, multiple): tone} if mains else {}
    return sorted(kept, key=lambda tone: tone.frequency_hz)


def _differ(tone: Tone, other: Tone, ratio: float) -> bool:
    """Whether a ``tone`` is surely not ``ratio`` times the ``other``: all multiples of a supply wander together."""
    error = float(np.hypot(tone.frequency_error_hz, ratio * other.frequency_error_hz))
    apart = abs(tone.frequency_hz - ratio * other.frequency_hz)
    return bool(apart > NUMBERS.same_sigmas * error + (0.0 if ratio == 1.0 else MAINS.least_apart_hz))


def on_order(frequency_hz: float, error_hz: float, floor: Floor, *, settings: IdentifySettings) -> str:
    """Why a narrow line at ``frequency_hz`` may be an order of the shaft, where the speeds are too alike; else "".

    ``error_hz``: standard error of the frequency; ``floor``: in all channels; ``settings``: those in use.
    """
    if not at_one_speed(floor, settings=settings):
        return ""
    speed = floor.speed_rpm[np.isfinite(floor.speed_rpm)]
    step = float(np.median(speed)) / 60.0 / 2.0
    share = 0.5 * np.ptp(speed) / np.median(speed) + NUMBERS.speed_spread_share
    spread = share * frequency_hz + 2.0 * error_hz + floor.seen.bin_hz
    half = max(1, round(frequency_hz / step))
    if abs(frequency_hz - step * half) <= spread and step > 2.0 * spread:
        return f"lies on order {0.5 * half:g}, and the tested speeds are too alike to tell an order from a fixed line"
    return ""


def at_one_speed(floor: Floor, *, settings: IdentifySettings) -> bool:
    """Whether the speeds of a shaft are too alike to tell an order from a line of fixed frequency.

    ``floor``: the floor in all channels; ``settings``: ``mode_speed_ratio`` says how alike.
    """
    speed = floor.speed_rpm[np.isfinite(floor.speed_rpm)]
    return len(speed) > 0 and bool(speed.max() < settings.mode_speed_ratio * speed.min())


def with_tones_settled(
    orders: AgreedOrders,
    modal: ModalFit,
    held: Sequence[HeldFrames],
    known: Sequence[LineSeen],
    *,
    settings: IdentifySettings,
) -> ModalFit:
    """``modal`` with each tone as the recordings hold it: mains, a tone, or one of the ``orders``.

    ``held`` are the recordings at held speeds; ``known`` lines of the mains; ``settings``: the mains frequencies and
    how far they wander.
    """
    modal = with_mains_tones(modal, known, orders)
    modal = without_absent_mains(modal, held, settings=settings)
    return without_doubles(replace(modal, tones=with_one_mains(list(modal.tones), settings=settings)))


def without_absent_mains(modal: ModalFit, held: Sequence[HeldFrames], *, settings: IdentifySettings) -> ModalFit:
    """``modal`` with higher multiples of the mains called tones where one of the recordings ``held`` has none there.

    A supply is there at every speed; what stands near one of its many multiples at some speeds is something else, but
    where it is the exact multiple of a supply that the test shows: a weak one is not seen in every recording. What may
    be mains or an order is an order where most recordings whose shaft has none there do not show it.
    ``settings``: the mains frequencies and how far they wander.
    """
    mains = [tone for tone in modal.tones if tone.kind == "mains"]
    alone_hz = MAINS.alone_multiples * max(settings.mains_hz) + 2.0 * settings.mains_tolerance_hz
    supplies = [tone for tone in mains if tone.frequency_hz <= alone_hz]
    high = [tone for tone in mains if tone.frequency_hz > alone_hz]
    doubted = [tone for tone in high if not any(_is_multiple(tone, supply, settings) for supply in supplies)]
    doubted += [tone for tone in modal.tones if tone.kind == "mains or order"]
    tones = [_unless_absent(tone, held, modal.step_hz) if tone in doubted else tone for tone in modal.tones]
    return replace(modal, tones=tuple(tones))


def _is_multiple(tone: Tone, supply: Tone, settings: IdentifySettings) -> bool:
    """Whether ``tone`` is, within the errors of both, a whole multiple of what ``supply`` is one of."""
    for own, _ in multiples_near(supply.frequency_hz, supply.frequency_error_hz, settings=settings):
        times = round(tone.frequency_hz / supply.frequency_hz * own) / own
        error = np.hypot(tone.frequency_error_hz, times * supply.frequency_error_hz)
        if abs(tone.frequency_hz - times * supply.frequency_hz) <= Z95 * error:
            return True
    return False


def _unless_absent(tone: Tone, held: Sequence[HeldFrames], reach_hz: float) -> Tone:
    """``tone``, or no mains where a recording has none there although no order of its shaft hides the place.

    What may be an order as well is no mains where most of such recordings have none.
    """
    place = tone.frequency_hz
    inside = [run for run in held if run.reaches(1.0, run.order_of(Place(place + reach_hz)))]
    inside = [run for run in inside if not run.is_half(run.order_of(Place(place)))]
    shown = sum(found_near(run, place - reach_hz, place + reach_hz) is not None for run in inside)
    either = tone.kind == "mains or order"
    if not inside or shown >= (0.5 if either else 1.0) * len(inside):
        return tone
    words = f"{tone.evidence if either else 'no damping'}; {shown} of {len(inside)} recordings show it"
    return replace(tone, kind="order" if either else "tone", evidence=words)


def is_shown(tone: Tone, mode: Mode) -> bool:
    """Whether ``tone`` is what the floor shows of a ``mode`` that orders raise."""
    near = max(mode.damping_ratio * mode.frequency_hz, 3.0 * np.hypot(mode.frequency_error_hz, tone.frequency_error_hz))
    return tone.kind == "tone" and abs(tone.frequency_hz - mode.frequency_hz) <= near


def _is_flank(tone: Tone, other: Tone, reach_hz: float) -> bool:
    size, more = (max(value for value, _ in line.amplitude.values()) for line in (tone, other))
    return size < more and abs(tone.frequency_hz - other.frequency_hz) < reach_hz


def without_doubles(modal: ModalFit) -> ModalFit:
    """``modal`` without tones that may be orders and stand on the flank of a stronger tone.

    Lines closer than the main lobe of the window are one in the map; such a one is what the fit of the stronger left.
    """
    reach = NEAR_BINS * modal.step_hz
    flanks = [tone for tone in modal.tones if any(_is_flank(tone, other, reach) for other in modal.tones)]
    return replace(modal, tones=tuple(t for t in modal.tones if "order" not in t.kind or t not in flanks))
