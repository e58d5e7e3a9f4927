# SPDX-License-Identifier: Apache-2.0
"""Depth of grey sensors: synthetic round trips with faults, and the authors' own 9DTact presses."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import CapturedPress, CaptureSet, ContactCircle
from taccel_lab.calibration.circles.grey import find_grey_contact
from taccel_lab.calibration.grey.curve import (
    SECTOR_COUNT,
    fit_response,
    left_out_errors,
    reading_sigma_mm,
)
from taccel_lab.calibration.grey.depth_page import depth_page
from taccel_lab.calibration.grey.fit import fit_depth
from taccel_lab.calibration.grey.result import DepthCalibration
from taccel_lab.calibration.normals.read_surface import SurfaceReader
from taccel_lab.calibration.press_options import DepthOptions
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile, load_profile, save_profile
from taccel_lab.report.page import write_page
from taccel_lab.signals.depth_response import DepthResponse
from tests.support.real_data import real_data
from tests.support.synthetic_presses import flat_profile, memory_captures, with_circles, with_images

GRID = PixelGrid(200, 150, 0.1, 0.1)
BALL_MM = 4.0
NINE = "9dtact_official/shape_reconstruction/calibration"

TRUE = DepthResponse("grey", np.linspace(0, 80, 81), 1.6 * (np.linspace(0, 1, 81) ** 1.2))


def captures_of(
    circles: list[ContactCircle], noise: float = 0.0, seed: int = 0, labelled: bool = True
) -> CaptureSet:
    """Ball presses on a grey sensor whose depth below the rim answers by ``TRUE``."""
    rng = np.random.default_rng(seed)
    background = np.full((GRID.height_px, GRID.width_px, 3), 160.0)
    images = []
    for circle in circles:
        distance = circle.distance_px(GRID) * GRID.mm_per_px_x
        rim = circle.radius_px * GRID.mm_per_px_x
        depth = np.sqrt(np.maximum(BALL_MM**2 - distance**2, 0)) - np.sqrt(BALL_MM**2 - rim**2)
        image = TRUE.render(np.maximum(depth, 0.0), background)
        images.append(image + rng.normal(0, noise, image.shape[:2])[..., None])
    labels = circles if labelled else [None] * len(circles)
    return memory_captures(labels, images, background, GRID, BALL_MM, "9dtact")


CIRCLES = [
    ContactCircle(70.3, 60.1, 26.0),
    ContactCircle(125.7, 85.2, 29.0),
    ContactCircle(95.0, 75.0, 31.5),
]


def grey_unit() -> tuple[CaptureSet, SensorProfile]:
    """Noisy presses before a background in whole levels, and the profile that they give."""
    captures = captures_of(CIRCLES, noise=1.0)
    captures = replace(captures, background=captures.background.astype(np.uint8))
    return captures, fit_depth(captures, DepthOptions(zero="rim")).apply_to(flat_profile(GRID))


def test_perfect_presses_give_the_curve() -> None:
    result = fit_depth(captures_of(CIRCLES), DepthOptions(zero="rim"))
    inside = (result.response.drop_levels > 3) & (result.response.drop_levels < 60)
    wanted = TRUE.depth_of(result.response.drop_levels[inside])
    assert result.response.depth_mm[inside] == pytest.approx(wanted, abs=2e-3)
    assert result.left_out == "press"
    # The deepest press lies partly beyond the curve of the others, which ends there.
    assert np.median(result.left_out_mm) < 2e-3
    assert result.left_out_mm.mean() < 0.02
    assert result.response.depth_mm[0] == 0.0


@pytest.mark.thorough
def test_noisy_presses_lie_within_their_spread() -> None:
    inside = slice(8, 55)
    errors = []
    for seed in range(3):
        result = fit_depth(captures_of(CIRCLES, noise=1.0, seed=seed), DepthOptions(zero="rim"))
        level = result.response.drop_levels
        error = result.response.depth_mm - TRUE.depth_of(level)
        # Noise in the abscissa draws a curve's ends towards the middle, by well under a level.
        assert np.abs(error[inside]).max() < 0.03
        spread = np.hypot(result.spread_mm, 0.003)
        errors.append((error / spread)[inside])
    assert np.mean(np.abs(np.concatenate(errors)) < 3.0) > 0.85


@pytest.mark.thorough
def test_contacts_are_found_without_circles() -> None:
    captures = captures_of(CIRCLES, noise=1.0, labelled=False)
    for press, circle in zip(captures.presses, CIRCLES, strict=True):
        drop = (captures.background - press.image())[..., 0]
        found = find_grey_contact(drop, GRID, name=press.name)
        off = np.hypot(found.circle.u_px - circle.u_px, found.circle.v_px - circle.v_px)
        assert off < 0.5
        # Smoothing moves the steepest place inwards.
        assert circle.radius_px - 2.5 < found.circle.radius_px < circle.radius_px + 1.0
    result = fit_depth(captures)
    assert result.left_out_mm.mean() < 0.08
    assert not any(p.given for p in result.presses)


def test_one_press_is_judged_by_its_eighths() -> None:
    result = fit_depth(captures_of(CIRCLES[:1], noise=1.0), DepthOptions(zero="rim"))
    assert result.left_out == "eighth of the contact"
    assert result.left_out_mm.mean() < 0.05
    assert any(remark.code == "too_few" for remark in result.remarks)


def codes(result: DepthCalibration) -> dict[str, str]:
    return {remark.code: str(remark.severity) for remark in result.remarks}


@pytest.mark.thorough
def test_a_dark_patch_that_the_border_cuts_is_read_where_its_label_puts_it() -> None:
    cut = ContactCircle(GRID.width_px - 12.0, 70.0, 28.0)
    captures = captures_of([*CIRCLES, cut])
    result = fit_depth(captures, DepthOptions(zero="rim"))
    assert len(result.presses) == len(CIRCLES) + 1 and result.presses[-1].given
    assert result.presses[-1].mae_mm < 0.02
    unlabelled = captures_of([*CIRCLES, cut], labelled=False)
    for left_out in (
        fit_depth(unlabelled, DepthOptions(zero="rim")),
        fit_depth(captures, DepthOptions(zero="rim", circles="detected")),
    ):
        assert len(left_out.presses) == len(CIRCLES)
        (message,) = [r.message for r in left_out.remarks if r.code == "presses_left_out"]
        assert "p3" in message and "touches the image's border" in message
    with pytest.raises(InputError, match="touches the image's border"):
        fit_depth(captures_of([cut]), DepthOptions(circles="detected"))


@pytest.mark.thorough
def test_labels_off_the_dark_patch_are_weak() -> None:
    captures = captures_of(CIRCLES, noise=0.5)
    assert not {"labels_off", "too_few", "heldout_error"} & codes(fit_depth(captures)).keys()
    moved = [replace(circle, u_px=circle.u_px - 9) for circle in CIRCLES]
    result = fit_depth(with_circles(captures, moved))
    assert codes(result)["labels_off"] == "error"
    far = replace(CIRCLES[0], u_px=160.0, v_px=110.0)
    lost = replace(captures, presses=(replace(captures.presses[0], circle=far),))
    with pytest.raises(InputError, match="given circles disagree with the images"):
        fit_depth(lost)


@pytest.mark.thorough
def test_presses_at_one_spot_or_that_answer_differently_are_told() -> None:
    assert codes(fit_depth(captures_of([CIRCLES[0]] * 3, noise=0.5)))["too_few"] == "warning"
    # One press under a third of the light of the others: no curve fits both.
    captures = captures_of(CIRCLES[:2])
    dim = captures.background - 0.35 * (captures.background - captures.presses[1].image())
    result = fit_depth(with_images(captures, {1: dim}))
    assert codes(result)["heldout_error"] in ("warning", "error")


@pytest.mark.thorough
def test_poisoned_masked_pixels_have_no_effect() -> None:
    captures = captures_of(CIRCLES, noise=1.0, labelled=False)
    mask = np.ones((GRID.height_px, GRID.width_px), dtype=bool)
    mask[50:56, 60:75] = False
    mask[:, :6] = False
    captures = replace(captures, mask=mask)

    dirty = with_images(
        captures, [np.where(mask[..., None], p.image(), 0.0) for p in captures.presses]
    )
    one, two = fit_depth(captures), fit_depth(dirty)
    assert np.array_equal(one.response.depth_mm, two.response.depth_mm)
    assert one.presses == two.presses


@pytest.mark.thorough
def test_profile_and_report(tmp_path: Path) -> None:
    captures = captures_of(CIRCLES, noise=1.0)
    captures = replace(captures, background=captures.background.astype(np.uint8))
    result = fit_depth(captures, DepthOptions(zero="rim"))
    save_profile(result.apply_to(flat_profile(GRID, thickness_mm=BALL_MM)), tmp_path / "profile")
    profile = load_profile(tmp_path / "profile")
    assert profile.depth_response is not None
    assert profile.depth_response.provenance.residuals["left_out_depth_mm"] > 0
    found = SurfaceReader(profile).read(captures.presses[2].image())
    rim = CIRCLES[2].radius_px * GRID.mm_per_px_x
    deepest = BALL_MM - np.sqrt(BALL_MM**2 - rim**2)
    assert -1e3 * found.rise_m.min() == pytest.approx(deepest, abs=0.06)
    assert found.method == "depth" and found.sigma_deg is None
    figures = found.figures(GRID)
    assert figures["sigma_of"] == "absolute depth" and not figures["warnings"]
    assert figures["max_depth_sigma_mm"] >= result.zero_sigma_mm
    (new,) = captures_of([ContactCircle(100.0, 70.0, 28.0)], noise=1.0, seed=9).presses
    (exact,) = captures_of([ContactCircle(100.0, 70.0, 28.0)]).presses
    read = SurfaceReader(profile).read(new.image())
    drop = (captures.background - exact.image())[..., 0]
    contact = drop > result.response.drop_levels[1]
    off_mm = np.abs(-1e3 * read.rise_m - TRUE.depth_of(drop))[contact]
    assert read.reading_sigma_m is not None and read.height_sigma_m is not None
    assert 0.9 < (off_mm <= 2e3 * read.reading_sigma_m[contact]).mean() <= 1.0
    assert (read.height_sigma_m >= read.reading_sigma_m).all()
    write_page(depth_page(result), tmp_path / "report")
    assert (tmp_path / "report" / "curve.png").stat().st_size > 5_000


def test_unusable_images_are_refused() -> None:
    empty = np.random.default_rng(0).normal(0, 1, (150, 200))
    with pytest.raises(InputError, match="no contact found"):
        find_grey_contact(empty, GRID, name="empty.png")
    edge = np.zeros((150, 200))
    edge[:, 90:100] = 40.0
    with pytest.raises(InputError, match="no round contact"):
        find_grey_contact(edge, GRID)
    captures = captures_of(CIRCLES)
    with pytest.raises(InputError, match="not below the ball's"):
        fit_depth(replace(captures, ball_radius_mm=3.14), DepthOptions(zero="rim"))


def real_press(unit: int, mm_per_px: float) -> DepthCalibration:
    folder = real_data(f"{NINE}/sensor_{unit}/depth_calibration")
    image, background = folder / "rectify_crop_sample.png", folder / "rectify_crop_ref.png"
    untouched = read_image(background)
    return fit_depth(
        CaptureSet(
            str(folder), "9dtact", untouched, file_sha256(background),
            np.ones(untouched.shape[:2], dtype=bool), 4.0,
            PixelGrid(untouched.shape[1], untouched.shape[0], mm_per_px, mm_per_px),
            (
                CapturedPress(
                    "ball", str(image), file_sha256(image), partial(read_image, image)
                ),
            ),
            {},
        )
    )  # fmt: skip


@pytest.mark.parametrize(("unit", "mm_per_px"), [(1, 0.0510151), (2, 0.0499950)])
def test_the_authors_tables_of_two_units(unit: int, mm_per_px: float) -> None:
    """Their Pixel_to_Depth.npy, made from the same press by averaging and a circle of their own."""
    result = real_press(unit, mm_per_px)
    table = np.load(real_data(f"{NINE}/sensor_{unit}/depth_calibration/Pixel_to_Depth.npy"))
    drop = np.arange(5, len(table))
    off = result.response.depth_of(drop) - table[drop]
    assert np.abs(off).mean() < 0.035
    assert np.abs(off - off.mean()).mean() < 0.012
    assert result.left_out_mm.mean() < 0.035
    sigma = result.response.sigma_of(drop)
    assert sigma is not None and (np.abs(off) <= sigma).all()


@pytest.mark.thorough
@pytest.mark.parametrize(("unit", "mm_per_px"), [(1, 0.0510151), (2, 0.0499950)])
def test_the_reading_of_an_eighth_is_held_by_the_other_seven(unit: int, mm_per_px: float) -> None:
    """And both zeros that the image shows by the whole."""
    result = real_press(unit, mm_per_px)
    (part,) = result.parts
    held = []
    for sector in range(SECTOR_COUNT):
        out = part.sector == sector
        rest = part.of(~out)
        sigma_mm = reading_sigma_mm(left_out_errors([rest])[0])
        off = fit_response([rest]).depth_of(part.drop_levels[out]) - part.depth_mm[out]
        held.append([np.mean(np.abs(off) <= k * sigma_mm) for k in (1, 2)])
    one, two = np.mean(held, axis=0)
    assert 0.65 < one < 0.9 and 0.9 < two <= 1.0
    by_rim = fit_depth(result.captures, DepthOptions(zero="rim")).response
    sigma = result.response.sigma_of(part.drop_levels)
    apart = by_rim.depth_of(part.drop_levels) - result.response.depth_of(part.drop_levels)
    assert sigma is not None and (np.abs(apart) <= sigma).all()


@pytest.mark.thorough
def test_depths_of_another_units_press_lie_within_two_deviations() -> None:
    one, two = real_press(1, 0.0510151), real_press(2, 0.0499950)
    for a, b in ((one, two), (two, one)):
        drop, sigma = b.parts[0].drop_levels, a.response.sigma_of(b.parts[0].drop_levels)
        off = np.abs(a.response.depth_of(drop) - b.parts[0].depth_mm)
        # By up to 0.3 mm, ten times what the reading alone is off by.
        assert sigma is not None and (off <= 2 * sigma).mean() > 0.93


def test_the_headline_counts_the_zero() -> None:
    circles = [ContactCircle(60 + 40 * i, 70.0, 18.0 + 2 * i) for i in range(3)]
    captures = captures_of(circles, noise=0.4)
    found = {zero: fit_depth(captures, DepthOptions(zero=zero)) for zero in ("untouched", "rim")}
    for zero, result in found.items():
        # Images show two zeros; which of them is chosen does not make the other one wrong.
        apart = abs(np.mean([p.rim_depth_mm for p in found["untouched"].presses]))
        assert result.zero_gap_mm == pytest.approx(apart, abs=1e-3)
        assert result.absolute_mm >= result.zero_sigma_mm >= result.offset_sigma_mm > 0
        assert result.absolute_mm >= result.left_out_mm.mean()
        figures = result.figures()
        assert figures["absolute_mm"] == result.absolute_mm and figures["zero"] == zero
        assert result.headline().startswith(f"absolute depths are off by {result.absolute_mm:.2f}")


def test_travel_of_a_press_settles_the_zero() -> None:
    """The rim lies 0.2 mm below the untouched face, whatever the grey at no drop says."""
    captures = captures_of(CIRCLES)
    rim_mm = CIRCLES[1].radius_px * GRID.mm_per_px_x
    travel_mm = BALL_MM - np.sqrt(BALL_MM**2 - rim_mm**2) + 0.2
    first, second, third = captures.presses
    measured = replace(captures, presses=(first, replace(second, depth_mm=travel_mm), third))
    rim, known = fit_depth(captures, DepthOptions(zero="rim")), fit_depth(measured)
    assert rim.zero == "rim" and known.zero == "travel"
    assert [press.rim_depth_mm for press in known.presses] == pytest.approx([0.2] * 3)
    deeper = known.response.depth_mm[1:] - rim.response.depth_mm[1:]
    assert deeper == pytest.approx(0.2, abs=1e-6)
    # No image leaves it open any more: what first touch may be off by is left.
    assert known.zero_sigma_mm == pytest.approx(0.05) and "zero_unsure" not in codes(known)
    with pytest.raises(InputError, match="zero travel needs depth_mm"):
        fit_depth(captures, DepthOptions(zero="travel"))
