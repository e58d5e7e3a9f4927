# SPDX-License-Identifier: Apache-2.0
"""The surface through nodes: gradients of least bending, hanging corners, walls and shear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from scipy.optimize import minimize

from taccel_lab.geometry import PixelGrid, QuadraticMesh, Region, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import AffineBody, Element, Material, Scene, SoftBody, TimeStepping, box_mesh
from taccel_lab.signals import ContactFaceMesh, SignalTactile
from taccel_lab.signals.deformed_face import DeformedFace, HangingCorners
from taccel_lab.signals.gradient_recovery import recover_gradients
from tests.signals.pressed_surface import flat_pad, pixel_xy
from tests.support.blocks import pose


def _bending(gradients: np.ndarray, edges: np.ndarray, xy: np.ndarray, f: np.ndarray) -> float:
    """Sum over edges of the integral of f''^2 of the Hermite cubic, by Gauss points."""
    edge = xy[edges[:, 1]] - xy[edges[:, 0]]
    length = np.linalg.norm(edge, axis=1)
    start = (gradients[edges[:, 0]] * edge).sum(axis=1)
    end = (gradients[edges[:, 1]] * edge).sum(axis=1)
    rise = f[edges[:, 1]] - f[edges[:, 0]]
    total = 0.0
    for t in (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)):
        second = rise * (6 - 12 * t) + start * (6 * t - 4) + end * (6 * t - 2)
        total += float((0.5 * second**2 / length**3).sum())
    return total


def test_the_network_of_least_bending_is_found():
    mesh = flat_pad(1.0, (2.5, 2.5), seed=4)
    surface = ContactFaceMesh.from_mesh(mesh)
    # Millimetres, so that the optimiser sees numbers near one.
    points = mesh.nodes_m[surface.node_idx] * 1e3
    values = np.random.default_rng(0).normal(size=len(points))
    device = "cpu"
    gradients = recover_gradients(
        wp.array(points[None], dtype=wp.vec3d, device=device),
        wp.array(values[None], dtype=wp.float64, device=device),
        wp.array(surface.ring_start, dtype=wp.int32, device=device),
        wp.array(surface.ring_nodes, dtype=wp.int32, device=device),
    ).numpy()[0]

    def energy(flat):
        return _bending(flat.reshape(-1, 2), surface.edges, points[:, :2], values)

    best = minimize(energy, np.zeros(2 * len(points)), method="L-BFGS-B", options={"maxfun": 10**6})
    assert energy(gradients.ravel()) <= best.fun * (1 + 1e-9)
    assert np.abs(gradients - best.x.reshape(-1, 2)).max() < 1e-2
    assert np.abs(gradients).max() > 0.5


BLOCK = block_mesh((8, 8, 2), (4e-3, 4e-3, 1e-3), jitter=0.2, seed=1)


def bowl(nodes: np.ndarray) -> np.ndarray:
    """The face pressed by a paraboloid, 0.3 mm deep."""
    x, y = nodes[:, 0], nodes[:, 1]
    down = -3e-4 + 40.0 * x * x + 60.0 * y * y + 20.0 * x * y
    return nodes + np.column_stack([0 * x, 0 * x, down])


def lifted(
    moved_m: np.ndarray, carries: np.ndarray, element: Element, mounted: bool = False
) -> np.ndarray:
    """Nodes after ``lift``, of loads along -z on the nodes that carry."""
    soft = SoftBody(BLOCK, Material(1e5, 0.45), element=element)
    links = []
    if mounted:
        soft = replace(soft, mount="link", mount_pose=pose(0, 0, 1e-2, (1, 0, 0), 90))
        links = [AffineBody(box_mesh((2e-2, 2e-2, 2e-2)), name="link")]
    model = Scene(soft, affine_bodies=links, time=TimeStepping(quasi_static=not mounted)).finalize(
        device="cpu"
    )
    first, last = (int(node) for node in model.bodies[0].nodes)
    gradient, positions = np.zeros((2, 1, model.node_count, 3))
    gradient[0, first:last][carries, 2] = 1e-3
    positions[0, first:last] = moved_m
    moved = wp.array(positions, dtype=wp.vec3d)
    HangingCorners(model, 0).lift(moved, wp.array(gradient, dtype=wp.vec3d))
    return moved.numpy()[0, first:last]


def quadratic() -> QuadraticMesh:
    mesh = SoftBody(BLOCK, Material(1e5, 0.45)).nodal_mesh
    assert isinstance(mesh, QuadraticMesh)
    return mesh


@pytest.mark.parametrize("mounted", [False, True])
def test_only_a_corner_that_hangs_is_moved_and_to_the_paraboloid(mounted):
    mesh = quadratic()
    right = bowl(mesh.nodes_m)
    face = mesh.region_nodes(Region.CONTACT)
    inner = np.abs(mesh.nodes_m[face, :2]).max(axis=1) < 1.6e-3
    hangs, stands = face[inner & (face < mesh.base.node_count)][[3, 10]]
    moved = right.copy()
    moved[hangs, 2] -= 4e-5
    moved[stands, 2] += 4e-5
    carries = np.isin(np.arange(mesh.node_count), face)
    found = lifted(moved, carries, Element.QUADRATIC, mounted)
    assert found[hangs] == pytest.approx(right[hangs], abs=1e-12)
    assert found[stands] == pytest.approx(moved[stands], abs=0)
    # The others hang by rounding at most.
    assert found == pytest.approx(
        np.where(np.arange(len(moved))[:, None] == hangs, right, moved), abs=1e-12
    )


def test_a_corner_at_the_rim_of_the_contact_stays():
    mesh = quadratic()
    moved = bowl(mesh.nodes_m)
    corners = mesh.region_nodes(Region.CONTACT)
    corner = corners[corners < mesh.base.node_count][20]
    moved[corner, 2] -= 4e-5
    right_side = mesh.nodes_m[:, 0] > mesh.nodes_m[corner, 0]
    assert (lifted(moved, right_side, Element.QUADRATIC)[corner] == moved[corner]).all()


def test_environments_with_gels_of_their_own_shape():
    """The same cells, graded otherwise in the second environment."""
    mesh = quadratic()
    graded = np.sign(BLOCK.nodes_m) * np.abs(BLOCK.nodes_m) ** [1.3, 1.2, 1.0]
    graded *= np.abs(BLOCK.nodes_m).max(axis=0) / np.abs(graded).max(axis=0)
    rests = np.stack([BLOCK.nodes_m, graded])
    soft = SoftBody(BLOCK, Material(1e5, 0.45), rest_positions_m=rests)
    model = Scene(soft_bodies=[soft], env_count=2).finalize(device="cpu")
    right = np.stack([bowl(rest) for rest in model.rest_positions.numpy()])
    face = mesh.region_nodes(Region.CONTACT)
    inner = np.abs(mesh.nodes_m[face, :2]).max(axis=1) < 1.6e-3
    hangs = face[inner & (face < mesh.base.node_count)][[3, 10]]
    moved = right.copy()
    moved[:, hangs, 2] -= 4e-5
    carries = np.isin(np.arange(mesh.node_count), face)
    gradient = np.broadcast_to(np.where(carries[:, None], [0.0, 0.0, 1e-3], 0.0), moved.shape)
    positions = wp.array(moved, dtype=wp.vec3d)
    HangingCorners(model, 0).lift(positions, wp.array(gradient.copy(), dtype=wp.vec3d))
    assert positions.numpy() == pytest.approx(right, abs=1e-12)


def test_linear_elements_have_none():
    moved = bowl(BLOCK.nodes_m)
    assert (lifted(moved, np.ones(len(moved), bool), Element.LINEAR) == moved).all()


GRID = PixelGrid(120, 90, 0.05, 0.05)
HALF_MM = (4.2, 3.4)


def _seen(face: DeformedFace, mesh: TetMesh, nodes_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights and slopes of the face with surface nodes at [m]."""
    positions = mesh.nodes_m.copy()
    positions[ContactFaceMesh.from_mesh(mesh).node_idx] = nodes_m
    given = wp.array(positions[None], dtype=wp.vec3d, device="cpu")
    samples = face.sample(given).numpy()[0].astype(np.float64)
    return samples[..., 2], samples[..., :2]


HEIGHT_M = 0.8e-3


def _wall(rest: np.ndarray) -> np.ndarray:
    """Gel with a step at x = 0: what lay within 0.4 mm of it has become a wall ten times as steep
    as the mesh could draw over the image, 20 um thick."""
    x = rest[:, 0]
    along = np.clip(x / 0.4e-3, -1, 1)
    squeezed = np.where(np.abs(x) < 0.4e-3, 10e-6 * along, x - 0.39e-3 * np.sign(x))
    rise = 0.5 * HEIGHT_M * along
    return np.stack([squeezed, rest[:, 1], rise], axis=1)


def test_a_wall_does_not_swing():
    """Over the image its triangles are slivers, on which a height overshoots."""
    mesh = flat_pad(0.2, HALF_MM)
    face = DeformedFace(mesh, GRID)
    nodes = mesh.nodes_m[ContactFaceMesh.from_mesh(mesh).node_idx]
    height, slope = _seen(face, mesh, _wall(nodes))
    x, _ = pixel_xy(GRID)
    clear = np.abs(x) > 0.15e-3
    error = np.abs(height - 0.5 * HEIGHT_M * np.sign(x))[clear]
    assert error.max() < 0.03 * HEIGHT_M
    assert np.degrees(np.arctan(np.abs(slope)))[clear].max() < 20
    positions = mesh.nodes_m.copy()
    positions[ContactFaceMesh.from_mesh(mesh).node_idx] = _wall(nodes)
    plain = SignalTactile(mesh, GRID, env_count=1)
    plain.update(wp.array(positions[None], dtype=wp.vec3d, device="cpu"))
    over_image = np.abs(plain.height_m.numpy()[0] - 0.5 * HEIGHT_M * np.sign(x))[clear]
    assert over_image.max() > 3 * error.max()


def test_slopes_are_those_over_the_image():
    """Of a sheared and tilted face, whose slopes over the places at rest are others."""
    mesh = flat_pad(0.3, HALF_MM)
    face = DeformedFace(mesh, GRID)
    rest = mesh.nodes_m[ContactFaceMesh.from_mesh(mesh).node_idx]
    x = 0.8 * rest[:, 0] + 0.3 * rest[:, 1]
    y = 1.1 * rest[:, 1] - 0.1 * rest[:, 0]
    height, slope = _seen(face, mesh, np.stack([x, y, 0.3 * x - 0.2 * y + 1e-4], axis=1))
    px, py = pixel_xy(GRID)
    seen = np.isfinite(height)
    assert seen.mean() > 0.8
    assert np.abs(height - (0.3 * px - 0.2 * py + 1e-4))[seen].max() < 1e-8
    assert np.abs(slope - [0.3, -0.2])[seen].max() < 1e-4


def test_a_face_that_came_from_elsewhere_is_covered():
    """Slid by 1.5 mm: what the image shows lay beside it at rest."""
    mesh = flat_pad(0.3, (8.0, 8.0))
    face = DeformedFace(mesh, GRID)
    rest = mesh.nodes_m[ContactFaceMesh.from_mesh(mesh).node_idx]
    assert np.isfinite(_seen(face, mesh, rest)[0]).all()
    height, _ = _seen(face, mesh, rest + [1.5e-3, -1.5e-3, 1e-4])
    assert np.allclose(height, 1e-4, rtol=0, atol=1e-9)


def test_each_environment_has_its_own_rest():
    """Two pads whose nodes lie elsewhere at rest, in one batch, sunk by the same."""
    mesh = flat_pad(0.3, HALF_MM)
    rest = np.stack([mesh.nodes_m, mesh.nodes_m * [1.1, 0.9, 1.0]])
    given = wp.array(rest, dtype=wp.vec3d, device="cpu")
    face = DeformedFace(mesh, GRID, env_count=2, rest_positions=given)
    moved = rest.copy()
    moved[:, :, 2] -= 1e-4 * np.exp(-((rest[:, :, :2] / 1e-3) ** 2).sum(axis=2))
    both = face.sample(wp.array(moved, dtype=wp.vec3d, device="cpu")).numpy().copy()
    x, y = pixel_xy(GRID)
    truth = -1e-4 * np.exp(-((x / 1e-3) ** 2) - (y / 1e-3) ** 2)
    for samples in both:
        assert np.nanmax(np.abs(samples[..., 2] - truth)) < 3e-6
    envs = wp.array([1], dtype=wp.int32, device="cpu")
    alone = face.sample(wp.array(moved, dtype=wp.vec3d, device="cpu"), None, envs).numpy()
    np.testing.assert_array_equal(alone[0], both[1])
