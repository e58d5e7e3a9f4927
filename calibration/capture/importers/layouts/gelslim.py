# SPDX-License-Identifier: Apache-2.0
"""GelSlim 3.0 (mcubelab/gelslim): ref.jpg and sample_<n>.jpg, in any folder.

The ball is 7.6 mm across; ball and scale may differ between its sets.
"""

from pathlib import Path

from taccel_lab.calibration.capture.importers import Draft, ImportOptions, images_in

PUBLISHED = "that of calibration.py of mcubelab/gelslim, whatever the set"


def read(source: Path, options: ImportOptions) -> list[Draft]:
    """A set for each folder with presses and a background, or with presses where none has both."""
    pressed = sorted({image.parent for image in images_in(source, "**/sample_*")})
    folders = [folder for folder in pressed if images_in(folder, "ref.*")] or pressed
    drafts = []
    for folder in folders:
        draft = Draft(folder.name if len(folders) > 1 else "", "flat_pad", folder)
        draft.assume_sensor()
        draft.find_background(options, "ref.jpg", "ref.png")
        draft.set_ball(3.8, PUBLISHED)
        draft.set_scale(0.10577, why=PUBLISHED)
        draft.add_presses(images_in(folder, "sample_*"))
        drafts.append(draft)
    return drafts
