# SPDX-License-Identifier: Apache-2.0
"""What every sensor family provides: parameters, pad, optics, housing, material, sources."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from taccel_lab.cad.parameters import ParameterSet
from taccel_lab.cad.parts.housing_shape import HousingShape
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile.optical_design import MarkerGrid, OpticalDesign

STIFFNESS = ("young_modulus_mpa", "shore_00", "shore_a")
"""Parameters of which one says how stiff the gel is."""
HARDNESSES = STIFFNESS[1:]
"""Names of those that are a durometer's reading."""
INCOMPRESSIBLE = 0.499
"""Poisson's ratio of a solid rubber: a bulk modulus of 1 GPa makes it 0.4999."""
OF_A_HARDNESS = ("poisson_ratio", "skin_poisson_ratio")
"""What is ``INCOMPRESSIBLE`` in a gel of a hardness unless it is given."""
NO_FIGURE = "assumption: no source states it for this sensor"
"""The source of a default that no source states."""


@dataclass(frozen=True)
class GelMaterial:
    """A layer of the gel as a Neo-Hookean solid and its friction against indenters."""

    young_modulus_pa: float
    """Young's modulus at small strain [Pa]."""
    poisson_ratio: float
    density_kg_m3: float
    friction_coefficient: float
    """Coulomb friction coefficient."""
    young_interval_pa: tuple[float, float] | None = None
    """Interval of the modulus, where it stands for a Shore hardness; None otherwise."""
    branches: tuple[tuple[float, float], ...] = ()
    """Relative modulus and time [s] of each Maxwell branch."""


class FamilyParameters(ParameterSet, ABC):
    """Parameters of one sensor of a family; subclasses are frozen dataclasses of ``parameter``."""

    @abstractmethod
    def pad(self) -> Pad:
        """The gel pad [mm]; raises InputError for dimensions that cannot be built."""

    @abstractmethod
    def grid(self) -> PixelGrid:
        """The pixel grid that the tactile image lays over the gel."""

    @abstractmethod
    def material(self) -> GelMaterial:
        """The gel's material (layer 0)."""

    def layer_materials(self) -> tuple[GelMaterial, ...]:
        """Materials of the pad's layers, in the order of ``pad().layer_names``."""
        return (self.material(),)

    def optics(self) -> OpticalDesign | None:
        """Camera, lights, coating and window; None while the family has no optical model."""
        return None

    def views(self) -> Mapping[str, FamilyParameters]:
        """The same sensor through each further camera, by its name; ``grid`` and ``optics`` are of
        the first camera."""
        return {}

    def markers(self) -> MarkerGrid | None:
        """Dots painted on the contact face; None for a sensor without."""
        return None

    def housing(self) -> HousingShape | None:
        """The rigid housing; None while the family models none."""
        return None

    def describe(self) -> dict[str, dict[str, Any]]:
        """Descriptions as of any set; what follows from a hardness is not said to be the user's."""
        found = super().describe()
        if hardness_of(self.values()):
            for name in OF_A_HARDNESS:
                if name in found and found[name]["value"] == INCOMPRESSIBLE:
                    found[name]["source"] = "incompressible, as the formula of the hardness has it"
        return found


def all_optics(parameters: FamilyParameters) -> list[OpticalDesign]:
    """What each camera of a sensor sees, the first one's first; nothing without optics."""
    found = [seen.optics() for seen in (parameters, *parameters.views().values())]
    return [design for design in found if design is not None]


@dataclass(frozen=True)
class SensorFamily:
    """One family of the catalogue."""

    name: str
    """Name on the command line and in profiles."""
    title: str
    """One line for people."""
    parameters_type: type[FamilyParameters]
    references: tuple[str, ...] = ()
    """Publications and data the family rests on."""

    @property
    def label(self) -> str:
        """Name in titles."""
        return self.name

    @property
    def identity(self) -> str:
        """Stands for all of a design that its parameters do not say."""
        return self.name

    def parameters(self, overrides: Mapping[str, Any] | None = None) -> FamilyParameters:
        """Parameters of the family, the defaults where ``overrides`` says nothing.

        A gel of a hardness is incompressible where ``overrides`` does not say otherwise: the
        formulas that make a modulus of it take the rubber as that, and what a catalogue's modulus
        was found with does not belong to another gel. All parts are built once as formulas, so that
        parameters which contradict each other are rejected here.
        """
        try:
            values = dict(overrides or {})
            given = [name for name in STIFFNESS if values.get(name)]
            if len(given) > 1:
                raise InputError(f"{' and '.join(given)} are given; the gel has one stiffness")
            if hardness_of(values):
                known = self.parameters_type.parameters()
                values = {n: INCOMPRESSIBLE for n in OF_A_HARDNESS if n in known} | values
            found = self.parameters_type.of(values)
            for part in ("pad", "grid", "layer_materials", "optics", "markers", "housing"):
                getattr(found, part)()
            for view in found.views().values():
                view.optics()
        except InputError as error:
            raise InputError(f"sensor {self.name}: {error}") from error
        return found


def hardness_of(values: Mapping[str, Any]) -> str | None:
    """The parameter that says how stiff the gel is, where that is a hardness."""
    return next((name for name in HARDNESSES if values.get(name)), None)
