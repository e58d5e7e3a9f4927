# SPDX-License-Identifier: Apache-2.0
"""Broken files, tables, settings, flags and scripts of imports: refused, or left out and told."""

from __future__ import annotations

import io
import json
import os
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureFolder, load_capture_folder
from taccel_lab.calibration.capture.importers import detect_layout, read_drafts
from taccel_lab.calibration.capture.importers.label_tables import read_label_tables, read_labels
from taccel_lab.calibration.capture.records import is_record, read_columns
from taccel_lab.calibration.capture.sensor_facts import SAME_SHAPE
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.sensors.registry import sensor_family
from tests.calibration.capture import made_up_layouts as layouts
from tests.calibration.capture.made_up_layouts import imported, layout_of, source_of, write_text
from tests.calibration.drawn.faults import quantise
from tests.support.capture_sets import gel, press, spread_circles, write_image
from tests.support.commands import run


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "source"
    folder.mkdir()
    write_image(folder / "background.png", quantise(gel()))
    for i, circle in enumerate(spread_circles(8)):
        write_image(folder / f"p{i}.png", quantise(press(circle)))
    return folder


def taken(source: Path, layout: str = "auto") -> tuple[CaptureFolder, str]:
    """The one folder that is made of it, and its manifest."""
    (captures,) = imported(source, layout)
    return captures, layouts.manifest_of(source)


def refused(source: Path, layout: str = "auto", **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        imported(source, layout, **options)
    assert not (source.parent / "out").exists()
    return str(caught.value)


def test_broken_files_are_left_out_and_named(source: Path) -> None:
    (source / "p1.png").write_bytes(b"")
    os.truncate(source / "p2.png", (source / "p2.png").stat().st_size // 2)
    captures, manifest = taken(source)
    assert [p.name for p in captures.presses] == ["p0", "p3", "p4", "p5", "p6", "p7"]
    assert "# left out, 1 file (p1.png): is empty (0 bytes)" in manifest
    assert "# left out, 1 file (p2.png): is not an image" in manifest


@pytest.mark.parametrize("name", ["p1.png", "background.png"])
def test_what_a_link_names_is_not_taken_in(source: Path, name: str) -> None:
    """The folder that is written is one that people publish."""
    (source / name).rename(source.parent / "private.png")
    (source / name).symlink_to("../private.png")
    said = refused(source)
    assert f"{name} is a link out of " in said and "; put the file itself there" in said


def test_an_image_of_gigabytes_is_refused_before_it_is_copied(tmp_path: Path) -> None:
    source = source_of("rvsathu", tmp_path)
    image = source / "calib_10_real.png"
    os.truncate(image, 1 << 30)
    # Of the image itself; the copy's refusal would add where it was imported from.
    said = refused(source, layout_of("rvsathu"))
    assert said == f"{image} has 1 GiB; an image may have up to 512 MiB"


def test_sixteen_bits(tmp_path: Path) -> None:
    image = quantise(gel())
    cv2.imwrite(str(tmp_path / "full.png"), image.astype(np.uint16) * 257)
    assert np.array_equal(read_image(tmp_path / "full.png"), image[..., ::-1])
    cv2.imwrite(str(tmp_path / "raw.png"), image.astype(np.uint16) * 16)
    with pytest.raises(InputError, match=r"raw\.png has 16 bits and no value above .* 65535"):
        read_image(tmp_path / "raw.png")
    cv2.imwrite(str(tmp_path / "float.tiff"), image.astype(np.float32) / 255)
    with pytest.raises(InputError, match=r"float\.tiff holds float32 values"):
        read_image(tmp_path / "float.tiff")


def test_tables_of_spreadsheets_and_lists_of_circles(tmp_path: Path) -> None:
    table, record = tmp_path / "circles.csv", tmp_path / "record.csv"
    table.write_bytes("Datei;file;cx;cy;r\n\xfc;a.png;1,5;2;30,25\n".encode("latin-1"))
    assert read_labels(table) == {"a.png": {"u_px": 1.5, "v_px": 2.0, "radius_px": 30.25}}
    record.write_bytes(b"\xef\xbb\xbfdepth_mm, force_n\n0,0\n0.1,0.2\n")
    assert is_record(record) and set(read_columns(record)) == {"depth_mm", "force_n"}
    table.write_text("a.png (204, 98) 31\nb.png (10, 20) 5.5\n")
    labels = read_labels(table)
    assert labels is not None and labels["b.png"] == {"u_px": 10, "v_px": 20, "radius_px": 5.5}
    for none in ("image, u_px, v_px, radius_px\n", "nothing of the kind\n"):
        table.write_text(none)
        assert read_labels(table) is None and not is_record(table)


def test_labels_without_effect_are_told(source: Path) -> None:
    (source / "mine.csv").write_text("picture,column\np0.png,3\n")
    (source / "circles.csv").write_text("file,cx,cy,r\np0.png,60,60,12\nq9.png,60,60,12\n")
    captures, manifest = taken(source)
    assert captures.contents()["labelled_presses"] == 1
    said = next(line for line in manifest.splitlines() if "left out, 1 file (mine.csv)" in line)
    for word in ("the image (file, ", "press)", "cx_px", "cy_px", "radius_px", "without the end"):
        assert word in said
    assert "circles without an image here, or of no press: q9.png" in manifest


@pytest.mark.parametrize("table", [
    "press,cx_px,cy_px,radius_px\n{0},60,50,12\n",
    "{0} (60, 50) 12\n",
    "file,cx,cy,r\n{0}.png,60,50,12\n",
])  # fmt: skip
@pytest.mark.parametrize("name", ["deep/a", "a", "b", "b.c", "deep/b"])
def test_labels_name_images_with_or_without_end(tmp_path: Path, table: str, name: str) -> None:
    layouts.pictures(tmp_path, *(f"{stem}.png" for stem in ("deep/a", "deep/b", "b", "b.c")))
    (tmp_path / "labels.txt").write_text(table.format(name))
    tables, images = read_label_tables(tmp_path), [*tmp_path.rglob("*.png")]
    if name == "b" and ".png" not in table:
        with pytest.raises(InputError, match=r"'b' may be .*b.png or .*b.png; name images by the"):
            tables.of_images(images)
        return
    whole = "deep/a.png" if name == "a" else f"{name}.png"
    assert [image.relative_to(tmp_path).as_posix() for image in tables.of_images(images)] == [whole]


def test_rvsathu_with_another_background(tmp_path: Path) -> None:
    source = source_of("rvsathu", tmp_path)
    (source / "background_real.png").rename(source / "bg.png")
    captures, _ = taken(source, layout_of("rvsathu"))
    assert captures.background is not None
    (source / "bg.png").unlink()
    captures, manifest = taken(source, layout_of("rvsathu"))
    assert captures.background is None and "background_real.png is missing; give" in manifest


BOARD = "camera_calibration: {row_points: 7, col_points: 9, grid_distance: 2.5}\n"


def metadata(px_per_mm: object) -> str:
    return json.dumps({"px_per_mm": px_per_mm, "probe_radius_mm": 2.0})


def indentations(**values: object) -> str:
    known = {"indenter": "radius 7.5 mm", "indentation_mm": [0.5], "normal_force_N": [1.65]}
    return json.dumps(known | values)


def saved(**arrays: Any) -> bytes:
    """A ``.npz``."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("name", "file", "content", "words"),  # Of the content None: the file is gone.
    [
        ("9dtact", "shape_config.yaml", "camera_calibration: {row_points: seven}",
         "shape_config.yaml: camera_calibration.row_points is 'seven'; a number is needed"),
        ("9dtact", "shape_config.yaml", BOARD.replace("9", "7.5"),
         "camera_calibration.col_points is 7.5; a whole number is needed"),
        ("9dtact", "shape_config.yaml", "camera_calibration: {row_points: 7, col_points: 9}",
         "grid_distance of"),
        ("9dtact", "shape_config.yaml", None, "--board dots:COLUMNSxROWS:PI"),
        ("taxim", "params.json", None, " with --mm-per-px-x"),
        ("gs-sdk", "gsmini.yaml", "ppmm: 15.8\n", "mm_per_px_x"),
        ("gs-sdk", "gsmini.yaml", "ppmm: [1,", "gsmini.yaml cannot be read as YAML"),
        ("gs-sdk", "4.760mm/0/label.npz", saved(center=np.zeros(2), radius="x"),
         "radius has type <U1; real numbers"),
        ("gs-sdk", "4.760mm/0/gelsight.png", None, "0/gelsight.png does not exist"),
        ("cube-edges", "2/label.npz", saved(line_center=np.zeros(3)),
         "2/label.npz lacks line_length and line_angle"),
        ("cube-edges", "2/label.npz", None, "2/label.npz"),
        ("py3dcal", "annotations/annotations.csv", "img_name\n../../secret.png\n", "leads out"),
        ("py3dcal", "annotations/annotations.csv", "img_name\n/etc/secret.png\n", "absolute path"),
        ("py3dcal", "annotations/annotations.csv", "img_name,depth_mm\n0.png,1_0\n",
         "csv: line 2: column depth_mm: '1_0' is not"),
        ("py3dcal", "annotations/annotations.csv", "file\n0.png\n", "lacks a column img_name"),
        ("py3dcal", "annotations/metadata.json", metadata(0), "px_per_mm is 0; a positive number"),
        ("py3dcal", "probe_images/0.png", None, "0.png does not exist"),
        ("feats", "force_indentation.json", indentations(indenter="radius 7.5.1 mm"),
         "force_indentation.json: '7.5.1' is not a number"),
        ("feats", "force_indentation.json", indentations(indentation_mm=["x"]), "json: could"),
        ("fots", "mlp_calib/gelsight/0001.png", "x", "is not an image"),
        ("plain", "labels.csv", "name,x,y,radius,X\na_2.png,3,2,1,4\n", "has the columns x and X"),
        ("plain", "labels.csv", "name,x,y,radius\na_2.png,3,2,1\na_2.png,3,2,2\n",
         "has two circles of"),
        ("plain", "more.csv", "name,x,y,radius\na_2.png,3,2,1\n",
         "have different circles of 'a_2.png'"),
    ],
)  # fmt: skip
def test_faulty_files(
    tmp_path: Path, name: str, file: str, content: str | bytes | None, words: str
) -> None:
    source = source_of(name, tmp_path)
    if content is None:
        (source / file).unlink()
    else:
        (source / file).write_bytes(content if isinstance(content, bytes) else content.encode())
    assert words in refused(source, name if name in layouts.MAKERS else layout_of(name))


@pytest.mark.parametrize(("name", "options", "words"), [
    ("plain", {"board": "chessboard:6x6:2.5.1"}, "the pitch: '2.5.1' is not a number"),
    ("plain", {"board": "chessboard:6x" + "9" * 5000}, "kind:COLUMNSxROWS"),
    ("plain", {"board": "8x6"}, "kind:COLUMNSxROWS"),
    ("9dtact", {"board": "dots:9x7"}, "the pitch is missing"),
    # Flags that nothing would follow.
    ("ruihangao", {"board": "dots:9x7:2.5"}, "--board was given, but .* has no boards"),
    ("ruihangao", {"edge_mm": 3.0}, "--edge-mm was given, but .* has no edges"),
    ("plain", {"radius_mm": 0.00292}, r"--radius-mm .* 0.05 to 50 mm .* metres \(2.92 mm\)"),
    ("plain", {"radius_mm": 51.0}, "--radius-mm is 51; 0.05 to 50 mm is allowed$"),
    ("plain", {"mm_per_px_x": 5.9e-05}, r"--mm-per-px-x .* 1 mm/px .* \(0.059 mm/px\)"),
    ("plain", {"edge_mm": float("nan")}, "--edge-mm is nan; 0.1 to 200 mm is allowed$"),
])  # fmt: skip
def test_faulty_flags(tmp_path: Path, name: str, options: dict[str, Any], words: str) -> None:
    assert re.search(words, refused(source_of(name, tmp_path), layout_of(name), **options))


def test_a_bare_file_name_of_two_images(tmp_path: Path) -> None:
    source = tmp_path / "source"
    layouts.pictures(source, "bg", "a/1", "b/1")
    table = source / "labels.csv"
    for name in ("1.png", "1"):
        table.write_text(f"name,x,y,radius\n{name},30,20,11\n")
        assert f"labels.csv: '{name}' may be a/1.png or b/1.png; name images by" in refused(source)
    table.write_text("name,x,y,radius\nb/1.png,30,20,11\n1.png,31,21,12\n")
    presses = taken(source)[0].presses
    assert {p.name: p.circle and p.circle.u_px for p in presses} == {"a_1": 31.0, "b_1": 30.0}


@pytest.mark.parametrize(("content", "words"), [
    (b"name\0x", ""), ("name,x".encode("utf-16"), ""), (b'"name,x\n', ""), (b"", ""),
    (b"depth_mm,force_n,force_n\n0.2,0.1,0.1\n", "twice"),
])  # fmt: skip
def test_files_that_are_no_tables_are_told(tmp_path: Path, content: bytes, words: str) -> None:
    source = source_of("plain", tmp_path)
    (source / "odd.csv").write_bytes(content)
    captures, manifest = taken(source)
    assert manifest.count("odd.csv") == 1 and words in manifest
    assert "# left out, 1 file (odd.csv): " in manifest
    assert captures.contents()["labelled_presses"] == 1


def test_names_that_are_no_text(tmp_path: Path) -> None:
    source = Path(os.fsdecode(os.fsencode(tmp_path) + b"/m\xe4rz\n\x07"))
    source.mkdir()
    layouts.MAKERS["plain"](source)
    told = imported(source)[0].provenance["source"]
    assert told == r"unknown; imported from m\udce4rz\n\x07, layout plain"
    source = source_of("plain", tmp_path / "other")
    os.rename(os.fsencode(source / "a_1.png"), os.fsencode(source) + b"/gr\xf6sse.png")
    assert r"the file name gr\udcf6sse.png is not UTF-8; rename it" in refused(source)


def test_nothing_to_import(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"follows none of the layouts known: taxim \(Taxim"):
        detect_layout(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        detect_layout(tmp_path / "gone")
    layouts.picture(tmp_path / "a.png")
    for layout, words in (
        ("x", "no layout 'x'; known: auto, taxim"),
        ("fot", r"no layout .fot. \(did you mean fots"),
        ("fots", "is not of the layout fots"),
        ("printer", "is not of the layout printer"),
    ):
        with pytest.raises(InputError, match=words):
            read_drafts(tmp_path, layout)
    (tmp_path / "captures.toml").write_text("")
    assert "is a capture folder already" in refused(tmp_path)


MINE = str(layouts.EXAMPLES / "my_bench.py")


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
        layouts.picture(folder / "untouched.png", size=(240, 320))
        rows = ["file,x_px,y_px,r_px,travel_mm,fz_n,ball_mm"]
        (folder / "pictures").mkdir()
        for i, (u, v) in enumerate(((80, 90), (200, 150))):
            write_image(folder / "pictures" / f"p{i}.jpg", spot(u, v))
            rows.append(f"p{i}.jpg,{u},{v},9,0.{i + 3},{'' if i else 1.5},{4 + i}")
        write_text(folder / "presses.csv", "\n".join(rows))
        write_text(folder / "stage.json", json.dumps({"camera": {"px_per_mm": 20.0}}))
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
        assert [(p.depth_mm, p.force_n) for p in captures.presses] == [(0.3, 1.5), (0.4, None)]
        for one in captures.presses:
            assert one.circle is not None
            v, u = (axis.mean() for axis in np.nonzero(one.image()[..., 0] > 140))
            assert (one.circle.u_px, one.circle.v_px) == pytest.approx((u, v), abs=0.5)


@pytest.mark.parametrize("read", ["stage.json", "presses.csv", "pictures/p0.jpg", "untouched.png"])
def test_scripts_follow_no_links_out_of_the_source(bench: Path, read: str) -> None:
    path = bench / "left" / read
    path.rename(bench.parent / "private")
    path.symlink_to(bench.parent / "private")
    assert "is a link out of" in refused(bench, MINE)


@pytest.mark.parametrize(("text", "words"), [
    (None, "mine.py does not exist"),
    ("read = 1", "mine.py defines no read(source, options)"),
    ("def read(source, options): return []", "is not of the layout mine: a layout of your own"),
    ("def read(source, options): return [1]", "mine.py: read(source, options) returns a list"),
    ("def read(source, options):\n    return 1 / 0", "mine.py, line 2: ZeroDivisionError: "),
    ("def read(source, options", "mine.py: SyntaxError: "),
    ("import nothing_of_this_name", "mine.py, line 1: ModuleNotFoundError: "),
])  # fmt: skip
def test_faulty_scripts(tmp_path: Path, text: str | None, words: str) -> None:
    layouts.picture(tmp_path / "in" / "p.png")
    if text is not None:
        (tmp_path / "mine.py").write_text(text)
    assert words in refused(tmp_path / "in", str(tmp_path / "mine.py"))


def test_a_row_with_half_a_place_is_refused(bench: Path) -> None:
    (bench / "left" / "presses.csv").write_text("file,x_px,y_px,r_px\np0.jpg,3,4,\n")
    assert "presses.csv: line 2: lacks r_px" in refused(bench, MINE)


def test_a_scale_of_the_catalogue_is_taken_where_none_is_stated(source: Path) -> None:
    """The sensor has to be stated, and to have images of these proportions."""
    assert "needs the sensor" in refused(source, scale="catalogue")
    height, width = gel().shape[:2]
    grid = sensor_family("gelsight_mini").parameters().grid()
    alike = abs(height * grid.width_px / width / grid.height_px - 1) <= SAME_SHAPE
    assert alike
    (captures,) = imported(source, scale="catalogue", sensor="gelsight_mini")
    assert captures.mm_per_px is not None
    assert captures.mm_per_px[0] * width == pytest.approx(grid.width_px * grid.mm_per_px_x)
    assert "the usual one of the catalogue's gelsight_mini" in captures.assumed["mm_per_px"]


def test_a_stated_scale_wins_over_that_of_the_catalogue(source: Path) -> None:
    (captures,) = imported(source, scale="catalogue", sensor="gelsight_mini", mm_per_px_x=0.05)
    assert captures.mm_per_px == (0.05, 0.05) and "mm_per_px" not in captures.assumed


def test_images_that_cannot_have_the_catalogues_scale_are_refused(source: Path) -> None:
    for path in source.glob("*.png"):
        write_image(path, read_image(path)[:, :100])
    said = refused(source, scale="catalogue", sensor="gelsight_mini")
    assert "cannot show the same part of the gel" in said and "--mm-per-px-x" in said
