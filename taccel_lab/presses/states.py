# SPDX-License-Identifier: Apache-2.0
"""Every step of a press, to be looked at again: gel, loads, what the sensor sees, and its dots."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.camera.gel_camera import View, camera_of
from taccel_lab.files.atomic_file import atomic_file, write_by
from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.scene import Ball, sphere_mesh
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.summary import Summary

if TYPE_CHECKING:
    from taccel_lab.outputs import Outputs
    from taccel_lab.presses.env import PressEnv
    from taccel_lab.presses.indenter import Indenter
    from taccel_lab.profile import SensorProfile

MARKERS = "markers.csv"
"""Name of the file in the folder of a press."""
COLUMNS = (
    "marker", "rest_u_px", "rest_v_px", "u_px", "v_px", "rest_x_mm", "rest_y_mm", "rest_z_mm",
    "x_mm", "y_mm", "z_mm",
)  # fmt: skip


@dataclass(frozen=True, repr=False)
class PressMarkers(Summary):
    """Dots that the image shows at rest, at rest and in each of some states."""

    image_px: tuple[int, int]
    """Width and height of the image that pixels are of."""
    rest_mm: np.ndarray
    """Gel xyz at rest, [marker, 3]."""
    places_mm: np.ndarray
    """The same in each state, [state, marker, 3]."""
    rest_px: np.ndarray
    """Columns and rows (u, v) at rest, [marker, 2]."""
    places_px: np.ndarray
    """[state, marker, 2]; NaN where the lens sees nothing."""

    @classmethod
    def of(
        cls, profile: SensorProfile, mesh: TetMesh | QuadraticMesh, positions_m: np.ndarray
    ) -> PressMarkers | None:
        """Dots of a profile with nodes at ``positions_m`` [state, node, 3], through its camera;
        None for a gel without."""
        if profile.markers is None:
            return None
        view: View = camera_of(profile)
        points = profile.markers.grid().points_mm()
        layout, _ = MarkerLayout.seen_on(mesh, points, view, designed=profile.mesh)
        rest, places = layout.places_mm(mesh.nodes_m), layout.places_mm(positions_m)
        size = view.width_px, view.height_px
        return cls(size, rest, places, view.pixel_from_gel(rest), view.pixel_from_gel(places))

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """How many there are and how far they moved."""
        moved = np.linalg.norm(self.places_px[-1] - self.rest_px, axis=1)
        return f"{len(self.rest_px)} markers", [
            ("image", f"{self.image_px[0]} x {self.image_px[1]} px"),
            ("largest motion", f"{np.nanmax(moved, initial=0.0):.3g} px"),
        ]

    def arrays(self) -> dict[str, np.ndarray]:
        """The last state, for ``signals.npz``."""
        return {
            "rest_markers_px": self.rest_px,
            "markers_px": self.places_px[-1],
            "rest_markers_m": 1e-3 * self.rest_mm,
            "markers_m": 1e-3 * self.places_mm[-1],
        }

    def figures(self) -> dict[str, Any]:
        """The last state, for JSON."""
        moved_px = np.linalg.norm(self.places_px[-1] - self.rest_px, axis=1)
        known = moved_px[np.isfinite(moved_px)]
        return {
            "count": len(self.rest_px),
            "image_px": self.image_px,
            "largest_motion_px": float(known.max()) if len(known) else None,
            "rest_px": self.rest_px,
            "px": self.places_px[-1],
            "rest_mm": self.rest_mm,
            "mm": self.places_mm[-1],
        }

    def write_csv(self, path: Path) -> None:
        """A row a marker of the last state; empty cells where the lens sees nothing."""
        numbers = np.concatenate(
            [self.rest_px, self.places_px[-1], self.rest_mm, self.places_mm[-1]], axis=1
        )
        lines = [",".join(COLUMNS)]
        for number, row in enumerate(numbers.tolist()):
            cells = ("" if math.isnan(value) else f"{value:.6g}" for value in row)
            lines.append(",".join([str(number), *cells]))
        with atomic_file(path) as staging:
            staging.write_text("\n".join(lines) + "\n", encoding="utf-8")


STATES = "states.npz"
"""Name of the file in the folder of a press."""
BALL_EDGES = 12
"""Edges along the radius of a ball that is kept as triangles."""


@dataclass(frozen=True)
class PressSurface:
    """Pixels of one environment of a press; NaN outside the pad."""

    height_m: np.ndarray
    """z of the contact face [m], shape [height_px, width_px]."""
    rest_height_m: np.ndarray
    normals: np.ndarray
    """Outward unit normals, shape [height_px, width_px, 3]."""
    rest_normals: np.ndarray
    contact_mask: np.ndarray
    """Pixels in contact, bool."""
    contact_radius_m: float
    """Radius of the disc of the contact's area [m]."""
    fine_force_n: float | None = None
    """Force against the press of the contact with a texture [N]; None without one."""


@dataclass
class PressStates:
    """Filled step by step; row 0 of what is written is the untouched gel."""

    moved_m: list[np.ndarray] = field(default_factory=list)
    """Displacement of every node, float32 [node, 3], a step."""
    contact_forces_n: list[np.ndarray] = field(default_factory=list)
    """Forces of the indenter on the nodes, float32 [node, 3]."""
    contact_pressures_pa: list[np.ndarray] = field(default_factory=list)
    """Float32 [node]."""
    von_mises_pa: list[np.ndarray] = field(default_factory=list)
    """Equivalent stress at the nodes, float32 [node]."""
    indenter_poses: list[np.ndarray] = field(default_factory=list)
    """gel_from_indenter, [7]."""
    surfaces: list[PressSurface] = field(default_factory=list)
    """What the pixels show."""

    def add(
        self,
        env: PressEnv,
        outputs: Outputs,
        surface: Callable[[], PressSurface],
    ) -> None:
        """Keep the step that ``outputs`` look at; ``surface`` reads the pixels."""
        count = env.model.soft_count
        pressures = outputs.surface_load.pressures.numpy()[:, :count].copy()
        moved = env.positions[0] - env.mesh.nodes_m
        self.moved_m.append(moved.astype(np.float32))
        self.contact_forces_n.append(env.contact_forces[0].astype(np.float32))
        self.contact_pressures_pa.append(pressures[0].astype(np.float32))
        self.von_mises_pa.append(outputs.von_mises.numpy()[0, :count].astype(np.float32))
        self.indenter_poses.append(env.poses[0, 0])
        self.surfaces.append(surface())

    def cut(self, count: int) -> bool:
        """Drop what is kept beyond the first ``count`` steps, and of one that was kept in part;
        whether all of them are left."""
        rows = [getattr(self, entry.name) for entry in fields(self)]
        whole = min(count, *map(len, rows))
        for row in rows:
            del row[whole:]
        return whole == count

    def positions_m(self, mesh: TetMesh | QuadraticMesh) -> np.ndarray:
        """Nodes at rest and after each step [m], [step + 1, node, 3]."""
        rest = np.zeros_like(self.moved_m[0])
        return mesh.nodes_m + np.stack([rest, *self.moved_m])


def write_states(
    path: Path,
    states: PressStates,
    mesh: TetMesh | QuadraticMesh,
    indenter: Indenter,
    profile: SensorProfile,
    depths_mm: list[float],
    forces_n: np.ndarray,
    images: np.ndarray | None,
) -> None:
    """Write ``states.npz`` (docs/formats.md); it holds all that a viewer needs.

    Args:
        path: The file.
        states: Of all steps.
        mesh: Whose nodes they belong to.
        indenter: Whose surface is kept.
        profile: For the markers, which are left out where it has none.
        depths_mm: Past first touch, a step.
        forces_n: Of the gel on the indenter, [step, 3].
        images: Of the sensor, uint8 [step + 1, height, width, 3]; None without one.
    """
    positions = states.positions_m(mesh)
    arrays: dict[str, np.ndarray] = {
        "nodes_m": mesh.nodes_m,
        "tets": mesh.tets,
        "faces": mesh.faces,
        "face_regions": mesh.face_regions,
        "depth_mm": np.array([0.0, *depths_mm]),
        "force_n": np.concatenate([np.zeros((1, 3)), forces_n]),
        "indenter_poses": np.stack([states.indenter_poses[0], *states.indenter_poses]),
    }
    for name in ("moved_m", "contact_forces_n", "contact_pressures_pa", "von_mises_pa"):
        rows = getattr(states, name)
        arrays[name] = np.stack([np.zeros_like(rows[0]), *rows])
    arrays["indenter_vertices_m"], arrays["indenter_faces"] = tool_surface(indenter)
    if images is not None:
        arrays["images"] = images
    markers = PressMarkers.of(profile, mesh, positions)
    if markers is not None:
        arrays["markers_px"], arrays["image_px"] = markers.places_px, np.array(markers.image_px)
    write_by(path, partial(np.savez_compressed, **arrays))


def tool_surface(indenter: Indenter) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [m], [n, 3], and triangles [m, 3] of an indenter in its own frame."""
    shape = indenter.shape
    if isinstance(shape, Ball):
        shape = sphere_mesh(shape.radius_m, shape.radius_m / BALL_EDGES)
    return shape.vertices_m, shape.faces
