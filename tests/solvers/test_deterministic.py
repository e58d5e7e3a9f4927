# SPDX-License-Identifier: Apache-2.0
"""The same bits in whatever order contacts are found and added, as on a GPU from run to run.

The CPU takes everything in turn, so the disorder is made here: candidates are shuffled, parallel
branches run in another order, and whatever adds by atomics goes through its contacts in another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.potentials.contact import ContactPotential
from taccel_lab.ipc.potentials.friction import FrictionPotential
from taccel_lab.model.launches import Branches
from taccel_lab.scene import Element, KinematicBody, Plane, Scene
from tests.solvers.driven_grasp import base_poses, driven_grasp
from tests.solvers.steps import begun, left, stepped
from tests.support.blocks import cube, soft_block
from tests.support.grasps import FALLING, mount_poses, mounted_gels
from tests.support.variants import variants

ENVS = 2


def grasp() -> Scene:
    """A cube between two gels on mounts: on the CPU with blocks outside of the pattern."""
    gels, mounts = mounted_gels((3, 3, 1), (Element.LINEAR, Element.QUADRATIC))
    held = cube(8e-3, friction_coefficient=1.0)
    floor = Plane((0, 0, -4.05e-3), (0, 0, 1), friction_coefficient=0.5)
    return Scene(gels, mounts, ENVS, FALLING, affine_bodies=[held], planes=[floor])


def grasp_poses(step: int) -> np.ndarray:
    return mount_poses(np.array([4.05e-3, 4.06e-3]) - 6e-5 * min(step, 4), 1e-4 * max(step - 4, 0))


def pads() -> Scene:
    size, rubs = (4e-3, 4e-3, 2e-3), {"friction_coefficient": 0.5}
    gels = [
        soft_block((3, 3, 1), size, name="lower", mount="lower mount", **rubs),
        soft_block((2, 2, 1), size, name="upper", mount="upper mount", **rubs),
    ]
    return Scene(gels, [KinematicBody(None, name=f"{gel.name} mount") for gel in gels], ENVS)


def pad_poses(step: int) -> np.ndarray:
    depth = 4e-5 * min(step, 4)
    along = np.array([1e-5, 2e-5]) * step
    upper = [[x, 0, 1.1e-4 - depth, 1, 0, 0, 0] for x in along]
    return np.array([[[0, 0, 0, 0, 0, 0, 1], pose] for pose in upper])


SCENES: dict[str, tuple[Callable[[], Scene], Callable[[int], np.ndarray]]] = {
    "grasp": (grasp, grasp_poses),
    "pads": (pads, pad_poses),
    "driven": (driven_grasp, lambda step: base_poses(ENVS, 1e-4 * max(step - 4, 0))),
}


def run(name: str, deterministic: bool) -> list[np.ndarray]:
    make, poses = SCENES[name]
    options = {"dhat_m": 1e-4, "capture": False, "relative_tolerance": 1e-8}
    solver, state = begun(make().finalize("cpu"), poses(0), deterministic=deterministic, **options)
    for step in range(1, 7):
        stepped(solver, state, poses(step))
    assert solver.friction is not None
    assert solver.friction.counts.numpy().min() > 8, "they touch"
    for env in range(ENVS):
        found = solver.collisions.snapshot(env)
        keys = np.column_stack([found["kinds"], found["stencils"]])
        assert len(np.unique(keys, axis=0)) == len(keys), "what they are sorted by is their own"
    return left(solver, state)


in_turn = cache(run)


def permute(
    arrays: Iterable[wp.array], starts: wp.array, counts: wp.array, rng: np.random.Generator
) -> Callable[[], None]:
    """Shuffle the entries of each environment; returns what puts them back."""
    changed: list[tuple[np.ndarray, np.ndarray]] = []
    for first, count in zip(starts.numpy(), counts.numpy(), strict=False):
        order = rng.permutation(int(count))
        for array in arrays:
            entries = array.numpy()[first : first + count]
            changed.append((entries, entries.copy()))
            entries[:] = entries[order]

    def restore() -> None:
        for entries, before in changed:
            entries[:] = before

    return restore


def disorder(patch: pytest.MonkeyPatch, seed: int) -> None:
    rng = np.random.default_rng(seed)
    search = Candidates.search

    def shuffled_search(self: Candidates, *inputs: Any) -> None:
        search(self, *inputs)
        for part in (self.node_faces, self.edge_edges):
            fits = np.minimum(part.counts.numpy(), part.rooms).astype(np.int32)
            permute([part.pairs], part.starts, wp.array(fits, dtype=wp.int32, device="cpu"), rng)

    def shuffled_branches(self: Branches, parts: Any) -> None:
        for i in rng.permutation(len(parts)):
            parts[i]()

    def shuffling(method: Any, arrays_of: Callable[[Any], list[wp.array]]) -> Any:
        def wrapped(self: Any, *inputs: Any) -> None:
            restore = permute(arrays_of(self), self.room.starts, self.room.counts, rng)
            method(self, *inputs)
            restore()

        return wrapped

    def of_contact(self: ContactPotential) -> list[wp.array]:
        return [getattr(self.collisions, name) for name in self.collisions.columns]

    def of_friction(self: FrictionPotential) -> list[wp.array]:
        names = ("stencils", "weights", "normals", "mu_lambdas", "normal_motions")
        return [getattr(self.frozen, name) for name in names]

    patch.setattr(Candidates, "search", shuffled_search)
    patch.setattr(Branches, "run", shuffled_branches)
    for owner, arrays_of in ((ContactPotential, of_contact), (FrictionPotential, of_friction)):
        for name in ("add_gradient", "add_hessian"):
            patch.setattr(owner, name, shuffling(getattr(owner, name), arrays_of))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("deterministic", "name"), variants([(True, "grasp"), (False, "grasp")], [True, False], SCENES)
)
def test_bits_depend_on_the_order_of_contacts_unless_asked_not_to(
    name: str, deterministic: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    ordered = in_turn(name, deterministic)
    disorder(monkeypatch, 1)
    same = [np.array_equal(a, b) for a, b in zip(ordered, run(name, deterministic), strict=True)]
    assert same == [deterministic] * 4
    if deterministic:
        # The result is that of any order within the tolerance.
        plain = in_turn(name, False)
        np.testing.assert_allclose(ordered[0], plain[0], rtol=0, atol=1e-9)
        for a, b in zip(plain[2:], ordered[2:], strict=True):
            np.testing.assert_allclose(b, a, rtol=0, atol=1e-5 * np.abs(a).max())
