# SPDX-License-Identifier: Apache-2.0
"""The fabrication list read as Taccel reads it: keys, masks, markers, and where a press lands."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import pyvista
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial.transform import Rotation

from taccel_lab.exporters.export import export_profile
from taccel_lab.exporters.frames import TACCEL_FROM_GEL
from taccel_lab.exporters.taccel import vbts_config
from taccel_lab.geometry import Region
from taccel_lab.profile import SensorProfile
from tests.support.real_data import real_data

SHIPPED = "taccel_assets/pads/single_sensor__pad_maxv_1e-05"


class PlainNumpy(pickle.Unpickler):
    """Refuses everything but numpy's arrays."""

    def find_class(self, module: str, name: str) -> object:
        if module.split(".")[0] != "numpy":
            raise pickle.UnpicklingError(f"{module}.{name}")
        return super().find_class(module, name)


class Pad:
    """What TactileRobot._load_tac_fabrications makes of an entry of the list."""

    def __init__(self, path: Path) -> None:
        self.folder = path.parent
        self.entry = json.loads(path.read_text())[0]
        grid = pyvista.read(path.parent / self.entry["mesh_vtk_file"])
        assert isinstance(grid, pyvista.UnstructuredGrid)
        self.grid = grid
        with (path.parent / self.entry["mesh_metadata_file"]).open("rb") as file:
            self.metadata = PlainNumpy(file).load()
        turn = Rotation.from_euler("xyz", self.entry["rot"]).as_matrix()
        assert np.array_equal(turn, np.eye(3)) and self.entry["pos"] == [0, 0, 0]
        self.config = json.loads((path.parent / "vbts_config.json").read_text())

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

    def markers(self, points: np.ndarray) -> np.ndarray:
        corners = points[self.metadata["marker_vert_idx"]]
        return (self.metadata["marker_bc_coords"][..., None] * corners).sum(axis=1)


@pytest.fixture(scope="module")
def pad(mini: SensorProfile, tmp_path_factory: pytest.TempPathFactory) -> Pad:
    out = tmp_path_factory.mktemp("taccel") / "out"
    export_profile(mini, "taccel", out)
    return Pad(out / "tac_fabr.json")


def test_tets_are_positive_and_in_metres(pad: Pad, mini: SensorProfile) -> None:
    assert set(pad.grid.celltypes) == {10}
    corners = np.asarray(pad.grid.points)[pad.grid.cells.reshape(-1, 5)[:, 1:]]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(mini.mesh.volumes_m3().sum(), rel=1e-12)
    z = np.asarray(pad.grid.points)[:, 2]
    # Touched from -z, apex at 0, 4 mm thick.
    assert z.min() == pytest.approx(0.0, abs=1e-12) and z.max() == pytest.approx(4e-3)
    surface = pyvista.read(pad.folder / pad.entry["mesh_path"])
    assert isinstance(surface, pyvista.PolyData) and surface.is_manifold
    assert surface.volume == pytest.approx(volumes.sum(), rel=1e-5)


def test_masks(pad: Pad, mini: SensorProfile) -> None:
    stick, coat = pad.metadata["stick_mask"], pad.metadata["coat_mask"]
    assert set(np.flatnonzero(stick)) == set(mini.mesh.bonded_nodes())
    assert not (stick & coat).any()
    assert set(np.flatnonzero(coat)) <= set(mini.mesh.region_nodes(Region.CONTACT))
    nodes = np.asarray(pad.grid.points)
    assert nodes[stick, 2].min() > nodes[coat, 2].max()
    surface = pad.grid.extract_surface(algorithm="dataset_surface")
    original = np.asarray(surface.point_data["vtkOriginalPointIds"])
    assert np.array_equal(coat[original], pad.metadata["coat_mask_surf"])
    assert np.array_equal(
        original[pad.metadata["marker_vert_idx_surf"]], pad.metadata["marker_vert_idx"]
    )
    assert np.array_equal(pad.metadata["surface_index"], pad.metadata["marker_vert_idx_surf"])


def test_markers_keep_their_places(pad: Pad, mini: SensorProfile) -> None:
    assert mini.markers is not None
    wanted = mini.markers.grid().points_mm()
    found = pad.markers(np.asarray(pad.grid.points)) * 1e3
    in_gel = found @ TACCEL_FROM_GEL  # the inverse of the half turn is itself
    middle = mini.grid().gel_from_pixel(np.array([159.5, 119.5]))
    np.testing.assert_allclose(in_gel[:, :2] + middle, wanted, atol=1e-9)
    assert pad.metadata["marker_bc_coords"].sum(axis=1) == pytest.approx(1.0)


def test_a_press_lands_at_the_same_pixel(pad: Pad, mini: SensorProfile) -> None:
    u, v = 232, 71
    at = mini.grid().gel_from_pixel(np.array([u, v])) * 1e-3
    nodes = mini.mesh.nodes_m
    dent = np.exp(-((nodes[:, :2] - at) ** 2).sum(axis=1) / (2 * 2e-3**2))
    pushed = nodes - np.outer(dent * (nodes[:, 2] + 4e-3) / 4, [0, 0, 1])
    origin = np.append(mini.grid().gel_from_pixel(np.array([159.5, 119.5])) * 1e-3, 0)
    present = (pushed - origin) @ TACCEL_FROM_GEL.T
    rest = np.asarray(pad.grid.points)
    np.testing.assert_allclose((nodes - origin) @ TACCEL_FROM_GEL.T, rest, atol=1e-12)
    depth = pad.depth_image(present) - pad.depth_image(rest)
    # Flipped rows, then the middle of the square.
    depth = depth[::-1][40:280]
    assert depth.shape == (240, 320) and np.nanmax(depth) > 5e-4
    row, column = np.unravel_index(int(np.nanargmax(depth)), depth.shape)
    # The mesh has elements of about half a millimetre, 8 px.
    assert abs(column - u) < 10 and abs(row - v) < 10


def test_the_values_of_the_configuration(pad: Pad, mini: SensorProfile) -> None:
    config = pad.config
    assert config["E"] == 460e3 and config["nu"] == 0.46 and config["mu"] == 1.0
    assert config["density"] == 1000.0
    assert config["cam_pixel_size"] == pytest.approx(0.0634)
    assert config["cam_h"] == config["cam_w"] == 320
    # 320 px of 0.0634 mm from 19.7 mm.
    assert config["cam_fov"] == pytest.approx(np.degrees(2 * np.arctan(10.144 / 19.7127)), rel=1e-3)


def test_the_same_arrays_as_a_shipped_pad(pad: Pad) -> None:
    shipped = np.load(real_data(f"{SHIPPED}.npz"))
    grid = pyvista.read(real_data(f"{SHIPPED}.vtk"))
    assert isinstance(grid, pyvista.UnstructuredGrid)
    assert set(shipped.files) <= set(pad.metadata)
    for name in shipped.files:
        mine = pad.metadata[name]
        assert mine.dtype == shipped[name].dtype and mine.shape[1:] == shipped[name].shape[1:]
    assert set(grid.celltypes) == set(pad.grid.celltypes)
    # Both are touched from -z with the face at 0.
    for nodes, metadata in ((grid.points, shipped), (pad.grid.points, pad.metadata)):
        coat = np.asarray(nodes)[metadata["coat_mask"]]
        assert coat[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        assert np.asarray(nodes)[metadata["stick_mask"], 2].min() > 0


def test_without_markers_the_arrays_are_empty(digit: SensorProfile, tmp_path: Path) -> None:
    document = export_profile(digit, "taccel", tmp_path / "out")
    pad = Pad(tmp_path / "out" / "tac_fabr.json")
    assert pad.metadata["marker_vert_idx"].shape == (0, 3)
    assert pad.config["with_marker"] is False
    assert "taccel-lab calibrate markers" in document["left_out"]["markers"]


def test_turned_markers_with_gaps(mini: SensorProfile, tmp_path: Path) -> None:
    assert mini.markers is not None
    markers = mini.markers.replace(rotation_deg=8.0, missing=((0, 0), (3, 4)))
    export_profile(mini.with_block(markers), "taccel", tmp_path / "out")
    pad = Pad(tmp_path / "out" / "tac_fabr.json")
    assert pad.metadata["marker_vert_idx"].shape == (61, 3)
    found = pad.markers(np.asarray(pad.grid.points)) * 1e3 @ TACCEL_FROM_GEL
    middle = mini.grid().gel_from_pixel(np.array([159.5, 119.5]))
    np.testing.assert_allclose(found[:, :2] + middle, markers.grid().points_mm(), atol=1e-9)


def test_pixels_of_two_scales_become_those_of_their_mean(mini: SensorProfile) -> None:
    camera = mini.camera.replace(mm_per_px_y=1.21 * mini.camera.mm_per_px_x)
    config = vbts_config(mini.with_block(camera))
    assert config["cam_pixel_size"] == pytest.approx(1.1 * mini.camera.mm_per_px_x)
