"""Every shipped scene through the whole analysis: what it put in is found, what it made faulty is told."""

import json

import pytest

from crankorder.settings import shipped
from crankorder.synth.load import load_scene
from crankorder.synth.write import truth_of
from made.command import crankorder, done
from made.contradictions import contradictions

LONG = {"thesis-second-motoring", "thesis-literal-fourfold", "run-up", "bearing-growth"}
"""Scenes that take more than some seconds; the first is analysed in tests/batch too."""


class Analysed:
    """A scene's first look, its truth, and what the analysis says of it."""

    def __init__(self, name, folder):
        self.said, self.status, self.folder = [], [], folder / name
        done("synth", name, "--out", folder / name, "--quick", "-q")
        tests = sorted((folder / name).glob("run_*")) or [folder / name]
        self.truths, self.findings = [], []
        for number, test in enumerate(tests):
            outcome = crankorder("run", test, "--out", folder / f"out-{number}")
            self.said.append(outcome.output)
            self.status.append(outcome.exit_code)
            self.truths.append(json.loads((test / "truth.json").read_bytes()))
            self.findings += [
                json.loads(found.read_bytes()) for found in (folder / f"out-{number}").glob("*/findings.json")
            ]
            assert not [words for findings in self.findings for words in contradictions(findings)]

    def line(self, channel, order):
        """What was put in and what was found at an order."""
        found = [
            record
            for record in self.findings[0]["orders"]
            if record["channel"] == channel and abs(record["order"] - order) < 0.02
        ]
        put_in = [r for r in self.truths[0]["orders"] if r["channel"] == channel and r["order"] == order]
        assert found, self.said
        return put_in[0], found[0]

    def holds(self, channel, order):
        """Whether the interval of an order's amplitude holds what was put in."""
        put_in, found = self.line(channel, order)
        low, high = found["amplitude_ci95"]
        return bool(low < put_in["amplitude"] < high)

    def flags(self, recording):
        """Flags of one recording."""
        return {flag["flag"] for flag in self.findings[0]["quality"] if flag["recording"] == recording}


@pytest.fixture(scope="module")
def analysed(tmp_path_factory):
    """First looks by name, each made once."""
    made: dict[str, Analysed] = {}

    def analysis(name):
        if name not in made:
            made[name] = Analysed(name, tmp_path_factory.mktemp(name))
        return made[name]

    return analysis


def test_firing_shows_half_orders_an_order_of_magnitude_above_motoring(analysed):
    scene = analysed("thesis-second-firing")
    assert scene.status == [0]
    for order in (1.5, 2.0, 2.5, 3.0, 3.5, 4.5):
        put_in, found = scene.line("Z", order)
        # scatter from cycle to cycle adds to the interval what a handful of cycles leaves of it
        assert found["amplitude"] == pytest.approx(put_in["amplitude"], rel=0.05)
        turn = (found["phase_deg"] - put_in["phase_deg"]) % (put_in["phase_ambiguity_deg"] or 360)
        assert min(turn, abs(turn - (put_in["phase_ambiguity_deg"] or 360))) < 5
    motoring = truth_of(load_scene("thesis-second-motoring").first_look())
    largest = {r["order"]: r["amplitude"] for r in motoring["orders"] if r["channel"] == "Z"}
    assert scene.line("Z", 2.0)[0]["amplitude"] > 5 * largest[2.0]


def test_a_run_up_shows_its_orders_and_natural_frequencies(analysed):
    scene = analysed("run-up")
    assert scene.status == [0]
    orders = {round(record["order"], 1) for record in scene.findings[0]["orders"] if record["channel"] == "Z"}
    assert {2.0, 4.0} <= orders
    assert {2.7} <= {round(record["order"], 1) for record in scene.findings[0]["orders"] if record["channel"] == "X"}


def test_every_run_of_a_growing_damage_is_a_test_of_its_own_and_names_the_race(analysed):
    scene = analysed("bearing-growth")
    assert scene.status == [0, 0]
    assert [found["test"] for found in scene.findings] == ["bearing growth, run 1", "bearing growth, run 2"]
    sizes = [truth["bearings"][0]["amplitude"] for truth in scene.truths]
    assert sizes[1] == pytest.approx(1.5 * sizes[0])
    for truth, findings in zip(scene.truths, scene.findings, strict=True):
        told = [
            record for record in findings["bearings"] if record["line"] == "BPFO" and record["name"] == "jack shaft"
        ]
        assert told and {record["lock"] for record in told} == {"slips"}
        low, high = told[0]["order_ci95"]
        assert low < truth["bearings"][0]["order"] < high


def test_a_damaged_line_costs_nothing_of_order_5_5(analysed):
    scene = analysed("hard-damaged-line")
    assert scene.holds("X", 5.5)
    assert "encoder_damaged_line" in scene.flags("rpm_1000.h5")
    lost = next(r for r in scene.truths[0]["quality"] if r["flag"] == "encoder_double_pulse")
    assert f"{lost['count']} false pulses" in json.dumps(scene.findings[0]["quality"])


@pytest.mark.slow
def test_every_fault_of_a_signal_is_told_and_takes_no_other_recording_along(analysed):
    scene = analysed("hard-faulty-signals")
    assert scene.status == [0]
    assert "rpm_1200.h5: channel Y left out of all averages: iepe_overload" in scene.said[0]
    told = {"rpm_1000.h5": "clipped", "rpm_1400.h5": "gap", "rpm_1600.h5": "spikes", "rpm_1800.h5": "dropout"}
    assert all(flag in scene.flags(recording) for recording, flag in told.items())
    put_in, found = scene.line("X", 5.5)
    assert found["amplitude"] == pytest.approx(put_in["amplitude"], rel=0.1)
    told = {(record["recording"], record["flag"]) for record in scene.truths[0]["quality"]}
    assert {"rpm_1000.h5", "rpm_1200.h5", "rpm_1400.h5", "rpm_1600.h5", "rpm_1800.h5", "rpm_2000.h5"} == {
        recording for recording, _ in told
    }


@pytest.mark.slow
def test_what_folds_is_where_the_truth_of_folding_says(analysed):
    scene = analysed("hard-folding")
    assert "lines_may_fold" in {flag["flag"] for flag in scene.findings[0]["quality"]}
    put_in = next(r for r in scene.truths[0]["orders"] if r["order"] == 353.5 and r["channel"] == "X")
    folded = [r for r in scene.findings[0]["orders"] if abs(r["order"] - 6.5) < 0.02 and r["channel"] == "X"]
    low, high = folded[0]["amplitude_ci95"]
    assert low < put_in["amplitude"] < high


@pytest.mark.slow
def test_volts_of_a_late_fast_and_filtered_chain_come_back_as_acceleration(analysed):
    scene = analysed("hard-acquisition")
    assert scene.status == [0]
    assert all(scene.holds(channel, 5.5) for channel in "XYZ")


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(shipped("scenes")) - LONG))
def test_every_scene_is_analysed_or_refused_with_a_reason(analysed, name):
    scene = analysed(name)
    assert set(scene.status) <= {0, 3, 4}
    assert all("internal fault" not in said for said in scene.said)
    assert all(said.count("\n") >= 1 for said in scene.said)
