# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab robot list`` and ``show``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from taccel_lab.robots import names
from tests.cli.conftest import Cli
from tests.robots.test_urdf import TETRAHEDRON, with_mesh
from tests.support.robot_files import CHAIN, write

pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")


def test_list(cli: Cli) -> None:
    text = cli("robot list").out
    assert all(name in text for name in names())
    listed = cli.json("robot list")
    assert list(listed) == names()
    assert listed["parallel_gripper"]["from"] == "taccel-lab"
    assert listed["panda"]["from"] == "example-robot-data"


def test_show_of_the_catalogue(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    text = cli("robot show", "parallel_gripper").out
    for word in ("1 coordinates, base palm", "slide_right", "0 to 40 mm", "box 12 x 24 x 60 mm"):
        assert word in text
    assert "refused" not in text


def test_picture(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "hand.png"
    shown = cli("robot show three_finger_hand --picture", path).out
    assert "hand.png" in shown.replace("\n", "")
    pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
    covered = (pixels.min(axis=2) < 230).mean()
    assert 0.1 < covered < 0.9
    wrong = tmp_path / "hand.jpg"
    assert "must end in .png" in cli.refusal("robot show", "three_finger_hand", "--picture", wrong)


def test_show_of_a_file(cli: Cli, tmp_path: Path) -> None:
    shown = cli.json("robot show", str(write(tmp_path, CHAIN)))
    assert shown["coordinates"] == ["shoulder", "lift", "spin"]
    joints = shown["joints"]
    assert joints["lift"]["limits"] == pytest.approx([-50, 100])
    assert joints["shoulder"]["limits"] == pytest.approx([-114.59156, 85.94367])
    assert (joints["lift"]["unit"], joints["spin"]["unit"]) == ("mm", "deg")
    assert joints["spin"]["limits"] == [None, None] and joints["spin"]["kind"] == "continuous"
    assert joints["follow"]["mimics"] == "shoulder" and joints["shoulder"]["max_effort"] == 7
    assert shown["links"]["arm"] == {"mass_kg": 2.0, "shapes": ["box 20 x 30 x 200 mm"]}
    assert shown["links"]["slide"]["shapes"] == ["sphere r 10 mm"]
    assert shown["links"]["wheel"]["shapes"] == ["cylinder r 20, length 10 mm"]
    assert shown["refused"] == []


def test_what_is_refused_is_shown(cli: Cli, tmp_path: Path) -> None:
    # The second face is turned over.
    write(tmp_path, TETRAHEDRON.replace("f 1 2 4", "f 1 4 2"), "mesh.obj")
    path = write(tmp_path, with_mesh("mesh.obj"))
    assert "rejected: collision shape of link 'a': " in cli("robot show", path).out
    planar = write(tmp_path, CHAIN.replace('"continuous"', '"planar"'), "planar.urdf")
    assert "joint 'spin' is planar, which is not supported" in cli.refusal("robot show", planar)
    told = cli.refusal("robot show hand")
    assert "'hand' is neither a file nor a robot of the catalogue: par" in told
