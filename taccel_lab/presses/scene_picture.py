# SPDX-License-Identifier: Apache-2.0
"""What is about to be pressed, to scale: the sensor, the tool at first touch, the mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.geometry import Region
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.presses.touch import first_touch_m
from taccel_lab.report.style import BLUE, INK, in_report_style
from taccel_lab.scene import Ball
from taccel_lab.sensors.sensor_picture import draw_sensor

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from taccel_lab.geometry import TetMesh
    from taccel_lab.presses import Indenter
    from taccel_lab.sensors.base import SensorFamily

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
