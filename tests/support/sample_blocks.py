# SPDX-License-Identifier: Apache-2.0
"""Parts of a small made-up profile, for the tests of profiles and the samples that are damaged.

Samples that are damaged keep their bytes: kept seeds are dealt from them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.profile import (
    CameraBlock,
    CoatingBlock,
    GelBlock,
    LayerMaterial,
    LightEntry,
    MarkersBlock,
    MaterialBlock,
    OpticsBlock,
    Provenance,
    SensorBlock,
    SensorProfile,
    WindowBlock,
)

ASSUMED = Provenance(kind="assumed", method="made up for a test", source="none")
CALIBRATED = Provenance(
    kind="calibrated",
    method="least squares",
    source="48 ball presses",
    inputs={"captures.npz": "ab" * 32},
    residuals={"heldout_l1_levels": 2.5},
    spread={"heldout_l1_levels": 0.25},
    valid_region={"slope_deg": (0.0, 62.0)},
)


def bare_profile(
    mesh: TetMesh, grid: PixelGrid, name: str = "test", thickness_mm: float = 1.0
) -> SensorProfile:
    """The blocks that every profile has, for a gel."""
    return SensorProfile(
        sensor=SensorBlock(name=name, family="gelsight", provenance=ASSUMED),
        gel=GelBlock(
            thickness_mm=thickness_mm, node_count=mesh.node_count, tet_count=mesh.tet_count,
            min_dihedral_deg=1.0, provenance=ASSUMED,
        ),
        material=MaterialBlock(
            young_modulus_pa=1.5e5, poisson_ratio=0.48, density_kg_m3=1000.0,
            friction_coefficient=0.5, provenance=ASSUMED,
        ),
        camera=CameraBlock.from_grid(grid, ASSUMED),
        mesh=mesh,
    )  # fmt: skip


@dataclass(frozen=True)
class SampleBlocks:
    """What both profiles have alike."""

    sensor: SensorBlock
    gel: GelBlock
    material: MaterialBlock
    mesh: TetMesh
    optics: OpticsBlock
    light: LightEntry
    window: WindowBlock
    coating: CoatingBlock
    markers: MarkersBlock


def sample_blocks() -> SampleBlocks:
    """Anew for each profile."""
    nodes = np.array([[0, 0, 0], [1, 0, -1], [0, 1, -1], [0, 0, -1], [1, 1, 0]]) * 1e-3
    tets = np.array([[0, 2, 1, 3], [0, 1, 2, 4]])
    faces = boundary_faces(tets)
    return SampleBlocks(
        sensor=SensorBlock(
            name="bench unit 3",
            family="gelsight",
            parameters={"width_mm": 17.0, "divisions": [3, 4], "domed": False, "note": "a"},
            provenance=ASSUMED,
        ),
        gel=GelBlock(
            thickness_mm=1.0,
            node_count=5,
            tet_count=2,
            min_dihedral_deg=54.7,
            provenance=ASSUMED,
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
            provenance=ASSUMED,
        ),
        mesh=TetMesh(nodes, tets, faces, np.arange(len(faces)) % 4, tet_layers=np.array([1, 0])),
        optics=OpticsBlock(
            width_px=12, height_px=9, fx_px=400.0, fy_px=399.0, cx_px=5.25, cy_px=4.0,
            distortion=(-0.1, 0.02, 0.0, 0.001), position_mm=(0.0, 0.5, -12.0), provenance=ASSUMED,
        ),
        light=LightEntry(
            position_mm=(-9.0, 0.0, -3.0), direction=(1.0, 0.0, 0.0), rgb=(0.0, 1.0, 0.0)
        ),
        window=WindowBlock(thickness_mm=2.0, size_mm=(4.0, 3.0), provenance=ASSUMED),
        coating=CoatingBlock(albedo_rgb=(0.5, 0.4, 0.5), specular=0.1, provenance=ASSUMED),
        markers=MarkersBlock(
            rows=3, columns=4, pitch_x_mm=1.5, pitch_y_mm=1.6, radius_mm=0.3, provenance=ASSUMED
        ),
    )  # fmt: skip
