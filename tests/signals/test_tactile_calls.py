# SPDX-License-Identifier: Apache-2.0
"""What reading device signals launches, allocates and shares, and which calls are refused."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import (
    BackgroundBlock,
    ColorBlock,
)
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
    background,
    color_model,
    make,
    on_device,
    presses,
)
from tests.support.sample_blocks import ASSUMED, bare_profile


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
def test_some_environments_look_as_among_all(device: str, chunk_images: int) -> None:
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
    with pytest.raises(InputError, match="2 environments"):
        signal.update(on_device(nodes[:1], "cpu"))
    with pytest.raises(InputError, match="nodes are needed"):
        signal.update(on_device(nodes[:, :-1], "cpu"))
    with pytest.raises(InputError, match="vec3d"):
        signal.update(wp.array(nodes, dtype=wp.vec3f, device="cpu"))
    positions = on_device(nodes, "cpu")
    with pytest.raises(InputError, match="transformd"):
        signal.update(positions, wp.zeros(3, dtype=wp.transformd, device="cpu"))
    signal.update(positions)
    for name, message in (
        ("rgb", "color_model"),
        ("markers_px", "markers"),
        ("depth", "unknown signal 'depth'"),
    ):
        with pytest.raises(InputError, match=message):
            signal.read(name)
    with pytest.raises(InputError, match="together"):
        make(mesh, background_rgb=None)
    with pytest.raises(InputError, match="env_count"):
        make(mesh, env_count=0)
    wrong = make(mesh, color_model=color_model(PixelGrid(50, 72, 0.05, 0.05)))
    wrong.update(on_device(presses(mesh), "cpu"))
    with pytest.raises(InputError, match="background has shape"):
        wrong.read("rgb")
    wide = make(mesh, color_model=color_model(GRID, hidden=(129,)))
    wide.update(on_device(presses(mesh), "cpu"))
    with pytest.raises(InputError, match="at most 128"):
        wide.read("rgb")
