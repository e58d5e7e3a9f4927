# SPDX-License-Identifier: Apache-2.0
"""Materials refuse what their energy cannot represent, and say which tet it is."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.scene import Element, Material, MaterialField, MaterialModel, SoftBody
from tests.support.blocks import block_mesh

MOONEY = MaterialModel.MOONEY_RIVLIN


def test_neo_hookean_is_the_default() -> None:
    assert Material(1e5, 0.4).model is MaterialModel.NEO_HOOKEAN
    assert MaterialField(1e5, 0.4).model is MaterialModel.NEO_HOOKEAN


def test_constants_of_mooney_rivlin() -> None:
    material = Material.mooney_rivlin(c10_pa=3e4, c01_pa=1e4, bulk_modulus_pa=2e6)
    assert material.shear_modulus_pa == pytest.approx(8e4)
    assert material.lame_lambda_pa + 2 / 3 * material.shear_modulus_pa == pytest.approx(2e6)
    assert material.mooney_ratio == pytest.approx(0.25)
    assert material.model is MOONEY


@pytest.mark.parametrize("model", list(MaterialModel))
def test_incompressible_is_refused(model: MaterialModel) -> None:
    with pytest.raises(InputError, match="incompressible"):
        Material(1e5, 0.5, model=model)
    with pytest.raises(InputError, match=r"of tet 2 .*incompressible"):
        MaterialField(1e5, np.array([0.4, 0.45, 0.5]), model=model)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mooney_ratio": 0.1}, "mooney_rivlin only"),
        ({"model": "mooney_rivlin"}, "model must be one of neo_hookean"),
        ({"model": MOONEY, "mooney_ratio": 1.2}, r"\[0, 1\], got 1.2"),
        ({"model": MOONEY, "mooney_ratio": -0.1}, r"\[0, 1\], got -0.1"),
        ({"model": MOONEY, "mooney_ratio": float("nan")}, "got nan"),
        ({"model": MOONEY, "mooney_ratio": 0.5, "poisson_ratio": 0.2}, "at least 0.25"),
    ],
)
@pytest.mark.parametrize("kind", [Material, MaterialField])
def test_bad_parameters_are_refused(kind: type, arguments: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        kind(**{"young_modulus_pa": 1e5, "poisson_ratio": 0.4, **arguments})


@pytest.mark.parametrize(
    ("constants", "message"),
    [
        ((-1.0, 2.0, 1e6), "c10 must be zero or positive"),
        ((1e4, float("nan"), 1e6), "c01 must be zero or positive"),
        ((0.0, 0.0, 1e6), "must be positive"),
        ((1e4, 0.0, 0.0), "bulk modulus must be positive"),
        ((1e4, 1e4, 2e4), "at least 0.25"),
    ],
)
def test_bad_mooney_constants_are_refused(constants: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Material.mooney_rivlin(*constants)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"young_modulus_pa": np.array([1e5, -1e5])}, "of tet 1 must lie"),
        ({"young_modulus_pa": np.array([np.nan, 1e5])}, "of tet 0 must lie"),
        ({"density_kg_m3": np.array([1e3, 1e3, 0.0])}, "density of tet 2"),
        ({"young_modulus_pa": np.full(3, 1e5), "poisson_ratio": np.full(4, 0.4)}, r"\(3,\)"),
        ({"young_modulus_pa": np.full((3, 1), 1e5)}, r"arrays \[tet_count\]"),
        (
            {
                "poisson_ratio": np.array([0.4, 0.1]),
                "model": MOONEY,
                "mooney_ratio": np.array([0.3, 0.4]),
            },
            "of tet 1",
        ),
    ],
)
def test_bad_fields_are_refused(arguments: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        MaterialField(**{"young_modulus_pa": 1e5, "poisson_ratio": 0.4, **arguments})


def test_a_field_belongs_to_a_mesh() -> None:
    mesh = block_mesh((1, 1, 1), (1e-3, 1e-3, 1e-3))
    SoftBody(mesh, MaterialField(np.full(6, 1e5), 0.4), element=Element.LINEAR)
    with pytest.raises(InputError, match="moduli of 5 tets, the mesh has 6 tets"):
        SoftBody(mesh, MaterialField(np.full(5, 1e5), 0.4), element=Element.LINEAR)


def test_a_field_keeps_its_own_values() -> None:
    young = np.full(6, 1e5)
    field = MaterialField(young, 0.4)
    young[:] = -1
    assert field.largest_young_modulus_pa == 1e5
    with pytest.raises(ValueError, match="read-only"):
        np.asarray(field.young_modulus_pa)[0] = 1
