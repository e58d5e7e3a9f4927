# SPDX-License-Identifier: Apache-2.0
"""The optical model of catalogue sensors beside their captures: backgrounds and ball presses.

No light of these sensors is published, and the catalogue's lights were placed by such presses, so
these are no predictions: they hold that the model can look like the sensor, which a wrong side, a
flipped axis, lost refraction or a wrong slope of the shading would end. A press is the ball itself
inside its contact circle and an elastic half-space around it. What is not there skips the test
(``tests.support.real_data``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import load_captures
from taccel_lab.sensors.registry import sensor_family
from tests.optics.compare import compare_backgrounds, compare_press, pressed_top
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
    presses: Callable[[], Iterable[RealPress]]
    """Read where they are asked for."""
    press_mm_per_px: float | None = None
    """Scale of the presses where they are framed unlike the background."""


def classic_gelsight() -> RealSensor:
    """Taxim's calibration presses (MIT)."""
    captures = load_captures(taxim_presses())
    rest, ball_mm = captures.background, captures.ball_radius_mm

    def presses() -> Iterator[RealPress]:
        """Well inside the image, one in each part of it."""
        for press in (captures.presses[i] for i in (5, 20, 30, 40)):
            c = press.circle
            assert c is not None
            yield RealPress(rest, press.image(), (c.u_px, c.v_px), c.radius_px, ball_mm)

    return RealSensor("gelsight", rest, presses)


def gelsight_mini() -> RealSensor:
    """The Mini of R. Gao (NormalFlow, MIT)."""
    background = _read(real_data("gsmini_normalflow/examples/data/background.png"))
    # The picture shows the 25.25 mm of the gel over 310 px.
    return RealSensor("gelsight_mini", background, _mini_presses, press_mm_per_px=0.0815)


def _mini_presses() -> list[RealPress]:
    folder = real_data("gsmini_ruihangao_calib/calib_ball")
    frames = [_read(path) for path in sorted(folder.glob("frame_*.jpg"))]
    rest = np.median(np.stack(frames), axis=0).astype(np.uint8)
    height, width = rest.shape[:2]
    inside = [
        RealPress(rest, frame, (u, v), 0.85 * radius, 2.0)
        for frame, (u, v, radius) in ((frame, _find_dent(rest, frame, 0.35)) for frame in frames)
        if 0.22 * width < u < 0.78 * width and 0.25 * height < v < 0.75 * height
    ]
    return inside[::6][:4]


def ninedtact() -> RealSensor:
    """The official calibration press of 9DTact (MIT)."""
    folder = real_data("9dtact_official/shape_reconstruction/calibration/sensor_1")
    rest, image = (
        _read(folder / f"depth_calibration/rectify_crop_{name}.png") for name in ("ref", "sample")
    )
    u, v, radius = _find_dent(rest, image, 0.15)
    return RealSensor("9dtact", rest, lambda: [RealPress(rest, image, (u, v), radius, 4.0, True)])


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


class Bench:
    """The model of one family, framed and exposed as a real image."""

    def __init__(self, sensor: RealSensor, image: np.ndarray, mm_per_px: float | None) -> None:
        parameters = sensor_family(sensor.family).parameters()
        design, pad = parameters.optics(), parameters.pad()
        assert design is not None
        if mm_per_px is not None:
            zoom, camera = parameters.grid().mm_per_px_x / mm_per_px, design.camera
            camera = replace(camera, fx_px=camera.fx_px * zoom, fy_px=camera.fy_px * zoom)
            design = replace(design, camera=camera)
        half = np.abs(pad.bounds_mm()).max(axis=0)
        self.half_mm = float(half[0]), float(half[1])
        height, width = image.shape[:2]
        scale = LONG_SIDE_PX / max(height, width)
        self.size_px = round(width * scale), round(height * scale)
        red, green, blue = np.clip(np.median(image.reshape(-1, 3), axis=0), 1, 254).tolist()
        self.top = pad.top_mm
        self.model = formula_model(
            design, self.top, half_size_mm=self.half_mm, back_z_mm=-pad.thickness_mm,
            step_mm=STEP_MM, size_px=self.size_px, level=(red, green, blue),
        )  # fmt: skip
        self.rest = self.model.render()

    def resized(self, image: np.ndarray) -> np.ndarray:
        return cv2.resize(image, self.size_px, interpolation=cv2.INTER_AREA)

    def pair(self, press: RealPress) -> tuple[Pair, Pair, tuple[float, float], float]:
        """Background and press, real and of the model; centre and radius of the contact [px]."""
        scale = self.size_px[0] / press.image.shape[1]
        u, v = (scale * (c + 0.5) - 0.5 for c in press.center_px)
        radius = scale * press.radius_px
        at = self.rest.points_mm[round(v), round(u)]
        beside = self.rest.points_mm[round(v), min(round(u) + 2, self.size_px[0] - 1)]
        contact = min(radius * float(np.linalg.norm(beside - at)) / 2, 0.98 * press.ball_mm)
        center = (float(at[0]), float(at[1]))
        top = pressed_top(self.top, center, contact, press.ball_mm, thin=press.thin_gel)
        model = self.rest.rgb, render_formula(self.model, top, self.half_mm, STEP_MM).rgb
        return (self.resized(press.background), self.resized(press.image)), model, (u, v), radius


Pair = tuple[np.ndarray, np.ndarray]


@cache
def compared(read: Callable[[], RealSensor]) -> list[tuple[Pair, Pair, tuple[float, float], float]]:
    """Each press of a sensor."""
    sensor = read()
    presses = list(sensor.presses())
    bench = Bench(sensor, presses[0].background, sensor.press_mm_per_px)
    return [bench.pair(press) for press in presses]


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
    scores = [compare_press(*pair) for pair in compared(read)]
    assert np.mean([score.mean_cosine for score in scores]) > cosine
    assert contrast[0] < np.mean([score.contrast for score in scores]) < contrast[1]
    assert (np.mean([score.correlation for score in scores], axis=0) > correlation).all()


@pytest.mark.thorough
def test_the_score_would_notice_lights_on_the_wrong_side() -> None:
    real, model, *circle = compared(classic_gelsight)[0]
    right = compare_press(real, model, *circle)
    # Red and green in each other's place; half of the contrast.
    background, image = (picture[..., [1, 0, 2]] for picture in model)
    swapped = compare_press(real, (background, image), *circle)
    assert swapped.mean_cosine < right.mean_cosine - 0.5
    half = ((model[1].astype(int) + model[0]) // 2).astype(np.uint8)
    pale = compare_press(real, (model[0], half), *circle)
    assert pale.contrast == pytest.approx(0.5 * right.contrast, rel=0.05)


@pytest.mark.thorough
@pytest.mark.parametrize("read", [classic_gelsight, gelsight_mini])
def test_backgrounds_beat_one_colour(read: Callable[[], RealSensor]) -> None:
    sensor = read()
    bench = Bench(sensor, sensor.background, None)
    real, blur_px = bench.resized(sensor.background), BLUR * max(bench.size_px)
    background = compare_backgrounds(real, bench.rest.rgb, bench.rest.mask, blur_px=blur_px)
    assert background.psnr_db > background.flat_psnr_db + 0.5
    assert min(background.correlation) > 0.3
