# SPDX-License-Identifier: Apache-2.0

"""Our bench: <unit>/pictures, <unit>/presses.csv with a row a press, <unit>/stage.json."""

from pathlib import Path

from taccel_lab.calibration.capture.importers import (
    Draft,
    ImportOptions,
    press_rows,
    stated_number,
)


def read(source: Path, options: ImportOptions) -> list[Draft]:
    """A set, and a capture folder, for each unit."""
    drafts = []
    for table in sorted(source.glob("*/presses.csv")):
        unit = table.parent
        draft = Draft(unit.name, "gelsight_mini", source, license="CC0-1.0")
        draft.manifest["unit"] = unit.name
        draft.find_background(options, f"{unit.name}/untouched.*", f"{unit.name}/bg.*")
        draft.set_scale(1 / stated_number(unit / "stage.json", "camera.px_per_mm"))
        draft.used |= {table, unit / "stage.json"}
        for row in press_rows(table, unit / "pictures", "file"):
            circle = row.together("x_px", "y_px", "r_px")
            keys = ("u_px", "v_px", "radius_px")
            draft.add_press(
                row.image,
                contact=dict(zip(keys, circle, strict=True)) if circle else None,
                depth_mm=row.first("travel_mm"),
                force_n=row.first("fz_n"),
                radius_mm=(row.first("ball_mm") or 0) / 2 or None,
            )
        drafts.append(draft)
    return drafts
