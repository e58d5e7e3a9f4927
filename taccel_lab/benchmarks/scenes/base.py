# SPDX-License-Identifier: Apache-2.0
"""What a benchmark scene is: bodies, settings and a motion; pads, gels on mounts, poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.exporters.published_meshes import choose_source, mesh_folder
from taccel_lab.files.tet_file import read_tet_file
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.scene import Element, KinematicBody, Scene, SoftBody
from taccel_lab.solvers import SolverConfig
from taccel_lab.tasks.peg_scene import GEL

RESIDUAL_RATIO, RESIDUAL_N = 1e-4, 1e-5
"""A step counts as converged when the force residual is at most the first times the contact force,
or the second [N]; speeds are quoted at that."""


@dataclass(frozen=True)
class SceneOptions:
    """What a user may choose of any scene."""

    env_count: int = 1
    source: str = "auto"
    """Meshes: published, generated, or auto for the published ones where they are."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Fields of ``SolverConfig`` other than the scene's."""
    lag: int = 0
    """Environment e is e modulo (lag + 1) steps behind: environments that differ, as in use."""


@dataclass(frozen=True)
class BenchScene:
    """A scene and its motion."""

    name: str
    what: str
    """One line for a table."""
    scene: Scene
    config: SolverConfig
    path: np.ndarray
    """Poses of the kinematic bodies, [steps + 1, kinematic_count, 7]: at the start, and the target
    of each step."""
    source: str
    """published or generated: where the meshes are from."""
    notes: Mapping[str, Any] = field(default_factory=dict)
    """Figures of the arrangement that go into results."""
    lag: int = 0
    """See ``SceneOptions``."""

    def __post_init__(self) -> None:
        expected = (len(self.scene.kinematic_bodies), 7)
        if self.path.ndim != 3 or self.path.shape[1:] != expected:
            raise InputError(
                f"path of {self.name!r} has shape {self.path.shape}, expected [steps + 1, "
                f"{expected[0]}, 7]"
            )

    @property
    def steps(self) -> int:
        """Steps of the whole motion."""
        return len(self.path) - 1

    def targets(self, step: int) -> np.ndarray:
        """Poses at the end of a step (1, 2, ...; 0 is the start), [env, kinematic, 7]."""
        behind = np.arange(self.scene.env_count) % (self.lag + 1)
        return self.path[np.maximum(step - behind, 0)]


def make_config(defaults: Mapping[str, Any], chosen: Mapping[str, Any]) -> SolverConfig:
    """Settings of a scene, with what was chosen in their place."""
    try:
        return SolverConfig(**{"absolute_tolerance_n": RESIDUAL_N, **defaults, **chosen})
    except TypeError as error:
        raise InputError(f"no such setting of the solver: {error}") from None


def straight(points: np.ndarray, counts: list[int]) -> np.ndarray:
    """Poses along straight lines between key poses [k, ..., 7], ``counts`` steps for each line.

    Positions go evenly, quaternions by normalised linear interpolation (key poses are near each
    other or have the same turn). Shape [sum(counts) + 1, ..., 7].
    """
    rows = [points[:1]]
    for first, last, count in zip(points, points[1:], counts, strict=False):
        parts = (np.arange(count) + 1) / count
        parts = parts.reshape(-1, *[1] * (points.ndim - 1))
        rows.append(first + parts * (last - first))
    path = np.concatenate(rows)
    path[..., 3:] /= np.linalg.norm(path[..., 3:], axis=-1, keepdims=True)
    return path


SIZE_M = (40e-3, 40e-3, 5.925e-3)
"""Size of the pad of a parallel gripper, published at two resolutions."""
HELD_M = 2.9e-3
"""Depth below which the published pads are held: their back is in a tray."""
_FILES = {239: "single_sensor__pad_maxv_1e-07", 5215: "single_sensor__pad_maxv_1e-09"}
_CELLS = {239: (8, 8, 2), 5215: (24, 24, 7)}


def pad(nodes: int, source: str) -> tuple[TetMesh, str]:
    """A pad in the gel frame (contact face at z = 0, outward z) with about ``nodes`` nodes, and
    where it is from."""
    name = _FILES[nodes]
    source = choose_source(source, f"pads/{name}.vtk", f"pads/{name}.npz")
    if source == "generated":
        return held_below(block_mesh(_CELLS[nodes], SIZE_M, jitter=0.15, seed=7), HELD_M), source
    folder = mesh_folder() / "pads"
    points, tets = read_tet_file(folder / f"{name}.vtk")
    masks = np.load(folder / f"{name}.npz")
    # The file's contact face looks to -z: half a turn about x.
    return label(points * [1, -1, -1], tets, masks["stick_mask"], masks["coat_mask"]), source


def label(nodes_m: np.ndarray, tets: np.ndarray, held: np.ndarray, touched: np.ndarray) -> TetMesh:
    """Bonded are faces among held nodes, in contact those among touched ones; the rest are sides.

    ``held``, ``touched``: bool, [node].
    """
    faces = boundary_faces(tets)
    region = np.full(len(faces), int(Region.SIDE))
    region[touched[faces].all(axis=1)] = int(Region.CONTACT)
    region[held[faces].all(axis=1)] = int(Region.BOND)
    return TetMesh(nodes_m, tets, faces, region)


def held_below(mesh: TetMesh, depth_m: float) -> TetMesh:
    """The same block, bonded on every face that lies deeper than that."""
    z = mesh.nodes_m[:, 2]
    return label(mesh.nodes_m, mesh.tets, z < z.max() - depth_m, z > z.max() - 1e-9)


def mounted(
    meshes: Mapping[str, TetMesh], friction: float, **options: Any
) -> tuple[list[SoftBody], list[KinematicBody]]:
    """A gel of linear tets for each name, and the mount that carries it; ``options``: of
    ``SoftBody``."""
    alike = {"friction_coefficient": friction, "element": Element.LINEAR, **options}
    gels = [
        SoftBody(mesh, GEL, name=name, mount=f"{name} mount", **alike)
        for name, mesh in meshes.items()
    ]
    return gels, [KinematicBody(None, name=f"{name} mount") for name in meshes]


def facing(outward: np.ndarray, right: np.ndarray) -> np.ndarray:
    """world_from_gel [3, 3] of a gel whose face looks to ``outward``, its x axis near ``right``."""
    z = outward / np.linalg.norm(outward)
    x = right - (right @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def pose(matrix: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Position and quaternion, [7]."""
    return np.concatenate([place, wp.quat_from_matrix(wp.mat33d(*matrix.ravel()))])


def turn_about(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    """Matrix [3, 3] of a turn by an angle [rad] about a unit axis."""
    turn = wp.quat_from_axis_angle(wp.vec3d(*axis), wp.float64(angle))
    return np.array(wp.quat_to_matrix(turn)).reshape(3, 3)


def same_side(poses: np.ndarray) -> np.ndarray:
    """The same poses [step, ..., 7], each quaternion on the side of the one before."""
    poses = poses.copy()
    for before, after in pairwise(poses):
        across = (before[..., 3:] * after[..., 3:]).sum(axis=-1, keepdims=True) < 0
        after[..., 3:] = np.where(across, -after[..., 3:], after[..., 3:])
    return poses
