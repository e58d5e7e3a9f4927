# SPDX-License-Identifier: Apache-2.0
"""The colour model, its fit, and what its evaluation says."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from taccel_lab.calibration.block_outcome import BlockOutcome, BlockState
from taccel_lab.calibration.capture import CaptureSet, ContactCircle
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.color.evaluate import crop_slices, psnr_db, score_image, ssim
from taccel_lab.calibration.color.fit import fit_color
from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.frames import ColorFrame, ColorSamples
from taccel_lab.calibration.color.heldout import HeldoutSet
from taccel_lab.calibration.color.network_fit import fit_color_model
from taccel_lab.calibration.color.training import train
from taccel_lab.calibration.color.untouched_light import (
    beside_pixels,
    light_beside,
    noise_floor_l1,
)
from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.calibration.profiles import Profiles
from taccel_lab.calibration.unfinished import UnfinishedCalibration
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.tactile_image import tactile_image
from tests.calibration.drawn.faults import poison, quantise
from tests.support.analytic_surface import analytic_surface
from tests.support.synthetic_presses import (
    GRID,
    calibrated,
    flat_background,
    known_change,
    synthetic_captures,
    tiny_profile,
    true_surfaces,
    with_images,
)

QUICK = ColorFitOptions(
    hidden=(32, 32), steps=400, batch_pixels=2048, disc_pixels=1500, ring_pixels=1000,
    far_pixels=300,
)  # fmt: skip


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def frames_of(captures: CaptureSet, surfaces: list[BallSurface]) -> list[ColorFrame]:
    return [
        ColorFrame(press.name, press.image(), press.circle, surface, press.sha256)
        for press, surface in zip(captures.presses, surfaces, strict=True)
        if press.circle is not None
    ]


def test_round_trip_recovers_the_colour_law() -> None:
    captures, surfaces = synthetic_captures(12, noise=1.0)
    result = calibrated(captures, surfaces, options=QUICK)
    assert result.split == captures.split(4)
    assert tuple(item.name for item in result.heldout) == captures.split(4).heldout_names
    assert result.placement == "label"
    for item in result.heldout:
        surface = surfaces[int(item.name[1:])]
        truth = flat_background() + known_change(surface)
        disc = item.circle.distance_px(GRID) <= item.circle.radius_px
        # The captures' noise has a mean absolute value of 0.8 levels, the law spans +-60.
        assert np.abs(item.rendered - truth)[disc].mean() < 1.5
        assert item.score.crop_psnr_db > item.background_only.crop_psnr_db + 12
        assert item.score.crop_ssim > item.background_only.crop_ssim
    figures = result.figures()
    assert figures["heldout"]["disc_l1"] < 1.6
    psnr = [row["crop_psnr_db"] for row in figures["presses"]]
    assert psnr == sorted(psnr)


def test_poisoned_masked_pixels_have_no_effect() -> None:
    captures, surfaces = synthetic_captures(4)
    frames = frames_of(captures, surfaces)
    mask = np.ones((GRID.height_px, GRID.width_px), dtype=bool)
    mask[40:70, 60:90] = False
    rng = np.random.default_rng(0)
    spoilt = [dataclasses.replace(f, image=quantise(poison(f.image, mask, rng))) for f in frames]
    options = dataclasses.replace(QUICK, steps=40)
    clean = fit_color_model(frames, captures.background, GRID, options, mask=mask)
    dirty = fit_color_model(spoilt, captures.background, GRID, options, mask=mask)
    for name, weight in clean.model.weights.items():
        assert np.array_equal(weight, dirty.model.weights[name])
    assert np.array_equal(clean.background, dirty.background)
    assert clean.disc_l1_train == dirty.disc_l1_train
    unmasked = fit_color_model(spoilt, captures.background, GRID, options)
    other = fit_color_model(frames, captures.background, GRID, dataclasses.replace(options, seed=1))
    for fit in (unmasked, other):
        assert not np.array_equal(
            fit.model.weights["layer0.weight"], clean.model.weights["layer0.weight"]
        )


def test_the_steepest_ball_bounds_what_slopes_may_do() -> None:
    captures, surfaces = synthetic_captures(8)
    options = dataclasses.replace(QUICK, steps=9)
    fit = fit_color_model(frames_of(captures, surfaces), captures.background, GRID, options)
    steepest = max(np.arccos(surface.normals[..., 2].min()) for surface in surfaces)
    assert fit.model.cone_deg == pytest.approx(np.degrees(steepest), abs=2.0)
    assert fit.model.cone_deg <= np.degrees(steepest) + 1e-9


@pytest.mark.parametrize("steps", [1, 9])
def test_a_few_steps_can_be_asked_for(steps: int) -> None:
    captures, surfaces = synthetic_captures(2)
    options = dataclasses.replace(QUICK, steps=steps)
    fit = fit_color_model(frames_of(captures, surfaces), captures.background, GRID, options)
    assert fit.loss_curve[-1][0] == steps


def test_bad_fits_are_refused() -> None:
    captures, surfaces = synthetic_captures(3)
    with pytest.raises(InputError, match="at least one press"):
        fit_color_model([], captures.background, GRID)
    with pytest.raises(InputError, match="steps must be at least 1"):
        ColorFitOptions(steps=0)
    with pytest.raises(InputError, match="learning_rate must be positive"):
        ColorFitOptions(learning_rate=-1.0)
    with pytest.raises(InputError, match="3 presses need as many circles and surfaces"):
        fit_color(captures, [], surfaces)
    circles = [press.circle for press in captures.presses if press.circle is not None]
    held = HeldoutSet(captures.only([1]), true_surfaces, captures.split(2))
    with pytest.raises(InputError, match="p1: held out and fitted at once"):
        fit_color(captures, circles, surfaces, held)
    everything = np.zeros((GRID.height_px, GRID.width_px), dtype=bool)
    with pytest.raises(InputError, match="masked"):
        fit_color_model(
            frames_of(captures, surfaces), captures.background, GRID, QUICK, mask=everything
        )


def test_blocks_go_through_a_profile(tmp_path: Path) -> None:
    captures, surfaces = synthetic_captures(12)
    options = dataclasses.replace(QUICK, steps=60)
    result = calibrated(captures, surfaces, options=options)
    save_profile(result.scored.apply_to(tiny_profile(GRID)), tmp_path / "profile")
    loaded = load_profile(tmp_path / "profile")
    assert loaded.color is not None and loaded.color_weights is not None
    model = ColorModel(ColorModelConfig.from_dict(loaded.color.architecture), loaded.color_weights)
    item = result.heldout[0]
    (surface,) = true_surfaces(captures, [item.placed])
    assert loaded.background_rgb is not None
    rendered = tactile_image(model, loaded.background_rgb, surface)
    assert np.array_equal(rendered, item.rendered)
    residuals = loaded.color.provenance.residuals
    assert residuals["heldout_disc_l1"] == pytest.approx(
        np.mean([held.score.disc_l1 for held in result.heldout])
    )
    assert result.split is not None
    fitted = {press.name for press in captures.presses} - set(result.split.heldout_names)
    assert set(loaded.color.provenance.inputs) == {"background", *fitted}
    assert result.split.sha256[:16] in loaded.color.provenance.method


def test_a_profile_gets_the_fit_to_all_presses_with_the_scores_of_the_first() -> None:
    captures, surfaces = synthetic_captures(12)
    result = calibrated(captures, surfaces, options=dataclasses.replace(QUICK, steps=60))
    last, scored = (item.apply_to(tiny_profile(GRID)) for item in (result, result.scored))
    assert last.color is not None and scored.color is not None and last.color_weights is not None
    names = {press.name for press in captures.presses}
    assert set(last.color.provenance.inputs) == {"background", *names}
    assert "then fitted to all 12 presses" in last.color.provenance.method
    assert result.final is not None and result.scored.final is None
    # Normals are read against the same background as they were fitted to.
    np.testing.assert_array_equal(last.background_rgb, scored.background_rgb)
    for name, weight in last.color_weights.items():
        assert np.array_equal(weight, result.final.model.weights[name])
        assert not np.array_equal(weight, result.fit.model.weights[name])
    for name, value in scored.color.provenance.residuals.items():
        if name.startswith("heldout"):
            assert last.color.provenance.residuals[name] == value
    assert calibrated(captures, surfaces, options=QUICK, holdout_every=0).final is None


def test_an_image_without_its_press_is_not_in_the_last_fit() -> None:
    captures, surfaces = synthetic_captures(12)
    empty = captures.split(4).heldout[0]
    image = np.round(captures.background).astype(np.uint8)
    spoilt = with_images(captures, {empty: image})
    result = calibrated(spoilt, surfaces, options=dataclasses.replace(QUICK, steps=60))
    names = {press.name for press in captures.presses}
    assert result.final is not None
    assert set(result.final.inputs) == names - {captures.presses[empty].name}


def test_later_blocks_build_on_the_model_that_was_scored(tmp_path: Path) -> None:
    captures, surfaces = synthetic_captures(12)
    result = calibrated(captures, surfaces, options=dataclasses.replace(QUICK, steps=20))
    profiles = Profiles.of(tiny_profile(GRID)).after(result)
    kept = UnfinishedCalibration.open(tmp_path / "kept", "key")
    kept.add(BlockOutcome("color", BlockState.DONE, "good"), profiles, None)
    again = UnfinishedCalibration.open(tmp_path / "kept", "key").profiles
    assert again is not None
    for found in (profiles, again):
        assert found.basis.color is not None and found.final.color is not None
        seen = set(found.basis.color.provenance.inputs)
        assert seen == {"background", *result.train_names}
        assert set(found.final.color.provenance.inputs) > seen


def test_light_that_changes_within_the_image_asks_for_bands() -> None:
    """Lamps in stripes of a fifth of the image: the plain network smooths them away."""
    captures, surfaces = synthetic_captures(20, noise=1.0, seed=3)
    stripes = 1 + np.sin(2 * np.pi * 5 * np.arange(GRID.width_px) / GRID.width_px)[None, :, None]
    truth = [flat_background() + known_change(surface) * stripes for surface in surfaces]
    rng = np.random.default_rng(0)
    noisy = [np.clip(x + rng.normal(0, 1, x.shape), 0, 255) for x in truth]
    frames = [
        dataclasses.replace(frame, image=image)
        for frame, image in zip(frames_of(captures, surfaces), noisy, strict=True)
    ]
    error = {}
    for bands in (0, 4):
        fit = fit_color_model(
            frames[5:], captures.background, GRID,
            dataclasses.replace(QUICK, position_bands=bands),
        )  # fmt: skip
        off = []
        for frame, wanted in zip(frames[:5], truth[:5], strict=True):
            rendered = tactile_image(fit.model, fit.background, frame.surface)
            disc = frame.circle.distance_px(GRID) <= frame.circle.radius_px
            off.append(np.abs(rendered - wanted)[disc].mean())
        error[bands] = np.mean(off)
    assert error[4] < 0.6 * error[0], error


SHARE, LEVELS, FAR = 0.3, 10.0, 100.0
"""Of the pixels, a share is off by so much: a hair, a glint."""


def pixels(count: int = 4000) -> ColorSamples:
    rng = np.random.default_rng(3)
    slope = rng.uniform(0.2, 0.5, (count, 2)) * rng.choice([-1, 1], (count, 2))
    normals = np.concatenate([-slope, np.ones((count, 1))], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    change = np.full((count, 3), LEVELS)
    change[rng.uniform(size=count) < SHARE] += FAR
    return ColorSamples(
        uv=rng.uniform(-1, 1, (count, 2)),
        normals=normals,
        rest_normals=np.tile([0.0, 0.0, 1.0], (count, 1)),
        displacement_mm=rng.uniform(-0.4, -0.1, count),
        change=change,
    )


@pytest.mark.parametrize("width", [5.0, 40.0])
def test_the_width_says_how_far_pixels_that_are_far_off_draw(width: float) -> None:
    """The answer a draws by (1 - share) (a - levels) against share * width: in closed form."""
    options = ColorFitOptions(
        steps=400, batch_pixels=1024, hidden=(8,), learning_rate=0.02, huber_levels=width
    )
    samples = pixels()
    trained = train(samples, PixelGrid(40, 30, 0.1, 0.1), options)
    index = np.arange(len(samples.uv)) % (40 * 30)
    found = trained.model.predict_pixels(
        index, samples.normals, samples.displacement_mm, samples.rest_normals
    )
    share = np.mean(samples.change[:, 0] > LEVELS)
    drawn = share / (1 - share) * width
    assert np.median(found) - LEVELS == pytest.approx(drawn, rel=0.25)
    # Slope 1 beyond the width: a mean absolute error [levels].
    near, far = drawn**2 / 2, width * (FAR - drawn - width / 2)
    loss = np.mean([loss for step, loss in trained.curve if step > 300])
    assert loss == pytest.approx(((1 - share) * near + share * far) / width, rel=0.1)


@given(
    height=st.integers(11, 40), width=st.integers(11, 40), seed=st.integers(0, 99),
    noise=st.floats(0.5, 60),
)  # fmt: skip
def test_ssim_and_psnr_agree_with_scikit_image(
    height: int, width: int, seed: int, noise: float
) -> None:
    rng = np.random.default_rng(seed)
    a = rng.uniform(0, 255, (height, width, 3))
    b = np.clip(a + rng.normal(0, noise, a.shape), 0, 255)
    reference = structural_similarity(
        a, b, channel_axis=2, data_range=255, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False,
    )  # fmt: skip
    assert ssim(a, b) == pytest.approx(reference, abs=1e-9)
    assert psnr_db(a, b) == pytest.approx(peak_signal_noise_ratio(a, b, data_range=255))
    assert ssim(a, a) == pytest.approx(1.0) and psnr_db(a, a) == float("inf")


def test_score_separates_disc_crop_and_image() -> None:
    grid = PixelGrid(200, 150, 0.1, 0.1)
    circle = ContactCircle(100.0, 70.0, 20.0)
    captured = np.full((150, 200, 3), 100.0)
    rendered = captured.copy()
    disc = circle.distance_px(grid) <= 20.0
    rendered[disc] += 6.0
    rendered[0, 0] += 30.0  # outside the crop
    score = score_image(rendered, captured, circle, grid)
    crop = crop_slices(circle, grid)
    assert (crop[0].start, crop[0].stop) == (38, 103)
    assert (crop[1].start, crop[1].stop) == (68, 133)
    assert score.disc_l1 == pytest.approx(6.0)
    assert score.crop_l1 == pytest.approx(6.0 * disc.sum() / 65**2)
    assert score.full_l1 == pytest.approx((6.0 * disc.sum() + 30.0) / disc.size)
    assert score.crop_psnr_db == pytest.approx(10 * np.log10(255**2 / (36.0 * disc.sum() / 65**2)))


def test_crop_of_oblong_pixels_is_square_in_millimetres() -> None:
    grid = PixelGrid(200, 200, 0.1, 0.05)
    rows, columns = crop_slices(ContactCircle(100.0, 100.0, 20.0), grid)
    assert columns.stop - columns.start == 65
    assert rows.stop - rows.start == 129


def test_shapes_are_checked() -> None:
    grid = PixelGrid(60, 50, 0.1, 0.1)
    with pytest.raises(InputError, match="differ in shape"):
        score_image(np.zeros((50, 60, 3)), np.zeros((50, 61, 3)), ContactCircle(30, 25, 10), grid)
    with pytest.raises(InputError, match="at least 11x11"):
        ssim(np.zeros((8, 20, 3)), np.zeros((8, 20, 3)))


DRIFT = LightDrift(np.array([1.25, 0.8, 1.0]), np.array([2.0, -3.0, 5.0]))
CONTACTS = [
    ContactCircle(70.0, 60.0, 13.0),
    ContactCircle(80.0, 59.5, 30.0),
    ContactCircle(70.0, 66.0, 40.0),
]
"""A tenth, a quarter and a third of the picture's height."""


def background() -> np.ndarray:
    """With a gradient wide enough to tell gain from offset."""
    return flat_background() * np.linspace(0.5, 1.5, GRID.width_px)[None, :, None]


def pressed(circle: ContactCircle) -> np.ndarray:
    """A press of a ball of 1.25 times the contact's radius, before any noise and drift."""
    ball_mm = 1.25 * circle.radius_px * GRID.mm_per_px_x
    decay_mm = 0.5 * circle.radius_px * GRID.mm_per_px_x
    return background() + known_change(analytic_surface(circle, GRID, ball_mm, decay_mm=decay_mm))


@pytest.mark.parametrize(("circle", "left"), list(zip(CONTACTS, (0.05, 0.1, 0.25), strict=True)))
def test_drift_is_recovered_beside_a_contact(circle: ContactCircle, left: float) -> None:
    rng = np.random.default_rng(0)
    still = background()
    frame = DRIFT.apply(pressed(circle)) + rng.normal(0, 0.5, still.shape)
    found = light_beside(frame, still, circle, GRID).apply(still)
    wanted = DRIFT.apply(still)
    # The gel sinks as far as two radii, which a large contact leaves little beyond.
    assert np.abs(found - wanted).mean() < left * np.abs(wanted - still).mean()
    assert DRIFT.remove(DRIFT.apply(frame)) == pytest.approx(frame)


@pytest.mark.parametrize("size", [(80, 60), (160, 120), (320, 240), (640, 480), (1280, 960)])
@pytest.mark.parametrize("share", [0.1, 0.25, 0.33])
def test_the_same_contact_leaves_enough_at_every_size(size: tuple[int, int], share: float) -> None:
    grid = PixelGrid(*size, 16.0 / size[0], 16.0 / size[0])
    circle = ContactCircle(0.45 * size[0], 0.52 * size[1], share * size[1])
    still = np.full((size[1], size[0], 3), 100.0)
    found = light_beside(still + 5.0, still, circle, grid)
    assert found.apply(still) == pytest.approx(still + 5.0, abs=0.1)


def test_no_crop_is_reached() -> None:
    for circle in CONTACTS:
        far = beside_pixels(circle, GRID)
        v, u = np.nonzero(far)
        beside = np.maximum(np.abs(u - circle.u_px), np.abs(v - circle.v_px))
        assert beside.min() > 1.6 * circle.radius_px
        assert circle.distance_px(GRID)[far].min() > 2 * circle.radius_px


def test_a_contact_that_fills_the_picture_leaves_its_light_unknown() -> None:
    circle = ContactCircle(80.0, 59.5, 55.0)
    frame = background()
    found = light_beside(frame + 9.0, frame, circle, GRID)
    assert found.apply(frame) == pytest.approx(frame)
    assert np.sqrt(found.covariance[:, 1, 1]).min() > 9.0
    assert np.isnan(noise_floor_l1(frame, frame, circle, GRID))


def test_noise_floor_ignores_the_contact() -> None:
    grid = PixelGrid(200, 150, 0.1, 0.1)
    circle = ContactCircle(100.0, 70.0, 20.0)
    still = np.full((150, 200, 3), 100, dtype=np.uint8)
    captured = still + np.uint8(2)
    captured[circle.distance_px(grid) < 36] = 255
    captured[::2] += np.uint8(2) * (captured[::2] < 200)
    assert noise_floor_l1(captured, still, circle, grid) == pytest.approx(1.0, abs=0.05)
