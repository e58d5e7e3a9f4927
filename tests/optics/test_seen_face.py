# SPDX-License-Identifier: Apache-2.0
"""The fine face cut from a mesh, and renders of deformed gels."""

from __future__ import annotations

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.camera.refraction import DomeMedia, FlatMedia, media_between
from taccel_lab.geometry import quadratic_mesh
from taccel_lab.optics.surface import GelFace, seen_faces
from taccel_lab.presses.mesh import press_mesh
from taccel_lab.profile.optical_design import DesignedCamera, Light, MarkerGrid, Window
from taccel_lab.sensors.profile import catalogue_profile
from tests.optics.compare import pressed_top
from tests.support.formula_model import formula_model

PAD = GelPad(
    length_x_mm=16, length_y_mm=14, corner_radius_mm=2, thickness_mm=4, crown_radius_x_mm=30,
    crown_radius_y_mm=40, window_x_mm=12, window_y_mm=10,
)  # fmt: skip
DESIGN = tl.OpticalDesign(
    camera=DesignedCamera(64, 48, 110.0, 110.0, 31.5, 23.5, (0.0, 0.0, -20.0)),
    lights=(
        Light((9.0, 0.0, -6.0), (-0.8, 0.0, 0.6), (1.0, 0.0, 0.0), (4.0, 1.0)),
        Light((-5.0, 8.0, -6.0), (0.6, -0.64, 0.48), (0.0, 1.0, 0.0), (4.0, 1.0)),
        Light((-5.0, -8.0, -6.0), (0.6, 0.64, 0.48), (0.0, 0.0, 1.0), (4.0, 1.0)),
    ),
    window=Window(2.0, (16.0, 14.0)),
)


@pytest.fixture(scope="module")
def mesh():
    return gel_mesh(PAD, 1.5)


def pressed(mesh: tl.TetMesh, at: tuple[float, float], radius: float, ball: float) -> np.ndarray:
    """Nodes under a ball's dent, the sinking shared out over the gel's depth [m]."""
    nodes = mesh.nodes_m * 1e3
    top = PAD.top_mm(nodes[:, :2] * 0.999)
    sunk = pressed_top(PAD.top_mm, at, radius, ball)(nodes[:, :2] * 0.999) - top
    share = np.clip((nodes[:, 2] + PAD.thickness_mm) / (top + PAD.thickness_mm), 0, 1)
    nodes[:, 2] += sunk * share
    return nodes * 1e-3


def test_patches_follow_the_pad_better_than_triangles(mesh):
    fine = GelFace(mesh).rest
    inside = np.abs(fine.points_mm[:, :2] / [6.5, 5.5]).max(axis=1) < 1
    errors = PAD.contact_error_mm(fine.points_mm)[inside]
    middles = mesh.nodes_m[seen_faces(mesh)].mean(axis=1) * 1e3
    coarse = PAD.contact_error_mm(middles)[(np.abs(middles[:, :2]) < [6.5, 5.5]).all(axis=1)]
    assert np.mean(errors**2) < 0.15**2 * np.mean(coarse**2)
    corners = fine.points_mm[fine.triangles]
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facets /= np.linalg.norm(facets, axis=1, keepdims=True)

    def angle_deg(points, normals):
        cosine = np.sum(PAD.top_normal(points[:, :2]) * normals, axis=1)
        return np.degrees(np.arccos(np.clip(cosine, -1, 1)))

    angle = angle_deg(fine.points_mm, fine.normals)[inside]
    assert np.median(angle) < 0.15
    assert np.percentile(angle, 99) < 0.5
    coarse_angle = angle_deg(corners[:, 0], facets)[inside[fine.triangles].all(axis=1)]
    assert np.median(angle) < 0.5 * np.median(coarse_angle)
    np.testing.assert_allclose(np.linalg.norm(fine.normals, axis=1), 1.0, atol=1e-12)


def test_mesh_formula_and_ten_node_tets_give_the_same_picture(mesh):
    quadratic, half = quadratic_mesh(mesh), (8.0, 7.0)
    formula = formula_model(DESIGN, PAD.top_mm, half_size_mm=half, back_z_mm=-PAD.thickness_mm)
    by_mesh, by_formula, by_nodes = (
        optics.render()
        for optics in (tl.OpticalModel(DESIGN, mesh), formula, tl.OpticalModel(DESIGN, quadratic))
    )
    assert (by_mesh.mask & by_formula.mask).all()
    assert np.abs(by_mesh.rgb.astype(int) - by_formula.rgb).max() <= 3
    np.testing.assert_allclose(by_mesh.points_mm, by_formula.points_mm, atol=0.01)
    assert np.abs(by_nodes.rgb.astype(int) - by_mesh.rgb).max() <= 6
    moved = tl.OpticalModel(DESIGN, quadratic).render(quadratic.nodes_m)
    assert moved.rgb.shape == (48, 64, 3)


def test_environments_are_rendered_one_by_one(mesh):
    model = tl.OpticalModel(DESIGN, mesh)
    dent = pressed(mesh, (1.0, -1.0), 1.5, 3.0)
    rest = model.render()
    both = model.render(np.stack([mesh.nodes_m, dent]))
    assert both.rgb.shape == (2, 48, 64, 3)
    np.testing.assert_array_equal(both.rgb[0], rest.rgb)
    np.testing.assert_array_equal(both.rgb[1], model.render(dent).rgb)
    np.testing.assert_array_equal(model.render().rgb, rest.rgb)
    # The dent is where it was made, its floor toward the camera.
    deepest = np.unravel_index(np.nanargmin(both.points_mm[1, ..., 2]), (48, 64))
    np.testing.assert_allclose(both.points_mm[1][deepest][:2], (1.0, -1.0), atol=0.3)


def test_flanks_of_a_dent_take_the_colour_of_their_light(mesh):
    """Seen from inside a dent is a bump: its right flank faces the red light on the right."""
    model = tl.OpticalModel(DESIGN, mesh)
    dent = model.render(pressed(mesh, (0.0, 0.0), 2.0, 4.0))
    change = dent.linear - model.render().linear

    def flank(along, beside):
        return change[(along > 0.5) & (along < 1.5) & (np.abs(beside) < 0.5)].mean(axis=0)

    x, y = dent.points_mm[..., 0], dent.points_mm[..., 1]
    right, left, below, above = flank(x, y), flank(-x, y), flank(y, x), flank(-y, x)
    assert right[0] > 0 > left[0]
    assert below[1] > above[1] and above[2] > below[2]


@pytest.mark.thorough
def test_markers_move_with_the_gel(mesh):
    size = (200, 150)
    model = tl.OpticalModel(DESIGN, mesh, size_px=size, markers=MarkerGrid(1, 1, 3.0, 3.0, 0.8))
    plain = tl.OpticalModel(DESIGN, mesh, size_px=size)
    moved = mesh.nodes_m.copy()
    moved[:, :2] += [0.6e-3, -0.4e-3]

    def dark_centre(positions):
        image = model.render(positions)
        dark = image.linear[..., 1] < 0.5 * plain.render(positions).linear[..., 1]
        return image.points_mm[dark].mean(axis=0)[:2]

    np.testing.assert_allclose(dark_centre(None), (0, 0), atol=0.02)
    np.testing.assert_allclose(dark_centre(moved), (0.6, -0.4), atol=0.02)


@pytest.mark.thorough
def test_bevels_stay_sharp():
    bevelled = GelPad(
        length_x_mm=16, length_y_mm=14, corner_radius_mm=2, thickness_mm=4, rim="chamfer",
        rim_mm=1.0, window_x_mm=12, window_y_mm=10,
    )  # fmt: skip
    fine = GelFace(gel_mesh(bevelled, 1.5)).rest
    tilt = np.degrees(np.arccos(np.clip(fine.normals[:, 2], -1, 1)))
    # Either flat or along the bevel, nothing between.
    assert ((tilt < 1.0) | (np.abs(tilt - 45) < 6.0)).all()
    assert (tilt < 1.0).any()
    assert (tilt > 30.0).any()


def test_a_dome_is_round_on_the_mesh_of_a_press():
    """Its chords far from the contact left a ring in the camera's picture: 60 um, 3 degrees."""
    profile = catalogue_profile("rtac")
    mesh = press_mesh("rtac", {}, (0.0, 0.0), 1.2)
    radius = 15.0
    face = GelFace(mesh, designed=profile.mesh).rest
    middle = np.array([0.0, 0.0, -radius])
    outwards = face.points_mm - middle
    distance = np.linalg.norm(outwards, axis=1)
    assert np.abs(distance - radius).max() < 0.02
    upper = face.points_mm[:, 2] > -0.9 * radius
    turned = np.linalg.norm(face.normals - outwards / distance[:, None], axis=1)
    assert np.degrees(np.quantile(turned[upper], 0.99)) < 0.5


def test_the_skin_is_seen_from_its_inner_side():
    flat = GelPad(
        length_x_mm=10, length_y_mm=10, corner_radius_mm=1, thickness_mm=3, window_x_mm=8,
        window_y_mm=8,
    )  # fmt: skip
    base = gel_mesh(flat, 1.0)
    inner = np.unique(np.round(base.nodes_m[:, 2] * 1e3, 6))[-2]
    skin = (base.nodes_m[base.tets].mean(axis=1)[:, 2] * 1e3 > inner).astype(np.int32)
    mesh = tl.TetMesh(base.nodes_m, base.tets, base.faces, base.face_regions, skin)
    seen = mesh.nodes_m[seen_faces(mesh)] * 1e3
    np.testing.assert_allclose(seen[..., 2], inner, atol=1e-6)
    normals = np.cross(seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0])
    assert (normals[:, 2] > 0).all()
    assert np.ptp(seen[..., 0]) == pytest.approx(10, abs=0.1)


def test_media_of_flat_and_domed_backs():
    flat = np.array([[x, y, -4.0] for x in (-5, 5) for y in (-5, 5)])
    assert media_between(DESIGN, flat) == FlatMedia((-6.0, -4.0), (1.0, 1.49, 1.41))
    angles = np.linspace(0, 1.4, 30)
    dome = np.stack([13.5 * np.sin(angles), 0 * angles, 13.5 * np.cos(angles) - 15.0], axis=1)

    def seen_from(z_mm, window):
        camera = DesignedCamera(64, 48, 60, 60, 31.5, 23.5, (0.0, 0.0, z_mm))
        return tl.OpticalDesign(camera, DESIGN.lights, window=window)

    inside = seen_from(-16.0, Window(2.0, (27.0, 27.0), 1.41, "dome", 13.5))
    wanted = DomeMedia((0.0, 0.0, -15.0), (11.5, 13.5), (1.0, 1.41, 1.41))
    assert media_between(inside, dome) == wanted
    with pytest.raises(tl.InputError, match="off the dome window's sphere"):
        media_between(inside, dome * [1.2, 1, 1])
    with pytest.raises(tl.InputError, match="the window is a plate"):
        media_between(DESIGN, dome)
    # A camera cast into the gel looks through no interface.
    assert media_between(seen_from(-2.0, None), flat) == FlatMedia((), (1.41,))


def test_faces_that_are_not_there(mesh):
    bare = tl.TetMesh(
        mesh.nodes_m, mesh.tets, mesh.faces, np.full(len(mesh.faces), int(tl.Region.SIDE))
    )
    broken = mesh.nodes_m.copy()
    broken[seen_faces(mesh)[0, 0]] = np.nan
    for call, given, words in (
        (GelFace, bare, "CONTACT"),
        (GelFace(mesh).at, mesh.nodes_m[:-1], "positions must have shape"),
        (GelFace(mesh).at, broken, "NaN"),
        (tl.OpticalModel(DESIGN, mesh).render, np.zeros((0, 3, 3)), r"\[env, node, 3\]"),
    ):
        with pytest.raises(tl.InputError, match=words):
            call(given)
