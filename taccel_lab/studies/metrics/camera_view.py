# SPDX-License-Identifier: Apache-2.0
"""What the camera of a design sees: photometric figures, and how a press changes its picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.studies.metrics.design_point import NoFigure
from taccel_lab.studies.presses.press_record import PressRecord

if TYPE_CHECKING:
    from taccel_lab.optics.photometry import Photometry
    from taccel_lab.optics.render import OpticalModel
    from taccel_lab.sensors.base import FamilyParameters

VIEW_PX = 240
"""Longer side of the pictures that figures are read from."""
_DENTED = 0.1
"""Part of the largest dent from which a pixel counts as dented."""


def view_model(
    parameters: FamilyParameters,
    record: PressRecord | None = None,
    *,
    size_px: int = VIEW_PX,
    enlarged: bool = False,
    markers: bool = True,
    device: str = "cpu",
) -> OpticalModel:
    """Optical model of a design, on the mesh of a press or on the even mesh of its pad, with its
    markers or without; pictures of ``size_px`` along the longer side, finer than the camera's own
    pixels only when ``enlarged``.

    Raises InputError for a family without optics.
    """
    from taccel_lab.cad.mesh.gel_mesh import gel_mesh
    from taccel_lab.optics.render import OpticalModel

    design = parameters.optics()
    if design is None:
        raise InputError("the family has no optical model")
    size = design.camera.size_within(size_px, enlarged=enlarged)
    mesh = gel_mesh(parameters.pad()) if record is None else record.mesh
    dots = parameters.markers() if markers else None
    return OpticalModel(design, mesh, size_px=size, markers=dots, device=device)


def photometry(parameters: FamilyParameters, device: str = "cpu") -> Photometry:
    """Photometric figures of the untouched gel, without its markers."""
    from taccel_lab.optics.photometry import measure_photometry

    return measure_photometry(view_model(parameters, markers=False, device=device))


def picture_change(model: OpticalModel, record: PressRecord, steps: list[int]) -> np.ndarray:
    """Mean change of the grey levels (of 255, mean of the channels) where a press dents the gel.

    Over the pixels whose point of the face lies deeper by at least a tenth of the deepest; [step].
    Raises NoFigure where the camera sees nothing of the dent.
    """
    rest = model.render(record.rest_m)
    changes = []
    for step in steps:
        pressed = model.render(record.positions_m(step))
        deeper = _along(record, rest.points_mm) - _along(record, pressed.points_mm)
        seen = rest.mask & pressed.mask & np.isfinite(deeper)
        dented = seen & (deeper >= _DENTED * np.max(deeper, where=seen, initial=0.0))
        if not (dented.any() and deeper[dented].max() > 0):
            raise NoFigure("the camera sees nothing of the press")
        levels = np.abs(pressed.rgb[dented].astype(float) - rest.rgb[dented]).mean(axis=-1)
        changes.append(float(levels.mean()))
    return np.array(changes)


def _along(record: PressRecord, points_mm: np.ndarray) -> np.ndarray:
    """Heights of points along the press [mm], [..., 3] -> [...]."""
    return record.in_press(points_mm.astype(np.float64) * 1e-3)[..., 2] * 1e3
