# SPDX-License-Identifier: Apache-2.0
"""Pictures that are wrong as files: each fault is named, and sound ones are left alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.capture.captures import CapturedPress, Frame
from taccel_lab.calibration.check import check_captures
from taccel_lab.files.images import read_image
from taccel_lab.report.remark import Severity
from tests.support.capture_sets import CaptureMaker, spread_circles
from tests.support.real_data import real_data

Spoil = Callable[[np.ndarray], np.ndarray]
CODES = {
    "channel_dead", "channels_equal", "levels_missing", "enlarged", "sides_exchanged", "tone_curve",
    "lamps_reversed",
}  # fmt: skip


def green_dead(image: np.ndarray) -> np.ndarray:
    return image * np.array([1, 0, 1], np.uint8)


def green_for_blue(image: np.ndarray) -> np.ndarray:
    return image[..., [0, 1, 1]]


def saved_grey(image: np.ndarray) -> np.ndarray:
    return np.repeat(image.mean(axis=-1, keepdims=True).round().astype(np.uint8), 3, axis=-1)


def of_16_levels(image: np.ndarray) -> np.ndarray:
    return image // 16 * 16 + 8


def enlarged(image: np.ndarray, how: int = cv2.INTER_LINEAR) -> np.ndarray:
    height, width = image.shape[:2]
    small = cv2.resize(image, (width // 4, height // 4), interpolation=cv2.INTER_AREA)
    return cv2.resize(small, (width, height), interpolation=how)


def brightened(image: np.ndarray) -> np.ndarray:
    """Shadows lifted, as a gamma of 0.5 does."""
    return np.rint(np.sqrt(255.0 * image)).astype(np.uint8)


def local_contrast(image: np.ndarray) -> np.ndarray:
    """Brightness spread out by what is near, as programs for HDR do."""
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB)
    lab[..., 0] = cv2.createCLAHE(3.0, (8, 8)).apply(np.ascontiguousarray(lab[..., 0]))
    return cv2.cvtColor(lab, cv2.COLOR_LAB2RGB)


def mirrored(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image[:, ::-1])


def turned(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image[::-1, ::-1])


WHOLE: dict[str, tuple[Spoil, str]] = {
    "dead": (green_dead, "channel_dead"),
    "copied": (green_for_blue, "channels_equal"),
    "levels": (of_16_levels, "levels_missing"),
    "linear": (enlarged, "enlarged"),
    "nearest": (partial(enlarged, how=cv2.INTER_NEAREST), "enlarged"),
}
TONED: dict[str, tuple[Spoil, str]] = {
    "gamma": (brightened, "tone_curve"),
    "contrast": (local_contrast, "tone_curve"),
}
ONE = {
    **WHOLE,
    **TONED,
    "grey": (saved_grey, "channels_equal"),
    "turned": (turned, "sides_exchanged"),
}


def spoilt(folder: CaptureFolder, how: Spoil, which: slice, background: bool) -> CaptureFolder:
    def wrong(one: Frame) -> Callable[[], np.ndarray]:
        return lambda: how(one.read())

    def changed(one: CapturedPress) -> CapturedPress:
        return replace(one, read=wrong(one), sha256=one.sha256[::-1])

    picked = {one.name for one in folder.presses[which]}
    presses = tuple(changed(one) if one.name in picked else one for one in folder.presses)
    known = folder.background
    if known is not None and background:
        known = replace(known, read=wrong(known))
    return replace(folder, presses=presses, background=known)


def said(folder: CaptureFolder) -> dict[str, tuple[Severity, tuple[str, ...]]]:
    found = check_captures(folder, fit_ball=False).findings
    return {one.code: (one.severity, one.frames) for one in found if one.code in CODES}


@pytest.mark.thorough
@pytest.mark.parametrize("fault", WHOLE)
def test_a_whole_set_is_refused(tmp_path: Path, fault: str) -> None:
    how, code = WHOLE[fault]
    folder = CaptureMaker(spread_circles(4)).load(tmp_path)
    assert said(spoilt(folder, how, slice(None), background=True))[code][0] == Severity.ERROR


@pytest.mark.thorough
@pytest.mark.parametrize("fault", ONE)
def test_one_press_is_named_alone(tmp_path: Path, fault: str) -> None:
    how, code = ONE[fault]
    folder = CaptureMaker(spread_circles(4)).load(tmp_path)
    found = said(spoilt(folder, how, slice(1, 2), background=False))
    assert found == {code: (Severity.WARNING, ("p01",))}


def test_sound_and_honestly_grey_pictures_pass(tmp_path: Path) -> None:
    folder = CaptureMaker(spread_circles(4)).load(tmp_path)
    assert not said(folder)
    assert not said(spoilt(folder, saved_grey, slice(None), background=True))


SETS = {
    "fots_calib/mlp_calib/gelsight/*.png": ("fots_calib/mlp_calib/0000.png", "flat_pad"),
    "gelsight_rvsathu_sim2real/calib_*.png": (
        "gelsight_rvsathu_sim2real/background_real.png", "flat_pad",
    ),
    "fots_calib/mlp_calib/digit/*.png": ("fots_calib/assets/gel/digit_bg.png", "digit"),
    "gelslim_mcubelab/updated_calib/sample_*.jpg": (
        "gelslim_mcubelab/updated_calib/ref.jpg", "flat_pad",
    ),
    "gsmini_ruihangao_calib/calib_ball/frame_*.jpg": (None, "gelsight_mini"),
}  # fmt: skip
FAST = 2


def real_folder(pattern: str, root: Path) -> CaptureFolder:
    """Four presses of a set without labels; the median stands for a background that it lacks."""
    background, sensor = SETS[pattern]
    place = real_data(str(Path(pattern).parent))
    paths = [path for path in sorted(place.glob(Path(pattern).name)) if path.stem != "frame_0"]
    if background is None:
        image = np.median([read_image(path) for path in paths[::2]], axis=0).astype(np.uint8)
    else:
        image = read_image(real_data(background))
    picked = paths[:: max(1, len(paths) // 4)][:4]
    return CaptureFolder(
        source=pattern, root=root, sensor=sensor, unit=None, untouched=(), mask=None,
        background=Frame("background", pattern, "0" * 64, partial(np.copy, image)),
        mm_per_px=None, ball_radius_mm=None,
        presses=tuple(
            CapturedPress(path.stem, str(path), f"{k:064}", partial(read_image, path))
            for k, path in enumerate(picked)
        ),
    )  # fmt: skip


@pytest.mark.parametrize("pattern", [
    pytest.param(pattern, marks=pytest.mark.thorough if k < FAST else pytest.mark.slow)
    for k, pattern in enumerate(SETS)
])  # fmt: skip
def test_real_sets(tmp_path: Path, pattern: str) -> None:
    folder = real_folder(pattern, tmp_path)
    assert not said(folder)
    for how, code in WHOLE.values():
        found = said(spoilt(folder, how, slice(None), background=True))
        assert found[code][0] == Severity.ERROR
    for how, code in TONED.values():
        # A set that is toned as a whole is learnt and read so.
        assert code not in said(spoilt(folder, how, slice(None), background=True))
        found = said(spoilt(folder, how, slice(2, 3), background=False))
        assert found[code] == (Severity.WARNING, (folder.presses[2].name,))
    reversed_lamps = said(spoilt(folder, mirrored, slice(None), background=True))
    assert ("lamps_reversed" in reversed_lamps) == (folder.sensor != "flat_pad")
