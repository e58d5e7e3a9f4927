# SPDX-License-Identifier: Apache-2.0
"""Newton's tets as our gels.

Each connected piece of tets is a soft body. Particles that newton holds (of no mass, or not active)
are bonded in the world, those that are attached to a body are bonded to that body, exactly, however
stiff newton's springs are. Small strains follow newton's Lame parameters:
E = mu (3 lambda + 2 mu) / (lambda + mu), nu = lambda / (2 (lambda + mu)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.connectivity import compacted, piece_of_nodes
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.newton_bridge.newton_model import NewtonModel
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.scene import Element, Material, MaterialField, SoftBody

REST_SLACK = 1e-6
"""How far a particle may be from where it rests or is attached, over the size of its body."""
STRAIN = 1e-3
"""Largest strain that tets may start with."""


@dataclass(frozen=True)
class NewtonGel:
    """A soft body, and what carries it."""

    gel: SoftBody
    body: int
    """Newton's body that its bonded nodes are attached to; -1 for none."""
    particles: np.ndarray
    """Newton's particles that are its nodes, [node]."""


def soft_bodies(source: NewtonModel) -> list[NewtonGel]:
    """All soft bodies of a model, in the frames of the bodies that carry them.

    Raises InputError for particles that belong to no tet, springs and cloth, tets that do not start
    at rest, gels that two bodies carry, and attachments that start stretched.
    """
    for what in ("tri", "spring"):
        stiff = source.array("tri_materials" if what == "tri" else "spring_stiffness")
        if stiff.size and (stiff.reshape(len(stiff), -1)[:, :3] != 0).any():
            name = "triangles with a stiffness (cloth)" if what == "tri" else "springs"
            raise InputError(f"the model has {name}: of soft bodies, tets can be taken over")
    count = int(source.model.particle_count)
    tets = source.array("tet_indices").reshape(-1, 4).astype(np.int64)
    if not count:
        return []
    pieces = piece_of_nodes(tets, count)
    alone = np.setdiff1d(np.arange(count), tets)
    if len(alone):
        raise InputError(f"{len(alone)} particles belong to no tet, such as particle {alone[0]}")
    return [
        _gel(source, f"soft {k}", tets, np.flatnonzero(pieces[tets[:, 0]] == piece))
        for k, piece in enumerate(np.unique(pieces))
    ]


def _gel(source: NewtonModel, name: str, tets: np.ndarray, own: np.ndarray) -> NewtonGel:
    particles, local = compacted(tets[own])
    points = source.array("particle_q").reshape(-1, 3)[particles]
    size = float(np.ptp(points, axis=0).max())
    _check_rest(source, name, points[local], own)
    held = source.array("particle_mass")[particles] == 0
    held |= source.array("particle_flags")[particles] & int(source.newton.ParticleFlags.ACTIVE) == 0
    carrier, attached = _attachments(source, name, particles, points, size)
    if carrier >= 0:
        if (held & ~attached).any():
            raise InputError(f"{name} is held by the world and by a body: one of them can be")
        place = matrix_of(source.body_q[carrier])
        points = (points - place[:3, 3]) @ place[:3, :3]
        held = attached
    faces = boundary_faces(local)
    regions = np.where(held[faces].all(axis=1), int(Region.BOND), int(Region.CONTACT))
    mesh = TetMesh(points, local, faces, regions)
    density = _density(mesh, source.array("particle_mass")[particles])
    mu, lam = source.array("tet_materials")[own].T[:2]
    young = mu * (3 * lam + 2 * mu) / (lam + mu)
    poisson = lam / (2 * (lam + mu))
    material: Material | MaterialField = Material(float(young[0]), float(poisson[0]), density)
    if np.ptp(young) > 0 or np.ptp(poisson) > 0:
        material = MaterialField(young, poisson, density)
    gel = SoftBody(
        mesh,
        material,
        bonded_nodes=np.flatnonzero(held),
        name=name,
        element=Element.LINEAR,
    )
    return NewtonGel(gel, carrier, particles)


def _check_rest(source: NewtonModel, name: str, corners: np.ndarray, own: np.ndarray) -> None:
    """Refuse tets whose corners [tet, 4, 3] are not where newton's rest shapes have them."""
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    strain = edges @ source.array("tet_poses")[own]
    off = np.abs(np.swapaxes(strain, 1, 2) @ strain - np.eye(3)).max(axis=(1, 2))
    if off.max() > STRAIN:
        raise InputError(
            f"{name} does not start at rest: tet {own[off.argmax()]} is strained by {off.max():.3g}"
        )
    if source.array("tet_activations")[own].any():
        raise InputError(f"{name} has tets with an activation: these cannot be taken over")


def _attachments(
    source: NewtonModel, name: str, particles: np.ndarray, points: np.ndarray, size: float
) -> tuple[int, np.ndarray]:
    """The body that particles are attached to, -1 for none, and which ones, bool, [node]."""
    attached = np.zeros(len(particles), dtype=bool)
    if not source.model.attachment_particle_body_count:
        return -1, attached
    ids = source.array("attachment_particle_body_particle")
    rows = np.flatnonzero(
        np.isin(ids, particles) & source.array("attachment_particle_body_enabled").astype(bool)
    )
    if not len(rows):
        return -1, attached
    bodies = np.unique(source.array("attachment_particle_body_body")[rows])
    if len(bodies) > 1:
        names = ", ".join(source.bodies[i] for i in bodies)
        raise InputError(f"{name} is attached to several bodies, {names}: one can carry it")
    nodes = np.searchsorted(particles, ids[rows])
    place = matrix_of(source.body_q[bodies[0]])
    anchors = source.array("attachment_particle_body_body_point")[rows]
    gaps = np.linalg.norm(anchors @ place[:3, :3].T + place[:3, 3] - points[nodes], axis=1)
    slack = REST_SLACK * (size + float(np.abs(points).max()))
    if gaps.max() > slack:
        raise InputError(
            f"{name} starts {gaps.max():.3g} m from where particle {ids[rows][gaps.argmax()]} is "
            "attached: attachments must start closed"
        )
    attached[nodes] = True
    return int(bodies[0]), attached


def _density(mesh: TetMesh, masses: np.ndarray) -> float:
    """The density [kg/m^3] that gives the nodes with a mass the sum of newton's masses.

    Newton's grids give each particle the mass of a whole cell, so that it is not that of the tets.
    """
    shares = np.zeros(mesh.node_count)
    np.add.at(shares, mesh.tets, mesh.volumes_m3()[:, None] / 4)
    return float(masses.sum() / shares[masses > 0].sum())
