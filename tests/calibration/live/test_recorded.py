# SPDX-License-Identifier: Apache-2.0
"""Recorded sequences become tables; an interrupted one goes on."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import h5py
import numpy as np
import pytest

from taccel_lab.calibration.capture.camera.recording import Recording
from taccel_lab.calibration.live.reader import LiveReader
from taccel_lab.calibration.live.recorded import draw_recorded, figures_of, read_recorded
from taccel_lab.calibration.untouched_frame import UntouchedFrame
from taccel_lab.errors import InputError
from taccel_lab.files.videos import RecordedFrame
from taccel_lab.profile import BranchEntry
from taccel_lab.signals.frame_operators import lost_rows, torn
from tests.calibration.depth.test_depth import grey_unit
from tests.support.capture_sets import write_image
from tests.support.oblong_grey import grey_profile

GROWN = 0.5 * -np.expm1(-1.0)
"""What a branch of half the modulus and 0.5 s adds to a force that rises evenly for 0.5 s."""


def reader_of(*, relaxes: bool) -> LiveReader:
    profile = grey_unit().profile
    branches = (BranchEntry(relative_modulus=0.5, time_s=0.5),) if relaxes else ()
    profile = profile.with_block(profile.material.replace(branches=branches))
    return LiveReader(profile, grey_unit().rest.astype(np.float32))


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    """Images of untouched gel, a press, a torn file and untouched gel again."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for number in (0, 2, 10):
        image = grey_unit().pressed if number == 2 else grey_unit().rest
        write_image(folder / f"frame_{number}.png", image)
    (folder / "frame_3.png").write_bytes(b"torn")
    return folder


def killed_at(frame: int) -> Callable[[str, int, int], None]:
    def stop(task: str, done: int, total: int) -> None:
        if done == frame:
            raise KeyboardInterrupt

    return stop


def table_of(out: Path) -> list[dict[str, str]]:
    with (out / "readings.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_ways_of_dots_are_told_in_millimetres_of_oblong_pixels() -> None:
    """3 px of 0.2 mm across and 4 px of 0.1 mm down; one that is not seen does not count."""
    rest = np.array([[10.0, 20.0], [30.0, 20.0], [50.0, 20.0]])
    moved = rest + [[3.0, 4.0], [0.0, 0.0], [90.0, 0.0]]
    seen = np.array([True, True, False])
    reading: Any = SimpleNamespace(
        reading=None, refused="", press=None,
        markers=SimpleNamespace(uv_px=moved, rest_px=rest, seen=seen),
    )  # fmt: skip
    reader: Any = SimpleNamespace(profile=grey_profile())
    row = figures_of(reading, reader)
    assert row["marker_largest_mm"] == pytest.approx(np.hypot(0.6, 0.4))
    assert row["marker_mean_mm"] == pytest.approx(np.hypot(0.6, 0.4) / 2)
    assert row["markers_seen"] == 2


def test_broken_frames_are_refused_with_their_rows_and_repeated_ones_said(tmp_path: Path) -> None:
    unit, folder = grey_unit(), tmp_path / "frames"
    folder.mkdir()
    height = len(unit.rest)
    images = [
        unit.rest, lost_rows(unit.pressed, 70), unit.rest, unit.pressed, unit.pressed,
        torn(unit.pressed, height // 2, before=unit.rest),
    ]  # fmt: skip
    for number, image in enumerate(images):
        write_image(folder / f"frame_{number}.png", image)
    out = tmp_path / "out"
    read_recorded(Recording.of(folder), reader_of(relaxes=False), out, {"of": 1})
    table = table_of(out)
    assert f"rows 70 to {height - 1} are of one colour" in table[1]["refused"]
    assert "of another moment" in table[5]["refused"]
    assert table[1]["depth_mm"] == table[1]["force_n"] == ""
    assert not any(table[k]["refused"] for k in (0, 2, 3, 4))
    said = ["that of the frame before" in row["remarks"] for row in table]
    assert said == [False] * 4 + [True, False]
    assert table[3]["force_n"] == table[4]["force_n"]


@pytest.mark.thorough
@pytest.mark.parametrize("end", ["\n", "", '\n{"frame": 2, "na'], ids=["whole", "open", "torn"])
def test_a_folder_becomes_a_table_and_goes_on_after_a_kill(
    frames: Path, tmp_path: Path, end: str
) -> None:
    reader, recorded, out = reader_of(relaxes=False), Recording.of(frames), tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        read_recorded(recorded, reader, out, {"of": 1}, killed_at(2))
    assert not out.exists()
    (kept,) = tmp_path.glob(".out.readings*")
    kept.write_text(kept.read_text().removesuffix("\n") + end)
    seen: list[int] = []
    rows = read_recorded(recorded, reader, out, {"of": 1}, lambda _, done, __: seen.append(done))
    assert seen == [3, 4]
    assert [row["name"] for row in rows] == [f"frame_{n}.png" for n in (0, 2, 3, 10)]
    table = table_of(out)
    assert [row["refused"] for row in table[:2] + table[3:]] == ["", "", ""]
    forces = [float(row["force_n"] or "nan") for row in table]
    assert forces[1] > 10 * max(forces[0], forces[3])
    assert float(table[1]["force_low_n"]) < forces[1] < float(table[1]["force_high_n"])
    assert "frame_3.png" in table[2]["refused"]
    assert {path.name for path in out.iterdir()} >= {"readings.json", "readings.png"}
    assert not list(tmp_path.glob(".out.readings*"))


@pytest.mark.thorough
def test_a_gel_that_relaxes_is_followed_and_an_interrupt_changes_nothing(frames, tmp_path) -> None:
    """At two frames a second a branch of 0.5 s has relaxed by exp(-1) of an even rise."""

    def rows(name: str, fps: float | None, *, relaxes: bool = True, kill: bool = False) -> list:
        recording = Recording.of(frames, fps=fps)
        if kill:
            with pytest.raises(KeyboardInterrupt):
                read_recorded(recording, reader_of(relaxes=True), tmp_path / name, {}, killed_at(1))
        return read_recorded(recording, reader_of(relaxes=relaxes), tmp_path / name, {})

    plain, alone, timed = (
        rows("plain", None, relaxes=False),
        rows("alone", None),
        rows("timed", 2.0),
    )
    relaxed = plain[1]["force_n"]
    assert alone[1]["force_n"] == pytest.approx(1.25 * relaxed, rel=1e-6)
    assert alone[1]["force_low_n"] == pytest.approx(plain[1]["force_low_n"], rel=1e-6)
    assert timed[1]["force_n"] == pytest.approx((1 + GROWN) * relaxed, rel=0.02)
    again = rows("again", 2.0, kill=True)
    assert [row.get("force_n") for row in again] == [row.get("force_n") for row in timed]


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["stamps", "video"])
def test_the_times_of_a_recording_relax_the_gel(kind: str, tmp_path: Path) -> None:
    """Pressed within half a second, held for two: the branch has gone by exp(-4)."""
    reader, unit = reader_of(relaxes=True), grey_unit()
    taken = {0.0: unit.rest, 0.5: unit.pressed, 2.5: unit.pressed, 2.6: unit.rest}
    if kind == "stamps":
        source = tmp_path / "stamped"
        source.mkdir()
        for time_s, image in taken.items():
            write_image(source / f"{1699999999033000000 + round(1e9 * time_s)}.png", image)
    else:
        source = tmp_path / "v.mkv"
        with av.open(str(source), "w") as container:
            stream = container.add_stream("ffv1", rate=25)
            stream.height, stream.width = unit.rest.shape[:2]
            stream.pix_fmt, stream.codec_context.time_base = "bgr0", Fraction(1, 1000)
            for time_s, image in taken.items():
                frame = av.VideoFrame.from_ndarray(image, "rgb24")
                frame.pts, frame.time_base = round(1000 * time_s), Fraction(1, 1000)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
    out = tmp_path / "out"
    rows = read_recorded(Recording.of(source), reader, out, {"of": 1})
    times = [float(row["time_s"]) for row in table_of(out)]
    assert times == pytest.approx(list(taken), abs=1e-9)
    plain = reader_of(relaxes=False).read(unit.pressed).press
    assert plain is not None
    held = (1 + GROWN * np.exp(-4.0)) * plain.force_n
    assert rows[1]["force_n"] == pytest.approx((1 + GROWN) * plain.force_n, rel=0.02)
    assert rows[2]["force_n"] == pytest.approx(held, rel=0.005)
    about = json.loads((out / "readings.json").read_text())
    assert about["times_from"] and about["frames"][2]["time_s"] == pytest.approx(2.5)
    rows = read_recorded(Recording.of(source, fps=1.0), reader, tmp_path / "rated", {"of": 2})
    assert [row["time_s"] for row in rows] == [0, 1, 2, 3]
    assert rows[2]["force_n"] > (1 + 0.9 * GROWN * np.exp(-3.0)) * plain.force_n


@pytest.mark.thorough
def test_episodes_begin_anew_whatever_their_clocks_say(tmp_path: Path) -> None:
    """Nothing is known of how long the gel was held before, though the times rise."""
    reader, rest, pressed = reader_of(relaxes=True), grey_unit().rest, grey_unit().pressed
    images = [rest, pressed, InputError("torn"), pressed]
    clocks = [(0.0, 0), (1.0, 0), (0.0, 1), (5.0, 1)]
    frames = [RecordedFrame("", i, *clock) for i, clock in zip(images, clocks, strict=True)]
    recording = Recording(tmp_path, "", lambda: len(frames), lambda: iter(frames))
    rows = read_recorded(recording, reader, tmp_path / "out", {"of": 1})
    alone = reader.read(pressed).press
    assert alone is not None and rows[3]["time_s"] == 5.0
    assert rows[3]["force_n"] == pytest.approx(alone.force_n, rel=0.005)
    assert rows[3]["force_high_n"] > 1.5 * rows[1]["force_n"] / 1.25
    assert not draw_recorded(rows).axes[-1].get_xlabel().startswith("time")
    assert draw_recorded(rows[:2]).axes[-1].get_xlabel() == "time [s]"


@pytest.mark.thorough
def test_what_holds_no_frames_or_others_is_refused(frames, tmp_path, monkeypatch) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "words.txt").write_text("none")
    with h5py.File(tmp_path / "0.hdf5", "w") as file:
        file["levels"] = np.zeros((1000, 20, 30, 3), np.uint8)
    reader, before = reader_of(relaxes=False), sorted(tmp_path.iterdir())
    for name, said in (
        ("empty", "no images"),
        ("words.txt", r"words\.txt is none of these: a video"),
        ("frames/frame_3.png", "no frame of"),
        # A stream of another size ends at its first frame.
        ("0.hdf5", "frame 0 is 30x20 px; 200x150 px are needed"),
    ):
        with pytest.raises(InputError, match=said):
            read_recorded(Recording.of(tmp_path / name), reader, tmp_path / "out", {})
    assert sorted(tmp_path.iterdir()) == before
    monkeypatch.setattr("taccel_lab.calibration.untouched_frame.is_starter", lambda _: True)
    with pytest.raises(InputError, match="frame 0 is 30x20 px; the profile's camera has"):
        UntouchedFrame.of(reader.profile, [tmp_path / "0.hdf5"])
