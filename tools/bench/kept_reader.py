# SPDX-License-Identifier: Apache-2.0
"""A kept reader's time for an image, beside a network and integration of the size of gs_sdk's.

The reader tells touch, force and deviations of everything; the small one (layers of 5, 32, 32, 32
and 2 from colour and place to angles, as of ``exporters.gs_sdk``, then Poisson's equation by cosine
transforms) heights alone. Both read the same image by turns, each on one thread.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from scipy.fft import dctn, idctn

from taccel_lab.api.read import Reader
from taccel_lab.benchmarks.measure import clock_of
from taccel_lab.benchmarks.results import spread
from taccel_lab.exporters.gs_sdk import WIDTHS
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import CameraBlock, NormalsBlock, SensorProfile
from taccel_lab.reading.slopes import NormalModel
from taccel_lab.sensors.profile import catalogue_profile

WARM_UP = 3


class SmallNetwork:
    """Heights over rest [px] of one sensor's images, whose network's weights are random."""

    def __init__(self, untouched: np.ndarray) -> None:
        """``untouched``: RGB levels, shape [height_px, width_px, 3]."""
        rows, columns = untouched.shape[:2]
        places = torch.meshgrid(
            torch.linspace(0, 1, rows), torch.linspace(0, 1, columns), indexing="ij"
        )
        self._places = torch.stack(places[::-1], dim=-1)
        torch.manual_seed(0)
        layers = [torch.nn.Linear(*widths) for widths in pairwise(WIDTHS)]
        between = [part for layer in layers[:-1] for part in (layer, torch.nn.ReLU())]
        self._network = torch.nn.Sequential(*between, layers[-1])
        waves = [2 * np.cos(np.pi * np.arange(n) / n) - 2 for n in (rows, columns)]
        self._eigenvalues = np.add.outer(*waves)
        self._eigenvalues[0, 0] = np.inf
        self._rest = self._slopes(untouched)

    def _slopes(self, image: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            colors = torch.from_numpy(image).float() / 255
            angles = self._network(torch.cat([colors, self._places], dim=-1).flatten(0, 1))
        return np.tan(angles.numpy()).reshape(*image.shape[:2], 2)

    def heights(self, image: np.ndarray) -> np.ndarray:
        """Grey levels of an image, shape [height_px, width_px]."""
        slopes = self._slopes(image) - self._rest
        flow = np.zeros(image.shape[:2])
        along_x = 0.5 * (slopes[:, 1:, 0] + slopes[:, :-1, 0])
        along_y = 0.5 * (slopes[1:, :, 1] + slopes[:-1, :, 1])
        flow[:, :-1] += along_x
        flow[:, 1:] -= along_x
        flow[:-1] += along_y
        flow[1:] -= along_y
        return np.asarray(idctn(np.asarray(dctn(flow)) / self._eigenvalues))


def unit_of(model: NormalModel, grid: PixelGrid) -> SensorProfile:
    """A flat gel whose images the model reads."""
    size = {"length_x_mm": grid.width_px * grid.mm_per_px_x + 4.0}
    size["length_y_mm"] = grid.height_px * grid.mm_per_px_y + 4.0
    flat = catalogue_profile("flat_pad", {**size, "thickness_mm": 4.0})
    camera = CameraBlock.from_grid(grid, flat.camera.provenance)
    normals = NormalsBlock(architecture=model.config.to_dict(), provenance=flat.camera.provenance)
    return flat.with_block(camera).with_block(normals, dict(model.weights))


def measure_reader(
    model: NormalModel, image: np.ndarray, light: np.ndarray, grid: PixelGrid, repeats: int
) -> dict[str, Any]:
    """Milliseconds an image of a reader, touched and untouched, and of the small network.

    Args:
        model: That the reader reads with.
        image: A press, uint8, shape [height_px, width_px, 3].
        light: The untouched gel without noise, likewise.
        grid: Of both.
        repeats: Images of each; three before are not timed.
    """
    noise = np.random.default_rng(5).normal(0.0, 1.0, light.shape)
    rest = np.clip(np.rint(light), 0, 255).astype(np.uint8)
    untouched = np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)
    reader, small = Reader(unit_of(model, grid), background=rest), SmallNetwork(rest)
    works: dict[str, Callable[[], object]] = {
        "touched": lambda: reader(image),
        "untouched": lambda: reader(untouched),
        "small network": lambda: small.heights(image),
    }
    clock = clock_of("cpu")
    milliseconds: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats + WARM_UP):
        for name, work in works.items():
            start = clock()
            work()
            milliseconds[name].append(1e3 * (clock() - start))
    return {f"{name} ms": spread(found[WARM_UP:]) for name, found in milliseconds.items()}
