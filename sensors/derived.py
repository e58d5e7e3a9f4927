# SPDX-License-Identifier: Apache-2.0
"""What follows from a sensor's parameters and is often needed: sizes, scales, counts."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from taccel_lab.cad.parts.pad import Pad
from taccel_lab.profile.optical_design import DesignedCamera
from taccel_lab.sensors.base import FamilyParameters, SensorFamily
from taccel_lab.sensors.parameter_groups.camera import CameraParameters


@dataclass(frozen=True)
class DerivedFigure:
    """One derived figure."""

    name: str
    value: float | int | str
    unit: str = ""

    def text(self) -> str:
        """Value and unit for people."""
        value = f"{self.value:.4g}" if isinstance(self.value, float) else str(self.value)
        return f"{value} {self.unit}".rstrip()


def derived_figures(parameters: FamilyParameters) -> list[DerivedFigure]:
    """Figures of gel, image, camera, lights, window, markers and housing, where there are any."""
    pad, grid = parameters.pad(), parameters.grid()
    size = np.ptp(pad.bounds_mm(), axis=0)
    figures = [
        DerivedFigure("pad", pad_words(pad)),
        DerivedFigure("pad size", size_words(pad), "mm"),
        DerivedFigure("gel under the apex", float(pad.thickness_mm), "mm"),
        DerivedFigure("gel volume", pad.volume_mm3(), "mm3"),
        DerivedFigure("layers", ", ".join(pad.layer_names)),
        DerivedFigure("image", f"{grid.width_px} x {grid.height_px}", "px"),
        DerivedFigure("scale", _pair(grid.mm_per_px_x, grid.mm_per_px_y), "mm/px"),
        DerivedFigure(
            "image shows",
            f"{grid.width_px * grid.mm_per_px_x:.4g} x {grid.height_px * grid.mm_per_px_y:.4g}",
            "mm",
        ),
        DerivedFigure("gel in the image", 100 * share_in_image(parameters), "% of its plan"),
    ]
    if views := parameters.views():
        figures.append(DerivedFigure("cameras", 1 + len(views)))
        shared = 100 * share_in_image(parameters, *views.values())
        figures.append(DerivedFigure("gel in all images", shared, "% of its plan"))
    design, markers, housing = parameters.optics(), parameters.markers(), parameters.housing()
    if design is not None:
        x, y = field_of_view_deg(design.camera)
        figures.append(DerivedFigure("field of view", f"{x:.1f} x {y:.1f}", "deg"))
        if isinstance(parameters, CameraParameters):
            figures.append(
                DerivedFigure(
                    "lens differs from the scale by", 100 * lens_difference(parameters), "%"
                )
            )
            figures.append(DerivedFigure("focal length", design.camera.fx_px, "px"))
            if parameters.pixel_pitch_um:
                raw = (parameters.raw_width_px, parameters.raw_height_px)
                x, y = (1e-3 * parameters.pixel_pitch_um * count for count in raw)
                figures.append(DerivedFigure("image sensor", f"{x:.4g} x {y:.4g}", "mm"))
        figures.append(DerivedFigure("LEDs", len(design.lights)))
        window = design.window
        if window is not None:
            across = f"{window.size_mm[0]:.4g} x {window.size_mm[1]:.4g}"
            figures.append(
                DerivedFigure(
                    "window", f"{window.shape} {across} x {window.thickness_mm:.4g}", "mm"
                )
            )
    if markers is not None:
        count = markers.rows * markers.columns
        figures.append(DerivedFigure("markers", f"{markers.columns} x {markers.rows} = {count}"))
    if housing is not None:
        figures.append(
            DerivedFigure("housing", " x ".join(f"{v:.4g}" for v in housing.size_mm), "mm")
        )
        depth = housing.size_mm[2] - housing.front_z_mm
        figures.append(DerivedFigure("depth in all", max(depth, float(size[2])), "mm"))
    return figures


def describe_sensor(parameters: FamilyParameters) -> dict[str, Any]:
    """Everything that the parameters build, ready for JSON."""
    pad = parameters.pad()
    design, markers, housing = parameters.optics(), parameters.markers(), parameters.housing()
    materials = zip(pad.layer_names, parameters.layer_materials(), strict=True)
    return {
        "derived": {
            f.name: {"value": f.value, "unit": f.unit} for f in derived_figures(parameters)
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
    return " x ".join(f"{v:.4g}" for v in np.ptp(pad.bounds_mm(), axis=0))


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


def _pair(x: float, y: float) -> str:
    return f"{x:.5g}" if x == y else f"{x:.5g} x {y:.5g}"
