# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate background``: the image of the untouched sensor, and what its light did"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from taccel_lab.cli.calibrate.base import BlockCommand, Fitted

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.progress import Progress


@dataclass(frozen=True)
class CalibrateBackground(BlockCommand):
    """Average all frames to a quieter background, the drift of each frame's light taken off.

    Uses the background, the further untouched images and the untouched parts of the presses; with
    no untouched image at all, the median of five or more presses. Reports the drift over the
    frames, whether the white balance was automatic, the noise of the pixels, and dust. Writes the
    block ``background``, and dust.png beside the report, which serves as the captures' mask.
    """

    def fit(self, folder: CaptureFolder, progress: Progress) -> Fitted:
        """Average the frames."""
        from taccel_lab.calibration.background.fit import calibrate_background
        from taccel_lab.calibration.background.report import background_page

        base = self.profile_to_extend(folder)
        result = calibrate_background(folder, base, progress)
        return Fitted("background", base, result, background_page(result))
