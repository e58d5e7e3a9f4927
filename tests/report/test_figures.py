# SPDX-License-Identifier: Apache-2.0
"""Figures of reports, and pages that follow a run."""

from __future__ import annotations

import base64
import socket
import sys
import urllib.request

import matplotlib as mpl
import numpy as np
import pytest
import pyvista as pv

from taccel_lab.calibration.profile_page import disc_normals
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import eight_bit
from taccel_lab.files.images import read_image
from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.report.figures import (
    draw_contact_forces,
    draw_force_depth,
    draw_height_map,
    draw_image,
    draw_normals,
)
from taccel_lab.report.live_page import (
    PageOptions,
    live_page,
    page_address,
    require_free_port,
    serve_until_stopped,
)
from taccel_lab.report.mesh_view import MOST_FACES, MeshView, mesh_view
from taccel_lab.report.style import new_figure, save_figure

pytestmark = pytest.mark.rasterised
GRID = PixelGrid(80, 60, 0.1, 0.1, 39.5, 29.5)


@pytest.mark.thorough
def test_height_map_is_drawn_in_millimetres_over_the_gel(tmp_path):
    height = np.full((60, 80), np.nan)
    height[10:50, 10:70] = -2e-4
    height[30, 40] = -5e-4
    figure = draw_height_map(height, GRID)
    image = figure.axes[0].images[0]
    assert np.nanmin(image.get_array().filled(np.nan)) == pytest.approx(-0.5)
    assert image.get_extent() == pytest.approx((-4.0, 4.0, 3.0, -3.0))
    save_figure(figure, tmp_path / "h.png")
    tall, width, _ = read_image(tmp_path / "h.png").shape
    assert width > 500 and tall > 300
    # A flat one has no contours to draw.
    save_figure(draw_height_map(np.zeros((60, 80)), GRID), tmp_path / "flat.png")
    assert (tmp_path / "flat.png").stat().st_size > 1000


def test_normals_image_and_force_are_drawn(tmp_path):
    before = dict(mpl.rcParams)
    figure = draw_normals(np.broadcast_to([0.5, 0.0, 0.866], (60, 80, 3)), GRID)
    assert figure.axes[0].images[0].get_array()[0, 0, 2] == pytest.approx(0.933, abs=1e-3)
    rgb, depth = np.full((60, 80, 3), 100.0), np.array([0.2, 0.4])
    save_figure(draw_image(rgb, GRID), tmp_path / "rgb.png")
    with pytest.raises(InputError, match="rgb"):
        draw_image(rgb[:-1], GRID)
    with pytest.raises(InputError, match="height_m"):
        draw_height_map(np.zeros((60, 81)), GRID)
    figure = draw_force_depth(depth, depth * 3, "simulation")
    assert np.allclose(figure.axes[0].lines[0].get_ydata(), [0.6, 1.2])
    draw_height_map(np.zeros((60, 80)), GRID)
    assert dict(mpl.rcParams) == before, "the caller's settings are left alone"


def test_contact_pressure_is_force_over_area():
    """A uniform pressure on a flat face, given as its consistent nodal forces."""
    x, y = np.meshgrid(np.linspace(-1e-3, 1e-3, 5), np.linspace(-1e-3, 1e-3, 5))
    nodes = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    corner = np.arange(20).reshape(4, 5)[:, :4].ravel()[:, None]
    faces = np.concatenate([corner + [0, 1, 6], corner + [0, 6, 5]])
    area = np.bincount(faces.ravel(), minlength=25) * 0.5 * (0.5e-3) ** 2 / 3
    forces = area[:, None] * [0, 0, -50e3]
    figure = draw_contact_forces(nodes, faces, forces, np.full(25, 50e3))
    assert np.allclose(figure.axes[0].collections[0].get_array(), 50.0)
    assert "0.2 N" in figure.axes[0].get_title()
    draw_contact_forces(nodes, faces, np.zeros_like(forces), np.zeros(25))


def test_disc_normals_are_unit_and_oriented():
    normals = disc_normals(33, 0.8)
    inside = np.isfinite(normals).all(axis=-1)
    assert np.allclose(np.linalg.norm(normals[inside], axis=-1), 1)
    assert normals[16, 32] == pytest.approx([0.8, 0.0, 0.6])
    assert normals[32, 16] == pytest.approx([0.0, 0.8, 0.6])
    assert not inside[0, 0]


def test_bytes_are_rounded_and_clipped():
    assert eight_bit(np.array([-3.0, 1.6, 300.0, np.nan])).tolist() == [0, 2, 255, 255]


def test_names_between_dollars_are_no_formulas(tmp_path):
    figure, axes = new_figure(3, 2)
    axes.plot([1, 100], [1, 1000], label="press_$\\frac$.png")
    axes.set(title="$\\frac$", xlabel="a$_b$c", yscale="log", xticks=[1, 50])
    axes.set_xticklabels(["$\\frac$", "x"])
    axes.legend()
    save_figure(figure, tmp_path / "names.png")  # An error of the formula, had it been one.
    assert not axes.title.get_parse_math() and not axes.xaxis.label.get_parse_math()
    powers = [label for label in axes.yaxis.get_ticklabels() if label.get_text()]
    assert powers and all(label.get_parse_math() for label in powers)


@pytest.mark.filterwarnings("error")
def test_names_of_any_script_and_control_characters_are_drawn_without_a_warning(tmp_path):
    figure, axes = new_figure(3, 2)
    axes.set(title="触觉\nsecond line", xlabel="a\x1b[31m")
    save_figure(figure, tmp_path / "names.png")
    assert (axes.title.get_text(), axes.get_xlabel()) == ("触觉\nsecond line", "a\\x1b[31m")


def box(cells: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Surface of a pad of 20 x 20 x 4 mm with a bump: nodes [m], faces, regions."""
    sheet = pv.Plane(i_size=0.02, j_size=0.02, i_resolution=cells, j_resolution=cells).triangulate()
    top, faces = np.array(sheet.points, dtype=float), sheet.regular_faces
    top[:, 2] = 0.001 * np.exp(-(top[:, :2] ** 2).sum(axis=1) / 0.004**2)
    nodes = np.concatenate([top, top * [1, 1, 0] - [0, 0, 0.004]])
    both = np.concatenate([faces, faces[:, ::-1] + len(top)])
    return nodes, both, np.repeat([int(Region.CONTACT), int(Region.BOND)], len(faces))


def drawn(view: MeshView) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes from -1 to 1, faces, regions as a browser reads them."""
    nodes = np.frombuffer(base64.b64decode(view.nodes), "<i2").reshape(-1, 3) / 32767
    faces = np.frombuffer(base64.b64decode(view.faces), "<u2").reshape(-1, 3)
    return nodes, faces, np.frombuffer(base64.b64decode(view.regions), "u1")


def area_mm2(view: MeshView) -> float:
    nodes, faces, _ = drawn(view)
    a, b, c = (max(view.size_mm) / 2 * nodes[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_a_surface_is_drawn_as_it_is():
    nodes, faces, regions = box(20)
    view = mesh_view(nodes, faces, regions)
    assert view.drawn_faces == view.faces_in_all == len(faces)
    seen, shown, kinds = drawn(view)
    assert np.array_equal(kinds, regions) and len(seen) == len(nodes) and shown.max() < len(seen)
    assert view.size_mm == pytest.approx((20, 20, 5), abs=0.1)
    assert [name for name, _ in view.legend] == ["contact", "bond"]
    assert mesh_view(nodes, faces[:0], regions[:0]) is None, "there is nothing to draw"


def test_a_fine_surface_is_drawn_coarser_with_its_shape_and_borders():
    coarse, fine = mesh_view(*box(80)), mesh_view(*box(130))
    assert fine.faces_in_all == 4 * 130**2 > 4 * MOST_FACES
    assert 0.5 * MOST_FACES < fine.drawn_faces <= MOST_FACES
    assert fine.size_mm == pytest.approx(coarse.size_mm, rel=1e-3)
    assert area_mm2(fine) == pytest.approx(area_mm2(coarse), rel=0.01)
    nodes, faces, regions = drawn(fine)
    for region in (Region.CONTACT, Region.BOND):
        own = nodes[np.unique(faces[regions == int(region)])]
        # All 4 x 130 nodes of the region's border are still there.
        assert (np.abs(own[:, :2]).max(axis=1) > 1 - 1e-4).sum() == 4 * 130


def test_a_page_answers_while_it_is_open_and_not_after(capsys):
    pytest.importorskip("viser")
    said: list[str] = []
    with live_page("A page", PageOptions(port=0, browser=False), said.append) as server:
        address = page_address(server)
        with urllib.request.urlopen(address, timeout=10) as answer:
            assert b"<html" in answer.read()
    assert said == [f"A page: {address} (Ctrl-C closes it)"]
    with pytest.raises(OSError):
        urllib.request.urlopen(address, timeout=2)
    assert capsys.readouterr().out == ""


def test_ports_and_hosts_that_cannot_be_are_refused_with_what_to_do():
    require_free_port("127.0.0.1", 0)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        used = other.getsockname()[1]
        for host, port, words in (
            ("127.0.0.1", used, rf"port {used} of 127.0.0.1 .*--port 0"),
            ("127.0.0.1", 70000, "does not exist"),
            ("no.such.host.invalid", 8080, "no address"),
        ):
            with pytest.raises(InputError, match=words):
                require_free_port(host, port)


def test_without_viser_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with (
        pytest.raises(InputError, match=r"pip install 'taccel-lab\[view\]'"),
        live_page("x", PageOptions(port=0, browser=False)),
    ):
        pass


def test_ctrl_c_ends_a_page_as_it_ends_a_command():
    class Interrupted:
        def wait(self, _):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        serve_until_stopped(Interrupted())  # type: ignore[arg-type]
