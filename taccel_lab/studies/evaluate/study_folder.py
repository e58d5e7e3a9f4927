# SPDX-License-Identifier: Apache-2.0
"""The folder of a study: grown design by design, never replaced as a whole, one run at a time.

::

    .taccel_lab_study     marks the folder, and is locked while a run works in it
    study.toml            the study file as last run
    designs.csv           the table, a row each design
    designs/ID/           result.json, picture and presses of a design
    meshes/, steps/       of each different pad
    report.html           and report.json, figures/

Each file appears whole or not at all, so that a run may be killed at any time.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import atomic_file, write_json
from taccel_lab.files.file_lock import hold
from taccel_lab.files.inner_path import inner_path, require_inner_files
from taccel_lab.files.output_folder import may_hold, require_growable
from taccel_lab.files.shard import Shard
from taccel_lab.studies.evaluate.design_row import DesignRow, read_row

STUDY_MARKER = ".taccel_lab_study"
"""A marker for studies: no other command takes the folder for an output that it may replace."""
RESULT = "result.json"


class StudyFolder:
    """Results of a study on disk."""

    def __init__(self, root: Path | str) -> None:
        self.root = Path(os.path.abspath(root))

    @property
    def designs(self) -> Path:
        return self.root / "designs"

    def design(self, design_id: str) -> Path:
        """Folder of one design."""
        return self.designs / design_id

    def require_usable(self) -> None:
        """Refuse a path with a file in the way, or a folder with files of somebody else."""
        if not may_hold(self.root, STUDY_MARKER):
            raise InputError(
                f"{self.root} holds files and no study; name a new folder, an empty one, or that "
                "of an earlier study to go on with it"
            )
        # Not those of submitit's jobs: it leaves links, which a study that was moved takes along.
        require_inner_files(self.root, levels=1)
        for name in ("designs", "figures", "meshes", "steps"):
            require_inner_files(self.root / name)
        if self.is_study() or not self.root.is_dir():
            # Not into an empty folder: a shard that begins there too would take it for foreign.
            require_growable(self.root)

    def is_study(self) -> bool:
        """Whether a study has been begun here."""
        return (self.root / STUDY_MARKER).is_file()

    @contextmanager
    def locked(self, shard: Shard | None = None) -> Iterator[None]:
        """Hold the folder, or a shard's part of it; raises InputError while another run does.

        Shards of one study share the folder. The lock ends with the process, so that a killed run
        leaves none behind.
        """
        self.require_usable()
        self.root.mkdir(parents=True, exist_ok=True)
        with open(self.root / STUDY_MARKER, "a+", encoding="utf-8") as marker:
            advice = "wait for its end or name another folder"
            shared = shard is not None
            hold(marker, f"another run works in {self.root}", advice, shared=shared)
            if shard is None:
                self._sweep_up()
                try:
                    yield
                finally:
                    # Processes that an error or Ctrl-C ended may have been writing.
                    self._sweep_up()
                return
            self.designs.mkdir(exist_ok=True)
            own = self.root / f".shard_{shard.number}_of_{shard.count}"
            with open(own, "a+", encoding="utf-8") as mine:
                busy = f"another run works in {self.root} at shard {shard.number}/{shard.count}"
                hold(mine, busy, "wait for its end")
                yield

    def _sweep_up(self) -> None:
        """Remove temporary files of processes that were ended while they wrote."""
        self.designs.mkdir(exist_ok=True)
        names = (".designs.*", ".report.*", "designs/*/.*", "figures/.*", "meshes/.*", "steps/.*")
        for pattern in names:
            for path in self.root.glob(pattern):
                if path.is_file():
                    path.unlink()

    def add_row(self, row: DesignRow) -> None:
        """Write the row of a design, its last file: with it the design counts as evaluated.

        What an earlier row knows besides stays.
        """
        earlier = self.read(row.id)
        row = row if earlier is None else earlier.merged(row)
        write_json(self.design(row.id) / RESULT, row.to_json())

    def read(self, design_id: str) -> DesignRow | None:
        """The row of a design; None for one that has not been evaluated."""
        path = inner_path(self.root, f"designs/{design_id}/{RESULT}")
        if not path.is_file():
            return None
        row = read_row(path)
        if row.id != design_id:
            raise InputError(f"{path} is that of another design, {row.id}")
        return row

    def ids(self) -> list[str]:
        """Of all designs that have a row, sorted."""
        if not self.designs.is_dir():
            return []
        return sorted(path.parent.name for path in self.designs.glob(f"[!.]*/{RESULT}"))

    def write_text(self, name: str, text: str) -> None:
        """Write a text file of the study."""
        with atomic_file(self.root / name) as staging:
            staging.write_text(text, encoding="utf-8", errors="backslashreplace")
            staging.chmod(0o644)
