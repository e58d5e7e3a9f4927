# SPDX-License-Identifier: Apache-2.0
"""Presses use the moduli of the layer that each tet belongs to."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.envs import profile_material
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.profile import LayerMaterial, MaterialBlock, Provenance
from taccel_lab.scene import Element, Material, MaterialField, SoftBody

SKIN = LayerMaterial(name="skin", young_modulus_pa=9e5, poisson_ratio=0.3, density_kg_m3=1200.0)


def block(*layers: LayerMaterial) -> MaterialBlock:
    return MaterialBlock(
        young_modulus_pa=2e5,
        poisson_ratio=0.45,
        density_kg_m3=1000.0,
        friction_coefficient=0.5,
        layers=layers,
        provenance=Provenance(kind="assumed", method="made up for a test", source="none"),
    )


def mesh(layers: list[int]) -> TetMesh:
    nodes = np.array([[0, 0, 0], [1, 0, -1], [0, 1, -1], [0, 0, -1], [1, 1, 0]]) * 1e-3
    tets = np.array([[0, 2, 1, 3], [0, 1, 2, 4]])
    faces = boundary_faces(tets)
    return TetMesh(nodes, tets, faces, np.zeros(len(faces)), tet_layers=np.array(layers))


def test_each_tet_has_the_moduli_of_its_layer() -> None:
    body = mesh([1, 0])
    found = profile_material(block(SKIN), body)
    assert isinstance(found, MaterialField)
    assert np.array_equal(found.young_modulus_pa, [9e5, 2e5])
    assert np.array_equal(found.poisson_ratio, [0.3, 0.45])
    assert np.array_equal(found.density_kg_m3, [1200.0, 1000.0])
    assert SoftBody(body, found, element=Element.LINEAR).material is found


@pytest.mark.parametrize(("layer", "young"), [(0, 2e5), (1, 9e5)])
def test_a_mesh_of_one_layer_is_uniform(layer: int, young: float) -> None:
    found = profile_material(block(SKIN), mesh([layer, layer]))
    assert isinstance(found, Material) and found.young_modulus_pa == young


def test_a_layer_without_material_is_refused() -> None:
    with pytest.raises(InputError, match="layer 1"):
        profile_material(block(), mesh([0, 1]))
