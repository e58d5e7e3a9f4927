# SPDX-License-Identifier: Apache-2.0
"""The main job on real captures: calibrate, then simulate photos that the calibration never saw.

Held-out presses are written as photos, pressed as by ``taccel-lab press --like``, and shown beside
their simulations on one page, with the way to all else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from taccel_lab.errors import InputError, SimulationError
from taccel_lab.files.atomic_file import write_image
from taccel_lab.presses.options import PressOptions
from taccel_lab.presses.page import force_score, press_strip
from taccel_lab.processes.process_pool import Died, ProcessPool, Underway, usable_cores
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.profile.assumed import is_modulus_known
from taccel_lab.progress import Progress, silent
from taccel_lab.report.lead import Link, Score, Strip
from taccel_lab.report.page import PAGE, Page, write_page_into
from taccel_lab.report.remark import Remark, Severity

if TYPE_CHECKING:
    from taccel_lab.calibration.calibrate import Calibration
    from taccel_lab.calibration.capture.captures import CapturedPress
    from taccel_lab.calibration.capture.folder import CaptureFolder

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
    """A held-out photo and what its simulation gave."""

    name: str
    file: str
    """What its files are called, without a suffix."""
    strip: Strip | None = None
    """Photo, simulation, difference and depth; None where the photo cannot be simulated."""
    force: Score | None = None
    figures: dict[str, Any] | None = None
    said: str = ""
    """What the press says of itself, or why there is none."""


def simulate_photos(
    found: Calibration,
    presses: Sequence[CapturedPress],
    root: Path,
    progress: Progress = silent,
) -> list[SimulatedPhoto]:
    """Simulate held-out photos, each in a process, and write them and their presses below
    ``root``."""
    captured = {press.name: press for press in found.captures.presses}
    asked = []
    (root / PHOTOS).mkdir()
    (root / PRESSES).mkdir()
    for press in presses:
        file = press.name.replace("/", "_")  # Images may lie in inner folders.
        # As the blocks saw it: rectified where a board lay on the gel.
        seen = captured.get(press.name, press)
        write_image(root / PHOTOS / f"{file}.png", seen.image())
        asked.append(_Asked(press.name, file, _ball(press, found.captures)))
    cores = usable_cores()
    done: dict[str, SimulatedPhoto] = {}
    with TemporaryDirectory(prefix="taccel_lab_") as basis:
        # By the models that were scored: those of the profile were fitted to these photos, too.
        save_profile(found.basis, Path(basis) / PROFILE)
        work = partial(_simulate, Path(basis) / PROFILE, root)
        with ProcessPool(work, min(len(asked), cores) if cores > 1 else 0) as pool:
            for event in pool.run(asked):
                if isinstance(event, Underway):
                    progress(event.what, event.done, event.total)
                elif isinstance(event, Died):
                    one = event.item
                    done[one.name] = SimulatedPhoto(one.name, one.file, said=event.cause)
                else:
                    done[event.item.name] = event.result
    return [done[one.name] for one in asked]


@dataclass(frozen=True)
class _Asked:
    name: str
    file: str
    indenter: str


def _simulate(basis: Path, root: Path, asked: _Asked, progress: Progress) -> SimulatedPhoto:
    from taccel_lab.api.press import planned_press

    name, file = asked.name, asked.file
    options = PressOptions(indenter=asked.indenter, like=root / PHOTOS / f"{file}.png")
    try:
        run = planned_press(load_profile(basis), options)
        assert run.photo is not None
        # As seen from the press's folder, wherever the whole is moved.
        photo = replace(run.photo, path=Path("..", "..", PHOTOS, f"{file}.png"))
        pressed = replace(run, photo=photo).run(
            lambda done, total, _: progress(f"simulating {name}", done, total)
        )
    except (InputError, SimulationError) as error:
        return SimulatedPhoto(name, file, said=str(error))
    pressed.save(root / PRESSES / file)
    strip = press_strip(pressed, file, tuple(_links(file)))
    return SimulatedPhoto(name, file, strip, force_score(pressed), pressed.figures(), repr(pressed))


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
        Remark(Severity.WARNING, "not_simulated", f"{one.name} was not simulated: {one.said}")
        for one in photos
        if one.strip is None
    ]
    strips = [one.strip for one in photos if one.strip is not None]
    forces = [_force(one.name, one.force, found) for one in photos if one.force is not None]
    return replace(
        page,
        title=f"{found.captures.sensor}: photos beside their simulations",
        summary="The photos were held out: no model had seen them when they were simulated. Place "
        "and depth are read from the photo, the gel is pressed by finite elements, and its image "
        "is painted by the calibrated colours. The profile was fitted to all presses afterwards. "
        + page.summary,
        remarks=(*lost, *page.remarks),
        strips=strips,
        scores=(*page.scores, *forces[:1]),
        links=(Link("the profile", f"../{PROFILE}/"), *page.links),
        # The photos say it better.
        pictures=page.pictures[1:] if strips else page.pictures,
    )


def _ball(press: CapturedPress, folder: CaptureFolder) -> str:
    """The indenter of a press."""
    radius_mm = press.radius_mm or folder.ball_radius_mm
    if radius_mm is None:
        raise InputError(f"{folder.source} states no radius of the ball; give radius_mm")
    return f"sphere:{radius_mm:g}"


def _links(file: str) -> Iterator[Link]:
    name = quote(file)
    yield Link("all of this press", f"../{PRESSES}/{name}/{PAGE}")
    yield Link("its files", f"../{PRESSES}/{name}/")
    yield Link("the photo", f"../{PHOTOS}/{name}.png")


def _force(name: str, score: Score, found: Calibration) -> Score:
    if is_modulus_known(found.profile.material):
        return replace(score, scored_on=f"{name}, {score.scored_on}")
    return replace(
        score,
        scored_on=f"{name}, simulated; scored on nothing: these captures have no forces, and the "
        "modulus is assumed",
    )
