# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate depth``: ball presses on a grey sensor in, its depth curve out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.calibration.depth.options import DepthOptions
from taccel_lab.cli.calibrate.base import BlockCommand, Fitted

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.calibration.depth.result import DepthCalibration
    from taccel_lab.progress import Progress


@dataclass(frozen=True)
class CalibrateDepth(BlockCommand, DepthOptions):
    """Fit the depth of a grey sensor (9DTact) to ball presses and write a profile.

    Where such a gel is pressed it looks darker. The ball's shape gives the depth of every pixel
    inside a contact; a monotone curve from the drop of the grey level to the depth is fitted to
    them, with what left-out presses (or parts of a single one) say of it. Raw images of a lens
    that distorts should be rectified: give --maps. `taccel-lab depth` then reads height maps.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md): background and [[presses]]."""
    base: Path | None = None
    """Profile to extend; the catalogue's design of the captures' sensor when left out. Its camera
    gives the scale where the captures state none."""

    def fit(self, folder: CaptureFolder, progress: Progress) -> Fitted:
        """Fit the depth curve."""
        from taccel_lab.calibration.depth.fit import calibrate_depth
        from taccel_lab.calibration.depth.report import depth_page

        base = self.profile_to_extend(folder)
        result = calibrate_depth(folder, base, self, progress)
        page = depth_page(result)
        return Fitted("depth", base, result, page, partial(_print_summary, result))


def _print_summary(result: DepthCalibration, console: Console) -> None:
    console.print(
        f"depth up to {result.response.depth_mm[-1]:.2f} mm over "
        f"{result.response.drop_levels[-1]:.0f} levels: {result.headline()}",
    )
