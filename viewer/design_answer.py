# SPDX-License-Identifier: Apache-2.0
"""What a design page says of a design, piece by piece in the order in which it is known."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.cad.mesh.quality import MeshQuality, QualityGate, check_quality, measure_quality
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.geometry import TetMesh
from taccel_lab.optics.render import OpticalModel
from taccel_lab.viewer.design_press import (
    BallPress,
    PressAnswer,
    SupersededError,
    formula_force_n,
    press_ball,
    scaled,
)

if TYPE_CHECKING:
    from taccel_lab.sensors.base import FamilyParameters, SensorFamily

PICTURE_PX = 240
"""Longer side of the pictures of the page."""
DRAWING_PX = (1400, 990)
_KEPT = 16
"""Meshes, presses and pictures that are kept, so that sliders may go back and forth."""


@dataclass(frozen=True)
class Choice:
    """What the sliders say."""

    overrides: Mapping[str, Any]
    press: BallPress = field(default_factory=BallPress)


@dataclass
class Answer:
    """Filled from top to bottom; ``seconds`` has when each piece was known, since the change."""

    parameters: FamilyParameters
    press: BallPress
    """As deep as the gel allows."""
    formula_n: float = math.nan
    mesh: TetMesh | None = None
    quick: PressAnswer | None = None
    quality: MeshQuality | None = None
    refused: list[str] = field(default_factory=list)
    """Limits that the mesh breaks."""
    rest_rgb: np.ndarray | None = None
    pressed_rgb: np.ndarray | None = None
    drawing_rgb: np.ndarray | None = None
    exact: PressAnswer | None = None
    seconds: dict[str, float] = field(default_factory=dict)


class DesignAnswers:
    """Answers of one family; keeps what later answers can take over."""

    def __init__(self, family: SensorFamily) -> None:
        self.family = family
        self._meshes = lru_cache(_KEPT)(gel_mesh)
        self._qualities = lru_cache(_KEPT)(lambda pad: _quality(pad, self._meshes(pad)))
        self._drawings = lru_cache(_KEPT)(_drawing)
        self._presses: dict[Any, tuple[float, PressAnswer]] = {}
        self._pictures: dict[Any, np.ndarray] = {}

    def answer(
        self,
        choice: Choice,
        told: Callable[[str, Answer], None],
        superseded: Callable[[], bool] = lambda: False,
    ) -> Answer:
        """Work out everything; ``told(piece, answer)`` is called as soon as a piece is there:
        formula, solid, quick, quality, rest, pressed, drawing, exact.

        Raises:
            SupersededError: ``superseded`` said so between two pieces, or two steps of a press.
            InputError: Parameters that the family refuses, in its own words.
            SimulationError: A press that did not converge.
        """
        began = time.perf_counter()
        parameters = self.family.parameters(choice.overrides)
        pad = parameters.pad()
        found = Answer(parameters, choice.press.limited(pad.thickness_mm))

        def tell(piece: str) -> None:
            found.seconds[piece] = time.perf_counter() - began
            told(piece, found)
            if superseded():
                raise SupersededError

        found.formula_n = formula_force_n(parameters, found.press)
        tell("formula")
        found.mesh = self._meshes(pad)
        tell("solid")
        found.quick = self._press(found, True, superseded)
        tell("quick")
        found.quality, found.refused = self._qualities(pad)
        tell("quality")
        if parameters.optics() is not None:
            found.rest_rgb = self._picture(found, None)
            tell("rest")
            found.pressed_rgb = self._picture(found, found.quick)
            tell("pressed")
        found.drawing_rgb = self._drawings(self.family.name, pad)
        tell("drawing")
        found.exact = self._press(found, False, superseded)
        tell("exact")
        return found

    def _press(self, answer: Answer, quick: bool, superseded: Callable[[], bool]) -> PressAnswer:
        """A press; where all moduli are those of an earlier one times a factor, that one's."""
        layers = answer.parameters.layer_materials()
        modulus = layers[0].young_modulus_pa
        shape = tuple(
            replace(one, young_modulus_pa=one.young_modulus_pa / modulus, young_interval_pa=None)
            for one in layers
        )
        key = (repr(answer.parameters.pad()), shape, answer.press, quick)
        if key not in self._presses:
            made = press_ball(answer.parameters, answer.press, quick=quick, superseded=superseded)
            _keep(self._presses, key, (modulus, made))
        known, made = self._presses[key]
        return scaled(made, modulus / known)

    def _picture(self, answer: Answer, press: PressAnswer | None) -> np.ndarray:
        """What the camera sees, uint8 [height, width, 3], of the untouched gel or of a press."""
        design, markers = answer.parameters.optics(), answer.parameters.markers()
        assert design is not None and answer.mesh is not None
        pad = repr(answer.parameters.pad())
        # A press shapes the picture by its positions, which moduli together do not change.
        shape = None if press is None else press.positions_m.tobytes()
        key = (pad, repr(design), repr(markers), shape)
        if key not in self._pictures:
            mesh = answer.mesh if press is None else press.mesh
            size = design.camera.size_within(PICTURE_PX)
            model = OpticalModel(design, mesh, size_px=size, markers=markers)
            seen = model.render() if press is None else model.render(press.positions_m)
            _keep(self._pictures, key, seen.rgb)
        return self._pictures[key]


def _keep(kept: dict[Any, Any], key: Any, value: Any) -> None:
    """Add a value; the oldest goes."""
    kept[key] = value
    while len(kept) > _KEPT:
        del kept[next(iter(kept))]


def _drawing(name: str, pad: Pad) -> np.ndarray:
    """The dimensioned drawing of the gel, uint8 [height, width, 3]."""
    from PIL import Image

    from taccel_lab.cad.drawing.pad_drawing import write_pad_drawing
    from taccel_lab.cad.parts.pad_solid import labelled_solid

    with TemporaryDirectory() as folder:
        path = Path(folder) / "drawing.png"
        write_pad_drawing(labelled_solid(pad), [path], title=f"{name}: gel")
        with Image.open(path) as file:
            return np.asarray(file.convert("RGB").resize(DRAWING_PX))


def _quality(pad: Pad, mesh: TetMesh) -> tuple[MeshQuality, list[str]]:
    """Figures of a mesh, and the limits of the gate that it breaks, in words."""
    quality = measure_quality(mesh, pad)
    result = check_quality(mesh, quality, QualityGate())
    return quality, [violation.text for violation in result.violations]
