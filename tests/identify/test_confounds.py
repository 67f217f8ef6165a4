"""Whatever else than the machine differs is named, with what it does to the comparison."""

import copy
from dataclasses import replace

import pytest

from crankorder.identify.compared import compared, confounds
from made.two_tests import made_test, stated

LINES = {1.0: lambda rpm: 0.5}


@pytest.fixture(scope="module")
def base():
    return made_test(LINES, name="base", seed=1, channels=("A", "B"), duration_s=8.0)


def differing(path, value):
    """What run.json states of a test, with another value at ``path``."""
    run = copy.deepcopy(stated("other", ("A", "B")))
    at = run
    *keys, last = path
    for key in keys:
        at = at[key]
    at[last] = value
    return run


CLIPPED = {"recording": "a", "flag": "clipped", "severity": "suspect", "detail": ""}
DIFFERENCES = [
    (("manifest", "sampling", "domain"), "crank_angle", "sampling domain", "weakens"),
    (("manifest", "sampling", "rate_hz"), 2000.0, "sampling rate", "weakens"),
    (("manifest", "encoder", "kind"), "pulse_times", "encoder kind", "weakens"),
    (("manifest", "test", "engine"), "task5", "engine", "harmless"),
    (("settings", "orders", "revs_per_frame"), 8, "revolutions per frame", "weakens"),
    (("settings", "campbell", "resolution_hz"), 1.0, "map resolution", "weakens"),
    (("settings", "campbell", "window"), "flat-top", "map window", "weakens"),
    (("settings", "campbell", "max_frequency_hz"), 200.0, "highest frequency", "harmless"),
    (("settings", "orders", "tolerance"), 1e-3, "tolerance", "harmless"),
    (("manifest", "channels", 1, "unit"), "g", "unit", "invalid"),
    (("manifest", "channels", 1, "sensitivity"), "100 mV/g", "sensitivity", "weakens"),
    (("manifest", "channels", 1, "direction"), "-Z", "direction", "weakens"),
    (("code_sha256",), "1" * 64, "program", "weakens"), (("versions", "numpy"), "1.0", "library numpy", "harmless"),
    (("test",), "firing", "firing or motoring", "weakens"), (("quality",), [CLIPPED], "quality: clipped", "weakens"),
]  # fmt: skip
"""Where in run.json two tests differ, the value there, what is named, and how much it matters."""


def test_every_difference_of_how_the_tests_were_made_is_named_and_no_other(base):
    one, wrong = replace(base, run=stated("motoring", ("A", "B"))), []
    alike = confounds(one, replace(base, run=stated("other", ("A", "B"))))
    assert [(c.what, c.severity) for c in alike] == [("repeats", "weakens")]
    for path, value, what, severity in DIFFERENCES:
        found = {c.what: c for c in confounds(one, replace(base, run=differing(path, value)))}
        named = what in found and found[what].severity == severity and found[what].words is not None
        if not named or set(found) - {what, "repeats"}:
            wrong.append((what, {name: c.severity for name, c in found.items()}))
    assert wrong == []


def test_a_channel_in_another_unit_is_refused_and_the_others_are_compared(base):
    run = differing(("manifest", "channels", 1, "unit"), "g")
    other = made_test(LINES, name="other", seed=2, channels=("A", "B"), duration_s=8.0, run=run)
    document = compared([base, other], q=0.05).document
    assert {c.name: c.compared for c in document.channels} == {"A": True, "B": False}
    assert {record.channel for record in document.orders} == {"A"}


def test_where_the_mark_may_have_moved_amplitudes_alone_are_compared(base):
    turned = {1.0: lambda rpm: 0.5j}
    moved = differing(("manifest", "encoder", "index_to_tdc_deg"), 90.0)
    same, other = (
        made_test(turned, name="turned", seed=3, channels=("A", "B"), duration_s=8.0, run=run) for run in (None, moved)
    )
    found = [compared([base, test], q=0.05).document.cause.orders for test in (same, other)]
    assert found == [(1.0,), ()]


def test_speeds_of_one_test_only_are_left_out_and_named():
    one = made_test(LINES, name="one", speeds=(900.0, 1200.0), duration_s=8.0)
    two = made_test(LINES, name="two", speeds=(1205.0, 1800.0), duration_s=8.0)
    document = compared([one, two], q=0.05).document
    assert [(round(s.base_rpm), round(s.new_rpm)) for s in document.speeds] == [(1200, 1205)]
    assert any(c.what == "speeds" and c.severity == "weakens" for c in document.confounds)
    slow = replace(one, maps={"order_map": one.maps["order_map"].isel(speed=[0])})
    fast = replace(two, maps={"order_map": two.maps["order_map"].isel(speed=[1])})
    assert compared([slow, fast], q=0.05).document.cause.cause == "not comparable"
