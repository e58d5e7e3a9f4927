# SPDX-License-Identifier: Apache-2.0
"""Contact circles for the commands that fit to ball presses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture import CaptureSet, ContactCircle
    from taccel_lab.calibration.result import Remark

CircleSource = Literal["fused", "labels", "detected"]


def contact_circles(
    captures: CaptureSet, which: CircleSource, console: Console, *, cache: bool = True
) -> tuple[CaptureSet, list[ContactCircle], list[Remark]]:
    """The presses with a contact, their circles, and a remark on presses left out.

    How far found circles lie from labels is printed.
    """
    from taccel_lab.calibration.contacts.usable import usable_circles

    with console.status("finding the contact circles"):
        found = usable_circles(captures, which, cache=cache)
    agreement = found.agreement
    if agreement is not None:
        console.print(
            f"found circles against {agreement.count} labels, median and 90th percentile: centre "
            f"{agreement.center_median_px:.1f} and {agreement.center_p90_px:.1f} px, radius "
            f"{agreement.radius_median_px:.1f} and {agreement.radius_p90_px:.1f} px",
            highlight=False,
        )
    return found.captures, found.circles, found.remarks
