# SPDX-License-Identifier: Apache-2.0
"""Pictures of one press, and of a gel at rest: maps, image, normals, pressure, force, mesh.

Each function returns a matplotlib figure; ``style.save_figure`` writes it as PNG. Maps are drawn
as the camera sees them: x right, y down, in millimetres of the gel frame.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.files.atomic_file import eight_bit
from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.guards import require_shape
from taccel_lab.report.style import (
    BLUE,
    INK,
    ORANGE,
    in_report_style,
    new_figure,
)
from taccel_lab.with_error import with_error

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taccel_lab.geometry import PixelGrid


def _extent_mm(grid: PixelGrid) -> tuple[float, float, float, float]:
    """Outer edges of the image for imshow with the origin at the top [mm]."""
    x, y = grid.x_mm(), grid.y_mm()
    half_x, half_y = grid.mm_per_px_x / 2, grid.mm_per_px_y / 2
    return (x[0] - half_x, x[-1] + half_x, y[-1] + half_y, y[0] - half_y)


def _map_axes(grid: PixelGrid, title: str) -> tuple[Figure, Any]:
    aspect = (grid.height_px * grid.mm_per_px_y) / (grid.width_px * grid.mm_per_px_x)
    figure, axes = new_figure(6.4, 0.5 + 5.4 * aspect)
    axes.set_title(title)
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    return figure, axes


@in_report_style
def draw_height_map(height_m: np.ndarray, grid: PixelGrid) -> Figure:
    """Height [m], shape [height_px, width_px], with contours; NaN is left white."""
    require_shape("height_m", height_m, (grid.height_px, grid.width_px), finite=False)
    height_mm = height_m * 1e3
    figure, axes = _map_axes(grid, "Height map")
    image = axes.imshow(height_mm, extent=_extent_mm(grid), cmap="viridis")
    low, high = np.nanmin(height_mm), np.nanmax(height_mm)
    if high - low > 1e-6:
        levels = np.linspace(low, high, 11)[1:-1]
        axes.contour(
            grid.x_mm(), grid.y_mm(), height_mm, levels, colors="white", linewidths=0.5, alpha=0.6
        )
    figure.colorbar(image, ax=axes, label="height [mm]", shrink=0.9)
    return figure


@in_report_style
def draw_image(rgb: np.ndarray, grid: PixelGrid) -> Figure:
    """RGB levels 0..255, shape [height_px, width_px, 3]."""
    require_shape("rgb", rgb, (grid.height_px, grid.width_px, 3), finite=False)
    figure, axes = _map_axes(grid, "Tactile image")
    axes.imshow(eight_bit(rgb), extent=_extent_mm(grid))
    return figure


@in_report_style
def draw_press(
    rgb: np.ndarray | None,
    depth_mm: np.ndarray,
    contact: np.ndarray,
    grid: PixelGrid,
    title: str,
) -> Figure:
    """Image (of any size, or none), depth [mm] and contact of a press, over the gel."""
    aspect = (grid.height_px * grid.mm_per_px_y) / (grid.width_px * grid.mm_per_px_x)
    figure, axes = new_figure(11, 1.2 + 3.4 * aspect, 1, 3)
    figure.suptitle(title)
    extent = _extent_mm(grid)
    if rgb is not None:
        axes[0].imshow(eight_bit(rgb), extent=extent)
    axes[0].set_title("tactile image" if rgb is not None else "no colour model")
    shown = axes[1].imshow(depth_mm, extent=extent, cmap="viridis")
    axes[1].set_title("depth")
    figure.colorbar(shown, ax=axes[1], label="depth [mm]", shrink=0.8)
    axes[2].imshow(contact, extent=extent, cmap="Greys", vmin=0, vmax=1)
    axes[2].set_title("contact")
    for axis in axes:
        axis.set_xlabel("x [mm]")
        axis.set_aspect("equal")
        axis.set_xlim(extent[0], extent[1])
        axis.set_ylim(extent[2], extent[3])
    axes[0].set_ylabel("y [mm]")
    return figure


def twofold_difference(simulated: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """Difference of two images, twofold about middle grey [levels]."""
    return 128 + 2 * (simulated.astype(np.float64) - photo)


def depth_panel(depth_mm: np.ndarray, top_mm: float) -> np.ndarray:
    """Depth [mm], shape [height_px, width_px], as a picture like a photo, its scale up to
    ``top_mm`` inside it: RGB levels, uint8, [height_px, width_px, 3]. Black where no gel is seen.

    By OpenCV, which images need anyway: a command that draws its figures in a process beside does
    without the seconds that Matplotlib takes to load.
    """
    import cv2

    def colored(share: np.ndarray) -> np.ndarray:
        steps = np.rint(255 * np.clip(share, 0, 1)).astype(np.uint8)
        return cv2.applyColorMap(steps, cv2.COLORMAP_VIRIDIS)[..., ::-1]

    seen = np.isfinite(depth_mm)
    picture = colored(np.where(seen, depth_mm, 0.0) / max(top_mm, 1e-3)) * seen[..., None]
    picture = np.ascontiguousarray(picture, dtype=np.uint8)
    height, width = depth_mm.shape
    row, column, long, thick = (int(p) for p in (0.9 * height, 0.07 * width, 0.34 * width, 2))
    thick = max(thick, height // 60)
    bar = colored(np.tile(np.linspace(0, 1, max(long, 2)), (thick, 1)))
    picture[row : row + thick, column : column + bar.shape[1]] = bar[: height - row]
    size = max(width / 640, 0.3)
    for text, at in (("0", column), (f"{top_mm:.2f} mm", column + int(0.8 * long))):
        place, font = (at, row - 2 * thick // 3), cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(picture, text, place, font, size, (255, 255, 255), 1, cv2.LINE_AA)
    return picture


@in_report_style
def draw_comparison(
    photo: np.ndarray, simulated: np.ndarray, grid: PixelGrid, psnr_db: float
) -> Figure:
    """Photo of a press, its simulation, and their difference, twofold about middle grey, over the
    gel; RGB levels, uint8, [height_px, width_px, 3]."""
    difference = twofold_difference(simulated, photo)
    aspect = (grid.height_px * grid.mm_per_px_y) / (grid.width_px * grid.mm_per_px_x)
    figure, axes = new_figure(11, 1.2 + 3.4 * aspect, 1, 3)
    for panel, title, image in (
        (axes[0], "photo", photo),
        (axes[1], f"simulated, {psnr_db:.1f} dB", simulated),
        (axes[2], "difference x 2", difference),
    ):
        panel.imshow(eight_bit(image), extent=_extent_mm(grid))
        panel.set_title(title)
        panel.set_xlabel("x [mm]")
    axes[0].set_ylabel("y [mm]")
    return figure


@in_report_style
def draw_markers(
    rgb: np.ndarray | None,
    size_px: tuple[int, int],
    rest_px: np.ndarray,
    now_px: np.ndarray,
) -> Figure:
    """Where dots were at rest and where they are, over the image where there is one.

    Args:
        rgb: RGB levels 0..255, [row, column, 3], of any size; None for none.
        size_px: Width and height of the image that pixels are of.
        rest_px: Columns and rows (u, v) at rest, [marker, 2].
        now_px: The same now; NaN for one that is not seen.
    """
    width, height = size_px
    figure, axes = new_figure(6.4, 0.8 + 5.4 * height / width)
    axes.set_title("Markers")
    axes.set_xlabel("u [px]")
    axes.set_ylabel("v [px]")
    if rgb is not None:
        axes.imshow(eight_bit(rgb), extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    axes.plot(*rest_px.T, "o", mfc="none", mec=BLUE, ms=4, label="at rest")
    axes.plot(*now_px.T, "+", color=ORANGE, ms=5, label="now")
    for rest, now in zip(rest_px, now_px, strict=True):
        axes.plot([rest[0], now[0]], [rest[1], now[1]], color=ORANGE, lw=0.9)
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal")
    figure.legend(loc="outside lower center", ncols=2)
    return figure


@in_report_style
def draw_normals(normals: np.ndarray, grid: PixelGrid) -> Figure:
    """Outward unit normals as RGB = (n + 1) / 2, shape [height_px, width_px, 3]."""
    require_shape("normals", normals, (grid.height_px, grid.width_px, 3), finite=False)
    figure, axes = _map_axes(grid, "Surface normals  (RGB = (n + 1) / 2)")
    axes.imshow(np.nan_to_num(np.clip((normals + 1) / 2, 0, 1), nan=1.0), extent=_extent_mm(grid))
    return figure


@in_report_style
def draw_contact_forces(
    positions_m: np.ndarray,
    contact_faces: np.ndarray,
    forces_n: np.ndarray,
    pressures_pa: np.ndarray,
) -> Figure:
    """Contact pressure and shear arrows.

    Args:
        positions_m: Deformed nodes, shape [node, 3].
        contact_faces: Outward triangles of the contact face, shape [face, 3].
        forces_n: Contact force on each node [N], shape [node, 3].
        pressures_pa: Contact pressure at each node [Pa], shape [node], as of
            ``Outputs.surface_load``: force over nodal area is none on quadratic tets.
    """
    from matplotlib.tri import Triangulation

    corners = positions_m[contact_faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    vector_area = np.zeros_like(positions_m)
    for corner in range(3):
        np.add.at(vector_area, contact_faces[:, corner], cross / 6)
    area = np.linalg.norm(vector_area, axis=1)
    normal = vector_area / np.maximum(area, 1e-30)[:, None]
    along = (forces_n * normal).sum(axis=1)
    shear = (forces_n - along[:, None] * normal)[:, :2]

    loaded = np.flatnonzero(np.linalg.norm(forces_n, axis=1) > 0)
    figure, axes = new_figure(6.4, 5.2)
    axes.set_title(f"Contact pressure, {-forces_n[:, 2].sum():.3g} N along -z")
    xy_mm = positions_m[:, :2] * 1e3
    mesh = Triangulation(xy_mm[:, 0], xy_mm[:, 1], contact_faces)
    drawn = axes.tripcolor(mesh, pressures_pa * 1e-3, shading="gouraud", cmap="magma_r", vmin=0)
    axes.triplot(mesh, color="black", linewidth=0.25, alpha=0.25)
    figure.colorbar(drawn, ax=axes, label="pressure [kPa]", shrink=0.9)
    if len(loaded):
        center = xy_mm[loaded].mean(axis=0)
        reach = max(1.6 * np.abs(xy_mm[loaded] - center).max(), 0.2)
        axes.set_xlim(center[0] - reach, center[0] + reach)
        axes.set_ylim(center[1] + reach, center[1] - reach)
        size = np.linalg.norm(shear[loaded], axis=1).max()
        if size > 0:
            arrows = axes.quiver(
                *xy_mm[loaded].T, *shear[loaded].T, angles="xy", color=BLUE, width=0.004,
                scale_units="xy", scale=size / (0.2 * reach),
            )  # fmt: skip
            key = axes.quiverkey(
                arrows, 0.14, 0.05, size, f"tangential, {size * 1e3:.3g} mN", labelpos="E",
                coordinates="axes",
            )  # fmt: skip
            key.text.set_backgroundcolor("#ffffffcc")
    else:
        axes.invert_yaxis()
    axes.set_aspect("equal")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    return figure


@in_report_style
def draw_force_depth(
    depth_mm: np.ndarray,
    force_n: np.ndarray,
    label: str,
    error_n: float = math.nan,
) -> Figure:
    """Normal force [N] over indentation depth [mm], both of shape [step], and the error of the last
    one where it is known."""
    figure, axes = new_figure(6.4, 4.0)
    axes.grid(True)
    axes.set_axisbelow(True)
    axes.plot(depth_mm, force_n, "o-", color=BLUE, label=label, zorder=3)
    if math.isfinite(error_n):
        label = f"{with_error(float(force_n[-1]), error_n)} N, numerical error"
        ends = depth_mm[-1:], force_n[-1:], error_n
        axes.errorbar(*ends, color=ORANGE, capsize=6, lw=2, label=label, zorder=4)
    axes.set_title("Force over depth")
    axes.set_xlabel("indentation depth [mm]")
    axes.set_ylabel("normal force [N]")
    axes.set_xlim(left=0)
    axes.set_ylim(0, 1.15 * max(float(np.nanmax(force_n)), 1e-9))
    axes.legend(loc="upper left", labelcolor=INK)
    return figure


REGION_COLORS = {
    Region.SIDE: "#e5e7eb",
    Region.CONTACT: "#8ecae6",
    Region.BOND: "#f4a261",
    Region.WINDOW: "#e9c46a",
}


@in_report_style
def draw_mesh(nodes_m: np.ndarray, faces: np.ndarray, regions: np.ndarray) -> Figure:
    """The contact face from above and the surface from the front.

    Args:
        nodes_m: Of the gel [m], shape [node, 3].
        faces: Outward triangles, shape [face, 3].
        regions: ``Region`` of each, shape [face].
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    corners = nodes_m[faces] * 1e3
    span = np.ptp(nodes_m, axis=0) * 1e3
    height = min(0.9 + 6.0 * span[1] / span[0], 5.0)
    figure, axes = new_figure(8.6, height + 2.0, 2, 1, height_ratios=[height, 1.6])
    top, side = axes
    contact = regions == int(Region.CONTACT)
    top.add_collection(
        PolyCollection(
            corners[contact][:, :, :2].tolist(),
            facecolor=REGION_COLORS[Region.CONTACT],
            edgecolor=INK,
            linewidth=0.25,
        )
    )
    top.autoscale()
    top.invert_yaxis()
    top.set_aspect("equal")
    top.set_title(f"contact face from above: {int(contact.sum())} triangles")
    top.set_xlabel("x [mm]")
    top.set_ylabel("y [mm]")
    # Seen from the front: faces nearest to the viewer (largest y) hide the others.
    order = np.argsort(corners[:, :, 1].mean(axis=1))
    colors = [REGION_COLORS[Region(int(regions[face]))] for face in order]
    side.add_collection(
        PolyCollection(
            corners[order][:, :, [0, 2]].tolist(), facecolor=colors, edgecolor=INK, linewidth=0.25
        )
    )
    side.autoscale()
    side.set_aspect("equal" if span[2] > 0.1 * span[0] else "auto")
    side.set_title("from the front")
    side.set_xlabel("x [mm]")
    side.set_ylabel("z [mm]")
    used = [region for region in Region if (regions == int(region)).any()]
    figure.legend(
        handles=[Patch(color=REGION_COLORS[r], label=r.name.lower()) for r in used],
        loc="outside lower center",
        ncols=len(used),
    )
    return figure


@in_report_style
def draw_image_at_rest(image: np.ndarray, grid: PixelGrid, dots_mm: np.ndarray | None) -> Figure:
    """The untouched image over the gel's x and y [mm], with the dots that the profile states.

    Args:
        image: RGB levels, [H, W, 3].
        grid: Of its pixels.
        dots_mm: Of the printed dots in the gel frame [mm], [dot, 2]; None without any.
    """
    corners = grid.gel_from_pixel(
        np.array([[-0.5, -0.5], [grid.width_px - 0.5, grid.height_px - 0.5]])
    )
    (left, top), (right, bottom) = corners
    figure, axes = new_figure(7.0, 7.0 * (bottom - top) / (right - left) + 0.6)
    axes.imshow(image.astype(np.uint8), extent=(left, right, bottom, top))
    if dots_mm is not None:
        axes.plot(dots_mm[:, 0], dots_mm[:, 1], "o", color="white", mfc="none", markersize=7)
        axes.set_xlim(left, right)
        axes.set_ylim(bottom, top)
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    return figure
