# SPDX-License-Identifier: Apache-2.0
"""Gels in layers: moduli by tet, and a stiff skin is felt."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.envs import PressEnv, layered_material, parse_indenter
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.scene import Material, MaterialField, MaterialModel
from tests.support.coarse_pads import GEL, pad


def layered_pad() -> TetMesh:
    """The coarse pad, its upper elements a skin."""
    mesh = pad()
    centres = mesh.nodes_m[mesh.tets].mean(axis=1)[:, 2]
    skin = (centres > np.median(centres)).astype(np.int32)
    return TetMesh(mesh.nodes_m, mesh.tets, mesh.faces, mesh.face_regions, skin)


def force(mesh: TetMesh, material: Material | MaterialField) -> float:
    env = PressEnv(mesh, material, parse_indenter("sphere:2"), np.zeros((1, 2)))
    env.move_to(0.3)
    return float(env.wrench[0, 2])


def test_moduli_follow_the_layers() -> None:
    mesh = layered_pad()
    field = layered_material([GEL, Material(1e6, 0.4, 1200.0)], mesh)
    assert isinstance(field, MaterialField)
    skin = mesh.tet_layers == 1
    assert 0 < skin.sum() < len(skin)
    assert np.array_equal(field.young_modulus_pa, np.where(skin, 1e6, 1.5e5))
    assert np.array_equal(field.poisson_ratio, np.where(skin, 0.4, 0.46))
    assert np.array_equal(field.density_kg_m3, np.where(skin, 1200.0, 1000.0))


def test_equal_layers_press_like_one() -> None:
    mesh = layered_pad()
    field = layered_material([GEL, GEL], mesh)
    assert isinstance(field, MaterialField)
    assert force(mesh, field) == pytest.approx(force(pad(), GEL), rel=1e-3)


def test_a_stiffer_skin_is_felt() -> None:
    mesh = layered_pad()
    soft, stiff = (layered_material([GEL, Material(e, 0.46)], mesh) for e in (5e4, 5e5))
    whole = force(pad(), GEL)
    assert force(mesh, soft) < 0.9 * whole < 1.1 * whole < force(mesh, stiff)


def test_bad_layers() -> None:
    assert layered_material([GEL, Material(1e6, 0.4)], pad()) is GEL, "it has one layer"
    with pytest.raises(InputError, match="tets of layer 1, but 1 materials"):
        layered_material([GEL], layered_pad())
    other = Material(1e5, 0.4, model=MaterialModel.STABLE_NEO_HOOKEAN)
    with pytest.raises(InputError, match="layers of one gel must share model"):
        layered_material([GEL, other], layered_pad())
