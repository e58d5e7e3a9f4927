# SPDX-License-Identifier: Apache-2.0
"""The face that the camera sees from inside, as fine triangles with smooth normals.

A gel's elements are larger than a pixel, so each triangle of the contact face becomes a curved
patch through its corners and their normals (PN triangle: A. Vlachos, J. Peters, C. Boyd, J. L.
Mitchell, "Curved PN triangles", I3D 2001) that is cut into small flat ones. Corner normals follow
the least bent network of curves where the face is a smooth function of x and y, else the mean of
the triangles around weighted by their angles (G. Thuermer, C. A. Wuethrich, "Computing vertex
normals from polygonal facets", J. Graphics Tools 3, 1998). Creases of the design, such as a bevel,
stay sharp.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.guards import require_shape
from taccel_lab.optics.shading_kernels import hit_kernel
from taccel_lab.signals.gradient_recovery import ContactFaceMesh, recover_gradients

CREASE_DEG = 30.0
"""Faces that meet more sharply than this at rest are not smoothed into one another."""
FINE_EDGE_MM = 0.3
MAX_CUTS = 4
_CREASE_RINGS = 3
"""Nodes this many edges from a crease take no part in the network, which swings there."""
_CANDIDATES = 24
_STEEPEST = 0.1
"""Least z of a unit face normal for the face to count as a function of x and y."""


class FineFace:
    """Triangles of the seen face with their normals, for one state of the gel."""

    def __init__(
        self, points_mm: np.ndarray, normals: np.ndarray, triangles: np.ndarray, edge_mm: float
    ) -> None:
        self.points_mm = points_mm
        """Vertices [mm], shape [vertex, 3]."""
        self.normals = normals
        """Outward unit normals, shape [vertex, 3]."""
        self.triangles = triangles
        """Vertex indices, outward, int32, shape [triangle, 3]."""
        self.edge_mm = edge_mm
        """Typical length of a triangle's edge."""


class GelFace:
    """Turns node positions of a tet mesh into the fine face that the camera sees."""

    def __init__(
        self,
        mesh: TetMesh | QuadraticMesh,
        cuts: int | None = None,
        *,
        designed: TetMesh | None = None,
        device: Any = "cpu",
    ) -> None:
        """
        Args:
            mesh: Gel at rest. The contact face is seen, or with several layers the inner side of
                the skin: where layer 0 meets the others.
            cuts: Parts that each edge is cut into; as many as make them ``FINE_EDGE_MM`` long, at
                most ``MAX_CUTS``, when None.
            designed: The gel as designed, where ``mesh`` draws a curved face with longer chords:
                the face is moved and turned by what that leaves out at rest.
            device: Warp device of the network that smooths the face.

        Raises:
            InputError: The mesh has no contact face.
        """
        self._device = device
        faces = seen_faces(mesh)
        self._node_idx, local = np.unique(faces, return_inverse=True)
        self._faces = local.reshape(-1, 3)
        self._node_count = mesh.node_count
        rest = mesh.nodes_m[self._node_idx] * 1e3
        edges = rest[self._faces] - rest[np.roll(self._faces, -1, axis=1)]
        edge = float(np.median(np.linalg.norm(edges, axis=2)))
        if cuts is None:
            cuts = int(np.clip(math.ceil(edge / FINE_EDGE_MM), 1, MAX_CUTS))
        self._edge_mm = edge / cuts
        self._pair_of, self._pair_start, self._split = _smoothing_pairs(rest, self._faces)
        self._near_crease = _grown(self._split, self._faces, _CREASE_RINGS)
        self._rings = self._smooth_rings(rest)
        barycentric, pattern = _subdivision(cuts)
        self._positions_from_controls = _bernstein(barycentric, _CUBIC)
        self._normals_from_controls = _bernstein(barycentric, _QUADRATIC)
        offsets = np.arange(len(self._faces))[:, None, None] * len(barycentric)
        self.triangles = (pattern[None] + offsets).reshape(-1, 3).astype(np.int32)
        self._left_out: tuple[np.ndarray, np.ndarray] | None = None
        self.rest = self.at(mesh.nodes_m)
        if designed is not None and designed is not mesh:
            whole = GelFace(designed, device=device).rest
            if not (_is_flat(self.rest) and _is_flat(whole)):
                self._left_out = _left_out(self.rest, whole, device)
                self.rest = self.at(mesh.nodes_m)
        """The face of the undeformed gel."""

    def at(self, positions_m: np.ndarray) -> FineFace:
        """The fine face of node positions in the gel frame [m], shape [node, 3]."""
        positions = np.asarray(positions_m, dtype=np.float64)
        require_shape("positions", positions, (self._node_count, 3), finite=False)
        nodes = positions[self._node_idx] * 1e3
        if not np.isfinite(nodes).all():
            raise InputError("positions holds NaN or infinite coordinates")
        corners = nodes[self._faces]
        normals = self._corner_normals(nodes, corners)
        controls, quadratic = _pn_controls(corners, normals, self._split[self._faces])
        points = np.einsum("kc,fcx->fkx", self._positions_from_controls, controls)
        fine = np.einsum("kc,fcx->fkx", self._normals_from_controls, quadratic)
        points, fine = points.reshape(-1, 3), _unit(fine.reshape(-1, 3))
        if self._left_out is not None:
            away, turn = self._left_out
            points += away
            fine = _unit(fine + turn)
        return FineFace(points, fine, self.triangles, self._edge_mm)

    def _corner_normals(self, nodes: np.ndarray, corners: np.ndarray) -> np.ndarray:
        """Unit normal of every corner of every face, [face, 3, 3]."""
        weighted = _angle_weighted_normals(corners)
        summed = np.add.reduceat(weighted[self._pair_of], self._pair_start, axis=0)
        normals = _unit(summed).reshape(-1, 3, 3)
        slopes = self._network_slopes(nodes, corners)
        if slopes is not None:
            smooth = _unit(np.concatenate([-slopes, np.ones((len(slopes), 1))], axis=1))
            keep = self._near_crease[self._faces][..., None]
            normals = np.where(keep, normals, smooth[self._faces])
        return normals

    def _smooth_rings(self, rest: np.ndarray) -> tuple[Any, Any] | None:
        """Edge neighbours on the device for the network of curves; None on folded faces."""
        if not _is_function_of_xy(rest[self._faces]):
            return None
        import warp as wp

        surface = ContactFaceMesh.from_faces(self._faces)
        return (
            wp.array(surface.ring_start, dtype=wp.int32, device=self._device),
            wp.array(surface.ring_nodes, dtype=wp.int32, device=self._device),
        )

    def _network_slopes(self, nodes: np.ndarray, corners: np.ndarray) -> np.ndarray | None:
        """Slopes of z over x and y at the nodes by the least bent network, [node, 2]."""
        if self._rings is None or not _is_function_of_xy(corners):
            return None
        import warp as wp

        points = wp.array(nodes[None], dtype=wp.vec3d, device=self._device)
        z = np.ascontiguousarray(nodes[None, :, 2])
        height = wp.array(z, dtype=wp.float64, device=self._device)
        return recover_gradients(points, height, *self._rings).numpy()[0]


def _is_flat(face: FineFace) -> bool:
    return bool((face.normals[:, 2] == 1.0).all())


def _left_out(drawn: FineFace, designed: FineFace, device: Any) -> tuple[np.ndarray, np.ndarray]:
    """Differences from a drawn face to a designed one: points [mm] and unit normals, each [vertex,
    3].

    The two are compared along rays from below their middle, which meet a flat pad once, and the
    sides of a dome, too; nothing is left out where a ray misses the design.
    """
    import warp as wp

    low, high = designed.points_mm.min(axis=0), designed.points_mm.max(axis=0)
    below = 0.25 * float((high - low)[:2].min())
    eye = np.array([*(low + high)[:2] / 2, low[2] - below])
    count = len(drawn.points_mm)

    def vectors(values: np.ndarray) -> wp.array:
        return wp.array(values.astype(np.float32), dtype=wp.vec3, device=device)

    corners = vectors(designed.points_mm)
    triangles = wp.array(designed.triangles.ravel(), dtype=wp.int32, device=device)
    mesh = wp.Mesh(points=corners, indices=triangles)
    given = [vectors(designed.normals), corners, triangles]
    rays = [vectors(np.tile(eye, (count, 1))), vectors(_unit(drawn.points_mm - eye))]
    met, normals, rest = (wp.zeros(count, dtype=wp.vec3, device=device) for _ in range(3))
    seen = wp.zeros(count, dtype=wp.int32, device=device)
    wp.launch(
        hit_kernel, count, inputs=[mesh.id, *given, *rays], outputs=[met, normals, rest, seen],
        device=device,
    )  # fmt: skip
    there = seen.numpy()[:, None] == 1
    away = np.where(there, met.numpy() - drawn.points_mm, 0.0)
    return away, np.where(there, normals.numpy() - drawn.normals, 0.0)


def seen_faces(mesh: TetMesh | QuadraticMesh) -> np.ndarray:
    """Triangles that the camera sees, outward, int32, shape [n, 3]; see ``GelFace``."""
    base = mesh if isinstance(mesh, TetMesh) else mesh.base
    if base.tet_layers.any():
        return _interface_faces(base)
    faces = mesh.region_faces(Region.CONTACT)
    if len(faces) == 0:
        raise InputError(
            "TetMesh.face_regions holds no face of region CONTACT; the camera needs one to see "
            f"(value {int(Region.CONTACT)})"
        )
    return faces


def _interface_faces(mesh: TetMesh) -> np.ndarray:
    """Faces between layer 0 and the skin over it that lie under the contact face."""
    core = boundary_faces(mesh.tets[mesh.tet_layers == 0])
    outer = {tuple(face) for face in np.sort(mesh.faces, axis=1).tolist()}
    inner = core[np.array([tuple(face) not in outer for face in np.sort(core, axis=1).tolist()])]
    from scipy.spatial import KDTree

    # A face lies under the nearest outer face that looks the same way.
    outside, inside = mesh.nodes_m[mesh.faces], mesh.nodes_m[inner]
    count = min(_CANDIDATES, len(outside))
    near = KDTree(outside.mean(axis=1)).query(inside.mean(axis=1), k=count)[1]
    near = near.reshape(len(inner), count)
    alike = np.einsum("fkx,fx->fk", _face_normals(outside)[near], _face_normals(inside)) > 0.5
    over = np.take_along_axis(near, np.argmax(alike, axis=1)[:, None], axis=1)[:, 0]
    is_contact = mesh.face_regions[over] == int(Region.CONTACT)
    under = inner[np.logical_and(is_contact, alike.any(axis=1))]
    if len(under) == 0:
        raise InputError("no face between layer 0 and the skin lies under the contact face")
    return under


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


def _face_normals(corners: np.ndarray) -> np.ndarray:
    return _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def _is_function_of_xy(corners: np.ndarray) -> bool:
    return bool((_face_normals(corners)[:, 2] > _STEEPEST).all())


def _angle_weighted_normals(corners: np.ndarray) -> np.ndarray:
    """Face normal times the angle at each corner, [3 face, 3]."""
    ahead = _unit(np.roll(corners, -1, axis=1) - corners)
    behind = _unit(np.roll(corners, 1, axis=1) - corners)
    angle = np.arccos(np.clip(np.sum(ahead * behind, axis=-1), -1.0, 1.0))
    return (angle[..., None] * _face_normals(corners)[:, None]).reshape(-1, 3)


def _smoothing_pairs(
    rest: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners whose normals are summed for each corner, and the nodes that lie on creases.

    Returns:
        Corner numbers (3 face + corner), where those of each corner start, and a flag a node.
    """
    corner_node = faces.ravel()
    order = np.argsort(corner_node, kind="stable")
    counts = np.bincount(corner_node, minlength=len(rest))
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    per_corner = counts[corner_node]
    first = np.repeat(np.arange(len(corner_node)), per_corner)
    within = np.arange(len(first)) - np.repeat(np.cumsum(per_corner) - per_corner, per_corner)
    second = order[starts[corner_node[first]] + within]
    normals = _face_normals(rest[faces])
    cosine = np.sum(normals[first // 3] * normals[second // 3], axis=1)
    together = cosine >= math.cos(math.radians(CREASE_DEG))
    split = np.zeros(len(rest), dtype=bool)
    split[corner_node[first[~together]]] = True
    first, second = first[together], second[together]
    return second, np.searchsorted(first, np.arange(len(corner_node))), split


def _grown(nodes: np.ndarray, faces: np.ndarray, rings: int) -> np.ndarray:
    """Flagged nodes and those up to ``rings`` edges away."""
    for _ in range(rings):
        touched = nodes[faces].any(axis=1)
        nodes = nodes.copy()
        nodes[faces[touched].ravel()] = True
    return nodes


def _subdivision(cuts: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points of a triangle cut ``cuts`` times an edge, and its small triangles."""
    index, points = {}, []
    for i in range(cuts + 1):
        for j in range(cuts + 1 - i):
            index[i, j] = len(points)
            points.append(((cuts - i - j) / cuts, i / cuts, j / cuts))
    small = []
    for i in range(cuts):
        for j in range(cuts - i):
            small.append((index[i, j], index[i + 1, j], index[i, j + 1]))
            if i + j < cuts - 1:
                small.append((index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]))
    return np.array(points), np.array(small)


_CUBIC = ((3, 0, 0), (0, 3, 0), (0, 0, 3), (2, 1, 0), (1, 2, 0), (0, 2, 1), (0, 1, 2), (1, 0, 2),
          (2, 0, 1), (1, 1, 1))  # fmt: skip
_QUADRATIC = ((2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (0, 1, 1), (1, 0, 1))


def _bernstein(barycentric: np.ndarray, powers: tuple[tuple[int, int, int], ...]) -> np.ndarray:
    degree = sum(powers[0])
    columns = [
        math.factorial(degree)
        / math.prod(math.factorial(e) for e in power)
        * np.prod(barycentric ** np.array(power), axis=1)
        for power in powers
    ]
    return np.stack(columns, axis=1)


def _pn_controls(
    corners: np.ndarray, normals: np.ndarray, on_crease: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Control points [face, 10, 3] and control normals [face, 6, 3] in the order of the weights.

    An edge with an end on a crease stays straight, so that both its faces have the same.
    """
    inner, middles = [], []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        pa, pb, na, nb = corners[:, a], corners[:, b], normals[:, a], normals[:, b]
        edge = pb - pa
        straight = (on_crease[:, a] | on_crease[:, b])[:, None]
        rise_a = np.sum(edge * na, axis=1, keepdims=True)
        rise_b = np.sum(-edge * nb, axis=1, keepdims=True)
        inner.append((2 * pa + pb - np.where(straight, 0.0, rise_a * na)) / 3)
        inner.append((2 * pb + pa - np.where(straight, 0.0, rise_b * nb)) / 3)
        both = na + nb
        tilt = 2 * np.sum(edge * both, axis=1) / np.maximum(np.sum(edge * edge, axis=1), 1e-30)
        bent = both - np.where(straight, 0.0, tilt[:, None] * edge)
        middles.append(_unit(bent))
    mean = sum(inner) / 6
    centre = mean + 0.5 * (mean - corners.mean(axis=1))
    controls = np.stack([corners[:, 0], corners[:, 1], corners[:, 2], *inner, centre], axis=1)
    return controls, np.stack([normals[:, 0], normals[:, 1], normals[:, 2], *middles], axis=1)
