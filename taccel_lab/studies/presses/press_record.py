# SPDX-License-Identifier: Apache-2.0
"""What a press leaves behind: forces, depths, the shape of the gel at every step, its sections."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.files.atomic_file import write_by
from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.model.embedding import rotate
from taccel_lab.signals import ContactFaceMesh


@dataclass(frozen=True, eq=False)
class PressRecord:
    """Converged steps of one press; of one that failed half way those before."""

    press: str
    indenter: str
    place: tuple[float, float]
    mesh: TetMesh | QuadraticMesh
    """The gel at rest, with all its nodes."""
    surface: ContactFaceMesh
    """Contact face of ``mesh``."""
    gel_from_press: np.ndarray
    """[7]."""
    thickness_mm: float
    """Gel under the press."""
    depth_mm: np.ndarray
    """Depth past first touch, shape [step]."""
    shear_mm: np.ndarray
    """Motion along x of the press frame, shape [step]."""
    twist_deg: np.ndarray
    """Shape [step]."""
    force_n: np.ndarray
    """Force of the gel on the indenter, in the press frame, shape [step, 3]."""
    torque_nm: np.ndarray
    """Torque about the press's axis, shape [step]."""
    indenter_poses: np.ndarray
    """gel_from_indenter, shape [step, 7]."""
    moved_m: np.ndarray
    """Displacement of every node, float32, shape [step, node, 3]."""
    bond_peak_pa: np.ndarray
    """Largest von Mises stress at a bonded node, shape [step]."""
    residual_n: np.ndarray
    newton_iterations: np.ndarray
    step_count: int
    """Steps that were wanted."""
    cause: str = ""
    """Why there are fewer steps; empty when all converged."""
    contact_radius_mm: np.ndarray | None = None
    """Radius of the disc of the contact's area, shape [step]; None of tools whose contact is not
    measured."""
    device: str = "cpu"
    """Warp device that simulated it, and on which its surfaces are rebuilt and rendered."""

    @property
    def down(self) -> slice:
        """The steps straight down, up to the greatest depth."""
        side = np.flatnonzero((self.shear_mm != 0) | (self.twist_deg != 0))
        last = int(side[0]) if len(side) else len(self.depth_mm)
        return slice(0, int(np.argmax(self.depth_mm[:last])) + 1 if last else 0)

    @property
    def normal_n(self) -> np.ndarray:
        """Normal force of the steps straight down [N]."""
        return self.force_n[self.down, 2]

    @cached_property
    def rest_m(self) -> np.ndarray:
        """Nodes at rest, shape [node, 3]."""
        return self.mesh.nodes_m

    def positions_m(self, step: int) -> np.ndarray:
        """Nodes at the end of a step [m], shape [node, 3]."""
        return self.rest_m + self.moved_m[step]

    def in_press(self, points_m: np.ndarray) -> np.ndarray:
        """Points of the gel frame in the press frame [m]."""
        pose = self.gel_from_press
        return rotate(pose[3:] * [-1, -1, -1, 1], points_m - pose[:3])

    def scaled(self, factor: float) -> PressRecord:
        """The press of a gel whose moduli are all ``factor`` times these."""
        if factor == 1.0:
            return self
        loads = ("force_n", "torque_nm", "bond_peak_pa", "residual_n")
        return dataclasses.replace(self, **{name: getattr(self, name) * factor for name in loads})

    @property
    def contact_diameter_mm(self) -> np.ndarray | None:
        """See ``contact_radius_mm``."""
        return None if self.contact_radius_mm is None else 2 * self.contact_radius_mm

    def curve(self) -> dict[str, Any]:
        """Steps, ready for JSON."""
        return {
            "indenter": self.indenter,
            "place": self.place,
            "thickness_mm": self.thickness_mm,
            "depth_mm": self.depth_mm,
            "shear_mm": self.shear_mm,
            "twist_deg": self.twist_deg,
            "force_n": self.force_n,
            "torque_nmm": self.torque_nm * 1e3,
            "contact_diameter_mm": self.contact_diameter_mm,
            "bond_peak_kpa": self.bond_peak_pa * 1e-3,
            "residual_n": self.residual_n,
            "newton_iterations": self.newton_iterations,
            "nodes": self.mesh.node_count,
            "cause": self.cause,
        }

    def save(self, path: Path) -> None:
        """Write the contact face's nodes and the steps as a compressed npz."""
        idx = self.surface.node_idx
        save = partial(
            np.savez_compressed,
            indenter=self.indenter,
            place=np.array(self.place),
            gel_from_press=self.gel_from_press,
            thickness_mm=self.thickness_mm,
            depth_mm=self.depth_mm,
            shear_mm=self.shear_mm,
            twist_deg=self.twist_deg,
            force_n=self.force_n,
            torque_nm=self.torque_nm,
            indenter_poses=self.indenter_poses,
            bond_peak_pa=self.bond_peak_pa,
            residual_n=self.residual_n,
            contact_rest_m=self.rest_m[idx],
            contact_moved_m=self.moved_m[:, idx],
            contact_faces=self.surface.faces,
            cause=self.cause,
        )
        write_by(path, save)


_EDGES = ((0, 1), (1, 2), (2, 0))


def section_heights(points_m: np.ndarray, faces: np.ndarray, x_m: np.ndarray) -> np.ndarray:
    """Heights z [m] over the line y = 0 at ``x_m``, ascending, [n]; NaN beside the surface.

    The section of the mesh itself: beside the edge of a tool a smooth surface through the same
    nodes would swing.

    ``points_m``: [node, 3]; ``faces``: [face, 3]. Where faces lie above one another the highest.
    """
    heights = np.full(len(x_m), -np.inf)
    y = points_m[faces, 1]
    across = (y.min(axis=1) <= 0) & (y.max(axis=1) >= 0)
    for face in faces[across]:
        ends = []
        for edge in _EDGES:
            # In the order of the nodes, so that neighbours end at the same bits.
            a, b = points_m[np.sort(face[list(edge)])]
            if a[1] != b[1] and min(a[1], b[1]) <= 0 <= max(a[1], b[1]):
                ends.append(a + a[1] / (a[1] - b[1]) * (b - a))
        if not ends:
            continue
        (x0, _, z0), *_, (x1, _, z1) = sorted(ends, key=lambda end: end[0])
        here = slice(np.searchsorted(x_m, x0), np.searchsorted(x_m, x1, "right"))
        share = (x_m[here] - x0) / (x1 - x0) if x1 > x0 else np.zeros(len(x_m[here]))
        heights[here] = np.maximum(heights[here], z0 + share * (z1 - z0))
    return np.where(np.isfinite(heights), heights, np.nan)
