"""What is committed can be installed anywhere, says nothing of the machine it came from, and is written up."""

import ast
import json
import re
import tomllib

import jsonschema
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

# Character classes keep these patterns from finding themselves.
FOREIGN = re.compile(
    r"(?<![\w.])/(?:wor[k]|far[m]|roo[t])/(?!\*)|/tm[p]/(?:venv|studio|bash_jobs)|/op[t]/(?:pypi|wheels)"
    r"|index-ur[l]|find-link[s]|//[\w.-]+/simpl[e]\b|pythonhoste[d]",
    re.IGNORECASE,
)
PINNED = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*==[0-9][A-Za-z0-9.!_-]*")
MAX_BYTES = 2_000_000


def _project(project_root):
    return tomllib.loads((project_root / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def _constraints(project_root):
    return (project_root / "constraints.txt").read_text(encoding="utf-8").splitlines()


def test_constraints_hold_name_and_version_only(project_root):
    lines = _constraints(project_root)
    assert len(lines) > 20
    assert [line for line in lines if not PINNED.fullmatch(line)] == []


def test_constraints_pin_every_dependency_within_its_bounds(project_root):
    pins = {
        canonicalize_name(name): version for name, version in (line.split("==") for line in _constraints(project_root))
    }
    project = _project(project_root)
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    wanted = [Requirement(text) for group in groups for text in group if not text.startswith("crankorder")]
    pinned = {need: pins.get(canonicalize_name(need.name), "0") for need in wanted}
    assert {str(need): pin for need, pin in pinned.items() if not need.specifier.contains(pin)} == {}
    notice = (project_root / "NOTICE").read_text(encoding="utf-8")
    assert [need.name for need in map(Requirement, project["dependencies"]) if need.name not in notice] == []


def test_no_file_names_a_path_of_this_machine_or_a_package_host_and_none_is_large(project_root, project_files):
    offenders = []
    for path in project_files:
        data = (project_root / path).read_bytes()
        found = FOREIGN.search(data.decode("utf-8", "replace"))
        if found or len(data) > MAX_BYTES:
            offenders.append((str(path), found and found[0], len(data)))
    assert offenders == []


def test_the_changelog_has_an_entry_for_this_version(project_root):
    changelog = (project_root / "CHANGELOG.md").read_text(encoding="utf-8")
    version = _project(project_root)["version"]
    entry = re.search(rf"^## {re.escape(version)}\b[^\n]*\n(.*?)(?=^## |\Z)", changelog, re.MULTILINE | re.DOTALL)
    assert entry is not None, f"no heading '## {version}'"
    assert re.search(r"^[-*] \w", entry.group(1), re.MULTILINE), "the entry says nothing"


def test_every_schema_is_a_valid_json_schema(project_root):
    schemas = sorted((project_root / "data_schema").glob("*.json"))
    assert len(schemas) >= 7
    for path in schemas:
        schema = json.loads(path.read_text(encoding="utf-8"))
        jsonschema.Draft202012Validator.check_schema(schema)
        assert schema.get("title") and schema.get("description"), path.name


def test_every_test_can_fail(python_files):
    offenders = []
    for source in (source for source in python_files if source.path.parts[0] == "tests"):
        for test in source.nodes:
            if isinstance(test, ast.FunctionDef) and test.name.startswith("test_"):
                inner = list(ast.walk(test))
                called = [ast.unparse(call.func).rpartition(".")[2] for call in inner if isinstance(call, ast.Call)]
                told = any(re.match(r"_?(assert|check|expect|raises|warns)", name) for name in called)
                if not told and not any(isinstance(node, ast.Assert) for node in inner):
                    offenders.append(f"{source.path}:{test.lineno}: {test.name}")
    assert offenders == []
