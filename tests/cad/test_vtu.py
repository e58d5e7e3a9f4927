# SPDX-License-Identifier: Apache-2.0
"""VTU files: what is written comes back, VTK reads it, damaged files are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis.extra import numpy as hnp

from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.errors import InputError
from taccel_lab.geometry.vtu import read_mesh_vtu, read_vtu, write_mesh_vtu, write_vtu

MESH = gel_mesh(GelPad(), 2.0)


def test_mesh_comes_back_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "pad.vtu"
    write_mesh_vtu(path, MESH)
    again = read_mesh_vtu(path)
    for name in ("nodes_m", "tets", "faces", "face_regions"):
        assert getattr(again, name).tobytes() == getattr(MESH, name).tobytes()


def test_deformed_positions_and_fields(tmp_path: Path) -> None:
    path = tmp_path / "pressed.vtu"
    rng = np.random.default_rng(0)
    positions = MESH.nodes_m + 1e-5 * rng.normal(size=MESH.nodes_m.shape)
    force = rng.normal(size=(MESH.node_count, 3)).astype(np.float32)
    energy, kind = rng.normal(size=MESH.tet_count), rng.integers(0, 200, MESH.tet_count)
    write_mesh_vtu(
        path, MESH, positions_m=positions, point_data={"force_n": force},
        cell_data={"energy_j": energy, "kind": kind.astype(np.uint8), "fixed": kind > 3},
    )  # fmt: skip
    data = read_vtu(path)
    assert np.array_equal(data.nodes_m, positions)
    assert np.array_equal(data.point_data["force_n"], force)
    assert np.array_equal(data.cell_data["energy_j"][: MESH.tet_count], energy)
    assert np.isnan(data.cell_data["energy_j"][MESH.tet_count :]).all()
    assert np.array_equal(data.cell_data["kind"][: MESH.tet_count], kind)
    assert (data.cell_data["kind"][MESH.tet_count :] == -1).all()
    assert np.array_equal(data.cell_data["fixed"][: MESH.tet_count], kind > 3)


def test_vtk_reads_the_same_mesh(tmp_path: Path) -> None:
    import pyvista as pv

    path = tmp_path / "pad.vtu"
    write_mesh_vtu(path, MESH, point_data={"t": np.arange(MESH.node_count)})
    grid = pv.read(path)
    assert isinstance(grid, pv.UnstructuredGrid)
    assert np.array_equal(grid.points, MESH.nodes_m)
    assert np.array_equal(grid.cells_dict[10], MESH.tets)
    assert np.array_equal(grid.cells_dict[5], MESH.faces)
    assert np.array_equal(grid.cell_data["region"][MESH.tet_count :], MESH.face_regions)
    assert np.array_equal(grid.point_data["t"], np.arange(MESH.node_count))
    assert grid.volume == pytest.approx(MESH.volumes_m3().sum(), rel=1e-9)


@given(
    hnp.arrays(
        np.float64,
        hnp.array_shapes(min_dims=2, max_dims=2, min_side=4, max_side=4),
        elements={"allow_infinity": False},
    )
)
@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_point_arrays_survive(tmp_path: Path, values: np.ndarray) -> None:
    path = tmp_path / "one.vtu"
    nodes = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    write_vtu(path, nodes, np.array([[0, 1, 2, 3]]), {"values": values})
    data = read_vtu(path)
    assert data.point_data["values"].tobytes() == values.tobytes()
    assert len(data.faces) == 0


@pytest.mark.parametrize("keep", [0, 40, 400, 5000, -30])
def test_truncated_files_are_refused(tmp_path: Path, keep: int) -> None:
    path = tmp_path / "pad.vtu"
    write_mesh_vtu(path, MESH)
    path.write_text(path.read_text()[:keep])
    with pytest.raises(InputError, match=r"pad\.vtu"):
        read_mesh_vtu(path)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("UnstructuredGrid", "PolyData", "not a VTK unstructured grid"),
        ('header_type="UInt64"', 'header_type="UInt32"', "64-bit"),
        ('header_type="UInt64"', 'header_type="UInt64" compressor="vtkZLib"', "compressed"),
        ('Name="region"', 'Name="label"', "region"),
        ('format="binary"', 'format="appended"', "inline"),
        ('NumberOfComponents="3"', 'NumberOfComponents="7"', "truncated"),
        ('Name="offsets"', 'Name="ends"', "cell lists"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, old: str, new: str, word: str) -> None:
    path = tmp_path / "pad.vtu"
    write_mesh_vtu(path, MESH)
    text = path.read_text().replace("'", '"')
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=word):
        read_mesh_vtu(path)


def test_arrays_of_other_length_are_refused_and_nothing_is_left(tmp_path: Path) -> None:
    path = tmp_path / "pad.vtu"
    for fields in ({"point_data": {"f": np.zeros(3)}}, {"cell_data": {"f": np.zeros(3)}}):
        with pytest.raises(InputError, match="'f'"):
            write_mesh_vtu(path, MESH, **fields)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="infinite"):
        write_mesh_vtu(path, MESH, point_data={"f": np.full(MESH.node_count, np.inf)})
    with pytest.raises(InputError, match="positions"):
        write_mesh_vtu(path, MESH, positions_m=np.zeros((2, 3)))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="does not exist"):
        read_vtu(path)


def test_inverted_tets_name_the_file(tmp_path: Path) -> None:
    path = tmp_path / "bad.vtu"
    mirrored = MESH.nodes_m * [1, 1, -1]
    write_vtu(path, mirrored, MESH.tets, faces=MESH.faces, face_regions=MESH.face_regions)
    with pytest.raises(InputError, match=r"bad\.vtu.*inverted"):
        read_mesh_vtu(path)
