# SPDX-License-Identifier: Apache-2.0
"""The solid against closed forms and integrals; STEP and STL come back as they were written."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from build123d import import_step

from taccel_lab.cad.export import dimensions, write_step, write_stl
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region

DOME = {"crown_radius_x_mm": 50.0, "crown_radius_y_mm": 50.0, "thickness_mm": 5.0}
OUTLINE_AREA = 24 * 20 - (4 - np.pi) * 2**2


@pytest.fixture(scope="module")
def dome() -> LabelledSolid:
    return labelled_solid(GelPad(**DOME))


def integrated_volume(pad: GelPad, cells: int = 1200) -> float:
    """Midpoint rule over a quarter of the bounding rectangle, all of which are alike [mm^3]."""
    axes = [
        (np.arange(cells // 2) + 0.5) / cells * length
        for length in (pad.length_x_mm, pad.length_y_mm)
    ]
    xy = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = pad.inside_distance_mm(xy) > 0
    column = (pad.height_mm(xy) + pad.thickness_mm) * inside
    area = pad.length_x_mm * pad.length_y_mm
    # What the rule misses of the rounded corners is nearly a wall high.
    missed = (pad.outline.area_mm2 - inside.mean() * area) * pad.min_wall_mm()
    return float(column.mean() * area + missed)


def test_flat_pad_has_the_volume_and_areas_of_a_prism() -> None:
    part = labelled_solid(GelPad(thickness_mm=4))
    assert part.solid.volume == pytest.approx(4 * OUTLINE_AREA, rel=1e-9)
    assert part.area_mm2(Region.CONTACT) == pytest.approx(OUTLINE_AREA, rel=1e-9)
    assert part.area_mm2(Region.WINDOW) == pytest.approx(18 * 14, rel=1e-9)
    assert part.area_mm2(Region.BOND) == pytest.approx(OUTLINE_AREA - 18 * 14, rel=1e-9)
    perimeter = 2 * (24 + 20) - 8 * 2 + 2 * np.pi * 2
    assert part.area_mm2(Region.SIDE) == pytest.approx(4 * perimeter, rel=1e-9)


@pytest.mark.parametrize(
    ("values", "tolerance"),
    [
        (DOME, 1e-5),
        ({"crown_radius_x_mm": 189.0, "crown_radius_y_mm": 114.0}, 1e-5),
        ({"crown_radius_x_mm": 60.0}, 1e-5),
        ({"rim": "chamfer", "rim_mm": 0.8}, 1e-5),
        # The midpoint rule is slow where the fillet meets the wall.
        ({"rim": "fillet", "rim_mm": 0.8}, 3e-5),
        # The kernel's rim rolls on the sphere, the formula on its tangent plane.
        ({"rim": "chamfer", **DOME}, 2e-4),
        ({"rim": "fillet", **DOME}, 2e-4),
    ],
)
def test_solid_and_formulas_agree(values: dict[str, object], tolerance: float) -> None:
    pad = GelPad(**values)  # type: ignore[arg-type]
    part = labelled_solid(pad)
    assert part.volume_mm3 == pytest.approx(integrated_volume(pad), rel=tolerance)
    surface = tessellate_solid(part)
    top = surface.vertices_mm[np.unique(surface.triangles[surface.regions == Region.CONTACT])]
    inside = pad.inside_distance_mm(top[:, :2]) > pad.rim_setback_mm() + 1e-3
    np.testing.assert_allclose(top[inside, 2], pad.height_mm(top[inside, :2]), atol=2e-4)


def test_step_comes_back_with_volume_and_face_names(dome: LabelledSolid, tmp_path: Path) -> None:
    path = tmp_path / "pad.step"
    write_step(dome, path)
    again = import_step(path)
    assert again.volume == pytest.approx(dome.solid.volume, rel=1e-9)
    names = re.findall(r"ADVANCED_FACE\('(\w*)'", path.read_text())
    assert names == [region.name.lower() for region in dome.regions]
    assert set(names) == {"contact", "bond", "window", "side"}


def test_stl_is_closed_and_in_millimetres(dome: LabelledSolid, tmp_path: Path) -> None:
    import pyvista as pv

    path = tmp_path / "pad.stl"
    write_stl(tessellate_solid(dome), path)
    surface = pv.read(path)
    assert isinstance(surface, pv.PolyData)
    assert surface.clean().n_open_edges == 0
    assert surface.volume == pytest.approx(dome.solid.volume, rel=5e-4)


def test_tessellation_is_closed_outward_and_close(dome: LabelledSolid) -> None:
    surface = tessellate_solid(dome)
    assert surface.volume_mm3() == pytest.approx(dome.solid.volume, rel=5e-4)
    normals = surface.normals()
    assert (normals[surface.regions == Region.CONTACT, 2] > 0.9).all()
    back = np.isin(surface.regions, [Region.BOND, Region.WINDOW])
    np.testing.assert_allclose(normals[back, 2], -1)
    assert np.abs(normals[surface.regions == Region.SIDE, 2]).max() < 1e-3


def test_dimensions_measure_the_solid(dome: LabelledSolid) -> None:
    found = dimensions(dome, GelPad(**DOME))
    np.testing.assert_allclose(found["bounding_box_min"], [-12, -10, -5], atol=1e-6)
    # The box of an analytic sphere face may be padded by the kernel's tolerance.
    np.testing.assert_allclose(found["bounding_box_max"], [12, 10, 0], atol=1e-5)
    drop = 50 - np.sqrt(50**2 - 9**2 - 7**2)
    assert found["crown_drop_at_window_corner"] == pytest.approx(drop)


def test_tessellation_tolerance_has_bounds(dome: LabelledSolid) -> None:
    with pytest.raises(InputError, match="tolerance_mm"):
        tessellate_solid(dome, tolerance_mm=0)
