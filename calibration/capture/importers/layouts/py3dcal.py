# SPDX-License-Identifier: Apache-2.0
"""py3DCal: annotations, probe_images, blank_images, of a 3D printer's probing.

The table names images and the probe's centre, no rim.
"""

from pathlib import Path

from taccel_lab.calibration.capture.importers import (
    Draft,
    ImportOptions,
    press_rows,
    stated_number,
)

DEPTHS = ("penetration_depth_mm", "penetration_mm", "depth_mm")
TABLES = ("annotations.csv", "probe_data.csv")


def read(source: Path, options: ImportOptions) -> list[Draft]:
    """The one set."""
    tables = [p for name in TABLES if (p := source / "annotations" / name).is_file()]
    if not tables:
        return []
    digit = "digit" in "/".join(source.absolute().parts[-3:]).lower()
    draft = Draft("", "digit" if digit else "gelsight_mini", source)
    why = "since the folder's path does not say digit; --sensor names another"
    draft.assume_sensor("by the folder's path" if digit else why)
    draft.find_background(options, "blank_images/blank.png", "blank_images/blank.jpg")
    settings = source / "annotations" / "metadata.json"
    if settings.is_file():
        draft.used.add(settings)
        draft.set_ball(options.radius_mm or stated_number(settings, "probe_radius_mm"))
        draft.set_scale(options.mm_per_px_x or 1 / stated_number(settings, "px_per_mm"))
    elif options.mm_per_px_x is None or options.radius_mm is None:
        draft.notes.append(
            "annotations/metadata.json is missing; --mm-per-px-x and --radius-mm give what it "
            "states"
        )
    draft.notes.append("the travel of the probe is kept; circles are found in the images")
    draft.used.add(tables[0])
    for row in press_rows(tables[0], source / "probe_images", "img_name"):
        stage_mm = row.together("x_mm", "y_mm")
        depth_mm = row.first(*DEPTHS)
        draft.add_press(row.image, row.image.stem, depth_mm=depth_mm, stage_mm=stage_mm)
    for further in tables[1:]:
        draft.leave_out(further, f"{tables[0].name} is read instead")
    return [draft]
