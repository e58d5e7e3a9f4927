# SPDX-License-Identifier: Apache-2.0
"""Where tests find real captures; a test whose captures are not there is skipped with the reason.

The PyPI wheel ``taxim`` comes with the extra ``demo``, so that its presses are there in continuous
integration; everything else lies in the data folder (``taccel_lab.exporters.published_meshes``).
"""

from __future__ import annotations

import csv
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import CapturedPress, CaptureSet, ContactCircle, find_taxim_pack
from taccel_lab.errors import InputError
from taccel_lab.exporters.published_meshes import data_folder
from taccel_lab.files.images import read_image
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.geometry import PixelGrid


def real_data(name: str) -> Path:
    """A file or folder of the real captures, by its path below the data folder."""
    path = data_folder() / name
    if not path.exists():
        pytest.skip(f"{path} is not there; TACCEL_LAB_DATA names the folder of real captures")
    return path


def taxim_presses(sensor: str = "gelsight") -> Path:
    """The ``dataPack.npz`` of ball presses on one of taxim's sensors."""
    try:
        return find_taxim_pack().parents[1] / sensor / "dataPack.npz"
    except InputError as error:
        pytest.skip(f"the real presses are not there: {error}")


def labelled_presses(
    folder: str,
    labels: str,
    background: str,
    ball_mm: float,
    mm_per_px: float,
    largest_radii: float = np.inf,
) -> CaptureSet:
    """Ball presses of a set with the contacts that a person labelled, which reach
    ``largest_radii`` of the ball at most."""
    root = real_data(folder)
    with (root / labels).open(encoding="utf-8", newline="") as stream:
        rows = sorted(csv.DictReader(stream), key=lambda row: row["file"])
    presses = []
    for row in rows:
        path = root / row["file"]
        u_px, v_px, radius_px = (float(row[key]) for key in ("cx_px", "cy_px", "contact_r_px"))
        circle = ContactCircle(u_px, v_px, min(radius_px, largest_radii * ball_mm / mm_per_px))
        read = partial(read_image, path)
        presses.append(CapturedPress(path.stem, str(path), file_sha256(path), read, circle))
    image = read_image(root / background)
    height, width = image.shape[:2]
    return CaptureSet(
        folder, "gelsight", image, file_sha256(root / background), np.ones((height, width), bool),
        ball_mm, PixelGrid(width, height, mm_per_px, mm_per_px), tuple(presses), {},
    )  # fmt: skip
