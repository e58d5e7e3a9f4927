# SPDX-License-Identifier: Apache-2.0
"""Device code: what kernels are given, and one size of thread blocks for each module."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.bodies.maxwell import MaxwellBranch
from taccel_lab.scene import AffineBody, Element, Material, Plane, RevoluteJoint, Scene, box_mesh
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.solvers.env_progress import PARTS
from taccel_lab.state import initial_state
from tests.support.blocks import pose
from tests.support.grasps import FALLING, mount_poses, mounted_gels

PACKAGE = Path(__file__).parents[2] / "taccel_lab"
SOLVERS = sorted((PACKAGE / "solvers").glob("*.py"))
CALLED = [*SOLVERS, *(PACKAGE / "ipc").rglob("*.py"), *(PACKAGE / "model").glob("*.py")]


@cache
def device_functions(path: Path) -> list[ast.FunctionDef]:
    """Kernels of a file, and the functions that they call."""
    tree = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    functions = [node for node in tree if isinstance(node, ast.FunctionDef)]
    return [
        function
        for function in functions
        if any(ast.unparse(d).startswith(("wp.kernel", "wp.func")) for d in function.decorator_list)
    ]


@cache
def all_functions() -> dict[str, ast.FunctionDef]:
    return {node.name: node for path in CALLED for node in device_functions(path)}


def root(node: ast.expr) -> str:
    """The variable at the left of attributes and indices."""
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else ""


def arguments(function: ast.FunctionDef) -> list[str]:
    return [a.arg for a in function.args.args]


@cache
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
            elif name in all_functions():
                called = all_functions()[name]
                names, outs = arguments(called), written(called)
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


def grasp() -> Scene:
    """Two gels of either element on mounts, damped, a jointed pair between them, above a plane."""
    material = Material(1e5, 0.4, branches=(MaxwellBranch(0.5, 1e-2),))
    gels, mounts = mounted_gels((2, 2, 1), (Element.LINEAR, Element.QUADRATIC), material)
    halves = [
        AffineBody(
            box_mesh((8e-3, 8e-3, 4e-3)), name=name, friction_coefficient=1.0,
            initial_pose=pose(0, 0, z),
        )
        for name, z in (("lower", -2.2e-3), ("upper", 2.2e-3))
    ]  # fmt: skip
    planes = [Plane((0, 0, -5e-3), (0, 0, 1))]
    hinge = RevoluteJoint("lower", "upper", (0, 0, 0), (0, 1, 0))
    return Scene(gels, mounts, 1, FALLING, affine_bodies=halves, planes=planes, joints=[hinge])


def grasp_poses(step: int) -> np.ndarray:
    return mount_poses([4.05e-3 - 5e-5 * step])


def test_a_module_has_one_size(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: dict[str, dict[int, set[str]]] = defaultdict(lambda: defaultdict(set))
    stated: dict[str, int] = {}

    def noting(launch: Any) -> Any:
        def note(kernel: wp.Kernel, *args: Any, **options: Any) -> Any:
            module = kernel.module
            # What Warp takes where a launch does not say, whatever the module states.
            size = options.get("block_dim") or 256
            # The linear solvers choose theirs by the number of environments.
            if ".linear." not in module.name:
                sizes[module.name][size].add(kernel.key)
                stated[module.name] = module.options["block_dim"]
            return launch(kernel, *args, **options)

        return note

    for name in ("launch", "launch_tiled"):
        monkeypatch.setattr(wp, name, noting(getattr(wp, name)))
    config = SolverConfig(dhat_m=1e-4, capture=False)
    solver = SolverIPC(grasp().finalize(), config)
    state = initial_state(solver.model, grasp_poses(0))
    for step in range(1, 4):
        assert solver.step(state, grasp_poses(step)).converged.all()
    assert solver.friction_gradient.numpy().any()
    assert len(sizes) > 20
    several = {name: dict(found) for name, found in sizes.items() if len(found) > 1}
    assert not several
    # What a module is compiled for ahead of its first launch, and what its shared memory is for.
    others = {name: found for name, found in sizes.items() if stated[name] not in (256, *found)}
    assert not others
