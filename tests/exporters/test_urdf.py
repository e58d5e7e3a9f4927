# SPDX-License-Identifier: Apache-2.0
"""The URDF in a parser of others: links, frames, meshes, inertias."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import pyvista

from taccel_lab.exporters.export import export_profile
from taccel_lab.exporters.urdf import HOUSING_DENSITY
from taccel_lab.profile import SensorProfile
from tests.exporters.conftest import Exported


@pytest.fixture
def folder(exported: Exported) -> Path:
    return exported("urdf")[0]


@pytest.fixture
def robot(folder: Path) -> Any:
    yourdfpy = pytest.importorskip("yourdfpy")
    return yourdfpy.URDF.load(str(folder / "sensor.urdf"), load_collision_meshes=True)


def test_further_cameras_have_frames_or_are_named_as_left_out(
    mini: SensorProfile, tmp_path: Path
) -> None:
    assert mini.optics is not None
    place, turn = (4.0, 0.0, -20.0), (0.0, -0.1, 0.0, math.sqrt(0.99))
    moved = mini.optics.replace(position_mm=place, rotation=turn)
    both = mini.with_view("right", mini.with_block(moved))
    document = export_profile(both, "urdf", tmp_path / "urdf")
    assert "views" in document["carries"]
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(str(tmp_path / "urdf" / "sensor.urdf"))
    found = robot.get_transform("right_optical_frame", "gel_frame")
    np.testing.assert_allclose(1e3 * found[:3, 3], place, atol=1e-6)
    np.testing.assert_allclose(found[:3, :3], moved.camera().gel_from_camera(), atol=1e-6)
    document = export_profile(both, "opencv", tmp_path / "opencv")
    assert document["left_out"]["views"].endswith("export FOLDER@right besides")


def test_meshes_lie_in_the_link(folder: Path, mini: SensorProfile) -> None:
    volume = mini.mesh.volumes_m3().sum()
    for name, low_mm, high_mm, volume_m3 in (
        # x: thickness, y: 25.25 mm, z: 20.75 mm.
        ("gel", [-4, -12.625, -10.375], [0, 12.625, 10.375], volume),
        # Gel x 0.25 is link y -0.25, gel y -0.5 is link z 0.5.
        ("housing", [-28.25, -16.25, -13.5], [-4.25, 15.75, 14.5], 32e-3 * 28e-3 * 24e-3),
    ):
        mesh = pyvista.read(folder / "meshes" / f"{name}.stl")
        assert isinstance(mesh, pyvista.PolyData) and mesh.is_manifold
        low, high = 1e3 * np.reshape(mesh.bounds, (3, 2)).T
        np.testing.assert_allclose(low, low_mm, atol=1e-4)
        np.testing.assert_allclose(high, high_mm, atol=1e-4)
        assert mesh.volume == pytest.approx(volume_m3, rel=1e-5)
        normals = mesh.compute_normals(consistent_normals=False, auto_orient_normals=False)
        away = mesh.cell_centers().points - mesh.center
        assert np.einsum("fk,fk->f", normals.cell_data["Normals"], away).mean() > 0


def test_inertias_are_physical(robot: Any, mini: SensorProfile) -> None:
    volume = mini.mesh.volumes_m3().sum()
    bodies = {link.name: link.inertial for link in robot.robot.links if link.inertial}
    assert set(bodies) == {"sensor_link", "gel", "gel_frame", "camera_optical_frame"}
    # Simulators give a link without inertia 1 kg.
    assert bodies["gel_frame"].mass == bodies["camera_optical_frame"].mass == 1e-6
    assert bodies["gel"].mass == pytest.approx(1000 * volume)
    for body in bodies.values():
        a, b, c = np.linalg.eigvalsh(body.inertia)
        assert a > 0 and a + b > c


def lean(profile: SensorProfile) -> SensorProfile:
    """With a gel that is symmetric about no plane, beside its frame's axes."""
    nodes = profile.mesh.nodes_m.copy()
    nodes[:, 0] += 0.3 * nodes[:, 2] + 1e-3
    nodes[:, 1] += 0.2 * nodes[:, 0] - 0.4 * nodes[:, 2]
    mesh = dataclasses.replace(profile.mesh, nodes_m=nodes)
    assert profile.housing is not None
    housing = profile.housing.replace(size_mm=(32.0, 28.0, 20.0), offset_mm=(1.0, -2.0))
    return dataclasses.replace(profile, mesh=mesh, housing=housing)


def test_inertias_are_those_of_the_meshes_beside_them(mini: SensorProfile, tmp_path: Path) -> None:
    """In the link's frame, each axis another: as trimesh integrates them over the written files."""
    trimesh = pytest.importorskip("trimesh")
    profile = lean(mini)
    export_profile(profile, "urdf", tmp_path / "out")
    root = ElementTree.parse(tmp_path / "out" / "sensor.urdf").getroot()
    links = {str(link.get("name")): link for link in root.iter("link")}
    gel = trimesh.load(tmp_path / "out" / "meshes" / "gel.stl")
    gel.density = profile.material.density_kg_m3
    mass, center, inertia = inertial(links["gel"])
    assert mass == pytest.approx(gel.mass, rel=1e-4)
    np.testing.assert_allclose(center, gel.center_mass, atol=1e-8)
    np.testing.assert_allclose(inertia, gel.moment_inertia, atol=1e-4 * inertia.max())
    assert np.unique(np.round(np.abs(inertia[np.triu_indices(3)]), 12)).size == 6

    # The housing's walls: the box that is drawn without the room inside, open to the front (x).
    box = trimesh.load(tmp_path / "out" / "meshes" / "housing.stl")
    wall = 1e-3 * profile.housing.wall_mm  # type: ignore[union-attr]
    room = trimesh.creation.box(box.extents - [wall, 2 * wall, 2 * wall])
    room.apply_translation(box.bounds.mean(axis=0) + [wall / 2, 0, 0])
    for mesh in (box, room):
        mesh.density = HOUSING_DENSITY
    mass, center, inertia = inertial(links["sensor_link"])
    assert mass == pytest.approx(box.mass - room.mass, rel=1e-4)
    weighed = box.mass * box.center_mass - room.mass * room.center_mass
    np.testing.assert_allclose(center, weighed / mass, atol=1e-7)
    wanted = about(box, center) - about(room, center)
    np.testing.assert_allclose(inertia, wanted, atol=1e-4 * inertia.max())
    collision = links["sensor_link"].find("collision")
    assert collision is not None
    origin, shape = collision.find("origin"), collision.find("geometry/box")
    assert origin is not None and shape is not None
    np.testing.assert_allclose(numbers(origin.get("xyz")), box.bounds.mean(axis=0), atol=1e-8)
    np.testing.assert_allclose(numbers(shape.get("size")), box.extents, atol=1e-8)


def numbers(text: str | None) -> np.ndarray:
    return np.array(str(text).split(), dtype=np.float64)


def inertial(link: ElementTree.Element) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre and inertia that a link states."""
    found = link.find("inertial")
    assert found is not None
    parts = {part.tag: part.attrib for part in found}
    entries = {name: float(value) for name, value in parts["inertia"].items()}
    rows = [[entries["i" + "".join(sorted(a + b))] for b in "xyz"] for a in "xyz"]
    return float(parts["mass"]["value"]), numbers(parts["origin"]["xyz"]), np.array(rows)


def about(mesh: Any, center: np.ndarray) -> np.ndarray:
    """Inertia of a mesh about a point, by Steiner's theorem."""
    arm = mesh.center_mass - center
    return mesh.moment_inertia + mesh.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))


def masses(folder: Path) -> dict[str, float]:
    root = ElementTree.parse(folder / "sensor.urdf").getroot()
    return {str(link.get("name")): inertial(link)[0] for link in root.iter("link")}


@pytest.mark.slow
def test_pybullet_s_loader_gives_no_link_a_weight_of_its_own(folder: Path) -> None:
    pybullet = pytest.importorskip("pybullet", reason="the extra peers is not installed")
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet.loadURDF(str(folder / "sensor.urdf"), physicsClientId=client)
        found = {"sensor_link": pybullet.getDynamicsInfo(body, -1, physicsClientId=client)[0]}
        for i in range(pybullet.getNumJoints(body, physicsClientId=client)):
            name = pybullet.getJointInfo(body, i, physicsClientId=client)[12].decode()
            found[name] = pybullet.getDynamicsInfo(body, i, physicsClientId=client)[0]
    finally:
        pybullet.disconnect(client)
    assert found == pytest.approx(masses(folder)) and sum(found.values()) < 0.02


@pytest.mark.slow
def test_mujoco_s_loader_has_the_same_bodies(folder: Path) -> None:
    mujoco = pytest.importorskip("mujoco", reason="the extra peers is not installed")
    spec = mujoco.MjSpec.from_file(str(folder / "sensor.urdf"))
    # A root without a joint is part of the world there, and its mass counts for nothing.
    spec.compiler.fusestatic = False
    spec.worldbody.first_body().add_freejoint()
    model = spec.compile()
    found = {model.body(i).name: float(model.body_mass[i]) for i in range(1, model.nbody)}
    assert found == pytest.approx(masses(folder))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = data.body("camera_optical_frame").xpos - data.body("gel_frame").xpos
    # The camera looks out of the gel, along x of the link.
    np.testing.assert_allclose(camera, [-0.024, 0, 0], atol=1e-6)
