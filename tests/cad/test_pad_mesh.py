# SPDX-License-Identifier: Apache-2.0
"""Structured meshes of pads with a plane back: invariants over pads and places of contact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from catalogue_pads import PADS
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from pad_strategies import gel_pads

from taccel_lab.cad.mesh.gel_mesh import FocusOptions, focused_gel_mesh, gel_mesh
from taccel_lab.cad.mesh.surface import check_closed
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh

CLASSIC = PADS["gelsight"]
FLAT_FILLET = GelPad(
    length_x_mm=20, length_y_mm=16, corner_radius_mm=2, thickness_mm=5, rim="fillet",
    rim_mm=0.5, rim_radius_mm=5, window_x_mm=10, window_y_mm=8,
)  # fmt: skip


def around(at_mm: tuple[float, float], radius: float = 2.0, size: float = 0.25) -> FocusOptions:
    return FocusOptions(at_mm, radius, size, core=8, rings=10)


def check_invariants(mesh: TetMesh, pad: GelPad) -> None:
    assert (mesh.volumes_m3() > 0).all()
    check_closed(mesh.faces, "boundary")
    assert np.array_equal(np.unique(mesh.tets), np.arange(mesh.node_count))
    boundary = mesh.nodes_m[mesh.faces]
    enclosed = (boundary[:, 0] * np.cross(boundary[:, 1], boundary[:, 2])).sum() / 6
    assert enclosed == pytest.approx(mesh.volumes_m3().sum(), rel=1e-9)

    bonded = mesh.nodes_m[mesh.bonded_nodes()]
    assert np.unique(bonded[:, 2]).size == 1
    assert bonded[0, 2] == pytest.approx(-pad.thickness_mm * 1e-3, rel=1e-15)
    assert (mesh.nodes_m[:, 2] >= bonded[0, 2]).all()
    contact = mesh.nodes_m[mesh.region_nodes(Region.CONTACT)] * 1e3
    off = np.abs(contact[:, 2] - pad.height_mm(contact[:, :2]))
    # A fillet is upright at the wall: 1e-15 mm beside it is 1e-7 mm above its foot.
    foot = pad.has_fillet & (np.abs(pad.inside_distance_mm(contact[:, :2])) < 1e-12)
    assert off[~foot].max(initial=0.0) < 1e-11
    assert off[foot].max(initial=0.0) < 2e-6
    side = mesh.nodes_m[mesh.region_nodes(Region.SIDE)] * 1e3
    np.testing.assert_allclose(pad.inside_distance_mm(side[:, :2]), 0, atol=1e-9)


@given(gel_pads(), st.floats(1.4, 2.5))
@example(replace(FLAT_FILLET, length_x_mm=33.5, window_x_mm=16.75), 1.6)
@settings(max_examples=5, deadline=None)
def test_even_meshes_are_sound(pad: GelPad, edge_mm: float) -> None:
    mesh = gel_mesh(pad, edge_mm)
    check_invariants(mesh, pad)
    window = mesh.nodes_m[mesh.region_faces(Region.WINDOW)] * 1e3
    area = np.linalg.norm(
        np.cross(window[:, 1] - window[:, 0], window[:, 2] - window[:, 0]), axis=1
    )
    assert area.sum() / 2 == pytest.approx(pad.window_x_mm * pad.window_y_mm, rel=1e-9)


@given(gel_pads(), st.floats(-1, 1), st.floats(-1, 1), st.floats(0.8, 2.2), st.floats(0.1, 0.2))
@settings(max_examples=10, deadline=None)
def test_focused_meshes_are_sound(
    pad: GelPad, u: float, v: float, radius_mm: float, relative_size: float
) -> None:
    focus = (u * (pad.length_x_mm / 2 - 4), v * (pad.length_y_mm / 2 - 4))
    assume(pad.inside_distance_mm(np.array(focus)) - pad.rim_setback_mm() > 3)
    mesh = focused_gel_mesh(pad, around(focus, radius_mm, relative_size * radius_mm))
    check_invariants(mesh, pad)


@pytest.mark.parametrize("focus", [(0, 0), (3, 2), (7.04, -3.05), (-6.5, -4.1), (-6.6, 3.6)])
def test_focus_has_the_wanted_elements(focus: tuple[float, float]) -> None:
    size = 0.25
    mesh = focused_gel_mesh(CLASSIC, around(focus, 2.0, size))
    assert 1900 < mesh.node_count < 2100
    faces = mesh.region_faces(Region.CONTACT)
    corners = mesh.nodes_m[faces] * 1e3
    length = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    near = np.linalg.norm(corners.mean(axis=1)[:, :2] - focus, axis=1)
    # Diagonals and the fan of the spokes lengthen edges; the finest quarter is the wanted size.
    assert np.quantile(length[near < 1.5], 0.25) == pytest.approx(size, rel=0.3)
    assert length[near < 1.5].max() < 3.2 * size
    assert np.median(length[near > 6]) > 4 * size


def test_mesh_volume_converges_to_the_pad() -> None:
    # Volume of the spherical dome over the rounded rectangle, by midpoint rule.
    cells = 2000
    axes = [(np.arange(cells) + 0.5) / cells * length - length / 2 for length in (24.0, 20.0)]
    xy = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    exact = ((CLASSIC.height_mm(xy) + 5) * (CLASSIC.inside_distance_mm(xy) > 0)).mean() * 480
    errors = [
        1 - gel_mesh(CLASSIC, edge).volumes_m3().sum() * 1e9 / exact for edge in (3.0, 1.7, 0.9)
    ]
    assert 0 < errors[2] < errors[1] < errors[0] < 0.02
    assert errors[2] < 1e-3


def test_same_input_gives_the_same_bytes() -> None:
    meshes = [focused_gel_mesh(CLASSIC, around((2.2, -1.7))) for _ in range(2)]
    assert meshes[0].nodes_m.tobytes() == meshes[1].nodes_m.tobytes()


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"core": 7}, "core = 7"),
        ({"core": 2}, "core = 2 is not allowed"),
        ({"core": 8.0}, "core"),
        ({"rings": 2}, "rings = 2"),
        ({"layers": 0}, "layers = 0"),
        ({"layer_ratio": 0.5}, "layer_ratio"),
        ({"at_mm": (11.5, 0)}, "at least 1.5 mm"),
        ({"at_mm": (50, 0)}, "at least 1.5 mm"),
        ({"at_mm": (float("nan"), 0)}, "at_mm"),
        ({"radius_mm": -1}, "radius_mm"),
        ({"size_mm": 5}, "size_mm"),
    ],
)
def test_bad_options_say_what_is_allowed(options: dict[str, object], word: str) -> None:
    with pytest.raises(InputError, match=word):
        focused_gel_mesh(CLASSIC, replace(around((0, 0)), **options))  # type: ignore[arg-type]


def test_edge_out_of_bounds_is_refused() -> None:
    with pytest.raises(InputError, match="edge_mm"):
        gel_mesh(CLASSIC, 0.0)
