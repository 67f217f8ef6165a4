"""A manifest is read strictly: every fault at once, with its key and line."""

import json
import subprocess
import sys

import pytest

from crankorder.errors import ManyErrors, RequestError
from crankorder.ingest.manifest import Manifest, key_lines, load_manifest
from crankorder.quantities import schema_of
from made.recordings import read_manifest

GOOD = """schema_version = 1
[test]
name = "second configuration, motoring"
engine = "msu-optical-second"
cycle = "four-stroke"
[recordings]
files = ["rpm_*.h5"]
[recordings.speed_rpm]
"rpm_300.h5" = 300
[sampling]
domain = "time"
rate_hz = 50000
[[channels]]
name = "Z"
source = "acc_z"
quantity = "acceleration"
unit = "m/s²"
sensitivity = "100 mV/g"
direction = "+Z"
[encoder]
source = "encoder"
kind = "square"
pulses_per_rev = 360
index = "index"
edge = "rising"
[[bearings]]
name = "jack shaft"
shaft_ratio = 0.5
rolling_elements = 11
ball_over_pitch = 0.2
"""


def written(folder, text):
    (folder / "run.toml").write_text(text, encoding="utf-8")
    return folder


def faults_of(folder, text):
    with pytest.raises(ManyErrors) as caught:
        load_manifest(written(folder, text))
    return [str(fault) for fault in caught.value.faults]


def test_the_manifest_of_the_design_is_read(tmp_path):
    manifest = load_manifest(written(tmp_path, GOOD))
    assert manifest.channels[0].unit == "m/s2"
    assert manifest.encoder.missing_teeth == 0
    assert manifest.bearings[0].ball_over_pitch == 0.2
    assert manifest.speed_of(tmp_path / "rpm_300.h5") == 300.0
    assert manifest.speed_of(tmp_path / "rpm_400.h5") is None
    assert load_manifest(tmp_path / "data", tmp_path / "run.toml").test == manifest.test  # it may live elsewhere


def test_a_missing_manifest_names_the_command_that_drafts_one(tmp_path):
    with pytest.raises(RequestError, match=r"run\.toml: there is no manifest.*crankorder init"):
        load_manifest(tmp_path)


def test_a_syntax_error_is_told_with_line_and_column(tmp_path):
    with pytest.raises(RequestError, match=r"run\.toml:2:7: not valid TOML"):
        load_manifest(written(tmp_path, "schema_version = 1\n[test]] \n"))


def test_all_faults_of_one_manifest_are_listed_with_key_and_line(tmp_path):
    text = GOOD.replace("index = ", "idnex = ").replace("= 360", '= "360"').replace('"100 mV/g"', '"-100 mV/g"')
    faults = faults_of(tmp_path, text.replace('unit = "m/s²"\n', ""))
    assert len(faults) == 4
    text = "\n".join(faults)
    assert "run.toml:13: channels.0.unit: this key is missing. Add it\n" in text
    assert "run.toml:17: channels.0.sensitivity: the sensitivity must be above 0; found '-100 mV/g'" in text
    assert "run.toml:22: encoder.pulses_per_rev: must be a valid integer; found '360'" in text
    assert "run.toml:23: encoder.idnex: unknown key" in text
    assert "Did you mean 'index'?" in text


KIND, TEETH = 'kind = "square"', "pulses_per_rev = 360"
SECOND = '[[channels]]\nname = "Z"\nunit = "V"\n[encoder]'
NUMBERS = [("ratio", "1e300"), ("ratio", "1e-300"), ("index_to_tdc_deg", "1e308"), ("missing_teeth", "5000000000")]
CONTRADICTIONS = [
    *(("= 50000", f"= {rate}", "run.toml:12: sampling.rate_hz") for rate in ("nan", "-inf", "-1.0", "0")),
    *((TEETH, f"pulses_per_rev = {n}", "encoder.pulses_per_rev: must be") for n in ("9" * 26, "1000000000")),
    *((TEETH, f"{TEETH}\n{key} = {value}", f"encoder.{key}: must be") for key, value in NUMBERS),
    ("100 mV/g", "77 mV/bar", "channels.0.sensitivity: bar (pressure) cannot become m/s2 (acceleration)"),
    ('"acceleration"', '"sound pressure"', "channels.0.quantity: quantity and unit disagree: m/s2 is a unit of"),
    (TEETH, f'{TEETH}\npattern = "60-2"', "stated by pattern and by pulses_per_rev"),
    (TEETH, 'pattern = "36-2-l"', "unknown wheel; found '36-2-l'"),
    (TEETH, "tooth_angles_deg = [0, 90, 80]", "tooth angles must rise"),
    (TEETH, "tooth_angles_deg = [10, 90]", "tooth angles start at 0"),
    (TEETH, f"{TEETH}\ncam_to_tdc_deg = 3.0", "cam_to_tdc_deg needs cam"),
    ('source = "encoder"\n', "", "an encoder of kind 'square' needs source"),
    (TEETH, "pulses_per_rev = 2\nmissing_teeth = 2", "more teeth are missing than the wheel has"),
    ('domain = "time"', 'domain = "crank_angle"', "samples by crank angle need samples_per_rev"),
    ("rolling_elements = 11\n", "", "a bearing needs a designation, rolling_elements and ball_over_pitch, or"),
    ("[encoder]", SECOND, "two channels have the same name"),
    (TEETH, f"{TEETH}\nexpected_rpm = [900.0, 800.0]", "the lowest and the highest speed"),
    (TEETH, f"{TEETH}\nexpected_rpm = [800.0, 900.0]", "expected_rpm goes with kind"),
    (TEETH, f'{TEETH}\nfile = "../a.csv"', "beside the recording"),
    (TEETH, f'{TEETH}\nfile = "a.csv"', "a file of its own holds times"),
    (TEETH, f"{TEETH}\noffset_s = 1.0", "offset_s is that of the file of pulses"),
    (f'{KIND}\n{TEETH}\nindex = "index"', 'kind = "angle"', "edge says nothing of kind 'angle'"),
    (f"{KIND}\n{TEETH}", 'kind = "count"', "an encoder of kind 'count' needs pulses_per_rev"),
]  # fmt: skip


def test_keys_that_contradict_or_need_each_other_are_refused_with_their_place(tmp_path):
    for old, new, words in CONTRADICTIONS:
        assert words in "\n".join(faults_of(tmp_path, GOOD.replace(old, new))), (old, new)


def test_a_newer_schema_is_refused(tmp_path):
    with pytest.raises(RequestError, match=r"newer crankorder; found 2; allowed: 1\. Update crankorder"):
        load_manifest(written(tmp_path, GOOD.replace("schema_version = 1", "schema_version = 2")))


def test_no_bytes_get_through_as_anything_but_a_request_error(tmp_path):
    for content in [b"\xff\xfe\x00", b"", b"\0\0\0\0", b"[" * 100_000, b"a = " + b"[" * 5000]:
        (tmp_path / "run.toml").write_bytes(content)
        with pytest.raises(RequestError, match=r"run\.toml"):
            load_manifest(tmp_path)


def test_lines_are_found_below_strings_and_arrays_of_several_lines():
    lines = key_lines(
        'a = """\n[x]\nb = 1\n"""\nc = [\n  "d = 1",\n]\n[t]\n"k.h5" = 1 # [z]\n[[u]]\nv = 1\n[[u]]\nv = 2\n'
    )
    assert lines == {"a": 1, "c": 5, "t": 8, "t.k.h5": 9, "u": 10, "u.0": 10, "u.0.v": 11, "u.1": 12, "u.1.v": 13}


def test_a_wrong_manifest_is_refused_before_numpy_is_loaded(tmp_path):
    written(tmp_path, GOOD.replace("index = ", "idnex = "))
    code = (
        "import sys\nfrom pathlib import Path\nfrom crankorder.ingest.check import check_folder\n"
        "from crankorder.settings import load_settings\n"
        f"faults = check_folder(Path({str(tmp_path)!r}), settings=load_settings().ingest)\n"
        "heavy = {'numpy', 'xarray', 'h5py', 'pandas', 'scipy'} & set(sys.modules)\n"
        "print(len(faults), sorted(heavy))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1 []"


def test_the_schema_file_is_that_of_the_model():
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **Manifest.model_json_schema()}
    assert json.dumps(schema_of("manifest"), sort_keys=True) == json.dumps(schema, sort_keys=True)


# Transfer paths, added masses and the motor of a manifest are checked, and their tables read.


PATH = '[[transfer_paths]]\nchannel = "Z"\ndirection = "Z"\n'
RIGID = PATH + "apparent_mass_kg = 330.0\nfrequency_range_hz = [5.0, 50.0]\nuncertainty_percent = 5\n"


def faults(folder, text):
    with pytest.raises(ManyErrors) as caught:
        read_manifest(folder, text + '[[channels]]\nname = "P"\nunit = "bar"\n')
    return str(caught.value)


def test_paths_masses_and_a_motor_are_read(tmp_path):
    assert read_manifest(tmp_path, "").motor is None
    text = RIGID + (
        "[motor]\nsupply_hz = 50.0\npoles = 4\nrotor_bars = 44\n"
        "[[added_masses]]\nmass_g = 20.0\nradius_mm = 50.0\nangle_deg = 90.0\n"
        '[[added_masses]]\nmass_g = 116\non = "piston"\n'
    )
    manifest = read_manifest(tmp_path, text)
    (path,) = manifest.transfer_paths
    assert (path.apparent_mass_kg, path.frequency_range_hz, path.uncertainty_percent) == (330.0, (5.0, 50.0), 5.0)
    assert [mass.on for mass in manifest.added_masses] == ["crank", "piston"]
    motor = manifest.motor
    assert (motor.supply_hz, motor.poles, motor.rotor_bars, motor.shaft_ratio) == (50.0, 4, 44, 1)


def test_a_table_is_read_from_beside_the_manifest(tmp_path):
    (tmp_path / "z.csv").write_text("frequency_hz, real, imag\n5, 0.003, 0\n50, 0.004, -1e-4\n", encoding="utf-8")
    (path,) = read_manifest(tmp_path, PATH + 'table = "z.csv"\n').transfer_paths
    assert path.points == ((5.0, 0.003, 0.0), (50.0, 0.004, -1e-4))
    assert path.holds_hz == (5.0, 50.0)


def test_a_table_elsewhere_or_with_a_fault_is_refused_by_name(tmp_path):
    rows = [
        ("f,r,i\n1,2,3\n", "frequency_hz, real, imag"), ("", "wrong columns"),
        ("frequency_hz,real,imag\n1,2\n3,4,5\n", "line 2"),
        ("frequency_hz,real,imag\n1,2,3\n", "two or more rows"),
        ("frequency_hz,real,imag\n2,2,3\n1,2,3\n", "ascending"), ("frequency_hz,real,imag\n1,nan,3\n2,2,3\n", "finite"),
    ]  # fmt: skip
    (tmp_path / "run").mkdir()
    (tmp_path / "outside.csv").write_text("frequency_hz,real,imag\n1,1,1\n2,1,1\n", encoding="utf-8")
    for name in ["missing.csv", "../outside.csv", "/etc/passwd", "a\\u0000b"]:
        assert "transfer_paths.0.table" in faults(tmp_path / "run", PATH + f'table = "{name}"\n')
    for text, words in rows:
        (tmp_path / "z.csv").write_text(text, encoding="utf-8")
        message = faults(tmp_path, PATH + 'table = "z.csv"\n')
        assert words in message and "z.csv" in message and "transfer_paths.0.table" in message


def test_what_is_wrong_is_said_with_its_key(tmp_path):
    rows = [
        ("[motor]\nsupply_hz = 50.0\npoles = 3\n", "poles come in pairs"),
        ("[motor]\nsupply_hz = -50.0\npoles = 4\n", "greater than 0"),
        ("[motor]\nsupply_hz = 50.0\n", "a motor needs poles, rotor_bars or stator_slots"),
        ("[motor]\npoles = 4\nrotor_bar = 44\n", "Did you mean 'rotor_bars'?"),
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
        assert words in message and "run.toml:" in message
        assert any(table in message for table in ("motor", "transfer_paths", "added_masses"))
