# SPDX-License-Identifier: Apache-2.0
"""Pads of the catalogue and of real sensors, random ones, and what holds of meshes of any."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from taccel_lab.cad.mesh.surface import check_closed
from taccel_lab.cad.parts.dome_pad import DomePad, ShellDomePad, SolidDomePad
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.sensors import sensor_families

PADS: dict[str, HeightPad] = {
    name: pad
    for name, family in sensor_families().items()
    if isinstance(pad := family.parameters().pad(), HeightPad)
}
CLASSIC, MINI, BEVELLED, SKINNED, DIGIT = (
    PADS[name] for name in ("gelsight", "gelsight_mini", "gelsight_40", "9dtact", "digit")
)


@st.composite
def gel_pads(draw: st.DrawFn) -> GelPad:
    """Pads of the proportions of real sensors: flat or domed, with or without rim."""
    x, y = draw(st.floats(14, 34)), draw(st.floats(14, 34))
    rim = draw(st.sampled_from(["none", "chamfer", "fillet"]))
    crown = st.sampled_from([0.0, 60.0, 110.0, 190.0])
    corner = draw(st.floats(1.0, 3.0))
    radii = draw(crown), draw(crown)
    # A little more than the crown's drop at the corners, so that a wall is left below it.
    drop = sum(1.2 * (size / 2) ** 2 / (2 * r) for size, r in zip((x, y), radii, strict=True) if r)
    return GelPad(
        length_x_mm=x,
        length_y_mm=y,
        corner_radius_mm=corner,
        thickness_mm=max(draw(st.floats(4.5, 7.0)), drop + 1.2),
        crown_radius_x_mm=radii[0],
        crown_radius_y_mm=radii[1],
        rim=rim,
        rim_mm=draw(st.floats(0.2, 0.6)),
        window_x_mm=x * draw(st.floats(0.5, 0.75)),
        window_y_mm=y * draw(st.floats(0.5, 0.75)),
    )


DIGIT_360 = SolidDomePad(
    dome_radius_mm=12.5, wall_height_mm=13.5, pocket_radius_mm=4.927, pocket_taper_deg=2,
    pocket_depth_mm=1.55, pocket_edge_radius_mm=0.25, pocket_dome_radius_mm=7.439,
)  # fmt: skip
R_TAC = ShellDomePad(dome_radius_mm=15, thickness_mm=1.5, window_deg=60)
GEL_TIP = ShellDomePad(dome_radius_mm=11.5, thickness_mm=2, skirt_mm=10, window_deg=70)


@st.composite
def shell_domes(draw: st.DrawFn) -> ShellDomePad:
    """Shells of the proportions of real sensors."""
    radius = draw(st.floats(6, 20))
    opening = draw(st.one_of(st.just(90.0), st.floats(40, 90)))
    return ShellDomePad(
        dome_radius_mm=radius,
        thickness_mm=radius * draw(st.floats(0.08, 0.3)),
        opening_deg=opening,
        skirt_mm=radius * draw(st.floats(0.2, 1.5)) if opening == 90 else 0.0,
        window_deg=opening * draw(st.floats(0.45, 0.9)),
        rim=draw(st.sampled_from(["bonded", "free"])),
    )


@st.composite
def solid_domes(draw: st.DrawFn) -> SolidDomePad:
    """Solid domes of the proportions of real sensors."""
    radius = draw(st.floats(6, 14))
    wall, pocket = radius * draw(st.floats(0.4, 1.3)), radius * draw(st.floats(0.35, 0.6))
    return SolidDomePad(
        dome_radius_mm=radius,
        wall_height_mm=wall,
        bonded_wall_mm=draw(st.sampled_from([0.0, 0.4])) * wall,
        pocket_radius_mm=pocket,
        pocket_taper_deg=draw(st.floats(0, 8)),
        pocket_depth_mm=radius * draw(st.floats(0.1, 0.2)),
        pocket_edge_radius_mm=0.2,
        pocket_dome_radius_mm=pocket * draw(st.floats(1.4, 4)),
    )


def domes() -> st.SearchStrategy[DomePad]:
    return st.one_of(shell_domes(), solid_domes())


def check_sound(mesh: TetMesh, pad: Pad) -> None:
    """Closed, of positive tets; what is glued and touched lies on its formula."""
    assert (mesh.volumes_m3() > 0).all()
    check_closed(mesh.faces, "boundary")
    assert np.array_equal(np.unique(mesh.tets), np.arange(mesh.node_count))
    nodes = mesh.nodes_m * 1e3
    bonded = nodes[mesh.bonded_nodes()]
    assert np.linalg.norm(bonded - pad.bond_projection_mm(bonded), axis=1).max() < 1e-9
    contact = nodes[mesh.region_nodes(Region.CONTACT)]
    error = pad.contact_error_mm(contact)
    if isinstance(pad, HeightPad):
        # Where a fillet meets the wall the formula is infinitely steep.
        steep = pad.inside_distance_mm(contact[:, :2]) < 1e-3
        assert error[~steep].max() < 1e-6
    else:
        assert error.max() < 1e-9


def check_same(mesh: TetMesh, other: TetMesh) -> None:
    """The same connectivity to the byte."""
    for name in ("tets", "faces", "face_regions", "tet_layers"):
        assert getattr(mesh, name).tobytes() == getattr(other, name).tobytes()
    assert mesh.nodes_m.shape == other.nodes_m.shape


def contact_edges(mesh: TetMesh, beside: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Lengths of the contact faces' edges [mm], [n, 3], and distances of their middles from a
    place, in the plan where it has two coordinates, [n]."""
    corners = mesh.nodes_m[mesh.region_faces(Region.CONTACT)] * 1e3
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    away = corners.mean(axis=1)[:, : len(beside)] - beside
    return lengths, np.linalg.norm(away, axis=1)
