# SPDX-License-Identifier: Apache-2.0
"""One door to the structured meshers of domes, even or fine around a contact."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from taccel_lab.cad.mesh.contact_plan import ContactOutline
from taccel_lab.cad.mesh.dome_shell import even_shell_mesh, focused_shell_mesh
from taccel_lab.cad.mesh.dome_solid import even_solid_mesh, focused_solid_mesh
from taccel_lab.cad.mesh.structured_plan import Focus
from taccel_lab.cad.mesh.tet_smoothing import improve_worst_tets
from taccel_lab.cad.parts.dome_pad import DomePad, ShellDomePad, SolidDomePad
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh

MIN_FOCUS_EDGE_MM = 1.5
"""Least distance along the cap between a contact and the cap's edge [mm]."""
_EVEN_DEG, _FOCUSED_DEG = 11.5, 3.0
_POWERS = (4, 8, 16, 16, 16)
_CORES, _RINGS, _LAYERS = (4, 64), (10, 128), (1, 64)


def even_dome_mesh(pad: DomePad, edge_mm: float = 1.0) -> TetMesh:
    """Mesh of ``pad`` whose cells on the contact face are about ``edge_mm`` large."""
    if isinstance(pad, ShellDomePad):
        return _improved(even_shell_mesh(pad, edge_mm), _EVEN_DEG)
    if isinstance(pad, SolidDomePad):
        return _improved(even_solid_mesh(pad, edge_mm), _EVEN_DEG)
    raise InputError(f"no structured mesher for {type(pad).__name__}; use the mesher tetwild")


def focused_dome_mesh(
    pad: DomePad,
    *,
    focus_mm: tuple[float, float],
    focus_radius_mm: float = 2.0,
    focus_size_mm: float = 0.25,
    core: int = 12,
    rings: int = 28,
    layers: int = 4,
    outlines: tuple[ContactOutline, ContactOutline] | None = None,
    layer_ratio: float = 1.5,
) -> TetMesh:
    """Mesh of ``pad``, fine around gel xy ``focus_mm``, of the same connectivity anywhere.

    Cells are about ``focus_size_mm`` large within ``focus_radius_mm`` and grow outside. With
    ``outlines`` at the contact face and at the back, in the plane that touches the cap there, rings
    follow those instead, see ``contact_plan``, and layers grow from the uppermost by
    ``layer_ratio`` or more. ``core``,
    ``rings`` (both even) and ``layers`` alone set the connectivity, with what the pad has: a wall,
    a glued part of it, a window.
    """
    for name, value, (low, high) in (
        ("core", core, _CORES),
        ("rings", rings, _RINGS),
        ("layers", layers, _LAYERS),
    ):
        if not isinstance(value, int) or not low <= value <= high:
            raise InputError(f"{name} = {value!r} is not allowed; use a whole number {low}..{high}")
    if core % 2 or rings % 2:
        raise InputError(f"core = {core} and rings = {rings} must both be even")
    focus = _checked_focus(pad, focus_mm, focus_radius_mm, focus_size_mm)
    counts = {"core": core, "rings": rings, "layers": layers, "layer_ratio": layer_ratio}
    if isinstance(pad, ShellDomePad):
        mesh = focused_shell_mesh(pad, focus, outlines, **counts)
    elif isinstance(pad, SolidDomePad):
        mesh = focused_solid_mesh(pad, focus, outlines, **counts)
    else:
        raise InputError(f"no focused mesher for {type(pad).__name__}")
    return _improved(mesh, _FOCUSED_DEG)


def _improved(mesh: TetMesh, wanted_deg: float) -> TetMesh:
    """The mesh with inner nodes moved where tets are flatter than wanted; the surface stays."""
    nodes = mesh.nodes_m * 1e3
    inner = np.setdiff1d(np.arange(mesh.node_count), mesh.faces)
    moved = improve_worst_tets(nodes, mesh.tets, inner, wanted_deg=wanted_deg, powers=_POWERS)
    return replace(mesh, nodes_m=moved * 1e-3)


def _checked_focus(
    pad: DomePad, center_mm: tuple[float, float], radius_mm: float, size_mm: float
) -> Focus:
    center = np.asarray(center_mm, dtype=np.float64)
    if center.shape != (2,) or not np.isfinite(center).all():
        raise InputError(f"focus_mm = {center_mm!r} is not a pair of numbers (x, y) in mm")
    away = float(np.hypot(*center))
    arc = pad.arc_to_edge_mm(center)
    if away > pad.cap_radius_mm or arc < MIN_FOCUS_EDGE_MM:
        reach = pad.dome_radius_mm * math.sin(
            pad.cap_angle - MIN_FOCUS_EDGE_MM / pad.dome_radius_mm
        )
        raise InputError(
            f"focus_mm = ({center[0]:g}, {center[1]:g}) lies {away:.3f} mm from the axis; allowed: "
            f"up to {reach:.3f} mm, {MIN_FOCUS_EDGE_MM:g} mm inside the edge of the contact face"
        )
    for name, value, low, high in (
        ("focus_radius_mm", radius_mm, 0.05, pad.cap_radius_mm),
        ("focus_size_mm", size_mm, 0.01, radius_mm),
    ):
        if not (math.isfinite(value) and low <= value <= high):
            raise InputError(f"{name} = {value!r} is not allowed; use {low:g} to {high:g}")
    return Focus((float(center[0]), float(center[1])), float(radius_mm), float(size_mm))
