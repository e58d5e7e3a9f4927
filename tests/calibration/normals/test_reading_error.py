# SPDX-License-Identifier: Apache-2.0
"""How far read normals and depths are off, and what their sigma says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet, ContactCircle
from taccel_lab.calibration.circles import ball_surface as ball_surfaces
from taccel_lab.calibration.circles.ball_surface import (
    BallSurface,
    depth_share,
    layer_surfaces,
    sunk_share,
)
from taccel_lab.calibration.circles.labels import LabelPlacement
from taccel_lab.calibration.color.network_fit import fit_color_model
from taccel_lab.calibration.color.options import ColorFitOptions
from taccel_lab.calibration.normals import samples
from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.normals.samples import KnownPress, all_errors, circle_angle_rad, widened
from taccel_lab.calibration.normals.score import read_heldout, reliability_of
from taccel_lab.calibration.normals.synthetic_presses import ImageNoise, SyntheticPresses
from taccel_lab.calibration.response.frame import EXACT, CaptureScene, HeldoutSet, PressFrame
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.reading.bonded_layer import BondedLayer
from taccel_lab.reading.heights import BAND_SIGMAS, ReadHeights, read_heights
from taccel_lab.reading.slopes import NormalModel
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.normals import normals_from_slopes, slopes_from_height
from taccel_lab.signals.rest_surface import flat_rest
from tests.calibration.normals.conftest import ON_PAD, PAD, QUICK, calibrated, sunk_captures
from tests.support.synthetic_presses import (
    GRID,
    circles_of,
    frames_of,
    synthetic_captures,
    with_circles,
)

pytestmark = pytest.mark.usefixtures("one_thread")
AREA = PixelGrid(60, 56, 0.1, 0.1)
BALL_MM, LAYER = 3.0, BondedLayer(4.0, 0.46)
SLOPE_PER_LEVEL = 0.02
"""Of the sensor drawn here: red tells the slope along x, green that along y."""
SCENE = CaptureScene(np.full((56, 60, 3), 120.0, dtype=np.float32), AREA, BALL_MM)


@pytest.mark.parametrize(("deepest_mm", "low_mm", "high_mm"), [(2.6, 0.12, 1.2), (0.5, 0.05, 0.65)])
def test_tools_go_as_deep_as_the_balls(deepest_mm: float, low_mm: float, high_mm: float) -> None:
    """Where balls went 2.6 mm deep, networks that saw tools from 0.26 to 2 mm read those of 0.3 mm
    1.6 times as far off as ones that see 0.12 to 1.2 mm."""
    weights = {"layer0.weight": np.zeros((3, 6)), "layer0.bias": np.zeros(3)}
    colors = ColorModel(ColorModelConfig(60, 56, hidden=()), weights)
    noise, rng = ImageNoise(1.0, 0.0, 0.0), np.random.default_rng(0)
    drawn = SyntheticPresses(SCENE, LAYER, colors, noise, deepest_mm, rng)
    depths_mm = [-1e3 * press.rise_m.min() for press in drawn.presses(30)]
    assert max(depths_mm) < 1.03 * high_mm  # A press is solved to 3 % of its depth.
    assert min(depths_mm) < 1.8 * low_mm


def reader(members: int = 2, wrong: float = 0.0) -> NormalModel:
    """Linear networks that read tilts of small slopes; the first is off by the share ``wrong``."""
    scales = {"scales_px": (0.0,), "slope_scales_px": ()}
    config = NormalModelConfig(60, 56, members=members, hidden=(), **scales)
    weights = {k: np.zeros(s, dtype=np.float32) for k, s in config.weight_shapes().items()}
    for axis in range(2):
        weights["layer0.weight"][:, axis, axis] = -SLOPE_PER_LEVEL * 32.0
        weights["layer0.weight"][0, axis, axis] *= 1 + wrong
    weights["layer0.bias"][:, 2] = np.log(np.radians(0.5))
    return NormalModel(config, weights)


def drawn(rise_m: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Image of a surface with noise, and its normals as the linear networks read slopes."""
    slope = slopes_from_height(rise_m, AREA)
    image = SCENE.background.copy()
    image[..., :2] += slope / SLOPE_PER_LEVEL
    tilt = np.linalg.norm(slope, axis=-1, keepdims=True)
    normals = normals_from_slopes(slope * np.tan(tilt) / np.maximum(tilt, 1e-9))
    return image + rng.normal(0, 0.4, image.shape).astype(np.float32), normals


@cache
def ball(circle: ContactCircle) -> BallSurface:
    """The layer under a ball, which one contact is enough to solve."""
    return ball_surfaces.ball_surface(circle, BALL_MM, AREA, LAYER, flat_rest(AREA))


def presses(label_px: float, stated_px: float) -> Iterator[KnownPress]:
    """Balls whose labels are off by ``label_px`` to all sides and stated to be by ``stated_px``."""
    rng = np.random.default_rng(1)
    for k in range(8):
        u_px, v_px, radius_px = rng.uniform((26, 24, 7), (34, 32, 9)).tolist()
        true = ContactCircle(u_px, v_px, radius_px)
        off = label_px * (-1.0) ** (k // np.array([1, 2, 4]))
        label = ContactCircle(true.u_px + off[0], true.v_px + off[1], true.radius_px + off[2])
        image, _ = drawn(1e-3 * ball(true).displacement_mm(), rng)
        known = ball(label)
        frame = PressFrame("p", image, label, known, circle_sigma_px=(stated_px, stated_px))
        normals = samples.true_normals(frame, SCENE)
        inside = label.distance_px(AREA) <= 0.9 * label.radius_px
        sigma_deg = np.degrees(circle_angle_rad(frame, SCENE, normals))
        rise_m = 1e-3 * known.displacement_mm()
        yield KnownPress(image, normals, rise_m, inside, normals_sigma_deg=sigma_deg)


@cache
def noted(label_px: float, stated_px: float) -> NormalModel:
    """Synthetic presses are read without error of labels, balls with."""
    drawn = [replace(press, normals_sigma_deg=None) for press in presses(0.0, 0.0)]
    balls = presses(label_px, stated_px)
    model, score = samples.with_reading_errors(reader(), drawn, balls, SCENE, depth_share=0.03)
    assert score is not None and score.count == 8
    return model


@pytest.mark.thorough
def test_errors_of_labels_that_are_stated_widen_no_radius() -> None:
    errors_px = (0.0, 0.0), (0.4, 0.4), (0.4, 0.0)
    exact, stated, denied = (noted(*error_px).config for error_px in errors_px)
    assert denied.radius95_sigmas > 1.4 * exact.radius95_sigmas
    assert stated.radius95_sigmas < 1.15 * exact.radius95_sigmas
    # What balls are off by is in the absolute depth and not in the reading: labels or reading,
    # nobody can tell; what is stated of labels makes no depth better known.
    assert exact.height_factor == stated.height_factor == denied.height_factor > 0
    assert stated.along_factor == denied.along_factor > 2 * exact.along_factor
    assert exact.depth_share == 0.03


@pytest.mark.thorough
def test_presses_that_nothing_had_seen_widen_the_bands_and_never_narrow_them() -> None:
    model = noted(0.0, 0.0)
    before = model.config
    same = widened(model, all_errors(model, presses(0.0, 0.0), SCENE)).config
    assert same.radius95_sigmas == pytest.approx(before.radius95_sigmas)
    assert same.along_factor == pytest.approx(before.along_factor)
    off = list(presses(0.4, 0.0))
    wider = widened(model, all_errors(model, off, SCENE)).config
    assert wider.radius95_sigmas > 1.4 * before.radius95_sigmas
    assert wider.along_factor > 2 * before.along_factor
    # What their circles are stated to be off by is no error of the reading.
    stated = [replace(press, rise_sigma_m=1e-4) for press in presses(0.4, 0.4)]
    found = widened(model, all_errors(model, stated, SCENE)).config
    assert found.radius95_sigmas < 1.15 * before.radius95_sigmas
    assert found.along_factor < 0.5 * wider.along_factor
    assert widened(model, all_errors(model, off[:3], SCENE)).config == before


@pytest.mark.thorough
def test_held_out_figures_are_of_the_bands_passed_on(synthetic: NormalCalibration) -> None:
    captures, scene = sunk_captures()[0], synthetic.scene
    split = captures.split(4)
    training = captures.only(split.train)
    config = replace(
        synthetic.fit.model.config,
        along_factor=0.0, depth_share=0.0, radius95_sigmas=1.0, height_factor=1e-3,
    )  # fmt: skip
    narrow = NormalModel(config, synthetic.fit.model.weights)
    found = read_heldout(
        narrow, HeldoutSet.of(captures, split, ON_PAD),
        LabelPlacement.of(training.presses, circles_of(training)), scene, EXACT,
    )  # fmt: skip
    assert found.model.config.along_factor > 0
    shares = []
    for item in found.items:
        wanted_m = 1e-3 * item.frame.surface.displacement_mm()
        for model in (narrow, found.model):
            read = read_heights(model, item.frame.image, scene.background, GRID)
            assert read.sigma_m is not None
            held = np.abs(read.rise_m - wanted_m) <= BAND_SIGMAS * read.sigma_m
            shares.append(held[scene.inside(item.frame.circle)].mean())
        assert item.depth.within_95 == pytest.approx(shares[-1])
    assert np.mean(shares[1::2]) > np.mean(shares[::2])
    reliability = reliability_of(found.items, scene)
    assert reliability.within_95 > 0.9


def test_the_network_that_reads_a_left_out_press_does_not_tell_itself_that_it_errs() -> None:
    """On a new press nothing does: a member's distance from the others is known only where these
    saw the press."""
    rng = np.random.default_rng(2)
    image, _ = drawn(1e-3 * ball(ContactCircle(30, 28, 9)).displacement_mm(), rng)
    model = reader(members=4, wrong=0.5)
    alone = model.predict(image, SCENE.background, left_out=0)
    together = model.predict(image, SCENE.background)
    agreeing = reader(members=1, wrong=0.5).predict(image, SCENE.background)
    np.testing.assert_allclose(alone.tilt_rad, agreeing.tilt_rad, atol=1e-6)
    np.testing.assert_allclose(alone.sigma_deg, agreeing.sigma_deg, rtol=1e-4)
    assert together.sigma_deg.max() > 3 * alone.sigma_deg.max()


def test_a_stated_pixel_of_all_radii_moves_depths_as_it_does() -> None:
    circle = ContactCircle(30.0, 28.0, 18.0)
    here, there = ball(circle), ball(replace(circle, radius_px=19.0))
    without, with_it = (depth_share([(here, circle)], px, BALL_MM, AREA) for px in (0.0, 1.0))
    found = there.depth_mm / here.depth_mm - 1
    assert np.sqrt(with_it**2 - without**2) == pytest.approx(found, rel=0.1)
    scaled = depth_share([(here, circle)], 0.0, BALL_MM, AREA, scale_share=0.05)
    assert scaled == pytest.approx(np.hypot(without, 0.1))


def test_a_thickness_between_none_and_endless_halves_the_depth_at_a_contact() -> None:
    """A thin layer that can be compressed sinks under the ball's cap alone, a thick one by as much
    at the rim; the interval is of four standard deviations."""
    layer = BondedLayer(4.0, 0.2)
    share = sunk_share((0.1, 20.0), 1.0, 12.0, layer)
    assert share == pytest.approx(np.log(2.0) / 4, rel=0.15)


def test_noise_is_that_of_the_captures_where_contacts_fill_the_picture() -> None:
    """No pixel lies beyond 2.5 radii of any of these; a level of noise was made up for them."""
    captures, surfaces = synthetic_captures(6, noise=3.0, radii_px=(44.0, 48.0), ball_mm=6.0)
    whole = [f for f in frames_of(captures, surfaces) if not f.circle.untouched(GRID).any()]
    frames = [replace(frame, image=frame.image.astype(np.float32)) for frame in whole]
    assert len(frames) > 1
    scene = CaptureScene.of(captures, None)
    colors = fit_color_model(frames, scene, ColorFitOptions(steps=5)).model
    noise = ImageNoise.of(frames, scene, colors)
    assert noise.white_levels == pytest.approx(3.0, rel=0.15)


Known = tuple[CaptureSet, list[BallSurface]]


def told(known: Known, radius_px: float, scale_share: float) -> NormalCalibration:
    """A calibration whose circles and scale are too large by their stated errors."""
    mm_per_px = (1 + scale_share) * GRID.mm_per_px_x
    grid = PixelGrid(GRID.width_px, GRID.height_px, mm_per_px, mm_per_px)
    captures = replace(known[0], grid=grid)
    circles = [replace(c, radius_px=c.radius_px + radius_px) for c in circles_of(captures)]
    captures = with_circles(captures, circles)
    flat, count = flat_rest(grid), len(captures.split(4).train)
    surfaces = layer_surfaces(captures, circles, PAD, flat)
    on_pad = partial(ball_surfaces.ball_surface, grid=grid, layer=PAD, rest=flat)
    return calibrated(
        captures, surfaces, on_pad, options=replace(QUICK, synthetic_presses=24), pad=PAD,
        circle_sigmas_px=[(0.0, radius_px)] * count, scale_share=scale_share,
    )  # fmt: skip


def readings(result: NormalCalibration, known: Known) -> list[tuple[ReadHeights, np.ndarray]]:
    """Held-out presses as they are read, and their true rise [m]."""
    captures, surfaces = known
    found = []
    for i in captures.split(4).heldout:
        image = captures.presses[i].image().astype(np.float32)
        read = read_heights(result.fit.model, image, captures.background, result.scene.grid)
        found.append((read, 1e-3 * surfaces[i].displacement_mm()))
    return found


def held(found: Sequence[tuple[ReadHeights, np.ndarray]], *, alone: bool = False) -> np.ndarray:
    """Share of each dent within two standard deviations."""
    shares = []
    for read, rise_m in found:
        sigma_m = read.reading_sigma_m if alone else read.sigma_m
        assert sigma_m is not None
        dent = rise_m < 0.3 * rise_m.min()
        shares.append(np.mean(np.abs(read.rise_m - rise_m)[dent] <= BAND_SIGMAS * sigma_m[dent]))
    return np.array(shares)


def share_of_depth(found: Sequence[tuple[ReadHeights, np.ndarray]]) -> float:
    """Mean standard deviation of the deepest points over their depth."""
    shares = []
    for read, _ in found:
        assert read.sigma_m is not None
        deepest = np.unravel_index(int(np.argmin(read.rise_m)), read.rise_m.shape)
        shares.append(-read.sigma_m[deepest] / read.rise_m[deepest])
    return float(np.mean(shares))


@pytest.fixture(scope="module")
def known() -> Known:
    return sunk_captures()


@pytest.mark.thorough
@pytest.mark.parametrize(("radius_px", "scale_share"), [
    pytest.param(1.2, 0.0, id="circles"),
    pytest.param(0.0, 0.05, id="scale", marks=pytest.mark.slow),
])  # fmt: skip
def test_what_is_wrong_as_stated_is_held(
    known: Known, radius_px: float, scale_share: float
) -> None:
    found = readings(told(known, radius_px, scale_share), known)
    assert held(found, alone=True).mean() < 0.5
    # 95 % are wanted, as far as four presses tell: they hold 87 to 97 %, and rounding, another one
    # on another machine, moves their mean by a half per cent.
    shares = held(found)
    assert shares.mean() > 0.9
    assert shares.mean() > 0.95 - 2 * shares.std(ddof=1) / np.sqrt(len(shares))
    # Wide enough, and not silly.
    off = np.mean([np.abs(read.rise_m.min() / rise_m.min() - 1) for read, rise_m in found])
    assert off < 2 * share_of_depth(found) < 5 * off
