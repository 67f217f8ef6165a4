"""Where the energy of a made test lies, against what was put in."""

import numpy as np
import pytest
import xarray as xr
from scipy.signal import welch

from crankorder.identify.energy import energy_shares
from crankorder.identify.explain import Cause, Causes
from crankorder.identify.found import Tone
from made.found_lines import agreed, fit, line
from made.shipped import IDENTIFY


def told_shares(*args, **kwargs):
    """The shares as JSON has them, with the fraction that nothing explains."""
    energy, fraction = energy_shares(*args, **kwargs)
    told = energy.as_dict()
    for channel in told["channels"]:
        del channel["above_band"]  # of the levels, which nobody asks here
    return told | {"unexplained_energy_fraction": fraction}


SPEEDS = np.arange(600.0, 2001.0, 100.0)
FREQUENCY = np.arange(0.0, 500.25, 0.5)
N_FRAMES = 40
HANN = np.array([1 / 36, 4 / 9, 1.0, 4 / 9, 1 / 36]) / (1 + 8 / 9 + 1 / 18)


def floor_of(frequency):
    """Spectral density with a resonance at 115 Hz."""
    x = frequency / 115.0
    return 1e-3 / ((1 - x**2) ** 2 + (0.03 * x) ** 2 + 0.05)


def campbell(lines=(), *, speeds=SPEEDS, seed=0, n_channels=1, cells=()):
    """CampbellMap of noise under ``floor_of``, of ``lines`` (frequency by speed, amplitude) and of single ``cells``."""
    rng = np.random.default_rng(seed)
    shape = (n_channels, len(speeds), len(FREQUENCY))
    psd = floor_of(FREQUENCY) * rng.gamma(N_FRAMES, 1 / N_FRAMES, shape)
    for frequency_of, amplitude in lines:
        for row, rpm in enumerate(speeds):
            at = round(frequency_of(rpm) / 0.5)
            if 2 <= at < len(FREQUENCY) - 2:
                psd[:, row, at - 2 : at + 3] += amplitude**2 / 2 / 0.5 * HANN
    for row, at, energy in cells:
        psd[:, row, at] += energy / 0.5
    names = [chr(65 + k) for k in range(n_channels)]
    return xr.Dataset(
        {"psd": (("channel", "speed", "frequency"), psd), "n_frames": ("speed", np.full(len(speeds), N_FRAMES))},
        coords={"channel": names, "unit": ("channel", ["m/s2"] * n_channels), "speed": speeds, "frequency": FREQUENCY},
        attrs={"resolution_hz": 0.5, "enbw_hz": 0.75, "speed_bin_rpm": 25.0, "amplitude_scaling": "peak"},
    )


def surface(n_channels=1, *, of=floor_of):
    psd = np.tile(of(FREQUENCY), (n_channels, 1))
    return {"frequency_hz": FREQUENCY, "floor_psd": np.tile(floor_of(FREQUENCY), (n_channels, 1)), "fitted_psd": psd}


def causes(orders=(), known=(), tones=()):
    words = {True: Cause("engine kinematics", "made"), False: Cause("unexplained", "")}
    return Causes(
        {(item.channel, o.order): words[k] for o, k in zip(orders, known, strict=True) for item in o.lines},
        (),
        tuple(words[k] for k in tones),
    )


def order(k):
    return lambda rpm: k * rpm / 60


def seen(k, amplitude, *, speeds=SPEEDS):
    return agreed(k, line(k, amplitude, speed_rpm=speeds))


def shares(made, orders=(), known=(), modal=None, tones=()):
    modal = modal or fit(**surface(made.sizes["channel"]))
    return told_shares(made, made, tuple(orders), modal, causes(orders, known, tones), settings=IDENTIFY)


def total_of(record):
    return sum(record[key] for key in ("orders", "tones", "modes_and_floor", "unexplained"))


@pytest.mark.parametrize("seed", range(2))
def test_shares_add_up_to_one_and_none_is_negative(seed):
    rng = np.random.default_rng(seed)
    sizes = rng.uniform(0.0, 2.0, 6)
    orders = [seen(k, a) for k, a in zip((0.5, 1.0, 2.0, 2.03, 5.5, 9.0), sizes, strict=True)]
    tone = Tone(50.0, 0.01, "mains", {"A": (float(sizes[0]), 0.01)}, "")
    made = campbell(
        [(order(k.order), a / 2) for k, a in zip(orders, sizes, strict=True)], seed=seed, cells=[(3, 500, 9)]
    )
    modal = fit(tones=(tone,), **surface())
    (record,) = shares(made, orders, rng.random(6) < 0.5, modal, (True,))["channels"]
    assert total_of(record) == pytest.approx(1.0, abs=1e-9)
    assert min(value for key, value in record.items() if key not in ("channel", "unit")) >= 0.0
    assert record["unexplained"] == pytest.approx(record["unexplained_lines"] + record["unexplained_cells"])


@pytest.mark.parametrize(("known", "where"), [(True, "tones"), (False, "unexplained_lines")])
def test_a_line_and_a_tone_have_half_their_amplitude_squared_by_their_cause(known, where):
    made = campbell([(order(2.0), 1.0), (order(5.5), 0.5), (lambda _: 200.0, 0.8)])
    modal = fit(tones=(Tone(200.0, 0.01, "tone", {"A": (0.8, 0.01)}, ""),), **surface())
    (channel,) = shares(made, [seen(2.0, 1.0), seen(5.5, 0.5)], (True, known), modal, (known,))["channels"]
    total = made["psd"].values.sum(axis=-1).mean() * 0.5
    assert channel["total"] == pytest.approx(total, rel=0.02)  # the first cells, the mean, are left out
    assert channel["orders"] * channel["total"] == pytest.approx(0.5 + 0.125 * known, rel=0.02)
    assert channel[where] * channel["total"] == pytest.approx(0.32 + 0.125 * (not known), rel=0.02)


def test_noise_alone_is_broadband_but_for_the_stated_chance():
    made = [shares(campbell(seed=seed)) for seed in range(60)]
    assert all(item["cells_judged"] for item in made)
    # 1 % is stated; 3 of 300 were measured, and 4 of 60 would have a chance of 0.3 %
    assert sum(item["unexplained_energy_fraction"] > 0.0 for item in made) < 4
    assert all(item["channels"][0]["modes_and_floor"] > 0.9999 for item in made)


def test_a_line_that_nobody_found_counts_as_unexplained():
    made = campbell([(order(2.0), 1.0), (order(7.3), 1.0)])
    record = shares(made, [seen(2.0, 1.0)], (True,))
    (channel,) = record["channels"]
    # all but what hides in the floor at the skirts of its main lobe, and beside the resonance
    assert channel["unexplained_cells"] * channel["total"] == pytest.approx(0.5, rel=0.1)
    assert channel["unexplained_lines"] == 0.0
    assert record["unexplained_energy_fraction"] == pytest.approx(0.5, rel=0.06)


def test_a_hump_that_the_fit_leaves_out_counts_as_unexplained():
    made = campbell()
    without = fit(**surface(of=lambda f: np.where(f < 150.0, np.minimum(floor_of(f), 1e-3), floor_of(f))))
    (channel,) = shares(made, modal=without)["channels"]
    missing = np.maximum(0.0, floor_of(FREQUENCY) - 1e-3)[FREQUENCY < 150.0].sum() / floor_of(FREQUENCY).sum()
    assert channel["unexplained_cells"] == pytest.approx(missing, rel=0.1)


def test_where_a_line_is_not_seen_it_has_what_is_there():
    loud, made = SPEEDS >= 1500.0, campbell()
    made["psd"][:, loud] = campbell([(order(3.0), 1.0)])["psd"][:, loud]
    (channel,) = shares(made, [seen(3.0, 1.0, speeds=SPEEDS[loud])], (True,))["channels"]
    assert channel["orders"] * channel["total"] == pytest.approx(0.5 * loud.mean(), rel=0.02)


def test_a_speed_without_data_in_one_channel_changes_nothing_else():
    whole = campbell([(order(2.0), 1.0)], n_channels=2)
    holed = whole.copy(deep=True)
    holed["psd"][0, 4] = np.nan
    one, other = (shares(each, [seen(2.0, 1.0)], (True,))["channels"] for each in (whole, holed))
    assert other[1] == one[1]
    assert other[0]["orders"] == pytest.approx(one[0]["orders"], rel=0.02)
    assert total_of(other[0]) == pytest.approx(1.0)


def test_an_amplitude_beyond_what_the_map_holds_takes_no_more_than_that():
    (channel,) = shares(campbell(), [seen(3.0, 100.0)], (True,))["channels"]
    assert 0.0 < channel["orders"] < 0.1
    assert total_of(channel) == pytest.approx(1.0)


def test_without_a_fitted_surface_the_lines_alone_are_judged():
    record = shares(campbell([(order(2.0), 1.0), (order(7.3), 1.0)]), [seen(2.0, 1.0)], (False,), fit())
    assert not record["cells_judged"]
    assert record["channels"][0]["unexplained_cells"] == 0.0
    assert record["unexplained_energy_fraction"] == 1.0


def test_a_test_without_speeds_is_judged_by_its_order_map():
    lines = [(order(2.0), 1.0), (order(5.5), 0.5)]
    order_map = order_map_of(lines, speeds=SPEEDS[:1]).assign_coords(speed=[np.nan])
    empty = campbell().isel(speed=slice(0, 0))
    orders = [seen(k, a, speeds=[np.nan]) for k, a in ((2.0, 1.0), (5.5, 0.5))]
    record = told_shares(empty, order_map, tuple(orders), fit(), causes(orders, (True, False)), settings=IDENTIFY)
    (channel,) = record["channels"]
    assert channel["orders"] * channel["total"] == pytest.approx(0.5, rel=0.02)
    assert channel["unexplained_lines"] * channel["total"] == pytest.approx(0.125, rel=0.02)
    assert record["unexplained_energy_fraction"] == pytest.approx(0.2, rel=0.02)
    assert total_of(channel) == pytest.approx(1.0)


def order_map_of(lines=(), *, speeds=SPEEDS, n_frames=30, modes=()):
    """OrderMap of noise of 1e-4 per hertz and of ``lines`` (frequency by speed, amplitude) without scatter.

    ``modes`` (frequency, damping ratio, height over that noise) ring by noise.
    """
    rng, axis = np.random.default_rng(0), np.arange(0.0, 20.01, 1 / 16)
    hertz = axis * speeds[:, None] / 60
    over = 1.0 + sum(height / (1.0 + ((hertz / at - 1.0) / damping) ** 2) for at, damping, height in modes)
    mean = 1e-4 * speeds[:, None] / 60 / 16 * np.broadcast_to(over, hertz.shape)
    frames = rng.exponential(1.0, (n_frames, *mean.shape))
    energy = mean * frames.mean(axis=0)
    ratio = (frames**2).mean(axis=0) / frames.mean(axis=0) ** 2
    kurtosis = ((n_frames + 1) * ratio - 2 * n_frames) / (n_frames - 1)
    for frequency_of, amplitude in lines:
        for row, rpm in enumerate(speeds):
            away = 16 * (axis - 60 * frequency_of(rpm) / rpm)
            shape = np.sinc(away) + 0.5 * (np.sinc(away - 1) + np.sinc(away + 1))
            energy[row] += amplitude**2 / 2 / 1.5 * shape**2
            kurtosis[row, np.abs(away) < 3] = -0.99
    amplitude = np.sqrt(2 * 1.5 * energy)[None]
    return xr.Dataset(
        {
            "amplitude": (("channel", "speed", "order"), amplitude),
            "spectral_kurtosis": (("channel", "speed", "order"), kurtosis[None]),
            "n_independent": ("speed", np.full(len(speeds), float(n_frames))),
        },
        coords={"channel": ["A"], "unit": ("channel", ["m/s2"]), "speed": speeds, "order": axis},
        attrs={"enbw_bins": 1.5, "amplitude_scaling": "peak", "revs_per_cycle": 1},
    )


def test_what_lies_above_the_campbell_map_is_read_in_the_order_map_and_all_adds_up():
    """Order 15 at 425, 600 and 725 Hz, and a line of 650 Hz, which order 20 reaches at two of the speeds."""
    speeds = np.array([1700.0, 2400.0, 2900.0])
    lines = [(order(15.0), 0.8), (lambda _: 650.0, 0.6)]
    made = order_map_of(lines, speeds=speeds)
    below, lined = campbell(lines, speeds=speeds), (seen(15.0, 0.8, speeds=speeds),)
    record = told_shares(below, made, lined, fit(**surface()), causes(lined, (True,)), settings=IDENTIFY)
    (channel,) = record["channels"]
    total = 0.5 * below["psd"].values[..., 2:].sum(axis=-1).mean()
    hertz = made["order"].values * speeds[:, None] / 60
    total += ((made["amplitude"].values[0] ** 2 / 3) * (hertz > 500.25)).sum(axis=-1).mean()
    assert record["band_hz"] == pytest.approx(20.0 * speeds[-1] / 60)
    assert channel["total"] == pytest.approx(total, rel=0.02)
    assert total_of(channel) == pytest.approx(1.0, abs=1e-9)
    assert channel["orders"] * channel["total"] == pytest.approx(0.8**2 / 2, rel=0.03)
    assert channel["unexplained"] * channel["total"] == pytest.approx(2 / 3 * 0.6**2 / 2, rel=0.03)


def test_natural_frequencies_above_the_campbell_map_are_no_lines():
    speeds = np.array([1700.0, 2900.0])
    above = order_map_of(speeds=speeds, modes=((560.0, 0.005, 1e4), (640.0, 0.02, 30.0), (830.0, 0.04, 1e3)))
    below = campbell(speeds=speeds)
    (channel,) = told_shares(below, above, (), fit(**surface()), causes(), settings=IDENTIFY)["channels"]
    assert channel["unexplained"] == 0.0


def test_amplitudes_given_as_root_mean_square_make_the_same_shares():
    made = campbell([(order(2.0), 1.0)])
    as_rms = made.assign_attrs(amplitude_scaling="rms")
    one = shares(made, [seen(2.0, 1.0)], (True,))["channels"]
    other = shares(as_rms, [seen(2.0, np.sqrt(0.5))], (True,))["channels"]
    assert one[0]["orders"] == pytest.approx(other[0]["orders"])


def test_lines_closer_than_a_bin_have_the_energy_of_their_amplitudes():
    """Parseval: three lines within a bin are told a² / 2 each, whichever of them is known and wherever cells lie."""
    rng = np.random.default_rng([0, 6])
    sizes, speeds = rng.uniform(0.2, 1.0, 3), SPEEDS[:1]
    places = 2.0 + 0.01 * np.array([0.0, *np.cumsum(rng.uniform(0.5, 2.0, 2))])
    step, n = 0.5, 4000
    psd = campbell(speeds=speeds)
    time_s, signal = np.arange(n * 40) / (n * step), np.zeros(n * 40)
    for place, size in zip(places, sizes, strict=True):
        signal += size * np.cos(2.0 * np.pi * (place * speeds[0] / 60.0 * time_s + rng.random()))
    psd["psd"][0, 0] += welch(signal, n * step, "hann", n, detrend=False)[1][: len(FREQUENCY)]
    lines = [seen(float(k), float(a), speeds=speeds) for k, a in zip(places, sizes, strict=True)]
    told = shares(psd, lines, (True, False, False))
    wanted = np.square(sizes[1:]).sum() / np.square(sizes).sum()
    assert told["unexplained_energy_fraction"] == pytest.approx(wanted, rel=0.03)
