# SPDX-License-Identifier: Apache-2.0
"""Device signals of many environments against the one-image classes, and what they launch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.geometry.block import block_mesh
from taccel_lab.profile import (
    BackgroundBlock,
    CameraBlock,
    ColorBlock,
    GelBlock,
    MaterialBlock,
    Provenance,
    SensorBlock,
    SensorProfile,
)
from taccel_lab.signals import MarkerLayout, SignalHeightMap, SignalTactile, SurfaceMode
from taccel_lab.signals.color_model import ColorModel, ColorModelConfig, expected_shapes
from tests.signals.pressed_surface import PressedSphere, extrude, flat_pad, shaped

DEVICES = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]
GRID = PixelGrid(96, 72, 0.05, 0.05)
PAD_HALF_MM = (3.0, 2.4)
ENV_COUNT = 5
MARKERS_MM = np.array([[0.0, 0.0], [1.0, -0.5], [-1.5, 1.2]])
ALL = ("rgb", "rgb_levels", "height_m", "normals", "markers_px")
# FP32 network on the CPU; FP16 weights and activations on CUDA.
LEVELS = {"cpu": 1e-2, "cuda:0": 0.3}


def color_model(grid: PixelGrid, hidden: tuple[int, ...] = (32, 20)) -> ColorModel:
    rng = np.random.default_rng(4)
    config = ColorModelConfig(
        grid.width_px,
        grid.height_px,
        hidden=hidden,
        input_mean=(0.0, 0.0, 0.0, 0.0, 0.95, -0.1),
        input_scale=(0.6, 0.6, 0.2, 0.2, 0.1, 0.2),
    )
    return ColorModel(
        config,
        {
            name: rng.normal(0, 1.5 / np.sqrt(shape[-1]), shape)
            for name, shape in expected_shapes(config).items()
        },
    )


def background(grid: PixelGrid) -> np.ndarray:
    rng = np.random.default_rng(5)
    return rng.uniform(0, 255, (grid.height_px, grid.width_px, 3)).astype(np.float32)


def presses(mesh: Any) -> np.ndarray:
    """At rest, pressed, pressed with shear, tilted and stretched, pressed elsewhere."""
    positions = np.concatenate(
        [
            mesh.nodes_m[None],
            shaped(mesh, PressedSphere(1.0e-3).height),
            shaped(mesh, PressedSphere(1.4e-3).height),
            shaped(mesh, lambda x, y: 0.1 * x - 0.05 * y),
            shaped(mesh, PressedSphere(0.7e-3, center_xy_m=(-1e-3, 0.5e-3)).height),
        ]
    )
    bulge = np.exp(-((positions[2, :, :2] / 1.1e-3) ** 2).sum(axis=-1))[:, None]
    positions[2, :, :2] += bulge * [0.5e-3, -0.35e-3]
    positions[3, :, :2] *= 1.05
    return positions


def on_device(positions: np.ndarray, device: str) -> wp.array:
    return wp.array(positions, dtype=wp.vec3d, device=device)


def make(mesh: Any, device: str = "cpu", grid: PixelGrid = GRID, **changes: Any) -> SignalTactile:
    arguments = {
        "env_count": ENV_COUNT,
        "color_model": color_model(grid),
        "background_rgb": background(grid),
        "device": device,
        **changes,
    }
    if "markers" not in arguments:
        arguments["markers"] = MarkerLayout.from_points(mesh, MARKERS_MM)
    return SignalTactile(mesh, grid, **arguments)


def reference(mesh: Any, positions: np.ndarray, grid: PixelGrid, mode: SurfaceMode) -> dict:
    """What the numpy classes make of it."""
    signal = SignalHeightMap(mesh, grid, mode=mode)
    signal.update(np.concatenate([mesh.nodes_m[None], positions]))
    height, normals = signal.height_m, signal.normals
    seen = np.isfinite(height[1:]) & np.isfinite(height[0])
    flat = np.array([0.0, 0.0, 1.0])
    levels = color_model(grid).render(
        np.where(seen[..., None], normals[1:], flat),
        np.where(seen, height[1:] - height[0], 0.0) * 1e3,
        np.where(seen[..., None], normals[:1], flat),
        background(grid),
    )
    return {"height_m": height[1:], "normals": normals[1:], "rgb_levels": levels}


def assert_agrees(
    signal: SignalTactile, expected: dict, device: str, normal_bound: float = 5e-6
) -> None:
    height, normals = signal.height_m.numpy(), signal.normals.numpy()
    assert np.array_equal(np.isnan(height), np.isnan(expected["height_m"]))
    assert np.array_equal(np.isnan(normals).any(axis=-1), np.isnan(height))
    assert np.nanmax(np.abs(height - expected["height_m"])) < 1e-9
    assert np.nanmax(np.abs(normals - expected["normals"])) < normal_bound
    levels = signal.rgb_levels.numpy()
    assert np.abs(levels - expected["rgb_levels"]).max() < LEVELS[device]
    assert np.array_equal(signal.rgb.numpy(), np.rint(levels))


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


@pytest.mark.parametrize("device", DEVICES)
def test_folded_faces_and_pixels_beside_the_pad_are_rasterized(device):
    mesh = flat_pad(0.3, (2.0, 1.3), seed=2)
    positions = presses(mesh)
    top = mesh.region_nodes(Region.CONTACT)
    near = top[np.argmin(np.linalg.norm(mesh.nodes_m[top], axis=1))]
    positions[4, near] += [0.7e-3, 0.0, 0.0]
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
    assert not signal._sampler.rasterized[[0, 1, 3, 4]].any()


@pytest.mark.parametrize("device", DEVICES)
def test_only_folded_environments_are_rasterized(device):
    mesh = flat_pad(0.3, PAD_HALF_MM, seed=2)
    positions = presses(mesh)
    top = mesh.region_nodes(Region.CONTACT)
    near = top[np.argmin(np.linalg.norm(mesh.nodes_m[top], axis=1))]
    positions[2, near] += [0.7e-3, 0.0, 0.0]
    signal = make(mesh, device)
    signal.update(on_device(positions, device))
    expected = reference(mesh, positions, GRID, SurfaceMode.SMOOTH)
    assert_agrees(signal, expected, device, normal_bound=1e-4)
    assert signal._sampler.rasterized.tolist() == [False, False, True, False, False]


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
def test_untouched_gels_show_the_background_exactly(device):
    mesh = flat_pad(0.3, PAD_HALF_MM, seed=2)
    signal = make(mesh, device)
    signal.update(on_device(presses(mesh), device))
    assert np.array_equal(signal.rgb_levels.numpy()[0], background(GRID))
    assert not np.array_equal(signal.rgb_levels.numpy()[1], background(GRID))


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


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the kernels that are launched."""
    names: list[str] = []
    launch = wp.launch

    def counted(kernel: Any, *args: Any, **kwargs: Any) -> Any:
        names.append(kernel.key)
        return launch(kernel, *args, **kwargs)

    launch_tiled = wp.launch_tiled

    def counted_tiled(kernel: Any, *args: Any, **kwargs: Any) -> Any:
        names.append(kernel.key)
        return launch_tiled(kernel, *args, **kwargs)

    monkeypatch.setattr(wp, "launch", counted)
    monkeypatch.setattr(wp, "launch_tiled", counted_tiled)
    return names


def test_only_what_is_read_is_launched(launched):
    mesh = flat_pad(0.4, PAD_HALF_MM)
    signal = make(mesh)
    positions = on_device(presses(mesh), "cpu")
    signal.update(positions)
    assert launched == []
    assert signal.markers_px is not None
    assert launched == ["_project_markers_kernel"]
    launched.clear()
    assert signal.markers_px is signal.read("markers_px")[0]
    assert launched == []
    signal.read("height_m", "rgb", "markers_px")
    signal.update(positions)
    launched.clear()

    def surface_and(*own: str) -> list[str]:
        return sorted([*SURFACE, *own])

    signal.read("height_m")
    assert sorted(launched) == surface_and("_height_kernel")
    launched.clear()
    signal.read("rgb")
    signal.read("rgb_levels")
    # The surface is still there from the height map.
    assert len(launched) == 2 and all("color_kernel" in name for name in launched)
    signal.update(positions)
    launched.clear()
    signal.read("rgb", "rgb_levels", "height_m")
    assert len(launched) == len(SURFACE) + 2
    assert "_project_markers_kernel" not in launched


SURFACE = [
    "_gather_surface_kernel",
    "_network_terms_kernel",
    "_relax_gradients_kernel",
    "build_patches_kernel",
    "_sample_kernel",
    "_prepare_raster_kernel",
    "_rasterize_faces_kernel",
    "_rasterize_faces_kernel",
    "_settle_kernel",
]


def test_signals_that_are_not_read_take_no_memory():
    mesh = flat_pad(0.4, PAD_HALF_MM)
    signal = make(mesh)
    signal.update(on_device(presses(mesh), "cpu"))
    signal.read("markers_px")
    assert signal._sampler is None and signal._painter is None
    signal.read("height_m")
    assert signal._painter is None


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


def test_a_profile_says_all_but_the_markers():
    mesh = flat_pad(0.4, PAD_HALF_MM)
    model = color_model(GRID)
    said = Provenance(kind="assumed", method="made up for a test", source="none")
    profile = SensorProfile(
        sensor=SensorBlock(name="one", family="gelsight", provenance=said),
        gel=GelBlock(
            thickness_mm=1.0,
            node_count=mesh.node_count,
            tet_count=mesh.tet_count,
            min_dihedral_deg=1.0,
            provenance=said,
        ),
        material=MaterialBlock(
            young_modulus_pa=1e5,
            poisson_ratio=0.45,
            density_kg_m3=1e3,
            friction_coefficient=0.5,
            provenance=said,
        ),
        camera=CameraBlock.from_grid(GRID, said),
        mesh=mesh,
    )
    positions = on_device(presses(mesh), "cpu")
    bare = SignalTactile.from_profile(profile, env_count=ENV_COUNT)
    bare.update(positions)
    with pytest.raises(InputError, match="color_model"):
        _ = bare.rgb
    profile = profile.with_block(BackgroundBlock(provenance=said), background(GRID))
    block = ColorBlock(architecture=model.config.to_dict(), provenance=said)
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
