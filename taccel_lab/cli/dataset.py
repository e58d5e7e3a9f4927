# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab dataset``: make labelled data sets of simulated touches, check and export them."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from taccel_lab.errors import InputError, SimulationError, keeping, naming

if TYPE_CHECKING:
    import numpy as np

    from taccel_lab.datasets.plan import DatasetPlan
    from taccel_lab.datasets.runner import DatasetOutcome
    from taccel_lab.files.shard import Shard

LONG_DRAW = 20_000
"""Episodes whose drawing is announced: it takes a second."""


@dataclass(frozen=True)
class DatasetMake:
    """Simulate the touches of a file and write images, markers, forces and other channels.

    The file names sensors, objects, motions, variations and channels (docs/datasets.md). The same
    command continues a stopped run. Any number of processes or machines can make shards, in one
    folder or in one each: --shard 3/8, or from SLURM --shard $SLURM_ARRAY_TASK_ID/8 (--array=1-8),
    one process a GPU. The files do not depend on shards or processes; on the CPU they are equal to
    the byte.

    Example: taccel-lab dataset mini_touches --out out/mini
    """

    spec: Positional[Path]
    """File of the data set (TOML), or the name of an example."""
    out: Path | None = None
    """Folder of the data set, new or begun. Default: out/NAME-OF-THE-FILE."""
    shard: str = "1/1"
    """Which part of the work, i/n from 1."""
    device: str = "cpu"
    """Device of the solver: cpu or cuda:0."""
    processes: int | None = None
    """Number of processes, 0 for this one alone. Default: one a core, or this one for a GPU."""
    limit: int | None = None
    """Stop after this number of parts; a later run continues."""
    check_only: bool = False
    """Read and check everything, say what would be made, and stop."""
    write: bool = True
    """--no-write simulates and draws, but writes no data: to time it. Needs no zarr."""
    json: bool = False
    """Print images a second and what else was measured as JSON."""

    def run(self) -> None:
        from taccel_lab.cli.console import notes, working
        from taccel_lab.datasets.folder import ABOUT, DatasetFolder
        from taccel_lab.datasets.plan import DatasetPlan
        from taccel_lab.datasets.spec import load_spec
        from taccel_lab.files.inner_path import file_or_example, real_path
        from taccel_lab.files.shard import Shard
        from taccel_lab.model.launches import require_device
        from taccel_lab.printable import counted
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.progress import stage_progress

        start_warp()
        console = notes()
        shard = Shard.parse(self.shard)
        for name in ("limit", "processes"):
            value, least = getattr(self, name), 1 if name == "limit" else 0
            if value is not None and not least <= value <= 1024**2:
                raise InputError(f"{name} must be at least {least}, got {value}")
        require_device(self.device)
        file = file_or_example(self.spec, "datasets")
        if self.write and not self.check_only:
            _require_zarr()
        with working(console, "reading sensors and objects"):
            with naming(file):
                plan = DatasetPlan(load_spec(file), real_path(file).parent)
        if plan.spec.dataset.episodes >= LONG_DRAW:
            with stage_progress(console) as progress:
                plan.group(progress)
        _describe(plan, shard)
        if self.check_only:
            return
        root = self.out or Path("out") / file.stem

        def what() -> str:
            if not (self.write and (root / ABOUT).is_file()):
                return ""
            there = {path.name for path in DatasetFolder(root).part_folders()}
            parts = plan.shard(shard.number, shard.count)
            count = sum(part.name in there for part in parts)
            return (
                f"{count} of {counted(len(parts), 'part')} finished and kept in {root}, others are "
                f"made anew; go on with: {self._again(root)}"
            )

        with keeping(what):
            outcome = self._make(plan, file, root if self.write else None, shard)
        self._conclude(outcome, root)

    def _make(
        self, plan: DatasetPlan, file: Path, root: Path | None, shard: Shard
    ) -> DatasetOutcome:
        from taccel_lab.cli.console import notes, say
        from taccel_lab.datasets.runner import make_dataset
        from taccel_lab.files.documents import TOML_LIMIT_BYTES
        from taccel_lab.files.regular_file import read_text
        from taccel_lab.progress import stage_progress

        with stage_progress(notes()) as progress:
            return make_dataset(
                plan,
                root,
                source=read_text(file, TOML_LIMIT_BYTES, "the file of a data set"),
                shard=(shard.number, shard.count),
                device=self.device,
                processes=self.processes,
                limit=self.limit,
                listener=lambda done, total, steps, seconds: progress(
                    f"parts ({steps / seconds:.2f} images/s)" if steps else "parts", done, total
                ),
                say=say,
            )

    def _conclude(self, outcome: DatasetOutcome, root: Path) -> None:
        from taccel_lab.cli.console import print_json, say

        record = outcome.record()
        if self.json:
            print_json(record)
        text = (
            f"{record['images']} images of {record['episodes']} touches in "
            f"{record['seconds']:.1f} s: {record['images_per_s']:.2f} images/s on {self.device}"
        )
        if record["written"]:
            text += f", {record['bytes'] / 1e6:.1f} MB"
        if record["episodes_stopped"]:
            text += (
                f"; {record['episodes_stopped']} touches stopped early, causes in episodes.parquet"
            )
        say(text)
        if outcome.root is not None:
            say(f"data set: {root}")
            if not outcome.complete:
                say(f"not finished; go on with:\n  {self._again(root)}")
        if outcome.done and outcome.steps <= record["episodes"]:
            raise SimulationError("no touch has a converged step; see cause in episodes.parquet")

    def _again(self, root: Path) -> str:
        words = ["taccel-lab", "dataset", str(self.spec), "--out", str(root)]
        words += ["--shard", self.shard] if self.shard != "1/1" else []
        words += ["--device", self.device] if self.device != "cpu" else []
        words += [] if self.processes is None else ["--processes", str(self.processes)]
        return shlex.join(words)


@dataclass(frozen=True)
class DatasetCheck:
    """Check files against their digests, and find empty, constant and NaN columns.

    Exit code 1: something is broken; warnings alone leave 0. Several folders are checked as shards
    of one data set.
    """

    folders: Positional[tuple[Path, ...]]
    """Folders of data sets."""
    json: bool = False
    """Print the findings as JSON."""

    def run(self) -> None:
        from taccel_lab.cli.console import notes, print_json, say
        from taccel_lab.datasets.check import check_dataset
        from taccel_lab.progress import stage_progress

        with stage_progress(notes()) as progress:
            findings = check_dataset(_some(self.folders), progress)
        if self.json:
            print_json([vars(finding) for finding in findings])
        for finding in () if self.json else findings:
            say(f"{finding.severity}: {finding}")
        errors = sum(finding.severity == "error" for finding in findings)
        say(f"{errors} errors, {len(findings) - errors} warnings")
        if errors:
            raise SystemExit(1)


@dataclass(frozen=True)
class DatasetExport:
    """Write a data set for other projects: as LeRobotDataset v3.0, or with UniVTAC's HDF5 names."""

    format: Positional[Literal["lerobot", "univtac"]]
    """Whose layout."""
    folders: Positional[tuple[Path, ...]]
    """Folders of data sets."""
    out: Path
    """Folder to write; an earlier one is replaced when everything is done."""
    fps: int = 10
    """Nominal frames a second for lerobot; touches have no time scale."""
    json: bool = False
    """Print what was written as JSON."""

    def run(self) -> None:
        from taccel_lab.cli.console import print_json, say
        from taccel_lab.datasets import exports

        folders = _some(self.folders)
        if not 1 <= self.fps <= 1000:
            raise InputError(f"fps must lie in 1..1000, got {self.fps}")
        if self.format == "lerobot":
            info = exports.export_lerobot(folders, self.out, self.fps)
            count, left_out = info["total_episodes"], exports.LEROBOT_LEFT_OUT
        else:
            count = exports.export_univtac(folders, self.out)
            left_out = exports.UNIVTAC_LEFT_OUT
        if self.json:
            print_json({"out": self.out, "episodes": count, "left_out": left_out})
        say(f"wrote {count} episodes to {self.out}")
        say(f"not exported: {left_out}")


@dataclass(frozen=True)
class DatasetChannels:
    """List the channels: what is always kept, and what output.channels of a file may name."""

    json: bool = False
    """Print JSON instead of tables."""

    def run(self) -> None:
        from taccel_lab.cli.console import print_json, print_table
        from taccel_lab.datasets.channels import ALWAYS, FAULTS, channels_of, known_channels

        asked = channels_of(tuple(known_channels()))[len(ALWAYS) :]
        labels = tuple(FAULTS.values())
        tables = (("always", ALWAYS), ("output.channels", asked), ("with [faults]", labels))
        if self.json:
            names = ("name", "dtype", "shape", "unit", "what")
            print_json({
                title: [{name: getattr(c, name) for name in names} for c in channels]
                for title, channels in tables
            })  # fmt: skip
            return
        for title, channels in tables:
            rows = [
                (c.name, f"{c.dtype} [{c.shape}]" if c.shape else c.dtype, c.unit, c.what)
                for c in channels
            ]
            print_table(("channel", "of a step", "unit", "what"), rows, title)


@dataclass(frozen=True)
class DatasetFaults:
    """Show each fault that [faults] of a data set's file, or of a task, gives to frames of yours.

    Writes report.html with every fault on the last frame, what was drawn, and what the judge of
    frames makes of it that readers ask.

    Example: taccel-lab dataset faults rest.png press.png --out out/faults
    """

    frames: Positional[tuple[Path, ...]]
    """Two images of a sensor or more, of one size, in their order, the untouched gel first."""
    out: Path
    """Folder to write; an earlier one is replaced when everything is done."""
    spec: Path | None = None
    """File of a data set, or an example's name, whose ranges are drawn from. Default: stock."""
    seed: int = 0
    """Which examples."""
    json: bool = False
    """Print what was drawn as JSON."""

    def run(self) -> None:
        import numpy as np

        from taccel_lab.cli.console import print_json, say
        from taccel_lab.datasets.faults_page import faults_page
        from taccel_lab.datasets.spec import load_spec
        from taccel_lab.files.images import read_image
        from taccel_lab.files.inner_path import file_or_example
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.reading.common_gain import common_gain
        from taccel_lab.reading.light import fit_light
        from taccel_lab.reading.whole_frame import broken_frame
        from taccel_lab.report.page import PAGE, write_page
        from taccel_lab.signals.frame_faults import FrameFaults

        start_warp()
        require_replaceable(self.out)
        if not 0 <= self.seed < 2**31:
            raise InputError(f"seed must lie in 0..{2**31 - 1}, got {self.seed}")
        faults = FrameFaults()
        if self.spec is not None:
            faults = load_spec(file_or_example(self.spec, "datasets")).faults
        frames = [read_image(path) for path in self.frames]

        def judged(image: np.ndarray) -> str:
            found = broken_frame(image, frames[0])
            if found is not None:
                return f"{found.kind}: {found.axis} {found.first} to {found.last}"
            levels, rest = (each.astype(np.float32) for each in (image, frames[0]))
            common = common_gain(fit_light(levels, rest).remove(levels), rest)
            return "whole" if common is None else f"whole; {common.remark}"

        page = faults_page(frames, faults, judged, self.seed)
        write_page(page, self.out)
        if self.json:
            print_json(page.figures)
        say(f"wrote {self.out / PAGE}")


COMMANDS = {
    "make": DatasetMake,
    "faults": DatasetFaults,
    "check": DatasetCheck,
    "export": DatasetExport,
    "channels": DatasetChannels,
}


def with_make(words: Sequence[str]) -> list[str]:
    """``dataset FILE ...`` is short for ``dataset make FILE ...``."""
    named = words[1:2] and (words[1] in COMMANDS or words[1] in ("-h", "--help"))
    # A file stands alone before the options: two words are a command, known or not.
    named = named or any(not word.startswith("-") for word in words[2:3])
    if words[:1] == ["dataset"] and len(words) > 1 and not named:
        return ["dataset", "make", *words[1:]]
    return list(words)


def _some(folders: tuple[Path, ...]) -> tuple[Path, ...]:
    if not folders:
        raise InputError("name at least one folder of a data set")
    return folders


def _require_zarr() -> None:
    from importlib.util import find_spec

    missing = [name for name in ("zarr", "pyarrow") if find_spec(name) is None]
    if missing:
        raise InputError(
            f"{' and '.join(missing)} must be installed to write data: "
            "pip install 'taccel-lab[datasets]'; --no-write times it without"
        )


def _describe(plan: DatasetPlan, shard: Shard) -> None:
    from taccel_lab.cli.console import say
    from taccel_lab.printable import counted

    parts = plan.shard(shard.number, shard.count)
    touches = sum(len(part.episodes) for part in parts)
    steps = sum(part.steps for part in parts)
    grid = plan.sensors[0].grid
    say(
        f"{plan.spec.dataset.name}: {counted(touches, 'touch', 'touches')}, "
        f"{counted(steps, 'step')} in {counted(len(parts), 'part')}, shard {shard.number} of "
        f"{shard.count}; {counted(len(plan.sensors), 'sensor')}, "
        f"{counted(len(plan.indenters), 'object')}, images of {grid.width_px}x{grid.height_px} px"
    )
