"""Findings are types: JSON goes in and out of them unchanged, and a wrong file is refused by file, place and value."""

import copy

import jsonschema
import pytest

from crankorder.errors import InputError
from crankorder.findings import Findings, LineFinding, Motor
from crankorder.quantities import schema_of


def test_findings_go_to_json_and_back_with_later_keys_passed_over_and_those_of_an_older_version_empty(full, campaign):
    findings, old = Findings.from_dict(full), Findings.from_dict(campaign.findings)
    assert Findings.from_dict(findings.as_dict() | {"later": {"a": 1}}) == findings
    assert findings.orders[0].amplitude == full["orders"][0]["amplitude"]
    assert (old.free_bands, old.motor) == ((), None)


def test_a_key_that_python_keeps_for_itself_has_another_name_in_the_type():
    line = {
        "name": "n", "side": "", "channel": "Z", "frequency_hz": 50.0, "order": 2.0, "speed_rpm": 1500.0,
        "amplitude": 1.0, "amplitude_ci95": [0.5, 1.5], "or": ["mains"], "n_recordings": 1,
    }  # fmt: skip
    motor = {
        "supply_hz": 50.0, "supply_hz_ci95": None, "supply_measured": False, "poles": 4, "rotor_bars": None,
        "misfit": "", "speeds": [], "lines": [line],
    }  # fmt: skip
    assert Motor.from_dict(motor).lines[0].others == ("mains",)
    assert Motor.from_dict(motor).as_dict() == motor


def test_what_a_record_leaves_out_has_no_key():
    line = LineFinding(
        channel="Z", frequency_hz=50.0, frequency_hz_ci95=(49.9, None), explained_by=None, amplitude=None
    )
    assert line.as_dict() == {
        "channel": "Z", "frequency_hz": 50.0, "frequency_hz_ci95": [49.9, None], "explained_by": None,
        "amplitude": None, "causes": [],
    }  # fmt: skip


def test_findings_that_nobody_asked_for_leave_out_what_was_not_sought(campaign):
    document = campaign.findings | {table: [] for table in ("orders", "modes", "crossings", "bearings", "lines")}
    document |= {"balance": None, "balance_reason": "maps only", "not_asked_for": "maps only"}
    assert "free_bands" in Findings.from_dict(campaign.findings).as_dict()
    assert "free_bands" not in Findings.from_dict(document).as_dict()


WRONG = (
    ("orders", "amplitude", "much", "orders[0].amplitude: .*found much; allowed: a number ≥ 0"),
    ("orders", "amplitude", -1.0, "orders[0].amplitude: .*found -1.0; allowed: a number ≥ 0"),
    ("orders", "order", True, "orders[0].order: .*allowed: a number > 0"),
    ("orders", "lock", "perhaps", "orders[0].lock: .*allowed: locked, slips, undecided or null"),
    ("orders", "amplitude_ci95", [1.0], "orders[0].amplitude_ci95: .*allowed: a list of 2 or null"),
    ("modes", "channels", "X", "modes[0].channels: .*allowed: a list"),
    ("quality", "severity", None, "quality[0].severity: .*allowed: info, suspect, bad"),
    ("orders", "unit", ..., "orders[0].unit: is missing; allowed: unit of amplitude"),
)


def test_a_wrong_value_is_refused_by_file_place_and_what_is_allowed(campaign):
    for table, key, value, told in WRONG:
        wrong = copy.deepcopy(campaign.findings)
        wrong[table][0][key] = value
        if value is ...:
            del wrong[table][0][key]
        with pytest.raises(InputError, match="old.json: " + told.replace("[", r"\[", 1).replace("]", r"\]", 1)):
            Findings.from_dict(wrong, file="old.json")


# The schemas of findings.json and run.json take what design.md names and refuse what it forbids.


def _faults(document, schema):
    return [error.message for error in jsonschema.Draft202012Validator(schema_of(schema)).iter_errors(document)]


RUN = {
    "schema_version": 1, "test": "t", "versions": {"crankorder": "0.1.0"}, "quality": [],
    "inputs": [{"name": "rpm_0300.h5", "sha256": "0" * 64, "bytes": 12}], "settings": {"report": {"dpi": 130}},
}  # fmt: skip
OPEN = {"low_rpm": 900.0, "high_rpm": 1200.0, "remark": "not tested between"}


def test_what_identification_may_give_is_accepted_and_what_the_design_forbids_is_refused(full, campaign):
    plain, order = campaign.findings, full["orders"][0]
    for table, key in (("orders", "amplitude_ci95"), ("modes", "evidence"), ("lines", "explained_by")):
        lacking = [{name: value for name, value in record.items() if name != key} for record in plain[table]]
        assert any(key in fault for fault in _faults(plain | {table: lacking}, "findings"))
    for taken in (
        plain, full, plain | {"orders": [{**plain["orders"][0], "locked": True}], "later": {}},
        full | {"open_bands": [OPEN]}, plain | {"balance": None, "balance_reason": "no engine named"},
    ):  # fmt: skip
        assert _faults(taken, "findings") == []
    for wrong in (
        {"free_bands": [{"low_rpm": 300.0}]}, {"orders": [{**order, "lock": "perhaps"}]},
        {"energy": {"channels": [{"channel": "X", "orders": 1.5}]}}, {"balance": None, "balance_reason": None},
        {"lines": [{"channel": "X", "explained_by": None, "amplitude": 1.0}]},  # neither frequency nor order
        {"orders": [{**order, "amplitude_ci95": [1.0]}]},
        *({"open_bands": [{name: OPEN[name] for name in OPEN if name != key}]} for key in OPEN),  # open for no reason
    ):  # fmt: skip
        assert _faults(full | wrong, "findings") != []
    assert _faults(RUN, "run") == []
    assert _faults({**RUN, "inputs": [{"name": "a", "sha256": "12"}]}, "run") != []
    assert _faults({key: value for key, value in RUN.items() if key != "versions"}, "run") != []
