# SPDX-License-Identifier: Apache-2.0
"""Tables and settings of other projects: numbers are numbers, names stay in the folder."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import import_captures, load_capture_folder
from taccel_lab.calibration.capture.importers import ImportOptions
from taccel_lab.errors import InputError
from taccel_lab.files.yaml_file import YAML_LIMIT_BYTES
from tests.calibration.capture.made_up_layouts import (
    cube_edges,
    feats,
    fots,
    gs_sdk,
    imported,
    ninedtact,
    picture,
    plain,
    py3dcal,
    source_of,
    taxim,
)

Make = Callable[[Path], None]
BOARD = "camera_calibration: {row_points: 7, col_points: 9, grid_distance: 2.5}\n"
CATALOG = "experiment_reldir,diameter(mm)\n"


def refused(source: Path, options: ImportOptions | None = None) -> str:
    with pytest.raises(InputError) as caught:
        import_captures(source, source.parent / "out", options=options)
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


def alone(array: np.ndarray) -> bytes:
    """A ``.npy``."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


FAULTS: list[tuple[Make, str, str | bytes | None, str]] = [
    (ninedtact, "shape_config.yaml", "camera_calibration: {row_points: seven}",
     "shape_config.yaml: camera_calibration.row_points is 'seven'; a number is needed"),
    (ninedtact, "shape_config.yaml", BOARD.replace("9", "7.5"),
     "camera_calibration.col_points is 7.5; a whole number is needed"),
    (ninedtact, "shape_config.yaml", BOARD + "depth_calibration: {BallRad: 2026-01-01}",
     "depth_calibration.BallRad is '2026-01-01'; a number is needed"),
    (ninedtact, "shape_config.yaml", "camera_calibration: {row_points: 7, col_points: 9}",
     "grid_distance of"),
    (gs_sdk, "gsmini.yaml", "ppmm: true\n", "ppmm is True; a number is needed"),
    (gs_sdk, "gsmini.yaml", "ppmm: 15.8\n", "ppmm is 15.8; gs_sdk"),
    (gs_sdk, "gsmini.yaml", "ppmm: [1,", "gsmini.yaml cannot be read as YAML"),
    (gs_sdk, "catalog.csv", CATALOG + "4.760mm/0,4.7_6\n", "line 2: column diameter(mm): '4.7_6'"),
    (gs_sdk, "catalog.csv", CATALOG + "x,1\n", "x/gelsight.png does not exist"),
    (gs_sdk, "catalog.csv", CATALOG + "../other,4.76\n", "'..' leads out of it"),
    (gs_sdk, "catalog.csv", CATALOG + "/etc,4.76\n", "not by an absolute path"),
    (gs_sdk, "catalog.csv", CATALOG + "x" * 5000 + ",4.76\n", "File name too long"),
    (gs_sdk, "4.760mm/0/label.npz", "x", "label.npz is not a"),
    (gs_sdk, "4.760mm/0/label.npz", saved(center=np.zeros(2), radius="x"),
     "radius has type <U1; real numbers"),
    (cube_edges, "2/label.npz", saved(line_center=np.zeros(3)),
     "2/label.npz lacks line_length and line_angle"),
    (cube_edges, "2/gelsight.png", None, "2/gelsight.png does not exist"),
    (py3dcal, "annotations/annotations.csv", "img_name\n../../secret.png\n", "'..' leads out"),
    (py3dcal, "annotations/annotations.csv", "img_name\n/etc/secret.png\n", "absolute path"),
    (py3dcal, "annotations/annotations.csv", "img_name,img_name\n0.png,0.png\n", "twice"),
    (py3dcal, "annotations/annotations.csv", "img_name,depth_mm\n0.png,1_0\n",
     "csv: line 2: column depth_mm: '1_0' is not"),
    (py3dcal, "annotations/annotations.csv", "file\n0.png\n", "lacks a column img_name"),
    (py3dcal, "annotations/metadata.json", metadata("20"), "px_per_mm is '20'; a number"),
    (py3dcal, "annotations/metadata.json", metadata(0), "px_per_mm is 0; a positive number"),
    (py3dcal, "annotations/metadata.json", "[" * 100_000, "nested more than 32 deep"),
    (py3dcal, "probe_images/0.png", None, "0.png does not exist"),
    (feats, "force_indentation.json", "{", "not valid JSON"),
    (feats, "force_indentation.json", indentations(indenter="radius 7.5.1 mm"),
     "force_indentation.json: indenter: '7.5.1' is not a number"),
    (feats, "force_indentation.json", indentations(indentation_mm=[True]), "a list of numbers"),
    (feats, "homography.npy", "x", "homography.npy is not a read"),
    (feats, "homography.npy", alone(np.full((3, 3), "x")), "homography.npy has type <U1"),
    (feats, "homography.npy", alone(np.full((3, 3), np.nan)), "npy[0, 0] is nan"),
    (fots, "mlp_calib/gelsight/0001.png", "x", "is not an image"),
    (taxim, "params.json", '{"sensor": {"pixmm": "0.1"}}', "sensor.pixmm is '0.1'; a number"),
    (plain, "labels.csv", "name,x,y,radius\na_2.png,30,1_0,11\n", "column y: '1_0' is not a"),
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
    assert words in refused(source)


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


@pytest.mark.parametrize("size", [0, YAML_LIMIT_BYTES + 1])
def test_settings_of_others_beside_the_captures_are_left_out(tmp_path: Path, size: int) -> None:
    source = source_of(gs_sdk, tmp_path)
    (source / "compose.yaml").write_text("x: &x {}\ny: {<<: *x}\n" + "#" * size)
    (out,) = import_captures(source, tmp_path / "out")
    assert load_capture_folder(out).mm_per_px == (0.0634, 0.0634)
    assert "# left out, 1 file (compose.yaml): not used: " in (out / "captures.toml").read_text()


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


def test_a_bare_file_name_in_two_sets(tmp_path: Path) -> None:
    source = source_of(fots, tmp_path)
    picture(source / "mlp_calib" / "digit" / "0002.png")
    (source / "labels_gelsight.csv").write_text("file,cx,cy,r\n0002.png,30,20,12\n")
    assert "may be mlp_calib/gelsight/0002.png or mlp_calib/digit/0002.png" in refused(source)


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
        (ImportOptions(crop="0,0,64x" + "4" * 5000), "LEFT,TOP,WIDTHxHEIGHT"),
    ],
)
def test_options_with_odd_numbers(tmp_path: Path, options: ImportOptions, words: str) -> None:
    assert words in refused(source_of(plain, tmp_path), options)
