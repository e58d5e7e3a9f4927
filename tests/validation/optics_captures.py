# SPDX-License-Identifier: Apache-2.0
"""Real backgrounds and ball presses of catalogue sensors, for comparison with the optical model.

What is not there skips the test (``tests.support.real_data``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture import load_captures
from tests.support.real_data import real_data, taxim_presses


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
    presses: tuple[RealPress, ...] = ()
    press_mm_per_px: float | None = None
    """Scale of the presses where they are framed unlike the background."""


def classic_gelsight() -> RealSensor:
    """Taxim's calibration presses (MIT)."""
    captures = load_captures(taxim_presses())
    # Presses well inside the image, one in each part of it.
    chosen = [captures.presses[i] for i in (5, 20, 30, 40)]
    presses = []
    for press in chosen:
        assert press.circle is not None
        presses.append(
            RealPress(
                captures.background,
                press.image(),
                (press.circle.u_px, press.circle.v_px),
                press.circle.radius_px,
                captures.ball_radius_mm,
            )
        )
    return RealSensor("gelsight", captures.background, tuple(presses))


def gelsight_mini() -> RealSensor:
    """The Mini of R. Gao (NormalFlow, MIT)."""
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
    background = _read(real_data("gsmini_normalflow/examples/data/background.png"))
    return RealSensor(
        "gelsight_mini",
        background,
        tuple(inside[::6][:4]),
        press_mm_per_px=0.0815,  # The picture shows the 25.25 mm of the gel over 310 px.
    )


def ninedtact() -> RealSensor:
    """The official calibration press of 9DTact (MIT)."""
    folder = real_data("9dtact_official/shape_reconstruction/calibration/sensor_1")
    rest = _read(folder / "depth_calibration/rectify_crop_ref.png")
    image = _read(folder / "depth_calibration/rectify_crop_sample.png")
    u, v, radius = _find_dent(rest, image, 0.15)
    press = RealPress(rest, image, (u, v), radius, 4.0, thin_gel=True)
    return RealSensor("9dtact", rest, (press,))


def _read(path: Path) -> np.ndarray:
    import cv2

    image = cv2.imread(str(path))
    if image is None:
        raise FileNotFoundError(path)
    return np.ascontiguousarray(image[..., ::-1])


def _find_dent(
    background: np.ndarray, image: np.ndarray, threshold: float
) -> tuple[float, float, float]:
    """Centre and radius [px] of the largest change: pixels above a share of its peak."""
    import cv2

    change = np.abs(image.astype(np.float32) - background).sum(axis=2)
    change = cv2.GaussianBlur(change, (0, 0), 3)
    v, u = np.unravel_index(int(change.argmax()), change.shape)
    _, labels, stats, centroids = cv2.connectedComponentsWithStats(
        (change > threshold * change.max()).astype(np.uint8)
    )
    part = labels[v, u]
    radius = float(np.sqrt(stats[part, cv2.CC_STAT_AREA] / np.pi))
    return float(centroids[part][0]), float(centroids[part][1]), radius
