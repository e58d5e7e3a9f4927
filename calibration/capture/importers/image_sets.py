# SPDX-License-Identifier: Apache-2.0
"""Published sets of ball presses that are folders of images with a pattern in their names.

Radius of the ball and scale are those of each project's own scripts:

- GelSlim 3.0 (mcubelab/gelslim), ``calibration.py``: 7.6 mm across, 0.10577 mm/px; both may differ
  between its sets.
- ShapeMap3D for the GelSight Mini (RuihanGao), ``sensorParams.py``: R = 2.0 mm, 0.08 mm/px. Frame 0
  of the published set is a crop of the framing of the others, which ``capture check`` says.
- GelSight-Sim2Real (RVSATHU, RA-L 2022), ``depth_reconstruction``: R = 2.92 mm, 0.05926 mm/px.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from taccel_lab.calibration.capture.importers.background_guess import BACKGROUND_NAME
from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import images_in
from taccel_lab.calibration.capture.importers.label_tables import read_label_tables
from taccel_lab.calibration.capture.importers.layout import FALLBACK_SENSOR, Layout
from taccel_lab.errors import InputError


@dataclass(frozen=True)
class ImageSet:
    """How the images of a published set are named, and what is known of them."""

    name: str
    title: str
    published: str
    """Whose set it is, and where its ball and scale are stated."""
    presses: str
    """Pattern of the file names of presses."""
    backgrounds: tuple[str, ...]
    """Patterns of the untouched sensor's, the best first."""
    ball_radius_mm: float
    mm_per_px: float
    sensor: str = FALLBACK_SENSOR
    folder: str | None = None
    """Name of the folder that holds the images; any when None."""
    several: bool = False
    """Whether every folder below with a background and presses is a set of its own."""

    def layout(self) -> Layout:
        """The layout that reads such sets."""
        return Layout(
            self.name, self.title, lambda path: bool(self._places(path)), self._read, False
        )

    def _places(self, path: Path, with_background: bool = True) -> list[Path]:
        """Folders that hold a set; ``with_background``: of several, those that have one."""
        if not path.is_dir():
            return []
        if self.several:
            below = sorted(place for place in path.rglob("*") if place.is_dir())
            return [
                place
                for place in (path, *below)
                if any(place.glob(self.presses))
                and not (with_background and self._background(place) is None)
            ]
        if self.folder is not None:
            path = path / self.folder if (path / self.folder).is_dir() else path
            if path.name != self.folder:
                return []
        return [path] if any(path.glob(self.presses)) else []

    def _background(self, place: Path) -> Path | None:
        named = [found for pattern in self.backgrounds for found in sorted(place.glob(pattern))]
        return next((path for path in named if path.is_file()), None)

    def _read(self, path: Path, options: ImportOptions) -> list[Draft]:
        places = self._places(path) or self._places(path, with_background=False)
        if not places:
            raise InputError(f"{path} is not of the layout {self.name}: {self.title}")
        return [self._draft(place, len(places) > 1, options) for place in places]

    def _draft(self, place: Path, one_of_several: bool, options: ImportOptions) -> Draft:
        draft = Draft(place.name if one_of_several else "", self.sensor, place)
        draft.assume(
            "sensor",
            f"{self.sensor}, that of the published set"
            if self.sensor != FALLBACK_SENSOR
            else f"{FALLBACK_SENSOR}, which stands for any flat gel; --sensor names another",
        )
        images = images_in(place)
        background = self._background(place)
        if background is None:
            background = next((i for i in images if BACKGROUND_NAME.search(i.stem)), None)
        if background is not None:
            draft.set_background(background, f"{background.name}, by its name")
        elif options.background is None:
            draft.notes.append(
                f"no background: {self.backgrounds[0].replace('*', 'png')} is missing; give one "
                "with --background, or --background median for that of the presses"
            )
        draft.set_ball(self.ball_radius_mm, f"that of {self.published}, whatever the set")
        draft.set_scale(self.mm_per_px, why=f"that of {self.published}, whatever the set")
        presses = [image for image in images if image.match(self.presses) and image != background]
        labels = read_label_tables(place)
        circles = labels.of_images(presses)
        for image in presses:
            draft.add_press(image, contact=circles.get(image))
        labels.tell(draft, presses)
        return draft


SETS = (
    ImageSet(
        name="rvsathu",
        title="GelSight-Sim2Real: calib_<n>_real.png, background_real.png",
        published="depth_reconstruction of RVSATHU/GelSight-Sim2Real",
        presses="calib_*_real.*",
        backgrounds=("background_real.*",),
        ball_radius_mm=2.92,
        mm_per_px=0.05926,
    ),
    ImageSet(
        name="ruihangao",
        title="calib_ball/frame_<n>, frame 0 untouched",
        published="sensorParams.py of RuihanGao/16741-Proj-ShapeMap3D-GelSightMini",
        sensor="gelsight_mini",
        folder="calib_ball",
        presses="frame_*.*",
        backgrounds=("frame_0.*",),
        ball_radius_mm=2.0,
        mm_per_px=0.08,
    ),
    ImageSet(
        name="gelslim",
        title="GelSlim: ref.jpg and sample_<n>.jpg",
        published="calibration.py of mcubelab/gelslim",
        several=True,
        presses="sample_*.*",
        backgrounds=("ref.jpg", "ref.png"),
        ball_radius_mm=3.8,
        mm_per_px=0.10577,
    ),
)
