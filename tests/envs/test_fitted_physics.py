# SPDX-License-Identifier: Apache-2.0
"""A press that is not like those of the fit says so in a sentence."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from taccel_lab.envs import PHYSICS, Accuracy, PressPhysics, physics_difference
from taccel_lab.output import to_jsonable
from taccel_lab.profile import FittedWith, MaterialBlock, Provenance

DEFAULT = PHYSICS[Accuracy.DEFAULT]


def block(fitted: FittedWith | None, **provenance: Any) -> MaterialBlock:
    told = {"kind": "assumed", "method": "test", "source": "test", **provenance}
    return MaterialBlock(
        young_modulus_pa=2e5,
        poisson_ratio=0.47,
        density_kg_m3=1000.0,
        friction_coefficient=0.3,
        fitted_with=fitted,
        provenance=Provenance(**told),
    )


def fitted(friction: float = 0.3) -> FittedWith:
    return FittedWith(
        physics=to_jsonable(DEFAULT.record()),
        friction_coefficient=friction,
        friction_measured=False,
        indenters=("sphere:7.5",),
        touch_shift_mm={"press.csv": -0.02},
    )


def test_a_press_like_those_of_the_fit_says_nothing() -> None:
    assert physics_difference(block(fitted()), DEFAULT, 0.3) is None
    assert physics_difference(block(None), DEFAULT, 0.3) is None


@pytest.mark.parametrize(
    ("physics", "friction", "words"),
    [
        (DEFAULT, 0.8, "friction 0.3 (this press: 0.8)"),
        (PHYSICS[Accuracy.FAST], 0.3, "accuracy default (this press: fast)"),
        (
            dataclasses.replace(DEFAULT, dhat_m=2e-5),
            0.3,
            "contact range in metres 1e-05 (this press: 2e-05)",
        ),
        (
            dataclasses.replace(DEFAULT, mesh=dataclasses.replace(DEFAULT.mesh, rings=7)),
            0.3,
            f"mesh.rings {DEFAULT.mesh.rings} (this press: 7)",
        ),
    ],
)
def test_what_differs_is_named(physics: PressPhysics, friction: float, words: str) -> None:
    said = physics_difference(block(fitted()), physics, friction)
    assert said is not None and words in said
    assert said.count("this press:") == 1


def test_an_older_calibration_is_said_to_be_unknown() -> None:
    old = block(
        None,
        kind="calibrated",
        inputs={"press.csv": "ab" * 32},
        residuals={"indentation_worst_relative": 0.01},
        spread={"young_modulus_pa": 1e3},
        valid_region={"depth_mm": (0.1, 1.0)},
    )
    said = physics_difference(old, DEFAULT, 0.3)
    assert said is not None and "not recorded" in said
    friction_only = old.replace(
        provenance=old.provenance.replace(spread={"friction_coefficient": 0.01})
    )
    assert physics_difference(friction_only, DEFAULT, 0.3) is None
