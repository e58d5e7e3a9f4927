# SPDX-License-Identifier: Apache-2.0
"""Recipes: a layout of one's own is read as it says, and says what is wrong with it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import import_captures, load_capture_folder
from taccel_lab.calibration.capture.importers.path_pattern import find, natural_key
from taccel_lab.calibration.capture.importers.recipe_layout import RECIPES
from taccel_lab.errors import InputError
from tests.calibration.capture.made_up_layouts import picture
from tests.support.capture_sets import write_image
from tests.support.commands import run

DOCS = Path(__file__).parents[3] / "docs" / "capture_import.md"


def recipe(folder: Path, text: str) -> str:
    path = folder / "mine.toml"
    path.write_text(text)
    return str(path)


def of_docs() -> str:
    """The recipe of the documentation's page."""
    page = DOCS.read_text(encoding="utf-8").partition("### A layout of your own")[2]
    return page.partition("```toml\n")[2].partition("```")[0]


def spot(u: int, v: int) -> np.ndarray:
    """A picture of 320 x 240 px whose red channel has a bright disc of 9 px around (u, v)."""
    rows, columns = np.mgrid[:240, :320]
    disc = np.hypot(columns - u, rows - v) < 9
    channels = [60 + 150 * disc, np.full_like(rows, 60), np.full_like(rows, 20)]
    return np.stack(channels, 2).astype(np.uint8)


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Two units in the layout of the documentation's recipe."""
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


def test_the_documented_recipe(bench: Path, tmp_path: Path) -> None:
    mine = recipe(tmp_path, of_docs())
    out = tmp_path / "out"
    assert run("capture", "import", bench, out, "--layout", mine) == 0
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


def test_words_of_file_names_and_records(tmp_path: Path) -> None:
    source = tmp_path / "in"
    for name in ("4.0mm/a_0.30", "4.0mm/b_0.45", "6.0mm/c_0.20"):
        picture(source / f"{name}.png")
    picture(source / "4.0mm" / "ref.png")
    (source / "curve.csv").write_text("z,f,note\n0.1,0.2,1\n0.3,0.9,1\n")
    mine = recipe(
        tmp_path,
        "[[sets]]\nbackground = '*mm/ref.png'\npresses = { files = '{ball}mm/{who}_{depth}.png', "
        "diameter_mm = 'ball', depth_mm = 'depth', force_n = 'load', name = '{who}-{ball}' }\n"
        "radius_mm = 2\nrecord = { kind = 'indentation', file = 'curve.csv', "
        "columns = { z = 'depth_mm', f = 'force_n' } }\nwhy = { radius_mm = 'of the bench' }\n",
    )
    (out,) = import_captures(source, tmp_path / "out", mine)
    captures = load_capture_folder(out)
    assert [p.name for p in captures.presses] == ["a-4.0", "b-4.0", "c-6.0"]
    assert [p.depth_mm for p in captures.presses] == [0.3, 0.45, 0.2]
    assert captures.ball_radii_mm() == {2.0: 2, 3.0: 1}
    assert captures.assumed["radius_mm"] == "2 mm, of the bench"
    assert captures.records[0].columns["force_n"].tolist() == [0.2, 0.9]
    assert captures.records[0].entry.tool.radius_mm == 2
    text = (out / "captures.toml").read_text(encoding="utf-8")
    assert "# no press has its force_n: nothing is called load" in text


def test_sets_of_one_name_are_all_kept(tmp_path: Path) -> None:
    for place, count in (("a/x", 2), ("b/x", 3)):
        for name in ("ref", *(f"sample_{i}" for i in range(count))):
            picture(tmp_path / "in" / place / f"{name}.jpg")
    outs = import_captures(tmp_path / "in", tmp_path / "out", "gelslim")
    assert [len(load_capture_folder(out).presses) for out in outs] == [2, 3]


SET = "[[sets]]\npresses = '*.png'\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sets = []", "sets: list should have at least 1 item"),
        ("[[sets]]\nradius_mm = 2", "presses, edges, boards, a record or markers are needed"),
        (SET + "sensor = '../x'", "sets.0.sensor: string should match"),
        (SET + "sensor = 'gelsite'", "mine.toml: no sensor 'gelsite'"),
        (SET + "radius_mm = 1\ndiameter_mm = 2", "radius_mm or diameter_mm; one is enough"),
        (SET + "radius_mm = { key = 'r' }", "stand in the file settings; name it"),
        (SET + "background = '../b.png'", "'..' leads out of it"),
        (SET + "place = '..'", "'..' leads out of it"),
        (SET + "mask = '*a*b*c*'", "one name may have 3 wildcards"),
        (SET + "mask = '{A}.png'", "wildcards are"),
        (SET + "part = '../up'", "sets.0.part: string should match"),
        (SET + "crop = '0,0,9x9'", "sets.0.crop: unknown key"),
        ("[[sets]]\npresses = { files = 'a.png', name = '../{stem}' }", "sets.0.presses.name"),
        ("[[sets]]\npresses = { table = 'a.csv' }", "a table and image, its column"),
        ("[[sets]]\npresses = { table = 'a.csv', image = 'x', folder = '..' }", "leads out"),
        ("[[sets]]\npresses = { files = '{n}.png', radius_mm = 'n' }", "p.png: {n}: 'p' is not"),
        ("[[sets]]\npresses = 'q*.png'", "is not of the layout mine: a recipe of your own"),
        ("[[sets]]\nrecord = { kind = 'indentation' }", "a record has a file, or lists"),
    ],
)
def test_faulty_recipes(tmp_path: Path, text: str, words: str) -> None:
    picture(tmp_path / "in" / "p.png")
    with pytest.raises(InputError, match=re.escape(words)):
        import_captures(tmp_path / "in", tmp_path / "out", recipe(tmp_path, text))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("read", ["stage.json", "presses.csv", "pictures/p0.jpg", "untouched.png"])
def test_links_out_of_the_source_are_not_followed(bench: Path, tmp_path: Path, read: str) -> None:
    path = bench / "left" / read
    path.rename(tmp_path / "private")
    path.symlink_to(tmp_path / "private")
    with pytest.raises(InputError, match="is a link out of"):
        import_captures(bench, tmp_path / "out", recipe(tmp_path, of_docs()))
    assert not (tmp_path / "out").exists()


def test_patterns(tmp_path: Path) -> None:
    for name in ("a_1/x-2.png", "a_10/x-2.png", "a_2/x-3.png", "a_2/y*.png", ".a_3/x-2.png"):
        picture(tmp_path / name)

    def found(pattern: str, **known: str) -> list[tuple[str, dict[str, str]]]:
        return [(m.path.relative_to(tmp_path).as_posix(), dict(m.fields))
                for m in find(tmp_path, pattern, known)]  # fmt: skip

    assert found("a_{n:number}/x-{k}.png") == [
        ("a_1/x-2.png", {"n": "1", "k": "2"}),
        ("a_2/x-3.png", {"n": "2", "k": "3"}),
        ("a_10/x-2.png", {"n": "10", "k": "2"}),
    ]
    # A word that stands twice, or is known, is one and the same text, whatever it holds.
    assert [name for name, _ in found("a_{n}/x-{n}.png")] == []
    assert [name for name, _ in found("a_2/{k}.png", k="y*")] == ["a_2/y*.png"]
    names = ["f_10", "f_2", "f_1", "g", "2", "10"]
    assert sorted(names, key=natural_key) == ["2", "10", "f_1", "f_2", "f_10", "g"]
    # Digits of other scripts are none.
    assert sorted(["²", "10", "2", "١"], key=natural_key)[:2] == ["2", "10"]


def test_published_recipes_are_short() -> None:
    lengths = {path.stem: len(path.read_text().splitlines()) for path in RECIPES.glob("*.toml")}
    assert len(lengths) == 10 and max(lengths.values()) <= 40
