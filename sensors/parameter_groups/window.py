# SPDX-License-Identifier: Apache-2.0
"""The rigid transparent part behind the gel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from taccel_lab.cad.parameters import ParameterSet, parameter
from taccel_lab.sensors.base import NO_FIGURE


@dataclass(frozen=True)
class WindowParameters(ParameterSet):
    """The rigid transparent part behind the gel."""

    parameter_group: ClassVar[str] = "window"

    window_thickness_mm: float = parameter(
        2.0, minimum=0.2, maximum=12, unit="mm", source=NO_FIGURE,
        description="thickness of the window behind the gel",
    )  # fmt: skip
    window_index: float = parameter(
        1.49, minimum=1.0, maximum=2.5,
        source="acrylic (PMMA): 1.49 in visible light",
        description="refractive index of the window",
    )  # fmt: skip
    gel_index: float = parameter(
        1.41, minimum=1.0, maximum=2.5,
        source="clear silicone such as Solaris: about 1.41",
        description="refractive index of the gel",
    )  # fmt: skip
    gel_scattering_per_mm: float = parameter(
        0.0, minimum=0.0, maximum=20, unit="1/mm", source="assumption: a clear gel",
        description="scattering coefficient of a turbid gel (Kubelka and Munk's S)",
    )  # fmt: skip
