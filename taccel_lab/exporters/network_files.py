# SPDX-License-Identifier: Apache-2.0
"""The networks of a profile as safetensors files that stand alone: weights, settings, formula."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.exporters.record import MAKERS, ExportRecord
from taccel_lab.files.atomic_file import write_by, write_json
from taccel_lab.profile import ColorBlock, ForceBlock, NormalsBlock, SensorProfile
from taccel_lab.signals.color_model import ColorModel

PEER = "safetensors 0.4 and later"
Network = tuple[ColorBlock | NormalsBlock | ForceBlock, Mapping[str, np.ndarray]]

COLOR_FORMULA = (
    "x = (inputs - input_mean) / input_scale, inputs in the order of `inputs`; u = 2 column / "
    "(width_px - 1) - 1, v = 2 row / (height_px - 1) - 1; normal: outward unit normal in the gel "
    "frame, turned back to a tilt of cone_deg where it leans further; displacement_mm: rise of the "
    "face over rest. After them, for k = 0 .. position_bands - 1: sin(2^k pi u), sin(2^k pi v), "
    "cos(2^k pi u), cos(2^k pi v), as they are. Each layer: x = activation(weight x + bias), the "
    "last without activation. change [levels of 255, RGB] = output_scale (f(pressed) - f(at "
    "rest)), at rest being the same pixel with its resting normal and displacement 0."
)
NORMAL_FORMULA = (
    "x = (features - input_mean) / input_scale, features in the order of `features`, of which "
    "sin_u_k is sin(2^k pi u); each member: x = silu(weight x + bias), the last layer without. "
    "tilt [rad] = the mean over the members of the first two outputs, minus the same for the pixel "
    "without change of colour; expected angle of error [rad] = sqrt((error_factor mean(exp(clip("
    "third output, -12, 2)) + 3.5e-4))^2 + spread of the members' tilts^2); 95 % of the errors lie "
    "below radius95_sigmas / sqrt(pi / 2) times that. The tilt turns the resting normal, leaning "
    "towards it."
)


FORCE_FORMULA = (
    "x = (image - background) / 32 levels, averaged over rows patch_px x columns patch_px equal "
    "parts, with planes u and v from -1 to 1; down<k>: x = silu(conv 3x3, stride 2, padding 1); "
    "block<k>: x = x + silu(conv 3x3, padding 1), block0 with three planes of markers, too, where "
    "markers is true; patch: 1x1, force by patch [N] = first three channels times patch_scale_n, "
    "area = sum of softplus of the fourth times target_scale[6]; hidden: features = silu(linear of "
    "means and maxima over patches); rest: linear of these, three corrections of the moment about "
    "the gel's origin [N mm] times target_scale[3:6], and logarithms of standard deviations over "
    "target_scale, clipped to -7..3, times sigma_factor. Forces and moments are for "
    "young_modulus_pa and proportional to it."
)
FORMULAS = {"color": COLOR_FORMULA, "normals": NORMAL_FORMULA, "force": FORCE_FORMULA}


def networks(profile: SensorProfile) -> dict[str, Network]:
    """Block and weights of each network that the profile has, by key; InputError when none."""
    found: dict[str, Network] = {}
    if profile.color is not None and profile.color_weights is not None:
        found["color"] = (profile.color, profile.color_weights)
    if profile.normals is not None and profile.normal_weights is not None:
        found["normals"] = (profile.normals, profile.normal_weights)
    if profile.force is not None and profile.force_weights is not None:
        found["force"] = (profile.force, profile.force_weights)
    if not found:
        raise InputError(
            f"the profile of {profile.sensor.name!r} has none of the blocks color, normals and "
            f"force, whose networks are exported; made by {MAKERS['color']}, {MAKERS['normals']}, "
            f"{MAKERS['force']}"
        )
    return found


def export_safetensors(profile: SensorProfile, folder: Path) -> ExportRecord:
    """Write the networks' safetensors files and ``models.json``."""
    from safetensors.numpy import save

    record = ExportRecord(
        notes=[
            "the header's metadata holds the settings as JSON (key architecture); models.json "
            "has them with the formula",
        ]
    )
    described: dict[str, dict[str, object]] = {}
    for key, (block, weights) in networks(profile).items():
        settings, name = block.architecture, block.file
        metadata = {
            "kind": key,
            "sensor": profile.sensor.name,
            "architecture": json.dumps(settings, sort_keys=True),
        }
        tensors = {item: np.ascontiguousarray(weights[item]) for item in sorted(weights)}
        (folder / name).write_bytes(save(tensors, metadata=metadata))
        described[key] = {
            "file": name,
            "architecture": settings,
            "formula": FORMULAS[key],
            "shapes": {item: list(tensor.shape) for item, tensor in tensors.items()},
        }
        colors = ColorModel.from_profile(profile) if key == "color" else None
        if colors is not None:
            described[key]["cone_deg"] = colors.cone_deg
        record.carries[key] = "all weights, unchanged"
    write_json(folder / "models.json", described)
    record.leave_out_missing(profile, "color", "normals", "force")
    if profile.background_rgb is not None:
        background = {"rgb": profile.background_rgb}
        write_by(folder / "background.npz", partial(np.savez_compressed, **background))
        record.carries["background"] = "as background.npz, unchanged"
    return record
