# SPDX-License-Identifier: Apache-2.0
"""A profile becomes a scene, and what its sensor sees and feels is read from the solver."""

from __future__ import annotations

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.camera.gel_camera import camera_of, in_image
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.profile import BranchEntry, LayerMaterial, MaterialBlock, Provenance
from taccel_lab.scene import MaxwellBranch
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import sensor_family

RADIUS_M, DEPTH_M = 4e-3, 3e-4


@pytest.fixture(scope="module")
def pressed():
    """Mini, ball, three environments; the middle one is not touched."""
    profile = catalogue_profile("gelsight_mini")
    mesh = gel_mesh(sensor_family("gelsight_mini").parameters().pad(), edge_mm=4)
    bodies = {
        "gel": {"element": tl.Element.LINEAR},
        "kinematic_bodies": tl.KinematicBody(tl.Ball(RADIUS_M)),
    }
    scene = tl.profile_scene(profile, mesh=mesh, env_count=3, **bodies)
    solver = tl.SolverIPC(scene.finalize("cpu"))
    poses = np.zeros((3, 1, 7))
    poses[..., 6] = 1.0
    poses[..., 2] = RADIUS_M + 2e-4
    state = tl.initial_state(solver.model, poses)
    for part in (0.5, 1.0):
        poses[[0, 2], 0, 2] = RADIUS_M - part * DEPTH_M
        assert solver.step(state, poses).converged.all()
    return profile, scene, solver, state


@pytest.mark.thorough
def test_gel_is_the_profiles(pressed):
    profile, scene, _, _ = pressed
    (gel,) = scene.soft_bodies
    assert gel.material.young_modulus_pa == profile.material.young_modulus_pa
    assert gel.friction_coefficient == profile.material.friction_coefficient
    assert gel.element is tl.Element.LINEAR


def test_signals_are_the_profiles(pressed):
    profile, _, solver, state = pressed
    sensor = tl.SignalTactile.from_profile(profile, solver=solver)
    sensor.update(state)
    markers, depth = (tl.to_torch(array).numpy() for array in sensor.read("markers_px", "depth_m"))
    grid = profile.grid()
    assert depth.shape == (3, grid.height_px, grid.width_px)
    assert 0.5 * DEPTH_M < np.nanmax(depth[0]) < 1.2 * DEPTH_M
    assert np.nanmax(np.abs(depth[1])) < 1e-6
    # The dots of the profile's own block, in its order, where they are not touched.
    points = profile.markers.grid().points_mm()
    camera, layout = camera_of(profile), tl.MarkerLayout.from_points(profile.mesh, points)
    where = camera.pixel_from_gel(layout.places_mm(profile.mesh.nodes_m))
    where = where[in_image(where, camera)]
    assert markers.shape == (3, len(where), 2)
    assert np.abs(markers[1] - where).max() < 1e-3
    assert np.abs(markers[0] - where).max() > 0.02
    # The wrench is a tensor that pushes the gel down.
    wrench = tl.to_torch(tl.Outputs(solver).update(state).soft_wrenches())[:, 0].numpy()
    assert wrench.shape == (3, 6)
    assert wrench[0, 2] < -0.1 and abs(wrench[1, 2]) < 1e-9
    assert wrench[2, 2] == pytest.approx(wrench[0, 2], rel=1e-3)


def test_options_go_first_and_a_count_is_needed(pressed):
    profile, _, solver, _ = pressed
    assert tl.SignalTactile.from_profile(profile, solver=solver, markers=None).env_count == 3
    with pytest.raises(tl.InputError, match="how many environments"):
        tl.SignalTactile.from_profile(profile)
    with pytest.raises(tl.InputError, match="no soft body 2"):
        tl.SignalTactile.from_profile(profile, solver=solver, gel=2)


SKIN = LayerMaterial(name="skin", young_modulus_pa=9e5, poisson_ratio=0.3, density_kg_m3=1200.0)
PLAIN = MaterialBlock(
    young_modulus_pa=2e5, poisson_ratio=0.45, density_kg_m3=1000.0, friction_coefficient=0.5,
    provenance=Provenance(kind="assumed", method="made up for a test", source="none"),
)  # fmt: skip
SKINNED = PLAIN.replace(layers=(SKIN,))


def two_tets(*layers: int) -> tl.TetMesh:
    nodes = np.array([[0, 0, 0], [1, 0, -1], [0, 1, -1], [0, 0, -1], [1, 1, 0]]) * 1e-3
    tets = np.array([[0, 2, 1, 3], [0, 1, 2, 4]])
    faces = boundary_faces(tets)
    return tl.TetMesh(nodes, tets, faces, np.zeros(len(faces)), tet_layers=np.array(layers))


def test_each_tet_has_the_moduli_of_its_layer():
    found = tl.profile_material(SKINNED, two_tets(1, 0))
    assert isinstance(found, tl.MaterialField)
    assert np.array_equal(found.young_modulus_pa, [9e5, 2e5])
    assert np.array_equal(found.poisson_ratio, [0.3, 0.45])
    assert np.array_equal(found.density_kg_m3, [1200.0, 1000.0])
    assert tl.SoftBody(two_tets(1, 0), found, element=tl.Element.LINEAR).material is found
    # A mesh of one layer is uniform.
    for layer, young in ((0, 2e5), (1, 9e5)):
        uniform = tl.profile_material(SKINNED, two_tets(layer, layer))
        assert isinstance(uniform, tl.Material) and uniform.young_modulus_pa == young
    with pytest.raises(tl.InputError, match="layer 1"):
        tl.profile_material(PLAIN, two_tets(0, 1))


def test_all_layers_relax_as_the_gel():
    block = SKINNED.replace(branches=(BranchEntry(relative_modulus=0.2, time_s=3.0),))
    for layers in ((1, 0), (1, 1)):
        assert tl.profile_material(block, two_tets(*layers)).branches == (MaxwellBranch(0.2, 3.0),)
