# SPDX-License-Identifier: Apache-2.0
"""The press whose simulated image reads as a photo does.

What one reading of a photo says of place and depth is off by what readings are off by. So the press
is simulated roughly there, its image is read like the photo, and place and depth are corrected by
the difference, until that is small beside what the photo leaves open.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.api.press_photo import PressPhoto
from taccel_lab.presses import PHYSICS, Accuracy
from taccel_lab.presses.touch import check_depth

if TYPE_CHECKING:
    from taccel_lab.api.press_result import Press
    from taccel_lab.api.press_run import PressPlan

TRIALS = 3
"""Rough presses at most. One leaves a tenth to a third of what a reading is off by."""
SETTLED = 0.25
"""Share of the standard deviation; a correction below it leaves a tenth of one."""
UNREAD = (
    "the simulated press is too shallow to be read as the photo is: place and depth are those of "
    "the photo's reading, which nothing corrects"
)


def like_photo(plan: PressPlan, simulate: Callable[[PressPlan], Press]) -> PressPlan:
    """Return the plan with place and depth that its simulated image reads as its photo's.

    Args:
        plan: Place and depth as read in its photo.
        simulate: Presses a plan.

    Raises:
        InputError: A corrected place or depth that the gel does not allow.
        SimulationError: A rough press did not converge.
    """
    photo = plan.photo
    assert photo is not None
    for _ in range(TRIALS):
        options = plan.options
        assert options.depth_mm is not None
        image = simulate(_rough(plan)).image
        assert image is not None
        found = photo.beside(image, options.at_mm, options.depth_mm)
        if found is None:
            unread = replace(photo, warnings=(*photo.warnings, UNREAD))
            return replace(plan, photo=unread)
        check_depth(found.depth_mm, plan.profile)
        settled = _settled(plan, found)
        moved = replace(options, at_mm=found.at_mm, depth_mm=found.depth_mm)
        plan = replace(plan, options=moved, photo=found)
        if settled:
            break
    return plan


def _rough(plan: PressPlan) -> PressPlan:
    """A press for its image: the end of the same way in, of low accuracy."""
    physics = replace(PHYSICS[Accuracy.FAST], element=plan.physics.element)
    options = replace(
        plan.options, like=None, accuracy=Accuracy.FAST, unload=False, hold_s=0.0, states=False
    )
    return replace(plan, options=options, physics=physics, photo=None, is_rough=True)


def _settled(plan: PressPlan, found: PressPhoto) -> bool:
    """Whether a correction is small; never where no deviation is known."""
    if found.at_sigma_mm is None or found.depth_sigma_mm is None:
        return False
    options = plan.options
    assert options.depth_mm is not None
    moved = np.array([*found.at_mm, found.depth_mm]) - [*options.at_mm, options.depth_mm]
    return bool(
        (np.abs(moved) < SETTLED * np.array([*found.at_sigma_mm, found.depth_sigma_mm])).all()
    )
