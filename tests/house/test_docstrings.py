"""Everything public says what it is, and names each of its parameters."""

import ast
import re

Function = ast.FunctionDef | ast.AsyncFunctionDef


def _public(body, owner=""):
    for node in body:
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) or node.name.startswith("_"):
            continue
        yield f"{owner}{node.name}", node
        if isinstance(node, ast.ClassDef):
            yield from _public(node.body, f"{owner}{node.name}.")


def _decorators(node):
    functions = [named.func if isinstance(named, ast.Call) else named for named in node.decorator_list]
    return {ast.unparse(function).rpartition(".")[2] for function in functions}


def _repeats_another(node):
    return bool(_decorators(node) & {"overload", "override", "setter"})


def _parameters(node):
    arguments = node.args
    every = [*arguments.posonlyargs, *arguments.args, arguments.vararg, *arguments.kwonlyargs, arguments.kwarg]
    names = [argument.arg for argument in every if argument is not None]
    return [name for name in names if name not in ("self", "cls") and not name.startswith("_")]


def test_every_module_says_what_it_is(python_files):
    offenders = [str(source.path) for source in python_files if not ast.get_docstring(source.tree)]
    assert not offenders, "no docstring:\n" + "\n".join(offenders)


def test_every_public_class_and_function_says_what_it_is(package_files):
    offenders = [
        f"{source.path}:{node.lineno}: {name}"
        for source in package_files
        for name, node in _public(source.tree.body)
        if not _repeats_another(node) and not ast.get_docstring(node)
    ]
    assert not offenders, "no docstring:\n" + "\n".join(offenders)


def test_every_parameter_of_a_public_function_is_named_in_its_docstring(package_files):
    offenders = []
    for source in package_files:
        for name, node in _public(source.tree.body):
            # a command's docstring is its help page: there each option has its own help text (next test)
            if isinstance(node, ast.ClassDef) or _repeats_another(node) or _decorators(node) & {"command", "group"}:
                continue
            text = ast.get_docstring(node) or ""
            missing = [parameter for parameter in _parameters(node) if not re.search(rf"\b{parameter}\b", text)]
            if missing:
                offenders.append(f"{source.path}:{node.lineno}: {name}: {', '.join(missing)}")
    assert not offenders, "not named in the docstring:\n" + "\n".join(offenders)


def test_every_command_line_option_has_its_help(package_files):
    offenders = []
    for source in package_files:
        for node in ast.walk(source.tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "click.option":
                keywords = {keyword.arg for keyword in node.keywords}
                if not keywords & {"help", "hidden", None}:
                    offenders.append(f"{source.path}:{node.lineno}: {ast.unparse(node.args[0])}")
    assert not offenders, "no help text:\n" + "\n".join(offenders)
