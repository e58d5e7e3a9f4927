# SPDX-License-Identifier: Apache-2.0
"""Scripts of layouts: what your own script states is imported; its faults name their line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import import_captures, load_capture_folder
from taccel_lab.calibration.capture.camera.recording import natural_key
from taccel_lab.errors import InputError
from tests.calibration.capture.made_up_layouts import SCRIPTS, gelslim, layout_of, picture
from tests.support.capture_sets import write_image
from tests.support.commands import run

MINE = str(SCRIPTS / "my_bench.py")


def spot(u: int, v: int) -> np.ndarray:
    """A picture of 320 x 240 px whose red channel has a bright disc of 9 px around (u, v)."""
    rows, columns = np.mgrid[:240, :320]
    disc = np.hypot(columns - u, rows - v) < 9
    channels = [60 + 150 * disc, np.full_like(rows, 60), np.full_like(rows, 20)]
    return np.stack(channels, 2).astype(np.uint8)


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Two units in the layout of the documentation's script."""
    for unit in ("left", "right"):
        folder = tmp_path / "bench" / unit
        rows = ["file,x_px,y_px,r_px,travel_mm,fz_n,ball_mm"]
        for i, (u, v) in enumerate(((80, 90), (200, 150))):
            (folder / "pictures").mkdir(parents=True, exist_ok=True)
            write_image(folder / "pictures" / f"p{i}.jpg", spot(u, v))
            rows.append(f"p{i}.jpg,{u},{v},9,0.{i + 3},{'' if i else 1.5},{4 + i}")
        picture(folder / "untouched.png", size=(240, 320))
        (folder / "presses.csv").write_text("\n".join(rows))
        (folder / "stage.json").write_text(json.dumps({"camera": {"px_per_mm": 20.0}}))
    return tmp_path / "bench"


def test_the_documented_script(bench: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run("capture", "import", bench, out, "--layout", MINE) == 0
    for unit in ("left", "right"):
        captures = load_capture_folder(out / unit)
        assert (captures.sensor, captures.unit) == ("gelsight_mini", unit)
        assert captures.mm_per_px == (0.05, 0.05) and captures.ball_radii_mm() == {2.0: 1, 2.5: 1}
        assert captures.provenance["license"] == "CC0-1.0"
        assert "source" in captures.provenance and "radius_mm" not in captures.assumed
        assert [p.depth_mm for p in captures.presses] == [0.3, 0.4]
        assert [p.force_n for p in captures.presses] == [1.5, None]
        for press in captures.presses:
            red, circle = press.image()[..., 0] > 140, press.circle
            assert circle is not None
            v, u = (axis.mean() for axis in np.nonzero(red))
            assert (circle.u_px, circle.v_px) == pytest.approx((u, v), abs=0.5)


@pytest.mark.parametrize("read", ["stage.json", "presses.csv", "pictures/p0.jpg", "untouched.png"])
def test_links_out_of_the_source_are_not_followed(bench: Path, tmp_path: Path, read: str) -> None:
    path = bench / "left" / read
    path.rename(tmp_path / "private")
    path.symlink_to(tmp_path / "private")
    with pytest.raises(InputError, match="is a link out of"):
        import_captures(bench, tmp_path / "out", MINE)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "mine.py does not exist"),
        ("read = 1", "mine.py defines no read(source, options)"),
        ("def read(source, options): return []", "is not of the layout mine: a layout of your own"),
        ("def read(source, options): return [1]", "mine.py: read(source, options) returns a list"),
        ("def read(source, options):\n    return 1 / 0", "mine.py, line 2: ZeroDivisionError: "),
        ("def read(source, options", "mine.py: SyntaxError: "),
        ("import nothing_of_this_name", "mine.py, line 1: ModuleNotFoundError: "),
    ],
)
def test_faulty_scripts(tmp_path: Path, text: str | None, words: str) -> None:
    picture(tmp_path / "in" / "p.png")
    if text is not None:
        (tmp_path / "mine.py").write_text(text)
    with pytest.raises(InputError, match=re.escape(words)):
        import_captures(tmp_path / "in", tmp_path / "out", str(tmp_path / "mine.py"))
    assert not (tmp_path / "out").exists()


def test_a_row_with_half_a_place_is_refused(bench: Path, tmp_path: Path) -> None:
    (bench / "left" / "presses.csv").write_text("file,x_px,y_px,r_px\np0.jpg,3,4,\n")
    with pytest.raises(InputError, match=r"presses.csv: line 2: lacks r_px"):
        import_captures(bench, tmp_path / "out", MINE)


def test_sets_of_one_name_are_all_kept(tmp_path: Path) -> None:
    for place, count in (("a/x", 2), ("b/x", 3)):
        for name in ("ref", *(f"sample_{i}" for i in range(count))):
            picture(tmp_path / "in" / place / f"{name}.jpg")
    outs = import_captures(tmp_path / "in", tmp_path / "out", layout_of(gelslim))
    assert [len(load_capture_folder(out).presses) for out in outs] == [2, 3]


def test_natural_order() -> None:
    names = ["f_10", "f_2", "f_1", "g", "2", "10"]
    assert sorted(names, key=natural_key) == ["2", "10", "f_1", "f_2", "f_10", "g"]
    # Digits of other scripts are none.
    assert sorted(["²", "10", "2", "١"], key=natural_key)[:2] == ["2", "10"]
