# SPDX-License-Identifier: Apache-2.0
"""The folder of a data set: grown part by part, by any number of processes.

::

    dataset.json          what it holds, which parts there will be, and what made it
    spec.toml             the file as it was run
    profiles/N/           the sensors' profiles
    objects/              meshes that the file names
    parts/NNNNNN/         episodes that are written together (``part``)
    episodes.parquet      the index: all episodes of all parts there are
    steps.parquet         and all of their steps
    runs/                 how long runs took

Every file and part appears whole or not at all: a run may be killed at any time and goes on with
the same command. Shards write different parts and may share the folder, or have one each.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.datasets.part import EPISODES, STEPS
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import (
    atomic_file,
    errors_named,
    parents_made,
    write_bytes,
    write_json,
)
from taccel_lab.files.documents import read_json
from taccel_lab.files.growing_file import held_file
from taccel_lab.files.inner_path import inner_path, require_inner_files
from taccel_lab.files.output_folder import may_hold, remove_damaged, require_growable
from taccel_lab.files.output_marker import visible_faults
from taccel_lab.files.regular_file import LARGEST_BYTES, require_regular_file, shown

if TYPE_CHECKING:
    from taccel_lab.datasets.plan import DatasetPart, DatasetPlan

ABOUT = "dataset.json"
ABOUT_KEYS = {
    "format": int,
    "name": str,
    "plan": str,
    "episodes": int,
    "parts": int,
    "channels": dict,
    "sensors": list,
    "recipe": dict,
}
CHANNEL_KEYS = {"dtype": str, "row": str, "unit": str, "what": str, "may_be_nan": bool}
SENSOR_KEYS = {"name": str, "profile_digest": str, "grid": dict, "units": list}
PARTS = "parts"
MAX_TABLE_VALUES = 1 << 30
"""Values of all rows and columns: 26 million steps."""
LOCK = ".lock-"


class DatasetFolder:
    """A data set on disk."""

    def __init__(self, root: Path | str) -> None:
        self.root = Path(os.path.abspath(root))

    def require_usable(self, plan: DatasetPlan) -> None:
        """Refuse a folder of somebody else, or of another data set than ``plan``."""
        if not self.root.is_dir():
            require_growable(self.root)
        if not may_hold(self.root, ABOUT):
            raise InputError(
                f"{self.root} holds files and no data set; name a new folder, an empty one, or "
                "that of this data set to go on with it"
            )
        # What a run writes, locks or takes away lies at these places; the files of parts do not
        # change.
        require_inner_files(self.root, levels=2)
        if not (self.root / ABOUT).is_file():
            return
        about = self.about()
        if about.get("plan") != plan.digest:
            differs = _differences(about.get("recipe", {}), plan.recipe)
            raise InputError(
                f"{self.root} holds another data set: {differs}. Name another folder; several are "
                "read as one"
            )

    def about(self) -> dict[str, Any]:
        """``dataset.json``; InputError where there is none."""
        path = inner_path(self.root, ABOUT)
        if not path.is_file():
            raise InputError(f"{self.root} holds no data set: it has no {ABOUT}")
        about = read_json(path)
        _require_keys(path, about, ABOUT_KEYS)
        for name, channel in about["channels"].items():
            _require_keys(path, channel, CHANNEL_KEYS, f"channels.{name}.")
        for number, sensor in enumerate(about["sensors"] or [None]):
            _require_keys(path, sensor, SENSOR_KEYS, f"sensors.{number}.")
        return about

    def begin(self, plan: DatasetPlan, source: str) -> None:
        """Write what does not depend on any part, unless it is there. ``source``: the file."""
        from taccel_lab.datasets.plan import tool_file
        from taccel_lab.profile import save_profile

        self.require_usable(plan)
        # First: what is begun is known by it.
        if not (self.root / ABOUT).is_file():
            write_json(self.root / ABOUT, _about(plan))
        (self.root / PARTS).mkdir(parents=True, exist_ok=True)
        for number, profile in enumerate(plan.profiles):
            target = self.root / "profiles" / str(number)
            if not target.exists():
                save_profile(profile, target)
        for number, tool in enumerate(plan.tools):
            path = tool_file(tool)
            if path is not None:
                kept = self.root / "objects" / f"{number}_{path.name}"
                if not kept.exists():
                    with atomic_file(kept) as staging:
                        shutil.copyfile(path, staging)
        if not (self.root / "spec.toml").exists():
            write_bytes(self.root / "spec.toml", source.encode("utf-8"))

    @contextmanager
    def locked(self, shard: str) -> Iterator[None]:
        """Hold a shard; raises InputError while another run does. It ends with the process.

        Where the block fails before anything of the data set is there, nothing is left."""
        path = self.root / f"{LOCK}{shard.replace('/', '-of-')}"
        busy = f"another run makes shard {shard} in {self.root}"
        with (
            parents_made(path),
            errors_named(path, self.root),
            held_file(path, busy, "wait for its end or choose another shard"),
        ):
            try:
                yield
            except BaseException:
                if not (self.root / ABOUT).is_file():
                    path.unlink(missing_ok=True)
                raise

    def part(self, part: DatasetPart) -> Path:
        """Folder of a part."""
        return self.root / PARTS / part.name

    def part_folders(self) -> list[Path]:
        """Folders of all parts that are there, in order."""
        found = (self.root / PARTS).glob("[0-9]*")
        return sorted(path for path in found if path.name.isdecimal() and path.is_dir())

    def without_damaged(
        self, parts: Sequence[DatasetPart], say: Callable[[str], None]
    ) -> tuple[list[DatasetPart], list[DatasetPart]]:
        """The parts that are there, and those that are missing.

        One of which files are missing or cut short is taken away, so that it is made again, and
        told; one look at its files tells, ``dataset check`` reads them. Raises InputError for one
        whose list of files cannot be read, or that holds files of somebody else.
        """
        names = {path.name for path in self.part_folders()}
        there, missing = [], []
        for part in parts:
            faults = []
            if part.name in names:
                try:
                    faults = visible_faults(self.part(part))
                    if faults:
                        remove_damaged(self.part(part))
                except InputError as error:
                    raise InputError(
                        f"{error}; delete the part, and the same command makes it again"
                    ) from None
            if faults:
                more = f" and {len(faults) - 1} more" if faults[1:] else ""
                say(f"part {part.name} is damaged and made again: {faults[0]}{more}")
            (missing if faults or part.name not in names else there).append(part)
        return there, missing

    def write_index(self) -> None:
        """Gather the tables of all parts; Parquet, a row an episode and a row a step."""
        for name in (EPISODES, STEPS):
            table = self.gathered(name)
            if table is not None:
                write_bytes(self.root / name, _index_bytes(table))

    def gathered(self, name: str) -> Any:
        """A table of all parts that are there as one, None without parts; InputError for a damaged
        one."""
        import pyarrow as pa

        tables = []
        for part in self.part_folders():
            table = read_parquet(inner_path(self.root, f"{PARTS}/{part.name}/{name}"))
            if name == STEPS:
                numbers = pa.array([int(part.name)] * len(table), pa.int64())
                table = table.add_column(0, "part", numbers)
            tables.append(table)
        return pa.concat_tables(tables, promote_options="default") if tables else None


def read_parquet(path: Path) -> Any:
    """A table of a file; InputError where it is none, or larger than ``MAX_TABLE_VALUES``."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    require_regular_file(path, LARGEST_BYTES, "a table (Parquet)")
    try:
        about = pq.read_metadata(path)
        if about.num_rows * about.num_columns > MAX_TABLE_VALUES:
            raise InputError(
                f"{path} says that it has {about.num_rows:,} rows; {MAX_TABLE_VALUES:,} values are "
                "allowed"
            )
        return pq.read_table(path)
    except InputError:
        raise
    # A name that is no text is a ValueError of Python's.
    except (pa.ArrowException, OSError, ValueError) as error:
        raise InputError(
            f"{path} cannot be read as Parquet: {error}; a part or an index that is deleted is "
            "made again by the command that made it"
        ) from None


def _index_bytes(table: Any) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue().to_pybytes()


def _require_keys(path: Path, table: Any, keys: dict[str, type], above: str = "") -> None:
    """InputError for a table of ``dataset.json`` that lacks a key, or has it of another type."""
    for key, kind in keys.items():
        value = table.get(key) if isinstance(table, dict) else None
        if not isinstance(value, kind):
            found = "missing" if value is None else shown(value)
            raise InputError(f"{path} is no description of a data set: '{above}{key}' is {found}")


def is_as_written(path: Path, table: Any) -> bool:
    """Whether an index is, to the byte, what ``table`` was written as; True, unseen, for the file
    of another version of Arrow."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    written = _index_bytes(table)
    now = pq.read_metadata(pa.BufferReader(written)).created_by
    return pq.read_metadata(path).created_by != now or path.read_bytes() == written


def _about(plan: DatasetPlan) -> dict[str, Any]:
    from taccel_lab.datasets.channels import camera_record, channels_of, grid_record

    spec = plan.spec
    return {
        "kind": "taccel-lab data set",
        "format": plan.recipe["format"],
        "name": spec.dataset.name,
        "plan": plan.digest,
        "episodes": spec.dataset.episodes,
        "parts": len(plan.parts),
        "channels": {
            channel.name: {
                "dtype": channel.dtype,
                "row": channel.shape,
                "unit": channel.unit,
                "what": channel.what,
                "may_be_nan": channel.may_be_nan,
            }
            for channel in channels_of(spec.channels)
        },
        "sensors": [
            {
                "name": sensor.name,
                "profile": f"profiles/{number}",
                "profile_digest": sensor.digest,
                "grid": grid_record(sensor.grid),
                "image_from": "colour model" if sensor.color else "optical model",
                "markers_mm": sensor.marker_places_mm().tolist(),
                "units": [
                    {
                        "young_modulus_factor": unit.young_modulus_factor,
                        "poisson_ratio": unit.poisson_ratio,
                        "friction_coefficient": unit.friction_coefficient,
                        "grid": grid_record(sensor.unit_grid(index)),
                        "camera": camera_record(sensor.unit_camera(index)),
                    }
                    for index, unit in enumerate(sensor.units)
                ],
            }
            for number, sensor in enumerate(plan.sensors)
        ],
        "recipe": plan.recipe,
    }


def _differences(earlier: dict[str, Any], now: dict[str, Any]) -> str:
    """Which entries of two recipes differ, in words."""
    found = []
    for key in sorted({*earlier, *now}):
        a, b = earlier.get(key), now.get(key)
        if a == b:
            continue
        if isinstance(a, dict) and isinstance(b, dict):
            found += [f"{key}.{k}" for k in sorted({*a, *b}) if a.get(k) != b.get(k)]
        else:
            found.append(key)
    return "its " + ", ".join(found) + " differ from what is requested" if found else "it differs"
