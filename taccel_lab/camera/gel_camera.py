# SPDX-License-Identifier: Apache-2.0
"""The one camera of a sensor: all that has pixels, pictures and markers alike, looks through it.

A real camera sees the gel in perspective, through its lens, the window and the gel, so that a
press moves what it shows away from the optical axis. A profile with optics therefore has a
``GelCamera``. Colours are fitted pixel by pixel on the orthographic pixel grid, where a photo's
place counts as the place on the gel: they mean pixels of that grid, and a profile whose pictures
they draw keeps it in all channels, as does one without optics.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.camera.refraction import DomeMedia, FlatMedia, Media, glued_back_mm, media_between
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.geometry.lens import (
    distort_pinhole,
    fisheye_limit,
    fisheye_radius,
    invert_fisheye,
    undistort_pinhole,
)
from taccel_lab.profile.optical_design import DesignedCamera, Light, OpticalDesign

if TYPE_CHECKING:
    from taccel_lab.profile import OpticsBlock, SensorProfile


class CameraModel:
    """Projects points of the gel frame through one camera, and back to rays."""

    def __init__(self, camera: DesignedCamera) -> None:
        self.camera = camera
        self.gel_from_camera = camera.gel_from_camera()
        """Rotation, shape [3, 3]."""
        self.position_mm = np.array(camera.position_mm, dtype=np.float64)
        count = 4 if camera.model == "fisheye" else 8
        self._coefficients = np.zeros(count)
        self._coefficients[: len(camera.distortion)] = camera.distortion

    def project(self, points_mm: np.ndarray) -> np.ndarray:
        """Pixels (u, v) of points in air, [..., 3] -> [..., 2]; NaN where the lens sees nothing."""
        in_camera = (np.asarray(points_mm, dtype=np.float64) - self.position_mm) @ (
            self.gel_from_camera
        )
        return self.pixels_from_directions(in_camera)

    def pixels_from_directions(self, directions: np.ndarray) -> np.ndarray:
        """Pixels of directions in the camera's own frame, any length, [..., 3] -> [..., 2]."""
        directions = np.asarray(directions, dtype=np.float64)
        if self.camera.model == "fisheye":
            image = self._distort_fisheye(directions)
        else:
            z = directions[..., 2]
            with np.errstate(divide="ignore", invalid="ignore"):
                plane = directions[..., :2] / np.where(z > 0, z, np.nan)[..., None]
            image = distort_pinhole(plane, self._coefficients)
        c = self.camera
        return image * np.array([c.fx_px, c.fy_px]) + np.array([c.cx_px, c.cy_px])

    def directions_from_pixels(self, uv_px: np.ndarray) -> np.ndarray:
        """Unit directions in the camera's own frame, [..., 2] -> [..., 3]; NaN beyond the lens."""
        c = self.camera
        uv = np.asarray(uv_px, dtype=np.float64)
        image = (uv - np.array([c.cx_px, c.cy_px])) / np.array([c.fx_px, c.fy_px])
        if c.model == "fisheye":
            return self._undistort_fisheye(image)
        plane = undistort_pinhole(image, self._coefficients)
        rays = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    def rays(self, uv_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rays that leave the camera through pixels, in the gel frame.

        Args:
            uv_px: Pixels, shape [..., 2].

        Returns:
            Centre of projection [mm], shape [3], and unit directions, shape [..., 3].
        """
        return self.position_mm, self.directions_from_pixels(uv_px) @ self.gel_from_camera.T

    def _distort_fisheye(self, directions: np.ndarray) -> np.ndarray:
        radius = np.hypot(directions[..., 0], directions[..., 1])
        theta = np.arctan2(radius, directions[..., 2])
        bent = np.where(
            theta <= fisheye_limit(self._coefficients),
            fisheye_radius(theta, self._coefficients),
            np.nan,
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(radius > 0, bent / radius, 0.0 * bent)
        return directions[..., :2] * scale[..., None]

    def _undistort_fisheye(self, image: np.ndarray) -> np.ndarray:
        bent = np.linalg.norm(image, axis=-1)
        theta = invert_fisheye(bent, self._coefficients)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(bent > 0, np.sin(theta) / bent, 1.0)
        return np.concatenate([image * scale[..., None], np.cos(theta)[..., None]], axis=-1)


def resized(camera: DesignedCamera, width_px: int, height_px: int) -> DesignedCamera:
    """The same camera with its image scaled to another size; pixel centres are whole numbers."""
    sx, sy = width_px / camera.width_px, height_px / camera.height_px
    return replace(
        camera,
        width_px=width_px,
        height_px=height_px,
        fx_px=camera.fx_px * sx,
        fy_px=camera.fy_px * sy,
        cx_px=(camera.cx_px + 0.5) * sx - 0.5,
        cy_px=(camera.cy_px + 0.5) * sy - 0.5,
    )


_MEASURED = ("calibrated", "measured")
_AGREES = 0.05
"""Optics whose scale at the gel is off a measured one by more are of another unit's camera."""
_BULGE_MM = 1.0
"""How far a pressed face may reach beyond the pad at rest, sideways and out."""
_SUNK = 0.75
"""Part of the gel's height that a press may push in."""


@dataclass(frozen=True, eq=False)
class GelCamera:
    """A camera that sees the gel in perspective."""

    camera: DesignedCamera
    """Camera with the intrinsics of the image."""
    media: Media
    """Media between it and the gel."""
    face: PixelGrid
    """Pixels over the gel, along its normal, that hold all that the image shows: what surfaces are
    computed on before they are looked at."""

    @property
    def width_px(self) -> int:
        return self.camera.width_px

    @property
    def height_px(self) -> int:
        return self.camera.height_px

    @cached_property
    def model(self) -> CameraModel:
        """The projection in air."""
        return CameraModel(self.camera)

    def pixel_from_gel(self, points_mm: np.ndarray) -> np.ndarray:
        """Pixels (u, v) in which points of the gel [mm] are seen, [..., 3] -> [..., 2]; NaN where
        the lens sees nothing."""
        points = np.asarray(points_mm, dtype=np.float64)
        sight = self.media.sight(self.model.position_mm, points)
        return self.model.pixels_from_directions(sight @ self.model.gel_from_camera)

    def contains(self, points_mm: np.ndarray) -> np.ndarray:
        """Whether points of the gel [mm], [..., 3], lie in the image, bool, [...]."""
        return in_image(self.pixel_from_gel(points_mm), self)

    def sight_lines(self, uv_px: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Where the sight lines of pixels enter the gel [mm] and their unit directions in it, both
        [..., 3], NaN for none; of all pixels, [height_px, width_px, 3], when None."""
        if uv_px is None:
            entry, direction = _lines_of_all(self.camera, self.media)
            return entry.copy(), direction.copy()
        entry, direction, _ = self.media.trace(*self.model.rays(np.asarray(uv_px)))
        return entry, direction

    def resized(self, width_px: int, height_px: int) -> GelCamera:
        """Return the same view in other pixels."""
        across, down = width_px / self.width_px, height_px / self.height_px
        face = self.face
        size = max(2, round(face.width_px * across)), max(2, round(face.height_px * down))
        return GelCamera(resized(self.camera, width_px, height_px), self.media, face.resized(*size))

    def regridded(self, before: PixelGrid, after: PixelGrid) -> GelCamera:
        """The camera whose image shows at ``after`` what this one's shows at ``before``: another
        scale, about the gel's origin, and another place of it."""
        scale = np.array([
            before.mm_per_px_x / after.mm_per_px_x, before.mm_per_px_y / after.mm_per_px_y
        ])  # fmt: skip
        camera = self.camera
        place = np.array([camera.cx_px - before.center_u_px, camera.cy_px - before.center_v_px])
        cx, cy = scale * place + [after.center_u_px, after.center_v_px]
        fx, fy = scale * [camera.fx_px, camera.fy_px]
        changed = replace(
            camera, fx_px=float(fx), fy_px=float(fy), cx_px=float(cx), cy_px=float(cy)
        )
        return GelCamera(changed, self.media, self.face)

    def record(self) -> dict[str, Any]:
        """Gives it as JSON; ``of_record`` reads it."""
        media: dict[str, Any] = {"shape": "flat" if isinstance(self.media, FlatMedia) else "dome"}
        return {
            "camera": asdict(self.camera),
            "media": media | asdict(self.media),
            "face": asdict(self.face),
        }

    @classmethod
    def of_record(cls, record: dict[str, Any]) -> GelCamera:
        """The camera that ``record`` wrote; KeyError, TypeError or InputError for what is none."""
        camera, media = dict(record["camera"]), dict(record["media"])
        for name in ("position_mm", "rotation", "distortion"):
            camera[name] = tuple(camera[name])
        kind = {"flat": FlatMedia, "dome": DomeMedia}[media.pop("shape")]
        return cls(
            DesignedCamera(**camera),
            kind(**{name: tuple(values) for name, values in media.items()}),
            PixelGrid(**record["face"]),
        )


@lru_cache(maxsize=4)
def _lines_of_all(camera: DesignedCamera, media: Media) -> tuple[np.ndarray, np.ndarray]:
    """Sight lines of all pixels: presses of a sensor look through the same again and again."""
    uv_px = np.stack(np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px)), -1)
    entry, direction, _ = media.trace(*CameraModel(camera).rays(uv_px))
    return entry, direction


View = PixelGrid | GelCamera
"""What pixels see: the gel along its normal, or in perspective."""


def face_of(view: View) -> PixelGrid:
    """Pixels over the gel that surfaces are computed on for a view."""
    return view if isinstance(view, PixelGrid) else view.face


def in_image(uv_px: np.ndarray, view: View) -> np.ndarray:
    """Whether pixel coordinates [..., 2] lie in the image of a view, bool, [...]."""
    with np.errstate(invalid="ignore"):
        inside = (uv_px > -0.5) & (uv_px < np.array([view.width_px, view.height_px]) - 0.5)
    return np.asarray(inside.all(axis=-1))


def camera_of(profile: SensorProfile) -> View:
    """The camera that all channels of a profile's sensor look through.

    In this order: the pixel grid, where a colour model draws on a background, or without optics;
    the camera of the optics, where its image is the tactile one; else a camera straight over the
    gel that has the scale of the grid at rest and the distance of the optics, as rectified images
    do.
    """
    painted = profile.color is not None and profile.background is not None
    if profile.optics is None or painted:
        return profile.grid()
    return optics_camera(profile, profile.optics)


def optics_camera(profile: SensorProfile, optics: OpticsBlock) -> GelCamera:
    """The perspective camera of a profile, whatever else it holds; see ``camera_of``."""
    grid, camera = profile.grid(), optics.camera()
    media = profile_media(profile, optics)
    own = (camera.width_px, camera.height_px) == (grid.width_px, grid.height_px)
    if own and not profile.camera.rectified and _agrees(profile, camera, media):
        return _with_face(camera, media, profile)
    matrix = rectified_matrix(optics, profile)
    straight = replace(
        camera,
        width_px=grid.width_px,
        height_px=grid.height_px,
        fx_px=float(matrix[0, 0]),
        fy_px=float(matrix[1, 1]),
        cx_px=float(matrix[0, 2]),
        cy_px=float(matrix[1, 2]),
        position_mm=(*camera.position_mm[:2], -_apparent_depth_mm(optics, profile)),
        rotation=(0.0, 0.0, 0.0, 1.0),
        model="pinhole",
        distortion=(),
    )
    return _with_face(straight, FlatMedia((), (1.0,)), profile)


def profile_media(profile: SensorProfile, optics: OpticsBlock) -> Media:
    """What lies between a profile's camera and its gel; lights and coating have no part in it."""
    light = Light((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    design = OpticalDesign(
        camera=optics.camera(),
        lights=(light,),
        window=None if profile.window is None else profile.window.window(),
        gel_refractive_index=optics.gel_refractive_index,
    )
    return media_between(design, glued_back_mm(profile.mesh))


def _agrees(profile: SensorProfile, camera: DesignedCamera, media: Media) -> bool:
    """Whether optics have the scale of the grid, or nobody measured that."""
    if profile.camera.provenance.kind not in _MEASURED:
        return True
    grid = profile.grid()
    step_mm = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    seen = GelCamera(camera, media, grid).pixel_from_gel(step_mm)
    theirs = np.array([seen[1, 0] - seen[0, 0], seen[2, 1] - seen[0, 1]]) / 0.1
    ours = 1 / np.array([grid.mm_per_px_x, grid.mm_per_px_y])
    return bool((np.abs(theirs / ours - 1) < _AGREES).all())


def _with_face(camera: DesignedCamera, media: Media, profile: SensorProfile) -> GelCamera:
    """The camera, with pixels over all of the face that it sees, at rest and pressed in."""
    found = GelCamera(camera, media, profile.grid())
    nodes = 1e3 * profile.mesh.nodes_m[np.unique(profile.mesh.region_faces(Region.CONTACT))]
    entry, direction = found.sight_lines()
    heights = nodes[:, 2].max() + _BULGE_MM, nodes[:, 2].min() - _SUNK * profile.gel.thickness_mm
    seen = []
    for z in heights:
        rise = np.where(direction[..., 2] > 0, direction[..., 2], np.nan)
        seen.append((entry + direction * ((z - entry[..., 2]) / rise)[..., None])[..., :2])
    places = np.concatenate([one.reshape(-1, 2) for one in seen])
    places = places[np.isfinite(places).all(axis=1)]
    if len(places) == 0:
        raise InputError(
            f"no pixel of the camera sees the gel; it stands at {camera.position_mm} mm in the gel "
            "frame"
        )
    low = np.maximum(places.min(axis=0), nodes[:, :2].min(axis=0) - _BULGE_MM)
    high = np.minimum(places.max(axis=0), nodes[:, :2].max(axis=0) + _BULGE_MM)
    grid = profile.grid()
    first = np.floor(grid.pixel_from_gel(low)) - 1
    last = np.ceil(grid.pixel_from_gel(high)) + 1
    width, height = np.maximum(last - first + 1, 2).astype(int).tolist()
    face = PixelGrid(
        width,
        height,
        grid.mm_per_px_x,
        grid.mm_per_px_y,
        grid.center_u_px - float(first[0]),
        grid.center_v_px - float(first[1]),
    )
    return GelCamera(camera, media, face)


def rectified_matrix(optics: OpticsBlock, profile: SensorProfile) -> np.ndarray:
    """Camera matrix of a view along the gel's normal that shows the profile's pixel grid."""
    grid = profile.grid()
    x, y, _ = optics.position_mm
    depth_mm = _apparent_depth_mm(optics, profile)
    return np.array(
        [
            [depth_mm / grid.mm_per_px_x, 0.0, grid.center_u_px + x / grid.mm_per_px_x],
            [0.0, depth_mm / grid.mm_per_px_y, grid.center_v_px + y / grid.mm_per_px_y],
            [0.0, 0.0, 1.0],
        ]
    )


def _apparent_depth_mm(optics: OpticsBlock, profile: SensorProfile) -> float:
    """Apparent distance along the gel's normal."""
    return apparent_distance_mm(optics, profile) * float(optics.camera().gel_from_camera()[2, 2])


def apparent_distance_mm(optics: OpticsBlock, profile: SensorProfile) -> float:
    """Distance from the centre of projection to the gel along the optical axis, as the lens sees
    it.

    Focal length times mm/px, of the mean of both axes. The intrinsics may be of another image than
    the tactile one, which was then cut out of it or made smaller; which of the two is decided by
    what paraxial refraction leaves of the true distance.
    """
    grid = profile.grid()
    scale = np.array([grid.mm_per_px_x, grid.mm_per_px_y])
    focal = np.array([optics.fx_px, optics.fy_px])
    smaller = np.array([grid.width_px / optics.width_px, grid.height_px / optics.height_px])
    cut, shrunk = (float(np.sqrt(np.prod(pixels * scale))) for pixels in (focal, focal * smaller))
    axis_z = abs(optics.camera().gel_from_camera()[2, 2])
    lifted = profile.gel.thickness_mm * (1 - 1 / optics.gel_refractive_index)
    if profile.window is not None:
        lifted += profile.window.thickness_mm * (1 - 1 / profile.window.refractive_index)
    expected = (-optics.position_mm[2] - lifted) / max(axis_z, 1e-3)
    return min(cut, shrunk, key=lambda distance: abs(distance - expected))
