# SPDX-License-Identifier: Apache-2.0
"""The main job on real captures: calibrate, then simulate photos that the calibration never saw.

Held-out presses are written as photos, pressed as by ``taccel-lab press --like``, and shown beside
their simulations on one page, with the way to all else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from taccel_lab.api.press_options import PressOptions
from taccel_lab.api.press_page import force_score, press_strip
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_image
from taccel_lab.profile.assumed import is_modulus_known
from taccel_lab.report.lead import Link, Score
from taccel_lab.report.page import PAGE, Page, write_page_into
from taccel_lab.report.remark import Remark, Severity

if TYPE_CHECKING:
    from taccel_lab.api.press_result import Press
    from taccel_lab.calibration.calibrate import Calibration
    from taccel_lab.calibration.capture.captures import CapturedPress
    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.presses.press_force import StepProgress

REPORT, PROFILE, PHOTOS, PRESSES = "report", "profile", "photos", "presses"
"""Folders of a demonstration."""
SHOWN = 2
"""Held-out photos that are simulated."""


def shown_presses(folder: CaptureFolder) -> tuple[CapturedPress, ...]:
    """Held-out presses that are simulated: the first and the last, so that nobody has chosen them
    by their images.

    Raises:
        InputError: No press is held out, or a ball is of unknown size.
    """
    if not folder.presses:
        raise InputError(
            f"{folder.source} has no ball presses: the demonstration calibrates with them and "
            "simulates those that it held out; taccel-lab calibrate all takes any captures"
        )
    held = folder.split().heldout
    last = len(held) - 1
    chosen = sorted({round(last * k / (SHOWN - 1)) for k in range(SHOWN)})
    found = tuple(folder.presses[held[place]] for place in chosen)
    for press in found:
        _ball(press, folder)
    return found


@dataclass(frozen=True)
class SimulatedPhoto:
    """A held-out photo and its simulation."""

    name: str
    file: str
    """What its files are called, without a suffix."""
    pressed: Press | None = None
    """None where the photo cannot be simulated."""
    reason: str = ""
    """Why it cannot."""


def simulate_photo(
    found: Calibration, press: CapturedPress, root: Path, progress: StepProgress | None = None
) -> SimulatedPhoto:
    """Simulate a held-out photo and write both below ``root``; ``progress`` as of ``press``.

    Raises:
        SimulationError: A step did not converge.
    """
    from taccel_lab.api.press_run import PressRun

    name = press.name.replace("/", "_")  # Images may lie in inner folders.
    photo = root / PHOTOS / f"{name}.png"
    photo.parent.mkdir(exist_ok=True)
    # As the blocks saw it: rectified where a board lay on the gel.
    seen = next(one for one in found.captures.presses if one.name == press.name)
    write_image(photo, seen.image())
    options = PressOptions(indenter=_ball(press, found.captures), like=photo)
    try:
        # By the models that were scored: those of the profile were fitted to this photo, too.
        pressed = PressRun.plan(found.basis, options).run(progress)
    except InputError as error:
        return SimulatedPhoto(press.name, name, reason=str(error))
    (root / PRESSES).mkdir(exist_ok=True)
    pressed.save(root / PRESSES / name)
    return SimulatedPhoto(press.name, name, pressed)


def write_demonstration(found: Calibration, photos: Sequence[SimulatedPhoto], root: Path) -> None:
    """Write profile, reports of the blocks and the page of the whole below ``root``."""
    found.save(root / PROFILE)
    report = root / REPORT
    report.mkdir()
    found.write_blocks(report)
    write_page_into(demonstration_page(found, photos, report), report)


def demonstration_page(found: Calibration, photos: Sequence[SimulatedPhoto], report: Path) -> Page:
    """The page of the calibration, opened by held-out photos beside their simulations.

    ``report`` is where the blocks' pages are, and where the page will be.
    """
    page = found.page(report)
    lost = [
        Remark(Severity.WARNING, "not_simulated", f"{one.name} was not simulated: {one.reason}")
        for one in photos
        if one.pressed is None
    ]
    done = [(one, one.pressed) for one in photos if one.pressed is not None]
    return replace(
        page,
        title=f"{found.captures.sensor}: photos beside their simulations",
        summary="The photos were held out: no model had seen them when they were simulated. Place "
        "and depth are read from the photo, the gel is pressed by finite elements, and its image "
        "is painted by the calibrated colours. The profile was fitted to all presses afterwards. "
        + page.summary,
        remarks=(*lost, *page.remarks),
        strips=[press_strip(pressed, one.name, _links(one)) for one, pressed in done],
        scores=(*page.scores, *(_force(one, pressed, found) for one, pressed in done[:1])),
        links=(Link("the profile", f"../{PROFILE}/"), *page.links),
        # The photos say it better.
        pictures=page.pictures if not done else page.pictures[1:],
    )


def _ball(press: CapturedPress, folder: CaptureFolder) -> str:
    """The indenter of a press."""
    radius_mm = press.radius_mm or folder.ball_radius_mm
    if radius_mm is None:
        raise InputError(f"{folder.source} states no radius of the ball; give radius_mm")
    return f"sphere:{radius_mm:g}"


def _links(photo: SimulatedPhoto) -> Iterator[Link]:
    name = quote(photo.file)
    yield Link("all of this press", f"../{PRESSES}/{name}/{PAGE}")
    yield Link("its files", f"../{PRESSES}/{name}/")
    yield Link("the photo", f"../{PHOTOS}/{name}.png")


def _force(photo: SimulatedPhoto, pressed: Press, found: Calibration) -> Score:
    score = force_score(pressed)
    if is_modulus_known(found.profile.material):
        return replace(score, scored_on=f"{photo.name}, {score.scored_on}")
    return replace(
        score,
        scored_on=f"{photo.name}, simulated; scored on nothing: these captures have no forces, and "
        "the modulus is assumed",
    )
