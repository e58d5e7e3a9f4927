# SPDX-License-Identifier: Apache-2.0
"""Where tests find real captures; a test whose captures are not there is skipped with the reason.

The PyPI wheel ``taxim`` comes with the extra ``demo``, so that its presses are there in continuous
integration; everything else lies in the data folder (``taccel_lab.exporters.published_meshes``).
"""

from __future__ import annotations

from pathlib import Path

import pytest

from taccel_lab.calibration.capture import find_taxim_pack
from taccel_lab.errors import InputError
from taccel_lab.exporters.published_meshes import data_folder


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
