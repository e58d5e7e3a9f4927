# SPDX-License-Identifier: Apache-2.0
"""Captures whose background is framed otherwise than the presses: both cut to what both show.

Pixels of the presses keep their size, and with it the scale in mm per pixel: the image of the wider
framing is cut, and where that is the presses', the background is made smaller to fit.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from taccel_lab.calibration.capture.framing import (
    CROP_GAIN,
    OTHER_FRAMING_LEVELS,
    find_crop,
    misfit_levels,
    thumb,
)
from taccel_lab.calibration.capture.importers.draft import Draft, is_picture
from taccel_lab.errors import InputError
from taccel_lab.files.images import Image, levels

AUTO_CROP = "auto"
MIN_PRESSES = 3
FINE_PX = 320
MIN_SIZE_PX = 32
_PART = re.compile(r"^([0-9]{1,6}),([0-9]{1,6}),([0-9]{1,6})x([0-9]{1,6})$")

Part = tuple[int, int, int, int]
"""Left, top, width and height [px]."""


def crop_draft(draft: Draft, text: str) -> None:
    """Cut the presses, or the background, of ``draft`` to the part that the other shows.

    ``text`` is ``LEFT,TOP,WIDTHxHEIGHT``, the part of the presses that the background shows, or
    ``auto``: the part is found by comparing the background with the median of the presses. Contact
    circles move along; those that are cut are left out, with their presses.

    Raises:
        InputError: No background or presses, a part that is not one, or none that fits.
    """
    name = draft.manifest.get("background")
    presses = draft.manifest.get("presses", [])
    if name is None or not presses:
        raise InputError(f"{draft.place}: crop needs a background and presses")
    background = levels(draft.files[name])
    height, width = levels(draft.files[presses[0]["image"]]).shape[:2]
    if text == AUTO_CROP:
        part, of_presses = _find(draft, background)
    else:
        part, of_presses = _parse(text, width, height, draft.place), True
    left, top, wide, high = part
    window = slice(top, top + high), slice(left, left + wide)

    def of_background(image: np.ndarray, interpolation: int = cv2.INTER_AREA) -> np.ndarray:
        """An image framed as the background is, as the presses will be."""
        if of_presses:
            return cv2.resize(image, (wide, high), interpolation=interpolation)
        return cv2.resize(image[window], (width, height), interpolation=interpolation)

    draft.files[name] = of_background(background)
    for image in draft.manifest.get("untouched", []):
        # Cut when it is written: a folder of large pictures is never held whole.
        draft.files[image] = lambda picture=draft.files[image]: of_background(levels(picture))
    mask = draft.manifest.get("mask")
    if mask is not None:
        drawn = levels(draft.files[mask])
        if drawn.shape[:2] != (height, width):
            draft.files[mask] = of_background(drawn, cv2.INTER_NEAREST)
        elif of_presses:
            draft.files[mask] = np.ascontiguousarray(drawn[window])
    if not of_presses:
        draft.notes.append(
            f"the background is the part {wide}x{high} px of it from ({left}, {top}) px, which the "
            "presses show"
        )
        return
    for image in {press["image"] for press in presses}:
        whole = draft.files[image]
        draft.files[image] = partial(_cut, whole, part, width, height)
    draft.notes.append(
        f"the presses are cut to the part {wide}x{high} px from ({left}, {top}) px, which the "
        "background shows; the background is made smaller to fit, mm per pixel are as before"
    )
    _move_circles(draft, part)


def change_pictures(draft: Draft, part: str | None, turn_deg: int, swap: bool) -> None:
    """Cut, turn and recolour all pictures of ``draft`` alike; circles and lines go along.

    ``part``: ``LEFT,TOP,WIDTHxHEIGHT`` [px]; ``turn_deg``: against the clock; ``swap``: red and
    blue stand in each other's place. Raises InputError for a part that is none.
    """
    quarters = turn_deg // 90
    pictures = [n for n, c in draft.files.items() if not isinstance(c, str) and is_picture(n)]
    if not pictures:
        return
    height, width = levels(draft.files[pictures[0]]).shape[:2]
    whole = (0, 0, width, height)
    cut_to = whole if part is None else _parse(part, width, height, draft.place)
    left, top, wide, high = cut_to

    def changed(picture: Image | str) -> np.ndarray:
        cut = _cut(picture, cut_to, width, height)
        return np.ascontiguousarray(np.rot90(cut[..., :: -1 if swap else 1], quarters))

    names = {
        name: draft.replace_image(name, partial(changed, draft.files[name])) for name in pictures
    }
    draft.manifest = _renamed(draft.manifest, names)
    _move_circles(draft, cut_to)
    marks = [entry.get("contact") for entry in draft.manifest.get("presses", [])]
    marks += [entry.get("line") for entry in draft.manifest.get("edges", [])]
    for mark in filter(None, marks):
        if "angle_deg" in mark:
            mark["u_px"], mark["v_px"] = mark["u_px"] - left, mark["v_px"] - top
            mark["angle_deg"] -= turn_deg
        across = wide
        for _ in range(quarters):
            mark["u_px"], mark["v_px"] = mark["v_px"], across - 1 - mark["u_px"]
            across = wide + high - across
    draft.notes.append(
        f"all pictures are the part {wide}x{high} px from ({left}, {top}) px of the files, turned "
        f"by {turn_deg} degrees{', red and blue exchanged' if swap else ''}, as the recipe says"
    )


def _renamed(value: Any, names: dict[str, str]) -> Any:
    """A manifest in which files are called otherwise."""
    if isinstance(value, dict):
        return {key: _renamed(inner, names) for key, inner in value.items()}
    if isinstance(value, list):
        return [_renamed(inner, names) for inner in value]
    return names.get(value, value) if isinstance(value, str) else value


def _move_circles(draft: Draft, part: Part) -> None:
    """Move the presses' circles into the part; presses whose circle it cuts are left out."""
    presses = draft.manifest.get("presses", [])
    lost = [press["image"] for press in presses if not _shift_circle(press, part)]
    for image in lost:
        del draft.files[image]
    if lost:
        draft.manifest["presses"] = [press for press in presses if press["image"] not in lost]
        draft.notes.append(f"left out, since the contact is cut: {', '.join(lost)}")


def _cut(picture: Image | str, part: Part, width: int, height: int) -> np.ndarray:
    """The part of a picture; InputError for one that is of another size than its like."""
    image, (left, top, wide, high) = levels(picture), part
    if image.shape[:2] != (height, width):
        raise InputError(
            f"{picture} is {image.shape[1]}x{image.shape[0]} px, others that are cut are "
            f"{width}x{height} px"
        )
    return image[top : top + high, left : left + wide]


def _parse(text: str, width: int, height: int, place: Path) -> Part:
    match = _PART.match(text.replace(" ", ""))
    if match is None:
        raise InputError(
            f"{place}: crop {text!r}; LEFT,TOP,WIDTHxHEIGHT in pixels or auto is allowed"
        )
    left, top, wide, high = (int(group) for group in match.groups())
    if left + wide > width or top + high > height or min(wide, high) < MIN_SIZE_PX:
        raise InputError(
            f"{place}: crop {text!r} is no part of pictures of {width}x{height} px, or smaller "
            f"than {MIN_SIZE_PX}x{MIN_SIZE_PX} px"
        )
    return left, top, wide, high


def _find(draft: Draft, background: np.ndarray) -> tuple[Part, bool]:
    """The part that one framing shows of the other, and whether it is one of the presses."""
    if len(draft.manifest["presses"]) < MIN_PRESSES:
        raise InputError(
            f"{draft.place}: crop auto needs {MIN_PRESSES} presses for their median; give the "
            "part as LEFT,TOP,WIDTHxHEIGHT"
        )
    median = draft.median_of_presses()
    height, width = median.shape[:2]
    own = background.shape[1], background.shape[0]
    small = cv2.resize(background, (width, height), interpolation=cv2.INTER_AREA)
    fine = thumb(small, FINE_PX), thumb(median, FINE_PX)
    misfit = misfit_levels(fine[0], fine[1])
    inner, outer = find_crop(*fine), find_crop(*fine[::-1])
    best = min(inner, outer, key=lambda crop: crop.misfit_levels)
    if misfit < OTHER_FRAMING_LEVELS or best.misfit_levels * CROP_GAIN > misfit:
        raise InputError(
            f"{draft.place}: crop auto found no part that fits {CROP_GAIN:g} times better than "
            f"the whole, which is {misfit:.1f} levels apart (the part {best.misfit_levels:.1f}); "
            "leave --crop away, or give the part as LEFT,TOP,WIDTHxHEIGHT"
        )
    return best.in_pixels(*((width, height) if best is inner else own)), best is inner


def _shift_circle(press: dict[str, object], part: Part) -> bool:
    """Move the circle of a press into the part; False when it is cut there."""
    circle = press.get("contact")
    if not isinstance(circle, dict):
        return True
    left, top, wide, high = part
    circle["u_px"], circle["v_px"] = circle["u_px"] - left, circle["v_px"] - top
    u, v, radius = circle["u_px"], circle["v_px"], circle["radius_px"]
    return u - radius >= 0 and v - radius >= 0 and u + radius < wide and v + radius < high
