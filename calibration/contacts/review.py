# SPDX-License-Identifier: Apache-2.0
"""What a person should know of the contacts that were found, worst first."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.capture.overrides import CONTACTS_NAME
from taccel_lab.calibration.contacts.ball_radius import BallCheck, check_ball
from taccel_lab.calibration.contacts.fit import find_contacts
from taccel_lab.calibration.contacts.labels import LabelAgreement, compare_with_labels
from taccel_lab.calibration.contacts.remarks import PRESSES_LEFT_OUT
from taccel_lab.calibration.contacts.result import DetectedContact, FoundContacts
from taccel_lab.calibration.light.drift import drift_remarks
from taccel_lab.calibration.shared_remarks import LABELS_OFF
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark

LOW_CONFIDENCE = 0.6
SHIFT_PX = 1.5
"""Common shift of all labels against the found circles that is worth a remark."""
OFF_SIGMAS = 4.0


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


def review_contacts(captures: CaptureSet, progress: Progress = silent) -> Review:
    """Find the contacts of all presses and judge them."""
    found = find_contacts(captures, progress)
    agreement = compare_with_labels(captures, found.contacts)
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
        refused = [found.refusals[i] for i in sorted(found.refusals)[:8]]
        remarks.append(
            PRESSES_LEFT_OUT(
                lost=len(found.refusals),
                count=len(captures.presses),
                names=", ".join(refusal.name for refusal in refused),
                reasons=refused[0].message,
                advice=f" The {CONTACTS_NAME} written here leaves them out",
            )
        )
    if agreement is not None and np.hypot(agreement.shift_u_px, agreement.shift_v_px) > SHIFT_PX:
        how = (
            f"all lie to one side of the found ones, by ({-agreement.shift_u_px:+.1f}, "
            f"{-agreement.shift_v_px:+.1f}) px at the median; without that shift they differ by "
            f"{agreement.center_median_shifted_px:.1f} px"
        )
        advice = "Check how they were made, or use the found ones"
        count = agreement.count
        figures = {"off": count, "count": count, "how": how, "advice": advice}
        remarks.append(LABELS_OFF(what="given circles", **figures))
    if ball is not None:
        remarks += ball.remarks()
    drifts = [found.drifts[i] for i in sorted(found.drifts)]
    if len(drifts) > 1:
        remarks += drift_remarks(drifts, captures.background)
    return tuple(remarks)
