# SPDX-License-Identifier: Apache-2.0
"""The fused surface and its contact against analytic presses, and objects finer than the mesh."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, Region, TetMesh
from taccel_lab.signals import (
    ContactSurface,
    HeightFieldSurface,
    SignalFusedSurface,
    SignalTactile,
    SphereSurface,
    normals_from_height,
)
from tests.signals.height_map_referee import HeightMapReferee
from tests.signals.pressed_surface import PressedSphere, angle_deg, flat_pad, pixel_xy, shaped

GRID = PixelGrid(192, 144, 0.05, 0.05)
PAD_HALF_MM = (5.2, 4.2)


def _press(sphere: PressedSphere, element_mm: float, seed: int = 0) -> SignalFusedSurface:
    mesh = flat_pad(element_mm, PAD_HALF_MM, seed)
    signal = SignalFusedSurface(mesh, GRID)
    surface = SphereSurface(sphere.center_m, sphere.radius_m, GRID)
    positions = shaped(mesh, sphere.height)
    signal.update(positions, surface, sphere.pressures(mesh, positions))
    return signal


def _errors(signal: SignalFusedSurface, sphere: PressedSphere) -> dict[str, float]:
    """RMS errors [um, deg] in the contact and in the ring out to 1.6 contact radii."""
    x, y = pixel_xy(GRID)
    r = sphere.distance_xy(x, y) / sphere.contact_radius_m
    height = (signal.height_m[0] - sphere.height(x, y)) * 1e6
    normal = angle_deg(signal.normals[0], sphere.normals(x, y))
    result = {}
    for name, where in (("disc", r < 1), ("ring", (r >= 1) & (r < 1.6))):
        result[f"{name}_um"] = float(np.sqrt((height[where] ** 2).mean()))
        result[f"{name}_deg"] = float(np.sqrt((normal[where] ** 2).mean()))
    return result


@pytest.mark.parametrize("contact_mm", [1.0, 1.4, 1.8])
def test_fused_surface_of_a_ball_press(contact_mm):
    """Limits are about twice what is measured at 0.2 mm elements (four pixels of this image).

    In the disc the height is off by the chord that nodes of a solved press would hang below.
    """
    sphere = PressedSphere(contact_mm * 1e-3)
    errors = _errors(_press(sphere, 0.2), sphere)
    assert errors["disc_um"] < 12 and errors["disc_deg"] < 0.3
    assert errors["ring_um"] < 4.0 and errors["ring_deg"] < 1.9


def test_fused_surface_converges():
    sphere = PressedSphere(1.8e-3)
    coarse, fine = (_errors(_press(sphere, h), sphere) for h in (0.3, 0.15))
    for name in coarse:
        assert fine[name] < 0.4 * coarse[name], name


@pytest.mark.parametrize("contact_mm", [0.8, 1.3, 1.8])
@pytest.mark.parametrize("seed", [0, 1])
def test_contact_radius_is_found_within_a_fraction_of_an_element(contact_mm, seed):
    sphere = PressedSphere(contact_mm * 1e-3)
    radius_mm = _press(sphere, 0.2, seed).contact_radius_m[0] * 1e3
    assert abs(radius_mm - contact_mm) < 0.1 * 0.2


def test_contact_radius_grows_with_the_press():
    """A search for the depth of a labelled radius needs a monotone answer."""
    mesh = flat_pad(0.2, PAD_HALF_MM)
    signal = SignalFusedSurface(mesh, GRID)
    found = []
    for contact in np.linspace(1.2e-3, 1.4e-3, 9):
        sphere = PressedSphere(float(contact))
        surface = SphereSurface(sphere.center_m, sphere.radius_m, GRID)
        positions = shaped(mesh, sphere.height)
        signal.update(positions, surface, sphere.pressures(mesh, positions))
        found.append(signal.contact_radius_m[0])
    assert (np.diff(found) > 0).all()
    assert found[-1] - found[0] == pytest.approx(0.2e-3, rel=0.1)


def test_no_ripple_across_the_contact_edge():
    """The error of the slope along a radius stays small on both sides of the edge."""
    sphere = PressedSphere(1.8e-3)
    signal = _press(sphere, 0.2)
    x, y = pixel_xy(GRID)
    r = sphere.distance_xy(x, y)
    near = np.abs(r - 1.8e-3) < 0.3e-3
    error = angle_deg(signal.normals[0], sphere.normals(x, y))[near]
    assert error.max() < 11.0
    # The plain C1 surface smears the edge over an element.
    plain = HeightMapReferee(flat_pad(0.2, PAD_HALF_MM), GRID)
    plain.update(shaped(flat_pad(0.2, PAD_HALF_MM), sphere.height))
    plain_error = angle_deg(plain.normals[0], sphere.normals(x, y))[near]
    assert np.sqrt((error**2).mean()) < 0.8 * np.sqrt((plain_error**2).mean())


def test_slope_is_the_derivative_of_the_fused_height():
    sphere = PressedSphere(1.5e-3)
    grid = PixelGrid(500, 40, 0.01, 0.01)
    mesh = flat_pad(0.25, PAD_HALF_MM)
    signal = SignalFusedSurface(mesh, grid)
    surface = SphereSurface(sphere.center_m, sphere.radius_m, grid)
    positions = shaped(mesh, sphere.height)
    signal.update(positions, surface, sphere.pressures(mesh, positions))
    step = 0.01e-3
    along_x = (signal.height_m[0, :, 2:] - signal.height_m[0, :, :-2]) / (2 * step)
    error = np.abs(along_x - signal.slope[0, :, 1:-1, 0])
    # The curvature jumps at the edge, where a central difference is off by a step times it.
    assert np.quantile(error, 0.99) < 0.01
    assert error.max() < 0.15


def _hovering(sphere: PressedSphere, mesh: TetMesh, dhat: float) -> np.ndarray:
    """Node positions as a barrier leaves them: edges touch, nodes hang below, less under load."""
    positions = shaped(mesh, sphere.height)
    top = mesh.region_nodes(Region.CONTACT)
    surface = ContactSurface.from_mesh(mesh)
    towards = sphere.center_m - positions[0, top]
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    r = sphere.distance_xy(positions[0, top, 0], positions[0, top, 1]) / sphere.contact_radius_m
    middle = positions[0, top][surface.edges].mean(axis=1)
    dip = sphere.radius_m - np.linalg.norm(middle - sphere.center_m, axis=1)
    hang = np.zeros(len(top))
    for ends in surface.edges.T:
        np.add.at(hang, ends, dip / np.diff(surface.ring_start)[ends])
    pressure = np.sqrt(np.maximum(1 - r**2, 0))
    positions[0, top] -= (dhat * (1 - 0.6 * pressure) + hang * (r < 1))[:, None] * towards
    return positions


@pytest.mark.parametrize("contact_mm", [0.9, 1.5])
def test_barrier_gap_and_chords_do_not_move_the_edge(contact_mm):
    sphere = PressedSphere(contact_mm * 1e-3)
    mesh = flat_pad(0.2, PAD_HALF_MM)
    signal = SignalFusedSurface(mesh, GRID)
    surface = SphereSurface(sphere.center_m, sphere.radius_m, GRID)
    radii = []
    for dhat in (20e-6, 10e-6, 5e-6, 2e-6):
        positions = _hovering(sphere, mesh, dhat)
        signal.update(positions, surface, sphere.pressures(mesh, positions))
        radii.append(signal.contact_radius_m[0])
        assert radii[-1] == pytest.approx(contact_mm * 1e-3, rel=0.03)
        errors = _errors(signal, sphere)
        assert errors["disc_deg"] < 0.8 and errors["ring_deg"] < 2.0
        # In contact the surface is the ball's, as much lower as the rim's nodes hover and hang.
        x, y = pixel_xy(GRID)
        r = sphere.distance_xy(x, y)
        inside = r < sphere.contact_radius_m - 0.2e-3
        layer = np.hypot(r, signal.height_m[0] - sphere.center_m[2]) - sphere.radius_m
        assert np.ptp(layer[inside]) < 1e-9
        assert 0.4 * dhat < layer[inside].mean() < dhat + 5e-6
    assert np.ptp(radii) < 0.02 * contact_mm * 1e-3


def test_without_contact_the_gel_surface_is_untouched():
    mesh = flat_pad(0.4, PAD_HALF_MM)
    positions = shaped(mesh, lambda x, y: 0.1 * x)
    fused = SignalFusedSurface(mesh, GRID)
    nothing = np.zeros((1, mesh.node_count))
    fused.update(positions, SphereSurface(np.array([0, 0, 3e-3]), 2e-3, GRID), nothing)
    plain = SignalTactile(mesh, GRID, env_count=1)
    plain.update(wp.array(positions, dtype=wp.vec3d, device="cpu"))
    assert np.allclose(fused.height_m, plain.height_m.numpy(), rtol=0, atol=1e-9)
    assert fused.contact_radius_m[0] == 0.0
    assert not fused.contact_mask.any()


def test_warp_arrays_are_read():
    mesh = flat_pad(0.4, PAD_HALF_MM)
    positions = shaped(mesh, lambda x, y: 0.2 * x)
    far = SphereSurface(np.array([0, 0, 9e-3]), 2e-3, GRID)
    signal = SignalFusedSurface(mesh, GRID)
    heights = []
    for given in (positions, wp.array(positions, dtype=wp.vec3d, device="cpu")):
        signal.update(given, far, np.zeros((1, mesh.node_count)))
        heights.append(signal.height_m.copy())
    assert np.array_equal(*heights)


def test_texture_finer_than_the_mesh_shows_in_contact_only():
    """A flat square stamp with 0.2 mm grooves on a gel of 0.4 mm elements."""
    mesh = flat_pad(0.4, PAD_HALF_MM)
    x, y = pixel_xy(GRID)
    groove = 5e-6 * (1 - np.cos(2 * np.pi * x / 0.2e-3))
    stamp = np.where(np.maximum(np.abs(x), np.abs(y)) < 1.5e-3, -0.3e-3 + groove, np.nan)
    flat = lambda px, py: np.where(  # noqa: E731
        np.maximum(np.abs(px), np.abs(py)) < 1.5e-3,
        -0.3e-3,
        -0.3e-3 * np.exp(-(np.maximum(np.abs(px), np.abs(py)) - 1.5e-3) / 0.5e-3),
    )
    signal = SignalFusedSurface(mesh, GRID)
    positions = shaped(mesh, flat)
    positions[0, mesh.region_nodes(Region.CONTACT), 2] -= 12e-6
    pressures = np.zeros((1, mesh.node_count))
    pressures[0, mesh.region_nodes(Region.CONTACT)] = 1.0
    pressures[:, (np.abs(positions[0, :, :2]) > 1.5e-3).any(axis=1)] = 0.0
    signal.update(positions, HeightFieldSurface(stamp, GRID), pressures)
    inner = np.maximum(np.abs(x), np.abs(y)) < 0.9e-3
    outer = np.maximum(np.abs(x), np.abs(y)) > 3.0e-3
    # As much lower as the nodes are: 12 um and, in the mean, half a groove.
    below = (stamp - signal.height_m[0])[inner]
    assert np.ptp(below) < 1e-9 and 12e-6 < below.mean() < 22e-6
    assert np.isfinite(signal.height_m).all() and np.isfinite(signal.normals).all()
    assert np.abs(signal.height_m[0])[outer].max() < 30e-6


def test_a_sphere_mesh_gives_the_sphere():
    sphere = PressedSphere(1.2e-3)
    vertices, triangles = _icosphere(4)
    vertices = vertices * sphere.radius_m + sphere.center_m
    surface = HeightFieldSurface.from_mesh(vertices, triangles, GRID)
    x, y = pixel_xy(GRID)
    r = sphere.distance_xy(x, y)
    inside = r < 1.5e-3
    exact = sphere.center_m[2] - np.sqrt(sphere.radius_m**2 - np.minimum(r, 1.9e-3) ** 2)
    # Chords of a convex body lie inside it: the mesh is above the sphere's underside.
    difference = (surface.height_m[0] - exact)[inside]
    assert difference.min() > -1e-12 and difference.max() < 12e-6
    mesh = flat_pad(0.2, PAD_HALF_MM)
    signal = SignalFusedSurface(mesh, GRID)
    positions = shaped(mesh, sphere.height)
    signal.update(positions, surface, sphere.pressures(mesh, positions))
    assert signal.contact_radius_m[0] == pytest.approx(1.2e-3, abs=0.06e-3)
    true = sphere.normals(x, y)
    assert np.sqrt((angle_deg(signal.normals[0], true)[r < 1.0e-3] ** 2).mean()) < 2.0


def test_the_walls_of_a_leaning_stamp_are_not_followed():
    """A box that leans by four degrees shows its walls in the image: they are no part of what
    touches, however high they go."""
    half, lean = np.array([1.5e-3, 1.5e-3]), np.radians(4.0)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0.0, 1.0)])
    corners = corners * [*half, 4e-3]
    turn = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    vertices = corners @ turn.T - [0, 0, 0.3e-3]
    quads = [(0, 2, 6, 4), (1, 5, 7, 3), (0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    surface = HeightFieldSurface.from_mesh(vertices, triangles, GRID)
    x, _ = pixel_xy(GRID)
    seen = np.isfinite(surface.height_m[0])
    floor = -0.3e-3 - np.tan(lean) * x
    assert seen.sum() > 100
    assert np.abs(surface.height_m[0] - floor)[seen].max() < 1e-6


def test_environments_do_not_mix():
    spheres = [PressedSphere(1.0e-3), PressedSphere(1.6e-3, center_xy_m=(0.5e-3, 0.2e-3))]
    mesh = flat_pad(0.3, PAD_HALF_MM)
    # The third ball hovers over the rest shape.
    positions = np.concatenate([*(shaped(mesh, s.height) for s in spheres), mesh.nodes_m[None]])
    centers = np.stack([*(s.center_m for s in spheres), [0.0, 0.0, 2.5e-3]])
    signal = SignalFusedSurface(mesh, GRID)
    pressures = np.zeros((3, mesh.node_count))
    for env, sphere in enumerate(spheres):
        pressures[env] = sphere.pressures(mesh, positions[env : env + 1])[0]
    signal.update(positions, SphereSurface(centers, 2e-3, GRID), pressures)
    together = signal.height_m.copy(), signal.contact_radius_m.copy()
    assert together[1][2] == 0.0 and (together[0][2] == 0.0).all()
    for env in range(3):
        here = slice(env, env + 1)
        signal.update(positions[here], SphereSurface(centers[env], 2e-3, GRID), pressures[here])
        assert np.array_equal(together[0][env], signal.height_m[0])
        assert together[1][env] == signal.contact_radius_m[0]
    assert together[1][1] > together[1][0] + 0.4e-3


def test_bad_input_is_refused():
    mesh = flat_pad(0.4, PAD_HALF_MM)
    surface = SphereSurface(np.zeros(3), 1e-3, GRID)
    for wrong in (np.zeros((1, 3)), np.full((1, mesh.node_count), np.nan)):
        with pytest.raises(InputError, match="pressures_pa"):
            SignalFusedSurface(mesh, GRID).update(mesh.nodes_m[None], surface, wrong)
    nothing = np.zeros((3, mesh.node_count))
    positions = mesh.nodes_m[None].repeat(3, axis=0)
    positions[1, mesh.region_nodes(Region.CONTACT)[4], 2] = np.nan
    with pytest.raises(InputError, match=r"NaN.*\[1\]"):
        SignalFusedSurface(mesh, GRID).update(positions, surface, nothing)
    with pytest.raises(InputError, match="shape"):
        SignalFusedSurface(mesh, GRID).update(mesh.nodes_m[None, :-1], surface, nothing[:1])
    flipped = mesh.nodes_m[None] * [-1.0, 1.0, 1.0]
    with pytest.raises(InputError, match=r"environment 0.*folded"):
        SignalFusedSurface(mesh, GRID).update(flipped, surface, nothing[:1])
    bare = TetMesh(mesh.nodes_m, mesh.tets, mesh.faces, np.full(len(mesh.faces), int(Region.SIDE)))
    with pytest.raises(InputError, match="CONTACT"):
        SignalFusedSurface(bare, GRID)
    with pytest.raises(InputError, match="radius_m"):
        SphereSurface(np.zeros(3), 0.0, GRID)
    with pytest.raises(InputError, match="center_m"):
        SphereSurface(np.array([0, 0, np.nan]), 1e-3, GRID)
    with pytest.raises(InputError, match="vertices_m"):
        HeightFieldSurface.from_mesh(np.full((3, 3), np.nan), np.array([[0, 1, 2]]), GRID)


def test_normals_from_height_are_exact_on_planes_up_to_nan_borders():
    x, y = pixel_xy(GRID)
    height = 0.3 * x - 0.7 * y
    height[40:60, 50:90] = np.nan
    normals = normals_from_height(height, GRID)
    expected = np.array([-0.3, 0.7, 1.0]) / np.sqrt(1 + 0.3**2 + 0.7**2)
    valid = np.isfinite(height)
    assert np.abs(normals[valid] - expected).max() < 1e-10
    assert np.isnan(normals[~valid]).all()
    with pytest.raises(InputError, match="pixel grid"):
        normals_from_height(height[:-1], GRID)


def _icosphere(levels: int) -> tuple[np.ndarray, np.ndarray]:
    """A unit sphere by subdividing an octahedron, outward faces."""
    vertices = np.array(
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float
    )
    triangles = np.array(
        [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    )
    for _ in range(levels):
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        middle = index.reshape(-1, 3) + len(vertices)
        points = vertices[unique].sum(axis=1)
        vertices = np.concatenate([vertices, points / np.linalg.norm(points, axis=1)[:, None]])
        a, b, c = triangles.T
        ab, bc, ca = middle.T
        triangles = np.concatenate(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    return vertices, triangles
