# SPDX-License-Identifier: Apache-2.0
"""The suite ``readings``: images a second from colours to heights, how far blocks are off, and a
kept reader's time beside a small network's.

Dents with a sharp rim, slow sinking beside them and a camera's noise are read by networks of the
real size: random layers, the last one fitted to a dent. Images come as bytes of the host, on a GPU
also page-locked or of the device, and maps stay on the device. Heights are compared with those of a
reading of every pixel alone.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import torch

from taccel_lab.benchmarks.measure import seconds_of
from taccel_lab.benchmarks.results import ResultFile, Suite, spread
from taccel_lab.calibration.normals.options import InverseFitOptions
from taccel_lab.calibration.normals.small_network_fit import Lesson, taught
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.reading.blocks import finest_px
from taccel_lab.reading.features import color_change, image_features, of_blocks
from taccel_lab.reading.heights import read_heights
from taccel_lab.reading.network_answers import network
from taccel_lab.reading.slope_integration import resting_height
from taccel_lab.reading.slopes import NormalMap, NormalModel, relative_normals

SIZES = ((320, 320), (640, 480))
WIDTH_MM = 19.0
SCALES_PX = (0.7, 1.3, 2.5, 5.1)
"""Windows that a calibration finds for presses of 30 px (RVSATHU, GelSight Mini)."""
STEEPEST_RAD = 0.6
LOG_ERROR = -4.0
"""Logarithm of the expected error [rad]."""
TAUGHT = 100
"""Steps of a fit after which the small network is taught."""
LEAST_TAUGHT = 14_000
"""Pixels that networks are made and taught with at least, as far as an image has them."""
CPU_AIM_PER_S, GPU_AIM_PER_S = 20, 10_000


@dataclass(frozen=True)
class Readings(Suite):
    """Images a second from colours to heights, and how far blocks are off single pixels."""

    name: ClassVar[str] = "readings"
    what: ClassVar[str] = "Images read a second, and heights against a reading of every pixel."
    shown: ClassVar[tuple[str, ...]] = (
        "heights: images_per_s",
        "heights and deviation: images_per_s",
        "of page-locked memory: images_per_s",
        "of the device: images_per_s",
        "off_mm_max",
        "touched ms: median",
        "untouched ms: median",
        "small network ms: median",
    )
    at_once: tuple[int, ...] = (1, 16, 64)
    """Numbers of images read at once, a row each for each size."""
    repeats: int = 20
    """Readings of each row; the median counts."""

    def settings(self) -> dict[str, Any]:
        return super().settings() | {"threads": 1, "sizes": SIZES}

    def measure_rows(self, result: ResultFile) -> None:
        """All rows, then the best speed of the smaller size."""
        # The clock of the CPU counts all threads.
        torch.set_num_threads(1)
        for size, count in itertools.product(SIZES, self.at_once):
            row = partial(measure, size, count, self.device, self.repeats)
            result.measure(f"{size[0]}x{size[1]}, {count} at once", row)
        speeds = [
            row["heights and deviation"]["images_per_s"]
            for row in result.rows
            if tuple(row["size"]) == SIZES[0]
        ]
        if speeds:
            aim = CPU_AIM_PER_S if self.device == "cpu" else GPU_AIM_PER_S
            result.put("headline", {"images_per_s": max(speeds), "aim_per_s": aim})


def networks(grid: PixelGrid, device: str) -> NormalModel:
    """Seeded networks of the real architecture that read a dent, and a small one taught by them."""
    scales = (0.0, *SCALES_PX)
    blank = NormalModelConfig(
        grid.width_px,
        grid.height_px,
        scales_px=scales,
        slope_scales_px=SCALES_PX,
        hidden=(64, 64, 64),
        error_length_px=8.0,
        height_factor=1.0,
        along_factor=1.0,
        depth_share=0.05,
    )
    rng = np.random.default_rng(3)
    images, light, tilts = presses(grid, 1)
    change = color_change(images[0], light)
    features = image_features(blank, change, light).reshape(-1, blank.input_count)
    spread = tuple(float(value) for value in features.std(axis=0) + 1e-3)
    config = replace(blank, input_scale=spread)
    weights = {
        name: rng.normal(0.0, shape[-1] ** -0.5 if name.endswith("weight") else 0.1, shape)
        for name, shape in config.weight_shapes().items()
    }
    # What the last layer has to make of the ones before, at every few pixels of a large image.
    apart = min(7, max(1, len(features) // LEAST_TAUGHT))
    inputs = config.normalise(features)[::apart]
    pairs = [(weights[f"layer{i}.weight"], weights[f"layer{i}.bias"]) for i in range(3)]
    layers = [(torch.tensor(weight), torch.tensor(bias)) for weight, bias in pairs]
    given = torch.tensor(inputs, dtype=torch.float64).expand(config.members, -1, -1)
    hidden = network(layers, given)
    active = torch.nn.functional.silu(hidden).numpy()
    wanted = tilts[0].reshape(-1, 2)[::apart]
    for k in range(config.members):
        terms = np.column_stack([active[k], np.ones(len(wanted))])
        gram = terms.T @ terms + 1e-3 * len(terms) * np.eye(terms.shape[1])
        found = np.linalg.solve(gram, terms.T @ wanted)
        weights["layer3.weight"][k, :2] = found[:-1].T
        weights["layer3.weight"][k, 2] *= 0.1
        weights["layer3.bias"][k] = *found[-1], LOG_ERROR
    ensemble, pixels = NormalModel(config, weights), torch.from_numpy(inputs)
    shown, left_out = (Lesson.by(ensemble, pixels[k::2]) for k in range(2))
    both = taught(ensemble, shown, left_out, InverseFitOptions(steps=TAUGHT))
    return NormalModel(both.config, both.weights, device)


def presses(grid: PixelGrid, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Images, uint8, shape [image, h, w, 3], of a dent in different places, the background, and
    the tilts that they show [rad], shape [image, h, w, 2]."""
    rng = np.random.default_rng(7)
    v, u = np.mgrid[: grid.height_px, : grid.width_px]
    light = np.stack([90 + 60 * u / u.max(), 140 - 40 * v / v.max(), 120 + 0 * u], axis=-1)
    radius = 0.1 * grid.width_px
    images, tilts = [], []
    for _ in range(count):
        away = np.stack([u, v], axis=-1) - rng.uniform(0.3, 0.7, 2) * [u.max(), v.max()]
        distance = np.hypot(away[..., 0], away[..., 1]) / radius
        lean = np.where(distance < 1, distance, 0.8 * np.exp((1 - distance) / 0.2))
        lean += 0.2 * np.exp(-distance / 2)
        way = away / (radius * np.maximum(distance, 0.1)[..., None])
        # A dent's normals lean to its middle.
        lean_to = -way * lean[..., None]
        change = 60.0 * np.concatenate([lean_to, -lean_to.sum(axis=-1, keepdims=True)], axis=-1)
        noisy = light + change + rng.normal(0.0, 1.0, light.shape)
        images.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
        tilts.append(STEEPEST_RAD * lean_to)
    return np.stack(images), light.astype(np.float32), np.stack(tilts)


def heights_mm(
    model: NormalModel, image: np.ndarray, light: np.ndarray, grid: PixelGrid
) -> tuple[np.ndarray, np.ndarray]:
    """Heights of one image [mm], by blocks and by every pixel alone, of the smallest blocks."""
    every = finest_px(grid)
    read = read_heights(model, image, light, grid, uncertainty=False, every=every)
    features = image_features(model.config, color_change(image, light), light)
    tilt, error = model.predict_pixels(features.reshape(-1, model.config.input_count))
    tilt, error = tilt.reshape(*image.shape[:2], 2), error.reshape(image.shape[:2])
    alone = NormalMap(relative_normals(tilt), tilt, error, error)
    zero = read.zero.repeat(every, axis=0).repeat(every, axis=1)
    zero = zero[: grid.height_px, : grid.width_px]
    rise_m = of_blocks(resting_height(alone.slopes(), grid, zero=zero), every)
    return 1e3 * read.rise_m, 1e3 * rise_m


def measure(size: tuple[int, int], count: int, device: str, repeats: int) -> dict[str, Any]:
    """All figures of a row."""
    grid = PixelGrid(*size, WIDTH_MM / size[0], WIDTH_MM / size[0])
    model = networks(grid, device)
    images, light, _ = presses(grid, count)
    given = torch.from_numpy(images)
    blocks, pixels = heights_mm(model, images[0], light, grid)
    off = np.abs(blocks - pixels)
    row: dict[str, Any] = {
        "size": list(size),
        "at_once": count,
        "off_mm_max": float(off.max()),
        "off_mm_mean": float(off.mean()),
        "deepest_mm": float(-pixels.min()),
    }
    ways = {"heights": (given, False), "heights and deviation": (given, True)}
    if device != "cpu":
        ways["of page-locked memory"] = given.pin_memory(), True
        ways["of the device"] = given.to(device), True
    for name, (shown, uncertainty) in ways.items():
        work = partial(
            read_heights, model, shown, light, grid, uncertainty=uncertainty, every=finest_px(grid)
        )
        figures = spread(seconds_of(work, device, repeats))
        row[name] = {**figures, "images_per_s": count / figures["median"]}
    if count == 1 and device == "cpu":
        # Readers need what a machine of a GPU may lack (cv2).
        from tools.bench.kept_reader import measure_reader

        row |= measure_reader(model, images[0], light, grid, repeats)
    return row
