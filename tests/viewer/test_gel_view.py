# SPDX-License-Identifier: Apache-2.0
"""A gel's view: sections, arrows that add up, colours with their unit, and how often it draws."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.geometry.tet_mesh import tet_volumes
from taccel_lab.report.live_page import PageOptions, live_page
from taccel_lab.scene import Element, Material, SoftBody
from taccel_lab.viewer.arrows import Forces, arrow_lines, patch_forces, round_length
from taccel_lab.viewer.gel_states import Field, GelStates, SensorImages
from taccel_lab.viewer.gel_view import GelView
from taccel_lab.viewer.painting import bar_html, map_rgb, painted, shares
from taccel_lab.viewer.section import Surface, clip_faces, cut_tets, linear_tets

pytest.importorskip("viser", reason="the extra view is not installed")


def block_states(count: int, *labels: str) -> GelStates:
    mesh = block_mesh((2, 2, 1), (0.02, 0.02, 0.004))
    rest = 1e3 * mesh.nodes_m
    return GelStates(
        rest_mm=rest,
        tets=mesh.tets.astype(np.int64),
        faces=mesh.faces.astype(np.int64),
        moved_mm=np.zeros((count, *rest.shape)),
        captions=[f"state {k}" for k in range(count)],
        fields=[Field(label, "kPa", np.zeros((count, len(rest)))) for label in labels],
    )


def test_another_gel_is_drawn_once_and_shows_the_field_that_was_chosen_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn: list[str] = []
    draw = GelView._draw
    with live_page("Views", PageOptions(port=0, browser=False)) as server:
        untouched, press = block_states(1), block_states(2, "stress", "pressure")
        view = GelView(server, press)

        def counted(self: GelView) -> None:
            drawn.append(str(self._field.value))
            draw(self)

        monkeypatch.setattr(GelView, "_draw", counted)
        view.choose(field="pressure")
        drawn.clear()
        # As on the design page: the solid of a new design, then its press.
        view.show_states(untouched)
        view.show_states(press, 1)
        assert drawn == ["displacement", "pressure"]
        assert view.time.state == 1

        # Images come without the gel being drawn again, for the state that is shown.
        shades = np.stack([np.full((4, 4, 3), shade, dtype=np.uint8) for shade in (10, 200)])
        view.show_images(SensorImages(shades))
        assert len(drawn) == 2
        assert view.sensor._image.image.max() == 200
        view.choose(state=0)
        assert view.sensor._image.image.max() == 10
        view.sensor.clear("No picture: it is dark")
        assert view.sensor._note.content == "No picture: it is dark"
        view.show_states(replace(press, images=None), 1)
        assert view.sensor._image.image.max() == 128


# Arrows and colours -------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), patches=st.integers(1, 40))
def test_forces_of_patches_add_up_to_those_of_the_nodes(seed: int, patches: int) -> None:
    rng = np.random.default_rng(seed)
    at, forces = rng.uniform(-10, 10, (60, 3)), rng.normal(size=(60, 3))
    forces[rng.random(60) < 0.5] = 0.0
    found = patch_forces(at, forces, patches)
    np.testing.assert_allclose(found.forces_n.sum(axis=0), forces.sum(axis=0), atol=1e-12)
    assert len(found.at_mm) <= patches**2 + 2 * patches + 1
    if patches == 1 and len(found.at_mm) == 1:
        weights = np.linalg.norm(forces, axis=1)
        np.testing.assert_allclose(found.at_mm[0], weights @ at / weights.sum(), atol=1e-9)


def test_arrows_end_where_a_tool_pushes() -> None:
    forces = Forces(np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]), np.array([[0, 0, -2.0], [0] * 3]))
    np.testing.assert_allclose(
        arrow_lines(forces, 5.0, onto=True), [[[1, 2, 13], [1, 2, 3]]]
    )  # the force of zero has none
    np.testing.assert_allclose(arrow_lines(forces, 5.0, onto=False)[0, 1], [1, 2, -7])
    assert forces.largest_n() == 2.0


@given(st.floats(1e-9, 1e9))
def test_round_lengths_are_round_and_not_longer(value: float) -> None:
    found = round_length(value)
    assert value / 2.5 < found * (1 + 1e-6) and found <= value * (1 + 1e-6)
    lead = found / 10.0 ** np.floor(np.log10(found) + 1e-9)
    assert np.isclose(lead, [1, 2, 5]).any()


def test_values_meet_the_ends_of_the_colour_map() -> None:
    np.testing.assert_allclose(
        shares(np.array([-1.0, 0, 1, 2, 9, np.nan]), (0, 2)), [0, 0, 0.5, 1, 1, 0]
    )
    surface = Surface(np.eye(3), np.array([[0, 1, 2]]), np.array([0.0, 1.0, 2.0]))
    mesh = painted(surface, (0, 2), map_rgb("viridis"))
    np.testing.assert_allclose(mesh.visual.uv[:, 0], [0.5 / 256, 0.5, 255.5 / 256])


def test_the_bar_names_field_and_unit_and_takes_no_markup() -> None:
    text = bar_html("<b>pressure", "kPa", (0.0, 200.0), map_rgb("magma"))
    assert "&lt;b&gt;pressure" in text and "[kPa]" in text
    assert ">0<" in text and ">100<" in text and ">200<" in text


def test_an_unknown_colour_map_is_an_error() -> None:
    with pytest.raises(KeyError):
        map_rgb("no such map")


# Sections against the closed form of a box cut by a plane -----------------------------------------


SIZE = np.array([0.03, 0.02, 0.01])
component = st.floats(0.05, 1.0).flatmap(lambda v: st.sampled_from([v, -v]))


def section_area(normal: np.ndarray, offset: float, size: np.ndarray) -> float:
    """Area of the plane ``normal . x = offset`` in the box [0, size], no component of ``normal``
    being 0: the derivative of the volume below it, by inclusion and exclusion of its corners."""
    flipped = np.where(normal < 0, size, 0.0)
    n, c = np.abs(normal), offset - float(normal @ flipped)
    total = 0.0
    for corner in itertools.product((0, 1), repeat=3):
        reach = max(c - float((n * size) @ np.array(corner)), 0.0)
        total += (-1) ** sum(corner) * reach**2
    return float(np.linalg.norm(n) * total / (2 * n.prod()))


def vector_area(surface: Surface) -> np.ndarray:
    a, b, c = (surface.points[surface.faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a).sum(axis=0) / 2


@given(
    normal=st.tuples(component, component, component),
    share=st.floats(0.02, 0.98),
    jitter=st.floats(0.0, 0.3),
)
def test_the_section_of_a_box_has_its_area(
    normal: tuple[float, float, float], share: float, jitter: float
) -> None:
    mesh = block_mesh((4, 3, 2), (SIZE[0], SIZE[1], SIZE[2]), jitter, seed=1)
    nodes = mesh.nodes_m - mesh.nodes_m.min(axis=0)
    n = np.array(normal)
    along = nodes @ n
    offset = along.min() + share * np.ptp(along)
    point = n * offset / (n @ n)
    values = nodes @ [1.0, 2.0, 3.0] + 4
    cut = cut_tets(nodes, mesh.tets, values, point, n)
    assert cut.area() == pytest.approx(section_area(n, offset, SIZE), rel=1e-9, abs=1e-15)
    # On the plane, facing what is taken away, with the field's own values.
    assert np.abs(cut.points @ n - offset).max() < 1e-12
    assert vector_area(cut) @ n == pytest.approx(cut.area() * np.linalg.norm(n), rel=1e-9)
    np.testing.assert_allclose(cut.values, cut.points @ [1.0, 2.0, 3.0] + 4, rtol=1e-12)
    # With what is left of the skin it closes.
    skin = clip_faces(nodes, mesh.faces.astype(np.int64), values, point, n)
    np.testing.assert_allclose(vector_area(skin) + vector_area(cut), 0, atol=1e-16)
    assert (skin.points @ n).max() <= offset + 1e-12


def test_a_plane_beside_the_box_cuts_nothing_and_takes_all_or_nothing() -> None:
    mesh = block_mesh((2, 2, 2), (1.0, 1.0, 1.0))
    nodes, values = mesh.nodes_m, mesh.nodes_m[:, 2]
    up, faces = np.array([0.0, 0.0, 1.0]), mesh.faces.astype(np.int64)
    above, below = np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.0, -5.0])
    for point in (above, below):
        assert len(cut_tets(nodes, mesh.tets, values, point, up).faces) == 0
    assert clip_faces(nodes, faces, values, above, up).area() == pytest.approx(6.0)
    assert len(clip_faces(nodes, faces, values, below, up).faces) == 0


def test_ten_node_tets_fall_into_eight_of_the_same_volume() -> None:
    mesh = block_mesh((2, 2, 1), (1.0, 1.0, 0.5), jitter=0.2, seed=3)
    body = SoftBody(mesh, Material(1e5, 0.45), element=Element.QUADRATIC)
    whole: TetMesh | QuadraticMesh = body.nodal_mesh
    parts = linear_tets(whole.tets)
    volumes = tet_volumes(whole.nodes_m, parts)
    assert len(parts) == 8 * len(whole.tets)
    assert (volumes > 0).all()
    assert volumes.sum() == pytest.approx(0.5, rel=1e-12)
