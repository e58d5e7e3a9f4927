# SPDX-License-Identifier: Apache-2.0
"""A capture folder of tiny synthetic ball presses, and a small profile."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.background import fit as background_fit
from taccel_lab.calibration.background.background_page import background_page
from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.profile import (
    BackgroundBlock,
    CameraBlock,
    ColorBlock,
    Provenance,
    SensorProfile,
    save_profile,
)
from taccel_lab.progress import Progress
from taccel_lab.sensors.profile import catalogue_profile
from tests.support.analytic_surface import analytic_surface

GRID = PixelGrid(96, 72, 0.1, 0.08)
"""Oblong: a contact's circle is wider in rows than in columns."""
BALL_MM = 2.0
CIRCLES = (
    ContactCircle(30.0, 30.0, 10.0),
    ContactCircle(62.0, 28.0, 12.0),
    ContactCircle(33.0, 44.0, 11.0),
    ContactCircle(60.0, 43.0, 10.5),
    ContactCircle(47.0, 36.0, 12.5),
)


def color_change(surface: BallSurface) -> np.ndarray:
    """Three lamps at 120 degrees, and some darkening with depth."""
    slope = surface.normals - surface.rest_normals
    angles = 2 * np.pi * np.arange(3) / 3
    tilt = slope[..., :1] * np.cos(angles) + slope[..., 1:2] * np.sin(angles)
    return 70 * tilt + 12 * surface.displacement_mm()[..., None]


def background() -> np.ndarray:
    u, v = np.meshgrid(np.linspace(0, 1, GRID.width_px), np.linspace(0, 1, GRID.height_px))
    return np.rint(np.stack([100 + 20 * u, 120 - 10 * v, 110 + 5 * u], axis=-1)).astype(np.uint8)


def write_image(path: Path, rgb: np.ndarray) -> None:
    assert cv2.imwrite(str(path), np.ascontiguousarray(rgb[..., ::-1]))


def write_captures(folder: Path) -> Path:
    """Five labelled presses on disk; returns the folder."""
    rng = np.random.default_rng(3)
    folder.mkdir(parents=True)
    lines = [
        "schema_version = 1",
        'sensor = "gelsight"',
        'background = "background.png"',
        f"mm_per_px_x = {GRID.mm_per_px_x}",
        f"mm_per_px_y = {GRID.mm_per_px_y}",
        'source = "made up for a test"',
        "[indenter]",
        f"radius_mm = {BALL_MM}",
    ]
    write_image(folder / "background.png", background())
    for i, circle in enumerate(CIRCLES):
        surface = analytic_surface(circle, GRID, BALL_MM, decay_mm=1.0)
        image = background() + color_change(surface)
        image += rng.normal(0, 0.7, image.shape)
        write_image(folder / f"p{i}.png", np.clip(np.rint(image), 0, 255).astype(np.uint8))
        lines += [
            "[[presses]]",
            f'image = "p{i}.png"',
            f"contact = {{ u_px = {circle.u_px}, v_px = {circle.v_px}, "
            f"radius_px = {circle.radius_px} }}",
        ]
    (folder / "captures.toml").write_text("\n".join(lines) + "\n")
    return folder


def write_profile(folder: Path, *, color: bool = True) -> Path:
    """The catalogue's GelSight with a small image, and a colour model of random weights."""
    made_up = Provenance(kind="assumed", method="made up for a test", source="none")
    profile = catalogue_profile("gelsight").with_block(CameraBlock.from_grid(GRID, made_up))
    if color:
        config = ColorModelConfig(GRID.width_px, GRID.height_px, hidden=(8,))
        rng = np.random.default_rng(0)
        weights = {
            name: rng.normal(size=shape).astype(np.float32)
            for name, shape in config.weight_shapes().items()
        }
        profile = profile.with_block(BackgroundBlock(provenance=made_up), background())
        profile = profile.with_block(
            ColorBlock(architecture=config.to_dict(), provenance=made_up), weights
        )
    save_profile(profile, folder)
    return folder


def everything_below(folder: Path) -> dict[str, bytes | None]:
    """Contents of every file below ``folder``, hidden ones too; None for folders."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def never(*_: object, **__: object) -> NoReturn:
    """Stands in for work that must not begin."""
    raise AssertionError("work began although the input is bad")


def fit_colors_as_backgrounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the block of colours fit, in no time, what that of the background does."""
    fit = background_fit.calibrate_background

    def quick(folder: CaptureFolder, base: SensorProfile, _: Any, progress: Progress) -> Any:
        return fit(folder, base, background_fit.BackgroundOptions(), progress)

    monkeypatch.setattr("taccel_lab.calibration.color.fit.calibrate_color", quick)
    monkeypatch.setattr("taccel_lab.calibration.color.color_page.color_page", background_page)
