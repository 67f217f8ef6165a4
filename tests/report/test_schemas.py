"""The schemas of findings.json and run.json take what design.md names and refuse what it forbids."""

from __future__ import annotations

import copy
from typing import Any

import jsonschema
import pytest

from crankorder.quantities import schema_of


@pytest.fixture
def run() -> dict[str, Any]:
    return {
        "schema_version": 1,
        "test": "t",
        "inputs": [{"name": "rpm_0300.h5", "sha256": "0" * 64, "bytes": 12}],
        "versions": {"crankorder": "0.1.0"},
        "settings": {"report": {"dpi": 130}},
        "quality": [],
    }


def _faults(document: Any, schema: str) -> list[str]:
    return [error.message for error in jsonschema.Draft202012Validator(schema_of(schema)).iter_errors(document)]


def test_the_findings_of_the_design_are_accepted_and_so_are_more_keys(campaign: Any) -> None:
    assert _faults(campaign.findings, "findings") == []
    more = copy.deepcopy(campaign.findings)
    more["orders"][0]["locked"] = True
    more["later"] = {}
    assert _faults(more, "findings") == []


def test_everything_that_identification_may_give_is_accepted_and_wrong_values_are_refused(full: Any) -> None:
    assert _faults(full, "findings") == []
    assert _faults({**full, "free_bands": [{"low_rpm": 300.0}]}, "findings") != []
    still_open = {"low_rpm": 900.0, "high_rpm": 1200.0, "remark": "not tested between"}
    assert _faults({**full, "open_bands": [still_open]}, "findings") == []
    for key in still_open:  # a speed is never open without the reason
        lacking = {name: value for name, value in still_open.items() if name != key}
        assert any(key in fault for fault in _faults({**full, "open_bands": [lacking]}, "findings"))
    assert _faults({**full, "orders": [{**full["orders"][0], "lock": "perhaps"}]}, "findings") != []
    assert _faults({**full, "energy": {"channels": [{"channel": "X", "orders": 1.5}]}}, "findings") != []


NEEDED = (
    ("orders", "amplitude_ci95"),
    ("orders", "explained_by"),
    ("modes", "frequency_hz_ci95"),
    ("modes", "evidence"),
    ("crossings", "excited"),
    ("bearings", "order_expected"),
    ("lines", "explained_by"),
    ("quality", "severity"),
)


def test_a_record_without_a_key_of_the_design_is_refused(campaign: Any) -> None:
    taken = []
    for table, key in NEEDED:
        lacking = copy.deepcopy(campaign.findings)
        del lacking[table][0][key]
        if not any(key in fault for fault in _faults(lacking, "findings")):
            taken.append((table, key))
    assert taken == []


def test_no_balance_needs_a_reason(campaign: Any) -> None:
    assert _faults({**campaign.findings, "balance": None}, "findings") != []
    assert _faults({**campaign.findings, "balance": None, "balance_reason": "no engine named"}, "findings") == []


def test_a_line_has_a_frequency_or_an_order_and_an_interval_has_two_ends(campaign: Any) -> None:
    homeless = {**campaign.findings, "lines": [{"channel": "X", "explained_by": None, "amplitude": 1.0}]}
    assert _faults(homeless, "findings") != []
    lopsided = copy.deepcopy(campaign.findings)
    lopsided["orders"][0]["amplitude_ci95"] = [1.0]
    assert _faults(lopsided, "findings") != []


def test_a_run_names_its_inputs_by_hash(run: dict[str, Any]) -> None:
    assert _faults(run, "run") == []
    assert _faults({**run, "inputs": [{"name": "a", "sha256": "12"}]}, "run") != []
    assert _faults({key: value for key, value in run.items() if key != "versions"}, "run") != []
