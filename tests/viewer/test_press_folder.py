# SPDX-License-Identifier: Apache-2.0
"""What ``press --states`` keeps is what the press left, step by step."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.cli.app import main
from taccel_lab.envs import PHYSICS, Accuracy
from taccel_lab.errors import InputError
from taccel_lab.scene import Element
from taccel_lab.viewer.press_folder import STATES, read_press
from tests.support.small_captures import write_profile


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("press")
    profile = write_profile(root / "unit")
    fast = replace(PHYSICS[Accuracy.FAST], element=Element.LINEAR)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PHYSICS, Accuracy.FAST, fast)
        patch.setattr("taccel_lab.envs.press_files.PREDICTED_PX", 64)
        patch.setattr("taccel_lab.envs.press_files.STATES_PX", 64)
        words = ["press", str(profile), "--indenter", "sphere:2", "--depth-mm", "0.2"]
        words += ["--step-mm", "0.1", "--accuracy", "fast", "--friction", "0", "--states"]
        assert main([*words, "--out", str(root / "press")]) == 0
    return root / "press"


def test_every_step_is_there_and_the_last_is_the_end(folder: Path) -> None:
    states = read_press(folder)
    assert states.count == 3 and len(states.captions) == 3
    assert states.captions[0] == "untouched" and "depth 0.20 mm" in states.captions[2]
    assert not states.moved_mm[0].any()
    (folder / STATES).rename(folder / "aside.npz")
    try:
        end = read_press(folder)
    finally:
        (folder / "aside.npz").rename(folder / STATES)
    np.testing.assert_allclose(states.moved_mm[2], end.moved_mm[1], atol=1e-6)
    assert [field.label for field in end.fields] == [field.label for field in states.fields]
    for mine, theirs in zip(states.fields, end.fields, strict=True):
        np.testing.assert_allclose(mine.values[2], theirs.values[1], rtol=1e-4, atol=1e-6)
    assert states.fields[0].values[2].max() > 1 > states.fields[0].values[0].max()


def test_forces_are_those_of_the_tool_on_the_gel_and_the_tool_comes_down(folder: Path) -> None:
    states = read_press(folder)
    force = json.loads((folder / "press.json").read_text())["press"]["wrench"]["force_n"]
    assert states.forces_n is not None and states.tool is not None and states.images is not None
    np.testing.assert_allclose(states.forces_n[2].sum(axis=0), -np.array(force), atol=1e-5)
    z = states.tool.poses[:, 2]
    assert z[0] > z[1] > z[2]
    assert np.linalg.norm(states.tool.vertices_mm, axis=1).max() == pytest.approx(2.0, rel=0.01)
    assert len(states.images.rgb) == 3


def test_states_that_lack_an_array_are_refused_with_the_file(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "press.json").write_text((folder / "press.json").read_text())
    arrays = dict(np.load(folder / STATES))
    del arrays["moved_m"]
    np.savez(tmp_path / STATES, **arrays)
    with pytest.raises(InputError, match=f"{STATES} is not as"):
        read_press(tmp_path)
