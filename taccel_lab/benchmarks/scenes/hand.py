# SPDX-License-Identifier: Apache-2.0
"""The 17 gels of a tactile hand close on a free ball, carry it up and turn it.

The published gels come in the frames of their links, without the hand. Here each stands on its
own mount, its contact face tangent to a ball of 45 mm radius: the two gels of the palm below, the
four fingers of three gels each up one side, 18 degrees apart, the three gels of the thumb up the
other. All mounts move along their normals until each gel is pressed in by 0.4 mm, then all
together. Gels meet the ball only: in the hand they are on links that keep apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.benchmarks.scenes.base import (
    BenchScene,
    SceneOptions,
    facing,
    label,
    make_config,
    mounted,
    pose,
    same_side,
    turn_about,
)
from taccel_lab.benchmarks.scenes.drag import touching_height
from taccel_lab.exporters.published_meshes import choose_source, mesh_folder
from taccel_lab.files.tet_file import read_tet_file
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import AffineBody, Scene, Surface, TimeStepping, sphere_mesh
from taccel_lab.tasks.peg_scene import GEL_FRICTION, GRAVITY, STIFF_FRICTION

DT_S = 1 / 50
BALL_M, BALL_EDGE_M, BALL_DENSITY = 45e-3, 6e-3, 300.0
GAP_M, SQUEEZE_M = 0.2e-3, 0.4e-3
LIFT_M, TURN_RAD = 10e-3, np.pi / 6
STEPS = (12, 38)
"""Closing, carrying."""
GEL_LAYER, BALL_LAYER = 1, 2


@dataclass(frozen=True)
class GelPlace:
    """Where a gel touches the ball and how it lies there."""

    link: str
    """Name of the published gel."""
    polar_deg: float
    """Angle from straight below, over +y."""
    lateral_deg: float = 0.0
    """Angle towards +x."""
    along: bool = True
    """Whether its long side follows the polar direction."""


def hand() -> list[GelPlace]:
    """The 17 places."""
    palm = [
        GelPlace("base_link_gel_0", -20, along=False),
        GelPlace("base_link_gel_1", 25, along=False),
    ]
    fingers = [
        GelPlace(f"f_{joint}_gel", polar, lateral)
        for lateral in (-27.0, -9.0, 9.0, 27.0)
        for joint, polar in ((1, 62.0), (2, 91.0), (3, 115.0))
    ]
    thumb = [
        GelPlace("thumb_1_gel", -64, along=False),
        GelPlace("thumb_2_gel", -98),
        GelPlace("thumb_3_gel", -128),
    ]
    return palm + fingers + thumb


_BLOCKS = {
    "base_link_gel_0": ((24, 16, 1), (56.9e-3, 34.6e-3, 2.5e-3)),
    "base_link_gel_1": ((18, 10, 1), (39.2e-3, 20.5e-3, 2.5e-3)),
    "f_1_gel": ((10, 6, 1), (21.0e-3, 11.2e-3, 2.5e-3)),
    "f_2_gel": ((6, 5, 1), (11.3e-3, 11.2e-3, 2.5e-3)),
    "f_3_gel": ((8, 5, 1), (15.2e-3, 11.2e-3, 2.5e-3)),
    "thumb_1_gel": ((12, 12, 1), (42.0e-3, 18.9e-3, 2.5e-3)),
    "thumb_2_gel": ((10, 6, 1), (21.0e-3, 11.2e-3, 2.5e-3)),
    "thumb_3_gel": ((7, 6, 1), (16.4e-3, 12.2e-3, 2.5e-3)),
}
"""Cells and size of blocks that are like the published gels [m]."""


def gel_of(link: str, source: str) -> TetMesh:
    """A gel, z out of its contact face, x along its long side."""
    if source == "generated":
        return block_mesh(*_BLOCKS[link], jitter=0.1, seed=3)
    path = mesh_folder() / "pads" / f"f_tac_hand_description__{link}_maxv_1e-08.vtk"
    nodes, tets = read_tet_file(path)
    masks = np.load(path.with_suffix(".npz"))
    mesh = label(nodes, tets, masks["stick_mask"], masks["coat_mask"])
    return TetMesh(to_gel_frame(mesh), mesh.tets, mesh.faces, mesh.face_regions)


def to_gel_frame(mesh: TetMesh) -> np.ndarray:
    """Nodes with the contact face's mean normal along z and its middle at the origin, the gel's
    longest direction across that along x."""
    corners = mesh.nodes_m[mesh.region_faces(Region.CONTACT)]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    size = np.linalg.norm(areas, axis=1)
    middle = (corners.mean(axis=1) * size[:, None]).sum(axis=0) / size.sum()
    normal = areas.sum(axis=0) / np.linalg.norm(areas.sum(axis=0))
    flat = mesh.nodes_m - middle
    flat = flat - np.outer(flat @ normal, normal)
    longest = np.linalg.eigh(flat.T @ flat)[1][:, -1]
    return (mesh.nodes_m - middle) @ facing(normal, longest)


def build(options: SceneOptions) -> BenchScene:
    """The published gels where they are."""
    places = hand()
    files = [f"pads/f_tac_hand_description__{p.link}_maxv_1e-08.vtk" for p in places]
    source = choose_source(options.source, *files)
    meshes = {link: gel_of(link, source) for link in _BLOCKS}
    gels, mounts = mounted(
        {f"gel {i}": meshes[place.link] for i, place in enumerate(places)},
        GEL_FRICTION,
        surface=Surface(layer=GEL_LAYER, collides_with=BALL_LAYER),
    )
    ball = sphere_mesh(BALL_M, BALL_EDGE_M)
    scene = Scene(
        gels,
        mounts,
        options.env_count,
        TimeStepping(quasi_static=False, dt_s=DT_S, gravity_m_s2=GRAVITY),
        affine_bodies=AffineBody(
            ball, BALL_DENSITY, 1e9, "ball", STIFF_FRICTION, Surface(layer=BALL_LAYER)
        ),
    )
    radius = float(np.linalg.norm(ball.vertices_m, axis=1).max())
    return BenchScene(
        "hand",
        f"17 gels, {sum(meshes[p.link].node_count for p in places):,} nodes, close on a free ball "
        "and carry it",
        scene,
        make_config({"dhat_m": 1e-4, "friction_speed_m_s": 1e-2}, options.config),
        mount_path(places, meshes, radius),
        source,
    )


def mount_path(places: list[GelPlace], meshes: dict[str, TetMesh], radius_m: float) -> np.ndarray:
    """Poses of the mounts about the ball's first place, [steps + 1, 17, 7]."""
    close, carry = STEPS
    moments = np.arange(close + carry + 1)
    gaps = np.interp(moments, [0, close], [GAP_M, -SQUEEZE_M])
    part = np.clip((moments - close) / carry, 0, 1)
    part = part**2 * (3 - 2 * part)
    rows = []
    for gap, done in zip(gaps, part, strict=True):
        turn = turn_about((1.0, 0.0, 0.0), TURN_RAD * done)
        lift = np.array([0.0, 0.0, LIFT_M * done])
        row = []
        for place in places:
            direction, along = _touch(place)
            height = touching_height(meshes[place.link], (0.0, 0.0), radius_m)
            frame = turn @ facing(-direction, along)
            row.append(pose(frame, turn @ (direction * (height + gap)) + lift))
        rows.append(row)
    return same_side(np.array(rows))


def _touch(place: GelPlace) -> tuple[np.ndarray, np.ndarray]:
    """Direction of a place from the ball's centre, and of the gel's long side."""
    polar, lateral = np.radians([place.polar_deg, place.lateral_deg])
    down, out = -np.cos(polar), np.sin(polar)
    direction = np.array([np.sin(lateral), np.cos(lateral) * out, np.cos(lateral) * down])
    along = np.array([0.0, np.cos(polar), np.sin(polar)])
    across = np.cross(along, direction)
    return direction, along if place.along else across
