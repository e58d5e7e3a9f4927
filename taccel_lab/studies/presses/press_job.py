# SPDX-License-Identifier: Apache-2.0
"""One press of one design, ready to simulate, and a key that is equal where the result is.

A quasi-static press at given depths depends on the ratios of the layers' moduli alone: contact
stiffness, elastic forces and friction all scale with Young's modulus, so that positions stay and
forces scale. Jobs therefore hold no modulus; density has no effect at all.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.presses import normal_frame, parse_indenter
from taccel_lab.sensors.base import FamilyParameters
from taccel_lab.sensors.press_mesh import pad_press_mesh
from taccel_lab.studies.presses.standard import StandardPress

DEEPEST = 0.8
"""Deepest press as a part of the gel's thickness; ``depth_fraction`` ends there, too."""


@dataclass(frozen=True, eq=False)
class PressJob:
    """One indenter in one place on one gel."""

    press: StandardPress
    indenter: str
    place: tuple[float, float]
    """Place as in ``StandardPress.places``."""
    mesh: TetMesh
    gel_from_press: np.ndarray
    """Origin on the contact face, z along its normal, [7]."""
    modulus_ratios: tuple[float, ...]
    """Young's modulus of each layer over that of layer 0."""
    poisson_ratios: tuple[float, ...]
    friction: float

    @cached_property
    def _path(self) -> str:
        """What moves how, and the meshes' connectivity apart."""
        p = self.press
        path = [dataclasses.astuple(point) for point in p.waypoints()]
        rule = [p.depth_fraction, p.depth_mm, min(p.depth_limit_mm, 1e3), p.shear_fraction]
        physics = p.physics.record()
        return json.dumps([self.indenter, path, rule, p.twist_deg, self.friction, physics])

    @cached_property
    def batch_key(self) -> str:
        """Equal for jobs that can be environments of one batch."""
        digest = hashlib.sha256(self._path.encode())
        digest.update(json.dumps([self.modulus_ratios, self.poisson_ratios]).encode())
        for array in (self.mesh.tets, self.mesh.faces, self.mesh.face_regions):
            digest.update(array.tobytes())
        digest.update(self.mesh.tet_layers.tobytes())
        return digest.hexdigest()

    @cached_property
    def key(self) -> str:
        """Equal for jobs whose results are, up to the modulus."""
        digest = hashlib.sha256(self.batch_key.encode())
        digest.update(self.mesh.nodes_m.tobytes())
        digest.update(self.gel_from_press.tobytes())
        return digest.hexdigest()


def press_jobs(press: StandardPress, parameters: FamilyParameters) -> list[PressJob]:
    """The simulations of a standard press on a design: each indenter in each place.

    Raises InputError for a place beside the pad or too near to its edge to be meshed, and for a
    depth of which the gel would leave nothing.
    """
    pad, grid = parameters.pad(), parameters.grid()
    layers = parameters.layer_materials()
    jobs = []
    depth_mm, deepest_mm = press.full_depth_mm(pad.thickness_mm), DEEPEST * pad.thickness_mm
    if depth_mm > deepest_mm:
        raise InputError(
            f"{depth_mm:.3g} mm is too deep for a gel of {pad.thickness_mm:.3g} mm; at most "
            f"{deepest_mm:.3g} mm, or depth_fraction in place of depth_mm"
        )
    for text in press.indenters:
        contact = parse_indenter(text).contact(depth_mm)
        for place in press.places:
            at = place_mm(grid, place)
            jobs.append(
                PressJob(
                    press=press,
                    indenter=text,
                    place=place,
                    mesh=pad_press_mesh(pad, at, contact, press.physics.mesh),
                    gel_from_press=_frame(pad, at),
                    modulus_ratios=tuple(
                        m.young_modulus_pa / layers[0].young_modulus_pa for m in layers
                    ),
                    poisson_ratios=tuple(m.poisson_ratio for m in layers),
                    friction=layers[-1].friction_coefficient,
                )
            )
    return jobs


def place_mm(grid: PixelGrid, place: tuple[float, float]) -> tuple[float, float]:
    """Gel xy [mm] of a place in parts of half of the camera's view; (0, 0) is its centre."""
    half = 0.5 * np.array([grid.width_px - 1, grid.height_px - 1])
    x, y = grid.gel_from_pixel(half + half * np.array(place))
    return float(x), float(y)


def _frame(pad: Pad, at_mm: tuple[float, float]) -> np.ndarray:
    xy = np.array(at_mm)
    top, normal = float(pad.top_mm(xy)), pad.top_normal(xy)
    if not (math.isfinite(top) and np.isfinite(normal).all()):
        raise InputError(f"({at_mm[0]:.3g}, {at_mm[1]:.3g}) mm lies beside the contact face")
    return normal_frame(np.append(xy, top) * 1e-3, normal)
