# SPDX-License-Identifier: Apache-2.0
"""The colour model, its fit, and what its evaluation says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from taccel_lab.calibration import unfinished
from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.calibration.color.fit import fit_color
from taccel_lab.calibration.color.network_fit import ColorSamples, fit_color_model, train
from taccel_lab.calibration.color.options import ColorFitOptions
from taccel_lab.calibration.color.result import ColorCalibration
from taccel_lab.calibration.normals.options import InverseFitOptions
from taccel_lab.calibration.response.frame import CaptureScene, FittedPresses, HeldoutSet
from taccel_lab.calibration.unfinished import BlockOutcome, BlockState, UnfinishedCalibration
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.tactile_image import tactile_image
from tests.calibration.drawn.faults import poison, quantise
from tests.support import synthetic_presses as synthetic
from tests.support.synthetic_presses import GRID, calibrated, frames_of, synthetic_captures

QUICK = ColorFitOptions(
    hidden=(32, 32), steps=400, batch_pixels=2048, disc_pixels=1500, ring_pixels=1000,
    far_pixels=300,
)  # fmt: skip
BRIEF = replace(QUICK, steps=60)


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def captures() -> CaptureSet:
    return synthetic_captures(12)[0]


@pytest.fixture(scope="module")
def result(one_thread: None) -> ColorCalibration:
    return calibrated(*synthetic_captures(12), options=BRIEF)


@pytest.mark.thorough
def test_round_trip_recovers_the_colour_law() -> None:
    captures, surfaces = synthetic_captures(12, noise=1.0)
    result = calibrated(captures, surfaces, options=QUICK)
    assert result.split == captures.split(4) and result.placement == "label"
    assert tuple(item.name for item in result.heldout) == captures.split(4).heldout_names
    for item in result.heldout:
        truth = synthetic.flat_background() + synthetic.known_change(surfaces[int(item.name[1:])])
        disc = item.circle.distance_px(GRID) <= item.circle.radius_px
        # The captures' noise has a mean absolute value of 0.8 levels, the law spans +-60.
        assert np.abs(item.rendered - truth)[disc].mean() < 1.5
        assert item.score.crop_psnr_db > item.background_only.crop_psnr_db + 12
        assert item.score.crop_ssim > item.background_only.crop_ssim
    figures = result.figures()
    assert figures["heldout"]["disc_l1"] < 1.6
    psnr = [row["crop_psnr_db"] for row in figures["presses"]]
    assert psnr == sorted(psnr)


@pytest.mark.thorough
def test_poisoned_masked_pixels_have_no_effect() -> None:
    captures, surfaces = synthetic_captures(4)
    frames = frames_of(captures, surfaces)
    mask = np.ones((GRID.height_px, GRID.width_px), dtype=bool)
    mask[40:70, 60:90] = False
    rng = np.random.default_rng(0)
    spoilt = [replace(f, image=quantise(poison(f.image, mask, rng))) for f in frames]
    options = replace(QUICK, steps=40)
    whole = CaptureScene.of(captures, None)
    masked = replace(whole, mask=mask)
    clean, dirty = (fit_color_model(some, masked, options) for some in (frames, spoilt))
    for name, weight in clean.model.weights.items():
        assert np.array_equal(weight, dirty.model.weights[name])
    assert np.array_equal(clean.background, dirty.background)
    assert clean.disc_l1_train == dirty.disc_l1_train
    unmasked = fit_color_model(spoilt, whole, options)
    other = fit_color_model(frames, whole, replace(options, seed=1))
    first = clean.model.weights["layer0.weight"]
    for fit in (unmasked, other):
        assert not np.array_equal(fit.model.weights["layer0.weight"], first)


@pytest.mark.parametrize("steps", [1, 9])
def test_the_steepest_ball_bounds_what_slopes_may_do(steps: int) -> None:
    captures, surfaces = synthetic_captures(4)
    scene, options = CaptureScene.of(captures, None), replace(QUICK, steps=steps)
    fit = fit_color_model(frames_of(captures, surfaces), scene, options)
    assert fit.loss_curve[-1][0] == steps
    steepest = np.degrees(max(np.arccos(s.normals[..., 2].min()) for s in surfaces))
    assert steepest - 2.0 <= fit.model.cone_deg <= steepest + 1e-9


@pytest.mark.parametrize(("call", "words"), [
    (lambda c, s, scene: fit_color_model([], scene), "at least one press"),
    (lambda *_: ColorFitOptions(steps=0), "steps must be at least 1"),
    (lambda *_: ColorFitOptions(learning_rate=-1.0), "learning_rate must lie in"),
    (lambda *_: ColorFitOptions(huber_levels=1e3), r"lie in \(0, 1000\), got 1000"),
    (lambda *_: InverseFitOptions(learning_rate=1.0), r"learning_rate .* \(0, 1\), got 1"),
    (lambda c, s, scene: fit_color(FittedPresses(c, [], s)),
     "3 presses need as many circles and surfaces"),
    (lambda c, s, scene: fit_color(FittedPresses(
        c, synthetic.circles_of(c), s,
        HeldoutSet(c.only([1]), c.split(2), synthetic.true_surface))),
     "p1: held out and fitted at once"),
    (lambda c, s, scene: fit_color_model(
        frames_of(c, s), replace(scene, mask=np.zeros((120, 160), bool)), QUICK), "masked"),
])  # fmt: skip
def test_bad_fits_are_refused(call: Callable[..., object], words: str) -> None:
    captures, surfaces = synthetic_captures(3)
    with pytest.raises(InputError, match=words):
        call(captures, surfaces, CaptureScene.of(captures, None))


@pytest.mark.thorough
def test_blocks_go_through_a_profile(
    result: ColorCalibration, captures: CaptureSet, tmp_path: Path
) -> None:
    save_profile(result.scored.apply_to(synthetic.tiny_profile(GRID)), tmp_path / "profile")
    loaded = load_profile(tmp_path / "profile")
    assert loaded.color is not None and loaded.color_weights is not None
    model = ColorModel(ColorModelConfig.from_dict(loaded.color.architecture), loaded.color_weights)
    item, split = result.heldout[0], result.split
    assert loaded.background_rgb is not None and split is not None
    surface = synthetic.true_surface(item.placed, captures.ball_radius_mm)
    rendered = tactile_image(model, loaded.background_rgb, surface)
    assert np.array_equal(rendered, item.rendered)
    provenance = loaded.color.provenance
    scores = [held.score.disc_l1 for held in result.heldout]
    assert provenance.residuals["heldout_disc_l1"] == pytest.approx(np.mean(scores))
    fitted = {press.name for press in captures.presses} - set(split.heldout_names)
    assert set(provenance.inputs) == {"background", *fitted}
    assert split.sha256[:16] in provenance.method


@pytest.mark.thorough
def test_a_profile_gets_the_fit_to_all_presses_with_the_scores_of_the_first(
    result: ColorCalibration, captures: CaptureSet, tmp_path: Path
) -> None:
    last, scored = (item.apply_to(synthetic.tiny_profile(GRID)) for item in (result, result.scored))
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
    # Later blocks build on the model that was scored.
    profiles = unfinished.Profiles.of(synthetic.tiny_profile(GRID)).after(result)
    kept = UnfinishedCalibration.open(tmp_path / "kept", "key")
    kept.add(BlockOutcome("color", BlockState.DONE, "good"), profiles, None)
    again = UnfinishedCalibration.open(tmp_path / "kept", "key").profiles
    assert again is not None
    for found in (profiles, again):
        assert found.basis.color is not None and found.final.color is not None
        seen = set(found.basis.color.provenance.inputs)
        assert seen == {"background", *result.train_names}
        assert set(found.final.color.provenance.inputs) > seen


@pytest.mark.thorough
def test_an_image_without_its_press_is_not_in_the_last_fit(captures: CaptureSet) -> None:
    empty, surfaces = captures.split(4).heldout[0], synthetic_captures(12)[1]
    spoilt = synthetic.with_images(
        captures, {empty: np.round(captures.background).astype(np.uint8)}
    )
    result = calibrated(spoilt, surfaces, options=BRIEF)
    assert result.final is not None
    wanted = {press.name for press in captures.presses} - {captures.presses[empty].name}
    assert set(result.final.inputs) == wanted
    assert calibrated(spoilt, surfaces, options=BRIEF, holdout_every=0).final is None


@pytest.mark.thorough
def test_light_that_changes_within_the_image_asks_for_bands() -> None:
    """Lamps in stripes of a fifth of the image: the plain network smooths them away."""
    captures, surfaces = synthetic_captures(20, noise=1.0, seed=3)
    stripes = 1 + np.sin(2 * np.pi * 5 * np.arange(GRID.width_px) / GRID.width_px)[None, :, None]
    truth = [
        synthetic.flat_background() + synthetic.known_change(surface) * stripes
        for surface in surfaces
    ]
    rng = np.random.default_rng(0)
    frames = [
        replace(frame, image=np.clip(image + rng.normal(0, 1, image.shape), 0, 255))
        for frame, image in zip(frames_of(captures, surfaces), truth, strict=True)
    ]
    error, scene = {}, CaptureScene.of(captures, None)
    for bands in (0, 4):
        fit = fit_color_model(frames[5:], scene, replace(QUICK, position_bands=bands))
        off = []
        for frame, wanted in zip(frames[:5], truth[:5], strict=True):
            rendered = tactile_image(fit.model, fit.background, frame.surface)
            disc = frame.circle.distance_px(GRID) <= frame.circle.radius_px
            off.append(np.abs(rendered - wanted)[disc].mean())
        error[bands] = np.mean(off)
    assert error[4] < 0.6 * error[0], error


@pytest.mark.parametrize("width", [5.0, 40.0])
def test_the_width_says_how_far_pixels_that_are_far_off_draw(width: float) -> None:
    """The answer a draws by (1 - share) (a - levels) against share * width: in closed form."""
    levels, far_off, count = 10.0, 100.0, 4000
    rng = np.random.default_rng(3)
    slope = rng.uniform(0.2, 0.5, (count, 2)) * rng.choice([-1, 1], (count, 2))
    normals = np.concatenate([-slope, np.ones((count, 1))], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    change = np.full((count, 3), levels)
    change[rng.uniform(size=count) < 0.3] += far_off  # A hair, a glint.
    up = np.tile([0.0, 0.0, 1.0], (count, 1))
    uv, depth = rng.uniform(-1, 1, (count, 2)), rng.uniform(-0.4, -0.1, count)
    samples = ColorSamples(
        uv=uv, normals=normals, rest_normals=up, displacement_mm=depth, change=change
    )
    options = ColorFitOptions(
        steps=400, batch_pixels=1024, hidden=(8,), learning_rate=0.02, huber_levels=width
    )
    model, curve = train(samples, PixelGrid(40, 30, 0.1, 0.1), options)
    found = model.predict_pixels(np.arange(count) % (40 * 30), normals, depth, up)
    share = np.mean(change[:, 0] > levels)
    drawn = share / (1 - share) * width
    assert np.median(found) - levels == pytest.approx(drawn, rel=0.25)
    # Slope 1 beyond the width: a mean absolute error [levels].
    near, far = drawn**2 / 2, width * (far_off - drawn - width / 2)
    loss = np.mean([loss for step, loss in curve if step > 300])
    assert loss == pytest.approx(((1 - share) * near + share * far) / width, rel=0.1)
