# SPDX-License-Identifier: Apache-2.0
"""Every block that a capture folder has captures for, each on the profile of the one before.

The captures are checked first. A block without captures is skipped; one that the check blocks, or
that refuses its captures, is passed over, and the profile keeps what the base says of it. After a
board on the gel the other blocks see the images that the profile's camera describes: rectified.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from taccel_lab.calibration.base_profile import base_profile, with_measured_scale, with_session
from taccel_lab.calibration.block import Block
from taccel_lab.calibration.blocks import HOMES, block_named
from taccel_lab.calibration.calibration_page import MAPS, calibration_page, telling_first
from taccel_lab.calibration.camera.rectification import (
    LEFT_OUT,
    RectificationMaps,
    rectify_captures,
)
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.check.content import Readiness
from taccel_lab.calibration.check.run import CaptureCheck, capture_check
from taccel_lab.calibration.unfinished import (
    BlockOutcome,
    BlockState,
    Profiles,
    UnfinishedCalibration,
    calibration_key,
)
from taccel_lab.errors import InputError
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.guards import require_known, unknown
from taccel_lab.processes.start_warp import start_warp
from taccel_lab.profile import SensorProfile, save_profile
from taccel_lab.progress import Progress, bars_if_watched
from taccel_lab.report.page import Page, first_figure, write_page, write_page_into
from taccel_lab.report.remark import Severity, judge
from taccel_lab.summary import Summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taccel_lab.calibration.result import BlockResult


@dataclass(frozen=True, repr=False, eq=False)
class Calibration(Summary):
    """A profile with how each of its blocks came about."""

    profile: SensorProfile
    """Fitted to all presses, once the held-out ones were scored."""
    basis: SensorProfile
    """Profile that no held-out press has a part in: simulations of their photos are honest by it
    alone."""
    captures: CaptureFolder
    """What was captured, as the blocks saw it: rectified where a board lay on the gel."""
    blocks: tuple[BlockOutcome, ...]
    """Outcomes in the order of ``taccel_lab.calibration.blocks``."""
    results: Mapping[str, BlockResult] = field(default_factory=dict)
    """What each block found, by its name; without those that an earlier run had finished."""
    maps: RectificationMaps | None = None
    """Maps from raw images to those of the profile's camera, after a board on the gel."""
    notes: tuple[str, ...] = ()
    """What rectification left out of the captures."""
    rectified: TemporaryDirectory[str] | None = None
    """Rectified captures, which pages read while they are written; they live as long as this
    object."""
    unfinished: UnfinishedCalibration | None = None
    """Where blocks were kept as they were finished."""

    def __getattr__(self, name: str) -> Any:
        """Return what a block found, by its name: ``calibration.color.score``; InputError where it
        is not done."""
        if name not in HOMES:
            raise AttributeError(f"a calibration has no {name!r}")
        if name in self.results:
            return self.results[name]
        ended = {o.name: f"{o.state}, {o.message}" for o in self.blocks}
        raise InputError(f"there is no result of {name}: {ended.get(name, 'it was not asked for')}")

    def save(self, folder: Path | str) -> None:
        """Write the profile; errors as of ``save_profile``."""
        save_profile(self.profile, folder)

    def figures(self) -> dict[str, Any]:
        """Everything measured by each block, ready for JSON."""
        return {name: result.figures() for name, result in self.results.items()}

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """List how each block ended."""
        rows = [
            (o.name, f"{o.state}: {o.message}" + (f" ({o.seconds:.0f} s)" if o.seconds else ""))
            for o in self.blocks
        ]
        return f"calibration of {self.profile.sensor.name}", rows

    @property
    def unfit(self) -> tuple[BlockOutcome, ...]:
        """Blocks whose captures are there and cannot be used."""
        return tuple(outcome for outcome in self.blocks if outcome.is_unfit)

    def plot(self, block: str | None = None) -> Figure:
        """Draw the first figure of a block's page, of the most telling where ``block`` is None.

        Raises:
            InputError: No such block was fitted, or none has a figure.
        """
        pages = {o.name: o.page for o in self.blocks if o.page is not None}
        if block is not None and block not in pages:
            raise InputError(f"{block!r} was not fitted{unknown(block, pages, they_are='allowed')}")
        order = telling_first(pages) if block is None else [block]
        return first_figure(pages[name] for name in order)

    def page(self, report: Path) -> Page:
        """Return the page of the whole, which links to the blocks' pages in the folder
        ``report``."""
        return calibration_page(self.profile, self.blocks, report)

    def write_blocks(self, report: Path) -> None:
        """Write the page of each block into a folder of its name, and the maps beside them."""
        for outcome in self.blocks:
            if outcome.written is not None:
                shutil.copytree(outcome.written, report / outcome.name)
            elif outcome.page is not None:
                write_page(outcome.page, report / outcome.name)
        if self.maps is not None:
            self.maps.save(report / MAPS)

    def write_report(self, folder: Path | str) -> None:
        """Write the page of the whole, and that of each block into a folder of its name.

        Raises:
            InputError: The folder holds files that taccel-lab did not write.
        """
        with atomic_directory(folder) as staging:
            self.write_blocks(staging)
            write_page_into(self.page(staging), staging)


def calibrate(
    folder: CaptureFolder | Path | str,
    base: SensorProfile | Path | str | None = None,
    only: str | Sequence[str] = (),
    options: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    unfinished: Path | str | None = None,
) -> Calibration:
    """Fit every block that the captures allow; arguments and errors as of
    ``taccel_lab.calibrate``."""
    start_warp()
    only = (only,) if isinstance(only, str) else tuple(only)
    with bars_if_watched(progress) as bars:
        return _calibrate(folder, base, only, dict(options or {}), bars, unfinished)


def _calibrate(
    folder: CaptureFolder | Path | str,
    base: SensorProfile | Path | str | None,
    only: Sequence[str],
    options: Mapping[str, Any],
    progress: Progress,
    unfinished: Path | str | None,
) -> Calibration:
    chosen = _chosen(only, options)
    if not isinstance(folder, CaptureFolder):
        folder = load_capture_folder(folder)
    raw, profiles = folder, Profiles.of(base_profile(base, folder))
    extended = None if base is None else profiles.final
    kept = None
    if unfinished is not None:
        key = calibration_key(raw, profiles.final, only, options)
        kept = UnfinishedCalibration.open(unfinished, key)
    known = with_measured_scale(folder, profiles.basis)
    ready = _readiness(capture_check(known, progress, only))
    outcomes: list[BlockOutcome] = []
    results: dict[str, BlockResult] = {}
    maps, rectified, notes = None, None, ()
    if kept is not None and kept.profiles is not None:
        profiles, maps = kept.profiles, kept.maps
    for block in chosen:
        state, message = ready[block.name]
        if block.measures_scale and rectified is not None:
            state, message = BlockState.SKIPPED, "the board on the gel gave the scale"
        if state is not None:
            outcomes.append(BlockOutcome(block.name, state, message))
            continue
        if kept is not None and block.name in kept.outcomes:
            outcome, result = kept.outcomes[block.name], None
        else:
            if not block.measures_scale:
                folder = with_measured_scale(folder, profiles.basis)
            outcome, result, profiles = _fit(block, folder, profiles, options, progress)
        if rectified is not None:  # In a folder that goes: the user knows what it was made of.
            known = outcome.message.replace(str(folder.root), str(raw.root))
            outcome = replace(outcome, message=known)
        if result is not None:
            results[block.name] = result
            maps = maps or result.rectification
        if kept is not None and block.name not in kept.outcomes:
            outcome = kept.add(outcome, profiles, maps)
        outcomes.append(outcome)
        if maps is not None and rectified is None and raw.background is not None:
            rectified = TemporaryDirectory(prefix="taccel_lab_")
            place = Path(rectified.name) / "captures"
            left_out = rectify_captures(raw, maps, place)
            # Boards have done all they can: the maps are of them.
            notes = tuple(note for note in left_out if note != LEFT_OUT.format("boards"))
            folder = replace(load_capture_folder(place), source=raw.source)
    if not any(outcome.state is BlockState.DONE for outcome in outcomes):
        if kept is not None:  # A refusal is an end: there is nothing to go on with.
            kept.remove()
        lines = "\n".join(f"  {o.name}: {o.message}" for o in outcomes)
        raise InputError(f"{raw.source}: nothing could be calibrated\n{lines}")
    profile = with_session(extended, profiles.final, raw)
    return Calibration(
        profile, profiles.basis, folder, tuple(outcomes), results, maps, notes, rectified, kept
    )


def _chosen(only: Sequence[str], options: Mapping[str, Any]) -> list[Block]:
    for name in (*only, *options):
        require_known("block", name, list(HOMES))
    return [block_named(name) for name in HOMES if not only or name in only]


def _readiness(check: CaptureCheck) -> dict[str, tuple[BlockState | None, str]]:
    """Why a block is not fitted, by its name; None where it is."""
    found: dict[str, tuple[BlockState | None, str]] = {}
    for block in check.blocks:
        if block.readiness is Readiness.ABSENT:
            found[block.command] = BlockState.SKIPPED, f"needs {block.missing}"
        elif block.readiness is Readiness.BLOCKED:
            # Warnings do not stop it: the check tells them, and the block's own report.
            stops = [
                finding.message.removesuffix(".")
                for finding in check.findings
                if block.command in finding.blocks and finding.severity is Severity.ERROR
            ]
            needs = [f"needs {block.missing}"] if block.missing else []
            found[block.command] = BlockState.BLOCKED, "; ".join([*needs, *stops])
        else:
            found[block.command] = None, block.found
    return found


def _fit(
    block: Block,
    folder: CaptureFolder,
    profiles: Profiles,
    options: Mapping[str, Any],
    progress: Progress,
) -> tuple[BlockOutcome, Any, Profiles]:
    """How it ended, the result (None where it was rejected) and the profiles after it."""

    def block_progress(task: str, done: int, total: int) -> None:
        progress(f"{block.name}: {task}", done, total)

    started = time.perf_counter()
    try:
        result = block.fit(folder, profiles.basis, options.get(block.name), block_progress)
        after, page = profiles.after(result), block.page(result, folder)
    except InputError as error:
        seconds = time.perf_counter() - started
        return BlockOutcome(block.name, BlockState.REFUSED, str(error), seconds), None, profiles
    seconds = time.perf_counter() - started
    verdict = str(judge(result.remarks))
    return BlockOutcome(block.name, BlockState.DONE, verdict, seconds, page), result, after
