"""The text of a balance fits a terminal, shows what the document holds and nothing that it does not."""

from dataclasses import replace
from typing import Any

import pytest

from crankorder.engine.balance_data import load_balanced_engine
from crankorder.engine.balance_sheet import BalanceSheet, balance_sheet
from crankorder.engine.hinge_sheet import hinge_sheet
from crankorder.engine.hinged_crank import load_hinged_engine
from crankorder.report.balance.text import balance_text, hinge_text, shown_orders
from crankorder.report.text_table import MISSING, WIDTH, text_table
from crankorder.settings import shipped

CRANK_ENGINES = sorted(set(shipped("engines")) - {"elastic-hinge"})


def _sheet(name: str, **options: Any) -> BalanceSheet:
    return balance_sheet(load_balanced_engine(name), **options)


def _line(text: str, start: str) -> list[str]:
    """Words of the first line that starts so."""
    return next(line for line in text.splitlines() if line.strip().startswith(start)).split()


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", CRANK_ENGINES)
@pytest.mark.parametrize("speeds", [None, (500.0, 1000.0, 1500.0, 2000.0, 2500.0, 3000.0, 123456.0)])
def test_no_line_is_wider_than_a_terminal_and_nothing_is_none(name: str, speeds: Any) -> None:
    text = balance_text(_sheet(name, speeds_rpm=speeds, max_order=12))
    assert max(map(len, text.splitlines())) <= WIDTH
    words = set(text.split())
    assert not words & {"None", "nan", "inf", "NaN"}


def test_the_hinges_fit_a_terminal_too() -> None:
    text = hinge_text(hinge_sheet(load_hinged_engine("elastic-hinge"), max_order=8))
    assert max(map(len, text.splitlines())) <= WIDTH
    assert "None" not in text


def test_strategies_stand_side_by_side_with_the_masses_of_the_document() -> None:
    text = balance_text(_sheet("task5"))
    assert _line(text, "counterweight on the crank, g")[-5:] == [MISSING, "962.5", "562.5", "762.5", "1962.5"]
    assert _line(text, "counterweight on the rod, g")[-1] == "800"
    assert _line(text, "order 1 along, g·mm")[-5:] == ["19250", "0", "8000", "4000", "0"]
    assert _line(text, "order 1 across, g·mm")[-5:] == ["11250", "8000", "0", "4000", "0"]
    assert "against crank" in next(line for line in text.splitlines() if "order 1 turns" in line)


@pytest.mark.slow
def test_the_angle_of_a_counterweight_is_shown_only_where_there_is_one() -> None:
    sheet = _sheet("task5")
    assert "opposite to the pin" not in balance_text(sheet)
    assert sheet.strategies is not None
    turned = {**sheet.strategies, "b": replace(sheet.strategies["b"], counterweight_deg=37.0)}
    sheet = replace(sheet, strategies=turned)
    assert _line(balance_text(sheet), "… on from opposite to the pin")[-5:] == [MISSING, "0", "37", "0", "0"]


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", CRANK_ENGINES)
def test_every_sentence_and_note_is_told_in_full(name: str) -> None:
    sheet = _sheet(name)
    told = " ".join(balance_text(sheet).split())
    assert sheet.sentences
    for text in (*sheet.sentences, *sheet.notes):
        assert " ".join(text.split()) in told


def test_an_engine_of_several_cylinders_shows_forces_and_moments_and_no_strategy() -> None:
    text = balance_text(_sheet("v-twin"))
    assert "Moments by order" in text
    assert "Strategies" not in text
    assert "Additional shafts" not in text


@pytest.mark.slow
def test_shaft_parts_the_crankshaft_and_both_readings_of_a_printed_pair_are_shown() -> None:
    text = balance_text(_sheet("msu-shafts"))
    assert "−44974" in text
    sums = [line.split() for line in text.splitlines() if line.split()[:1] == ["sum"]]
    assert [cell for line in sums for cell in line[1:] if cell != "–"] == [
        "−0.0083306",
        "0.0098489",
        "0.43007",
        "1354.3",
    ]
    assert _line(text, "Counterweight 1")[2] == "1.865"  # of table 2; the planes come after it


def test_text_from_a_file_cannot_reach_the_terminal_raw() -> None:
    sheet = _sheet("msu-shafts")
    evil = "\x1b[31mred\x07" + "w" * 200
    first, second = sheet.crankshaft.planes
    crankshaft = replace(sheet.crankshaft, planes=(replace(first, name=evil), second))
    text = balance_text(replace(sheet, engine=evil, notes=(evil,), crankshaft=crankshaft, sentences=(evil,)))
    assert "\x1b" not in text
    assert "\x07" not in text
    assert max(map(len, text.splitlines())) <= WIDTH


def test_a_wide_table_repeats_the_names_of_its_rows() -> None:
    lines = text_table("T", ["name", *(f"column {n}" for n in range(20))], [["row", *map(float, range(20))]])
    assert max(map(len, lines)) <= WIDTH
    assert sum("row" in line for line in lines) > 1
    assert [float(word) for line in lines if "row" in line for word in line.split()[1:]] == list(map(float, range(20)))


def test_orders_that_nobody_can_feel_are_left_out_of_the_text() -> None:
    assert shown_orders([{"1": 1.0, "2": 1e-12}, None, {"10": 0.5}]) == ["1", "10"]
    assert len(shown_orders([{str(order): 1.0 for order in range(1, 800)}])) < 50
