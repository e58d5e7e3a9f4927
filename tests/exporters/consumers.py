# SPDX-License-Identifier: Apache-2.0
"""Exported files as their consumers read them: frames, units and orders are theirs."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import pyvista
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial.transform import Rotation

LINK = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From the gel frame to ROS' body axes: x out of the gel, y left and z up in the image."""
TACCEL = np.diag([1.0, -1.0, -1.0])
"""From the gel frame to that of Taccel's pads, touched from -z; also its own inverse."""


def opencv_values(path: Path) -> dict[str, Any]:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    values: dict[str, Any] = {}
    for key in storage.root().keys():
        node = storage.getNode(key)
        values[key] = (
            node.string() if node.isString() else node.real() if not node.isMap() else node.mat()
        )
    storage.release()
    return values


def decoded(png: bytes) -> np.ndarray:
    """As OpenCV decodes an image: channels in the order in which they were encoded."""
    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR))


def isaac_render(data: Path, penetration_m: np.ndarray, cfg: dict[str, Any]) -> np.ndarray:
    """As GelsightRender.render, less the smoothing of the height map."""
    table = np.load(data / cfg["calib_path"])
    background = np.asarray(cv2.imread(str(data / cfg["background_path"])))[..., ::-1]
    dzdx, dzdy = np.gradient(penetration_m * -1000 / cfg["mm_per_pixel"])
    steep = np.hypot(dzdx, dzdy)
    direction = np.where(steep == 0, 0.0, np.arctan2(dzdx, dzdy))
    steps = cfg["num_bins"] - 1
    i = np.clip(np.floor(np.arctan(steep) / (0.5 * np.pi / steps)).astype(int), 0, steps)
    j = np.clip(np.floor((direction + np.pi) / (2 * np.pi / steps)).astype(int), 0, steps)
    x, y = np.meshgrid(range(cfg["image_width"]), range(cfg["image_height"]))
    terms = np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=-1)
    change = [(terms * table[f"grad_{c}"][i, j]).sum(axis=-1) for c in "rgb"]
    return np.clip(np.stack(change, axis=-1) + background, 0, 255)


def taxim(folder: Path, **simulator: object) -> Any:
    """PyPI's taxim on a calibration folder."""
    taxim = pytest.importorskip("taxim", reason="PyPI's taxim is not installed")
    pytest.importorskip("jax", reason="taxim needs jax or torch-scatter")
    return taxim.Taxim(calib_folder=folder, backend="jax", params={"simulator": simulator})


def taxim_render(simulator: Any, height_mm: np.ndarray, **options: object) -> np.ndarray:
    return 255 * np.asarray(simulator.render_direct(height_mm.astype(np.float32), **options))


class PlainNumpy(pickle.Unpickler):
    """Refuses everything but numpy's arrays."""

    def find_class(self, module: str, name: str) -> object:
        if module.split(".")[0] != "numpy":
            raise pickle.UnpicklingError(f"{module}.{name}")
        return super().find_class(module, name)


class TaccelPad:
    """What TactileRobot._load_tac_fabrications makes of the first entry of the list."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.entry = json.loads((folder / "tac_fabr.json").read_text())[0]
        grid = pyvista.read(folder / self.entry["mesh_vtk_file"])
        assert isinstance(grid, pyvista.UnstructuredGrid)
        self.grid, self.nodes = grid, np.asarray(grid.points)
        with (folder / self.entry["mesh_metadata_file"]).open("rb") as file:
            self.metadata = PlainNumpy(file).load()
        turn = Rotation.from_euler("xyz", self.entry["rot"]).as_matrix()
        assert np.array_equal(turn, np.eye(3)) and self.entry["pos"] == [0, 0, 0]
        self.config = json.loads((folder / "vbts_config.json").read_text())

    def depth_image(self, points: np.ndarray) -> np.ndarray:
        """Rows and columns as TaccelModel.render_tactile lays them out [m]."""
        coat = points[self.metadata["coat_mask"]]
        side = self.config["cam_h"]
        x = (np.arange(side) - (side - 1) / 2) * self.config["cam_pixel_size"] * 1e-3
        # Rays from z = ray_start_level along -z; the first index of the grid goes with x, then the
        # image is transposed.
        z = LinearNDInterpolator(coat[:, :2], coat[:, 2])(*np.meshgrid(x, x, indexing="ij"))
        start = self.config["ray_start_level"]
        return (abs(start - self.config["ray_rest_level"]) - (start - z)).T

    def markers(self) -> np.ndarray:
        corners = self.nodes[self.metadata["marker_vert_idx"]]
        return (self.metadata["marker_bc_coords"][..., None] * corners).sum(axis=1)
