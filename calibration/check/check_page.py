# SPDX-License-Identifier: Apache-2.0
"""The page of a check: verdict, blocks, findings worst first, pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.capture.contacts_file import CONTACTS_NAME, override_text
from taccel_lab.calibration.capture.coverage import coverage_map
from taccel_lab.calibration.capture.folder import contents_in_words
from taccel_lab.calibration.check.background import BackgroundCheck
from taccel_lab.calibration.check.content import Readiness
from taccel_lab.calibration.check.frames import FrameFigures
from taccel_lab.calibration.check.presses import found_circles
from taccel_lab.calibration.check.run import CaptureCheck
from taccel_lab.geometry import PixelGrid
from taccel_lab.printable import counted
from taccel_lab.report.lead import Link, Picture, Score
from taccel_lab.report.page import Page, Table, picture
from taccel_lab.report.style import CHANNELS, GREEN, INK, ORANGE, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_ROWS = 40
SHEET_COLUMNS, SHEET_FRAMES = 4, 60


def check_page(check: CaptureCheck) -> Page:
    """Describe the check for ``taccel_lab.report.page.write_page``."""
    contents = contents_in_words(check.folder.contents()) or "nothing"
    state = (
        "Nothing stops what these captures are there for."
        if check.usable
        else "Something here stops a calibration or makes it wrong; see the errors first."
    )
    return Page(
        title=f"Captures of a {check.folder.sensor}",
        summary=f"{check.folder.source}: {contents}. {state}",
        remarks=check.findings,
        tables=[_blocks(check), *_presses(check)],
        pictures=_pictures(check),
        figures=check.figures(),
        files={CONTACTS_NAME: lambda path: _write_contacts(check, path)} if check.frames else {},
        scores=_scores(check),
        links=[Link(f"{CONTACTS_NAME}: circles to correct", CONTACTS_NAME)] if check.frames else (),
    )


def _scores(check: CaptureCheck) -> list[Score]:
    """What can be fitted, how many contacts were found, and how much of the gel they touch."""
    run = [b.command for b in check.blocks if b.readiness in (Readiness.READY, Readiness.WEAK)]
    scores = [
        Score(
            f"{len(run)} of {len(check.blocks)}",
            "",
            "blocks of a profile can be calibrated",
            ", ".join(run) or "the table says what each one needs",
        )
    ]
    if check.grid is not None and check.frames:
        found = found_circles(check.frames)
        touched = (coverage_map(found, check.grid) > 0).mean()
        presses = f"{counted(len(check.frames), 'ball press', 'ball presses')}, without any label"
        scores += [
            Score(f"{len(found)}", "", "contacts found in the images", f"of {presses}"),
            Score(f"{100 * touched:.0f}", "%", "of the image touched", "by all contacts together"),
        ]
    return scores


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
    return Table.of(
        "Blocks of a profile",
        check.blocks,
        {
            "command": lambda block: f"calibrate {block.command}",
            "state": "readiness.value",
            "found": lambda block: block.found or None,
            "missing": "missing",
        },
        "ready: can be run; weak: runs, and the warnings say why its result will not be good; "
        "blocked: captures are there and something stops the command; absent: no captures for it.",
    )


def _presses(check: CaptureCheck) -> list[Table]:
    if check.grid is None or not check.frames:
        return []
    figures = {row["name"]: row for row in check.press_figures()}
    remarks = remarks_by_frame(check)
    columns = (
        "press", "u [px]", "v [px]", "radius [px]", "confidence", "label off [px]",
        "radius off [px]", "light shift [levels]", "saturated [%]", "rim [px]", "findings",
    )  # fmt: skip
    rows = []
    for frame in _worst_first(check)[:MAX_ROWS]:
        row = figures[frame.press.name]
        rows.append(
            (
                *(row[key] for key in ("name", "u_px", "v_px", "radius_px")),
                None if frame.contact is None else frame.contact.confidence,
                *(row[key] for key in ("label_center_px", "label_radius_px")),
                float(abs(row["shift_levels"]).max()),
                100 * row["saturated_share"],
                row["rim_px"],
                ", ".join(remarks.get(frame.press.name, [])).replace("_", " "),
            )
        )
    caption = (
        "Circles as found in the image; “off”: distance of the given circle's centre from it, and "
        "found less given radius. Light shift: untouched gel against the background."
    )
    return [Table("Presses, worst first", columns, rows, caption, folded=True)]


def _pictures(check: CaptureCheck) -> list[Picture]:
    if check.grid is None or not check.frames or check.background is None:
        return []
    frames, grid, background = check.frames, check.grid, check.background
    pictures = [
        _coverage(frames, background.image, grid),
        _frames(_worst_first(check), remarks_by_frame(check), grid),
    ]
    if len(frames) > 1:
        pictures.append(_light(frames))
    given = check.folder.background
    if background.is_median and given is not None:
        pictures.insert(0, _framings(background, given.image))
    return pictures


@picture(
    "coverage",
    "Where balls were: what is fitted to them holds there and nowhere else. Green: contact found; "
    "orange: only the given circle.",
)
def _coverage(frames: Sequence[FrameFigures], background: np.ndarray, grid: PixelGrid) -> Figure:
    """Contacts over the untouched gel, and how often each pixel was touched."""
    aspect = grid.height_px / grid.width_px
    width = 8.6 if aspect <= 1 else 7.4
    figure, axes = new_figure(width, 1.0 + 0.4 * width * aspect, 1, 2)
    figure.set_layout_engine("compressed")
    axes[0].imshow(background)
    for frame in frames:
        if frame.circle is not None:
            color = GREEN if frame.contact is not None else ORANGE
            _circle(axes[0], frame.circle, grid, color, "-", 1.0)
    axes[0].set_title(counted(len(frames), "press", "presses"))
    count = coverage_map(found_circles(frames), grid)
    top = max(1, int(count.max()))
    drawn = axes[1].imshow(count, cmap="viridis", vmin=0, vmax=top)
    ticks = np.unique(np.linspace(0, top, min(top, 5) + 1).round())
    figure.colorbar(drawn, ax=axes[1], label="contacts on a pixel", ticks=ticks)
    axes[1].set_title(f"{(count > 0).mean():.0%} of the image touched")
    for panel in axes:
        panel.set_xlim(-0.5, grid.width_px - 0.5)
        panel.set_ylim(grid.height_px - 0.5, -0.5)
        panel.set_xlabel("u [px]")
    axes[0].set_ylabel("v [px]")
    return figure


@picture(
    "light",
    "Colour of the untouched gel in each frame against the background: flat lines are fixed camera "
    "settings.",
)
def _light(frames: Sequence[FrameFigures]) -> Figure:
    """Colour of the untouched gel over the frames, against the background."""
    figure, axes = new_figure(8.6, 2.6)
    shifts = np.stack([frame.shift_levels for frame in frames])
    for channel, (name, color) in enumerate(CHANNELS):
        axes.plot(shifts[:, channel], marker=".", lw=1, color=color, label=name)
    axes.axhline(0, color=INK, lw=0.6)
    axes.set_xlabel("press, in the order of the manifest")
    axes.set_ylabel("untouched gel less\nbackground [levels]")
    axes.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.2))
    return figure


@picture(
    "frames",
    "Presses, worst first. Orange: the contact as found; white, dashed: as given. To correct one, "
    f"edit {CONTACTS_NAME} (the link above) and put it into the capture folder.",
)
def _frames(
    frames: Sequence[FrameFigures], remarks: dict[str, list[str]], grid: PixelGrid
) -> Figure:
    """The first ``SHEET_FRAMES`` frames: contact found, label, findings."""
    chosen = frames[:SHEET_FRAMES]
    columns = min(SHEET_COLUMNS, len(chosen))
    rows = -(-len(chosen) // columns)
    aspect = grid.height_px / grid.width_px
    figure, axes = new_figure(
        2.3 * columns + 0.2, rows * (2.2 * aspect + 0.62), rows, columns, squeeze=False
    )
    for panel in axes.ravel():
        panel.set_axis_off()
    for panel, frame in zip(axes.ravel(), chosen, strict=False):
        panel.imshow(np.clip(frame.press.image(), 0, 255))
        if frame.press.circle is not None:
            _circle(panel, frame.press.circle, grid, "white", "--", 1.2)
        if frame.contact is not None:
            _circle(panel, frame.contact.circle, grid, ORANGE, "-", 1.2)
        panel.set_xlim(-0.5, grid.width_px - 0.5)
        panel.set_ylim(grid.height_px - 0.5, -0.5)
        codes = remarks.get(frame.press.name, [])
        text = ", ".join(code.replace("_", " ") for code in codes[:3]) or "no remark"
        panel.set_title(f"{_short(frame.press.name)}\n{text}", fontsize=8)
    return figure


@picture(
    "framings",
    "The background as given is not the untouched gel of the presses; the box shows the part that "
    "both have in common, where one was found.",
)
def _framings(check: BackgroundCheck, given: Callable[[], np.ndarray]) -> Figure:
    """The background beside the median of the presses."""
    background = given()
    figure, axes = new_figure(8.6, 1.0 + 4.0 * background.shape[0] / background.shape[1], 1, 2)
    figure.set_layout_engine("compressed")
    axes[0].imshow(background)
    axes[0].set_title("background as given")
    axes[1].imshow(check.image)
    axes[1].set_title("median of the presses")
    for panel in axes:
        panel.set_xlabel("u [px]")
    axes[0].set_ylabel("v [px]")
    return figure


def _short(name: str) -> str:
    return name if len(name) <= 26 else name[:12] + "…" + name[-12:]


def _circle(
    panel: Any, circle: ContactCircle, grid: PixelGrid, color: str, line: str, width: float
) -> None:
    from matplotlib.patches import Ellipse

    high = 2 * circle.radius_px * grid.mm_per_px_x / grid.mm_per_px_y
    panel.add_patch(
        Ellipse(
            (circle.u_px, circle.v_px), 2 * circle.radius_px, high,
            fill=False, ec=color, ls=line, lw=width,
        )
    )  # fmt: skip
