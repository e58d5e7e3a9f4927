# SPDX-License-Identifier: Apache-2.0
"""The image is made by commands that there are, on the Python whose versions are pinned, and tried
where a Docker daemon answers."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")
PYTHONS = {"bookworm": "3.11", "trixie": "3.13"}
"""Python of Debian's releases."""
DAEMON = """#!/bin/sh
echo "$@" >> "{calls}"
[ {answers} = yes ] || exit 1
for word; do case "$word" in *:/work) folder="${{word%:/work}}"; esac; done
[ "$1" != run ] || {{ mkdir "$folder/press"; echo "{{}}" > "$folder/press/press.json"; }}
"""


def test_the_image_runs_the_two_commands() -> None:
    stages = re.findall(r"^FROM (\S+)(?: AS (\w+))?$", DOCKERFILE, flags=re.MULTILINE)
    made = re.findall(r"^RUN make (\w+)", DOCKERFILE, flags=re.MULTILINE)
    assert made == ["demo", "test"]
    # Whoever builds without --target gets the demonstration's image.
    assert [name for name, _ in stages][1:] == ["demo", "demo"]
    for target in made:
        found = subprocess.run(["make", "-n", target], cwd=ROOT, capture_output=True, check=False)
        assert found.returncode == 0, found.stderr


def test_the_image_has_the_python_of_the_constraints() -> None:
    (release,) = re.findall(r"^FROM debian:(\w+)-slim", DOCKERFILE, flags=re.MULTILINE)
    assert f"Python {PYTHONS[release]}." in (ROOT / "constraints.txt").read_text()[:200]


@pytest.mark.parametrize("answers", ["yes", "no"])
def test_the_image_is_tried_where_a_daemon_answers(answers: str, tmp_path: Path) -> None:
    calls, docker = tmp_path / "calls", tmp_path / "docker"
    docker.write_text(DAEMON.format(calls=calls, answers=answers))
    docker.chmod(0o755)
    env = os.environ | {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        [ROOT / "tools" / "try_image.sh"], env=env, capture_output=True, text=True, check=True
    )
    asked = [line.split()[0] for line in calls.read_text().splitlines()]
    if answers == "yes":
        assert asked == ["info", "build", "run"] and done.stdout == "the image works\n"
    else:
        assert asked == ["info"] and "the image is not built" in done.stdout
