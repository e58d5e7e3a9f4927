# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate refit``: an existing profile brought to the light of today."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional


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
        from taccel_lab.calibration.light.refit import calibrate_refit
        from taccel_lab.calibration.light.refit_result import refit_page
        from taccel_lab.cli.calibrate.base import (
            Sayings,
            report_folder,
            require_outputs,
            write_results,
        )
        from taccel_lab.cli.console import notes, working
        from taccel_lab.profile import load_profile

        console = notes()
        report = report_folder(self.out, self.report)
        require_outputs(self.out, report)
        profile = load_profile(self.profile)
        folder = load_capture_folder(self.captures)
        with working(console, "finding the presses and fitting the light"):
            result = calibrate_refit(folder, profile)
        fresh = with_session(profile, result.apply_to(profile), folder)
        say = Sayings("refit", console, self.json)
        write_results(result, refit_page(result, profile), fresh, self.out, report, say)
