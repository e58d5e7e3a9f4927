# SPDX-License-Identifier: Apache-2.0
"""The mesh of a sensor's gel for one press: fine around the contact, one connectivity for all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cad.mesh.gel_mesh import FocusOptions, focused_gel_mesh
from cad.mesh.structured_plan import MIN_SQUEEZE
from sensors.registry import sensor_family
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.press_mesh_options import DEFAULT_PRESS_MESH, PressMeshOptions

LARGEST_LAYER_RATIO = 4.0
"""Thickest layer over the one above it."""
LARGEST_CONTACT_MM = 4.0
"""Half width of the largest contact that a mesh is graded for."""
LEAST_CONTACT_MM = 0.05


def press_mesh(
    family: str,
    parameters: Mapping[str, Any],
    at_mm: tuple[float, float],
    contact_mm: float | tuple[float, float],
    options: PressMeshOptions = DEFAULT_PRESS_MESH,
) -> TetMesh:
    """Gel pad of a catalogue sensor, graded around the contact at gel xy ``at_mm``.

    ``contact_mm`` is the contact's radius, or its half widths along gel x and y, see
    ``Indenter.contact_half_mm``. All meshes of the same options share tets, faces and regions
    bitwise, whatever the place. Raises InputError for an unknown family or a place too close to
    the pad's edge.
    """
    found = sensor_family(family)
    pad = found.pad(found.parameters(parameters))
    return focused_gel_mesh(pad, press_focus(at_mm, contact_mm, pad.thickness_mm, options))


def press_focus(
    at_mm: tuple[float, float],
    contact_mm: float | tuple[float, float],
    thickness_mm: float,
    options: PressMeshOptions,
) -> FocusOptions:
    """Where and how finely a pad of some thickness [mm] is meshed for a contact."""
    if not (np.asarray(contact_mm) > 0).all():
        raise InputError(f"contact_mm must be half widths above 0 mm, got {contact_mm}")
    half = np.clip(np.broadcast_to(contact_mm, (2,)), LEAST_CONTACT_MM, LARGEST_CONTACT_MM)
    largest, least = float(half.max()), float(half.min())
    x, y = (float(v) for v in np.maximum(half / largest, MIN_SQUEEZE))
    return FocusOptions(
        at_mm=at_mm,
        radius_mm=options.fine_radii * largest,
        size_mm=largest / options.elements_per_radius,
        core=options.core,
        rings=options.rings,
        layers=options.layers,
        layer_ratio=_layer_ratio(options.layers, options.top_layer * least / thickness_mm),
        squeeze=(x, y),
    )


def _layer_ratio(layers: int, top_share: float) -> float:
    """Ratio of layers the uppermost of which is ``top_share`` of the whole, between 1 and
    ``LARGEST_LAYER_RATIO``."""
    low, high = 1.0, LARGEST_LAYER_RATIO
    for _ in range(40):
        ratio = 0.5 * (low + high)
        share = 1 / sum(ratio**k for k in range(layers))
        low, high = (ratio, high) if share > top_share else (low, ratio)
    return low
