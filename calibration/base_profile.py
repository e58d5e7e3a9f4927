# SPDX-License-Identifier: Apache-2.0
"""The profile that a calibration starts from, its pixel grid against that of the captures, and what
it keeps of how these were recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from taccel_lab.calibration.capture.captures import CaptureSet, check_place
from taccel_lab.calibration.capture.folder import CaptureFolder, source_of
from taccel_lab.calibration.pad import fitted_design, pixels_on_pad, require_view_on_pad
from taccel_lab.calibration.remarks import BLOCKS_DROPPED
from taccel_lab.errors import InputError, naming
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import CameraBlock, Provenance, SensorProfile
from taccel_lab.profile.schema import Session
from taccel_lab.report.remark import Remark
from taccel_lab.sensors.profile import catalogue_profile, load_sensor
from taccel_lab.sensors.profile_family import IMPORTED
from taccel_lab.sensors.registry import is_of_sensor, profile_folder
from taccel_lab.sensors.starters import is_starter

MEASURED = ("calibrated", "measured")
"""Kinds of blocks that say something about the unit at hand."""
FROM_CAPTURES = ("stated", "measured", "calibrated")
"""Kinds of blocks that rest on captures; the others are the catalogue's."""


def base_profile(base: SensorProfile | Path | str | None, folder: CaptureFolder) -> SensorProfile:
    """The profile to extend: given, in a profile folder, that which the captures name as their
    sensor, or the catalogue's design of the sensor, also by its name or in place of a starter.

    A design has the dimensions that the captures' ``[design]`` states, and takes their image size
    and scale where these state a scale.

    Raises:
        InputError: The profile is of another family than the captures, or has other dimensions
            than they state.
    """
    if str(base) == folder.sensor:
        base = None
    base = base or profile_folder(folder.sensor)
    if isinstance(base, SensorProfile) and is_starter(base):
        base = None  # Its blocks are of another unit: the design under them is what is known.
    if base is None:
        with naming(folder.source):
            if folder.mm_per_px is None or folder.background is None:
                return catalogue_profile(folder.sensor, folder.design)
            grid = folder.grid()
            design = fitted_design(folder.sensor, grid, folder.design)
            return on_grid(design, grid, folder.provenance, rectified=folder.rectified)
    profile = base if isinstance(base, SensorProfile) else load_sensor(str(base))
    if not is_of_sensor(profile, folder.sensor):
        name = "to extend" if isinstance(base, SensorProfile) else base
        raise InputError(
            f"the captures are of a {folder.sensor}, the profile {name} is of a "
            f"{profile.sensor.family}"
            + (", another gel" if profile.sensor.family == IMPORTED else "")
        )
    for key, value in folder.design.items():
        known = profile.sensor.parameters.get(key)
        if known != value:
            name = "to extend" if isinstance(base, SensorProfile) else base
            raise InputError(
                f"{folder.source} states {key} = {value} under [design], the profile {name} has "
                f"{'no such parameter' if known is None else known}; make the profile anew with "
                f"`taccel-lab design {folder.sensor} --set {key}={value}`, or take the line out"
            )
    return profile


def require_image_of(profile: SensorProfile, folder: CaptureFolder) -> None:
    """InputError where raw captures meet a profile whose pixel grid is that of rectified images."""
    if profile.camera.rectified and not folder.rectified:
        raise InputError(
            f"{folder.source}: these images are raw, the profile's pixel grid is that of rectified "
            "ones; rectify them with `taccel-lab capture rectify` and the maps of the profile's "
            "calibration; if they are rectified already, write rectified = true into "
            "captures.toml"
        )


def with_measured_scale(folder: CaptureFolder, profile: SensorProfile) -> CaptureFolder:
    """The captures with the scale that the profile's camera has measured on this unit, where they
    state none and are of its size; else as they are."""
    grid = measured_grid(folder, profile)
    if grid is None or folder.mm_per_px is not None:
        return folder
    return replace(folder, mm_per_px=(grid.mm_per_px_x, grid.mm_per_px_y))


def measured_grid(folder: CaptureFolder, profile: SensorProfile) -> PixelGrid | None:
    """The grid of the profile's camera, where that was measured on this unit and the background is
    of its size."""
    if folder.background is None or profile.camera.provenance.kind not in MEASURED:
        return None
    grid, shape = profile.grid(), folder.background.image().shape[:2]
    return grid if shape == (grid.height_px, grid.width_px) else None


def presses_on_camera(
    folder: CaptureFolder, base: SensorProfile
) -> tuple[CaptureSet, SensorProfile]:
    """Ball presses and profile on one pixel grid: ``measured_grid``, or else the one that the
    captures state."""
    require_image_of(base, folder)
    grid = measured_grid(folder, base)
    if grid is not None:
        captures = folder.ball_presses((grid.mm_per_px_x, grid.mm_per_px_y))
        return captures_on_pad(replace(captures, grid=grid), base), base
    captures = folder.ball_presses()
    profile = on_grid(base, captures.grid, captures.provenance, rectified=folder.rectified)
    return captures_on_pad(captures, profile), profile


def captures_on_pad(captures: CaptureSet, profile: SensorProfile) -> CaptureSet:
    """The captures with the pixels masked that the pad of ``profile`` does not cover."""
    mask = pixels_on_pad(profile, captures.grid, captures.mask)
    return replace(captures, mask=mask)


def require_labels_and_view(folder: CaptureFolder, base: SensorProfile, block: str) -> None:
    """Refuse, before any press is looked at, labels that no press can have and images that show too
    much beside the pad for ``block``.

    Raises:
        InputError: Says which, and what is allowed.
    """
    grid = measured_grid(folder, base)
    if grid is None:
        if folder.background is None or folder.mm_per_px is None:
            return  # Said of the captures as a whole.
        grid = folder.grid()
    for press in folder.presses:
        if press.circle is not None:
            check_place(press.circle, grid, press.source)
    require_view_on_pad(base, grid, folder.mask, folder.source, block)


def on_grid(
    profile: SensorProfile,
    grid: PixelGrid,
    provenance: Mapping[str, str],
    *,
    rectified: bool | None = None,
) -> SensorProfile:
    """The profile with the captures' image size and scale, of ``rectified`` images or raw ones
    where that is known; as it is where it has them."""
    if profile.camera.grid() == grid and rectified in (None, profile.camera.rectified):
        return profile
    return profile.without("background", "color", "normals", "force").with_block(
        CameraBlock.from_grid(
            grid,
            Provenance(
                kind="stated",
                method="image size and scale that the captures state; the image centre lies over "
                "the apex",
                source=source_of(provenance, "captures.toml"),
            ),
            bool(rectified),
        )
    )


def lost_blocks(before: SensorProfile, after: SensorProfile) -> list[Remark]:
    """Says which blocks of the profile do not fit the captures' image size and scale."""
    lost = [key for key in before.blocks() if key not in after.blocks()]
    if not lost:
        return []
    old, new = before.grid(), after.grid()
    return [
        BLOCKS_DROPPED(
            lost=", ".join(lost),
            old_width=old.width_px,
            old_height=old.height_px,
            old_x=old.mm_per_px_x,
            old_y=old.mm_per_px_y,
            width=new.width_px,
            height=new.height_px,
            x=new.mm_per_px_x,
            y=new.mm_per_px_y,
        )
    ]


def with_session(
    before: SensorProfile | None, after: SensorProfile, folder: CaptureFolder
) -> SensorProfile:
    """Profile ``after`` with what ``folder`` says of its recording for the blocks that come from
    it: those that differ from ``before`` (None: from the catalogue), whatever an earlier session
    said."""
    old = {} if before is None else before.blocks()
    new = tuple(
        key
        for key, block in after.blocks().items()
        if block.provenance.kind in FROM_CAPTURES and block != old.get(key)
    )
    sessions = []
    for session in after.sensor.recorded:
        left = tuple(key for key in session.blocks if key not in new)
        if left:
            sessions.append(session.model_copy(update={"blocks": left}))
    if folder.recorded is not None and new:
        stated = {**folder.recorded.model_dump(), "source": folder.provenance.get("source")}
        sessions.append(Session.model_validate({**stated, "blocks": new}))
    if tuple(sessions) == after.sensor.recorded:
        return after
    return after.with_block(after.sensor.replace(recorded=tuple(sessions)))
