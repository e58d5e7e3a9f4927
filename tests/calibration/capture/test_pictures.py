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
from taccel_lab.report.remark import Severity
from tests.support.capture_sets import CaptureMaker, spread_circles
from tests.support.real_data import labelled_presses

Spoil = Callable[[np.ndarray], np.ndarray]
CODES = {"channel_dead", "channels_equal", "levels_missing", "enlarged", "sides_exchanged"}


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


def turned(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image[::-1, ::-1])


WHOLE: dict[str, tuple[Spoil, str]] = {
    "dead": (green_dead, "channel_dead"),
    "copied": (green_for_blue, "channels_equal"),
    "levels": (of_16_levels, "levels_missing"),
    "linear": (enlarged, "enlarged"),
    "nearest": (partial(enlarged, how=cv2.INTER_NEAREST), "enlarged"),
}
ONE = {**WHOLE, "grey": (saved_grey, "channels_equal"), "turned": (turned, "sides_exchanged")}


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


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "labels", "background"),
    [
        ("fots_calib", "labels_gelsight.csv", "mlp_calib/0000.png"),
        ("gelsight_rvsathu_sim2real", "labels/calib_labels.csv", "background_real.png"),
    ],
)
def test_real_presses(tmp_path: Path, name: str, labels: str, background: str) -> None:
    captures = labelled_presses(name, labels, background, 2.92, 0.05926)
    folder = CaptureFolder(
        source=name, root=tmp_path, sensor="flat_pad", unit=None, untouched=(), mask=None,
        background=Frame("background", name, "0" * 64, partial(np.copy, captures.background)),
        mm_per_px=None, ball_radius_mm=2.92, presses=captures.presses[:4],
    )  # fmt: skip
    assert not said(folder)
    for how, code in WHOLE.values():
        assert code in said(spoilt(folder, how, slice(None), background=True))
