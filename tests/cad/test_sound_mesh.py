# SPDX-License-Identifier: Apache-2.0
"""Where nobody asks for an edge length, a mesh that is unsound by a hair is made a little finer."""

from __future__ import annotations

import pytest

from taccel_lab.cad.mesh.gel_mesh import gel_mesh, usual_edge_mm
from taccel_lab.cad.mesh.quality import QualityGate, check_quality, measure_quality
from taccel_lab.cad.mesh.sound_mesh import SHORTER, sound_gel_mesh
from taccel_lab.sensors.registry import sensor_family


def test_a_digit_cast_flat_gets_a_sound_mesh() -> None:
    """The usual mesh has tets of 8.4 degrees at its fillet."""
    pad = sensor_family("digit").parameters({"mid_radius_mm": 0, "roll_off": 0}).pad()
    usual = gel_mesh(pad)
    assert not check_quality(usual, measure_quality(usual, pad)).passed
    mesh, quality, edge_mm = sound_gel_mesh(pad)
    assert check_quality(mesh, quality, QualityGate().at_edge(edge_mm)).passed
    assert edge_mm in [pytest.approx(share * usual_edge_mm(pad)) for share in SHORTER[1:]]


def test_a_sound_mesh_stays_the_usual_one() -> None:
    pad = sensor_family("flat_pad").parameters().pad()
    mesh, _, edge_mm = sound_gel_mesh(pad)
    assert edge_mm == usual_edge_mm(pad)
    assert (mesh.nodes_m == gel_mesh(pad).nodes_m).all()
