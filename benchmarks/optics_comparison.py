# SPDX-License-Identifier: Apache-2.0
"""The optical model beside real sensors: backgrounds and ball presses of the catalogue.

No light of these sensors is published; the catalogue's lights were placed by the presses, so that
the figures say how far such a model reaches, not how it predicts an unknown sensor. A press is the
ball itself inside its contact circle and an elastic half-space around it. Run from the repository
root:

    python -m taccel_lab.benchmarks.optics_comparison --out benchmarks/results
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.benchmarks.optics_captures import RealPress, RealSensor, real_sensors
from taccel_lab.optics.compare import (
    BackgroundMatch,
    PressMatch,
    compare_backgrounds,
    compare_press,
    pressed_top,
)
from taccel_lab.optics.render import OpticalModel, PreviewImage
from taccel_lab.output import atomic_file, write_json
from taccel_lab.profile.optical_design import OpticalDesign
from taccel_lab.sensors.registry import sensor_family

LONG_SIDE_PX = 240
BLUR = 0.02
"""Low-pass of backgrounds as a share of the long side."""
STEP_MM = 0.08


@dataclass(frozen=True)
class Comparison:
    """One sensor's scores and the pictures behind them."""

    sensor: RealSensor
    background: BackgroundMatch
    presses: tuple[PressMatch, ...]
    real_background: np.ndarray
    model_background: np.ndarray
    real_press: np.ndarray | None
    model_press: np.ndarray | None

    def to_json(self) -> dict[str, Any]:
        return {
            "family": self.sensor.family,
            "title": self.sensor.title,
            "licence": self.sensor.licence,
            "background": self.background.to_json(),
            "presses": [press.to_json() for press in self.presses],
        }


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


Picture = tuple[str, np.ndarray]


def _rows(comparisons: list[Comparison]) -> list[list[Picture]]:
    """Four titled pictures a row: background and press of a sensor, or two backgrounds."""
    rows: list[list[Picture]] = []
    alone: list[Picture] = []
    for item in comparisons:
        c = item.background.correlation
        pair = [
            (item.sensor.title, item.real_background),
            (f"model: r = {c[0]:.2f}, {c[1]:.2f}, {c[2]:.2f}", item.model_background),
        ]
        if item.real_press is None or item.model_press is None:
            alone += pair
            continue
        cosine = np.mean([press.mean_cosine for press in item.presses])
        contrast = np.mean([press.contrast for press in item.presses])
        title = f"model: cosine {cosine:.2f}, contrast {contrast:.2f}"
        rows.append([*pair, ("real press", item.real_press), (title, item.model_press)])
    return rows + [alone[i : i + 4] for i in range(0, len(alone), 4)]


def plot(comparisons: list[Comparison], path: Path) -> None:
    """Real and model side by side, one sensor a row; only what its licence lets be shown."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = _rows([c for c in comparisons if c.sensor.may_show])
    figure, axes = plt.subplots(
        len(rows), 4, figsize=(10.0, 2.05 * len(rows)), squeeze=False, layout="constrained"
    )
    for axis in axes.ravel():
        axis.set_axis_off()
    for row, pictures in zip(axes, rows, strict=True):
        for axis, (title, picture) in zip(row, pictures, strict=False):
            axis.imshow(picture)
            axis.set_title(title, fontsize=9)
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=85, format="png")
    plt.close(figure)


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for JSON and picture")
    options = parser.parse_args(arguments)
    comparisons = [compare(sensor) for sensor in real_sensors()]
    for item in comparisons:
        b, presses = item.background, item.presses
        line = f"{item.sensor.title}: background r {np.round(b.correlation, 2).tolist()}, PSNR "
        line += f"{b.psnr_db:.1f} dB (one colour {b.flat_psnr_db:.1f})"
        if presses:
            cosine = np.mean([press.mean_cosine for press in presses])
            correlation = np.mean([press.correlation for press in presses], axis=0)
            line += f"; {len(presses)} presses: colour cosine {cosine:.2f}, "
            contrast = np.mean([press.contrast for press in presses])
            line += f"r {np.round(correlation, 2).tolist()}, contrast {contrast:.2f}"
        print(line)
    write_json(options.out / "optics_comparison.json", [item.to_json() for item in comparisons])
    plot(comparisons, options.out / "optics_comparison.png")


if __name__ == "__main__":
    main()
