# SPDX-License-Identifier: Apache-2.0
"""The suite ``images``: images and markers a second, and their error against one-image classes.

A pad of 20 x 15 mm with 1,271 nodes on its contact face, a colour network of the real architecture
with seeded random weights, and a smooth press with shear that differs in each environment and moves
every pixel: the most work an image can be. Each update is captured in a CUDA graph and timed by
device events; on the CPU by ``taccel_lab.benchmarks.measure``.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
import warp as wp

from taccel_lab.benchmarks.learning import background, color_model
from taccel_lab.benchmarks.measure import seconds_of
from taccel_lab.benchmarks.results import ResultFile, Suite, spread
from taccel_lab.camera.gel_camera import face_of
from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.tactile import SignalTactile

PAD_M = (20e-3, 15e-3, 4e-3)
WIDTH_MM = 19.36
WIDE_MM = 23.0
"""Width of an image that shows what lies beside the pad too."""
SIZES = ((320, 240), (640, 480))
READS: dict[str, tuple[str, ...]] = {
    "RGB": ("rgb",),
    "markers": ("markers_px",),
    "RGB and markers": ("rgb", "markers_px"),
    "height": ("height_m",),
    "height and normals": ("height_m", "normals"),
}
STILL_LEVELS = 0.1
"""Limit of the rows that leave pixels alone which hardly change."""
FLOOR_PER_S, AIM_PER_S = 25_000, 100_000


@dataclass(frozen=True)
class Images(Suite):
    """Tactile images and markers a second, and their error against the one-image classes."""

    name: ClassVar[str] = "images"
    what: ClassVar[str] = "Tactile images and markers a second, and their error in grey levels."
    shown: ClassVar[tuple[str, ...]] = (
        *(f"{name}: images_per_s" for name in READS),
        "view beyond the pad: images_per_s", "errors: levels_mean", "errors: levels_max",
        "errors: markers_px_max", "captured_equals_eager", "build_and_first_read_s",
    )  # fmt: skip
    sensors: tuple[int, ...] = (1, 64, 1024)
    """Numbers of sensors at once, a row each for each size of the image."""
    repeats: int = 20
    """Updates of each row; the median counts."""

    def settings(self) -> dict[str, Any]:
        return super().settings() | {"sizes": SIZES}

    def measure_rows(self, result: ResultFile) -> None:
        """All rows, then the speed of the most sensors."""
        mesh = pad()
        with wp.ScopedDevice(self.device):
            for size, count in itertools.product(SIZES, self.sensors):
                row = partial(measure, mesh, size, count, self.device, self.repeats)
                result.measure(f"{size[0]}x{size[1]}, {count} sensors", row)
        rows = [row for row in result.rows if tuple(row["size"]) == SIZES[0]]
        if rows:
            most = max(rows, key=lambda row: row["sensors"])
            speed = most["RGB and markers"]["images_per_s"]
            result.put(
                "headline",
                {"images_per_s": speed, "floor_per_s": FLOOR_PER_S, "aim_per_s": AIM_PER_S},
            )


def pad() -> TetMesh:
    """The gel."""
    return block_mesh((40, 30, 4), PAD_M, jitter=0.2)


def pressed(mesh: TetMesh, env_count: int, reach_m: float | None = None) -> np.ndarray:
    """Node positions [m] of presses with shear, shape [env, node, 3].

    ``reach_m``: Distance from the press beyond which nothing moves; None for an unbounded press.
    """
    rng = np.random.default_rng(7)
    positions = np.repeat(mesh.nodes_m[None], env_count, axis=0)
    center = rng.uniform(-4e-3, 4e-3, (env_count, 1, 2))
    width = rng.uniform(1e-3, 2.5e-3, (env_count, 1))
    depth = rng.uniform(0.2e-3, 1.0e-3, (env_count, 1))
    shear = rng.uniform(-0.4e-3, 0.4e-3, (env_count, 1, 2))
    distance2 = ((positions[..., :2] - center) ** 2).sum(axis=-1)
    share = np.exp(-distance2 / (2 * width**2)) * (1 + positions[..., 2] / PAD_M[2])
    if reach_m is not None:
        share = np.where(distance2 < reach_m**2, share, 0.0)
    positions[..., 2] -= depth * share
    positions[..., :2] += shear * share[..., None]
    return positions


def marker_points_mm() -> np.ndarray:
    """A 9 x 7 grid of markers."""
    x, y = np.meshgrid(np.linspace(-8, 8, 9), np.linspace(-6, 6, 7))
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def build(
    mesh: TetMesh,
    size: tuple[int, int],
    env_count: int,
    device: str,
    still_levels: float = 0.0,
    width_mm: float = WIDTH_MM,
) -> SignalTactile:
    """The signal of the benchmark."""
    grid = PixelGrid(*size, width_mm / size[0], width_mm / size[0])
    return SignalTactile(
        mesh,
        grid,
        env_count=env_count,
        color_model=color_model(grid),
        background_rgb=background(grid),
        markers=MarkerLayout.from_points(mesh, marker_points_mm()),
        still_levels=still_levels,
        device=device,
    )


def timed(work: Callable[[], Any], device: wp.Device, repeats: int) -> dict[str, float]:
    """Time [s] of ``work``, warm; captured once on CUDA: median and range."""
    if not device.is_cuda:
        return spread(seconds_of(work, device, repeats))
    work()
    with wp.ScopedCapture(device) as capture:
        work()
    events = [wp.Event(device, enable_timing=True) for _ in range(repeats + 1)]
    for _ in range(3):
        wp.capture_launch(capture.graph)
    wp.record_event(events[0])
    for event in events[1:]:
        wp.capture_launch(capture.graph)
        wp.record_event(event)
    wp.synchronize_device(device)
    pairs = itertools.pairwise(events)
    return spread([wp.get_event_elapsed_time(a, b) * 1e-3 for a, b in pairs])


def errors(signal: SignalTactile, positions: np.ndarray, env_count: int) -> dict[str, Any]:
    """Differences of the first environments' colours from ``ColorModel`` on the host, for the
    surfaces that the signal reads, and of their markers from their nodes' weighted means.

    The surfaces have their referee in the tests.
    """
    grid, mesh = face_of(signal.grid), pad()
    names = ("rgb", "rgb_levels", "markers_px", "height_m", "normals")
    rgb, levels, markers, height, normals = (
        array[:env_count].numpy() for array in signal.read(*names)
    )
    image = np.stack([host_image(grid, *surface) for surface in zip(height, normals, strict=True)])
    layout = MarkerLayout.from_points(mesh, marker_points_mm())
    points = np.einsum("mk,emkc->emc", layout.weights, positions[:env_count][:, layout.nodes])
    markers_px = grid.pixel_from_gel(points[..., :2] * 1e3)
    error = np.abs(levels - image)
    change = np.abs(image - background(grid))
    return {
        "environments": env_count,
        "change_levels_mean": float(change.mean()),
        "change_levels_max": float(change.max()),
        "levels_mean": float(error.mean()),
        "levels_p99": float(np.quantile(error, 0.99)),
        "levels_max": float(error.max()),
        "rgb_differing_share": float((rgb != np.rint(image)).mean()),
        "rgb_max": float(np.abs(rgb - np.rint(image)).max()),
        "markers_px_max": float(np.abs(markers - markers_px).max()),
    }


def host_image(grid: PixelGrid, height_m: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Levels of one image by the colour model on the host; the pad of the benchmark is flat."""
    seen = np.flatnonzero(np.isfinite(height_m))
    flat = np.broadcast_to([0.0, 0.0, 1.0], (len(seen), 3))
    image = background(grid).astype(np.float32).reshape(-1, 3)
    image[seen] += color_model(grid).predict_pixels(
        seen, normals.reshape(-1, 3)[seen], 1e3 * height_m.ravel()[seen], flat
    )
    return np.clip(image, 0.0, 255.0).reshape(normals.shape)


def replay_agrees(signal: SignalTactile, env_count: int) -> bool | None:
    """Whether a captured read of other positions gives what a plain one does; None on the CPU."""
    if not signal.device.is_cuda:
        return None
    mesh = pad()
    positions = wp.array(pressed(mesh, env_count), dtype=wp.vec3d, device=signal.device)
    signal.update(positions)
    signal.read("rgb", "markers_px")
    with wp.ScopedCapture(signal.device) as capture:
        signal.update(positions)
        arrays = signal.read("rgb", "markers_px")
    positions.assign(pressed(mesh, env_count)[::-1].copy())
    wp.capture_launch(capture.graph)
    replayed = [array.numpy() for array in arrays]
    signal.update(positions)
    plain = [array.numpy() for array in signal.read("rgb", "markers_px")]
    return all(np.array_equal(a, b) for a, b in zip(replayed, plain, strict=True))


def measure(
    mesh: TetMesh, size: tuple[int, int], env_count: int, device: str, repeats: int
) -> dict[str, Any]:
    """All figures of a row."""
    wp_device = wp.get_device(device)
    positions = pressed(mesh, env_count)
    on_device = wp.array(positions, dtype=wp.vec3d, device=device)
    before = time.perf_counter()
    signal = build(mesh, size, env_count, device)
    signal.update(on_device)
    signal.read("rgb", "markers_px")
    wp.synchronize_device(wp_device)
    row: dict[str, Any] = {
        "size": list(size),
        "sensors": env_count,
        "build_and_first_read_s": time.perf_counter() - before,
        "environments_rasterized": signal.rasterized_count(),
        "errors": errors(signal, positions, min(env_count, 2)),
    }

    def speed(signal: SignalTactile, on_device: wp.array, *reads: str) -> dict[str, float]:
        def work() -> None:
            signal.update(on_device)
            signal.read(*reads)

        figures = timed(work, wp_device, repeats)
        return {**figures, "images_per_s": env_count / figures["median"]}

    for name, reads in READS.items():
        row[name] = speed(signal, on_device, *reads)
    if env_count <= 64:
        row["captured_equals_eager"] = replay_agrees(signal, env_count)
    del signal

    def seen(signal: SignalTactile, reach_m: float | None = None) -> dict[str, Any]:
        positions = pressed(mesh, env_count, reach_m)
        on_device = wp.array(positions, dtype=wp.vec3d, device=device)
        figures = speed(signal, on_device, "rgb", "markers_px")
        return {**figures, "errors": errors(signal, positions, min(env_count, 2))}

    lazy = build(mesh, size, env_count, device, STILL_LEVELS)
    row["still"] = {
        "still_levels": STILL_LEVELS,
        "unbounded press": seen(lazy),
        "reach of 4 mm": seen(lazy, 4e-3),
    }
    del lazy
    wide = build(mesh, size, env_count, device, width_mm=WIDE_MM)
    row["view beyond the pad"] = {
        **seen(wide),
        "width_mm": WIDE_MM,
        "environments_rasterized": wide.rasterized_count(),
    }
    if wp_device.is_cuda:
        row["device_memory_high_mib"] = wp.get_mempool_used_mem_high(wp_device) / 2**20
    return row
