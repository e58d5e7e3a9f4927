# SPDX-License-Identifier: Apache-2.0
"""What a session writes is a capture folder, at every moment, through kills and lost cameras."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.check import check_captures
from taccel_lab.calibration.record.folder import RecordFacts, open_record
from taccel_lab.calibration.record.session import Recorder, SessionStatus, run_session
from taccel_lab.errors import InputError
from tests.calibration.record.sessions import (
    FACTS,
    NOISY,
    UnpluggedCamera,
    Watching,
    replaying,
    source,
)
from tests.support.capture_sets import write_image


def recorded(path: Path, out: Path, wanted: int = 3, facts: RecordFacts = FACTS) -> SessionStatus:
    with open_record(out, facts) as folder:
        return run_session(Recorder(folder, facts, wanted), replaying(path), [])


@pytest.mark.thorough
def test_the_folder_is_one_that_checks_and_calibrations_read(tmp_path: Path) -> None:
    original = source(tmp_path / "set", 5)
    status = recorded(original, tmp_path / "out", 5)
    assert status.finished and status.taken == 5
    made, given = load_capture_folder(tmp_path / "out"), load_capture_folder(original)
    assert made.ball_radius_mm == given.ball_radius_mm and made.mm_per_px == given.mm_per_px
    assert made.heldout is not None and made.untouched
    for mine, theirs in zip(made.presses, given.presses, strict=True):
        apart = mine.image().astype(float) - theirs.image()
        assert apart.std() < 2 * NOISY.noise_levels  # the very press, and no frame on the way
    check = check_captures(made, fit_ball=False)
    assert all(frame.contact is not None for frame in check.frames)


@pytest.mark.thorough
def test_the_same_command_goes_on(tmp_path: Path) -> None:
    path, out = source(tmp_path / "set", 3), tmp_path / "out"
    with open_record(out, FACTS) as folder:
        watching = Watching({110: "finish"})
        run_session(Recorder(folder, FACTS, 3), replaying(path), [watching])
    before = [press.sha256 for press in load_capture_folder(out).presses]
    assert 0 < len(before) < 3
    status = recorded(path, out, 3, RecordFacts("flat_pad"))  # What is known need not be stated.
    after = load_capture_folder(out)
    assert status.finished and [p.sha256 for p in after.presses][: len(before)] == before
    assert len(after.untouched) >= 1  # The gel at the start of the second session.


@pytest.mark.thorough
def test_a_kill_at_any_moment_leaves_a_whole_folder(tmp_path: Path) -> None:
    path, out = source(tmp_path / "set", 3), tmp_path / "out"
    command = (
        "from pathlib import Path; from tests.calibration.record.test_session import recorded;"
        f"recorded(Path({str(path)!r}), Path({str(out)!r}))"
    )
    child = subprocess.Popen([sys.executable, "-c", command], cwd=Path.cwd())
    while len(list(out.glob("press_*.png"))) < 2 and child.poll() is None:
        time.sleep(0.002)
    child.kill()
    child.wait()
    written = len(list(out.glob("press_*.png")))
    there = len(load_capture_folder(out).presses)
    assert written >= 2 and there >= written - 1  # At most the frame in hand is lost.
    assert recorded(path, out).finished
    names = sorted(p.name for p in out.iterdir() if not p.name.startswith("untouched"))
    assert names == ["background.png", "captures.toml", *(f"press_{k:03d}.png" for k in range(3))]


@pytest.mark.thorough
def test_a_camera_may_go_and_come_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("taccel_lab.calibration.capture.camera.camera.AGAIN_S", 0.0)
    camera = UnpluggedCamera(source(tmp_path / "set", 3), lost_at=(30, 75, 120), drop_every=7)
    watching = Watching()
    with open_record(tmp_path / "out", FACTS) as folder:
        recorder = Recorder(folder, FACTS, 3)
        run_session(recorder, camera.open, [watching])
    assert camera.opened == 4
    gone = [status.prompt for status in watching.seen if "camera is gone" in status.prompt]
    assert len(gone) == 9 and "nothing is lost" in gone[0]  # the loss, and two refusals each
    assert len(load_capture_folder(tmp_path / "out").presses) >= 2


@pytest.mark.thorough
def test_take_undo_and_finish(tmp_path: Path) -> None:
    path = source(tmp_path / "set", 2)
    watching = Watching({47: "take", 55: "undo", 58: "finish"})  # Before it stands still.
    with open_record(tmp_path / "out", FACTS) as folder:
        run_session(Recorder(folder, FACTS, 5), replaying(path), [watching])
    counts = [status.taken for status in watching.seen]
    assert counts[46] == 0 and counts[47] == 1 and counts[-1] == 0
    assert watching.seen[-1].finished
    assert len(load_capture_folder(tmp_path / "out").presses) == counts[-1]


def test_all_missing_facts_are_named_at_once(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match=r"(?s)--radius-mm.*--mm-per-px-x.*--scale later"),
        open_record(tmp_path / "out", RecordFacts("gelsight_mini")),
    ):
        pass
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_folders_of_others_are_left_alone(tmp_path: Path) -> None:
    imported = source(tmp_path / "set", 2)
    with pytest.raises(InputError, match="did not write"), open_record(imported, FACTS):
        pass
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match=r"mine\.txt"), open_record(tmp_path / "notes", FACTS):
        pass
    recorded(imported, tmp_path / "out", 1)
    other = replace(FACTS, radius_mm=3.0)
    with pytest.raises(InputError, match="begun otherwise"), open_record(tmp_path / "out", other):
        pass
    with open_record(tmp_path / "out", FACTS), pytest.raises(InputError, match="another taccel"):
        with open_record(tmp_path / "out", FACTS):
            pass


@pytest.mark.thorough
def test_a_scale_of_the_catalogue_is_noted_as_assumed(tmp_path: Path) -> None:
    facts = RecordFacts("gelsight_mini", radius_mm=2.0, scale="catalogue", quick=True)
    recorded(source(tmp_path / "set", 1), tmp_path / "out", 1, facts)
    made = load_capture_folder(tmp_path / "out")
    assert made.mm_per_px is not None and "mm_per_px" in made.assumed
    text = (tmp_path / "out" / "captures.toml").read_text()
    assert text.startswith("# a quick session, which leaves out:") and "# - force" in text
    with pytest.raises(InputError, match="turned by a quarter: turn it back"):
        facts.catalogue_scale(240, 320)
    with pytest.raises(InputError, match="--crop"):
        facts.catalogue_scale(320, 320)


@pytest.mark.thorough
def test_images_that_cannot_have_the_catalogues_scale_leave_nothing(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    (tmp_path / "turned").mkdir()
    for k in range(80):
        image = rng.normal(90.0, 1.0, (320, 240, 3)).round().astype(np.uint8)
        write_image(tmp_path / "turned" / f"{k}.png", image)
    facts = RecordFacts("gelsight_mini", radius_mm=2.0, scale="catalogue", quick=True)
    watching, out = Watching(), tmp_path / "new" / "out"
    with pytest.raises(InputError, match="turned by a quarter"), open_record(out, facts) as folder:
        run_session(Recorder(folder, facts, 1), replaying(tmp_path / "turned"), [watching])
    assert watching.seen == [], "refused at the first frame"
    assert not (tmp_path / "new").exists()


@pytest.mark.thorough
def test_lamps_say_what_is_wrong(tmp_path: Path) -> None:
    path = source(tmp_path / "set", 2)
    image = load_capture_folder(path).presses[0].image().astype(float)
    bright = np.clip(2.2 * image, 0, 255).astype(np.uint8)
    write_image(path / "p00.png", bright)
    watching = Watching()
    with open_record(tmp_path / "out", FACTS) as folder:
        run_session(Recorder(folder, FACTS, 2), replaying(path), [watching])
    bad = {lamp.name for status in watching.seen for lamp in status.lamps if lamp.state == "bad"}
    assert {"saturation", "drift"} <= bad
    first = {lamp.name: lamp.state for lamp in watching.seen[50].lamps}
    assert first["saturation"] == "ok" and first["drift"] == "ok" and first["blur"] == "ok"


@pytest.mark.thorough
def test_other_sizes_are_refused(tmp_path: Path) -> None:
    recorded(source(tmp_path / "set", 1), tmp_path / "out", 1)
    wide = tmp_path / "wide"
    wide.mkdir()
    for k in range(20):
        write_image(wide / f"{k}.png", np.full((100, 200, 3), 90, np.uint8))
    with pytest.raises(InputError, match="200x100"), open_record(tmp_path / "out", FACTS) as folder:
        run_session(Recorder(folder, FACTS, 2), replaying(wide), [])
