# SPDX-License-Identifier: Apache-2.0
"""Fine concave surfaces that hold each other: threads, linked rings.

A screw that may slide but not turn, in a nut that turns: it rides on its flanks and goes by one
pitch a turn. Meshes of a thread repeat after a part of a turn, where that is exact; between, facets
ride on facets. The M20 bolt and nut (11,044 faces) are those of Taccel's assets.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from taccel_lab.exporters.published_meshes import mesh_folder, read_stl
from taccel_lab.scene import AffineBody, KinematicBody, PrismaticJoint, TriangleMesh
from taccel_lab.solvers import SolverConfig
from tests.support.blocks import everywhere, pose
from tests.support.variants import variants
from tests.verification.affine_scenes import Run, affine_scene
from tests.verification.shapes import nut_mesh, screw_mesh, torus_mesh


class Thread(NamedTuple):
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


@pytest.mark.thorough
@pytest.mark.parametrize("source", variants(["published"], ["generated", "published"]))
def test_a_turning_nut_lowers_a_screw(source: str) -> None:
    made = thread(source)
    place = pose(0, 0, -0.9 * made.slack)
    screw = AffineBody(
        made.screw, 7800.0, name="screw", friction_coefficient=0.1, initial_pose=place
    )
    slides = PrismaticJoint("screw", None, axis=(0, 0, 1))
    scene = affine_scene(screw, slides, kinematic=KinematicBody(made.nut, 0.1, name="nut"))
    run = Run(scene, SolverConfig(dhat_m=5e-5))
    run.steps(4)
    start = run.y[0, 0, 2]
    for angle in np.arange(7.5, 30.1, 7.5):
        run.step(pose(0, 0, 0, deg=angle))
        assert run.crossings() == []
        exact = angle % made.period_deg == 0
        # Where facets meet as before, the screw hangs by the same gap as before.
        assert start - run.y[0, 0, 2] == pytest.approx(
            made.pitch * angle / 360, abs=2e-6 if exact else made.facet
        )
    assert run.strain < 1e-4
    total = run.contact("screw") + run.friction("screw")
    # It is being lowered in jerks, from facet to facet.
    assert total.sum(axis=0)[2] == pytest.approx(run.weight, rel=0.2)


def test_a_ring_hangs_in_a_ring_and_is_swung() -> None:
    shape = torus_mesh(10e-3, 2e-3, 32, 16)
    # Upright, too, a quarter of a turn about z, its top within the held ring's bottom.
    place = pose(0, 0, -15.8e-3, (0, 1, 0), 90)
    ring = AffineBody(shape, 1000.0, name="ring", friction_coefficient=0.4, initial_pose=place)
    scene = affine_scene(ring, kinematic=KinematicBody(shape, 0.4, name="held"))
    upright = pose(0, 0, 0, (1, 0, 0), 90)
    run = Run(scene, SolverConfig(dhat_m=1e-4, kappa_pa=1e5), everywhere(1, upright))
    for _ in range(20):
        run.step()
        assert run.crossings() == []
    np.testing.assert_allclose(run.force("ring") / run.weight, [0, 0, 1], atol=1e-2)
    # Its top rests in the other's bottom: 16 mm below, and the gap and facets closer to it.
    assert run.y[0, 0, 2] == pytest.approx(-16e-3, abs=0.2e-3)
    for turn in np.deg2rad(np.arange(15, 121, 15)):
        place = 20e-3 * np.array([np.sin(turn), 0, 1 - np.cos(turn)])
        run.step(np.append(place, upright[3:]))
        assert run.crossings() == []
        assert np.linalg.norm(run.y[0, 0] - place) < 16.2e-3, "it is still linked"
    assert run.strain < 1e-4
