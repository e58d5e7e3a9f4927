# SPDX-License-Identifier: Apache-2.0
"""The page of a check: verdict, blocks, findings worst first, pictures."""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.overrides import CONTACTS_NAME, override_text
from taccel_lab.calibration.check import drawings
from taccel_lab.calibration.check.frames import FrameFigures
from taccel_lab.calibration.check.presses import label_gaps
from taccel_lab.calibration.check.run import CaptureCheck
from taccel_lab.report.page import Page, Picture, Table

MAX_ROWS = 40


def check_page(check: CaptureCheck) -> Page:
    """Describe the check for ``taccel_lab.calibration.report.write_page``."""
    contents = [f"{n} {name.replace('_', ' ')}" for name, n in check.folder.contents().items() if n]
    state = (
        "Nothing stops what these captures are there for."
        if check.usable
        else "Something here stops a calibration or makes it wrong; see the errors first."
    )
    return Page(
        title=f"Captures of a {check.folder.sensor}",
        summary=f"{check.folder.source}: {', '.join(contents) or 'nothing'}. {state}",
        remarks=check.findings,
        tables=[_blocks(check), *_presses(check)],
        pictures=_pictures(check),
        figures=check.figures(),
        files={CONTACTS_NAME: lambda path: _write_contacts(check, path)} if check.frames else {},
    )


def _write_contacts(check: CaptureCheck, path: Path) -> None:
    """The file with which a person corrects circles; as it is, presses without one are left out."""
    remarks, entries = remarks_by_frame(check), []
    for frame in _worst_first(check):
        said = [code.replace("_", " ") for code in remarks.get(frame.press.name, [])]
        if frame.contact is None:
            entries.append((frame.press.name, None, frame.fault))
        else:
            note = ", ".join([f"confidence {frame.contact.confidence:.2f}", *said])
            entries.append((frame.press.name, frame.contact.circle, note))
    path.write_text(override_text(check.folder.source, entries), encoding="utf-8")


def _worst_first(check: CaptureCheck) -> list[FrameFigures]:
    """Presses without a contact, then by their findings and by how sure the circle is."""
    remarks = remarks_by_frame(check)

    def rank(frame: FrameFigures) -> tuple[bool, int, float]:
        sure = 0.0 if frame.contact is None else frame.contact.confidence
        return frame.contact is not None, -len(remarks.get(frame.press.name, [])), sure

    return sorted(check.frames, key=rank)


def remarks_by_frame(check: CaptureCheck) -> dict[str, list[str]]:
    """Codes of the findings about each image."""
    remarks: dict[str, list[str]] = {}
    for finding in check.findings:
        for name in finding.frames:
            remarks.setdefault(name, []).append(finding.code)
    return remarks


def _blocks(check: CaptureCheck) -> Table:
    return Table(
        "Blocks of a profile",
        ("command", "state", "found", "missing"),
        [
            (
                f"calibrate {block.command}",
                block.readiness.value,
                block.found or None,
                block.missing,
            )
            for block in check.blocks
        ],
        "ready: can be run; weak: runs, and the warnings say why its result will not be good; "
        "blocked: captures are there and something stops the command; absent: no captures for it.",
    )


def _presses(check: CaptureCheck) -> list[Table]:
    if check.grid is None or not check.frames:
        return []
    gaps = {gap.name: gap for gap in label_gaps(check.frames, check.grid)}
    remarks = remarks_by_frame(check)
    rows = []
    for frame in _worst_first(check)[:MAX_ROWS]:
        gap, circle = gaps.get(frame.press.name), frame.circle
        rows.append(
            (
                frame.press.name,
                *((None,) * 3 if circle is None else (circle.u_px, circle.v_px, circle.radius_px)),
                None if frame.contact is None else frame.contact.confidence,
                None if gap is None else gap.center_px,
                None if gap is None else gap.radius_px,
                float(abs(frame.shift_levels).max()),
                100 * frame.saturated_share,
                frame.rim_px,
                ", ".join(remarks.get(frame.press.name, [])).replace("_", " "),
            )
        )
    return [
        Table(
            "Presses, worst first",
            (
                "press",
                "u [px]",
                "v [px]",
                "radius [px]",
                "confidence",
                "label off [px]",
                "radius off [px]",
                "light shift [levels]",
                "saturated [%]",
                "rim [px]",
                "findings",
            ),
            rows,
            "Circles as found in the image; “off”: distance of the given circle's centre from it, "
            "and found less given radius. Light shift: untouched gel against the background.",
        )
    ]


def _pictures(check: CaptureCheck) -> list[Picture]:
    if check.grid is None or not check.frames or check.background is None:
        return []
    frames, grid, background = check.frames, check.grid, check.background
    remarks = remarks_by_frame(check)
    pictures = [
        Picture(
            "coverage",
            lambda: drawings.draw_coverage(frames, background.image, grid),
            "Where balls were: the colour model holds there and nowhere else. Green: contact "
            "found; orange: only the given circle.",
        ),
        Picture(
            "frames",
            lambda: drawings.draw_frames(_worst_first(check), remarks, grid),
            "Presses, worst first. Orange: the contact as found; white, dashed: as given. To "
            f"correct one, edit {CONTACTS_NAME} beside this page and put it into the capture "
            "folder.",
        ),
    ]
    if len(frames) > 1:
        pictures.append(
            Picture(
                "light",
                lambda: drawings.draw_light(frames),
                "Colour of the untouched gel in each frame against the background: flat lines are "
                "fixed camera settings.",
            )
        )
    given = check.folder.background
    if background.is_median and given is not None:
        pictures.insert(
            0,
            Picture(
                "framings",
                lambda: drawings.draw_framings(background, given.image()),
                "The background as given is not the untouched gel of the presses; the box shows "
                "the part that both have in common, where one was found.",
            ),
        )
    return pictures
