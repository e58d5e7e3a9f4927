# SPDX-License-Identifier: Apache-2.0
"""FOTS (Zhao et al., RA-L 2024): mlp_calib/{gelsight,digit}, marker_calib/data."""

from pathlib import Path

from taccel_lab.calibration.capture.importers import (
    Draft,
    ImportOptions,
    images_in,
    read_label_tables,
)
from taccel_lab.files.table_file import read_table_text

PUBLISHED = "that of the published set: params.py and normal_to_rgb.yaml of Rancho-zhao/FOTS"
UNPROVEN = (
    "ball and scale of the DIGIT set are unproven (4.7 and 6.0 mm appear in its code); add "
    "[indenter] radius_mm and mm_per_px_x, mm_per_px_y where you know them"
)
NO_REST = (
    "the only frame is a press: its dots have moved by what marker_labels.csv says, and there is "
    "no picture of the gel at rest, so that calibrate markers refuses; give one as markers.rest"
)


def read(source: Path, options: ImportOptions) -> list[Draft]:
    """A set of presses a sensor, and the dots."""
    shadows = images_in(source, "shadow_calib/shadow_data/*")
    presses = {
        "gelsight": images_in(source, "mlp_calib/gelsight/*"),
        "digit": images_in(source, "mlp_calib/digit/*") + shadows,
    }
    everything = [image for images in presses.values() for image in images]
    labels = read_label_tables(source)
    circles = labels.of_images(everything)
    drafts = []
    for part, sensor, place in (
        ("gelsight", "gelsight_mini", "mlp_calib"),
        ("digit", "digit", "mlp_calib/scripts"),
    ):
        if not presses[part]:
            continue
        draft = Draft(part, sensor, source)
        draft.assume_sensor(f"that of the folder mlp_calib/{part} of the published set")
        further = f"assets/gel/{part}_bg.*"
        background = draft.find_background(options, f"{place}/0000.*", further)
        for image in images_in(source, further):
            if background not in (None, image):
                draft.add_untouched(image)
        if part == "gelsight":
            draft.set_ball(2.35, PUBLISHED)
            draft.set_scale(1 / 19.58, why=PUBLISHED)
        else:
            draft.notes.append(UNPROVEN)
        for image in presses[part]:
            draft.add_press(image, contact=circles.get(image))
        if part == "digit" and shadows:
            draft.assume(
                "presses", "images of shadow_calib/shadow_data are of the same sensor and ball"
            )
        drafts.append(draft)
    if drafts:
        drafts[0].tell_labels(labels, everything)
    return drafts + [_dots(source, frame) for frame in images_in(source, "marker_calib/data/*")[:1]]


def _dots(source: Path, frame: Path) -> Draft:
    draft = Draft("markers", "gelsight_mini", source)
    draft.assume_sensor("that of the published set (Rancho-zhao/FOTS)")
    markers = draft.manifest["markers"] = {"labels_image": draft.add_image(frame, "labelled")}
    table = frame.with_suffix(".csv")
    if table.is_file():
        draft.used.add(table)
        head, _, rows = read_table_text(table).partition("\n")
        names = {"Mx": "u_px", "My": "v_px", "dx": "du_px", "dy": "dv_px"}
        columns = [names.get(name.strip(), name.strip()) for name in head.split(",")]
        text = ",".join(columns) + "\n" + rows.rstrip("\n") + "\n"
        markers["labels"] = draft.add_text(text, "marker_labels.csv")
        draft.assume(
            "labels",
            f"{table.name} has the places of the dots without load and the way from there to where "
            f"{frame.name} shows them, that of the published set",
        )
        draft.notes.append(NO_REST)
    return draft
