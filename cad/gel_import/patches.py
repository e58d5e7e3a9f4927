# SPDX-License-Identifier: Apache-2.0
"""The faces of a surface of triangles: its planes, and its smooth regions between sharp edges.

A file of triangles names no faces. Planes of some size are found first, since a fillet would join
them to all that it touches; the rest falls apart at edges sharper than the crease angle. A smooth
region that turns far, such as a crowned face with the fillet and the walls around it, is cut where
it leaves its mean direction, so that directions select what they mean.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.cad.gel_import.importer import FaceInfo, PartFaces, triple
from taccel_lab.cad.mesh.surface import doubled_areas
from taccel_lab.geometry.connectivity import pieces_of_pairs
from taccel_lab.geometry.tet_checks import unique_rows

CREASE_DEG = 30.0
"""Edges at which the surface turns more than this part two faces."""
_FLAT_DEG = 0.5
_PLANE_SHARE = 0.01
"""Least share of the surface's area of a plane that is a face by itself."""
_PLANE_TOLERANCE = 1e-4
"""How far corners of a plane lie off it, over the surface's diagonal."""
_TURN_DEG = 60.0
"""Farthest that a region's normals turn from their mean."""


def faces_of_triangles(points: np.ndarray, triangles: np.ndarray) -> PartFaces:
    """Numbered faces of a closed, outward surface [mm], the largest first."""
    crosses = doubled_areas(points[triangles])
    areas = 0.5 * np.linalg.norm(crosses, axis=1)
    normals = crosses / (2 * areas)[:, None]
    pairs = _neighbours(triangles)
    turned = (normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(axis=1)
    flat = pieces_of_pairs(pairs[turned > np.cos(np.radians(_FLAT_DEG))], len(triangles))
    plane = _planes(points[triangles], normals, areas, flat)
    # Triangles of planes keep to these; between the others sharp edges count.
    smooth = (turned > np.cos(np.radians(CREASE_DEG))) & ~plane[pairs].any(axis=1)
    piece = pieces_of_pairs(pairs[smooth], len(triangles))
    piece = np.where(plane, flat, len(triangles) + piece)
    piece = _cut(piece, plane, normals, areas, pairs)
    _, piece = np.unique(piece, return_inverse=True)
    order = np.argsort(-np.bincount(piece, areas), kind="stable")
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    face_of = number[piece].astype(np.int32)
    centers = points[triangles].mean(axis=1)
    table = [
        _described(k, own, plane, normals, areas, centers)
        for k, own in enumerate(_groups(face_of, len(order)))
    ]
    return PartFaces(table, points, triangles, face_of)


def _groups(face_of: np.ndarray, count: int) -> list[np.ndarray]:
    order = np.argsort(face_of, kind="stable")
    return np.split(order, np.searchsorted(face_of[order], np.arange(1, count)))


def _neighbours(triangles: np.ndarray) -> np.ndarray:
    """Triangles that share an edge, [n, 2]."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, inverse, uses = unique_rows(sides.astype(np.int64))
    order = np.argsort(inverse, kind="stable")
    return (order[uses[inverse[order]] == 2] // 3).reshape(-1, 2)


def _planes(
    corners: np.ndarray, normals: np.ndarray, areas: np.ndarray, flat: np.ndarray
) -> np.ndarray:
    """Which triangles belong to a plane of some size, [m]."""
    diagonal = np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0))
    total = np.bincount(flat, areas)
    mean = np.stack([np.bincount(flat, areas * normals[:, k]) for k in range(3)], axis=1)
    mean /= np.maximum(np.linalg.norm(mean, axis=1), 1e-300)[:, None]
    height = np.einsum("ijk,ik->ij", corners, mean[flat])
    low, high = np.full(len(total), np.inf), np.full(len(total), -np.inf)
    np.minimum.at(low, flat, height.min(axis=1))
    np.maximum.at(high, flat, height.max(axis=1))
    plane = (high - low < _PLANE_TOLERANCE * diagonal) & (total > _PLANE_SHARE * areas.sum())
    return plane[flat]


def _cut(
    piece: np.ndarray, plane: np.ndarray, normals: np.ndarray, areas: np.ndarray, pairs: np.ndarray
) -> np.ndarray:
    """Pieces that turn far, cut at ``_TURN_DEG`` from their mean, or by axis where they have
    none."""
    part = np.zeros(len(piece), dtype=np.int64)
    least = np.cos(np.radians(_TURN_DEG))
    _, number = np.unique(piece, return_inverse=True)
    for own in _groups(number, number.max() + 1):
        left, level = own, 0
        while len(left) and not plane[left[0]]:
            mean = (areas[left, None] * normals[left]).sum(axis=0) / areas[left].sum()
            if np.linalg.norm(mean) < 0.2:
                near = np.abs(normals[left]).argmax(axis=1)
                sign = np.take_along_axis(normals[left], near[:, None], axis=1)[:, 0] > 0
                part[left] = 100 + 2 * near + sign
                break
            along = normals[left] @ mean / np.linalg.norm(mean) >= least
            part[left[along]] = level
            left, level = left[~along], level + 1
            if level == 99 or not along.any():
                part[left] = level
                break
    same = (piece[pairs[:, 0]] == piece[pairs[:, 1]]) & (part[pairs[:, 0]] == part[pairs[:, 1]])
    return pieces_of_pairs(pairs[same], len(piece))


def _described(
    index: int,
    own: np.ndarray,
    plane: np.ndarray,
    normals: np.ndarray,
    areas: np.ndarray,
    centers: np.ndarray,
) -> FaceInfo:
    weights = areas[own] / areas[own].sum()
    center, normal = weights @ centers[own], weights @ normals[own]
    length = float(np.linalg.norm(normal))
    if length < 0.2:  # It turns all round: that of its middle.
        normal = normals[own[np.linalg.norm(centers[own] - center, axis=1).argmin()]]
        length = float(np.linalg.norm(normal))
    return FaceInfo(
        index=index,
        name="",
        kind="plane" if plane[own[0]] else "curved",
        area_mm2=float(areas[own].sum()),
        center_mm=triple(center),
        normal=triple(normal / length),
        color="",
    )
