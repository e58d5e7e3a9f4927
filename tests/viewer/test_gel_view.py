# SPDX-License-Identifier: Apache-2.0
"""The gel's view, and texts of others that it shows."""

from __future__ import annotations

import io
import itertools
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from taccel_lab.calibration.live.page import LivePage, LiveSheet
from taccel_lab.calibration.record.lamps import Lamp
from taccel_lab.calibration.record.page import RecordPage
from taccel_lab.geometry.block import block_mesh
from taccel_lab.geometry.tet_mesh import tet_volumes
from taccel_lab.report.live_page import PageOptions, live_page, page_address
from taccel_lab.report.painted_mesh import painted_mesh
from taccel_lab.scene import Element, Material, SoftBody
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.viewer.arrows import Forces, arrow_lines, patch_forces, round_length
from taccel_lab.viewer.design_controls import DesignControls
from taccel_lab.viewer.gel_states import Field, GelStates, SensorImages
from taccel_lab.viewer.gel_view import GelView, probe
from taccel_lab.viewer.pages import find_source, source_page
from taccel_lab.viewer.painting import bar_html, map_rgb, shares
from taccel_lab.viewer.section import SectionSurface, clip_faces, cut_tets, linear_tets
from tests.viewer import sample_sources
from tests.viewer.browser import chromium_page, shared_browser, wait_for  # noqa: F401
from tests.viewer.sample_sources import ATTACK

pytest.importorskip("viser", reason="the extra view is not installed")
HERE = PageOptions(port=0, browser=False)


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


def test_another_gel_is_drawn_once_and_shows_the_field_that_was_chosen_before(monkeypatch):
    drawn = []
    draw = GelView._draw
    with live_page("Views", HERE) as server:
        untouched, press = block_states(1), block_states(2, "stress", "pressure")
        view = GelView(server, press)

        def counted(self):
            drawn.append(str(self._field.value))
            draw(self)

        monkeypatch.setattr(GelView, "_draw", counted)
        view.choose(field="pressure")
        drawn.clear()
        # As on the design page: the solid of a new design, then its press.
        view.show_states(untouched)
        view.show_states(press, 1)
        assert drawn == ["displacement", "pressure"] and view.time.state == 1

        # Images come without the gel being drawn again, for the state that is shown.
        shades = np.stack([np.full((4, 4, 3), shade, dtype=np.uint8) for shade in (10, 200)])
        view.show_images(SensorImages(shades))
        assert len(drawn) == 2 and view.sensor._image.image.max() == 200
        view.choose(state=0)
        assert view.sensor._image.image.max() == 10
        view.sensor.clear("No picture: it is dark")
        assert view.sensor._note.content == "No picture: it is dark"
        view.show_states(replace(press, images=None), 1)
        assert view.sensor._image.image.max() == 128


@given(seed=st.integers(0, 2**32 - 1), patches=st.integers(1, 40))
def test_forces_of_patches_add_up_to_those_of_the_nodes(seed, patches):
    rng = np.random.default_rng(seed)
    at, forces = rng.uniform(-10, 10, (60, 3)), rng.normal(size=(60, 3))
    forces[rng.random(60) < 0.5] = 0.0
    # Some nodes are of no face.
    faces = rng.integers(0, 50, (80, 3))
    found = patch_forces(at, faces, forces, patches)
    np.testing.assert_allclose(found.forces_n.sum(axis=0), forces.sum(axis=0), atol=1e-11)
    assert len(found.at_mm) <= patches**2


def flat_face(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [mm] and triangles of a square of 10 mm, at random places."""
    edge = np.linspace(-5, 5, 11)
    frame = [np.stack([edge, np.full(11, y)], axis=1) for y in (-5.0, 5.0)]
    inside = rng.uniform(-5, 5, (count, 2))
    plane = np.unique(np.concatenate([*frame, *(f[:, ::-1] for f in frame), inside]), axis=0)
    return np.column_stack([plane, np.zeros(len(plane))]), Delaunay(plane).simplices


def test_arrows_of_one_pressure_are_the_same_on_every_mesh():
    rng = np.random.default_rng(5)
    found = []
    for count in (1500, 2500, 4000):
        at, faces = flat_face(rng, count)
        corners = at[faces]
        area = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2])
        around = np.bincount(faces.ravel(), np.repeat(area / 6, 3), len(at))
        # Hertz: an ellipsoid of pressure, 2 mm in radius.
        pressure = np.sqrt(np.maximum(1 - (at[:, :2] ** 2).sum(axis=1) / 4, 0))
        arrows = patch_forces(at, faces, -(pressure * around)[:, None] * [0, 0, 1.0], 12)
        places = map(tuple, np.round(arrows.at_mm[:, :2], 3))
        found.append(dict(zip(places, arrows.forces_n[:, 2], strict=True)))
    first, *others = found
    largest = max(map(abs, first.values()))
    for other in others:
        for place in {*first, *other}:
            gap = abs(first.get(place, 0.0) - other.get(place, 0.0))
            assert gap < 0.1 * largest, (place, gap / largest)


def test_arrows_end_where_a_tool_pushes_and_a_force_of_zero_has_none():
    forces = Forces(np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]), np.array([[0, 0, -2.0], [0] * 3]))
    onto, from_it = (arrow_lines(forces, 5.0, onto=one) for one in (True, False))
    np.testing.assert_allclose(onto, [[[1, 2, 13], [1, 2, 3]]])
    np.testing.assert_allclose(from_it[0, 1], [1, 2, -7])
    assert forces.largest_n() == 2.0


@given(st.floats(1e-9, 1e9))
def test_round_lengths_are_round_and_not_longer(value):
    found = round_length(value)
    assert value / 2.5 < found * (1 + 1e-6) and found <= value * (1 + 1e-6)
    lead = found / 10.0 ** np.floor(np.log10(found) + 1e-9)
    assert np.isclose(lead, [1, 2, 5]).any()


def test_a_probe_reads_the_value_that_lies_in_front():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    near = SectionSurface(square + [0, 0, 1], faces, square[:, 0] * 4)
    far = SectionSurface(square, faces, np.full(4, 9.0))
    down = np.array([0.0, 0.0, -2.0])
    hit = probe([far, near], np.array([0.75, 0.5, 5.0]), down)
    assert hit is not None and hit.value == pytest.approx(3.0)
    np.testing.assert_allclose(hit.point, [0.75, 0.5, 1.0])
    assert probe([far, near], np.array([2.0, 0.5, 5.0]), down) is None
    assert probe([far], np.array([0.5, 0.5, -1.0]), down) is None, "it lies behind the eye"


def test_values_meet_the_ends_of_the_colour_map():
    found = shares(np.array([-1.0, 0, 1, 2, 9, np.nan]), (0, 2))
    np.testing.assert_allclose(found, [0, 0, 0.5, 1, 1, 0])
    points, faces, share = np.eye(3), np.array([[0, 1, 2]]), np.array([0.0, 0.5, 1.0])
    colors, normals = map_rgb("viridis"), np.tile([0.0, 0.6, 0.8], (3, 1))
    shown = io.BytesIO(painted_mesh(points, faces, share, colors, normals))
    (mesh,) = trimesh.load(shown, file_type="glb", process=False).geometry.values()
    np.testing.assert_allclose(mesh.vertices, points)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_allclose(mesh.vertex_normals, normals, rtol=1e-6)
    np.testing.assert_array_equal(np.asarray(mesh.visual.material.baseColorTexture)[0], colors)
    np.testing.assert_allclose(mesh.visual.uv[:, 0], [0.5 / 256, 0.5, 255.5 / 256])
    with pytest.raises(KeyError):
        map_rgb("no such map")
    # The bar beside names field and unit, and takes no markup.
    text = bar_html("<b>pressure", "kPa", (0.0, 200.0), colors)
    for words in ("&lt;b&gt;pressure", "[kPa]", ">0<", ">100<", ">200<"):
        assert words in text


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


def vector_area(surface: SectionSurface) -> np.ndarray:
    a, b, c = (surface.points[surface.faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a).sum(axis=0) / 2


@given(normal=st.tuples(*[component] * 3), share=st.floats(0.02, 0.98), jitter=st.floats(0.0, 0.3))
def test_the_section_of_a_box_has_its_area(normal, share, jitter):
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


def test_a_plane_beside_the_box_cuts_nothing_and_takes_all_or_nothing():
    mesh = block_mesh((2, 2, 2), (1.0, 1.0, 1.0))
    nodes, values, up = mesh.nodes_m, mesh.nodes_m[:, 2], np.array([0.0, 0.0, 1.0])
    for height, left in ((5.0, 6.0), (-5.0, 0.0)):
        assert len(cut_tets(nodes, mesh.tets, values, height * up, up).faces) == 0
        skin = clip_faces(nodes, mesh.faces.astype(np.int64), values, height * up, up)
        assert skin.area() == pytest.approx(left) and (len(skin.faces) == 0) == (left == 0)


def test_ten_node_tets_fall_into_eight_of_the_same_volume():
    mesh = block_mesh((2, 2, 1), (1.0, 1.0, 0.5), jitter=0.2, seed=3)
    whole = SoftBody(mesh, Material(1e5, 0.45), element=Element.QUADRATIC).nodal_mesh
    parts = linear_tets(whole.tets)
    volumes = tet_volumes(whole.nodes_m, parts)
    assert len(parts) == 8 * len(whole.tets) and (volumes > 0).all()
    assert volumes.sum() == pytest.approx(0.5, rel=1e-12)


def seen(page: Any) -> int:
    """How often the attack can be read on the page, letter by letter."""
    return page.locator("body").inner_text().count(ATTACK)


def assert_inert(page: Any, asked: list[str], times: int = 1) -> None:
    """The attack stands on the page as it is written, and nothing came of it."""
    wait_for(page, lambda: seen(page) >= times)
    page.wait_for_timeout(300)
    assert page.evaluate("window.hacked") is None
    assert page.locator(".f").count() == 0 == page.locator("iframe").count()
    assert [one for one in asked if one.startswith("http://0.0.0.0:1")] == []


@pytest.mark.thorough(cases=("profile", "study"))
@pytest.mark.usefixtures("shared_browser")
@pytest.mark.parametrize(
    "kind", ["profile", "press", "replay", "study", pytest.param("dataset", marks=pytest.mark.slow)]
)
def test_texts_of_sources_are_shown_as_they_are_written(kind, tmp_path):
    folder = tmp_path / "source"
    folder.mkdir()
    getattr(sample_sources, f"hostile_{kind}")(folder)
    asked = []
    # Without the second line, which forbids the browser scripts and what lies elsewhere.
    with (
        source_page(find_source(str(folder)), HERE) as server,
        chromium_page("about:blank", bypass_csp=True) as page,
    ):
        page.on("request", lambda request: asked.append(request.url))
        page.goto(page_address(server))
        assert_inert(page, asked)


@pytest.mark.thorough
@pytest.mark.usefixtures("shared_browser")
def test_texts_of_sessions_and_designs_are_shown_as_they_are_written():
    status: Any = SimpleNamespace(
        image=None, taken=0, wanted=5, prompt=ATTACK, messages=(ATTACK,), finished=True,
        lamps=(Lamp(ATTACK, "bad", ATTACK),), circles=(), advice=None,
    )  # fmt: skip
    asked = []
    with live_page(ATTACK, HERE) as server, chromium_page("about:blank", bypass_csp=True) as page:
        page.on("request", lambda request: asked.append(request.url))
        page.goto(page_address(server))
        record = RecordPage(server)
        record._taken = hash((status.circles, status.advice, status.finished))
        record.show(status)
        LivePage(LiveSheet(server), 10.0, Path()).tell(ATTACK)
        controls = DesignControls(server, sensor_family("flat_pad"), {}, lambda _: None)
        controls.refuse(f"thickness_mm: {ATTACK}", "")
        # Title, prompt, lamp, message, live, refusal.
        assert_inert(page, asked, times=1 + 1 + 2 + 1 + 1 + 1)


@pytest.mark.thorough
@pytest.mark.usefixtures("shared_browser")
def test_the_browser_itself_refuses_scripts_and_what_lies_elsewhere():
    """The second line, where markup would get into a page after all."""
    with live_page("A page", HERE) as server, chromium_page(page_address(server)) as page:
        refused = []
        page.on("console", lambda message: refused.append(message.text))
        server.gui.add_html(ATTACK.partition("<iframe")[0])
        page.locator("b.f").click()
        for words in ("Loading the image", "inline event handler"):
            wait_for(page, lambda words=words: any(words in text for text in refused))
        assert page.evaluate("window.hacked") is None
