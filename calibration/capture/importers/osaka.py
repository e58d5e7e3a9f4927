# SPDX-License-Identifier: Apache-2.0
"""A fisheye GelSight (Photon26/Gelsight_controller): ``fisheye`` chessboards, ``cam2`` presses.

Facts used: 6 x 6 inner corners, squares of unknown size; ball of R = 5.5 mm. Its 0.0412 mm/px holds
after its own undistortion only and is not taken.
"""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.importers.board_text import board_entry
from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import images_in
from taccel_lab.calibration.capture.importers.layout import FALLBACK_SENSOR, Layout

_PUBLISHED = "that of the published set (Photon26/Gelsight_controller)"
BALL_RADIUS_MM = 5.5
INNER_CORNERS = (6, 6)


def _boards(path: Path) -> list[Path]:
    return [place for place in sorted((path / "fisheye").glob("cam*")) if place.is_dir()]


def _recognises(path: Path) -> bool:
    return bool(_boards(path))


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    drafts = []
    cameras = _boards(path)
    for camera in cameras:
        draft = Draft(camera.name if len(cameras) > 1 else "", FALLBACK_SENSOR, path)
        draft.assume(
            "sensor", f"{FALLBACK_SENSOR}, which stands for any flat gel; --sensor names another"
        )
        names = [draft.add_image(image, f"board_{image.stem}") for image in images_in(camera)]
        if options.board is None:
            board = f"chessboard:{INNER_CORNERS[0]}x{INNER_CORNERS[1]}"
            draft.assume("board", f"{board}, {_PUBLISHED}; its pitch is unknown")
        else:
            board = options.board
        draft.manifest["boards"] = [board_entry(board) | {"images": names}]
        presses = path / camera.name
        if presses.is_dir():
            for image in images_in(presses):
                if image.stem == "0":
                    draft.set_background(image, f"{image.name}, by its number")
                elif image.stem.isdigit():
                    draft.add_press(image, f"press_{image.stem}")
                else:
                    draft.leave_out(image, "its name is no number, so it need not show the ball")
            draft.set_ball(BALL_RADIUS_MM, _PUBLISHED)
        drafts.append(draft)
    return drafts


LAYOUT = Layout("osaka", "fisheye/cam<n> chessboards and cam<n> presses", _recognises, _read)
