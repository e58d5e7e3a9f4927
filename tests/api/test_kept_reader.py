# SPDX-License-Identifier: Apache-2.0
"""Readers that are kept: made once, never stale, and of the same bits as single calls."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import taccel_lab as tl
from taccel_lab.api import kept_readers
from taccel_lab.profile import SensorProfile
from taccel_lab.reading import reader as room
from taccel_lab.signals.frame_operators import lost_rows
from tests.calibration.depth.test_depth import grey_unit
from tests.support.capture_sets import write_image


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """A list that grows with each reader that is made; none is kept at first."""
    kept_readers._readers.clear()
    readers, init = [], room.Reader.__init__

    def counted(self: Any, *arguments: Any, **how: Any) -> None:
        init(self, *arguments, **how)
        readers.append(1)

    monkeypatch.setattr(room.Reader, "__init__", counted)
    yield readers


def unit() -> tuple[SensorProfile, np.ndarray, np.ndarray]:
    """A grey sensor's profile, its untouched image and a press."""
    found = grey_unit()
    return found.profile, found.rest, found.pressed


def test_a_loop_of_single_calls_makes_one_reader(made: list[int], tmp_path: Path) -> None:
    profile, rest, pressed = unit()
    tl.save_profile(profile, tmp_path / "profile")
    mask = np.ones(rest.shape[:2], bool)
    for _ in range(3):
        tl.read(profile, pressed, background=rest)
        tl.read(tmp_path / "profile", pressed, background=rest, mask=mask)
    assert len(made) == 2


def test_what_has_changed_is_read_by_another_reader(made: list[int], tmp_path: Path) -> None:
    profile, rest, pressed = unit()
    folder, image = tmp_path / "profile", tmp_path / "rest.png"
    tl.save_profile(profile, folder)
    write_image(image, rest)

    def depth_mm() -> float:
        return tl.read(folder, pressed, background=image).depth_mm

    first = depth_mm()
    assert first == depth_mm() > 1.0 and len(made) == 1
    # The press itself as background: nothing touches.
    write_image(image, pressed)
    assert depth_mm() == 0.0 and len(made) == 2
    write_image(image, rest)
    assert depth_mm() == first and len(made) == 2
    # A profile written again, of a thinner gel.
    gel = profile.gel.model_copy(update={"thickness_mm": 1.2})
    shutil.rmtree(folder)
    tl.save_profile(replace(profile, gel=gel), folder)
    with pytest.raises(tl.InputError, match=r"in a gel of 1\.2 mm"):
        depth_mm()
    # An array that is written over, and a mask.
    background, mask = rest.copy(), np.ones(rest.shape[:2], bool)
    assert tl.read(profile, pressed, background=background).touch.any
    background[:] = pressed
    assert not tl.read(profile, pressed, background=background).touch.any
    mask[:, :20] = False
    whole = tl.read(profile, pressed, background=rest)
    assert len({whole.depth_m.tobytes()}) == 1
    before = len(made)
    tl.read(profile, pressed, background=rest, mask=mask)
    assert len(made) == before + 1


def test_few_readers_are_kept(made: list[int]) -> None:
    profile, rest, pressed = unit()
    for level in range(kept_readers.KEPT + 3):
        tl.read(profile, pressed, background=rest - np.uint8(level))
    assert len(kept_readers._readers) == kept_readers.KEPT
    tl.read(profile, pressed, background=rest - np.uint8(kept_readers.KEPT + 2))
    assert len(made) == kept_readers.KEPT + 3


def test_a_reader_takes_images_lists_batches_and_streams(made: list[int], tmp_path: Path) -> None:
    profile, rest, pressed = unit()
    reader, files = tl.load_sensor(profile).reader(background=rest), tmp_path / "frames"
    files.mkdir()
    for number, image in enumerate((rest, pressed)):
        write_image(files / f"{number}.png", image)
    batch = np.stack([rest, pressed])
    alone = [tl.read(profile, image, background=rest) for image in batch]
    moved = torch.from_numpy(batch).permute(0, 3, 1, 2)
    for several in (
        reader([rest, pressed]), reader(batch), reader(torch.from_numpy(batch)), reader(moved),
        reader(files), [*reader.stream(files)], [*reader.stream(batch)],
        tl.read(profile, batch, background=rest), [reader(rest), reader(files / "1.png")],
    ):  # fmt: skip
        assert len(several) == 2
        for found, one in zip(several, alone, strict=True):
            assert np.array_equal(found.depth_m, one.depth_m)
            assert np.array_equal(found.pressure_pa, one.pressure_pa)
            assert found.figures() == one.figures()
    assert len(made) == 2
    with pytest.raises(tl.InputError, match="list of images is empty"):
        reader(batch[:0])
    with pytest.raises(tl.InputError, match="background="):
        tl.Reader("gelsight_mini")


def test_a_stream_ends_at_what_is_refused_or_tells_it() -> None:
    profile, rest, pressed = unit()
    reader, told = tl.Reader(profile, background=rest), []
    frames = [rest, lost_rows(pressed, 70), pressed]
    with pytest.raises(tl.InputError, match="frame 1 is not whole"):
        list(reader.stream(frames))
    found = list(reader.stream(iter(frames), refused=told.append))
    assert [one.touch.any for one in found] == [False, True]
    assert [str(error)[:8] for error in told] == ["frame 1 "]


def test_a_starter_finds_its_background_anew(made: list[int], tmp_path: Path) -> None:
    """A folder that has got another untouched image."""
    from taccel_lab.sensors.profile import stock_sensor

    profile = stock_sensor("gelsight_mini")
    rest = np.asarray(profile.background_rgb)
    write_image(tmp_path / "background.png", np.rint(rest).astype(np.uint8))
    image = tmp_path / "shot.png"
    write_image(image, np.rint(rest).astype(np.uint8))
    for _ in range(2):
        assert tl.read("gelsight_mini", image).depth_mm == 0.0
    assert len(made) == 1
    os.rename(tmp_path / "background.png", tmp_path / "untouched.png")
    assert "untouched.png" in " ".join(tl.read("gelsight_mini", image).remarks)
