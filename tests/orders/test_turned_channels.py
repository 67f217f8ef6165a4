"""A reversed polarity and two swapped channels in one recording are told; what machines do by themselves is not."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from crankorder.orders.turned_channels import RecordedPhases, recorded_phases, turned_channels
from crankorder.quantities import QualityFlag

ORDERS, FRAMES, REVS = 8, 12, 8
NAMES = ("X", "Y", "Z")


def frames_of(
    rng: np.random.Generator, lines: np.ndarray, *, name: str, rpm: float, mark: bool, names: tuple[str, ...]
) -> xr.Dataset:
    """OrderFrames with ``lines`` (channels, orders) at whole orders, in noise; without a mark any turn of the crank."""
    n_bins = ORDERS * REVS + 32
    noise = 0.01 * (rng.standard_normal((len(names), FRAMES, n_bins)) + 1j * rng.standard_normal(n_bins))
    turn = 0.0 if mark else rng.uniform()
    order = np.arange(1, ORDERS + 1)
    noise[:, :, order * REVS] += (lines * np.exp(2j * np.pi * order * turn))[:, None]
    attrs = {"recording": name, "revs_per_cycle": 1, "revs_per_frame": REVS, "cycle_known": 1}
    attrs["phase_reference"] = "index" if mark else "first_sample"
    return xr.Dataset(
        {"spectrum": (("channel", "frame", "order"), noise), "speed": ("frame", np.full(FRAMES, rpm))},
        coords={"channel": list(names), "order": np.arange(n_bins) / REVS},
        attrs=attrs,
    )


def machine(
    rng: np.random.Generator, speeds: list[float], *, mark: bool = True, names: tuple[str, ...] = NAMES
) -> list[xr.Dataset]:
    """Recordings of a machine whose orders scatter by a tenth, grow with the speed and pass one mode."""
    shape = (len(names), ORDERS)
    first = rng.lognormal(0.0, 0.7, shape) * np.exp(2j * np.pi * rng.uniform(size=shape))
    mode_hz, part = rng.uniform(60.0, 200.0), rng.standard_normal(len(names))
    made = []
    for number, rpm in enumerate(speeds):
        hertz = rpm / 60.0 * np.arange(1, ORDERS + 1)
        response = 1.0 + part[:, None] / (1.0 - (hertz / mode_hz) ** 2 + 0.04j * hertz / mode_hz)
        scatter = 1.0 + 0.1 * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
        lines = first * response * (rpm / 1000.0) ** 2 * scatter
        made.append(frames_of(rng, lines, name=f"r{number}", rpm=rpm, mark=mark, names=names))
    return made


def told(frames: list[xr.Dataset]) -> list[QualityFlag]:
    found = [recorded_phases(item, n_orders=ORDERS + 2) for item in frames]
    assert all(isinstance(one, RecordedPhases) for one in found)
    return turned_channels([one for one in found if one is not None])


def reversed_in(item: xr.Dataset, *channels: int) -> xr.Dataset:
    made = item.copy(deep=True)
    made["spectrum"][list(channels)] *= -1.0
    return made


LIKE, STEPPED = [1500.0, 1503.0, 1498.0, 1500.0], [1000.0, 1100.0, 1210.0, 1330.0, 1460.0, 1600.0]


@pytest.mark.parametrize("seed", range(15))
@pytest.mark.parametrize("speeds", [LIKE, STEPPED])
@pytest.mark.parametrize("mark", [True, False])
def test_i16_a_reversed_channel_is_named_and_nothing_is_in_sound_recordings(
    seed: int, speeds: list[float], mark: bool
) -> None:
    rng = np.random.default_rng([seed, len(speeds), mark])
    sound = machine(rng, speeds, mark=mark)
    assert told(sound) == []
    number, channel = int(rng.integers(1, len(speeds) - 1)), int(rng.integers(3))
    turned = told([reversed_in(item, channel) if k == number else item for k, item in enumerate(sound)])
    if speeds is LIKE:
        assert [(one["recording"], one["channel"]) for one in turned] == [(f"r{number}", NAMES[channel])]
    # where speeds are apart modes may hide it, or beside which channel it is, but never make it of another one
    assert {one["recording"] for one in turned} <= {f"r{number}"}
    assert all(
        NAMES[channel] in one.get("channel", one["detail"].split("channel ")[1].split(" is ")[0]) for one in turned
    )
    assert all(one["flag"] == "polarity_doubt" and one["severity"] == "suspect" for one in turned)


@pytest.mark.parametrize("seed", range(10))
def test_one_channel_alone_is_told_by_the_mark_and_not_without(seed: int) -> None:
    for mark in (True, False):
        rng = np.random.default_rng([1, seed])
        sound = machine(rng, LIKE, mark=mark, names=("X",))
        assert told(sound) == []
        turned = told([reversed_in(sound[0], 0), *sound[1:]])
        assert [one["recording"] for one in turned] == (["r0"] if mark else [])


@pytest.mark.parametrize("seed", range(10))
def test_of_two_channels_without_a_mark_either_may_be_the_reversed_one(seed: int) -> None:
    sound = machine(np.random.default_rng([2, seed]), LIKE, mark=False, names=("X", "Y"))
    [flag] = told([*sound[:2], reversed_in(sound[2], 1), sound[3]])
    assert flag["recording"] == "r2" and "channel X or Y" in flag["detail"] and "left_out" not in flag


@pytest.mark.parametrize("seed", range(10))
def test_of_two_recordings_nobody_knows_which_is_wrong(seed: int) -> None:
    sound = machine(np.random.default_rng([3, seed]), LIKE[:2])
    flags = told([sound[0], reversed_in(sound[1], 2)])
    assert [one["recording"] for one in flags] == ["r0", "r1"]
    assert all("nothing tells which" in one["detail"] and "left_out" not in one for one in flags)


@pytest.mark.parametrize("seed", range(15))
def test_i16_two_swapped_channels_are_named(seed: int) -> None:
    rng = np.random.default_rng([4, seed])
    sound = machine(rng, LIKE)
    number = int(rng.integers(len(LIKE)))
    sound[number]["spectrum"][:] = sound[number]["spectrum"].values[[1, 0, 2]]
    [flag] = told(sound)
    assert (flag["recording"], flag["flag"]) == (f"r{number}", "channels_swapped")
    assert "channels X and Y" in flag["detail"] and "left_out" not in flag


@pytest.mark.parametrize("seed", range(40))
def test_nothing_is_told_of_machines_whose_modes_lie_among_the_steps(seed: int) -> None:
    rng = np.random.default_rng([5, seed])
    speeds = np.cumprod(rng.uniform(1.02, 1.3, int(rng.integers(2, 9)))) * 700.0
    assert told(machine(rng, speeds.tolist(), mark=bool(rng.integers(2)))) == []


def test_a_mark_that_moved_is_no_polarity() -> None:
    sound = machine(np.random.default_rng(6), LIKE)
    order = sound[1]["order"].values
    sound[1]["spectrum"][:] = sound[1]["spectrum"].values * np.exp(1j * np.pi * order)  # by half a turn of the crank
    assert told(sound) == []


def test_recordings_of_unknown_speed_are_held_against_nothing() -> None:
    item = machine(np.random.default_rng(7), LIKE)[0]
    item["speed"][:] = np.nan
    assert recorded_phases(item, n_orders=ORDERS) is None
