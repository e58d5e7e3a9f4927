# SPDX-License-Identifier: Apache-2.0
"""What follows from a sensor's parameters and is often needed: sizes, scales, counts."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

import numpy as np

from taccel_lab.cad.parts.pad import Pad
from taccel_lab.profile.optical_design import DesignedCamera
from taccel_lab.sensors.base import FamilyParameters, SensorFamily
from taccel_lab.sensors.parameter_groups.camera import CameraParameters

Figure = float | int | str


def derived_figures(parameters: FamilyParameters) -> dict[str, tuple[Figure, str]]:
    """Figures of gel, image, camera, lights, window, markers and housing, where there are any: name
    -> value and unit."""
    pad, grid = parameters.pad(), parameters.grid()
    seen_mm = (grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y)
    figures: dict[str, tuple[Figure, str]] = {
        "pad": (pad_words(pad), ""),
        "pad size": (size_words(pad), "mm"),
        "gel under the apex": (float(pad.thickness_mm), "mm"),
        "gel volume": (pad.volume_mm3(), "mm3"),
        "layers": (", ".join(pad.layer_names), ""),
        "image": (f"{grid.width_px} x {grid.height_px}", "px"),
        "scale": (_pair(grid.mm_per_px_x, grid.mm_per_px_y), "mm/px"),
        "image shows": (_times(seen_mm), "mm"),
        "gel in the image": (100 * share_in_image(parameters), "% of its plan"),
    }
    if views := parameters.views():
        figures["cameras"] = (1 + len(views), "")
        shared = 100 * share_in_image(parameters, *views.values())
        figures["gel in all images"] = (shared, "% of its plan")
    design, markers, housing = parameters.optics(), parameters.markers(), parameters.housing()
    if design is not None:
        x, y = field_of_view_deg(design.camera)
        figures["field of view"] = (f"{x:.1f} x {y:.1f}", "deg")
        if isinstance(parameters, CameraParameters):
            figures["lens differs from the scale by"] = (100 * lens_difference(parameters), "%")
            figures["focal length"] = (design.camera.fx_px, "px")
            if parameters.pixel_pitch_um:
                raw = (parameters.raw_width_px, parameters.raw_height_px)
                pitch_mm = 1e-3 * parameters.pixel_pitch_um
                figures["image sensor"] = (_times([pitch_mm * count for count in raw]), "mm")
        figures["LEDs"] = (len(design.lights), "")
        window = design.window
        if window is not None:
            size = _times([*window.size_mm, window.thickness_mm])
            figures["window"] = (f"{window.shape} {size}", "mm")
    if markers is not None:
        count = markers.rows * markers.columns
        figures["markers"] = (f"{markers.columns} x {markers.rows} = {count}", "")
    if housing is not None:
        figures["housing"] = (_times(housing.size_mm), "mm")
        depth = max(housing.size_mm[2] - housing.front_z_mm, float(np.ptp(pad.bounds_mm()[:, 2])))
        figures["depth in all"] = (depth, "mm")
    return figures


def figure_text(value: Figure, unit: str) -> str:
    """Value and unit for people."""
    return (
        f"{value:.4g} {unit}".rstrip() if isinstance(value, float) else f"{value} {unit}".rstrip()
    )


def describe_sensor(parameters: FamilyParameters) -> dict[str, Any]:
    """Everything that the parameters build, ready for JSON."""
    pad = parameters.pad()
    design, markers, housing = parameters.optics(), parameters.markers(), parameters.housing()
    materials = zip(pad.layer_names, parameters.layer_materials(), strict=True)
    return {
        "derived": {
            name: {"value": value, "unit": unit}
            for name, (value, unit) in derived_figures(parameters).items()
        },
        "pad": {"type": type(pad).__name__, "values": pad.values(), "figures": pad.figures()},
        "layers": {name: asdict(material) for name, material in materials},
        "image": asdict(parameters.grid()),
        "optics": None if design is None else asdict(design),
        "views": {name: _view(seen) for name, seen in parameters.views().items()},
        "markers": None if markers is None else asdict(markers),
        "housing": None if housing is None else asdict(housing),
    }


def _view(parameters: FamilyParameters) -> dict[str, Any]:
    design = parameters.optics()
    return {
        "image": asdict(parameters.grid()),
        "camera": None if design is None else asdict(design.camera),
    }


def catalogue_row(family: SensorFamily) -> dict[str, str]:
    """What a list of the catalogue states of a family with its defaults."""
    parameters = family.parameters()
    pad, grid, markers = parameters.pad(), parameters.grid(), parameters.markers()
    materials = parameters.layer_materials()
    return {
        "title": family.title,
        "pad": pad_words(pad),
        "size_mm": size_words(pad),
        "image_px": f"{grid.width_px} x {grid.height_px}",
        "mm_per_px": f"{grid.mm_per_px_x:.4g}",
        "young_modulus_mpa": ", ".join(f"{m.young_modulus_pa / 1e6:.3g}" for m in materials),
        "markers": "none" if markers is None else f"{markers.columns} x {markers.rows}",
    }


def pad_words(pad: Pad) -> str:
    """Kind of the pad in words, from the name of its class."""
    return re.sub(r"(?<!^)(?=[A-Z])", " ", type(pad).__name__).lower()


def size_words(pad: Pad) -> str:
    """Extents of the pad [mm] in words."""
    return _times(np.ptp(pad.bounds_mm(), axis=0))


def share_in_image(parameters: FamilyParameters, *views: FamilyParameters) -> float:
    """Part of the gel's plan that the tactile image shows, 0..1; that of further ``views``, too."""
    pad = parameters.pad()
    xy = pad.plan_points_mm()
    gel = np.isfinite(pad.top_mm(xy))
    seen = gel.copy()
    for grid in (one.grid() for one in (parameters, *views)):
        uv, last = grid.pixel_from_gel(xy), np.array([grid.width_px, grid.height_px]) - 0.5
        seen &= ((uv >= -0.5) & (uv <= last)).all(axis=-1)
    return float(seen.sum() / gel.sum())


def field_of_view_deg(camera: DesignedCamera) -> tuple[float, float]:
    """Full angles that the image spans along x and y [deg], without distortion."""
    if camera.model == "fisheye":
        return (
            math.degrees(camera.width_px / camera.fx_px),
            math.degrees(camera.height_px / camera.fy_px),
        )
    return (
        2 * math.degrees(math.atan(camera.width_px / 2 / camera.fx_px)),
        2 * math.degrees(math.atan(camera.height_px / 2 / camera.fy_px)),
    )


def lens_difference(parameters: CameraParameters) -> float:
    """Share by which the scale of focal length and distance exceeds the image's: 0.01 is 1 %.

    The stated focal length stands beside a stated scale, whichever rules.
    """
    from_lens = parameters.apparent_distance_mm() / parameters.lens_px()
    return from_lens / parameters.mm_per_px - 1


def _times(lengths: Iterable[float]) -> str:
    return " x ".join(f"{length:.4g}" for length in lengths)


def _pair(x: float, y: float) -> str:
    return f"{x:.5g}" if x == y else f"{x:.5g} x {y:.5g}"
