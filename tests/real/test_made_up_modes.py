"""No recording gets a made-up mode: what is called one is known to be one, and what is not decidable says why."""

import numpy as np
import pytest

pytestmark = pytest.mark.slow  # the runs of all real recordings, two minutes

TOWER_HZ = (1.228, 1.436, 2.100, 4.018, 4.770, 6.682, 7.616, 9.665, 12.166, 12.598, 13.854)

# manifest, folder, file, and the natural frequencies that may be called modes: those that somebody else measured
RECORDINGS = [
    ("beam", "beam_dropbear4", "", (6.62, 41.4, 117.5)),
    ("hammer", "modal_vtb", "", (212.09,)),
    ("oma_tower", "oma_tower", "", TOWER_HZ),
    ("auth_360ppr", "auth_360ppr", "", ()),
    ("tue_genset", "tue_genset", "", ()),
    ("tue_training", "tue_genset", "", ()),
    ("gear0", "gear0", "", ()),
    ("rotor_without", "rotorbalancer", "", ()),
    ("rotor_with", "rotorbalancer", "", ()),
    ("rotorbalancer", "rotorbalancer", "", ()),
    ("ansys_accel", "ansys_accel", "", ()),
]


@pytest.mark.parametrize(("name", "folder", "only", "known_hz"), RECORDINGS)
def test_what_is_called_a_mode_was_measured_by_somebody_else_too(analysed, name, folder, only, known_hz):
    for frequency in analysed(name, folder, only).modes_hz():
        assert any(abs(frequency / known - 1.0) <= 0.01 for known in known_hz), f"{frequency:.3f} Hz is made up"


@pytest.mark.parametrize(("name", "folder", "only"), [item[:3] for item in RECORDINGS])
def test_what_is_not_decidable_is_said_to_be_so_and_why(analysed, name, folder, only):
    for record in analysed(name, folder, only).findings["modes"]:
        assert record["evidence"], f"{record['frequency_hz']:.3f} Hz without evidence"
        if record["explained_by"] == "undecided":
            assert record["undecided"]
        if record["explained_by"] == "mode":
            low, high = record["frequency_hz_ci95"]
            assert record["undecided"] == ""
            assert np.isfinite([low, high]).all() and low <= record["frequency_hz"] <= high
