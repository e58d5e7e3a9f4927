# SPDX-License-Identifier: Apache-2.0
"""Do the blocks of a profile agree? Each alone may have figures that together no sensor has.

A wrong unit or sign in one block shows against another: the image against the gel that it shows,
the camera against the image's grid, lights against the gel that they shine on, a mesh against the
thickness of its gel.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.profile.bounds import Bound
from taccel_lab.profile.optical_design import DesignedCamera, Light
from taccel_lab.profile.optional_blocks import (
    CoatingBlock,
    DepthResponseBlock,
    ForceBlock,
    LightsBlock,
    MarkersBlock,
    OpticsBlock,
    PerturbationBlock,
)
from taccel_lab.profile.schema import CameraBlock, GelBlock, MaterialBlock

_MOST_IMAGE = 8.0
"""Times the gel: 1.5 is the most of the catalogue, but pictures of a webcam may be uncropped."""
_OFF_IMAGE, _OFF_MM = 0.5, 1.0
"""Share of the image, or mounting, by which optics and grid may differ: one of two cameras that
look aslant at an eye's distance does by 0.44, others by 0.03."""
_SCALES = Bound(0.2, 5.0, "", "the same camera has one scale, but for windows and curved gels")
_STIFFNESS = Bound(0.02, 50, "", "forces of a far softer or harder gel are no touches of this one")
_PIVOT_LEVELS = 64.0
"""Lights drift by less than a quarter of the range."""
_VIEW = (0.25, 0.75)
"""Middle of the image, where no sensor has a lamp before its lens."""
_GLOW_NODES = 200
_SLACK = 0.1
"""Largest difference over the thickness. Chords of a coarse mesh miss a curved face by some per
cent, a wrong unit by a factor of 25 or more."""
MAX_EXTENT_MM = 1000.0
"""Largest extent of a gel along an axis; the largest that the catalogue's bounds allow has 160."""
_SLIPS = {
    1e3: "its coordinates look like millimetres, where metres belong",
    1e6: "its coordinates look like micrometres, where metres belong",
    1 / 25.4e-3: "its coordinates look like inches, where metres belong",
    1e-3: "its coordinates look like metres that were taken for millimetres",
    1e-6: "its coordinates look like metres that were taken for micrometres",
}
"""Times too large -> what went wrong."""


class Blocks(Protocol):
    """What a ``SensorProfile`` holds, as far as it is compared."""

    @property
    def gel(self) -> GelBlock: ...
    @property
    def mesh(self) -> TetMesh: ...
    @property
    def material(self) -> MaterialBlock: ...
    @property
    def camera(self) -> CameraBlock: ...
    @property
    def optics(self) -> OpticsBlock | None: ...
    @property
    def coating(self) -> CoatingBlock | None: ...
    @property
    def lights(self) -> LightsBlock | None: ...
    @property
    def markers(self) -> MarkersBlock | None: ...
    @property
    def background_rgb(self) -> np.ndarray | None: ...
    @property
    def depth_response(self) -> DepthResponseBlock | None: ...
    @property
    def perturbation(self) -> PerturbationBlock | None: ...
    @property
    def force(self) -> ForceBlock | None: ...


def disagreements(profile: Blocks) -> Iterator[str]:
    """A line for each relation of two blocks that no sensor has."""
    xy_mm = 1e3 * profile.mesh.nodes_m[:, :2]
    low, high = xy_mm.min(axis=0), xy_mm.max(axis=0)
    yield from _image(profile, low, high)
    yield from _optics(profile)
    yield from _lights(profile)
    yield from _responses(profile)
    if profile.markers is not None:
        dots, radius = profile.markers.grid().points_mm(), profile.markers.radius_mm
        if not ((low - radius <= dots) & (dots <= high + radius)).all(axis=1).any():
            yield (
                f"markers: no dot lies on the gel, from {_pair(low)} to {_pair(high)} mm: correct "
                "offset_mm, the pitch or the turn"
            )


def _image(profile: Blocks, low: np.ndarray, high: np.ndarray) -> Iterator[str]:
    """The image shows the gel, and not much else."""
    grid = profile.camera.grid()
    for k, (axis, places) in enumerate((("x", grid.x_mm()), ("y", grid.y_mm()))):
        middle, span = float(places[0] + places[-1]) / 2, float(abs(places[-1] - places[0]))
        if not low[k] <= middle <= high[k]:
            yield (
                f"camera: the image's middle lies at {axis} = {middle:.4g} mm, the gel from "
                f"{low[k]:.4g} to {high[k]:.4g} mm: correct center_u_px, center_v_px or the scale"
            )
        most = _MOST_IMAGE * float(high[k] - low[k])
        if not span <= most:
            yield (
                f"camera.mm_per_px_{axis}: the image is {span:.4g} mm long along {axis}, the gel "
                f"{high[k] - low[k]:.4g} mm; at most {most:.4g} mm are allowed"
            )


def _optics(profile: Blocks) -> Iterator[str]:
    """The physical camera has the scale of the image's grid at the gel's apex, and its place."""
    optics, grid = profile.optics, profile.camera.grid()
    if optics is None or profile.camera.rectified:
        return
    if (optics.width_px, optics.height_px) != (grid.width_px, grid.height_px):
        return
    way = -np.array(optics.position_mm) @ optics.camera().gel_from_camera()
    if way[2] <= 0:
        yield "optics.rotation: the camera looks away from the gel"
        return
    for k, axis in enumerate("xy"):
        focal, middle = ((optics.fx_px, optics.cx_px), (optics.fy_px, optics.cy_px))[k]
        scale, center, count = (
            (grid.mm_per_px_x, grid.center_u_px, grid.width_px),
            (grid.mm_per_px_y, grid.center_v_px, grid.height_px),
        )[k]
        seen_mm = float(way[2] / focal)
        if not _SCALES.allows(seen_mm / scale):
            yield (
                f"optics.f{axis}_px: at the gel a pixel is {seen_mm:.4g} mm wide, "
                f"camera.mm_per_px_{axis} says {scale:.4g}; their ratio {_SCALES}"
            )
        if profile.camera.provenance.kind in ("measured", "calibrated"):
            continue  # Its images may be cut elsewhere; cameras then look straight down.
        off_px = float(focal * way[k] / way[2] + middle - center)
        most_px = max(_OFF_IMAGE * count, _OFF_MM / seen_mm)
        if not abs(off_px) <= most_px:
            uv = "uv"[k]
            yield (
                f"optics: the camera sees the gel's origin {off_px:.4g} px from "
                f"camera.center_{uv}_px = {center:.4g}; at most {most_px:.4g} px are allowed: "
                f"correct position_mm, rotation, c{axis}_px or center_{uv}_px"
            )


def _lights(profile: Blocks) -> Iterator[str]:
    """Every light shines on some of the gel, and none stands in the middle of the view."""
    if profile.lights is None:
        return
    nodes = profile.mesh.region_nodes(Region.CONTACT)
    touched_mm = 1e3 * profile.mesh.nodes_m[nodes[:: max(1, len(nodes) // _GLOW_NODES)]]
    camera = None if profile.optics is None else profile.optics.camera()
    for number, light in enumerate(profile.lights.lights()):
        pieces = light.straight_pieces()
        if not any(
            ((touched_mm - piece.position_mm) @ np.array(piece.direction) > 0).any()
            for piece in pieces
        ):
            yield (
                f"lights.led.{number}: shines away from all of the gel: correct position_mm or "
                "direction"
            )
        if camera is not None and any(_in_view(camera, piece) for piece in pieces):
            yield (
                f"lights.led.{number}.position_mm: stands between camera and gel in the middle of "
                f"the image, got {list(light.position_mm)}"
            )


def _in_view(camera: DesignedCamera, light: Light) -> bool:
    way = np.subtract(light.position_mm, camera.position_mm) @ camera.gel_from_camera()
    if way[2] <= 0:
        return False
    u = (camera.fx_px * way[0] / way[2] + camera.cx_px) / camera.width_px
    v = (camera.fy_px * way[1] / way[2] + camera.cy_px) / camera.height_px
    return bool(_VIEW[0] < u < _VIEW[1] and _VIEW[0] < v < _VIEW[1])


def _responses(profile: Blocks) -> Iterator[str]:
    """What a touch does fits the gel and the image."""
    thickness = profile.gel.thickness_mm
    if profile.coating is not None and not profile.coating.thickness_mm <= thickness:
        yield (
            f"coating.thickness_mm: at most the gel's {thickness:g} mm, got "
            f"{profile.coating.thickness_mm:g}"
        )
    curve = profile.depth_response
    if curve is not None:
        rules = [("depth_mm", max(curve.depth_mm), 2 * thickness, "twice the gel's thickness")]
        for name in ("reading_sigma_mm", "zero_sigma_mm"):
            sigma = getattr(curve, name)
            if sigma is not None:
                rules.append((name, sigma, max(curve.depth_mm), "the deepest touch"))
        for name, value, most, what in rules:
            if not value <= most:
                yield f"depth_response.{name}: at most {most:g} mm, {what}, got {value:g}"
    if profile.force is not None:
        trained, own = profile.force.architecture["young_modulus_pa"], profile.material
        ratio = own.young_modulus_pa / float(trained)  # type: ignore[arg-type]
        if not _STIFFNESS.allows(ratio):
            yield (
                f"force.architecture.young_modulus_pa: material.young_modulus_pa = "
                f"{own.young_modulus_pa:g} over it {_STIFFNESS}, got {ratio:.4g}: {_STIFFNESS.why}"
            )
    spread, grid = profile.perturbation, profile.camera.grid()
    if spread is None:
        return
    most_px = max(grid.width_px, grid.height_px) / 2
    if not spread.center_px <= most_px:
        yield (
            f"perturbation.center_px: at most {most_px:g} px, half the image, got "
            f"{spread.center_px:g}"
        )
    if profile.background_rgb is not None and any(spread.gain_rgb):
        means = profile.background_rgb.mean(axis=(0, 1))
        for pivot, mean in zip(spread.pivot_rgb, means.tolist(), strict=True):
            if not abs(pivot - mean) <= _PIVOT_LEVELS:
                yield (
                    f"perturbation.pivot_rgb: within {_PIVOT_LEVELS:g} levels of the background's "
                    f"mean, {mean:.4g}, got {pivot:g}"
                )


def _pair(place: np.ndarray) -> str:
    return f"({place[0]:.4g}, {place[1]:.4g})"


def check_mesh_size(mesh: TetMesh, thickness_mm: float) -> None:
    """Refuse a mesh without touched or glued faces, or of another size than the gel's block.

    The thickness is that of the gel under the apex, so it lies between the depth of the highest
    glued point and that of the lowest point of all: the same in a pad with a flat back, while a
    dome's glued wall or its skirt may reach farther up or down.
    """
    z_mm = mesh.nodes_m[:, 2] * 1e3
    contact, glued = mesh.region_nodes(Region.CONTACT), mesh.bonded_nodes()
    for nodes, name in ((contact, "contact"), (glued, "bond or window")):
        if not len(nodes):
            raise InputError(f"the mesh has no {name} faces; a gel needs some")
    apex = z_mm[contact].max()
    least, most = float(apex - z_mm[glued].max()), float(apex - z_mm.min())
    if _is_thick(least, most, thickness_mm):
        extent = float(1e3 * (mesh.nodes_m.max(axis=0) - mesh.nodes_m.min(axis=0)).max())
        if extent > MAX_EXTENT_MM:
            raise InputError(
                f"the mesh is {extent:g} mm large; up to {MAX_EXTENT_MM:g} mm are allowed"
            )
        return
    found = f"{most:.4g} mm" if most - least < _SLACK * most else f"{least:.4g} to {most:.4g} mm"
    why = "".join(
        f". It is {max(factor, 1 / factor):,.0f} times too {'large' if factor > 1 else 'small'}: "
        f"{words}"
        for factor, words in _SLIPS.items()
        if _is_thick(least / factor, most / factor, thickness_mm)
    )
    raise InputError(
        f"the mesh has {found} of gel under its apex, gel.thickness_mm says {thickness_mm:g} mm; "
        f"they must agree within {_SLACK:.0%}{why}"
    )


def _is_thick(least: float, most: float, thickness: float) -> bool:
    return bool(least <= thickness * (1 + _SLACK) and thickness <= most * (1 + _SLACK))
