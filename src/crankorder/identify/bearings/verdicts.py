"""What a bearing line says, in plain words."""

from __future__ import annotations

import math

from crankorder.identify.bearings.candidates import Candidate
from crankorder.identify.bearings.envelope_lines import EnvelopeLine
from crankorder.identify.bearings.places import Place
from crankorder.identify.bearings.shaft_speed import ShaftSpeed
from crankorder.identify.found import AgreedOrder
from crankorder.identify.intervals import Z95
from crankorder.settings import MethodNumbers


class _Numbers(MethodNumbers, file="5-identify-bearings.toml", table="verdicts"):
    companion_share: float
    off_share: float


NUMBERS = _Numbers.load()

DAMAGED = {
    "BPFO": "the outer race",
    "BPFI": "the inner race",
    "BSF": "a rolling element",
    "FTF": "the cage",
}

RE_RUN = "Re-run the same test: a growing amplitude means a failing bearing."


def vibration_verdict(place: Place, order: AgreedOrder, *, revs_per_cycle: int) -> str:
    """Verdict on an ``order`` of the vibration at ``place``: a bearing, or a part that keeps step with the shaft.

    ``revs_per_cycle``: crank revolutions of an engine cycle, whose multiples combustion makes.
    """
    if place.line == "N*fs":
        return _passage_verdict(place, order, revs_per_cycle)
    slip = place.slip_percent(order.order)
    text = f"Order {order.order:.4g} may be {DAMAGED[place.line]} of {place.name}: {_slip_words(slip)}."
    if order.lock == "undecided":
        text += f" Whether it slips is not decided{_revs_words(order)}."
    return f"{text} {RE_RUN}"


def _passage_verdict(place: Place, order: AgreedOrder, revs_per_cycle: int) -> str:
    """Verdict on N*fs, which is BPFO + BPFI for every geometry, and a multiple of the shaft's order as well."""
    n, shaft = place.elements or 0, place.shaft_order
    whose = "the crankshaft" if shaft == 1.0 else f"the shaft that turns at {shaft:g} of the crank's speed"
    if order.lock == "locked":
        text = (
            f"Exactly locked: {n} x of {whose}, such as a toothed or lobed part. BPFO + BPFI adds up to it too, "
            "at any slip of the cage."
        )
        cycle = place.expected * revs_per_cycle
        if abs(cycle - round(cycle)) < 1e-9:
            text += " In a firing engine combustion makes this order too."
        return text
    if order.lock == "slips":
        slip = place.slip_percent(order.order)
        return (
            f"Slips ({_slip_words(slip)}), so no part that keeps step with {whose}, nor BPFO + BPFI on it: "
            f"the {n} rolling elements of {place.name}, passing more slowly or faster than it turns. {RE_RUN}"
        )
    return (
        f"Either the {n} rolling elements of {place.name} (N*fs = BPFO + BPFI) or a part with {n} teeth or lobes on "
        f"{whose}: not decided{_revs_words(order)}."
    )


def races_words(races: list[str], struck: list[str]) -> str:
    """What the ``races`` (BPFO, BPFI) of a bearing that were found, in vibration or envelope, say of its N*fs.

    ``struck``: its other lines that the envelope shows.
    """
    if not races and struck:
        verb = "was" if len(struck) == 1 else "were"
        return f"Neither of its races was found, but {' and '.join(struck)} {verb}, in the envelope: see there."
    if not races:
        return "Neither of its races was found: no bearing alarm."
    return f"{' and '.join(races)} of the same bearing {'was' if len(races) == 1 else 'were'} found: see there."


def _damage(place: Place) -> str:
    if place.line == "N*fs":
        return "strikes of every rolling element"
    return f"damage of {DAMAGED[place.line]}"


def _revs_words(order: AgreedOrder) -> str:
    if order.needed_revs is None or not math.isfinite(order.needed_revs):
        return ""
    return f"; a recording of {math.ceil(order.needed_revs)} revolutions would tell"


def _slip_words(slip_percent: float) -> str:
    if abs(slip_percent) < 0.005:
        return "just as in pure rolling"
    return f"{abs(slip_percent):.2f} % {'slower' if slip_percent > 0.0 else 'faster'} than in pure rolling"


def envelope_verdict(
    line: EnvelopeLine, found: list[EnvelopeLine], *, speed_is_nominal: bool, shaft: ShaftSpeed | None = None
) -> str:
    """Verdict on a ``line`` of the envelope among all ``found``: which part is damaged, and how sure that is.

    ``speed_is_nominal``: where the speed was stated and not measured, its error looks like slip; ``shaft``: what the
    sidebands tell of it.
    """
    place = line.place
    slip = _slip_words(place.slip_percent(line.order / (shaft.factor if shaft is not None else 1.0)))
    lead = _lead(line, found)
    if lead is not None:
        share = line.amplitude / lead.amplitude
        sure = not _rivals(lead, found)
        goes = f"{_damage(lead.place)} as the load passes the rolling elements" if sure else "the strikes there"
        return (
            f"{place.title} of {place.name} ({slip}) with {share:.0%} of the amplitude of {lead.place.title}: it goes "
            f"with {goes}; no second damage is concluded."
        )
    text = _part_words(line, _rivals(line, found), slip)
    if speed_is_nominal:
        text += f" {_speed_words(shaft)}"
    others = [other for other in found if other is not line]
    same = [
        other
        for other in others
        if abs(other.order - line.order) <= 3.0 * math.hypot(other.order_error, line.order_error)
    ]
    if same:
        names = ", ".join(f"{other.place.name} {other.place.title}" for other in same)
        text += f" {names} cannot be told from it."
    return f"{text} {RE_RUN}"


def _speed_words(shaft: ShaftSpeed | None) -> str:
    """What is said of a nominal speed."""
    if shaft is None:
        return "The speed is nominal: its error looks like slip."
    off, error = 100.0 * (shaft.factor - 1.0), 100.0 * Z95 * shaft.error
    return (
        f"The stated speed is nominal: by the spacing of the sidebands the shaft turns {abs(off):.2f} % "
        f"{'faster' if off > 0.0 else 'slower'} (± {error:.2f} %), and the slip is counted from that."
    )


def _lead(line: EnvelopeLine, found: list[EnvelopeLine]) -> EnvelopeLine | None:
    """The line of the same bearing with which ``line`` goes; None where it leads or may be the damage itself."""
    kin = [other for other in found if other.place.name == line.place.name and other.place.line != line.place.line]
    higher = [other for other in kin if (other.level_db, other.ratio) > (line.level_db, line.ratio)]
    lead = max(higher, key=lambda other: (other.level_db, other.ratio), default=None)
    if lead is None or line.place.line in {one.place.line for one in _rivals(lead, found)}:
        return None
    return lead


def _rivals(line: EnvelopeLine, found: list[EnvelopeLine]) -> list[Candidate]:
    """Parts of its bearing that that of ``line`` is not told from.

    They stand about as high by their harmonics, or have a line of about its amplitude among those ``found``; a cage's
    goes with every damage that comes and goes with the load.
    """
    ranked, place_line = line.ranking, line.place.line
    high = {one.place.line for one in (ranked.candidates[0], *ranked.rivals())} if ranked.candidates else set()
    kin = [other for other in found if other.place.name == line.place.name]
    large = {
        other.place.line
        for other in kin
        if other.place.line not in ("FTF", "N*fs")
        and other.amplitude >= NUMBERS.companion_share * line.amplitude
        and not (place_line == "FTF" and _is_multiple(other.order, line.order))
    }
    return [one for one in ranked.candidates if one.place.line in (high | large) - {line.place.line}]


def _is_multiple(order: float, cage: float) -> bool:
    """Whether a line at ``order`` is one of the many harmonics that a damaged ``cage`` has."""
    return abs(order / cage - round(order / cage)) <= NUMBERS.off_share


def _part_words(line: EnvelopeLine, rivals: list[Candidate], slip: str) -> str:
    """Which part a ``line`` that goes with no other tells of, by how much, and which of ``rivals`` it may be."""
    place, ranked = line.place, line.ranking
    own = ranked.of(place.line)
    if own is None:
        return f"{_damage(place).capitalize()} of {place.name}: strikes at {place.title}, {slip}."
    if not rivals:
        margin = f", {ranked.margin_db:.0f} dB more than {ranked.candidates[1].place.title}" if ranked.others else ""
        return (
            f"{_damage(place).capitalize()} of {place.name}: strikes at {place.title}, {slip}; its harmonics stand "
            f"{own.level_db:.0f} dB over the floor{margin}."
        )
    levels = ", ".join(f"{one.place.title} {one.level_db:.0f} dB" for one in (own, *rivals))
    if {place.line, *(one.place.line for one in rivals)} == {"BPFO", "BPFI"}:
        return (
            f"Strikes at {place.title} of {place.name}, {slip}, and about as strong at {rivals[0].place.title}: both "
            "races are struck, as by a damaged rolling element, by dirt or by damage of both; which part is not told "
            f"(harmonics over the floor: {levels})."
        )
    parts = " or ".join(DAMAGED[one.place.line] for one in (own, *rivals))
    return (
        f"Strikes at {place.title} of {place.name}, {slip}: damage of {parts}; which of them is not told (harmonics "
        f"over the floor: {levels})."
    )


def envelope_evidence(
    line: EnvelopeLine, channels: list[str], band_hz: list[float], *, level: float, n_speeds: int
) -> str:
    """How a ``line`` was found: how high, in which of ``channels`` and ``band_hz``, at how many speeds.

    ``level``: the false-alarm probability of the whole test; ``n_speeds``: the speeds looked at.
    """
    seen = line.seen.any(axis=0).sum()
    text = (
        f"{10.0 * math.log10(line.ratio):.1f} dB over the envelope's floor in {channels[line.channel]}, band "
        f"{band_hz[0]:.0f} to {band_hz[1]:.0f} Hz; over the level at {seen} of {n_speeds} speeds"
    )
    if not seen:
        text += ", so only in the mean of all"
    text += f"; {line.harmonics} of its first 4 multiples"
    if line.sidebands is not None:
        text += f", sidebands {line.sidebands:.3g} apart"
    chance = "below 1e-12" if line.chance < 1e-12 else f"{line.chance:.1e}"
    text += f"; chance that noise makes it anywhere in the test {chance} (level {level:g})"
    return "; ".join([text, *line.also])
