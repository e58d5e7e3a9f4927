# SPDX-License-Identifier: Apache-2.0
"""Images that a command holds: one decoding each while there is room, and nobody writes to them."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.files import kept_images
from taccel_lab.files.kept_images import KeptImages


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often each file is decoded."""
    counts: Counter[str] = Counter()
    real = kept_images.read_image

    def counted(path: Path) -> Any:
        counts[path.name] += 1
        return real(path)

    monkeypatch.setattr(kept_images, "read_image", counted)
    return counts


def test_images_are_decoded_once_while_there_is_room(tmp_path: Path, decoded: Counter[str]) -> None:
    paths = [tmp_path / f"{i}.png" for i in range(3)]
    for i, path in enumerate(paths):
        cv2.imwrite(str(path), np.full((10, 20, 3), 40 * i, np.uint8))
    images = KeptImages(limit_bytes=2 * 10 * 20 * 3)
    for _ in range(4):
        found = [images.read(path) for path in paths]
    assert [int(image.mean()) for image in found] == [0, 40, 80]
    assert decoded == {"0.png": 1, "1.png": 1, "2.png": 4}
    with pytest.raises(ValueError, match="read-only"):
        found[0][:] = 1
