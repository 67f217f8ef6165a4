"""Statements that exclude each other are told, every kind of them, and sound findings give none."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from crankorder.report.contradictions import contradiction_flags, contradictions
from made.typed import from_dicts

contradiction_flags, contradictions = map(
    from_dicts,
    (contradiction_flags, contradictions),
)

Findings = dict[str, Any]


def _order(findings: Findings, order: float) -> dict[str, Any]:
    return next(record for record in findings["orders"] if record["order"] == order)


def _slips_on_a_multiple(findings: Findings) -> None:
    _order(findings, 5.5).update(lock="slips", order=5.5, order_ci95=[5.4996, 5.5004], revs_to_decide=None)


def _locked_off_every_multiple(findings: Findings) -> None:
    _order(findings, 2.0).update(lock="locked", order=2.0, order_ci95=[2.001, 2.003])


def _both_in_one_evidence(findings: Findings) -> None:
    _order(findings, 2.0).update(lock="locked", evidence="locked to the shaft; 20 dB; not locked to the shaft")


def _decided_and_more_would_decide(findings: Findings) -> None:
    _order(findings, 2.0)["revs_to_decide"] = 32.0


def _grows_downwards(findings: Findings) -> None:
    _order(findings, 1.0).update(speed_law="grows with speed^n", speed_exponent=-1.6, speed_exponent_ci95=[-2.0, -1.2])


def _outside_its_interval(findings: Findings) -> None:
    _order(findings, 1.0).update(amplitude=2505.0, amplitude_ci95=[0.0, 2404.0])


def _largest_where_it_was_not_seen(findings: Findings) -> None:
    _order(findings, 1.0).update(speed_rpm_at_max=9000.0)


def _a_mode_and_undecided(findings: Findings) -> None:
    findings["modes"][0].update(explained_by="mode", undecided="at one speed its modulation looks the same")


def _unreached_and_excited(findings: Findings) -> None:
    record = next(one for one in findings["crossings"] if one["excited"] and one["in_range"])
    mode = next(one for one in findings["modes"] if one["frequency_hz"] == record["mode_hz"])
    mode["reached_by_orders"] = []


def _a_mode_and_mains(findings: Findings) -> None:
    mode = findings["modes"][0]
    mode["explained_by"] = "mode"
    findings["modes"].append({**mode, "damping_ratio": None, "explained_by": "mains"})


def _excited_with_another_verdict(findings: Findings) -> None:
    findings["crossings"][0].update(verdict="not excited", excited=True)


def _crossing_far_outside(findings: Findings) -> None:
    findings["speed_range_rpm"] = [300.0, 2000.0]
    findings["crossings"][0].update(in_range=True, rpm=50.0, rpm_ci95=[49.0, 51.0])


def _excited_and_no_such_mode(findings: Findings) -> None:
    findings["crossings"][0].update(excited=True, verdict="excited", mode_hz=17.0)


def _free_and_to_avoid(findings: Findings) -> None:
    low, high = findings["speeds_to_avoid"][0]["rpm_range"]
    findings["free_bands"] = [{"low_rpm": low - 20.0, "high_rpm": high + 20.0, "remark": ""}]


def _free_and_open(findings: Findings) -> None:
    findings["free_bands"] = [{"low_rpm": 400.0, "high_rpm": 420.0, "remark": ""}]
    findings["open_bands"] = [{"low_rpm": 410.0, "high_rpm": 430.0, "remark": "not tested between"}]


def _struck_and_no_alarm(findings: Findings) -> None:
    record = dict(findings["bearings"][0])
    findings["bearings"] = [
        {**record, "verdict": "Damage of the outer race.", "seen_in": "envelope"},
        {**record, "verdict": "Neither of its races was found: no bearing alarm."},
    ]


def _a_doubt_that_names_no_tone(findings: Findings) -> None:
    mode = findings["modes"][0]
    mode.update(explained_by="undecided", undecided="no order passes it")
    findings["modes"].append({**mode, "damping_ratio": None, "undecided": "", "explained_by": "tone"})


def _two_mains(findings: Findings) -> None:
    lines = [_order(findings, order) for order in (1.0, 2.0)]
    for record, hertz in zip(lines, (49.94, 50.0), strict=True):
        order = 60.0 * hertz / 1500.0
        record.update(explained_by="mains", speed_rpm_at_max=1500.0, lock="slips", order=order, revs_to_decide=None)
        record.update(order_ci95=[order - 1e-6, order + 1e-6])


def _a_slip_by_a_wrong_speed(findings: Findings) -> None:
    words = "a shaft at 0.99 times the stated speed, this one if that is wrong"
    _order(findings, 2.0).update(explained_by=words)
    findings["motor"] = {"speeds": [{"slip": 0.01, "speed_rpm": 1485.0}]}


def _another_gain_that_takes_part(findings: Findings) -> None:
    findings["quality"].append({"recording": "a.h5", "flag": "level_jump", "severity": "suspect", "channel": "Y"})


def _two_amplifications(findings: Findings) -> None:
    avoid = findings["speeds_to_avoid"][0]
    for record in findings["crossings"]:
        if (record["order"], record["mode_hz"]) == (avoid["order"], avoid["mode_hz"]):
            record.update(amplification=9.3, amplification_ci95=[8.0, 10.0])


def _a_crossing_of_the_mains(findings: Findings) -> None:
    _order(findings, findings["crossings"][0]["order"])["explained_by"] = "twice mains"


MADE: dict[Callable[[Findings], None], str] = {
    _slips_on_a_multiple: "slips, and its interval holds 5.5",
    _locked_off_every_multiple: "holds no multiple",
    _both_in_one_evidence: "locked and not locked",
    _decided_and_more_would_decide: "more revolutions would decide",
    _grows_downwards: "grows with the speed, with an exponent of -1.6",
    _outside_its_interval: "amplitude 2505 lies outside its interval",
    _largest_where_it_was_not_seen: "speed_rpm_at_max 9000 lies outside speed_range_rpm",
    _a_mode_and_undecided: "a natural frequency, and not decided",
    _unreached_and_excited: "no order reaches it, and a crossing there is excited",
    _a_mode_and_mains: "a natural frequency, and mains at",
    _excited_with_another_verdict: "verdict 'not excited', and excited is True",
    _crossing_far_outside: "in the tested range, and at 50 rpm",
    _excited_and_no_such_mode: "no such natural frequency is listed",
    _free_and_to_avoid: "to be avoided",
    _free_and_open: "not known",
    _two_amplifications: "amplified 9.3 times, and 12 times where it is to be avoided",
    _a_crossing_of_the_mains: "a line of fixed frequency moves with the speed",
    _a_doubt_that_names_no_tone: "may be a natural frequency, and tone at",
    _two_mains: "mains at 49.94 Hz and at 50 Hz: a supply has one frequency",
    _a_slip_by_a_wrong_speed: "slip is told",
    _another_gain_that_takes_part: "its gain was changed, and it took part",
    _struck_and_no_alarm: "no bearing alarm, and another line of it is called damage",
}


def test_sound_findings_contradict_nothing(full: Findings, campaign: Any) -> None:
    assert contradictions(full) == ()
    assert contradictions(campaign.findings) == ()
    assert contradictions({"orders": [], "modes": [], "crossings": []}) == ()


@pytest.mark.parametrize("make", MADE, ids=lambda make: make.__name__.strip("_"))
def test_each_contradiction_is_told(full: Findings, make: Callable[[Findings], None]) -> None:
    make(full)
    told = contradictions(full)
    assert any(MADE[make] in words for words in told), told
    flags = contradiction_flags(json.loads(json.dumps(full)))
    assert {flag.flag for flag in flags} == {"contradiction"} and len(flags) == len(told)


def test_a_crossing_that_is_seen_but_hardly_felt_may_lie_in_a_free_band() -> None:
    crossing: Findings = {"order": 2.0, "mode_hz": 13.67, "excited": True, "rpm": 410.0, "in_range": True}
    crossing |= {"verdict": "excited", "amplification": 1.2, "amplification_ci95": [0.9, 1.6]}
    band = {"low_rpm": 400.0, "high_rpm": 420.0, "remark": ""}
    findings = {"free_bands": [band], "crossings": [crossing]}
    assert not [words for words in contradictions(findings) if "free" in words]
    crossing["amplification_ci95"] = [0.9, 2.6]
    assert [words for words in contradictions(findings) if "free" in words]
