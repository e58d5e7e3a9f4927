# SPDX-License-Identifier: Apache-2.0
"""The fine surface and its contact measure on presses that the solver computed.

Truth comes from the nodes: where they carry contact force, where they are nearer than the barrier's
range, and the plain C1 surface through them.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from taccel_lab.geometry import PixelGrid
from taccel_lab.outputs import Outputs
from taccel_lab.outputs.contact_layer import mean_gaps
from taccel_lab.presses import Indenter, PressEnv, PressMeshOptions, PressSetup
from taccel_lab.presses.mesh import press_mesh
from taccel_lab.presses.outcome import contact_radii_m
from taccel_lab.scene import Ball, Material
from taccel_lab.signals import ContactFaceMesh, FineSurface, SignalTactile, normals_from_height
from taccel_lab.solvers import SolverConfig
from tests.signals.height_map_referee import HeightMapReferee
from tests.signals.pressed_surface import angle_deg, pixel_xy
from tests.support.variants import variants

GRID = PixelGrid(640, 480, 0.0295, 0.0295)
X, Y = pixel_xy(GRID)
BALL_M = 2e-3
BALL = Indenter("ball", Ball(BALL_M))
FINE = PressMeshOptions(elements_per_radius=6.0, core=6, rings=8)
COARSE = PressMeshOptions(elements_per_radius=4.0, core=6, rings=10)
PRESSES = {
    # The last goes past the ball's equator.
    "frictionless": (0.0, (0.0, 0.0), (1.2, 2.2)),
    "friction 1": (1.0, (0.0, 0.0), (0.4, 0.9)),
    "off centre": (0.0, (3.0, 2.0), (0.4, 1.5)),
}
"""Friction, place [mm] and depths [mm]."""


@dataclass(frozen=True)
class PressedTo:
    """A press at one depth: its nodes, and what pixels show of it."""

    depth_mm: float
    surface: ContactFaceMesh
    points_m: np.ndarray
    """Of the surface's nodes, as all that follows."""
    forces_n: np.ndarray
    pressures_pa: np.ndarray
    center_m: np.ndarray
    gap_m: float
    """Mean gap of the contacts, by which the ball shows nearer."""
    height_m: np.ndarray
    normals: np.ndarray
    contact_radius_m: float
    plain: HeightMapReferee

    @property
    def slope(self) -> np.ndarray:
        return -self.normals[..., :2] / self.normals[..., 2:]

    def gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """Gaps [m] of the nodes to the ball, and whether they carry normal force."""
        towards = self.center_m - self.points_m
        distance = np.linalg.norm(towards, axis=1)
        return distance - BALL_M, -(self.forces_n * towards).sum(axis=1) / distance > 1e-8

    def radius_of(self, nodes: np.ndarray) -> float:
        """Radius [m] of the disc that has the projected area of a set of nodes."""
        a, b, c = (self.points_m[self.surface.faces[:, k], :2] for k in range(3))
        share = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 6
        return float(np.sqrt((share[:, None] * nodes[self.surface.faces]).sum() / np.pi))

    def rim(self) -> tuple[float, float, float]:
        """Least and largest distance of the contact's edge from the axis, element length [m]."""
        _, loaded = self.gaps()
        r = np.linalg.norm(self.points_m[:, :2] - self.center_m[:2], axis=1)
        leaving = self.surface.edges[loaded[self.surface.edges].sum(axis=1) == 1]
        ends = self.points_m[leaving, :2]
        element = np.median(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))
        return float(r[~loaded].min()), float(r[loaded].max()), float(element)

    def distance(self) -> np.ndarray:
        """Distance of the pixels from the ball's axis [m]."""
        return np.hypot(X - self.center_m[0], Y - self.center_m[1])


def simulated(
    friction: float,
    at_mm: tuple[float, float],
    depths_mm: tuple[float, ...],
    options: PressMeshOptions = FINE,
) -> list[PressedTo]:
    mesh = press_mesh("gelsight", {}, at_mm, 1.85, options)
    at, gel = np.array([at_mm]), Material(1.5e5, 0.46)
    env = PressEnv(PressSetup(mesh, gel, BALL, friction_coefficient=friction), at)
    outputs, fine = Outputs(env.solver), FineSurface(env.solver, "ball", GRID)
    signal = SignalTactile.from_solver(env.solver, GRID, fine=fine)
    surface, nodes = ContactFaceMesh.from_mesh(env.mesh), env.model.bodies[0].nodes
    found = []
    for depth in depths_mm:
        env.move_to(depth)
        signal.update(env.state)
        height, normals = (a.numpy()[0].astype(float) for a in signal.read("height_m", "normals"))
        plain = HeightMapReferee(env.mesh, GRID)
        plain.update(env.positions)
        of_nodes = (env.positions[0], env.contact_forces[0])
        pressures = outputs.update(env.state).surface_load.pressures.numpy()[0]
        found.append(
            PressedTo(
                depth,
                surface,
                *(values[surface.node_idx].copy() for values in of_nodes),
                pressures[surface.node_idx].copy(),
                env.poses[0, 0, :3].copy(),
                mean_gaps(env.solver.collisions, env.state.positions, nodes).numpy()[0],
                height,
                normals,
                float(np.sqrt(fine.contact_area_m2[0] / np.pi)),
                plain,
            )
        )
    return found


@functools.cache
def of_name(name: str) -> list[PressedTo]:
    return simulated(*PRESSES[name])


@pytest.fixture(params=variants(["frictionless"], PRESSES))
def press(request):
    return of_name(request.param)


@pytest.mark.thorough
def test_it_is_the_ball_inside_the_contact_and_the_surface_through_the_nodes_outside(press):
    """Of the same nodes, interpolated over their places at rest and over their places now; without
    spikes, also at the silhouette."""
    for at in press:
        least, rim, element = at.rim()
        r, fine, plain = at.distance(), at.height_m, at.plain.height_m[0]
        assert np.array_equal(np.isnan(fine), np.isnan(plain)), "beside the pad in both"
        assert np.isfinite(at.slope[np.isfinite(fine)]).all()
        outside = r > rim + 1.25 * element
        assert np.nanmax(np.abs(fine - plain)[outside]) < 0.01 * at.depth_mm * 1e-3 + 3e-6
        angle = angle_deg(at.normals, at.plain.normals[0])[outside]
        # Slivers far out let the two differ by up to 5 degrees, in a hundredth of the image.
        assert np.nanmax(angle[r[outside] < rim + 8 * element]) < 2.5
        assert np.sqrt(np.nanmean(angle**2)) < 0.3
        inside = r < least - element
        below = np.sqrt(BALL_M**2 - np.minimum(r, 0.99 * BALL_M) ** 2)
        ball = at.center_m[2] - at.gap_m - below
        # Measured up to 1.02e-6 m, an element within the rim, after ten iterations.
        assert np.abs(fine - ball)[inside].max() < 1.5e-6
        steepness = np.arctan(np.linalg.norm(at.slope, axis=-1))
        assert np.degrees(np.abs(steepness - np.arctan(r / below)))[inside].max() < 0.05
        # Near the nodes and below the ball everywhere.
        seen = r < np.sin(np.radians(75)) * BALL_M
        across = np.sqrt(np.maximum(1 - (r / BALL_M) ** 2, 0))
        assert (np.abs(fine - plain) * across)[seen].max() < 20e-6
        assert np.nanmax(np.abs(fine - plain)) < 120e-6
        assert (fine - at.center_m[2] + BALL_M * across)[seen].max() < 0
        assert np.nanmax(fine) < np.nanmax(plain) + 1e-6


@pytest.mark.slow
def test_gel_that_hangs_over_the_equator_does_not_break_it():
    """Nothing can be followed up there: the surface is that of the nodes, finite and close."""
    before, at = simulated(0.0, (-4.0, 4.0), (1.4, 2.8), COARSE)
    gap, _ = at.gaps()
    assert ((at.points_m[:, 2] > at.center_m[2]) & (gap < 0.3e-3)).any()
    fine, plain = at.height_m, at.plain.height_m[0]
    assert np.array_equal(np.isnan(fine), np.isnan(plain))
    assert np.isfinite(at.normals[np.isfinite(fine)]).all()
    # The wall is 1.5 mm high; the referee's own surface swings beside it.
    assert np.nanmax(np.abs(fine - plain)) < 180e-6
    assert before.contact_radius_m < at.contact_radius_m < 1.02 * BALL_M


@pytest.mark.thorough
def test_no_ring_around_the_contact(press):
    """Away from a central contact the skirt flattens, as the nodes do."""
    if np.abs(press[0].center_m[:2]).max() > 0:
        pytest.skip("off centre the pad's own dome tilts the skirt")
    # A shallow press is resolved by four elements; its nodes show their own ripple.
    for at in (each for each in press if each.depth_mm >= 0.8):
        r, start = at.distance(), at.rim()[1]
        slope = np.degrees(np.arctan(np.linalg.norm(at.slope, axis=-1)))
        rings = np.arange(start, 1.5 * start, 2 * GRID.mm_per_px_x * 1e-3)
        mean = np.array([slope[(r >= a) & (r < b)].mean() for a, b in pairwise(rings)])
        assert np.diff(mean).max() < 0.2


@pytest.mark.thorough
def test_slopes_are_the_heights_and_the_contact_radius_the_nodes(press):
    """Between the nodes with half of the pressure and those with any: the barrier acts a little
    beyond the edge."""
    for at in press:
        by_pixels = normals_from_height(at.height_m, GRID)
        error = angle_deg(at.normals, by_pixels)[at.distance() < 3e-3]
        # Across the edge of contact the slope turns by degrees a pixel.
        assert np.quantile(error, 0.99) < (1.5 if at.depth_mm < 2 else 6.0)
        most = at.radius_of(at.gaps()[1])
        least = at.radius_of(at.pressures_pa > 0.5 * at.pressures_pa.max())
        assert least < at.contact_radius_m < 1.02 * most
        assert most - at.contact_radius_m < 0.5 * at.rim()[2]
    assert (np.diff([at.contact_radius_m for at in press]) > 0).all()


CONVERGED = 0.1075060, 8.92353e-4
"""Force [N] and contact radius [m] on a fine mesh with a short contact range."""


def coarse_press(
    at_mm: tuple[float, float], radius_mm: float, dhat_m: float, options: PressMeshOptions
) -> PressEnv:
    """A ball over a gel that is fine within ``radius_mm``."""
    mesh, config = (
        press_mesh("gelsight", {}, at_mm, radius_mm, options),
        SolverConfig(dhat_m=dhat_m),
    )
    return PressEnv(PressSetup(mesh, Material(1.5e5, 0.46), BALL), np.array([at_mm]), config=config)


def radius_m(env: PressEnv) -> float:
    grid, frame = PixelGrid(161, 161, 0.016, 0.016), np.array([[0.0, 0, 0, 0, 0, 0, 1]])
    return float(contact_radii_m(env, BALL, grid, frame)[0])


@pytest.mark.thorough
def test_contact_radius_follows_small_changes_of_depth():
    """The depth search takes secants of it: no steps from node to node."""
    env = coarse_press((0.3, 0.2), 0.9, 2e-5, PressMeshOptions(3.0, core=6, rings=10))
    depths, radii = np.linspace(0.4, 0.42, 4), []
    for depth in depths:
        env.move_to(depth)
        radii.append(radius_m(env))
    assert (np.diff(radii) > 0).all()
    smooth = np.polyval(np.polyfit(depths, radii, 2), depths)
    assert np.abs(radii - smooth).max() < 3e-6


def force_and_radius(dhat_m: float, options: PressMeshOptions) -> tuple[float, float]:
    env = coarse_press((0.0, 0.0), (0.4 * BALL_M * 1e3) ** 0.5, dhat_m, options)
    env.move_to(0.4)
    return float(env.wrench[0, 2]), radius_m(env)


@pytest.mark.thorough
@pytest.mark.parametrize(("size", "dhat_m"), variants([(3.0, 2e-5)], [3.0, 5.0], [2e-5, 2e-6]))
def test_contact_radius_depends_on_neither_dhat_nor_mesh(dhat_m, size):
    """At the same force: the barrier's layer presses a little deeper."""
    force, radius = force_and_radius(dhat_m, PressMeshOptions(size, core=6, rings=10))
    assert radius == pytest.approx(CONVERGED[1] * (force / CONVERGED[0]) ** (1 / 3), rel=0.03)


@pytest.mark.slow
def test_the_converged_press_is_measured():
    found = force_and_radius(2e-6, PressMeshOptions(6.0, core=8, rings=12, layers=2))
    assert found == pytest.approx(CONVERGED, rel=1e-4)
