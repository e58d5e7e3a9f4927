# SPDX-License-Identifier: Apache-2.0
"""Parts of a scene hold exactly what their environments had in the whole."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, is_dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import (
    AffineBody,
    Ball,
    FixedJoint,
    KinematicBody,
    Plane,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
    Scene,
    SoftBody,
    Surface,
    VelocityDrive,
    box_mesh,
)
from taccel_lab.scene.shards import PER_ENVIRONMENT, cut_scene, shard_of, shard_slice
from tests.support.scene_steps import in_time, linear

MESH = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
SHARED = {
    SoftBody: "mesh material bonded_nodes name friction_coefficient mount mount_pose element "
    "self_contact surface initial_velocity_m_s",
    AffineBody: "shape density_kg_m3 young_modulus_pa name friction_coefficient surface "
    "initial_velocity_m_s initial_spin_rad_s stated_mass",
    KinematicBody: "shape friction_coefficient name surface",
    Plane: "point_m normal friction_coefficient name surface",
    Surface: "layer collides_with thickness_m apart_from environments",
    FixedJoint: "first second name bodies_touch",
    RevoluteJoint: "first second name bodies_touch limits_deg drive",
    PrismaticJoint: "first second name bodies_touch limits_mm drive",
    PositionDrive: "stiffness damping max_effort",
    VelocityDrive: "damping max_effort",
    Scene: "soft_bodies kinematic_bodies env_count time affine_bodies planes joints pair_friction",
}
"""Fields that are the same in all environments, or cut by a rule of their own."""


def poses(count: int, seed: int) -> np.ndarray:
    draw = np.random.default_rng(seed)
    turn = draw.normal(size=(count, 4))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    return np.concatenate([draw.normal(size=(count, 3)), turn], axis=1)


def full_scene(count: int) -> Scene:
    draw = np.random.default_rng(7)
    rest = MESH.nodes_m + 1e-5 * draw.normal(size=(count, MESH.node_count, 3))
    cube = box_mesh((1e-3,) * 3)
    return Scene(
        [
            linear(MESH, rest_positions_m=rest, initial_pose=poses(count, 1)),
            linear(MESH, name="mounted", mount="frame"),
        ],
        [
            KinematicBody(Ball(1e-3), name="ball", surface=Surface(environments=(0, count - 1))),
            KinematicBody(None, name="frame"),
        ],
        count,
        in_time(1e-2, 0.0),
        affine_bodies=[
            AffineBody(cube, name="a", initial_pose=poses(count, 2)),
            AffineBody(cube, name="b", surface=Surface(environments=tuple(range(1, count)))),
        ],
        planes=Plane((0, 0, -1), (1, 2, 3), surface=Surface(environments=(count // 2,))),
        joints=[
            FixedJoint("b", anchor_m=draw.normal(size=(count, 3))),
            RevoluteJoint(
                "a",
                "frame",
                axis=draw.normal(size=(count, 3)),
                second_pose=poses(count, 3),
                name="hinge",
                drive=PositionDrive(1.0, target=draw.normal(size=count)),
            ),
            PrismaticJoint("a", "b", name="rail", drive=VelocityDrive(1.0, target=0.25)),
        ],
        pair_friction={("a", "b"): 0.3},
    )


def test_every_field_is_known_to_be_shared_or_cut() -> None:
    """A field that is new in a description must be sorted into one or the other."""
    for kind, names in SHARED.items():
        found = {field.name for field in fields(kind)}
        assert found - set(PER_ENVIRONMENT) == set(names.split()), kind.__name__
    used = {field.name for kind in SHARED for field in fields(kind)}
    assert set(PER_ENVIRONMENT) <= used


def rows_of(scene: Scene, env: int) -> dict[str, object]:
    found: dict[str, object] = {}

    def look(item: object, where: str) -> None:
        assert is_dataclass(item)
        for field in fields(item):
            value = getattr(item, field.name)
            place = f"{where}.{field.name}"
            if field.name in PER_ENVIRONMENT and value is not None:
                array = np.asarray(value)
                if array.ndim == PER_ENVIRONMENT[field.name]:
                    assert len(array) == scene.env_count
                    array = array[env]
                found[place] = array.tobytes()
            elif field.name == "environments":
                found[place] = value is None or env in value
            elif field.name in ("surface", "drive") and value is not None:
                look(value, place)
            else:
                # The very same objects: nothing is copied.
                found[place] = value if isinstance(value, (str, float, int, tuple)) else id(value)

    for i, item in enumerate([*scene.bodies, *scene.joints]):
        look(item, f"{i}")
    found["time"], found["friction"] = scene.time, scene.pair_friction
    return found


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_parts_hold_the_rows_of_the_whole(count: int) -> None:
    whole = full_scene(5)
    parts = [shard_of(whole, rank, count) for rank in range(count)]
    assert sum(part.env_count for part in parts) == 5
    env = 0
    for part in parts:
        for row in range(part.env_count):
            assert rows_of(part, row) == rows_of(whole, env)
            env += 1
    different = [rows_of(whole, env) for env in range(5)]
    assert all(a != b for a, b in pairwise(different)), "the environments were meant to differ"


def test_a_cut_scene_passes_the_checks_of_a_scene_that_is_made_anew() -> None:
    whole = full_scene(4)
    for part in (cut_scene(whole, 1, 3), cut_scene(whole, 3, 4), cut_scene(whole, 0, 4)):
        again = Scene(**{field.name: getattr(part, field.name) for field in fields(Scene)})
        assert rows_of(again, 0).keys() == rows_of(part, 0).keys()


@given(env_count=st.integers(1, 10_000), world_size=st.integers(1, 64))
def test_slices_cover_all_environments_evenly(env_count: int, world_size: int) -> None:
    if world_size > env_count:
        with pytest.raises(InputError, match=f"at most {env_count} devices"):
            shard_slice(env_count, 0, world_size)
        return
    parts = [shard_slice(env_count, rank, world_size) for rank in range(world_size)]
    assert parts[0].start == 0 and parts[-1].stop == env_count
    assert all(a.stop == b.start for a, b in pairwise(parts))
    sizes = [part.stop - part.start for part in parts]
    assert max(sizes) - min(sizes) <= 1 and min(sizes) >= 1


def test_wrong_parts_are_refused() -> None:
    scene = Scene(linear(MESH), env_count=3)
    for rank, count, words in (
        (0, 0, "world_size must be at least 1"),
        (0, 4, "3 environments cannot be split into 4 parts"),
        *((rank, 2, rf"rank must lie in \[0, 1\], got {rank}") for rank in (-1, 2)),
    ):
        with pytest.raises(InputError, match=words):
            shard_of(scene, rank, count)
    for first, last in ((-1, 2), (1, 1), (2, 1), (0, 4)):
        with pytest.raises(InputError, match=r"numbered from 0"):
            cut_scene(scene, first, last)


@pytest.mark.slow
def test_the_example_runs_a_process_a_device() -> None:
    script = Path(__file__).parents[2] / "docs" / "examples" / "many_gpus.py"
    words = [sys.executable, str(script), "2", "cpu", "cpu"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert "steps/s on 2 devices" in done.stdout
