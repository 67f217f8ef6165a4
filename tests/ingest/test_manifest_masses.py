"""Transfer paths and added masses of a manifest are checked, and their tables read."""

from pathlib import Path

import pytest

from crankorder.errors import ManyErrors
from crankorder.ingest.manifest import Manifest
from made.recordings import read_manifest

PRESSURE = '[[channels]]\nname = "P"\nunit = "bar"\n'
PATH = '[[transfer_paths]]\nchannel = "Z"\ndirection = "Z"\n'
RIGID = PATH + "apparent_mass_kg = 330.0\nfrequency_range_hz = [5.0, 50.0]\nuncertainty_percent = 5\n"


def read(folder: Path, text: str) -> Manifest:
    return read_manifest(folder, PRESSURE + text)


def faults(folder: Path, text: str) -> str:
    with pytest.raises(ManyErrors) as caught:
        read(folder, text)
    return str(caught.value)


def test_paths_and_masses_are_read(tmp_path):
    text = RIGID + (
        "[[added_masses]]\nmass_g = 20.0\nradius_mm = 50.0\nangle_deg = 90.0\n"
        '[[added_masses]]\nmass_g = 116\non = "piston"\n'
    )
    manifest = read(tmp_path, text)
    (path,) = manifest.transfer_paths
    assert (path.apparent_mass_kg, path.frequency_range_hz, path.uncertainty_percent) == (330.0, (5.0, 50.0), 5.0)
    assert [mass.on for mass in manifest.added_masses] == ["crank", "piston"]


def test_a_table_is_read_from_beside_the_manifest(tmp_path):
    (tmp_path / "z.csv").write_text("frequency_hz, real, imag\n5, 0.003, 0\n50, 0.004, -1e-4\n", encoding="utf-8")
    (path,) = read(tmp_path, PATH + 'table = "z.csv"\n').transfer_paths
    assert path.points == ((5.0, 0.003, 0.0), (50.0, 0.004, -1e-4))
    assert path.holds_hz == (5.0, 50.0)


def test_a_table_with_a_fault_is_refused_by_name(tmp_path):
    rows = [
        ("f,r,i\n1,2,3\n", "frequency_hz, real, imag"),
        ("", "wrong columns"),
        ("frequency_hz,real,imag\n1,2\n3,4,5\n", "line 2"),
        ("frequency_hz,real,imag\n1,2,x\n", "line 2"),
        ("frequency_hz,real,imag\n1,2,3\n", "two or more rows"),
        ("frequency_hz,real,imag\n2,2,3\n1,2,3\n", "ascending"),
        ("frequency_hz,real,imag\n1,nan,3\n2,2,3\n", "finite"),
    ]
    for text, words in rows:
        (tmp_path / "z.csv").write_text(text, encoding="utf-8")
        message = faults(tmp_path, PATH + 'table = "z.csv"\n')
        assert words in message and "z.csv" in message and "transfer_paths.0.table" in message


def test_a_table_elsewhere_is_refused(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (tmp_path / "outside.csv").write_text("frequency_hz,real,imag\n1,1,1\n2,1,1\n", encoding="utf-8")
    for name in ["missing.csv", "../outside.csv", "/etc/passwd", "a\\u0000b"]:
        assert "transfer_paths.0.table" in faults(folder, PATH + f'table = "{name}"\n')


def test_what_is_wrong_is_said_with_its_key(tmp_path):
    rows = [
        (RIGID.replace('channel = "Z"', 'channel = "W"'), "no such channel"),
        (RIGID.replace('channel = "Z"', 'channel = "P"'), "not of pressure"),
        (RIGID + RIGID, "a second path from Z to Z"),
        (PATH, "one of apparent_mass_kg, table or modes"),
        (PATH + "apparent_mass_kg = 330.0\n", "where the path holds"),
        (RIGID.replace("[5.0, 50.0]", "[50.0, 5.0]"), "must ascend"),
        (RIGID.replace("apparent_mass_kg = 330.0", "apparent_mass_kg = -3.0"), "greater than 0"),
        (RIGID.replace('direction = "Z"', 'direction = "up"'), "'X', 'Y' or 'Z'"),
        (RIGID.replace("apparent_mass_kg", "aparent_mass_kg"), "apparent_mass_kg"),
        ("[[added_masses]]\nmass_g = 20.0\n", "radius_mm"),
        ("[[added_masses]]\nmass_g = 0.0\nradius_mm = 5.0\n", "0 g"),
        ('[[added_masses]]\nmass_g = 2.0\non = "piston"\nangle_deg = 5.0\n', "neither"),
    ]
    for text, words in rows:
        message = faults(tmp_path, text)
        assert (
            words in message and ("transfer_paths" in message or "added_masses" in message) and "run.toml:" in message
        )
