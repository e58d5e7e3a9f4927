# SPDX-License-Identifier: Apache-2.0
"""``calibrate normals``, ``calibrate depth`` and ``depth`` from folders to height maps."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from taccel_lab.calibration.base_profile import lost_blocks, on_grid
from taccel_lab.calibration.camera.rectification import RectificationMaps
from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.check.block_findings import joined, refusing_with
from taccel_lab.errors import InputError
from taccel_lab.profile import BackgroundBlock, load_profile, save_profile
from taccel_lab.report.remark import Remark, Severity
from tests.cli.conftest import Cli
from tests.support.synthetic_presses import (
    GRID,
    flat_profile,
    synthetic_captures,
    without_check,
    write_captures,
    write_folder,
)


@pytest.fixture(autouse=True)
def quick_on_one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture
def presses(tmp_path: Path) -> Path:
    captures, _ = synthetic_captures(8)
    save_profile(flat_profile(GRID), tmp_path / "base")
    return write_captures(tmp_path / "captures", captures)


def test_normals_then_depth(presses: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    without_check(monkeypatch)
    folder = presses.parent
    profile, base = str(folder / "profile"), str(folder / "base")
    options = ["--base", base, "--circles", "labels", "--steps", "150"]
    figures = cli.json("calibrate normals", presses, "--out", profile, *options)["normals"]
    assert len(figures["presses"]) == 2
    assert load_profile(profile).normals is not None
    assert (folder / "profile_report" / "report.html").is_file()

    image = str(presses / "p3.png")
    found = cli.json("depth", profile, image, "--out", folder / "depths")["images"]["p3"]
    assert found["method"] == "normals"
    assert 0.2 < found["max_depth_mm"] < 1.2
    with np.load(folder / "depths" / "p3.npz") as stored:
        assert stored["height_m"].shape == (GRID.height_px, GRID.width_px)
        assert -1e3 * stored["rise_m"].min() == pytest.approx(found["max_depth_mm"], rel=1e-5)
        assert {"normals", "sigma_deg", "radius95_deg"} <= set(stored.files)
    assert (folder / "depths" / "p3.png").stat().st_size > 5000
    assert json.loads((folder / "depths" / "p3.json").read_text())["image"] == image
    _says_nothing_but_json(["depth", profile, image, "--out", str(folder / "again"), "--json"])
    _refuses_what_is_no_press(Path(image), profile, folder, cli)
    _reads_what_it_can(Path(image), profile, folder, cli)


def _reads_what_it_can(image: Path, profile: str, folder: Path, cli: Cli) -> None:
    """After `_refuses_what_is_no_press`: a black frame stops no other image."""
    out, black = folder / "some", str(folder / "black.png")
    said = cli("depth", profile, black, image, "--out", out, "--json", code=2)
    told = json.loads(said.out)
    assert list(told["images"]) == ["p3"] and list(told["refused"]) == ["black"]
    assert "no image of the sensor" in told["refused"]["black"] and "black.png" in said.err
    kept = sorted(path.name for path in out.iterdir())
    assert "p3.npz" in kept and not any("black" in name for name in kept)
    assert cli.json("depth", profile, black, "--out", out, code=2)["out"] is None
    assert sorted(path.name for path in out.iterdir()) == kept


def _says_nothing_but_json(words: list[str]) -> None:
    """A process of its own, where Warp has not started yet, prints JSON and no line of Warp's."""
    done = subprocess.run(
        [sys.executable, "-m", "taccel_lab.cli.app", *words], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    json.loads(done.stdout)
    assert "Warp" not in done.stderr


def _refuses_what_is_no_press(image: Path, profile: str, folder: Path, cli: Cli) -> None:
    """A black frame and noise end with code 2, the file and the reason, and leave nothing."""
    levels = np.asarray(Image.open(image))
    noise = np.random.default_rng(0).integers(0, 256, levels.shape)
    for name, spoilt in (("black", 0 * levels), ("noise", noise)):
        path, out = folder / f"{name}.png", folder / name
        Image.fromarray(spoilt.astype(np.uint8)).save(path)
        said = cli.refusal("depth", profile, path, "--out", out)
        assert f"{name}.png" in said and "no image of the sensor" in said
        assert not out.exists()


def test_grey_depth(tmp_path: Path, cli: Cli) -> None:
    save_profile(flat_profile(GRID), tmp_path / "base")
    background = np.full((GRID.height_px, GRID.width_px, 3), 150, dtype=np.uint8)
    circle = ContactCircle(80.0, 60.0, 25.0)
    distance = circle.distance_px(GRID) * 0.1
    depth = np.sqrt(np.maximum(16.0 - distance**2, 0)) - np.sqrt(16.0 - 2.5**2)
    image = np.rint(background - 50 * np.maximum(depth, 0)[..., None]).astype(np.uint8)
    folder = write_folder(tmp_path / "captures", background, {"ball": image}, {}, 4.0)
    profile = str(tmp_path / "profile")
    base = str(tmp_path / "base")
    assert "off by" in cli("calibrate depth", folder, "--out", profile, "--base", base).out
    ball, out = str(folder / "ball.png"), str(tmp_path / "depths")
    found = cli.json("depth", profile, ball, "--out", out)["images"]["ball"]
    assert found["method"] == "depth"
    assert found["max_depth_mm"] == pytest.approx(depth.max(), abs=0.08)

    # The same through maps that shift it and reach past the raw picture, where nothing is read.
    u, v = np.meshgrid(np.arange(GRID.width_px), np.arange(GRID.height_px))
    u = (u + 30).astype(np.float32)
    maps = RectificationMaps(
        u, v.astype(np.float32), np.ones(u.shape, dtype=bool), GRID, (GRID.width_px, GRID.height_px)
    )
    maps.save(tmp_path / "maps.npz")
    shifted = ["depth", profile, ball, "--out", out, "--maps", tmp_path / "maps.npz"]
    moved = cli.json(*shifted)["images"]["ball"]
    assert moved["max_depth_mm"] == pytest.approx(found["max_depth_mm"], abs=0.01)
    assert moved["touched_mm2"] == pytest.approx(found["touched_mm2"], rel=0.05)
    replace(maps, raw_size_px=(640, 480)).save(tmp_path / "maps.npz")
    assert "the maps were made for images of 640x480 px" in cli.refusal(*shifted)
    small = replace(maps.require_grid(), width_px=50)
    part = {name: getattr(maps, name)[:, :50] for name in ("map_u_px", "map_v_px", "measured")}
    replace(maps, grid=small, **part).save(tmp_path / "maps.npz")
    assert "give the maps of the profile's calibration" in cli.refusal(*shifted)


def test_unusable_input_exits_with_2(presses: Path, cli: Cli) -> None:
    folder, image = presses.parent, presses / "p3.png"
    base, out = folder / "base", ("--out", folder / "out")
    told = cli.refusal("depth", base, image, *out)
    assert "neither a normals nor a depth_response" in told
    assert "does not exist" in cli.refusal("depth", base, folder / "nothing.png", *out)
    assert "named alike" in cli.refusal("depth", base, image, image, *out)
    calibrate = (presses, *out, "--base", base)
    assert "not a readable .npz" in cli.refusal("calibrate depth", *calibrate, "--maps", image)
    manifest = presses / "captures.toml"
    manifest.write_text(manifest.read_text().replace("contact = {", "# contact = {"))
    told = cli.refusal("calibrate normals", *calibrate, "--circles", "labels")
    assert "6 presses come without" in told and not out[1].exists()


def test_normals_of_captures_that_contradict_themselves_are_weak(presses: Path, cli: Cli) -> None:
    """The fit believes its labels: the check of the captures holds them against the images."""
    manifest = presses / "captures.toml"
    text = manifest.read_text()
    manifest.write_text(re.sub(r"u_px = ([\d.]+)", lambda m: f"u_px = {float(m[1]) - 14.0}", text))
    options = ["--base", presses.parent / "base", "--circles", "labels", "--steps", "10"]
    profile = presses.parent / "profile"
    figures = cli.json("calibrate normals", presses, "--out", profile, *options)["normals"]
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


_about_normals = partial(Remark, blocks=("normals",))


def test_a_refusal_names_what_else_was_found() -> None:
    found = [
        _about_normals(Severity.ERROR, "channels_swapped", "p3 has red and blue exchanged"),
        _about_normals(Severity.ERROR, "no_contact", "again"),
        _about_normals(Severity.INFO, "some", "told elsewhere"),
    ]
    with pytest.raises(InputError) as refusal, refusing_with(found):
        raise InputError("p3: no contact found")
    assert str(refusal.value).splitlines() == [
        "p3: no contact found",
        "the captures have more faults:",
        "- p3 has red and blue exchanged",
    ]


def test_the_graver_of_two_remarks_on_one_thing_is_kept() -> None:
    found = [
        _about_normals(Severity.WARNING, "few", "check"),
        _about_normals(Severity.ERROR, "other", "check"),
    ]
    fitted = [
        Remark(Severity.ERROR, "normals_few", "fit"),
        Remark(Severity.WARNING, "other", "fit"),
    ]
    kept = joined(found, [*fitted, Remark(Severity.INFO, "third", "fit")])
    assert [(r.code, r.message) for r in kept] == [
        ("other", "check"),
        ("normals_few", "fit"),
        ("third", "fit"),
    ]
