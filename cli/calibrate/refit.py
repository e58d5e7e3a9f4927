# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate refit``: an existing profile brought to the light of today."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional


@dataclass(frozen=True)
class CalibrateRefit:
    """Correct an existing profile for aged lamps or a changed camera, from about 5 new frames.

    Fits gain, offset and gradient of the background and the response of the colour model, a channel
    each, and says how far frames that were left out of the fit are off before and after. Refuses
    when the frames cannot tell, and when nothing is gained. Of four presses or more a quarter has
    no part in it and is scored in the end. The profile stays of the same kind: the model's last
    layer is scaled.
    """

    profile: Positional[Path]
    """Profile folder to correct; it has a background, and a colour model that is to be kept."""
    captures: Positional[Path]
    """Capture folder of today: 5 frames or more, at least 2 ball presses among them; the presses
    also need [indenter] radius_mm. The scale is the profile's."""
    out: Path
    """Profile folder to write."""
    report: Path | None = None
    """Folder for the report; <out>_report when left out."""
    json: bool = False
    """Print the figures as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.capture import load_capture_folder
        from taccel_lab.calibration.recorded import with_session
        from taccel_lab.calibration.refit.fit import calibrate_refit
        from taccel_lab.calibration.refit.report import refit_page
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
