# SPDX-License-Identifier: Apache-2.0
"""Scenes that cannot be solved are refused with what was found and what is allowed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.scene import (
    AffineBody,
    Ball,
    Element,
    KinematicBody,
    Material,
    Plane,
    Scene,
    SoftBody,
    Surface,
    TimeScheme,
    TimeStepping,
    TriangleMesh,
    box_mesh,
    cylinder_mesh,
    sphere_mesh,
)
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import as_poses, initial_state
from tests.support.blocks import block_mesh, everywhere, pose

NAN, INF = float("nan"), float("inf")
MESH = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
GEL = Material(1e5, 0.45)


@pytest.mark.parametrize(
    ("young", "poisson", "density", "words"),
    [
        (-1e5, 0.4, 1000, "Young's modulus.*100 Pa.*-100000"),
        (0.0, 0.4, 1000, "Young's modulus"),
        (0.15, 0.4, 1000, "the unit is pascal"),
        (NAN, 0.4, 1000, "Young's modulus.*nan"),
        (INF, 0.4, 1000, "Young's modulus"),
        (1e5, 0.5, 1000, r"Poisson's ratio must lie in \(-1, 0.5\), got 0.5"),
        (1e5, 0.7, 1000, "Poisson's ratio"),
        (1e5, -1.0, 1000, "Poisson's ratio"),
        (1e5, NAN, 1000, "Poisson's ratio"),
        (1e5, 0.4, -5, "density"),
        (1e5, 0.4, NAN, "density"),
    ],
)
def test_materials(young: float, poisson: float, density: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        Material(young, poisson, density)


@pytest.mark.parametrize("friction", [-0.1, NAN, INF, 11.0])
def test_friction(friction: float) -> None:
    with pytest.raises(InputError, match="friction coefficient of 'pin'"):
        KinematicBody(Ball(1e-3), friction, name="pin")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Ball(0.0), "ball radius"),
        (lambda: Ball(NAN), "ball radius.*nan"),
        (lambda: Ball(4.0), "ball radius.*4000 mm"),
        (lambda: sphere_mesh(1e-3, -1.0), "edge"),
        (lambda: box_mesh((1e-3, 0.0, 1e-3)), "box edge"),
        (lambda: cylinder_mesh(1e-3, NAN), "cylinder height"),
        (lambda: cylinder_mesh(1e-3, 1e-3, segments=3), "at least 8 segments, got 3"),
    ],
)
def test_primitives(make: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()


@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        (np.zeros((4, 2)), [[0, 1, 2]], r"vertices \[n, 3\]"),
        (np.zeros((4, 3)), [[0, 1, 2, 3]], r"faces \[n, 3\]"),
        (np.zeros((4, 3)), np.zeros((0, 3)), r"faces \[n, 3\]"),
        (np.full((4, 3), NAN), [[0, 1, 2]], "NaN"),
        (np.eye(4, 3), [[0, 1, 4]], "do not exist"),
        (np.eye(4, 3), [[0, 1, -1]], "do not exist"),
    ],
)
def test_triangle_meshes(vertices: np.ndarray, faces: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        TriangleMesh(vertices, np.asarray(faces))


def test_tet_meshes() -> None:
    nodes = MESH.nodes_m.copy()
    nodes[0] = NAN
    with pytest.raises(InputError, match="NaN"):
        TetMesh(nodes, MESH.tets, MESH.faces, MESH.face_regions)
    with pytest.raises(InputError, match="inverted or flat"):
        TetMesh(MESH.nodes_m, MESH.tets[:, [1, 0, 2, 3]], MESH.faces, MESH.face_regions)
    with pytest.raises(InputError, match="face_regions has shape"):
        TetMesh(MESH.nodes_m, MESH.tets, MESH.faces, MESH.face_regions[1:])
    with pytest.raises(InputError, match="do not exist"):
        TetMesh(MESH.nodes_m[:-1], MESH.tets, MESH.faces, MESH.face_regions)


@pytest.mark.parametrize("dt", [0.0, -0.01, NAN, 100.0])
def test_time_steps(dt: float) -> None:
    with pytest.raises(InputError, match="dt must lie in"):
        TimeStepping(quasi_static=False, dt_s=dt)


@pytest.mark.parametrize("gravity", [(0, 0, NAN), (INF, 0, 0), (0, 0)])
def test_gravity_must_be_a_finite_vector(gravity: Any) -> None:
    with pytest.raises(InputError, match="gravity"):
        TimeStepping(quasi_static=False, gravity_m_s2=gravity)


def test_gravity_without_inertia_is_not_silently_ignored() -> None:
    with pytest.raises(InputError, match=r"gravity.*quasi_static"):
        TimeStepping(quasi_static=True, gravity_m_s2=(0, 0, -9.81))


def test_scenes() -> None:
    with pytest.raises(InputError, match="env_count must be at least 1, got 0"):
        Scene(SoftBody(MESH, GEL, element=Element.LINEAR), env_count=0)
    with pytest.raises(InputError, match=r"rest_positions_m has shape \(2, 18, 3\).*\(3, 18, 3\)"):
        Scene(
            SoftBody(MESH, GEL, rest_positions_m=np.zeros((2, 18, 3)), element=Element.LINEAR),
            env_count=3,
        )
    with pytest.raises(InputError, match="at least three bonded nodes"):
        Scene(SoftBody(MESH, GEL, bonded_nodes=np.array([0, 1]), element=Element.LINEAR))


@pytest.mark.parametrize("node", [-1, 18])
def test_bonded_nodes_must_exist(node: int) -> None:
    bonded = np.array([0, 2, 4, node])
    with pytest.raises(InputError, match="bonded_nodes"):
        Scene(SoftBody(MESH, GEL, bonded_nodes=bonded, element=Element.LINEAR)).finalize()


def test_every_node_bonded_leaves_nothing_to_solve() -> None:
    with pytest.raises(InputError, match="bonded"):
        Scene(SoftBody(MESH, GEL, bonded_nodes=np.arange(18), element=Element.LINEAR)).finalize()


def test_rest_shapes_of_environments() -> None:
    good = MESH.nodes_m
    inverted = good.copy()
    inverted[-1] -= [0, 0, 3e-3]
    for bad, words in ((inverted, "environment 1 is inverted"), (good * NAN, "environment 1")):
        rest = np.stack([good, bad])
        with pytest.raises(InputError, match=words):
            Scene(
                SoftBody(MESH, GEL, rest_positions_m=rest, element=Element.LINEAR), env_count=2
            ).finalize()


def on_cube(carrier: AffineBody | None = None, **options: Any) -> Scene:
    """A gel on an affine body."""
    body = AffineBody(box_mesh((1e-3, 1e-3, 1e-3)), name="cube") if carrier is None else carrier
    gel = SoftBody(MESH, GEL, **{"name": "pad", "mount": "cube", **options})
    return Scene(
        gel,
        KinematicBody(None, name="frame"),
        env_count=2,
        affine_bodies=body,
        time=TimeStepping(quasi_static=False),
    )


REST = np.stack([MESH.nodes_m, MESH.nodes_m * 1.01])
CUBE = box_mesh((1e-3, 1e-3, 1e-3))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: on_cube(mount="hand"),
            "mount 'hand' of 'pad' must be the name of one kinematic or affine body; there are "
            "'cube', 'frame'",
        ),
        (
            lambda: on_cube(mount="frame", mount_pose=pose(0, 0, 1e-3)),
            "mount_pose of 'pad' is for a mount that is an affine body; 'frame' is kinematic",
        ),
        (
            lambda: on_cube(mount=None, mount_pose=pose(0, 0, 1e-3)),
            "'pad' has a mount_pose, but no mount",
        ),
        (
            lambda: on_cube(mount_pose=np.tile(pose(0, 0, 1e-3), (2, 1))),
            r"mount_pose of 'pad' is one for all environments, \[7\], got shape \(2, 7\)",
        ),
        (
            lambda: on_cube(mount_pose=np.array([0, 0, 0, 0, 0, 0, 2.0])),
            "of 'pad' in its mount must have unit length",
        ),
        (
            lambda: on_cube(initial_pose=pose(0, 0, 1e-3)),
            "'pad' has a mount: its pose is the mount's",
        ),
        (
            lambda: on_cube(initial_velocity_m_s=(0, 0, 1.0)),
            "'pad' starts to move as its mount 'cube' does",
        ),
        (
            lambda: on_cube(AffineBody(CUBE, name="cube", surface=Surface(environments=(0,)))),
            "'cube' carries 'pad': it must be present in all environments",
        ),
        (
            lambda: on_cube(rest_positions_m=REST),
            "rest_positions_m of 'pad' must have the bonded nodes in the same places in all",
        ),
        (
            lambda: on_cube(bonded_nodes=np.zeros(0, dtype=int)),
            "'pad' has a mount, but no bonded nodes to hold it there",
        ),
    ],
)
def test_gels_on_affine_bodies(make: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()


def test_collision_surfaces_must_be_manifold() -> None:
    fan = TriangleMesh(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]]) * 1e-3,
        np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]),
    )
    with pytest.raises(InputError, match=r"not manifold: 1 edges .* two faces.*\(0, 1\)"):
        Scene(SoftBody(MESH, GEL, element=Element.LINEAR), (KinematicBody(fan),)).finalize()


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        (np.zeros((1, 7)), "poses have shape"),
        (np.zeros((2, 1, 7)), "poses have shape"),
        (everywhere(1, pose(NAN, 0, 0)), "NaN"),
        (np.zeros((1, 1, 7)), "unit length"),
        (everywhere(1, 2 * pose(0, 0, 1)), "unit length"),
    ],
)
def test_poses(poses: np.ndarray, words: str) -> None:
    model = Scene(
        SoftBody(MESH, GEL, element=Element.LINEAR), (KinematicBody(Ball(1e-3)),)
    ).finalize()
    with pytest.raises(InputError, match=words):
        as_poses(model, poses)
    with pytest.raises(InputError, match=words):
        initial_state(model, poses)
    state = initial_state(model, everywhere(1, pose(0, 0, 5e-3)))
    with pytest.raises(InputError, match=words):
        SolverIPC(model).step(state, poses)


BOX = box_mesh((1e-3, 1e-3, 1e-3))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: AffineBody(BOX, -1.0, name="peg"), "density of 'peg'.*got -1"),
        (lambda: AffineBody(BOX, 0.0), "density"),
        (lambda: AffineBody(BOX, NAN), "density.*nan"),
        (lambda: AffineBody(BOX, young_modulus_pa=-1e9, name="peg"), "young_modulus_pa of 'peg'"),
        (lambda: AffineBody(BOX, young_modulus_pa=INF), "young_modulus_pa"),
        (lambda: AffineBody(Ball(1e-3)), "needs a closed TriangleMesh"),
        (lambda: AffineBody(BOX, initial_pose=np.zeros(6)), r"pose.*\(6,\)"),
        (lambda: AffineBody(BOX, initial_pose=np.zeros(7)), "unit length"),
        (lambda: AffineBody(BOX, initial_pose=pose(NAN, 0, 0)), "pose.*NaN"),
        (lambda: AffineBody(BOX, initial_velocity_m_s=(0, NAN, 0)), "initial_velocity_m_s"),
        (lambda: AffineBody(BOX, initial_spin_rad_s=(0, INF, 0)), "initial_spin_rad_s"),
        (lambda: Plane(normal=(0, 0, 0)), "normal.*must not be zero"),
        (lambda: Plane(point_m=(0, 0, NAN)), "point_m"),
        (lambda: Surface(thickness_m=-1e-4), "thickness_m"),
        (lambda: Surface(layer=-1), "layer"),
        (lambda: TimeStepping(scheme="rk4"), "scheme must be one of euler, bdf2, got 'rk4'"),
    ],
)
def test_bodies_and_schemes(make: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()


def test_a_scheme_may_be_given_by_name() -> None:
    assert TimeStepping(quasi_static=False, scheme="bdf2").scheme is TimeScheme.BDF2  # pyright: ignore


def test_open_affine_bodies_have_no_mass() -> None:
    lid = TriangleMesh(BOX.vertices_m, BOX.faces[2:])
    body = AffineBody(lid, name="peg")
    with pytest.raises(InputError, match=r"body 0 \('peg'\) is not closed: 4 edges"):
        Scene(affine_bodies=body, time=TimeStepping(quasi_static=False)).finalize()
