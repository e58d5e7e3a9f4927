# SPDX-License-Identifier: Apache-2.0
"""Commands that take long show a picture first: before a kernel is compiled or a solid is built."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

CODE = """
import sys
from taccel_lab.cli import console

say = console.say_first_look

def look(shown, picture):
    say(shown, picture)
    warp = sys.modules.get("warp")
    modules = warp._src.context.user_modules.values() if warp else ()
    print("LOADED", *(m.name for m in modules if m.execs))
    print("BUILT", *({"build123d", "OCP"} & set(sys.modules)))
    print("SIZE", picture.stat().st_size)
    raise KeyboardInterrupt

console.say_first_look = look
from taccel_lab.cli.app import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    "command",
    [
        ["press", "gelsight_mini", "--depth-mm", "0.5"],
        ["preview", "gelsight_mini"],
        ["design", "gelsight_mini"],
    ],
    ids=lambda words: words[0],
)
def test_a_picture_stands_before_anything_is_compiled_or_built(
    command: list[str], tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """In a fresh process, which is interrupted there: nothing is left then."""
    out = tmp_path / "deep" / "out"
    run = subprocess.run(
        [sys.executable, "-c", CODE, *command, "--out", str(out)],
        capture_output=True, text=True, check=False,
        env={**os.environ, "TACCEL_LAB_CACHE": str(tmp_path_factory.mktemp("cache"))},
    )  # fmt: skip
    assert run.returncode == 130, run.stderr
    lines = [line for line in run.stdout.splitlines() if line.split()[0].isupper()]
    assert lines[:2] == ["LOADED", "BUILT"]
    assert int(lines[2].split()[1]) > 20_000
    assert list(tmp_path.iterdir()) == []
    # The picture that was told of is still there.
    told = next(line for line in run.stderr.splitlines() if line.startswith("first look: "))
    assert Path(told.removeprefix("first look: ")).stat().st_size == int(lines[2].split()[1])
