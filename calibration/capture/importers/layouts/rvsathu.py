# SPDX-License-Identifier: Apache-2.0
"""GelSight-Sim2Real (RVSATHU, RA-L 2022): calib_<n>_real.png, background_real.png."""

from pathlib import Path

from taccel_lab.calibration.capture.importers import Draft, ImportOptions, images_in

PUBLISHED = "that of depth_reconstruction of RVSATHU/GelSight-Sim2Real, whatever the set"


def read(source: Path, options: ImportOptions) -> list[Draft]:
    """The one set; its circles are in labels/res.txt."""
    draft = Draft("", "flat_pad", source)
    draft.assume_sensor()
    draft.find_background(options, "background_real.*")
    draft.set_ball(2.92, PUBLISHED)
    draft.set_scale(0.05926, why=PUBLISHED)
    draft.add_presses(images_in(source, "calib_*_real.*"))
    return [draft] if draft.manifest.get("presses") else []
