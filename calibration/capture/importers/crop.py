# SPDX-License-Identifier: Apache-2.0
"""All pictures of a draft cut, turned and recoloured alike, as a recipe says."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.calibration.capture.importers.draft import Draft, is_picture
from taccel_lab.errors import InputError
from taccel_lab.files.images import Image, levels

MIN_SIZE_PX = 32
_PART = re.compile(r"^([0-9]{1,6}),([0-9]{1,6}),([0-9]{1,6})x([0-9]{1,6})$")

Part = tuple[int, int, int, int]
"""Left, top, width and height [px]."""


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
        raise InputError(f"{place}: crop {text!r}; LEFT,TOP,WIDTHxHEIGHT in pixels is allowed")
    left, top, wide, high = (int(group) for group in match.groups())
    if left + wide > width or top + high > height or min(wide, high) < MIN_SIZE_PX:
        raise InputError(
            f"{place}: crop {text!r} is no part of pictures of {width}x{height} px, or smaller "
            f"than {MIN_SIZE_PX}x{MIN_SIZE_PX} px"
        )
    return left, top, wide, high


def _shift_circle(press: dict[str, object], part: Part) -> bool:
    """Move the circle of a press into the part; False when it is cut there."""
    circle = press.get("contact")
    if not isinstance(circle, dict):
        return True
    left, top, wide, high = part
    circle["u_px"], circle["v_px"] = circle["u_px"] - left, circle["v_px"] - top
    u, v, radius = circle["u_px"], circle["v_px"], circle["radius_px"]
    return u - radius >= 0 and v - radius >= 0 and u + radius < wide and v + radius < high
