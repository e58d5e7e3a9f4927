# SPDX-License-Identifier: Apache-2.0
"""Synthetic ball presses with a known colour law, and a small profile to put results in."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import CapturedPress, CaptureSet, ContactCircle
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.color.fit import fit_color
from taccel_lab.calibration.color.result import ColorCalibration
from taccel_lab.calibration.response.frame import FittedPresses, HeldoutSet, PressFrame
from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.profile import SensorProfile
from tests.support.analytic_surface import analytic_surface
from tests.support.sample_blocks import bare_profile

GRID = PixelGrid(160, 120, 0.1, 0.1)
BALL_RADIUS_MM = 2.0


def known_change(surface: BallSurface) -> np.ndarray:
    """Three lamps at 120 degrees whose strength falls over the image, plus a depth term."""
    slope = surface.normals - surface.rest_normals
    u = np.linspace(0.8, 1.2, GRID.width_px)[None, :]
    channels = []
    for k in range(3):
        angle = 2 * np.pi * k / 3
        tilt = slope[..., 0] * np.cos(angle) + slope[..., 1] * np.sin(angle)
        channels.append(60 * u * tilt - 10 * surface.displacement_mm())
    return np.stack(channels, axis=-1)


def flat_background() -> np.ndarray:
    u, v = np.meshgrid(np.linspace(0, 1, GRID.width_px), np.linspace(0, 1, GRID.height_px))
    return np.stack([100 + 20 * u, 120 - 10 * v, 110 + 10 * u * v], axis=-1)


def press_image(
    circle: ContactCircle,
    rng: np.random.Generator,
    noise: float = 1.0,
    ball_mm: float = BALL_RADIUS_MM,
) -> tuple[np.ndarray, BallSurface]:
    """A noisy capture of one press, RGB uint8, with the surface that made it."""
    surface = analytic_surface(circle, GRID, ball_mm, decay_mm=1.0)
    image = flat_background() + known_change(surface)
    image += rng.normal(0, noise, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), surface


def memory_captures(
    circles: Sequence[ContactCircle | None],
    images: Sequence[np.ndarray],
    background: np.ndarray,
    grid: PixelGrid,
    ball_mm: float,
    sensor: str = "gelsight",
) -> CaptureSet:
    """A capture set of images in memory, levels of any type."""
    presses = tuple(
        CapturedPress(f"p{i}", f"memory[{i}]", f"{i:064x}", partial(np.copy, image), circle)
        for i, (circle, image) in enumerate(zip(circles, images, strict=True))
    )
    mask = np.ones(background.shape[:2], dtype=bool)
    return CaptureSet("memory", sensor, background, "0" * 64, mask, ball_mm, grid, presses, {})


def synthetic_captures(
    count: int = 12,
    seed: int = 0,
    noise: float = 1.0,
    radii_px: tuple[float, float] = (11, 16),
    ball_mm: float = BALL_RADIUS_MM,
) -> tuple[CaptureSet, list[BallSurface]]:
    """A capture set in memory, and the true surface of each press."""
    rng = np.random.default_rng(seed)
    circles, images, surfaces = [], [], []
    margin = max(35.0, radii_px[1] + 2)
    for _ in range(count):
        circle = ContactCircle(
            float(rng.uniform(margin, GRID.width_px - margin)),
            float(rng.uniform(margin, GRID.height_px - margin)),
            float(rng.uniform(*radii_px)),
        )
        image, surface = press_image(circle, rng, noise, ball_mm)
        circles.append(circle)
        images.append(image)
        surfaces.append(surface)
    background = np.rint(flat_background()).astype(np.uint8)
    return memory_captures(circles, images, background, GRID, ball_mm), surfaces


def write_folder(
    path: Path,
    background: np.ndarray,
    images: Mapping[str, np.ndarray],
    circles: Mapping[str, ContactCircle],
    ball_mm: float = BALL_RADIUS_MM,
    grid: PixelGrid = GRID,
    sensor: str = "gelsight",
) -> Path:
    """A capture folder of ball presses, those of ``circles`` labelled; returns it."""
    path.mkdir(parents=True)
    lines = [
        "schema_version = 2",
        f'sensor = "{sensor}"',
        'background = "background.png"',
        f"mm_per_px_x = {grid.mm_per_px_x}",
        f"mm_per_px_y = {grid.mm_per_px_y}",
        "[indenter]",
        f"radius_mm = {ball_mm}",
    ]
    cv2.imwrite(str(path / "background.png"), background[..., ::-1])
    for name, image in images.items():
        cv2.imwrite(str(path / f"{name}.png"), image[..., ::-1])
        lines += ["[[presses]]", f'image = "{name}.png"']
        if name in circles:
            c = circles[name]
            lines.append(
                f"contact = {{ u_px = {c.u_px}, v_px = {c.v_px}, radius_px = {c.radius_px} }}"
            )
    (path / "captures.toml").write_text("\n".join(lines))
    return path


def write_captures(path: Path, captures: CaptureSet, unlabelled: Container[str] = ()) -> Path:
    """The same of captures in memory, labels of some left out."""
    images = {press.name: press.image() for press in captures.presses}
    circles = {
        press.name: press.circle
        for press in captures.presses
        if press.circle is not None and press.name not in unlabelled
    }
    return write_folder(path, captures.background, images, circles, captures.ball_radius_mm)


def circles_of(captures: CaptureSet) -> list[ContactCircle]:
    """Labels of the presses that have one."""
    return [press.circle for press in captures.presses if press.circle is not None]


def frames_of(captures: CaptureSet, surfaces: Sequence[BallSurface]) -> list[PressFrame]:
    """Labelled presses as the fits take them."""
    return [
        PressFrame(press.name, press.image(), press.circle, surface, press.sha256)
        for press, surface in zip(captures.presses, surfaces, strict=True)
        if press.circle is not None
    ]


def true_surface(circle: ContactCircle, ball_mm: float) -> BallSurface:
    """The surface that a press in this circle has."""
    return analytic_surface(circle, GRID, ball_mm, decay_mm=1.0)


def calibrated(
    captures: CaptureSet,
    surfaces: Sequence[BallSurface],
    *,
    holdout_every: int = 4,
    heldout_names: tuple[str, ...] | None = None,
    **more: Any,
) -> ColorCalibration:
    """``fit_color`` with the labels as circles, the rest of the presses held out."""
    if heldout_names is not None:
        captures = replace(captures, heldout=heldout_names)
    split = captures.split(holdout_every)
    training = captures.only(split.train)
    known, held = [surfaces[i] for i in split.train], HeldoutSet.of(captures, split, true_surface)
    return fit_color(FittedPresses(training, circles_of(training), known, held), **more)


def with_images(
    captures: CaptureSet, images: Mapping[int, np.ndarray] | Sequence[np.ndarray], **changes: Any
) -> CaptureSet:
    """Some presses, or all, with other images; ``changes`` of the set beside."""
    by_place = dict(images.items() if isinstance(images, Mapping) else enumerate(images))
    presses = list(captures.presses)
    for i, image in by_place.items():
        presses[i] = replace(presses[i], read=partial(np.copy, image))
    return replace(captures, presses=tuple(presses), **changes)


def with_circles(
    captures: CaptureSet,
    circles: Mapping[int, ContactCircle | None] | Sequence[ContactCircle | None],
    **changes: Any,
) -> CaptureSet:
    """The same with other labels."""
    by_place = dict(circles.items() if isinstance(circles, Mapping) else enumerate(circles))
    presses = list(captures.presses)
    for i, circle in by_place.items():
        presses[i] = replace(presses[i], circle=circle)
    return replace(captures, presses=tuple(presses), **changes)


def without_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits go without the check of the captures, whose findings other tests look at."""
    monkeypatch.setattr("taccel_lab.calibration.ball_presses.capture_findings", lambda *_: [])
    monkeypatch.setattr(
        "taccel_lab.calibration.ball_presses.capture_check",
        lambda *_: SimpleNamespace(rejected_labels=frozenset()),
    )


def _wide(nodes_m: np.ndarray, grid: PixelGrid) -> np.ndarray:
    """The corner of a gel of 1 mm, 12 mm wide or as far as half of a wider image."""
    half_mm = np.array([np.ptp(grid.x_mm()), np.ptp(grid.y_mm()), 0.0]) / 2
    return nodes_m * np.maximum(half_mm, [12.0, 12.0, 1.0])


def tiny_profile(grid: PixelGrid) -> SensorProfile:
    """A profile of one tet, without background and colour."""
    tets = np.array([[0, 2, 1, 3]])
    nodes = _wide(np.array([[0, 0, 0], [1, 0, -1], [0, 1, -1], [0, 0, -1]]) * 1e-3, grid)
    faces = boundary_faces(tets)
    return bare_profile(TetMesh(nodes, tets, faces, np.arange(4)), grid)


def flat_profile(grid: PixelGrid, thickness_mm: float = 1.0) -> SensorProfile:
    """A profile of one tet whose contact face is flat, without background and colour."""
    nodes = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -thickness_mm]]) * 1e-3
    nodes = _wide(nodes, grid)
    tets = np.array([[0, 2, 1, 3]])
    faces = boundary_faces(tets)
    up = (nodes[faces][..., 2] == 0).all(axis=1)
    mesh, tiny = TetMesh(nodes, tets, faces, np.where(up, 1, 2)), tiny_profile(grid)
    return replace(tiny, mesh=mesh, gel=tiny.gel.model_copy(update={"thickness_mm": thickness_mm}))
