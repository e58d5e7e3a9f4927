# SPDX-License-Identifier: Apache-2.0
"""The files of a press: signals, pictures, deformed mesh, figures. Its image is in the profile's
calibrated colours, or as the optical design predicts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.camera.gel_camera import GelCamera, camera_of
from taccel_lab.files.atomic_file import eight_bit, write_by, write_image, write_json
from taccel_lab.geometry import Region
from taccel_lab.geometry.vtu import write_mesh_vtu
from taccel_lab.optics.render import OpticalModel
from taccel_lab.presses.outcome import PressOutcome
from taccel_lab.presses.states import MARKERS, STATES, PressMarkers, PressStates, write_states
from taccel_lab.processes.process_pool import Call
from taccel_lab.report.figures import (
    draw_contact_forces,
    draw_force_depth,
    draw_height_map,
    draw_image,
    draw_markers,
    draw_normals,
)
from taccel_lab.report.style import save_drawing
from taccel_lab.signals.dots import image_painter
from taccel_lab.version import __version__

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile

VIEWS = "views"
"""Folder with a folder for each further camera: what ``write_seen`` writes."""
PREDICTED_PX = 640
"""Longest side of the picture that the optical model predicts."""
STATES_PX = 320
"""Longest side of the pictures that the optical model predicts of all steps."""


@dataclass(frozen=True)
class PressImages:
    """Tactile images of a press as a camera shows it."""

    rgb: np.ndarray | None
    """Image of its end, levels; None where the profile has no colours."""
    frames: Sequence[np.ndarray] | None
    """Images at rest and after each step that was kept, levels; None where the optical model
    predicts them."""
    predicted: Callable[[], np.ndarray | None]
    """Returns, without colours, the picture that the optical model predicts, uint8, [height_px,
    width_px, 3], if the sensor has one and it is wanted."""


def write_press(
    folder: Path,
    outcome: PressOutcome,
    profile: SensorProfile,
    images: PressImages,
    about: Mapping[str, Any],
    call: Call,
) -> None:
    """Write arrays, pictures, the deformed mesh and ``press.json`` of a press.

    Args:
        folder: To write to; it exists.
        outcome: The press.
        profile: Of the sensor that was pressed.
        images: Those that are written; those of steps go into ``states.npz``, where the press kept
            its states.
        about: What the caller knows of the press, first in ``press.json``; ``indenter`` labels the
            curve of the force.
        call: Draws and compresses, see ``Beside``.
    """
    # First, so that another process draws while this one follows the light.
    _draw_loads(folder, outcome, about["indenter"], call)
    markers = write_seen(folder, outcome, profile, images, call)
    write_mesh_vtu(
        folder / "gel.vtu",
        outcome.mesh,
        positions_m=outcome.positions_m,
        point_data={
            "displacement_m": outcome.positions_m - outcome.mesh.nodes_m,
            "contact_force_n": outcome.contact_forces_n,
            "contact_pressure_pa": outcome.contact_pressures_pa,
            "von_mises_pa": outcome.von_mises_pa,
        },
    )
    if outcome.states is not None:
        _write_states(folder / STATES, outcome, outcome.states, profile, images.frames)
    write_json(
        folder / "press.json",
        {
            **about,
            "path": {
                "depth_mm": outcome.path.depth_mm,
                "shear_mm": outcome.path.shear_mm,
                "twist_deg": outcome.path.twist_deg,
            },
            "material": profile.material.model_dump(
                include={"young_modulus_pa", "poisson_ratio", "layers"}, exclude_defaults=True
            ),
            "mesh": {"node_count": outcome.mesh.node_count, "tet_count": outcome.mesh.tet_count},
            "physics": outcome.physics.record(),
            "press": outcome.figures(),
            "markers": None if markers is None else markers.figures(),
            "indenter_pose": outcome.indenter_pose,
            "tool_version": __version__,
        },
    )


def write_seen(
    folder: Path,
    outcome: PressOutcome,
    profile: SensorProfile,
    images: PressImages,
    call: Call,
) -> PressMarkers | None:
    """Write what a camera shows of a press: ``signals.npz``, its pictures and its dots, which are
    returned; arguments as of ``write_press``."""
    grid, rgb = profile.grid(), images.rgb
    call(save_drawing, folder / "height_map.png", draw_height_map, outcome.height_m, grid)
    call(save_drawing, folder / "normals.png", draw_normals, outcome.normals, grid)
    arrays: dict[str, Any] = {
        "height_m": outcome.height_m,
        "rest_height_m": outcome.rest_height_m,
        "normals": outcome.normals,
        "rest_normals": outcome.rest_normals,
        "contact_mask": outcome.contact_mask,
        "contact_forces_n": outcome.contact_forces_n,
        "contact_pressures_pa": outcome.contact_pressures_pa,
    }
    seen = None if rgb is None else eight_bit(rgb)
    if seen is not None:
        arrays["rgb"] = seen
    markers = PressMarkers.of(profile, outcome.mesh, outcome.positions_m[None])
    if markers is not None:
        arrays |= markers.arrays()
    # Before the light is followed: another process compresses meanwhile.
    call(write_by, folder / "signals.npz", partial(np.savez_compressed, **arrays))
    if rgb is not None:
        call(save_drawing, folder / "image.png", draw_image, rgb, grid)
        call(write_image, folder / "image_raw.png", rgb)
    else:
        seen = images.predicted()
        if seen is not None:
            call(write_image, folder / "predicted.png", seen)
    if markers is not None:
        markers.write_csv(folder / MARKERS)
        places = markers.image_px, markers.rest_px, markers.places_px[-1]
        call(save_drawing, folder / "markers.png", draw_markers, seen, *places)
    return markers


def _draw_loads(folder: Path, outcome: PressOutcome, label: str, call: Call) -> None:
    call(
        save_drawing,
        folder / "contact_pressure.png",
        draw_contact_forces,
        outcome.positions_m,
        outcome.mesh.region_faces(Region.CONTACT),
        outcome.contact_forces_n,
        outcome.contact_pressures_pa,
    )
    down = [s for s in outcome.steps if s.shear_mm == (0.0, 0.0) and s.twist_deg == 0.0]
    depth_mm = np.array([0.0] + [s.depth_mm for s in down])
    force_n = np.array([0.0] + [s.wrench[2] for s in down])
    # After a way back or a turn the error is that of another step than the curve's last.
    error_n = outcome.force_error_n if len(down) == len(outcome.steps) else math.nan
    if outcome.path.back:
        error_n = math.nan
    draw = partial(draw_force_depth, error_n=error_n)
    call(save_drawing, folder / "force_depth.png", draw, depth_mm, force_n, label)


def _write_states(
    path: Path,
    outcome: PressOutcome,
    states: PressStates,
    profile: SensorProfile,
    frames: Sequence[np.ndarray] | None,
) -> None:
    if frames is not None:
        images = np.stack([eight_bit(frame) for frame in frames])
    else:
        places = states.positions_m(outcome.mesh)
        predicted = predicted_images(profile, outcome, places, STATES_PX)
        images = None if predicted is None else np.stack(predicted)
    write_states(
        path,
        states,
        outcome.mesh,
        outcome.setup.indenter,
        profile,
        [step.depth_mm for step in outcome.steps],
        np.array([step.wrench[:3] for step in outcome.steps]),
        images,
    )


def painted_images(
    profile: SensorProfile, outcome: PressOutcome
) -> tuple[np.ndarray | None, list[np.ndarray] | None]:
    """The image of a press in the profile's colours, RGB levels, float32, [height_px, width_px, 3],
    and those at rest and after each step that was kept; None where colours or steps are missing."""
    paint = image_painter(profile, outcome.mesh)
    if paint is None:
        return None, None
    rgb = paint(outcome, outcome.positions_m)
    if outcome.states is None:
        return rgb, None
    rest, states = outcome.mesh.nodes_m, outcome.states
    seen = zip(states.surfaces, states.moved_m, strict=True)
    assert profile.background_rgb is not None
    return rgb, [profile.background_rgb, *(paint(one, rest + moved) for one, moved in seen)]


def predicted_images(
    profile: SensorProfile, outcome: PressOutcome, places_m: np.ndarray, longest_px: int
) -> list[np.ndarray] | None:
    """Pictures that the optical model of an uncalibrated sensor predicts, through its one camera.

    Args:
        profile: Of the sensor.
        outcome: Press whose mesh the places are of.
        places_m: Positions of its nodes [m], [state, node, 3].
        longest_px: Longest side of a picture.

    Returns:
        RGB levels, uint8, [height_px, width_px, 3] each; None where the sensor has no optics.
    """
    design, camera = profile.optical_design(), camera_of(profile)
    if design is None or not isinstance(camera, GelCamera):
        return None
    seen = camera.resized(*camera.camera.size_within(longest_px))
    markers = None if profile.markers is None else profile.markers.grid()
    model = OpticalModel.through(seen, design, outcome.mesh, markers=markers, designed=profile.mesh)
    return [model.render(places).rgb for places in places_m]


def predicted_image(profile: SensorProfile, outcome: PressOutcome) -> np.ndarray | None:
    """The picture of the end of a press, see ``predicted_images``."""
    pictures = predicted_images(profile, outcome, outcome.positions_m[None], PREDICTED_PX)
    return None if pictures is None else pictures[0]
