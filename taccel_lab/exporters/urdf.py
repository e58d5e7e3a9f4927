# SPDX-License-Identifier: Apache-2.0
"""The sensor as a URDF: housing and gel with meshes and inertias, and the frames to work in.

``sensor_link`` has the body axes of ROS (REP 103): x out of the gel, y left and z up in the tactile
image, its origin at the gel's apex. ``gel_frame`` is the gel frame, ``camera_optical_frame`` the
camera with z along the view (REP 103's optical frame). http://wiki.ros.org/urdf/XML/link
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from taccel_lab.exporters.frames import LINK_FROM_GEL, euler_xyz, m_from_mm, turn
from taccel_lab.exporters.mesh_files import gel_surface, housing_box, write_stl
from taccel_lab.exporters.record import ExportRecord
from taccel_lab.geometry import TetMesh
from taccel_lab.profile import MAIN_VIEW, HousingBlock, SensorProfile

HOUSING_DENSITY = 1050.0
"""Density of the walls [kg/m^3], printed plastic; no block says it."""


@dataclass(frozen=True)
class UrdfInertia:
    """Inertia of a body in a frame [kg, m, kg m^2]."""

    mass: float
    center: np.ndarray
    inertia: np.ndarray
    """Inertia tensor about the centre of mass, shape [3, 3]."""


FRAME_MASS = UrdfInertia(1e-6, np.zeros(3), 1e-12 * np.eye(3))
"""Inertia of a link that is a frame only: a milligram. Bullet gives a link without inertia 1 kg."""


def export_urdf(profile: SensorProfile, folder: Path) -> ExportRecord:
    """Write ``sensor.urdf`` and ``meshes/``."""
    meshes = folder / "meshes"
    meshes.mkdir()
    name = re.sub(r"\W", "_", profile.sensor.name)
    robot = ElementTree.Element("robot", name=name)
    base = ElementTree.SubElement(robot, "link", name="sensor_link")
    if profile.housing is not None:
        _add_inertial(base, _turned(housing_mass(profile.housing)))
        _add_shape(base, "housing.stl", profile.housing, meshes)
    else:
        _add_inertial(base, FRAME_MASS)
    gel = ElementTree.SubElement(robot, "link", name="gel")
    _add_inertial(gel, _turned(tet_mass(profile.mesh, profile.material.density_kg_m3)))
    points, faces = gel_surface(profile.mesh)
    write_stl(meshes / "gel.stl", turn(LINK_FROM_GEL, points), faces)
    for kind in ("visual", "collision"):
        _add_mesh(ElementTree.SubElement(gel, kind), "gel.stl")
    _add_joint(robot, "gel", np.zeros(3), np.eye(3))
    _add_inertial(ElementTree.SubElement(robot, "link", name="gel_frame"), FRAME_MASS)
    _add_joint(robot, "gel_frame", np.zeros(3), LINK_FROM_GEL)
    for name in profile.view_names():
        optics = profile.seen_by(name).optics
        if optics is None:
            continue
        camera = optics.camera()
        link = f"{'camera' if name == MAIN_VIEW else name}_optical_frame"
        _add_inertial(ElementTree.SubElement(robot, "link", name=link), FRAME_MASS)
        _add_joint(
            robot,
            link,
            LINK_FROM_GEL @ m_from_mm(np.array(camera.position_mm)),
            LINK_FROM_GEL @ camera.gel_from_camera(),
        )
    tree = ElementTree.ElementTree(robot)
    ElementTree.indent(tree)
    tree.write(folder / "sensor.urdf", encoding="utf-8", xml_declaration=True)

    record = ExportRecord(
        carries={
            "gel": "surface as visual and collision mesh, mass and inertia",
            "material": "density",
        },
        notes=[
            "sensor_link: x out of the gel, y left and z up in the tactile image, origin at the "
            "apex of the contact face; metres, kilograms",
            "gel_frame: x right and y down in the image, z out of the gel",
            "the gel is a rigid body: what bends belongs into a soft-body format",
            "links that are frames only weigh a milligram: simulators give links without inertia "
            "1 kg",
        ],
    )
    if profile.housing is not None:
        record.carries["housing"] = "outer box; mass and inertia of its walls"
        record.notes.append(
            f"the housing's density of {HOUSING_DENSITY:g} kg/m^3 is assumed, and its box is "
            "without corner radius, screws and electronics"
        )
    if profile.optics is not None:
        record.carries["optics"] = "pose of the camera"
        if profile.views:
            record.carries["views"] = "poses of further cameras, NAME_optical_frame"
        record.left_out["optics.intrinsics"] = "URDF has no place for them; see the opencv export"
    record.leave_out_missing(profile, "housing", "optics")
    record.no_place_for(profile, "color", "markers", "lights")
    return record


def tet_mass(mesh: TetMesh, density: float) -> UrdfInertia:
    """Exact for uniform tets: the integral of x x^T over one is
    V / 20 (sum x_i x_i^T + (sum x_i)(sum x_i)^T)."""
    corners = mesh.nodes_m[mesh.tets]
    volumes = mesh.volumes_m3()
    mass = float(density * volumes.sum())
    center = density * np.einsum("t,tk->k", volumes, corners.mean(axis=1)) / mass
    arms = corners - center
    total = arms.sum(axis=1)
    second = (
        np.einsum("t,tia,tib->ab", volumes, arms, arms)
        + np.einsum("t,ta,tb->ab", volumes, total, total)
    ) * (density / 20)
    return UrdfInertia(mass, center, np.trace(second) * np.eye(3) - second)


def housing_mass(housing: HousingBlock) -> UrdfInertia:
    """A closed box of the stated wall, open to the front."""
    outer = m_from_mm(np.array(housing.size_mm))
    wall = m_from_mm(housing.wall_mm)
    inner = np.maximum(outer - np.array([2 * wall, 2 * wall, wall]), 0.0)
    front = m_from_mm(housing.front_z_mm)
    offset = m_from_mm(np.array(housing.offset_mm))
    parts = [
        _box(outer, np.append(offset, front - outer[2] / 2), HOUSING_DENSITY),
        _box(inner, np.append(offset, front - inner[2] / 2), -HOUSING_DENSITY),
    ]
    mass = sum(part.mass for part in parts)
    center = sum((part.mass * part.center for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        arm = part.center - center
        inertia += part.inertia + part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return UrdfInertia(mass, center, inertia)


def _box(size: np.ndarray, center: np.ndarray, density: float) -> UrdfInertia:
    mass = float(density * size.prod())
    squares = size**2
    return UrdfInertia(mass, center, np.diag(mass / 12 * (squares.sum() - squares)))


def _turned(body: UrdfInertia) -> UrdfInertia:
    return UrdfInertia(
        body.mass, LINK_FROM_GEL @ body.center, LINK_FROM_GEL @ body.inertia @ LINK_FROM_GEL.T
    )


def _add_inertial(link: ElementTree.Element, body: UrdfInertia) -> None:
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_text(body.center), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=repr(float(body.mass)))
    entries = {
        "ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2),
    }  # fmt: skip
    ElementTree.SubElement(
        inertial, "inertia", {key: repr(float(body.inertia[at])) for key, at in entries.items()}
    )


def _add_shape(link: ElementTree.Element, file: str, housing: HousingBlock, meshes: Path) -> None:
    points, faces = housing_box(housing)
    turned = turn(LINK_FROM_GEL, points)
    write_stl(meshes / file, turned, faces)
    _add_mesh(ElementTree.SubElement(link, "visual"), file)
    collision = ElementTree.SubElement(link, "collision")
    low, high = turned.min(axis=0), turned.max(axis=0)
    ElementTree.SubElement(collision, "origin", xyz=_text((low + high) / 2), rpy="0 0 0")
    geometry = ElementTree.SubElement(collision, "geometry")
    ElementTree.SubElement(geometry, "box", size=_text(high - low))


def _add_mesh(element: ElementTree.Element, file: str) -> None:
    ElementTree.SubElement(element, "origin", xyz="0 0 0", rpy="0 0 0")
    geometry = ElementTree.SubElement(element, "geometry")
    ElementTree.SubElement(geometry, "mesh", filename=f"meshes/{file}")


def _add_joint(
    robot: ElementTree.Element, child: str, origin: np.ndarray, rotation: np.ndarray
) -> None:
    joint = ElementTree.SubElement(robot, "joint", name=f"sensor_link_to_{child}", type="fixed")
    ElementTree.SubElement(joint, "parent", link="sensor_link")
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(
        joint, "origin", xyz=_text(origin), rpy=_text(np.array(euler_xyz(rotation)))
    )


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)
