# SPDX-License-Identifier: Apache-2.0
"""Recorded sequences become tables; an interrupted one goes on."""

from __future__ import annotations

import csv
import json
from fractions import Fraction
from pathlib import Path

import av
import cv2
import h5py
import numpy as np
import pytest

from taccel_lab.calibration.capture.camera.recording import Recording
from taccel_lab.calibration.live.reader import LiveReader
from taccel_lab.calibration.live.recorded import draw_recorded, read_recorded
from taccel_lab.calibration.untouched_frame import UntouchedFrame
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.files.videos import RecordedFrame
from taccel_lab.profile import BranchEntry, SensorProfile
from tests.calibration.grey.test_depth import grey_unit
from tests.support.small_captures import write_image


def folder_and_reader(folder: Path, branches: tuple[BranchEntry, ...] = ()) -> LiveReader:
    """Images of untouched gel, a press, a torn file and untouched gel again."""
    captures, profile = grey_unit()
    profile = profile.with_block(profile.material.replace(branches=branches))
    rest = np.asarray(captures.background)
    folder.mkdir()
    for number, image in ((0, rest), (2, captures.presses[2].image()), (10, rest)):
        levels = np.clip(np.rint(image), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"frame_{number}.png"), levels[..., ::-1])
    (folder / "frame_3.png").write_bytes(b"torn")
    return LiveReader(profile, rest.astype(np.float32), sigma_every=1)


@pytest.mark.thorough
def test_a_folder_becomes_a_table_and_goes_on_after_a_kill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = folder_and_reader(tmp_path / "frames")
    recorded, out = Recording.of(tmp_path / "frames"), tmp_path / "out"

    def stop(task: str, done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        read_recorded(recorded, reader, out, {"of": 1}, stop)
    assert not out.exists()
    seen: list[int] = []
    rows = read_recorded(recorded, reader, out, {"of": 1}, lambda _, done, __: seen.append(done))
    assert seen == [3, 4]
    assert [row["name"] for row in rows] == [f"frame_{n}.png" for n in (0, 2, 3, 10)]
    with (out / "readings.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert [row["refused"] for row in table[:2] + table[3:]] == ["", "", ""]
    forces = [float(row["force_n"] or "nan") for row in table]
    assert forces[1] > 10 * max(forces[0], forces[3])
    assert float(table[1]["force_low_n"]) < forces[1] < float(table[1]["force_high_n"])
    assert "frame_3.png" in table[2]["refused"]
    assert {path.name for path in out.iterdir()} >= {"readings.json", "readings.png"}
    assert not list(tmp_path.glob(".out.readings*"))


@pytest.mark.thorough
def test_a_gel_that_relaxes_is_followed_and_an_interrupt_changes_nothing(tmp_path: Path) -> None:
    """At two frames a second a branch of 0.5 s has relaxed by exp(-1) of an even rise."""
    branches = (BranchEntry(relative_modulus=0.5, time_s=0.5),)

    def stop(task: str, done: int, total: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    def rows(name: str, fps: float | None, interrupt: bool = False) -> list[dict]:
        folder = tmp_path / name
        reader = folder_and_reader(folder, branches if name != "plain" else ())
        out, recording = tmp_path / f"{name} out", Recording.of(folder, fps=fps)
        if interrupt:
            with pytest.raises(KeyboardInterrupt):
                read_recorded(recording, reader, out, {"of": 1}, stop)
            reader = folder_and_reader(tmp_path / "other", branches)
        return read_recorded(recording, reader, out, {"of": 1})

    plain, alone, timed = rows("plain", None), rows("alone", None), rows("timed", 2.0)
    relaxed = plain[1]["force_n"]
    assert alone[1]["force_n"] == pytest.approx(1.25 * relaxed, rel=1e-6)
    assert alone[1]["force_low_n"] == pytest.approx(plain[1]["force_low_n"], rel=1e-6)
    assert timed[1]["force_n"] == pytest.approx((1 + 0.5 * -np.expm1(-1.0)) * relaxed, rel=0.02)
    again = rows("again", 2.0, interrupt=True)
    assert [row.get("force_n") for row in again] == [row.get("force_n") for row in timed]


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["stamps", "video"])
def test_the_times_of_a_recording_relax_the_gel(kind: str, tmp_path: Path) -> None:
    """Pressed within half a second, held for two: the branch of half a second has gone by exp(-4);
    the table says when each frame was taken, and a stated rate counts in their place."""
    reader = folder_and_reader(
        tmp_path / "frames", (BranchEntry(relative_modulus=0.5, time_s=0.5),)
    )
    rest, pressed = (read_image(tmp_path / "frames" / f"frame_{n}.png") for n in (0, 2))
    taken = {0.0: rest, 0.5: pressed, 2.5: pressed, 2.6: rest}
    if kind == "stamps":
        source = tmp_path / "stamped"
        source.mkdir()
        for time_s, image in taken.items():
            write_image(source / f"{1699999999033000000 + round(1e9 * time_s)}.png", image)
    else:
        source = tmp_path / "v.mkv"
        with av.open(str(source), "w") as container:
            stream = container.add_stream("ffv1", rate=25)
            stream.height, stream.width = rest.shape[:2]
            stream.pix_fmt, stream.codec_context.time_base = "bgr0", Fraction(1, 1000)
            for time_s, image in taken.items():
                frame = av.VideoFrame.from_ndarray(image, "rgb24")
                frame.pts, frame.time_base = round(1000 * time_s), Fraction(1, 1000)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
    rows = read_recorded(Recording.of(source), reader, tmp_path / "out", {"of": 1})
    table = list(csv.DictReader((tmp_path / "out" / "readings.csv").open(encoding="utf-8")))
    assert [float(row["time_s"]) for row in table] == pytest.approx(list(taken), abs=1e-9)
    plain = folder_and_reader(tmp_path / "plain").read(pressed).press
    assert plain is not None
    grown = 0.5 * -np.expm1(-1.0)
    assert rows[1]["force_n"] == pytest.approx((1 + grown) * plain.force_n, rel=0.02)
    assert rows[2]["force_n"] == pytest.approx(
        (1 + grown * np.exp(-4.0)) * plain.force_n, rel=0.005
    )
    about = json.loads((tmp_path / "out" / "readings.json").read_text())
    assert about["times_from"] and about["frames"][2]["time_s"] == pytest.approx(2.5)
    rated = Recording.of(source, fps=1.0)
    rows = read_recorded(rated, reader, tmp_path / "rated", {"of": 2})
    assert [row["time_s"] for row in rows] == [0, 1, 2, 3]
    assert rows[2]["force_n"] > (1 + 0.9 * grown * np.exp(-3.0)) * plain.force_n


@pytest.mark.thorough
def test_episodes_begin_anew_whatever_their_clocks_say(tmp_path: Path) -> None:
    """The first frames of an episode are torn, and its clock goes on after the other's: nothing is
    known of how long the gel was held, though the times rise."""
    reader = folder_and_reader(
        tmp_path / "frames", (BranchEntry(relative_modulus=0.5, time_s=0.5),)
    )
    rest, pressed = (read_image(tmp_path / "frames" / f"frame_{n}.png") for n in (0, 2))
    torn = InputError("torn")
    frames = [
        RecordedFrame("", rest, 0.0, 0), RecordedFrame("", pressed, 1.0, 0),
        RecordedFrame("", torn, 0.0, 1), RecordedFrame("", pressed, 5.0, 1),
    ]  # fmt: skip
    recording = Recording(tmp_path, "", lambda: len(frames), lambda: iter(frames))
    rows = read_recorded(recording, reader, tmp_path / "out", {"of": 1})
    alone = reader.read(pressed).press
    assert alone is not None and rows[3]["time_s"] == 5.0
    assert rows[3]["force_n"] == pytest.approx(alone.force_n, rel=0.005)
    assert rows[3]["force_high_n"] > 1.5 * rows[1]["force_n"] / 1.25
    assert not draw_recorded(rows).axes[-1].get_xlabel().startswith("time")
    assert draw_recorded(rows[:2]).axes[-1].get_xlabel() == "time [s]"


def test_what_holds_no_frames_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no images"):
        Recording.of(tmp_path / "empty")
    (tmp_path / "words.txt").write_text("none")
    with pytest.raises(InputError, match=r"words\.txt is none of these: a video"):
        Recording.of(tmp_path / "words.txt")
    reader = folder_and_reader(tmp_path / "frames")
    torn = Recording.of(tmp_path / "frames" / "frame_3.png")
    with pytest.raises(InputError, match="no frame of"):
        read_recorded(torn, reader, tmp_path / "out", {})
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_a_stream_of_another_size_ends_at_its_first_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = folder_and_reader(tmp_path / "frames")
    with h5py.File(tmp_path / "0.hdf5", "w") as file:
        file["levels"] = np.zeros((1000, 20, 30, 3), np.uint8)
    recording = Recording.of(tmp_path / "0.hdf5")
    height, width = reader.background.shape[:2]
    said = f"frame 0 is 30x20 px; {width}x{height} px are needed"
    with pytest.raises(InputError, match=said):
        read_recorded(recording, reader, tmp_path / "out", {})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.hdf5", "frames"]
    with pytest.raises(InputError, match="frame 0 is 30x20 px; the profile's camera has"):
        UntouchedFrame.of(starter_like(reader.profile, monkeypatch), [tmp_path / "0.hdf5"])


def starter_like(profile: SensorProfile, monkeypatch: pytest.MonkeyPatch) -> SensorProfile:
    """The profile, taken for one of the catalogue: of another unit."""
    monkeypatch.setattr("taccel_lab.calibration.untouched_frame.is_starter", lambda _: True)
    return profile
