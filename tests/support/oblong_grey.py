# SPDX-License-Identifier: Apache-2.0
"""A grey sensor whose depths follow from its levels, with all that slips hide behind: pixels twice
as wide as high, an image that is not square, a gel frame that begins beside its middle."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import (
    BackgroundBlock,
    CameraBlock,
    DepthResponseBlock,
    Provenance,
    SensorProfile,
)
from taccel_lab.reading.bonded_layer import FAR_MM, BondedLayer, press_layer
from taccel_lab.sensors.profile import catalogue_profile

GRID = PixelGrid(72, 96, 0.2, 0.1, center_u_px=30.5, center_v_px=52.0)
THICK_MM, NU, PA = 4.0, 0.46, 3e5
BALL_MM, DEPTH_MM, AT_MM = 4.0, 0.6, (1.2, -0.7)
LEVELS_PER_MM = 50.0
KNOWN = Provenance(kind="measured", method="made up for a test", source="none")


@cache
def _pad() -> SensorProfile:
    size = {"length_x_mm": 30.0, "length_y_mm": 30.0, "young_modulus_mpa": 1e-6 * PA}
    return catalogue_profile("flat_pad", {"thickness_mm": THICK_MM, "poisson_ratio": NU, **size})


def grey_profile(**changes: dict[str, Any]) -> SensorProfile:
    """The sensor; ``changes`` of ``provenance`` by the block: ``gel``, ``material``, ``camera``; or
    of the fields of ``depth_response``. Without any all is known nearly to perfection."""
    made = _pad()
    known = {
        "gel": {"spread": {"thickness_mm": 1e-4}},
        "material": {"spread": {"young_modulus_pa": 10.0, "poisson_ratio": 1e-7}},
        "camera": {"spread": {"mm_per_px_x": 1e-6, "mm_per_px_y": 1e-6}},
    }
    said = {name: {**known[name], **changes.get(name, {})} for name in known}
    blocks = {"gel": made.gel, "material": made.material}
    blocks["camera"] = CameraBlock.from_grid(GRID, KNOWN)
    for name, block in blocks.items():
        of = KNOWN.model_copy(update=said[name])
        blocks[name] = block.replace(provenance=of)
    v, u = np.meshgrid(*(np.linspace(-1, 1, n) for n in (96, 72)), indexing="ij")
    background = np.rint(150 + 8 * u - 5 * v + 6 * u * v)
    made = made.with_block(blocks["material"]).with_block(blocks["camera"])
    made = made.with_block(blocks["gel"], made.mesh)
    made = made.with_block(
        BackgroundBlock(provenance=KNOWN), np.repeat(background[..., None], 3, 2).astype(np.float32)
    )
    curve = {"drop_levels": (0.0, 1.0, 100.0), "depth_mm": (0.0, 0.02, 100.0 / LEVELS_PER_MM)}
    stated = {"reading_sigma_mm": 1e-4, **changes.get("depth_response", {})}
    return made.with_block(DepthResponseBlock(**curve, **stated, provenance=KNOWN))


def ball_depth_mm(depth_mm: float = DEPTH_MM) -> np.ndarray:
    """How deep a ball at ``AT_MM`` presses the face of a bonded layer, on finer pixels that are
    square, [96, 144]."""
    fine = GRID.resized(2 * GRID.width_px, GRID.height_px)
    x, y = np.meshgrid(fine.x_mm() - AT_MM[0], fine.y_mm() - AT_MM[1])
    away2 = x**2 + y**2
    cap = BALL_MM - np.sqrt(np.maximum(BALL_MM**2 - away2, 0.0))
    tool = np.where(away2 < BALL_MM**2, cap, FAR_MM)
    step = fine.mm_per_px_x, fine.mm_per_px_y
    return -press_layer(tool, depth_mm, step, BondedLayer(THICK_MM, NU)).rise_mm


def ball_image(profile: SensorProfile, depth_mm: float = DEPTH_MM) -> np.ndarray:
    """What it shows of such a ball, float levels."""
    deep = ball_depth_mm(depth_mm).reshape(GRID.height_px, GRID.width_px, 2).mean(axis=2)
    assert profile.background_rgb is not None
    return profile.background_rgb - LEVELS_PER_MM * np.maximum(deep, 0.0)[..., None]
