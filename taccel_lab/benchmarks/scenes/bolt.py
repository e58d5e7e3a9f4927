# SPDX-License-Identifier: Apache-2.0
"""Two gels turn a nut on a bolt by one pitch: helical contact of 8,000 with 3,000 faces.

The bolt stands still, its head above; the nut is free and begins in the middle of its play, some
0.4 mm all around. The gels close on two flats of its hexagon and go around the axis once at their
height, while the thread lifts the nut by a pitch: flank slides on flank under the weight of the nut
and the drag of the gels, along which the flats must slip.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.benchmarks.scenes.base import (
    BenchScene,
    SceneOptions,
    facing,
    make_config,
    mounted,
    pose,
    same_side,
    turn_about,
)
from taccel_lab.exporters.published_meshes import choose_source, mesh_folder, read_stl
from taccel_lab.geometry import TetMesh
from taccel_lab.scene import AffineBody, KinematicBody, Scene, TimeStepping, TriangleMesh
from taccel_lab.tasks.parts import APOTHEM_M, PITCH_M, hexagon_nut, threaded_rod
from taccel_lab.tasks.peg_scene import (
    GEL_FRICTION,
    GRAVITY,
    STIFF_FRICTION,
    generated_parts,
    published_parts,
)

DT_S = 1 / 50
DENSITY = 1000.0
FACE_M = 2e-3
"""Height of a gel's contact face in its frame."""
GAP_M, SQUEEZE_M = 0.3e-3, 0.5e-3
STEPS = (8, 180)
"""Closing, turning."""
FRICTION_SPEED_M_S = 1e-3
"""Sliding speed below which friction is static: the flats slip at about that."""


def parts_of(source: str) -> tuple[TetMesh, TriangleMesh, TriangleMesh, float]:
    """Gel, bolt, nut, and the height at which the nut begins [m]."""
    if source == "generated":
        return generated_parts().gel, threaded_rod(), hexagon_nut(), 4 * PITCH_M
    folder = mesh_folder()
    bolt, nut = (read_stl(folder / "bolt_and_nut" / f"m20_{n}_wt.stl") for n in ("bolt", "nut"))
    return published_parts(folder).gel, bolt, nut, 0.0


def build(options: SceneOptions) -> BenchScene:
    """The published meshes where they are."""
    source = choose_source(options.source, "bolt_and_nut", "pads/sensor.vtk", "peg/peg.stl")
    gel, bolt, nut, height = parts_of(source)
    gels, mounts = mounted({"left": gel, "right": gel}, GEL_FRICTION)
    start = np.array([0, 0, height, 0, 0, 0, 1.0])
    middle = height + (nut.vertices_m[:, 2].min() + nut.vertices_m[:, 2].max()) / 2
    scene = Scene(
        gels,
        [*mounts, KinematicBody(bolt, STIFF_FRICTION, name="bolt")],
        options.env_count,
        TimeStepping(quasi_static=False, dt_s=DT_S, gravity_m_s2=GRAVITY),
        affine_bodies=AffineBody(nut, DENSITY, 1e9, "nut", STIFF_FRICTION, initial_pose=start),
    )
    config = make_config({"dhat_m": 1e-4, "friction_speed_m_s": FRICTION_SPEED_M_S}, options.config)
    return BenchScene(
        "bolt",
        f"two gels turn a nut of {len(nut.faces):,} faces on a bolt of {len(bolt.faces):,} by a "
        "pitch",
        scene,
        config,
        gel_path(middle),
        source,
    )


def gel_path(middle_m: float) -> np.ndarray:
    """Poses of both mounts and the bolt, [steps + 1, 3, 7]; ``middle_m``: height of the nut."""
    close, turn = STEPS
    moments = np.arange(close + turn + 1)
    gaps = np.interp(moments, [0, close], [GAP_M, -SQUEEZE_M])
    angles = np.interp(moments, [close, close + turn], [0, 2 * np.pi])
    rows = []
    for gap, angle in zip(gaps, angles, strict=True):
        around = turn_about((0.0, 0.0, 1.0), angle)
        row = []
        for side in (-1.0, 1.0):
            outward = around @ [-side, 0.0, 0.0]
            place = -outward * (APOTHEM_M + gap + FACE_M) + [0.0, 0.0, middle_m]
            row.append(pose(facing(outward, around @ [0.0, 1.0, 0.0]), place))
        row.append(np.array([0, 0, 0, 0, 0, 0, 1.0]))
        rows.append(row)
    return same_side(np.array(rows))
