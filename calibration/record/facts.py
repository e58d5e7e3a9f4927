# SPDX-License-Identifier: Apache-2.0
"""What a person states of a session, since no camera sees it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from taccel_lab.calibration.capture.camera.camera import CameraInfo, ControlLock
from taccel_lab.calibration.capture.guide import capture_plan
from taccel_lab.calibration.capture.importers.draft import require_lengths
from taccel_lab.calibration.capture.schema import MANIFEST_NAME
from taccel_lab.errors import InputError
from taccel_lab.sensors import sensor_family

QUICK_PRESSES = 20
QUICK_LEAVES_OUT = (
    "scale: no board, no edge and no ruler was pressed. What is stated or taken from the catalogue "
    "is believed; published figures for one and the same sensor differ by a quarter, and lengths, "
    "heights and forces scale with it",
    "lens: no board was shown, so that distortion stays in the images",
    "force: no load cell was there. The gel's modulus and friction stay those of the catalogue, "
    "and no image is turned into newtons",
    "presses: 20, not the 40 of a full session. Half of the image may have one press or none; "
    "colours and slopes there are less certain, and fewer presses are held out to say how much",
    "markers: no dots were followed, so that nothing tells how they move with the gel",
    "time: a few minutes. Drift over a session, and from one day to the next, is not seen",
)
"""What twenty presses of a ball, without a board and without a load cell, cannot tell."""
SAME_SHAPE = 0.02
"""Difference of two images' proportions up to which they count as of one framing."""

ScaleFrom = Literal["stated", "catalogue", "later"]


@dataclass(frozen=True)
class RecordFacts:
    """Facts of one session; what is None was not stated."""

    sensor: str
    radius_mm: float | None = None
    """Radius of the ball [mm]."""
    mm_per_px: tuple[float, float] | None = None
    """Scale along x and y [mm/px]."""
    scale: ScaleFrom = "stated"
    """``catalogue``: that of the sensor's family is taken, and noted as assumed; ``later``: it will
    be measured with an edge or a board, and is left open."""
    unit: str | None = None
    license: str | None = None
    quick: bool = False
    source: str = ""
    camera: CameraInfo | None = None
    locks: tuple[ControlLock, ...] = field(default=())
    framing: str = "whole images"

    def __post_init__(self) -> None:
        sensor_family(self.sensor)
        x, y = self.mm_per_px or (None, None)
        require_lengths(radius_mm=self.radius_mm, mm_per_px_x=x, mm_per_px_y=y)
        if self.mm_per_px is not None and self.scale != "stated":
            raise InputError(
                f"--mm-per-px-x states the scale, --scale {self.scale} leaves it open; give one"
            )

    def at(self, camera: CameraInfo, locks: list[ControlLock], framing: str) -> RecordFacts:
        """Facts with the camera that was opened."""
        return replace(self, camera=camera, locks=tuple(locks), framing=framing)

    def require_complete(self) -> None:
        """Name everything that is missing at once."""
        missing = []
        if self.radius_mm is None:
            plan = capture_plan(self.sensor)
            missing.append(
                "the ball's radius: --radius-mm, half of what callipers say (a ball of "
                f"{plan.ball_radius_mm:g} mm radius suits this sensor)"
            )
        if self.mm_per_px is None and self.scale == "stated":
            missing.append(
                "the scale: --mm-per-px-x where you have measured it, --scale catalogue to assume "
                "the usual one of this sensor, or --scale later to press an edge or a board"
            )
        if missing:
            raise InputError("not stated yet:\n" + "\n".join(f"  {line}" for line in missing))

    def require_same(self, manifest: Mapping[str, Any], path: Path) -> None:
        """Refuse to go on with a folder that was begun otherwise, naming all that differs."""
        if "recorded" not in manifest:
            raise InputError(
                f"{path} has a {MANIFEST_NAME} that taccel-lab capture record did not write; name "
                "a new folder"
            )
        begun = {
            "sensor": manifest["sensor"],
            "--radius-mm": manifest.get("indenter", {}).get("radius_mm"),
            "--mm-per-px-x": manifest.get("mm_per_px_x"),
            "--mm-per-px-y": manifest.get("mm_per_px_y"),
            "--unit": manifest.get("unit"),
        }
        x, y = self.mm_per_px or (None, None)
        sensor = sensor_family(self.sensor).name
        now = dict(zip(begun, (sensor, self.radius_mm, x, y, self.unit), strict=True))
        differing = [
            f"{key} was {begun[key]} and is {now[key]}"
            for key in begun
            if now[key] is not None and now[key] != begun[key]
        ]
        if differing:
            raise InputError(
                f"{path} was begun otherwise: {'; '.join(differing)}. Name a new folder, or give "
                "what it was begun with"
            )

    def manifest(self, width_px: int, height_px: int) -> dict[str, Any]:
        """Keys of the manifest for images of this size."""
        assert self.radius_mm is not None
        assert self.camera is not None
        found: dict[str, Any] = {"indenter": {"kind": "sphere", "radius_mm": self.radius_mm}}
        unit = self.unit or self.camera.serial
        if unit is not None:
            found["unit"] = unit
        scale = self.mm_per_px
        if self.scale == "catalogue":
            scale = self.catalogue_scale(width_px, height_px)
            found["assumed"] = {
                "mm_per_px": f"{scale[0]:.4g} mm/px, the usual one of the catalogue's {self.sensor}"
            }
        if scale is not None:
            found["mm_per_px_x"], found["mm_per_px_y"] = scale
        found["source"] = self.source or f"recorded from {self.camera.name}"
        found["license"] = self.license or "unknown"
        found["recorded"] = {
            "camera": self.camera.id,
            "begun": datetime.now(UTC).replace(microsecond=0),
            "controls": {lock.name: lock.text for lock in self.locks},
            "framing": self.framing,
            "left_out": list(QUICK_LEAVES_OUT) if self.quick else [],
        }
        return found

    def catalogue_scale(self, width_px: int, height_px: int) -> tuple[float, float]:
        """Scale of the family's usual view over images of this size [mm/px].

        Raises:
            InputError: The images have other proportions than the family's, so that they cannot
                show the same.
        """
        grid = sensor_family(self.sensor).parameters().grid()
        factor = grid.width_px / width_px

        def alike(width: int, height: int) -> bool:
            return abs(height * grid.width_px / width / grid.height_px - 1) <= SAME_SHAPE

        if not alike(width_px, height_px):
            advice = (
                "the camera is turned by a quarter: turn it back"
                if alike(height_px, width_px)
                else "cut them with --crop"
            )
            raise InputError(
                f"--scale catalogue: {self.sensor} has images of {grid.width_px}x{grid.height_px} "
                f"px, the camera's are {width_px}x{height_px} px and cannot show the same part of "
                f"the gel; {advice}, or state --mm-per-px-x"
            )
        return grid.mm_per_px_x * factor, grid.mm_per_px_y * grid.height_px / height_px

    def notes(self) -> tuple[str, ...]:
        """Comments for the head of the manifest."""
        if not self.quick:
            return ()
        return ("a quick session, which leaves out:", *(f"- {line}" for line in QUICK_LEAVES_OUT))
