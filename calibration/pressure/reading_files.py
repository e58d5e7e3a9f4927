# SPDX-License-Identifier: Apache-2.0
"""The touch that one image shows, as files: arrays, figures and a picture."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.calibration.pressure.touch import TouchReading, draw_reading
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_by, write_json
from taccel_lab.files.images import read_grey
from taccel_lab.profile import SensorProfile
from taccel_lab.report.style import save_figure

ARRAYS = (
    "height_m",
    "rise_m",
    "height_sigma_m",
    "reading_sigma_m",
    "normals",
    "sigma_deg",
    "radius95_deg",
    "beyond_balls",
    "saturated",
)
"""Arrays of a reading, as they are stored; those that its method does not give are left out."""


def read_mask(path: Path, profile: SensorProfile) -> np.ndarray:
    """Pixels that count, from a grey image of the profile's size, bool, shape [h, w].

    Raises:
        InputError: No image, another size, or no pixel that counts.
    """
    mask = read_grey(path) > 0
    expected = (profile.camera.height_px, profile.camera.width_px)
    if mask.shape != expected or not mask.any():
        raise InputError(
            f"{path} is {mask.shape[1]}x{mask.shape[0]} px with {int(mask.sum())} "
            f"usable pixels; {expected[1]}x{expected[0]} px and some non-zero ones needed"
        )
    return mask


def write_reading(
    found: TouchReading, image: np.ndarray, source: Path, folder: Path, stem: str = ""
) -> dict[str, Any]:
    """Write ``NAME.npz``, ``NAME.png`` and ``NAME.json`` into ``folder``; returns the figures.

    ``image`` is what was read, RGB levels; it came from the file ``source``, whose name is taken
    where there is no ``stem``.
    """
    stem = stem or source.stem
    stored: dict[str, Any] = {}
    for key in ARRAYS:
        value = getattr(found, key)
        if value is not None:
            stored[key] = value if value.dtype == bool else value.astype(np.float32)
    if found.press is not None:
        stored["pressure_pa"] = found.pressure_pa.astype(np.float32)
    write_by(folder / f"{stem}.npz", partial(np.savez_compressed, **stored))
    save_figure(draw_reading(found, image, stem), folder / f"{stem}.png")
    figures = {"image": str(source), **found.figures()}
    write_json(folder / f"{stem}.json", figures)
    return figures
