"""Waves of known lines in frames and bins, against one line and one frame at a time."""

from __future__ import annotations

import numpy as np

from crankorder.identify.known_lines import Held, waves_of


def test_waves_of_all_lines_are_those_of_each_in_each_frame_and_bin() -> None:
    rng = np.random.default_rng(4)
    revs, axis, turn = 16, np.arange(200) / 16.0, np.cumsum(rng.uniform(4.0, 9.0, 12)) - 20.0
    time_s = np.cumsum(rng.uniform(0.2, 0.3, 12))
    held = Held(np.zeros((1, 12, 200), dtype=complex), axis, turn, time_s, revs, 1500.0, ("a",))
    bins = np.arange(60, 75)
    places = [
        (float(hertz), float(turns)) for hertz, turns in zip(rng.uniform(-5, 110, 6), (0, 0, 2, 4, 0, 4), strict=True)
    ]
    places.append((0.0, 65.0 / 16.0))  # on bins beside it the response has a pole of its formula
    made = waves_of(held, bins, places).reshape(12, 15, len(places))
    pace = np.gradient(time_s, turn)
    for frame in range(12):
        for number, place in enumerate(bins):
            for line, (hertz, turns) in enumerate(places):
                away = (turns + hertz * pace[frame] - axis[place]) * revs
                near = abs(abs(away) - 1.0) < 1e-6
                size = 0.5 if near else np.sinc(away) / (1.0 - away**2)
                phase = turns * turn[frame] + hertz * time_s[frame] - axis[place] * turn[frame]
                wanted = size * np.exp(2j * np.pi * phase)
                np.testing.assert_allclose(made[frame, number, line], wanted, rtol=1e-9, atol=1e-12)
