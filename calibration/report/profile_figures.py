# SPDX-License-Identifier: Apache-2.0
"""Pictures of a profile."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.report.color_discs import draw_color_discs, profile_discs
from taccel_lab.profile import SensorProfile
from taccel_lab.report.figures_mesh import draw_mesh
from taccel_lab.report.style import BLUE, ORANGE, in_report_style, new_figure
from taccel_lab.signals.perturbation import draw_perturbation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DRAWS = 6


def draw_profile_mesh(profile: SensorProfile) -> Figure:
    """The contact face and a side view."""
    mesh = profile.mesh
    return draw_mesh(mesh.nodes_m, mesh.faces, mesh.face_regions)


def draw_profile_discs(profile: SensorProfile) -> Figure:
    """Colour change over the hemisphere of normals at a few places."""
    return draw_color_discs(profile_discs(profile))


@in_report_style
def draw_image_at_rest(profile: SensorProfile) -> Figure:
    """Background over the gel's x and y [mm], with the markers that the profile states."""
    image, grid = profile.background_rgb, profile.grid()
    assert image is not None
    corners = grid.gel_from_pixel(
        np.array([[-0.5, -0.5], [grid.width_px - 0.5, grid.height_px - 0.5]])
    )
    (left, top), (right, bottom) = corners
    figure, axes = new_figure(7.0, 7.0 * (bottom - top) / (right - left) + 0.6)
    axes.imshow(image.astype(np.uint8), extent=(left, right, bottom, top))
    if profile.markers is not None:
        points = profile.markers.grid().points_mm()
        axes.plot(points[:, 0], points[:, 1], "o", color="white", mfc="none", markersize=7)
        axes.set_xlim(left, right)
        axes.set_ylim(bottom, top)
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    return figure


@in_report_style
def draw_depth_response(profile: SensorProfile) -> Figure:
    """Drop of the grey level against indentation, with the stated spread as a band."""
    block = profile.depth_response
    assert block is not None
    drop, depth = np.array(block.drop_levels), np.array(block.depth_mm)
    figure, axes = new_figure(6.4, 3.6)
    axes.grid(True)
    axes.plot(drop, depth, color=BLUE)
    sigma = block.provenance.spread.get("depth_mm")
    if sigma is not None:
        axes.fill_between(
            drop, depth - sigma, depth + sigma, color=ORANGE, alpha=0.25, linewidth=0,
            label="± 1 standard deviation",
        )  # fmt: skip
        axes.legend()
    axes.set_xlabel(f"background minus image, {block.channel} [levels]")
    axes.set_ylabel("indentation [mm]")
    return figure


@in_report_style
def draw_perturbed(profile: SensorProfile) -> Figure:
    """The image at rest of a few drawn sensors."""
    image, block = profile.background_rgb, profile.perturbation
    assert image is not None and block is not None
    rng = np.random.default_rng(0)
    draw = draw_perturbation(block, DRAWS, rng)
    images = draw.apply(np.repeat(image[None].astype(np.float32), DRAWS, axis=0), rng)
    ratio = image.shape[0] / image.shape[1]
    figure, axes = new_figure(9.0, 6.0 * ratio + 0.4, 2, 3)
    for panel, drawn in zip(axes.ravel(), images, strict=True):
        panel.imshow(drawn.astype(np.uint8))
        panel.set_axis_off()
    return figure
