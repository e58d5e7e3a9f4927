# SPDX-License-Identifier: Apache-2.0
"""Which flat media a profile describes between its camera and the contact face."""

from __future__ import annotations

from taccel_lab.errors import InputError
from taccel_lab.optics.media import OUTSIDE_INDEX
from taccel_lab.optics.refraction import FlatMedia
from taccel_lab.profile import SensorProfile


def profile_media(profile: SensorProfile) -> FlatMedia:
    """Window and gel before the contact face z = 0, seen from the air.

    Raises:
        InputError: The profile has no optics, or a domed window.
    """
    if profile.optics is None:
        raise InputError(
            "the profile has no optics block, so that what the camera looks through is unknown; "
            "give --refraction none"
        )
    back = -profile.gel.thickness_mm
    planes, indices = [back], [OUTSIDE_INDEX, profile.optics.gel_refractive_index]
    window = profile.window
    if window is not None:
        if window.shape != "plate":
            raise InputError(
                "refraction at a domed window is not modelled for boards; give --refraction none"
            )
        planes.insert(0, back - window.thickness_mm)
        indices.insert(1, window.refractive_index)
    return FlatMedia(tuple(planes), tuple(indices))
