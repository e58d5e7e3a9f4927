# SPDX-License-Identifier: Apache-2.0
"""A fisheye GelSight (Photon26/Gelsight_controller): fisheye/cam<n> chessboards, cam<n> presses.

The squares of its chessboard are of unknown size; its 0.0412 mm/px holds after its own
undistortion alone and is not taken.
"""

from pathlib import Path

from taccel_lab.calibration.capture.importers import (
    Draft,
    ImportOptions,
    board_entry,
    images_in,
)

PUBLISHED = "that of the published set (Photon26/Gelsight_controller)"


def read(source: Path, options: ImportOptions) -> list[Draft]:
    """A set a camera."""
    cameras = sorted(folder.name for folder in source.glob("fisheye/cam*"))
    return [_camera(source, name, len(cameras) > 1, options) for name in cameras]


def _camera(source: Path, name: str, several: bool, options: ImportOptions) -> Draft:
    draft = Draft(name if several else "", "flat_pad", source)
    draft.assume_sensor()
    views = images_in(source, f"fisheye/{name}/*")
    board = board_entry(options.board or "chessboard:6x6")
    if options.board is None:
        draft.assume("board", f"chessboard:6x6, {PUBLISHED}; its pitch is unknown")
    names = [draft.add_image(view, f"board_{view.stem}") for view in views]
    draft.manifest["boards"] = [board | {"images": names}]
    background = draft.find_background(options, f"{name}/0.*", why="by its number")
    draft.set_ball(5.5, PUBLISHED)
    numbered = [image for image in images_in(source, f"{name}/*") if image.stem.isdecimal()]
    presses = [image for image in numbered if image != background]
    draft.add_presses(presses, lambda image: f"press_{image.stem}")
    for path in sorted((source / name).glob("*")):
        if path not in draft.used:
            draft.leave_out(path, "its name is no number, so it need not show the ball")
    return draft
