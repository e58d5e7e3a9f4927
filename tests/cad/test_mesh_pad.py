# SPDX-License-Identifier: Apache-2.0
"""A gel known by its mesh alone has the surfaces of the pad that the mesh was made of."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.cad.mesh.mesh_pad import MeshPad
from taccel_lab.cad.parts.gel_pad import GelPad

PAD = GelPad(
    length_x_mm=16, length_y_mm=14, corner_radius_mm=1.5, thickness_mm=4, window_x_mm=10,
    window_y_mm=9, crown_radius_x_mm=40, crown_radius_y_mm=60,
)  # fmt: skip
MESHED = MeshPad(PAD.thickness_mm, mesh=gel_mesh(PAD, 0.7))


def test_surfaces_of_the_mesh_are_those_of_the_formulas() -> None:
    xy = np.stack(np.meshgrid(np.linspace(-7, 7, 23), np.linspace(-6, 6, 19)), axis=-1)
    # Chords of 0.7 mm on a radius of 40 mm lie 0.7^2 / (8 * 40) = 0.0015 mm deep.
    assert MESHED.top_mm(xy) == pytest.approx(PAD.top_mm(xy), abs=6e-3)
    inner = (np.abs(xy) < 5).all(axis=-1)
    cosine = (MESHED.top_normal(xy) * PAD.top_normal(xy)).sum(axis=-1)[inner]
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.3
    assert MESHED.bounds_mm() == pytest.approx(PAD.bounds_mm(), abs=1e-6)
    assert np.isnan(MESHED.top_mm(np.array([20.0, 0.0])))
    assert np.isnan(MESHED.top_normal(np.array([20.0, 0.0]))).all()


def test_distance_to_the_edge_has_the_sign_of_the_side() -> None:
    xy = np.array([[0.0, 0.0], [6.0, 0.0], [0.0, -6.5], [11.0, 0.0], [0.0, 9.0]])
    assert MESHED.inside_distance_mm(xy) == pytest.approx(PAD.inside_distance_mm(xy), abs=0.05)
    assert MESHED.inside_distance_mm(xy[:1]).shape == (1,)


def test_glued_and_touched_surfaces_and_the_volume() -> None:
    points = np.array([[1.0, 2.0, -3.5], [0.0, 0.0, -5.0]])
    assert MESHED.bond_projection_mm(points) == pytest.approx(PAD.bond_projection_mm(points))
    above = np.array([[0.0, 0.0, 0.2]])
    assert MESHED.contact_error_mm(above) == pytest.approx([0.2], abs=4e-3)
    volume = 1e9 * MESHED.mesh.volumes_m3().sum()
    assert MESHED.figures() == {"volume_mm3": pytest.approx(volume)}


def test_equal_gels_have_one_name_and_others_another() -> None:
    assert repr(pickle.loads(pickle.dumps(MESHED))) == repr(MESHED)
    assert repr(MeshPad(PAD.thickness_mm, mesh=gel_mesh(PAD, 0.9))) != repr(MESHED)
    assert gel_mesh(MESHED) is MESHED.mesh
