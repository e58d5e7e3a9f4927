# SPDX-License-Identifier: Apache-2.0
"""How the captures that blocks of a profile rest on were recorded, kept in the profile."""

from __future__ import annotations

from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.profile import SensorProfile
from taccel_lab.profile.schema import Session

FROM_CAPTURES = ("stated", "measured", "calibrated")
"""Kinds of blocks that rest on captures; the others are the catalogue's."""


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
