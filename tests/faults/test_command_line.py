"""Faults of the shared catalogue that only a whole command shows, each named by its entry."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from crankorder.batch.frame_store import STORE
from made.command import crankorder as in_process
from made.processes import PATIENCE_S, children_of, processor_s, started
from made.recordings import write_hdf5


def manifest_of(*channels, name="a", files=("*.h5",), rate_hz="1000.0", more=""):
    """Text of a manifest of a rotor: these channels, and what is to stand behind all."""
    listed = "".join(f'[[channels]]\nname = "{one}"\nunit = "m/s2"\n' for one in channels)
    return (
        f'schema_version = 1\n[test]\nname = "{name}"\ncycle = "rotor"\n[recordings]\nfiles = {json.dumps(files)}\n'
        f'[sampling]\nrate_hz = {rate_hz}\n[encoder]\nsource = "speed"\nkind = "speed"\n{listed}{more}'
    )


TIMES = 10.0
"""How often the processor time of a short refusal a request may take: 2 s where that is 0.2 s, on any machine."""


def crankorder(*arguments, **given):
    """The command as it ended, and the processor seconds that it took."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "crankorder", *map(str, arguments)]
    made = subprocess.run(command, capture_output="stdout" not in given and "stderr" not in given, **given)  # type: ignore[call-overload]
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return made, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def folder_of(place, manifest):
    place.mkdir()
    (place / "run.toml").write_text(manifest, encoding="utf-8")
    (place / "a.h5").write_bytes(b"")
    return place


MANIFESTS: dict[str, Callable[[], str]] = {
    "90,000 channels": lambda: manifest_of(*(f"c{k}" for k in range(90_000))),
    "300,000 unknown keys": lambda: manifest_of("a", more="[x]\n" + "".join(f"k{k} = 1\n" for k in range(300_000))),
    "100,000 missing files": lambda: manifest_of("a", files=[f"m{k}.h5" for k in range(100_000)]),
    "a key of 20,000 parts": lambda: manifest_of("a", more=".".join(["k"] * 20_000) + " = 1\n"),
    "a number of 5,000 digits": lambda: manifest_of("a", rate_hz="9" * 5_000),
    "a table 100,000 deep": lambda: manifest_of("a", more="x = " + "[" * 100_000 + "]" * 100_000),
}


@pytest.fixture(scope="module")
def short_s(tmp_path_factory):
    """Processor seconds in which a manifest of a few lines is refused."""
    folder = folder_of(tmp_path_factory.mktemp("short") / "data", manifest_of())
    return min(crankorder("check", folder)[1] for _ in range(3))


@pytest.mark.parametrize("what", MANIFESTS)
def test_i8_i9_an_endless_manifest_is_refused_in_ten_times_a_short_one_at_most(what, short_s, tmp_path):
    made, seconds = crankorder("check", folder_of(tmp_path / "data", MANIFESTS[what]()))
    said = made.stderr.decode()
    assert made.returncode in (2, 3, 4), said[-500:]
    assert "Traceback" not in said and said.startswith("crankorder: ")
    assert seconds <= TIMES * short_s
    assert len(said) < 100_000


def test_i8_a_recipe_of_900_characters_is_no_recipe_and_a_link_that_leads_to_itself_is_told(tmp_path):
    folder, out, loop = folder_of(tmp_path / "data", manifest_of("a")), tmp_path / "out", tmp_path / "loop"
    loop.symlink_to(loop)
    for arguments in (
        ("run", folder, "--out", out, "--recipe", "r" * 900),
        ("check", loop),
        ("run", loop, "--out", out),
    ):
        made, _ = crankorder(*arguments)
        assert made.returncode in (2, 3) and b"Traceback" not in made.stderr
    assert not out.exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_i8_a_full_standard_output_is_exit_5():
    with Path("/dev/full").open("wb") as full:
        made, _ = crankorder("balance", "msu-optical-second", "--json", stdout=full, stderr=subprocess.PIPE)
    assert made.returncode == 5 and b"Traceback" not in made.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize("kept", [1, 0])
def test_i8_a_full_standard_error_loses_its_remarks_and_nothing_else(recordings_of, tmp_path, kept):
    arguments = ("run", recordings_of("hard-two-revolutions"), "--recipe", "maps", "--json", "--keep-frames", kept)
    with Path("/dev/full").open("wb") as full:
        made, _ = crankorder(*arguments, "--out", tmp_path / "out", stdout=subprocess.PIPE, stderr=full)
        refused, _ = crankorder("run", tmp_path / "none", "--out", tmp_path / "a", stderr=full)
    assert (made.returncode, refused.returncode) == (0, 2) and json.loads(made.stdout)["tests"][0]["status"] == "done"
    assert any((tmp_path / "out" / STORE).rglob("*.frames")) == bool(kept)


def test_i8_a_closed_stderr_and_no_home_change_nothing(tmp_path):
    folder = folder_of(tmp_path / "data", "x = ")
    whole, _ = crankorder("check", folder)
    line = f'exec "{sys.executable}" -m crankorder check "{folder}" 2>&-'
    homeless = {name: value for name, value in os.environ.items() if name not in ("HOME", "USER", "LOGNAME")}
    made = subprocess.run(["/bin/sh", "-c", line], env=homeless, capture_output=True)
    assert (made.returncode, made.stdout) == (whole.returncode, whole.stdout) == (2, b"")


def test_i7_kernels_are_kept_only_where_nobody_else_can_write(tmp_path):
    """A folder of the expected name that others may write is passed over."""
    guess = tmp_path / f"crankorder-kernels-{os.getuid()}"
    guess.mkdir()
    program = (
        "import os, stat; os.access = lambda *unused: False\n"
        "from crankorder.cli import keep_compiled_kernels\n"
        "keep_compiled_kernels(); place = os.environ['NUMBA_CACHE_DIR']\n"
        "print(place, oct(stat.S_IMODE(os.stat(place).st_mode)))"
    )
    surroundings = {**os.environ, "TMPDIR": str(tmp_path)}
    surroundings.pop("NUMBA_CACHE_DIR", None)
    for mode, taken in ((0o777, False), (0o700, True)):
        guess.chmod(mode)
        made = subprocess.run([sys.executable, "-c", program], env=surroundings, capture_output=True, check=True)
        place, own = made.stdout.decode().rsplit(maxsplit=1)
        assert (Path(place) == guess) is taken and own == "0o700"


def test_i10_a_name_cannot_write_on_the_terminal(tmp_path, monkeypatch):
    odd = "".join(map(chr, (*range(1, 32), *range(0x7F, 0xA0), *range(0x2028, 0x202F), *range(0x2066, 0x206A), 0xDCFF)))
    name = json.dumps(f"[31m{odd[:-1]}")[1:-1]
    folder = folder_of(tmp_path / f"[31m{odd}", manifest_of(name, name=name))
    (folder / "a.h5").unlink()
    write_hdf5(folder / f"{odd}.h5", {odd[:-1]: np.arange(50.0)}, rate_hz=1000.0, unit=odd[:-1])
    monkeypatch.chdir(tmp_path)
    asked = "init|check|clean|report|balance|run --out o --dry-run|run -v --out o|export --to csv|compare --out c"
    for command, *more in map(str.split, asked.split("|")):
        said = in_process(command, *more, folder, *([folder] if command == "compare" else [])).output
        assert "[31m" in said and all(line.isprintable() for line in said.split("\n")), (command, said)


def logged_in(out, event):
    return sum(path.read_text().count(f" {event}:") for path in out.glob(".crankorder-logs/*"))


@pytest.mark.skipif(sys.platform != "linux", reason="children are looked up in /proc")
@pytest.mark.cases(1)
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_f2_a_run_that_is_told_to_end_begins_nothing_more_and_goes_on_later(
    number, status, campaign_at, short_s, tmp_path
):
    """The 5 s of the catalogue are processor time here: what is left to do does not depend on the machine."""
    out = tmp_path / "out"
    folder = campaign_at(tmp_path / "data", *range(1000, 1500, 100))
    command = ("run", folder, "--out", out, "--recipe", "maps", "-q", "--jobs", "1")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with started("-m", "crankorder", *command, stderr=subprocess.PIPE) as process:
        while logged_in(out, "recording computed") < 2:
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGSTOP)  # what is seen now is what was done when it was told to end
        family = children_of(process.pid)
        done, spent = logged_in(out, "recording computed"), processor_s(process.pid, *family)
        process.send_signal(number)
        process.send_signal(signal.SIGCONT)
        _, said = process.communicate(timeout=PATIENCE_S)
        assert family and not [pid for pid in family if Path(f"/proc/{pid}").exists()]
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert process.returncode == status and b"Traceback" not in said
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime - spent < TIMES * short_s
    assert logged_in(out, "recording computed") <= done + 1
    assert not list(out.glob("*/done.json"))
    assert crankorder(*command)[0].returncode == 0
    assert logged_in(out, "recording reused") >= 2
