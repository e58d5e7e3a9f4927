# SPDX-License-Identifier: Apache-2.0
"""The force behind one tactile image of a sensor, markers found where its model sees them.

>>> reader = ForceReader(load_profile("my_mini_force"))                    # doctest: +SKIP
>>> found = reader.read(read_image("press.png"))                           # doctest: +SKIP
>>> found.force_n, found.sigma[:3], found.outside                          # doctest: +SKIP
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.markers.tracking import track_markers
from taccel_lab.errors import InputError, naming
from taccel_lab.files.atomic_file import write_json
from taccel_lab.learning.force.force_page import draw_forces
from taccel_lab.profile import SensorProfile
from taccel_lab.reading.dots.marker_picture import MarkerPicture, find_markers
from taccel_lab.reading.frame_judge import FrameJudge
from taccel_lab.reading.whole_frame import BrokenFrameError
from taccel_lab.report.style import ORANGE, in_report_style, new_figure, save_figure
from taccel_lab.signals.force_model import ForceModel, ForceReading

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MIN_SEEN = 0.5
"""Share of the markers at rest that an image has to show."""


class ForceReader:
    """Reads images of one sensor; what does not depend on the image is done once."""

    def __init__(
        self,
        profile: SensorProfile,
        *,
        background: np.ndarray | None = None,
        background_name: str = "the background",
        profile_name: str = "the profile",
    ) -> None:
        """A reader of the profile's images.

        Args:
            profile: With a block force.
            background: Untouched sensor instead of the profile's, RGB, shape [h, w, 3].
            background_name: How an error calls ``background``, such as by its file.
            profile_name: How an error calls ``profile``, such as by its folder.

        Raises:
            InputError: No force model, no background, or one of another size.
        """
        with naming(profile_name):
            self.model = ForceModel.from_profile(profile)
        self.background = profile.untouched(background, background_name)
        self.background_name = background_name
        self._judge = FrameJudge(self.background)

    def _require_size(self, image: np.ndarray, name: str) -> None:
        config = self.model.config
        if image.shape != (config.height_px, config.width_px, 3):
            raise InputError(
                f"{name} is {image.shape[1]}x{image.shape[0]} px, the profile's camera "
                f"{config.width_px}x{config.height_px} px; give images of that size"
            )

    @cached_property
    def markers_at_rest(self) -> MarkerPicture:
        """Dots of the background."""
        with naming(self.background_name):
            return find_markers(self.background)

    def read(self, image: np.ndarray, name: str = "image") -> ForceReading:
        """The force behind one image, RGB levels, shape [height_px, width_px, 3]."""
        self._require_size(image, name)
        frame = self._judge.frame(image)
        broken = frame.lost or frame.torn
        if broken is not None:
            raise BrokenFrameError(f"{name}: it {broken}")
        found = self._read(image, name)
        foreign = frame.foreign(frame.pressed)
        return replace(found, outside=(f"it {foreign}", *found.outside)) if foreign else found

    def _read(self, image: np.ndarray, name: str) -> ForceReading:
        if not self.model.config.markers:
            return self.model.read(image, self.background)
        with naming(name):
            tracks = track_markers([image], self.markers_at_rest)
            if (unread := tracks.unread.get(0)) is not None:
                raise InputError(f"it is {unread.words}: take it again; {unread.fault.advice}")
            seen = tracks.seen[0]
            if seen.mean() < MIN_SEEN:
                raise InputError(
                    f"only {int(seen.sum())} of {len(seen)} markers are seen; is it an image of "
                    "this sensor, near the light of the background?"
                )
        return self.model.read(
            image,
            self.background,
            (tracks.rest_px[seen], tracks.displacement_px[0][seen]),
        )


def write_force(
    found: ForceReading, image: np.ndarray, source: Path, folder: Path
) -> dict[str, Any]:
    """Write ``NAME.png`` and ``NAME.json`` into ``folder``; returns the figures."""
    figures = {"image": str(source), **found.figures()}
    save_figure(draw_reading(image, found, source.stem), folder / f"{source.stem}.png")
    write_json(folder / f"{source.stem}.json", figures)
    return figures


@in_report_style
def draw_reading(image: np.ndarray, found: ForceReading, title: str) -> Figure:
    """The image, and forces by patch."""
    figure, axes = new_figure(8.4, 4.2, 1, 2)
    axes[0].imshow(np.clip(image, 0, 255).astype(np.uint8))
    axes[0].set_title(title)
    top = max(float(found.patch_forces_n[..., 2].max()), 2 * float(found.sigma[2]), 1e-6)
    shown = draw_forces(axes[1], found.patch_forces_n, top)
    figure.colorbar(shown, ax=axes[1], shrink=0.8).set_label("force along z by patch [N]")
    force, sigma = found.force_n, found.sigma
    axes[1].set_title(
        f"Fx {force[0]:.2f} ± {sigma[0]:.2f}, Fy {force[1]:.2f} ± {sigma[1]:.2f}, "
        f"Fz {force[2]:.2f} ± {sigma[2]:.2f} N",
        fontsize=9.5,
    )
    if found.outside:
        axes[1].set_xlabel("outside what the model was trained on", color=ORANGE)
    for ax in axes:
        ax.set_xticks([])
        ax.set_yticks([])
    return figure
