# SPDX-License-Identifier: Apache-2.0
"""Contact circles for the commands that fit to ball presses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture import CaptureSet, ContactCircle
    from taccel_lab.calibration.result import Remark

CircleSource = Literal["fused", "labels", "detected"]


def contact_circles(
    captures: CaptureSet, which: CircleSource, console: Console, *, cache: bool = True
) -> tuple[CaptureSet, list[ContactCircle], list[Remark]]:
    """The presses with a contact, their circles, and a remark on presses left out.

    ``captures`` are the training presses: they are explained together. All of them are looked at,
    so that empty frames are told; how far they lie from
    labels is printed. ``labels`` needs a label of every press. With ``cache``, contacts that an
    earlier run or stage found in these images are taken as they are.
    """
    from taccel_lab.calibration.contacts import choose_circles, compare_with_labels, usable_presses

    unlabelled = sum(press.circle is None for press in captures.presses)
    if which == "labels" and unlabelled:
        raise InputError(
            f"{captures.source}: {unlabelled} presses come without a contact circle; --circles "
            "labels needs all of them, fused or detected does not"
        )
    with console.status("finding the contact circles"):
        captures, found, remarks = usable_presses(captures, cache=cache)
    agreement = compare_with_labels(captures, found)
    if agreement is not None:
        console.print(
            f"found circles against {agreement.count} labels, median and 90th percentile: centre "
            f"{agreement.center_median_px:.1f} and {agreement.center_p90_px:.1f} px, radius "
            f"{agreement.radius_median_px:.1f} and {agreement.radius_p90_px:.1f} px",
            highlight=False,
        )
    return captures, choose_circles(captures, found, which), remarks
