# SPDX-License-Identifier: Apache-2.0
"""A small report with every section, from made-up numbers."""

from __future__ import annotations

import numpy as np

from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.report.figures_color import disc_normals
from taccel_lab.report.model import (
    ColorScore,
    ColorSection,
    DetectionSection,
    ForceDepth,
    HeldoutFrame,
    LossCurve,
    MeshSection,
    NormalDisc,
    PressMaps,
    PressRecord,
    PressSection,
    Report,
    Stage,
    Target,
)

GRID = PixelGrid(80, 60, 0.1, 0.1)


def score(psnr_db: float) -> ColorScore:
    return ColorScore(psnr_db, 0.96, 2.5, 1.9, 2.2)


def heldout_frame(name: str, psnr_db: float) -> HeldoutFrame:
    rng = np.random.default_rng(3)
    real = rng.integers(0, 255, (60, 80, 3)).astype(np.uint8)
    rendered = real + rng.normal(0, 8, real.shape)
    # The circle is cut by the image's border.
    return HeldoutFrame(name, real, rendered, (9.0, 30.0, 12.0), score(psnr_db), score(21.0))


def press(name: str, force_n: float, **changes: object) -> PressRecord:
    values = {
        "depth_mm": 0.8,
        "force_n": force_n,
        "residual_n": 2e-6,
        "newton_iterations": 8.5,
        "seconds_per_step": 1.25,
        "min_distance_m": 4e-6,
        "steps": 10,
        "contact_radius_mm": 1.2,
    }
    return PressRecord(name, **{**values, **changes})


def mesh_section() -> MeshSection:
    nodes = np.array([[0, 0, 0], [2e-3, 0, 0], [0, 2e-3, 0], [0, 0, -1e-3]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    regions = np.array([Region.CONTACT, Region.SIDE, Region.SIDE, Region.BOND])
    angles = np.array([[54.7, 90, 90, 90, 35.3, 35.3]])
    return MeshSection(4, 1, 35.3, nodes, faces, regions, angles, {"Mesher": "by hand"})


def full_report() -> Report:
    frames = tuple(heldout_frame(f"press {i}", psnr) for i, psnr in enumerate((34.0, 29.5, 36.5)))
    depth = np.array([0.2, 0.4, 0.8])
    discs = tuple(
        NormalDisc((u, v), 80 * np.nan_to_num(disc_normals(17)), 0.9, 0.7)
        for u in (20.0, 60.0)
        for v in (15.0, 45.0)
    )
    x = np.linspace(-1, 1, 80)[None] + np.zeros((60, 1))
    normals = np.stack([x * 0.5, 0 * x, np.sqrt(1 - 0.25 * x**2)], axis=-1)
    mesh = mesh_section()
    forces = np.zeros((4, 3))
    forces[0] = [0.1, 0.0, -0.5]
    labelled = np.array([[30.0, 30.0, 10.0], [40.0, 20.0, 12.0], [20.0, 40.0, 11.0]])
    detected = labelled + [[1.0, 0.0, 0.5], [0.0, -3.0, -1.0], [np.nan, np.nan, np.nan]]
    return Report(
        title="Sample <report>",
        subtitle="made up",
        targets=(
            Target("color.heldout.crop_psnr_db", "crop PSNR", 34.0, True, "dB", 1, "too dark."),
            Target("color.heldout.disc_l1", "L1 in the disc", 2.6, False, "levels"),
            Target("color.heldout.nothing", "something else", 1.0, True),
        ),
        color=ColorSection(
            score(33.3),
            score(21.0),
            frames,
            9,
            discs,
            LossCurve(np.arange(5), np.geomspace(1, 0.1, 5)),
            2.4,
            {"Parameters": 1234},
        ),
        press=PressSection(
            press("press 0", 2.0),
            (press("press 0", 2.0), press("press 1", 2.5, min_distance_m=3e-6)),
            ForceDepth("simulation", depth, depth**1.5),
            PressMaps(
                GRID,
                1e-4 * x,
                normals,
                100 + 50 * normals,
                mesh.nodes_m,
                mesh.faces[:1],
                forces,
                np.linalg.norm(forces, axis=1) / 1e-6,
            ),
            {"Friction": 0.5},
        ),
        mesh=mesh,
        detection=DetectionSection(("a", "b", "c"), labelled, detected),
        stages=(Stage("Mesh", 1.5), Stage("Press", 4.5)),
        remarks=("A remark.",),
        provenance={"warp-lang": "1.19.0"},
    )
