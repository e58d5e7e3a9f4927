# SPDX-License-Identifier: Apache-2.0
"""Touches of a data set as the network takes them: reduced images, markers and nominal labels.

Labels are of the gel with the profile's own modulus: forces of a motion are proportional to it, no
image shows it, and each touch was simulated with one of its own. Areas do not depend on it.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.force_settings import (
    ForceModelConfig,
)
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.force_network import marker_planes, reduced

if TYPE_CHECKING:
    from taccel_lab.datasets.reading import Dataset
    from taccel_lab.profile import SensorProfile

READ_STEPS = 256
"""Steps that are read at once."""
VALIDATION_SHARE = 1 / 6
TEST_SHARE = 1 / 5
LEAST_OBJECTS = 3
"""Objects from which on whole ones are held out."""
NEEDED = ("rgb", "patch_forces_n", "wrench", "contact_area_mm2")
ASPECT = 0.01
"""Largest share by which the ratio of an image's sides may differ from the camera's."""


@dataclass(frozen=True)
class ForceSamples:
    """Steps of touches, a row each."""

    change: np.ndarray
    """Image minus untouched image [levels], float16, [step, 3, height, width]."""
    rest: np.ndarray
    """The untouched image [levels], float16, [touch, 3, height, width]."""
    touch: np.ndarray
    """Row of ``rest``, [step]."""
    moved: np.ndarray | None
    """``marker_planes``, [step, 3, row, column]."""
    patches_n: np.ndarray
    """Forces by patch at the nominal modulus, float32, [step, 3, row, column]."""
    targets: np.ndarray
    """``TARGETS`` at the nominal modulus, float32, [step, 7]."""
    stiffness: np.ndarray
    """Modulus of the touch over the nominal one, [step]."""
    about: dict[str, np.ndarray]
    """Facts of each step: object, unit, motion, depth_mm, shear_mm, off_center_mm,
    force_error_n."""

    def __len__(self) -> int:
        return len(self.touch)


@dataclass(frozen=True)
class Split:
    """Which touches are for what; whole touches, so that no step of one is on two sides."""

    train: np.ndarray
    """Places of touches in ``Dataset.episodes``."""
    validation: np.ndarray
    """Objects that the training does not see; standard deviations and limits go by them."""
    test: np.ndarray
    """Objects and units that nothing goes by."""
    validation_objects: tuple[str, ...]
    test_objects: tuple[str, ...]
    test_units: tuple[int, ...]
    rule: str
    """How they were chosen, in words."""


def split_touches(episodes: Sequence[dict[str, Any]]) -> Split:
    """Choose by names alone, before any image is read.

    The data set's own split comes first. Where it has no ``test``, a fifth of the objects and of
    the units is taken, those with the lowest hashes of their names; a sixth of the other objects is
    for validation. With fewer than three objects touches take their place.
    """
    split = np.array([row["split"] for row in episodes])
    objects = np.array([row["object"] for row in episodes])
    units = np.array([row["unit"] for row in episodes])
    test = split == "test"
    rule = "test: as the data set says"
    if not test.any():
        chosen = _lowest("test object", sorted(set(objects.tolist())), TEST_SHARE)
        few = _lowest("test unit", sorted(set(units.tolist())), TEST_SHARE)
        test = np.isin(objects, chosen) | np.isin(units, few)
        rule = "test: a fifth of the objects and of the units, by hashes of their names"
        if not test.any():
            test = _touches("test", episodes, TEST_SHARE)
            rule = "test: a fifth of the touches, by hash; too few objects and units to hold out"
    left = sorted(set(objects[~test].tolist()))
    chosen = _lowest("validation object", left, VALIDATION_SHARE)
    validation = ~test & np.isin(objects, chosen)
    if validation.any():
        rule += "; validation: a sixth of the other objects, by hash"
    else:
        validation = ~test & _touches("validation", episodes, VALIDATION_SHARE)
        rule += "; validation: a sixth of the other touches, by hash"
    train = ~test & ~validation
    for name, found in (("training", train), ("validation", validation), ("test", test)):
        if not found.any():
            raise InputError(
                f"the data set leaves no touch for {name} ({len(episodes)} touches of "
                f"{len(set(objects.tolist()))} objects); make a larger one, with three objects and "
                "more"
            )
    seen_objects = set(objects[train | validation].tolist())
    seen_units = set(units[train | validation].tolist())
    return Split(
        np.flatnonzero(train),
        np.flatnonzero(validation),
        np.flatnonzero(test),
        tuple(sorted(set(objects[validation].tolist()))),
        tuple(sorted(set(objects[test].tolist()) - seen_objects)),
        tuple(sorted(set(units[test].tolist()) - seen_units)),
        rule,
    )


def _hash(text: str) -> float:
    """Number from 0 to 1, by the text alone."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") / 2**64


def _lowest(purpose: str, names: Sequence[Any], share: float) -> list[Any]:
    """A share of names, at least one; none of fewer than three."""
    if len(names) < LEAST_OBJECTS:
        return []
    ranked = sorted(names, key=lambda name: _hash(f"{purpose}:{name}"))
    return ranked[: max(1, round(share * len(names)))]


def _touches(purpose: str, episodes: Sequence[dict[str, Any]], share: float) -> np.ndarray:
    return np.array(
        [_hash(f"{purpose}:{row['seed']}:{row['episode']}") < share for row in episodes]
    )


def require_usable(data: Dataset, profile: SensorProfile) -> None:
    """Refuse a data set that lacks a channel, or whose images are not of the profile's camera."""
    missing = [name for name in NEEDED if name not in data.channels]
    if missing:
        raise InputError(
            f"{data.folders[0].root} has no channel {', '.join(missing)}, which a force model is "
            "trained on; add it to output.channels and make the data set anew"
        )
    camera = profile.camera
    for about in data.about:
        for sensor in about["sensors"]:
            grid = sensor["grid"]
            wide = grid["width_px"] / grid["height_px"]
            if abs(wide / (camera.width_px / camera.height_px) - 1) > ASPECT:
                raise InputError(
                    f"images of {sensor['name']} are {grid['width_px']}x{grid['height_px']} px, "
                    f"the profile's camera has {camera.width_px}x{camera.height_px} px: not the "
                    "same view"
                )
            scale = grid["mm_per_px_x"] * grid["width_px"] / (camera.mm_per_px_x * camera.width_px)
            if abs(scale - 1) > ASPECT:
                raise InputError(
                    f"images of {sensor['name']} show {scale:.3g} times the width of gel that the "
                    "profile's camera shows; give the profile that the data set was made with"
                )


def patch_count(data: Dataset) -> tuple[int, int]:
    """Rows and columns of patches."""
    shape = data.read("patch_forces_n", [0]).shape
    return int(shape[1]), int(shape[2])


def read_samples(
    data: Dataset,
    touches: np.ndarray,
    config: ForceModelConfig,
    what: str = "touches",
    progress: Progress = silent,
) -> ForceSamples:
    """Read touches by their places in ``data.episodes``, ascending."""
    steps = data.steps
    chosen = np.flatnonzero(np.isin(steps["place"], touches))
    place = steps["place"][chosen]
    # Steps come touch by touch, in order: the first of each is the untouched gel.
    first = np.searchsorted(place, np.unique(place))
    touch = np.searchsorted(np.unique(place), place)
    height, width = config.input_px
    levels = np.empty((len(chosen), 3, height, width), dtype=np.float32)
    patches = np.empty((len(chosen), 3, config.rows, config.columns), dtype=np.float32)
    markers = []
    for start in range(0, len(chosen), READ_STEPS):
        rows = chosen[start : start + READ_STEPS]
        part = slice(start, start + len(rows))
        levels[part] = reduced(data.read("rgb", rows), config).transpose(0, 3, 1, 2)
        patches[part] = data.read("patch_forces_n", rows).transpose(0, 3, 1, 2)
        if config.markers:
            markers.append(data.read("markers_px", rows))
        progress(f"reading {what}", start + len(rows), len(chosen))
    rest = levels[first]
    levels -= rest[touch]
    table = data.episode_table
    factor = table["young_modulus_factor"][place]
    wrench = np.stack(
        [steps[f"force_{axis}_n"][chosen] for axis in "xyz"]
        + [1e3 * steps[f"moment_{axis}_nm"][chosen] for axis in "xyz"],
        axis=1,
    )
    targets = np.column_stack([wrench / factor[:, None], steps["contact_area_mm2"][chosen]])
    return ForceSamples(
        change=levels.astype(np.float16),
        rest=rest.astype(np.float16),
        touch=touch,
        moved=_moved(data, np.concatenate(markers), chosen, first, touch, config)
        if markers
        else None,
        patches_n=patches / factor[:, None, None, None].astype(np.float32),
        targets=targets.astype(np.float32),
        stiffness=factor,
        about={
            "object": table["object"][place],
            "unit": table["unit"][place],
            "motion": table["motion"][place],
            "depth_mm": steps["depth_mm"][chosen],
            "shear_mm": np.hypot(steps["shear_x_mm"][chosen], steps["shear_y_mm"][chosen]),
            "off_center_mm": np.hypot(table["x_mm"][place], table["y_mm"][place]),
            "force_error_n": steps["force_error_n"][chosen] / factor,
        },
    )


def _moved(
    data: Dataset,
    markers_px: np.ndarray,
    steps: np.ndarray,
    first: np.ndarray,
    touch: np.ndarray,
    config: ForceModelConfig,
) -> np.ndarray:
    """Marker planes of steps, [step, 3, row, column]."""
    sensors = data.episode_table["sensor_index"][data.steps["place"][steps]]
    folders = data.steps["folder"][steps]
    rest = markers_px[first][touch]
    return np.stack(
        [
            marker_planes(
                rest[k],
                markers_px[k] - rest[k],
                config,
                PixelGrid(**data.about[folders[k]]["sensors"][sensors[k]]["grid"]),
            )
            for k in range(len(steps))
        ]
    )


def spread_of(values: np.ndarray) -> tuple[float, ...]:
    """Root mean square of each column, kept above zero."""
    rms = np.sqrt(np.mean(np.asarray(values, dtype=np.float64) ** 2, axis=0))
    return tuple(max(float(value), 1e-6) if math.isfinite(value) else 1.0 for value in rms)
