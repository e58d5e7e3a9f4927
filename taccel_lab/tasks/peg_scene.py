# SPDX-License-Identifier: Apache-2.0
"""The peg insertion of Taccel (arXiv 2504.12908, ``examples/peg.py``), as a scene of ours.

Two gels on moving mounts grasp a peg whose section is a dog bone, carry it sideways while it drags
over the rim of the hole, and push it down; clearance 2 mm. Settings are the published ones; the
gels move 3.7 mm further than the hole lets the peg go, so they must slip and shear.

``published_parts`` reads the meshes of the example from a data folder, ``generated_parts`` makes
others of the same dimensions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from taccel_lab.bodies.mass_properties import mass_properties
from taccel_lab.exporters.published_meshes import choose_source, mesh_folder, read_stl
from taccel_lab.files.inner_path import inner_path
from taccel_lab.files.tet_file import read_tet_file
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.block import block_mesh, labelled
from taccel_lab.scene import (
    AffineBody,
    Element,
    FixedJoint,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TimeStepping,
    TriangleMesh,
)

DT_S = 1 / 50
STEPS = 200
DHAT_M = 1e-4
FRICTION_SPEED_M_S = 1e-2
"""Sliding speed below which friction is static, as published."""
GRAVITY = (0.0, 0.0, -9.81)
PEG_MASS_KG = 0.0205
"""Mass of the peg as published: half of what its volume weighs at the density of 1000 kg/m^3 that
is given, too."""
GEL = Material(young_modulus_pa=1e5, poisson_ratio=0.4, density_kg_m3=1000.0)
GEL_FRICTION, STIFF_FRICTION = 1.0, 0.2


@dataclass(frozen=True)
class PegPath:
    """Where the peg starts and how the gels move."""

    peg_m: tuple[float, float, float]
    """The peg's frame, its lower end in the middle, at the start."""
    times_s: tuple[float, ...]
    gel_m: np.ndarray
    """Places of the gel on the side of positive x at these times, shape [n, 3]; the other one is
    its mirror image. Straight lines between."""
    first: int = 0
    """Number of the first step: 0 stays at the start for a step, 1 moves at once."""

    @classmethod
    def of_mm(
        cls,
        peg_mm: Sequence[float],
        times_s: Sequence[float],
        gel_mm: Sequence[Sequence[float]],
    ) -> PegPath:
        """The path of a task's file."""
        x, y, z = (1e-3 * value for value in peg_mm)
        return cls((x, y, z), tuple(times_s), 1e-3 * np.array(gel_mm))


PUBLISHED = PegPath(
    (0.0, 0.005, 0.021),
    (0.0, 0.1, 2.0, 4.0),
    np.array(
        [
            (0.0171, 0.005, 0.071),
            (0.0165, 0.005, 0.071),
            (0.0165, -0.006, 0.066),
            (0.0165, -0.006, 0.05),
        ]
    ),
)
"""Path as published. The peg falls 1 mm onto the rim before the gels have it, and lies there askew;
the gels drag it along, turning in their grip, and push it into the hole still askew."""
_HALF = np.sqrt(0.5)
TURNS = np.array([(_HALF, 0.0, _HALF, 0.0), (0.0, -_HALF, 0.0, _HALF)])
"""Quaternions of both gels: their faces look at each other."""


@dataclass(frozen=True)
class PegParts:
    """The meshes of the scene."""

    gel: TetMesh
    """Middle of the pad at the origin, bonded at its smallest z."""
    peg: TriangleMesh
    hole: TriangleMesh
    peg_mass_kg: float = PEG_MASS_KG
    peg_friction: float = STIFF_FRICTION
    hole_friction: float = STIFF_FRICTION


def published_parts(folder: Path) -> PegParts:
    """The meshes of the published example, of ``pads`` and ``peg`` in a folder."""
    return PegParts(
        labelled(*read_tet_file(inner_path(folder, "pads/sensor.vtk"))),
        read_stl(inner_path(folder, "peg/peg.stl")),
        read_stl(inner_path(folder, "peg/hole.stl")),
    )


def peg_parts(source: str) -> tuple[PegParts, str]:
    """Meshes by where they are from, "published", "generated", or "auto" for the published ones
    where they are; and which these are."""
    source = choose_source(source, "peg/peg.stl", "peg/hole.stl", "pads/sensor.vtk")
    return (published_parts(mesh_folder()) if source == "published" else generated_parts()), source


DOG_BONE_CAP = [(0, 1, 7), (1, 6, 7), (1, 2, 6), (2, 5, 6), (2, 3, 5), (3, 4, 5)]
"""Triangles of the inside of a ``dog_bone``."""


def dog_bone(x: float, y: float, waist_x: float, waist_y: float) -> np.ndarray:
    """A rectangle of half sizes x, y, narrowed to ``waist_y`` within ``waist_x``: counter-clockwise
    from its corner (x, y), shape [8, 2]."""
    upper = [(x, y), (waist_x, waist_y), (-waist_x, waist_y), (-x, y)]
    return np.array([*upper, *((-a, -b) for a, b in upper)])


def prism(outline: np.ndarray, cap: list[tuple[int, int, int]], height: float) -> TriangleMesh:
    """A counter-clockwise outline [n, 2], with the triangulation of its inside, from z = 0 up."""
    n = len(outline)
    i, j = np.arange(n), (np.arange(n) + 1) % n
    flat = np.array(cap)
    vertices = [np.column_stack([outline, np.full(n, z)]) for z in (0.0, height)]
    sides = [np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)]
    return TriangleMesh(np.concatenate(vertices), np.concatenate([flat[:, ::-1], flat + n, *sides]))


def tube(inner: np.ndarray, outer: np.ndarray, height: float) -> TriangleMesh:
    """A block with a hole: outlines [n, 2], counter-clockwise, vertex beside vertex."""
    n = len(inner)
    i, j = np.arange(n), (np.arange(n) + 1) % n
    levels = [(ring, z) for z in (0.0, height) for ring in (inner, outer)]
    vertices = [np.column_stack([ring, np.full(n, z)]) for ring, z in levels]
    a, b, c, d = (k * n for k in range(4))
    quads = [
        (i + b, j + b, j + d, i + d),
        (j + a, i + a, i + c, j + c),
        (i + c, i + d, j + d, j + c),
        (i + b, i + a, j + a, j + b),
    ]
    faces = [np.stack(t, 1) for p, q, r, s in quads for t in ((p, q, r), (p, r, s))]
    return TriangleMesh(np.concatenate(vertices), np.concatenate(faces))


def generated_gel() -> TetMesh:
    """Gel of the published dimensions, in the frame of ``PegParts``."""
    size = (20.75e-3, 25.25e-3, 4e-3)
    pad = block_mesh((6, 7, 1), size, jitter=0.15, seed=4)
    return labelled(pad.nodes_m + [0, 0, size[2] / 2], pad.tets)


def generated_parts() -> PegParts:
    """Meshes of the published dimensions; about as many gel nodes as the published pad."""
    peg = prism(dog_bone(15e-3, 17.5e-3, 5e-3, 11.7265e-3), DOG_BONE_CAP, 50e-3)
    hole = dog_bone(17e-3, 20.9641e-3, 4.4641e-3, 13.7265e-3)
    outside = dog_bone(25e-3, 35e-3, 4.4641e-3, 35e-3)
    return PegParts(generated_gel(), peg, tube(hole, outside, 20e-3))


def peg_scene(
    parts: PegParts,
    path: PegPath = PUBLISHED,
    env_count: int = 1,
    hole_is_affine: bool = False,
    peg_poses: np.ndarray | None = None,
    dt_s: float = DT_S,
    gel: SoftBody | None = None,
) -> Scene:
    """The scene; kinematic bodies are both mounts and, unless it is affine, the hole.

    An affine hole is held by a fixed joint instead of being prescribed. ``peg_poses``: where the
    peg starts in each environment, [env_count, 7]; where the path says when None. ``gel`` stands in
    place of the example's, see ``face_offset``.
    """
    names = ("left", "right")
    if gel is None:
        gel = SoftBody(parts.gel, GEL, friction_coefficient=GEL_FRICTION, element=Element.LINEAR)
    gels = [replace(gel, name=name, mount=f"{name} mount") for name in names]
    frames = [KinematicBody(None, name=f"{name} mount") for name in names]
    volume = mass_properties(parts.peg, 1.0).volume_m3
    peg = AffineBody(
        parts.peg,
        density_kg_m3=parts.peg_mass_kg / volume,
        young_modulus_pa=1e9,
        name="peg",
        friction_coefficient=parts.peg_friction,
        initial_pose=np.array([*path.peg_m, 0, 0, 0, 1]) if peg_poses is None else peg_poses,
    )
    bodies, joints = [peg], []
    if hole_is_affine:
        bodies.append(
            AffineBody(
                parts.hole,
                young_modulus_pa=1e9,
                name="hole",
                friction_coefficient=parts.hole_friction,
            )
        )
        joints.append(FixedJoint("hole"))
    else:
        frames.append(KinematicBody(parts.hole, parts.hole_friction, name="hole"))
    time = TimeStepping(quasi_static=False, dt_s=dt_s, gravity_m_s2=GRAVITY)
    return Scene(gels, frames, env_count, time, affine_bodies=bodies, joints=joints)


def face_offset(parts: PegParts, gel: SoftBody) -> float:
    """How much further from the peg the mount of another gel has to be than the path says [m], for
    the crown of its contact face to be where the example's face is."""
    crowns = [float(mesh.nodes_m[:, 2].max()) for mesh in (gel.mesh, parts.gel)]
    return crowns[0] - crowns[1]


def targets(scene: Scene, step: int, path: PegPath = PUBLISHED) -> np.ndarray:
    """Poses of the kinematic bodies at a step, shape [env_count, kinematic_count, 7]."""
    place = [np.interp(step * scene.time.dt_s, path.times_s, path.gel_m[:, k]) for k in range(3)]
    mirrored = np.array([[-1, 1, 1], [1, 1, 1]]) * place
    poses = np.concatenate([mirrored, TURNS], axis=1)
    if len(scene.kinematic_bodies) > 2:
        poses = np.concatenate([poses, [[0, 0, 0, 0, 0, 0, 1]]])
    return np.tile(poses, (scene.env_count, 1, 1))
