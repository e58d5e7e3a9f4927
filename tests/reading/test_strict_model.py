# SPDX-License-Identifier: Apache-2.0
"""Models of files take what is written as what it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydantic import Field

from taccel_lab.errors import InputError
from taccel_lab.reading.strict_model import Flag, Number, StrictModel, Whole


class Ball(StrictModel):
    radius_mm: Number = Field(gt=0)
    count: Whole = 1
    hollow: Flag = False


class Box(StrictModel):
    balls: list[Ball] = Field(default_factory=list)


def test_numbers_of_python_and_numpy() -> None:
    ball = Ball(radius_mm=2, count=np.int64(3))  # type: ignore[arg-type]
    assert ball == Ball(radius_mm=2.0, count=3)
    assert type(ball.radius_mm) is float and type(ball.count) is int


@pytest.mark.parametrize(
    "entry",
    ['radius_mm = "2"', "radius_mm = true", "radius_mm = 2\ncount = 3.0", "radius_mm = 2026-01-01",
     "radius_mm = 2\ncount = true", "radius_mm = 2\nhollow = 1", 'radius_mm = 2\nhollow = "no"'],
)  # fmt: skip
def test_nothing_is_taken_for_something_else(tmp_path: Path, entry: str) -> None:
    path = tmp_path / "box.toml"
    path.write_text(f"[[balls]]\n{entry}\n")
    with pytest.raises(InputError, match=r"box\.toml: balls\.0\.\w+: input should be a valid"):
        Box.read(path)


@pytest.mark.parametrize("key", ["self", "model_config", "__class__", "__init__", "cls", '""'])
def test_keys_that_python_has_other_uses_for(tmp_path: Path, key: str) -> None:
    path = tmp_path / "box.toml"
    path.write_text(f"{key} = 1\n")
    with pytest.raises(InputError, match=r"box\.toml: .*: unknown key; allowed: balls"):
        Box.read(path)


def test_an_unknown_key_of_an_inner_table_says_what_is_allowed_there(tmp_path: Path) -> None:
    path = tmp_path / "box.toml"
    path.write_text("[[balls]]\nradius_mm = 2\nradios_mm = 2\n")
    with pytest.raises(
        InputError, match=r"balls\.0\.radios_mm: unknown key; allowed: radius_mm, count, hollow$"
    ):
        Box.read(path)


def test_long_lists_of_faults_are_cut(tmp_path: Path) -> None:
    path = tmp_path / "box.toml"
    path.write_text("balls = [" + "'" + "x" * 5000 + "'," + "1," * 9999 + "]")
    with pytest.raises(InputError, match="and 9980 more faults") as caught:
        Box.read(path)
    assert len(str(caught.value)) < 21 * 300
