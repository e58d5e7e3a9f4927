# SPDX-License-Identifier: Apache-2.0
"""Device signals of many environments against the one-image classes."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, Region, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.signals import SignalTactile, SurfaceMode
from tests.signals.pressed_surface import extrude, flat_pad
from tests.signals.tactile_cases import (
    ALL,
    DEVICES,
    ENV_COUNT,
    GRID,
    PAD_HALF_MM,
    assert_agrees,
    background,
    make,
    on_device,
    presses,
    reference,
)


def fold(mesh: TetMesh, positions: np.ndarray, env: int) -> np.ndarray:
    """Move the node in the middle of one environment's face past its neighbours."""
    top = mesh.region_nodes(Region.CONTACT)
    near = top[np.argmin(np.linalg.norm(mesh.nodes_m[top], axis=1))]
    positions[env, near] += [0.7e-3, 0.0, 0.0]
    return positions


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("mode", SurfaceMode)
def test_every_environment_equals_the_reference(device, mode):
    # A quarter pixel off the nodes: on an edge of facets both their slopes are right.
    grid = PixelGrid(96, 72, 0.05, 0.05, 47.37, 35.81)
    mesh = flat_pad(0.3, PAD_HALF_MM, seed=2)
    positions = presses(mesh)
    signal = make(mesh, device, grid, mode=mode)
    signal.update(on_device(positions, device))
    expected = reference(mesh, positions, grid, mode)
    assert np.abs(expected["rgb_levels"][1] - background(grid)).max() > 20
    assert_agrees(signal, expected, device)
    assert signal.rasterized_count() == 0
    assert np.array_equal(signal.rgb_levels.numpy()[0], background(grid)), "untouched"


@pytest.mark.parametrize("device", DEVICES)
def test_folded_faces_and_pixels_beside_the_pad_are_rasterized(device):
    mesh = flat_pad(0.3, (2.0, 1.3), seed=2)
    positions = fold(mesh, presses(mesh), 4)
    signal = make(mesh, device)
    signal.update(on_device(positions, device))
    expected = reference(mesh, positions, GRID, SurfaceMode.SMOOTH)
    beside = np.isnan(expected["height_m"])
    assert beside.any(axis=(1, 2)).all() and not beside.all(axis=(1, 2)).any()
    # Faces squeezed to slivers by the fold.
    assert_agrees(signal, expected, device, normal_bound=1e-4)
    unseen = beside | beside[0]
    shown = np.broadcast_to(background(GRID), (ENV_COUNT, *background(GRID).shape))
    assert np.array_equal(signal.rgb_levels.numpy()[unseen], shown[unseen])


@pytest.mark.parametrize("device", DEVICES)
def test_outlines_may_be_concave_and_have_holes(device):
    mesh = flat_pad(0.3, (2.0, 1.3), seed=2)
    center = mesh.nodes_m[mesh.faces].mean(axis=1)
    hole = (np.abs(center[:, 0] - 0.4e-3) < 0.5e-3) & (np.abs(center[:, 1]) < 0.4e-3)
    notch = (np.abs(center[:, 0] + 1e-3) < 0.3e-3) & (center[:, 1] < 0.2e-3)
    regions = np.where((hole | notch) & (center[:, 2] == 0), int(Region.SIDE), mesh.face_regions)
    mesh = type(mesh)(mesh.nodes_m, mesh.tets, mesh.faces, regions)
    positions = presses(mesh)
    positions[1:, :, 1] *= 1.07
    positions[4, :, :2] += [0.31e-3, -0.17e-3]
    signal = make(mesh, device, markers=None)
    signal.update(on_device(positions, device))
    expected = reference(mesh, positions, GRID, SurfaceMode.SMOOTH)
    assert 0.2 < np.isnan(expected["height_m"]).mean() < 0.8
    assert_agrees(signal, expected, device, normal_bound=1e-4)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("shift_mm", [(0.0, 0.0), (0.31, -0.17), (-0.9, 0.4)])
def test_pixels_beside_a_pad_need_no_rasterizer(device, shift_mm):
    mesh = block_mesh((11, 8, 2), (4.1e-3, 2.9e-3, 1e-3), jitter=0.2)
    positions = presses(mesh)
    positions[:, :, :2] += np.array(shift_mm) * 1e-3
    signal = make(mesh, device)
    signal.update(on_device(positions, device))
    expected = reference(mesh, positions, GRID, SurfaceMode.SMOOTH)
    assert np.isnan(expected["height_m"]).any(axis=(1, 2)).all()
    assert_agrees(signal, expected, device, normal_bound=1e-4)
    # Straight rims; the sheared one is dented, and a walk may end at the dent.
    assert not signal._surface.made.rasterized[[0, 1, 3, 4]].any()


@pytest.mark.parametrize("device", DEVICES)
def test_only_folded_environments_are_rasterized(device):
    mesh = flat_pad(0.3, PAD_HALF_MM, seed=2)
    positions = presses(mesh)
    fold(mesh, positions, 2)
    signal = make(mesh, device)
    signal.update(on_device(positions, device))
    expected = reference(mesh, positions, GRID, SurfaceMode.SMOOTH)
    assert_agrees(signal, expected, device, normal_bound=1e-4)
    assert signal._surface.made.rasterized.tolist() == [False, False, True, False, False]


@pytest.mark.parametrize("device", DEVICES)
def test_of_two_layers_the_camera_sees_the_lower_one(device):
    xy = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 3e-3
    xy = np.concatenate([xy, xy])
    mesh = extrude(xy, np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]))
    positions = mesh.nodes_m[None].repeat(2, axis=0)
    positions[0, 4:8, 2] = 5e-4
    positions[1, :4, 2] = 5e-4
    signal = SignalTactile(mesh, GRID, env_count=2, device=device)
    signal.update(on_device(positions, device))
    assert (signal.height_m.numpy() == 0).all()


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("chunk_envs", [1, 2, 4])
def test_chunks_and_neighbours_change_nothing(device, chunk_envs):
    mesh = flat_pad(0.3, (2.0, 2.4), seed=6)
    positions = presses(mesh)
    together = make(mesh, device)
    together.update(on_device(positions, device))
    pixels = GRID.width_px * GRID.height_px + 8 * len(mesh.region_faces(Region.CONTACT))
    chunked = make(mesh, device, chunk_pixels=chunk_envs * pixels)
    assert chunked.chunk_envs == chunk_envs < together.chunk_envs == ENV_COUNT
    order = [3, 1, 4, 0, 2]
    chunked.update(on_device(positions[order], device))
    for whole, parts in zip(together.read(*ALL), chunked.read(*ALL), strict=True):
        assert np.array_equal(whole.numpy()[order], parts.numpy(), equal_nan=True)


@pytest.mark.parametrize("device", DEVICES)
def test_nan_stays_in_its_environment(device):
    mesh = flat_pad(0.3, PAD_HALF_MM, seed=2)
    positions = presses(mesh)
    sane = make(mesh, device)
    sane.update(on_device(positions, device))
    positions[1] = np.nan
    ill = make(mesh, device)
    ill.update(on_device(positions, device))
    others = [0, 2, 3, 4]
    for good, found in zip(sane.read(*ALL), ill.read(*ALL), strict=True):
        assert np.array_equal(good.numpy()[others], found.numpy()[others], equal_nan=True)
    assert np.isnan(ill.height_m.numpy()[1]).all()
    assert np.isnan(ill.markers_px.numpy()[1]).all()
    assert np.array_equal(ill.rgb_levels.numpy()[1], background(GRID))


@pytest.mark.parametrize("device", DEVICES)
def test_pixels_that_hardly_change_may_be_left_alone(device):
    mesh = flat_pad(0.3, PAD_HALF_MM, seed=2)
    positions = presses(mesh)
    exact, lazy = make(mesh, device), make(mesh, device, still_levels=0.5)
    for signal in (exact, lazy):
        signal.update(on_device(positions, device))
    every, some = exact.rgb_levels.numpy(), lazy.rgb_levels.numpy()
    left = (some == background(GRID)).all(axis=-1) & (every != background(GRID)).any(axis=-1)
    assert 0.02 < left[1:].mean() < 0.9 and not left[0].any()
    assert 0.1 < np.abs(every - some)[left].max() < 0.6
    assert np.array_equal(every[~left], some[~left])
    with pytest.raises(InputError, match="still_levels"):
        bad = make(mesh, device, still_levels=-1.0)
        bad.update(on_device(positions, device))
        bad.read("rgb")
