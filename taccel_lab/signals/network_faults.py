# SPDX-License-Identifier: Apache-2.0
"""What keeps the networks of a profile from being built, before anybody asks them."""

from __future__ import annotations

from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.color_model import ColorModel, ColorModelConfig
from taccel_lab.signals.normal_model import NormalModel


def network_faults(profile: SensorProfile) -> dict[str, str]:
    """Block: why its settings and weights make no network for the profile's camera."""
    faults = {}
    for key in ("color", "normals"):
        if getattr(profile, key) is None:
            continue
        try:
            config = _model(profile, key).config
            size = (config.width_px, config.height_px)
            camera = (profile.camera.width_px, profile.camera.height_px)
            if size != camera:
                raise InputError(
                    f"the network is for images of {size[0]}x{size[1]} px, the camera block says "
                    f"{camera[0]}x{camera[1]} px"
                )
        except InputError as fault:
            faults[key] = str(fault)
    return faults


def _model(profile: SensorProfile, key: str) -> ColorModel | NormalModel:
    if key == "normals":
        return NormalModel.from_profile(profile)
    assert profile.color is not None and profile.color_weights is not None
    return ColorModel(ColorModelConfig.from_dict(profile.color.architecture), profile.color_weights)
