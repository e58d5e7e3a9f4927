# SPDX-License-Identifier: Apache-2.0
"""Data sets of simulated touches: the file that asks for one, and one that was made."""

from __future__ import annotations

import shutil
import tempfile
from functools import lru_cache
from pathlib import Path

SPEC = """\
[dataset]
name = "Touches"
episodes = 6
seed = 4
view = 0.3

[[sensors]]
profile = "flat_pad"

[[objects]]
tool = "sphere:2"
weight = 2.0

[[objects]]
tool = "box:2x1"
split = "test"
tilt_deg = [0.0, 5.0]

[[motions]]
kind = "press"
depth_mm = [0.1, 0.4]

[[motions]]
kind = "slip"
depth_mm = [0.1, 0.2]
shear_mm = [0.2, 0.4]

[randomise]
light_gain = 0.05
friction = [0.3, 0.6]

[output]
episodes_per_part = 2
size_px = [32, 24]
"""


def file(given: Path) -> None:
    """What may be asked for."""
    (given / "touches.toml").write_text(SPEC)


def folder(given: Path) -> None:
    """Two touches, made once a process."""
    # Logs of runs are named by the time.
    shutil.copytree(_made(), given / "data", ignore=shutil.ignore_patterns("runs"))


@lru_cache(maxsize=1)
def _made() -> Path:
    from tests.support.small_data_sets import make, saved_profile

    root = Path(tempfile.mkdtemp(prefix="touches"))
    profile = saved_profile(root / "profile")
    make(profile, root / "data", dataset={"episodes": 2})
    return root / "data"
