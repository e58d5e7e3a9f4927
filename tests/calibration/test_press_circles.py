# SPDX-License-Identifier: Apache-2.0
"""Circles of a folder: found once for all blocks, held-out presses after their figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.ball_presses import ball_presses
from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.color.options import ColorOptions
from taccel_lab.calibration.normals.options import NormalOptions
from tests.support.synthetic_presses import (
    GRID,
    flat_profile,
    synthetic_captures,
    with_circles,
    without_check,
    write_captures,
)

SHIFT_PX = 2.0
"""By which all labels lie to the right."""


def test_blocks_share_circles_and_held_out_presses_are_chosen_as_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_check(monkeypatch)
    captures, _ = synthetic_captures(12)
    true = {press.name: press.circle for press in captures.presses if press.circle is not None}
    labels = [replace(c, u_px=c.u_px + SHIFT_PX) for c in true.values()]
    folder = load_capture_folder(
        write_captures(tmp_path / "captures", with_circles(captures, labels))
    )
    base = flat_profile(GRID)
    for_color = ball_presses(folder, base, "color", ColorOptions(), cache=False)
    for_normals = ball_presses(folder, base, "normals", NormalOptions(), cache=False)
    assert for_normals.shared is for_color.shared
    found = for_normals.shared.of_heldout
    assert set(found) == set(for_color.split.heldout_names)
    trained = {
        press.name: c
        for press, c in zip(for_color.training.presses, for_color.circles, strict=True)
    }
    off = [
        np.mean([circle.u_px - true[name].u_px for name, circle in circles.items()])
        for circles in (trained, found)
    ]
    # What the training presses say of all labels is taken off those of the held-out ones too.
    assert off[1] == pytest.approx(off[0], abs=0.3)
    assert abs(off[1]) < 0.5 * SHIFT_PX
    # Other choices are another set.
    as_given = NormalOptions(circles="labels")
    plain = ball_presses(folder, base, "normals", as_given, cache=False)
    assert plain.circles == [press.circle for press in plain.training.presses]
    assert plain.heldout is not None
    assert plain.shared.of_heldout == {p.name: p.circle for p in plain.heldout.presses}
