# SPDX-License-Identifier: Apache-2.0
"""``calibrate``: blocks in order, what is skipped, blocked and refused, and one check for all."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.blocks import BLOCKS, block_named
from taccel_lab.calibration.calibrate import calibrate
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.check import run as block_findings
from taccel_lab.calibration.check.run import CaptureCheck
from taccel_lab.calibration.press_options import ColorOptions
from taccel_lab.calibration.unfinished import BlockState
from taccel_lab.errors import InputError
from taccel_lab.files import images
from taccel_lab.profile import CameraBlock, Provenance, SensorProfile, load_profile
from taccel_lab.sensors.profile import catalogue_profile
from tests.support.small_captures import fit_colors_as_backgrounds, write_captures


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    return write_captures(tmp_path / "captures")


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Sources of the checks that are made."""
    sources: list[str] = []
    real = block_findings.check_captures

    def counted(folder: CaptureFolder, **options: Any) -> CaptureCheck:
        sources.append(folder.source)
        return real(folder, **options)

    monkeypatch.setattr(block_findings, "check_captures", counted)
    return sources


def refuse(*_: object) -> None:
    raise InputError("the light is off")


@pytest.fixture
def quick_color(monkeypatch: pytest.MonkeyPatch) -> None:
    fit_colors_as_backgrounds(monkeypatch)


def replace_fit(monkeypatch: pytest.MonkeyPatch, name: str, fit: Any) -> None:
    module = import_module(f"taccel_lab.calibration.{block_named(name).fitted_in}")
    monkeypatch.setattr(module, f"calibrate_{name}", fit)


@pytest.mark.thorough
def test_a_block_loads_no_other() -> None:
    """Nor torch, where it fits no network."""
    script = (
        "import sys; from taccel_lab.calibration.blocks import block_named; "
        "block_named('scale').verb; print('torch' in sys.modules, *sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    torch, *modules = done.stdout.split()
    assert torch == "False" and "taccel_lab.calibration.scale.fit" in modules
    others = {block.fitted_in for block in BLOCKS} - {"scale.fit"}
    assert not {f"taccel_lab.calibration.{name}" for name in others} & set(modules)


@pytest.mark.thorough
def test_blocks_build_on_one_another(captures: Path, tmp_path: Path) -> None:
    told: list[str] = []
    found = calibrate(
        captures,
        only=("background", "markers"),
        progress=lambda task, done, total: told.append(task),
    )
    assert [(o.name, o.state) for o in found.blocks] == [
        ("background", BlockState.DONE),
        ("markers", BlockState.SKIPPED),
    ]
    assert "dots at rest" in found.blocks[1].message
    assert not found.unfit
    assert found.profile.background is not None and found.profile.perturbation is not None
    assert found.profile.background.provenance.kind == "calibrated"
    assert {"checking the presses", "background: comparing the frames"} <= set(told)

    found.write_report(tmp_path / "report")
    assert (tmp_path / "report" / "background" / "report.html").is_file()
    assert (tmp_path / "report" / "background" / "dust.png").is_file()
    html = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert "Calibrated blocks" in html and "perturbation" in html


@pytest.mark.thorough
@pytest.mark.usefixtures("quick_color")
def test_a_block_that_refuses_leaves_the_others_alone(
    captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace_fit(monkeypatch, "background", refuse)
    found = calibrate(load_capture_folder(captures), only=("background", "color"))
    (refused,) = found.unfit
    assert (refused.state, refused.message) == (BlockState.REFUSED, "the light is off")
    assert refused.page is None
    assert found.profile.background is not None
    found.write_report(tmp_path / "report")
    data = json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))
    assert data["verdict"] == "weak" and data["blocks"][0]["state"] == "refused"


@pytest.mark.thorough
@pytest.mark.usefixtures("quick_color")
def test_the_same_call_goes_on_after_a_kill(
    captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    only, kept = ("background", "color"), tmp_path / "kept"

    def kill(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        replace_fit(patch, "color", kill)
        with pytest.raises(KeyboardInterrupt):
            calibrate(captures, only=only, unfinished=kept)
    # What is finished is a whole profile with its report.
    assert load_profile(kept / "profile").background is not None
    assert (kept / "report" / "background" / "report.html").is_file()
    with monkeypatch.context() as patch:
        replace_fit(patch, "background", kill)
        found = calibrate(captures, only=only, unfinished=kept)
    assert [o.state for o in found.blocks] == [BlockState.DONE, BlockState.DONE]
    whole_run = calibrate(captures, only=only)
    made = []
    for profile in (found.profile, whole_run.profile):
        assert profile.perturbation is not None
        made.append(profile.perturbation.model_dump(exclude={"provenance"}))
    assert made[0] == made[1]
    np.testing.assert_array_equal(found.profile.background_rgb, whole_run.profile.background_rgb)
    found.write_report(tmp_path / "report")
    assert (tmp_path / "report" / "background" / "report.html").is_file()
    with pytest.raises(InputError, match="no result of background: done, "):
        _ = found.background
    text = repr(found.results["color"])
    assert text.startswith("BackgroundCalibration\n  verdict") and len(text.splitlines()) < 14
    # Captures that were written again begin anew, whatever time they bear.
    again, about = captures / "p0.png", (captures / "p0.png").stat()
    again.write_bytes(again.read_bytes())
    os.utime(again, ns=(about.st_atime_ns, about.st_mtime_ns))
    with monkeypatch.context() as patch:
        replace_fit(patch, "background", kill)
        with pytest.raises(KeyboardInterrupt):
            calibrate(captures, only=only, unfinished=kept)
    assert found.unfinished is not None
    found.unfinished.remove()
    assert not kept.exists()


def test_captures_that_calibrate_nothing_leave_nothing(
    captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace_fit(monkeypatch, "background", refuse)
    with pytest.raises(InputError, match="nothing could be calibrated"):
        calibrate(captures, only=("background",), unfinished=tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


@pytest.mark.thorough
def test_a_block_is_fitted_with_its_options(
    captures: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[ColorOptions] = []

    def fit(folder: CaptureFolder, base: SensorProfile, options: ColorOptions, _: object) -> None:
        given.append(options)
        raise InputError("no fit in this test")

    replace_fit(monkeypatch, "color", fit)
    seeded = ColorOptions(seed=3)
    only = ("background", "color")
    calibrate(captures, only=only, options={"color": seeded})
    calibrate(captures, only=only)
    assert given == [seeded, ColorOptions()]


@pytest.mark.thorough
def test_the_example_of_the_docs_runs(captures: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (Path(__file__).parents[2] / "docs" / "calibration.md").read_text(encoding="utf-8")
    example = re.search(r"```python\n(from .*?calibrate\(.*?)```", text, re.DOTALL)
    assert example is not None
    monkeypatch.chdir(captures.parent)
    names: dict[str, Any] = {}
    exec(compile(example[1], "calibration.md", "exec"), names)
    assert [block.state for block in names["found"].blocks] == [BlockState.DONE]
    assert Path("unit3", "profile.toml").is_file() and Path("unit3_report").is_dir()


def test_nothing_to_do_unknown_blocks_and_other_sensors_are_refused(captures: Path) -> None:
    with pytest.raises(InputError, match="nothing could be calibrated\n  markers: needs"):
        calibrate(captures, only=("markers",))
    with pytest.raises(InputError, match="no block colour; there are camera, scale"):
        calibrate(captures, only=("colour",))
    with pytest.raises(InputError, match="no block colour"):
        calibrate(captures, options={"colour": None})
    with pytest.raises(InputError, match="captures are of a gelsight, the profile to extend is of"):
        calibrate(captures, catalogue_profile("digit"))


def test_a_block_is_stopped_by_errors_and_not_by_warnings(captures: Path) -> None:
    manifest = captures / "captures.toml"
    manifest.write_text(manifest.read_text().replace("[indenter]\nradius_mm = 2.0\n", ""))
    found = calibrate(captures, only=("background", "color"))
    (blocked,) = found.unfit
    assert blocked.message.startswith("needs the ball's radius; the radius of the ball is not")
    assert "30 to 50" not in blocked.message, "five presses are a warning"


@pytest.mark.thorough
def test_a_measured_scale_of_the_base_serves_captures_that_state_none(
    captures: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = load_capture_folder(captures)
    scale = folder.grid()
    on_board = Provenance(
        kind="measured", method="for this test", source="none", inputs={"board": "0" * 64}
    )
    measured = CameraBlock.from_grid(scale, on_board)
    base = catalogue_profile(folder.sensor).with_block(measured)
    manifest = captures / "captures.toml"
    kept = [line for line in manifest.read_text().splitlines() if "mm_per_px" not in line]
    manifest.write_text("\n".join(kept) + "\n")
    seen: list[tuple[float, float] | None] = []

    def fit(folder: CaptureFolder, *_: object) -> None:
        seen.append(folder.mm_per_px)
        raise InputError("no fit in this test")

    replace_fit(monkeypatch, "color", fit)
    found = calibrate(captures, base, only=("background", "color"))
    assert [o.state for o in found.blocks] == [BlockState.DONE, BlockState.REFUSED]
    assert seen == [(scale.mm_per_px_x, scale.mm_per_px_y)]
    with pytest.raises(
        InputError, match=r"(?s)background: needs the scale.*color: needs the scale"
    ):
        calibrate(captures, only=("background", "color"))


def test_one_check_serves_all_blocks(
    captures: Path, made: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def asks(folder: CaptureFolder, *_: object) -> None:
        block_findings.capture_findings(folder, "color")
        raise InputError("no fit in this test")

    replace_fit(monkeypatch, "color", asks)
    found = calibrate(captures, only=("background", "color"))
    assert [o.state for o in found.blocks] == [BlockState.DONE, BlockState.REFUSED]
    assert len(made) == 1


@pytest.mark.thorough
def test_a_check_goes_with_its_captures_and_is_made_again_for_others(
    captures: Path, made: list[str]
) -> None:
    folder = load_capture_folder(captures)
    first = block_findings.capture_check(folder)
    assert block_findings.capture_check(folder) is first
    assert block_findings.capture_findings(folder, "color") == [
        finding for finding in first.findings if "color" in finding.blocks
    ]
    assert len(made) == 1
    # Another folder in between takes nothing from the first.
    other = load_capture_folder(captures)
    block_findings.capture_check(other)
    assert block_findings.capture_check(folder) is first
    assert len(made) == 2
    # What is changed of the captures is checked anew.
    block_findings.capture_check(replace(folder, mm_per_px=(0.1, 0.1)))
    assert len(made) == 3


@pytest.mark.usefixtures("quick_color")
def test_every_image_is_decoded_once(captures: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded: Counter[str] = Counter()
    real = images.read_apart

    def counted(what: str, *arguments: Any, **options: Any) -> Any:
        decoded[what] += 1
        return real(what, *arguments, **options)

    monkeypatch.setattr(images, "read_apart", counted)
    found = calibrate(captures, only=("background", "color"))
    assert [o.state for o in found.blocks] == [BlockState.DONE, BlockState.DONE]
    files = {str(path) for path in captures.glob("*.png")}
    assert decoded == Counter(dict.fromkeys(files, 1))
