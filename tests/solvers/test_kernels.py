# SPDX-License-Identifier: Apache-2.0
"""Device code: what kernels are given, and one size of thread blocks for each module."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import pytest
import warp as wp

from taccel_lab.bodies.material import MaxwellBranch
from taccel_lab.scene import AffineBody, Element, Material, Plane, RevoluteJoint, Scene, box_mesh
from taccel_lab.solvers.env_progress import Progress
from tests.solvers.steps import begun, stepped
from tests.support.blocks import pose
from tests.support.grasps import FALLING, mount_poses, mounted_gels


def test_what_a_step_knows_comes_in_parts_of_at_most_twenty_arrays() -> None:
    parts = [member.type.vars for member in Progress.vars.values()]
    assert all(len(part) <= 20 for part in parts)
    names = [name for part in parts for name in part]
    assert len(names) == len(set(names)) > 60


def grasp() -> Scene:
    """Two gels of either element on mounts, damped, a jointed pair between them, above a plane."""
    material = Material(1e5, 0.4, branches=(MaxwellBranch(0.5, 1e-2),))
    gels, mounts = mounted_gels((2, 2, 1), (Element.LINEAR, Element.QUADRATIC), material)
    shape, rubs = box_mesh((8e-3, 8e-3, 4e-3)), {"friction_coefficient": 1.0}
    halves = [
        AffineBody(shape, name=name, initial_pose=pose(0, 0, z), **rubs)
        for name, z in (("lower", -2.2e-3), ("upper", 2.2e-3))
    ]
    planes = [Plane((0, 0, -5e-3), (0, 0, 1))]
    hinge = RevoluteJoint("lower", "upper", (0, 0, 0), (0, 1, 0))
    return Scene(gels, mounts, 1, FALLING, affine_bodies=halves, planes=planes, joints=[hinge])


@pytest.mark.thorough
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
    start, *targets = (mount_poses([4.05e-3 - 5e-5 * step]) for step in range(4))
    solver, state = begun(grasp(), start, dhat_m=1e-4, capture=False)
    for target in targets:
        stepped(solver, state, target)
    assert solver.friction_gradient.numpy().any() and len(sizes) > 20
    assert not {name: dict(found) for name, found in sizes.items() if len(found) > 1}
    # What a module is compiled for ahead of its first launch, and what its shared memory is for.
    assert not {name: found for name, found in sizes.items() if stated[name] not in (256, *found)}
