# SPDX-License-Identifier: Apache-2.0
"""Every section of a version 2 manifest, its force records, and what each refuses."""

from __future__ import annotations

import os
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.calibration.capture import CaptureFolder, ForceRecord, load_capture_folder
from taccel_lab.calibration.capture.guide import capture_plan
from taccel_lab.calibration.capture.load import cut_short
from taccel_lab.calibration.capture.records import (
    apparent_modulus_mpa,
    check_record,
    load_record,
)
from taccel_lab.calibration.capture.schema import CaptureManifest, RecordEntry, ToolEntry
from taccel_lab.errors import InputError
from taccel_lab.files.loading_faults import require_loading
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.sensors import sensor_families
from tests.support.capture_sets import write_image

MANIFEST = """
schema_version = 2
sensor = "gelsight_mini"
unit = "S1"
background = "background.png"
untouched = ["later.png"]
indenter = { radius_mm = 2.0 }
presses = [
    { image = "a.png", depth_mm = 0.5, force_n = 0.7 }, { image = "b.png", radius_mm = 3.0 },
    { image = "c.png" },
]
boards = [{ kind = "chessboard", columns = 6, rows = 5, images = ["board.png"] }]
[[edges]]
image = "edge.png"
length_mm = 10.0
line = { u_px = 30.0, v_px = 20.0, length_px = 40.0, angle_deg = 5.0 }
[markers]
pitch_x_mm = 2.0
labels = "dots.csv"
[[markers.videos]]
frames = ["video/*.png"]
motion = "shear"
[[records]]
file = "force.csv"
kind = "indentation"
tool = { kind = "sphere", radius_mm = 4.0 }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "captures"
    (folder / "video").mkdir(parents=True)
    names = ["background", "later", "a", "b", "c", "edge", "video/0", "video/1", "video/2"]
    for i, name in enumerate(names):
        write_image(folder / f"{name}.png", np.full((48, 64, 3), 40 + 10 * i, np.uint8))
    # A view of a board need not be of the size of the presses.
    write_image(folder / "board.png", np.full((96, 128, 3), 90, np.uint8))
    (folder / "dots.csv").write_text("u_px,v_px,du_px,dv_px\n1,2,0,0\n3,4,0,1\n")
    (folder / "force.csv").write_text("depth_mm,force_n\n0.2,0.1\n0.5,0.4\n1.0,1.1\n")
    (folder / "captures.toml").write_text(MANIFEST)
    return folder


def edit(folder: Path, old: str, new: str) -> None:
    text = (folder / "captures.toml").read_text()
    assert old in text
    (folder / "captures.toml").write_text(text.replace(old, new))


def test_every_section(folder: Path) -> None:
    captures = load_capture_folder(folder)
    assert (captures.sensor, captures.unit) == ("gelsight_mini", "S1")
    assert captures.mm_per_px is None and len(captures.untouched) == 1
    assert (captures.presses[0].depth_mm, captures.presses[0].force_n) == (0.5, 0.7)
    assert captures.boards[0].entry.columns == 6
    assert captures.boards[0].frames[0].image().shape == (96, 128, 3)
    line = captures.edges[0].entry.line
    assert line is not None and line.angle_deg == 5.0
    markers = captures.markers
    assert markers is not None and markers.rest is captures.background
    assert markers.labels["dv_px"].tolist() == [0.0, 1.0]
    video = markers.videos[0]
    assert [frame[0, 0, 0] for frame in video.frames()] == [100, 110, 120]
    assert captures.records[0].columns["force_n"].tolist() == [0.1, 0.4, 1.1]
    assert captures.contents().items() >= {
        "background": 1, "untouched": 1, "ball_presses": 3, "labelled_presses": 0, "boards": 1,
        "board_views": 1, "edges": 1, "marker_images": 1, "marker_videos": 1, "force_records": 1,
    }.items()  # fmt: skip


def test_presses_of_several_balls(folder: Path) -> None:
    captures = load_capture_folder(folder)
    assert captures.ball_radii_mm() == {2.0: 2, 3.0: 1}
    of_two = captures.ball_presses((0.1, 0.1))
    assert [press.name for press in of_two.presses] == ["a", "c"]
    assert of_two.ball_radius_mm == 2.0 and "1 press of other" in of_two.provenance["left_out"]
    of_three = captures.ball_presses((0.1, 0.1), radius_mm=3.0)
    assert [press.name for press in of_three.presses] == ["b"]
    with pytest.raises(InputError, match=r"no press of a ball of 5 mm; the balls are of 2, 3 mm"):
        captures.ball_presses((0.1, 0.1), radius_mm=5.0)
    with pytest.raises(InputError, match="no scale; give mm_per_px_x and mm_per_px_y, or calib"):
        captures.ball_presses()


def test_only_some_sections(folder: Path) -> None:
    (folder / "captures.toml").write_text('schema_version = 2\nsensor = "digit"\n')
    captures = load_capture_folder(folder)
    assert captures == CaptureFolder(
        source=captures.source, root=folder, sensor="digit", unit=None, background=None,
        untouched=(), mask=None, mm_per_px=None, ball_radius_mm=None, presses=(),
        provenance=captures.provenance,
    )  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), [
    ('untouched = ["later.png"]', 'untouched = ["board.png"]', r"board\.png is 128x96 px, the"),
    ('image = "edge.png"', 'image = "gone.png"', r"gone\.png does not exist"),
    ('"video/*.png"', '"nothing/*.png"', "at least 2 frames, found 0"),
    ('frames = ["video/*.png"]', "", "either a file or frames"),
    ('frames = ["video/*.png"]', 'file = "force.csv"', "csv does not decode as a video"),
    ('frames = ["video/*.png"]', 'file = "gone.avi"', r"gone\.avi does not exist"),
    ('labels = "dots.csv"', 'labels = "force.csv"', r"force\.csv lacks du_px"),
    ("depth_mm = 0.5", "depth_mm = -0.5", r"presses\.0\.depth_mm.*greater than or equal to 0"),
    ('unit = "S1"', "mm_per_px_x = 0.1", "give both mm_per_px_x and mm_per_px_y"),
])  # fmt: skip
def test_refusals(folder: Path, old: str, new: str, message: str) -> None:
    edit(folder, old, new)
    with pytest.raises(InputError, match=message) as caught:
        load_capture_folder(folder)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize(
    "name",  # in every way in which the manifest names a file
    ["background.png", "later.png", "a.png", "board.png", "edge.png", "dots.csv", "video/*.png",
     "force.csv"],
)  # fmt: skip
def test_files_outside_of_the_folder_are_refused(folder: Path, name: str) -> None:
    for place, message in (
        ("../", "'..' leads out of it"),
        ("video/../../", "'..' leads out of it"),
        ("/etc/", "relative to the folder, not by an absolute path"),
        ("C:/", "relative to the folder, not by an absolute path"),
    ):
        edit(folder, f'"{name}"', f'"{place}{name}"')
        with pytest.raises(InputError, match=message):
            load_capture_folder(folder)
        (folder / "captures.toml").write_text(MANIFEST)
    path = folder / name.replace("*", "1")
    elsewhere = folder.parent / path.name
    path.rename(elsewhere)
    path.symlink_to(elsewhere)
    with pytest.raises(InputError, match=r"is a link out of .*; put the file itself there"):
        load_capture_folder(folder)
    path.unlink()
    elsewhere.rename(folder / f"real_{path.name}")
    path.symlink_to(folder / f"real_{path.name}")
    assert load_capture_folder(folder).contents()["force_records"] == 1


def test_a_video_file(folder: Path) -> None:
    writer = cv2.VideoWriter(str(folder / "v.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
    if not writer.isOpened():
        pytest.skip("OpenCV is built without a video writer")
    for level in (60, 120, 180):
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    edit(folder, 'frames = ["video/*.png"]', 'file = "v.avi"')
    markers = load_capture_folder(folder).markers
    assert markers is not None
    (video,) = markers.videos
    assert [frame.mean() for frame in video.frames()] == pytest.approx([60, 120, 180], abs=3)
    assert cut_short(video) is None
    said = str(cut_short(replace(video, frame_count=2)))
    assert "2 of the 3 frames that it states can be read" in said
    os.truncate(folder / "v.avi", 64)
    with pytest.raises(InputError, match=r"v\.avi does not decode as a video \(0 frames read\)"):
        load_capture_folder(folder)


@pytest.mark.parametrize("sensor", sorted(sensor_families()))
def test_guide_of_every_sensor(sensor: str) -> None:
    plan = capture_plan(sensor)
    assert 20 < plan.minutes < 60
    manifest = CaptureManifest.model_validate(tomllib.loads(plan.manifest))
    assert manifest.sensor == sensor and manifest.indenter is not None
    assert manifest.indenter.radius_mm == plan.ball_radius_mm
    (forces,) = [step for step in plan.steps if step.title == "Force against depth"]
    assert forces.count.startswith("1 flat punch, 1 ball")
    assert "flat round punch" in forces.equipment and "ball of at most" in forces.equipment
    assert plan.manifest.count("indentation_ball") == 1  # to be filled in
    blocks = " ".join(step.block for step in plan.steps)
    assert ("markers" in blocks) == (manifest.markers is not None)
    assert ("depth" in blocks) != ("color" in blocks)
    titles = {step.title for step in plan.steps}
    assert ("Board of dots" in titles) == (sensor in ("9dtact", "rtac", "stereo_pad"))
    assert ("Sides of the dome" in titles) == (sensor in ("digit_360", "rtac"))
    falls = any("along its normal" in step.how for step in plan.steps)
    assert falls == (sensor in ("digit", "digit_360", "gelsight"))


RADIUS_MM = 4.0
DEPTH_MM = np.array([0.1, 0.25, 0.4, 0.6, 0.8, 1.0])
DENSE_MM = np.linspace(0.05, 1.0, 20)


def hertz_n(modulus_mpa: float, depth_mm: np.ndarray = DEPTH_MM) -> np.ndarray:
    return 4 / 3 * modulus_mpa * np.sqrt(RADIUS_MM) * depth_mm**1.5


def entry(**changes: object) -> RecordEntry:
    tool = {"kind": "sphere", "radius_mm": RADIUS_MM}
    return RecordEntry.model_validate(
        {"file": "r.csv", "kind": "indentation", "tool": tool} | changes
    )


def indentation(depth_mm: Any, force_n: Any, **changes: Any) -> None:
    """Checks a record; ``changes`` are of its entry, or further columns."""
    columns = {"depth_mm": np.asarray(depth_mm), "force_n": np.asarray(force_n)}
    columns |= {k: changes.pop(k) for k in ("time_s", "sigma_n") if k in changes}
    check_record("r.csv", entry(**changes), columns)


@given(
    modulus=st.floats(0.01, 3.0), deepest=st.floats(0.1, 3.0), count=st.integers(3, 40),
    noise=st.floats(0.0, 0.01), seed=st.integers(0, 99),
)  # fmt: skip
def test_records_of_gels_are_accepted(
    modulus: float, deepest: float, count: int, noise: float, seed: int
) -> None:
    depth = np.linspace(deepest / count, deepest, count)
    force = hertz_n(modulus, depth)
    force += np.random.default_rng(seed).normal(0, noise * force.max(), count)
    indentation(depth, force, time_s=depth)
    assert apparent_modulus_mpa(depth, force, RADIUS_MM) == pytest.approx(modulus, rel=0.1)


@given(modulus=st.floats(0.1, 2.0), unit=st.sampled_from(["mN", "grams"]))
def test_forces_in_another_unit(modulus: float, unit: str) -> None:
    factor = {"mN": 1e3, "grams": 101.97}[unit]
    with pytest.raises(InputError, match=rf"r\.csv.*MPa stiff.*read as .*{unit}"):
        indentation(DEPTH_MM, factor * hertz_n(modulus))


FORCE_N = hertz_n(0.2)
FALLING_N = FORCE_N - [0, 0, 0, FORCE_N[3] - FORCE_N[2] + 0.03, 0, 0]


@pytest.mark.parametrize(("depth", "force", "changes", "message"), [
    (DEPTH_MM, -FORCE_N, {}, "sign of the column is reversed"),
    (-DEPTH_MM, FORCE_N, {}, "row 6 has depth_mm = -1; travel past first touch"),
    (DEPTH_MM / 1e3, FORCE_N, {}, r"reaches only 0\.001.*in metres"),
    (DEPTH_MM * 1e3, FORCE_N, {}, r"reaches 1000; at most 20 mm \(micrometres\?\)"),
    (DEPTH_MM[::-1], FORCE_N, {}, r"depth_mm falls from 1 to 0\.8 in row 2"),
    (np.r_[DEPTH_MM, DEPTH_MM[::-1]], np.r_[FORCE_N, FORCE_N[::-1]], {}, "unloading"),
    (DEPTH_MM, [0.1, 0.3, 0.9, 0.5, 0.6, 1.5], {}, r"falls to 0\.5 N in row 4 after 0\.9 N"),
    (DEPTH_MM, [0.1, 0.3, -0.4, 0.9, 1.2, 1.5], {}, r"row 3 has force_n = -0\.4 N.*than noise"),
    (DEPTH_MM, FORCE_N / 9.8e3, {}, "kN"),
    (DEPTH_MM, np.zeros(6), {}, "no force is positive"),
    (np.full(6, 0.5), FORCE_N, {}, "N while depth_mm stays at 0.5"),
    (DEPTH_MM, FORCE_N, {"time_s": -DEPTH_MM}, r"time_s falls from -?0\.?\d* to .* in row 2"),
    (DEPTH_MM, FORCE_N, {"sigma_n": np.full(6, 100.0)}, "of such a record no force is known"),
    # The stated noise decides what falls.
    (DEPTH_MM, FALLING_N, {"force_sigma_n": 0.005}, "in row 4"),
    (DEPTH_MM, hertz_n(14.0), {}, "MPa stiff"),
])  # fmt: skip
def test_faulty_indentation(depth: Any, force: Any, changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        indentation(depth, force, **changes)


def test_what_may_be_noise_or_of_another_tool_is_accepted() -> None:
    indentation(DEPTH_MM, FORCE_N - 0.02, force_sigma_n=0.02)
    indentation(DEPTH_MM, FALLING_N, force_sigma_n=0.02)
    # 14 MPa by a 4 mm ball, 6 MPa by a 20 mm one: nobody knows.
    indentation(DEPTH_MM, hertz_n(14.0), tool=ToolEntry())


@pytest.mark.parametrize(("text", "message"), [
    ("depth_mm,force_n\n", "holds 0 rows; a header and at least 2"),
    ("depth_mm,force_n\n0.1,0.2\n0.2,nan\n", "line 3: column force_n: 'nan' is not a finite"),
    ("depth_mm,force_g\n0.1,20\n0.2,30\n", "lacks the column force_n.*found depth_mm"),
    ("depth_mm,force_n,sigma_n\n0.1,0.1,0\n0.2,0.3,0.1\n", "sigma_n has to be positive"),
])  # fmt: skip
def test_broken_file(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        load_record(tmp_path, entry())


def loaded(folder: Path, depth: Any, force: Any) -> ForceRecord:
    rows = [f"{d:.9g},{f:.9g}" for d, f in zip(depth, force, strict=True)]
    (folder / "r.csv").write_text("\n".join(["depth_mm,force_n", *rows]) + "\n")
    return load_record(folder, entry())


PUBLISHED = [0.5, 1.0, 1.5], [1.6503, 5.9641, 13.5257]
"""The three depths and forces of FEATS."""


@pytest.mark.parametrize(("depth", "force", "message"), [
    (DENSE_MM, np.full(20, 1.0), r"r\.csv: force_n does not rise with depth_mm: it is 1 N"),
    (hertz_n(0.5, DENSE_MM), DENSE_MM, "rises ever less .*columns swapped"),
    (DENSE_MM, hertz_n(0.5, DENSE_MM) + 1.0, r"zero is off.*rows in air.*\(depth_mm below 0\)"),
    (*PUBLISHED[::-1], "columns swapped"),
])  # fmt: skip
def test_what_no_ball_presses(tmp_path: Path, depth: Any, force: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        loaded(tmp_path, depth, force)


@pytest.mark.thorough
@settings(max_examples=30)
@given(
    radius=st.floats(1.0, 15.0), thickness=st.floats(1.0, 6.0), nu=st.floats(0.4, 0.5),
    late=st.floats(-0.3, 0.3), count=st.integers(3, 40), noise=st.sampled_from([0, 0.003, 0.01]),
    seed=st.integers(0, 999),
)  # fmt: skip
def test_no_press_of_a_ball_on_a_layer_is_refused(
    radius: float, thickness: float, nu: float, late: float, count: int, noise: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    deepest = min(0.5 * thickness, 0.6 * radius)
    depth = np.sort(rng.uniform(0.05, 1.0, count)) * deepest
    late *= min(1.0, deepest)
    force = layer_force_n("sphere", np.maximum(depth - late, 0), radius, thickness, nu, 2e5)
    force += rng.normal(0, noise * force.max(), count)
    require_loading(depth, force, 0.02 * force.max(), ball=True)


def test_what_the_load_cell_reads_in_air_is_taken_off(tmp_path: Path) -> None:
    record = loaded(tmp_path, *PUBLISHED)
    assert record.zero is None and len(record.columns["force_n"]) == 3
    depth = np.linspace(-1.0, 1.0, 41)
    true = hertz_n(0.5, np.maximum(depth, 0.0))
    noise = np.random.default_rng(0).normal(0, 0.01, len(depth))
    record = loaded(tmp_path, depth, true + 1.0 + noise)
    assert record.zero is not None and record.columns["depth_mm"].min() > 0
    low, high = record.zero.interval95
    assert low < 1.0 < high and high - low < 0.05
    assert record.columns["force_n"] == pytest.approx(true[depth > 0], abs=0.05)
    with pytest.raises(InputError, match="Reverse the column's sign, or cut the approach off"):
        loaded(tmp_path, depth, true[::-1] + 1.0)
    # Rows that stand twice count once.
    once = loaded(tmp_path, DENSE_MM, hertz_n(0.5, DENSE_MM))
    twice = loaded(tmp_path, np.repeat(DENSE_MM, 2), np.repeat(hertz_n(0.5, DENSE_MM), 2))
    for name, values in once.columns.items():
        assert np.array_equal(twice.columns[name], values)
