# SPDX-License-Identifier: Apache-2.0
"""The optional blocks of a profile: how a sensor looks at its gel, what holds it, how it answers a
touch besides its colour model, and how far units and days differ.

Those of the optics hold what ``taccel_lab.profile.optical_design`` holds, whose checks they share.
"""

from __future__ import annotations

from dataclasses import asdict
from itertools import pairwise
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from taccel_lab.files.strict_model import Number, StrictModel, Whole
from taccel_lab.geometry.lens import invert_fisheye, undistort_pinhole
from taccel_lab.profile.bounds import Bound
from taccel_lab.profile.optical_design import (
    Coating,
    DesignedCamera,
    Light,
    MarkerGrid,
    OpticalDesign,
    Window,
)
from taccel_lab.profile.schema import Block, ConfigValue, Name, Provenance

Triple = tuple[Number, Number, Number]
_MOST_BENDING = 4.0
"""Times that a lens moves what it shows half way to the corners; fisheyes do by 1.5."""


class OpticsBlock(Block):
    """The physical camera behind the gel, and the media that it looks through.

    Its intrinsics belong to the tactile image; ``raw_width_px``, ``crop_x`` and so on say how that
    is cut out of the camera's own pictures.
    """

    key: ClassVar[str] = "optics"

    model: Literal["pinhole", "fisheye"] = "pinhole"
    width_px: Whole
    height_px: Whole
    fx_px: Number
    fy_px: Number
    cx_px: Number
    cy_px: Number
    distortion: tuple[Number, ...] = ()
    """OpenCV's coefficients, in its order."""
    position_mm: Triple
    """Centre of projection in the gel frame."""
    rotation: tuple[Number, Number, Number, Number] = (0.0, 0.0, 0.0, 1.0)
    """gel_from_camera, quaternion x, y, z, w."""
    focus_mm: Number = 0.0
    aperture_mm: Number = 0.0
    falloff: Number = 4.0
    raw_width_px: Whole = 0
    """Width of the camera's own pictures; 0 when unknown."""
    raw_height_px: Whole = 0
    crop_x: Number = 1.0
    """Share of their width that the tactile image shows, centred."""
    crop_y: Number = 1.0
    gel_refractive_index: Number = 1.41
    gel_scattering_per_mm: Number = 0.0
    ambient_rgb: Triple = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _check_camera(self) -> Self:
        self.camera()
        longest = max(self.width_px, self.height_px)
        lens = Bound(0.05 * longest, 60 * longest, "px", "lenses see 1 to 170 degrees")
        behind = Bound(-1000, -0.5, "mm", "it looks at the gel from behind, along +z")
        rules = [("fx_px", self.fx_px, lens), ("fy_px", self.fy_px, lens)]
        rules.append(("position_mm, z", self.position_mm[2], behind))
        for name, size in (("cx_px", self.width_px), ("cy_px", self.height_px)):
            place = Bound(-0.4 * size, 1.4 * size, "px", "the axis passes near the image")
            rules.append((name, getattr(self, name), place))
        for name, value, bound in rules:
            for fault in bound.faults(name, value):
                raise ValueError(fault)
        if (self.raw_width_px == 0) != (self.raw_height_px == 0):
            raise ValueError(
                "raw_width_px and raw_height_px: both are known or both 0, got "
                f"{self.raw_width_px} and {self.raw_height_px}"
            )
        _require_unfolded(self.camera())
        return self

    def camera(self) -> DesignedCamera:
        """The camera; raises InputError for figures that no camera has."""
        return DesignedCamera(
            **{name: getattr(self, name) for name in DesignedCamera.__dataclass_fields__}
        )

    @classmethod
    def from_design(
        cls,
        design: OpticalDesign,
        provenance: Provenance,
        *,
        raw_px: tuple[int, int] = (0, 0),
        crop: tuple[float, float] = (1.0, 1.0),
    ) -> OpticsBlock:
        """Camera and media of an optical design; ``raw_px`` and ``crop`` as in the fields."""
        return cls(
            **asdict(design.camera),
            raw_width_px=raw_px[0],
            raw_height_px=raw_px[1],
            crop_x=crop[0],
            crop_y=crop[1],
            gel_refractive_index=design.gel_refractive_index,
            gel_scattering_per_mm=design.gel_scattering_per_mm,
            ambient_rgb=design.ambient_rgb,
            provenance=provenance,
        )


def _require_unfolded(camera: DesignedCamera) -> None:
    """Refuse a distortion that folds, or bends beyond any lens, half way to the corners."""
    if not any(camera.distortion):
        return
    half = np.array([camera.width_px, camera.height_px]) / 4
    turns = np.array([[x, y] for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y])
    focal, middle = (camera.fx_px, camera.fy_px), (camera.cx_px, camera.cy_px)
    image = (2 * half + turns * half - 0.5 - np.array(middle)) / np.array(focal)
    bent = np.linalg.norm(image, axis=-1)
    coefficients = np.zeros(4 if camera.model == "fisheye" else 8)
    coefficients[: len(camera.distortion)] = camera.distortion
    if camera.model == "fisheye":
        straight = invert_fisheye(bent, coefficients)
    else:
        straight = np.linalg.norm(undistort_pinhole(image, coefficients), axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(bent > 1e-9, straight / bent, 1.0)
    if not ((ratio >= 1 / _MOST_BENDING) & (ratio <= _MOST_BENDING)).all():
        raise ValueError(
            f"distortion: folds or bends the image more than {_MOST_BENDING:g} times half way to "
            f"its corners, got {list(camera.distortion)}"
        )


class WindowBlock(Block):
    """The rigid transparent part behind the gel."""

    key: ClassVar[str] = "window"

    shape: Literal["plate", "dome"] = "plate"
    thickness_mm: Number
    size_mm: tuple[Number, Number]
    refractive_index: Number = 1.49
    outer_radius_mm: Number = 0.0
    """Radius of the face of a dome that the gel is glued to."""

    @model_validator(mode="after")
    def _check_window(self) -> Self:
        self.window()
        return self

    def window(self) -> Window:
        """The window."""
        return Window(**{name: getattr(self, name) for name in Window.__dataclass_fields__})


class CoatingBlock(Block):
    """The reflective layer on the gel."""

    key: ClassVar[str] = "coating"

    albedo_rgb: Triple
    specular: Number = 0.0
    roughness: Number = 0.5
    thickness_mm: Number = 0.0

    @model_validator(mode="after")
    def _check_coating(self) -> Self:
        self.coating()
        return self

    def coating(self) -> Coating:
        """The coating."""
        return Coating(**{name: getattr(self, name) for name in Coating.__dataclass_fields__})


class LightEntry(StrictModel):
    """One LED; see ``taccel_lab.profile.optical_design.Light``."""

    name: str = ""
    position_mm: Triple
    direction: Triple
    rgb: Triple
    size_mm: tuple[Number, Number] = (0.0, 0.0)
    lobe: Number = 1.0
    arc_deg: Number = 0.0

    @model_validator(mode="after")
    def _check_light(self) -> Self:
        self.light()
        if self.position_mm[2] > 0:
            raise ValueError("position_mm, z: must be at most 0: LEDs lie behind the gel's apex")
        return self

    def light(self) -> Light:
        """The LED."""
        return Light(**{name: getattr(self, name) for name in Light.__dataclass_fields__})


class LightsBlock(Block):
    """The LEDs."""

    key: ClassVar[str] = "lights"

    led: tuple[LightEntry, ...] = Field(min_length=1)

    def lights(self) -> tuple[Light, ...]:
        """The LEDs, in the order of the file."""
        return tuple(entry.light() for entry in self.led)


class MarkersBlock(Block):
    """The dots painted on the contact face; see ``MarkerGrid``."""

    key: ClassVar[str] = "markers"

    rows: Whole
    columns: Whole
    pitch_x_mm: Number
    pitch_y_mm: Number
    radius_mm: Number
    offset_mm: tuple[Number, Number] = (0.0, 0.0)
    rotation_deg: Number = 0.0
    stagger: Number = 0.0
    missing: tuple[tuple[Whole, Whole], ...] = ()

    @model_validator(mode="after")
    def _check_grid(self) -> Self:
        self.grid()
        return self

    def grid(self) -> MarkerGrid:
        """The grid of dots."""
        fields = MarkerGrid.__dataclass_fields__
        return MarkerGrid(**{name: getattr(self, name) for name in fields})


class HousingBlock(Block):
    """The rigid box that holds window, lights and camera."""

    key: ClassVar[str] = "housing"

    size_mm: Triple
    wall_mm: Number
    corner_radius_mm: Number
    front_z_mm: Number
    """z of the front face in the gel frame."""
    offset_mm: tuple[Number, Number] = (0.0, 0.0)
    """Centre of the box in gel xy."""

    @model_validator(mode="after")
    def _check_offset(self) -> Self:
        if any(abs(o) > s / 2 for o, s in zip(self.offset_mm, self.size_mm, strict=False)):
            raise ValueError("offset_mm: the box must hold the axis of the gel")
        least = min(self.size_mm) / 2
        for name in ("wall_mm", "corner_radius_mm"):
            if not getattr(self, name) <= least:
                raise ValueError(
                    f"{name}: at most {least:g} mm, half of the box, got {getattr(self, name):g}"
                )
        return self


class NormalsBlock(Block):
    """The model from colour and pixel position to surface normal.

    Its weights are stored in ``normal_model.safetensors``.
    """

    key: ClassVar[str] = "normals"

    file: Literal["normal_model.safetensors"] = "normal_model.safetensors"
    architecture: dict[Name, ConfigValue]
    """What is needed to rebuild the network: features, layer widths, activation, scales."""


class ForceBlock(Block):
    """The network from the change of colour, and moved markers, to force, moment and area.

    Its weights are stored in ``force_model.safetensors``.
    """

    key: ClassVar[str] = "force"

    file: Literal["force_model.safetensors"] = "force_model.safetensors"
    architecture: dict[Name, ConfigValue]
    """What is needed to rebuild the network: patches, layer widths, scales, limits, modulus."""


class DepthResponseBlock(Block):
    """Indentation of a grey sensor (9DTact) from how far a pixel darkens: a monotone curve."""

    key: ClassVar[str] = "depth_response"

    channel: Literal["grey", "red", "green", "blue"] = "grey"
    """Channel whose drop is read; grey is OpenCV's luma 0.299 R + 0.587 G + 0.114 B."""
    drop_levels: tuple[Number, ...] = Field(min_length=2)
    """Background minus image [levels of 255], rising."""
    depth_mm: tuple[Number, ...] = Field(min_length=2)
    """Indentation of the contact face at each drop [mm], not falling."""
    reading_sigma_mm: Number | None = None
    """Standard deviation of a pixel's depth about the curve on presses that it did not see [mm];
    None where it is not known, and the two below then are not either."""
    zero_sigma_mm: Number = 0.0
    """Standard deviation of the zero [mm], which all depths from the second entry on share; below
    it runs straight to none, since untouched gel is at zero whatever the zero is."""
    depth_share: Number = 0.0
    """Standard deviation, as a share of the depth, by the scale that the calibration took."""

    @model_validator(mode="after")
    def _check_curve(self) -> Self:
        drop, depth = self.drop_levels, self.depth_mm
        if len(drop) != len(depth):
            raise ValueError(f"drop_levels has {len(drop)} entries, depth_mm {len(depth)}")
        if any(b <= a for a, b in pairwise(drop)):
            raise ValueError("drop_levels must rise")
        if any(b < a for a, b in pairwise(depth)):
            raise ValueError("depth_mm must not fall")
        return self


class PerturbationBlock(Block):
    """How far captures of this sensor spread, for domain randomisation; standard deviations.

    A perturbed image is ``pivot + gain * (image - pivot) + offset + gradient + noise``; see
    ``taccel_lab.signals.perturbation``.
    """

    key: ClassVar[str] = "perturbation"

    gain_rgb: Triple = (0.0, 0.0, 0.0)
    """Standard deviation of the per-frame gain of each channel."""
    pivot_rgb: Triple = (0.0, 0.0, 0.0)
    """Level of each channel that its gain leaves as it is, usually the mean of the background:
    about it gain and offset vary independently [levels]; not a spread."""
    offset_rgb: Triple = (0.0, 0.0, 0.0)
    """Standard deviation of the per-frame offset of each channel, at the pivot [levels]."""
    gradient_rgb: Triple = (0.0, 0.0, 0.0)
    """Standard deviation of a linear gradient of the light over half the image [levels]."""
    noise_levels: Number = 0.0
    """Standard deviation of one pixel between frames [levels]."""
    mm_per_px_relative: Number = 0.0
    """Standard deviation of the scale, as a part of it."""
    center_px: Number = 0.0
    """Standard deviation of the gel's place in the image [px]."""
    young_modulus_relative: Number = 0.0
    """Standard deviation of Young's modulus, as a part of it."""
    friction_coefficient: Number = 0.0
    """Standard deviation of the coefficient of friction."""
