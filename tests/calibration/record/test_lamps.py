# SPDX-License-Identifier: Apache-2.0
"""Lamps at their limits."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.capture.camera.camera import Shot
from taccel_lab.calibration.record.lamps import FROZEN_S, FrozenWatch, saturation_lamp


@pytest.mark.parametrize(("level", "state"), [(253, "ok"), (254, "bad"), (255, "bad")])
def test_a_contact_whose_levels_have_ended_is_told(level: int, state: str) -> None:
    """Of JPEGs 254 is the end, too; one channel suffices, and a part of the contact."""
    image = np.full((48, 64, 3), 120, dtype=np.uint8)
    image[20:28, 24:40, 1] = level
    touched = np.zeros((12, 16), dtype=bool)
    touched[4:9, 5:11] = True
    assert saturation_lamp(image, touched).state == state
    assert saturation_lamp(image, ~touched & (np.arange(16) < 4)).state == "ok"


def test_a_camera_that_hangs_is_told_after_its_clock_was_put_back() -> None:
    watch, image = FrozenWatch(), np.zeros((32, 32, 3), dtype=np.uint8)
    times = [100.0, 101.0, 1.0, 2.0, 1.0 + FROZEN_S]
    said = [watch.see(Shot(image, time_s)) for time_s in times]
    assert said[:4] == [""] * 4 and "hangs" in said[4]
