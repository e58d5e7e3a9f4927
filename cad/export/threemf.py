# SPDX-License-Identifier: Apache-2.0
"""3MF files for printing: named, coloured bodies with their unit."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Sequence
from pathlib import Path

from build123d import Color, Mesher, Unit

from taccel_lab.cad.parts.part import Part
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_by

DEVIATION_MM, ANGLE_RAD = 0.005, 0.06


def write_3mf(parts: Sequence[Part], path: Path) -> None:
    """Write parts, where they stand, as bodies of one 3MF file in millimetres.

    Bodies carry the names and colours of the parts; triangles keep within 0.005 mm of
    edges, on crowned faces within 0.03 mm.
    """
    mesher = Mesher(unit=Unit.MM)
    for part in parts:
        solid = copy.copy(part.solid)
        solid.label, solid.color = part.name, Color(*part.color)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                mesher.add_shape(solid, DEVIATION_MM, ANGLE_RAD, part_number=part.name)
            except (UserWarning, RuntimeError) as error:
                raise InputError(
                    f"{part.name}: the CAD kernel gives no closed triangles for 3MF ({error})"
                ) from error
    write_by(path, lambda file: mesher.write_stream(file, "3mf"))
