"""Everything public says what it is, and names each of its parameters."""

import ast
import re


def _public(files):
    """Place and node of all that is public; what repeats another has the docstring of that."""

    def inside(body, owner):
        for node in body:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and node.name[0] != "_":
                if not _decorators(node) & {"overload", "override", "setter"}:
                    yield f"{owner}{node.name}", node
                if isinstance(node, ast.ClassDef):
                    yield from inside(node.body, f"{owner}{node.name}.")

    for source in files:
        yield from inside(source.tree.body, f"{source.path}: ")


def _decorators(node):
    functions = [named.func if isinstance(named, ast.Call) else named for named in node.decorator_list]
    return {ast.unparse(function).rpartition(".")[2] for function in functions}


def _parameters(node):
    arguments = node.args
    every = [*arguments.posonlyargs, *arguments.args, arguments.vararg, *arguments.kwonlyargs, arguments.kwarg]
    names = [argument.arg for argument in every if argument is not None]
    return [name for name in names if name not in ("self", "cls") and not name.startswith("_")]


def test_every_module_and_all_that_is_public_says_what_it_is(python_files, package_files):
    assert [str(source.path) for source in python_files if not ast.get_docstring(source.tree)] == []
    assert [name for name, node in _public(package_files) if not ast.get_docstring(node)] == []


def test_every_parameter_of_a_public_function_is_named_in_its_docstring(package_files):
    offenders = {}
    for name, node in _public(package_files):
        # a command's docstring is its help page: there each option has its own help text (next test)
        if not isinstance(node, ast.ClassDef) and not _decorators(node) & {"command", "group"}:
            text = ast.get_docstring(node) or ""
            offenders[name] = [one for one in _parameters(node) if not re.search(rf"\b{one}\b", text)]
    assert {name: missing for name, missing in offenders.items() if missing} == {}


def test_every_command_line_option_has_its_help(package_files):
    calls = [node for source in package_files for node in source.nodes if isinstance(node, ast.Call)]
    options = [node for node in calls if ast.unparse(node.func) == "click.option"]
    keywords = {ast.unparse(node.args[0]): {keyword.arg for keyword in node.keywords} for node in options}
    assert options and [name for name, given in keywords.items() if not given & {"help", "hidden", None}] == []
