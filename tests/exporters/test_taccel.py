# SPDX-License-Identifier: Apache-2.0
"""The fabrication list read as Taccel reads it: keys, masks, markers, and where a press lands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista

from taccel_lab.exporters.export import export_profile
from taccel_lab.geometry import Region
from taccel_lab.profile import SensorProfile
from tests.exporters.conftest import Exported
from tests.exporters.consumers import TACCEL, TaccelPad
from tests.support.real_data import real_data

SHIPPED = "taccel_assets/pads/single_sensor__pad_maxv_1e-05"


@pytest.fixture(scope="module")
def pad(exported: Exported) -> TaccelPad:
    return TaccelPad(exported("taccel")[0])


def test_tets_are_positive_and_in_metres(pad: TaccelPad, mini: SensorProfile) -> None:
    assert set(pad.grid.celltypes) == {10}
    corners = pad.nodes[pad.grid.cells.reshape(-1, 5)[:, 1:]]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(mini.mesh.volumes_m3().sum(), rel=1e-12)
    z = pad.nodes[:, 2]
    # Touched from -z, apex at 0, 4 mm thick.
    assert z.min() == pytest.approx(0.0, abs=1e-12) and z.max() == pytest.approx(4e-3)
    surface = pyvista.read(pad.folder / pad.entry["mesh_path"])
    assert isinstance(surface, pyvista.PolyData) and surface.is_manifold
    assert surface.volume == pytest.approx(volumes.sum(), rel=1e-5)


def test_masks(pad: TaccelPad, mini: SensorProfile) -> None:
    stick, coat = pad.metadata["stick_mask"], pad.metadata["coat_mask"]
    assert set(np.flatnonzero(stick)) == set(mini.mesh.bonded_nodes())
    assert not (stick & coat).any()
    assert set(np.flatnonzero(coat)) <= set(mini.mesh.region_nodes(Region.CONTACT))
    nodes = pad.nodes
    assert nodes[stick, 2].min() > nodes[coat, 2].max()
    surface = pad.grid.extract_surface(algorithm="dataset_surface")
    original = np.asarray(surface.point_data["vtkOriginalPointIds"])
    assert np.array_equal(coat[original], pad.metadata["coat_mask_surf"])
    assert np.array_equal(
        original[pad.metadata["marker_vert_idx_surf"]], pad.metadata["marker_vert_idx"]
    )
    assert np.array_equal(pad.metadata["surface_index"], pad.metadata["marker_vert_idx_surf"])


def test_a_press_lands_at_the_same_pixel(pad: TaccelPad, mini: SensorProfile) -> None:
    u, v = 232, 71
    at = mini.grid().gel_from_pixel(np.array([u, v])) * 1e-3
    nodes = mini.mesh.nodes_m
    dent = np.exp(-((nodes[:, :2] - at) ** 2).sum(axis=1) / (2 * 2e-3**2))
    pushed = nodes - np.outer(dent * (nodes[:, 2] + 4e-3) / 4, [0, 0, 1])
    origin = np.append(mini.grid().gel_from_pixel(np.array([159.5, 119.5])) * 1e-3, 0)
    present = (pushed - origin) @ TACCEL.T
    rest = pad.nodes
    np.testing.assert_allclose((nodes - origin) @ TACCEL.T, rest, atol=1e-12)
    depth = pad.depth_image(present) - pad.depth_image(rest)
    # Flipped rows, then the middle of the square.
    depth = depth[::-1][40:280]
    assert depth.shape == (240, 320) and np.nanmax(depth) > 5e-4
    row, column = np.unravel_index(int(np.nanargmax(depth)), depth.shape)
    # The mesh has elements of about half a millimetre, 8 px.
    assert abs(column - u) < 10 and abs(row - v) < 10


def test_the_same_arrays_as_a_shipped_pad(pad: TaccelPad) -> None:
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
    pad = TaccelPad(tmp_path / "out")
    assert pad.metadata["marker_vert_idx"].shape == (0, 3)
    assert pad.config["with_marker"] is False
    assert "taccel-lab calibrate markers" in document["left_out"]["markers"]
