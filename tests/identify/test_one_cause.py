"""What is found twice at one place is told once, or each with the other."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.explain import Cause, Causes
from crankorder.identify.found import Tone
from crankorder.identify.one_cause import with_neighbours_named, without_doubles
from crankorder.identify.said import MAY_BE_ALL
from crankorder.report.sentences.of_lines import tone_sentences
from crankorder.report.sentences.of_modes import mode_sentences
from made.found_lines import agreed, fit, line, mode
from made.typed import findings_of

GRID_HZ = np.arange(0.0, 200.0, 0.5)


def tone(hertz: float, kind: str, size: float = 1.0) -> Tone:
    return Tone(hertz, 0.005, kind, {"A": (size, 0.01)}, "")  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(5))
def test_a_tone_on_the_flank_of_a_stronger_one_is_not_told(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hertz, away = rng.uniform(60.0, 150.0), rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.9)
    strong, flank, apart = tone(hertz, "mains"), tone(hertz + away, "order", 0.7), tone(hertz + 3.0, "order", 0.7)
    other = tone(hertz - away, "tone", 0.7)
    found = without_doubles(fit(tones=(strong, flank, apart, other), frequency_hz=GRID_HZ))
    assert found.tones == (strong, apart, other)


def test_a_doubtful_natural_frequency_names_the_line_that_stands_there() -> None:
    modal = fit(
        mode(49.98, undecided="no order passes it"), mode(49.95, undecided="its damping is not determined"),
        mode(80.0, undecided="no order passes it"), mode(120.0), tones=(tone(49.984, "mains"),),
    )  # fmt: skip
    said = with_neighbours_named(modal, (), Causes({}, (), (Cause("mains", ""),)))
    assert [MAY_BE_ALL in one.undecided for one in said.modes] == [True, True, False, False]
    assert said.modes[0].undecided == f"no order passes it; mains at 49.984 Hz {MAY_BE_ALL}"
    records = [
        {"frequency_hz": one.frequency_hz, "explained_by": "undecided" if one.undecided else "mode"}
        | {"undecided": one.undecided}
        for one in said.modes
    ] + [{"frequency_hz": 49.984, "explained_by": "mains"}]
    findings = findings_of({"modes": records})
    text = "\n".join(mode_sentences(findings))
    assert text.count(MAY_BE_ALL) == 1 and "1 more line is not decided" in text
    assert "a natural frequency may be there too" in tone_sentences(findings)[0]


def test_at_one_speed_it_names_the_order_that_stands_there() -> None:
    rpm = 1713.0
    one = agreed(3.0, line(3.0, speed_rpm=[rpm]))
    beside = fit(mode(3.0 * rpm / 60.0 + 0.01, undecided="at one speed its modulation looks the same"))
    causes = Causes({("A", 3.0): Cause("bearing pump BPFO", "")}, (), ())
    assert (
        "bearing pump BPFO at 85.65 Hz stands there" in with_neighbours_named(beside, (one,), causes).modes[0].undecided
    )
    swept = agreed(3.0)
    assert MAY_BE_ALL not in with_neighbours_named(beside, (swept,), causes).modes[0].undecided
