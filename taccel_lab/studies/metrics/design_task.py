# SPDX-License-Identifier: Apache-2.0
"""The task ``touch-insertion`` with gels of a design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.cad.mesh.mesh_pad import MeshPad
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.sensors.base import FamilyParameters
from taccel_lab.tasks.bodies import pad_mesh
from taccel_lab.tasks.catalogue import Task, named
from taccel_lab.tasks.touch_insertion import TouchInsertion, TouchInsertionParameters

_INWARD, _MOST_INWARD = 0.98, 40
"""Factor of a step inward, and their number. Beside a face with round corners its height is read at
0.98, 0.98^2, ... of the way from its middle, down to less than half."""


@dataclass(frozen=True)
class DesignTask(Task):
    """The task with gels of a shape."""

    gel: TetMesh

    def begin(self, seeds: Sequence[int], device: str | None = None) -> TouchInsertion:
        """Seeds at their starts, as environments of one solver."""
        assert isinstance(self.parameters, TouchInsertionParameters)
        return TouchInsertion(self.parameters, seeds, device, self.gel)


def design_task(design: FamilyParameters, name: str = "touch-insertion") -> DesignTask:
    """A task of the kind ``touch-insertion`` with the design's shape, modulus, friction, markers.

    The block of the task's cells takes the height of the design's contact face; an imported gel
    keeps its mesh. Poisson's ratio stays the task's, since linear tets lock near 0.5. Layers over
    the gel have its modulus. InputError for a design without markers.
    """
    markers = design.markers()
    if markers is None:
        raise InputError("the policy of touch-insertion sees markers, and this design has none")
    task = named(name)
    assert isinstance(task.parameters, TouchInsertionParameters)
    pad, gel = design.pad(), design.material()
    low, high = pad.bounds_mm()
    width, height = (float(side) for side in (high - low)[:2])
    block = task.parameters.gel.replace(
        size_mm=(width, height, float(pad.thickness_mm)),
        young_modulus_pa=gel.young_modulus_pa,
        friction=gel.friction_coefficient,
    )
    parameters = task.parameters.replace(
        gel=block,
        markers=task.parameters.markers.replace(
            columns=markers.columns,
            rows=markers.rows,
            pitch_mm=(markers.pitch_x_mm, markers.pitch_y_mm),
        ),
    )
    mesh = pad.mesh if isinstance(pad, MeshPad) else _under_face(pad_mesh(block), pad)
    return DesignTask(task.name, parameters, task.made_by, mesh)


def _under_face(block: TetMesh, pad: Pad) -> TetMesh:
    """The block with its columns as high as the contact face of ``pad`` over them."""
    middle = pad.bounds_mm()[:, :2].mean(axis=0)
    nodes_mm = 1e3 * block.nodes_m
    away = nodes_mm[:, :2]
    top = pad.top_mm(middle + away)
    for step in range(1, _MOST_INWARD):
        beside = ~np.isfinite(top)
        if not beside.any():
            break
        top[beside] = pad.top_mm(middle + _INWARD**step * away[beside])
    share = 1 + nodes_mm[:, 2] / pad.thickness_mm
    nodes_mm[:, 2] = share * (pad.thickness_mm + top) - pad.thickness_mm
    return TetMesh(1e-3 * nodes_mm, block.tets, block.faces, block.face_regions)
