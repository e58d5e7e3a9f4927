# SPDX-License-Identifier: Apache-2.0
"""``calibrate force`` and ``force`` from a data set to numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.force.training_file import TrainingFile
from taccel_lab.cli.app import main
from taccel_lab.datasets.reading import Dataset
from taccel_lab.profile import load_profile, save_profile
from tests.calibration.force.small_touches import planned, write_touches
from tests.fuzz.samples.captures import write_image
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
    assert main(training(root, root / "p")) == 0
    data = root / "data"
    images = Dataset(data).read("rgb", [0, 2])
    write_image(root / "rest.png", images[0])
    write_image(root / "press.png", images[1])
    write_image(root / "black.png", np.zeros_like(images[0]))
    return root


def called(*words: str) -> int:
    """Exit code of a command."""
    try:
        return main(list(words))
    except SystemExit as left:
        return int(left.code or 0)


def test_figures_and_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert load_profile(folder / "p").force is not None
    report = json.loads((folder / "p_report" / "report.json").read_text())
    assert report["split"]["test_objects"] == ["sphere:4"] and report["by"]["depth"]
    profile, out = str(folder / "p"), str(folder / "out")
    rest, press = (str(folder / name) for name in ("rest.png", "press.png"))
    words = ["force", profile, press, rest, "--background", rest]
    assert called(*words, "--out", out, "--json") in (0, 1)
    found = json.loads(capsys.readouterr().out)["images"]
    assert np.sum(found["press"]["patch_forces_n"], axis=(0, 1)) == pytest.approx(
        found["press"]["force_n"]
    )
    stored = json.loads((folder / "out" / "press.json").read_text())
    assert stored == found["press"]
    assert (folder / "out" / "press.png").stat().st_size > 5000
    assert called(*words) in (0, 1)
    said = capsys.readouterr().out
    assert "Fz" in said and "+-" in said and "N mm" in said and "mm2" in said


def test_an_interrupted_training_goes_on_with_the_same_command(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
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
        assert called(*words) == 130
    assert "the same command goes on after step 30" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "new").iterdir()] == [".p.training.pt"]
    assert called(*words) == 0
    assert "goes on after step 30" in capsys.readouterr().err
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"p", "p_report"}
    whole, found = load_profile(folder / "p"), load_profile(tmp_path / "new" / "p")
    assert whole.force_weights is not None and found.force_weights is not None
    assert whole.force_weights.keys() == found.force_weights.keys()
    for name, weights in whole.force_weights.items():
        assert np.array_equal(weights, found.force_weights[name]), name


def test_images_of_something_else_are_marked(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert called("force", str(folder / "p"), str(folder / "black.png")) == 1
    assert "outside the training" in capsys.readouterr().out


def test_an_image_that_is_refused_stops_no_other(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    profile, press, out = str(folder / "p"), str(folder / "press.png"), tmp_path / "out"
    wide, broken = tmp_path / "wide.png", tmp_path / "broken.png"
    write_image(wide, np.zeros((24, 40, 3), np.uint8))
    broken.write_bytes((folder / "rest.png").read_bytes()[:200])
    bad = [str(wide), str(broken)]
    assert called("force", profile, *bad, press, "--out", str(out), "--json") == 2
    said = capsys.readouterr()
    told = json.loads(said.out)
    assert list(told["images"]) == ["press"] and list(told["refused"]) == ["wide", "broken"]
    assert "40x24 px" in told["refused"]["wide"] and str(broken) in told["refused"]["broken"]
    assert "wide.png" in said.err and "broken.png" in said.err
    kept = sorted(path.name for path in out.iterdir())
    assert {name for name in kept if "." in name[1:]} == {"press.json", "press.png"}
    # With lines, and nothing written, the same; an image outside the training keeps the 2.
    assert called("force", profile, *bad, press, str(folder / "black.png")) == 2
    said = capsys.readouterr()
    assert "press.png: Fx" in said.out and "outside the training" in said.out
    assert "broken.png" in said.err
    # Where none can be read, an earlier run's files stay.
    assert called("force", profile, *bad, "--out", str(out), "--json") == 2
    told = json.loads(capsys.readouterr().out)
    assert told["out"] is None and list(told["refused"]) == ["wide", "broken"]
    assert sorted(path.name for path in out.iterdir()) == kept


def test_what_cannot_be_read_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(*words: str) -> str:
        assert main(list(words)) == 2
        return " ".join(capsys.readouterr().err.split())

    profile, press = str(folder / "p"), str(folder / "press.png")
    assert "no force block" in refused("force", str(folder / "pad"), press)
    assert "does not exist" in refused("force", profile, str(folder / "none.png"))
    write_image(tmp_path / "wide.png", np.zeros((24, 40, 3), np.uint8))
    assert "40x24 px" in refused("force", profile, str(tmp_path / "wide.png"))
    assert "40x24 px" in refused(
        "force", profile, press, "--background", str(tmp_path / "wide.png")
    )
    assert "holds no data set" in refused(
        "calibrate", "force", str(tmp_path), "--out", str(tmp_path / "q")
    )


def test_a_spoilt_block_is_refused_in_words(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    profile = load_profile(folder / "p")
    assert profile.force is not None and profile.force_weights is not None
    wrong = dict(profile.force_weights)
    del wrong["hidden.bias"]
    settings = {**profile.force.architecture, "patch_px": 5}
    for number, (block, weights, said) in enumerate(
        (
            (profile.force, wrong, "hidden.bias"),
            (profile.force.replace(architecture=settings), profile.force_weights, "patch_px"),
        )
    ):
        spoilt = tmp_path / str(number)
        save_profile(profile.with_block(block, weights), spoilt)
        for words in (["force", str(spoilt), str(folder / "press.png")], ["profile", "validate"]):
            words = words if words[0] == "force" else [*words, str(spoilt)]
            assert main(words) == 2
            told = capsys.readouterr()
            assert said in told.out + told.err
