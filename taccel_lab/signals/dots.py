# SPDX-License-Identifier: Apache-2.0
"""Dots of the gel in images of a colour model: cut out of the untouched image, and put back where
the gel has taken them.

The background that a colour model changes has the dots where they are at rest. There they are cut
out (``PaintedDots``), the light that each lets through is kept, pixel by pixel, and multiplies the
image where the dot is now, stretched and turned as its face is. An image that has no dots there
keeps its light to within its own noise.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from taccel_lab.camera.gel_camera import View, camera_of
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, TetMesh
from taccel_lab.model.env_rows import chosen_env
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.markers import MarkerLayout, in_gel_frame
from taccel_lab.signals.raster import GridMap, grid_map, pixel_of
from taccel_lab.signals.tactile_image import PressedFace, tactile_image

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile

wp.set_module_options({"enable_backward": False})

BLUR_RADII, BLUR_PX = 0.25, 2.0
"""How far beyond its radius a dot darkens the image: a part of the radius and the lens' blur."""
FILL_PX = 3
"""Neighbourhood that the light without a dot is filled in from."""
_STRETCHED = 1.6
_LEAST_AREA = wp.constant(wp.float64(0.2))
"""Faces that have shrunk to less stand upright or are folded; their dots keep their shape."""


@dataclass(frozen=True)
class PaintedDots:
    """Dots of an untouched sensor's image."""

    clean_rgb: np.ndarray
    """The image without them, levels, float32, shape [height_px, width_px, 3]."""
    shares: np.ndarray
    """Light that each lets through, float32, shape [dot, side, side, 3], 1 beside it."""
    centers_px: np.ndarray
    """Its middle (u, v) in these, shape [dot, 2]."""

    @classmethod
    def cut_out(
        cls, background_rgb: np.ndarray, places_px: np.ndarray, radius_px: float
    ) -> PaintedDots:
        """Dots of an image.

        Args:
            background_rgb: Untouched sensor, levels, shape [height_px, width_px, 3].
            places_px: Columns and rows (u, v) of the dots, shape [dot, 2].
            radius_px: Of all of them.

        Raises:
            InputError: The radius is not above 0.
        """
        import cv2

        if not radius_px > 0:
            raise InputError(f"radius_px of dots must be above 0, got {radius_px}")
        levels = np.asarray(background_rgb, dtype=np.float32)
        places = np.asarray(places_px, dtype=np.float64).reshape(-1, 2)
        reach = (1 + BLUR_RADII) * radius_px + BLUR_PX
        half = int(np.ceil(reach)) + 1
        nearest = np.rint(places).astype(int)
        step = np.arange(-half, half + 1)
        v = np.broadcast_to(
            nearest[:, 1, None, None] + step[:, None], (len(places), *[len(step)] * 2)
        )
        u = np.broadcast_to(nearest[:, 0, None, None] + step, v.shape)
        near = np.hypot(u - places[:, 0, None, None], v - places[:, 1, None, None]) <= reach
        height, width = levels.shape[:2]
        near &= (u >= 0) & (u < width) & (v >= 0) & (v < height)
        hole = np.zeros((height, width), dtype=np.uint8)
        hole[v[near], u[near]] = 1
        # Telea's method takes bytes; channels apart keep halves of levels out of reach of rounding.
        filled = cv2.inpaint(np.rint(levels).astype(np.uint8), hole, FILL_PX, cv2.INPAINT_TELEA)
        clean = np.where(hole[..., None] > 0, np.maximum(filled, 1).astype(np.float32), levels)
        shares = np.ones((len(places), len(step), len(step), 3), dtype=np.float32)
        shares[near] = (levels / np.maximum(clean, 1.0))[v[near], u[near]]
        return cls(clean, shares, places - nearest + half)


def radius_px(radius_mm: float, grid: PixelGrid) -> float:
    """Radius of dots in an image, whose pixels need not be square."""
    return radius_mm / float(np.sqrt(grid.mm_per_px_x * grid.mm_per_px_y))


@wp.func
def _light(
    shares: wp.array4d(dtype=wp.float32), dot: int, x: wp.float64, y: wp.float64
) -> wp.vec3f:
    """Bilinear between the pixels of a dot, 1 beside them."""
    side = shares.shape[1]
    i = int(wp.floor(x))
    j = int(wp.floor(y))
    found = wp.vec3f(1.0, 1.0, 1.0)
    if i < 0 or j < 0 or i + 1 >= side or j + 1 >= side:
        return found
    s = float(x - wp.float64(i))
    t = float(y - wp.float64(j))
    for c in range(3):
        # Exactly 1 between ones.
        upper = shares[dot, j, i, c]
        upper += s * (shares[dot, j, i + 1, c] - upper)
        lower = shares[dot, j + 1, i, c]
        lower += s * (shares[dot, j + 1, i + 1, c] - lower)
        found[c] = upper + t * (lower - upper)
    return found


@wp.kernel
def _paint_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    frames: wp.array(dtype=wp.transformd),
    envs: wp.array(dtype=wp.int32),
    nodes: wp.array3d(dtype=wp.int32),
    weights: wp.array2d(dtype=wp.vec3d),
    at_rest: wp.array2d(dtype=wp.mat22d),
    shares: wp.array4d(dtype=wp.float32),
    centers: wp.array(dtype=wp.vec2d),
    reach: int,
    grid: GridMap,
    # In and out; those that are None are left out
    image: wp.array4d(dtype=wp.uint8),
    levels: wp.array4d(dtype=wp.float32),
    height_px: int,
    width_px: int,
):
    row, dot, j, i = wp.tid()
    env = chosen_env(envs, row)
    gel = env % nodes.shape[0]
    a = pixel_of(grid, in_gel_frame(frames, env, positions[env, nodes[gel, dot, 0]]))
    b = pixel_of(grid, in_gel_frame(frames, env, positions[env, nodes[gel, dot, 1]]))
    c = pixel_of(grid, in_gel_frame(frames, env, positions[env, nodes[gel, dot, 2]]))
    w = weights[gel, dot]
    middle = w[0] * a + w[1] * b + w[2] * c
    u = int(wp.round(middle[0])) - reach + i
    v = int(wp.round(middle[1])) - reach + j
    if u < 0 or v < 0 or u >= width_px or v >= height_px:
        return
    ab = b - a
    ac = c - a
    stretch = wp.mat22d(ab[0], ac[0], ab[1], ac[1]) * at_rest[gel, dot]
    offset = wp.vec2d(wp.float64(u), wp.float64(v)) - middle
    if wp.determinant(stretch) > _LEAST_AREA:
        offset = wp.inverse(stretch) * offset
    place = centers[dot] + offset
    share = _light(shares, dot, place[0], place[1])
    if share[0] == 1.0 and share[1] == 1.0 and share[2] == 1.0:
        # Corners of squares lie in those of other dots, which are painted at the same time.
        return
    for k in range(3):
        if image:
            shown = wp.round(float(image[row, v, u, k]) * share[k])
            image[row, v, u, k] = wp.uint8(wp.clamp(shown, 0.0, 255.0))
        if levels:
            levels[row, v, u, k] = levels[row, v, u, k] * share[k]


class DotPainter:
    """Puts dots into images of many environments."""

    def __init__(
        self,
        dots: PaintedDots,
        layout: MarkerLayout,
        mesh: TetMesh | QuadraticMesh,
        grid: PixelGrid,
        *,
        rest_positions_m: np.ndarray | None = None,
        first_node: int = 0,
        device: Any = "cpu",
    ) -> None:
        """
        Args:
            dots: Cut out of the image of the undeformed gel.
            layout: Where they are painted, as many and in the same order.
            mesh: Gel pad at rest.
            grid: Pixels of the image.
            rest_positions_m: As the layout was made with.
            first_node: Of this gel in the arrays of positions.
            device: Warp device.

        Raises:
            InputError: Other dots than those of the layout, or other rest shapes.
        """
        if len(dots.shares) != layout.count:
            raise InputError(f"{len(dots.shares)} dots for {layout.count} markers")
        nodes, weights = layout.by_rest()
        rest = mesh.nodes_m[None] if rest_positions_m is None else rest_positions_m
        if len(nodes) not in (1, len(rest)):
            raise InputError(f"markers of {len(nodes)} shapes of the gel, of which {len(rest)} are")
        corners = np.stack([at[of] for at, of in zip(rest, nodes, strict=False)])
        corners = grid.pixel_from_gel(1e3 * corners[..., :2])
        sides = corners[..., 1:, :] - corners[..., :1, :]
        self._grid, self._size = grid_map(grid), (grid.height_px, grid.width_px)
        self._reach = int(np.ceil(_STRETCHED * dots.shares.shape[1] / 2))
        self._arrays = [
            wp.array(nodes + first_node, dtype=wp.int32, device=device),
            wp.array(weights, dtype=wp.vec3d, device=device),
            wp.array(np.linalg.inv(np.swapaxes(sides, -1, -2)), dtype=wp.mat22d, device=device),
            wp.array(dots.shares, dtype=wp.float32, device=device),
            wp.array(dots.centers_px, dtype=wp.vec2d, device=device),
        ]

    def paint(
        self,
        positions: wp.array,
        frames: wp.array,
        envs: wp.array,
        image: wp.array | None = None,
        levels: wp.array | None = None,
    ) -> None:
        """Darken images of the clean background where the dots are now.

        Args:
            positions: Of nodes [m], vec3d, [env_count, node_count].
            frames: world_from_gel, transformd, [env_count], or of length 0 for none.
            envs: Environments of the rows, int32; of length 0 for all.
            image: RGB, uint8, [row, height_px, width_px, 3]; in place.
            levels: The same, float32.
        """
        shown = image if image is not None else levels
        assert shown is not None
        side = 2 * self._reach + 1
        wp.launch(
            _paint_kernel,
            dim=(shown.shape[0], self._arrays[1].shape[1], side, side),
            inputs=[positions, frames, envs, *self._arrays, self._reach, self._grid],
            outputs=[image, levels, *self._size],
            device=shown.device,
        )

    def painted(self, levels: np.ndarray, positions_m: np.ndarray) -> np.ndarray:
        """One image on the host, float32, [height_px, width_px, 3], of nodes at ``positions_m``
        [m], [node, 3], in the gel's frame."""
        found = wp.array(levels[None], dtype=wp.float32, device="cpu")
        positions = wp.array(positions_m[None], dtype=wp.vec3d, device="cpu")
        nothing = wp.empty(0, dtype=wp.int32, device="cpu")
        self.paint(positions, wp.empty(0, dtype=wp.transformd, device="cpu"), nothing, levels=found)
        return found.numpy()[0]


def profile_options(
    profile: SensorProfile,
    mesh: TetMesh | QuadraticMesh,
    own: Mapping[str, Any] | None = None,
    rest_positions_m: np.ndarray | None = None,
) -> dict[str, Any]:
    """Arguments of ``SignalTactile``: ``color_model`` and ``background_rgb`` where the profile has
    both, ``markers`` where it has dots: those that the camera sees and that lie on ``mesh``; and
    ``dots``, cut out of the background, where it has all of them. What is given in ``own`` goes
    first; dots are then its own as well. ``rest_positions_m``: nodes at rest [rest_count, node, 3],
    where they are not those of ``mesh``."""
    own = own or {}
    found: dict[str, Any] = {}
    model, grid = ColorModel.from_profile(profile), profile.grid()
    view = profile_view(profile, own)
    if model is not None and profile.background_rgb is not None:
        found |= {"color_model": model, "background_rgb": profile.background_rgb}
    if profile.markers is not None:
        points = profile.markers.grid().points_mm()
        found["markers"], seen = MarkerLayout.seen_on(
            mesh, points, view, rest_positions_m, profile.mesh
        )
        if "background_rgb" in found and own.keys().isdisjoint(found):
            dots = PaintedDots.cut_out(
                found["background_rgb"],
                grid.pixel_from_gel(points[seen]),
                radius_px(profile.markers.radius_mm, grid),
            )
            found |= {"dots": dots, "background_rgb": dots.clean_rgb}
    return found | dict(own)


def profile_view(profile: SensorProfile, own: Mapping[str, Any]) -> View:
    """What the pixels of a profile's signals see: its camera, or, with colours of one's own, which
    are of its pixel grid, that."""
    return profile.grid() if "color_model" in own else camera_of(profile)


def image_painter(
    profile: SensorProfile, mesh: TetMesh | QuadraticMesh
) -> Callable[[PressedFace, np.ndarray], np.ndarray] | None:
    """What makes images of a pressed gel in the colours of a profile, with its dots; None where the
    profile has no colour model or no background.

    It takes the face on the profile's pixels and the positions of the nodes of ``mesh`` [m],
    [node, 3], in the gel's frame, and gives levels, float32, [height_px, width_px, 3].
    """
    options = profile_options(profile, mesh)
    if "color_model" not in options:
        return None
    model, background = options["color_model"], options["background_rgb"]
    painter = None
    if "dots" in options:
        painter = DotPainter(options["dots"], options["markers"], mesh, profile.grid())

    def image(face: PressedFace, positions_m: np.ndarray) -> np.ndarray:
        levels = tactile_image(model, background, face)
        return levels if painter is None else painter.painted(levels, positions_m)

    return image
