# SPDX-License-Identifier: Apache-2.0
"""A sensor profile in memory: validated blocks and the arrays they describe."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.profile.schema import (
    BackgroundBlock,
    Block,
    CameraBlock,
    ColorBlock,
    GelBlock,
    MaterialBlock,
    SensorBlock,
)

# Block key -> field of SensorProfile that holds the array(s) the block describes.
ARRAY_FIELDS = {"gel": "mesh", "background": "background_rgb", "color": "color_weights"}


@dataclass(frozen=True, eq=False)
class SensorProfile:
    """Everything that is known of one sensor. Pure data: no device arrays, no handles.

    Profiles never change; ``with_block`` and ``without`` return new ones. Image and weights are
    read-only copies of what was given.
    """

    sensor: SensorBlock
    gel: GelBlock
    material: MaterialBlock
    camera: CameraBlock
    mesh: TetMesh
    """The gel pad's mesh [m]."""
    background: BackgroundBlock | None = None
    background_rgb: np.ndarray | None = None
    """Image of the untouched sensor, RGB levels 0..255, uint8 or float32, shape [H, W, 3]."""
    color: ColorBlock | None = None
    color_weights: Mapping[str, np.ndarray] | None = None
    """Weights of the colour model by name; ``color.architecture`` says how they combine."""

    def __post_init__(self) -> None:
        self._check_mesh()
        self._check_background()
        self._check_weights()

    def grid(self) -> PixelGrid:
        """The pixel grid of the tactile image."""
        return self.camera.grid()

    def blocks(self) -> dict[str, Block]:
        """The blocks that are present, by key, in the order of the file."""
        keys = ("sensor", "gel", "material", "camera", "background", "color")
        return {key: getattr(self, key) for key in keys if getattr(self, key) is not None}

    def with_block(
        self,
        block: Block,
        arrays: TetMesh | np.ndarray | Mapping[str, np.ndarray] | None = None,
    ) -> SensorProfile:
        """Return a profile with ``block`` added or replaced.

        ``arrays`` is what the block describes: a TetMesh for a GelBlock, an RGB image for a
        BackgroundBlock, named weights for a ColorBlock, nothing for the others. A camera of
        another image size needs ``without("background", "color")`` first.
        """
        changes: dict[str, Any] = {block.key: block}
        if block.key in ARRAY_FIELDS:
            if arrays is None:
                raise InputError(
                    f"a {block.key} block needs its {ARRAY_FIELDS[block.key]}, got none"
                )
            changes[ARRAY_FIELDS[block.key]] = arrays
        elif arrays is not None:
            raise InputError(f"a {block.key} block takes no arrays")
        return dataclasses.replace(self, **changes)

    def without(self, *keys: Literal["background", "color"]) -> SensorProfile:
        """Return a profile that lacks the named optional blocks and their arrays."""
        changes: dict[str, Any] = {}
        for key in keys:
            if key not in ("background", "color"):
                raise InputError(f"a profile cannot lack {key!r}; optional: background, color")
            changes |= {key: None, ARRAY_FIELDS[key]: None}
        return dataclasses.replace(self, **changes)

    def _check_mesh(self) -> None:
        for name in ("node_count", "tet_count"):
            stated, found = getattr(self.gel, name), getattr(self.mesh, name)
            if stated != found:
                raise InputError(f"gel.{name} is {stated} but the mesh has {found}")

    def _check_background(self) -> None:
        if (self.background is None) != (self.background_rgb is None):
            raise InputError("a background block and its image come together; one is missing")
        if self.background_rgb is None:
            return
        image = np.array(self.background_rgb)
        expected = (self.camera.height_px, self.camera.width_px, 3)
        if image.shape != expected:
            raise InputError(
                f"the background has shape {list(image.shape)}, the camera block asks for "
                f"{list(expected)} (height, width, RGB)"
            )
        if image.dtype not in (np.uint8, np.float32):
            raise InputError(f"the background must be uint8 or float32, got {image.dtype}")
        if not np.isfinite(image).all():
            raise InputError("the background holds NaN or infinite values")
        if image.min() < 0 or image.max() > 255:
            raise InputError(
                f"the background must hold levels 0..255, found {image.min()}..{image.max()}"
            )
        image.setflags(write=False)
        object.__setattr__(self, "background_rgb", image)

    def _check_weights(self) -> None:
        if (self.color is None) != (self.color_weights is None):
            raise InputError("a color block and its weights come together; one is missing")
        if self.color_weights is None:
            return
        if not self.color_weights:
            raise InputError("the color model has no weights")
        weights = {}
        for name, value in self.color_weights.items():
            array = np.array(value)
            if array.dtype not in (np.float32, np.float64):
                raise InputError(
                    f"color weight {name!r} must be float32 or float64, got {array.dtype}"
                )
            if not np.isfinite(array).all():
                raise InputError(f"color weight {name!r} holds NaN or infinite values")
            array.setflags(write=False)
            weights[name] = array
        object.__setattr__(self, "color_weights", MappingProxyType(weights))
