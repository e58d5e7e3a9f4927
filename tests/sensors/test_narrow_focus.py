# SPDX-License-Identifier: Apache-2.0
"""Places beside a pad's border, where the usual focus of a ball folds."""

from __future__ import annotations

import pytest

from taccel_lab.sensors.press_mesh import press_mesh


def test_a_narrower_focus_is_taken_where_the_usual_one_folds_and_told() -> None:
    """It was refused: folded tets far from the contact."""
    with pytest.warns(UserWarning, match="fine part is 70% as wide"):
        beside = press_mesh("gelsight_r15", {}, (0.0, 13.33), 2.1)
    usual = press_mesh("gelsight_r15", {}, (0.0, 0.0), 2.1)
    assert (beside.tets == usual.tets).all()
