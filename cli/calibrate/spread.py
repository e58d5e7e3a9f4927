# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate spread``: how far days and units differ, for domain randomisation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.cli.calibrate.base import BlockCommand, Fitted

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.progress import Progress


@dataclass(frozen=True)
class CalibrateSpread(BlockCommand):
    """Measure how much frames drift and units differ, for domain randomisation.

    The light of every frame (gain, offset, gradient) is fitted against the background; with
    --units the images at rest, scales and materials of other units of this design are compared
    too. The block ``perturbation`` holds the standard deviations;
    taccel_lab.signals.perturbation.draw_perturbation draws sensors from it.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml: its untouched images are compared, or else its presses."""
    units: tuple[Path, ...] = ()
    """Profiles of other units of the same design; the base counts as one when it is given."""

    def fit(self, folder: CaptureFolder, progress: Progress) -> Fitted:
        """Compare frames and units."""
        from taccel_lab.calibration.spread.fit import SpreadOptions, calibrate_spread
        from taccel_lab.calibration.spread.report import spread_page
        from taccel_lab.profile import load_profile

        base = self.profile_to_extend(folder)
        units = [load_profile(path) for path in self.units]
        if units and self.base is not None:
            units.insert(0, base)
        result = calibrate_spread(folder, base, SpreadOptions(tuple(units)), progress)
        return Fitted("spread", base, result, spread_page(result))
