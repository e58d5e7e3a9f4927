# SPDX-License-Identifier: Apache-2.0
"""Synthetic presses: random tools in a bonded layer, seen through the fitted colours.

A calibration with balls shows a sensor one curvature and no edge; a network that saw nothing else
reads a wall of 48 degrees as one of 16. So it also trains on tools of every kind: their surfaces
are those of the sensor's own pad, their pictures those of its colour model, with the noise, the
uneven colours and the blur that the captures show.

Tools are balls and eggs, rollers, wedges, cones, punches with sharp and rounded edges, gratings,
knobs, rough faces and cube corners, one to three side by side, turned and leaning. Sizes are drawn
between fine details and the whole view; ``reach_mm``, half of the view's shorter side, is the unit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import binary_dilation, gaussian_filter

from taccel_lab.calibration.circles.ball_surface import slope_of
from taccel_lab.calibration.normals.samples import KnownPress, NormalSamples
from taccel_lab.calibration.press_options import UNTOUCHED_RADII
from taccel_lab.calibration.response.frame import CaptureScene, PressFrame
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.processes.ahead import ahead
from taccel_lab.progress import Progress, counted, silent
from taccel_lab.reading.bonded_layer import FAR_MM, BondedLayer, press_in_view
from taccel_lab.reading.features import color_change, image_features
from taccel_lab.reading.windows import blurred
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.normals import normals_from_slopes, rotate_to_z, slopes_from_height

TASK = "drawing synthetic presses"
DEPTHS = (0.1, 1.3)
"""Depths over that of the deepest ball; drawn so that all orders of size are as frequent. Who
presses something else on a sensor presses about as hard as he did balls.
"""
LEAST, MOST = 0.03, 0.3
"""Shares of the thickness of the gel: depths begin at the first at the latest, and end at the
second. Networks that train on deeper tools read shallow ones half as far off again, and deep ones
no better (``docs/evidence/ablations.md``)."""
SOLVED_TO = 2e-2
"""Share of the depth that presses are solved to: heights are then within 0.8 um (rms), slopes in
the mean within 0.07 degrees."""
STILL_MM, STILL_SLOPE = 0.01, 0.0035
"""Gel that moved and leans by less, a fifth of a degree, keeps its colour: it would change by less
than the noise, and that is half of the image."""
SEEN_PX = 1.0
"""What a network is asked for is the surface as a camera sees it, smoothed by this much: the slope
of a vertical wall has no bound, its height has."""
MAX_BLUR_PX = 1.0
"""Images are blurred by up to this much, since no two lenses are focused alike."""
SMOOTH_NOISE_PX = 8.0
"""Noise is white up to here, beyond it is uneven light."""
DENT_MM = 0.02
"""Heights below this belong to the dent."""
PRESSED_RAD = np.radians(4.0)
BESIDE_PX = 8
PRESSED_SHARE = 0.75
"""Share of the pixels drawn where the surface leans by more than that, or so near to it."""
UNEVEN_PX = 30.0
"""Distance over about which colours are off together, in the model's light and in its colours."""
Tool = Callable[[np.random.Generator, np.ndarray, np.ndarray, float], np.ndarray]
"""(rng, x, y, reach_mm) -> height of the underside [mm], ``FAR_MM`` where there is none."""
LEAN = 0.15
"""Largest slope of a tool that leans; every second one does."""
SIDE_BY_SIDE = (1, 1, 1, 2, 3)


@dataclass(frozen=True)
class DrawnNoise:
    """Random numbers of one image's noise."""

    blur_px: float
    colors: np.ndarray
    """Numbers of uneven colours, shape [row, column, 3]."""
    light: np.ndarray
    """Numbers of uneven light, likewise."""
    white: np.ndarray
    """Number of each pixel, shape [h, w, 3]."""


@dataclass(frozen=True)
class DrawnPress:
    """Random numbers of one press."""

    depth_mm: float
    tool_mm: np.ndarray
    """Height of the tool over its lowest point, shape [h, w]."""
    noise: DrawnNoise


@dataclass(frozen=True)
class ImageNoise:
    """How captures differ from their model's pictures."""

    white_levels: float
    """Standard deviation of each pixel by itself [levels]."""
    uneven_levels: float
    """Standard deviation of what neighbours share on untouched gel [levels]."""
    uneven_share: float
    """Standard deviation of what they share in a contact, over the change of colour there."""

    @classmethod
    def of(
        cls, frames: Sequence[PressFrame], scene: CaptureScene, colors: ColorModel
    ) -> ImageNoise:
        """Noise from the presses that are fitted; ``colors`` was fitted to them too."""
        white, uneven, left, change = [], [], [], []
        for frame in frames:
            untouched = frame.circle.far(scene.grid, UNTOUCHED_RADII, scene.usable)
            if untouched.any():
                off = np.where(untouched[..., None], frame.image - scene.background, 0.0)
                cover = gaussian_filter(untouched.astype(float), SMOOTH_NOISE_PX)
                smooth = gaussian_filter(off, (SMOOTH_NOISE_PX, SMOOTH_NOISE_PX, 0))
                smooth /= np.maximum(cover, 1e-3)[..., None]
                uneven.append(np.mean(smooth[untouched] ** 2))
                white.append(np.mean((off - smooth)[untouched] ** 2))
            inside, surface = scene.inside(frame.circle), frame.surface
            drawn = colors.predict_pixels(
                np.flatnonzero(inside),
                surface.normals[inside],
                surface.displacement_mm()[inside],
                surface.rest_normals[inside],
            )
            seen = (frame.image - scene.background)[inside]
            left.append(np.mean((seen - drawn) ** 2))
            change.append(np.mean(drawn**2))
        flat = float(np.mean(white) + np.mean(uneven)) if white else 0.0
        more = max(float(np.mean(left)) - flat, 0.0)
        return cls(
            float(np.sqrt(np.mean(white))) if white else 1.0,
            float(np.sqrt(np.mean(uneven))) if uneven else 0.0,
            float(np.sqrt(more / max(float(np.mean(change)), 1e-9))),
        )

    def draw(self, shape: tuple[int, ...], rng: np.random.Generator) -> DrawnNoise:
        """Noise of the next image, of shape [h, w, 3]."""
        blur_px = rng.uniform(0.0, MAX_BLUR_PX)
        colors, light = _coarse(rng, shape), _coarse(rng, shape)
        return DrawnNoise(blur_px, colors, light, rng.standard_normal(shape, dtype=np.float32))

    def spoil(self, change: np.ndarray, background: np.ndarray, noise: DrawnNoise) -> np.ndarray:
        """An image as the camera would give it [levels] of a change of colour, float32, [h, w, 3].

        Blur, uneven colours and light, white noise, and full level where it is too bright.
        """
        change = blurred(change, noise.blur_px)
        change = change * (1.0 + self.uneven_share * _uneven(noise.colors, change.shape))
        image = background + change + self.uneven_levels * _uneven(noise.light, change.shape)
        image += self.white_levels * noise.white
        return np.clip(image, 0.0, 255.0).astype(np.float32)


@dataclass(frozen=True)
class SyntheticPresses:
    """Draws presses one after the other, each another one."""

    scene: CaptureScene
    """Background, pixel grid and resting face."""
    pad: BondedLayer
    colors: ColorModel
    noise: ImageNoise
    """How captures differ from these colours."""
    deepest_mm: float
    """How deep the deepest ball was pressed."""
    rng: np.random.Generator
    """Draws tools, places, depths and noise."""

    def presses(self, count: int, progress: Progress = silent) -> Iterator[KnownPress]:
        """The next ``count`` presses."""
        drawn = (self._draw() for _ in range(count))
        return counted(ahead(self._press, drawn), progress, TASK, count)

    @cached_property
    def _rest(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Normals at rest [h, w, 3], their slopes [h, w, 2], and what the colours give for each
        pixel at rest [levels], shape [h * w, 3]."""
        grid, rest = self.scene.grid, self.scene.rest_normals
        if rest is None:
            rest = np.zeros((grid.height_px, grid.width_px, 3))
            rest[..., 2] = 1.0
        pixels = np.arange(grid.height_px * grid.width_px)
        still = self.colors.network_levels(pixels, rest.reshape(-1, 3), np.zeros(len(pixels)))
        return rest, slope_of(rest), still

    def _draw(self) -> DrawnPress:
        """Depth and tool of the next press, and where the noise of its image is drawn from.

        All random numbers are drawn here, in order: a press is the same however many are worked on
        at once.
        """
        grid, rng = self.scene.grid, self.rng
        low, high = (share * self.deepest_mm for share in DEPTHS)
        low = min(low, LEAST * self.pad.thickness_mm)
        high = min(high, MOST * self.pad.thickness_mm)
        depth_mm = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        tool_mm = draw_tool(rng, *np.meshgrid(grid.x_mm(), grid.y_mm()))
        return DrawnPress(depth_mm, tool_mm, self.noise.draw(self.scene.background.shape, rng))

    def _press(self, drawn: DrawnPress) -> KnownPress:
        """The press that was drawn, simulated and seen."""
        grid = self.scene.grid
        step = (grid.mm_per_px_x, grid.mm_per_px_y)
        found = press_in_view(drawn.tool_mm, drawn.depth_mm, step, self.pad, SOLVED_TO)
        rise_mm = found.rise_mm
        rest, lean, still = self._rest
        slope = slopes_from_height(1e-3 * rise_mm, grid)
        sharp = normals_from_slopes(lean + slope)
        moved = (np.abs(rise_mm) > STILL_MM) | (np.hypot(*np.moveaxis(slope, -1, 0)) > STILL_SLOPE)
        change = np.zeros((*rise_mm.shape, 3), dtype=np.float32)
        pixels = np.flatnonzero(moved)
        pressed = self.colors.network_levels(pixels, sharp[moved], rise_mm[moved])
        change[moved] = pressed - still[pixels]
        smooth_m = blurred(1e-3 * rise_mm, SEEN_PX)
        seen = normals_from_slopes(lean + slopes_from_height(smooth_m, grid))
        rise_m = 1e-3 * rise_mm
        return KnownPress(
            image=self.noise.spoil(change, self.scene.background, drawn.noise),
            normals=rotate_to_z(seen, rest).astype(np.float32),
            rise_m=rise_m,
            compared=rise_m < -1e-3 * DENT_MM,
        )


def _coarse(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """What ``_uneven`` is smoothed from."""
    rows, columns = (max(2, round(count / UNEVEN_PX)) + 1 for count in shape[:2])
    return rng.standard_normal((rows, columns, 3))


def _uneven(coarse: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A smooth field of about unit variance for each channel, shape [h, w, 3]."""
    import cv2

    return np.asarray(cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC))


def synthetic_samples(
    presses: Iterable[KnownPress],
    scene: CaptureScene,
    config: NormalModelConfig,
    count: int,
    rng: np.random.Generator,
) -> list[NormalSamples]:
    """``count`` pixels of each press, most of them on and beside what is not flat.

    They are drawn by place, not by tilt: draws by the truth would have the networks expect steep
    walls wherever they cannot tell. All are drawn here, in order, as in ``samples_of_presses``.
    """
    drawn = ((press, _drawn_pixels(press, scene, count, rng)) for press in presses)
    return list(ahead(lambda one: _samples(*one, scene, config), drawn))


def _drawn_pixels(
    press: KnownPress, scene: CaptureScene, count: int, rng: np.random.Generator
) -> np.ndarray:
    usable = scene.usable
    leaning = press.normals[..., 2] < np.cos(PRESSED_RAD)
    pressed = np.asarray(binary_dilation(leaning, iterations=BESIDE_PX), dtype=bool)
    most = round(PRESSED_SHARE * count)
    regions = [(usable & pressed, most), (usable & ~pressed, count - most)]
    return np.concatenate(
        [rng.permutation(np.flatnonzero(region))[:most] for region, most in regions]
    )


def _samples(
    press: KnownPress, picked: np.ndarray, scene: CaptureScene, config: NormalModelConfig
) -> NormalSamples:
    change = color_change(press.image, scene.background, scene.mask)
    return NormalSamples(
        image_features(config, change, scene.background, mask=scene.mask, picked=picked),
        press.normals.reshape(-1, 3)[picked].astype(np.float32),
    )


def draw_tool(rng: np.random.Generator, x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
    """Height of a tool over its lowest point on a grid [mm], shape as ``x_mm`` and ``y_mm``."""
    reach = 0.5 * float(min(np.ptp(x_mm), np.ptp(y_mm)))
    middle = np.array([x_mm.mean(), y_mm.mean()])
    height = np.full(x_mm.shape, FAR_MM)
    for _ in range(rng.choice(SIDE_BY_SIDE)):
        at = middle + rng.uniform(-0.7, 0.7, 2) * reach
        turn = rng.uniform(0.0, 2 * np.pi)
        x, y = x_mm - at[0], y_mm - at[1]
        along = np.cos(turn) * x + np.sin(turn) * y
        across = np.cos(turn) * y - np.sin(turn) * x
        one = TOOLS[int(rng.integers(len(TOOLS)))](rng, along, across, reach)
        lean = rng.uniform(-LEAN, LEAN, 2) * rng.integers(2)
        one = one + lean[0] * along + lean[1] * across
        one += rng.integers(2) * rng.uniform(0.0, 0.05) * reach - one.min()
        height = np.minimum(height, one)
    return np.minimum(height - height.min(), FAR_MM)


def _length(rng: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _round(distance2: np.ndarray, radius: float) -> np.ndarray:
    """A round underside of ``radius`` at squared distances from its lowest point or line."""
    inside = distance2 < radius**2
    return np.where(inside, radius - np.sqrt(np.maximum(radius**2 - distance2, 0.0)), FAR_MM)


def _filleted(outside: np.ndarray, radius: float) -> np.ndarray:
    """A flat underside whose edge is rounded; ``outside`` is the distance from the flat part."""
    wall = _round(outside**2, radius) if radius > 0 else FAR_MM
    return np.where(outside <= 0, 0.0, wall)


def _edge_radius(rng: np.random.Generator, reach: float) -> float:
    """Sharp, broken or round."""
    bounds = ((0.0, 0.0), (0.002, 0.02), (0.005, 0.1))[int(rng.integers(3))]
    return 0.0 if bounds[1] == 0 else _length(rng, *bounds) * reach


def _ball(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    radius = _length(rng, 0.06, 1.3) * reach
    stretch = 1.0 if rng.integers(2) else _length(rng, 1.0, 3.0)
    return _round(x**2 + (y / stretch) ** 2, radius)


def _roller(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    half = 0.5 * _length(rng, 0.2, 2.0) * reach
    return np.where(np.abs(y) < half, _round(x**2, _length(rng, 0.04, 0.9) * reach), FAR_MM)


def _wedge(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    """Two flanks with a sharp, round or flat edge between them."""
    rise = 1.0 / np.tan(np.radians(rng.uniform(60.0, 160.0)) / 2)
    flat = rng.integers(2) * 0.5 * _length(rng, 0.03, 0.3) * reach
    out = np.maximum(np.abs(x) - flat, 0.0)
    radius = rng.integers(2) * _length(rng, 0.005, 0.05) * reach
    # A circle that goes over into the flank where it is as steep.
    foot = radius * rise / np.hypot(1.0, rise)
    tip = radius - np.sqrt(np.maximum(radius**2 - np.minimum(out, foot) ** 2, 0.0))
    height = tip + rise * np.maximum(out - foot, 0.0)
    return np.where(np.abs(y) < 0.5 * _length(rng, 0.2, 2.0) * reach, height, FAR_MM)


def _cone(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    rise = 1.0 / np.tan(np.radians(rng.uniform(80.0, 165.0)) / 2)
    tip = _length(rng, 0.002, 0.05) * reach
    return np.sqrt(rise**2 * (x**2 + y**2) + tip**2) - tip


def _round_punch(
    rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float
) -> np.ndarray:
    away = np.hypot(x, y) - _length(rng, 0.05, 0.4) * reach
    return _filleted(away, _edge_radius(rng, reach))


def _box(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    half = [_length(rng, 0.05, 0.4) * reach for _ in range(2)]
    away = np.maximum(np.stack([np.abs(x) - half[0], np.abs(y) - half[1]]), 0.0)
    return _filleted(np.hypot(*away), _edge_radius(rng, reach))


def _grating(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    pitch = _length(rng, 0.05, 0.3) * reach
    from_ridge = np.abs((x / pitch + 0.5) % 1 - 0.5) * pitch
    land = from_ridge - 0.5 * rng.uniform(0.3, 0.7) * pitch
    height = np.minimum(
        _filleted(land, _length(rng, 0.03, 0.3) * pitch), _length(rng, 0.2, 1.0) * pitch
    )
    half = 0.5 * _length(rng, 0.3, 1.5) * reach
    return np.where((np.abs(x) < half) & (np.abs(y) < half), height, FAR_MM)


def _knobs(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    pitch = _length(rng, 0.08, 0.3) * reach
    radius = _length(rng, 0.3, 0.6) * pitch
    near = [np.abs((value / pitch + 0.5) % 1 - 0.5) * pitch for value in (x, y)]
    height = np.minimum(_round(near[0] ** 2 + near[1] ** 2, radius), radius)
    half = 0.5 * _length(rng, 0.2, 1.2) * reach
    return np.where((np.abs(x) < half) & (np.abs(y) < half), height, FAR_MM)


def _rough(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    """Waves of random direction on a gently round face."""
    waves = np.zeros_like(x)
    length = _length(rng, 0.05, 0.4) * reach
    for _ in range(12):
        k = 2 * np.pi / (length * rng.uniform(0.7, 1.5))
        turn, phase = rng.uniform(0.0, 2 * np.pi, 2)
        waves += np.cos(k * (np.cos(turn) * x + np.sin(turn) * y) + phase)
    away2 = x**2 + y**2
    height = away2 / (2 * _length(rng, 0.3, 3.0) * reach)
    height += 0.02 * length * _length(rng, 0.3, 3.0) * waves
    return np.where(away2 < (_length(rng, 0.15, 0.7) * reach) ** 2, height, FAR_MM)


def _corner(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    """Three faces that meet in a point."""
    turns = np.array([0.0, 2.0, 4.0]) * np.pi / 3 + rng.uniform(-0.4, 0.4, 3)
    rises = rng.uniform(0.3, 1.3, 3)
    return np.max(
        [r * (np.cos(t) * x + np.sin(t) * y) for r, t in zip(rises, turns, strict=True)], axis=0
    )


TOOLS: Sequence[Tool] = (
    _ball, _ball, _roller, _wedge, _wedge, _cone, _round_punch, _round_punch, _box, _box, _box,
    _grating, _grating, _knobs, _rough, _corner,
)  # fmt: skip
"""Sharp edges come more often than they would by kind: they are what is hard to read."""
