# SPDX-License-Identifier: Apache-2.0
"""Layouts of other projects: told apart, every byte kept, nothing invented, nothing dropped."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.base_profile import on_grid
from taccel_lab.calibration.capture import import_captures, load_capture_folder
from taccel_lab.calibration.capture.framing import guess_background
from taccel_lab.calibration.capture.importers import LAYOUTS, PUBLISHED, detect_layout, read_drafts
from taccel_lab.calibration.capture.importers.files import (
    UNKNOWN,
    Origin,
    files_of,
    left_out_sentences,
    read_origin,
)
from taccel_lab.calibration.check import check_captures
from taccel_lab.errors import InputError
from taccel_lab.sensors.profile import catalogue_profile
from tests.calibration.capture import made_up_layouts as layouts
from tests.calibration.capture.made_up_layouts import imported, layout_of, only, picture, source_of
from tests.calibration.drawn.faults import add_noise, quantise
from tests.support.capture_sets import gel, press, spread_circles, write_image


def files_in(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", sorted({*LAYOUTS, *PUBLISHED}))
def test_every_layout_is_told_and_its_files_keep_their_bytes(name: str, tmp_path: Path) -> None:
    source = source_of(name, tmp_path)
    before = files_in(source)
    if name in layouts.SCRIPTED:
        with pytest.raises(InputError, match=f"add --layout {name}, or"):
            detect_layout(source)
    else:
        assert detect_layout(source).name == name
    layout, drafts = read_drafts(source, layout_of(name))
    assert layout.name == name
    outs = import_captures(source, tmp_path / "out", layout_of(name))
    assert files_in(source) == before
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
    # Every file is imported, read or told.
    picture(source / "deep" / "below" / "x.png", size=(40, 50))
    for other in ("notes.docx", ".hidden"):
        layouts.write_text(source / other, "not looked at")
    _, drafts = read_drafts(source, name if name in layouts.MAKERS else layout_of(name))
    used = {path for draft in drafts for path in draft.used}
    told = {path for draft in drafts for path in draft.left_out}
    assert set(files_of(source)) == {path for path in used | told if source in path.parents}
    assert not used & told and {source / "notes.docx", source / "deep/below/x.png"} <= told
    sentences = [text for draft in drafts for text in draft.remarks()]
    counts = [int(text.split()[2]) for text in sentences if text.startswith("left out, ")]
    assert sum(counts) == sum(len(draft.left_out) for draft in drafts)


def test_fots_has_three_sets(tmp_path: Path) -> None:
    mini, digit, dots = imported(source_of("fots", tmp_path), layout_of("fots"))
    assert (mini.sensor, mini.ball_radius_mm) == ("gelsight_mini", 2.35)
    assert mini.mm_per_px == pytest.approx((1 / 19.58,) * 2)
    assert [press.circle is not None for press in mini.presses] == [False, True]
    assert (digit.sensor, digit.ball_radius_mm, digit.mm_per_px) == ("digit", None, None)
    assert dots.markers is not None and dots.markers.labels["du_px"].tolist() == [-1.0, 0.0]
    # Its only frame is a press.
    assert dots.markers.rest is None and dots.markers.labels_frame is not None
    assert "rest" not in dots.assumed
    assert "0.csv has the places of the dots without load" in dots.assumed["labels"]


def test_9dtact_has_units_whose_settings_a_given_board_replaces(tmp_path: Path) -> None:
    source = source_of("9dtact", tmp_path)

    def board_of(**options: Any) -> tuple[Any, ...]:
        entry = imported(source, **options)[0].boards[0].entry
        assert entry.on_gel
        return entry.columns, entry.rows, entry.pitch_mm

    units = imported(source)
    assert [unit.unit for unit in units] == ["sensor_1", "sensor_2"]
    assert board_of() == (9, 7, 2.5) and units[0].boards[0].reference is not None
    assert units[0].ball_radius_mm == 4.0 and len(units[0].presses) == 1
    assert board_of(board="dots:8x6:1.5") == (8, 6, 1.5)
    assert not {"board", "radius_mm"} & set(imported(source, board="dots:8x6:1.5")[0].assumed)
    (source / "shape_config.yaml").write_text(
        "camera_calibration: {row_points: 5, col_points: 9, grid_distance: 3}\n"
        "depth_calibration: {BallRad: 2.5}\n"
    )
    assert board_of() == (9, 5, 3.0) and imported(source)[0].ball_radius_mm == 2.5
    (source / "shape_config.yaml").unlink()
    assert board_of(board="dots:9x7:3.0") == (9, 7, 3.0)
    unit = imported(source, board="dots:9x7:3.0")[0]
    assert unit.ball_radius_mm == 4.0 and "radius_mm" in unit.assumed


def test_lengths_and_names_of_other_layouts(tmp_path: Path) -> None:
    captures = only("gs-sdk", tmp_path / "gs")
    assert captures.mm_per_px == (0.0634, 0.0634)
    assert captures.ball_radii_mm() == {2.38: 2, 3.175: 1}
    assert [press.name for press in captures.presses] == ["4.760mm_0", "4.760mm_1", "6.350mm_2"]
    circle = captures.presses[1].circle
    assert circle is not None and (circle.u_px, circle.v_px, circle.radius_px) == (31, 22, 11)
    (record,) = only("feats", tmp_path / "feats").records
    assert record.entry.tool.radius_mm == 7.5 and record.columns["force_n"].tolist() == [1.65, 5.96]
    edges = only("cube-edges", tmp_path / "edges", edge_mm=8.0).edges
    assert [edge.frame.name for edge in edges] == ["edge_0", "edge_2", "edge_10"]
    assert edges[0].entry.length_mm == 8.0
    captures = only("py3dcal", tmp_path / "py")
    assert captures.mm_per_px == (0.05, 0.05) and captures.ball_radius_mm == 2.0
    assert captures.presses[0].depth_mm == 0.8
    captures = only("osaka", tmp_path / "osaka")
    assert len(captures.boards[0].frames) == 3 and not captures.boards[0].entry.on_gel
    assert [press.name for press in captures.presses] == ["press_1", "press_2"]
    assert captures.background is not None
    captures = only("osaka", tmp_path / "given", board="chessboard:5x4:3")
    assert captures.boards[0].entry.pitch_mm == 3 and "board" not in captures.assumed
    captures = only("gelslim", tmp_path / "gelslim")
    assert captures.sensor == "flat_pad" and "4 mm thick" in captures.assumed["gel"]


def test_what_a_person_states_is_not_assumed(tmp_path: Path) -> None:
    captures = only("ruihangao", tmp_path)
    assert {"sensor", "radius_mm", "mm_per_px", "background", "gel"} == set(captures.assumed)
    assert captures.assumed["radius_mm"].startswith("2 mm, that of sensorParams.py")
    findings = {f.code: f.message for f in check_captures(captures, fit_ball=False).findings}
    assert "radius_mm: 2 mm, that of sensorParams.py" in findings["assumed"]
    profile = on_grid(catalogue_profile(captures.sensor), captures.grid(), captures.provenance)
    assert "; assumed: sensor: gelsight_mini" in profile.camera.provenance.source
    captures = only(
        "ruihangao", tmp_path / "stated", sensor="flat_pad", unit="mine", radius_mm=3.0,
        mm_per_px_x=0.09, mm_per_px_y=0.08, background="calib_ball/frame_0.png",
        origin="bench 2", license="CC0-1.0",
    )  # fmt: skip
    assert set(captures.assumed) == {"gel"}
    assert (captures.sensor, captures.unit, captures.ball_radius_mm) == ("flat_pad", "mine", 3.0)
    assert captures.mm_per_px == (0.09, 0.08) and captures.provenance["license"] == "CC0-1.0"
    assert captures.provenance["source"].startswith("bench 2; imported from source")


MIT = "MIT License\n\nPermission is hereby granted, free of charge, to any person"


@pytest.mark.parametrize(("files", "license"), [
    ({"LICENSE": MIT}, "MIT (LICENSE says)"),
    ({"COPYING.txt": "GNU GENERAL PUBLIC LICENSE\n   Version 3, 29 June"}, "GPL-3.0 (COPYING"),
    ({"LICENSE": "Ours. Ask us."}, "not recognised: Ours. Ask us. (LICENSE says)"),
    ({"README.md": "# A set\n\n## License\n\nCC BY 4.0, see paper\n"}, "CC BY 4.0, see paper"),
    ({"README.md": "- **Licence:** none\n"}, "none (README.md says)"),
    ({"README.md": "Source: our bench\n", "LICENSE": MIT}, "MIT (LICENSE says)"),
    ({"README.md": "License: MIT\n", "LICENSE": "Apache License\n Version 2.0"}, "Apache-2.0"),
    ({"sub/LICENSE": MIT}, "MIT (sub/LICENSE says)"),
    ({"README.md": "licensed as the rest\n"}, "unknown"),
    ({"LICENSE": ""}, "unknown"),
])  # fmt: skip
def test_licence_and_source(tmp_path: Path, files: dict[str, str], license: str) -> None:
    for name, text in files.items():
        layouts.write_text(tmp_path / name, text)
    origin = read_origin(tmp_path)
    assert origin.license.startswith(license)
    assert (origin.source == "our bench (README.md says)") == (
        "Source" in files.get("README.md", "")
    )
    # A project speaks for no captures below it.
    (tmp_path / "x" / "y").mkdir(parents=True)
    assert read_origin(tmp_path / "x" / "y") == Origin(UNKNOWN, UNKNOWN, frozenset())


@pytest.mark.parametrize(("name", "missing", "flags"), [
    ("taxim", ["params.json"], {"mm_per_px_x": 0.1}),
    ("gs-sdk", ["background.png"], {"background": "4.760mm/1/gelsight.png"}),
    ("gs-sdk", ["gsmini.yaml"], {"mm_per_px_x": 0.06}),
    ("py3dcal", ["annotations/metadata.json"], {"mm_per_px_x": 0.05, "radius_mm": 2.0}),
    ("py3dcal", ["annotations/metadata.json"], {"radius_mm": 2.0}),
    ("py3dcal", ["blank_images/blank.png"], {}),
    ("fots", ["mlp_calib/0000.png", "mlp_calib/scripts/0000.png"], {}),
    ("9dtact", [f"calibration/sensor_{n}/{part}_calibration/ref.png"
                for n in (1, 2) for part in ("camera", "depth")], {}),
    ("gelslim", ["updated_calib/ref.jpg"], {}),
    ("cube-edges", ["background.png"], {}),
])  # fmt: skip
def test_flags_replace_missing_files(
    tmp_path: Path, name: str, missing: list[str], flags: dict[str, Any]
) -> None:
    source, flags = source_of(name, tmp_path), flags or {"background": "spare.png"}
    for file in missing:
        (source / file).unlink()
    picture(source / "spare.png")
    captures = imported(source, name if name in layouts.MAKERS else layout_of(name), **flags)[0]
    # What may be missing is noted.
    if list(flags) == ["radius_mm"]:
        assert f"# {missing[0]} is missing; --mm-per-px-x" in layouts.manifest_of(source)
    if "mm_per_px_x" in flags:
        assert captures.mm_per_px == (flags["mm_per_px_x"],) * 2
        assert "mm_per_px" not in captures.assumed
    if "radius_mm" in flags:
        assert captures.ball_radius_mm == flags["radius_mm"]
    if "background" in flags:
        background = captures.require_background()
        assert Path(background.source).read_bytes() == (source / flags["background"]).read_bytes()
        assert "background" not in captures.assumed


def test_plain_folder(tmp_path: Path) -> None:
    captures = only("plain", tmp_path, sensor="digit", radius_mm=3.0, mm_per_px_x=0.05)
    assert [press.name for press in captures.presses] == ["a_1", "a_2", "a_10"]
    assert [press.circle is not None for press in captures.presses] == [False, True, False]
    assert captures.background is not None and captures.mm_per_px == (0.05, 0.05)
    assert captures.records[0].entry.kind == "indentation"
    wrong_size = "# left out, 1 file (other_camera.png): 80x60 px, not 64x48 px as most images"
    assert wrong_size in layouts.manifest_of(tmp_path / "source")
    layouts.pictures(tmp_path / "views/source", "view_a", "view_b")
    (captures,) = imported(tmp_path / "views/source", board="charuco:8x6:3.5")
    entry = captures.boards[0].entry
    assert (entry.kind, entry.columns, entry.rows, entry.pitch_mm) == ("charuco", 8, 6, 3.5)


def test_a_background_by_name_is_no_other_image_of_that_name(tmp_path: Path) -> None:
    source = source_of("plain", tmp_path)
    picture(source / "again" / "a_1.png")
    (captures,) = imported(source, sensor="flat_pad", background="a_1.png")
    assert {press.name for press in captures.presses} == {"again_a_1", "a_2", "a_10"}
    # What is called a background is never a press.
    assert [frame.name for frame in captures.untouched] == ["untouched"]


def test_names_that_differ_in_numbers_are_counted(tmp_path: Path) -> None:
    paths = {tmp_path / f"a/frame_{n}.png": "no ball" for n in range(300)}
    paths |= {tmp_path / "b_7.txt": "no ball", tmp_path / "c.txt": "empty"}
    assert left_out_sentences(paths, tmp_path) == [
        "left out, 301 files (a/frame_<n>.png, 300 x; b_7.txt): no ball",
        "left out, 1 file (c.txt): empty",
    ]


def test_an_earlier_import_below_the_source_is_not_read_again(tmp_path: Path) -> None:
    source = source_of("plain", tmp_path)
    first, again = (import_captures(source, source / "captures", replace=True) for _ in range(2))
    captures = load_capture_folder(again[0])
    assert first == again and len(captures.presses) == 3 and len(captures.records) == 1
    assert "part of a capture folder" in (again[0] / "captures.toml").read_text(encoding="utf-8")


def test_median_of_the_presses_as_background(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for i, circle in enumerate(spread_circles(9)):
        write_image(source / f"p{i}.png", np.clip(press(circle), 0, 255).astype(np.uint8))
    (captures,) = imported(source, "plain", background="median", sensor="flat_pad")
    assert len(captures.presses) == 9
    off = np.abs(captures.require_background().image().astype(float) - gel())
    assert np.median(off) < 1.0 and np.percentile(off, 99) < 10


def test_the_untouched_image_is_found_without_a_name(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    images = [press(circle) for circle in spread_circles(7)]
    images.insert(4, gel())
    for i, image in enumerate(images):
        write_image(tmp_path / f"shot_{i + 1}.png", quantise(add_noise(image, 0.7, rng)))
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
        writer.write(layouts.dots_at(shift))
    writer.release()


def test_a_video_file_or_a_folder_with_some(tmp_path: Path) -> None:
    video = tmp_path / "in" / "v.avi"

    def frames(source: Path) -> list[int]:
        (out,) = import_captures(source, tmp_path / "out", replace=True)
        markers = load_capture_folder(out).markers
        assert markers is not None
        return [video.frame_count for video in markers.videos]

    write_video(video, (0.0, 2.0, 4.0))
    for source in (video, video.parent):
        assert detect_layout(source).name == "markers" and frames(source) == [3]
    write_video(video.parent / "w.avi", (0.0, 1.0))
    assert frames(video.parent) == [3, 2]
    assert "no picture at rest is stated" in layouts.manifest_of(video.parent)
    layouts.SCRIPTED["rvsathu"](video.parent)  # What lies beside a file does not tell its layout.
    assert detect_layout(video).name == "markers"


def test_files_of_the_same_name_in_two_folders_are_both_kept(tmp_path: Path) -> None:
    source = source_of("plain", tmp_path)
    for folder, force, shifts in (("a", 0.1, (0.0, 2.0)), ("b", 0.3, (0.0, 2.0, 4.0))):
        write_video(source / folder / "v.avi", shifts)
        for name in (f"{folder}/force.csv", f"{folder}_force.csv"):
            layouts.write_text(source / name, f"depth_mm,force_n\n0.1,{force}\n0.2,0.5\n")
    imported(source, "plain", sensor="flat_pad")
    manifest, out = tomllib.loads(layouts.manifest_of(source)), tmp_path / "out"
    assert [v["file"] for v in manifest["markers"]["videos"]] == ["a_v.avi", "b_v.avi"]
    assert (out / "a_v.avi").read_bytes() != (out / "b_v.avi").read_bytes()
    records = [entry["file"] for entry in manifest["records"]]
    assert len(set(records)) == 5 and all((out / name).is_file() for name in records)


def test_images_of_other_formats_become_png(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    image = layouts.RNG.integers(0, 255, (48, 64, 3), dtype=np.uint8)
    for name in ("bg", "a", "b"):
        assert cv2.imwrite(str(source / f"{name}.bmp"), image)
    imported(source)
    out = tmp_path / "out"
    assert {path.suffix for path in out.iterdir() if path.suffix} == {".png", ".toml"}
    assert np.array_equal(cv2.imread(str(out / "a.png")), image)


def test_sets_of_one_name_are_all_kept(tmp_path: Path) -> None:
    layouts.pictures(tmp_path / "in/a/x", "ref.jpg", "sample_0.jpg", "sample_1.jpg")
    layouts.pictures(tmp_path / "in/b/x", "ref.jpg", *(f"sample_{i}.jpg" for i in range(3)))
    sets = imported(tmp_path / "in", layout_of("gelslim"))
    assert [len(captures.presses) for captures in sets] == [2, 3]


def test_importing_freezes_the_split(tmp_path: Path) -> None:
    layouts.pictures(tmp_path / "source", "background", *(f"press_{i}" for i in range(8)))
    (captures,) = imported(
        tmp_path / "source", sensor="gelsight_mini", radius_mm=2.0, mm_per_px_x=0.05
    )
    assert captures.heldout is not None and len(captures.heldout) == 2
    assert captures.split().by == "manifest"
    assert replace(captures, heldout=None).split().heldout_names == captures.heldout
