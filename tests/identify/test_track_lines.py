"""Findings and tracks: one number for both, at the order that was found; how large a held speed would make it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from crankorder.identify.found import AgreedOrder, ModalFit, Mode, OrderResponse
from crankorder.identify.lines.followed_orders import track_number
from crankorder.identify.modes.responses import HeldPeak, held_peak
from crankorder.orders.track_rows import track_order
from machines.draw import draw_machine
from machines.folder import write_folder
from machines.judge import Said
from machines.score import run_program

FLOAT32 = 2e-7
DRAWN = [
    ("run-up", 11),
    pytest.param("repeated sweep", 12, marks=pytest.mark.slow),
    ("stepped few", 13),
    pytest.param("one speed", 14, marks=pytest.mark.slow),
]


@pytest.mark.cases(1)
@pytest.mark.parametrize(("class_name", "seed"), DRAWN)
def test_the_largest_value_of_each_track_is_that_of_the_findings(class_name: str, seed: int, tmp_path: Path) -> None:
    machine = draw_machine(class_name, seed)
    write_folder(machine, tmp_path / "test")
    assert run_program(tmp_path / "test", tmp_path / "out") == ""
    said = Said.read(tmp_path / "out")
    assert said.tracks is not None and said.findings["orders"]
    for record in said.findings["orders"]:
        assert abs(record["tracked_order"] - record["order"]) <= max(1e-6, record["order_ci95"][1] - record["order"])
        off = np.abs(said.tracks["order"].values - record["tracked_order"])
        assert off.min() < 1e-6
        track = said.tracks.isel(order=int(off.argmin())).sel(channel=record["channel"])
        sure = track["amplitude"].values[track["amplitude_low"].values > 0.0]
        lawful = record["amplitude"] != pytest.approx(sure.max(), rel=FLOAT32)  # where all speeds follow one law
        assert not lawful or record["speed_law"] != "follows no power law"
        assert record["amplitude_ci95"][0] <= record["amplitude"] <= record["amplitude_ci95"][1]
        row = track.isel(speed=int(np.nanargmax(np.where(track["amplitude_low"] > 0.0, track["amplitude"], np.nan))))
        assert record["speed_rpm_at_max"] == pytest.approx(float(row["speed"]), rel=FLOAT32)
        phase = np.nan if record["phase_deg"] is None else record["phase_deg"]
        assert phase == pytest.approx(float(row["phase"]), rel=FLOAT32, abs=1e-4, nan_ok=True)


def test_an_order_whose_number_is_not_known_has_its_track_where_it_was_found() -> None:
    assert track_order(2.001, (1.99, 2.01), "undecided", revs_per_cycle=2) == 2.0
    assert track_order(2.02, (2.01, 2.03), "undecided", revs_per_cycle=2) == 2.02
    assert track_order(2.76, (2.48, 3.04), "undecided", revs_per_cycle=2) == 2.76
    assert track_order(2.001, (1.99, 2.01), "slips", revs_per_cycle=2) == 2.001


@pytest.mark.slow
def test_a_line_between_multiples_is_read_where_it_stands_however_little_is_known_of_the_speed() -> None:
    slow = AgreedOrder(2.54, 0.033, 1e6, "undecided", None, (), own_error=1e-5)
    assert track_number(slow, revs_per_cycle=2) == 2.54
    assert track_number(replace(slow, own_error=0.03), revs_per_cycle=2) == 2.5
    assert track_number(replace(slow, order=2.50001), revs_per_cycle=2) == 2.5


def _response(*, recording: str = "r1", fits: bool = True, error: float = 0.01) -> OrderResponse:
    one = np.array([1.0 + 0j])
    covariance = np.diag([error**2, error**2]).astype(complex)
    reached = np.array([0])
    return OrderResponse(
        2.0, "X", 0.0, (), 1800.0, (900.0, 3000.0), 0.0 * one, one, reached, covariance, 40, error, fits, recording
    )


def _held(*responses: OrderResponse, error: float = 0.0, order: float = 2.0, channel: str = "X") -> HeldPeak | None:
    mode = Mode(60.0, 0.1, 0.01, error, ("X",), 20.0, "")
    modal = ModalFit((mode,), (), np.diag([0.0, error**2]), responses or (_response(),))
    return held_peak(modal, order, channel, largest_rpm=1800.0)


def test_a_held_order_reaches_what_its_mode_amplifies() -> None:
    peak, wider = _held(), _held(error=0.001)
    assert peak is not None and wider is not None
    assert peak.amplitude == pytest.approx(50.0, rel=2e-3)  # 1 / (2 damping)
    assert peak.rpm == pytest.approx(1800.0, rel=2e-3)
    assert wider.error == pytest.approx(np.hypot(5.0, 0.5), rel=2e-2)


def test_no_response_beside_the_largest_amplitude_says_anything_of_held_speeds() -> None:
    beside = replace(_response(recording="b", error=1e-9), span_rpm=(2500.0, 3000.0))
    assert _held(_response(), beside) == _held()
    for silent in (beside, _response(recording=""), _response(fits=False)):
        assert _held(silent) is None
    assert _held(channel="Y") is None and _held(order=2.5) is None
