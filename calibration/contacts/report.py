# SPDX-License-Identifier: Apache-2.0
"""The page on which a person looks over the contacts that were found, and the file to correct."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle, Press
from taccel_lab.calibration.capture.overrides import CONTACTS_NAME, override_text
from taccel_lab.calibration.contacts.review import Review, ReviewedPress
from taccel_lab.report.page import Page, Picture, Table

PICTURE_PX = 480
FOUND_RGB = (255, 255, 255)
LABEL_RGB = (255, 190, 40)
CHANGE_GAIN = 1.5


def review_page(review: Review) -> Page:
    """All presses, worst first, with the file to correct beside them."""
    count, lost = len(review.presses), len(review.found.refusals)
    agreement = review.agreement
    tables = ()
    if agreement is not None:
        tables = (
            Table(
                "Found against given circles",
                ("", "median [px]", "90th percentile [px]"),
                (
                    ("centre", agreement.center_median_px, agreement.center_p90_px),
                    ("radius", agreement.radius_median_px, agreement.radius_p90_px),
                ),
                f"{agreement.count} circles; radii found minus given: "
                f"{agreement.radius_bias_px:+.1f} px.",
            ),
        )
    by_name = {press.name: press for press in review.captures.presses}
    pictures = tuple(
        Picture(
            f"{k:03d}",
            partial(_jpeg, by_name[press.name], review.captures, press),
            _caption(press),
        )
        for k, press in enumerate(review.presses)
    )
    return Page(
        title="Contacts, worst first",
        summary=f"{review.captures.source}: {count} presses, {count - lost} with a contact. Left "
        "the frame, right its difference from the background. White: the circle found; amber: the "
        f"circle given, or corrected. To correct one, edit {CONTACTS_NAME} beside this page and "
        "put it into the capture folder.",
        remarks=review.remarks,
        tables=tables,
        pictures=pictures,
        figures=review.figures(),
        files={CONTACTS_NAME: lambda path: _write_contacts(review, path)},
    )


def _caption(press: ReviewedPress) -> str:
    """Name, how sure the circle is, where it lies, and why to look at it."""
    said = [press.name]
    if press.checked:
        said.append("corrected")
    elif press.found is None:
        said.append("no contact")
    else:
        found, circle = press.found, press.found.circle
        said += [
            f"confidence {press.confidence:.2f}",
            f"centre ({circle.u_px:.1f}, {circle.v_px:.1f}) +- {found.center_sigma_px:.1f} px, "
            f"radius {circle.radius_px:.1f} +- {found.radius_sigma_px:.1f} px",
            f"{found.explained:.0%} explained",
        ]
        if press.given is not None:
            given = press.given
            said.append(f"given ({given.u_px:.1f}, {given.v_px:.1f}), {given.radius_px:.1f} px")
    if press.reason:
        said.append(press.reason)
    return "; ".join(said)


def _jpeg(press: Press, captures: CaptureSet, reviewed: ReviewedPress) -> bytes:
    image = press_picture(press.image(), captures, reviewed)
    quality = [cv2.IMWRITE_JPEG_QUALITY, 90]
    return cv2.imencode(".jpg", image[..., ::-1], quality)[1].tobytes()


def _write_contacts(review: Review, path: Path) -> None:
    path.write_text(_contacts_file(review), encoding="utf-8")


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
