# SPDX-License-Identifier: Apache-2.0
"""The example learns, here for two updates, with warp, numpy, scipy, torch and gymnasium alone."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from tests.test_architecture import HEAVY

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "notebooks" / "ppo_peg_insertion.py"
SCRIPT = """
import runpy, sys
sys.modules.update(dict.fromkeys({absent!r}))  # None makes the import of a module fail.
import warp as wp
wp.config.log_level = wp.LOG_ERROR
sys.argv = ["ppo_peg_insertion.py", *{arguments!r}]
runpy.run_path({path!r}, run_name="__main__")
"""


def test_two_updates_on_a_bare_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    absent = [name for name in HEAVY if name not in ("warp", "torch", "scipy")]
    absent += ["pydantic", "rich", "tyro", "jinja2", "tomli_w", "safetensors", "PIL", "yaml"]
    arguments = "--envs 3 --updates 2 --steps 6 --judge 0 --randomised --output"
    code = SCRIPT.format(
        absent=absent, arguments=[*arguments.split(), str(tmp_path)], path=str(EXAMPLE)
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "update 2/2, 36 steps" in done.stdout
    curve = json.loads((tmp_path / "curve.json").read_text())
    assert curve["complete"] and curve["settings"]["envs"] == 3
    assert [row["env_steps"] for row in curve["rows"]] == [18, 36]
    assert (tmp_path / "policy.pt").stat().st_size > 10_000
    assert not (tmp_path / "curve.png").exists(), "there is no matplotlib to draw it"
    monkeypatch.setattr(sys, "argv", ["ppo_peg_insertion.py", "--draw", str(tmp_path)])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
