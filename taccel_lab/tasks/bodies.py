# SPDX-License-Identifier: Apache-2.0
"""Bodies and physics that tasks have in common; it reads no files, and so needs no pydantic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.bodies.mass_properties import mass_properties
from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.block import block_mesh, labelled
from taccel_lab.model import BodyKind, Model
from taccel_lab.scene import (
    AffineBody,
    Ball,
    Element,
    KinematicBody,
    Material,
    SoftBody,
    TriangleMesh,
    box_mesh,
    cylinder_mesh,
    sphere_mesh,
)
from taccel_lab.solvers import SolverConfig

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile
    from taccel_lab.tasks.parameters import Contact, FreeBody, PadParameters


G = 9.81
"""Gravity [m/s^2], downwards."""


def contact_config(contact: Contact, quasi_static_s: float | None = None) -> SolverConfig:
    """Settings of the solver, of a scene with inertia, or of one without that takes steps of
    ``quasi_static_s``."""
    config = SolverConfig(
        dhat_m=1e-3 * contact.dhat_mm, absolute_tolerance_n=contact.absolute_tolerance_n
    )
    speed = 1e-3 * contact.friction_speed_mm_s
    if quasi_static_s is None:
        return replace(config, friction_speed_m_s=speed)
    return replace(config, friction_eps_m=speed * quasi_static_s)


def pad_mesh(pad: PadParameters) -> TetMesh:
    """Its contact face at z = 0, the bond below."""
    width, height, thickness = (1e-3 * side for side in pad.size_mm)
    cells = (pad.cells[0], pad.cells[1], pad.cells[2])
    if pad.focus == 0:
        return block_mesh(cells, (width, height, thickness), pad.jitter, seed=4)
    unit = block_mesh(cells, (2.0, 2.0, 1.0), pad.jitter, seed=4)
    graded = np.sinh(pad.focus * unit.nodes_m) / np.sinh(pad.focus)
    return labelled(graded * [width / 2, height / 2, thickness], unit.tets)


def pad_body(
    pad: PadParameters, mesh: TetMesh, name: str = "gel", mount: str | None = None
) -> SoftBody:
    """The gel, in its own frame, or in that of its mount."""
    return SoftBody(
        mesh,
        Material(pad.young_modulus_pa, pad.poisson_ratio, pad.density_kg_m3),
        name=name,
        mount=mount,
        friction_coefficient=pad.friction,
        element=Element(pad.element),
    )


def sensor_gel(sensor: SensorProfile, **options: Any) -> SoftBody:
    """The gel of a sensor in the sensor's frame; ``options``: further fields of ``SoftBody``.

    Raises InputError for a gel with layers of several materials.
    """
    # Profiles need pydantic, which the machines of a cluster may lack.
    from taccel_lab.presses.profile_gel import profile_gel

    if sensor.material.layers:
        raise InputError(
            f"sensor {sensor.sensor.name!r} has a gel of several layers: tasks take gels of one"
        )
    return profile_gel(sensor, **options)


def free_body(body: FreeBody, shape: TriangleMesh, name: str, poses: np.ndarray) -> AffineBody:
    """A stiff body of even density that nothing holds, at ``poses`` [7] or [env, 7]."""
    return AffineBody(
        shape,
        density_kg_m3=body.mass_kg / mass_properties(shape, 1.0).volume_m3,
        name=name,
        friction_coefficient=body.friction,
        initial_pose=poses,
    )


def solid(shape: str, size_mm: Sequence[float]) -> TriangleMesh:
    """Surface about its middle [m]: a "box" of three sides; a "cylinder", upright, of radius and
    height; a "sphere" of a radius."""
    size = [1e-3 * value for value in size_mm]
    if shape == "box":
        return box_mesh((size[0], size[1], size[2]))
    if shape == "cylinder":
        return cylinder_mesh(size[0], size[1])
    return sphere_mesh(size[0], size[0] / 5)


SIDES = ("left", "right")


def gels_of(
    pad: PadParameters, mesh: TetMesh | None = None
) -> tuple[list[SoftBody], list[KinematicBody]]:
    """The gels, and the frames that carry them: ``left mount``, ``right mount``.

    ``mesh`` stands in place of the block of ``pad``: its contact face touches z = 0 from below.
    """
    mesh = pad_mesh(pad) if mesh is None else mesh
    return (
        [pad_body(pad, mesh, side, f"{side} mount") for side in SIDES],
        [KinematicBody(None, name=f"{side} mount") for side in SIDES],
    )


def mounts_of(hands: np.ndarray, half_m: np.ndarray) -> np.ndarray:
    """Where the mounts are, [env, 2, 4, 4], the gels' faces at minus and plus ``half_m``, [env] or
    [env, 2], of the hands [env, 4, 4]; a gel's own y is the hand's z."""
    in_hand = np.tile(np.eye(4), (len(hands), 2, 1, 1))
    half_m = np.broadcast_to(half_m.reshape(len(hands), -1), (len(hands), 2))
    for k, side in enumerate((-1.0, 1.0)):
        in_hand[:, k, :3, 0] = [0.0, -side, 0.0]
        in_hand[:, k, :3, 1] = [0.0, 0.0, 1.0]
        in_hand[:, k, :3, 2] = [-side, 0.0, 0.0]
        in_hand[:, k, 0, 3] = side * half_m[:, k]
    return hands[:, None] @ in_hand


def surfaces(
    scene: SceneDescription, model: Model, positions: np.ndarray
) -> list[tuple[Any, np.ndarray, np.ndarray]]:
    """Kind, vertices [m] and triangles of every body that has a surface, of one environment.

    ``positions``: of its nodes [m], [node_count, 3]. Planes are left out.
    """
    found = []
    bodies = [b for b in scene.bodies if hasattr(b, "surface")]
    for body, nodes in zip(bodies, model.bodies, strict=True):
        place = positions[nodes.node_slice]
        shape = getattr(body, "shape", None)
        if nodes.kind is BodyKind.SOFT:
            found.append((nodes.kind, place, body.nodal_mesh.faces))  # type: ignore[union-attr]
        elif isinstance(shape, Ball):
            ball = sphere_mesh(shape.radius_m, shape.radius_m / 10)
            found.append((nodes.kind, ball.vertices_m + place[0], ball.faces))
        elif shape is not None:
            found.append((nodes.kind, place, shape.faces))
    return found
