"""Every shipped scene through the whole analysis: what it put in is found, what it made faulty is told."""

import json

import pytest

from crankorder.settings import shipped
from crankorder.synth.load import load_scene
from crankorder.synth.write import truth_of
from made.command import crankorder, done
from made.contradictions import contradictions

ELSEWHERE = {"thesis-second-motoring", "thesis-literal-fourfold"}
"""The campaign of 35 speeds of the source, which tests/truth analyses, and its variant."""


def line(truth, findings, channel, order, *, folded_to=None):
    """What was put in and what was found at an order."""
    at = order if folded_to is None else folded_to
    (put_in,) = [r for r in truth["orders"] if (r["channel"], r["order"]) == (channel, order)]
    found = [r for r in findings["orders"] if r["channel"] == channel and abs(r["order"] - at) < 0.02]
    assert found, f"order {at} in {channel} is not found"
    return put_in, found[0]


def holds(*asked, **folded):
    """Whether the interval of an order's amplitude holds what was put in."""
    put_in, found = line(*asked, **folded)
    return found["amplitude_ci95"][0] < put_in["amplitude"] < found["amplitude_ci95"][1]


def flags(findings, recording):
    return {flag["flag"] for flag in findings["quality"] if flag["recording"] == recording}


def firing(truth, findings):
    """Half orders an order of magnitude above motoring."""
    for order in (1.5, 2.0, 2.5, 3.0, 3.5, 4.5):
        put_in, found = line(truth, findings, "Z", order)
        # scatter from cycle to cycle adds to the interval what a handful of cycles leaves of it
        assert found["amplitude"] == pytest.approx(put_in["amplitude"], rel=0.05)
        turn = (found["phase_deg"] - put_in["phase_deg"]) % (put_in["phase_ambiguity_deg"] or 360)
        assert min(turn, abs(turn - (put_in["phase_ambiguity_deg"] or 360))) < 5
    motoring = truth_of(load_scene("thesis-second-motoring").first_look())
    (second,) = [r["amplitude"] for r in motoring["orders"] if (r["channel"], r["order"]) == ("Z", 2.0)]
    assert line(truth, findings, "Z", 2.0)[0]["amplitude"] > 5 * second


def run_up(_, findings):
    found = {(record["channel"], round(record["order"], 1)) for record in findings["orders"]}
    assert {("Z", 2.0), ("Z", 4.0), ("X", 2.7)} <= found


def growing_damage(truth, findings):
    told = [one for one in findings["bearings"] if (one["line"], one["name"]) == ("BPFO", "jack shaft")]
    assert told and {record["lock"] for record in told} == {"slips"}
    low, high = told[0]["order_ci95"]
    assert low < truth["bearings"][0]["order"] < high


def damaged_line(truth, findings):
    """It costs nothing of order 5.5."""
    assert holds(truth, findings, "X", 5.5)
    assert "encoder_damaged_line" in flags(findings, "rpm_1000.h5")
    lost = next(record for record in truth["quality"] if record["flag"] == "encoder_double_pulse")
    assert f"{lost['count']} false pulses" in json.dumps(findings["quality"])


def faulty_signals(truth, findings):
    """Every fault is told and takes no other recording along."""
    told = {1000: "clipped", 1200: "iepe_overload", 1400: "gap", 1600: "spikes", 1800: "dropout"}
    assert all(flag in flags(findings, f"rpm_{rpm}.h5") for rpm, flag in told.items())
    put_in, found = line(truth, findings, "X", 5.5)
    assert found["amplitude"] == pytest.approx(put_in["amplitude"], rel=0.1)


def folding(truth, findings):
    """What folds is where the truth of folding says."""
    assert "lines_may_fold" in {flag["flag"] for flag in findings["quality"]}
    assert holds(truth, findings, "X", 353.5, folded_to=6.5)


def acquisition(truth, findings):
    """Volts of a late, fast and filtered chain come back as acceleration."""
    assert all(holds(truth, findings, channel, 5.5) for channel in "XYZ")


FACTS = {
    "thesis-second-firing": firing, "run-up": run_up, "bearing-growth": growing_damage,
    "hard-damaged-line": damaged_line, "hard-faulty-signals": faulty_signals, "hard-folding": folding,
    "hard-acquisition": acquisition,
}  # fmt: skip
SCENES = sorted(set(shipped("scenes")) - ELSEWHERE, key=lambda name: name != "hard-damaged-line")


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", SCENES)
def test_every_scene_is_analysed_or_refused_with_a_reason_and_what_was_put_in_is_told(name, tmp_path):
    done("synth", name, "--out", tmp_path / "scene", "--quick", "-q")
    for number, test in enumerate(sorted((tmp_path / "scene").glob("run_*")) or [tmp_path / "scene"]):
        outcome = crankorder("run", test, "--out", tmp_path / f"out-{number}")
        assert outcome.exit_code in ({0} if name in FACTS else {0, 3, 4})
        assert "internal fault" not in outcome.output and outcome.output.count("\n") >= 1
        for path in (tmp_path / f"out-{number}").glob("*/findings.json"):
            findings = json.loads(path.read_bytes())
            assert contradictions(findings) == []
            if name in FACTS:
                FACTS[name](json.loads((test / "truth.json").read_bytes()), findings)
