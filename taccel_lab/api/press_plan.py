# SPDX-License-Identifier: Apache-2.0
"""A press as it is planned: checked before a kernel is compiled or a mesh is made, and drawn to
scale: the sensor, the tool at first touch, the mesh."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from taccel_lab.api.press_options import PressOptions
from taccel_lab.api.press_photo import PressPhoto
from taccel_lab.api.sensor import AnySensor, profile_of, reading_profile_of
from taccel_lab.camera.gel_camera import camera_of, face_of
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.length_units import size_words
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.model.devices import require_device
from taccel_lab.presses import parse_indenter, physics_difference
from taccel_lab.presses.force_interval import measured_range
from taccel_lab.presses.touch import check_depth, first_touch_m
from taccel_lab.processes.beside import Call, at_once
from taccel_lab.processes.start_warp import start_warp
from taccel_lab.profile.assumed import is_modulus_known
from taccel_lab.report import save_drawing
from taccel_lab.report.style import BLUE, INK, in_report_style
from taccel_lab.scene import Ball, TriangleMesh
from taccel_lab.sensors.press_mesh import profile_press_mesh
from taccel_lab.sensors.registry import profile_sensor
from taccel_lab.sensors.sensor_picture import draw_sensor
from taccel_lab.signals.color_model import ColorModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from taccel_lab.geometry import TetMesh
    from taccel_lab.presses import Indenter, PressPhysics
    from taccel_lab.presses.press_outcome import FurtherView
    from taccel_lab.profile import SensorProfile
    from taccel_lab.sensors.base import SensorFamily


@dataclass(frozen=True)
class PressPlan:
    """A press of one sensor, checked: what is pressed into what, on which meshes, and seen how."""

    sensor: str
    """Name of what is pressed, as it was given."""
    profile: SensorProfile
    indenter: Indenter
    options: PressOptions
    physics: PressPhysics
    friction: float
    """Coefficient between indenter and gel."""
    photo: PressPhoto | None = None
    """What is to be pressed like."""
    is_rough: bool = False
    """Whether it only leads to another press: its error is not measured."""

    @classmethod
    def plan(cls, sensor: AnySensor, options: PressOptions) -> Self:
        """Refuse, before a mesh is made, all that can be rejected. Errors as of ``press``."""
        start_warp()
        require_device(options.device)
        options.require_aim()
        indenter = parse_indenter(options.indenter, options.read_texture())
        physics, profile = (
            options.physics(),
            reading_profile_of(sensor) if options.like else profile_of(sensor),
        )
        stated = profile.material.friction_coefficient
        friction = stated if options.friction is None else options.friction
        name = str(sensor) if isinstance(sensor, (str, Path)) else profile.sensor.name
        photo = None
        if options.like is not None:
            photo = PressPhoto.read(profile, options.like, options.untouched)
            options = replace(options, depth_mm=photo.depth_mm, at_mm=photo.at_mm)
        run = cls(name, profile, indenter, options, physics, friction, photo)
        options.path(run.first_mm)
        if (options.hold_s or options.speed_mm_s is not None) and not profile.material.branches:
            raise InputError(
                f"the gel of {name} does not relax, so that time changes nothing: leave out "
                "--hold-s and --speed-mm-s, or give its material branches"
            )
        check_depth(run.first_mm, profile)
        indenter.require_size(run.first_mm)
        ColorModel.from_profile(profile)
        return run

    @property
    def first_mm(self) -> float:
        """Depth of the first press [mm]: the one asked for, or where the search begins."""
        if self.options.depth_mm is not None:
            return self.options.depth_mm
        from taccel_lab.presses.press_force import FIRST_SHARE

        return FIRST_SHARE * self.profile.gel.thickness_mm

    @property
    def remembers(self) -> bool:
        """Whether the gel's state depends on the path that led there."""
        return self.friction > 0 or bool(self.profile.material.branches)

    @property
    def is_friction_doubtful(self) -> bool:
        """Whether friction that nobody measured matters beside what is known of the modulus."""
        material = self.profile.material
        measured = measured_range(self.profile, "friction_coefficient") is not None
        chosen = self.options.friction is not None or measured or self.friction == 0
        return is_modulus_known(material) and not chosen

    @property
    def differs(self) -> str | None:
        """How the press differs from those that the material was fitted with, in a sentence."""
        return physics_difference(self.profile.material, self.physics, self.friction)

    def notes(self) -> list[str]:
        """What a person should know before the press, a sentence each."""
        found = list(self.profile.sensor.provenance.remarks[:1])
        if self.differs is not None:
            found.append(self.differs)
        if self.photo is not None:
            found += self.photo.warnings
        found += self.indenter.remarks
        if self.indenter.name.startswith("mesh:") and isinstance(self.indenter.shape, TriangleMesh):
            words = size_words(self.indenter.shape.vertices_m)
            found.append(f"{self.options.indenter} is {words}")
        return found

    @cached_property
    def gel(self) -> TetMesh:
        """Mesh of the first press, in the gel frame [m]."""
        return self._meshed(self.physics, self.first_mm)

    def write_scene(self, folder: Path, call: Call = at_once) -> Path:
        """Draw what is about to be pressed, which compiles nothing; returns the picture, which is
        there when ``call`` is done."""
        path, gel, family = folder / SCENE, self.gel, profile_sensor(self.profile)
        at_mm, aim = self.options.at_mm, self.options.aim()
        seen = family, gel, self.indenter, at_mm, self.first_mm, aim
        call(save_drawing, path, draw_scene, *seen)
        return path

    @cached_property
    def _views(self) -> dict[str, FurtherView]:
        """All cameras by name, the main one first, and the pad's face at rest on their pixels."""
        from taccel_lab.presses.press_outcome import FurtherView
        from taccel_lab.signals.rest_surface import rest_surface

        found = {}
        for name in self.profile.view_names():
            camera = camera_of(self.profile.seen_by(name))
            found[name] = FurtherView(camera, rest_surface(self.profile.mesh, face_of(camera)))
        return found

    def mesh_for(self, physics: PressPhysics, depth_mm: float, refinement: float = 1.0) -> TetMesh:
        """Mesh of a press to a depth [mm], in the gel frame [m], with ``refinement`` times as many
        elements along every side as ``physics`` says."""
        same = physics.mesh == self.physics.mesh and refinement == 1.0
        first = same and depth_mm == self.first_mm
        return self.gel if first else self._meshed(physics, depth_mm, refinement)

    def _meshed(self, physics: PressPhysics, depth_mm: float, refinement: float = 1.0) -> TetMesh:
        if self.options.mesh == "profile":
            return self.profile.mesh
        try:
            contact = self.indenter.contact(depth_mm)
            return profile_press_mesh(
                self.profile, self.options.at_mm, contact, physics.mesh, refinement
            )
        except InputError as error:
            x, y = self.options.at_mm
            raise InputError(
                f"{self.sensor} cannot be meshed for a press at ({x:g}, {y:g}) mm: {error}"
            ) from error


SCENE = "scene.png"
_TOOL = "#7c8694"
_MOST_FACES = 20_000
"""Faces of a tool whose shadow is drawn face by face; of finer ones the convex hull is."""


@in_report_style
def draw_scene(
    family: SensorFamily,
    mesh: TetMesh,
    indenter: Indenter,
    at_mm: tuple[float, float],
    depth_mm: float,
    aim: str,
) -> Figure:
    """The sensor's sections and front view with what is pressed into it.

    Args:
        family: Sensor, with its own parameters.
        mesh: Gel of the press, in the gel frame [m]; its contact face is drawn.
        indenter: Tool; its shadow along each axis is drawn where it first touches.
        at_mm: Gel xy of its axis.
        depth_mm: By which the contact that is expected is drawn.
        aim: How far it is pressed, in words, such as ``0.5 mm``.
    """
    figure = draw_sensor(family, family.parameters())
    nodes, faces = mesh.nodes_m, mesh.region_faces(Region.CONTACT)
    touch = 1e3 * first_touch_m(indenter.shape, nodes, faces, 1e-3 * np.asarray(at_mm))
    if indenter.texture is not None:
        touch += 1e3 * indenter.texture.mean_depth_m
    if np.isfinite(touch):
        for axis, ax in enumerate(figure.axes[:2]):
            _draw_shadow(ax, axis, indenter, (at_mm[axis], touch))
            _draw_aim(ax, indenter, at_mm[axis], touch, aim)
    front = figure.axes[2]
    x, y, _ = 1e3 * nodes.T
    front.triplot(x, y, faces, color=INK, lw=0.2, alpha=0.6)
    _draw_contact(front, indenter.contact(depth_mm), at_mm)
    count = f"{mesh.node_count:,} corners, {mesh.tet_count:,} tets"
    figure.suptitle(f"{family.label}: {indenter.name} at ({at_mm[0]:g}, {at_mm[1]:g}) mm, {count}")
    return figure


def _draw_shadow(ax: Axes, axis: int, indenter: Indenter, origin_mm: tuple[float, float]) -> None:
    """The tool seen along the other axis, as high above the gel as the section is wide."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Circle

    shape, style = indenter.shape, {"facecolor": _TOOL, "edgecolor": "none", "zorder": 3.5}
    if isinstance(shape, Ball):
        ax.add_patch(Circle(origin_mm, 1e3 * shape.radius_m, **style))
        high = 1e3 * shape.radius_m
    else:
        points = 1e3 * shape.vertices_m[:, [axis, 2]] + origin_mm
        shadow = points[shape.faces]
        if len(shadow) > _MOST_FACES:
            from scipy.spatial import ConvexHull

            shadow = points[ConvexHull(points).vertices][None]
        ax.add_collection(PolyCollection(list(shadow), **style), autolim=False)
        high = float(points[:, 1].max()) - origin_mm[1]
    left, right = ax.get_xlim()
    ax.set_xlim(left, right)
    _make_room(ax, min(origin_mm[1] + high, 0.6 * (right - left)))


def _draw_aim(ax: Axes, indenter: Indenter, at_mm: float, touch_mm: float, aim: str) -> None:
    """An arrow down the tool's axis, with how far it goes."""
    shape = indenter.shape
    low = -shape.radius_m if isinstance(shape, Ball) else float(shape.vertices_m[:, 2].min())
    tip = touch_mm + 1e3 * low
    size = 0.16 * float(np.diff(ax.get_xlim())[0])
    _make_room(ax, tip + 1.4 * size)
    arrow = {"arrowstyle": "-|>", "color": BLUE, "lw": 1.8}
    ax.annotate(
        aim, xy=(at_mm, tip), xytext=(at_mm, tip + size), arrowprops=arrow, ha="center",
        va="bottom", color=BLUE, zorder=10, bbox={"fc": "white", "ec": "none", "pad": 1},
    )  # fmt: skip


def _make_room(ax: Axes, top_mm: float) -> None:
    ax.set_ylim(top=max(ax.get_ylim()[1], top_mm))


def _draw_contact(ax: Axes, contact: float | ToolSection, at_mm: tuple[float, float]) -> None:
    from matplotlib.patches import Circle, Polygon

    style = {"fill": False, "edgecolor": BLUE, "lw": 1.6, "zorder": 9}
    if isinstance(contact, ToolSection):
        ax.add_patch(Polygon(contact.outline_mm + at_mm, **style))
    else:
        ax.add_patch(Circle(at_mm, contact, **style))
