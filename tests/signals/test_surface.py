# SPDX-License-Identifier: Apache-2.0
"""The surface through nodes: gradients of least bending, hanging corners, walls and shear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from scipy.optimize import minimize

from taccel_lab.geometry import PixelGrid, Region, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import AffineBody, Element, Material, Scene, SoftBody, TimeStepping, box_mesh
from taccel_lab.signals import ContactFaceMesh, SignalTactile
from taccel_lab.signals.deformed_face import DeformedFace, HangingCorners
from taccel_lab.signals.gradient_recovery import recover_gradients
from tests.signals.pressed_surface import flat_pad, pixel_xy
from tests.signals.tactile_cases import on_device
from tests.support.blocks import pose


def test_the_network_of_least_bending_is_found():
    mesh = flat_pad(1.0, (2.5, 2.5), seed=4)
    surface = ContactFaceMesh.from_mesh(mesh)
    # Millimetres, so that the optimiser sees numbers near one.
    points = mesh.nodes_m[surface.node_idx] * 1e3
    values = np.random.default_rng(0).normal(size=len(points))
    rings = (wp.array(ring, dtype=wp.int32) for ring in (surface.ring_start, surface.ring_nodes))
    heights = wp.array(values[None], dtype=wp.float64)
    gradients = recover_gradients(on_device(points[None]), heights, *rings).numpy()[0]

    first, second = surface.edges.T
    edge, rise = points[second, :2] - points[first, :2], values[second] - values[first]
    cubed = (edge**2).sum(axis=1) ** 1.5

    def energy(flat):
        """Sum over edges of the integral of f''^2 of the Hermite cubic, by Gauss points."""
        start, end = ((flat.reshape(-1, 2)[k] * edge).sum(axis=1) for k in (first, second))
        bent = (
            rise * (6 - 12 * t) + start * (6 * t - 4) + end * (6 * t - 2)
            for t in (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12))
        )
        return sum(float((0.5 * each**2 / cubed).sum()) for each in bent)

    best = minimize(energy, np.zeros(2 * len(points)), method="L-BFGS-B", options={"maxfun": 10**6})
    assert energy(gradients.ravel()) <= best.fun * (1 + 1e-9)
    assert np.abs(gradients - best.x.reshape(-1, 2)).max() < 1e-2
    assert np.abs(gradients).max() > 0.5


BLOCK = block_mesh((8, 8, 2), (4e-3, 4e-3, 1e-3), jitter=0.2, seed=1)
SOFT = SoftBody(BLOCK, Material(1e5, 0.45))
MESH = SOFT.nodal_mesh
FACE = MESH.region_nodes(Region.CONTACT)
ON_FACE = np.isin(np.arange(MESH.node_count), FACE)
CORNERS = FACE[FACE < BLOCK.node_count]
HANGS, STANDS = CORNERS[np.abs(MESH.nodes_m[CORNERS, :2]).max(axis=1) < 1.6e-3][[3, 10]]


def bowl(nodes: np.ndarray) -> np.ndarray:
    """The face pressed by a paraboloid, 0.3 mm deep."""
    x, y = nodes[..., 0], nodes[..., 1]
    down = -3e-4 + 40.0 * x * x + 60.0 * y * y + 20.0 * x * y
    return nodes + down[..., None] * [0, 0, 1]


def lifted(moved_m: np.ndarray, carries: np.ndarray, soft: SoftBody = SOFT) -> np.ndarray:
    """Nodes [env, node, 3] after ``lift``, of loads along -z on the nodes that carry."""
    mounted = soft.mount is not None
    links = [AffineBody(box_mesh((2e-2, 2e-2, 2e-2)), name="link")] * mounted
    time = TimeStepping(quasi_static=not mounted)
    scene = Scene(soft, affine_bodies=links, time=time, env_count=len(moved_m))
    model = scene.finalize(device="cpu")
    first, last = (int(node) for node in model.bodies[0].nodes)
    gradient, positions = np.zeros((2, len(moved_m), model.node_count, 3))
    gradient[:, first:last][:, carries, 2] = 1e-3
    positions[:, first:last] = moved_m
    moved = on_device(positions)
    HangingCorners(model, 0).lift(moved, on_device(gradient))
    return moved.numpy()[:, first:last]


MOUNTED = replace(SOFT, mount="link", mount_pose=pose(0, 0, 1e-2, (1, 0, 0), 90))


@pytest.mark.parametrize("soft", [SOFT, MOUNTED], ids=["free", "mounted"])
def test_only_a_corner_that_hangs_is_moved_and_to_the_paraboloid(soft):
    right = bowl(MESH.nodes_m)
    moved = right.copy()
    moved[[HANGS, STANDS], 2] += [-4e-5, 4e-5]
    (found,) = lifted(moved[None], ON_FACE, soft)
    assert (found[STANDS] == moved[STANDS]).all()
    # The others hang by rounding at most.
    moved[HANGS] = right[HANGS]
    assert found == pytest.approx(moved, abs=1e-12)


def test_a_corner_at_the_rim_of_the_contact_stays_and_linear_elements_have_none():
    moved, corner = bowl(MESH.nodes_m), CORNERS[20]
    moved[corner, 2] -= 4e-5
    right_side = MESH.nodes_m[:, 0] > MESH.nodes_m[corner, 0]
    assert (lifted(moved[None], right_side)[0, corner] == moved[corner]).all()
    moved, linear = bowl(BLOCK.nodes_m), replace(SOFT, element=Element.LINEAR)
    assert (lifted(moved[None], np.ones(len(moved), bool), linear) == moved).all()


def test_environments_with_gels_of_their_own_shape():
    """The same cells, graded otherwise in the second environment."""
    graded = np.sign(BLOCK.nodes_m) * np.abs(BLOCK.nodes_m) ** [1.3, 1.2, 1.0]
    graded *= np.abs(BLOCK.nodes_m).max(axis=0) / np.abs(graded).max(axis=0)
    soft = replace(SOFT, rest_positions_m=np.stack([BLOCK.nodes_m, graded]))
    model = Scene(soft_bodies=[soft], env_count=2).finalize(device="cpu")
    right = bowl(model.rest_positions.numpy())
    moved = right.copy()
    moved[:, [HANGS, STANDS], 2] -= 4e-5
    assert lifted(moved, ON_FACE, soft) == pytest.approx(right, abs=1e-12)


GRID = PixelGrid(120, 90, 0.05, 0.05)
X, Y = pixel_xy(GRID)
HALF_MM = (4.2, 3.4)


def nodes_of(mesh: TetMesh) -> np.ndarray:
    return mesh.nodes_m[ContactFaceMesh.from_mesh(mesh).node_idx]


def with_face(mesh: TetMesh, nodes_m: np.ndarray) -> wp.array:
    """Positions with surface nodes at [m]."""
    positions = mesh.nodes_m.copy()
    positions[ContactFaceMesh.from_mesh(mesh).node_idx] = nodes_m
    return on_device(positions[None])


def seen(mesh: TetMesh, nodes_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights and slopes of the face with surface nodes at [m]."""
    samples = DeformedFace(mesh, GRID).sample(with_face(mesh, nodes_m)).numpy()[0]
    return samples[..., 2].astype(np.float64), samples[..., :2].astype(np.float64)


def test_a_wall_does_not_swing():
    """Gel with a step of 0.8 mm at x = 0: what lay within 0.4 mm of it has become a wall ten times
    as steep as the mesh could draw over the image, where its triangles are slivers on which a
    height overshoots."""
    mesh, step = flat_pad(0.2, HALF_MM), 0.8e-3
    x, y, _ = nodes_of(mesh).T
    along = np.clip(x / 0.4e-3, -1, 1)
    squeezed = np.where(np.abs(x) < 0.4e-3, 10e-6 * along, x - 0.39e-3 * np.sign(x))
    wall = np.stack([squeezed, y, 0.5 * step * along], axis=1)
    height, slope = seen(mesh, wall)
    clear, truth = np.abs(X) > 0.15e-3, 0.5 * step * np.sign(X)
    error = np.abs(height - truth)[clear].max()
    assert error < 0.03 * step
    assert np.degrees(np.arctan(np.abs(slope)))[clear].max() < 20
    plain = SignalTactile(mesh, GRID, env_count=1)
    plain.update(with_face(mesh, wall))
    assert np.abs(plain.height_m.numpy()[0] - truth)[clear].max() > 3 * error


def test_slopes_are_those_over_the_image():
    """Of a sheared and tilted face, whose slopes over the places at rest are others."""
    mesh = flat_pad(0.3, HALF_MM)
    rest = nodes_of(mesh)
    x = 0.8 * rest[:, 0] + 0.3 * rest[:, 1]
    y = 1.1 * rest[:, 1] - 0.1 * rest[:, 0]
    height, slope = seen(mesh, np.stack([x, y, 0.3 * x - 0.2 * y + 1e-4], axis=1))
    covered = np.isfinite(height)
    assert covered.mean() > 0.8
    assert np.abs(height - (0.3 * X - 0.2 * Y + 1e-4))[covered].max() < 1e-8
    assert np.abs(slope - [0.3, -0.2])[covered].max() < 1e-4
    # Slid by 1.5 mm: what the image shows lay beside it at rest.
    mesh = flat_pad(0.3, (8.0, 8.0))
    rest = nodes_of(mesh)
    assert np.isfinite(seen(mesh, rest)[0]).all()
    height, _ = seen(mesh, rest + [1.5e-3, -1.5e-3, 1e-4])
    assert np.allclose(height, 1e-4, rtol=0, atol=1e-9)


def test_each_environment_has_its_own_rest():
    """Two pads whose nodes lie elsewhere at rest, in one batch, sunk by the same."""
    mesh = flat_pad(0.3, HALF_MM)
    rest = np.stack([mesh.nodes_m, mesh.nodes_m * [1.1, 0.9, 1.0]])
    face = DeformedFace(mesh, GRID, env_count=2, rest_positions=on_device(rest))
    moved = rest.copy()
    moved[:, :, 2] -= 1e-4 * np.exp(-((rest[:, :, :2] / 1e-3) ** 2).sum(axis=2))
    both = face.sample(on_device(moved)).numpy().copy()
    truth = -1e-4 * np.exp(-((X / 1e-3) ** 2) - (Y / 1e-3) ** 2)
    assert np.nanmax(np.abs(both[..., 2] - truth)) < 3e-6
    envs = wp.array([1], dtype=wp.int32, device="cpu")
    alone = face.sample(on_device(moved), None, envs).numpy()
    np.testing.assert_array_equal(alone[0], both[1])
