# SPDX-License-Identifier: Apache-2.0
"""A labelled tetrahedral mesh in metres: what CAD hands to the solver and to the profile."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.summary import Summary
from taccel_lab.typed import typed


class Region(enum.IntEnum):
    """What a surface face of a gel pad is for."""

    SIDE = 0
    CONTACT = 1
    BOND = 2
    WINDOW = 3


class RegionFaces(Summary):
    """What has surface faces, each of which belongs to a region."""

    faces: np.ndarray
    face_regions: np.ndarray

    def region_faces(self, *regions: Region) -> np.ndarray:
        """Return the faces of the given regions, int32, shape [n, 3]."""
        return self.faces[np.isin(self.face_regions, [int(r) for r in regions])]

    def region_nodes(self, *regions: Region) -> np.ndarray:
        """Return sorted node indices that lie on faces of the given regions, shape [n]."""
        return np.unique(self.region_faces(*regions))

    def bonded_nodes(self) -> np.ndarray:
        """Return sorted nodes glued to the rigid backing: those of the bond and window faces."""
        return self.region_nodes(Region.BOND, Region.WINDOW)


@typed
@dataclass(frozen=True, repr=False)
class TetMesh(RegionFaces):
    """Tetrahedra of one soft body with the region of each surface face.

    The gel frame: x right and y down in the tactile image, z out of the gel, origin on the
    undeformed contact face at the pad's centre; the bonded back lies at negative z.
    """

    nodes_m: np.ndarray
    """Node positions [m], float64, shape [node_count, 3]."""
    tets: np.ndarray
    """Node indices, positive volume, int32, shape [tet_count, 4]."""
    faces: np.ndarray
    """Boundary triangles, outward (right-hand rule), int32, shape [face_count, 3]."""
    face_regions: np.ndarray
    """``Region`` of each face, int32, shape [face_count]."""
    tet_layers: np.ndarray = None  # type: ignore[assignment]  # __post_init__ fills it in
    """Layer of each tet, int32, shape [tet_count]: 0 the gel proper, 1 a skin over it; all 0 when
    None."""

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """Return what ``repr`` shows."""
        size = " x ".join(f"{1e3 * side:.4g}" for side in np.ptp(self.nodes_m, axis=0))
        named = [(region, int((self.face_regions == int(region)).sum())) for region in Region]
        faces = ", ".join(f"{count} {region.name.lower()}" for region, count in named if count)
        nodes = f"{self.node_count}, {self.tet_count} linear tets"
        return "mesh of a soft body", [("nodes", nodes), ("size", f"{size} mm"), ("faces", faces)]

    def __post_init__(self) -> None:
        for name, width in (("nodes_m", 3), ("tets", 4), ("faces", 3)):
            if name == "nodes_m":
                value = np.ascontiguousarray(self.nodes_m, dtype=np.float64)
            else:
                value = _indices(getattr(self, name), name)
            if value.ndim != 2 or value.shape[1] != width or value.shape[0] == 0:
                raise InputError(f"TetMesh.{name} must have shape [n, {width}], got {value.shape}")
            object.__setattr__(self, name, value)
        regions = _indices(self.face_regions, "face_regions")
        if regions.shape != (len(self.faces),):
            raise InputError(
                f"TetMesh.face_regions has shape {regions.shape}, expected [{len(self.faces)}]"
            )
        if not np.isin(regions, list(Region)).all():
            raise InputError(
                f"TetMesh.face_regions holds {regions.min()} to {regions.max()}; allowed: "
                + ", ".join(f"{int(region)} ({region.name.lower()})" for region in Region)
            )
        object.__setattr__(self, "face_regions", regions)
        given = self.tet_layers
        layers = np.zeros(len(self.tets), np.int32)
        if given is not None:
            layers = _indices(given, "tet_layers")
        if layers.shape != (len(self.tets),) or layers.min() < 0:
            raise InputError(
                f"TetMesh.tet_layers must be {len(self.tets)} whole numbers from 0, got shape "
                f"{layers.shape}"
            )
        object.__setattr__(self, "tet_layers", layers)
        if not np.isfinite(self.nodes_m).all():
            raise InputError("TetMesh.nodes_m holds NaN or infinite coordinates")
        if self.tets.min() < 0 or self.tets.max() >= len(self.nodes_m):
            raise InputError("TetMesh.tets refers to nodes that do not exist")
        if self.faces.min() < 0 or self.faces.max() >= len(self.nodes_m):
            raise InputError("TetMesh.faces refers to nodes that do not exist")
        bad = np.flatnonzero(~(self.volumes_m3() > 0))
        if len(bad):
            first = ", ".join(map(str, bad[:5])) + (", ..." if len(bad) > 5 else "")
            raise InputError(
                f"{len(bad)} of {len(self.tets)} tets are inverted or flat: tets {first}; "
                "seen from outside, corners 1, 2, 3 of a tet must turn counter-clockwise"
            )

    @property
    def node_count(self) -> int:
        return len(self.nodes_m)

    @property
    def tet_count(self) -> int:
        return len(self.tets)

    def volumes_m3(self) -> np.ndarray:
        """Return signed tet volumes [m^3], shape [tet_count]."""
        return tet_volumes(self.nodes_m, self.tets)


def _indices(values: np.ndarray, name: str) -> np.ndarray:
    """Converts to int32; other numbers would come out as the index of something else."""
    given = np.asarray(values)
    with np.errstate(invalid="ignore"):
        indices = np.ascontiguousarray(given, dtype=np.int32)
    if given.dtype != np.int32 and (given != indices).any():
        raise InputError(f"TetMesh.{name} must hold whole numbers that fit in 32 bits")
    return indices


def tet_volumes(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Signed volumes of tets [unit of ``nodes`` cubed], from nodes [node, 3], shape [tet_count]."""
    corners = nodes[tets]
    # Coordinates of 1e200 are for others to judge: their volumes come out infinite or NaN.
    with np.errstate(all="ignore"):
        return np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6


def boundary_faces(tets: np.ndarray) -> np.ndarray:
    """Outward triangles that belong to exactly one tet, int32, shape [face_count, 3].

    Tets must have positive volume. Raises InputError when a face is shared by more than two tets.
    """
    tets = np.asarray(tets, dtype=np.int64)
    # Faces opposite to each corner, wound outward for a positive tet.
    corners = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
    all_faces = tets[:, corners].reshape(-1, 3)
    _, first, counts = np.unique(
        np.sort(all_faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    if counts.max() > 2:
        raise InputError(f"{int((counts > 2).sum())} faces are shared by more than two tets")
    return all_faces[np.sort(first[counts == 1])].astype(np.int32)
