# SPDX-License-Identifier: Apache-2.0
"""The optical model of catalogue sensors beside their captures: backgrounds and ball presses.

No light of these sensors is published, and the catalogue's lights were placed by such presses, so
these are no predictions: they hold that the model can look like the sensor, which a wrong side, a
flipped axis, lost refraction or a wrong slope of the shading would end. A press is the ball itself
inside its contact circle and an elastic half-space around it. What is not there skips the test
(``tests.support.real_data``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import load_captures
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
from tests.support.formula_model import formula_model, render_formula
from tests.support.real_data import real_data, taxim_presses

LONG_SIDE_PX = 240
BLUR = 0.02
"""Low-pass of backgrounds as a share of the long side."""
STEP_MM = 0.08


@dataclass(frozen=True)
class RealPress:
    """A ball press and the untouched image that goes with it."""

    background: np.ndarray
    image: np.ndarray
    center_px: tuple[float, float]
    radius_px: float
    ball_mm: float
    thin_gel: bool = False
    """Whether the gel is thin against the contact, so that nothing sinks around it."""


@dataclass(frozen=True)
class RealSensor:
    """Captures of one sensor of the catalogue, RGB."""

    family: str
    background: np.ndarray
    presses: Callable[[], tuple[RealPress, ...]]
    """Read where they are asked for."""
    press_mm_per_px: float | None = None
    """Scale of the presses where they are framed unlike the background."""


def classic_gelsight() -> RealSensor:
    """Taxim's calibration presses (MIT)."""
    captures = load_captures(taxim_presses())

    def presses() -> Iterator[RealPress]:
        """Well inside the image, one in each part of it."""
        for press in (captures.presses[i] for i in (5, 20, 30, 40)):
            assert press.circle is not None
            yield RealPress(
                captures.background,
                press.image(),
                (press.circle.u_px, press.circle.v_px),
                press.circle.radius_px,
                captures.ball_radius_mm,
            )

    return RealSensor("gelsight", captures.background, lambda: tuple(presses()))


def gelsight_mini() -> RealSensor:
    """The Mini of R. Gao (NormalFlow, MIT)."""
    background = _read(real_data("gsmini_normalflow/examples/data/background.png"))
    # The picture shows the 25.25 mm of the gel over 310 px.
    return RealSensor("gelsight_mini", background, _mini_presses, press_mm_per_px=0.0815)


def _mini_presses() -> tuple[RealPress, ...]:
    folder = real_data("gsmini_ruihangao_calib/calib_ball")
    files = sorted(folder.glob("frame_*.jpg"))
    frames = [_read(path) for path in files]
    rest = np.median(np.stack(frames), axis=0).astype(np.uint8)
    found = [(frame, _find_dent(rest, frame, 0.35)) for frame in frames]
    height, width = rest.shape[:2]
    inside = [
        RealPress(rest, frame, (u, v), 0.85 * radius, 2.0)
        for frame, (u, v, radius) in found
        if 0.22 * width < u < 0.78 * width and 0.25 * height < v < 0.75 * height
    ]
    return tuple(inside[::6][:4])


def ninedtact() -> RealSensor:
    """The official calibration press of 9DTact (MIT)."""
    folder = real_data("9dtact_official/shape_reconstruction/calibration/sensor_1")
    rest = _read(folder / "depth_calibration/rectify_crop_ref.png")
    image = _read(folder / "depth_calibration/rectify_crop_sample.png")
    u, v, radius = _find_dent(rest, image, 0.15)
    press = RealPress(rest, image, (u, v), radius, 4.0, thin_gel=True)
    return RealSensor("9dtact", rest, lambda: (press,))


def _read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    if image is None:
        raise FileNotFoundError(path)
    return np.ascontiguousarray(image[..., ::-1])


def _find_dent(
    background: np.ndarray, image: np.ndarray, threshold: float
) -> tuple[float, float, float]:
    """Centre and radius [px] of the largest change: pixels above a share of its peak."""
    change = np.abs(image.astype(np.float32) - background).sum(axis=2)
    change = cv2.GaussianBlur(change, (0, 0), 3)
    v, u = np.unravel_index(int(change.argmax()), change.shape)
    _, labels, stats, centroids = cv2.connectedComponentsWithStats(
        (change > threshold * change.max()).astype(np.uint8)
    )
    part = labels[v, u]
    radius = float(np.sqrt(stats[part, cv2.CC_STAT_AREA] / np.pi))
    return float(centroids[part][0]), float(centroids[part][1]), radius


@dataclass(frozen=True)
class Comparison:
    """Scores of one sensor's presses, and background and first press, real and of the model."""

    presses: tuple[PressMatch, ...]
    real: tuple[np.ndarray, np.ndarray]
    model: tuple[np.ndarray, np.ndarray]


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
        return formula_model(
            self.design,
            self.top,
            half_size_mm=self.half_mm,
            back_z_mm=self.back_z_mm,
            step_mm=STEP_MM,
            size_px=self.size_px,
            level=self.level,
        )


@cache
def compared(read: Callable[[], RealSensor]) -> Comparison:
    """Of one sensor."""
    sensor = read()
    presses = sensor.presses()
    bench = _bench(sensor, presses[0].background, sensor.press_mm_per_px)
    untouched = bench.model()
    preview = untouched.render()
    found = [_compare_press(bench, untouched, preview, press) for press in presses]
    real, model = found[0][1]
    return Comparison(tuple(match for match, _ in found), real, model)


def compared_backgrounds(sensor: RealSensor) -> BackgroundMatch:
    bench = _bench(sensor, sensor.background, None)
    real, rest = _resized(sensor.background, bench.size_px), bench.model().render()
    return compare_backgrounds(real, rest.rgb, rest.mask, blur_px=BLUR * max(bench.size_px))


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
            design, camera=replace(camera, fx_px=camera.fx_px * zoom, fy_px=camera.fy_px * zoom)
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
) -> tuple[PressMatch, tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]]:
    """Its score, and background and press, real and of the model."""
    scale = bench.size_px[0] / press.image.shape[1]
    u, v = (scale * (c + 0.5) - 0.5 for c in press.center_px)
    radius = scale * press.radius_px
    at = preview.points_mm[round(v), round(u)]
    beside = preview.points_mm[round(v), min(round(u) + 2, bench.size_px[0] - 1)]
    mm_per_px = float(np.linalg.norm(beside - at)) / 2
    contact = min(radius * mm_per_px, 0.98 * press.ball_mm)
    center = (float(at[0]), float(at[1]))
    top = pressed_top(bench.top, center, contact, press.ball_mm, thin=press.thin_gel)
    model = preview.rgb, render_formula(untouched, top, bench.half_mm, STEP_MM).rgb
    real = _resized(press.background, bench.size_px), _resized(press.image, bench.size_px)
    return compare_press(real, model, (u, v), radius), (real, model)


def _resized(image: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    return cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("read", "cosine", "contrast", "correlation"),
    [
        (classic_gelsight, 0.9, (0.7, 1.4), (0.9, 0.9, 0.85)),
        pytest.param(gelsight_mini, 0.85, (0.6, 1.5), (0.85, 0.85, 0.85), marks=pytest.mark.slow),
        (ninedtact, 0.95, (0.3, 2.0), (0.9, 0.9, 0.9)),
    ],
)
def test_ball_presses_turn_the_colours_of_the_real_ones(
    read: Callable[[], RealSensor],
    cosine: float,
    contrast: tuple[float, float],
    correlation: tuple[float, float, float],
) -> None:
    found = compared(read)
    assert np.mean([press.mean_cosine for press in found.presses]) > cosine
    strength = np.mean([press.contrast for press in found.presses])
    assert contrast[0] < strength < contrast[1]
    means = np.mean([press.correlation for press in found.presses], axis=0)
    assert (means > correlation).all()


@pytest.mark.thorough
def test_the_score_would_notice_lights_on_the_wrong_side() -> None:
    found, press = compared(classic_gelsight), classic_gelsight().presses()[0]
    scale = found.real[1].shape[1] / press.image.shape[1]
    circle = (scale * press.center_px[0], scale * press.center_px[1]), scale * press.radius_px
    right = compare_press(found.real, found.model, *circle)
    # Red and green in each other's place; half of the contrast.
    background, image = (picture[..., [1, 0, 2]] for picture in found.model)
    swapped = compare_press(found.real, (background, image), *circle)
    assert swapped.mean_cosine < right.mean_cosine - 0.5
    half = ((found.model[1].astype(int) + found.model[0]) // 2).astype(np.uint8)
    pale = compare_press(found.real, (found.model[0], half), *circle)
    assert pale.contrast == pytest.approx(0.5 * right.contrast, rel=0.05)


@pytest.mark.thorough
@pytest.mark.parametrize("read", [classic_gelsight, gelsight_mini])
def test_backgrounds_beat_one_colour(read: Callable[[], RealSensor]) -> None:
    background = compared_backgrounds(read())
    assert background.psnr_db > background.flat_psnr_db + 0.5
    assert min(background.correlation) > 0.3
