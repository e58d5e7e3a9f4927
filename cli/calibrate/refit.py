# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate refit``: an existing profile brought to the light of today."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.background.refit_frames import Surfaces
    from taccel_lab.calibration.capture import CaptureSet, ContactCircle
    from taccel_lab.calibration.surfaces import PressSurface
    from taccel_lab.profile import SensorProfile


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
    surface: Literal["simulated", "hertz"] = "simulated"
    """Gel surface under a press: the simulation, or a closed form, which is quick."""
    report: Path | None = None
    """Folder for the report; <out>_report when left out."""
    json: bool = False
    """Print the figures as JSON."""

    def run(self) -> None:
        from rich.console import Console

        from taccel_lab.calibration.background.refit import refit_profile
        from taccel_lab.calibration.background.refit_frames import refit_frames
        from taccel_lab.calibration.background.refit_report import refit_page
        from taccel_lab.calibration.capture import load_capture_folder
        from taccel_lab.cli.calibrate.base import report_folder, require_outputs, write_results
        from taccel_lab.cli.console import print_json
        from taccel_lab.profile import load_profile

        console = Console(stderr=True)
        report = report_folder(self.out, self.report)
        require_outputs(self.out, report)
        profile = load_profile(self.profile)
        folder = load_capture_folder(self.captures)
        if folder.sensor != profile.sensor.family:
            raise InputError(
                f"the captures are of a {folder.sensor}, the profile {self.profile} is of a "
                f"{profile.sensor.family}"
            )
        if profile.background_rgb is None:
            raise InputError(
                f"the profile {self.profile} has no background, so that there is nothing to refit; "
                "run taccel-lab calibrate color first"
            )
        surfaces: Surfaces | Literal["hertz"] = "hertz"
        if self.surface == "simulated":
            surfaces = _simulated(profile, console)
        new = refit_frames(profile, folder, surfaces)
        result = refit_profile(
            profile,
            new.fitted,
            source=folder.provenance.get("source", folder.source),
            surface_provider=new.surface_provider,
            mask=folder.mask,
            heldout=new.heldout,
        )
        write_results(result, refit_page(result, profile), profile, self.out, report, console)
        if self.json:
            print_json({"profile": str(self.out), "refit": result.figures()})


def _simulated(profile: SensorProfile, console: Console) -> Surfaces:
    def make(captures: CaptureSet, circles: list[ContactCircle]) -> list[PressSurface]:
        from taccel_lab.calibration.simulate import simulate_presses
        from taccel_lab.cli.progress import count_progress

        with count_progress(console, "simulating the presses") as progress:
            return simulate_presses(
                captures, circles, profile, progress=lambda _, done, count: progress(done, count)
            )

    return make
