"""The envelope's order spectra show the lines that bearings would make and ring those that were found."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from crankorder.plot.drawing import Drawing, Rings
from crankorder.plot.painter import picture_bytes
from crankorder.report.envelope_figure import envelope_figure
from crankorder.report.pictures import pictures_of
from made.typed import from_dicts

envelope_figure, pictures_of = map(
    from_dicts,
    (envelope_figure, pictures_of),
)


def _rings(figure: Drawing) -> list[Rings]:
    return [part for part in figure.parts if isinstance(part, Rings) and part.name == "found"]


def test_expected_lines_are_marked_in_every_channel_and_the_found_one_is_ringed_at_its_peak(
    full: Any, make_envelope: Callable[..., Any], settings: Any
) -> None:
    envelope = make_envelope(("X", "Y", "Z"))
    figure = envelope_figure(envelope, full, settings=settings)
    assert sorted(stroke.values[0][0] for stroke in figure.strokes("expected")) == 3 * [3.585] + 3 * [5.5]
    (ring,) = _rings(figure)
    mean = (envelope["amplitude"].sel(channel="Z") ** 4).mean("speed") ** 0.25
    near = mean.sel(order=slice(3.4, 3.7))
    assert ring.values is not None
    assert (ring.values[0][0], ring.values[1][0]) == (3.556, pytest.approx(float(near.max())))
    multiples = [stroke.values[0][0] for stroke in figure.strokes("multiple-")]
    assert multiples == pytest.approx([2 * 3.556, 3 * 3.556, 4 * 3.556])
    sidebands = [stroke.values[0][0] for stroke in figure.strokes("sideband")]
    assert sidebands == pytest.approx([1.556, 2.556, 4.556, 5.556])
    words = {words.text for words in figure.words}
    assert {"BPFO 3.585", "3.556", "its sidebands", "N·fs 5.5", "band 2000–4000 Hz", "found"} <= words


def test_the_mean_is_by_power_of_the_squared_envelope_and_unknown_speeds_take_no_part(
    full: Any, make_envelope: Callable[..., Any], settings: Any
) -> None:
    envelope = make_envelope(("Z",), speeds=2)
    envelope["amplitude"][0, 0], envelope["amplitude"][0, 1] = 3.0, 4.0
    (line,) = envelope_figure(envelope, full, settings=settings).strokes("spectrum")
    np.testing.assert_allclose(line.values[1], ((3**4 + 4**4) / 2) ** 0.25)
    envelope["amplitude"][0, 1] = np.nan
    (line,) = envelope_figure(envelope, full, settings=settings).strokes("spectrum")
    np.testing.assert_allclose(line.values[1], 3.0)


def test_nothing_found_is_said(full: Any, make_envelope: Callable[..., Any], settings: Any) -> None:
    envelope = make_envelope(("Z",), speeds=1)
    full["bearings"] = [record for record in full["bearings"] if record["seen_in"] == "vibration"]
    figure = envelope_figure(envelope, full, settings=settings)
    assert not _rings(figure)
    (subtitle,) = (words.text for words in figure.words if words.name == "subtitle")
    assert "No bearing line stands over the floor." in subtitle
    assert "speeds" not in subtitle
    full["bearings"] = []
    (subtitle,) = (
        words.text for words in envelope_figure(envelope, full, settings=settings).words if words.name == "subtitle"
    )
    assert "No bearing was named, or none" in subtitle


@pytest.mark.cases(1)
@pytest.mark.parametrize("factor", [1e290, 0.0, 1e-290])
def test_any_size_becomes_a_picture(factor: float, full: Any, make_envelope: Callable[..., Any], settings: Any) -> None:
    envelope = make_envelope(("X", "Z"))
    for name in ("amplitude", "floor"):
        envelope[name] = envelope[name] * factor
    assert picture_bytes(envelope_figure(envelope, full, settings=settings), dpi=50).startswith(b"\x89PNG")


def test_it_is_drawn_only_where_there_is_an_envelope(
    full: Any, make_envelope: Callable[..., Any], settings: Any
) -> None:
    envelope = make_envelope(("X",))
    for given, wanted in ((envelope, ["envelope.png"]), (envelope.isel(speed=slice(0)), [])):
        assert list(pictures_of({"envelope_map": given}, full, settings=settings, name_of=str)) == wanted


@pytest.mark.slow
def test_names_of_bearings_are_whole_where_there_is_room_and_else_told_apart(
    full: Any, make_envelope: Callable[..., Any], settings: Any
) -> None:
    record = next(one for one in full["bearings"] if one["seen_in"] == "envelope")

    def labels(names: list[str], lines: int) -> list[str]:
        full["bearings"] = [
            {**record, "name": name, "seen_in": "vibration", "order": None, "order_expected": 2.0 + 3 * k + 0.4 * n}
            for n, name in enumerate(names)
            for k in range(lines)
        ]
        figure = envelope_figure(make_envelope(("Z",), speeds=1), full, settings=settings)
        return [words.text for words in figure.words if words.text.startswith(record["line"])]

    names = ["gearbox, intermediate shaft, drive end", "gearbox, intermediate shaft, fan end"]
    assert [any(name in text for text in labels(names, 1)) for name in names] == [True, True]
    crowded = labels(names, 4)
    assert len(crowded) == 8
    assert len({text.rpartition(" ")[0] for text in crowded}) == 2
