# SPDX-License-Identifier: Apache-2.0
"""The manifest ``captures.toml`` of a capture folder: what was pressed where, on which sensor.

``docs/captures.md`` explains the format with an example; ``load_captures`` reads it.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

MANIFEST_NAME = "captures.toml"
SCHEMA_VERSION = 1

MAX_MM_PER_PX = 1.0
MIN_MM_PER_PX = 1e-4

Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class SphereIndenter(_Strict):
    """A ball, the calibration target whose surface normals are known everywhere."""

    kind: Literal["sphere"] = "sphere"
    radius_mm: Finite = Field(gt=0.05, le=50.0)
    """Ball radius [mm], 0.05 to 50."""


class CircleEntry(_Strict):
    """Contact circle in the image; pixel (0, 0) is the centre of the top left pixel."""

    u_px: Finite
    """Column of the centre [px]."""
    v_px: Finite
    """Row of the centre [px]."""
    radius_px: Finite = Field(gt=0.0)
    """Radius of the circle in columns [px]."""


class PressEntry(_Strict):
    """One image of one press."""

    image: str = Field(min_length=1)
    """Image file, relative to the manifest."""
    name: str | None = Field(default=None, min_length=1)
    """Name used in reports; the file's stem when missing."""
    contact: CircleEntry | None = None
    """Contact circle when it is known; found in the image otherwise."""


class CaptureManifest(_Strict):
    """Contents of ``captures.toml``."""

    schema_version: Literal[1]
    sensor: str = Field(min_length=1, pattern=r"^[a-z0-9_]+$")
    """Sensor family in the catalogue, such as ``gelsight``."""
    background: str = Field(min_length=1)
    """Image of the untouched sensor, relative to the manifest."""
    mask: str | None = Field(default=None, min_length=1)
    """Grey image of the same size; pixels that are 0 are never used (dust, markers, frame)."""
    mm_per_px_x: Finite = Field(ge=MIN_MM_PER_PX, le=MAX_MM_PER_PX)
    """Scale along the image's rows [mm/px]."""
    mm_per_px_y: Finite = Field(ge=MIN_MM_PER_PX, le=MAX_MM_PER_PX)
    """Scale along the image's columns [mm/px]."""
    source: str | None = None
    """Where the captures come from, free text kept as provenance."""
    license: str | None = None
    """Licence of the captures, free text kept as provenance."""
    indenter: SphereIndenter
    presses: list[PressEntry] = Field(min_length=1)
