"""Pictures, page and sentences of a comparison show what changed, and nothing that did not."""

import numpy as np
import pytest

from crankorder.comparison import Comparison, Trend
from crankorder.identify.compared import compared
from crankorder.report import comparison
from crankorder.report.comparison_figures import order_change_figure
from made.shipped import SETTINGS
from made.two_tests import made_test
from made.typed import record_of

LINES = {1.0: lambda rpm: 0.5, 5.5: lambda rpm: 0.4}


def documented(*tests):
    document, datasets = compared(tests, q=0.05)
    return comparison.with_sentences(document), datasets


@pytest.fixture(scope="module")
def doubled():
    base = made_test(LINES, name="base <b>", seed=1, channels=("A", "B"))
    new = made_test({**LINES, 5.5: lambda rpm: 0.8}, name="new", seed=2, channels=("A", "B"))
    return documented(base, new)


def test_orders_that_turned_alone_are_told_from_those_whose_amplitude_changed():
    base, turned = (
        made_test({order: lambda rpm, k=k: (1j**k) * 0.5 for order in (1.0, 2.0, 5.5)}, seed=k) for k in (0, 1)
    )
    document = documented(base, turned)[0]
    assert (document.cause.cause, document.cause.orders) == ("orders", (1.0, 2.0, 5.5))
    assert document.headline[0].startswith("The phase of orders 1, 2 and 5.5 turned, and no amplitude changed")


def test_the_order_that_changed_is_coloured_and_labelled_and_the_others_are_light(doubled):
    document, groups = doubled
    drawing = order_change_figure(groups["order_change"], document, settings=SETTINGS.report)
    lines = drawing.strokes("order-")
    assert {line.name for line in lines} == {"order-5.5"} and len(lines) == 2  # a panel per channel
    for line in lines:
        np.testing.assert_allclose(line.values[1], 6.02, atol=0.5)
    assert any(word.text == "5.5" for word in drawing.words)


@pytest.mark.parametrize(
    ("kind", "ends", "says"),
    [
        ("bearing", (0.3, 0.7), "grows by 50.0% a run"), ("bearing", (0.3, 0.7), "failing"),
        ("bearing", (0.01, 0.9), "too little"), ("bearing", (-0.4, -0.1), "no sign"),
        ("bearing", (-0.1, 1.1), "not decided: "), ("order", (-0.1, 1.1), "not decided"),
    ],
)  # fmt: skip
def test_the_verdict_on_a_line_is_that_of_its_interval(kind, ends, says):
    trend = {"kind": kind, "growth_per_run": 0.5, "growth_per_run_ci95": ends, "amplitude": (1.0, 1.5)}
    verdict = comparison.trend_verdict(record_of(Trend, trend))
    assert says in verdict and (kind == "bearing" or verdict == says)


def test_the_page_answers_first_and_escapes_what_comes_from_files(doubled):
    assert Comparison.from_dict(doubled[0].as_dict()) == doubled[0]  # as it is read back
    page = comparison.comparison_page(doubled[0], pictures=[("a.png", "A")], settings=SETTINGS.report)
    assert "base &lt;b&gt;" in page and "<b>" not in page
    for said in ("What changed", "How sure", "Order 5.5", "confounds"):
        assert said in page
    assert "<script" not in page and "http" not in page.split("</head>")[1]


def test_of_two_builds_each_change_is_said_once_by_the_test_that_tells_it_best():
    def of(shift, half, seed):
        known = {"damping_ratio": 0.01, "damping_ratio_ci95": [0.009, 0.011], "explained_by": "mode"}
        places = ({"frequency_hz": hz, "frequency_hz_ci95": [hz - half, hz + half]} for hz in (90.0, 90.0 + shift))
        modes = [[known | place] for place in places]
        return documented(*(made_test(LINES, name=n, seed=seed + k, modes=modes[k]) for k, n in enumerate("ab")))[0]

    sharp, rough, still = of(2.7, 0.1, 1), of(2.4, 0.5, 3), of(0.0, 0.1, 5)
    lead, *more = comparison.builds_headline({"rough": rough, "sharp": sharp}, ["lone (b)"])
    assert lead.startswith("The 90 Hz natural frequency moved to 92.70 Hz") and lead.endswith("(seen in both tests).")
    assert len(more) == 1 and "lone (b)" in more[0]
    none, doubt = comparison.builds_headline({"rough": rough, "still": still}, [])
    assert none == "No change is certain in rough and still."
    assert doubt.startswith("Not decided") and "still, which tells it best" in doubt
    assert comparison.builds_headline({"still": still}, [])[0].startswith(
        "Nothing that was compared changed by more than chance in still"
    )


def test_tests_that_are_alike_have_a_page_too():
    mode = {"frequency_hz": 90.0, "damping_ratio": 0.01, "explained_by": "mode"}
    base = made_test(LINES, name="base", seed=1, modes=[mode])
    document, _ = documented(base, base)
    assert comparison.comparison_story(document)["what"] == []
    assert document.headline[0].startswith("No order and no natural frequency that both tests show changed by more")
    assert document.headline[0] in comparison.comparison_page(document, pictures=[], settings=SETTINGS.report)
