# SPDX-License-Identifier: Apache-2.0
"""Signatures of the solver's device code: who writes what stands where a reader looks first."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from taccel_lab.solvers.env_progress import PARTS

PACKAGE = Path(__file__).parents[2] / "taccel_lab"
SOLVERS = sorted((PACKAGE / "solvers").glob("*.py"))
CALLED = [*SOLVERS, *(PACKAGE / "ipc").rglob("*.py"), *(PACKAGE / "model").glob("*.py")]


def device_functions(path: Path) -> Iterator[ast.FunctionDef]:
    """Kernels of a file, and the functions that they call."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        decorators = node.decorator_list if isinstance(node, ast.FunctionDef) else []
        if any(ast.unparse(d).startswith(("wp.kernel", "wp.func")) for d in decorators):
            assert isinstance(node, ast.FunctionDef)
            yield node


FUNCTIONS = {node.name: node for path in CALLED for node in device_functions(path)}


def root(node: ast.expr) -> str:
    """The variable at the left of attributes and indices."""
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else ""


def arguments(function: ast.FunctionDef) -> list[str]:
    return [a.arg for a in function.args.args]


def written(function: ast.FunctionDef) -> set[str]:
    """Arguments whose arrays it writes, or has written by what it calls."""
    found = set[str]()
    for node in ast.walk(function):
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AugAssign):
            targets = [node.target]
        found |= {root(t) for t in targets if isinstance(t, ast.Attribute | ast.Subscript)}
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name.startswith("wp.atomic_"):
                found.add(root(node.args[0]))
            elif name in FUNCTIONS:
                names, outs = arguments(FUNCTIONS[name]), written(FUNCTIONS[name])
                given = zip(names, node.args, strict=False)
                found |= {root(value) for name, value in given if name in outs}
    return found & set(arguments(function))


@pytest.mark.parametrize("path", SOLVERS, ids=lambda path: path.stem)
def test_arguments_are_marked_out_that_are_written_and_no_others(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    for function in device_functions(path):
        marked = {a.arg for a in function.args.args if lines[a.lineno - 1].endswith("  # out")}
        assert marked == written(function), function.name


def test_what_a_step_knows_comes_in_parts_of_at_most_twenty_arrays() -> None:
    assert all(len(part.vars) <= 20 for part in PARTS.values())
    names = [name for part in PARTS.values() for name in part.vars]
    assert len(names) == len(set(names)) > 60


@pytest.mark.parametrize("path", SOLVERS, ids=lambda path: path.stem)
def test_kernels_take_the_parts_that_they_use_under_their_names(path: Path) -> None:
    structs = {part.key: name for name, part in PARTS.items()}
    for function in device_functions(path):
        kinds = {a.arg: ast.unparse(a.annotation) for a in function.args.args if a.annotation}
        taken = [name for name, kind in kinds.items() if kind in structs]
        assert taken == [structs[kinds[name]] for name in taken], function.name
        assert taken == sorted(taken, key=list(PARTS).index), function.name
        body = "\n".join(map(ast.unparse, function.body))
        assert all(re.search(rf"\b{name}\b", body) for name in taken), function.name
