# SPDX-License-Identifier: Apache-2.0
"""Places beside a pad's border, where the usual focus of a ball folds."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.geometry.press_mesh_options import DEFAULT_PRESS_MESH
from taccel_lab.sensors.press_mesh import press_mesh
from taccel_lab.sensors.profile import catalogue_profile


@pytest.mark.thorough
def test_a_narrower_focus_is_taken_where_the_usual_one_folds_and_told() -> None:
    """It was refused: folded tets far from the contact."""
    with pytest.warns(UserWarning, match=r"fine part is \d+% as wide"):
        beside = press_mesh("gelsight_r15", {}, (0.0, 13.33), 2.1)
    usual = press_mesh("gelsight_r15", {}, (0.0, 0.0), 2.1)
    assert (beside.tets == usual.tets).all()


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:.*as finely as elsewhere")
@pytest.mark.parametrize("lowest", [0.0, pytest.param(-1.0, marks=pytest.mark.slow)])
def test_every_place_in_the_image_meshes(lowest: float) -> None:
    """12 of 81 were refused; a quarter of the image has three of them."""
    grid = catalogue_profile("gelsight_r15").grid()
    half = 0.475 * np.array([grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y])
    parts = np.linspace(-1, 1, 9)
    for x in half[0] * parts[parts >= lowest]:
        for y in half[1] * parts[parts >= lowest]:
            press_mesh("gelsight_r15", {}, (float(x), float(y)), 1.5)


def test_a_small_contact_on_a_thick_gel_has_more_layers_and_rings() -> None:
    thick = DEFAULT_PRESS_MESH.for_ball(0.22, 10.0, 12.5)
    assert thick.layers > DEFAULT_PRESS_MESH.layers and thick.rings > DEFAULT_PRESS_MESH.rings
    assert DEFAULT_PRESS_MESH.for_ball(1.5, 4.25, 11.5) == DEFAULT_PRESS_MESH
