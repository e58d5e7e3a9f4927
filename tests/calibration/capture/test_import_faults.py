# SPDX-License-Identifier: Apache-2.0
"""Broken files, tables and settings of other projects: refused, or left out and told."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureFolder, import_captures, load_capture_folder
from taccel_lab.calibration.capture.importers import ImportOptions
from taccel_lab.calibration.capture.importers.label_tables import read_label_tables, read_labels
from taccel_lab.calibration.capture.records import is_record, read_columns
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from tests.calibration.capture.made_up_layouts import (
    cube_edges,
    feats,
    fots,
    gs_sdk,
    imported,
    layout_of,
    ninedtact,
    picture,
    plain,
    py3dcal,
    rvsathu,
    source_of,
)
from tests.support.capture_sets import gel, press, spread_circles, write_image

CIRCLES = spread_circles(8)


def levels(image: np.ndarray) -> np.ndarray:
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "source"
    folder.mkdir()
    write_image(folder / "background.png", levels(gel()))
    for i, circle in enumerate(CIRCLES):
        write_image(folder / f"p{i}.png", levels(press(circle)))
    return folder


def taken(source: Path, layout: str = "auto") -> tuple[CaptureFolder, str]:
    """The one folder that is made of it, and its manifest."""
    (captures,) = imported(source, layout)
    return captures, (source.parent / "out" / "captures.toml").read_text(encoding="utf-8")


def test_broken_files_are_left_out_and_named(source: Path) -> None:
    (source / "p1.png").write_bytes(b"")
    whole = (source / "p2.png").read_bytes()
    (source / "p2.png").write_bytes(whole[: len(whole) // 2])
    captures, manifest = taken(source)
    assert [p.name for p in captures.presses] == ["p0", "p3", "p4", "p5", "p6", "p7"]
    assert "# left out, 1 file (p1.png): is empty (0 bytes)" in manifest
    assert "# left out, 1 file (p2.png): is not an image" in manifest


@pytest.mark.parametrize("name", ["p1.png", "background.png"])
def test_what_a_link_names_is_not_taken_in(source: Path, name: str) -> None:
    """The folder that is written is one that people publish."""
    (source / name).rename(source.parent / "private.png")
    (source / name).symlink_to("../private.png")
    with pytest.raises(InputError, match=rf"{name} is a link out of .*; put the file itself there"):
        taken(source)
    assert not (source.parent / "out").exists()


def test_an_image_of_gigabytes_is_refused_before_it_is_copied(tmp_path: Path) -> None:
    rvsathu(tmp_path / "s")
    image = tmp_path / "s" / "calib_10_real.png"
    os.truncate(image, 1 << 30)
    with pytest.raises(InputError) as error:
        import_captures(tmp_path / "s", tmp_path / "out", layout_of(rvsathu))
    # Of the image itself; the copy's refusal would add where it was imported from.
    assert str(error.value) == f"{image} has 1 GiB; an image may have up to 512 MiB"


def test_sixteen_bits(tmp_path: Path) -> None:
    image = levels(gel())
    cv2.imwrite(str(tmp_path / "full.png"), image.astype(np.uint16) * 257)
    assert np.array_equal(read_image(tmp_path / "full.png"), image[..., ::-1])
    cv2.imwrite(str(tmp_path / "raw.png"), image.astype(np.uint16) * 16)
    with pytest.raises(InputError, match=r"raw\.png has 16 bits and no value above .* 65535"):
        read_image(tmp_path / "raw.png")
    cv2.imwrite(str(tmp_path / "float.tiff"), image.astype(np.float32) / 255)
    with pytest.raises(InputError, match=r"float\.tiff holds float32 values"):
        read_image(tmp_path / "float.tiff")


def test_tables_of_spreadsheets_and_lists_of_circles(tmp_path: Path) -> None:
    table = tmp_path / "circles.csv"
    table.write_bytes("Datei;file;cx;cy;r\n\xfc;a.png;1,5;2;30,25\n".encode("latin-1"))
    assert read_labels(table) == {"a.png": {"u_px": 1.5, "v_px": 2.0, "radius_px": 30.25}}
    record = tmp_path / "record.csv"
    record.write_bytes(b"\xef\xbb\xbfdepth_mm,force_n\n0,0\n0.1,0.2\n")
    assert is_record(record)
    assert set(read_columns(record)) == {"depth_mm", "force_n"}
    table.write_text("a.png (204, 98) 31\nb.png (10, 20) 5.5\n")
    labels = read_labels(table)
    assert labels is not None and labels["b.png"] == {"u_px": 10, "v_px": 20, "radius_px": 5.5}
    for none in ("image, u_px, v_px, radius_px\n", "nothing of the kind\n"):
        table.write_text(none)
        assert read_labels(table) is None


def test_labels_without_effect_are_told(source: Path) -> None:
    (source / "mine.csv").write_text("picture,column\np0.png,3\n")
    (source / "circles.csv").write_text("file,cx,cy,r\np0.png,60,60,12\nq9.png,60,60,12\n")
    captures, manifest = taken(source)
    assert captures.contents()["labelled_presses"] == 1
    said = next(line for line in manifest.splitlines() if "left out, 1 file (mine.csv)" in line)
    for word in ("the image (file, ", "press)", "cx_px", "cy_px", "radius_px", "without the end"):
        assert word in said
    assert "circles without an image here, or of no press: q9.png" in manifest


@pytest.mark.parametrize(
    "table",
    [
        "press,cx_px,cy_px,radius_px\n{0},60,50,12\n",
        "{0} (60, 50) 12\n",
        "file,cx,cy,r\n{0}.png,60,50,12\n",
    ],
)
@pytest.mark.parametrize("name", ["deep/a", "a", "b", "b.c", "deep/b"])
def test_labels_name_images_with_or_without_the_ending(source: Path, table: str, name: str) -> None:
    (source / "deep").mkdir()
    for stem in ("deep/a", "deep/b", "b", "b.c"):
        picture(source / f"{stem}.png")
    (source / "labels.txt").write_text(table.format(name))
    tables, images = read_label_tables(source), [*source.rglob("*.png")]
    if name == "b" and ".png" not in table:
        with pytest.raises(
            InputError, match=r"'b' may be .*b.png or .*b.png; name images by their"
        ):
            tables.of_images(images)
        return
    whole = "deep/a.png" if name == "a" else f"{name}.png"
    assert [image.relative_to(source).as_posix() for image in tables.of_images(images)] == [whole]


def test_rvsathu_with_another_background(tmp_path: Path) -> None:
    source = source_of(rvsathu, tmp_path)
    (source / "background_real.png").rename(source / "bg.png")
    captures, _ = taken(source, layout_of(rvsathu))
    assert captures.background is not None
    (source / "bg.png").unlink()
    captures, manifest = taken(source, layout_of(rvsathu))
    assert captures.background is None and "background_real.png is missing; give" in manifest


Make = Callable[[Path], None]
BOARD = "camera_calibration: {row_points: 7, col_points: 9, grid_distance: 2.5}\n"


def refused(source: Path, options: ImportOptions | None = None, layout: str = "auto") -> str:
    with pytest.raises(InputError) as caught:
        import_captures(source, source.parent / "out", layout, options)
    assert not (source.parent / "out").exists()
    return str(caught.value)


def metadata(px_per_mm: object) -> str:
    return json.dumps({"px_per_mm": px_per_mm, "probe_radius_mm": 2.0})


def indentations(**values: object) -> str:
    known = {"indenter": "radius 7.5 mm", "indentation_mm": [0.5], "normal_force_N": [1.65]}
    return json.dumps(known | values)


def saved(**arrays: object) -> bytes:
    """A ``.npz``."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


FAULTS: list[tuple[Make, str, str | bytes | None, str]] = [
    (ninedtact, "shape_config.yaml", "camera_calibration: {row_points: seven}",
     "shape_config.yaml: camera_calibration.row_points is 'seven'; a number is needed"),
    (ninedtact, "shape_config.yaml", BOARD.replace("9", "7.5"),
     "camera_calibration.col_points is 7.5; a whole number is needed"),
    (ninedtact, "shape_config.yaml", "camera_calibration: {row_points: 7, col_points: 9}",
     "grid_distance of"),
    (gs_sdk, "gsmini.yaml", "ppmm: 15.8\n", "mm_per_px_x"),
    (gs_sdk, "gsmini.yaml", "ppmm: [1,", "gsmini.yaml cannot be read as YAML"),
    (gs_sdk, "4.760mm/0/label.npz", saved(center=np.zeros(2), radius="x"),
     "radius has type <U1; real numbers"),
    (cube_edges, "2/label.npz", saved(line_center=np.zeros(3)),
     "2/label.npz lacks line_length and line_angle"),
    (gs_sdk, "4.760mm/0/gelsight.png", None, "0/gelsight.png does not exist"),
    (cube_edges, "2/label.npz", None, "2/label.npz"),
    (py3dcal, "annotations/annotations.csv", "img_name\n../../secret.png\n", "'..' leads out"),
    (py3dcal, "annotations/annotations.csv", "img_name\n/etc/secret.png\n", "absolute path"),
    (py3dcal, "annotations/annotations.csv", "img_name,depth_mm\n0.png,1_0\n",
     "csv: line 2: column depth_mm: '1_0' is not"),
    (py3dcal, "annotations/annotations.csv", "file\n0.png\n", "lacks a column img_name"),
    (py3dcal, "annotations/metadata.json", metadata(0), "px_per_mm is 0; a positive number"),
    (py3dcal, "probe_images/0.png", None, "0.png does not exist"),
    (feats, "force_indentation.json", indentations(indenter="radius 7.5.1 mm"),
     "force_indentation.json: '7.5.1' is not a number"),
    (feats, "force_indentation.json", indentations(indentation_mm=["x"]), "json: could"),
    (fots, "mlp_calib/gelsight/0001.png", "x", "is not an image"),
    (plain, "labels.csv", "name,x,y,radius,X\na_2.png,3,2,1,4\n", "has the columns x and X"),
    (plain, "labels.csv", "name,x,y,radius\na_2.png,3,2,1\na_2.png,3,2,2\n", "has two circles of"),
    (plain, "more.csv", "name,x,y,radius\na_2.png,3,2,1\n", "have different circles of 'a_2.png'"),
    (plain, "press.csv", "depth_mm,force_n,force_n\n0.2,0.1,0.1\n", "twice"),
]  # fmt: skip
"""Layout, its file, what it holds (None: it is gone), words of the refusal."""


@pytest.mark.parametrize(("make", "file", "content", "words"), FAULTS)
def test_faulty_files(
    tmp_path: Path, make: Make, file: str, content: str | bytes | None, words: str
) -> None:
    source = source_of(make, tmp_path)
    if content is None:
        (source / file).unlink()
    else:
        (source / file).write_bytes(content if isinstance(content, bytes) else content.encode())
    if file == "press.csv":  # Not a table of circles: the folder is taken, the file told.
        (out,) = import_captures(source, tmp_path / "out")
        assert words in (out / "captures.toml").read_text(encoding="utf-8")
        return
    assert words in refused(source, layout=layout_of(make))


def test_settings_of_the_9dtact_are_taken(tmp_path: Path) -> None:
    source = source_of(ninedtact, tmp_path)
    (source / "shape_config.yaml").write_text(
        "camera_calibration: {row_points: 5, col_points: 9, grid_distance: 3}\n"
        "depth_calibration: {BallRad: 2.5}\n"
    )
    captures = imported(source)[0]
    board = captures.boards[0].entry
    assert (board.rows, board.columns, board.pitch_mm) == (5, 9, 3.0)
    assert captures.ball_radius_mm == 2.5


def test_a_bare_file_name_of_two_images(tmp_path: Path) -> None:
    source = tmp_path / "source"
    for name in ("bg", "a/1", "b/1"):
        picture(source / f"{name}.png")
    table = source / "labels.csv"
    for name in ("1.png", "1"):
        table.write_text(f"name,x,y,radius\n{name},30,20,11\n")
        assert f"labels.csv: '{name}' may be a/1.png or b/1.png; name images by" in refused(source)
    table.write_text("name,x,y,radius\nb/1.png,30,20,11\n1.png,31,21,12\n")
    captures = load_capture_folder(import_captures(source, tmp_path / "out")[0])
    circles = {press.name: press.circle for press in captures.presses}
    found = {name: None if circle is None else circle.u_px for name, circle in circles.items()}
    assert found == {"a_1": 31.0, "b_1": 30.0}


@pytest.mark.parametrize("content", [b"name\0x", "name,x".encode("utf-16"), b'"name,x\n', b""])
def test_files_that_are_no_tables_are_told(tmp_path: Path, content: bytes) -> None:
    source = source_of(plain, tmp_path)
    (source / "odd.csv").write_bytes(content)
    (out,) = import_captures(source, tmp_path / "out")
    manifest = (out / "captures.toml").read_text(encoding="utf-8")
    assert manifest.count("odd.csv") == 1 and "# left out, 1 file (odd.csv): " in manifest
    assert load_capture_folder(out).contents()["labelled_presses"] == 1


def test_image_names_that_are_no_text(tmp_path: Path) -> None:
    source = source_of(plain, tmp_path)
    os.rename(os.fsencode(source / "a_1.png"), os.fsencode(source) + b"/gr\xf6sse.png")
    assert r"the file name gr\udcf6sse.png is not UTF-8; rename it" in refused(source)


def test_a_folder_whose_name_is_no_text(tmp_path: Path) -> None:
    source = Path(os.fsdecode(os.fsencode(tmp_path) + b"/m\xe4rz\n\x07"))
    source.mkdir()
    plain(source)
    (out,) = import_captures(source, tmp_path / "out")
    source_text = load_capture_folder(out).provenance["source"]
    assert source_text == r"unknown; imported from m\udce4rz\n\x07, layout plain"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (ImportOptions(board="chessboard:6x6:2.5.1"), "the pitch: '2.5.1' is not a number"),
        (ImportOptions(board="chessboard:6x" + "9" * 5000), "kind:COLUMNSxROWS"),
    ],
)
def test_options_with_odd_numbers(tmp_path: Path, options: ImportOptions, words: str) -> None:
    assert words in refused(source_of(plain, tmp_path), options)
