# SPDX-License-Identifier: Apache-2.0
"""ShapeMap3D for the GelSight Mini (RuihanGao): calib_ball/frame_<n>, frame 0 untouched.

Frame 0 of the published set is a crop of the framing of the others, which capture check says.
"""

from pathlib import Path

from taccel_lab.calibration.capture.importers import Draft, ImportOptions, images_in

PUBLISHED = (
    "that of sensorParams.py of RuihanGao/16741-Proj-ShapeMap3D-GelSightMini, whatever the set"
)


def read(source: Path, options: ImportOptions) -> list[Draft]:
    """The one set, in calib_ball or in the source that is called so."""
    folder = source if source.name == "calib_ball" else source / "calib_ball"
    draft = Draft("", "gelsight_mini", folder)
    draft.assume_sensor("that of the published set")
    background = draft.find_background(options, "frame_0.*")
    draft.set_ball(2.0, PUBLISHED)
    draft.set_scale(0.08, why=PUBLISHED)
    draft.add_presses([image for image in images_in(folder, "frame_*") if image != background])
    return [draft] if draft.manifest.get("presses") else []
