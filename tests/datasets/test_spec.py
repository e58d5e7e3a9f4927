# SPDX-License-Identifier: Apache-2.0
"""The file of a data set: what is wrong is said before anything is simulated."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.datasets.plan import Plan
from taccel_lab.datasets.spec import DatasetSpec, load_spec
from taccel_lab.errors import InputError
from taccel_lab.profile import save_profile
from tests.support.small_data_sets import plan, small_profile, table

EXAMPLES = Path(__file__).parents[2] / "datasets" / "examples"


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_examples_are_sound(path: Path, tmp_path: Path) -> None:
    # What a reader has of their own lies beside the file: a profile with a spread.
    beside = tmp_path / "examples"
    shutil.copytree(EXAMPLES, beside)
    save_profile(small_profile(), beside / "my_mini")
    made = Plan(load_spec(beside / path.name), beside)
    assert len(made.episodes) == made.spec.dataset.episodes
    assert {e.split for e in made.episodes} == {"train", "test"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dataset": {"seeds": 1}}, r"dataset\.seeds: unknown key; allowed: name, episodes, seed"),
        ({"dataset": {"episodes": 0}}, r"dataset\.episodes: .*greater than or equal to 1"),
        ({"motions": [{"kind": "push", "depth_mm": [0.1, 0.2]}]}, r"motions\.0\.kind: .*'press'"),
        ({"motions": [{"kind": "press", "depth_mm": [0.3, 0.2]}]}, "wrong way round"),
        ({"motions": [{"kind": "press", "depth_mm": [0.0, 0.2]}]}, "above 0, got 0"),
        ({"motions": [{"kind": "shear", "depth_mm": [0.1, 0.2]}]}, "needs shear_mm"),
        (
            {"motions": [{"kind": "press", "depth_mm": [0.1, 0.2], "twist_deg": [0, 1]}]},
            "twist_deg belongs to twist, not to press",
        ),
        (
            {"motions": [{"kind": "press", "depth_mm": [0.1, 0.2], "step_mm": 1e-4}]},
            r"a touch would take 2e\+03 steps of step_mm = 0\.0001 mm .*; at most 1000",
        ),
        ({"motions": [{"kind": "press", "depth_mm": 0.3}]}, "a list in square brackets is needed"),
        ({"motions": []}, r"motions: list should have at least 1"),
        ({"objects": [{"tool": "sphere:2"}, {"tool": "sphere:2"}]}, "two objects are called"),
        ({"objects": [{"tool": "sphere:2", "tilt_deg": [0, 40]}]}, r"must lie in \[0, 15\]"),
        ({"randomise": {"friction": [0.5, 9]}}, r"friction must lie in \[0, 5\]"),
        ({"output": {"channels": ["rgb", "rgb"]}}, "named twice: rgb"),
        ({"output": {"size_px": [4, 4]}}, r"must lie in 8\.\.8192 px"),
        ({"dataset": {"x_mm": [0, 1], "y_mm": [0, 1], "view": 1}}, "either view, or x_mm and y_mm"),
    ],
)
def test_bad_form(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        DatasetSpec.checked(table("flat_pad", **changes), "small.toml")
    assert str(caught.value).startswith("small.toml: ")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sensors": [{"profile": "nowhere"}]}, "neither a profile folder nor a sensor"),
        ({"objects": [{"tool": "mesh:nowhere.stl"}]}, r"nowhere\.stl"),
        ({"objects": [{"tool": "star:3"}]}, "'star:3' is not understood"),
        (
            {"motions": [{"kind": "press", "depth_mm": [0.1, 60.0]}]},
            r"motions\[0\] on flat_pad: depth 60 mm goes past the gel",
        ),
        (
            {"motions": [{"kind": "press", "depth_mm": [1e-4, 4e-4]}]},
            r"motions\[0\]: depth_mm ends at 0\.0004 mm; .*in metres\?",
        ),
        ({"output": {"channels": ["heat"]}}, "no channel 'heat'; known: rgb, depth_mm"),
        ({"output": {"channels": ["rgb", "wrench"]}}, "'wrench' is always kept; leave it out"),
        ({"sensors": [{"profile": "flat_pad", "units": 3}]}, "states no measured spread"),
        ({"dataset": {"x_mm": [0, 90], "y_mm": [0, 0]}}, r"placed at \(90, 0\) mm: .*choose a"),
    ],
)
def test_what_cannot_be_is_refused(changes: dict[str, Any], message: str) -> None:
    changes = {"output": {"channels": ["depth_mm"]}, **changes}
    with pytest.raises(InputError, match=message):
        plan("flat_pad", **changes)


def test_images_need_a_sensor_that_can_draw_them(tmp_path: Path) -> None:
    save_profile(small_profile().without("color", "background", "lights"), tmp_path / "blind")
    with pytest.raises(InputError, match="neither a colour model nor an optical design"):
        plan(tmp_path / "blind")
