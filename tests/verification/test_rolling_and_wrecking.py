# SPDX-License-Identifier: Apache-2.0
"""A ball that rolls down a slope, and a wrecking ball on a chain of hinged links."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from taccel_lab.bodies.mass_properties import mass_properties
from taccel_lab.scene import AffineBody, Plane, RevoluteJoint, TimeScheme, sphere_mesh
from taccel_lab.solvers import SolverConfig
from tests.verification.affine_scenes import G, Run, affine_scene, box, turned

RADIUS, SLOPE = 20e-3, np.radians(10)


def ball_on_slope(friction: float) -> tuple[Run, float]:
    """2,562 vertices, and gravity that leans; also m r^2 over the mesh's moment of inertia."""
    mesh, dhat = sphere_mesh(RADIUS, 2e-3), 1e-4
    reach = float(np.linalg.norm(mesh.vertices_m, axis=1).max())
    ball = AffineBody(
        mesh,
        name="ball",
        friction_coefficient=friction,
        initial_pose=np.array([0, 0, reach + 0.5 * dhat, 0, 0, 0, 1]),
    )
    scene = affine_scene(
        [ball],
        planes=[Plane(friction_coefficient=friction)],
        gravity=(G * np.sin(SLOPE), 0.0, -G * np.cos(SLOPE)),
        dt=5e-3,
        scheme=TimeScheme.BDF2,
    )
    properties = mass_properties(mesh, 1000.0)
    ratio = properties.mass_kg * RADIUS**2 / properties.inertia_kg_m2[1, 1]
    return Run(scene, SolverConfig(dhat_m=dhat, kappa_pa=1e5)), float(ratio)


@pytest.mark.parametrize("friction", [0.5, 0.02])
def test_a_ball_on_a_slope(friction: float) -> None:
    """It rolls where mu > 2/7 tan, at 5/7 g sin, and else slides at g (sin - mu cos).

    A mesh rolls from facet to facet: edges of a tenth of the radius dip by a thousandth of it, half
    of the layer that carries the ball, and its acceleration wavers by some thousandths.
    """
    run, ratio = ball_on_slope(friction)
    assert ratio == pytest.approx(2.5, rel=3e-3)
    n = 15
    places, angles = [0.0], [0.0]
    for _ in range(2 * n):
        run.step()
        places.append(run.y[0, 0, 0])
        a = run.maps[0]
        angles.append(float(np.arctan2(-a[2, 0], a[0, 0])))
    assert run.overlaps() == []
    found = np.diff(places[::n], n=2)[0] / (n * run.dt) ** 2
    arc = RADIUS * np.unwrap(angles)[-1]
    if friction > 2 / 7 * np.tan(SLOPE):
        assert found == pytest.approx(5 / 7 * G * np.sin(SLOPE), rel=1e-2)
        assert arc == pytest.approx(places[-1], rel=5e-3)
    else:
        assert found == pytest.approx(G * (np.sin(SLOPE) - friction * np.cos(SLOPE)), rel=1e-2)
        assert arc < 0.5 * places[-1]
    assert run.strain < 1e-4


# Wrecking ball ---------------------------------------------------------------------------------

LINKS, LINK, BALL = 4, 25e-3, 15e-3
CUBE, GAP = 15e-3, 4e-5


def wrecking_ball(start: float) -> Run:
    """A chain held at the origin, straight, ``start`` from the vertical, with a ball of steel at
    its end; at its lowest point the ball meets a pyramid of three light cubes."""
    along = np.array([-np.sin(start), 0, -np.cos(start)])
    rotation = turned((0, 1, 0), start)
    links = [
        box(
            f"link {i}",
            (4e-3, 4e-3, LINK),
            (i + 0.5) * LINK * along,
            rotation,
            young_modulus_pa=1e10,
        )
        for i in range(LINKS)
    ]
    reach = LINKS * LINK
    ball = AffineBody(
        sphere_mesh(BALL, 6e-3),
        7800.0,
        name="ball",
        friction_coefficient=0.3,
        initial_pose=np.array([*((reach + BALL) * along), 0, 0, 0, 1]),
    )
    names = [None, *(link.name for link in links), "ball"]
    joints = [
        RevoluteJoint(str(first), second, i * LINK * along, (0, 1, 0), name=f"hinge {i}")
        for i, (second, first) in enumerate(pairwise(names))
    ]
    floor = -(reach + 2 * BALL) - 0.3 * CUBE
    x = BALL + 2e-3 + CUBE / 2
    places = [(x, -0.6 * CUBE, 0), (x, 0.6 * CUBE, 0), (x + 1e-3, 0, 1)]
    cubes = [
        box(
            f"cube {k}",
            (CUBE, CUBE, CUBE),
            (x, y, floor + (level + 0.5) * CUBE + (level + 1) * GAP),
            density_kg_m3=200.0,
            friction_coefficient=0.5,
        )
        for k, (x, y, level) in enumerate(places)
    ]
    ground = Plane((0, 0, floor), friction_coefficient=0.5)
    return Run(
        affine_scene([*links, ball, *cubes], joints, planes=[ground], dt=5e-3),
        SolverConfig(dhat_m=5e-5, kappa_pa=1e4),
    )


def test_a_wrecking_ball() -> None:
    """Joints stay closed (checked in each step), nothing intersects, energy is only ever lost."""
    run = wrecking_ball(np.radians(30))

    def energy() -> float:
        return run.kinetic_energy + float((run.masses[:, 0, 0] * G * run.y[:, 0, 2]).sum())

    before = energy()
    wall = run.y[LINKS + 1 :, 0].copy()
    fastest = 0.0
    for _ in range(39):
        run.step()
        assert run.overlaps() == []
        # Contacts and stiff bodies store next to nothing.
        assert energy() < before + 1e-9
        before = energy()
        fastest = max(fastest, run.v[LINKS, 0, 0])
    # A little below the speed of a pendulum: implicit Euler loses some of the swing.
    drop = (LINKS * LINK + BALL) * (1 - np.cos(np.radians(30)))
    assert 0.9 < fastest / np.sqrt(2 * G * drop) < 1
    assert (run.y[LINKS + 1 :, 0] - wall)[:, 0].min() > 5e-3, "all cubes are pushed ahead"
    assert run.strain < 1e-4
