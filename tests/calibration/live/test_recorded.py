# SPDX-License-Identifier: Apache-2.0
"""Recorded sequences become tables; an interrupted one goes on."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture.camera.recording import Recording
from taccel_lab.calibration.live.reader import LiveReader
from taccel_lab.calibration.live.recorded import read_recorded
from taccel_lab.errors import InputError
from taccel_lab.profile import BranchEntry
from tests.calibration.depth.test_depth import grey_unit


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


def test_a_gel_that_relaxes_is_followed_and_an_interrupt_changes_nothing(tmp_path: Path) -> None:
    """At two frames a second a branch of 0.5 s has relaxed by exp(-1) of an even rise."""
    branches = (BranchEntry(relative_modulus=0.5, time_s=0.5),)

    def stop(task: str, done: int, total: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    def rows(name: str, fps: float | None, interrupt: bool = False) -> list[dict]:
        folder = tmp_path / name
        reader = folder_and_reader(folder, branches if name != "plain" else ())
        out, recording = tmp_path / f"{name} out", Recording.of(folder)
        if interrupt:
            with pytest.raises(KeyboardInterrupt):
                read_recorded(recording, reader, out, {"of": 1}, stop, fps)
            reader = folder_and_reader(tmp_path / "other", branches)
        return read_recorded(recording, reader, out, {"of": 1}, fps=fps)

    plain, alone, timed = rows("plain", None), rows("alone", None), rows("timed", 2.0)
    relaxed = plain[1]["force_n"]
    assert alone[1]["force_n"] == pytest.approx(1.25 * relaxed, rel=1e-6)
    assert alone[1]["force_low_n"] == pytest.approx(plain[1]["force_low_n"], rel=1e-6)
    assert timed[1]["force_n"] == pytest.approx((1 + 0.5 * -np.expm1(-1.0)) * relaxed, rel=0.02)
    again = rows("again", 2.0, interrupt=True)
    assert [row.get("force_n") for row in again] == [row.get("force_n") for row in timed]


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
