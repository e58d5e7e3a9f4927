# SPDX-License-Identifier: Apache-2.0
"""What a maker decides about a mould."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.cad.parameters import ParameterSet, parameter

_PRACTICE = "common practice for silicone cast in printed or milled moulds"


@dataclass(frozen=True)
class MouldOptions(ParameterSet):
    """Dimensions of a two-part mould."""

    draft_deg: float = parameter(
        2.0, minimum=0, maximum=10, unit="deg", source=_PRACTICE,
        description="angle by which vertical walls open towards the parting plane",
    )  # fmt: skip
    shrinkage_percent: float = parameter(
        0.1, minimum=0, maximum=5, unit="%",
        source="data sheets of platinum-cured silicones: under 0.1 %; condensation-cured up to 1 %",
        description="linear shrinkage of the gel while it cures; the cavity is that much larger",
    )  # fmt: skip
    wall_mm: float = parameter(
        9.0, minimum=5, maximum=50, unit="mm", source=_PRACTICE,
        description="mould material beside and above the cavity",
    )  # fmt: skip
    lid_mm: float = parameter(
        6.0, minimum=2, maximum=30, unit="mm", source=_PRACTICE,
        description="thickness of the lid",
    )  # fmt: skip
    pin_mm: float = parameter(
        4.0, minimum=2, maximum=10, unit="mm", source=_PRACTICE,
        description="diameter of the thicker registration pin; the other is 1 mm thinner, so that "
        "the lid fits one way round only",
    )  # fmt: skip
    pin_clearance_mm: float = parameter(
        0.1, minimum=0.02, maximum=0.5, unit="mm", source=_PRACTICE,
        description="radial gap between pins and holes",
    )  # fmt: skip
    pour_mm: float = parameter(
        3.0, minimum=0.6, maximum=10, unit="mm", source=_PRACTICE,
        description="diameter of the pour hole, where the gel's back leaves room for it",
    )  # fmt: skip
    vent_mm: float = parameter(
        1.0, minimum=0.4, maximum=3, unit="mm", source=_PRACTICE,
        description="diameter of the vents, where the gel's back leaves room for them",
    )  # fmt: skip
    vents: int = parameter(3, minimum=1, maximum=8, source=_PRACTICE, description="number of vents")
