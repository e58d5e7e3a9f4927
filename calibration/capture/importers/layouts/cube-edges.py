# SPDX-License-Identifier: Apache-2.0
"""Presses of a 10 mm cube's edge (jonaszilke/gs_sdk): <n>/gelsight.png with label.npz."""

from pathlib import Path

from taccel_lab.calibration.capture.importers import (
    Draft,
    ImportOptions,
    images_in,
    label_numbers,
)

WORDS = ("line_center", "line_length", "line_angle")
KEYS = ("u_px", "v_px", "length_px", "angle_deg")


def read(source: Path, options: ImportOptions) -> list[Draft]:
    """The one set, with the line of each edge."""
    draft = Draft("", "gelsight_mini", source)
    draft.assume_sensor("that of the published set (jonaszilke/gs_sdk)")
    draft.find_background(options, "background.png", "background.jpg")
    draft.assume("edge_mm", "10 mm, that of the published cube; --edge-mm gives another")
    edges = draft.manifest["edges"] = []
    for image in images_in(source, "*/gelsight.png", "*/digit.png"):
        label = image.with_name("label.npz")
        draft.used.add(label)
        name = draft.add_image(image, f"edge_{image.parent.name}")
        line = label_numbers(label, WORDS, KEYS)
        edges.append({"image": name, "length_mm": options.edge_mm or 10.0, "line": line})
    for image in images_in(source, "*/labeled.png"):
        draft.leave_out(image, "a drawing of the label")
    return [draft] if edges else []
