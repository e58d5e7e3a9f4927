# SPDX-License-Identifier: Apache-2.0
"""Calibration of normals: synthetic round trips with faults, masks, curved gels, blocks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import ContactCircle, load_capture_folder
from taccel_lab.calibration.capture.captures import without_labels
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.circles.labels import LabelPlacement
from taccel_lab.calibration.color.options import ColorFitOptions
from taccel_lab.calibration.normals import fit, score
from taccel_lab.calibration.normals.fit import calibrate_normals, fit_normals
from taccel_lab.calibration.normals.network_fit import TASK, TASK_AGAIN, InverseTraining
from taccel_lab.calibration.normals.normals_page import normals_page
from taccel_lab.calibration.normals.options import InverseFitOptions
from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.normals.samples import angle_between_deg, ball_center_px, ball_normals
from taccel_lab.calibration.response.frame import EXACT, CaptureScene, FittedPresses, HeldoutSet
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.reading.bonded_layer import FAR_MM, press_layer
from taccel_lab.reading.reader import Reader
from taccel_lab.report.page import write_page
from taccel_lab.report.remark import Verdict, judge
from taccel_lab.signals.normals import normals_from_height, rotate_from_z
from taccel_lab.signals.rest_surface import flat_rest
from tests.calibration.drawn import faults
from tests.calibration.drawn.faults import quantise
from tests.calibration.normals.conftest import PAD, QUICK, Clean, calibrated, changed
from tests.support.analytic_surface import analytic_surface
from tests.support.synthetic_presses import (
    BALL_RADIUS_MM,
    GRID,
    circles_of,
    flat_background,
    flat_profile,
    known_change,
    synthetic_captures,
    tiny_profile,
    true_surface,
    with_images,
    without_check,
    write_captures,
)
from tests.support.synthetic_presses import calibrated as fit_colors

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.thorough
def test_a_label_that_its_image_rejects_widens_nothing(clean: Clean) -> None:
    captures, _, result = clean
    split = captures.split(4)
    wrong, training = split.heldout_names[0], captures.only(split.train)
    doubted = replace(captures, presses=without_labels(captures.presses, [wrong]))
    reading = score.read_heldout(
        result.fit.model, HeldoutSet.of(doubted, split, true_surface),
        LabelPlacement.of(training.presses, circles_of(training)), result.scene, EXACT,
    )  # fmt: skip
    assert [item.name for item in reading.items if item.rejected] == [wrong]
    # Three presses are too few to widen a band.
    assert reading.model.config == result.fit.model.config and len(reading.items) == 4
    found = replace(result, heldout=reading.items, rejected=frozenset([wrong]))
    others = [item.used.mean_deg for item in result.heldout if item.name != wrong]
    assert found.heldout_means("used")["mean_deg"] == pytest.approx(np.mean(others))
    apart = found.figures()["rejected_labels"]
    assert list(apart) == [wrong] and apart[wrong] < 5.0


@pytest.mark.thorough
def test_perfect_captures_are_read_to_the_networks_precision(clean: Clean) -> None:
    captures, surfaces, result = clean
    assert tuple(item.name for item in result.heldout) == captures.split(4).heldout_names
    for item in result.heldout:
        # A level of 255, which the images are rounded to, is about half a degree here.
        assert item.used.mean_deg < 1.5 and item.used.flat_deg > 15
        assert item.used.depth_mae_mm < 0.03
        surface = surfaces[int(item.name[1:])]
        off = angle_between_deg(item.predicted.normals, surface.normals)
        assert off.mean() < 1.5  # over the whole image, skirt and all
        assert -1e3 * item.height_m.min() == pytest.approx(surface.depth_mm, rel=0.08)
    assert judge(result.remarks) is not Verdict.WEAK
    left_out = float(np.mean(list(result.fit.left_out_deg.values())))
    assert 0.5 * left_out < result.fit.curve[-1][2] < 2 * left_out  # The curve is of degrees, too.


@pytest.mark.thorough
def test_noisy_captures_err_as_expected() -> None:
    result = calibrated(*synthetic_captures(16, noise=6.0))
    found = result.reliability
    assert found is not None and 0.75 < found.ratio() < 1.3
    assert 0.55 < found.within_68 < 0.85 and found.within_95 > 0.88
    assert found.expected_deg == tuple(sorted(found.expected_deg))
    errors = [row["used"]["mean_deg"] for row in result.figures()["presses"]]
    assert errors == sorted(errors, reverse=True)


@pytest.mark.thorough
@pytest.mark.parametrize(("count", "verdict"), [(3, Verdict.WEAK), (5, Verdict.USABLE)])
def test_a_few_presses_do_not_make_a_good_model(count: int, verdict: Verdict) -> None:
    captures, surfaces = synthetic_captures(count, noise=1.0)
    result = fit_normals(
        FittedPresses(captures, circles_of(captures), surfaces), replace(QUICK, steps=20)
    )
    assert judge(r for r in result.remarks if r.code == "too_few") is verdict


@pytest.mark.thorough
def test_a_wrong_circle_stands_out_where_its_press_was_left_out() -> None:
    captures, surfaces = synthetic_captures(12, noise=1.0)
    circles = circles_of(captures)
    circles[4] = replace(circles[4], u_px=circles[4].u_px + 5)
    surfaces[4] = true_surface(circles[4], BALL_RADIUS_MM)
    result = fit_normals(FittedPresses(captures, circles, surfaces), QUICK)
    errors = result.fit.left_out_deg
    assert max(errors, key=lambda name: errors[name]) == "p4"
    assert errors["p4"] > 2 * np.median(list(errors.values()))
    assert any(remark.code == "nothing_held_out" for remark in result.remarks)


@pytest.mark.thorough
def test_poisoned_masked_pixels_have_no_effect() -> None:
    captures, surfaces = synthetic_captures(8)
    mask = np.ones((GRID.height_px, GRID.width_px), dtype=bool)
    mask[40:60, 70:90] = False
    captures, rng = replace(captures, mask=mask), np.random.default_rng(0)
    spoilt = changed(captures, lambda image, _: quantise(faults.poison(image, mask, rng)))
    short = replace(QUICK, steps=30)
    one, two = (calibrated(some, surfaces, options=short) for some in (captures, spoilt))
    for name, weight in one.fit.model.weights.items():
        assert np.array_equal(weight, two.fit.model.weights[name])
    assert [i.used for i in one.heldout] == [i.used for i in two.heldout]


@pytest.mark.thorough
def test_drifting_light_is_taken_off() -> None:
    captures, surfaces = synthetic_captures(10, noise=0.5)
    rng = np.random.default_rng(3)
    gains, offsets = rng.uniform(0.9, 1.1, (10, 3)), rng.uniform(-15, 15, (10, 3))

    def drifted(image: np.ndarray, i: int) -> np.ndarray:
        return quantise(faults.drift(image.astype(float), gains[i], offsets[i]))

    found = calibrated(changed(captures, drifted), surfaces)
    assert np.mean([i.used.mean_deg for i in found.heldout]) < 3.0


@pytest.mark.parametrize(
    ("gain", "own_background"),
    [((0.9, 1.0, 1.0), False), ((0.8,) * 3, False), ((1.08,) * 3, False), ((1.2,) * 3, True)],
)
def test_light_that_was_never_calibrated_is_taken_off(
    clean: Clean, gain: tuple[float, float, float], own_background: bool
) -> None:
    """A lamp that ages or a camera that warms up is no contact and changes none; a brighter unit
    reads the same depth against its own background."""
    captures, _, result = clean
    profile = result.apply_to(flat_profile(GRID))
    reader, rest = Reader(profile), np.asarray(profile.background_rgb)
    held = captures.presses[captures.split(4).heldout[0]].image()
    one = reader.read(held).figures()
    if own_background:
        reader = Reader(profile, background=np.clip(rest * gain, 0, 255))
    two = reader.read(quantise(held * gain)).figures()
    within = 0.05 if own_background else 0.08
    assert two["depth_mm"] == pytest.approx(one["depth_mm"], rel=within)
    if not own_background:
        assert two["dent_mm2"] == pytest.approx(one["dent_mm2"], rel=0.05)
        assert reader.read(quantise(rest * gain)).figures()["dent_mm2"] == 0.0


@pytest.mark.slow
def test_light_that_changes_within_the_image_asks_for_bands(tmp_path: Path) -> None:
    """Lamps in stripes of a quarter of the image: the same colour means another tilt beside."""
    captures, surfaces = synthetic_captures(16, noise=0.0, seed=3)
    stripes = 1 + 0.6 * np.sin(2 * np.pi * 4 * np.arange(GRID.width_px) / GRID.width_px)
    images = [flat_background() + known_change(s) * stripes[None, :, None] for s in surfaces]
    striped = with_images(captures, [np.clip(image, 0, 255) for image in images])
    results = [
        calibrated(striped, surfaces, options=replace(QUICK, steps=500, position_bands=bands))
        for bands in (0, 3)
    ]
    off = [np.mean([item.used.mean_deg for item in result.heldout]) for result in results]
    assert off[1] < 0.7 * off[0], off
    save_profile(results[1].scored.apply_to(flat_profile(GRID)), tmp_path / "profile")
    held = striped.presses[striped.split(4).heldout[0]]
    found = Reader(load_profile(tmp_path / "profile")).read(held.image())
    assert found.normals == pytest.approx(results[1].heldout[0].predicted.normals, abs=1e-6)


@pytest.mark.thorough
def test_profile_reads_what_the_calibration_read(clean: Clean, tmp_path: Path) -> None:
    captures, surfaces, result = clean
    save_profile(result.scored.apply_to(flat_profile(GRID)), tmp_path / "profile")
    profile = load_profile(tmp_path / "profile")
    assert profile.normals is not None
    provenance = profile.normals.provenance
    held = captures.split(4).heldout
    assert set(provenance.inputs) == {"background"} | {f"p{i}" for i in range(16) if i not in held}
    assert provenance.residuals["heldout_failures"] == 0
    assert provenance.residuals["heldout_mean_deg"] < 1.5
    assert provenance.verdict == judge(result.remarks).value
    reader = Reader(profile)
    found = reader.read(captures.presses[held[0]].image())
    assert found.normals == pytest.approx(result.heldout[0].predicted.normals, abs=1e-6)
    depth_mm = 1e3 * found.depth_m
    assert depth_mm.max() == pytest.approx(surfaces[held[0]].depth_mm, rel=0.08)
    circle, figures = circles_of(captures)[held[0]], found.figures()
    assert figures["deepest_px"] == pytest.approx([circle.u_px, circle.v_px], abs=2.5)
    still = reader.read(np.asarray(profile.background_rgb))
    assert not still.touch.any and np.abs(still.depth_m).max() < 5e-6
    write_page(normals_page(result), tmp_path / "report")
    assert (tmp_path / "report" / "errors.png").stat().st_size > 10_000


def test_balls_are_those_of_the_analytic_surface() -> None:
    grid = PixelGrid(80, 60, 0.08, 0.1)
    circle = ContactCircle(41.3, 28.7, 16.0)
    surface = analytic_surface(circle, grid, 2.0)
    inside = circle.distance_px(grid) <= 0.99 * circle.radius_px
    found = ball_normals(circle, CaptureScene(np.empty(0), grid, 2.0))
    # The analytic surface is interpolated in a table of 8192 radii.
    assert angle_between_deg(found, surface.normals)[inside].max() < 0.1
    circle = ContactCircle(80.0, 60.0, 15.0)
    depth = score.ball_depth_mm(circle, CaptureScene(flat_background(), GRID, 2.0))
    assert depth[60, 80] == pytest.approx(2.0 - np.sqrt(4.0 - 2.25))
    assert depth[60, 95] == pytest.approx(0.0, abs=1e-12)
    # On a tilted face they stand off along its normal.
    grid = PixelGrid(81, 81, 0.05, 0.05)
    rest = np.broadcast_to(np.array([0.3, 0.0, np.sqrt(1 - 0.09)]), (81, 81, 3))
    circle = ContactCircle(40.0, 40.0, 20.0)
    scene = CaptureScene(np.empty(0), grid, 2.0, rest_normals=rest)
    u, v = ball_center_px(circle, scene)
    assert (u - 40) * 0.05 == pytest.approx(0.3 * np.sqrt(2.0**2 - 1.0**2))
    assert v == 40.0
    # The normal points from each place on the ball to its centre, which lies to the right.
    normal = ball_normals(circle, scene)[40, 40]
    assert normal[:2] * 2.0 == pytest.approx([(u - 40) * 0.05, 0.0])


@pytest.mark.thorough
def test_curved_gel_is_read_relative_to_its_rest() -> None:
    """Colours that tell the tilt from rest, on a face of 12 mm radius: a DIGIT's kind of gel."""
    u, v = np.meshgrid(GRID.x_mm(), GRID.y_mm())
    rest = np.stack([u / 20, v / 20, np.ones_like(u)], axis=-1)
    rest /= np.linalg.norm(rest, axis=-1, keepdims=True)
    captures, surfaces = synthetic_captures(12, noise=0.0)
    # The contact's own normals, turned with the face: what the lamps see is the same tilt.
    bent = [
        replace(surface, normals=rotate_from_z(surface.normals, rest), rest_normals=rest)
        for surface in surfaces
    ]
    face = replace(flat_rest(GRID), normals=rest)
    for item in calibrated(captures, bent, rest=face).heldout:
        wanted = bent[int(item.name[1:])].normals
        circle = item.frame.circle
        sink_in = circle.distance_px(GRID) > 1.1 * circle.radius_px
        # The contact itself follows the ball in the gel frame, here 2 to 6 degrees from the turned
        # cap; outside it the resting frame is everything.
        assert angle_between_deg(item.predicted.normals, wanted)[sink_in].mean() < 1.5
        flat = np.broadcast_to(np.array([0.0, 0.0, 1.0]), wanted.shape)
        assert angle_between_deg(flat, wanted)[sink_in].mean() > 6


@pytest.mark.thorough
def test_grey_captures_are_called_so() -> None:
    captures, surfaces = synthetic_captures(8)
    changes = [known_change(surface)[..., :1] for surface in surfaces]
    grey = with_images(captures, [quantise(captures.background + change) for change in changes])
    result = calibrated(grey, surfaces, options=replace(QUICK, steps=50))
    assert any(remark.code == "grey_or_colour" for remark in result.remarks)
    assert judge(result.remarks) is Verdict.WEAK


@pytest.mark.parametrize(("call", "words"), [
    (lambda c, s: InverseTraining([], CaptureScene.of(c, None), QUICK), "at least one press"),
    (lambda c, s: fit_normals(FittedPresses(c, [], s)),
     "3 presses need as many circles and surfaces"),
    (lambda c, s: InverseFitOptions(members=0), "members must be at least 1"),
    (lambda c, s: InverseFitOptions(position_bands=9), r"-bands of .* must lie in \[0, 8\], got 9"),
    (lambda c, s: fit_normals(
        FittedPresses(replace(c, mask=c.mask & False), circles_of(c), s), QUICK),
     "masked|usable"),
    (lambda c, s: Reader(tiny_profile(GRID)), "neither a normals nor a depth_response"),
])  # fmt: skip
def test_bad_fits_are_refused(call: Callable[..., object], words: str) -> None:
    captures, surfaces = synthetic_captures(3)
    with pytest.raises(InputError, match=words):
        call(captures, surfaces)


@pytest.mark.thorough
def test_edges_and_punches_are_read(synthetic: NormalCalibration, tmp_path: Path) -> None:
    """Absolute depths of tools that no ball resembles, in their band; balls alone read half."""
    save_profile(synthetic.apply_to(flat_profile(GRID)), tmp_path / "profile")
    reader = Reader(load_profile(tmp_path / "profile"))
    x, y = np.meshgrid(GRID.x_mm(), GRID.y_mm())
    wedge = np.where(np.abs(y) < 3, np.abs(x), FAR_MM)
    box = np.where((np.abs(x) < 1.5) & (np.abs(y) < 1.5), 0.0, FAR_MM)
    for tool, within_mm in ((wedge, 0.05), (box, 0.1)):
        rise_mm = press_layer(tool, 0.5, (0.1, 0.1), PAD).rise_mm
        flat, rise_m = flat_rest(GRID), 1e-3 * rise_mm
        shown = rise_m, flat.height_m, normals_from_height(rise_m, GRID), flat.normals
        surface = BallSurface(*shown, 0.5, "layer")
        found = reader.read(np.clip(flat_background() + known_change(surface), 0, 255))
        off = np.abs(1e3 * found.depth_m + rise_mm)
        dent = rise_mm < -0.02
        assert np.sqrt(np.mean(off[dent] ** 2)) < within_mm
        assert found.height_sigma_m is not None
        assert (off <= 2e3 * found.height_sigma_m)[dent].mean() > 0.8
        # Slopes of 45 degrees and more, where no ball was steeper than 53.
        assert found.figures()["depth_mm"] > 0.3


def test_every_stage_ends(synthetic: NormalCalibration, stages: dict[str, tuple[int, int]]) -> None:
    """Reading takes longer than the fit, and its bar stood at the fit's last step."""
    fitted, *read = list(stages)[list(stages).index(TASK) :]
    assert stages[fitted] == (800, 800)
    assert read == [fit.READING, fit.READING_BALLS, score.READING, TASK_AGAIN]
    assert all(done == total for done, total in stages.values())
    assert stages[score.READING][1] == len(synthetic.heldout)
    # Absolute depths of held-out balls are scored.
    absolute = synthetic.absolute_means()
    assert absolute["mae_mm"] < 0.04 and 0.6 < absolute["within_95"] <= 1.0
    figures = synthetic.figures()
    assert figures["heldout"]["absolute_depth"] == absolute
    assert figures["synthetic_presses"]["count"] > 10
    assert synthetic.fit.model.config.height_factor > 0
    assert 40 < synthetic.fit.model.config.cone_deg < 60


def test_an_untouched_image_is_not_touched(synthetic: NormalCalibration, tmp_path: Path) -> None:
    """Drift of the integrated height is no contact."""
    save_profile(synthetic.apply_to(flat_profile(GRID)), tmp_path / "profile")
    reader = Reader(load_profile(tmp_path / "profile"))
    rng = np.random.default_rng(0)
    image = flat_background() + 6.0 * np.linspace(-1, 1, GRID.width_px)[None, :, None]
    found = reader.read(np.clip(image + rng.normal(0, 1, image.shape), 0, 255))
    assert found.figures()["dent_mm2"] == 0.0


@pytest.mark.thorough
@pytest.mark.parametrize("seen", [True, False])
def test_synthetic_presses_do_not_take_colours_that_have_seen_held_out_ones(
    seen: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    captures, surfaces = synthetic_captures(8)
    without_check(monkeypatch)
    folder = load_capture_folder(write_captures(tmp_path / "captures", captures))
    held = set(captures.split(4).heldout_names)
    files = {p.name: p.sha256 for p in folder.presses if (p.name in held) == seen}
    options = ColorFitOptions(hidden=(8,), steps=1)
    base = fit_colors(captures, surfaces, options=options).apply_to(flat_profile(GRID, 3.0))
    assert base.color is not None and base.color_weights is not None
    provenance = base.color.provenance.model_copy(update={"inputs": files})
    block = base.color.model_copy(update={"provenance": provenance})
    base = base.without("color").with_block(block, base.color_weights)
    given: list[object] = []

    def look(_: object, __: object, colors: object, *___: object) -> None:
        given.append(colors)
        raise InputError("looked at")

    monkeypatch.setattr(fit, "fit_normals", look)
    with pytest.raises(InputError, match="looked at"):
        calibrate_normals(folder, base)
    assert (given[0] is None) == seen
