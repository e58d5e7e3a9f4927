# SPDX-License-Identifier: Apache-2.0
"""Young's modulus, Poisson's ratio, density and friction of the gel, and of a skin over it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from taccel_lab.cad.parameters import ParameterSet, parameter
from taccel_lab.sensors.base import NO_FIGURE, GelMaterial


@dataclass(frozen=True)
class MaterialParameters(ParameterSet):
    """The gel as a solid."""

    parameter_group: ClassVar[str] = "material"

    young_modulus_mpa: float = parameter(
        0.15, minimum=0.005, maximum=5, unit="MPa",
        source="assumption: XP-565 gel as in EstimateModulus (0.15 MPa; earlier versions 0.275 and "
        "0.54). Simulators of GelSight gels use 0.01 to 1 MPa, 55 Shore 00 means about 0.4 by "
        "Gent's formula; forces scale with it, shapes do not",
        description="Young's modulus of the gel at small strain",
    )  # fmt: skip
    poisson_ratio: float = parameter(
        0.46, minimum=0.0, maximum=0.499,
        source="assumption: nearly incompressible silicone; 0.3 to 0.49 are in use",
        description="Poisson's ratio of the gel",
    )  # fmt: skip
    density_kg_m3: float = parameter(
        1000.0, minimum=500, maximum=3000, unit="kg/m3",
        source="Taccel and TacEx defaults; without effect on a quasi-static press",
        description="density of the gel",
    )  # fmt: skip
    friction: float = parameter(
        1.0, minimum=0.0, maximum=5.0,
        source="assumption: FEATS and Taccel use 1.0, gelsight_ansys_sim 0.5",
        description="Coulomb friction coefficient between gel and indenter",
    )  # fmt: skip

    def material(self) -> GelMaterial:
        """The gel's material."""
        return GelMaterial(
            young_modulus_pa=self.young_modulus_mpa * 1e6,
            poisson_ratio=self.poisson_ratio,
            density_kg_m3=self.density_kg_m3,
            friction_coefficient=self.friction,
        )


@dataclass(frozen=True)
class SkinParameters(ParameterSet):
    """A second solid over the gel; its friction is that of the whole sensor."""

    parameter_group: ClassVar[str] = "material"

    skin_young_modulus_mpa: float = parameter(
        0.3, minimum=0.005, maximum=20, unit="MPa", source=NO_FIGURE,
        description="Young's modulus of the skin at small strain",
    )  # fmt: skip
    skin_poisson_ratio: float = parameter(
        0.46, minimum=0.0, maximum=0.499,
        source="assumption: nearly incompressible silicone, as the gel",
        description="Poisson's ratio of the skin",
    )  # fmt: skip
    skin_density_kg_m3: float = parameter(
        1000.0, minimum=500, maximum=3000, unit="kg/m3",
        source="assumption: silicone, as the gel",
        description="density of the skin",
    )  # fmt: skip

    def skin_material(self, friction: float) -> GelMaterial:
        """The skin's material; ``friction`` is the sensor's."""
        return GelMaterial(
            young_modulus_pa=self.skin_young_modulus_mpa * 1e6,
            poisson_ratio=self.skin_poisson_ratio,
            density_kg_m3=self.skin_density_kg_m3,
            friction_coefficient=friction,
        )
