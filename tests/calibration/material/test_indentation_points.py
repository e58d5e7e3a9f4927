# SPDX-License-Identifier: Apache-2.0
"""Force-depth points: what is kept of a record, and units and signs that no gel can have."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.material.gel import Gel
from taccel_lab.calibration.material.indentation_points import (
    IndentationPoints,
    points_of_record,
    require_plausible,
)
from taccel_lab.errors import InputError
from taccel_lab.presses.bonded_layer import layer_force_n
from tests.calibration.material.made_up import record

DEPTH = np.linspace(0.1, 1.0, 10)
FORCE = layer_force_n("sphere", DEPTH, 4.0, 4.0, 0.48, 3e5)


def read(gel: Gel, depth: np.ndarray, force: np.ndarray) -> IndentationPoints:
    return points_of_record(record("indentation", depth_mm=depth, force_n=force), gel, None)


def test_the_closed_form_starts_at_the_modulus(gel: Gel) -> None:
    modulus, remarks = require_plausible([read(gel, DEPTH, FORCE)], 4.0, 0.48)
    assert modulus == pytest.approx(3e5, rel=1e-6)
    assert not remarks


@pytest.mark.parametrize(
    ("force", "depth", "unit"),
    [
        (1 / 9.80665e-3, 1.0, "force in grams"),
        (1e3, 1.0, "force in mN"),
        (1.0, 1e-3, "depth in m "),
        (1.5, 0.1, "depth in cm"),
        (1e-3, 1.0, "force in kN"),
    ],
)
def test_a_wrong_unit_is_named(gel: Gel, force: float, depth: float, unit: str) -> None:
    points = read(gel, DEPTH * depth, FORCE * force)
    with pytest.raises(InputError, match=unit.strip()) as error:
        require_plausible([points], 4.0, 0.48)
    assert "1e+07" in str(error.value)


def test_soft_gels_in_grams_are_doubted(gel: Gel) -> None:
    _, remarks = require_plausible([read(gel, DEPTH, FORCE / 6 / 9.80665e-3)], 4.0, 0.48)
    assert [remark.code for remark in remarks] == ["unusual_modulus"]
    assert "grams" in remarks[0].message


@pytest.mark.parametrize(
    ("depth", "force", "words"),
    [
        (-DEPTH, FORCE, "no row lies below first touch"),
        (DEPTH, np.where(DEPTH < 0.75, 0.0, FORCE), "counted from first touch"),
    ],
)
def test_depths_that_are_not_from_first_touch_are_refused(gel: Gel, depth, force, words) -> None:
    with pytest.raises(InputError, match=words):
        read(gel, depth, force)


def test_tools_are_checked(gel: Gel) -> None:
    from taccel_lab.calibration.capture.schema import ToolEntry

    with pytest.raises(InputError, match="radius of the cylinder is missing"):
        gel.tool(ToolEntry(kind="cylinder"))
    with pytest.raises(InputError, match="beside the pad"):
        gel.tool(ToolEntry(kind="sphere", radius_mm=4.0, center_mm=(30.0, 0.0)))
    with pytest.raises(InputError, match="at most 100 mm"):
        gel.tool(ToolEntry(kind="sphere", radius_mm=400.0))
    assert gel.tool(ToolEntry(kind="sphere"), 3.0).radius_mm == 3.0
    assert gel.tool(ToolEntry(kind="flat")).description.startswith("box:")
