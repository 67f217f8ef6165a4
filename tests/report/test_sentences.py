"""The sentences say what the findings hold, in one way of writing numbers."""

import copy
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crankorder.cause import Cause
from crankorder.identify.lines import growth
from crankorder.plot import reading
from crankorder.plot.reading import level_reference, order_texts, percent_text
from crankorder.report import tables
from crankorder.report.sentences import of_lines, of_speeds, story
from crankorder.report.sentences.of_lines import LIKE_UNBALANCE, RE_RUN_RULE, SHAFT_SIDES
from crankorder.report.sentences.story import ALL_CLEAR, ALL_CLEAR_WITH_ENVELOPE, MORE_SPEEDS, TOO_SHORT
from made.contradictions import contradictions
from made.typed import from_dicts

estimate_text, nominal_order, order_name = map(
    from_dicts, (reading.estimate_text, reading.nominal_order, reading.order_name)
)
if_unbalance, tables_of = from_dicts(growth.if_unbalance), from_dicts(tables.tables_of)
headline, law_sentences, lead_of, lock_sentences, story_of = map(
    from_dicts, (story.headline, story.law_sentences, story.lead_of, story.lock_sentences, story.story_of)
)
motor_sentences, strongest_sentence, tone_sentences = map(
    from_dicts, (of_lines.motor_sentences, of_lines.strongest_sentence, of_lines.tone_sentences)
)
avoid_sentences, swing_sentences = map(from_dicts, (of_speeds.avoid_sentences, of_speeds.swing_sentences))

EXCLUDED = "the data exclude that an order is amplified more than 3 times (99 %)"
UNSEEN = "not tested between: order 2 could be amplified by any amount unseen; order 3 too"
UNTESTED = {"low_rpm": 900.0, "high_rpm": 1200.0, "remark": UNSEEN}
QUIET: dict[str, Any] = {"orders": [], "modes": [], "crossings": [], "bearings": [], "quality": []}


def with_order_2_of_z(campaign):
    """A copy of the findings, and its record of order 2 in channel Z."""
    findings = copy.deepcopy(campaign.findings)
    return findings, next(one for one in findings["orders"] if (one["channel"], one["order"]) == ("Z", 2.0))


ESTIMATES = (
    (0.83, [0.81, 0.85], "0.83 (0.81…0.85) m/s²"), (1.898, [1.860, 1.937], "1.90 (1.86…1.94) m/s²"),
    (116.0, [110.0, 122.0], "116 (110…122) m/s²"), (-42.0, [-44.0, -40.0], "−42 (−44…−40) m/s²"),
    (3.0e-9, [2.0e-9, 4.0e-9], "3.00e-9 (2.00e-9…4.00e-9) m/s²"), (5.0, None, "5.00 m/s²"), (None, None, "–"),
    (math.nan, None, "–"),
)  # fmt: skip


def test_an_estimate_is_written_with_the_digits_that_its_interval_earns():
    for value, interval, text in ESTIMATES:
        assert estimate_text({"x": value, "x_ci95": interval}, "x", unit="m/s²") == text


@given(st.floats(min_value=1e-12, max_value=1e12), st.floats(min_value=1e-3, max_value=0.5))
def test_a_written_interval_is_never_off_by_more_than_a_quarter_of_its_width(value, share):
    low, high = value * (1 - share), value * (1 + share)
    text = estimate_text({"x": value, "x_ci95": [low, high]}, "x").replace("−", "-")
    written = [float(part) for part in text.replace("(", " ").replace(")", " ").replace("…", " ").split()]
    tolerance = max(0.13 * (high - low), 0.006 * value)  # a quarter of the width rounds by an eighth; three digits
    assert written == pytest.approx([value, low, high], abs=tolerance)


def test_an_order_is_not_called_by_a_half_order_outside_its_interval():
    assert nominal_order({"order": 1.004, "order_ci95": [1.0039, 1.0041]}) == 1.004
    assert nominal_order({"order": 1.004, "order_ci95": [1.0039, 1.0041], "lock": "locked"}) == 1.0
    assert nominal_order(1.004) == 1.0


@pytest.mark.parametrize(
    ("order", "half", "text"), [(0.052, 1e-6, "0.052"), (0.0309278, 1e-7, "0.03093"), (7.3124, 0.2, "7.3")]
)
def test_an_order_is_called_by_the_digits_that_its_interval_carries_in_every_sentence(order, half, text, campaign):
    findings, record = with_order_2_of_z(campaign)
    record |= {"order": order, "order_ci95": [order - half, order + half], "lock": "slips", "amplitude": 1e3}
    assert order_name(record, findings) == order_name({"order": order}, findings) == text
    assert strongest_sentence(findings, "Z").startswith(f"Order {text} is the strongest")


@given(st.lists(st.integers(1, 20_000_000), min_size=1, max_size=12, unique=True))
def test_different_orders_have_different_texts_that_are_their_values(millionths):
    orders = [number / 1e6 for number in millionths]
    texts = order_texts(orders)
    assert len(set(texts)) == len(orders)
    assert [float(text) for text in texts] == pytest.approx(orders, abs=0.0051)


def test_a_share_is_never_written_as_nothing_when_there_is_something():
    texts = {0.0: "0 %", 1e-9: "< 0.01 %", 0.031: "3.1 %", 0.7: "70 %", 0.9999: "100 %"}
    assert {share: percent_text(share) for share in texts} == texts


def test_levels_refer_to_iso_1683_in_the_unit_of_the_channel(settings):
    assert level_reference("acceleration", "m/s2", settings=settings) == (1e-6, "dB re 1e-6 m/s² (peak)")
    reference, text = level_reference("acceleration", "g", settings=settings)
    assert (reference * 9.80665, text) == (pytest.approx(1e-6), "dB re 1e-6 m/s² (peak)")
    for quantity in ("sound_pressure", "sound pressure", "pressure"):
        assert level_reference(quantity, "Pa", settings=settings) == (20e-6, "dB re 20 µPa (peak)")
    assert level_reference("pressure", "bar", settings=settings) == (1.0, "dB re 1 bar (peak)")
    assert level_reference("other", "counts", settings=settings) == (1.0, "dB re 1 counts (peak)")


def test_the_headline_names_the_strongest_order_the_frequency_that_it_meets_and_what_is_unresolved(campaign):
    findings, record = with_order_2_of_z(campaign)
    record |= {"amplitude": 2.83, "amplitude_ci95": [2.81, 2.85], "speed_rpm_at_max": 1800.0}
    wanted = "Order 2 is the strongest line in Z: 2.83 m/s² (2.81…2.85) at 1800 rpm, "
    assert strongest_sentence(findings, "Z") == wanted + "where it meets the 60 Hz natural frequency."
    assert headline(findings)[0] == wanted + "where it meets the 60 Hz natural frequency. Cause: engine order."
    record["meets_hz"] = None  # as identification has it of a tone of the mains
    assert "meets" not in strongest_sentence(findings, "Z")
    unparted = {"order": 7.4525, "amplitude": 14.0, "amplitude_ci95": [0.0, 28.0], "doubts": ["unresolved"]}
    findings["orders"].append(record | unparted)
    said = headline(findings)[0]
    assert said.startswith("What is strongest in Z was not resolved: near order 7.452, 14 m/s² (0…28) at 1800 rpm; of")
    assert "orders that are told 2 is the strongest: 2.83 m/s²" in said
    assert strongest_sentence(findings, "Y").startswith("Order 2")


def test_a_fixed_tone_stronger_than_any_order_is_named_first(full):
    tone = "A fixed tone of 58.3 Hz is the strongest line in Z: 5.00 m/s² (4.90…5.10)"
    beside = "; the strongest order is 2: 1.90 m/s² (1.86…1.94) at 1800 rpm."
    assert strongest_sentence(full, "Z") == tone + beside
    assert headline(full)[1].endswith("The tone does not follow the shaft: it has a source of its own.")
    loose = full | each("lines", explained_by="order", causes=["order"])(full)
    assert headline(loose)[1].endswith("so alike nothing tells whether it follows the shaft.")
    assert strongest_sentence({"lines": full["lines"], "channels": full["channels"]}, "Z") == f"{tone}."


def test_the_headline_has_line_bearing_speed_balance_and_unexplained_share(full):
    bearing, line, speed, balance, energy = headline(full)  # what strikes goes first
    assert "58.3 Hz" in line
    damaged = "A bearing is damaged: order 3.556, the outer-race (BPFO) line of the jack shaft bearing, has 0.120 m/s² "
    assert bearing == f"{damaged}(0.110…0.130) in Z, in the envelope."
    why = " ".join(story_of(full)["why"])
    assert "outer-race (BPFO)" in why and "slip −0.80 (−0.90…−0.70) %" in why and "2000–4000 Hz" in why
    where = "near 1800 rpm (1755 to 1850 rpm), where order 2 excites the 60 Hz natural frequency"
    assert speed == f"Avoid steady running {where}; the worst of 2 speeds to avoid."
    peak = "order 2: peak 3.70 m/s² in Z, calculated by the modal fit for a held speed, amplified 12 times"
    assert avoid_sentences(full)[0] == f"Avoid steady running {where}; {peak}."
    assert balance.startswith("Unbalanced reciprocating mass: 116 (110…122) g") and energy.startswith("3.1 % of the")


DOUBT = {"speed_doubt": "all recordings turn at 1.2 times the speed that their names state"}
UNNAMED = {"looked_for": ["orders"], "bearings": []}
LIMIT = {"quantity": "velocity", "value": 2.0, "unit": "mm/s", "source": "rule", "channel": "Z", "level": 1.5}
ABOVE, KEPT = LIMIT | {"level": 6.0, "verdict": "above"}, LIMIT | {"verdict": "within"}
OVER = "The velocity of Z is above the limit of 2.00 mm/s (rule): 6.00 mm/s."
VERDICTS = (
    ({}, 0, "A bearing is damaged: order 3.556"), (DOUBT, 1, "If the speed is right, a bearing is damaged: order"),
    ({"damage": False}, 2, "A bearing strikes, and which part is damaged is not decided: order 3.556"),
    ({"line": "N*fs", "lock": "undecided", "damage": False, "seen_in": "vibration"}, 2,
     "Whether a bearing is failing is not decided: order"),
    ({"lock": "locked", "damage": False, "re_run": False}, 2, "No sign of a failing bearing: order"),
    ({"bearings": []}, 2, "No sign of a failing bearing: no line of those that are named"),
    ({"bearings": []} | DOUBT, 3, "Whether a bearing is failing is not decided: the speed is in doubt."),
    (UNNAMED, 2, "Whether anything is failing was not looked for: the manifest names no bearing and no limit."),
    ({"limits": [KEPT, ABOVE, ABOVE]}, 0, f"{OVER} 1 more is exceeded or not decided: see the table of limits."),
    (UNNAMED | {"limits": [KEPT, ABOVE]}, 0, OVER), (UNNAMED | {"limits": [KEPT] * 2}, 2, "All limits that were"),
)  # fmt: skip


@pytest.mark.parametrize(("changed", "place", "said"), VERDICTS)
def test_the_head_says_what_shakes_which_speed_to_avoid_and_what_fails_and_what_fails_goes_first(
    changed, place, said, full
):
    of_record = {key: value for key, value in changed.items() if key in full["bearings"][-1]}
    full |= {key: value for key, value in changed.items() if key not in of_record}
    full["bearings"] = [record | of_record for record in full["bearings"][-1:]]
    answers = lead_of(full)
    assert answers[place].startswith(said) and len(answers) == 3 + len({"speed_doubt", "limits"} & {*changed})
    assert max(map(len, answers)) <= 210 and contradictions(full) == []
    speeds = [words for words in answers if "void steady running near" in words]
    assert len(speeds) == 1 and speeds[0].startswith("If the speed is right") == ("speed_doubt" in changed)


def test_speeds_to_avoid_come_from_their_own_list_and_never_from_crossings_beside_it(full):
    _, second = avoid_sentences(full)
    assert all(words in second for words in ("1690 to 1760", "order 4", "order 8"))
    full["speeds_to_avoid"] = []
    assert avoid_sentences(full) == []
    full["free_bands"] = [{"low_rpm": 300.0, "high_rpm": 2000.0, "remark": EXCLUDED}]
    wanted = f"Free of resonances: 300 to 2000 rpm; {EXCLUDED}."
    full["open_bands"] = []
    assert wanted in story_of(full)["what_to_do"] and f"No speed to avoid was found. {wanted}" in headline(full)


def test_nothing_is_all_clear_while_speeds_are_open(full):
    quiet = QUIET | {"orders": full["orders"], "speeds_to_avoid": [], "speed_range_rpm": [300.0, 2000.0]}
    for free, still_open in (([], [UNTESTED]), ([{"low_rpm": 300.0, "high_rpm": 900.0}], [UNTESTED]), ([], [])):
        story = story_of({**quiet, "free_bands": free, "open_bands": still_open})
        assert not any("asks for action" in one for one in story["what_to_do"])
        assert story["what_to_do"]
    every = story_of({**quiet, "free_bands": [{"low_rpm": 300.0, "high_rpm": 2000.0}], "open_bands": []})
    assert ALL_CLEAR in every["what_to_do"]


def test_a_mode_in_doubt_is_not_called_a_natural_frequency_where_an_order_peaks(full):
    met = {**full["speeds_to_avoid"][0], "mode_hz": 265.0, "orders": [2.0], "modes_hz": [265.0]}
    (said,) = avoid_sentences({**full, "speeds_to_avoid": [met]})
    assert "order 2 peaks at 265 Hz, which may be a natural frequency" in said and "excites" not in said
    strongest = max(full["orders"], key=lambda one: float(one["amplitude"]))
    strongest |= {"amplitude": 50.0, "meets_hz": 265.0, "speed_rpm_at_max": 60.0 * 265.0 / strongest["order"]}
    assert "where it meets 265 Hz, which may be a natural frequency" in " ".join(headline(full))
    full["modes"] = [mode for mode in full["modes"] if mode["explained_by"] == "undecided"]
    unproven = "No natural frequency is proven; one may lie near 265 Hz."
    assert unproven in story_of(full)["why"] and dict(tables_of(full, limit=60))["modes"].empty == unproven


def test_a_speed_to_avoid_states_no_peak_that_is_not_known_and_no_factor_above_its_bound(full):
    one = full["speeds_to_avoid"][0]
    for nothing in (0.0, None):
        unknown = {**full, "speeds_to_avoid": [{**one, "amplitude": nothing, "amplification": None}]}
        (said,) = avoid_sentences(unknown)
        assert "peak " not in said and "amplified" not in said
        assert dict(tables_of(unknown, limit=60))["avoid"].rows[0][6] == "–"
    bound = {**one, "at_least": True, "amplification_ci95": [8.0, None]}
    (said,) = avoid_sentences({**full, "speeds_to_avoid": [bound]})
    assert "peak at least 3.7" in said and "amplified at least 8.0 times" in said
    (said,) = avoid_sentences({**full, "speeds_to_avoid": [{**one, "amplification_ci95": [8.0, 20.0]}]})
    assert "amplified 8.0 to 20 times" in said


def test_channels_of_different_units_are_not_ranked_against_each_other(full):
    full["lines"] = []
    full["channels"][0]["unit"] = "Pa"
    for record in full["orders"]:
        record["unit"] = "Pa" if record["channel"] == "X" else "m/s2"
        record["amplitude"] *= 1e-3 if record["channel"] == "X" else 1.0
    assert [one.split(" in ")[1][0] for one in story_of(full)["what"][:3]] == ["X", "Z", "Y"]


def each(table, **values):
    """The table of the findings with these values in each record."""
    return lambda given: {table: [record | values for record in given[table]]}


def inside(table, **values):
    """The object of the findings with these values."""
    return lambda given: {table: given[table] | values}


NO_SPEEDS = {"speeds_to_avoid": [], "free_bands": [], "open_bands": []}
EXPLAINED = "of the energy that is not broadband"
SAID = (
    # an estimate of the balance
    (inside("balance", along_g=89.0, along_g_ci95=[73.0, 105.0], residual_reciprocating_g=99.0,
            residual_reciprocating_g_ci95=[89.0, 110.0]), ["Unbalanced reciprocating mass: 99 (89…110) g"], ["73"]),
    ({"balance": None, "balance_reason": "no trial mass was run"},
     ["Residual unbalance in grams is not known: no trial mass was run."], []),
    # data and bearings
    ({"quality": [{"recording": "a", "flag": "no_index", "severity": "bad", "detail": ""}]},
     ["took no part", "Repeat the recordings that are marked bad."], []),
    (each("bearings", lock="locked", damage=False, re_run=False, verdict="A bearing would slip: no bearing alarm."),
     ["no bearing alarm"], ["Re-run"]),
    # what the findings hold as they are: tones are no natural frequencies
    ({}, ["58.3 Hz (tone, 5.00 m/s² (4.90…5.10) in Z) and 300 Hz (mains, 0.020 m/s² (0.018…0.022) in Z)",
          "Natural frequencies: 60 Hz, 115 Hz, 172 Hz, 187 Hz, 230 Hz, 350 Hz, 457 Hz and 470 Hz.",
          "265 Hz may be a natural frequency: not decided; order 10 lies on it at every speed.",
          "Order 5.5 keeps its size at all tested speeds", "excites",
          "Order 5.5 is not yet known to be locked to the shaft; recordings of 420 revolutions would tell.",
          "Not decided: at the crank radius, across the cylinder. The table Balance says why and"], []),
    # laws of speed
    (each("orders", speed_law="follows no power law"), [], ["its size", "square of the speed"]),
    (lambda full: {"orders": [full["orders"][0] | {
        "order": 1.0, "explained_by": "shaft harmonic", "speed_exponent": 0.02,
        "speed_exponent_ci95": [-0.1, 0.12], "doubts": ["slower than unbalance"]}]},
     ["Order 1 does not grow as unbalance does: it goes with speed to the 0.02"], []),
    (each("orders", order=5.48, order_ci95=[5.479, 5.481], lock="slips"),
     ["is no exact multiple of the half revolution: what makes it slips"], []),
    # speeds
    (NO_SPEEDS | {"bearings": [], "lines": [], "speed_range_rpm": [1800.0, 1800.0]},
     ["A test at one speed cannot tell which speeds are free of resonances."], ["Free of", "asks for action"]),
    (each("crossings", excited=False, verdict="not decided"), [], ["excites"]),
    ({"open_bands": []}, [], ["not known"]),
    (NO_SPEEDS | {"open_bands": [UNTESTED]},
     ["No speed of the tested range can be called free of resonances. Not free, or not known: 900 to 1200 rpm: "
      "not tested between: order 2 could be amplified by any amount unseen."], []),
    ({"open_bands": [UNTESTED | {"high_rpm": 1000.0}, UNTESTED]},
     ["Free of resonances", "Not free, or not known: 900 to 1200 rpm (and 1 more band): "], []),
    # energy
    ({"unexplained_energy_fraction": 1e-7}, ["< 0.01 % " + EXPLAINED], []),
    ({"unexplained_energy_fraction": 0.0}, ["All " + EXPLAINED + " is explained by orders and tones"], []),
    ({"unexplained_energy_fraction": 0.0, "energy": None}, ["All of the energy of the lines that were found"], []),
    ({"unexplained_energy_fraction": 0.0, "lines": [], "orders": [], "energy": None}, [], ["All of the energy"]),
)  # fmt: skip


@pytest.mark.cases(len(SAID))
@pytest.mark.parametrize(("changed", "said", "unsaid"), SAID)
def test_what_the_findings_hold_is_said_and_nothing_else(changed, said, unsaid, full):
    full |= changed(full) if callable(changed) else changed
    text = " ".join(sentence for answer in (*story_of(full).values(), headline(full)) for sentence in answer)
    assert [one for one in said if one not in text] == []
    assert [one for one in unsaid if one in text] == []


def test_without_a_law_an_exponent_near_two_with_a_narrow_interval_is_called_unbalance(campaign):
    why = story_of(campaign.findings)["why"]
    assert any("unbalanced mass" in one and "Orders 1 and 2" in one for one in why)
    assert not any("its size" in one for one in why)  # an exponent alone does not tell
    assert RE_RUN_RULE in story_of(campaign.findings)["what_to_do"]
    for wide in ([0.2, 0.9], [0.0, 4.0]):
        given = campaign.findings | each("orders", speed_exponent_ci95=wide)(campaign.findings)
        assert not any("unbalanced mass does" in one for one in story_of(given)["why"]), wide


def test_nothing_found_is_said_and_an_all_clear_covers_what_was_looked_for_and_needs_revolutions():
    assert headline(QUIET) == ["No order stands above the noise."]
    assert story_of(QUIET)["what_to_do"] == [ALL_CLEAR]
    assert "not looked for" in ALL_CLEAR  # an all-clear names what it does not cover
    assert story_of({**QUIET, "looked_for": ["envelope"]})["what_to_do"] == [ALL_CLEAR_WITH_ENVELOPE]
    short = [{"recording": "a", "flag": "short_recording", "severity": "info", "detail": ""}]
    assert story_of({**QUIET, "quality": short})["what_to_do"] == [TOO_SHORT]


def test_of_what_does_not_turn_the_natural_frequencies_go_first_and_nothing_is_said_of_shafts(full):
    still = full | {"orders": [], "bearings": [], "crossings": [], "speeds_to_avoid": [], "free_bands": []}
    still |= {"speed_range_rpm": [None, None], "balance": None, "balance_reason": "no index pulse"}
    assert headline(still)[0].startswith("Natural frequencies: 60 Hz, 115 Hz")
    said = " ".join(sentence for answer in story_of(still).values() for sentence in answer)
    assert not any(word in said for word in ("order stands", "index pulse", "rpm", "bearing"))


@pytest.mark.cases(1)
@pytest.mark.parametrize(("speeds", "words"), [((1800.0, 1800.0), "one speed"), ((900.0, 1800.0), "so few speeds")])
def test_order_one_at_few_speeds_may_be_unbalance_and_asks_for_more(full, speeds, words):
    one = {**full["orders"][0], "order": 1.0, "explained_by": LIKE_UNBALANCE, "amplitude": 99.0}
    full |= {"orders": [one | {"doubts": ["few speeds"]}], "speed_range_rpm": list(speeds)}
    assert any(f"Cause: {LIKE_UNBALANCE}; {words} cannot tell which." in said for said in headline(full))
    asked = story_of(full)["what_to_do"]
    assert MORE_SPEEDS in asked and not any(said.startswith("Balance it") for said in asked)


def test_grams_are_told_under_the_condition_that_their_evidence_states(full):
    balance = {"residual_rotating_gmm": 12.0, "residual_rotating_gmm_ci95": [11.0, 13.0], "if_unbalance": True}
    assert from_dicts(story.balance_sentences)({"balance": balance})[0].startswith(
        "Rotating unbalance, if order 1 is unbalance: "
    )
    assert if_unbalance(balance, [Cause("shaft harmonic", doubt="slower than unbalance")])[0] is None
    made = if_unbalance({"evidence": "a path"}, [Cause(LIKE_UNBALANCE), Cause("tone")])[0]
    assert made is not None and made.if_unbalance
    assert if_unbalance({"evidence": "a path"}, [Cause("unbalance", "grows")])[0].evidence == "a path"


def with_levels(findings, **of_z):
    """``findings`` with a record of the levels of channel Z: nothing above the band but what is given."""
    record = {"channel": "Z", "unit": "m/s2", "rms_max": 1.0, "band_hz": 500.0, "share_above": 0.001}
    above = dict.fromkeys(("amplitude_above", "frequency_hz_above", "order_above", "speed_rpm_above"))
    return findings | {"levels": [record | above | {"band_hz_there": 500.0} | of_z]}


def test_a_stronger_line_above_the_band_goes_first_and_the_other_says_how_far_it_was_looked(full):
    mesh = {"amplitude_above": 12.0, "frequency_hz_above": 575.0, "order_above": 23.0, "speed_rpm_above": 1500.0}
    full["bearings"] = []
    said = headline(with_levels(full, **mesh))
    assert said[0].startswith(
        "The strongest line in Z lies above the band that was looked at (to 500 Hz): about 575 Hz"
    )
    assert said[0].endswith("The recipe gear-mesh looks there.")
    assert "is the strongest line in Z in the band that was looked at: " in said[1]
    assert "maps-full-band" in headline(with_levels(full, **(mesh | {"order_above": 83.0})))[0]
    for order, named in ((23.0, "`--recipe gear-mesh`"), (59.5, "`max_order = 70`"), (151.0, "`max_order = 200`")):
        asked = story_of(with_levels(full, **(mesh | {"order_above": order})))["what_to_do"]
        assert [named in said for said in asked if said.startswith("Run it again")] == [True]


def test_balancing_is_asked_for_in_the_channels_in_which_unbalance_leads(full):
    first, second = ({**full["orders"][0], "order": order, "amplitude": 5.0} for order in (1.0, 4.0))
    led = full | {"speed_doubt": None, "levels": [], "orders": [first | {"channel": "Z", "explained_by": "unbalance"}]}
    assert "Balance it: the strongest order is that of an unbalanced mass." in story_of(led)["what_to_do"]
    led["orders"].append({**second, "channel": "X", "explained_by": "gear mesh"})
    assert "Balance it: the strongest order in Z is that of an unbalanced mass." in story_of(led)["what_to_do"]


def test_a_swing_of_one_share_at_all_speeds_may_be_the_encoders():
    def said(*swings):
        keys = ("speed_rpm", "order", "amplitude_rpm")
        also = {"may_be_encoder": all(row[2] < 0.03 * row[0] for row in swings)}
        records = [{"recording": f"{row[0]:.0f}", **dict(zip(keys, row, strict=True)), **also} for row in swings]
        return " ".join(swing_sentences({"speed_swing": records}))

    one_share = "Order 1 swings by one share of the speed at all speeds: an eccentric encoder would show the same."
    assert said((1100.0, 1.0, 5.76), (1900.0, 1.0, 9.95)).endswith(one_share)
    assert "eccentric" not in said((1100.0, 1.0, 22.0), (1900.0, 1.0, 9.0))
    assert said((1500.0, 2.0, 15.0)).endswith(
        "at the one speed at which it is told: an oval encoder would show the same."
    )
    assert "encoder would" not in said((1500.0, 0.5, 15.0), (1900.0, 0.5, 19.0))
    assert "encoder would" not in said((1500.0, 2.0, 150.0))  # ten percent: no encoder is so far off


def test_statements_that_exclude_each_other_are_told_and_sound_ones_give_none(full):
    assert contradictions(full) == []
    full["modes"][0].update(explained_by="mode", undecided="at one speed its modulation looks the same")
    low, high = full["speeds_to_avoid"][0]["rpm_range"]
    full["free_bands"] = [{"low_rpm": low - 20.0, "high_rpm": high + 20.0, "remark": ""}]
    told = "\n".join(contradictions(full))
    assert "a natural frequency, and not decided" in told and "to be avoided" in told


# What a page says of a motor and of lines at one speed: the frequency first, doubts said, no share of another line.


def line(name, hertz, size, *, side="", others=()):
    return {
        "name": name, "side": side, "channel": "Z", "frequency_hz": hertz, "order": hertz / 24.5, "speed_rpm": 1470.0,
        "amplitude": size, "amplitude_ci95": [size, size], "or": list(others), "n_recordings": 1,
    }  # fmt: skip


def order(number, size, *, lock, cause):
    return {
        "channel": "Z", "order": number, "order_ci95": [number - 1e-4, number + 1e-4], "lock": lock, "amplitude": size,
        "amplitude_ci95": [size, size], "unit": "m/s2", "speed_rpm_at_max": 1470.0, "explained_by": cause,
        "causes": ["mains"] * ("mains" in cause), "speed_law": "keeps its size",
    }  # fmt: skip


def findings(*lines, orders=(), **more):
    motor = {
        "supply_hz": 50.0, "supply_hz_ci95": [50.0, 50.0], "supply_measured": True, "poles": 4, "rotor_bars": 44,
        "misfit": "", "lines": list(lines),
        "speeds": [{"speed_rpm": 1470.0, "synchronous_rpm": 1500.0, "slip": 0.02, "slip_ci95": [0.02, 0.02],
                    "pole_pass_hz": 2.0, "fits": True}],
    }  # fmt: skip
    channels = [{"name": "Z", "unit": "m/s2"}]
    return {"channels": channels, "orders": list(orders), "motor": motor | more, "speed_range_rpm": [1470.0, 1470.0]}


def test_the_slip_and_the_pole_pass_are_said():
    said = motor_sentences(findings())[0]
    assert said.startswith("The motor (4 poles at 50 Hz, as its own lines measure) slips by 2 % at 1470 rpm; its pole-")


def test_sidebands_are_said_with_their_share_and_with_what_they_speak_for():
    sides = (line(SHAFT_SIDES, 22.5, 0.1, side="below"), line(SHAFT_SIDES, 26.5, 0.12, side="above"))
    one = order(1.0, 2.0, lock="locked", cause="unbalance")
    (text,) = [text for text in motor_sentences(findings(*sides, orders=(one,))) if "Beside" in text]
    assert "22.50 Hz and 26.50 Hz are its pole-pass sidebands" in text and "6.0 % of it" in text and "rotor bar" in text


def test_a_line_at_one_speed_leads_with_its_frequency():
    loose = order(5.492, 1.0, lock="slips", cause="unexplained")
    said = findings(orders=(loose,))
    assert strongest_sentence(said, "Z").startswith("A line at 134.55 Hz (order 5.492) is the strongest line in Z: 1")
    (text,) = lock_sentences(said)
    assert text.startswith("134.55 Hz (order 5.492") and text.endswith("nothing tells whether it follows the shaft.")


def test_mains_among_the_orders_are_told_as_mains_and_as_nothing_else():
    said = findings(orders=(order(4.0816, 1.0, lock="slips", cause="twice mains"),))
    del said["motor"]
    assert "99.999 Hz" not in str(lock_sentences(said)) and lock_sentences(said) == [] and law_sentences(said) == []
    assert tone_sentences(said)[0].startswith("A tone, no natural frequency: 100.00 Hz (twice mains, 1")
