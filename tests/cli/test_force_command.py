# SPDX-License-Identifier: Apache-2.0
"""``calibrate force`` and ``force`` from a data set to numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.datasets.reading import Dataset
from taccel_lab.learning.force.training_file import TrainingFile
from taccel_lab.profile import load_profile, save_profile
from tests.cli.conftest import Cli
from tests.fuzz.samples.captures import write_image
from tests.learning.force.small_touches import planned, write_touches
from tests.support.commands import done, run
from tests.support.small_data_sets import saved_profile


def training(root: Path, out: Path) -> list[str]:
    words = ["calibrate", "force", str(root / "data"), "--profile", str(root / "pad")]
    options = ["--steps", "60", "--batch", "32", "--light", "0.3", "--stiffness", "0.1"]
    return [*words, "--out", str(out), *options]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A profile with a force model, and images."""
    root = tmp_path_factory.mktemp("force_command")
    write_touches(planned(saved_profile(root / "pad"), episodes=60), root / "data")
    assert run(*training(root, root / "p")) == 0
    data = root / "data"
    images = Dataset(data).read("rgb", [0, 2])
    write_image(root / "rest.png", images[0])
    write_image(root / "press.png", images[1])
    write_image(root / "black.png", np.zeros_like(images[0]))
    return root


def test_figures_and_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert load_profile(folder / "p").force is not None
    report = json.loads((folder / "p_report" / "report.json").read_text())
    assert report["split"]["test_objects"] == ["sphere:4"] and report["by"]["depth"]
    profile, out = str(folder / "p"), str(folder / "out")
    rest, press = (str(folder / name) for name in ("rest.png", "press.png"))
    words = ["force", profile, press, rest, "--background", rest]
    said = done(capsys, *words, "--out", out, "--json")
    assert said.code in (0, 1)
    found = json.loads(said.out)["images"]
    assert np.sum(found["press"]["patch_forces_n"], axis=(0, 1)) == pytest.approx(
        found["press"]["force_n"]
    )
    stored = json.loads((folder / "out" / "press.json").read_text())
    assert stored == found["press"]
    assert (folder / "out" / "press.png").stat().st_size > 5000
    said = done(capsys, *words)
    assert said.code in (0, 1)
    assert all(words in said.out for words in ("Fz", "+-", "N mm", "mm2"))


def test_an_interrupted_training_goes_on_with_the_same_command(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    save = TrainingFile.save

    def interrupted(self: TrainingFile, key: str, step: int, state: Mapping[str, Any]) -> None:
        save(self, key, step, state)
        if step == 30:
            raise KeyboardInterrupt

    words = training(folder, tmp_path / "new" / "p")
    with monkeypatch.context() as patch:
        patch.setattr(TrainingFile, "save", interrupted)
        patch.setattr(TrainingFile, "due", lambda self: True)
        assert "the same command continues after step 30" in cli(*words, code=130).err
    assert [path.name for path in (tmp_path / "new").iterdir()] == [".p.training.pt"]
    assert "continues after step 30" in cli(*words).err
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"p", "p_report"}
    whole, found = load_profile(folder / "p"), load_profile(tmp_path / "new" / "p")
    assert whole.force_weights is not None and found.force_weights is not None
    assert whole.force_weights.keys() == found.force_weights.keys()
    for name, weights in whole.force_weights.items():
        assert np.array_equal(weights, found.force_weights[name]), name


def test_images_of_something_else_are_marked(folder: Path, cli: Cli) -> None:
    assert "outside the training" in cli("force", folder / "p", folder / "black.png", code=1).out


def test_an_image_that_is_refused_stops_no_other(folder: Path, tmp_path: Path, cli: Cli) -> None:
    profile, press, out = str(folder / "p"), str(folder / "press.png"), tmp_path / "out"
    wide, broken = tmp_path / "wide.png", tmp_path / "broken.png"
    write_image(wide, np.zeros((24, 40, 3), np.uint8))
    broken.write_bytes((folder / "rest.png").read_bytes()[:200])
    bad = [str(wide), str(broken)]
    said = cli("force", profile, *bad, press, "--out", out, "--json", code=2)
    told = json.loads(said.out)
    assert list(told["images"]) == ["press"] and list(told["refused"]) == ["wide", "broken"]
    assert "40x24 px" in told["refused"]["wide"] and str(broken) in told["refused"]["broken"]
    assert "wide.png" in said.err and "broken.png" in said.err
    kept = sorted(path.name for path in out.iterdir())
    assert {name for name in kept if "." in name[1:]} == {"press.json", "press.png"}
    # With lines, and nothing written, the same; an image outside the training keeps the 2.
    said = cli("force", profile, *bad, press, folder / "black.png", code=2)
    assert "press.png: Fx" in said.out and "outside the training" in said.out
    assert "broken.png" in said.err
    # Where none can be read, an earlier run's files stay.
    told = cli.json("force", profile, *bad, "--out", out, code=2)
    assert told["out"] is None and list(told["refused"]) == ["wide", "broken"]
    assert sorted(path.name for path in out.iterdir()) == kept


def test_what_cannot_be_read_is_refused(folder: Path, tmp_path: Path, cli: Cli) -> None:
    profile, press, wide = folder / "p", folder / "press.png", tmp_path / "wide.png"
    assert "no force block" in cli.refusal("force", folder / "pad", press)
    assert "does not exist" in cli.refusal("force", profile, folder / "none.png")
    write_image(wide, np.zeros((24, 40, 3), np.uint8))
    assert "40x24 px" in cli.refusal("force", profile, wide)
    assert "40x24 px" in cli.refusal("force", profile, press, "--background", wide)
    told = cli.refusal("calibrate force", tmp_path, "--out", tmp_path / "q")
    assert "holds no data set" in told


def test_a_spoilt_block_is_refused_in_words(folder: Path, tmp_path: Path, cli: Cli) -> None:
    profile = load_profile(folder / "p")
    assert profile.force is not None and profile.force_weights is not None
    wrong = dict(profile.force_weights)
    del wrong["hidden.bias"]
    settings = {**profile.force.architecture, "patch_px": 5}
    for block, weights, said in (
        (profile.force, wrong, "hidden.bias"),
        (profile.force.replace(architecture=settings), profile.force_weights, "patch_px"),
    ):
        spoilt = tmp_path / said
        save_profile(profile.with_block(block, weights), spoilt)
        for words in (["force", spoilt, folder / "press.png"], ["profile validate", spoilt]):
            told = cli(*words, code=2)
            assert said in told.out + told.err
