# SPDX-License-Identifier: Apache-2.0
"""``calibrate``: blocks in order, what is skipped, blocked and refused, and one check for all."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.background.fit import calibrate_background
from taccel_lab.calibration.blocks import HOMES
from taccel_lab.calibration.calibrate import calibrate
from taccel_lab.calibration.capture import CaptureFolder, load_capture_folder
from taccel_lab.calibration.check import run as block_findings
from taccel_lab.calibration.color.options import ColorOptions
from taccel_lab.calibration.unfinished import BlockState
from taccel_lab.errors import InputError
from taccel_lab.files import images
from taccel_lab.profile import CameraBlock, Provenance, load_profile
from taccel_lab.sensors.profile import catalogue_profile
from tests.support.capture_sets import edit_manifest
from tests.support.small_captures import fit_colors_as_backgrounds, write_captures

BOTH = ("background", "color")
ALL_DONE = [BlockState.DONE, BlockState.DONE]
REFUSED = [BlockState.DONE, BlockState.REFUSED]


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    return write_captures(tmp_path / "captures")


@pytest.fixture
def replace_fit(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, Any], None]:
    """Lets a function fit the block of this name."""

    def replaced(name: str, fit: Any) -> None:
        monkeypatch.setattr(f"taccel_lab.calibration.{name}.fit.calibrate_{name}", fit)

    return replaced


@pytest.fixture
def checked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Sources of the captures whose presses are checked."""
    sources: list[str] = []
    real = block_findings._check_presses

    def counted(folder: CaptureFolder, *options: Any) -> Any:
        sources.append(folder.source)
        return real(folder, *options)

    monkeypatch.setattr(block_findings, "_check_presses", counted)
    return sources


@pytest.fixture
def quick_color(monkeypatch: pytest.MonkeyPatch) -> None:
    fit_colors_as_backgrounds(monkeypatch)


def refuse(*_: object) -> None:
    raise InputError("the light is off")


def kill(*_: object) -> None:
    raise KeyboardInterrupt


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
    others = [home for name, home in HOMES.items() if name != "scale"]
    assert not {one for home in others for one in (home, home.replace("block", "fit"))} & {*modules}


@pytest.mark.thorough
def test_blocks_build_on_one_another(captures: Path, tmp_path: Path) -> None:
    tasks: list[str] = []
    found = calibrate(
        captures, only=("background", "markers"), progress=lambda task, *_: tasks.append(task)
    )
    states = {"background": BlockState.DONE, "markers": BlockState.SKIPPED}
    assert {o.name: o.state for o in found.blocks} == states
    assert "dots at rest" in found.blocks[1].message and not found.unfit
    assert found.profile.background is not None and found.profile.perturbation is not None
    assert found.profile.background.provenance.kind == "calibrated"
    assert {"checking the presses", "background: comparing the frames"} <= set(tasks)
    report = tmp_path / "report"
    found.write_report(report)
    assert {"report.html", "dust.png"} <= {path.name for path in (report / "background").iterdir()}
    html = (report / "report.html").read_text(encoding="utf-8")
    links = {"background/report.html", "background/report.json", "background/dust.png"}
    assert links <= set(re.findall(r'href="([^"]+)"', html)) and "perturbation" in html
    assert found.basis is found.profile and found.captures.sensor == found.profile.sensor.family


@pytest.mark.thorough
@pytest.mark.usefixtures("quick_color")
def test_a_block_that_refuses_leaves_the_others_alone(captures, tmp_path, replace_fit) -> None:
    replace_fit("background", refuse)
    found = calibrate(load_capture_folder(captures), only=BOTH)
    (refused,) = found.unfit
    assert (refused.state, refused.message) == (BlockState.REFUSED, "the light is off")
    assert refused.page is None and found.profile.background is not None
    found.write_report(tmp_path / "report")
    data = json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))
    assert data["verdict"] == "weak" and data["blocks"][0]["state"] == "refused"


@pytest.mark.thorough
@pytest.mark.usefixtures("quick_color")
def test_the_same_call_goes_on_after_a_kill(captures, tmp_path, replace_fit) -> None:
    how: dict[str, Any] = {"only": BOTH, "unfinished": tmp_path / "kept"}
    fits = import_module("taccel_lab.calibration.color.fit").calibrate_color
    replace_fit("color", kill)
    with pytest.raises(KeyboardInterrupt):
        calibrate(captures, **how)
    # What is finished is a whole profile with its report.
    kept = load_profile(tmp_path / "kept" / "profile")
    assert (tmp_path / "kept" / "report" / "background" / "report.html").is_file()
    replace_fit("color", fits)
    replace_fit("background", kill)
    found = calibrate(captures, **how)
    assert [o.state for o in found.blocks] == ALL_DONE
    first, second = (each.blocks()["perturbation"] for each in (kept, found.profile))
    assert first.replace(provenance=second.provenance) == second
    np.testing.assert_array_equal(found.profile.background_rgb, kept.background_rgb)
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
    with pytest.raises(KeyboardInterrupt):
        calibrate(captures, **how)
    assert found.unfinished is not None
    found.unfinished.remove()
    assert not (tmp_path / "kept").exists()


@pytest.mark.thorough
def test_a_block_is_fitted_with_its_options_on_the_scale_of_the_base(captures, replace_fit) -> None:
    """A measured scale serves captures that state none."""
    given: list[tuple[Any, Any]] = []

    def fit(folder: CaptureFolder, _: Any, options: ColorOptions, __: Any) -> None:
        given.append((folder.mm_per_px, options))
        refuse()

    replace_fit("color", fit)
    grid, seeded = load_capture_folder(captures).grid(), ColorOptions(seed=3)
    calibrate(captures, only=BOTH, options={"color": seeded})
    for axis, mm_per_px in (("x", grid.mm_per_px_x), ("y", grid.mm_per_px_y)):
        edit_manifest(captures, f"mm_per_px_{axis} = {mm_per_px}\n", "")
    on_board = Provenance(
        kind="measured", method="for this test", source="none", inputs={"board": "0" * 64}
    )
    base = catalogue_profile("gelsight").with_block(CameraBlock.from_grid(grid, on_board))
    found = calibrate(captures, base, only=BOTH)
    assert [o.state for o in found.blocks] == REFUSED
    scale = (grid.mm_per_px_x, grid.mm_per_px_y)
    assert given == [(scale, seeded), (scale, ColorOptions())]
    with pytest.raises(InputError, match=r"(?s)background: needs the scale.*color: needs the scal"):
        calibrate(captures, only=BOTH)


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


def test_what_calibrates_nothing_is_refused_and_leaves_nothing(captures, replace_fit) -> None:
    replace_fit("background", refuse)
    kept = captures.parent / "kept"
    rows: list[tuple[dict[str, Any], str]] = [
        ({"only": ("markers",)}, "nothing could be calibrated\n  markers: needs"),
        ({"only": ("background",), "unfinished": kept}, "nothing could be calibrated"),
        ({"only": "colour"}, r"no block 'colour' \(did you mean color\?\); known: camera, scale"),
        ({"options": {"colour": None}}, "no block 'colour'"),
        ({"base": catalogue_profile("digit")}, "are of a gelsight, the profile to extend is of"),
    ]
    for how, said in rows:
        with pytest.raises(InputError, match=said):
            calibrate(captures, **how)
    assert not kept.exists()


def test_a_block_is_stopped_by_errors_and_not_by_warnings(captures: Path) -> None:
    edit_manifest(captures, "[indenter]\nradius_mm = 2.0\n", "")
    (blocked,) = calibrate(captures, only=BOTH).unfit
    assert blocked.message.startswith("needs the ball's radius; the radius of the ball is not")
    assert "30 to 50" not in blocked.message, "five presses are a warning"


def test_all_blocks_share_one_check_and_images_that_are_decoded_once(
    captures: Path, checked: list[str], replace_fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded: Counter[str] = Counter()
    real = images.read_apart

    def counted(what: str, *arguments: Any, **options: Any) -> Any:
        decoded[what] += 1
        return real(what, *arguments, **options)

    def asks(folder: CaptureFolder, base: Any, *_: object) -> None:
        block_findings.capture_findings(folder, "color")
        calibrate_background(folder, base)
        refuse()

    monkeypatch.setattr(images, "read_apart", counted)
    replace_fit("color", asks)
    assert [o.state for o in calibrate(captures, only=BOTH).blocks] == REFUSED
    assert len(checked) == 1
    assert decoded == Counter(dict.fromkeys(map(str, captures.glob("*.png")), 1))


@pytest.mark.thorough
def test_a_check_goes_with_its_captures_and_is_made_again_for_others(captures, checked) -> None:
    folder = load_capture_folder(captures)
    first = block_findings.capture_check(folder)
    assert block_findings.capture_check(folder) is first
    of_color = [finding for finding in first.findings if "color" in finding.blocks]
    assert block_findings.capture_findings(folder, "color") == of_color
    assert len(checked) == 1
    # Another folder in between takes nothing from the first.
    block_findings.capture_check(load_capture_folder(captures))
    assert block_findings.capture_check(folder) is first
    assert len(checked) == 2
    # What is changed of the captures is checked anew.
    block_findings.capture_check(replace(folder, mm_per_px=(0.1, 0.1)))
    assert len(checked) == 3
