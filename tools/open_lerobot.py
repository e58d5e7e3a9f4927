# SPDX-License-Identifier: Apache-2.0
"""Open a LeRobot export with lerobot's own class and compare it with the data set it was made of.

    python tools/open_lerobot.py DATASET EXPORT [--fps 10] [--python PATH]

EXPORT is what ``taccel-lab dataset export lerobot`` made of the folder DATASET. lerobot brings an
OpenCV that overwrites ours: it is never installed beside this package. PATH is the Python of an
environment that has it; without one, an environment is made in a temporary folder (some gigabytes).
A line a check; exit code 1 where one differs.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

LEROBOT = "lerobot>=0.4,<0.5"  # Of the layout v3.0.


def compared(dataset: Any, expected: Mapping[str, np.ndarray]) -> dict[str, str]:
    """What differs by check, "" where nothing does. ``dataset``: a LeRobotDataset."""
    count = len(expected["episode"])
    sizes = {
        "fps": (dataset.fps, int(expected["fps"])),
        "frames in all": (len(dataset), count),
        "episodes": (dataset.num_episodes, len(np.unique(expected["episode"]))),
    }
    found = {n: "" if one == two else f"{one}, not {two}" for n, (one, two) in sizes.items()}
    if found["frames in all"]:
        return found
    items = [dataset[index] for index in range(count)]

    def column(name: str) -> np.ndarray:
        return np.stack([np.asarray(item[name]) for item in items])

    # As torch has them: channels first, 0 to 1.
    frames = np.rint(255 * column("observation.images.tactile").transpose(0, 2, 3, 1))
    times = expected["step"] / float(expected["fps"])
    for name, values, wanted, off in (
        ("frames", frames, expected["rgb"], 0.0),
        ("states", column("observation.state"), expected["state"], 1e-6),
        ("actions", column("action"), expected["action"], 1e-6),
        ("times", column("timestamp").reshape(-1), times, 1e-6),
        ("episode of each frame", column("episode_index").reshape(-1), expected["episode"], 0.0),
    ):
        found[name] = _differs(values, wanted, off)
    tasks = [str(item["task"]) for item in items]
    wrong = sum(one != other for one, other in zip(tasks, expected["task"], strict=True))
    return found | {"tasks": f"{wrong} of {count} are others" if wrong else ""}


def _differs(found: np.ndarray, wanted: np.ndarray, off: float) -> str:
    if found.shape != wanted.shape:
        return f"shape {found.shape}, not {wanted.shape}"
    most = float(np.abs(found.astype(np.float64) - wanted).max())
    return "" if most <= off else f"by up to {most:.3g}"


def exported(folder: Path, fps: int) -> dict[str, np.ndarray]:
    """What the export has to say, read from the data set."""
    from taccel_lab.datasets.reading import Dataset

    data = Dataset(folder)
    places = [place for place, row in enumerate(data.episodes) if row["rows"]]
    rows = [np.asarray(data.rows_of(place)) for place in places]
    about = [data.episodes[place] for place in places]
    every, counts = np.concatenate(rows), [len(one) for one in rows]
    state = [data.read("command", one).astype(np.float32) for one in rows]
    tasks = [f"{row['motion']} {row['object']} on {row['sensor']}" for row in about]
    return {
        "fps": np.array(fps),
        "rgb": data.read("rgb", every),
        "state": np.concatenate(state),
        "action": np.concatenate([np.concatenate([one[1:], one[-1:]]) for one in state]),
        "step": np.concatenate([np.arange(count) for count in counts]),
        "episode": np.repeat(np.arange(len(rows)), counts),
        "task": np.repeat(tasks, counts),
    }


def look(export: Path, stored: Path) -> int:
    """In the environment that has lerobot."""
    from lerobot.datasets import lerobot_dataset as lerobot  # pyright: ignore[reportMissingImports]

    differences = compared(lerobot.LeRobotDataset("a/b", root=export), dict(np.load(stored)))
    for name, what in differences.items():
        sys.stdout.write(f"{name}: {f'differs, {what}' if what else 'same'}\n")
    return int(any(differences.values()))


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folders", nargs=2, type=Path, metavar=("DATASET", "EXPORT"))
    parser.add_argument("--fps", type=int, default=10, help="frames a second of the export")
    parser.add_argument("--python", default="", help="Python of an environment that has lerobot")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args(words)
    first, export = given.folders
    if given.inside:
        return look(export, first)
    with tempfile.TemporaryDirectory() as scratch:
        python, stored = given.python, Path(scratch) / "expected.npz"
        if not python:
            python = str(Path(scratch) / "venv" / "bin" / "python")
            subprocess.run([sys.executable, "-m", "venv", Path(scratch) / "venv"], check=True)
            subprocess.run([python, "-m", "pip", "install", "-q", LEROBOT], check=True)
        np.savez(stored, **exported(first, given.fps))  # type: ignore[arg-type]
        command = [python, __file__, "--inside", str(stored), str(export.resolve())]
        return subprocess.run(command).returncode


if __name__ == "__main__":
    sys.exit(main())
