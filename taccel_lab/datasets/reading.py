# SPDX-License-Identifier: Apache-2.0
"""Data sets read: one folder or several as one, without copying anything.

>>> data = Dataset(["out/a", "out/b"])                                    # doctest: +SKIP
>>> data.episodes[0]["object"], data.read("wrench", data.rows_of(0))      # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from taccel_lab.datasets.arrays import Arrays
from taccel_lab.datasets.folder import PARTS, DatasetFolder, read_parquet
from taccel_lab.datasets.part import ARRAYS, EPISODES, STEPS
from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import inner_files, inner_path
from taccel_lab.guards import require_known
from taccel_lab.report.style import BLUE, ORANGE, in_report_style, new_figure
from taccel_lab.summary import Summary
from taccel_lab.typed import typed

if TYPE_CHECKING:
    from matplotlib.figure import Figure


STRIP = 7
"""Most images of a touch."""


def picked(count: int) -> np.ndarray:
    """Steps of ``count`` that are shown, evenly, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, STRIP).round().astype(int))


@in_report_style
def draw_touch(
    steps: Mapping[str, np.ndarray], images: np.ndarray | None, depth_mm: np.ndarray | None
) -> Figure:
    """Images above depth maps, dark for nothing, and forces with the band of their error.

    Args:
        steps: Columns of the touch's steps, each [step].
        images: RGB at the ``picked`` steps, [k, H, W, 3]; None where the data set has none.
        depth_mm: How far the face sank there [mm], [k, H, W]; None likewise.
    """
    figure, axes = new_figure(13, 3.1, 2, STRIP + 2)
    grid = axes[0, 0].get_gridspec()
    for axis in axes.ravel():
        axis.set_axis_off()
    for column, k in enumerate(picked(len(steps["step"])).tolist()):
        depth = float(steps["depth_mm"][k])
        if images is not None:
            axes[0, column].imshow(images[column])
        axes[0, column].set_title(
            f"{depth:.2f} mm\n{steps['press_force_z_n'][k]:.2f} N", fontsize=8
        )
        if depth_mm is not None:
            axes[1, column].imshow(depth_mm[column], vmin=0, vmax=max(depth, 0.05))
    for axis in axes[:, STRIP:].ravel():
        axis.remove()
    _draw_forces(figure.add_subplot(grid[:, STRIP:]), steps)
    return figure


def _draw_forces(axes: Any, steps: Mapping[str, np.ndarray]) -> None:
    number, normal = steps["step"], steps["press_force_z_n"]
    error = steps["force_error_n"]
    axes.plot(number, normal, color=BLUE, marker=".", label="normal")
    axes.fill_between(number, normal - error, normal + error, color=BLUE, alpha=0.2, linewidth=0)
    tangential = np.hypot(steps["press_force_x_n"], steps["press_force_y_n"])
    axes.plot(number, tangential, color=ORANGE, marker=".", label="tangential")
    axes.set_xlabel("step")
    axes.set_ylabel("force [N]")
    axes.set_ylim(top=1.3 * axes.get_ylim()[1])
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.legend(loc="upper center", ncols=2)


FORMATS = (1,)
"""Formats of folders that this reads."""


class Dataset(Summary):
    """Episodes and steps of one or several folders.

    Steps are numbered through all of them, ``0 .. len(data) - 1``; episodes too, by their place in
    ``episodes``. Columns of the tables are numpy arrays.
    """

    def __init__(
        self, folders: str | Path | Sequence[str | Path], *, split: str | None = None
    ) -> None:
        """``folders``: of data sets or of shards of one. ``split``: train or test alone.

        Raises InputError: no data set, another format, or channels that differ.
        """
        chosen = [folders] if isinstance(folders, (str, Path)) else list(folders)
        if not chosen:
            raise InputError("name at least one folder of a data set")
        self.folders = [DatasetFolder(folder) for folder in chosen]
        self.about = [folder.about() for folder in self.folders]
        for folder, about in zip(self.folders, self.about, strict=True):
            if about.get("format") not in FORMATS:
                raise InputError(
                    f"{folder.root} has format {about.get('format')}, this version reads "
                    f"{', '.join(map(str, FORMATS))}"
                )
        self.channels: dict[str, dict[str, Any]] = self.about[0]["channels"]
        for folder, about in zip(self.folders, self.about, strict=True):
            if set(about["channels"]) != set(self.channels):
                raise InputError(
                    f"{folder.root} has other channels than {self.folders[0].root}: "
                    f"{', '.join(sorted(set(about['channels']) ^ set(self.channels)))}"
                )
        self.split = split
        self._groups: dict[tuple[int, int], Arrays] = {}

    # Tables ----------------------------------------------------------------------------------

    @cached_property
    def episode_table(self) -> dict[str, np.ndarray]:
        """Columns of all episodes, with ``folder``, their place in ``folders``; [episode]."""
        tables = [self._table(k, EPISODES) for k in range(len(self.folders))]
        found = _stacked(tables)
        if self.split is not None:
            keep = found["split"] == self.split
            found = {name: column[keep] for name, column in found.items()}
        return found

    @cached_property
    def episodes(self) -> list[dict[str, Any]]:
        """The same as rows."""
        table = self.episode_table
        return [
            {name: column[i].item() if isinstance(column[i], np.generic) else column[i]
             for name, column in table.items()}
            for i in range(len(table["episode"]))
        ]  # fmt: skip

    @cached_property
    def steps(self) -> dict[str, np.ndarray]:
        """Columns of all steps, in the order of ``episodes``: folder, part, row in the part and the
        small channels, vectors by component; [step]."""
        found = _stacked([self._table(k, STEPS) for k in range(len(self.folders))])
        key = (found["folder"].astype(np.int64) << 40) + found["episode"]
        table = self.episode_table
        wanted = (table["folder"].astype(np.int64) << 40) + table["episode"]
        place = {int(value): i for i, value in enumerate(wanted)}
        order = np.array([place.get(int(value), -1) for value in key], dtype=np.int64)
        chosen = np.flatnonzero(order >= 0)
        chosen = chosen[np.lexsort((found["step"][chosen], order[chosen]))]
        steps = {name: column[chosen] for name, column in found.items()}
        steps["place"] = order[chosen]
        return steps

    def __len__(self) -> int:
        return len(self.steps["row"])

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """List touches, steps and channels."""
        table = self.episode_table
        kinds = {
            name: ", ".join(sorted({str(value) for value in table[name]}))
            for name in ("sensor", "object", "motion")
        }
        return f"data set {self.about[0]['name']}", [
            ("folders", ", ".join(str(folder.root) for folder in self.folders)),
            ("touches", f"{len(table['episode'])}, {len(self)} steps"),
            *kinds.items(),
            ("channels", ", ".join(self.channels)),
        ]

    def rows_of(self, episode: int) -> np.ndarray:
        """Return the steps of an episode by its place in ``episodes``."""
        return np.flatnonzero(self.steps["place"] == episode)

    def _table(self, number: int, name: str) -> dict[str, np.ndarray]:
        """A table of a folder: its index where that is up to date, else those of its parts."""
        folder = self.folders[number]
        there = {int(part.name) for part in folder.part_folders()}
        table = _index(inner_path(folder.root, name))
        if table is None or set(table["part"].to_pylist()) != there:
            table = folder.gathered(name)
            if table is None:
                raise InputError(f"{folder.root} has no finished part yet")
        columns = {
            field: np.asarray(table[field].to_numpy(zero_copy_only=False))
            for field in table.column_names
        }
        for column, kinds in _COLUMNS[name].items():
            if column not in columns or columns[column].dtype.kind not in kinds:
                what = "no column" if column not in columns else "other values than it should in"
                raise InputError(
                    f"{folder.root / name} has {what} {column}; delete it, and the parts' own is "
                    "read; taccel-lab dataset check says which files are damaged"
                )
        return {"folder": np.full(len(table), number), **columns}

    # Arrays ----------------------------------------------------------------------------------

    def group(self, folder: int, part: int) -> Arrays:
        """Open the zarr arrays of a part; InputError for links that lead out of the folder, and for
        what ``Arrays`` does not read."""
        if (folder, part) not in self._groups:
            root = self.folders[folder].root
            for _ in inner_files(root, f"{PARTS}/{part:06d}"):
                pass
            with self.sound(folder, part) as path:
                self._groups[folder, part] = Arrays(path)
        return self._groups[folder, part]

    @contextmanager
    def sound(self, folder: int, part: int) -> Iterator[Path]:
        """Reading arrays of a part: InputError where they are damaged."""
        path = self.folders[folder].root / PARTS / f"{part:06d}" / ARRAYS
        try:
            yield path
        except InputError:
            raise
        except (ValueError, LookupError, TypeError, RuntimeError, OSError, MemoryError) as error:
            raise InputError(
                f"{path} is damaged ({type(error).__name__}: {error}); taccel-lab dataset check "
                "says which files are; a part that is deleted is made again by the command that "
                "made it"
            ) from None

    def read(self, channel: str, steps: Sequence[int] | np.ndarray | slice) -> np.ndarray:
        """Read a channel at some steps, [step, ...]. Neighbours are read together.

        Raises InputError: no such channel, or rows of different size (nodes of different meshes),
        which are read an episode at a time.
        """
        require_known("channel", channel, self.channels)
        chosen = (
            np.arange(len(self))[steps]
            if isinstance(steps, slice)
            else np.asarray(steps, dtype=np.int64)
        )
        table = self.steps
        found: list[np.ndarray | None] = [None] * len(chosen)
        keys = np.stack([table["folder"][chosen], table["part"][chosen]], axis=1)
        for folder, part in np.unique(keys, axis=0).tolist():
            places = np.flatnonzero((keys == [folder, part]).all(axis=1))
            rows = table["row"][chosen[places]]
            low, high = int(rows.min()), int(rows.max()) + 1
            group = self.group(folder, part)
            with self.sound(folder, part):
                array = group[channel]
                if high - low <= 4 * len(rows):
                    values = array[low:high][rows - low]
                else:
                    values = np.stack([array[int(row)] for row in rows])
            for place, value in zip(places.tolist(), values, strict=True):
                found[place] = value
        if len({value.shape for value in found if value is not None}) > 1:
            raise InputError(
                f"{channel} has rows of different size in these steps; read an episode at a time"
            )
        return np.stack(found) if found else np.zeros(0)  # type: ignore[arg-type]

    def mesh(self, episode: int) -> tuple[np.ndarray, np.ndarray]:
        """Contact face of an episode at rest: nodes [m], [node, 3], and triangles, [face, 3]; rows
        of nodal channels belong to these nodes."""
        row = self.episodes[episode]
        group = self.group(row["folder"], row["part"])
        with self.sound(row["folder"], row["part"]):
            meshes = group["meshes"]
            nodes, faces = meshes["nodes_m"][row["place"]], meshes["faces"][row["place"]]
        return nodes[np.isfinite(nodes[:, 0])], faces[faces[:, 0] >= 0]

    def plot(self, episode: int = 0) -> Figure:
        """Draw a touch, by its place in ``episodes``: images, depths and forces over its steps.

        Raises:
            InputError: No such episode, or damaged files.
        """
        rows = self.rows_of(episode)
        if not len(rows):
            raise InputError(
                f"there is no episode {episode}; 0 to {len(self.episodes) - 1} are allowed"
            )
        shown = rows[picked(len(rows))]
        images, depths = (
            self.read(channel, shown) if channel in self.channels else None
            for channel in ("rgb", "depth_mm")
        )
        return draw_touch({k: column[rows] for k, column in self.steps.items()}, images, depths)

    def profile(self, episode: int) -> Any:
        """Return the ``SensorProfile`` that an episode was made with."""
        from taccel_lab.profile import load_profile

        row = self.episodes[episode]
        return load_profile(
            self.folders[row["folder"]].root / "profiles" / str(row["sensor_index"])
        )


@typed
def open_dataset(
    folders: str | Path | Sequence[str | Path], split: Literal["train", "test"] | None = None
) -> Dataset:
    """Open the data set of one folder or of several, all of it or a split; errors as of
    ``Dataset``."""
    return Dataset(folders, split=split)


_WHOLE, _NUMBER, _TEXT = "iu", "iuf", "OUT"
_COLUMNS = {
    EPISODES: {
        **dict.fromkeys(("episode", "part", "place", "rows", "sensor_index", "unit"), _WHOLE),
        **dict.fromkeys(("sensor", "object", "motion", "status", "cause", "split"), _TEXT),
        "depth_mm": _NUMBER,
    },
    STEPS: {
        **dict.fromkeys(("episode", "part", "row", "step"), _WHOLE),
        **dict.fromkeys(("depth_mm", "press_force_z_n", "contact_area_mm2"), _NUMBER),
    },
}
"""Kinds of NumPy's types of the columns that readers go by."""


def _index(path: Path) -> Any:
    """The index of all parts, None where there is none or it is damaged: parts have all of it."""
    if not path.is_file():
        return None
    try:
        table = read_parquet(path)
    except InputError:
        return None
    return table if "part" in table.column_names else None


def _stacked(tables: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
