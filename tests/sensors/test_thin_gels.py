# SPDX-License-Identifier: Apache-2.0
"""Gels down to 0.8 mm: they build, mesh well, and feel what closed forms of thin layers say."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.cad.mesh.quality import measure_quality
from taccel_lab.cad.parts.height_pad import MIN_WALL_MM
from taccel_lab.errors import InputError
from taccel_lab.presses import PressEnv, parse_indenter
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.scene import Material
from taccel_lab.sensors.press_mesh import pad_press_mesh
from taccel_lab.sensors.registry import sensor_family


@pytest.mark.thorough(cases=("9dtact-0.8", "9dtact-1.0", "9dtact-2.0"))
@pytest.mark.parametrize("thickness_mm", [0.8, 1.0, 2.0])
@pytest.mark.parametrize("name", ["digit", "9dtact", "flat_pad"])
def test_thin_gels_mesh_well(name: str, thickness_mm: float) -> None:
    pad = sensor_family(name).parameters({"thickness_mm": thickness_mm}).pad()
    assert pad.figures()["wall_height_min"] >= MIN_WALL_MM
    assert measure_quality(gel_mesh(pad), pad).min_dihedral_deg > 10


def test_a_thin_digit_is_flatter_and_the_usual_one_as_ever() -> None:
    digit = sensor_family("digit")
    assert digit.parameters().pad().mid_radius_mm == 21.4  # type: ignore[attr-defined]
    radii = [
        digit.parameters({"thickness_mm": t}).pad().mid_radius_mm  # type: ignore[attr-defined]
        for t in (3.0, 2.0, 1.0)
    ]
    assert 21.4 < radii[0] < radii[1] < radii[2]
    with pytest.raises(InputError, match="thickness_mm must be at least"):
        digit.parameters({"thickness_mm": 2.0, "thin_crown": "kept"})
    flat = digit.parameters({"thickness_mm": 1.0, "mid_radius_mm": 0, "roll_off": 0}).pad()
    assert float(flat.top_mm(np.array([4.0, 4.0]))) == pytest.approx(0.0)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("tool", "poisson"),
    [
        pytest.param("sphere:2", 0.46, marks=pytest.mark.slow),
        pytest.param("sphere:4", 0.46, marks=pytest.mark.slow),
        ("sphere:2", 0.499),
    ],
)
def test_a_ball_on_a_gel_of_0_8_mm_feels_the_closed_form(tool: str, poisson: float) -> None:
    pad = sensor_family("flat_pad").parameters({"thickness_mm": 0.8}).pad()
    indenter = parse_indenter(tool)
    mesh = pad_press_mesh(pad, (0.0, 0.0), indenter.contact(0.16))
    env = PressEnv(mesh, Material(1e5, poisson), indenter, np.zeros((1, 2)))
    for depth in (0.08, 0.16):
        report = env.try_to(np.array([depth]), np.zeros((1, 2)), 0.0, stay=np.zeros(1, dtype=bool))
        assert report.converged.all()
        force = layer_force_n("sphere", np.array([depth]), float(tool[-1]), 0.8, poisson, 1e5)[0]
        assert env.wrench[0, 2] == pytest.approx(force, rel=0.03)
