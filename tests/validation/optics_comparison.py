# SPDX-License-Identifier: Apache-2.0
"""The optical model beside real sensors: backgrounds and ball presses of the catalogue.

No light of these sensors is published; the catalogue's lights were placed by the presses, so that
the figures say how far such a model reaches, not how it predicts an unknown sensor. A press is the
ball itself inside its contact circle and an elastic half-space around it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taccel_lab.optics.render import OpticalModel, PreviewImage
from taccel_lab.profile.optical_design import OpticalDesign
from taccel_lab.sensors.registry import sensor_family
from tests.optics.compare import (
    BackgroundMatch,
    PressMatch,
    compare_backgrounds,
    compare_press,
    pressed_top,
)
from tests.validation.optics_captures import RealPress, RealSensor

LONG_SIDE_PX = 240
BLUR = 0.02
"""Low-pass of backgrounds as a share of the long side."""
STEP_MM = 0.08


@dataclass(frozen=True)
class Comparison:
    """One sensor's scores and the pictures of its background and first press."""

    sensor: RealSensor
    background: BackgroundMatch
    presses: tuple[PressMatch, ...]
    real_background: np.ndarray
    model_background: np.ndarray
    real_press: np.ndarray | None
    model_press: np.ndarray | None


@dataclass(frozen=True)
class _Bench:
    """The model of one family at one framing."""

    design: OpticalDesign
    top: Any
    half_mm: tuple[float, float]
    back_z_mm: float
    size_px: tuple[int, int]

    level: tuple[float, float, float]
    """Medians of the real background: its exposure and white balance."""

    def model(self) -> OpticalModel:
        return OpticalModel.from_formula(
            self.design,
            self.top,
            half_size_mm=self.half_mm,
            back_z_mm=self.back_z_mm,
            step_mm=STEP_MM,
            size_px=self.size_px,
            level=self.level,
        )


def compare(sensor: RealSensor) -> Comparison:
    """Scores of one sensor."""
    bench = _bench(sensor, sensor.background, None)
    real = _resized(sensor.background, bench.size_px)
    rest = bench.model().render()
    background = compare_backgrounds(real, rest.rgb, rest.mask, blur_px=BLUR * max(bench.size_px))
    matches, pictures = [], []
    if sensor.presses:
        framed = _bench(sensor, sensor.presses[0].background, sensor.press_mm_per_px)
        untouched = framed.model()
        preview = untouched.render()
        for press in sensor.presses:
            match, picture = _compare_press(framed, untouched, preview, press)
            matches.append(match)
            pictures.append(picture)
    return Comparison(
        sensor=sensor,
        background=background,
        presses=tuple(matches),
        real_background=real,
        model_background=rest.rgb,
        real_press=pictures[0][0] if pictures else None,
        model_press=pictures[0][1] if pictures else None,
    )


def _bench(sensor: RealSensor, image: np.ndarray, mm_per_px: float | None) -> _Bench:
    parameters = sensor_family(sensor.family).parameters()
    design = parameters.optics()
    assert design is not None
    pad = parameters.pad()
    grid = parameters.grid()
    if mm_per_px is not None:
        zoom = grid.mm_per_px_x / mm_per_px
        camera = design.camera
        design = replace(
            design,
            camera=replace(camera, fx_px=camera.fx_px * zoom, fy_px=camera.fy_px * zoom),
        )
    low, high = pad.bounds_mm()
    half = np.maximum(np.abs(low[:2]), np.abs(high[:2]))
    height, width = image.shape[:2]
    medians = np.clip(np.median(image.reshape(-1, 3), axis=0), 1, 254).tolist()
    scale = LONG_SIDE_PX / max(height, width)
    return _Bench(
        design,
        pad.top_mm,
        (float(half[0]), float(half[1])),
        -pad.thickness_mm,
        (round(width * scale), round(height * scale)),
        (medians[0], medians[1], medians[2]),
    )


def _compare_press(
    bench: _Bench, untouched: OpticalModel, preview: PreviewImage, press: RealPress
) -> tuple[PressMatch, tuple[np.ndarray, np.ndarray]]:
    scale = bench.size_px[0] / press.image.shape[1]
    u, v = (scale * (c + 0.5) - 0.5 for c in press.center_px)
    radius = scale * press.radius_px
    at = preview.points_mm[round(v), round(u)]
    beside = preview.points_mm[round(v), min(round(u) + 2, bench.size_px[0] - 1)]
    mm_per_px = float(np.linalg.norm(beside - at)) / 2
    contact = min(radius * mm_per_px, 0.98 * press.ball_mm)
    center = (float(at[0]), float(at[1]))
    top = pressed_top(bench.top, center, contact, press.ball_mm, thin=press.thin_gel)
    model = untouched.render_formula(top).rgb
    real = tuple(_resized(image, bench.size_px) for image in (press.background, press.image))
    match = compare_press((real[0], real[1]), (preview.rgb, model), (u, v), radius)
    return match, (real[1], model)


def _resized(image: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    import cv2

    return cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)
