"""Sidebands, meshes and shafts of their own: lines that other lines explain."""

from __future__ import annotations

import numpy as np
import pytest

from crankorder.identify.sidebands import meshes, other_shafts, sidebands


def modulated(carrier: float, spacing: float, depth: float) -> tuple[list[float], list[float]]:
    """Places and amplitudes of (1 + depth cos) · cos: the carrier and both sides at half the depth."""
    return [carrier - spacing, carrier, carrier + spacing], [depth / 2, 1.0, depth / 2]


def test_amplitude_modulation_by_the_shaft_makes_a_pair_about_its_carrier():
    places, amplitudes = modulated(3.317, 1.0, 0.6)
    found = sidebands(places, [1e-3] * 3, amplitudes, spacings={"shaft": 1.0}, highest=20.0)
    assert [(item.at, item.carrier, item.multiple, item.spacing_name) for item in found] == [
        (0, 1, -1, "shaft"),
        (2, 1, 1, "shaft"),
    ]
    assert [item.spacing for item in found] == pytest.approx([1.0, 1.0])


def test_a_deep_modulation_has_second_sidebands_of_the_same_spacing():
    places = [5.33 - 0.8, 5.33 - 0.4, 5.33, 5.33 + 0.4, 5.33 + 0.8]
    found = sidebands(places, [1e-3] * 5, [0.1, 0.3, 1.0, 0.3, 0.1], spacings={"cage": 0.4}, highest=20.0)
    assert {item.at: item.multiple for item in found} == {0: -2, 1: -1, 3: 1, 4: 2}
    assert all(item.spacing == pytest.approx(0.4) for item in found)


def test_a_single_line_beside_a_stronger_one_is_no_sideband():
    assert sidebands([2.317, 3.317], [1e-3] * 2, [0.3, 1.0], spacings={"shaft": 1.0}, highest=20.0) == []


def test_lines_stronger_than_the_one_between_them_are_not_its_sidebands():
    assert sidebands([2.317, 3.317, 4.317], [1e-3] * 3, [2.0, 1.0, 2.0], spacings={"shaft": 1.0}, highest=20.0) == []


def test_lopsided_lines_are_no_pair():
    assert sidebands([2.3, 3.317, 4.317], [1e-3] * 3, [0.3, 1.0, 0.3], spacings={"shaft": 1.0}, highest=20.0) == []


def test_lines_that_lie_anywhere_are_seldom_called_sidebands():
    rng = np.random.default_rng(5)
    false = 0
    for _ in range(400):
        places, amplitudes = rng.uniform(0.5, 20.0, 6).tolist(), rng.uniform(0.1, 1.0, 6).tolist()
        false += bool(sidebands(places, [2e-3] * 6, amplitudes, spacings={"shaft": 1.0, "half": 0.5}, highest=20.0))
    assert false <= 24  # 3 % are seen; 6 % would be too many


def test_a_mesh_stands_over_its_neighbours_and_harmonics_of_a_shaft_do_not():
    gear = {1: 2.0, 2: 1.0, 21: 0.05, 22: 0.2, 23: 1.0, 24: 0.3, 25: 0.1}
    assert meshes(gear) == [23]
    assert meshes({k: 1.0 / k for k in range(1, 20)}) == []
    assert meshes(dict.fromkeys(range(1, 20), 1.0)) == []
    assert meshes({22: 0.2, 23: 1.0}) == []  # one side alone


def test_a_second_shaft_is_told_by_its_multiples():
    places = [1.005, 2.010, 3.015, 4.71]
    assert other_shafts(places, [5e-4] * 4) == {0: (0, 1), 1: (0, 2), 2: (0, 3)}
    assert other_shafts([1.005, 2.017], [5e-4] * 2) == {}
    assert other_shafts([1.005], [5e-4]) == {}
    assert other_shafts([1.0, 2.0], [0.2] * 2) == {}  # errors so large that any line would fit


def test_the_largest_of_a_whole_row_of_low_harmonics_is_no_mesh() -> None:
    harmonics = dict.fromkeys(range(1, 13), 1.0)
    assert meshes(harmonics | {6: 5.0}) == []  # a V12 fires six times per turn
    assert meshes({k: size for k, size in harmonics.items() if k > 2} | {6: 5.0}) == [6]
