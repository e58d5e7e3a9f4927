# SPDX-License-Identifier: Apache-2.0
"""Robots by name: ours, of primitive shapes, and real ones of PyPI's example-robot-data.

Its meshes belong to others; they are read where they are installed, and never copied.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.guards import require_known
from taccel_lab.robots.robot import Robot
from taccel_lab.robots.urdf import load_urdf

PACKAGE = "example-robot-data"
_MODELS = Path(__file__).parent / "models"


@dataclass(frozen=True)
class RobotEntry:
    """A robot of the catalogue."""

    name: str
    summary: str
    file: str
    """URDF in ``models/``, or in the ``robots`` folder of example-robot-data."""
    ours: bool = False
    finish: Callable[[Robot], Robot] = lambda robot: robot
    """What is left to do when the file is read."""

    def path(self) -> Path:
        """The URDF file; InputError where example-robot-data is not installed."""
        return _MODELS / self.file if self.ours else _installed(self.name, self.file)


def _hand_of_panda(robot: Robot) -> Robot:
    return robot.part("panda_hand")


def _ur5(robot: Robot) -> Robot:
    # Surfaces that cross themselves; the base and wrist 1 do not.
    return robot.with_hulls(
        ["shoulder_link", "upper_arm_link", "forearm_link", "wrist_2_link", "wrist_3_link"]
    )


ENTRIES = (
    RobotEntry(
        "parallel_gripper",
        "two fingers on slides, 80 mm apart at most, the right one mimics the left one",
        "parallel_gripper.urdf",
        ours=True,
    ),
    RobotEntry(
        "three_finger_hand",
        "three fingers of three joints",
        "three_finger_hand.urdf",
        ours=True,
    ),
    RobotEntry(
        "panda",
        "Franka Emika's arm of seven joints with its hand",
        "panda_description/urdf/panda.urdf",
    ),
    RobotEntry(
        "panda_hand",
        "the hand of panda alone: two fingers on slides",
        "panda_description/urdf/panda.urdf",
        finish=_hand_of_panda,
    ),
    RobotEntry(
        "allegro_left",
        "Wonik's left hand: four fingers of four joints",
        "allegro_hand_description/urdf/allegro_left_hand.urdf",
    ),
    RobotEntry(
        "allegro_right",
        "Wonik's right hand",
        "allegro_hand_description/urdf/allegro_right_hand.urdf",
    ),
    RobotEntry(
        "ur5_gripper",
        "Universal Robots' arm of six joints; its gripper does not move",
        "ur_description/urdf/ur5_gripper.urdf",
        finish=_ur5,
    ),
)


def names() -> list[str]:
    """Names that ``named`` takes."""
    return [entry.name for entry in ENTRIES]


def named(name: str) -> Robot:
    """A robot of the catalogue.

    Five meshes of UR5 cross themselves: what is touched are their convex hulls.

    Raises InputError for another name, and where what it is read from is not installed.
    """
    require_known("robot", name, names(), "taccel-lab robot list")
    entry = ENTRIES[names().index(name)]
    return replace(entry.finish(load_urdf(entry.path())), name=name)


def _installed(name: str, file: str) -> Path:
    try:
        found = metadata.distribution(PACKAGE)
    except metadata.PackageNotFoundError:
        raise InputError(
            f"robot {name!r} is read from {PACKAGE}, which is not installed: "
            "pip install 'taccel-lab[robots]'"
        ) from None
    for part in found.files or ():
        if part.as_posix().endswith(f"{PACKAGE}/robots/{file}"):
            return Path(str(part.locate()))
    raise InputError(f"{PACKAGE} {found.version} has no {file}: another version may")
