# SPDX-License-Identifier: Apache-2.0
"""Comparisons find what was changed, and nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.comparison import compare_profiles
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.profile import (
    BackgroundBlock,
    ColorBlock,
    DepthResponseBlock,
    Provenance,
    SensorProfile,
)
from taccel_lab.report.page import write_page
from tests.support.synthetic_presses import GRID, tiny_profile


def provenance(**spread: float) -> Provenance:
    return Provenance(kind="measured", method="made up for a test", source="none", spread=spread)


def colored_profile(seed: int = 0, scale: float = 1.0) -> SensorProfile:
    config = ColorModelConfig(GRID.width_px, GRID.height_px, hidden=(8,))
    rng = np.random.default_rng(seed)
    weights = {
        name: (scale if name == "layer1.weight" else 1.0)
        * rng.normal(0, 0.5, shape).astype(np.float32)
        for name, shape in config.weight_shapes().items()
    }
    image = np.full((GRID.height_px, GRID.width_px, 3), 100, dtype=np.uint8)
    return (
        tiny_profile(GRID)
        .with_block(BackgroundBlock(provenance=provenance()), image)
        .with_block(ColorBlock(architecture=config.to_dict(), provenance=provenance()), weights)
    )


def test_equal_profiles_do_not_differ() -> None:
    found = compare_profiles(colored_profile(), colored_profile())
    assert found.fields == []
    assert found.responses.color_l1_levels == 0 and found.responses.background_l1_levels == 0
    assert found.remarks == ()


def test_a_value_is_measured_in_the_spread_of_both() -> None:
    first = colored_profile()
    soft = first.material.replace(
        young_modulus_pa=1.5e5, provenance=provenance(young_modulus_pa=3e3)
    )
    hard = soft.replace(young_modulus_pa=1.6e5, provenance=provenance(young_modulus_pa=4e3))
    found = compare_profiles(first.with_block(soft), first.with_block(hard))
    (field,) = found.fields
    assert (field.block, field.field) == ("material", "young_modulus_pa")
    assert field.difference == pytest.approx(1e4) and field.sigma == pytest.approx(5e3)
    assert field.z == pytest.approx(2.0) and field.significant
    assert [remark.code for remark in found.remarks] == ["significant"]
    near = compare_profiles(
        first.with_block(soft), first.with_block(hard.replace(young_modulus_pa=1.55e5))
    )
    assert not near.fields[0].significant and near.remarks == ()


def test_networks_are_compared_by_their_answers() -> None:
    found = compare_profiles(colored_profile(), colored_profile(scale=1.3))
    assert found.fields == []
    responses = found.responses
    assert responses.color_l1_levels == pytest.approx(0.3 * responses.color_size_levels, rel=1e-3)
    assert [remark.code for remark in found.remarks] == ["other_colors"]


def test_images_at_rest_and_depth_curves() -> None:
    first = colored_profile()
    brighter = np.full((GRID.height_px, GRID.width_px, 3), (110, 100, 90), dtype=np.uint8)
    block = DepthResponseBlock(
        drop_levels=(0.0, 50.0), depth_mm=(0.0, 1.0), provenance=provenance()
    )
    second = first.with_block(BackgroundBlock(provenance=provenance()), brighter)
    found = compare_profiles(
        first.with_block(block), second.with_block(block.replace(drop_levels=(0.0, 100.0)))
    )
    assert found.responses.background_l1_levels == pytest.approx(20 / 3)
    assert found.responses.background_gain_rgb == pytest.approx((1.1, 1.0, 0.9))
    # At a drop of 50 one says 1 mm and the other 0.5 mm.
    assert found.responses.depth_response_max_mm == pytest.approx(0.5, abs=0.01)


def test_a_missing_block_is_named() -> None:
    full = colored_profile()
    found = compare_profiles(full, full.without("color"))
    (field,) = found.fields
    assert (field.block, field.a, field.b) == ("color", "present", "missing")
    assert found.responses.color_l1_levels is None


def test_the_page_holds_the_figures(tmp_path: Path) -> None:
    found = compare_profiles(colored_profile(0), colored_profile(1), ("left", "right"))
    write_page(found.page(), tmp_path / "out")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"report.html", "report.json", "backgrounds.png", "color_responses.png"} <= names
    data = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert data["responses"]["color_l1_levels"] > 0 and data["verdict"] == "usable"
    assert "left against right" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
