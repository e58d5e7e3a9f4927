# SPDX-License-Identifier: Apache-2.0
"""Layouts of other projects, made up here: told apart, read, and every byte kept."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureFolder, import_captures, load_capture_folder
from taccel_lab.calibration.capture.framing import guess_background
from taccel_lab.calibration.capture.importers import (
    LAYOUTS,
    PUBLISHED,
    ImportOptions,
    detect_layout,
    read_drafts,
)
from taccel_lab.errors import InputError
from tests.calibration.capture.made_up_layouts import (
    MAKERS,
    RNG,
    SCRIPTED,
    cube_edges,
    dots_at,
    feats,
    fots,
    gs_sdk,
    imported,
    layout_of,
    ninedtact,
    osaka,
    picture,
    plain,
    py3dcal,
    ruihangao,
    rvsathu,
    source_of,
)
from tests.support.capture_sets import gel, press, spread_circles, write_image


def test_every_layout_has_a_maker() -> None:
    assert set(MAKERS) == set(LAYOUTS) and set(SCRIPTED) == set(PUBLISHED)


@pytest.mark.parametrize("name", sorted(MAKERS | SCRIPTED))
def test_every_layout_is_told_and_its_files_keep_their_bytes(name: str, tmp_path: Path) -> None:
    make = (MAKERS | SCRIPTED)[name]
    source = source_of(make, tmp_path)
    before = {path: path.read_bytes() for path in source.rglob("*") if path.is_file()}
    if name in SCRIPTED:
        with pytest.raises(InputError, match=f"add --layout docs/examples/layouts/{name}.py"):
            detect_layout(source)
    else:
        assert detect_layout(source).name == name
    layout, drafts = read_drafts(source, layout_of(make))
    assert layout.name == name
    outs = import_captures(source, tmp_path / "out", layout_of(make))
    assert {p: p.read_bytes() for p in source.rglob("*") if p.is_file()} == before
    for draft, out in zip(drafts, outs, strict=True):
        captures = load_capture_folder(out)
        assert tomllib.loads((out / "captures.toml").read_text())["schema_version"] == 2
        # Nothing states whence they are.
        stated = captures.provenance
        assert stated["source"].startswith(f"unknown; imported from source, layout {name}")
        assert stated["license"] == "unknown" and {"sensor", "gel"} <= set(captures.assumed)
        with draft.opened() as opened:  # Without being written.
            assert opened.contents() == captures.contents() and opened.source == str(draft.place)
        if name != "taxim":  # whose images come out of an archive
            for image in [*out.glob("*.png"), *out.glob("*.jpg")]:
                assert image.read_bytes() in before.values()


def test_fots_has_three_sets(tmp_path: Path) -> None:
    mini, digit, dots = imported(source_of(fots, tmp_path), layout_of(fots))
    assert (mini.sensor, mini.ball_radius_mm) == ("gelsight_mini", 2.35)
    assert mini.mm_per_px == pytest.approx((1 / 19.58,) * 2)
    assert [press.circle is not None for press in mini.presses] == [False, True]
    assert (digit.sensor, digit.ball_radius_mm, digit.mm_per_px) == ("digit", None, None)
    assert dots.markers is not None and dots.markers.labels["du_px"].tolist() == [-1.0, 0.0]
    # Its only frame is a press.
    assert dots.markers.rest is None and dots.markers.labels_frame is not None
    assert "rest" not in dots.assumed
    assert "0.csv has the places of the dots without load" in dots.assumed["labels"]


def test_gs_sdk_balls_and_scale(tmp_path: Path) -> None:
    (captures,) = imported(source_of(gs_sdk, tmp_path))
    assert captures.mm_per_px == (0.0634, 0.0634)
    assert captures.ball_radii_mm() == {2.38: 2, 3.175: 1}
    assert [press.name for press in captures.presses] == ["4.760mm_0", "4.760mm_1", "6.350mm_2"]
    circle = captures.presses[1].circle
    assert circle is not None and (circle.u_px, circle.v_px, circle.radius_px) == (31, 22, 11)


def test_ninedtact_units(tmp_path: Path) -> None:
    units = imported(source_of(ninedtact, tmp_path))
    assert [unit.unit for unit in units] == ["sensor_1", "sensor_2"]
    board = units[0].boards[0]
    assert (board.entry.columns, board.entry.rows, board.entry.pitch_mm) == (9, 7, 2.5)
    assert board.entry.on_gel and board.reference is not None
    assert units[0].ball_radius_mm == 4.0 and len(units[0].presses) == 1


def test_lengths_and_names_of_other_layouts(tmp_path: Path) -> None:
    def only(make: Callable[[Path], None], **options: object) -> CaptureFolder:
        (tmp_path / make.__name__).mkdir()
        (captures,) = imported(
            source_of(make, tmp_path / make.__name__), layout_of(make), **options
        )
        return captures

    captures = only(feats)
    assert captures.records[0].entry.tool.radius_mm == 7.5
    assert captures.records[0].columns["force_n"].tolist() == [1.65, 5.96]
    captures = only(cube_edges, edge_mm=8.0)
    assert [edge.frame.name for edge in captures.edges] == ["edge_0", "edge_2", "edge_10"]
    assert captures.edges[0].entry.length_mm == 8.0
    captures = only(py3dcal)
    assert captures.mm_per_px == (0.05, 0.05) and captures.ball_radius_mm == 2.0
    assert captures.presses[0].depth_mm == 0.8
    captures = only(osaka)
    assert len(captures.boards[0].frames) == 3 and not captures.boards[0].entry.on_gel
    assert [press.name for press in captures.presses] == ["press_1", "press_2"]
    assert captures.background is not None
    # Options replace what a layout says.
    captures = only(ruihangao, sensor="flat_pad", unit="mine", radius_mm=3.0, mm_per_px_x=0.09,
                    mm_per_px_y=0.08)  # fmt: skip
    assert (captures.sensor, captures.unit, captures.ball_radius_mm) == ("flat_pad", "mine", 3.0)
    assert captures.mm_per_px == (0.09, 0.08)


def test_plain_folder(tmp_path: Path) -> None:
    options = {"sensor": "digit", "radius_mm": 3.0, "mm_per_px_x": 0.05}
    (captures,) = imported(source_of(plain, tmp_path), **options)
    assert [press.name for press in captures.presses] == ["a_1", "a_2", "a_10"]
    assert [press.circle is not None for press in captures.presses] == [False, True, False]
    assert captures.background is not None and captures.mm_per_px == (0.05, 0.05)
    assert captures.records[0].entry.kind == "indentation"
    notes = (tmp_path / "out" / "captures.toml").read_text()
    assert "# left out, 1 file (other_camera.png): 80x60 px, not 64x48 px as most images" in notes


def test_median_of_the_presses_as_background(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for i, circle in enumerate(spread_circles(9)):
        write_image(source / f"p{i}.png", np.clip(press(circle), 0, 255).astype(np.uint8))
    (captures,) = imported(source, "plain", background="median", sensor="flat_pad")
    assert len(captures.presses) == 9
    off = np.abs(captures.require_background().image().astype(float) - gel())
    assert np.median(off) < 1.0 and np.percentile(off, 99) < 10


def test_board_views_of_a_plain_folder(tmp_path: Path) -> None:
    for name in ("view_a", "view_b"):
        picture(tmp_path / "source" / f"{name}.png")
    (captures,) = imported(tmp_path / "source", board="charuco:8x6:3.5")
    entry = captures.boards[0].entry
    assert (entry.kind, entry.columns, entry.rows, entry.pitch_mm) == ("charuco", 8, 6, 3.5)
    with pytest.raises(InputError, match=r"kind:COLUMNSxROWS"):
        read_drafts(tmp_path / "source", "plain", ImportOptions(board="8x6"))


def test_the_untouched_image_is_found_without_a_name(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    images = [press(circle) for circle in spread_circles(7)]
    images.insert(4, gel())
    for i, image in enumerate(images):
        noisy = image + rng.normal(0, 0.7, image.shape)
        write_image(tmp_path / f"shot_{i + 1}.png", np.clip(noisy, 0, 255).astype(np.uint8))
    paths = sorted(tmp_path.iterdir())
    found, why = guess_background(paths)
    assert found is not None and found.name == "shot_5.png" and "differs least" in why
    found, why = guess_background([path for path in paths if path.name != "shot_5.png"])
    assert found is None and "no image is untouched" in why


@pytest.mark.parametrize(
    ("name", "is_background"),
    [("bg", True), ("my_background_2", True), ("ref", True), ("refraction", False), ("abg", False)],
)
def test_names_of_backgrounds(tmp_path: Path, name: str, is_background: bool) -> None:
    paths = [picture(tmp_path / f"{stem}.png") for stem in (name, "x", "y")]
    assert (guess_background(paths)[0] is not None) == is_background


def test_numbered_presses_are_no_video(tmp_path: Path) -> None:
    for i, circle in enumerate(spread_circles(22)):
        write_image(tmp_path / f"{i:04d}.png", np.clip(press(circle), 0, 255).astype(np.uint8))
    assert detect_layout(tmp_path).name == "plain"
    # Who says that it is one is believed.
    (draft,) = read_drafts(tmp_path, "markers")[1]
    assert len(draft.manifest["markers"]["videos"][0]["frames"]) == 22


def write_video(path: Path, shifts: Sequence[float]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (160, 120))
    if not writer.isOpened():
        pytest.skip("OpenCV is built without a video writer")
    for shift in shifts:
        writer.write(dots_at(shift))
    writer.release()


def test_a_video_file_or_a_folder_with_some(tmp_path: Path) -> None:
    video = tmp_path / "in" / "v.avi"
    write_video(video, (0.0, 2.0, 4.0))
    for source in (video, video.parent):
        assert detect_layout(source).name == "markers"
        (out,) = import_captures(source, tmp_path / "out")
        markers = load_capture_folder(out).markers
        assert markers is not None and markers.videos[0].frame_count == 3
    write_video(video.parent / "w.avi", (0.0, 1.0))
    (out,) = import_captures(video.parent, tmp_path / "out")
    markers = load_capture_folder(out).markers
    assert markers is not None and [v.frame_count for v in markers.videos] == [3, 2]
    assert "no picture at rest is stated" in (out / "captures.toml").read_text()
    rvsathu(video.parent)  # What lies beside a file does not tell its layout.
    assert detect_layout(video).name == "markers"


def test_files_of_the_same_name_in_two_folders_are_both_kept(tmp_path: Path) -> None:
    source = tmp_path / "source"
    plain(source)
    write_video(source / "a" / "v.avi", (0.0, 2.0))
    write_video(source / "b" / "v.avi", (0.0, 2.0, 4.0))
    for folder, forces in (("a", "0.1"), ("b", "0.3")):
        text = f"depth_mm,force_n\n0.1,{forces}\n0.2,0.5\n"
        (source / folder / "force.csv").write_text(text)
        (source / f"{folder}_force.csv").write_text(text)
    options = ImportOptions(sensor="flat_pad")
    (out,) = import_captures(source, tmp_path / "out", "plain", options)
    manifest = tomllib.loads((out / "captures.toml").read_text())
    videos = [entry["file"] for entry in manifest["markers"]["videos"]]
    assert videos == ["a_v.avi", "b_v.avi"]
    assert (out / "a_v.avi").read_bytes() != (out / "b_v.avi").read_bytes()
    records = [entry["file"] for entry in manifest["records"]]
    assert len(set(records)) == 5 and all((out / name).is_file() for name in records)


def test_nothing_to_import(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"follows none of the layouts known: taxim \(Taxim"):
        detect_layout(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        detect_layout(tmp_path / "gone")
    picture(tmp_path / "a.png")
    with pytest.raises(InputError, match="no layout 'x'; known: auto, taxim"):
        read_drafts(tmp_path, "x")
    with pytest.raises(InputError, match=r"no layout 'fots'; docs/examples/layouts/fots.py reads"):
        read_drafts(tmp_path, "fots")
    with pytest.raises(InputError, match="is not of the layout printer"):
        read_drafts(tmp_path, "printer")
    (tmp_path / "captures.toml").write_text("")
    with pytest.raises(InputError, match="is a capture folder already"):
        import_captures(tmp_path, tmp_path / "out")


def test_images_of_other_formats_become_png(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    image = RNG.integers(0, 255, (48, 64, 3), dtype=np.uint8)
    for name in ("bg", "a", "b"):
        assert cv2.imwrite(str(source / f"{name}.bmp"), image)
    (out,) = import_captures(source, tmp_path / "out")
    assert {path.suffix for path in out.iterdir() if path.suffix} == {".png", ".toml"}
    assert np.array_equal(cv2.imread(str(out / "a.png")), image)
