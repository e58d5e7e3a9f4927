# SPDX-License-Identifier: Apache-2.0
"""The page on which a person looks over the contacts that were found, worst first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.capture.overrides import CONTACTS_NAME, override_text
from taccel_lab.calibration.contacts.agreement import LabelAgreement, compare_with_labels
from taccel_lab.calibration.contacts.ball import (
    DetectedContact,
    FoundContacts,
    Progress,
    find_contacts,
)
from taccel_lab.calibration.contacts.ball_check import BallCheck, check_ball
from taccel_lab.calibration.result import Remark, Severity, judge
from taccel_lab.output import atomic_directory, write_json
from taccel_lab.report.build import data_url, report_environment

LOW_CONFIDENCE = 0.6
SHIFT_PX = 1.5
"""Common shift of all labels against the found circles that is worth a remark."""
OFF_SIGMAS = 4.0
PICTURE_PX = 480
FOUND_RGB = (255, 255, 255)
LABEL_RGB = (255, 190, 40)
CHANGE_GAIN = 1.5
AUTO_BALANCE_LEVELS = 4.0
"""Spread of a channel's drift over the presses, relative to the other channels, above which the
camera's white balance has run free."""


@dataclass(frozen=True)
class ReviewedPress:
    """One press as the page shows it."""

    name: str
    confidence: float
    """0 when no contact was found."""
    found: DetectedContact | None
    given: ContactCircle | None
    checked: bool
    """The given circle is a person's correction."""
    reason: str
    """Why there is none, or why it should be looked at; empty for nothing."""


@dataclass(frozen=True)
class Review:
    """All presses of a capture set, worst first."""

    captures: CaptureSet
    found: FoundContacts
    presses: tuple[ReviewedPress, ...]
    agreement: LabelAgreement | None
    ball: BallCheck | None
    remarks: tuple[Remark, ...]

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        rows = []
        for press in self.presses:
            row: dict[str, Any] = {"name": press.name, "confidence": press.confidence}
            row["reason"] = press.reason
            if press.found is not None:
                row |= {k: v for k, v in asdict(press.found).items() if k != "circle"}
                row |= asdict(press.found.circle)
            if press.given is not None:
                row["given"] = asdict(press.given)
            rows.append(row)
        return {
            "source": self.captures.source,
            "press_count": len(self.presses),
            "refused_count": len(self.found.refusals),
            "agreement": None if self.agreement is None else asdict(self.agreement),
            "ball": None if self.ball is None else asdict(self.ball),
            "presses": rows,
        }


def review_contacts(captures: CaptureSet, progress: Progress | None = None) -> Review:
    """Find the contacts of all presses and judge them."""
    found = find_contacts(captures, progress)
    checked = [contact for contact in found.contacts if contact is not None]
    agreement = None
    if len(checked) == len(captures.presses):
        agreement = compare_with_labels(captures, checked)
    else:
        agreement = _partial_agreement(captures, found)
    ball = check_ball(captures, found)
    presses = []
    for i, press in enumerate(captures.presses):
        contact = found.contacts[i]
        presses.append(
            ReviewedPress(
                name=press.name,
                confidence=0.0 if contact is None else contact.confidence,
                found=contact,
                given=press.circle,
                checked=press.checked,
                reason=found.refusals[i].message
                if contact is None
                else ""
                if press.checked
                else _doubt(contact, press.circle, agreement),
            )
        )
    presses.sort(key=lambda p: (p.confidence, not p.reason))
    return Review(
        captures, found, tuple(presses), agreement, ball, _remarks(captures, found, agreement, ball)
    )


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
            cv2.imwrite(str(path), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
            images[press.name] = data_url(path).replace("image/png", "image/jpeg")
        html = (
            report_environment("taccel_lab.calibration.report")
            .get_template("review.html.j2")
            .render(review=review, verdict=judge(review.remarks), images=images)
        )
        (staging / "review.html").write_text(html, encoding="utf-8")
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


def _partial_agreement(captures: CaptureSet, found: FoundContacts) -> LabelAgreement | None:
    from taccel_lab.calibration.contacts.agreement import agreement

    return agreement(
        [None if press.checked else press.circle for press in captures.presses],
        [None if contact is None else contact.circle for contact in found.contacts],
    )


def _doubt(
    contact: DetectedContact, given: ContactCircle | None, agreement: LabelAgreement | None
) -> str:
    if contact.confidence < LOW_CONFIDENCE:
        return (
            f"uncertain: a ball's slope explains {contact.explained:.0%} of the colour change, "
            f"{contact.visible:.0%} of it can be seen"
        )
    if given is not None and agreement is not None:
        off = np.hypot(
            contact.circle.u_px - given.u_px - agreement.shift_u_px,
            contact.circle.v_px - given.v_px - agreement.shift_v_px,
        )
        if off > OFF_SIGMAS * max(agreement.center_median_shifted_px, 1.0):
            return f"the given circle lies {off:.0f} px from the found one"
    return ""


def _remarks(
    captures: CaptureSet,
    found: FoundContacts,
    agreement: LabelAgreement | None,
    ball: BallCheck | None,
) -> tuple[Remark, ...]:
    remarks = []
    if found.refusals:
        names = ", ".join(found.refusals[i].name for i in sorted(found.refusals)[:8])
        remarks.append(
            Remark(
                Severity.WARNING,
                "presses_refused",
                f"{len(found.refusals)} of {len(captures.presses)} presses show no usable contact: "
                f"{names}; the {CONTACTS_NAME} written here leaves them out",
            )
        )
    if agreement is not None and np.hypot(agreement.shift_u_px, agreement.shift_v_px) > SHIFT_PX:
        remarks.append(
            Remark(
                Severity.WARNING,
                "labels_shifted",
                f"the given circles all lie to one side of the found ones, by "
                f"({-agreement.shift_u_px:+.1f}, {-agreement.shift_v_px:+.1f}) px at the median; "
                f"without that shift they differ by {agreement.center_median_shifted_px:.1f} px. "
                "Check how they were made, or use the found ones",
            )
        )
    if ball is not None:
        remarks.append(ball.remark())
    remarks += _drift_remarks([found.drifts[i] for i in sorted(found.drifts)], captures.background)
    return tuple(remarks)


def _drift_remarks(drifts: Sequence[Any], background: np.ndarray) -> list[Remark]:
    if len(drifts) < 2:
        return []
    from taccel_lab.calibration.light.drift import drift_remark

    return [drift_remark(drifts, background)]
