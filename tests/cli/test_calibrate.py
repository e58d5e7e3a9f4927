# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate``: colours with simulated presses, camera, scale, material and all."""

from __future__ import annotations

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.blocks import HOMES
from taccel_lab.calibration.calibrate import calibrate
from taccel_lab.calibration.camera.lens import LENSES
from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.force_table import force_table
from taccel_lab.calibration.material.gel import Gel
from taccel_lab.errors import InputError
from taccel_lab.presses.physics import PHYSICS, Accuracy, PressMeshOptions, PressPhysics
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.sensors.profile import catalogue_profile
from tests.calibration.drawn.boards import chess_pattern, dot_pattern, pose_over, render_board
from tests.calibration.drawn.faults import add_noise, quantise
from tests.calibration.scale.test_agreement import write_folder
from tests.cli.conftest import Cli
from tests.support.small_captures import (
    fit_colors_as_backgrounds,
    write_captures,
    write_profile,
)


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    return write_captures(tmp_path / "captures")


TOY = {
    "__init__.py": "",
    "block.py": """
from dataclasses import dataclass

from taccel_lab.calibration.block import Block, BlockWords, Needs
from taccel_lab.report.lead import Score


@dataclass(frozen=True, kw_only=True)
class ToyOptions:
    every: int = 1
    \"\"\"Presses that make one toy.\"\"\"


@dataclass(frozen=True, kw_only=True)
class ToyWords(BlockWords, ToyOptions):
    \"\"\"Count presses as toys.\"\"\"


BLOCK = Block(
    name="toy",
    home=__name__,
    words=ToyWords,
    needs=lambda folder, grey: Needs(f"{len(folder.presses)} toys"),
    checked_by="fit:check_toys",
    fitted_by="fit:calibrate_toy",
    shown_by="fit:toy_page",
    choices="block:ToyOptions",
    telling=9,
    key="gel",
    scores=lambda left: [Score("5", "toys", "counted", "every press")],
)
""",
    "fit.py": """
from dataclasses import dataclass

from taccel_lab.calibration.remarks import warning
from taccel_lab.calibration.result import BlockResult
from taccel_lab.report.lead import Picture
from taccel_lab.report.page import Page

FEW_TOYS = warning("few_toys", "{count} toys: press more", ("toy",))


@dataclass(frozen=True)
class ToyCalibration(BlockResult):
    count: int
    remarks: tuple = ()

    def figures(self):
        return {"toys": self.count}

    def apply_to(self, profile):
        return profile


def calibrate_toy(folder, base, options, progress):
    return ToyCalibration(len(folder.presses) // options.every)


def toy_page(result):
    picture = Picture("toys", lambda: b"PNG of toys", "All toys.")
    return Page("Toys", f"{result.count} toys", pictures=[picture], figures=result.figures())


def check_toys(folder):
    return [FEW_TOYS(count=len(folder.presses))]
""",
}
"""A block of somebody else: a folder, and one line where it is registered."""


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "outside" / "toy_block"
    home.mkdir(parents=True)
    for name, text in TOY.items():
        (home / name).write_text(text)
    monkeypatch.syspath_prepend(home.parent)
    monkeypatch.setitem(HOMES, "toy", "toy_block.block")


@pytest.mark.thorough
@pytest.mark.usefixtures("toy")
def test_a_block_is_added_by_its_folder_and_one_line(
    captures: Path, tmp_path: Path, cli: Cli
) -> None:
    assert "Count presses as toys." in cli("calibrate --help").out
    assert "Presses that make one toy." in cli("calibrate toy --help").out
    status = cli.json("capture check", captures)
    (toys,) = [block for block in status["blocks"] if "toy" in block["command"]]
    assert (toys["found"], toys["readiness"]) == ("5 toys", "weak")
    assert "5 toys: press more" in {finding["message"] for finding in status["findings"]}
    out = tmp_path / "one"
    assert cli.json("calibrate toy", captures, "--out", out, "--every", "2")["toy"] == {"toys": 2}
    report = tmp_path / "all_report"
    words = [captures, "--out", tmp_path / "all", "--only", "background", "toy"]
    found = cli.json("calibrate all", *words)["blocks"]
    states = {"background": "done", "toy": "done"}
    assert {block["name"]: block["state"] for block in found} == states
    html = (report / "report.html").read_text(encoding="utf-8")
    assert 'href="toy/report.html"' in html and "All toys." in html and "every press" in html
    assert calibrate(captures, only="toy", options={}).toy.count == 5


@pytest.mark.thorough
def test_one_camera_of_several_is_calibrated_and_put_back(
    captures: Path, tmp_path: Path, cli: Cli
) -> None:
    """The other camera, whose images have another size, stays as it is."""
    pair, unit = tmp_path / "pair", tmp_path / "unit"
    right = load_profile(write_profile(tmp_path / "right", color=False))
    left = catalogue_profile("gelsight").without("background")
    save_profile(left.with_view("right", right), pair)
    cli("calibrate background", captures, "--base", f"{pair}@right", "--out", unit)
    calibrated = load_profile(unit)
    assert calibrated.background_rgb is not None and calibrated.view_names() == ("main",)
    cli("profile add-view", pair, "right", unit, "--out", pair)
    again = load_profile(pair)
    assert again.background_rgb is None and again.grid() == left.grid()
    found = again.seen_by("right").background_rgb
    np.testing.assert_array_equal(found, calibrated.background_rgb)


@pytest.mark.thorough
def test_a_block_that_refuses_ends_with_1(
    captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    def refuse(*_: object) -> None:
        raise InputError("the light is off")

    fit_colors_as_backgrounds(monkeypatch)
    fit = "taccel_lab.calibration.background.fit.calibrate_background"
    monkeypatch.setattr(fit, refuse)
    # The report may be the folder one is in.
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    words = [captures, "--out", tmp_path / "unit", "--report", "."]
    words += ["--only", "background", "color", "markers"]
    shown = cli.json("calibrate all", *words, code=1)["blocks"]
    states = {"background": "refused", "color": "done", "markers": "skipped"}
    assert {s["name"]: s["state"] for s in shown} == states
    assert any("the light is off" in json.dumps(block) for block in shown)
    assert load_profile(tmp_path / "unit").perturbation is not None
    assert (tmp_path / "here" / "color" / "report.html").is_file()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["captures", "here", "unit"]


@pytest.mark.thorough
def test_base_profile_gives_the_design(captures: Path, tmp_path: Path, cli: Cli) -> None:
    base = write_profile(tmp_path / "base", color=False)
    out = tmp_path / "unit"
    cli("calibrate background", captures, "--out", out)
    # In the place of the profile and the report of before.
    options = ["--base", base, "--steps", "5", "--holdout-every", "0"]
    cli("calibrate color", captures, "--out", out, *options)
    assert load_profile(out).color is not None
    assert load_profile(out).material == load_profile(base).material
    assert sorted(os.listdir(tmp_path)) == ["base", "captures", "unit", "unit_report"]


HEADER = 'schema_version = 2\nsensor = "gelsight"\n'


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_profile(tmp_path_factory.mktemp("base") / "profile")


@pytest.fixture
def boards(tmp_path: Path) -> Path:
    """Six chessboards in air, and a board of dots on the gel 24 mm before the camera."""
    folder = tmp_path / "captures"
    folder.mkdir()
    tilts = [(25, 0), (-25, 10), (5, 28), (0, -28), (20, 20), (-15, -20)]
    drawn = {
        f"view_{k}": (chess_pattern(7, 5), 4.0, pose_over(
            7, 5, 4.0, distance_mm=40 + 2 * k, tilt_deg=tilt, turn_deg=20.0 * k
        ))
        for k, tilt in enumerate(tilts)
    }  # fmt: skip
    on_gel = pose_over(9, 7, 2.0, distance_mm=24.0, tilt_deg=(2.0, -1.0), turn_deg=3.0)
    drawn["gel"] = dot_pattern(9, 7), 2.0, on_gel
    parameters = np.array([270.0, 268.0, 158.0, 121.0, -0.1])
    for name, (pattern, pitch_mm, pose) in drawn.items():
        image = render_board(
            LENSES["k1"], parameters, pose, (320, 240), pattern, pitch_mm, samples=2
        )
        noisy = quantise(add_noise(image, 1.5, np.random.default_rng(len(name) + 4)))
        cv2.imwrite(str(folder / f"{name}.png"), noisy[..., ::-1])
    names = ", ".join(f'"view_{k}.png"' for k in range(len(tilts)))
    (folder / "captures.toml").write_text(
        f'{HEADER}[[boards]]\nkind = "chessboard"\ncolumns = 7\nrows = 5\nimages = [{names}]\n'
        '[[boards]]\nkind = "dots"\ncolumns = 9\nrows = 7\npitch_mm = 2.0\non_gel = true\n'
        'images = ["gel.png"]\n'
    )
    return folder


@pytest.mark.thorough
def test_boards_to_profile_report_and_maps(
    boards: Path, base: Path, tmp_path: Path, cli: Cli
) -> None:
    out, maps, report = (tmp_path / name for name in ("out", "maps.npz", "out_report"))
    words = [boards, "--base", base, "--out", out, "--maps", maps, "--models", "k1", "--folds", "2"]
    figures = cli.json("calibrate camera", *words)["camera"]
    assert figures["intrinsics"]["heldout_rms_px"] < 0.3
    profile = load_profile(out)
    camera, optics = profile.camera, profile.optics
    assert camera.provenance.kind == "calibrated" and camera.provenance.verdict is not None
    # The board is 24 mm away: a pixel spans 24 / f there.
    assert camera.mm_per_px_x == pytest.approx(24.0 / 270.0, rel=0.01)
    assert optics is not None and optics.provenance.kind == "calibrated"
    assert optics.fx_px == pytest.approx(270.0, abs=5 * optics.provenance.spread["fx_px"] + 1)
    # Drawn in air: of both poses in the report, that of straight sight lines.
    (straight,) = (p for p in figures["on_gel"]["poses"] if not p["refracted"])
    assert straight["position_mm"][2] == pytest.approx(-24.0, rel=0.02)
    assert optics.distortion[0] == pytest.approx(-0.1, abs=0.05)
    with np.load(maps) as stored:
        assert stored["map_u_px"].shape == (240, 320)
    pictures = {"views", "residuals", "board_on_gel", "rectified"}
    assert pictures <= {path.stem for path in report.glob("*.png")}
    assert json.loads((report / "report.json").read_text())["verdict"] in ("good", "usable")
    # A board on the gel alone, which contradicts what is stated of one axis.
    stated = "mm_per_px_x = 0.2\nmm_per_px_y = 0.0896\n"
    dots = (boards / "captures.toml").read_text().split("[[boards]]")[2]
    (boards / "captures.toml").write_text(f"{HEADER}{stated}[[boards]]{dots}")
    said = cli("calibrate camera", boards, "--base", base, "--out", tmp_path / "other").err
    assert "the captures state mm_per_px_x = 0.2, measured is" in " ".join(said.split())
    assert "mm_per_px_y = " not in said


@pytest.mark.thorough
def test_known_lengths_to_profile(base: Path, tmp_path: Path, cli: Cli) -> None:
    captures = write_folder(tmp_path / "captures", (0.085, 0.082))
    cli("calibrate scale", captures, "--out", tmp_path / "out", "--base", base)
    camera = load_profile(tmp_path / "out").camera
    assert camera.mm_per_px_x == pytest.approx(0.085, rel=0.02)
    assert camera.mm_per_px_y == pytest.approx(0.082, rel=0.02)
    assert camera.provenance.interval["mm_per_px_x"][0] < 0.085
    assert (tmp_path / "out_report" / "estimates.png").is_file()


@pytest.mark.thorough
def test_records_become_a_profile_and_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    modulus, poisson, friction, ball_mm = 3e5, 0.47, 0.5, 5.0
    coarse = PressMeshOptions(elements_per_radius=2.0, core=4, rings=6)
    fast = PressPhysics(Accuracy.FAST, mesh=coarse)
    monkeypatch.setenv("TACCEL_LAB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setitem(PHYSICS, Accuracy.FAST, fast)
    monkeypatch.setattr("taccel_lab.calibration.material.force_table.DEPTHS", 4)
    gel = Gel.of_profile(catalogue_profile("gelsight_mini"), physics=fast).with_law(poisson)
    tool = gel.tool(ToolEntry(kind="sphere", radius_mm=ball_mm))
    table = force_table(gel, tool, (0.15, 1.2), free_nu=False, friction=friction)
    depth = np.linspace(0.15, 1.2, 10)
    force = table.force_n(depth, modulus, poisson)
    force = force * (1 + 0.01 * np.random.default_rng(0).normal(size=10))
    captures, out = tmp_path / "captures", tmp_path / "profile"
    captures.mkdir()
    rows = [f"{d:.9g},{f:.9g}\n" for d, f in zip(depth, force, strict=True)]
    (captures / "press.csv").write_text("depth_mm,force_n\n" + "".join(rows))
    (captures / "captures.toml").write_text(
        'schema_version = 2\nsensor = "gelsight_mini"\nsource = "test"\n[[records]]\n'
        'file = "press.csv"\nkind = "indentation"\n'
        f'tool = {{ kind = "sphere", radius_mm = {ball_mm} }}\n'
    )
    options = ["--accuracy", "fast", "--fix", f"nu={poisson}", f"friction={friction}"]
    printed = cli.json("calibrate material", captures, "--out", out, *options)["material"]
    assert printed["verdict"] == "good"
    block = load_profile(out).material
    low, high = block.provenance.interval["young_modulus_pa"]
    assert low < modulus < high and high / low < 1.3
    assert block.young_modulus_pa == pytest.approx(modulus, rel=0.02)
    assert (block.friction_coefficient, block.poisson_ratio) == (friction, poisson)
    assert block.fitted_with is not None and not block.fitted_with.friction_measured
    assert block.fitted_with.friction_coefficient == block.friction_coefficient
    assert block.fitted_with.physics["accuracy"] == "fast"
    assert block.provenance.kind == "calibrated" and block.provenance.verdict == "good"
    assert set(block.provenance.inputs) == {"press.csv", "captures.toml"}
    residuals = block.provenance.residuals
    assert next(iter(residuals)) == "indentation_held_out_worst_relative"
    assert residuals["indentation_worst_relative"] < 0.04
    assert residuals["indentation_held_out_worst_relative"] < 0.06
    assert block.provenance.valid_region["depth_mm"] == pytest.approx((0.15, 1.2))
    report = tmp_path / "profile_report"
    assert (report / "report.html").is_file() and (report / "indentation.png").is_file()
    held = json.loads((report / "report.json").read_text())["held"]
    assert held == {"friction_coefficient": friction, "poisson_ratio": poisson}
