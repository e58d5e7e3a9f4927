# SPDX-License-Identifier: Apache-2.0
"""Importers invent nothing, drop nothing in silence, and take from flags what files lack."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.calibration.base_profile import on_grid
from taccel_lab.calibration.capture import import_captures, load_capture_folder
from taccel_lab.calibration.capture.importers import read_drafts
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
from tests.calibration.capture.made_up_layouts import (
    MAKERS,
    SCRIPTED,
    cube_edges,
    fots,
    gelslim,
    gs_sdk,
    imported,
    layout_of,
    ninedtact,
    osaka,
    picture,
    plain,
    py3dcal,
    ruihangao,
    source_of,
    taxim,
)

MIT = "MIT License\n\nPermission is hereby granted, free of charge, to any person"


@pytest.mark.parametrize("make", (MAKERS | SCRIPTED).values())
def test_every_file_is_imported_read_or_told(make: Callable[[Path], None], tmp_path: Path) -> None:
    source = source_of(make, tmp_path)
    picture(source / "deep" / "below" / "x.png", size=(40, 50))
    (source / "notes.docx").write_bytes(b"anything")
    (source / ".hidden").write_text("not looked at")
    told = layout_of(make) if layout_of(make) != "auto" else make.__name__
    _, drafts = read_drafts(source, {"ninedtact": "9dtact", "gs_sdk": "gs-sdk"}.get(told, told))
    used = {path for draft in drafts for path in draft.used}
    told = {path for draft in drafts for path in draft.left_out}
    assert set(files_of(source)) == {path for path in used | told if source in path.parents}
    assert not used & told
    assert source / "notes.docx" in told and source / "deep" / "below" / "x.png" in told
    sentences = [text for draft in drafts for text in draft.remarks()]
    counted = sum(
        int(text.split()[2]) for text in sentences if text.startswith("left out, ")
    )  # fmt: skip
    assert counted == sum(len(draft.left_out) for draft in drafts)


def test_what_a_person_states_is_not_assumed(tmp_path: Path) -> None:
    source = source_of(ruihangao, tmp_path)
    (captures,) = imported(source, layout_of(ruihangao))
    assert {"sensor", "radius_mm", "mm_per_px", "background", "gel"} == set(captures.assumed)
    assert captures.assumed["radius_mm"].startswith("2 mm, that of sensorParams.py")
    (captures,) = imported(
        source,
        layout_of(ruihangao),
        sensor="gelsight_mini",
        radius_mm=2.0,
        mm_per_px_x=0.09,
        background="calib_ball/frame_0.png",
        origin="bench 2",
        license="CC0-1.0",
    )
    assert set(captures.assumed) == {"gel"}
    assert captures.provenance["source"].startswith("bench 2; imported from source")
    assert captures.provenance["license"] == "CC0-1.0"


def test_assumptions_reach_the_check_and_the_profile(tmp_path: Path) -> None:
    (captures,) = imported(source_of(ruihangao, tmp_path), layout_of(ruihangao))
    findings = {f.code: f.message for f in check_captures(captures, fit_ball=False).findings}
    assert "radius_mm: 2 mm, that of sensorParams.py" in findings["assumed"]
    profile = on_grid(catalogue_profile(captures.sensor), captures.grid(), captures.provenance)
    assert "; assumed: sensor: gelsight_mini" in profile.camera.provenance.source


def test_the_catalogue_s_thickness_is_told(tmp_path: Path) -> None:
    (captures,) = imported(source_of(gelslim, tmp_path), layout_of(gelslim))
    assert captures.sensor == "flat_pad" and "4 mm thick" in captures.assumed["gel"]


@pytest.mark.parametrize(
    ("files", "license"),
    [
        ({"LICENSE": MIT}, "MIT (LICENSE says)"),
        ({"COPYING.txt": "GNU GENERAL PUBLIC LICENSE\n   Version 3, 29 June"}, "GPL-3.0 (COPYING"),
        ({"LICENSE": "Ours. Ask us."}, "not recognised: Ours. Ask us. (LICENSE says)"),
        ({"README.md": "# A set\n\n## License\n\nCC BY 4.0, see paper\n"}, "CC BY 4.0, see paper"),
        ({"README.md": "- **Licence:** none\n"}, "none (README.md says)"),
        ({"README.md": "License: MIT\n", "LICENSE": "Apache License\n Version 2.0"}, "Apache-2.0"),
        ({"sub/LICENSE": MIT}, "MIT (sub/LICENSE says)"),
        ({"README.md": "licensed as the rest\n"}, "unknown"),
        ({"LICENSE": ""}, "unknown"),
    ],
)  # fmt: skip
def test_licence(tmp_path: Path, files: dict[str, str], license: str) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert read_origin(tmp_path).license.startswith(license)


def test_a_project_speaks_for_no_captures_below_it(tmp_path: Path) -> None:
    (tmp_path / "LICENSE").write_text(MIT)
    (tmp_path / "README.md").write_text("Source: our bench\n")
    below = tmp_path / "x" / "y"
    below.mkdir(parents=True)
    assert read_origin(below) == Origin(UNKNOWN, UNKNOWN, frozenset())
    assert read_origin(tmp_path).source == "our bench (README.md says)"


def test_a_given_board_replaces_the_settings(tmp_path: Path) -> None:
    source = source_of(ninedtact, tmp_path)
    unit, _ = imported(source, board="dots:8x6:1.5")
    entry = unit.boards[0].entry
    assert (entry.columns, entry.rows, entry.pitch_mm) == (8, 6, 1.5)
    assert "board" not in unit.assumed and "radius_mm" not in unit.assumed
    (source / "shape_config.yaml").unlink()
    unit, _ = imported(source, board="dots:9x7:3.0")
    assert unit.boards[0].entry.pitch_mm == 3.0 and unit.boards[0].entry.on_gel
    assert unit.ball_radius_mm == 4.0 and "radius_mm" in unit.assumed
    osaka(other := tmp_path / "other")
    (captures,) = imported(other, layout_of(osaka), board="chessboard:5x4:3")
    assert captures.boards[0].entry.pitch_mm == 3 and "board" not in captures.assumed


@pytest.mark.parametrize(
    ("make", "layout", "missing", "flags"),
    [
        (taxim, "taxim", ["params.json"], {"mm_per_px_x": 0.1}),
        (gs_sdk, "gs-sdk", ["background.png"], {"background": "4.760mm/1/gelsight.png"}),
        (gs_sdk, "gs-sdk", ["gsmini.yaml"], {"mm_per_px_x": 0.06}),
        (py3dcal, layout_of(py3dcal), ["annotations/metadata.json"],
         {"mm_per_px_x": 0.05, "radius_mm": 2.0}),
        (py3dcal, layout_of(py3dcal), ["blank_images/blank.png"], {"background": "spare.png"}),
        (fots, layout_of(fots), ["mlp_calib/0000.png", "mlp_calib/scripts/0000.png"],
         {"background": "spare.png"}),
        (ninedtact, "9dtact", [f"calibration/sensor_{n}/{part}_calibration/ref.png"
                               for n in (1, 2) for part in ("camera", "depth")],
         {"background": "spare.png"}),
        (gelslim, layout_of(gelslim), ["updated_calib/ref.jpg"], {"background": "spare.png"}),
        (cube_edges, layout_of(cube_edges), ["background.png"], {"background": "spare.png"}),
    ],
)  # fmt: skip
def test_flags_replace_missing_files(
    tmp_path: Path,
    make: Callable[[Path], None],
    layout: str,
    missing: list[str],
    flags: dict[str, Any],
) -> None:
    source = source_of(make, tmp_path)
    for name in missing:
        (source / name).unlink()
    picture(source / "spare.png")
    captures = imported(source, layout, **flags)[0]
    if "mm_per_px_x" in flags:
        assert captures.mm_per_px == (flags["mm_per_px_x"],) * 2
        assert "mm_per_px" not in captures.assumed
    if "radius_mm" in flags:
        assert captures.ball_radius_mm == flags["radius_mm"]
    if "background" in flags:
        background = captures.require_background()
        assert Path(background.source).read_bytes() == (source / flags["background"]).read_bytes()
        assert "background" not in captures.assumed


@pytest.mark.parametrize(
    ("make", "missing", "options", "words"),
    [
        (ninedtact, "shape_config.yaml", {}, r"board is not known.*--board dots:COLUMNSxROWS:PI"),
        (ninedtact, "shape_config.yaml", {"board": "dots:9x7"}, "the pitch is missing"),
        (taxim, "params.json", {}, r"params\.json is missing; .* with --mm-per-px-x"),
        # Flags that nothing would follow.
        (ruihangao, "", {"board": "dots:9x7:2.5"}, r"--board was given, but .* has no boards"),
        (ruihangao, "", {"edge_mm": 3.0}, r"--edge-mm was given, but .* has no edges"),
    ],
)
def test_what_is_missing_is_asked_for(
    tmp_path: Path, make: Callable[[Path], None], missing: str, options: dict, words: str
) -> None:
    source = source_of(make, tmp_path)
    if missing:
        (source / missing).unlink()
    with pytest.raises(InputError, match=words):
        imported(source, layout_of(make), **options)


def test_what_may_be_missing_is_noted(tmp_path: Path) -> None:
    source = source_of(py3dcal, tmp_path)
    (source / "annotations" / "metadata.json").unlink()
    imported(source, layout_of(py3dcal), radius_mm=2.0)
    notes = (tmp_path / "out" / "captures.toml").read_text()
    assert "# annotations/metadata.json is missing; --mm-per-px-x" in notes


def test_a_background_by_name_is_no_other_image_of_that_name(tmp_path: Path) -> None:
    source = source_of(plain, tmp_path)
    picture(source / "again" / "a_1.png")
    (captures,) = imported(source, sensor="flat_pad", background="a_1.png")
    assert {press.name for press in captures.presses} == {"again_a_1", "a_2", "a_10"}
    # What is called a background is never a press.
    assert [frame.name for frame in captures.untouched] == ["untouched"]


def test_names_that_differ_in_numbers_are_counted(tmp_path: Path) -> None:
    paths = {tmp_path / f"a/frame_{n}.png": "no ball" for n in range(300)}
    paths[tmp_path / "b_7.txt"] = "no ball"
    paths[tmp_path / "c.txt"] = "empty"
    assert left_out_sentences(paths, tmp_path) == [
        "left out, 301 files (a/frame_<n>.png, 300 x; b_7.txt): no ball",
        "left out, 1 file (c.txt): empty",
    ]


def test_an_earlier_import_below_the_source_is_not_read_again(tmp_path: Path) -> None:
    source = source_of(plain, tmp_path)
    first = import_captures(source, source / "captures")
    again = import_captures(source, source / "captures")
    assert first == again
    captures = load_capture_folder(again[0])
    assert len(captures.presses) == 3 and len(captures.records) == 1
    text = (again[0] / "captures.toml").read_text(encoding="utf-8")
    assert "part of a capture folder" in text


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ({"radius_mm": 0.00292}, r"--radius-mm is 0.00292; 0.05 to 50 mm .* metres \(2.92 mm\)"),
        ({"radius_mm": 51.0}, r"--radius-mm is 51; 0.05 to 50 mm is allowed$"),
        ({"mm_per_px_x": 5.9e-05}, r"--mm-per-px-x .* 1 mm/px .* metres \(0.059 mm/px\)"),
        ({"edge_mm": float("nan")}, r"--edge-mm is nan; 0.1 to 200 mm is allowed$"),
    ],
)
def test_lengths_out_of_bounds_are_told_by_their_flag(
    tmp_path: Path, option: dict[str, float], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        imported(source_of(plain, tmp_path), **option)
