"""Calls of the package's functions, in the package itself, tests, pages and notebooks, name arguments that exist.

Type checkers miss those that pass through a dict, as in `options = dict(...); f(**options)`.
"""

import ast
import importlib
import inspect
import json
from collections import Counter
from collections.abc import Iterator
from importlib.util import resolve_name
from pathlib import Path

import pytest

from .pages import ROOT, blocks

PARTS = ("slipperjax", "tests", "docs", "notebooks")


def sources(part: str) -> Iterator[tuple[Path, str]]:
    """The Python of a folder with its path: of files, of pages' blocks and of notebooks' cells, those as one text."""
    for path in sorted((ROOT / part).rglob("*.*")):
        if path.suffix == ".py":
            yield path, path.read_text(encoding="utf-8")
        elif path.suffix == ".md":
            yield path, "\n".join(block.text for block in blocks(path) if block.language == "python")
        elif path.suffix == ".ipynb":
            cells = [cell["source"] for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]
            yield path, "\n".join("".join(lines) for lines in cells if not "".join(lines).startswith("%"))


def imported(nodes: list[ast.AST], package: str) -> dict[str, object]:
    """What statements import from the package, by the names that they give."""
    names = {}
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name == "slipperjax":
                    names[alias.asname or alias.name] = importlib.import_module(alias.name)
        elif isinstance(node, ast.ImportFrom):
            module = resolve_name("." * node.level + (node.module or ""), package) if node.level else node.module
            if module.split(".")[0] == "slipperjax":
                for alias in node.names:
                    found = importlib.import_module(module)
                    names[alias.asname or alias.name] = getattr(found, alias.name, None)
    return names


def called(node: ast.expr, names: dict[str, object]) -> object:
    """The object that an expression such as `sj.plots.rail` names; None where it is not known."""
    if isinstance(node, ast.Name):
        return names.get(node.id)
    if isinstance(node, ast.Attribute) and inspect.ismodule(module := called(node.value, names)):
        return getattr(module, node.attr, None)
    return None


def given(call: ast.Call, dicts: dict[str, set[str]]) -> set[str]:
    """Names of the arguments of a call, and of those in a dict that is made in the same function."""
    direct = {word.arg for word in call.keywords if word.arg}
    through = [word.value.id for word in call.keywords if not word.arg and isinstance(word.value, ast.Name)]
    return direct.union(*(dicts.get(name, set()) for name in through))


def outside(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes of a tree that are not in functions."""
    for part in ast.iter_child_nodes(node):
        if not isinstance(part, ast.FunctionDef):
            yield part
            yield from outside(part)


def unknown(text: str, package: str = "", module: object = None) -> list[str]:
    """Calls of a text with arguments that do not exist."""
    tree = ast.parse(text)
    top = list(outside(tree))
    everywhere = imported(top, package) | (vars(module) if module else {})
    found = []
    # whatever stands outside of functions, and each function with those inside
    for nodes in (top, *(list(ast.walk(node)) for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))):
        names = everywhere | imported(nodes, package)
        made = [
            (node.targets[0].id, {word.arg for word in node.value.keywords if word.arg})
            for node in nodes
            if isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Name)
            and isinstance(node.value, ast.Call)
            and getattr(node.value.func, "id", "") == "dict"
        ]
        # a name that stands for several dicts is not followed
        named = Counter(node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store))
        named.update(node.arg for node in nodes if isinstance(node, ast.arg))
        dicts = {name: words for name, words in made if named[name] == 1}
        for call in [node for node in nodes if isinstance(node, ast.Call)]:
            function = called(call.func, names)
            if not callable(function):
                continue
            try:
                parameters = inspect.signature(function).parameters
            except ValueError:  # of built-in classes
                continue
            if not any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
                found += [f"line {call.lineno}: {name}" for name in given(call, dicts) - set(parameters)]
    return sorted(set(found))


@pytest.mark.full
@pytest.mark.parametrize("part", PARTS)
def test_arguments_of_calls_exist(part):
    wrong = {}
    for path, text in sources(part):
        if path.parent.name == "api":  # lists of names
            continue
        package = ".".join(path.relative_to(ROOT).parts[:-1])
        module = None
        if part == "slipperjax":
            dotted = path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".").removesuffix(".__init__")
            module = importlib.import_module(dotted)
        if found := unknown(text, package, module):
            wrong[str(path.relative_to(ROOT))] = found
    assert not wrong


def test_arguments_that_do_not_exist_are_found():
    text = """
import slipperjax as sj
from slipperjax.sweeps.follow import find_jump
def jumps(path):
    options = dict(direction="up", progress=None)
    return find_jump(sj.paper_scene(), path, **options), sj.plots.rail(scenes=1)
"""
    assert unknown(text) == ["line 6: progress", "line 6: scenes"]
