"""Each default has one home and one reason; recipes hold only what differs."""

import ast
import importlib
import tomllib

import pytest

from crankorder import settings
from crankorder.errors import RequestError
from crankorder.settings import Settings, load_settings, shipped

STAGES = tuple(Settings.file_of)


@pytest.fixture(scope="module")
def readmes():
    """The generator of the README pages."""
    return importlib.import_module("make_readmes")  # reports/ is on the path of the tests


def test_each_generated_page_and_schema_is_up_to_date(readmes):
    pages = readmes.pages()
    assert len(pages) == 11
    there = {path: path.read_text(encoding="utf-8") if path.is_file() else "" for path in pages}
    assert not [str(path) for path in pages if there[path] != pages[path]], "run `python reports/make_readmes.py`"


def test_every_stage_has_one_file_and_every_file_is_a_stage(project_root):
    # the stages' files are numbered in flow order; a catalogue such as bearings.toml is not, numbers of methods follow
    files = sorted(path.name for path in (project_root / "pipeline").glob("[0-9]*.toml") if path.name.count("-") == 1)
    assert files == list(Settings.file_of.values())
    assert set(STAGES) == set(Settings.model_fields)


@pytest.mark.parametrize("stage", STAGES)
def test_every_setting_has_its_reason_on_its_line_and_no_other_home(stage, project_root, readmes):
    file, fields = Settings.file_of[stage], Settings.model_fields[stage].annotation.model_fields
    text = (project_root / "pipeline" / file).read_text(encoding="utf-8")
    content, lines = tomllib.loads(text), readmes.settings_of(text)
    assert list(content) == [stage], "one table, named as the stage"
    assert [key for key, _, _ in lines] == list(content[stage]), "one setting a line, value and reason on it"
    without = [key for key, _, reason in lines if len(reason) < 5]
    assert not without, f"no reason: {', '.join(without)}"
    assert set(content[stage]) == set(fields)
    with_default = [name for name, field in fields.items() if not field.is_required()]
    assert not with_default, f"defaults belong into {file}: {', '.join(with_default)}"


def _numbers_read(package_files):
    """Tables of numbers of methods that modules load, and every number that one reads: file, table and name."""
    homes: dict[tuple[str, str], tuple[str, str]] = {}
    used: list[tuple[str, str, str]] = []
    modules = [(".".join(source.path.with_suffix("").parts[1:]), source.nodes) for source in package_files]
    for module, nodes in modules:
        for node in nodes:
            if isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("MethodNumbers("):
                file, table = map(ast.literal_eval, node.value.args)
                homes[module, ast.unparse(node.targets[0])] = file, table
    for own, nodes in modules:
        names = {name: home for (module, name), home in homes.items() if module == own}
        for node in nodes:
            if isinstance(node, ast.ImportFrom):
                imported = {item.asname or item.name: homes.get((node.module, item.name)) for item in node.names}
                names |= {name: home for name, home in imported.items() if home is not None}
        nodes = [node for node in nodes if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)]
        used += [(*names[node.value.id], node.attr) for node in nodes if node.value.id in names]
    return list(homes.values()), used


def test_each_table_of_a_methods_numbers_has_a_reader_and_each_number_a_reason_and_a_use(
    project_root, readmes, package_files
):
    (homes, used), tables = _numbers_read(package_files), {}
    for path in (project_root / "pipeline").glob("[0-9]-*-*.toml"):
        text = path.read_text(encoding="utf-8")
        for table, title, numbers in readmes.method_tables(text):
            assert title, f"{path.name}: what is [{table}] about?"
            assert [key for key, _, _ in numbers] == list(tomllib.loads(text)[table]), f"{path.name}: one number a line"
            without = [key for key, _, reason in numbers if len(reason) < 5]
            assert not without, f"{path.name}: no reason: {', '.join(without)}"
            tables[path.name, table] = {key for key, _, _ in numbers}
    assert sorted(tables) == sorted(homes)
    there = {(*home, key) for home, keys in tables.items() for key in keys}
    assert there == set(used), f"no use: {sorted(there - set(used))}; no number: {sorted(set(used) - there)}"


def test_numbers_of_a_method_cannot_be_set_and_a_missing_table_is_named(monkeypatch):
    monkeypatch.setattr(settings, "_tables", lambda _: {"zoom": {"ends": [1.0, 2.0]}})
    numbers = settings.MethodNumbers("5-identify-test.toml", "zoom")
    assert numbers.ends == (1.0, 2.0)
    with pytest.raises(AttributeError, match="ends"):
        numbers.ends = (1.0, 3.0)
    with pytest.raises(AttributeError, match="end is no number of ends"):
        assert numbers.end
    with pytest.raises(RequestError, match=r"5-identify-test\.toml"):
        settings.MethodNumbers("5-identify-test.toml", "other")


@pytest.mark.parametrize("key", ["calibrate_encoder", "calibration_speed_ratio"])
def test_a_setting_that_is_no_more_is_refused_with_what_to_do_instead(key):
    with pytest.raises(RequestError, match=f"shaft.{key}.*Remove it.*--recipe calibrated-encoder"):
        load_settings(asked={"shaft": {key: 2}})


@pytest.mark.parametrize("recipe", sorted(shipped("recipes")))
def test_a_recipe_is_valid_and_holds_only_what_differs(recipe):
    plain, asked = load_settings().model_dump(), load_settings(recipe).model_dump()
    tables = {key: value for key, value in tomllib.loads(shipped("recipes")[recipe]).items() if key in STAGES}
    given = [(stage, key) for stage, table in tables.items() for key in table]
    assert [(stage, key) for stage, key in given if asked[stage][key] == plain[stage][key]] == []


@pytest.mark.parametrize("kind", ["recipes", "engines", "scenes"])
def test_everything_shipped_has_a_title(kind):
    titles = {name: tomllib.loads(text).get("title") for name, text in shipped(kind).items()}
    assert titles and all(titles.values()), titles
