# SPDX-License-Identifier: Apache-2.0
"""The surface that a page's reader turns: what is drawn of it, and that fine ones are coarsened."""

from __future__ import annotations

import base64

import numpy as np
import pytest

from taccel_lab.geometry import Region
from taccel_lab.report.mesh_view import MOST_FACES, MeshView, mesh_view


def box(cells: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Surface of a pad of 20 x 20 x 4 mm with a bump: nodes [m], faces, regions."""
    import pyvista as pv

    cells = max(cells, 2)
    sheet = pv.Plane(i_size=0.02, j_size=0.02, i_resolution=cells, j_resolution=cells).triangulate()
    top = np.array(sheet.points, dtype=float)
    top[:, 2] = 0.001 * np.exp(-(top[:, :2] ** 2).sum(axis=1) / 0.004**2)
    bottom = top * [1, 1, 0] - [0, 0, 0.004]
    faces = sheet.regular_faces
    nodes = np.concatenate([top, bottom])
    both = np.concatenate([faces, faces[:, ::-1] + len(top)])
    regions = np.repeat([int(Region.CONTACT), int(Region.BOND)], len(faces))
    return nodes, both, regions


def drawn(view: MeshView) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes from -1 to 1, faces, regions as a browser reads them."""
    nodes = np.frombuffer(base64.b64decode(view.nodes), "<i2").reshape(-1, 3) / 32767
    faces = np.frombuffer(base64.b64decode(view.faces), "<u2").reshape(-1, 3)
    return nodes, faces, np.frombuffer(base64.b64decode(view.regions), "u1")


def area_mm2(view: MeshView) -> float:
    nodes, faces, _ = drawn(view)
    a, b, c = (max(view.size_mm) / 2 * nodes[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_a_surface_is_drawn_as_it_is() -> None:
    nodes, faces, regions = box(20)
    view = mesh_view(nodes, faces, regions)
    assert view is not None
    assert view.drawn_faces == view.faces_in_all == len(faces)
    seen, shown, kinds = drawn(view)
    assert np.array_equal(kinds, regions) and len(seen) == len(nodes) and shown.max() < len(seen)
    assert view.size_mm == pytest.approx((20, 20, 5), abs=0.1)
    assert [name for name, _ in view.legend] == ["contact", "bond"]


def test_a_fine_surface_is_drawn_coarser_with_its_shape_and_borders() -> None:
    coarse, fine = mesh_view(*box(80)), mesh_view(*box(130))
    assert coarse is not None and fine is not None
    assert fine.faces_in_all == 4 * 130**2 > 4 * MOST_FACES
    assert 0.5 * MOST_FACES < fine.drawn_faces <= MOST_FACES
    assert fine.size_mm == pytest.approx(coarse.size_mm, rel=1e-3)
    assert area_mm2(fine) == pytest.approx(area_mm2(coarse), rel=0.01)
    nodes, faces, regions = drawn(fine)
    for region in (Region.CONTACT, Region.BOND):
        own = nodes[np.unique(faces[regions == int(region)])]
        # All 4 x 130 nodes of the region's border are still there.
        assert (np.abs(own[:, :2]).max(axis=1) > 1 - 1e-4).sum() == 4 * 130


def test_nothing_to_draw_is_no_view() -> None:
    none = np.zeros((0, 3), dtype=int)
    assert mesh_view(np.zeros((3, 3)), none, np.zeros(0, dtype=int)) is None
