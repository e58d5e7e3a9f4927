# SPDX-License-Identifier: Apache-2.0
"""A CAD solid with another volume than its pad is refused, even where the kernel calls it valid."""

from __future__ import annotations

import pytest

from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.errors import InputError


def test_a_rim_that_the_kernel_leaves_out_is_noticed() -> None:
    """3.6 % too much gel: the face's radius is 24 m, and the rim falls by 1.5 mm."""
    pad = GelPad(
        length_x_mm=30.788743284948644,
        length_y_mm=32.71764397122602,
        corner_radius_mm=4.260061474251234,
        thickness_mm=4.255022618916337,
        crown_radius_y_mm=24264.26335531647,
        crown_pillow=0.9636708728449709,
        rim="arc",
        rim_mm=0.9967319403898857,
        wall_mm=2.781363584280929,
        rim_radius_mm=50.29238926713631,
        window_x_mm=13.854934478226891,
        window_y_mm=14.722939787051708,
    )
    with pytest.raises(InputError, match=r"mm3 where the pad has 416\d.\d mm3; use a smaller"):
        labelled_solid(pad)
