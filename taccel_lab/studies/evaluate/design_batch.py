# SPDX-License-Identifier: Apache-2.0
"""Batches of designs that are evaluated together: those that can share simulations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from taccel_lab.errors import InputError
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.studies.metrics.design_point import DesignPoint

Needs = tuple[tuple[str, ...], tuple[str, ...]]
"""Metrics and presses."""
MAX_BATCH = 32
"""Designs in a batch: what is lost at most, with every process, when a run is killed."""
GROUPS_ON_GPU = 16
"""Groups of designs in a batch on a GPU, which wants many environments at once. On a CPU each
group goes alone, so that rows appear early and cores share the work evenly."""


@dataclass(frozen=True)
class DesignBatch:
    """Designs that are evaluated together, all for the same metrics."""

    designs: tuple[DesignPoint, ...]
    metrics: tuple[str, ...]
    presses: tuple[str, ...]

    def one_by_one(self) -> list[DesignBatch]:
        """A batch of each design."""
        return [replace(self, designs=(design,)) for design in self.designs]


def sharing_key(family: SensorFamily, design: DesignPoint) -> str:
    """Equal for designs whose presses are the same but for the scale of the forces.

    Quasi-static presses scale with Young's modulus, and optics do not touch them: what counts is
    the pad, the camera's view (it places the presses), and the layers' other properties.
    """
    try:
        parameters = family.parameters(design.parameters)
    except InputError:
        return f"cannot be built: {design.id}"
    layers = parameters.layer_materials()
    modulus = layers[0].young_modulus_pa
    return repr(
        (
            parameters.pad(),
            parameters.grid(),
            [
                (m.young_modulus_pa / modulus, m.poisson_ratio, m.friction_coefficient)
                for m in layers
            ],
        )
    )


def gather_batches(
    family: SensorFamily, wanted: Sequence[DesignBatch], device: str
) -> list[DesignBatch]:
    """Batches made of others, in the order of each one's first design."""
    groups: dict[tuple[str, Needs], list[DesignPoint]] = {}
    for batch in wanted:
        for design in batch.designs:
            key = sharing_key(family, design)
            groups.setdefault((key, (batch.metrics, batch.presses)), []).append(design)
    merged = GROUPS_ON_GPU if device.startswith("cuda") else 1
    batches: list[DesignBatch] = []
    room = 0
    for (_, needs), group in groups.items():
        for start in range(0, len(group), MAX_BATCH):
            part = DesignBatch(tuple(group[start : start + MAX_BATCH]), *needs)
            if room and (batches[-1].metrics, batches[-1].presses) == needs:
                batches[-1] = replace(part, designs=batches[-1].designs + part.designs)
                room -= 1
            else:
                batches.append(part)
                room = merged - 1
    return batches
