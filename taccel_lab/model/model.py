# SPDX-License-Identifier: Apache-2.0
"""``Model``: everything about a scene that a step does not change, as device arrays.

Nodes are numbered through, in this order:

    nodes of the soft bodies | four control nodes of each affine body | vertices of the affine
    bodies | vertices of the kinematic bodies (a ball has one) | an origin node for each plane

A node is *free* (a row of the Newton system: unbonded soft nodes and all control nodes),
*embedded* (a vertex of an affine body: a weighted sum of its four control nodes) or *prescribed*
(bonded soft nodes, kinematic vertices, planes).

An affine body [Lan et al. 2022, Affine Body Dynamics] has the control nodes y0, its centre of mass,
and y1..y3 = L times the columns of its linear map along its principal axes - vectors in metres, not
points. A vertex X in the principal frame is y0 + sum_k (X_k / L) y_k. In that frame the mass matrix
of the control nodes is diagonal: the mass, and the second moments over L^2.

Arrays of rest quantities have ``rest_count`` rows, which is 1 when all environments share one rest
shape and ``env_count`` otherwise; kernels index them with ``env % rest_count``.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import warp as wp

from taccel_lab.bodies.mass_properties import MassProperties
from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.model.contact_plan import ContactPlan
from taccel_lab.model.elastic import ElementArrays
from taccel_lab.model.matrix_pattern import BlockPattern
from taccel_lab.model.surface import SurfaceArrays, SurfaceTrees


class BodyKind(IntEnum):
    """What moves a body."""

    SOFT = 0
    AFFINE = 1
    KINEMATIC = 2
    PLANE = 3


@dataclass(frozen=True)
class BodyRange:
    """One body: where its nodes, collision faces and edges are."""

    name: str
    kind: BodyKind
    nodes: tuple[int, int]
    """First node and the one after the last; of an affine body, its surface vertices."""
    faces: tuple[int, int]
    """Range in ``surface.faces``."""
    edges: tuple[int, int]
    """Range in ``surface.edges``."""

    @property
    def node_slice(self) -> slice:
        return slice(*self.nodes)


@dataclass
class AffineArrays:
    """Affine bodies on the device, in the order of the scene."""

    control_starts: wp.array
    """First control node y0, int32, shape [affine_count]."""
    lengths: wp.array
    """L [m], float64, shape [affine_count]."""
    stiffness: wp.array
    """Young's modulus times volume [J], float64, shape [affine_count]."""
    vertex_starts: wp.array
    """First vertex node, and the one after the last body's, int32, shape [affine_count + 1]."""
    have_joints: wp.array
    """1 for a body with joints, int32, shape [affine_count]."""
    properties: list[MassProperties]
    first_control: int
    """Node number of the first control node."""
    count: int


@dataclass
class RigidTarget:
    """A body whose search trees live in its own frame and never change: affine or kinematic."""

    body: int
    """Body id."""
    local_positions: wp.array
    """Vertices in the frame of the trees [m], vec3d, shape [vertex_count]."""
    trees: SurfaceTrees | None
    """None for a ball and for a frame without a surface."""
    radii_m: np.ndarray
    """Largest distance of the surface, and of what is mounted, from the frame's origin [m], shape
    [rest_count], or [1] of an affine body."""


@dataclass
class Model:
    """Static data of a scene; shapes beside each field."""

    scene: SceneDescription
    device: wp.Device
    env_count: int
    bodies: list[BodyRange]
    """All bodies by id."""
    soft_count: int
    """Nodes of all soft bodies."""
    node_count: int
    """All nodes."""
    free_count: int
    rest_count: int
    rest_positions: wp.array
    """Rest positions [m], vec3d, shape [rest_count, node_count]; of rigid bodies in the body
    frame, of a mounted gel in the frame of its mount."""
    free_index: wp.array
    """Row of a node in the linear system, -1 when it has none, int32, shape [node_count]."""
    free_nodes: wp.array
    """Node of each row, int32, shape [free_count]."""
    masses: wp.array
    """Lumped mass [kg], float64, shape [rest_count, node_count]."""
    gravity_scale: wp.array
    """1 for nodes that gravity acts on, 0 for the control nodes y1..y3, float64, [node_count]."""
    parents: wp.array
    """First control node of the body that a vertex is embedded in, else -1, int32, [node_count]."""
    weights: wp.array
    """Weights of the four control nodes of an embedded vertex, vec4d, shape [node_count]."""
    frame_nodes: wp.array
    """Nodes that follow a kinematic frame, int32, shape [frame_node_count]."""
    frame_ids: wp.array
    """Kinematic index of each frame node, int32, shape [frame_node_count]."""
    start_nodes: wp.array
    """Nodes that a kinematic frame places at the start, int32, shape [start_node_count]: those that
    follow it, and the others of gels that are mounted on it."""
    start_frames: wp.array
    """Kinematic index of each of them, int32, shape [start_node_count]."""
    elastic: list[ElementArrays]
    surface: SurfaceArrays
    affine: AffineArrays
    targets: list[RigidTarget]
    """Affine bodies, then kinematic bodies: those with a frame; index is the frame's number."""
    contact_plan: ContactPlan
    present: wp.array
    """1 where a body is present, int32, shape [env_count, body_count]."""
    pair_friction: wp.array
    """Coulomb coefficient of each pair of bodies, float64, shape [body_count, body_count]."""
    largest_thickness_m: float
    """Largest sum of the thicknesses of two bodies [m]."""
    rubs: bool
    """Whether any pair that may touch has friction."""
    contact_in_pattern: bool
    """Whether contact of gels and affine bodies has blocks in the pattern, and needs no list."""
    pattern: BlockPattern
    row_starts: wp.array
    columns: wp.array
    diagonal: wp.array

    @property
    def kinematic(self) -> list[BodyRange]:
        """The kinematic bodies, in the order of ``State.poses``."""
        return [body for body in self.bodies if body.kind is BodyKind.KINEMATIC]

    @property
    def kinematic_radii_m(self) -> np.ndarray:
        """Reach of each kinematic body and of what it carries from its origin, float64, shape
        [rest_count, kinematic_count]."""
        found = [target.radii_m for target in self.targets[self.affine.count :]]
        return np.stack(found, axis=1) if found else np.zeros((self.rest_count, 0))

    def body_rows(self) -> np.ndarray:
        """First row of each body in the Newton system and the one after the last, int64, shape
        [body_count, 2]; empty ranges for prescribed bodies."""
        rows = np.zeros((len(self.bodies), 2), dtype=np.int64)
        free, first = self.free_nodes.numpy(), self.free_count - 4 * self.affine.count
        for index, body in enumerate(self.bodies):
            if body.kind is BodyKind.SOFT:
                rows[index] = np.searchsorted(free, body.nodes)
            elif body.kind is BodyKind.AFFINE:
                rows[index] = first, first + 4
                first += 4
        return rows

    def body_id(self, name: str) -> int:
        """Id of the one body of that name; KeyError names what there is."""
        found = [i for i, body in enumerate(self.bodies) if body.name == name]
        if len(found) != 1:
            names = ", ".join(repr(body.name) for body in self.bodies)
            raise KeyError(f"{len(found)} bodies are called {name!r}; there are {names}")
        return found[0]
