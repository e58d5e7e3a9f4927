# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate force``: a data set of simulated touches in, a profile with a force model
out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from taccel_lab.cli.calibrate.base import Sayings, report_folder, require_outputs, write_results
from taccel_lab.learning.force.options import ForceOptions


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
    json: bool = False
    """Print the figures as JSON instead of a summary."""

    def run(self) -> None:
        from taccel_lab.cli.console import notes
        from taccel_lab.datasets.reading import Dataset
        from taccel_lab.errors import InputError, keeping
        from taccel_lab.learning.force.fit import calibrate_force
        from taccel_lab.learning.force.force_page import force_page
        from taccel_lab.learning.force.training_file import TrainingFile
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
        console = notes()

        def say(words: str) -> None:
            console.print(words, soft_wrap=True)

        kept = TrainingFile.beside(self.out, say)
        with keeping(kept.what_stays):
            with stage_progress(console) as progress:
                result = calibrate_force(self.datasets, base, self, progress, kept)
            profile, say_it = result.apply_to(base), Sayings("force", console, self.json)
            write_results(result, force_page(result), profile, self.out, report, say_it)
        kept.remove()
