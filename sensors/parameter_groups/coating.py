# SPDX-License-Identifier: Apache-2.0
"""The reflective layer on the gel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from taccel_lab.cad.parameters import ParameterSet, parameter
from taccel_lab.profile.optical_design import Coating


@dataclass(frozen=True)
class CoatingParameters(ParameterSet):
    """The reflective layer on the gel."""

    parameter_group: ClassVar[str] = "coating"

    coating_albedo: float = parameter(
        0.5, minimum=0.01, maximum=1.0,
        source="assumption: grey pigment; the coating measured for the PBR model of CMURoboTouch's "
        "tactile_optical_simulation reflects 0.40 to 0.51",
        description="diffuse reflectance of the coating",
    )  # fmt: skip
    coating_specular: float = parameter(
        0.0, minimum=0.0, maximum=1.0,
        source="assumption: matte, as the Lambertian coating of tactile_optical_simulation",
        description="weight of the glossy lobe",
    )  # fmt: skip
    coating_roughness: float = parameter(
        0.5, minimum=0.02, maximum=1.0, source="without effect while coating_specular is 0",
        description="width of the glossy lobe (GGX alpha)",
    )  # fmt: skip
    coating_thickness_mm: float = parameter(
        0.02, minimum=0.0, maximum=2.0, unit="mm",
        source="assumption: a sprayed film; no source states it",
        description="thickness of the coating, thin enough to leave out of the mesh",
    )  # fmt: skip

    def coating(self) -> Coating:
        """The coating, the same in all channels."""
        albedo = self.coating_albedo
        return Coating(
            albedo_rgb=(albedo, albedo, albedo),
            specular=self.coating_specular,
            roughness=self.coating_roughness,
            thickness_mm=self.coating_thickness_mm,
        )
