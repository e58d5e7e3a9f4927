# SPDX-License-Identifier: Apache-2.0
"""Fits a force model to a data set of touches: holds out, trains, judges.

It is not fitted to a capture folder as the other blocks are, and so is no part of ``calibrate
all``: its data set is made with the profile that they gave.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from taccel_lab.datasets.reading import Dataset
from taccel_lab.datasets.sensor import profile_digest
from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.learning.force import remarks as say
from taccel_lab.learning.force.options import ForceOptions
from taccel_lab.learning.force.result import ForceCalibration
from taccel_lab.learning.force.samples import (
    ForceSamples,
    Split,
    patch_count,
    read_samples,
    require_usable,
    split_touches,
)
from taccel_lab.learning.force.score import (
    TOUCHED_N,
    Errors,
    Imposters,
    errors_of,
    found_imposters,
    limits_of,
    outside_rows,
    sigma_factors,
    tables_of,
)
from taccel_lab.learning.force.train import (
    LightSpread,
    Predictions,
    tell,
    torch_device,
    train_force_model,
)
from taccel_lab.learning.force.training_file import TrainingFile
from taccel_lab.learning.scalars import Scalars, unwritten
from taccel_lab.networks.force_settings import (
    ForceModelConfig,
)
from taccel_lab.profile import SensorProfile
from taccel_lab.profile.measured_range import measured_ranges
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark
from taccel_lab.signals.force_network import patch_centers_mm

VALIDATION_SEED, TEST_SEED, WRONG_SEED = 11, 12, 13
"""Seeds of drawn lights and of noise, beside the options' own."""


def calibrate_force(
    folders: Path | str | Sequence[Path | str],
    base: SensorProfile | None = None,
    options: ForceOptions = ForceOptions(),
    progress: Progress = silent,
    kept: TrainingFile | None = None,
    scalars: Scalars = unwritten,
) -> ForceCalibration:
    """Train a force model on a data set.

    Args:
        folders: Of one data set, of several or of its shards.
        base: Profile that the block is for; the data set's own when None.
        options: Of the training.
        progress: Reports reading and training.
        kept: Where the training is kept and gone on with; for the caller to remove at the end.
        scalars: Receives the loss of the training.

    Raises:
        InputError: No data set, channels that it lacks, images of another view than the profile's,
            or too few touches to hold some out.
    """
    begun = time.perf_counter()
    torch_device(options.device)
    data = Dataset(folders)
    own = _made_with(data)
    profile = own if base is None else base
    require_usable(data, profile)
    split = split_touches(data.episodes)
    config = _config(data, profile, own, options)
    centers = patch_centers_mm(config, profile.grid())
    light = _light(profile)

    def read(name: str, touches: np.ndarray) -> ForceSamples:
        return read_samples(data, touches, config, f"touches for {name}", progress)

    train = read("training", split.train)
    trained = train_force_model(train, config, centers, light, options, progress, kept, scalars)

    def predicted(samples: ForceSamples, seed: int, strength: float = options.light) -> Predictions:
        drawn = dataclasses.replace(options, light=strength)
        seed += options.seed
        return tell(samples, trained.config, trained.weights, centers, light, drawn, seed=seed)

    validation = read("validation", split.validation)
    seen = predicted(validation, VALIDATION_SEED)
    config = dataclasses.replace(
        trained.config,
        sigma_factor=sigma_factors(validation, seen),
        distance_limits=limits_of(seen),
    )
    # Nothing goes by these: read when the model is frozen.
    test = read("test", split.test)
    found = predicted(test, TEST_SEED)
    touched = test.targets[:, 2] > TOUCHED_N
    if not touched.any():
        raise InputError("no touch for the test presses on the gel; make a larger data set")
    actual = found.targets[:, 2] - test.targets[:, 2] * test.stiffness
    result = ForceCalibration(
        trained=trained,
        config=config,
        split=split,
        options=options,
        counts={"training": len(train), "validation": len(validation), "test": len(test)},
        test=test,
        predicted=found,
        overall=errors_of("all", test, found, config, touched),
        at_rest=errors_of("untouched", test, found, config, ~touched) if (~touched).any() else None,
        same_light=errors_of("all", test, predicted(test, TEST_SEED, 0.0), config, touched),
        unknown_stiffness_n=float(np.sqrt(np.mean(actual[touched] ** 2))),
        tables=tables_of(test, found, config),
        false_alarms=float(outside_rows(found, config).mean()),
        imposters=found_imposters(
            test, config, trained.weights, centers, WRONG_SEED + options.seed
        ),
        label_floor_n=_floor(test, touched),
        markers_tell=config.markers,
        inputs=_inputs(data),
        source=_source(data),
        seconds=time.perf_counter() - begun + (0.0 if kept is None else kept.earlier_s),
    )
    return dataclasses.replace(result, remarks=_remarks(result, data, split, profile, own, light))


def _made_with(data: Dataset) -> SensorProfile:
    """The profile that the data set was made with; InputError for more than one."""
    digests = {sensor["profile_digest"] for about in data.about for sensor in about["sensors"]}
    if len(digests) > 1:
        raise InputError(
            f"the data set holds touches of {len(digests)} sensors; a force model is of one. Units "
            "of one profile are what differs between sensors of a kind"
        )
    return data.profile(0)


def _config(
    data: Dataset, profile: SensorProfile, made_with: SensorProfile, options: ForceOptions
) -> ForceModelConfig:
    rows, columns = patch_count(data)
    could = profile.markers is not None and "markers_px" in data.channels
    if options.markers == "on" and not could:
        raise InputError(
            "--markers on: "
            + (
                "the profile has no block markers"
                if profile.markers is None
                else "the data set has no channel markers_px"
            )
        )
    spacing = profile.camera.mm_per_px_x * profile.camera.width_px / columns
    return ForceModelConfig(
        width_px=profile.camera.width_px,
        height_px=profile.camera.height_px,
        columns=columns,
        rows=rows,
        markers=could and options.markers != "off",
        marker_reach_mm=0.5 * spacing,
        young_modulus_pa=made_with.material.young_modulus_pa,
        stiffness_relative=_stiffness(profile) if options.stiffness is None else options.stiffness,
    )


def _stiffness(profile: SensorProfile) -> float:
    """Standard deviation of the modulus that the profile states, as a part of it; 0 for none."""
    found = measured_ranges(profile).get("young_modulus_pa")
    return 0.0 if found is None else found.sigma / profile.material.young_modulus_pa


def _light(profile: SensorProfile) -> LightSpread:
    block = profile.perturbation
    if block is None:
        return LightSpread()
    return LightSpread(block.gain_rgb, block.pivot_rgb, block.offset_rgb, block.gradient_rgb)


def _floor(test: ForceSamples, touched: np.ndarray) -> tuple[float, float]:
    """Median and 95th percentile of the labels' estimated error [N]."""
    known = test.about["force_error_n"][touched]
    known = known[np.isfinite(known)]
    if not len(known):
        return math.nan, math.nan
    return float(np.median(known)), float(np.quantile(known, 0.95))


def _inputs(data: Dataset) -> dict[str, str]:
    """SHA-256 of what says what the data sets hold; they hold the digests of all else."""
    found = {}
    for number, folder in enumerate(data.folders):
        for name in ("dataset.json", "episodes.parquet"):
            path = folder.root / name
            if path.is_file():
                found[f"{number}/{name}"] = file_sha256(path)
    return found


def _source(data: Dataset) -> str:
    return ", ".join(
        f"{about['name']} (seed {about['recipe']['spec']['dataset']['seed']}, accuracy "
        f"{about['recipe']['spec']['dataset']['accuracy']})"
        for about in data.about
    )


def _remarks(
    result: ForceCalibration,
    data: Dataset,
    split: Split,
    profile: SensorProfile,
    own: SensorProfile,
    light: LightSpread,
) -> tuple[Remark, ...]:
    overall: Errors = result.overall
    found = [say.SIMULATED()]
    if result.config.stiffness_relative == 0:
        found.append(say.STIFFNESS_UNKNOWN())
    if result.options.light == 0 or light == LightSpread():
        found.append(say.NO_LIGHT())
    total = sum(result.counts.values())
    if total < say.FEW_IMAGES_COUNT:
        found.append(say.FEW_IMAGES(count=total, touches=len(data.episodes)))
    share = overall.fz_n / max(overall.fz_spread_n, 1e-12)
    if share > say.LARGE_SHARE:
        found.append(
            say.LARGE_ERROR(
                error=overall.fz_n, spread=overall.fz_spread_n, share=share,
                grave=share > say.USELESS_SHARE,
            )
        )  # fmt: skip
    share = overall.shear_n / max(overall.shear_spread_n, 1e-12)
    if overall.shear_spread_n > 0 and share > say.NO_SHEAR_SHARE:
        found.append(
            say.NO_SHEAR(error=overall.shear_n, spread=overall.shear_spread_n, share=share)
        )
    if overall.inside95 < 0.85:
        found.append(say.OVERCONFIDENT(inside=overall.inside95))
    if result.false_alarms > say.FALSE_ALARMS:
        found.append(say.FALSE_ALARM(share=result.false_alarms))
    missed: list[Imposters] = [i for i in result.imposters if i.outside < say.FOUND_SHARE]
    if missed:
        found.append(
            say.MISSED(missed=", ".join(f"{i.name} (found {i.outside:.0%})" for i in missed))
        )
    if not split.test_units:
        units = len(set(data.episode_table["unit"].tolist()))
        found.append(say.NO_UNITS(units=f"{units} unit{'s' if units > 1 else ''}"))
    # What the block itself adds is no difference.
    if profile_digest(own.without("force")) != profile_digest(profile.without("force")):
        found.append(say.OTHER_PROFILE())
    return tuple(found)
