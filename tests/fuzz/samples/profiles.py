# SPDX-License-Identifier: Apache-2.0
"""Profiles of two tets and a dozen pixels, with every block."""

from __future__ import annotations

import hashlib
import re
import shutil
from pathlib import Path

import numpy as np

from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.profile import (
    BackgroundBlock,
    CameraBlock,
    CoatingBlock,
    ColorBlock,
    DepthResponseBlock,
    GelBlock,
    LayerMaterial,
    LightEntry,
    LightsBlock,
    MarkersBlock,
    MaterialBlock,
    NormalsBlock,
    OpticsBlock,
    Provenance,
    SensorBlock,
    SensorProfile,
    WindowBlock,
    save_profile,
)
from taccel_lab.signals import color_model, normal_model
from tests.fuzz.samples.captures import write_image

_OLD = Path(__file__).parents[2] / "profile" / "old"
GRID = PixelGrid(12, 9, 0.03, 0.031)
_ASSUMED = Provenance(kind="assumed", method="made up for a test", source="none")
_CALIBRATED = Provenance(
    kind="calibrated",
    method="least squares",
    source="48 ball presses",
    inputs={"captures.npz": "ab" * 32},
    residuals={"heldout_l1_levels": 2.5},
    spread={"heldout_l1_levels": 0.25},
    valid_region={"slope_deg": (0.0, 62.0)},
)


def whole(given: Path) -> None:
    """A folder ``profile``."""
    save_profile(_profile(), given / "profile")


def with_pictures(given: Path) -> None:
    """A profile and pictures for it to read."""
    whole(given)
    rng = np.random.default_rng(0)
    size = (GRID.height_px, GRID.width_px)
    for name in ("press.png", "background.png"):
        write_image(given / name, rng.integers(0, 256, (*size, 3), dtype=np.uint8))
    write_image(given / "mask.png", np.full(size, 255, np.uint8))


def old(given: Path) -> None:
    """A profile as an earlier version wrote it."""
    shutil.copytree(_OLD / "v3", given / "profile")


def seal(given: Path) -> None:
    """Let ``profile.toml`` state the hashes of the files as they are now."""
    path = given / "profile" / "profile.toml"
    if not path.is_file() or path.is_symlink() or path.stat().st_size > 1 << 24:
        return
    text = path.read_bytes().decode("utf-8", errors="surrogateescape")

    def hashed(match: re.Match[str]) -> str:
        file = given / "profile" / match[1]
        if not file.is_file() or file.stat().st_size > 1 << 24:
            return match[0]
        return f'"{match[1]}" = "{hashlib.sha256(file.read_bytes()).hexdigest()}"'

    text = re.sub(r'"(\w+\.(?:npz|safetensors))" = "[0-9a-f]{64}"', hashed, text)
    path.write_bytes(text.encode("utf-8", errors="surrogateescape"))


def _profile() -> SensorProfile:
    nodes = np.array([[0, 0, 0], [1, 0, -1], [0, 1, -1], [0, 0, -1], [1, 1, 0]]) * 1e-3
    tets = np.array([[0, 2, 1, 3], [0, 1, 2, 4]])
    faces = boundary_faces(tets)
    rng = np.random.default_rng(7)
    color = color_model.ColorModelConfig(GRID.width_px, GRID.height_px, hidden=(3,))
    normal = normal_model.NormalModelConfig(GRID.width_px, GRID.height_px, hidden=(3,))
    return SensorProfile(
        sensor=SensorBlock(
            name="bench unit 3",
            family="gelsight",
            parameters={"width_mm": 17.0, "divisions": [3, 4], "domed": False, "note": "a"},
            provenance=_ASSUMED,
        ),
        gel=GelBlock(
            thickness_mm=1.0,
            node_count=5,
            tet_count=2,
            min_dihedral_deg=54.7,
            provenance=_ASSUMED,
        ),
        material=MaterialBlock(
            young_modulus_pa=1.5e5,
            poisson_ratio=0.48,
            density_kg_m3=1070.0,
            friction_coefficient=0.6,
            layers=(
                LayerMaterial(
                    name="skin", young_modulus_pa=3e5, poisson_ratio=0.4, density_kg_m3=1100.0
                ),
            ),
            provenance=_ASSUMED,
        ),
        camera=CameraBlock.from_grid(GRID, _ASSUMED),
        mesh=TetMesh(nodes, tets, faces, np.arange(len(faces)) % 4, tet_layers=np.array([1, 0])),
        optics=OpticsBlock(
            width_px=12,
            height_px=9,
            fx_px=400.0,
            fy_px=399.0,
            cx_px=5.25,
            cy_px=4.0,
            distortion=(-0.1, 0.02, 0.0, 0.001),
            position_mm=(0.0, 0.5, -12.0),
            provenance=_ASSUMED,
        ),
        window=WindowBlock(thickness_mm=2.0, size_mm=(4.0, 3.0), provenance=_ASSUMED),
        coating=CoatingBlock(albedo_rgb=(0.5, 0.4, 0.5), specular=0.1, provenance=_ASSUMED),
        lights=LightsBlock(
            led=(
                LightEntry(
                    position_mm=(-9.0, 0.0, -3.0), direction=(1.0, 0.0, 0.0), rgb=(0.0, 1.0, 0.0)
                ),
            ),
            provenance=_ASSUMED,
        ),
        markers=MarkersBlock(
            rows=3, columns=4, pitch_x_mm=1.5, pitch_y_mm=1.6, radius_mm=0.3, provenance=_ASSUMED
        ),
        background=BackgroundBlock(provenance=_ASSUMED),
        background_rgb=rng.integers(0, 256, (9, 12, 3), dtype=np.uint8),
        color=ColorBlock(architecture=color.to_dict(), provenance=_CALIBRATED),
        color_weights=_weights(color_model.expected_shapes(color), rng),
        normals=NormalsBlock(architecture=normal.to_dict(), provenance=_CALIBRATED),
        normal_weights=_weights(normal_model.expected_shapes(normal), rng),
        depth_response=DepthResponseBlock(
            drop_levels=(0.0, 10.0, 40.0), depth_mm=(0.0, 0.2, 0.9), provenance=_CALIBRATED
        ),
    )


def _weights(shapes: dict[str, tuple[int, ...]], rng: np.random.Generator) -> dict[str, np.ndarray]:
    return {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
