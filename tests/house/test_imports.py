"""Imports go down only, drawing stays in its room, and the command line starts light."""

import ast
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

FORBIDDEN_NAMES = {"utils", "util", "core", "common", "helpers", "helper", "misc"}
SHOWS_FIGURES = Path("src/crankorder/plot/axes.py")
"""The one file that may ask pyplot for a figure: a notebook shows no other. It does so where no axes are given."""
HEAVY = ["numpy", "scipy", "xarray", "matplotlib", "numba", "pandas", "h5py", "h5netcdf", "pyfftw", "jinja2"]

# Runs the command in a fresh interpreter and says on the last line of stderr which heavy packages it loaded.
PROBE = """
import atexit, json, os, sys
from crankorder.cli import main

def tell():
    answer = [name for name in {heavy!r} if name in sys.modules], os.environ.get("OPENBLAS_NUM_THREADS")
    print("\\n" + json.dumps(answer), file=sys.stderr)

atexit.register(tell)
sys.argv[0] = "crankorder"
main()
"""


def _imported(files):
    """File, line and name of all that ``files`` import."""
    for source in files:
        for node in source.nodes:
            if isinstance(node, ast.Import | ast.ImportFrom):
                begin = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
                yield from ((source.path, node.lineno, begin + alias.name) for alias in node.names)


def test_the_import_contract_holds(project_root):
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"]
    result = subprocess.run([*command, "--no-cache"], cwd=project_root, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "0 broken" in result.stdout


def test_matplotlib_is_imported_only_where_pictures_are_drawn(package_files):
    drawing = [found for found in _imported(package_files) if found[2].partition(".")[0] == "matplotlib"]
    assert [found for found in drawing if not {"report", "plot"} & set(found[0].parts)] == []


def test_no_file_uses_the_global_state_of_pyplot(python_files):
    using = [found for found in _imported(python_files) if {"pyplot", "pylab"} & set(found[2].split("."))]
    assert [found for found in using if found[0] != SHOWS_FIGURES] == []


def test_no_module_is_named_for_nothing_in_particular(python_files):
    """A function lives in the room whose noun it makes."""
    names = {
        source.path: {part.removesuffix(".py").strip("_") for part in source.path.parts} for source in python_files
    }
    assert [path for path, parts in names.items() if FORBIDDEN_NAMES & parts] == []


def _loaded_by(*arguments):
    command = [sys.executable, "-c", PROBE.format(heavy=HEAVY), *arguments]
    surroundings = {name: value for name, value in os.environ.items() if "THREADS" not in name}
    result = subprocess.run(command, capture_output=True, text=True, env=surroundings)
    assert result.stderr.strip(), "the probe said nothing"
    loaded, threads = json.loads(result.stderr.strip().splitlines()[-1])
    assert threads == "1", "numpy loads with threads that burn the processor waiting for small products"
    return result.returncode, loaded, result.stdout


@pytest.mark.cases(4)
@pytest.mark.parametrize(
    ("arguments", "status", "spared"),
    [
        (["--help"], 0, HEAVY),
        (["--version"], 0, HEAVY),
        (["check", "."], 2, HEAVY),  # a wrong manifest
        (["balance", "v8-cross", "--json"], 0, ["xarray", "pandas", "matplotlib", "h5py"]),  # the numbers take a tenth
    ],
)
def test_what_needs_no_heavy_package_loads_none(tmp_path, monkeypatch, arguments, status, spared):
    (tmp_path / "run.toml").write_text("schema_version = 1\nwrong = 1\n")
    monkeypatch.chdir(tmp_path)
    ended, loaded, output = _loaded_by(*arguments)
    assert ended == status and not set(spared) & set(loaded)
    assert "--" not in arguments[0] or "crankorder" in output


@pytest.mark.parametrize(
    ("loaded", "spared"),
    [
        ("from crankorder.batch.publish import prepare; prepare(draws=True)", "scipy numba pyfftw crankorder.orders"),
        (
            "import crankorder.batch.execute",
            "matplotlib jinja2 scipy.ndimage scipy.signal scipy.optimize "
            "crankorder.identify.lines crankorder.identify.modes crankorder.plot",
        ),
    ],
)
def test_processes_of_a_run_load_what_they_need(loaded, spared):
    """Pages and pictures are made beside the analysis, and maps need not what finds: what loads is paid for."""
    if importlib.util.find_spec("dask"):
        pytest.skip("dask is installed (extra dist): xarray loads it, and it loads scipy, with the first dataset")
    code = f"import sys\n{loaded}\nprint(*(name for name in {spared.split()} if name in sys.modules))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.split() == []
