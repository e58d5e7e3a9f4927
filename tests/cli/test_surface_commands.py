# SPDX-License-Identifier: Apache-2.0
"""``calibrate normals``, ``depth`` and ``force``, and what reads images with them."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from shutil import copy
from typing import Any

import numpy as np
import pytest
import torch

from taccel_lab.calibration.base_profile import lost_blocks, on_grid
from taccel_lab.calibration.camera.rectification import RectificationMaps
from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.check.run import joined, refusing_with
from taccel_lab.calibration.normals import fit as normals_fit
from taccel_lab.datasets.reading import Dataset
from taccel_lab.errors import InputError
from taccel_lab.learning.force.training_file import TrainingFile
from taccel_lab.profile import BackgroundBlock, load_profile, save_profile
from taccel_lab.reading import reading as reading_files
from taccel_lab.report.remark import Remark, Severity
from tests.cli.conftest import Cli
from tests.fuzz.samples.captures import write_image
from tests.learning.force.small_touches import planned, write_touches
from tests.support.commands import done, run
from tests.support.edited_profiles import swap_network
from tests.support.small_data_sets import saved_profile
from tests.support.synthetic_presses import (
    GRID,
    flat_profile,
    synthetic_captures,
    without_check,
    write_captures,
    write_folder,
)

FEW = "--circles labels --synthetic-presses 16"
"""Of other tools, which take as long to press as all else."""


@pytest.fixture(autouse=True)
def quick_on_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Normals practise in colours, too, which here need not be good."""
    torch.set_num_threads(1)
    rough = partial(normals_fit.ColorFitOptions, steps=60)
    monkeypatch.setattr(normals_fit, "ColorFitOptions", rough)


@pytest.fixture
def presses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    save_profile(flat_profile(GRID), tmp_path / "base")
    return write_captures(tmp_path / "captures", synthetic_captures(8)[0])


@pytest.mark.thorough
def test_normals_then_depth(presses: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    without_check(monkeypatch)
    command = f"calibrate normals captures --out profile --base base --steps 80 {FEW}"
    figures = cli.json(command)["normals"]
    assert len(figures["presses"]) == 2
    assert load_profile("profile").normals is not None
    assert Path("profile_report/report.html").is_file()

    image = str(presses / "p3.png")
    found = cli.json("depth profile", image, "--out", "depths")["images"]["p3"]
    assert found["method"] == "normals"
    assert 0.2 < found["depth_mm"] < 1.2
    with np.load("depths/p3.npz") as stored:
        assert stored["height_m"].shape == (GRID.height_px, GRID.width_px)
        assert 1e3 * stored["depth_m"].max() == pytest.approx(found["depth_mm"], rel=1e-5)
        assert {"normals", "sigma_deg", "radius95_deg"} <= set(stored.files)
    assert Path("depths/p3.png").stat().st_size > 5000
    assert json.loads(Path("depths/p3.json").read_text())["image"] == image
    # The figure takes a hundred times as long as all else, and has been seen.
    monkeypatch.setattr(reading_files, "draw_maps", lambda *_: None)
    monkeypatch.setattr(reading_files, "save_figure", lambda _, to: copy("depths/p3.png", to))
    size = (GRID.height_px, GRID.width_px, 3)
    noise = np.random.default_rng(0).integers(0, 256, size, dtype=np.uint8)
    for name, spoilt in (("black", np.zeros(size, np.uint8)), ("noise", noise)):
        write_image(Path(f"{name}.png"), spoilt)
        said = cli.refusal(f"depth profile {name}.png --out {name}")
        assert f"{name}.png" in said and "no image of the sensor" in said
        assert not Path(name).exists()
    # A black frame stops no other image.
    said = cli("depth profile black.png", image, "--out", "some", "--json", "--ply", code=2)
    told = json.loads(said.out)
    assert list(told["images"]) == ["p3"] and list(told["refused"]) == ["black"]
    assert "no image of the sensor" in told["refused"]["black"] and "black.png" in said.err
    kept = sorted(path.name for path in Path("some").iterdir())
    assert {"p3.npz", "p3.ply"} <= set(kept) and not Path("depths/p3.ply").exists()
    assert not any("black" in name for name in kept)
    assert cli.json("depth profile black.png --out some", code=2)["out"] is None
    assert sorted(path.name for path in Path("some").iterdir()) == kept


@pytest.mark.thorough
def test_grey_depth(tmp_path: Path, cli: Cli) -> None:
    save_profile(flat_profile(GRID), tmp_path / "base")
    background = np.full((GRID.height_px, GRID.width_px, 3), 150, dtype=np.uint8)
    distance = ContactCircle(80.0, 60.0, 25.0).distance_px(GRID) * 0.1
    depth = np.sqrt(np.maximum(16.0 - distance**2, 0)) - np.sqrt(16.0 - 2.5**2)
    image = np.rint(background - 50 * np.maximum(depth, 0)[..., None]).astype(np.uint8)
    folder = write_folder(tmp_path / "captures", background, {"ball": image}, {}, 4.0)
    profile, base = tmp_path / "profile", tmp_path / "base"
    assert "off by" in cli("calibrate depth", folder, "--out", profile, "--base", base).out
    words = ["depth", profile, folder / "ball.png", "--out", tmp_path / "depths"]
    found = cli.json(*words)["images"]["ball"]
    assert found["method"] == "depth"
    assert found["depth_mm"] == pytest.approx(depth.max(), abs=0.08)

    # The same through maps that shift it and reach past the raw picture, where nothing is read.
    v, u = np.mgrid[: GRID.height_px, : GRID.width_px].astype(np.float32)
    size = (GRID.width_px, GRID.height_px)
    maps = RectificationMaps(u + 30, v, np.ones(u.shape, dtype=bool), GRID, size)
    maps.save(tmp_path / "maps.npz")
    words += ["--maps", tmp_path / "maps.npz"]
    moved = cli.json(*words)["images"]["ball"]
    assert moved["depth_mm"] == pytest.approx(found["depth_mm"], abs=0.01)
    assert moved["dent_mm2"] == pytest.approx(found["dent_mm2"], rel=0.05)
    replace(maps, raw_size_px=(640, 480)).save(tmp_path / "maps.npz")
    assert "the maps were made for images of 640x480 px" in cli.refusal(*words)
    small = replace(maps.require_grid(), width_px=50)
    part = {name: getattr(maps, name)[:, :50] for name in ("map_u_px", "map_v_px", "measured")}
    replace(maps, grid=small, **part).save(tmp_path / "maps.npz")
    assert "give the maps of the profile's calibration" in cli.refusal(*words)


@pytest.mark.slow
def test_normals_of_captures_that_contradict_themselves_are_weak(presses: Path, cli: Cli) -> None:
    """The fit believes its labels: the check of the captures holds them against the images."""
    manifest = presses / "captures.toml"
    text = manifest.read_text()
    manifest.write_text(re.sub(r"u_px = ([\d.]+)", lambda m: f"u_px = {float(m[1]) - 14.0}", text))
    command = f"calibrate normals captures --out profile --base base --steps 10 {FEW}"
    figures = cli.json(command)["normals"]
    assert figures["verdict"] == "weak"
    assert any("labelled circles disagree with the images" in r for r in figures["remarks"])


def test_blocks_that_do_not_go_with_the_captures_are_named() -> None:
    before = flat_profile(GRID)
    image = np.zeros((GRID.height_px, GRID.width_px, 3), dtype=np.uint8)
    before = before.with_block(BackgroundBlock(provenance=before.camera.provenance), image)
    other = replace(GRID, mm_per_px_x=0.11)
    (remark,) = lost_blocks(before, on_grid(before, other, {}))
    assert remark.severity is Severity.WARNING
    assert "base profile: background." in remark.message and "0.11" in remark.message
    assert lost_blocks(before, on_grid(before, GRID, {})) == []


def test_a_refusal_names_what_else_was_found_and_the_graver_of_two_remarks_is_kept() -> None:
    about = partial(Remark, blocks=("normals",))
    found = [
        about(Severity.ERROR, "channels_swapped", "p3 has red and blue exchanged"),
        about(Severity.ERROR, "no_contact", "again"),
        about(Severity.INFO, "some", "told elsewhere"),
    ]
    with pytest.raises(InputError) as refusal, refusing_with(found):
        raise InputError("p3: no contact found")
    said = "p3: no contact found\nthe captures have more faults:\n- p3 has red and blue exchanged"
    assert str(refusal.value) == said

    found = [about(Severity.WARNING, "few", "check"), about(Severity.ERROR, "other", "check")]
    fitted = [
        Remark(Severity.ERROR, "few", "fit"),
        Remark(Severity.WARNING, "other", "fit"),
        Remark(Severity.INFO, "third", "fit"),
    ]
    kept = [("other", "check"), ("few", "fit"), ("third", "fit")]
    assert [(r.code, r.message) for r in joined(found, fitted)] == kept


def training(root: Path, out: Path) -> list[str]:
    options = "--steps 30 --batch 32 --light 0.3 --stiffness 0.1"
    words = ["calibrate", "force", root / "data", "--profile", root / "pad", "--out", out]
    return [*map(str, words), *options.split()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A profile with a force model, and images."""
    root = tmp_path_factory.mktemp("force_command")
    write_touches(planned(saved_profile(root / "pad"), episodes=60), root / "data")
    assert run(*training(root, root / "p")) == 0
    images = Dataset(root / "data").read("rgb", [0, 2])
    for name, image in zip(("rest", "press", "black"), (*images, 0 * images[0]), strict=True):
        write_image(root / f"{name}.png", image)
    write_image(root / "wide.png", np.zeros((24, 40, 3), np.uint8))
    (root / "broken.png").write_bytes((root / "rest.png").read_bytes()[:200])
    return root


@pytest.mark.thorough
def test_figures_and_files(folder: Path, cli: Cli) -> None:
    assert load_profile(folder / "p").force is not None
    report = json.loads((folder / "p_report" / "report.json").read_text())
    assert report["split"]["test_objects"] == ["sphere:4"] and report["by"]["depth"]
    rest, press, out = folder / "rest.png", folder / "press.png", folder / "out"
    words = ["force", folder / "p", press, rest, "--background", rest]
    said, shown = (done(cli.capsys, *words, *more) for more in (("--out", out, "--json"), ()))
    # Images may be unlike those of so short a training.
    assert {said.code, shown.code} <= {0, 1}
    found = json.loads(said.out)["images"]
    total = np.sum(found["press"]["patch_forces_n"], axis=(0, 1))
    assert total == pytest.approx(found["press"]["force_n"])
    assert json.loads((out / "press.json").read_text()) == found["press"]
    assert (out / "press.png").stat().st_size > 5000
    assert all(words in shown.out for words in ("Fz", "+-", "N mm", "mm2"))


@pytest.mark.thorough
def test_an_interrupted_training_goes_on_with_the_same_command(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    save = TrainingFile.save

    def interrupted(self: TrainingFile, key: str, step: int, state: Mapping[str, Any]) -> None:
        save(self, key, step, state)
        if step == 15:
            raise KeyboardInterrupt

    words = training(folder, tmp_path / "new" / "p")
    with monkeypatch.context() as patch:
        patch.setattr(TrainingFile, "save", interrupted)
        patch.setattr(TrainingFile, "due", lambda self: True)
        assert "the same command continues after step 15" in cli(*words, code=130).err
    assert [path.name for path in (tmp_path / "new").iterdir()] == [".p.training.pt"]
    assert "continues after step 15" in cli(*words).err
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"p", "p_report"}
    whole, found = (load_profile(root / "p").force_weights for root in (folder, tmp_path / "new"))
    assert whole is not None and found is not None and whole.keys() == found.keys()
    assert all(np.array_equal(whole[name], found[name]) for name in whole)


@pytest.mark.thorough
def test_an_image_that_is_refused_stops_no_other(folder: Path, tmp_path: Path, cli: Cli) -> None:
    out, broken = tmp_path / "out", folder / "broken.png"
    words = ["force", folder / "p", folder / "wide.png", broken]
    said = cli(*words, folder / "press.png", "--out", out, "--json", code=2)
    told = json.loads(said.out)
    assert list(told["images"]) == ["press"] and list(told["refused"]) == ["wide", "broken"]
    assert "40x24 px" in told["refused"]["wide"] and str(broken) in told["refused"]["broken"]
    assert "wide.png" in said.err and "broken.png" in said.err
    kept = sorted(path.name for path in out.iterdir())
    assert {name for name in kept if "." in name[1:]} == {"press.json", "press.png", "report.html"}
    # With lines, and nothing written, the same; an image outside the training keeps the 2.
    said = cli(*words, folder / "press.png", folder / "black.png", code=2)
    assert "press.png: Fx" in said.out and "outside the training" in said.out
    assert "broken.png" in said.err
    # Where none can be read, an earlier run's files stay.
    told = cli.json(*words, "--out", out, code=2)
    assert told["out"] is None and list(told["refused"]) == ["wide", "broken"]
    assert sorted(path.name for path in out.iterdir()) == kept
    background = ("--background", folder / "wide.png")
    assert "40x24 px" in cli.refusal("force", folder / "p", folder / "press.png", *background)


@pytest.mark.thorough
def test_a_spoilt_block_is_refused_in_words(folder: Path, tmp_path: Path, cli: Cli) -> None:
    profile = load_profile(folder / "p")
    assert profile.force is not None and profile.force_weights is not None
    wrong = dict(profile.force_weights)
    del wrong["hidden.bias"]
    for settings, weights, said in (
        (None, wrong, "hidden.bias"),
        ({**profile.force.architecture, "patch_px": 5}, None, "patch_px"),
    ):
        spoilt = tmp_path / said
        save_profile(profile, spoilt)
        swap_network(spoilt, "force", settings, weights)
        for words in (["force", spoilt, folder / "press.png"], ["profile validate", spoilt]):
            told = cli(*words, code=2)
            assert said in told.out + told.err
