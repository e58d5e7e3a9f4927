# SPDX-License-Identifier: Apache-2.0
"""Two gels grasp a soft bear by its trunk and lift it: soft bodies that touch soft bodies.

The bear is made of nothing but formulas, smoothly joined ellipsoids. Cells of a grid whose middle
is inside are kept, cut into tets, and their outer nodes moved onto the surface; where that would
flatten a tet, part of the way.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taccel_lab.benchmarks.scenes.base import (
    BenchScene,
    SceneOptions,
    facing,
    make_config,
    mounted,
    pad,
    pose,
)
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.block import grid_tets
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.scene import Element, Material, Plane, Scene, SoftBody, TimeStepping
from taccel_lab.tasks.peg_scene import GRAVITY

PARTS_M = 1e-3 * np.array(
    [
        [(0, 0, 31), (22, 16, 24)],
        [(0, 0, 66), (16, 15, 15)],
        [(11, 0, 81), (7, 6, 7)],
        [(-11, 0, 81), (7, 6, 7)],
        [(26, 0, 42), (15, 8, 8)],
        [(-26, 0, 42), (15, 8, 8)],
        [(14, 3, 10), (10, 13, 10)],
        [(-14, 3, 10), (10, 13, 10)],
    ]
)
"""Centre and half axes of trunk, head, ears, arms, legs [m]; it stands on z = 0."""
BLEND_M = 3e-3
LEAST_VOLUME = 0.15
"""Volume of a tet over that of one of an undistorted cell."""


def surface_value(points_m: np.ndarray) -> np.ndarray:
    """Estimate of the distance from the surface [m], negative inside, shape [...]."""
    center, radii = PARTS_M[:, 0], PARTS_M[:, 1]
    scaled = np.linalg.norm((points_m[..., None, :] - center) / radii, axis=-1)
    distance = (scaled - 1) * radii.min(axis=1)
    least = distance.min(axis=-1, keepdims=True)
    return least[..., 0] - BLEND_M * np.log(np.exp((least - distance) / BLEND_M).sum(axis=-1))


def teddy_mesh(cell_m: float = 5.5e-3) -> TetMesh:
    """A bear 88 mm tall; cells of 5.5 mm give some 600 nodes. All of its faces can touch."""
    low = (PARTS_M[:, 0] - PARTS_M[:, 1]).min(axis=0) - 2 * cell_m
    high = (PARTS_M[:, 0] + PARTS_M[:, 1]).max(axis=0) + 2 * cell_m
    counts = np.ceil((high - low) / cell_m).astype(int)
    low = (low + high - counts * cell_m) / 2
    cells = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
    inside = without_pinches(surface_value(low + (cells + 0.5) * cell_m) < 0)
    grid = np.stack(np.meshgrid(*[np.arange(n + 1) for n in counts], indexing="ij"), axis=-1)
    nodes = low + cell_m * grid.reshape(-1, 3)
    tets = grid_tets(*(int(n) for n in counts)).reshape(-1, 6, 4)[inside.ravel()].reshape(-1, 4)
    used, tets = np.unique(tets, return_inverse=True)
    nodes, tets = nodes[used], tets.reshape(-1, 4)
    faces = boundary_faces(tets)
    nodes = _moved(nodes, tets, np.unique(faces), cell_m)
    nodes[:, 2] -= nodes[:, 2].min()
    return TetMesh(nodes, tets, faces, np.full(len(faces), int(Region.SIDE)))


def without_pinches(inside: np.ndarray) -> np.ndarray:
    """Fill cells until no two meet in an edge or a corner alone, which no body can."""
    inside = inside.copy()
    while True:
        before = inside.sum()
        for first, second in ((0, 1), (1, 2), (2, 0)):
            view = np.moveaxis(inside, (first, second), (0, 1))
            p, q = view[:-1, :-1], view[1:, 1:]
            r, s = view[1:, :-1], view[:-1, 1:]
            r |= p & q & ~r & ~s
            p |= r & s & ~p & ~q
        _fill_corners(inside)
        if inside.sum() == before:
            return inside


def _fill_corners(inside: np.ndarray) -> None:
    """Fills a way from one cell to the other around a corner where opposite cells are all there
    is."""
    n = [size - 1 for size in inside.shape]

    def at(i: int, j: int, k: int) -> np.ndarray:
        return inside[i : n[0] + i, j : n[1] + j, k : n[2] + k]

    for i, j, k in ((0, 0, 0), (0, 0, 1), (0, 1, 0), (0, 1, 1)):
        pinch = at(i, j, k) & at(1 - i, 1 - j, 1 - k)
        for near in ((1 - i, j, k), (i, 1 - j, k), (i, j, 1 - k)):
            pinch = pinch & ~at(*near)
        at(1 - i, j, k)[pinch] = True


def _moved(nodes: np.ndarray, tets: np.ndarray, outer: np.ndarray, cell_m: float) -> np.ndarray:
    """Outer nodes on the surface where the tets allow it, inner ones between their neighbours."""
    wanted = nodes.copy()
    step = 1e-6
    for _ in range(6):
        value = surface_value(wanted[outer])
        slope = np.stack(
            [(surface_value(wanted[outer] + step * axis) - value) / step for axis in np.eye(3)], 1
        )
        wanted[outer] -= slope * (value / (slope**2).sum(axis=1))[:, None]
    shift = wanted - nodes
    length = np.linalg.norm(shift, axis=1, keepdims=True)
    shift *= np.minimum(1, 0.6 * cell_m / np.maximum(length, 1e-12))
    inner = np.setdiff1d(np.arange(len(nodes)), outer)
    first, second = (tets[:, ends].ravel() for ends in (_FROM, _TO))
    degree = np.bincount(first, minlength=len(nodes))[:, None]
    for _ in range(30):
        mean = np.zeros_like(shift)
        np.add.at(mean, first, shift[second])
        shift[inner] = (mean / degree)[inner]
    part = np.ones((len(nodes), 1))
    for _ in range(60):
        p = (nodes + part * shift)[tets]
        volume = np.linalg.det(p[:, 1:] - p[:, :1])
        flat = volume < LEAST_VOLUME * cell_m**3
        if not flat.any():
            break
        part[np.unique(tets[flat])] *= 0.85
    return nodes + part * shift


_FROM = [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
_TO = [1, 2, 3, 0, 2, 3, 0, 1, 3, 0, 1, 2]
"""Every edge of a tet in both directions."""


DT_S = 1 / 50
TEDDY = Material(young_modulus_pa=2e4, poisson_ratio=0.4, density_kg_m3=250.0)
FRICTION = 0.8
CLEARANCE_M = 0.15e-3
"""Height over the ground at the start."""
GRIP_M = 33e-3
"""Height of the middle of the gels."""
GAP_M, SQUEEZE_M, LIFT_M = 1e-3, 4e-3, 30e-3
STEPS = (16, 24)
"""Closing, lifting."""


def build(options: SceneOptions) -> BenchScene:
    """Builds it with the published pads of 239 nodes where they are; the bear is always ours."""
    gel, source = pad(239, options.source)
    bear = teddy_mesh()
    gels, mounts = mounted({"front": gel, "back": gel}, FRICTION)
    start = np.array([0, 0, CLEARANCE_M, 0, 0, 0, 1.0])
    soft = SoftBody(bear, TEDDY, name="bear", initial_pose=start, element=Element.LINEAR)
    scene = Scene(
        [replace(soft, friction_coefficient=FRICTION), *gels],
        mounts,
        options.env_count,
        TimeStepping(quasi_static=False, dt_s=DT_S, gravity_m_s2=GRAVITY),
        planes=Plane(friction_coefficient=FRICTION, name="ground"),
    )
    return BenchScene(
        "squeeze",
        f"two gels lift a soft bear of {bear.node_count:,} nodes",
        scene,
        make_config({"dhat_m": 1e-4, "friction_speed_m_s": 1e-2}, options.config),
        gel_path(),
        source,
    )


def gel_path() -> np.ndarray:
    """Poses of both mounts, [steps + 1, 2, 7]."""
    close, lift = STEPS
    moments = np.arange(close + lift + 1)
    half = PARTS_M[0, 1, 1]
    gaps = half + np.interp(moments, [0, close], [GAP_M, -SQUEEZE_M])
    part = np.clip((moments - close) / lift, 0, 1)
    heights = GRIP_M + LIFT_M * part**2 * (3 - 2 * part)
    frames = [facing(np.array([0.0, -side, 0.0]), np.array([1.0, 0.0, 0.0])) for side in (1, -1)]
    return np.array(
        [
            [
                pose(frame, np.array([0.0, side * gap, z]))
                for frame, side in zip(frames, (1, -1), strict=True)
            ]
            for gap, z in zip(gaps, heights, strict=True)
        ]
    )
