# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab force``: tactile images in, forces out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

if TYPE_CHECKING:
    import numpy as np

    from taccel_lab.signals.force_model import ForceReading


@dataclass(frozen=True)
class Force:
    """Read forces from tactile images with a profile that has a force model.

    Reads force and moment on the object in the gel frame (a press is +z), contact area and its
    middle, and the force by patch of the image, with standard deviations. With --out, `<name>.png`
    shows the patches of each image and `<name>.json` holds all of it. Images unlike the training
    (another sensor, deeper presses) are marked, and the exit code is 1. Images that cannot be read,
    or have another size, are listed with the reason. The others are still read, and the exit code
    is 2.
    """

    profile: Positional[Path]
    """Profile folder, from `taccel-lab calibrate force`."""
    images: Positional[tuple[Path, ...]]
    """Tactile images (PNG or JPEG) of the profile's size."""
    out: Path | None = None
    """Folder to write: two files per image. Default: none."""
    background: Path | None = None
    """Image of the untouched sensor, if newer than the profile's, or of another unit."""
    json: bool = False
    """Print the figures as JSON instead of lines per image."""

    def run(self) -> None:
        from taccel_lab.cli.each_image import each_image, require_images
        from taccel_lab.files.images import read_image
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.learning.force.read_force import ForceReader, write_force
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.profile import load_profile

        start_warp()
        if self.out is not None:
            require_replaceable(self.out)
        require_images(self.images)
        reader = ForceReader(
            load_profile(self.profile),
            background=None if self.background is None else read_image(self.background),
            background_name=str(self.background or "the background"),
            profile_name=str(self.profile),
        )

        def read(path: Path) -> tuple[ForceReading, np.ndarray]:
            image = read_image(path)
            return reader.read(image, str(path)), image

        def keep(
            found: tuple[ForceReading, np.ndarray], path: Path, folder: Path | None
        ) -> dict[str, Any]:
            if folder is not None:
                return write_force(*found, path, folder)
            return {"image": str(path), **found[0].figures()}

        figures = each_image(self.images, self.out, read, keep, as_json=self.json, lines=_lines)
        if not all(about["inside_training"] for about in figures.values()):
            raise SystemExit(1)


def _lines(path: Path, about: dict[str, Any]) -> list[str]:
    def components(letter: str, values: list[float], sigmas: list[float], unit: str) -> str:
        return ", ".join(
            f"{letter}{axis} {value:.3f} +- {sigma:.3f} {unit}"
            for axis, value, sigma in zip("xyz", values, sigmas, strict=True)
        )

    lines = [
        f"{path.name}: {components('F', about['force_n'], about['force_sigma_n'], 'N')}",
        f"  {components('T', about['moment_nmm'], about['moment_sigma_nmm'], 'N mm')}",
    ]
    area = f"  area {about['area_mm2']:.2f} +- {about['area_sigma_mm2']:.2f} mm2"
    if about["center_mm"] is None:
        area += "; no touch is detected"
    else:
        area += ", middle at ({:.2f}, {:.2f}) mm".format(*about["center_mm"])
    return [*lines, area, *(f"  outside the training: {reason}" for reason in about["outside"])]
