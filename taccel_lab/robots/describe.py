# SPDX-License-Identifier: Apache-2.0
"""A robot in plain values and in a picture: joints, links, gels, and what cannot be touched."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.bodies.joints import JointKind
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_image
from taccel_lab.geometry.length_units import size_words
from taccel_lab.guards import unknown
from taccel_lab.robots.catalogue import named, names
from taccel_lab.robots.description import RobotJoint
from taccel_lab.robots.robot import Robot
from taccel_lab.robots.shapes import PrimitiveShape
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.robots.urdf import load_urdf
from taccel_lab.scene import Ball, TriangleMesh, sphere_mesh


def robot_of(text: str, **options: Any) -> Robot:
    """A robot of the catalogue by its name, or of a URDF file by its path, with options of
    ``load_urdf``.

    Raises InputError for a file that cannot be taken over, and a name that is neither.
    """
    if text in names():
        return named(text)
    if not text.lower().endswith((".urdf", ".xml")) and not Path(text).exists():
        raise InputError(
            f"{text!r} is neither a file nor a robot of the catalogue"
            f"{unknown(text, names(), 'taccel-lab robot list')}"
        )
    return load_urdf(text, **options)


def describe_robot(robot: Robot) -> dict[str, Any]:
    """Names, joints with limits in degrees and millimetres, links with mass and shapes, and what is
    rejected when the robot is put into a scene: plain values; no limit is None."""
    refused = []
    links = {}
    for link in robot.links:
        shapes = []
        for shape in link.shapes:
            hull = "hull of " if getattr(shape.shape, "hull", False) else ""
            shapes.append(hull + shape.shape.what)
            try:
                surface = shape.surface()[0]
            except InputError as error:
                refused.append(f"collision shape of link {link.name!r}: {error}")
                continue
            if not isinstance(shape.shape, PrimitiveShape):
                assert isinstance(surface, TriangleMesh)
                shapes[-1] += f" {size_words(surface.vertices_m)}"
        links[link.name] = {
            "mass_kg": None if link.mass is None else link.mass.mass_kg,
            "shapes": shapes,
        }
    return {
        "name": robot.name,
        "base": robot.base,
        "coordinates": robot.dof_names,
        "joints": {joint.name: _joint(joint) for joint in robot.joints},
        "links": links,
        "refused": refused,
    }


def _joint(joint: RobotJoint) -> dict[str, Any]:
    turning = joint.kind is JointKind.REVOLUTE
    limits = np.array([joint.lower, joint.upper])
    scaled = np.degrees(limits) if turning else 1e3 * limits
    return {
        "kind": "continuous" if turning and np.isinf(limits).all() else joint.kind.name.lower(),
        "parent": joint.parent,
        "child": joint.child,
        "limits": [float(end) if np.isfinite(end) else None for end in scaled],
        "unit": ("deg" if turning else "mm") if joint.moves else None,
        "max_effort": float(joint.max_effort) if np.isfinite(joint.max_effort) else None,
        "mimics": joint.mimic and joint.mimic.joint,
    }


LINK_COLOR, GEL_COLOR = "#b8b8b8", "#7fb2d9"
SIZE_PX = (600, 600)


def draw_robot(
    robot: Robot,
    q: Any,
    path: Path,
    direction: tuple[float, float, float] = (1.0, -1.4, 0.6),
) -> None:
    """Draw shapes of links (grey) and gels at rest (blue) into a PNG file.

    Args:
        robot: Links without shape are not seen.
        q: Coordinates, [dof].
        path: The file.
        direction: Where it is looked at from, in world axes.

    Raises InputError for coordinates out of the limits, and shapes that cannot be made.
    """
    import pyvista

    plotter = pyvista.Plotter(off_screen=True, window_size=list(SIZE_PX))
    frames = matrix_of(robot.targets(q))[0]
    gels = {gel.mount: gel for gel in robot.soft_bodies()}
    for body, frame in zip(robot.kinematic_bodies(), frames, strict=True):
        shape = body.shape
        if isinstance(shape, Ball):
            shape = sphere_mesh(shape.radius_m, shape.radius_m / 10)
        gel = gels.get(body.name)
        if gel is not None:
            points, faces = gel.mesh.nodes_m, gel.mesh.faces
        else:
            assert shape is not None  # Only frames of gels have none.
            points, faces = shape.vertices_m, shape.faces
        surface = pyvista.PolyData(
            1e3 * (points @ frame[:3, :3].T + frame[:3, 3]),
            np.column_stack([np.full(len(faces), 3), faces]),
        )
        color = LINK_COLOR if gel is None else GEL_COLOR
        plotter.add_mesh(
            surface, color=color, ambient=0.3, show_edges=gel is not None, edge_color="#3b5a75"
        )
        if gel is None:
            edges = surface.extract_feature_edges(feature_angle=30.0)
            if edges.n_points:  # A ball has none, and nothing cannot be drawn.
                plotter.add_mesh(edges, color="#555555", line_width=1.2)
    plotter.view_vector(direction, viewup=(0, 0, 1))  # type: ignore[arg-type]
    picture = np.asarray(plotter.screenshot(return_img=True))
    plotter.close()
    write_image(path, picture)
