"""The command `balance`, end to end: exact numbers, one document, whole folders, clear faults."""

import json
import tomllib
from functools import reduce
from itertools import product

import jsonschema
import numpy as np
import pytest

from crankorder.batch.balance import balance_of, table_text
from crankorder.batch.result_folder import DONE, finished_with
from crankorder.errors import RequestError
from crankorder.quantities import schema_of
from crankorder.report.netcdf import read_results
from crankorder.settings import shipped, toml_table
from crankorder.synth.write import toml_text
from made.command import crankorder, done

KEYS = ("engine", "lambda", "harmonics", "force_g_mm", "strategies", "shafts", "crankshaft", "notes")
EXACT = 1e-12


def balance(*arguments):
    return crankorder("balance", *arguments)


def document(*arguments):
    return json.loads(done("balance", *arguments, "--json").stdout)


def engine_file(folder, name="task5", **values):
    """A file of a shipped engine's top-level numbers, with other values; None leaves a key out."""
    table = {**tomllib.loads(shipped("engines")[name]), **values}
    table.pop("balance", None)
    path = folder / "engine.toml"
    path.write_text("\n".join(f"{key} = {json.dumps(value)}" for key, value in table.items() if value is not None))
    return path


def test_counterweights_residuals_and_shafts_are_those_of_the_truth(shared_truth):
    found, truth = document("task5"), shared_truth["seed000"]["recovered"]
    left = shared_truth["seed000"]["residual_first_harmonic_over_l1w2"]["amplitudes_g"]
    for name, made in found["strategies"].items():
        assert made["counterweight_g"] == pytest.approx(float(truth.get(f"check_ma1_{name}", 0.0)), rel=EXACT)
        residual = [made["residual_along_g_mm"], made["residual_across_g_mm"]]
        radius_mm = float(truth["suggested_test_set"]["l1_mm"])
        assert residual == pytest.approx([radius_mm * part for part in left[name]], rel=EXACT)
    assert found["strategies"]["d"]["total_g"] == pytest.approx(float(truth["check_total_d"]), rel=EXACT)
    first = float(truth["mz1*lz1/l1_g (possibilities 1,3 each of two; 4 single)"])
    second = float(truth["mz2*lz2/l1_g at lambda"]["0.25"])
    for name in ("1", "2", "3", "4", "4+2"):
        for shaft in found["shafts"][name]["shafts"]:
            wanted = first if abs(shaft["speed_ratio"]) == 1 else second
            assert shaft["mass_at_crank_radius_g"] == pytest.approx(wanted, rel=EXACT)


def test_speeds_and_orders_are_those_asked_for():
    found = document("task5", "--speed", "1500", "--speed", 6000, "--max-order", 12)
    assert set(found["force_n"]) == {"1500", "6000"}
    assert set(found["harmonics"]) == {"2", "4", "6", "8", "10", "12"}
    assert found["force_n"]["6000"]["Z"]["1"] == pytest.approx(19250e-6 * (np.pi * 200) ** 2, rel=EXACT)


@pytest.mark.parametrize("name", sorted(shipped("engines")))
def test_a_shipped_engine_gives_one_valid_document_and_nothing_else(name, project_root):
    outcome = done("balance", project_root / "pipeline" / "engines" / f"{name}.toml", "--json")
    assert outcome.stderr == ""
    found, validator = json.loads(outcome.stdout), jsonschema.Draft202012Validator(schema_of("balance"))
    assert [fault.message for fault in validator.iter_errors(found)] == []
    assert found["sentences"]
    assert all(sentence.endswith(".") and len(sentence) < 500 for sentence in found["sentences"])
    for key in KEYS:
        assert not validator.is_valid({other: value for other, value in found.items() if other != key})
    for key in ("lambda", "harmonics", "force_g_mm", "shafts"):  # null of elastic hinges, and of no other
        assert not validator.is_valid({**found, key: 1.0 if found[key] is None else None})


def test_pictures_data_and_document_appear_whole(tmp_path):
    outcome = done("balance", "v-twin", "--out", tmp_path / "out", "--json")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    pictures = ("polar.png", "force.png", "orders.png", "harmonics.png", "torque.png", "loads.png")
    assert names == {"balance.json", *pictures, "balance.nc", DONE}
    assert json.loads((tmp_path / "out" / "balance.json").read_bytes()) == json.loads(outcome.stdout)
    assert finished_with(tmp_path / "out", json.loads((tmp_path / "out" / DONE).read_bytes())["key"])
    assert all((tmp_path / "out" / name).read_bytes()[:4] == b"\x89PNG" for name in names if name.endswith("png"))
    said = [line.rpartition("/")[2] for line in outcome.stderr.splitlines()]
    assert said == ["balance.json", *pictures, "balance.nc"]
    stored, found = read_results(tmp_path / "out" / "balance.nc")["balance"], json.loads(outcome.stdout)
    force = stored["force_at_speed"].sel(system="none", axis="X", order=2.0, speed=2000.0)
    assert float(force) == pytest.approx(found["force_n"]["2000"]["X"]["2"], rel=1e-6)
    np.testing.assert_allclose(stored["harmonic"].values, list(found["harmonics"].values()), rtol=1e-12)


@pytest.mark.slow
def test_an_engine_with_elastic_hinges_gets_its_own_pictures(tmp_path):
    done("balance", "elastic-hinge", "--out", tmp_path, "--speed", 3000)
    found = json.loads((tmp_path / "balance.json").read_bytes())
    assert len(list(tmp_path.glob("hinges_*.png"))) == len(found["mechanisms"]) == 6
    assert "pin_fig4_b" in read_results(tmp_path / "balance.nc")


def test_every_fault_of_a_file_is_listed_at_once(tmp_path):
    faulty = {"reciprocating_mass_kg": -1.0, "crank_radius_m": None, "strokes": 4, "cycle": "six-stroke"}
    outcome = balance(engine_file(tmp_path, **faulty), "--out", tmp_path / "out")
    assert (outcome.exit_code, outcome.stdout) == (2, "")
    assert all(key in outcome.stderr for key in faulty)
    assert len(outcome.stderr.strip().splitlines()) == len(faulty)
    assert not (tmp_path / "out").exists()


def test_an_engine_that_cannot_be_is_a_wrong_request_that_says_why(tmp_path):
    (tmp_path / "no.toml").write_text("title = 'a'\nbore = = 3\n")
    for arguments, said in ((("task6",), ("task6", "task5")), ((tmp_path / "no.toml",), ("line 2",))):
        outcome = balance(*arguments)
        assert (outcome.exit_code, outcome.stdout) == (2, "")
        assert all(words in outcome.stderr for words in said)


ABSURD = (1e300, -1e300, 1e-300, 0, -1.0, float("nan"), float("inf"), 1e12, 1e-30, 10**300, 10**12)


def numbers(table, place=()):
    """Place of every number of a table of an engine file, of lists that of the first entry."""
    if isinstance(table, dict | list):
        for key, value in table.items() if isinstance(table, dict) else list(enumerate(table))[:1]:
            yield from numbers(value, (*place, key))
    elif isinstance(table, int | float):
        yield place


@pytest.mark.parametrize("seed", range(3))
def test_an_absurd_number_of_any_key_is_borne_or_named(seed, tmp_path):
    draw = np.random.default_rng(seed)
    texts = list(shipped("engines").values())
    for text in (texts[n] for n in draw.integers(len(texts), size=24)):
        table = tomllib.loads(text)
        *place, key = (places := list(numbers(table)))[draw.integers(len(places))]
        holder, value = reduce(lambda part, name: part[name], place, table), ABSURD[draw.integers(len(ABSURD))]
        holder[key] = value
        path = tmp_path / "engine.toml"
        path.write_text(toml_text(table).replace("NaN", "nan").replace("Infinity", "inf"))
        try:
            table_text(balance_of(str(path), max_order=8))  # a warning is an error in tests
        except RequestError as error:
            named = next(str(name) for name in (key, *place[::-1]) if isinstance(name, str))
            assert named in str(error) or abs(value) < 1e200, (place, key, value)
        else:
            assert (not abs(value) > 1e200 and not 0 < abs(value) < 1e-200) or key == "seed", (place, key, value)


@pytest.mark.parametrize(
    "name", ["a" * 900, "a" * 900 + ".toml", "x\0y.toml", "../no.toml", "no/such.toml", "..", "/", ""]
)
def test_a_name_that_can_be_no_file_is_a_wrong_request(name, tmp_path):
    for kind, beside in product(("engines", "recipes", "scenes"), (None, tmp_path)):
        with pytest.raises(RequestError, match=f"no such {kind.removesuffix('s')}"):
            toml_table(name, kind, beside=beside)


def test_speeds_and_orders_out_of_range_are_wrong_requests():
    wrong = (("--speed", 0), ("--speed", -1), ("--speed", "nan"), ("--speed", "inf"), ("--max-order", 3))
    for engine, options in product(("task5", "elastic-hinge"), wrong):
        outcome = balance(engine, *options)
        assert (outcome.exit_code, outcome.stdout) == (2, ""), (engine, *options)
