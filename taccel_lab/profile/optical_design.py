# SPDX-License-Identifier: Apache-2.0
"""The optics of a sensor as plain, checked data: camera, lights, coating, window, markers.

Lengths in millimetres in the gel frame (x right and y down in the image, z out of the gel, origin
at the apex of the contact face): the camera sits at negative z and looks along +z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.profile.bounds import Bound, require_finite, require_within

Triple = tuple[float, float, float]
_PIECE_DEG = 45.0
Quaternion = tuple[float, float, float, float]
"""x, y, z, w."""


@dataclass(frozen=True)
class DesignedCamera:
    """A physical camera: intrinsics, distortion, pose and what decides its depth of field."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    """Column of the principal point; pixel centres are whole numbers."""
    cy_px: float
    position_mm: Triple
    """Centre of projection in the gel frame."""
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    """gel_from_camera, quaternion x, y, z, w; the camera looks along its +z, x right, y down."""
    model: Literal["pinhole", "fisheye"] = "pinhole"
    """pinhole: OpenCV's rational model; fisheye: OpenCV's (Kannala and Brandt) model."""
    distortion: tuple[float, ...] = ()
    """OpenCV's order: pinhole k1 k2 p1 p2 [k3 [k4 k5 k6]], fisheye k1 k2 k3 k4; () for none."""
    focus_mm: float = 0.0
    """Distance of sharp focus along the optical axis; 0 when unknown."""
    aperture_mm: float = 0.0
    """Diameter of the entrance pupil; 0 when unknown, a pinhole."""
    falloff: float = 4.0
    """Exponent of cos^n by which a pinhole camera's image darkens off the axis: 4 for a simple
    lens, 0 for an image whose shading is corrected."""

    def __post_init__(self) -> None:
        require_within("optics", self, "camera")
        require_finite("camera cx_px, cy_px", (self.cx_px, self.cy_px))
        require_finite("camera position_mm", self.position_mm, 3)
        require_finite("camera rotation", self.rotation, 4)
        if abs(math.hypot(*self.rotation) - 1) > 1e-6:
            raise InputError(f"camera rotation must be a unit quaternion, got {self.rotation}")
        allowed = {"pinhole": (0, 4, 5, 8), "fisheye": (0, 4)}
        if self.model not in allowed:
            raise InputError(f"camera model must be pinhole or fisheye, got {self.model!r}")
        if len(self.distortion) not in allowed[self.model]:
            raise InputError(
                f"a {self.model} camera takes {allowed[self.model]} distortion coefficients, got "
                f"{len(self.distortion)}"
            )
        require_finite("camera distortion", self.distortion)

    def size_within(self, longest_px: int, *, enlarged: bool = False) -> tuple[int, int]:
        """Width and height of a picture whose longer side has that many pixels, or the camera's
        own if that is smaller and the picture must not be ``enlarged``."""
        scale = longest_px / max(self.width_px, self.height_px)
        if not enlarged:
            scale = min(1.0, scale)
        return max(2, round(self.width_px * scale)), max(2, round(self.height_px * scale))

    def gel_from_camera(self) -> np.ndarray:
        """Rotation matrix that turns directions of the camera into the gel frame, [3, 3]."""
        return rotation_matrix(self.rotation)


def rotation_matrix(quaternion: Quaternion) -> np.ndarray:
    """The matrix, [3, 3], of a unit quaternion."""
    x, y, z, w = quaternion
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


@dataclass(frozen=True)
class Light:
    """A rectangular LED (a point when its size is zero) or exit of a light guide, with a cos^n
    lobe."""

    position_mm: Triple
    direction: Triple
    """Axis of emission, unit length."""
    rgb: Triple
    """Radiant power by colour channel of the camera, relative to the other lights."""
    size_mm: tuple[float, float] = (0.0, 0.0)
    """Width and height of the emitting face; its width lies as near to the xy plane as can be."""
    lobe: float = 1.0
    """Exponent n of the lobe cos^n; 1 is a Lambertian emitter."""
    name: str = ""
    arc_deg: float = 0.0
    """Angle about the gel's z axis over which the exit of a bent light guide reaches, with its
    middle at ``position_mm``: it has that in place of a width. 0 of a straight face."""

    def __post_init__(self) -> None:
        require_finite("light position_mm", self.position_mm, 3)
        require_finite("light direction", self.direction, 3)
        if abs(math.hypot(*self.direction) - 1) > 1e-6:
            raise InputError(f"light direction must have unit length, got {self.direction}")
        require_finite("light arc_deg", (self.arc_deg,))
        if not 0 <= self.arc_deg <= 360:
            raise InputError(f"light arc_deg must lie in [0, 360], got {self.arc_deg:g}")
        if self.arc_deg and (self.size_mm[0] or not math.hypot(*self.position_mm[:2])):
            raise InputError(
                "a light with arc_deg lies beside the gel's z axis, and its size_mm is 0 wide, got "
                f"{self.size_mm} at {self.position_mm}"
            )
        require_finite("light rgb", self.rgb, 3)
        if min(self.rgb) < 0 or max(self.rgb) <= 0:
            raise InputError(f"light rgb must be >= 0 with at least one above, got {self.rgb}")
        require_within("light", self)

    def straight_pieces(self) -> tuple[Light, ...]:
        """The light itself, or straight ones that stand for a bent exit, for who knows no arcs."""
        if not self.arc_deg:
            return (self,)
        count = math.ceil(self.arc_deg / _PIECE_DEG)
        part = math.radians(self.arc_deg / count)
        width = part * math.hypot(*self.position_mm[:2])
        red, green, blue = (power / count for power in self.rgb)
        return tuple(
            replace(
                self,
                position_mm=_turned(self.position_mm, (k + 0.5 - count / 2) * part),
                direction=_turned(self.direction, (k + 0.5 - count / 2) * part),
                rgb=(red, green, blue),
                size_mm=(width, self.size_mm[1]),
                arc_deg=0.0,
                name=f"{self.name} {k}",
            )
            for k in range(count)
        )


def _turned(vector: Triple, angle: float) -> Triple:
    """Turned about z, from x towards y."""
    x, y, z = vector
    c, s = math.cos(angle), math.sin(angle)
    return c * x - s * y, s * x + c * y, z


@dataclass(frozen=True)
class Coating:
    """The reflective skin under the contact face: a Lambertian part and a glossy lobe."""

    albedo_rgb: Triple = (0.5, 0.5, 0.5)
    """Diffuse reflectance by channel, 0..1."""
    specular: float = 0.0
    """Weight of the glossy lobe, 0..1."""
    roughness: float = 0.5
    """Width of the glossy lobe (GGX alpha), 0.02..1."""
    thickness_mm: float = 0.0

    def __post_init__(self) -> None:
        require_finite("coating albedo_rgb", self.albedo_rgb, 3)
        require_within("coating", self)


@dataclass(frozen=True)
class Window:
    """The rigid transparent part behind the gel: a plate, or a dome shell of given radius."""

    thickness_mm: float
    size_mm: tuple[float, float]
    """Extents along x and y."""
    refractive_index: float = 1.49
    shape: Literal["plate", "dome"] = "plate"
    outer_radius_mm: float = 0.0
    """Radius of the face of a dome that the gel is glued to."""

    def __post_init__(self) -> None:
        require_within("window", self)
        if self.shape not in ("plate", "dome"):
            raise InputError(f"window shape must be plate or dome, got {self.shape!r}")
        if self.shape == "plate" and self.outer_radius_mm:
            raise InputError(f"a plate has no outer_radius_mm, got {self.outer_radius_mm:g}")
        if self.shape == "dome" and not self.thickness_mm < self.outer_radius_mm <= 200:
            raise InputError(
                f"a dome window needs an outer_radius_mm above its thickness "
                f"{self.thickness_mm:g} mm and up to 200 mm, got {self.outer_radius_mm:g}"
            )


def lattice_steps(row: np.ndarray, column: np.ndarray, stagger: float) -> np.ndarray:
    """Pitches along and across the rows from the first dot of a lattice whose odd rows are shifted
    by ``stagger`` pitches, shape [.., 2]."""
    row, column = np.asarray(row), np.asarray(column)
    return np.stack([column + stagger * (row % 2), row.astype(np.float64)], axis=-1)


def lattice_middle(rows: int, columns: int, stagger: float) -> np.ndarray:
    """Pitches from the first dot to the mean of all dots, shape [2]."""
    return np.array([(columns - 1) / 2 + stagger * (rows // 2) / rows, (rows - 1) / 2])


@dataclass(frozen=True)
class MarkerGrid:
    """Dots painted on the contact face in a regular grid centred on the image."""

    rows: int
    columns: int
    pitch_x_mm: float
    """Distance of neighbours along a row."""
    pitch_y_mm: float
    """Distance of the rows."""
    radius_mm: float
    offset_mm: tuple[float, float] = (0.0, 0.0)
    """Middle of the grid, missing dots included, in gel xy."""
    rotation_deg: float = 0.0
    """Turn of the rows about that middle, from gel x towards y."""
    stagger: float = 0.0
    """Shift of every second row along itself, in pitches: 0.5 or -0.5 in a hexagonal grid."""
    missing: tuple[tuple[int, int], ...] = ()
    """Row and column, from 0, of places without a dot."""

    def __post_init__(self) -> None:
        require_finite("marker offset_mm", self.offset_mm, 2)
        require_within("markers", self)
        size = Bound(0.01, min(self.pitch_x_mm, self.pitch_y_mm) / 2, "mm", "dots do not touch")
        for fault in size.faults("markers.radius_mm", self.radius_mm):
            raise InputError(fault)
        for row, column in self.missing:
            if not (0 <= row < self.rows and 0 <= column < self.columns):
                raise InputError(
                    f"the missing marker ({row}, {column}) is not in the grid of {self.rows} rows "
                    f"and {self.columns} columns"
                )

    def present(self) -> np.ndarray:
        """Places that hold a dot, bool, shape [rows, columns]."""
        there = np.ones((self.rows, self.columns), dtype=bool)
        for row, column in self.missing:
            there[row, column] = False
        return there

    def points_mm(self) -> np.ndarray:
        """Gel xy of the dots [mm], row by row without the missing ones, shape [dot, 2]."""
        return self.places_mm()[self.present().ravel()]

    def places_mm(self) -> np.ndarray:
        """Gel xy of all places of the grid [mm], row by row, shape [rows * columns, 2]."""
        row, column = np.mgrid[: self.rows, : self.columns].reshape(2, -1)
        steps = lattice_steps(row, column, self.stagger)
        steps = steps - lattice_middle(self.rows, self.columns, self.stagger)
        along_rows = steps * (self.pitch_x_mm, self.pitch_y_mm)
        return along_rows @ self.gel_from_grid().T + np.array(self.offset_mm)

    def gel_from_grid(self) -> np.ndarray:
        """Rotation from the directions along and across the rows to gel xy, shape [2, 2]."""
        turn = math.radians(self.rotation_deg)
        c, s = math.cos(turn), math.sin(turn)
        return np.array([[c, -s], [s, c]])


@dataclass(frozen=True)
class OpticalDesign:
    """Everything that decides what the camera sees of the gel."""

    camera: DesignedCamera
    lights: tuple[Light, ...]
    coating: Coating = Coating()
    window: Window | None = None
    """None when nothing rigid and transparent stands between camera and gel."""
    gel_refractive_index: float = 1.41
    ambient_rgb: Triple = (0.0, 0.0, 0.0)
    """Light that reaches every point of the coating alike (many times reflected in the housing), by
    channel, as a share of the mean direct light on the visible gel at rest."""
    gel_scattering_per_mm: float = 0.0
    """Scattering coefficient of a turbid gel (Kubelka and Munk's S); 0 for a clear one."""

    def __post_init__(self) -> None:
        if not self.lights:
            raise InputError("an optical design needs at least one light")
        require_finite("ambient_rgb", self.ambient_rgb, 3)
        require_within("optics", self, "optics")
