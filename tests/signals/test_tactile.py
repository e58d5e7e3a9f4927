# SPDX-License-Identifier: Apache-2.0
"""Device signals of many environments against the one-image classes, and what they cost."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import torch
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

FINE, COARSE = flat_pad(0.3, PAD_HALF_MM, seed=2), flat_pad(0.4, PAD_HALF_MM)
pytestmark = pytest.mark.parametrize("device", DEVICES)


def shown(mesh: TetMesh, device: str, positions: np.ndarray, **changes) -> SignalTactile:
    signal = make(mesh, device, **changes)
    signal.update(on_device(positions, device))
    return signal


def test_every_environment_equals_the_reference(device):
    grid = PixelGrid(96, 72, 0.05, 0.05, 47.37, 35.81)
    positions = presses(FINE)
    signal, expected = shown(FINE, device, positions, grid=grid), reference(FINE, positions, grid)
    assert np.abs(expected["rgb_levels"][1] - background(grid)).max() > 20
    assert_agrees(signal, expected, device)
    assert signal.rasterized_count() == 0
    assert np.array_equal(signal.rgb_levels.numpy()[0], background(grid)), "untouched"


@pytest.mark.parametrize("chunk_envs", [1, 2, 4])
def test_chunks_and_neighbours_change_nothing(device, chunk_envs):
    mesh = flat_pad(0.3, (2.0, 2.4), seed=6)
    positions, order = presses(mesh), [3, 1, 4, 0, 2]
    together = shown(mesh, device, positions)
    pixels = GRID.width_px * GRID.height_px + 8 * len(mesh.region_faces(Region.CONTACT))
    chunked = shown(mesh, device, positions[order], chunk_pixels=chunk_envs * pixels)
    assert chunked.chunk_envs == chunk_envs < together.chunk_envs == ENV_COUNT
    for whole, parts in zip(together.read(*ALL), chunked.read(*ALL), strict=True):
        assert np.array_equal(whole.numpy()[order], parts.numpy(), equal_nan=True)


def test_nan_stays_in_its_environment(device):
    positions, others = presses(FINE), [0, 2, 3, 4]
    sane = shown(FINE, device, positions)
    positions[1] = np.nan
    ill = shown(FINE, device, positions)
    for good, found in zip(sane.read(*ALL), ill.read(*ALL), strict=True):
        assert np.array_equal(good.numpy()[others], found.numpy()[others], equal_nan=True)
    assert np.isnan(ill.height_m.numpy()[1]).all() and np.isnan(ill.markers_px.numpy()[1]).all()
    assert np.array_equal(ill.rgb_levels.numpy()[1], background(GRID))


def test_pixels_that_hardly_change_may_be_left_alone(device):
    positions = presses(FINE)
    every, some = (
        shown(FINE, device, positions, **options).rgb_levels.numpy()
        for options in ({}, {"still_levels": 0.5})
    )
    left = (some == background(GRID)).all(axis=-1) & (every != background(GRID)).any(axis=-1)
    assert 0.02 < left[1:].mean() < 0.9 and not left[0].any()
    assert 0.1 < np.abs(every - some)[left].max() < 0.6
    assert np.array_equal(every[~left], some[~left])
    with pytest.raises(InputError, match="still_levels"):
        shown(FINE, device, positions, still_levels=-1.0).read("rgb")


def test_signals_that_are_not_read_take_no_memory(device):
    signal = shown(COARSE, device, presses(COARSE))
    signal.read("markers_px")
    assert signal._surface.made is None and signal._painter is None
    signal.read("height_m")
    surface = signal._surface.made
    assert signal._painter is None
    signal.read("rgb")
    assert signal._surface.made is surface, "still there from the height map"


def test_torch_shares_the_memory(device):
    positions = presses(COARSE)
    signal = shown(COARSE, device, positions)
    rgb, markers = wp.to_torch(signal.rgb), wp.to_torch(signal.markers_px)
    assert rgb.dtype is torch.uint8 and rgb.shape == (ENV_COUNT, 72, 96, 3)
    assert markers.shape == (ENV_COUNT, 3, 2)
    assert rgb.data_ptr() == torch.from_dlpack(signal.rgb).data_ptr() == signal.rgb.ptr
    assert markers.data_ptr() == signal.markers_px.ptr
    before = rgb.clone()
    signal.update(on_device(positions[::-1], device))
    signal.read("rgb", "markers_px")
    assert torch.equal(rgb, before.flip(0)) and not torch.equal(rgb, before)


def test_a_gel_may_be_anywhere_among_the_nodes_and_in_the_world(device):
    positions, rng = presses(FINE), np.random.default_rng(0)
    plain = shown(FINE, device, positions)
    at, turn = rng.normal(0, 0.1, (ENV_COUNT, 1, 3)), rng.normal(0, 1, (ENV_COUNT, 1, 4))
    turn /= np.linalg.norm(turn, axis=-1, keepdims=True)
    world = np.zeros((ENV_COUNT, FINE.node_count + 9, 3))
    once = 2 * np.cross(turn[..., :3], positions)
    world[:, 7:-2] = positions + turn[..., 3:] * once + np.cross(turn[..., :3], once) + at
    poses = np.concatenate([at, turn], axis=-1)
    both = np.concatenate([poses[::-1], poses], axis=1)
    frames = wp.array(both, dtype=wp.transformd, device=device)[:, 1]
    moved = make(FINE, device, first_node=7)
    moved.update(on_device(world, device), frames)
    names = ("height_m", "normals", "rgb_levels", "markers_px")
    bounds = (1e-9, 1e-5, 0.01 + LEVELS[device], 1e-4)
    for here, there, bound in zip(plain.read(*names), moved.read(*names), bounds, strict=True):
        assert np.nanmax(np.abs(here.numpy() - there.numpy())) < bound


@pytest.mark.parametrize("chunk_images", [1, 2, ENV_COUNT])
def test_some_environments_look_as_among_all(device, chunk_images):
    """Whole or chunk by chunk, in the world or in the gel frame; a row for each that is shown."""
    positions = on_device(presses(COARSE), device)
    poses = np.zeros((ENV_COUNT, 7))
    poses[:, 2], poses[:, 6] = 1e-4 * np.arange(ENV_COUNT), 1.0
    frames = wp.array(poses, dtype=wp.transformd, device=device)
    chunk = chunk_images * (GRID.width_px * GRID.height_px + 8 * len(COARSE.faces))
    signal = make(COARSE, device, chunk_pixels=chunk)
    for frame in (None, frames):
        signal.update(positions, frame)
        expected = [array.numpy().copy() for array in signal.read(*ALL)]
        for chosen in ([4], [0, 2, 3], [1, 4], []):
            who = np.isin(np.arange(ENV_COUNT), chosen)
            signal.update(positions, frame, who)
            for array, all_of_it in zip(signal.read(*ALL), expected, strict=True):
                assert array.shape[0] == len(chosen)
                np.testing.assert_array_equal(array.numpy(), all_of_it[who])
    signal.update(positions)
    assert signal.markers_px.shape == (ENV_COUNT, 3)
    with pytest.raises(InputError, match=r"a mask is bool of shape \[5\]"):
        signal.update(positions, None, np.array([0, 3]))
    with pytest.raises(InputError, match="a mask of numpy, not the device's"):
        signal.update(positions, None, wp.zeros(ENV_COUNT, dtype=wp.bool, device=device))


def test_a_profile_says_all_but_the_markers(device):
    model, positions = color_model(GRID), presses(COARSE)
    profile = bare_profile(COARSE, GRID, "one")
    bare = SignalTactile.from_profile(profile, env_count=ENV_COUNT, device=device)
    bare.update(on_device(positions, device))
    with pytest.raises(InputError, match="color_model"):
        _ = bare.rgb
    profile = profile.with_block(BackgroundBlock(provenance=ASSUMED), background(GRID))
    block = ColorBlock(architecture=model.config.to_dict(), provenance=ASSUMED)
    profile = profile.with_block(block, model.weights)
    options = {"markers": MarkerLayout.from_points(COARSE, MARKERS_MM), "device": device}
    full = SignalTactile.from_profile(profile, env_count=ENV_COUNT, **options)
    full.update(on_device(positions, device))
    direct = shown(COARSE, device, positions)
    for one, other in zip(full.read(*ALL), direct.read(*ALL), strict=True):
        assert np.array_equal(one.numpy(), other.numpy())


def test_bad_calls_are_refused(device):
    signal = SignalTactile(COARSE, GRID, env_count=2, device=device)
    with pytest.raises(RuntimeError, match="update"):
        _ = signal.height_m
    nodes = COARSE.nodes_m[None].repeat(2, axis=0)
    positions = on_device(nodes, device)
    signal.update(positions)
    single = wp.array(nodes, dtype=wp.vec3f, device=device)
    frames = wp.zeros(3, dtype=wp.transformd, device=device)
    wide, deep = color_model(PixelGrid(50, 72, 0.05, 0.05)), color_model(GRID, hidden=(129,))

    def colored(model):
        return shown(COARSE, device, presses(COARSE), color_model=model).read("rgb")

    for call, given, message in (
        (signal.update, (on_device(nodes[:1], device),), "2 environments"),
        (signal.update, (on_device(nodes[:, :-1], device),), "nodes are needed"),
        (signal.update, (single,), "vec3d"),
        (signal.update, (positions, frames), "transformd"),
        (signal.read, ("rgb",), "color_model"),
        (signal.read, ("markers_px",), "markers"),
        (signal.read, ("depth",), "no signal 'depth'"),
        (partial(make, background_rgb=None), (COARSE, device), "together"),
        (partial(make, env_count=0), (COARSE, device), "env_co"),
        (colored, (wide,), "background has shape"),
        (colored, (deep,), "at most 128"),
    ):
        with pytest.raises(InputError, match=message):
            call(*given)


def folded(half_mm: tuple[float, float], env: int) -> tuple[TetMesh, np.ndarray]:
    """The node in the middle of one environment's face is past its neighbours."""
    mesh = flat_pad(0.3, half_mm, seed=2)
    positions, top = presses(mesh), mesh.region_nodes(Region.CONTACT)
    near = top[np.argmin(np.linalg.norm(mesh.nodes_m[top], axis=1))]
    positions[env, near] += [0.7e-3, 0.0, 0.0]
    return mesh, positions


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
    return mesh, presses(mesh) + np.array([x_mm, y_mm, 0.0]) * 1e-3


FOLDED, SMALL = partial(folded, PAD_HALF_MM, 2), partial(folded, (2.0, 1.3), 4)
# The sheared one is dented, and a walk may end at the dent.
STRAIGHT = [False, False, ..., False, False]


@pytest.mark.parametrize(
    ("made", "rasterized"),
    [
        (FOLDED, [False, False, True, False, False]),
        (SMALL, []),
        (with_a_hole_and_a_notch, []),
        *[(partial(beside, *at), STRAIGHT) for at in ((0.0, 0.0), (0.31, -0.17), (-0.9, 0.4))],
    ],
)
def test_awkward_faces_equal_the_reference(made, rasterized, device):
    mesh, positions = made()
    signal = shown(mesh, device, positions, markers=None)
    expected = reference(mesh, positions, GRID)
    # Faces squeezed to slivers by the fold.
    assert_agrees(signal, expected, device, normal_bound=1e-4)
    nowhere = np.isnan(expected["height_m"])
    if made is not FOLDED:
        assert nowhere.any(axis=(1, 2)).all() and not nowhere.all(axis=(1, 2)).any()
    if made is SMALL:
        unseen = nowhere | nowhere[0]
        still = np.broadcast_to(background(GRID), (ENV_COUNT, *background(GRID).shape))
        assert np.array_equal(signal.rgb_levels.numpy()[unseen], still[unseen])
    for found, wanted in zip(signal._surface.made.rasterized, rasterized, strict=False):
        assert wanted is ... or bool(found) == wanted
