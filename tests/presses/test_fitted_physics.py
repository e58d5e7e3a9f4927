# SPDX-License-Identifier: Apache-2.0
"""What a profile states of its fit: physics that a press should share."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from taccel_lab.files.atomic_file import to_jsonable
from taccel_lab.presses import PHYSICS, Accuracy, physics_difference
from taccel_lab.profile import FittedWith, MaterialBlock, Provenance

DEFAULT = PHYSICS[Accuracy.DEFAULT]
FITTED = FittedWith(
    physics=to_jsonable(DEFAULT.record()),
    friction_coefficient=0.3,
    friction_measured=False,
    indenters=("sphere:7.5",),
    touch_shift_mm={"press.csv": -0.02},
)


def block(fitted: FittedWith | None, **provenance: Any) -> MaterialBlock:
    about = {"kind": "assumed", "method": "test", "source": "test", **provenance}
    return MaterialBlock(
        young_modulus_pa=2e5, poisson_ratio=0.47, density_kg_m3=1000.0, friction_coefficient=0.3,
        fitted_with=fitted, provenance=Provenance(**about),
    )  # fmt: skip


def test_a_press_like_those_of_the_fit_says_nothing():
    assert physics_difference(block(FITTED), DEFAULT, 0.3) is None
    assert physics_difference(block(None), DEFAULT, 0.3) is None


@pytest.mark.parametrize(
    ("physics", "friction", "words"),
    [
        (DEFAULT, 0.8, "friction 0.3 (this press: 0.8)"),
        (PHYSICS[Accuracy.FAST], 0.3, "accuracy default (this press: fast)"),
        (replace(DEFAULT, dhat_m=2e-5), 0.3, "contact range in metres 1e-05 (this press: 2e-05)"),
        (
            replace(DEFAULT, mesh=replace(DEFAULT.mesh, rings=7)),
            0.3,
            f"mesh.rings {DEFAULT.mesh.rings} (this press: 7)",
        ),
    ],
)
def test_what_differs_is_named(physics, friction, words):
    said = physics_difference(block(FITTED), physics, friction)
    assert words in said and said.count("this press:") == 1


def test_an_older_calibration_is_said_to_be_unknown():
    old = block(
        None, kind="calibrated", inputs={"press.csv": "ab" * 32},
        residuals={"indentation_worst_relative": 0.01}, spread={"young_modulus_pa": 1e3},
        valid_region={"depth_mm": (0.1, 1.0)},
    )  # fmt: skip
    assert "not recorded" in physics_difference(old, DEFAULT, 0.3)
    friction_only = old.provenance.replace(spread={"friction_coefficient": 0.01})
    assert physics_difference(old.replace(provenance=friction_only), DEFAULT, 0.3) is None
