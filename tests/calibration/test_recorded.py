# SPDX-License-Identifier: Apache-2.0
"""A profile that was made from a recording says how it was recorded."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from taccel_lab.calibration.calibrate import calibrate
from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.record.facts import QUICK_LEAVES_OUT
from taccel_lab.calibration.record.folder import open_record
from taccel_lab.calibration.record.run import run_session
from taccel_lab.calibration.record.session import Recorder
from taccel_lab.calibration.report.profile_page import profile_page
from taccel_lab.profile import load_profile, save_profile
from tests.calibration.record.sessions import FACTS, Watching, replaying, source


def test_the_profile_and_its_page_say_how_captures_were_recorded(tmp_path: Path) -> None:
    path, out = source(tmp_path / "set", 2), tmp_path / "out"
    facts = replace(FACTS, quick=True, source="bench 2, by Ada")
    with open_record(out, facts) as folder:
        run_session(Recorder(folder, facts, 2), replaying(path), [Watching()])
    profile = calibrate(out, only=["background"]).profile
    save_profile(profile, tmp_path / "profile")
    (session,) = load_profile(tmp_path / "profile").sensor.recorded
    assert session.blocks == ("background",)
    assert session.camera == str(path) and session.source == "bench 2, by Ada"
    assert session.controls["exposure"] == "as it was recorded"
    assert session.left_out == QUICK_LEAVES_OUT
    assert session.begun and datetime.now(UTC) - session.begun < timedelta(minutes=5)

    page = profile_page(profile)
    (table,) = [table for table in page.tables if table.title == "Recordings"]
    told = {row[0]: row[1] for row in table.rows}
    assert told["camera"] == str(path) and told["blocks"] == "background"
    assert [row[1] for row in table.rows if row[0] == "left out"] == list(QUICK_LEAVES_OUT)

    # Another session's background takes the block over; what nobody recorded says nothing.
    both = session.model_copy(update={"blocks": ("background", "color")})
    older = profile.with_block(profile.sensor.replace(recorded=(both,)))
    assert load_capture_folder(path).recorded is None
    (left,) = calibrate(path, older, only=["background"]).profile.sensor.recorded
    assert left.blocks == ("color",) and left.camera == session.camera
