# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate NAME``: a command for each block, made of its words; forces from simulated
touches, and a profile brought to the light of today."""

from __future__ import annotations

from dataclasses import dataclass, make_dataclass
from pathlib import Path
from typing import cast

from tyro.conf import Positional

from taccel_lab.calibration.block import Block
from taccel_lab.calibration.blocks import all_blocks
from taccel_lab.cli.calibration_outputs import (
    BlockCommand,
    report_folder,
    require_outputs,
    write_results,
)
from taccel_lab.errors import InputError
from taccel_lab.learning.force.options import ForceOptions


def block_commands() -> dict[str, type[BlockCommand]]:
    """Commands of all blocks, by name."""
    return {block.name: command_of(block) for block in all_blocks()}


def command_of(block: Block) -> type[BlockCommand]:
    """Command of one block: its words, beside those that all blocks have."""
    name = f"Calibrate{block.name.capitalize()}"
    own = {"block": block, "__doc__": block.words.__doc__}
    made = make_dataclass(name, [], bases=(BlockCommand, block.words), namespace=own, frozen=True)
    return cast(type[BlockCommand], made)


@dataclass(frozen=True)
class CalibrateForce(ForceOptions):
    """Train the model from images to forces on a data set of simulated touches and write a profile.

    Make the data set (taccel-lab dataset) with the profile of your sensor and units drawn from its
    spread; it needs the channels rgb and patch_forces_n. Whole objects and units are held out
    before an image is read; the report has their errors by depth, shear and position. The training
    is saved every 10 s beside the new profile, and the same command continues it. `taccel-lab
    force` then reads images. Not part of calibrate all.
    """

    datasets: Positional[tuple[Path, ...]]
    """Folders of a data set, or of its shards."""
    out: Path
    """Profile folder to write."""
    profile: Path | None = None
    """Profile to extend. Default: the one of the data set."""
    report: Path | None = None
    """Folder for the report (HTML, pictures, JSON). Default: <out>_report."""
    tensorboard: Path | None = None
    """Folder for the loss as TensorBoard reads it; needs the extra tensorboard."""
    json: bool = False
    """Print the figures as JSON instead of a summary."""

    def run(self) -> None:
        from taccel_lab.cli.console import notes, say
        from taccel_lab.datasets.reading import Dataset
        from taccel_lab.errors import keeping
        from taccel_lab.learning.force.fit import calibrate_force
        from taccel_lab.learning.force.force_page import force_page
        from taccel_lab.learning.force.training_file import TrainingFile
        from taccel_lab.learning.scalars import scalars_in
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.profile import load_profile
        from taccel_lab.progress import stage_progress

        start_warp()
        if not self.datasets:
            raise InputError("name at least one folder of a data set")
        report = report_folder(self.out, self.report)
        require_outputs(self.out, report)
        base = (
            Dataset(self.datasets).profile(0)
            if self.profile is None
            else load_profile(self.profile)
        )
        kept = TrainingFile.beside(self.out, say)
        with keeping(kept.what_stays):
            with stage_progress(notes()) as progress, scalars_in(self.tensorboard) as scalars:
                result = calibrate_force(self.datasets, base, self, progress, kept, scalars)
            saved = result.apply_to(base), self.out
            write_results("force", result, force_page(result), saved, report, self.json)
        kept.remove()


@dataclass(frozen=True)
class CalibrateRefit:
    """Correct an existing profile for aged lamps or a changed camera, from about 5 new frames.

    Fits gain, offset and gradient of the background and the response of the colour model, by
    channel. Reports errors on left-out frames before and after. Rejects frames that do not
    determine the correction, and corrections that gain nothing. Of four presses or more a quarter
    is held out and scored. The model's last layer is scaled.
    """

    profile: Positional[Path]
    """Profile folder to correct, with a background and a colour model."""
    captures: Positional[Path]
    """Capture folder of today: 5 frames or more, at least 2 ball presses among them; the presses
    also need [indenter] radius_mm. The scale is the profile's."""
    out: Path
    """Profile folder to write."""
    report: Path | None = None
    """Folder for the report. Default: <out>_report."""
    json: bool = False
    """Print the figures as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.base_profile import with_session
        from taccel_lab.calibration.capture import load_capture_folder
        from taccel_lab.calibration.refit.fit import calibrate_refit
        from taccel_lab.calibration.refit.result import refit_page
        from taccel_lab.cli.console import notes, working
        from taccel_lab.profile import load_profile

        report = report_folder(self.out, self.report)
        require_outputs(self.out, report)
        profile = load_profile(self.profile)
        folder = load_capture_folder(self.captures)
        with working(notes(), "finding the presses and fitting the light"):
            result = calibrate_refit(folder, profile)
        fresh = with_session(profile, result.apply_to(profile), folder)
        page = refit_page(result, profile)
        write_results("refit", result, page, (fresh, self.out), report, self.json)
