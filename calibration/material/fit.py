# SPDX-License-Identifier: Apache-2.0
"""Fit of a material to captures: the points of records and presses, tables for them, and the
fit."""

from __future__ import annotations

import time

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.capture.folder import source_of
from taccel_lab.calibration.material.force_table import ForceTable, force_table
from taccel_lab.calibration.material.gel import (
    Gel,
    points_of_presses,
    points_of_record,
)
from taccel_lab.calibration.material.options import MaterialOptions
from taccel_lab.calibration.material.remarks import require_plausible
from taccel_lab.calibration.material.result import MaterialCalibration
from taccel_lab.calibration.material.stiffness import fit_stiffness
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, silent

_DEFAULTS = MaterialOptions()


def calibrate_material(
    folder: CaptureFolder,
    base: SensorProfile,
    options: MaterialOptions = _DEFAULTS,
    progress: Progress = silent,
) -> MaterialCalibration:
    """Fit the material of ``base`` to the records of a capture folder.

    E, and what else of the law the points determine, is fitted; the rest is held.

    Raises:
        InputError: No record of forces, or one that cannot be used, with what is allowed.
        SimulationError: A press that did not converge.
    """
    gel = Gel.of_profile(base, options.model, options.device, options.physics)
    if gel.material.model != "mooney_rivlin" and "mooney_ratio" in options.fixed:
        raise InputError("mooney_ratio belongs to the law mooney_rivlin: add --model mooney_rivlin")
    points = [points_of_record(record, gel, folder.ball_radius_mm) for record in folder.records]
    points += points_of_presses(folder, gel)
    if not points:
        raise InputError(
            f"{folder.source}: nothing that tells the material; give [[records]] of kind "
            "indentation (docs/captures.md), or presses with depth_mm and force_n"
        )
    started = time.perf_counter()
    free_nu = "nu" not in options.fixed
    pressed = gel.with_law(
        options.fixed.get("nu", base.material.poisson_ratio), options.fixed.get("mooney_ratio")
    )
    nu = pressed.material.poisson_ratio
    start, remarks = require_plausible(points, gel.thickness_mm, nu)
    tables: dict[float, list[ForceTable]] = {}
    for mu in _press_frictions(base, options):
        try:
            tables[mu] = [
                force_table(
                    pressed,
                    item.tool,
                    (float(item.depth_mm.min()), item.deepest_mm),
                    free_nu=free_nu,
                    friction=mu,
                    progress=progress,
                )
                for item in points
            ]
        except SimulationError:
            if not tables:
                raise
    found = fit_stiffness(
        points,
        tables,
        poisson_ratio=nu,
        free_nu=free_nu,
        start_pa=start,
        touch_sigma_mm=options.touch_sigma_mm,
    )
    inputs = {item.name: item.sha256 for item in points}
    if folder.provenance.get("manifest_sha256"):
        inputs["captures.toml"] = folder.provenance["manifest_sha256"]
    estimates = {
        "young_modulus_pa": None if "e" in options.fixed else found.young,
        "poisson_ratio": found.nu,
    }
    return MaterialCalibration(
        source=source_of(folder.provenance, folder.source),
        license=folder.provenance.get("license", ""),
        model=gel.material.model,
        mooney_ratio=pressed.material.mooney_ratio,
        estimates={name: value for name, value in estimates.items() if value is not None},
        physics=options.physics,
        stiffness=found,
        inputs=inputs,
        remarks=(*remarks, *found.remarks),
        seconds=time.perf_counter() - started,
    )


def _press_frictions(base: SensorProfile, options: MaterialOptions) -> list[float]:
    """Coefficients that presses may have had: the one that is held, or 0 and the base's."""
    if "friction" in options.fixed:
        return [options.fixed["friction"]]
    stated = base.material.friction_coefficient
    return [0.0] if stated == 0 else [0.0, stated]
