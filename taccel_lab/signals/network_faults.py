# SPDX-License-Identifier: Apache-2.0
"""What keeps the networks of a profile from being built, before anybody asks them."""

from __future__ import annotations

from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.force_model import ForceModel
from taccel_lab.signals.normal_model import NormalModel

_NETWORKS = {"color": ColorModel, "normals": NormalModel, "force": ForceModel}


def network_faults(profile: SensorProfile) -> dict[str, str]:
    """Block: why its settings and weights make no network for the profile's camera."""
    faults = {}
    for key, network in _NETWORKS.items():
        if getattr(profile, key) is None:
            continue
        try:
            network.from_profile(profile)
        except InputError as fault:
            faults[key] = str(fault)
    return faults
