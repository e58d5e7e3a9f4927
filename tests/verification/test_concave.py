# SPDX-License-Identifier: Apache-2.0
"""Fine concave surfaces that hold each other: threads, linked rings.

A screw that may slide but not turn, in a nut that turns: it rides on its flanks and goes by one
pitch a turn. Meshes of a thread repeat after a part of a turn, where that is exact; between, facets
ride on facets. The M20 bolt and nut (11,044 faces) are those of Taccel's assets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from taccel_lab.exporters.published_meshes import mesh_folder, read_stl
from taccel_lab.scene import AffineBody, KinematicBody, PrismaticJoint, TriangleMesh
from taccel_lab.solvers import SolverConfig
from tests.support.blocks import everywhere, pose
from tests.support.variants import variants
from tests.verification.affine_scenes import G, Run, affine_scene, turned
from tests.verification.shapes import nut_mesh, screw_mesh, torus_mesh

DENSITY = 7800.0


@dataclass(frozen=True)
class Thread:
    """A screw through a nut, both as they fit with the same clearance up and down."""

    screw: TriangleMesh
    nut: TriangleMesh
    pitch: float
    slack: float
    """How far the screw may sink from there [m], about."""
    period_deg: float
    """Turn after which the facets meet again as before."""
    facet: float
    """Largest depth of a facet's chord along the axis [m]."""


def thread(source: str) -> Thread:
    if source == "generated":
        screw = screw_mesh(4e-3, 5e-3, 2e-3, 4.0)
        lowered = TriangleMesh(screw.vertices_m - [0, 0, 2e-3], screw.faces)
        nut = nut_mesh(4.3e-3, 5.3e-3, 2e-3, 2.0, 8e-3)
        return Thread(lowered, nut, 2e-3, 0.3e-3, 22.5, 0.1e-3)
    folder = mesh_folder() / "bolt_and_nut"
    if not folder.is_dir():
        pytest.skip(f"the bolt and the nut are not at {folder}")
    screw, nut = (read_stl(folder / f"m20_{name}_wt.stl") for name in ("bolt", "nut"))
    return Thread(screw, nut, 2.5e-3, 0.36e-3, 30.0, 0.03e-3)


def screw_body(made: Thread, friction: float) -> AffineBody:
    start = np.array([0, 0, -0.9 * made.slack, 0, 0, 0, 1])
    return AffineBody(
        made.screw, DENSITY, name="screw", friction_coefficient=friction, initial_pose=start
    )


@pytest.mark.thorough
@pytest.mark.parametrize("source", variants(["published"], ["generated", "published"]))
def test_a_turning_nut_lowers_a_screw(source: str) -> None:
    """A twelfth of a turn, in steps of 7.5 degrees."""
    made = thread(source)
    scene = affine_scene(
        [screw_body(made, 0.1)],
        [PrismaticJoint("screw", None, axis=(0, 0, 1))],
        kinematic=[KinematicBody(made.nut, 0.1, name="nut")],
    )
    run = Run(scene, SolverConfig(dhat_m=5e-5), everywhere(1, pose(0, 0, 0)))
    for _ in range(4):
        run.step()
    start = run.y[0, 0, 2]
    for angle in np.arange(7.5, 30.1, 7.5):
        run.step(everywhere(1, pose(0, 0, 0, deg=angle)))
        assert run.overlaps() == []
        exact = angle % made.period_deg == 0
        # Where facets meet as before, the screw hangs by the same gap as before.
        assert start - run.y[0, 0, 2] == pytest.approx(
            made.pitch * angle / 360, abs=2e-6 if exact else made.facet
        )
    assert run.strain < 1e-4
    nodes = run.model.bodies[0].node_slice
    total = -(run.solver.contact_gradient.numpy() + run.solver.friction_gradient.numpy())
    # It is being lowered in jerks, from facet to facet.
    assert total[0, nodes].sum(axis=0)[2] == pytest.approx(run.masses[0, 0, 0] * G, rel=0.2)


def linked_rings(friction: float) -> Run:
    """A ring that hangs in another one, which is held upright."""
    held = torus_mesh(10e-3, 2e-3, 32, 16)
    ring = AffineBody(
        torus_mesh(10e-3, 2e-3, 32, 16),
        1000.0,
        name="ring",
        friction_coefficient=friction,
        # Upright, too, a quarter of a turn about z, its top within the held ring's bottom.
        initial_pose=np.array([0, 0, -15.8e-3, *turned((0, 1, 0), np.pi / 2)]),
    )
    scene = affine_scene([ring], kinematic=[KinematicBody(held, friction, name="held")])
    upright = pose(0, 0, 0, (1, 0, 0), 90)
    return Run(scene, SolverConfig(dhat_m=1e-4, kappa_pa=1e5), everywhere(1, upright))


def test_a_ring_hangs_in_a_ring_and_is_swung() -> None:
    run = linked_rings(0.4)
    for _ in range(20):
        run.step()
        assert run.overlaps() == []
    nodes = run.model.bodies[0].node_slice
    lift = -run.solver.contact_gradient.numpy()[0, nodes].sum(axis=0)
    np.testing.assert_allclose(lift / (run.masses[0, 0, 0] * G), [0, 0, 1], atol=1e-2)
    # Its top rests in the other's bottom: 16 mm below, and the gap and facets closer to it.
    assert run.y[0, 0, 2] == pytest.approx(-16e-3, abs=0.2e-3)
    upright = pose(0, 0, 0, (1, 0, 0), 90)[3:]
    for turn in np.deg2rad(np.arange(15, 121, 15)):
        place = 20e-3 * np.array([np.sin(turn), 0, 1 - np.cos(turn)])
        run.step(everywhere(1, np.array([*place, *upright])))
        assert run.overlaps() == []
        assert np.linalg.norm(run.y[0, 0] - place) < 16.2e-3, "it is still linked"
    assert run.strain < 1e-4
