# SPDX-License-Identifier: Apache-2.0
"""Parameters by environment that are refused: with a sentence, and nothing is changed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.model import Model
from taccel_lab.scene import AffineBody, Material, MaterialModel, Plane, Scene, SoftBody, box_mesh
from tests.support.scene_steps import in_time

PAD = block_mesh((3, 3, 2), (6e-3, 6e-3, 3e-3))
MOONEY = Material(1e5, 0.4, model=MaterialModel.MOONEY_RIVLIN, mooney_ratio=0.3)


def refusing_model(friction: float | None = 0.5) -> Model:
    cube = AffineBody(box_mesh((1e-3, 1e-3, 1e-3)), name="cube", friction_coefficient=friction)
    return Scene(
        SoftBody(PAD, MOONEY, name="pad"),
        affine_bodies=cube,
        planes=[Plane(name="table"), Plane(name="wall")],
        time=in_time(1e-2, 0.0),
        env_count=2,
    ).finalize()


@pytest.mark.parametrize(
    ("body", "values", "message"),
    [
        ("pad", {"young_modulus_pa": [1e5, -1.0]}, r"Young's modulus of environment 1 must lie"),
        ("pad", {"young_modulus_pa": [np.nan, 1e5]}, r"of environment 0 must lie in .*got nan"),
        ("pad", {"poisson_ratio": [0.4, 0.5]}, r"ratio of environment 1 must lie in \(-1, 0.5\)"),
        ("pad", {"poisson_ratio": [0.05, 0.4]}, "needs a Poisson's ratio of at least 0.1875"),
        ("pad", {"density_kg_m3": 0.1}, r"density of environment 0 must lie in \[1, 30000\]"),
        ("pad", {"mass_kg": 0.0}, r"mass of environment 0 must lie in \(0, 1e6\] kg"),
        ("pad", {"young_modulus_pa": [1e5, 1e5, 1e5]}, r"number or of shape \[2\] or \[2, 108\]"),
        ("pad", {"young_modulus_pa": "soft"}, "must be numbers of shape"),
        ("pad", {"young_modulus_pa": torch.ones(2)}, "must be float64 of shape .* got float32"),
        ("pad", {}, "nothing is set of body 'pad'"),
        ("pad", {"mass_kg": 1e-3, "density_kg_m3": 1e3}, "either density_kg_m3 or mass_kg"),
        ("gel", {"young_modulus_pa": 1e5}, "0 bodies are called 'gel'; there are 'pad', 'cube'"),
        ("cube", {"young_modulus_pa": 1e9}, "is an affine body, whose stiffness only keeps it"),
        ("table", {"mass_kg": 1.0}, "'table' is prescribed: it has no mass_kg"),
        ("pad", {"young_modulus_pa": 2e5, "mask": [True]}, r"mask is bool of shape \[2\]"),
        ("pad", {"young_modulus_pa": 2e5, "poisson_ratio": 0.6}, r"ratio of environment 0"),
    ],
)
def test_bad_values_change_nothing(body: str, values: dict[str, Any], message: str) -> None:
    model = refusing_model()
    with pytest.raises(InputError, match=message):
        model.set_body(body, **values)
    assert model.changes == model.moves == 0 and model.elastic[0].young_moduli is None


@pytest.mark.parametrize(
    ("pair", "value", "message"),
    [
        (("pad", "cube"), [0.5, -0.1], r"'pad' and 'cube' of environment 1 must lie in \[0, 10\]"),
        (("pad", "cube"), [0.5], r"must be a number or of shape \[2\], got shape \[1\]"),
        (("pad", "hand"), 0.5, "0 bodies are called 'hand'"),
        (("table", "wall"), 0.5, "'table' and 'wall' may not touch"),
    ],
)
def test_bad_friction_is_refused(pair: tuple[str, str], value: Any, message: str) -> None:
    model = refusing_model()
    with pytest.raises(InputError, match=message):
        model.set_friction(*pair, value)
    assert model.changes == model.moves == 0


def test_friction_needs_a_scene_with_friction() -> None:
    with pytest.raises(InputError, match="a coefficient above 0 in the scene first"):
        refusing_model(None).set_friction("pad", "cube", 0.5)
