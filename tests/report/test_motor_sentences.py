"""What a page says of a motor and of lines at one speed: the frequency first, doubts said, no share of another line."""

from __future__ import annotations

from typing import Any

from crankorder.report.sentences.of_lines import SHAFT_SIDES, motor_sentences, strongest_sentence, tone_sentences
from crankorder.report.sentences.of_orders import law_sentences, lock_sentences
from made.typed import from_dicts

strongest_sentence, tone_sentences, motor_sentences, law_sentences, lock_sentences = map(
    from_dicts,
    (strongest_sentence, tone_sentences, motor_sentences, law_sentences, lock_sentences),
)


def line(name: str, hertz: float, size: float, *, side: str = "", others: tuple[str, ...] = ()) -> dict[str, Any]:
    return {
        "name": name, "side": side, "channel": "Z", "frequency_hz": hertz, "order": hertz / 24.5, "speed_rpm": 1470.0,
        "amplitude": size, "amplitude_ci95": [size, size], "or": list(others), "n_recordings": 1,
    }  # fmt: skip


def order(number: float, size: float, *, lock: str, cause: str) -> dict[str, Any]:
    return {
        "channel": "Z", "order": number, "order_ci95": [number - 1e-4, number + 1e-4], "lock": lock, "amplitude": size,
        "amplitude_ci95": [size, size], "unit": "m/s2", "speed_rpm_at_max": 1470.0, "explained_by": cause,
        "speed_law": "keeps its size",
    }  # fmt: skip


def findings(*lines: dict[str, Any], orders: tuple[dict[str, Any], ...] = (), **more: Any) -> dict[str, Any]:
    motor = {
        "supply_hz": 50.0, "supply_hz_ci95": [50.0, 50.0], "supply_measured": True, "poles": 4, "rotor_bars": 44,
        "misfit": "", "lines": list(lines),
        "speeds": [{"speed_rpm": 1470.0, "synchronous_rpm": 1500.0, "slip": 0.02, "slip_ci95": [0.02, 0.02],
                    "pole_pass_hz": 2.0, "fits": True}],
    }  # fmt: skip
    channels = [{"name": "Z", "unit": "m/s2"}]
    return {"channels": channels, "orders": list(orders), "motor": motor | more, "speed_range_rpm": [1470.0, 1470.0]}


def test_the_slip_and_the_pole_pass_are_said() -> None:
    assert motor_sentences(findings())[0] == (
        "The motor (4 poles at 50 Hz, as its own lines measure) slips by 2 % at 1470 rpm; "
        "its pole-pass frequency is 2 Hz."
    )


def test_sidebands_are_said_with_their_share_and_with_what_they_speak_for() -> None:
    sides = (line(SHAFT_SIDES, 22.5, 0.1, side="below"), line(SHAFT_SIDES, 26.5, 0.12, side="above"))
    one = order(1.0, 2.0, lock="locked", cause="unbalance")
    (text,) = [text for text in motor_sentences(findings(*sides, orders=(one,))) if "Beside" in text]
    assert "22.50 Hz and 26.50 Hz are its pole-pass sidebands" in text and "6.0 % of it" in text and "rotor bar" in text


def test_a_line_at_one_speed_leads_with_its_frequency() -> None:
    loose = order(5.492, 1.0, lock="slips", cause="unexplained")
    said = findings(orders=(loose,))
    assert strongest_sentence(said, "Z").startswith("A line at 134.55 Hz (order 5.492) is the strongest line in Z: 1")
    (text,) = lock_sentences(said)
    assert text.startswith("134.55 Hz (order 5.492") and text.endswith("nothing tells whether it follows the shaft.")


def test_mains_among_the_orders_are_told_as_mains_and_as_nothing_else() -> None:
    said = findings(orders=(order(4.0816, 1.0, lock="slips", cause="twice mains"),))
    del said["motor"]
    assert "99.999 Hz" not in str(lock_sentences(said)) and lock_sentences(said) == [] and law_sentences(said) == []
    assert tone_sentences(said)[0].startswith("A tone, no natural frequency: 100.00 Hz (twice mains, 1")
