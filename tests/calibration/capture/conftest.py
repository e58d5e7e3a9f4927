# SPDX-License-Identifier: Apache-2.0
"""Contacts are found once for each picture: most tests spoil a few frames of the same captures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.check import frames
from taccel_lab.errors import InputError


@pytest.fixture(scope="session", autouse=True)
def remembered_contacts() -> Iterator[None]:
    detect, known = frames.detect_contact, {}

    def remembered(image: np.ndarray, background: np.ndarray, *args: Any, **options: Any) -> Any:
        key = (image.tobytes(), background.tobytes(), args)
        if key not in known:
            try:
                known[key] = detect(image, background, *args, **options)
            except InputError as error:
                known[key] = error
        if isinstance(known[key], InputError):
            raise known[key]
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frames, "detect_contact", remembered)
        yield
