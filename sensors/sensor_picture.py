# SPDX-License-Identifier: Apache-2.0
"""A sensor of the catalogue drawn to scale: two sections and the view from the front.

Sight lines of the image's edges are traced through window and gel. What is drawn is what the
family's formulas say; nothing is meshed or built.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.report.style import BLUE, GREY, INK, LIGHT, ORANGE, in_report_style, save_figure
from taccel_lab.sensors.base import all_optics

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from taccel_lab.cad.parts.housing_shape import HousingShape
    from taccel_lab.cad.parts.pad import Pad
    from taccel_lab.profile.optical_design import Light, OpticalDesign, Window
    from taccel_lab.sensors.base import FamilyParameters, SensorFamily

_GEL, _SKIN, _GLASS, _BOX = "#f4c9a8", "#4b3b36", "#cfe8f1", "#9aa1ab"
_SAMPLES = 801
_FRONT_SAMPLES = 301
"""Samples along each side of the view from the front, where every point is one of the gel's
formula: 801 take a DIGIT 5 s."""


def write_sections(family: SensorFamily, parameters: FamilyParameters, folder: Path) -> Path:
    """The sensor to scale, from its dimensions alone: there before anything is built or meshed."""
    path = folder / "sections.png"
    save_figure(draw_sensor(family, parameters), path)
    return path


@in_report_style
def draw_sensor(family: SensorFamily, parameters: FamilyParameters) -> Figure:
    """Sections at y = 0 and x = 0 and the view from the front, in mm of the gel frame."""
    from matplotlib.figure import Figure

    pad, design = parameters.pad(), parameters.optics()
    figure = Figure(figsize=(15, 6.4), layout="constrained")
    axes = figure.subplots(1, 3)
    for axis, name, ax in zip((0, 1), "xy", axes[:2], strict=True):
        _draw_section(ax, axis, parameters, pad, design)
        ax.set_xlabel(f"{name} [mm]")
        ax.set_ylabel("z [mm]")
        ax.set_title(f"section at {'yx'[axis]} = 0", pad=10)
    _draw_front(axes[2], parameters, pad, design)
    _label_parts(figure, parameters, pad, design)
    figure.suptitle(family.title, fontsize=12)
    return figure


def _draw_section(
    ax: Axes, axis: int, parameters: FamilyParameters, pad: Pad, design: OpticalDesign | None
) -> None:
    from matplotlib.patches import Polygon

    housing = parameters.housing()
    outline = pad_section(pad, axis)
    if housing is not None:
        inner = pad.bounds_mm()[:, axis]
        for corners in housing_section(housing, axis, (float(inner[0]), float(inner[1]))):
            ax.add_patch(Polygon(corners, facecolor=_BOX, edgecolor="none", zorder=1))
    if design is not None and design.window is not None:
        for corners in window_section(design.window, axis, -pad.thickness_mm):
            ax.add_patch(Polygon(corners, facecolor=_GLASS, edgecolor=GREY, lw=0.6, zorder=2))
    gel = Polygon(outline, facecolor=_GEL, edgecolor=INK, lw=0.8, zorder=3)
    ax.add_patch(gel)
    _shade_skin(ax, axis, pad, gel)
    markers = parameters.markers()
    if markers is not None:
        points = markers.points_mm()
        # The row or column of dots that lies nearest to the section.
        away = np.abs(points[:, 1 - axis])
        row = points[away < away.min() + 1e-6]
        z = pad.top_mm(row)
        ax.plot(row[:, axis], z, "o", ms=3, color=INK, zorder=5)
    for seen in all_optics(parameters):
        _draw_sight(ax, axis, pad, seen)
    if design is not None:
        for light in _pieces(design):
            _draw_light(ax, axis, light)
    _dimension(ax, axis, pad, design)
    ax.set_aspect("equal")
    ax.margins(0.04)
    ax.autoscale_view()
    ax.set_ylim(top=_width_line(pad) + 0.09 * float(np.diff(ax.get_ylim())[0]))


def pad_section(pad: Pad, axis: int) -> np.ndarray:
    """Outline of the pad's section along x (axis 0) or y (1), closed by itself, [n, 2]."""
    meridian = getattr(pad, "meridian", None)
    if meridian is not None:
        f = np.linspace(0, 1, 48)
        half = np.concatenate([piece.point(f) for piece in meridian.pieces])
        return np.concatenate([half, half[::-1] * [-1.0, 1.0]])
    low, high = pad.bounds_mm()
    along = np.linspace(low[axis], high[axis], _SAMPLES)
    # Just inside of the edge, where the top is defined.
    along[[0, -1]] += np.array([1e-9, -1e-9]) * (high - low)[axis]
    xy = np.zeros((len(along), 2))
    xy[:, axis] = along
    top = pad.top_mm(xy)
    seen = np.isfinite(top)
    face = np.stack([along[seen], top[seen]], axis=-1)
    back = face[[-1, 0]] * [1.0, 0.0] + [0.0, low[2]]
    return np.concatenate([face, back])


def housing_section(
    housing: HousingShape, axis: int, opening_mm: tuple[float, float]
) -> list[np.ndarray]:
    """Walls of the housing cut at the gel's middle: two sides, back, and what frames the gel."""
    half, middle = housing.size_mm[axis] / 2, housing.offset_mm[axis]
    left, right, wall = middle - half, middle + half, housing.wall_mm
    front, back = housing.front_z_mm, housing.front_z_mm - housing.size_mm[2]

    def box(x0: float, x1: float, z0: float, z1: float) -> np.ndarray:
        return np.array([[x0, z0], [x1, z0], [x1, z1], [x0, z1]])

    walls = [
        box(left, left + wall, back, front),
        box(right - wall, right, back, front),
        box(left, right, back, back + wall),
    ]
    if opening_mm[0] > left + wall:
        walls.append(box(left, opening_mm[0], front - wall, front))
    if opening_mm[1] < right - wall:
        walls.append(box(opening_mm[1], right, front - wall, front))
    return walls


def window_section(window: Window, axis: int, front_z_mm: float) -> list[np.ndarray]:
    """The window's section: a rectangle, or the ring of a dome."""
    half = window.size_mm[axis] / 2
    if window.shape == "plate":
        low = front_z_mm - window.thickness_mm
        return [np.array([[-half, low], [half, low], [half, front_z_mm], [-half, front_z_mm]])]
    radius = window.outer_radius_mm
    reach = np.arcsin(min(half / radius, 1.0))
    angle = np.linspace(-reach, reach, 121)
    arc = np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    middle = np.array([0.0, front_z_mm - radius])
    inner = radius - window.thickness_mm
    return [np.concatenate([middle + radius * arc, middle + inner * arc[::-1]])]


def _shade_skin(ax: Axes, axis: int, pad: Pad, gel: Any) -> None:
    if len(pad.layer_names) < 2:
        return
    low, high = pad.bounds_mm()
    a, z = np.meshgrid(
        np.linspace(low[axis], high[axis], _SAMPLES), np.linspace(low[2], high[2], 281)
    )
    points = np.zeros((a.size, 3))
    points[:, axis], points[:, 2] = a.ravel(), z.ravel()
    layer = pad.layer_of(points).reshape(a.shape)
    shade = ax.contourf(a, z, layer, levels=[0.5, 10], colors=[_SKIN], zorder=4)
    shade.set_clip_path(gel)


def _draw_sight(ax: Axes, axis: int, pad: Pad, design: OpticalDesign) -> None:
    """Camera, optical axis and the sight lines of the image's edges."""
    from matplotlib.patches import Rectangle

    eye = np.array(design.camera.position_mm)
    for path in sight_paths(pad, design, axis):
        ax.plot(path[:, axis], path[:, 2], color=BLUE, lw=0.9, zorder=6)
    ax.plot([eye[axis]], [eye[2]], "o", ms=5, color=BLUE, zorder=7)
    size = 0.12 * abs(eye[2])
    ax.add_patch(
        Rectangle(
            (eye[axis] - size / 2, eye[2] - size), size, size, facecolor=INK, zorder=6, alpha=0.85
        )
    )


def sight_paths(pad: Pad, design: OpticalDesign, axis: int) -> list[np.ndarray]:
    """Rays of the image's two edges and middle along one axis, [points, 3] each [mm].

    From the camera through the window into the gel and up to its contact face. Where the edge's ray
    misses the gel, the outermost one that meets it stands in.
    """
    from taccel_lab.camera.gel_camera import CameraModel
    from taccel_lab.camera.refraction import media_between

    camera = design.camera
    middle = np.array([camera.cx_px, camera.cy_px])
    last = (camera.width_px, camera.height_px)[axis] - 0.5
    media = media_between(design, _back_points(pad))
    paths = []
    for edge in (-0.5, middle[axis], last):
        shares = np.linspace(1.0, 0.0, 201)[:, None] if edge != middle[axis] else np.zeros((1, 1))
        pixels = np.repeat(middle[None], len(shares), axis=0)
        pixels[:, axis] += shares[:, 0] * (edge - middle[axis])
        eye, directions = CameraModel(camera).rays(pixels)
        entries, inside, _ = media.trace(eye, directions)
        for entry, direction in zip(entries, inside, strict=True):
            end = _meeting_mm(pad, entry, direction)
            if end is not None:
                paths.append(np.stack([eye, entry, end]))
                break
    return paths


def _meeting_mm(pad: Pad, start: np.ndarray, direction: np.ndarray) -> np.ndarray | None:
    """Where a ray inside the gel first meets the contact face; None beside it."""
    if not (np.isfinite(start).all() and np.isfinite(direction).all()):
        return None
    near, far = 0.0, 2 * float(np.ptp(pad.bounds_mm(), axis=0).max())
    for samples in (2001, 201, 201):  # to a millionth of the pad
        reach = np.linspace(near, far, samples)
        line = start + reach[:, None] * direction
        beyond = np.flatnonzero(line[:, 2] >= pad.top_mm(line[:, :2]))
        if not len(beyond):
            return None
        near, far = reach[max(beyond[0] - 1, 0)], reach[beyond[0]]
    return start + far * direction


def _back_points(pad: Pad) -> np.ndarray:
    """Points on the glued back near the axis [mm], shape [n, 3]."""
    radius = 0.2 * float(np.ptp(pad.bounds_mm()[:, :2], axis=0).min()) / 2
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    xy = np.concatenate([radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1), [[0.0, 0.0]]])
    under = np.column_stack([xy, pad.top_mm(xy) - 0.95 * pad.thickness_mm])
    return pad.bond_projection_mm(under)


def _draw_light(ax: Axes, axis: int, light: Light) -> None:
    position, direction = np.array(light.position_mm), np.array(light.direction)
    color = _light_color(light)
    a, z = position[axis], position[2]
    ax.plot([a], [z], "s", ms=6, color=color, mec=INK, mew=0.6, zorder=8)
    ax.annotate(
        "",
        xy=(a + 3 * direction[axis], z + 3 * direction[2]),
        xytext=(a, z),
        arrowprops={"arrowstyle": "->", "color": color, "lw": 1.6},
        zorder=8,
    )


def _pieces(design: OpticalDesign) -> list[Light]:
    return [piece for light in design.lights for piece in light.straight_pieces()]


def _light_color(light: Light) -> tuple[float, float, float]:
    rgb = np.array(light.rgb) / max(light.rgb)
    if rgb.min() > 0.9:
        return (1.0, 0.85, 0.2)
    red, green, blue = (0.15 + 0.8 * rgb).tolist()
    return red, green, blue


def _dimension(ax: Axes, axis: int, pad: Pad, design: OpticalDesign | None) -> None:
    """Width and thickness of the gel and the camera's distance."""
    low, high = pad.bounds_mm()
    style: Any = {"arrowstyle": "<->", "color": GREY, "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
    above = _width_line(pad)
    ax.annotate("", xy=(low[axis], above), xytext=(high[axis], above), arrowprops=style)
    width = float(high[axis] - low[axis])
    # Not in the middle, where a tool may stand.
    ax.text(low[axis] + width / 5, above, f"{width:.4g}", ha="center", va="bottom")
    # The gel's thickness stands on the axis, where it counts.
    back = -pad.thickness_mm
    ax.annotate("", xy=(0, 0), xytext=(0, back), arrowprops={**style, "color": INK}, zorder=9)
    ax.text(0.3, back / 2, f"{pad.thickness_mm:.4g}", va="center", ha="left", zorder=9)
    if design is not None:
        eye = design.camera.position_mm
        side = high[axis] + 0.08 * width + 3.5
        ax.annotate("", xy=(side, 0), xytext=(side, eye[2]), arrowprops=style)
        ax.text(side + 0.3, eye[2] / 2, f"{-eye[2]:.4g}", va="center", ha="left")
        for z in (0.0, eye[2]):
            ax.plot([side - 0.6, side + 0.6], [z, z], color=GREY, lw=0.8)


def _width_line(pad: Pad) -> float:
    """z of the line that states the gel's width."""
    low, high = pad.bounds_mm()
    return float(high[2] + 0.05 * (high - low).max() + 0.8)


def _draw_front(
    ax: Axes, parameters: FamilyParameters, pad: Pad, design: OpticalDesign | None
) -> None:
    from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

    low, high = pad.bounds_mm()
    housing, markers = parameters.housing(), parameters.markers()
    if housing is not None:
        (x, y), (cx, cy), r = housing.size_mm[:2], housing.offset_mm, housing.corner_radius_mm
        ax.add_patch(
            FancyBboxPatch(
                (cx - x / 2 + r, cy - y / 2 + r),
                x - 2 * r,
                y - 2 * r,
                boxstyle=f"round,pad={r}",
                facecolor=LIGHT,
                edgecolor=GREY,
            )
        )
    x, y = (np.linspace(low[k] - 0.01, high[k] + 0.01, _FRONT_SAMPLES) for k in (0, 1))
    xy = np.stack(np.meshgrid(x, y), axis=-1)
    height = pad.top_mm(xy)
    inside = np.isfinite(height).astype(float)
    ax.contourf(x, y, inside, levels=[0.5, 2], colors=[_GEL])
    ax.contour(x, y, inside, levels=[0.5], colors=[INK], linewidths=0.9)
    if np.nanmin(height) < -0.05:
        lines = ax.contour(x, y, height, levels=6, colors=[ORANGE], linewidths=0.6, linestyles="-")
        ax.clabel(lines, fmt="%.2g", fontsize=7)
    for grid in (seen.grid() for seen in (parameters, *parameters.views().values())):
        corner = grid.gel_from_pixel(np.array([-0.5, -0.5]))
        ax.add_patch(
            Rectangle(
                (float(corner[0]), float(corner[1])),
                grid.width_px * grid.mm_per_px_x,
                grid.height_px * grid.mm_per_px_y,
                fill=False,
                edgecolor=BLUE,
                lw=1.2,
                ls="--",
            )
        )
    if markers is not None:
        for point in markers.points_mm():
            ax.add_patch(Circle((point[0], point[1]), markers.radius_mm, color=INK))
    for light in _pieces(design) if design is not None else ():
        px, py, _ = light.position_mm
        ax.plot([px], [py], "s", ms=6, color=_light_color(light), mec=INK, mew=0.6)
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.invert_yaxis()  # y points down in the image
    ax.set_xlabel("x [mm]")
    ax.set_ylabel("y [mm]")
    ax.set_title("as in the image; heights of the contact face [mm]")


def _label_parts(
    figure: Figure, parameters: FamilyParameters, pad: Pad, design: OpticalDesign | None
) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Patch(facecolor=_GEL, edgecolor=INK, label="gel")]
    if len(pad.layer_names) > 1:
        handles.append(Patch(facecolor=_SKIN, label="skin"))
    if design is not None:
        if design.window is not None:
            handles.append(Patch(facecolor=_GLASS, edgecolor=GREY, label="window"))
        handles.append(Line2D([], [], color=BLUE, lw=1, label="sight lines of the image's edges"))
        handles.append(
            Line2D([], [], color="none", marker="s", mfc="#d55", mec=INK, label="LED and its axis")
        )
    handles.append(Line2D([], [], color=BLUE, lw=1.2, ls="--", label="tactile image"))
    if parameters.housing() is not None:
        handles.append(Patch(facecolor=_BOX, label="housing"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
