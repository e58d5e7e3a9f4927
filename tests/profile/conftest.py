# SPDX-License-Identifier: Apache-2.0
"""A small complete profile to start from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.profile import (
    BackgroundBlock,
    CameraBlock,
    CoatingBlock,
    ColorBlock,
    GelBlock,
    HousingBlock,
    LayerMaterial,
    LightEntry,
    LightsBlock,
    MarkersBlock,
    MaterialBlock,
    OpticsBlock,
    Provenance,
    SensorBlock,
    SensorProfile,
    WindowBlock,
    save_profile,
)


@pytest.fixture(scope="session")
def provenance() -> Provenance:
    return Provenance(kind="assumed", method="made up for a test", source="none")


@pytest.fixture(scope="session")
def full_profile(provenance: Provenance) -> SensorProfile:
    nodes = np.array([[0, 0, 0], [1, 0, -1], [0, 1, -1], [0, 0, -1], [1, 1, 0]]) * 1e-3
    tets = np.array([[0, 2, 1, 3], [0, 1, 2, 4]])
    faces = boundary_faces(tets)
    mesh = TetMesh(nodes, tets, faces, np.arange(len(faces)) % 4, tet_layers=np.array([1, 0]))
    rng = np.random.default_rng(7)
    grid = PixelGrid(12, 9, 0.03, 0.031, center_u_px=5.25)
    return SensorProfile(
        sensor=SensorBlock(
            name="bench unit 3",
            family="gelsight",
            parameters={"width_mm": 17.0, "divisions": [3, 4], "domed": False, "note": "a"},
            provenance=provenance,
        ),
        gel=GelBlock(
            thickness_mm=1.0,
            node_count=5,
            tet_count=2,
            min_dihedral_deg=54.7,
            provenance=provenance,
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
            provenance=provenance,
        ),
        camera=CameraBlock.from_grid(grid, provenance),
        mesh=mesh,
        optics=OpticsBlock(
            width_px=12,
            height_px=9,
            fx_px=400.0,
            fy_px=399.0,
            cx_px=5.25,
            cy_px=4.0,
            distortion=(-0.1, 0.02, 0.0, 0.001),
            position_mm=(0.0, 0.5, -12.0),
            raw_width_px=640,
            raw_height_px=480,
            crop_x=0.7,
            ambient_rgb=(0.1, 0.1, 0.2),
            provenance=provenance,
        ),
        window=WindowBlock(thickness_mm=2.0, size_mm=(4.0, 3.0), provenance=provenance),
        coating=CoatingBlock(albedo_rgb=(0.5, 0.4, 0.5), specular=0.1, provenance=provenance),
        lights=LightsBlock(
            led=(
                LightEntry(
                    name="red",
                    position_mm=(9.0, 0.0, -3.0),
                    direction=(-1.0, 0.0, 0.0),
                    rgb=(1.0, 0.0, 0.1),
                    size_mm=(2.0, 1.0),
                ),
                LightEntry(
                    position_mm=(-9.0, 0.0, -3.0), direction=(1.0, 0.0, 0.0), rgb=(0.0, 1.0, 0.0)
                ),
            ),
            provenance=provenance,
        ),
        markers=MarkersBlock(
            rows=3, columns=4, pitch_x_mm=1.5, pitch_y_mm=1.6, radius_mm=0.3, provenance=provenance
        ),
        housing=HousingBlock(
            size_mm=(20.0, 18.0, 25.0),
            wall_mm=1.2,
            corner_radius_mm=1.0,
            front_z_mm=-4.0,
            provenance=provenance,
        ),
        background=BackgroundBlock(provenance=provenance),
        background_rgb=rng.integers(0, 256, (9, 12, 3), dtype=np.uint8),
        color=ColorBlock(
            architecture={"layer_widths": [5, 16, 3], "activation": "tanh", "scale": 0.5},
            provenance=Provenance(
                kind="calibrated",
                method="least squares",
                source="48 ball presses",
                inputs={"captures.npz": "ab" * 32},
                residuals={"heldout_l1_levels": 2.5},
                spread={"heldout_l1_levels": 0.25},
                valid_region={"slope_deg": (0.0, 62.0)},
            ),
        ),
        color_weights={
            "layer0.weight": rng.normal(size=(16, 5)).astype(np.float32),
            "layer0.bias": rng.normal(size=16).astype(np.float32),
        },
    )


@pytest.fixture
def profile_folder(full_profile: SensorProfile, tmp_path: Path) -> Path:
    folder = tmp_path / "profile"
    save_profile(full_profile, folder)
    return folder
