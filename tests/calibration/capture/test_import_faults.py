# SPDX-License-Identifier: Apache-2.0
"""Sources with faults: what can be used is taken, what cannot is named."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureFolder, import_captures
from taccel_lab.calibration.capture.importers.background_guess import guess_background
from taccel_lab.calibration.capture.importers.label_tables import read_label_tables, read_labels
from taccel_lab.calibration.capture.records import kind_of_record, read_columns
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from tests.calibration.capture.made_up_layouts import imported, picture, rvsathu, source_of
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


def taken(source: Path, crop: str | None = None) -> tuple[CaptureFolder, str]:
    """The one folder that is made of it, and its manifest."""
    (captures,) = imported(source, crop=crop)
    return captures, (source.parent / "out" / "captures.toml").read_text(encoding="utf-8")


def test_broken_files_are_left_out_and_named(source: Path) -> None:
    (source / "p1.png").write_bytes(b"")
    whole = (source / "p2.png").read_bytes()
    (source / "p2.png").write_bytes(whole[: len(whole) // 2])
    captures, manifest = taken(source)
    assert [p.name for p in captures.presses] == ["p0", "p3", "p4", "p5", "p6", "p7"]
    assert "# left out, 1 file (p1.png): is empty (0 bytes)" in manifest
    assert "# left out, 1 file (p2.png): is not an image" in manifest


@pytest.mark.parametrize("crop", [None, "1,1,60,40"])
@pytest.mark.parametrize("name", ["p1.png", "background.png"])
def test_what_a_link_names_is_not_taken_in(source: Path, name: str, crop: str | None) -> None:
    """The folder that is written is one that people publish."""
    (source / name).rename(source.parent / "private.png")
    (source / name).symlink_to("../private.png")
    with pytest.raises(InputError, match=rf"{name} is a link out of .*; put the file itself there"):
        taken(source, crop)
    assert not (source.parent / "out").exists()


def test_an_image_of_gigabytes_is_refused_before_it_is_copied(tmp_path: Path) -> None:
    rvsathu(tmp_path / "s")
    image = tmp_path / "s" / "calib_10_real.png"
    os.truncate(image, 1 << 30)
    with pytest.raises(InputError) as error:
        import_captures(tmp_path / "s", tmp_path / "out")
    # Of the image itself; the copy's refusal would add where it was imported from.
    assert str(error.value) == f"{image} has 1 GiB; an image may have up to 512 MiB"


def test_only_broken_files(tmp_path: Path) -> None:
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "a.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"holds no images.*\(a\.png\): is empty"):
        import_captures(tmp_path / "s", tmp_path / "out")


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
    assert kind_of_record(record) == "indentation"
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


def test_images_that_are_all_alike(source: Path) -> None:
    paths = []
    for i in range(5):
        paths.append(source / f"a{i}.png")
        write_image(paths[-1], levels(gel()))
    found, why = guess_background(paths)
    assert found is None and "no contact shows" in why


def test_rvsathu_with_another_background(tmp_path: Path) -> None:
    source = source_of(rvsathu, tmp_path)
    (source / "background_real.png").rename(source / "bg.png")
    captures, _ = taken(source)
    assert captures.background is not None
    (source / "bg.png").unlink()
    captures, manifest = taken(source)
    assert captures.background is None and "background_real.png is missing; give" in manifest


@pytest.mark.parametrize("crop", ["auto", "20,15,120x90"])
def test_background_of_another_framing(source: Path, crop: str) -> None:
    height, width = gel().shape[:2]
    part = gel()[15:105, 20:140]
    write_image(source / "background.png", levels(cv2.resize(part, (width, height))))
    (source / "circles.csv").write_text(
        "file,cx,cy,r\n"
        + "".join(f"p{i}.png,{c.u_px},{c.v_px},{c.radius_px}\n" for i, c in enumerate(CIRCLES))
    )
    mask = np.full((height, width, 3), 255, dtype=np.uint8)
    mask[30:40, 60:80] = 0  # As the presses show it.
    write_image(source / "mask.png", mask)
    captures, manifest = taken(source, crop=crop)
    assert captures.mask is not None
    assert not captures.mask[18:22, 45:55].any() and captures.mask[:10].all()
    size = captures.require_background().image().shape
    assert size[:2] == pytest.approx((90, 120), abs=2)
    assert "mm per pixel are as before" in manifest
    inside = [
        c for c in CIRCLES
        if 22 + c.radius_px < c.u_px < 138 - c.radius_px
        and 17 + c.radius_px < c.v_px < 103 - c.radius_px
    ]  # fmt: skip
    assert 0 < len(inside) <= len(captures.presses) < len(CIRCLES)
    found = [p.circle for p in captures.presses if p.circle is not None]
    for circle in inside:
        at = (circle.u_px - 20, circle.v_px - 15)
        assert min(np.hypot(f.u_px - at[0], f.v_px - at[1]) for f in found) < 2.1
    near = read_image(source / "p0.png")[15:105, 20:140].astype(float)
    shown = captures.require_background().image().astype(float)
    shown = cv2.resize(shown, (120, 90))
    assert np.median(np.abs(near - shown)) < 4


def test_presses_that_show_a_part_of_the_background(source: Path) -> None:
    height, width = gel().shape[:2]
    for i, circle in enumerate(CIRCLES):
        part = press(circle)[15:105, 20:140]
        write_image(source / f"p{i}.png", levels(cv2.resize(part, (width, height))))
    mask = np.full((height, width, 3), 255, dtype=np.uint8)
    mask[:, :20] = 0
    write_image(source / "mask.png", mask)
    captures, manifest = taken(source, crop="auto")
    assert captures.mask is not None
    np.testing.assert_array_equal(captures.mask, mask[..., 0] > 0)
    assert len(captures.presses) == len(CIRCLES) and "which the presses show" in manifest
    wanted = cv2.resize(levels(gel())[15:105, 20:140], (width, height)).astype(float)
    off = np.abs(captures.require_background().image() - wanted)
    assert np.median(off) < 3


@pytest.mark.parametrize(
    ("crop", "message"),
    [
        ("12", "LEFT,TOP,WIDTHxHEIGHT"),
        ("100,0,900x90", "is no part of pictures"),
        ("0,0,20x20", "smaller than 32x32"),
        ("auto", "found no part that fits"),
    ],
)
def test_crops_that_are_none(source: Path, crop: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        taken(source, crop=crop)
    assert not (source.parent / "out").exists()
