# SPDX-License-Identifier: Apache-2.0
"""How the blocks of a calibration ended, the profiles after them, and where both are kept until all
is done, so that the same call goes on after a kill.

The folder holds ``profile`` (usable as it is), ``basis`` where that differs (``Profiles``), the
report of each finished block and the maps of a rectification. It is written anew, whole, after each
block.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from taccel_lab.calibration.camera.rectification import RectificationMaps
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.result import BlockResult
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_json
from taccel_lab.files.documents import read_json
from taccel_lab.files.file_cache import content_key
from taccel_lab.files.output_folder import atomic_directory, remove_output, require_replaceable
from taccel_lab.profile import SensorProfile, load_profile, save_profile
from taccel_lab.report.page import Page, write_page
from taccel_lab.version import __version__

_STATE, _REPORT, _MAPS = "calibration.json", "report", "maps.npz"
_PROFILE, _BASIS = "profile", "basis"


def calibration_key(
    captures: CaptureFolder,
    base: SensorProfile,
    only: Sequence[str],
    options: Mapping[str, Any],
) -> str:
    """Stands for all that a calibration depends on: files of the captures by size and times, the
    base, what is requested, and this version."""
    files = {
        str(path.relative_to(captures.root)): _version(path)
        for path in sorted(captures.root.rglob("*"))
        if path.is_file()
    }
    # A design of the catalogue is made anew by each call: when is no part of it.
    blocks = {
        name: block.model_dump(mode="json", exclude={"provenance": {"created"}})
        for name, block in base.blocks().items()
    }
    return content_key(
        {
            "files": files,
            "base": blocks,
            "nodes": base.mesh.nodes_m,
            "only": list(only),
            "options": repr(sorted(options.items())),
            "version": __version__,
        }
    )


def _version(path: Path) -> list[int]:
    """What changes with a file. Its own time is set by who copies it, or by a clock that went
    back; the other one is the system's, of any change."""
    about = path.stat()
    return [about.st_size, about.st_mtime_ns, about.st_ctime_ns]


@dataclass
class UnfinishedCalibration:
    """Blocks that earlier calls and this one have finished."""

    folder: Path
    key: str
    outcomes: dict[str, BlockOutcome] = field(default_factory=dict)
    """Outcomes by name of the block, in order."""
    profiles: Profiles | None = None
    """Profiles after the last of them that gave one."""
    maps: RectificationMaps | None = None

    @classmethod
    def open(cls, folder: Path | str, key: str) -> UnfinishedCalibration:
        """What is kept of a calibration with this key; nothing of another one.

        Raises:
            InputError: The folder holds files that taccel-lab did not write.
        """
        folder = Path(folder)
        require_replaceable(folder)
        kept = cls(folder, key)
        try:
            state = read_json(folder / _STATE)
        except (InputError, FileNotFoundError):
            return kept
        if state.get("key") != key:
            return kept
        for name, item in state["blocks"].items():
            page = folder / _REPORT / name
            kept.outcomes[name] = BlockOutcome(
                name,
                BlockState(item["state"]),
                item["message"],
                item["seconds"],
                written=page if page.is_dir() else None,
            )
        if (folder / _PROFILE).is_dir():
            kept.profiles = Profiles.of(load_profile(folder / _PROFILE))
            if (folder / _BASIS).is_dir():
                kept.profiles = replace(kept.profiles, basis=load_profile(folder / _BASIS))
        if (folder / _MAPS).is_file():
            kept.maps = RectificationMaps.load(folder / _MAPS)
        return kept

    def add(
        self, outcome: BlockOutcome, profiles: Profiles, maps: RectificationMaps | None
    ) -> BlockOutcome:
        """Keep how a block ended, with its page, the profiles after it and the maps so far; returns
        the outcome with the place of its page."""
        written = None if outcome.page is None else self.folder / _REPORT / outcome.name
        kept = replace(outcome, written=written)
        self.outcomes[outcome.name], self.profiles, self.maps = kept, profiles, maps
        with atomic_directory(self.folder) as staging:
            for earlier in self.outcomes.values():
                place = staging / _REPORT / earlier.name
                if earlier is kept and outcome.page is not None:
                    write_page(outcome.page, place)
                elif earlier.written is not None:
                    shutil.copytree(earlier.written, place)
            save_profile(profiles.final, staging / _PROFILE)
            if profiles.basis is not profiles.final:
                save_profile(profiles.basis, staging / _BASIS)
            if maps is not None:
                maps.save(staging / _MAPS)
            blocks = {name: item.figures() for name, item in self.outcomes.items()}
            write_json(staging / _STATE, {"key": self.key, "blocks": blocks})
        return kept

    def remove(self) -> None:
        """Remove the folder: everything stands where it was asked for."""
        remove_output(self.folder)


@dataclass(frozen=True)
class Profiles:
    """The same object twice until a model is fitted to held-out presses, too."""

    basis: SensorProfile
    """Nothing in it has seen the presses that blocks hold out, which are the same ones."""
    final: SensorProfile

    @classmethod
    def of(cls, profile: SensorProfile) -> Profiles:
        """One that is both."""
        return cls(profile, profile)

    def after(self, result: BlockResult) -> Profiles:
        """Both with what a block found; errors of ``apply_to``."""
        scored, final = result.scored, result.apply_to(self.final)
        alike = self.basis is self.final and scored is result
        return Profiles(final if alike else scored.apply_to(self.basis), final)


class BlockState(StrEnum):
    """How the calibration of a block ended."""

    DONE = "done"
    SKIPPED = "skipped"
    """There are no captures for it."""
    BLOCKED = "blocked"
    """The check of the captures found that they cannot be used for it."""
    REFUSED = "refused"
    """The calibration found that they cannot."""


@dataclass(frozen=True)
class BlockOutcome:
    """How the calibration of one block ended."""

    name: str
    state: BlockState
    message: str
    """The verdict, or the reason why the block is as before."""
    seconds: float = 0.0
    page: Page | None = None
    """Report of a block that is done; pictures are drawn when it is written. None where an earlier
    run wrote it."""
    written: Path | None = None
    """Folder of the report where it has been written."""

    @property
    def is_unfit(self) -> bool:
        """Whether there are captures for the block and they cannot be used."""
        return self.state in (BlockState.BLOCKED, BlockState.REFUSED)

    def figures(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "name": self.name,
            "state": str(self.state),
            "message": self.message,
            "seconds": self.seconds,
        }
