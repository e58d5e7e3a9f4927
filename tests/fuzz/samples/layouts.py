# SPDX-License-Identifier: Apache-2.0
"""Folders in the layouts of other projects."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.calibration.capture import made_up_layouts
from tests.fuzz.samples.captures import picture, write_image, write_video

NAMES = tuple(made_up_layouts.MAKERS)


def maker(name: str) -> Callable[[Path], None]:
    """Writes the layout into a folder, always the same."""

    def make(given: Path) -> None:
        made_up_layouts.RNG = np.random.default_rng(0)
        made_up_layouts.MAKERS[name](given)

    return make


def plain_with_mask(given: Path) -> None:
    """Any folder of images, one of which is a mask."""
    maker("plain")(given)
    write_image(given / "mask.png", made_up_layouts.dots_at(0.0)[:48, :64])


def video_of_dots(given: Path) -> None:
    """A folder with a video and nothing else."""
    write_video(given / "shear.avi")


def boards(given: Path) -> None:
    """Pictures that are said to show a board."""
    for number in range(2):
        write_image(given / f"{number}.png", picture(number))
