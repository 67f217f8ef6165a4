"""Findings of made tests whose truth is analytic."""

import numpy as np

from crankorder.campbell.frames import frequency_frames
from crankorder.campbell.map import campbell_map
from crankorder.findings import Findings, FreeBand, OpenBand
from crankorder.identify.findings import IN_DOUBT, Measured, find, speed_doubt, undecided_orders, without_free
from crankorder.identify.found import SpeedVerdicts
from crankorder.identify.machine_model import MachineModel
from crankorder.orders.frames import order_frames
from crankorder.orders.map import order_map
from crankorder.report.sentences.story import headline, story_of
from made.command import analysed
from made.found_lines import agreed
from made.recordings import line, steady, total, write_hdf5, write_manifest
from made.shipped import SETTINGS
from made.typed import as_dicts

find = as_dicts(find)


def findings_of(signal, *, duration_s):
    """Findings of one recording at 1500 rpm of ``signal`` and white noise."""
    recording = steady([signal], speed_rpm=1500.0, duration_s=duration_s, rate_hz=2000.0)
    recording[0]["signal"].values[:] += 0.05 * np.random.default_rng(0).standard_normal(round(duration_s * 2000.0))
    frames = [order_frames(*recording, settings=SETTINGS.orders)]
    campbell = campbell_map([frequency_frames(*recording, settings=SETTINGS.campbell)], speed_bin_rpm=25.0)
    measured = Measured(order_map(frames, settings=SETTINGS.orders), campbell, frames)
    return find(measured, test="made", sources=MachineModel(revs_per_cycle=2), settings=SETTINGS)


def test_one_speed_and_one_channel_are_enough_to_name_orders():
    made = findings_of(line(2.0, 1.0), duration_s=12.0)
    assert [round(record["order"], 2) for record in made["orders"]] == [2.0]
    assert made["orders"][0]["speed_exponent"] is None


def test_a_line_in_too_short_a_test_is_named_with_its_reservation():
    made = findings_of(total(line(2.0, 3.0), line(0.5, 1.0)), duration_s=0.75)
    assert [round(record["order"], 2) for record in made["orders"]] == [0.5, 2.0]
    assert all("too few revolutions" in record["evidence"] for record in made["orders"])


# A speed that the vibration tells only in doubt carries no sentence that is sure of it.


def test_nothing_is_locked_slips_or_is_free_by_a_doubtful_speed():
    tie = {"recording": "a.h5", "flag": "speed_tie", "severity": "suspect", "detail": "0.5 x fits nearly as well"}
    assert speed_doubt([]) is None and speed_doubt([{**tie, "flag": "no_index"}]) is None
    assert speed_doubt([tie, {**tie, "recording": "b.h5"}]) == "0.5 x fits nearly as well (a.h5 and 1 more)"
    orders = undecided_orders((agreed(2.0), agreed(3.41, lock="slips")))
    assert [one.lock for one in orders] == ["undecided", "undecided"]
    assert all(IN_DOUBT in [doubt.words for doubt in one.doubts] for one in orders)
    free, rest = FreeBand(low_rpm=500, high_rpm=900), OpenBand(low_rpm=900, high_rpm=950, remark="open")
    verdicts = without_free(SpeedVerdicts((), (free,), (rest,)))
    assert verdicts.free == () and verdicts.open == (OpenBand(low_rpm=500, high_rpm=900, remark=IN_DOUBT), rest)


def test_even_orders_alone_leave_the_speed_open_and_the_page_says_so(tmp_path):
    rng, at = np.random.default_rng(3), np.arange(4 * 4096) / 4096.0
    signal = sum(size * np.cos(2 * np.pi * k * 25.0 * at + k) for k, size in ((2.0, 1.0), (4.0, 0.6), (6.0, 0.4)))
    signal = signal + 3.0 * np.cos(2 * np.pi * 73.3 * at) + 0.5 * rng.standard_normal(at.size)
    tables = {"channels": {"Z": {"source": "z"}}, "sampling": {"rate_hz": 4096}, "encoder": {"kind": "vibration"}}
    write_hdf5(write_manifest(tmp_path / "in", "*.h5", **tables) / "a.h5", {"z": signal})
    findings = analysed(tmp_path / "in", tmp_path / "out")
    assert findings["speed_doubt"] and not findings["free_bands"]
    assert {record["lock"] for record in findings["orders"]} <= {"undecided"}
    typed = Findings.from_dict(findings)
    said = [*headline(typed), *(one for part in story_of(typed).values() for one in part)]
    assert "is in doubt" in said[0]
    for sure in ("does not follow the shaft", "Balance it", "Free of resonances", " slips", "Cause: "):
        assert not any(sure in one for one in said), sure
