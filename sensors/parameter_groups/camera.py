# SPDX-License-Identifier: Apache-2.0
"""The cameras behind the gel and the tactile images that are made of their pictures."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from taccel_lab.cad.parameters import ParameterSet, parameter
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile.optical_design import DesignedCamera, Quaternion, rotation_matrix
from taccel_lab.sensors.base import NO_FIGURE

Each = float | tuple[float, ...]
"""One value for all, or one for each."""
_CENTRED = "assumption: one camera over the middle, straight"


@dataclass(frozen=True)
class CameraParameters(ParameterSet):
    """The camera behind the gel, and the tactile image that is made of its pictures.

    Further cameras of the same kind are there where a parameter has a value for each; all else is
    said of the first one, and ``seen_by`` makes another one the first.

    The scale of the tactile image, at the apex, and the focal length describe the same thing, seen
    from the image and from the lens; ``scale_from`` says which of them rules: the image, the lens
    in pixels of the image, or the lens in millimetres, as data sheets have it.
    """

    parameter_group: ClassVar[str] = "camera"

    width_px: int = parameter(
        640, minimum=16, maximum=8192, unit="px", source=NO_FIGURE,
        description="width of the tactile image",
    )  # fmt: skip
    height_px: int = parameter(
        480, minimum=16, maximum=8192, unit="px", source=NO_FIGURE,
        description="height of the tactile image",
    )  # fmt: skip
    mm_per_px: float = parameter(
        0.03, minimum=2e-3, maximum=0.5, unit="mm/px", source=NO_FIGURE,
        description="size of a pixel on the contact face along x",
    )  # fmt: skip
    mm_per_px_y: float = parameter(
        0.0, minimum=2e-3, maximum=0.5, unit="mm/px", zero_means="as along x",
        source="square pixels, as no source states others",
        description="size of a pixel on the contact face along y",
    )  # fmt: skip
    raw_width_px: int = parameter(
        640, minimum=16, maximum=16384, unit="px", source=NO_FIGURE,
        description="width of the camera's own pictures",
    )  # fmt: skip
    raw_height_px: int = parameter(
        480, minimum=16, maximum=16384, unit="px", source=NO_FIGURE,
        description="height of the camera's own pictures",
    )  # fmt: skip
    crop_x: float = parameter(
        1.0, minimum=0.05, maximum=1.0, source="assumption: the whole picture is used",
        description="share of the camera's picture that the tactile image shows, along x, centred",
    )  # fmt: skip
    crop_y: float = parameter(
        1.0,
        minimum=0.05,
        maximum=1.0,
        source="assumption: the whole picture is used",
        description="the same along y",
    )
    camera_distance_mm: float = parameter(
        24.0, minimum=15.0, maximum=100, unit="mm", source=NO_FIGURE,
        description="from the apex of the contact face back to the camera's centre of projection",
    )  # fmt: skip
    scale_from: str = parameter(
        "mm_per_px", choices=("mm_per_px", "focal_px", "lens_focal_mm"),
        source="what the sources state for this sensor",
        description="what fixes the image's scale; with a focal length it follows the camera's "
        "distance",
    )  # fmt: skip
    focal_px: float = parameter(
        800.0, minimum=120, maximum=20_000, unit="px", source=NO_FIGURE,
        description="focal length in pixels of the tactile image, used when scale_from is focal_px",
    )  # fmt: skip
    lens_focal_mm: float = parameter(
        0.0, minimum=0.2, maximum=50, unit="mm", zero_means="unknown", source=NO_FIGURE,
        description="focal length of the lens, such as an M12 lens's data sheet states it, used "
        "when scale_from is lens_focal_mm",
    )  # fmt: skip
    pixel_pitch_um: float = parameter(
        0.0, minimum=0.5, maximum=20, unit="um", zero_means="unknown", source=NO_FIGURE,
        description="pitch of the image sensor's pixels, as its data sheet states it: the sensor's "
        "width over raw_width_px",
    )  # fmt: skip
    lens_model: str = parameter(
        "pinhole", choices=("pinhole", "fisheye"), source="assumption: an ordinary lens",
        description="pinhole maps tangents of angles to pixels, fisheye angles",
    )  # fmt: skip
    principal_x_px: float = parameter(
        0.0, minimum=-200, maximum=200, unit="px", source="assumption: centred lens",
        description="column of the principal point, counted from the middle of the image",
    )  # fmt: skip
    principal_y_px: float = parameter(
        0.0, minimum=-200, maximum=200, unit="px", source="assumption: centred lens",
        description="row of the principal point, counted from the middle of the image",
    )  # fmt: skip
    aperture_mm: float = parameter(
        0.0, minimum=0.05, maximum=20, unit="mm", zero_means="unknown, all in focus",
        source=NO_FIGURE, description="diameter of the entrance pupil",
    )  # fmt: skip
    camera_x_mm: float | tuple[float, ...] = parameter(
        0.0, minimum=-30, maximum=30, unit="mm", source=_CENTRED, each="camera",
        description="place of the centre of projection along x, from the middle of the gel",
    )  # fmt: skip
    camera_y_mm: float | tuple[float, ...] = parameter(
        0.0, minimum=-30, maximum=30, unit="mm", source=_CENTRED, each="camera",
        description="the same along y",
    )  # fmt: skip
    camera_tilt_x_deg: float | tuple[float, ...] = parameter(
        0.0, minimum=-30, maximum=30, unit="deg", source=_CENTRED, each="camera",
        description="angle by which the optical axis leans towards +x from the gel's normal",
    )  # fmt: skip
    camera_tilt_y_deg: float | tuple[float, ...] = parameter(
        0.0, minimum=-30, maximum=30, unit="deg", source=_CENTRED, each="camera",
        description="the same towards +y",
    )  # fmt: skip
    lens_distortion: ClassVar[tuple[float, ...]] = ()
    """Parameters of ``DesignedCamera``, with the family's own ``lens_model``."""

    def camera_count(self) -> int:
        """Cameras; InputError where two parameters speak of different numbers of them."""
        counts = {
            name: len(value)
            for name, spec in self.parameters().items()
            if spec.each == "camera" and isinstance(value := getattr(self, name), tuple)
        }
        if len(set(counts.values())) > 1:
            said = ", ".join(f"{name} has {count}" for name, count in counts.items())
            raise InputError(f"parameters state different numbers of cameras: {said}")
        return max(counts.values(), default=1)

    def seen_by(self, number: int) -> Self:
        """The same sensor with the camera of that number, from 0, and no other."""
        own: dict[str, Any] = {
            name: _of(getattr(self, name), number)
            for name, spec in self.parameters().items()
            if spec.each == "camera"
        }
        return dataclasses.replace(self, **own)

    def apparent_distance_mm(self) -> float:
        """Distance at which the camera sees the apex [mm]; nearer than it is, through media."""
        return self.camera_distance_mm

    def scale_mm_per_px(self) -> tuple[float, float]:
        """Size of a pixel on the contact face along x and y [mm]."""
        if self.scale_from != "mm_per_px":
            scale = self.apparent_distance_mm() / self.lens_px()
            return scale, scale
        return self.mm_per_px, self.mm_per_px_y or self.mm_per_px

    def lens_px(self) -> float:
        """Focal length of the lens in pixels of the tactile image, which the camera's picture is
        cropped and scaled to."""
        if self.scale_from != "lens_focal_mm":
            return self.focal_px
        if not (self.lens_focal_mm and self.pixel_pitch_um):
            raise InputError(
                "scale_from = lens_focal_mm needs lens_focal_mm and pixel_pitch_um, which the data "
                "sheets of lens and image sensor state"
            )
        of_picture = 1e3 * self.lens_focal_mm / self.pixel_pitch_um
        return of_picture * self.width_px / (self.raw_width_px * self.crop_x)

    def focal_lengths_px(self) -> tuple[float, float]:
        """Focal lengths fx and fy in pixels of the tactile image."""
        x, y = self.scale_mm_per_px()
        distance = self.apparent_distance_mm()
        return distance / x, distance / y

    def grid(self) -> PixelGrid:
        """The pixel grid of the tactile image, with the apex where the camera sees it."""
        x, y = self.scale_mm_per_px()
        if not (1e-4 <= x <= 1 and 1e-4 <= y <= 1):
            raise InputError(
                f"camera_distance_mm = {self.camera_distance_mm:g} and {self.scale_from} = "
                f"{getattr(self, self.scale_from):g} make {x:g} mm/px; allowed: 0.0001 to 1 mm/px"
            )
        u, v = self._principal_point_px()
        fx, fy = self.focal_lengths_px()
        distance = self.apparent_distance_mm()
        place = np.array([*self._place_mm(), -distance])
        aside_x, aside_y, ahead = (-place @ rotation_matrix(self._rotation())).tolist()
        return PixelGrid(
            width_px=self.width_px,
            height_px=self.height_px,
            mm_per_px_x=x * (ahead / distance),
            mm_per_px_y=y * (ahead / distance),
            center_u_px=u + fx * aside_x / ahead,
            center_v_px=v + fy * aside_y / ahead,
        )

    def axis_meets_mm(self) -> tuple[float, float]:
        """Gel xy at which the optical axis meets the contact face, as the camera sees it [mm]."""
        x, y, z = rotation_matrix(self._rotation())[:, 2].tolist()
        ahead = self.apparent_distance_mm() / z
        at_x, at_y = self._place_mm()
        return at_x + ahead * x, at_y + ahead * y

    def view_mm(self) -> tuple[float, float]:
        """What the tactile image shows of the gel, along x and y [mm]."""
        x, y = self.scale_mm_per_px()
        return self.width_px * x, self.height_px * y

    def camera(self) -> DesignedCamera:
        """The camera with the intrinsics of the tactile image, focused on the apex."""
        fx, fy = self.focal_lengths_px()
        u, v = self._principal_point_px()
        own_lens = self.lens_model == self.parameters()["lens_model"].default
        return DesignedCamera(
            width_px=self.width_px,
            height_px=self.height_px,
            fx_px=fx,
            fy_px=fy,
            cx_px=u,
            cy_px=v,
            position_mm=(*self._place_mm(), -self.camera_distance_mm),
            rotation=self._rotation(),
            model=self.lens_model,  # type: ignore[arg-type]
            distortion=self.lens_distortion if own_lens else (),
            focus_mm=self.apparent_distance_mm(),
            aperture_mm=self.aperture_mm,
        )

    def _place_mm(self) -> tuple[float, float]:
        return _of(self.camera_x_mm, 0), _of(self.camera_y_mm, 0)

    def _rotation(self) -> Quaternion:
        """Least turn from the gel's normal to the optical axis, gel_from_camera, x y z w."""
        x, y = (
            math.tan(math.radians(_of(one, 0)))
            for one in (self.camera_tilt_x_deg, self.camera_tilt_y_deg)
        )
        length = math.sqrt(1 + x * x + y * y)
        size = math.hypot(x, y, 1 + length)
        return (-y / size, x / size, 0.0, (1 + length) / size)

    def _principal_point_px(self) -> tuple[float, float]:
        return (
            (self.width_px - 1) / 2 + self.principal_x_px,
            (self.height_px - 1) / 2 + self.principal_y_px,
        )


def _of(value: Each, number: int) -> float:
    return value[number] if isinstance(value, tuple) else value
