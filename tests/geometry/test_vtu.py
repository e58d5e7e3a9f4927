# SPDX-License-Identifier: Apache-2.0
"""VTU files: what is written comes back through VTK, bad arrays are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.geometry.vtu import write_mesh_vtu
from tests.geometry.vtu_files import read_mesh_vtu

MESH = block_mesh((4, 3, 2), (4e-3, 3e-3, 2e-3), jitter=0.2)


def test_mesh_comes_back_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "pad.vtu"
    write_mesh_vtu(path, MESH)
    again = read_mesh_vtu(path)
    for name in ("nodes_m", "tets", "faces", "face_regions"):
        assert np.array_equal(getattr(again, name), getattr(MESH, name))
    assert again.nodes_m.dtype == np.float64
    assert pyvista.read(path).volume == pytest.approx(MESH.volumes_m3().sum(), rel=1e-9)


def test_deformed_positions_and_fields(tmp_path: Path) -> None:
    path = tmp_path / "pressed.vtu"
    rng = np.random.default_rng(0)
    positions = MESH.nodes_m + 1e-5 * rng.normal(size=MESH.nodes_m.shape)
    force = rng.normal(size=(MESH.node_count, 3)).astype(np.float32)
    pressure = rng.normal(size=MESH.node_count)
    pressure[0] = np.nan
    fields = {"force_n": force, "pressure_pa": pressure}
    write_mesh_vtu(path, MESH, positions_m=positions, point_data=fields)
    grid = pyvista.read(path)
    assert np.array_equal(grid.points, positions)
    for name, values in fields.items():
        assert np.array_equal(grid.point_data[name], values, equal_nan=True)
    assert (grid.cell_data["region"][: MESH.tet_count] == -1).all()


def test_arrays_of_other_length_are_refused_and_nothing_is_left(tmp_path: Path) -> None:
    path = tmp_path / "pad.vtu"
    with pytest.raises(InputError, match="'f'"):
        write_mesh_vtu(path, MESH, point_data={"f": np.zeros(3)})
    with pytest.raises(InputError, match="positions"):
        write_mesh_vtu(path, MESH, positions_m=np.zeros((2, 3)))
    assert list(tmp_path.iterdir()) == []
