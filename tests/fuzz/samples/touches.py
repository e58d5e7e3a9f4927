# SPDX-License-Identifier: Apache-2.0
"""Data sets of simulated touches: the file that asks for one, and one that was made."""

from __future__ import annotations

import shutil
import tempfile
from functools import lru_cache
from pathlib import Path

SPEC = (
    '[dataset]\nname = "Touches"\nepisodes = 6\nseed = 4\nview = 0.3\n\n'
    '[[sensors]]\nprofile = "flat_pad"\n\n'
    '[[objects]]\ntool = "sphere:2"\nweight = 2.0\n\n'
    '[[objects]]\ntool = "box:2x1"\nsplit = "test"\ntilt_deg = [0.0, 5.0]\n\n'
    '[[motions]]\nkind = "press"\ndepth_mm = [0.1, 0.4]\n\n'
    '[[motions]]\nkind = "slip"\ndepth_mm = [0.1, 0.2]\nshear_mm = [0.2, 0.4]\n\n'
    "[randomise]\nlight_gain = 0.05\nfriction = [0.3, 0.6]\n\n"
    "[output]\nepisodes_per_part = 2\nsize_px = [32, 24]\n"
)


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
