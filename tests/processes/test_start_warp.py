# SPDX-License-Identifier: Apache-2.0
"""A script that never heard of Warp sees none of its lines, whatever it begins with."""

from __future__ import annotations

import subprocess
import sys

import pytest

BEGUN_WITH = {
    "a scene": "tl.Scene.from_profile(tl.load_sensor('flat_pad'), env_count=1).finalize('cpu')",
    "the optical model": (
        "p = tl.load_sensor('digit')\n"
        "tl.OpticalModel(p.optical_design(), p.mesh, size_px=(40, 30)).render()"
    ),
    "the resting face": (
        "from taccel_lab.signals.rest_surface import rest_surface\n"
        "p = tl.load_sensor('digit')\n"
        "rest_surface(p.mesh, p.grid())"
    ),
}


@pytest.mark.parametrize("script", BEGUN_WITH.values(), ids=BEGUN_WITH)
def test_a_script_sees_no_lines_of_warp(script: str) -> None:
    words = [sys.executable, "-c", f"import taccel_lab as tl\n{script}"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (done.stdout, done.stderr) == ("", "")
