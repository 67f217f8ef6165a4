"""What is said where the speed is in doubt."""

import h5py
import numpy as np

from crankorder.findings import Findings, FreeBand, OpenBand
from crankorder.identify.findings import IN_DOUBT, speed_doubt, undecided_orders, without_free
from crankorder.identify.found import SpeedVerdicts
from crankorder.report.sentences.story import headline, story_of
from crankorder.settings import load_settings
from made.command import analysed
from made.found_lines import agreed
from made.recordings import manifest

SETTINGS = load_settings().identify


# A speed that the vibration tells only in doubt carries no sentence that is sure of it.


RATE_HZ = 8192
MANIFEST = manifest("*.h5", channels={"Z": {"source": "z"}}, sampling={"rate_hz": 8192}, encoder={"kind": "vibration"})


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


def findings_of(folder, orders):
    """Findings of one recording at 1500 rpm without an encoder that holds ``orders``, noise and a tone of 73.3 Hz."""
    rng, at = np.random.default_rng(3), np.arange(4 * RATE_HZ) / RATE_HZ
    signal = sum(size * np.cos(2 * np.pi * k * 25.0 * at + k) for k, size in orders.items())
    signal = signal + 3.0 * np.cos(2 * np.pi * 73.3 * at) + 0.5 * rng.standard_normal(at.size)
    (folder / "in").mkdir(parents=True)
    with h5py.File(folder / "in" / "a.h5", "w") as file:
        file["z"] = signal
    (folder / "in" / "run.toml").write_text(MANIFEST, encoding="utf-8")
    return analysed(folder / "in", folder / "out")


def test_even_orders_alone_leave_the_speed_open_and_the_page_says_so(tmp_path):
    findings = findings_of(tmp_path, {2.0: 1.0, 4.0: 0.6, 6.0: 0.4})
    assert findings["speed_doubt"] and not findings["free_bands"]
    assert {record["lock"] for record in findings["orders"]} <= {"undecided"}
    typed = Findings.from_dict(findings)
    said = [*headline(typed), *(one for part in story_of(typed).values() for one in part)]
    assert "is in doubt" in said[0]
    for sure in ("does not follow the shaft", "Balance it", "Free of resonances", " slips", "Cause: "):
        assert not any(sure in one for one in said), sure
