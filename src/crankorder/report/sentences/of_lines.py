"""The strongest lines of a test in plain sentences: orders of the shaft and tones of fixed frequency."""

from __future__ import annotations

from typing import Any

from crankorder.identify.said import LIKE_UNBALANCE, MAY_BE_ALL, ONE_SPEED, UNRESOLVED
from crankorder.report.fixed_lines import fixed_tones, hertz_of_order, is_electric, strongest_tone
from crankorder.report.notation import (
    NAME_CHARACTERS,
    at_one_speed,
    estimate_text,
    frequency_text,
    is_in_doubt,
    is_number,
    is_tone,
    listed,
    named,
    nominal_order,
    order_name,
    order_texts,
    percent_text,
    unit_of,
)
from crankorder.report.sentences.of_levels import above_sentence, look_above, stronger_above

_MEETING_SHARE = 0.03  # an order line this close to a natural frequency is said to meet it
_MANY = 3  # channels that a summary names one by one
_SHOWN = 14  # orders or tones that a sentence lists
_MOSTLY = 0.5  # share of the energy from which something is most of it


def line_sentences(findings: dict[str, Any]) -> list[str]:
    """What shakes: the strongest line of each channel of ``findings``, the strongest first, then what else there is."""
    names = _channels(findings)
    if not names:
        return [*_above(findings), _nothing(findings)]
    sentences = [*_above(findings), *(strongest_sentence(findings, name, with_cause=True) for name in names[:_MANY])]
    if len(names) > _MANY:
        sentences.append("The tables hold the other channels.")
    orders = sorted(
        {
            nominal_order(record)
            for record in findings.get("orders", [])
            if is_number(record.get("order")) and not is_electric(record)
        }
    )
    if orders:
        texts = order_texts(orders)
        end = " and more." if len(texts) > _SHOWN else "."
        sentences.append(f"{len(orders)} order{'s' * (len(orders) > 1)} found: {', '.join(texts[:_SHOWN])}{end}")
    return [*sentences, *_broadband(findings)]


def _above(findings: dict[str, Any]) -> list[str]:
    """That the strongest line of a channel lies above the band, of the channel where it is largest; else nothing."""
    return [above_sentence(findings, one) for one in _strongest_above(findings)]


def above_asks(findings: dict[str, Any]) -> list[str]:
    """What to do where ``findings`` say that the strongest line of a channel lies above the band; else nothing."""
    return [asked for asked in map(look_above, _strongest_above(findings)) if asked]


def _strongest_above(findings: dict[str, Any]) -> list[dict[str, Any]]:
    """Levels of the channel with the largest line above the band that is the strongest of its channel; else none."""
    found = []
    for record in findings.get("levels") or []:
        channel = str(record.get("channel"))
        own = [_strongest_order(findings, channel), strongest_tone(findings, channel)]
        largest = max((float(one["amplitude"]) for one in own if one is not None), default=0.0)
        if (above := stronger_above(findings, channel, largest)) is not None:
            found.append(above)
    units = list(dict.fromkeys(str(one.get("unit")) for one in found))
    found.sort(key=lambda one: (units.index(str(one.get("unit"))), -float(one["amplitude_above"])))
    return found[:1]


def lies_above(findings: dict[str, Any]) -> bool:
    """Whether the first of :func:`line_sentences` of ``findings`` says that the strongest line is above the band."""
    return bool(_strongest_above(findings))


def nothing_proven(findings: dict[str, Any]) -> bool:
    """True where ``findings`` hold no line because too few revolutions were recorded, not because there is none."""
    short = any(flag.get("flag") == "short_recording" for flag in findings.get("quality", []))
    return short and not _channels(findings)


def _nothing(findings: dict[str, Any]) -> str:
    if nothing_proven(findings):
        return "No order could be proven: the recordings hold too few revolutions."
    return "No order stands above the noise."


def _channels(findings: dict[str, Any]) -> list[str]:
    """Channels with a line, the strongest first among those of one unit; units in the order of the channels."""
    top: dict[str, tuple[str, float]] = {}
    for channel in dict.fromkeys(
        str(record.get("channel", "")) for key in ("orders", "lines") for record in findings.get(key, [])
    ):
        records = [one for one in (_strongest_order(findings, channel), strongest_tone(findings, channel)) if one]
        if records:
            best = max(records, key=lambda one: float(one["amplitude"]))
            top[channel] = unit_of(findings, best), float(best["amplitude"])
    known = [str(one.get("name")) for one in findings.get("channels", [])]
    ordered = sorted(top, key=lambda name: known.index(name) if name in known else len(known))
    units = list(dict.fromkeys(top[name][0] for name in ordered))
    return sorted(ordered, key=lambda name: (units.index(top[name][0]), -top[name][1]))


def _strongest_order(findings: dict[str, Any], channel: str) -> dict[str, Any] | None:
    records = [
        record
        for record in findings.get("orders", [])
        if record.get("channel") == channel and is_number(record.get("amplitude")) and is_number(record.get("order"))
    ]
    record = max(records, key=lambda one: float(one["amplitude"]), default=None)
    return record if record is not None and record["amplitude"] > 0 else None


def strongest_sentence(findings: dict[str, Any], channel: str, *, with_cause: bool = False) -> str:
    """``"Order 2 is the strongest line in Z: 0.83 m/s² (0.81…0.85) at 1800 rpm, where it meets the 60 Hz …"``

    ``findings`` of the test; ``channel`` whose strongest line, order or fixed tone, is asked for; ``with_cause`` adds
    what makes it. Empty where it has none.
    """
    order, tone = _strongest_order(findings, channel), strongest_tone(findings, channel)
    largest = max((float(one["amplitude"]) for one in (order, tone) if one is not None), default=0.0)
    above = stronger_above(findings, channel, largest)
    where = named(channel, limit=NAME_CHARACTERS) + ("" if above is None else " in the band that was looked at")
    if tone is not None and (order is None or float(tone["amplitude"]) > float(order["amplitude"])):
        noun = "line at" if at_one_speed(findings) else "fixed tone of"
        text = f"A {noun} {_tone_hz(tone)} Hz is the strongest line in {where}: {_level(findings, tone)}"
        if order is not None:
            hertz = hertz_of_order(order, findings)
            called = (
                f"order is {order_name(order, findings)}" if hertz is None else f"other line is {_called(hertz, order)}"
            )
            text += f"; the strongest {called}: {_level(findings, order)}"
            rpm = order.get("speed_rpm_at_max")
            text += f" at {rpm:.0f} rpm" if is_number(rpm) else ""
        return f"{text}.{_cause(tone, findings) if with_cause else ''}"
    if order is None:
        return ""
    if UNRESOLVED in str(order.get("evidence", "")):
        return _unresolved(findings, order, where)
    hertz = hertz_of_order(order, findings)
    called = f"Order {order_name(order, findings)}" if hertz is None else f"A line at {_called(hertz, order)}"
    text = f"{called} is the strongest line in {where}: {_at(findings, order)}"
    return f"{text}.{_cause(order, findings) if with_cause else ''}"


def _unresolved(findings: dict[str, Any], order: dict[str, Any], where: str) -> str:
    """What is said where something stronger than all orders that are told was not resolved."""
    near, rpm = order_name(order, findings), order.get("speed_rpm_at_max")
    text = f"What is strongest in {where} was not resolved: near order {near}, {_level(findings, order)}"
    text += f" at {rpm:.0f} rpm" if is_number(rpm) else ""
    rest = [one for one in findings["orders"] if UNRESOLVED not in str(one.get("evidence", ""))]
    told = _strongest_order({"orders": rest}, str(order["channel"]))
    if told is not None:
        text += f"; of the orders that are told {order_name(told, findings)} is the strongest: {_level(findings, told)}"
    return f"{text}."


def _called(hertz: float, order: dict[str, Any]) -> str:
    """``"48.35 Hz (order 5.492)"``: a line whose frequency says more than its order."""
    return f"{hertz:.2f} Hz (order {order_texts([nominal_order(order)])[0]})"


def _tone_hz(tone: dict[str, Any]) -> str:
    """Frequency of a tone to a tenth of a hertz: tones are sharp."""
    return f"{float(tone['frequency_hz']):.1f}".removesuffix(".0")


def _level(findings: dict[str, Any], record: dict[str, Any]) -> str:
    value, _, interval = estimate_text(record, "amplitude").partition(" ")
    return " ".join(part for part in (value, unit_of(findings, record), interval) if part)


def _at(findings: dict[str, Any], record: dict[str, Any]) -> str:
    text, rpm = _level(findings, record), record.get("speed_rpm_at_max")
    if not is_number(rpm):
        return text
    text += f" at {rpm:.0f} rpm"
    mode_hz = met_mode_hz(findings, record)
    if mode_hz is None:
        return text
    hertz = f"{frequency_text(mode_hz)} Hz"
    met = (
        f"{hertz}, which may be a natural frequency"
        if is_in_doubt(mode_hz, findings)
        else f"the {hertz} natural frequency"
    )
    return f"{text}, where it meets {met}"


def met_mode_hz(findings: dict[str, Any], record: dict[str, Any]) -> float | None:
    """Natural frequency [Hz] that an order ``record`` of the ``findings`` meets where it is largest, or None.

    As the record states it (``meets_hz``), else the one near its line at that speed.
    """
    rpm = record.get("speed_rpm_at_max")
    if not is_number(rpm):
        return None
    line_hz = float(record["order"]) * float(rpm) / 60
    modes = [
        float(mode["frequency_hz"])
        for mode in findings.get("modes", [])
        if is_number(mode.get("frequency_hz")) and not is_tone(mode)
    ]
    if "meets_hz" in record:
        modes = [float(record["meets_hz"])] if is_number(record["meets_hz"]) else []
    near = [mode_hz for mode_hz in modes if abs(mode_hz - line_hz) <= _MEETING_SHARE * mode_hz]
    return min(near, key=lambda mode_hz: abs(mode_hz - line_hz)) if near else None


def _cause(record: dict[str, Any], findings: dict[str, Any]) -> str:
    cause, in_doubt = str(record.get("explained_by") or "unexplained"), bool(findings.get("speed_doubt"))
    if cause == "unexplained":
        return " Its cause is not known."
    if cause == "tone":
        if in_doubt:
            return " Whether it follows the shaft is not decided, for the speed is in doubt."
        if at_one_speed(findings):
            return " At one speed nothing tells whether it follows the shaft."
        return " The tone does not follow the shaft: it has a source of its own."
    if in_doubt:
        return f" Cause, if the speed is right: {named(cause, limit=2 * NAME_CHARACTERS)}."
    return f" Cause: {named(cause, limit=2 * NAME_CHARACTERS)}{_untold(record, findings)}."


def _untold(record: dict[str, Any], findings: dict[str, Any]) -> str:
    """Why nothing tells which of the causes of an order ``record`` it is, where these are those of order 1."""
    if record.get("explained_by") != LIKE_UNBALANCE:
        return ""
    if ONE_SPEED not in str(record.get("evidence")):
        return "; how it grows does not tell which"
    return "; one speed cannot tell which" if at_one_speed(findings) else "; so few speeds cannot tell which"


def tone_sentences(findings: dict[str, Any]) -> list[str]:
    """Tones and mains of the ``findings`` with their amplitudes: they are no natural frequencies."""
    texts = []
    for tone in fixed_tones(findings)[:_SHOWN]:
        kind = named(tone["kind"], limit=NAME_CHARACTERS)
        text = f"{_tone_hz(tone['record'])} Hz ({kind}"
        if tone["lines"] and is_number(tone["lines"][0].get("amplitude")):
            line = tone["lines"][0]
            text += f", {_level(findings, line)} in {named(line.get('channel', ''), limit=NAME_CHARACTERS)}"
        texts.append(f"{text}{_or_mode(tone['record'], findings)})")
    texts += _mains_among_orders(findings)
    if not texts:
        return []
    if len(texts) == 1:
        return [f"A tone, no natural frequency: {texts[0]}."]
    return [f"Tones, no natural frequencies: {listed(texts)}."]


def _or_mode(tone: dict[str, Any], findings: dict[str, Any]) -> str:
    """That a natural frequency may stand at a ``tone`` too, where the ``findings`` do not decide it."""
    hertz = f" at {float(tone['frequency_hz']):.5g} Hz"
    doubts = (str(mode.get("undecided") or "").split("; ")[-1] for mode in findings.get("modes", []))
    beside = any(last.endswith(MAY_BE_ALL) and hertz in last for last in doubts)
    return "; a natural frequency may be there too" if beside else ""


def _mains_among_orders(findings: dict[str, Any]) -> list[str]:
    """Lines of the mains among the orders of ``findings``, each in the channel where it is strongest."""
    best: dict[float, dict[str, Any]] = {}
    for record in findings.get("orders", []):
        if "mains" not in str(record.get("explained_by") or "") or findings.get("motor"):
            continue  # a motor has sentences of its own
        if hertz_of_order(record, findings) is None:
            continue
        old = best.get(record["order"])
        if old is None or float(record.get("amplitude") or 0) > float(old.get("amplitude") or 0):
            best[record["order"]] = record
    return [
        f"{float(one['order']) * float(one['speed_rpm_at_max']) / 60.0:.2f} Hz "
        f"({named(one['explained_by'], limit=NAME_CHARACTERS)}, {_level(findings, one)} in "
        f"{named(one.get('channel', ''), limit=NAME_CHARACTERS)})"
        for _, one in sorted(best.items())
    ][:_SHOWN]


def _broadband(findings: dict[str, Any]) -> list[str]:
    """Where most of the energy lies between the lines: a page that names lines alone would mislead."""
    energy = findings.get("energy")
    channels = energy.get("channels") if isinstance(energy, dict) else None
    loud = [
        (named(one.get("channel", ""), limit=NAME_CHARACTERS), float(one["modes_and_floor"]))
        for one in channels or []
        if is_number(one.get("modes_and_floor")) and float(one["modes_and_floor"]) > _MOSTLY
    ]
    if not loud:
        return []
    said = [f"{name} {percent_text(share)}" for name, share in loud[:_MANY]]
    more = ", …" if len(loud) > _MANY else ""
    return [f"Most of the energy is broadband, at natural frequencies and in the noise floor: {', '.join(said)}{more}."]
