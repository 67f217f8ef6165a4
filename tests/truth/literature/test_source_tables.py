"""The tables of docs/sources.md: made of the program's own output, and every number that of the truth sheet."""

import pytest


@pytest.fixture(scope="module")
def made():
    import make_thesis

    return make_thesis


@pytest.mark.slow
def test_every_number_of_the_documents_is_the_true_one_at_its_last_digit(made):
    rows = made.source_rows()
    assert {document for document, _, _ in rows} == {"000", "001", "002", "003"}
    wrong = [
        f"{document} {place}, {what}: {ours} is not {truth}"
        for document, (place, what, *_, truth), ours in rows
        if truth and not made.agrees(ours, truth)
    ]
    assert not wrong, "\n".join(wrong)
    assert sum(bool(row[-1]) for _, row, _ in rows) > 100


def test_the_tables_of_the_page_are_what_the_program_gives(made):
    page = made.SOURCES.read_text(encoding="utf-8")
    assert page == made.with_tables(page, made.tables()), "run `python reports/make_thesis.py --tables-only`"


def test_a_number_agrees_where_it_rounds_to_the_digits_that_are_written(made):
    alike = [(962.5, "962.5"), (4.098e-3, "4.1e-3"), (0.0, "0")]
    others = [(962.56, "962.5"), (28.6, "28")]
    assert [pair for pair in alike if not made.agrees(*pair)] == []
    assert [pair for pair in others if made.agrees(*pair)] == []
