# SPDX-License-Identifier: Apache-2.0
"""Objects of a simulation say what they are within a screenful; results are drawn by ``plot``."""

from __future__ import annotations

from dataclasses import fields
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.api.study import StudyResult
from taccel_lab.calibration.calibrate import Calibration
from taccel_lab.calibration.unfinished import BlockOutcome, BlockState
from taccel_lab.geometry.block import free_block
from taccel_lab.report.lead import Picture
from taccel_lab.report.page import Page, first_figure
from taccel_lab.studies.evaluate.runner import StudyOutcome

SCREENFUL = 400
"""Characters."""


def page(name: str) -> Page:
    def draw() -> Any:
        from matplotlib.figure import Figure

        figure = Figure()
        figure.suptitle(name)
        return figure

    return Page(name, "", pictures=[Picture("file", lambda: b"png", ""), Picture(name, draw, "")])


def title(figure: Any) -> str:
    return figure.get_suptitle()


def test_a_simulation_describes_itself():
    mesh = free_block((2, 2, 2), 1e-3)
    ball = tl.KinematicBody(tl.Ball(4e-3))
    scene = tl.Scene(
        tl.SoftBody(mesh, tl.Material(1e5, 0.45), bonded_nodes=np.arange(9)), ball, env_count=3
    )
    model = scene.finalize("cpu")
    solver, state = tl.SolverIPC(model), tl.initial_state(model)
    for thing in (mesh, scene, model, solver, state, tl.sphere_mesh(4e-3, 1e-3)):
        assert len(repr(thing)) < SCREENFUL, type(thing)
    assert "env_count = 3" in repr(scene) and f"{mesh.node_count} nodes" in repr(scene)
    assert repr(model).startswith("model of a scene, env_count = 3 on cpu")
    assert "<table>" in scene._repr_html_()
    signals = tl.SignalTactile(mesh, tl.PixelGrid(8, 6, 0.2, 0.2), env_count=3)
    assert "env_count = 3" in repr(signals)


def test_a_calibration_draws_the_figure_of_a_block():
    blocks = tuple(
        BlockOutcome(name, BlockState.DONE, "good", page=page(name)) for name in ("scale", "color")
    )
    pad = tl.load_sensor("flat_pad")
    found = Calibration(pad, pad, Mock(), blocks)
    assert title(found.plot()) == "color" and title(found.plot("scale")) == "scale"
    with pytest.raises(tl.InputError, match="'depth' was not fitted; allowed: scale, color"):
        found.plot("depth")


def test_pages_without_figures_are_named():
    assert title(first_figure([Page("bare", ""), page("drawn")])) == "drawn"
    with pytest.raises(tl.InputError, match="nothing was measured"):
        first_figure([Page("bare", "")])


def test_a_profile_draws_its_untouched_image_or_its_mesh():
    starter = tl.load_sensor("gelsight_mini")
    image = starter.plot().axes[0].images[0]
    left, right, bottom, top = image.get_extent()
    grid = starter.grid()
    assert [right - left, bottom - top] == pytest.approx(
        [grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y]
    )
    assert np.array_equal(image.get_array(), np.asarray(starter.untouched(), dtype=np.uint8))
    bare = tl.load_sensor("flat_pad")
    assert bare.background_rgb is None
    assert "contact face" in bare.plot().axes[0].get_title()


def test_a_study_s_result_is_its_outcome():
    assert [f.name for f in fields(StudyResult)] == [f.name for f in fields(StudyOutcome)]
    assert callable(StudyResult.plot)
