"""Every public module, function, class and method has an explanation; the code in documentation and docstrings runs."""

from __future__ import annotations

import ast
import doctest
import functools
import importlib
import re
from pathlib import Path

import femu_piezo

ROOT = Path(femu_piezo.__file__).parent
#: A shape such as (k, 2n), (3, 6), (n,) or (…, 3).
SHAPE = re.compile(r"\(\w+,(?: \w+,?)*\)|\(\w*…?, ?\w+\)")
NOTATION = ROOT.parent / "tutorials" / "notation.md"


@functools.cache
def _modules() -> tuple[tuple[Path, ast.Module], ...]:
    paths = sorted(ROOT.rglob("*.py"))
    return tuple((path.relative_to(ROOT), ast.parse(path.read_text(encoding="utf-8"))) for path in paths)


def _public(body, kinds):
    return [node for node in body if isinstance(node, kinds) and not node.name.startswith("_")]


FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


def _classes() -> dict[str, ast.ClassDef]:
    return {node.name: node for _, tree in _modules() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}


@functools.cache
def _protocols() -> list[ast.ClassDef]:
    return [
        node
        for _, tree in _modules()
        for node in tree.body
        if isinstance(node, ast.ClassDef) and any("Protocol" in ast.unparse(base) for base in node.bases)
    ]


def _is_explained(method: ast.FunctionDef, owner: ast.ClassDef, classes: dict[str, ast.ClassDef]) -> bool:
    """Whether a method has a docstring or a line in that of its class, or either in a base class or a protocol of
    it.
    """
    kin = [owner, *(classes[name] for name in (ast.unparse(base) for base in owner.bases) if name in classes)]
    kin += [
        protocol
        for protocol in _protocols()
        if {node.name for node in _public(protocol.body, FUNCTIONS)}
        <= {node.name for node in _public(owner.body, FUNCTIONS)} | _fields(owner)
    ]
    for relative in kin:
        named = re.search(rf"\b{method.name}\b", ast.get_docstring(relative) or "")
        own = [
            node for node in _public(relative.body, FUNCTIONS) if node.name == method.name and ast.get_docstring(node)
        ]
        if named or own:
            return True
    return False


def _fields(owner: ast.ClassDef) -> set[str]:
    return {
        node.target.id for node in owner.body if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }


def test_modules_functions_and_classes_have_docstrings():
    missing = []
    for path, tree in _modules():
        if path.name != "__init__.py" and not ast.get_docstring(tree):
            missing.append(str(path))
        for node in _public(tree.body, (*FUNCTIONS, ast.ClassDef)):
            described = ast.get_docstring(node) or any("help=" in ast.unparse(item) for item in node.decorator_list)
            if not described:
                missing.append(f"{path}:{node.lineno} {node.name}")
    assert not missing


def test_methods_are_explained():
    classes = _classes()
    missing = [
        f"{path}:{method.lineno} {owner.name}.{method.name}"
        for path, tree in _modules()
        for owner in _public(tree.body, ast.ClassDef)
        for method in _public(owner.body, FUNCTIONS)
        if not _is_explained(method, owner, classes)
    ]
    assert not missing, "\n".join(missing)


def test_docstrings_state_the_shapes_of_arrays():
    """Functions of the lower layers that take or return an array state a shape."""
    missing = []
    for path, tree in _modules():
        if path.parts[0] not in ("extraction", "forward", "inference", "material", "measurement"):
            continue
        for node in _public(tree.body, FUNCTIONS):
            text = ast.get_docstring(node) or ""
            arrays = ast.unparse(node.args) + (ast.unparse(node.returns) if node.returns else "")
            if "np.ndarray" in arrays and not SHAPE.search(text):
                missing.append(f"{path}:{node.lineno} {node.name}")
    assert not missing, "\n".join(missing)


def test_examples_in_docstrings_run():
    names = [
        "femu_piezo." + ".".join(path.with_suffix("").parts)
        for path, _ in _modules()
        if ">>> " in (ROOT / path).read_text(encoding="utf-8")
    ]
    results = [doctest.testmod(importlib.import_module(name)) for name in names]
    assert sum(result.attempted for result in results) > 0
    assert all(result.failed == 0 for result in results)


def test_snippets_of_the_notation_page_run():
    code = re.findall(r"```python\n(.*?)```", NOTATION.read_text(encoding="utf-8"), flags=re.S)
    assert len(code) == 1
    names: dict = {}
    exec(compile(code[0], str(NOTATION), "exec"), names)
    assert names["c"].shape == (6, 6) and names["e"].shape == (6, 3)
    assert abs(names["same"].s33 / names["pzt"].s33 - 1) < 1e-9


def test_lists_in_docstrings_begin_after_a_blank_line():
    """Else docutils takes the items for a part of the sentence before, and the site is not built."""
    wrong = []
    for path, tree in _modules():
        for node in ast.walk(tree):
            if not isinstance(node, (ast.Module, ast.ClassDef, *FUNCTIONS)):
                continue
            before, in_list = "", False
            for line in (ast.get_docstring(node) or "").splitlines():
                item = line.startswith("- ")
                if item and before.strip() and not in_list:
                    wrong.append(f"{path}: {line}")
                in_list = item or (in_list and line.startswith("  "))
                before = line
    assert not wrong
