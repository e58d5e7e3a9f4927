# SPDX-License-Identifier: Apache-2.0
"""The page on which a person looks over the contacts that were found, and the file to correct."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.capture.overrides import CONTACTS_NAME, override_text
from taccel_lab.calibration.contacts.review import Review, ReviewedPress
from taccel_lab.calibration.result import judge
from taccel_lab.output import write_image, write_json
from taccel_lab.output_folder import atomic_directory
from taccel_lab.report.build import data_url, report_environment

PICTURE_PX = 480
FOUND_RGB = (255, 255, 255)
LABEL_RGB = (255, 190, 40)
CHANGE_GAIN = 1.5


def write_review(review: Review, folder: Path | str) -> None:
    """Write ``review.html``, ``review.json``, ``contacts.toml`` and a picture a press.

    Raises:
        InputError: The folder holds files that taccel-lab did not write.
    """
    by_name = {press.name: press for press in review.captures.presses}
    with atomic_directory(folder) as staging:
        images = {}
        for k, press in enumerate(review.presses):
            path = staging / f"{k:03d}.jpg"
            image = press_picture(by_name[press.name].image(), review.captures, press)
            write_image(path, image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
            images[press.name] = data_url(path).replace("image/png", "image/jpeg")
        html = (
            report_environment("taccel_lab.calibration.report")
            .get_template("review.html.j2")
            .render(review=review, verdict=judge(review.remarks), images=images)
        )
        (staging / "review.html").write_text(html, encoding="utf-8", errors="backslashreplace")
        write_json(staging / "review.json", _with_remarks(review))
        (staging / CONTACTS_NAME).write_text(_contacts_file(review), encoding="utf-8")


def _with_remarks(review: Review) -> dict[str, Any]:
    remarks = [
        {"severity": r.severity, "code": r.code, "message": r.message} for r in review.remarks
    ]
    return {"verdict": judge(review.remarks), "remarks": remarks, **review.figures()}


def _contacts_file(review: Review) -> str:
    entries = []
    for press in review.presses:
        circle = None if press.found is None else press.found.circle
        note = press.reason or f"confidence {press.confidence:.2f}"
        entries.append((press.name, circle, note))
    return override_text(review.captures.source, entries)


def press_picture(image: np.ndarray, captures: CaptureSet, press: ReviewedPress) -> np.ndarray:
    """Frame and colour change side by side with the circles, RGB uint8.

    The found circle is white, a given one amber.
    """
    change = np.clip(
        128 + CHANGE_GAIN * (image.astype(np.float32) - captures.background), 0, 255
    ).astype(np.uint8)
    change[~captures.mask] = 128
    ratio = captures.grid.mm_per_px_y / captures.grid.mm_per_px_x
    zoom = PICTURE_PX / max(image.shape[1], image.shape[0] * ratio)
    size = (max(1, round(image.shape[1] * zoom)), max(1, round(image.shape[0] * zoom * ratio)))
    filter_ = cv2.INTER_AREA if zoom < 1 else cv2.INTER_LINEAR
    panels = []
    for picture in (image, change):
        panel = cv2.resize(np.ascontiguousarray(picture), size, interpolation=filter_)
        if press.given is not None:
            _draw(panel, press.given, zoom, ratio, LABEL_RGB)
        if press.found is not None and not press.checked:
            _draw(panel, press.found.circle, zoom, ratio, FOUND_RGB)
        panels.append(panel)
    gap = np.full((size[1], 6, 3), 255, np.uint8)
    return np.hstack([panels[0], gap, panels[1]])


def _draw(
    panel: np.ndarray, circle: ContactCircle, zoom: float, ratio: float, rgb: tuple[int, int, int]
) -> None:
    at = (circle.u_px + 0.5) * zoom - 0.5, (circle.v_px + 0.5) * zoom * ratio - 0.5
    fixed = tuple(round(16 * float(x)) for x in at)
    for color, width in (((0, 0, 0), 4), (rgb, 2)):
        cv2.circle(
            panel, (fixed[0], fixed[1]), round(16 * circle.radius_px * zoom), color, width, 16, 4
        )
