# SPDX-License-Identifier: Apache-2.0
"""Frames of a refit: held-out presses are chosen before an image is read and place no other."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet, Press
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.refit.fit import calibrate_refit
from taccel_lab.calibration.refit.frames import NewFrames, refit_frames
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from tests.calibration.refit.test_refit import old_profile
from tests.support.synthetic_presses import BALL_RADIUS_MM, synthetic_captures

COUNT = 9


@pytest.fixture(scope="module")
def captures() -> CaptureSet:
    found, _ = synthetic_captures(COUNT)
    return found


@pytest.fixture(scope="module")
def profile(captures: CaptureSet) -> SensorProfile:
    # The colours of the presses are none of its model's: only circles and surfaces matter here.
    old = old_profile()
    assert old.background is not None
    return old.with_block(old.background, captures.background.astype(np.float32))


def folder_of(captures: CaptureSet, stated: tuple[str, ...] | None = None) -> CaptureFolder:
    return CaptureFolder(
        source="memory", root=Path("memory"), sensor="gelsight", unit=None, background=None,
        untouched=(), mask=None, mm_per_px=None, ball_radius_mm=BALL_RADIUS_MM,
        presses=captures.presses, heldout=stated,
    )  # fmt: skip


def names(frames: NewFrames) -> tuple[set[str], set[str]]:
    return {f.name for f in frames.fitted}, {f.name for f in frames.heldout}


def spoilt(press: Press) -> Press:
    """The press seen elsewhere, with another radius."""
    image = np.roll(press.image(), (7, -9), axis=(0, 1))
    return replace(press, read=partial(np.copy, image))


def test_presses_are_split_as_everywhere(captures: CaptureSet, profile: SensorProfile) -> None:
    folder = folder_of(captures)
    split = folder.split()
    fitted, heldout = names(refit_frames(profile, folder))
    assert heldout == set(split.heldout_names) and len(heldout) == COUNT // 4
    assert fitted == {press.name for press in captures.presses} - heldout


def test_what_the_manifest_holds_out_is_held_out(
    captures: CaptureSet, profile: SensorProfile
) -> None:
    few = replace(captures, presses=captures.presses[:3])
    assert names(refit_frames(profile, folder_of(few, ("p1",)))) == ({"p0", "p2"}, {"p1"})
    assert names(refit_frames(profile, folder_of(few))) == ({"p0", "p1", "p2"}, set())


def test_held_out_images_place_no_other_press(captures: CaptureSet, profile: SensorProfile) -> None:
    folder = folder_of(captures)
    heldout = folder.split().heldout
    presses = tuple(spoilt(p) if i in heldout else p for i, p in enumerate(captures.presses))
    clean, dirty = (
        refit_frames(profile, f) for f in (folder, folder_of(replace(captures, presses=presses)))
    )
    for before, after in zip(clean.fitted, dirty.fitted, strict=True):
        assert before.disc is not None and after.disc is not None
        assert before.change is not None and after.change is not None
        assert np.array_equal(before.disc, after.disc)
        assert np.array_equal(before.change, after.change)
    # Labels place held-out presses, so that theirs do not move either.
    for before, after in zip(clean.heldout, dirty.heldout, strict=True):
        assert before.disc is not None and after.disc is not None
        assert np.array_equal(before.disc, after.disc)
        assert not np.array_equal(before.image, after.image)


def test_a_held_out_press_without_a_label_is_found_in_its_own_image(
    captures: CaptureSet, profile: SensorProfile
) -> None:
    bare = replace(captures, presses=tuple(replace(p, circle=None) for p in captures.presses))
    found = refit_frames(profile, folder_of(bare, ("p4",)))
    (frame,) = found.heldout
    circle = captures.presses[4].circle
    assert circle is not None and frame.disc is not None
    truth = circle.distance_px(captures.grid) <= circle.radius_px
    assert (frame.disc & truth).sum() > 0.85 * (frame.disc | truth).sum()


def test_captures_of_another_sensor_and_profiles_without_a_background_are_refused(
    captures: CaptureSet, profile: SensorProfile
) -> None:
    folder = folder_of(captures)
    with pytest.raises(InputError, match="captures are of a digit, the profile is of a"):
        calibrate_refit(replace(folder, sensor="digit"), profile)
    with pytest.raises(InputError, match="nothing to refit"):
        calibrate_refit(folder, profile.without("background"))
