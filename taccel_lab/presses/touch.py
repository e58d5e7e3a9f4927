# SPDX-License-Identifier: Apache-2.0
"""Where an indenter that comes straight down first touches a surface at rest, exactly; and how deep
it may go from there.

The height of first touch is the largest over all pairs of features that can touch: face, edge or
corner of the surface against the ball, and for a mesh corner against face, face against corner and
edge against edge (two triangulated surfaces have no other first contacts).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.bodies.primitives import unique_edges
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.presses.indenter import Indenter
from taccel_lab.scene import Ball, TriangleMesh

if TYPE_CHECKING:
    from taccel_lab.presses.frame import PressFrames
    from taccel_lab.profile import SensorProfile

MAX_DEPTH_FRACTION = 0.9
"""Deepest press as a part of the gel's thickness."""
_CHUNK = 512


def first_touch_m(
    shape: Ball | TriangleMesh, positions: np.ndarray, faces: np.ndarray, at_m: np.ndarray
) -> float:
    """Height of the indenter's origin [m] at first touch, -inf when it passes beside the surface.

    ``positions`` [node, 3] and ``faces`` [face, 3] are the contact face, ``at_m`` [2] the xy of
    the indenter's origin.
    """
    reach = _reach(shape)
    corners = positions[faces]
    low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
    near = faces[((low <= at_m + reach) & (high >= at_m - reach)).all(axis=1)]
    if len(near) == 0:
        return -np.inf
    # From here on relative to the indenter's axis.
    points = positions - np.append(at_m, 0.0)
    if isinstance(shape, Ball):
        return _ball_touch(shape.radius_m, points, near)
    return _mesh_touch(shape, points, near)


def require_resolved(
    indenter: Indenter,
    mesh: TetMesh,
    rest_m: np.ndarray | None,
    frames: PressFrames,
    at_m: np.ndarray,
) -> None:
    """Refuse an indenter that is smaller than an element of the gel where it comes down."""
    contact = mesh.region_faces(Region.CONTACT)
    if len(at_m) and len(contact):
        nodes = mesh.nodes_m if rest_m is None else np.asarray(rest_m)[0]
        seen = frames.points_in_press(0, nodes)
        indenter.require_size(element_mm=1e3 * element_m(seen, contact, at_m[0]))


def element_m(positions: np.ndarray, faces: np.ndarray, at_m: np.ndarray) -> float:
    """Longest edge [m] of the face nearest to an axis; see ``first_touch_m``."""
    corners = positions[faces]
    nearest = ((corners[..., :2].mean(axis=1) - at_m) ** 2).sum(axis=1).argmin()
    around = corners[nearest]
    return float(np.linalg.norm(around - np.roll(around, 1, axis=0), axis=1).max())


def gel_below_m(
    positions: np.ndarray, contact: np.ndarray, bonded: np.ndarray, at_m: np.ndarray
) -> float:
    """Gel below the contact node nearest to an axis, straight down to a bonded face [m].

    ``positions`` [node, 3], ``contact`` and ``bonded`` [face, 3], ``at_m`` [2] the xy of the axis.
    Where no bonded face lies below, as at the overhanging rim of a shell, it is the distance to
    the nearest bonded node.
    """
    nodes = np.unique(contact)
    points = positions[nodes]
    apart = ((points[:, :2] - at_m) ** 2).sum(axis=1)
    # The far side of a dome may lie on the same axis: the indenter meets the upper one.
    near = np.flatnonzero(apart <= apart.min() + 1e-18)
    top = points[near[np.argmax(points[near, 2])]]
    if len(bonded) == 0:
        return float(top[2] - positions[:, 2].min())
    corners = positions[bonded]
    low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
    around = bonded[((low <= top[:2] + 1e-9) & (high >= top[:2] - 1e-9)).all(axis=1)]
    heights = [_height_over(top[None, :2], positions, face[None], lowest=False) for face in around]
    below = np.array([h[0] for h in heights if h[0] <= top[2]])
    if len(below):
        return float(top[2] - below.max())
    return float(np.linalg.norm(positions[np.unique(bonded)] - top, axis=1).min())


def _reach(shape: Ball | TriangleMesh) -> float:
    if isinstance(shape, Ball):
        return shape.radius_m
    return float(np.abs(shape.vertices_m[:, :2]).max())


def _ball_touch(radius: float, points: np.ndarray, faces: np.ndarray) -> float:
    """Largest height over the origin at which the ball's lower side touches the surface."""
    return max(
        _ball_on_corners(radius, points[np.unique(faces)]),
        _ball_on_edges(radius, points[unique_edges(faces)]),
        _ball_on_faces(radius, points[faces]),
    )


def _ball_on_corners(radius: float, points: np.ndarray) -> float:
    below_sq = radius**2 - (points[:, :2] ** 2).sum(axis=1)
    hit = below_sq >= 0
    return float((points[hit, 2] + np.sqrt(below_sq[hit])).max(initial=-np.inf))


def _ball_on_edges(radius: float, edges: np.ndarray) -> float:
    """The centre (0, 0, z) at distance ``radius`` of the line, its foot between the ends."""
    start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    length = np.linalg.norm(along, axis=1)
    unit = along / length[:, None]
    flat = 1 - unit[:, 2] ** 2
    offset_along = -(start[:, :2] * unit[:, :2]).sum(axis=1)
    # flat h^2 - 2 unit_z offset_along h + offset^2 - offset_along^2 - radius^2 = 0, h over start
    half = unit[:, 2] * offset_along
    rest = (start[:, :2] ** 2).sum(axis=1) - offset_along**2 - radius**2
    root_sq = half**2 - flat * rest
    # The corners of an upright edge say all about it.
    usable = (flat > 1e-12) & (root_sq >= 0)
    above = (half[usable] + np.sqrt(root_sq[usable])) / flat[usable]
    foot = offset_along[usable] + unit[usable, 2] * above
    between = (foot >= 0) & (foot <= length[usable])
    return float((start[usable, 2] + above)[between].max(initial=-np.inf))


def _ball_on_faces(radius: float, corners: np.ndarray) -> float:
    """The point of the ball that faces the triangle lies on it."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal *= np.sign(normal[:, 2:])
    usable = normal[:, 2] > 1e-12
    normal, corners = normal[usable], corners[usable]
    foot = -radius * normal[:, :2]
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    det = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    p = foot - a[:, :2]
    u = (p[:, 0] * ac[:, 1] - p[:, 1] * ac[:, 0]) / det
    v = (ab[:, 0] * p[:, 1] - ab[:, 1] * p[:, 0]) / det
    inside = (u >= 0) & (v >= 0) & (u + v <= 1)
    height = a[:, 2] + u * ab[:, 2] + v * ac[:, 2] + radius * normal[:, 2]
    return float(height[inside].max(initial=-np.inf))


def _mesh_touch(shape: TriangleMesh, points: np.ndarray, faces: np.ndarray) -> float:
    nodes = points[np.unique(faces)]
    down = nodes[:, 2] - _height_over(nodes[:, :2], shape.vertices_m, shape.faces, lowest=True)
    over = _height_over(shape.vertices_m[:, :2], points, faces, lowest=False)
    both = np.concatenate([down, over - shape.vertices_m[:, 2]])
    best = float(both[np.isfinite(both)].max(initial=-np.inf))
    # Only edges that reach high, or low, enough to touch any earlier.
    surface, indenter = points[unique_edges(faces)], shape.vertices_m[shape.edges()]
    low = shape.vertices_m[:, 2].min()
    surface = surface[surface[..., 2].max(axis=1) - low > best]
    indenter = indenter[nodes[:, 2].max() - indenter[..., 2].min(axis=1) > best]
    return max(best, _edge_touch(surface, indenter))


def _edge_touch(surface: np.ndarray, indenter: np.ndarray) -> float:
    """Largest height difference where edges [n, 2, 3] and [m, 2, 3] cross, seen from above."""
    best = -np.inf
    q, d = indenter[:, 0], indenter[:, 1] - indenter[:, 0]
    for start in range(0, len(surface), _CHUNK):
        edges = surface[start : start + _CHUNK, None]
        p, e = edges[:, :, 0], edges[:, :, 1] - edges[:, :, 0]
        det = e[..., 0] * d[:, 1] - e[..., 1] * d[:, 0]
        # The ends of parallel edges say all about them.
        scale = np.linalg.norm(e[..., :2], axis=-1) * np.linalg.norm(d[:, :2], axis=-1)
        det = np.where(np.abs(det) <= 1e-12 * scale, np.nan, det)
        w = q[:, :2] - p[..., :2]
        s = (w[..., 0] * d[:, 1] - w[..., 1] * d[:, 0]) / det
        t = (w[..., 0] * e[..., 1] - w[..., 1] * e[..., 0]) / det
        crossing = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
        gap = p[..., 2] + s * e[..., 2] - q[:, 2] - t * d[:, 2]
        best = max(best, float(gap[crossing].max(initial=-np.inf)))
    return best


def _height_over(
    xy: np.ndarray, vertices: np.ndarray, faces: np.ndarray, *, lowest: bool
) -> np.ndarray:
    """Lowest or highest z of a surface on the vertical line through each xy; NaN for a miss."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    ab, ac = (b - a)[:, :2], (c - a)[:, :2]
    det = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    upright = np.abs(det) <= 1e-12 * (np.abs(ab).max() + 1e-30) ** 2
    det = np.where(upright, np.nan, det)
    result = np.full(len(xy), np.nan)
    for start in range(0, len(xy), _CHUNK):
        p = xy[start : start + _CHUNK, None] - a[None, :, :2]
        u = (p[..., 0] * ac[:, 1] - p[..., 1] * ac[:, 0]) / det
        v = (ab[:, 0] * p[..., 1] - ab[:, 1] * p[..., 0]) / det
        inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
        z = a[:, 2] + u * (b - a)[:, 2] + v * (c - a)[:, 2]
        fill = np.inf if lowest else -np.inf
        z = np.where(inside, z, fill)
        best = z.min(axis=1) if lowest else z.max(axis=1)
        result[start : start + _CHUNK] = np.where(np.isfinite(best), best, np.nan)
    return result


def deepest_mm(mesh: TetMesh, at_mm: tuple[float, float]) -> float:
    """Deepest press of a gel at a place, but for what its mesh changes, which depends on the depth.

    ``mesh`` is in the gel frame, ``at_mm`` the gel xy.
    """
    contact = mesh.region_faces(Region.CONTACT)
    bonded = mesh.region_faces(Region.BOND, Region.WINDOW)
    thickness_m = gel_below_m(mesh.nodes_m, contact, bonded, 1e-3 * np.asarray(at_mm))
    return 0.99 * MAX_DEPTH_FRACTION * 1e3 * thickness_m


def check_depth(depth_mm: float, profile: SensorProfile) -> None:
    """Refuse a depth that no place of the pad allows, before a mesh is made for it."""
    thickness_mm = profile.gel.thickness_mm
    if not depth_mm <= MAX_DEPTH_FRACTION * thickness_mm:
        raise InputError(
            f"depth {depth_mm:g} mm goes past the gel, which is {thickness_mm:g} mm thick; at most "
            f"{MAX_DEPTH_FRACTION * thickness_mm:.3g} mm ({MAX_DEPTH_FRACTION:.0%}) is allowed"
        )
