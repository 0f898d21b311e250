"""Imports go from upper to lower layers only; extraction and forward never import each other."""

from __future__ import annotations

import ast
from pathlib import Path

import femu_piezo

ROOT = Path(femu_piezo.__file__).parent

#: Layers from the bottom; a module may import its own layer and those below.
LAYERS = (
    {"errors", "units", "files", "resonances", "threads", "steps", "interpolation"},
    {"specimen"},
    {"material"},
    {"measurement", "geometry"},
    {"standards"},
    {"extraction", "forward"},
    {"circuits"},
    {"effects"},
    {"inference"},
    {"diagnosis"},
    {"study"},
    {"output"},
    {"api"},
    {"batch"},
    {"store"},
    {"instruments"},
    {"web"},
    {"terminal"},
    {"cli"},
)


def _layer(name: str) -> int:
    """Number of the layer of a module."""
    return next(level for level, members in enumerate(LAYERS) if name in members)


def _imports():
    """(module, imported module) of every import within the package."""
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[0] == "__init__":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("femu_piezo."):
                yield "/".join(parts), parts[0], node.module.split(".")[1]


def test_imports_point_down():
    wrong = [f"{path} imports {target}" for path, origin, target in _imports() if _layer(target) > _layer(origin)]
    assert not wrong
    assert len(list(_imports())) > 50


def test_extraction_and_forward_never_import_each_other():
    pairs = {(origin, target) for _, origin, target in _imports()}
    assert ("extraction", "forward") not in pairs
    assert ("forward", "extraction") not in pairs
    assert ("measurement", "geometry") not in pairs


def test_no_relative_imports_and_no_pickle_or_eval():
    for path in ROOT.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, path
                assert node.module != "pickle", path
            if isinstance(node, ast.Import):
                assert all(alias.name not in ("pickle", "marshal") for alias in node.names), path
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("eval", "exec"), path
