"""Lines at speeds that differ by some percent: what stays and what goes with the shaft, each at its size."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
import xarray as xr

from crankorder.findings import Findings, FreeBand, OpenBand
from crankorder.identify.findings import IN_DOUBT, speed_doubt, undecided_orders, without_free
from crankorder.identify.found import SpeedVerdicts, Tone
from crankorder.identify.modes.alike_speeds import with_lines_of_recordings
from crankorder.orders.intervals import Z95
from crankorder.report.sentences.story import headline, story_of
from crankorder.settings import load_settings
from made.command import analysed
from made.found_lines import agreed, fit, line
from made.line_frames import held_at
from made.recordings import manifest

SETTINGS = load_settings().identify


def recorded(speeds, fixed, orders, *, seed):
    """Recordings at the ``speeds``, with lines at ``fixed`` Hz and at ``orders``, each with its amplitude."""
    rng, made = np.random.default_rng([seed, 5]), []
    for rpm in speeds:
        turning = [(order * rpm / 60.0, size) for order, size in orders.items()]
        made += held_at(rng, rpm, [*fixed.items(), *turning], noise=0.1)
    return made


def told(held, tones, orders=()):
    """What is made of ``tones`` of the map that are one with others."""
    made = tuple(Tone(hertz, 0.002, "order", {"A": (0.7, 0.001)}, "lies on an order") for hertz in tones)
    modal = replace(fit(), tones=made, frequency_hz=np.arange(0.5, 400.0, 0.5))
    speed = sorted(one.rpm for one in held)
    order_map = xr.Dataset(coords={"speed": speed, "order": held[0].axis}, attrs={"revs_per_cycle": 1})
    return with_lines_of_recordings(orders, modal, held, order_map, settings=SETTINGS)


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(8))
def test_mains_and_the_order_beside_them_have_their_own_size_whichever_is_larger(seed):
    rng = np.random.default_rng([seed, 9])
    supply = float(rng.choice([50.0, 60.0])) * float(rng.uniform(0.999, 1.001))
    slips = np.sort(rng.uniform(0.004, 0.02, 4))
    slips += np.array([0.0, 0.004, 0.008, 0.012])
    size, of_order = (float(one) for one in np.exp(rng.uniform(np.log(0.03), np.log(1.0), 2)))
    held = recorded([60.0 * supply * (1.0 - one) for one in slips], {supply: size}, {1.0: of_order}, seed=seed)
    orders, modal = told(held, [supply - 0.3, supply + 0.05], (agreed(1.012, line(1.012)),))
    assert [one.order for one in orders] == [1.0] and orders[0].lock == "locked"
    (row,) = orders[0].lines
    assert np.abs(row.amplitude - of_order) == pytest.approx(0.0, abs=4.0 * float(row.amplitude_error.max()))
    (tone,) = modal.tones
    assert tone.kind == "mains" and abs(tone.frequency_hz - supply) < 0.01
    mean, error = tone.amplitude["A"]
    assert abs(mean - size) < 4.0 * error and error < 0.01


def test_a_tone_beside_an_order_is_no_mains_and_a_line_that_slips_is_an_order():
    held = recorded([1480.0, 1500.0, 1530.0], {77.3: 0.5}, {3.0: 0.8, 3.06: 0.4}, seed=1)
    orders, modal = told(held, [74.8, 76.0, 77.0])
    assert [one.order for one in orders] == pytest.approx([3.0, 3.06], abs=1e-3)
    assert [one.lock for one in orders] == ["locked", "slips"]
    (tone,) = modal.tones
    assert tone.kind == "tone" and tone.frequency_hz == pytest.approx(77.3, abs=0.01)


@pytest.mark.slow
def test_what_is_neither_fixed_nor_an_order_leaves_all_as_it_was():
    """A pole-pass sideband moves with the slip: no frequency and no order of its own."""
    held = [
        one
        for rpm, slip in ((2985.0, 0.005), (2970.0, 0.01), (2952.0, 0.016))
        for one in recorded([rpm], {50.0: 0.5, 50.0 * (1.0 - slip) + 100.0 * slip: 0.4}, {1.0: 1.0}, seed=3)
    ]
    before = (agreed(1.0, line(1.0)),)
    orders, modal = told(held, [49.9], before)
    assert orders == before and [tone.frequency_hz for tone in modal.tones] == [49.9]


@pytest.mark.slow
@pytest.mark.parametrize("speeds", [[1500.0], [1500.0, 1500.0], [1000.0, 1500.0]])
def test_one_speed_and_speeds_far_apart_are_left_alone(speeds):
    held = recorded(speeds, {50.0: 0.5}, {2.0: 1.0}, seed=2)
    _, modal = told(held, [49.9])
    assert [tone.frequency_hz for tone in modal.tones] == [49.9]


@pytest.mark.slow
def test_the_interval_of_a_tone_that_stands_alone_holds_it():
    off = []
    for seed in range(12):
        rng = np.random.default_rng([seed, 4])
        hertz = float(rng.uniform(70.0, 130.0))
        held = recorded([1480.0, 1500.0, 1530.0], {hertz: 0.3}, {1.0: 1.0}, seed=seed)
        _, modal = told(held, [hertz - 0.08])
        off += [abs(tone.frequency_hz - hertz) / (Z95 * tone.frequency_error_hz) for tone in modal.tones]
    assert len(off) == 12 and np.mean(np.array(off) < 1.0) >= 0.8 and max(off) < 2.5


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
