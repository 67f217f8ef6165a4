"""What recordings beside each other tell to doubt."""

from crankorder.checks.doubts import short_recordings


def lasting(*lengths_s):
    return {f"{number}": length for number, length in enumerate(lengths_s)}


def test_a2_a_recording_that_is_shorter_than_all_others_is_told():
    [flag] = short_recordings(lasting(5.0, 5.02, 4.99, 3.1, 5.0, 5.0))
    assert (flag["recording"], flag["flag"], flag["severity"]) == ("3", "shorter_than_others", "info")
    assert "3.1 s" in flag["detail"] and "5 s" in flag["detail"]


def test_lengths_that_differ_anyway_say_nothing():
    for lengths in ((5.0, 5.0, 3.0), (5.0, 7.0, 3.0, 9.0), (5.0, 5.05, 4.95, 4.9), (0.0,) * 5, ()):
        assert short_recordings(lasting(*lengths)) == [], lengths
