# SPDX-License-Identifier: Apache-2.0
"""Device signals of many environments against the one-image classes, and what they cost."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, Region, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.profile import BackgroundBlock, ColorBlock
from taccel_lab.signals import MarkerLayout, SignalTactile
from tests.signals.pressed_surface import flat_pad
from tests.signals.tactile_cases import (
    ALL,
    DEVICES,
    ENV_COUNT,
    GRID,
    LEVELS,
    MARKERS_MM,
    PAD_HALF_MM,
    assert_agrees,
    background,
    color_model,
    make,
    on_device,
    presses,
    reference,
)
from tests.support.sample_blocks import ASSUMED, bare_profile


def fold(mesh: TetMesh, positions: np.ndarray, env: int) -> np.ndarray:
    """Move the node in the middle of one environment's face past its neighbours."""
    top = mesh.region_nodes(Region.CONTACT)
    near = top[np.argmin(np.linalg.norm(mesh.nodes_m[top], axis=1))]
    positions[env, near] += [0.7e-3, 0.0, 0.0]
    return positions


@pytest.mark.parametrize("device", DEVICES)
def test_every_environment_equals_the_reference(device):
    grid = PixelGrid(96, 72, 0.05, 0.05, 47.37, 35.81)
    mesh = flat_pad(0.3, PAD_HALF_MM, seed=2)
    positions = presses(mesh)
    signal = make(mesh, device, grid)
    signal.update(on_device(positions, device))
    expected = reference(mesh, positions, grid)
    assert np.abs(expected["rgb_levels"][1] - background(grid)).max() > 20
    assert_agrees(signal, expected, device)
    assert signal.rasterized_count() == 0
    assert np.array_equal(signal.rgb_levels.numpy()[0], background(grid)), "untouched"


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


def test_signals_that_are_not_read_take_no_memory():
    mesh = flat_pad(0.4, PAD_HALF_MM)
    signal = make(mesh)
    signal.update(on_device(presses(mesh), "cpu"))
    signal.read("markers_px")
    assert signal._surface.made is None and signal._painter is None
    signal.read("height_m")
    surface = signal._surface.made
    assert signal._painter is None
    signal.read("rgb")
    assert signal._surface.made is surface, "still there from the height map"


@pytest.mark.parametrize("device", DEVICES)
def test_torch_shares_the_memory(device):
    import torch

    mesh = flat_pad(0.4, PAD_HALF_MM)
    signal = make(mesh, device)
    positions = presses(mesh)
    signal.update(on_device(positions, device))
    rgb, markers = wp.to_torch(signal.rgb), wp.to_torch(signal.markers_px)
    again = torch.from_dlpack(signal.rgb)
    assert rgb.dtype is torch.uint8 and rgb.shape == (ENV_COUNT, 72, 96, 3)
    assert markers.shape == (ENV_COUNT, 3, 2)
    assert rgb.data_ptr() == again.data_ptr() == signal.rgb.ptr
    assert markers.data_ptr() == signal.markers_px.ptr
    before = rgb.clone()
    signal.update(on_device(positions[::-1], device))
    signal.read("rgb", "markers_px")
    assert torch.equal(rgb, before.flip(0)) and not torch.equal(rgb, before)


@pytest.mark.parametrize("device", DEVICES)
def test_a_gel_may_be_anywhere_among_the_nodes_and_in_the_world(device):
    mesh = flat_pad(0.3, PAD_HALF_MM, seed=2)
    positions = presses(mesh)
    plain = make(mesh, device)
    plain.update(on_device(positions, device))
    rng = np.random.default_rng(0)
    poses = np.concatenate(
        [rng.normal(0, 0.1, (ENV_COUNT, 3)), rng.normal(0, 1, (ENV_COUNT, 4))], 1
    )
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    world = np.zeros((ENV_COUNT, mesh.node_count + 9, 3))
    for env, pose in enumerate(poses):
        vector, scalar = pose[3:6], pose[6]
        once = 2 * np.cross(vector, positions[env])
        world[env, 7:-2] = positions[env] + scalar * once + np.cross(vector, once) + pose[:3]
    both = np.stack([poses[::-1], poses], axis=1)
    frames = wp.array(both, dtype=wp.transformd, device=device)[:, 1]
    moved = make(mesh, device, first_node=7)
    moved.update(on_device(world, device), frames)
    names = ("height_m", "normals", "rgb_levels", "markers_px")
    bounds = (1e-9, 1e-5, 0.01 + LEVELS[device], 1e-4)
    for here, there, bound in zip(plain.read(*names), moved.read(*names), bounds, strict=True):
        assert np.nanmax(np.abs(here.numpy() - there.numpy())) < bound


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("chunk_images", [1, 2, ENV_COUNT])
def test_some_environments_look_as_among_all(device, chunk_images):
    """Whole or chunk by chunk, in the world or in the gel frame; a row for each that is shown."""
    mesh = flat_pad(0.4, PAD_HALF_MM)
    positions = on_device(presses(mesh), device)
    poses = np.zeros((ENV_COUNT, 7))
    poses[:, 2] = 1e-4 * np.arange(ENV_COUNT)
    poses[:, 6] = 1.0
    frames = wp.array(poses, dtype=wp.transformd, device=device)
    chunk = chunk_images * (GRID.width_px * GRID.height_px + 8 * len(mesh.faces))
    signal = make(mesh, device, chunk_pixels=chunk)
    for shown in (None, frames):
        signal.update(positions, shown)
        expected = [array.numpy().copy() for array in signal.read(*ALL)]
        for chosen in ([4], [0, 2, 3], [1, 4], []):
            who = np.isin(np.arange(ENV_COUNT), chosen)
            signal.update(positions, shown, who)
            for array, all_of_it in zip(signal.read(*ALL), expected, strict=True):
                assert array.shape[0] == len(chosen)
                np.testing.assert_array_equal(array.numpy(), all_of_it[who])
    signal.update(positions)
    np.testing.assert_array_equal(signal.markers_px.numpy()[:, 0].shape, (ENV_COUNT, 2))
    with pytest.raises(InputError, match=r"a mask is bool of shape \[5\]"):
        signal.update(positions, None, np.array([0, 3]))
    with pytest.raises(InputError, match="a mask of numpy, not the device's"):
        signal.update(positions, None, wp.zeros(ENV_COUNT, dtype=wp.bool, device=device))


def test_a_profile_says_all_but_the_markers():
    mesh = flat_pad(0.4, PAD_HALF_MM)
    model = color_model(GRID)
    profile = bare_profile(mesh, GRID, "one")
    positions = on_device(presses(mesh), "cpu")
    bare = SignalTactile.from_profile(profile, env_count=ENV_COUNT)
    bare.update(positions)
    with pytest.raises(InputError, match="color_model"):
        _ = bare.rgb
    profile = profile.with_block(BackgroundBlock(provenance=ASSUMED), background(GRID))
    block = ColorBlock(architecture=model.config.to_dict(), provenance=ASSUMED)
    profile = profile.with_block(block, model.weights)
    full = SignalTactile.from_profile(
        profile, env_count=ENV_COUNT, markers=MarkerLayout.from_points(mesh, MARKERS_MM)
    )
    direct = make(mesh)
    for signal in (full, direct):
        signal.update(positions)
    for one, other in zip(full.read(*ALL), direct.read(*ALL), strict=True):
        assert np.array_equal(one.numpy(), other.numpy())


def test_bad_calls_are_refused():
    mesh = flat_pad(0.4, PAD_HALF_MM)
    signal = SignalTactile(mesh, GRID, env_count=2)
    with pytest.raises(RuntimeError, match="update"):
        _ = signal.height_m
    nodes = mesh.nodes_m[None].repeat(2, axis=0)
    positions = on_device(nodes, "cpu")
    for given, message in (
        ([on_device(nodes[:1], "cpu")], "2 environments"),
        ([on_device(nodes[:, :-1], "cpu")], "nodes are needed"),
        ([wp.array(nodes, dtype=wp.vec3f, device="cpu")], "vec3d"),
        ([positions, wp.zeros(3, dtype=wp.transformd, device="cpu")], "transformd"),
    ):
        with pytest.raises(InputError, match=message):
            signal.update(*given)
    signal.update(positions)
    for name, message in (
        ("rgb", "color_model"),
        ("markers_px", "markers"),
        ("depth", "no signal 'depth'"),
    ):
        with pytest.raises(InputError, match=message):
            signal.read(name)
    for changes, message in (({"background_rgb": None}, "together"), ({"env_count": 0}, "env_co")):
        with pytest.raises(InputError, match=message):
            make(mesh, **changes)
    for model, message in (
        (color_model(PixelGrid(50, 72, 0.05, 0.05)), "background has shape"),
        (color_model(GRID, hidden=(129,)), "at most 128"),
    ):
        wrong = make(mesh, color_model=model)
        wrong.update(on_device(presses(mesh), "cpu"))
        with pytest.raises(InputError, match=message):
            wrong.read("rgb")


def folded() -> tuple[TetMesh, np.ndarray]:
    """The third environment, which alone is rasterised."""
    mesh = flat_pad(0.3, PAD_HALF_MM, seed=2)
    return mesh, fold(mesh, presses(mesh), 2)


def folded_and_small() -> tuple[TetMesh, np.ndarray]:
    """Pixels beside the pad, too."""
    mesh = flat_pad(0.3, (2.0, 1.3), seed=2)
    return mesh, fold(mesh, presses(mesh), 4)


def with_a_hole_and_a_notch() -> tuple[TetMesh, np.ndarray]:
    mesh = flat_pad(0.3, (2.0, 1.3), seed=2)
    center = mesh.nodes_m[mesh.faces].mean(axis=1)
    hole = (np.abs(center[:, 0] - 0.4e-3) < 0.5e-3) & (np.abs(center[:, 1]) < 0.4e-3)
    notch = (np.abs(center[:, 0] + 1e-3) < 0.3e-3) & (center[:, 1] < 0.2e-3)
    regions = np.where((hole | notch) & (center[:, 2] == 0), int(Region.SIDE), mesh.face_regions)
    mesh = type(mesh)(mesh.nodes_m, mesh.tets, mesh.faces, regions)
    positions = presses(mesh)
    positions[1:, :, 1] *= 1.07
    positions[4, :, :2] += [0.31e-3, -0.17e-3]
    return mesh, positions


def beside(x_mm: float, y_mm: float) -> tuple[TetMesh, np.ndarray]:
    """Straight rims, for whose outside no rasteriser is needed."""
    mesh = block_mesh((11, 8, 2), (4.1e-3, 2.9e-3, 1e-3), jitter=0.2)
    positions = presses(mesh)
    positions[:, :, :2] += np.array([x_mm, y_mm]) * 1e-3
    return mesh, positions


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(
    ("made", "rasterized"),
    [
        (folded, [False, False, True, False, False]),
        (folded_and_small, None),
        (with_a_hole_and_a_notch, None),
        # The sheared one is dented, and a walk may end at the dent.
        *[(partial(beside, *at), [False, False, ..., False, False])
          for at in ((0.0, 0.0), (0.31, -0.17), (-0.9, 0.4))],
    ],
)  # fmt: skip
def test_awkward_faces_equal_the_reference(made, rasterized, device):
    mesh, positions = made()
    signal = make(mesh, device, markers=None)
    signal.update(on_device(positions, device))
    expected = reference(mesh, positions, GRID)
    # Faces squeezed to slivers by the fold.
    assert_agrees(signal, expected, device, normal_bound=1e-4)
    nowhere = np.isnan(expected["height_m"])
    if made is not folded:
        assert nowhere.any(axis=(1, 2)).all() and not nowhere.all(axis=(1, 2)).any()
    if made is folded_and_small:
        unseen = nowhere | nowhere[0]
        shown = np.broadcast_to(background(GRID), (ENV_COUNT, *background(GRID).shape))
        assert np.array_equal(signal.rgb_levels.numpy()[unseen], shown[unseen])
    for found, wanted in zip(signal._surface.made.rasterized, rasterized or (), strict=False):
        assert wanted is ... or bool(found) == wanted
