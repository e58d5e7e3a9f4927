# SPDX-License-Identifier: Apache-2.0
"""The part of a camera's frames that is kept, and the size that it is brought to.

Some sensors are used with a part of their camera's image, made smaller: the GelSight Mini's camera
gives 8 megapixels with the housing round the gel, everybody works with 320x240 px of the gel.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import cv2
import numpy as np

from taccel_lab.errors import InputError

_PART = re.compile(r"^([0-9]{1,6}),([0-9]{1,6}),([0-9]{1,6})x([0-9]{1,6})$")
_SIZE = re.compile(r"^([0-9]{1,6})x([0-9]{1,6})$")
SQUARE = 0.02
"""How unevenly rows and columns may be made smaller: pixels would no longer be square."""


def parse_size(text: str, option: str) -> tuple[int, int]:
    """``320x240`` as width and height [px]; InputError names ``option``."""
    found = _SIZE.match(text)
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if min(size) < 32:
        raise InputError(
            f"{option} is {text!r}; WIDTHxHEIGHT is allowed, at least 32x32, as 640x480"
        )
    return size


@dataclass(frozen=True)
class Framing:
    """Cut, then make smaller; neither when None."""

    part: tuple[int, int, int, int] | None = None
    """Left, top, width and height [px]."""
    size_px: tuple[int, int] | None = None
    """Width and height afterwards."""

    @classmethod
    def parse(cls, crop: str | None, resize: str | None) -> Framing:
        """Reads ``LEFT,TOP,WIDTHxHEIGHT`` and ``WIDTHxHEIGHT``; InputError for anything else."""
        part = None
        if crop is not None:
            found = _PART.match(crop)
            if found is None:
                raise InputError(f"--crop is {crop!r}; LEFT,TOP,WIDTHxHEIGHT in pixels is allowed")
            left, top, width, height = (int(value) for value in found.groups())
            part = (left, top, width, height)
        return cls(part, None if resize is None else parse_size(resize, "--resize"))

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The image as it is kept, RGB uint8; InputError where it has no such part."""
        if self.part is not None:
            left, top, width, height = self.part
            if left + width > image.shape[1] or top + height > image.shape[0]:
                raise InputError(
                    f"--crop reaches to ({left + width}, {top + height}) px; the camera's images "
                    f"have {image.shape[1]}x{image.shape[0]}"
                )
            image = image[top : top + height, left : left + width]
        if self.size_px is None or self.size_px == image.shape[1::-1]:
            return np.ascontiguousarray(image)
        ratios = [have / want for have, want in zip(image.shape[1::-1], self.size_px, strict=True)]
        if min(ratios) < 1 or abs(ratios[0] / ratios[1] - 1) > SQUARE:
            raise InputError(
                f"--resize to {self.size_px[0]}x{self.size_px[1]} px does not fit images of "
                f"{image.shape[1]}x{image.shape[0]}: they are made smaller only, both sides alike; "
                "cut them with --crop first"
            )
        return cv2.resize(image, self.size_px, interpolation=cv2.INTER_AREA)

    def __str__(self) -> str:
        words = []
        if self.part is not None:
            left, top, width, height = self.part
            words.append(f"the part {left},{top},{width}x{height}")
        if self.size_px is not None:
            words.append("made smaller to {}x{} px".format(*self.size_px))
        return ", ".join(words) or "whole images"
