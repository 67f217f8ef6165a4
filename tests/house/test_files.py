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
    offenders = [line for line in lines if not PINNED.fullmatch(line)]
    assert not offenders, "\n".join(offenders)


def test_constraints_pin_every_dependency_within_its_bounds(project_root):
    pins = {
        canonicalize_name(name): version
        for name, _, version in (line.partition("==") for line in _constraints(project_root))
    }
    project = _project(project_root)
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    wanted = [Requirement(text) for group in groups for text in group if not text.startswith("crankorder")]
    offenders = [
        f"{need}: {pins.get(canonicalize_name(need.name), 'not pinned')}"
        for need in wanted
        if not need.specifier.contains(pins.get(canonicalize_name(need.name), "0"))
    ]
    assert not offenders, "\n".join(offenders)


def test_no_file_names_a_path_of_this_machine_or_a_package_host(project_root, project_files):
    offenders = []
    for path in project_files:
        text = (project_root / path).read_bytes().decode("utf-8", "replace")
        offenders += [
            f"{path}:{text.count(chr(10), 0, match.start()) + 1}: {match.group()}" for match in FOREIGN.finditer(text)
        ]
    assert not offenders, "\n".join(offenders)


def test_no_committed_file_is_large(project_root, project_files):
    sizes = {str(path): (project_root / path).stat().st_size for path in project_files}
    offenders = [f"{path}: {size / 1e6:.1f} MB" for path, size in sizes.items() if size > MAX_BYTES]
    assert not offenders, "\n".join(offenders)


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
        assert schema.get("title"), f"{path.name}: no title"
        assert schema.get("description"), f"{path.name}: no description"


def test_every_test_can_fail(python_files):
    offenders = []
    for source in python_files:
        if source.path.parts[0] != "tests":
            continue
        for node in ast.walk(source.tree):
            if not isinstance(node, ast.FunctionDef) or not node.name.startswith("test_"):
                continue
            called = {
                ast.unparse(call.func).rpartition(".")[2] for call in ast.walk(node) if isinstance(call, ast.Call)
            }
            asserts = any(isinstance(inner, ast.Assert) for inner in ast.walk(node))
            if not asserts and not any(re.match(r"_?(assert|check|expect|raises|warns)", name) for name in called):
                offenders.append(f"{source.path}:{node.lineno}: {node.name}")
    assert not offenders, "asserts nothing:\n" + "\n".join(offenders)
