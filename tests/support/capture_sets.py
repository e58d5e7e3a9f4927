# SPDX-License-Identifier: Apache-2.0
"""Capture folders of made-up presses, sound or with one fault."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from taccel_lab.calibration.capture import CaptureFolder, ContactCircle, load_capture_folder
from tests.calibration.drawn.faults import quantise
from tests.support.analytic_surface import analytic_surface
from tests.support.synthetic_presses import GRID, flat_background, known_change

BALL_MM = 2.0
HEIGHT, WIDTH = GRID.height_px, GRID.width_px
_LAMPS_PX = ((150, 60), (45, 125), (45, -5))
_LAMP_LEVELS = 60.0


def gel() -> np.ndarray:
    """The untouched gel with lamps at its sides and a fixed fine texture, float levels."""
    texture = np.random.default_rng(5).normal(0, 3.0, (HEIGHT, WIDTH))
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    lamps = [
        _LAMP_LEVELS * np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / (2 * 55.0**2))
        for at in _LAMPS_PX
    ]
    return flat_background() * 0.7 + np.stack(lamps, axis=-1) + texture[..., None]


def press(circle: ContactCircle, ball_mm: float = BALL_MM) -> np.ndarray:
    """An image of one press, float levels without noise."""
    return gel() + 1.6 * known_change(analytic_surface(circle, GRID, ball_mm, decay_mm=0.6))


def spread_circles(count: int = 15, seed: int = 1) -> list[ContactCircle]:
    """Contacts all over the gel, of different sizes."""
    rng = np.random.default_rng(seed)
    places = [(u, v) for v in (26, 60, 94) for u in (26, 52, 80, 108, 134)]
    rng.shuffle(places)
    return [
        ContactCircle(
            float(u + rng.uniform(-3, 3)), float(v + rng.uniform(-3, 3)), float(rng.uniform(12, 17))
        )
        for u, v in (places * 2)[:count]
    ]


@dataclass
class CaptureMaker:
    """Images and manifest before they are written; a test spoils what it is about."""

    circles: list[ContactCircle] = field(default_factory=spread_circles)
    labelled: bool = True
    noise: float = 0.7
    background: np.ndarray = field(default_factory=gel)
    images: list[np.ndarray] = field(default_factory=list)
    labels: list[ContactCircle] = field(default_factory=list)
    extra: list[str] = field(default_factory=list)
    """Further lines of each press's entry."""
    sensor: str = "flat_pad"
    radius_mm: float | None = BALL_MM
    mm_per_px: float | None = GRID.mm_per_px_x
    tail: str = ""

    def __post_init__(self) -> None:
        self.images = self.images or [press(circle) for circle in self.circles]
        self.labels = self.labels or list(self.circles)
        self.extra = self.extra or [""] * len(self.circles)

    def change(self, which: Sequence[int], how: Callable[[np.ndarray], np.ndarray]) -> None:
        for i in which:
            self.images[i] = how(self.images[i])

    def write(self, folder: Path) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng(9)
        write_image(folder / "background.png", self._shot(self.background, rng))
        lines = ["schema_version = 2", f'sensor = "{self.sensor}"', 'background = "background.png"']
        if self.mm_per_px is not None:
            lines += [f"mm_per_px_x = {self.mm_per_px}", f"mm_per_px_y = {self.mm_per_px}"]
        if self.sensor == "flat_pad":
            lines += ["[design]", "thickness_mm = 4.0"]
        if self.radius_mm is not None:
            lines += ["[indenter]", f"radius_mm = {self.radius_mm}"]
        for i, (image, label) in enumerate(zip(self.images, self.labels, strict=True)):
            write_image(folder / f"p{i:02d}.png", self._shot(image, rng))
            lines += ["[[presses]]", f'image = "p{i:02d}.png"', self.extra[i]]
            if self.labelled:
                lines.append(
                    f"contact = {{ u_px = {label.u_px}, v_px = {label.v_px}, "
                    f"radius_px = {label.radius_px} }}"
                )
        (folder / "captures.toml").write_text("\n".join(lines) + "\n" + self.tail)
        return folder

    def load(self, folder: Path) -> CaptureFolder:
        return load_capture_folder(self.write(folder))

    def _shot(self, image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return quantise(image + rng.normal(0, self.noise, image.shape))


def write_image(path: Path, rgb: np.ndarray) -> None:
    # Not `imwrite`, which ends the process at a path that is not UTF-8.
    done, data = cv2.imencode(path.suffix, np.ascontiguousarray(rgb[..., ::-1]))
    assert done
    path.write_bytes(data.tobytes())


def edit_manifest(folder: Path, old: str, new: str) -> Path:
    """Replace what captures.toml says, which has to be there; the folder."""
    path = folder / "captures.toml"
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    return folder
