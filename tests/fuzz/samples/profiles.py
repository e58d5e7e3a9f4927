# SPDX-License-Identifier: Apache-2.0
"""Profiles of two tets and a dozen pixels, with every block."""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Callable
from os.path import isfile
from pathlib import Path

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.networks.force_settings import ForceModelConfig
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.profile import (
    BackgroundBlock,
    CameraBlock,
    ColorBlock,
    DepthResponseBlock,
    ForceBlock,
    LightsBlock,
    NormalsBlock,
    SensorProfile,
    save_profile,
)
from tests.fuzz.samples.captures import write_image
from tests.support.sample_blocks import ASSUMED, CALIBRATED, sample_blocks

_OLD = Path(__file__).parents[2] / "profile" / "old"
GRID = PixelGrid(12, 9, 0.03, 0.031)
_MOST = 1 << 24
"""Bytes of a file that is looked into."""


def whole(given: Path) -> None:
    """A folder ``profile``."""
    save_profile(_profile(), given / "profile")


def with_pictures(given: Path) -> None:
    """A profile and pictures for it to read."""
    whole(given)
    rng = np.random.default_rng(0)
    size = (GRID.height_px, GRID.width_px)
    # Levels of an untouched gel, and nearly the same: a press leaves most of the image as it was.
    rest = rng.integers(0, 250, (*size, 3), dtype=np.uint8)
    write_image(given / "background.png", rest)
    write_image(given / "press.png", rest + rng.integers(0, 5, rest.shape, dtype=np.uint8))
    write_image(given / "mask.png", np.full(size, 255, np.uint8))


def with_force(given: Path) -> None:
    """A profile with a force model."""
    config = ForceModelConfig(
        GRID.width_px, GRID.height_px, columns=3, rows=2, patch_px=2, widths=(3,), blocks=1,
        hidden=3, most=(1.0, 1.0, 1.0, 1.0), distance_limits=(1.0, 1.0, 1.0),
    )  # fmt: skip
    weights = _weights(config.weight_shapes(), np.random.default_rng(5))
    weights = {name: np.float32(0.5) * value for name, value in weights.items()}
    weights["colors.most"] = np.full(26, 50.0, np.float32)
    block = ForceBlock(architecture=config.to_dict(), provenance=CALIBRATED)
    save_profile(_profile().with_block(block, weights), given / "profile")


def old(given: Path) -> None:
    """A profile as an earlier version wrote it."""
    shutil.copytree(_OLD / "v3", given / "profile")


def with_views(given: Path) -> None:
    """A profile with a further camera."""
    profile = _profile()
    save_profile(profile.with_view("left", profile), given / "profile")


def seal_views(given: Path) -> None:
    """Let ``profile.toml`` state the hashes of the views and their files as they are now."""
    seal(given / "profile" / "views", "left")
    path, view = (given / "profile" / one for one in ("profile.toml", "views/left/profile.toml"))
    if isfile(view) and view.stat().st_size <= _MOST:
        digest = hashlib.sha256(view.read_bytes()).hexdigest()
        _reworded(path, r'left = "[0-9a-f]{64}"', f'left = "{digest}"')


def seal(given: Path, name: str = "profile") -> None:
    """Let the ``profile.toml`` of a folder state the hashes of the files as they are now."""

    def hashed(match: re.Match[str]) -> str:
        file = given / name / match[1]
        # No error where a link leads to what is no file name at all, as Path.is_file has.
        if not isfile(file) or file.stat().st_size > _MOST:
            return match[0]
        return f'"{match[1]}" = "{hashlib.sha256(file.read_bytes()).hexdigest()}"'

    pattern = r'"(\w+\.(?:npz|safetensors))" = "[0-9a-f]{64}"'
    _reworded(given / name / "profile.toml", pattern, hashed)


def _reworded(path: Path, pattern: str, by: str | Callable[[re.Match[str]], str]) -> None:
    """Replace what a file says, if it is one, and no large one."""
    if not isfile(path) or path.is_symlink() or path.stat().st_size > _MOST:
        return
    text = path.read_bytes().decode("utf-8", errors="surrogateescape")
    path.write_bytes(re.sub(pattern, by, text).encode("utf-8", errors="surrogateescape"))


def _profile() -> SensorProfile:
    shared = sample_blocks()
    rng = np.random.default_rng(7)
    color = ColorModelConfig(GRID.width_px, GRID.height_px, hidden=(3,))
    normal = NormalModelConfig(GRID.width_px, GRID.height_px, hidden=(3,), small_hidden=(2,))
    return SensorProfile(
        sensor=shared.sensor,
        gel=shared.gel,
        material=shared.material,
        camera=CameraBlock.from_grid(GRID, ASSUMED),
        mesh=shared.mesh,
        optics=shared.optics,
        window=shared.window,
        coating=shared.coating,
        lights=LightsBlock(led=(shared.light,), provenance=ASSUMED),
        markers=shared.markers,
        background=BackgroundBlock(provenance=ASSUMED),
        background_rgb=rng.integers(0, 256, (9, 12, 3), dtype=np.uint8),
        color=ColorBlock(architecture=color.to_dict(), provenance=CALIBRATED),
        color_weights=_weights(color.weight_shapes(), rng),
        normals=NormalsBlock(architecture=normal.to_dict(), provenance=CALIBRATED),
        normal_weights={
            name: 0.1 * value for name, value in _weights(normal.weight_shapes(), rng).items()
        },
        depth_response=DepthResponseBlock(
            drop_levels=(0.0, 10.0, 40.0), depth_mm=(0.0, 0.2, 0.9), provenance=CALIBRATED
        ),
    )


def _weights(shapes: dict[str, tuple[int, ...]], rng: np.random.Generator) -> dict[str, np.ndarray]:
    return {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
