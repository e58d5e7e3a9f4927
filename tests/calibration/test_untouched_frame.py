# SPDX-License-Identifier: Apache-2.0
"""A profile of another unit reads against an untouched frame of this one, or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.calibration.untouched_frame import UntouchedFrame
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.profile import SensorProfile
from taccel_lab.reading.reader import Reader
from tests.support.real_data import real_data
from tests.support.small_captures import write_image
from tests.support.synthetic_presses import GRID, flat_profile

SDK = "gsmini_gs_sdk/examples/data"
RUIHANGAO = "gsmini_ruihangao_calib/calib_ball"


@pytest.fixture(scope="module")
def mini() -> SensorProfile:
    """The starter of the GelSight Mini."""
    return tl.load_sensor("gelsight_mini")


def recorded(folder: Path, frames: Sequence[np.ndarray]) -> Path:
    """Frames with read noise of one level, as images in order."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    for number, frame in enumerate(frames):
        noisy = np.rint(frame + rng.normal(0.0, 1.0, frame.shape))
        write_image(folder / f"frame_{number}.png", np.clip(noisy, 0, 255).astype(np.uint8))
    return folder


def middle(number: int) -> np.ndarray:
    """An image of the uncropped Mini as its starter knows them: the middle 5/7."""
    image = read_image(real_data(f"{RUIHANGAO}/frame_{number}.jpg"))
    height, width = image.shape[:2]
    cut = image[height // 7 : height - height // 7, width // 7 : width - width // 7]
    return cv2.resize(cut, (320, 240), interpolation=cv2.INTER_AREA)


def touched_mm2(found: UntouchedFrame, image: np.ndarray) -> float:
    reader = Reader(found.profile, background=found.image)
    return reader.read(image).figures()["dent_mm2"]


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name", [f"{SDK}/bead.png", "gsmini_normalflow/examples/data/background.png"]
)
def test_a_file_beside_the_images_is_taken_by_its_name(name: str, mini: SensorProfile) -> None:
    path = real_data(name)
    found = UntouchedFrame.of(mini, [path])
    beside = path.parent / "background.png"
    assert found.image is not None and found.name == str(beside)
    np.testing.assert_array_equal(found.image, read_image(beside))
    said = f"untouched gel: {beside}, by its name"
    assert found.profile.sensor.provenance.remarks == (*mini.sensor.provenance.remarks, said)
    assert touched_mm2(found, found.image) == 0.0


@pytest.mark.thorough
def test_the_rest_before_the_first_touch_of_a_dotted_mini_is_found(mini, tmp_path) -> None:
    """57 frames are at rest, then a finger presses and shears, and never stands still."""
    for number in (*range(0, 56, 8), *range(57, 121, 8)):
        shutil.copy(real_data(f"gsmini_markers_video/{number:04d}.png"), tmp_path)
    found = UntouchedFrame.of(mini, [tmp_path / "0065.png", tmp_path / "0008.png"])
    said = found.profile.sensor.provenance.remarks[-1]
    first, last = (int(name[:4]) for name in said.rsplit(", ", 1)[1].split(" to "))
    assert 0 <= first < last < 57
    assert f"still frames of {tmp_path}" in said
    assert touched_mm2(found, read_image(tmp_path / "0008.png")) < 1.0
    assert touched_mm2(found, read_image(tmp_path / "0089.png")) > 10.0


@pytest.mark.thorough
@pytest.mark.parametrize("order", [1, -1])
def test_a_press_that_is_held_longer_than_the_rest_is_not_taken(order, mini, tmp_path) -> None:
    rest, press = (read_image(real_data(f"{SDK}/{n}.png")) for n in ("background", "bead"))
    between = [(1 - share) * rest + share * press for share in (0.25, 0.5, 0.75)]
    frames = [*[rest] * 6, *between, *[press] * 30][::order]
    found = UntouchedFrame.of(mini, [recorded(tmp_path / "frames", frames)])
    assert found.image is not None
    assert np.abs(found.image - rest).mean() < 1.0 < np.abs(found.image - press).mean()


@pytest.mark.thorough
def test_two_photos_of_the_gel_at_rest_among_presses_are_found(mini, tmp_path) -> None:
    rest = read_image(real_data(f"{RUIHANGAO}/frame_0.png"))
    presses = [middle(number) for number in range(1, 49, 6)]
    folder = recorded(tmp_path / "photos", [*presses[:3], rest, *presses[3:], rest])
    found = UntouchedFrame.of(mini, [folder / "frame_0.png"])
    assert found.name == f"2 still frames of {folder}"
    assert found.image is not None and np.abs(found.image - rest).mean() < 1.0


@pytest.mark.thorough(cases=("4-may be a press that is held",))
@pytest.mark.parametrize(
    ("held", "why"), [(1, "no two frames agree"), (4, "may be a press that is held")]
)
def test_presses_alone_are_refused(held: int, why: str, mini, tmp_path) -> None:
    presses = [middle(number) for number in range(1, 49, 8)]
    folder = recorded(tmp_path / "photos", [one for one in presses for _ in range(held)])
    with pytest.raises(InputError, match=rf"shows no untouched gel for certain \(.*{why}"):
        UntouchedFrame.of(mini, [folder])


def refused(mini: SensorProfile, sources: list[Path], said: str) -> None:
    with pytest.raises(InputError, match=said):
        UntouchedFrame.of(mini, sources, option="--untouched")


def test_images_of_no_or_several_folders_are_refused(mini, tmp_path) -> None:
    sides = [tmp_path / side / "0.png" for side in ("left", "right")]
    refused(mini, sides, "the images are of several folders; give an image")
    refused(mini, [], "is of another unit; give an image.*: --untouched$")


def test_a_gel_that_nothing_happens_to_or_several_untouched_images_are_refused(
    mini, tmp_path
) -> None:
    """Nobody knows whether something lies on it, nor which is of this unit and day."""
    rest = read_image(real_data(f"{SDK}/background.png"))
    still = recorded(tmp_path / "frames", [rest] * 5)
    refused(mini, [still], r"\(nothing changes in it\); give an image of your")
    alone = recorded(tmp_path / "alone", [rest]) / "frame_0.png"
    refused(mini, [alone], r"\(1 images of the profile's size\)")
    several = real_data("backgrounds_misc") / "fabprez_gsmini_ball.png"
    refused(mini, [several], r"several images called untouched \(maniskill_vitac_gsm")


def test_what_is_given_and_a_profile_of_the_unit_stay_as_they_are(mini, tmp_path) -> None:
    levels = np.full((240, 320, 3), 90, np.uint8)
    write_image(tmp_path / "mine.png", levels)
    for given in (levels, tmp_path / "mine.png"):
        found = UntouchedFrame.of(mini, [], given)
        assert found.profile is mini
        np.testing.assert_array_equal(np.asarray(found.image), levels)
    own = flat_profile(GRID)
    assert UntouchedFrame.of(own, [tmp_path / "background.png"]) == UntouchedFrame(own)
