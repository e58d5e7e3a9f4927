# SPDX-License-Identifier: Apache-2.0
"""What the check of captures does with a frame, once for all tests that show it the same one."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.check.balls import check_slopes
from taccel_lab.calibration.circles import contact_finder
from taccel_lab.calibration.circles.contact_finder import detect_contact


def detect_once(patch: pytest.MonkeyPatch) -> None:
    """The contact of equal images before equal backgrounds, and where a common search starts."""
    known: dict[str, Any] = {}
    starts: dict[str, Any] = {}
    first = contact_finder._first

    def detected(*given: Any, name: str, **named: Any) -> Any:
        # The name is a path, which is another in every test.
        find = partial(detect_contact, *given, name=name, **named)
        return _remembered(known, (given, named), find)

    def started(read: Callable[[], np.ndarray], scene: Any, name: str) -> Any:
        image = read()
        return _remembered(starts, (image, scene.key), lambda: first(lambda: image, scene, name))

    patch.setattr("taccel_lab.calibration.circles.contact_finder.detect_contact", detected)
    patch.setattr(contact_finder, "_first", started)


def judge_slopes_once(patch: pytest.MonkeyPatch) -> None:
    """Equal presses, by the hashes of their files, are held against a ball once."""
    known: dict[str, Any] = {}

    def judged(folder: CaptureFolder, background: np.ndarray) -> Any:
        presses = [(p.sha256, p.radius_mm, p.depth_mm) for p in folder.presses]
        about = (presses, folder.sensor, folder.mm_per_px, folder.ball_radius_mm, folder.mask)
        return _remembered(known, (about, background), lambda: check_slopes(folder, background))

    patch.setattr("taccel_lab.calibration.check.run.check_slopes", judged)


def _remembered(known: dict[str, Any], about: object, find: Callable[[], Any]) -> Any:
    key = hashlib.sha256(pickle.dumps(about)).hexdigest()
    if key not in known:
        known[key] = find()  # Refusals, which name a file, are made again.
    return known[key]
