# SPDX-License-Identifier: Apache-2.0
"""The optional blocks of a profile that say how a sensor looks at its gel, and what holds it.

They hold what ``taccel_lab.profile.optical_design`` holds, whose checks they share.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from taccel_lab.profile.optical_design import (
    Camera,
    Coating,
    Light,
    MarkerGrid,
    OpticalDesign,
    Window,
)
from taccel_lab.profile.schema import Block, Provenance
from taccel_lab.reading.strict_model import Number, StrictModel, Whole

Triple = tuple[Number, Number, Number]
Share = Annotated[Number, Field(gt=0, le=1)]


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
    raw_width_px: Whole = Field(default=0, ge=0, le=20_000)
    """Width of the camera's own pictures; 0 when unknown."""
    raw_height_px: Whole = Field(default=0, ge=0, le=20_000)
    crop_x: Share = 1.0
    """Share of their width that the tactile image shows, centred."""
    crop_y: Share = 1.0
    gel_refractive_index: Number = Field(default=1.41, ge=1.0, le=2.5)
    gel_scattering_per_mm: Number = Field(default=0.0, ge=0.0, le=100.0)
    ambient_rgb: Triple = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _check_camera(self) -> Self:
        self.camera()
        return self

    def camera(self) -> Camera:
        """The camera; raises InputError for figures that no camera has."""
        return Camera(**{name: getattr(self, name) for name in Camera.__dataclass_fields__})

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


class WindowBlock(Block):
    """The rigid transparent part behind the gel."""

    key: ClassVar[str] = "window"

    shape: Literal["plate", "dome"] = "plate"
    thickness_mm: Number
    size_mm: tuple[Number, Number]
    refractive_index: Number = 1.49
    outer_radius_mm: Number = 0.0
    """Of a dome: radius of the face that the gel is glued to."""

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

    @model_validator(mode="after")
    def _check_light(self) -> Self:
        self.light()
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

    size_mm: tuple[
        Annotated[Number, Field(gt=0, le=1000)],
        Annotated[Number, Field(gt=0, le=1000)],
        Annotated[Number, Field(gt=0, le=1000)],
    ]
    wall_mm: Number = Field(gt=0, le=100)
    corner_radius_mm: Number = Field(ge=0, le=500)
    front_z_mm: Number = Field(ge=-1000, le=0)
    """z of the front face in the gel frame."""
    offset_mm: tuple[Number, Number] = (0.0, 0.0)
    """Centre of the box in gel xy."""
