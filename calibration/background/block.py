# SPDX-License-Identifier: Apache-2.0
"""The untouched sensor."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from taccel_lab.calibration.background.options import BackgroundOptions
from taccel_lab.calibration.block import Block, BlockWords, Needs
from taccel_lab.calibration.needs import NO_BACKGROUND, balls_in_words, scale_sources
from taccel_lab.printable import counted

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.profile import SensorProfile


@dataclass(frozen=True, kw_only=True)
class BackgroundWords(BlockWords):
    """Average all frames to a quieter background, the drift of each frame's light taken off.

    Uses the background, the further untouched images and the untouched parts of the presses; with
    no untouched image at all, the median of five or more presses. Reports the drift over the
    frames, whether the white balance was automatic, the noise of the pixels, and dust. Writes the
    block ``background``, and dust.png beside the report, which serves as the captures' mask; of
    several frames the block ``perturbation``, too, from which
    taccel_lab.signals.perturbation.draw_perturbation draws sensors.
    """

    units: tuple[Path, ...] = ()
    """Profiles of other units of the same design, whose images at rest, scales and materials are
    compared, too; the base counts as one when it is given."""

    def options(self, base: SensorProfile | None) -> BackgroundOptions:
        from taccel_lab.profile import load_profile

        units = [load_profile(path) for path in self.units]
        if units and base is not None:
            units.insert(0, base)
        return BackgroundOptions(tuple(units))


def _needs(folder: CaptureFolder, _: bool | None) -> Needs:
    images = int(folder.background is not None) + len(folder.untouched)
    found = f"{counted(images, 'image')} of the untouched gel" if images else balls_in_words(folder)
    missing = NO_BACKGROUND if folder.background is None else _scale_for_size(folder)
    return Needs(found, missing)


def _scale_for_size(folder: CaptureFolder) -> str:
    """Need of a background of another size than the catalogue's images; empty for none."""
    from taccel_lab.sensors.registry import known_sensor

    family = known_sensor(folder.sensor)
    if family is None or folder.mm_per_px is not None or scale_sources(folder):
        return ""
    height, width = folder.require_background().image().shape[:2]
    designed = family.parameters().grid()
    if (designed.width_px, designed.height_px) == (width, height):
        return ""
    return (
        f"the scale (these images are {width}x{height} px, those of the catalogue's "
        f"{folder.sensor} {designed.width_px}x{designed.height_px} px), or a --base with a "
        "calibrated camera"
    )


BLOCK = Block(
    name="background",
    home=__name__,
    words=BackgroundWords,
    needs=_needs,
    fitted_by="fit:calibrate_background",
    shown_by="background_page:background_page",
    choices="options:BackgroundOptions",
    telling=2,
)
