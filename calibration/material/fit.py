# SPDX-License-Identifier: Apache-2.0
"""From captures to a material: which records say what, and in which order they are fitted."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.capture.folder import source_of
from taccel_lab.calibration.material.force_table import ForceTable, force_table
from taccel_lab.calibration.material.friction import friction_of_records
from taccel_lab.calibration.material.gel import Gel
from taccel_lab.calibration.material.indentation_points import (
    IndentationPoints,
    points_of_presses,
    points_of_record,
    require_plausible,
)
from taccel_lab.calibration.material.options import MaterialOptions
from taccel_lab.calibration.material.result import MaterialCalibration
from taccel_lab.calibration.material.sliding import SlideFit, fit_slide
from taccel_lab.calibration.material.stiffness import KnownLaw, Stiffness, fit_stiffness
from taccel_lab.calibration.result import Estimate
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark

_DEFAULTS = MaterialOptions()
_KINDS = ("indentation", "slide")


@dataclass(frozen=True)
class _Captures:
    """What there is to fit, and how."""

    folder: CaptureFolder
    base: SensorProfile
    gel: Gel
    options: MaterialOptions
    progress: Progress
    points: Sequence[IndentationPoints]
    slides: Sequence[SlideFit]


@dataclass(frozen=True)
class _Known:
    """What is known of the gel so far."""

    poisson_ratio: float
    mooney_ratio: float
    young: Estimate | None = None
    friction: Estimate | None = None
    stiffness: Stiffness | None = None
    friction_remarks: tuple[Remark, ...] = ()

    def gel(self, captures: _Captures) -> Gel:
        """The gel of presses beside indentations; Poisson's ratio is rounded, so that equal fits
        share them."""
        return captures.gel.with_law(round(self.poisson_ratio, 3), self.mooney_ratio)


def calibrate_material(
    folder: CaptureFolder,
    base: SensorProfile,
    options: MaterialOptions = _DEFAULTS,
    progress: Progress = silent,
) -> MaterialCalibration:
    """Fit the material of ``base`` to the records of a capture folder.

    Raises:
        InputError: No record of forces, or one that cannot be used, with what is allowed.
        SimulationError: A press that did not converge.
    """
    gel = Gel.of_profile(base, options.model, options.device, options.physics)
    if gel.material.model != "mooney_rivlin" and "mooney_ratio" in options.fixed:
        raise InputError("mooney_ratio belongs to the law mooney_rivlin: add --model mooney_rivlin")
    records = {kind: [r for r in folder.records if r.entry.kind == kind] for kind in _KINDS}
    points = [points_of_record(r, gel, folder.ball_radius_mm) for r in records["indentation"]]
    points += points_of_presses(folder, gel)
    if not points and not any(records.values()):
        raise InputError(
            f"{folder.source}: nothing that tells the material; give [[records]] of kind "
            "indentation or slide (docs/captures.md), or presses with depth_mm and force_n"
        )
    slides = [fit_slide(record) for record in records["slide"]]
    captures = _Captures(folder, base, gel, options, progress, points, slides)
    started = time.perf_counter()
    known = _Known(
        options.fixed.get("nu", base.material.poisson_ratio),
        options.fixed.get("mooney_ratio", gel.material.mooney_ratio),
    )
    if slides:
        # They give friction for a modulus, and the modulus depends a little on friction.
        frictions = [options.fixed.get("friction", 0.0)]
        known = _with_stiffness(captures, known, frictions)
        for first in (True, False):
            known = _with_friction(captures, known)
            before, frictions = frictions, _press_frictions(captures, known)
            if first or frictions != before:
                known = _with_stiffness(captures, known, frictions)
    else:
        known = _with_stiffness(captures, known, _press_frictions(captures, known))
    return _result(captures, known, time.perf_counter() - started)


def _press_frictions(captures: _Captures, known: _Known) -> list[float]:
    """Coefficients that presses may have had: the one that is known, or 0 and the base's."""
    if known.friction is not None:
        return [known.friction.value]
    if "friction" in captures.options.fixed:
        return [captures.options.fixed["friction"]]
    stated = captures.base.material.friction_coefficient
    return [0.0] if stated == 0 else [0.0, stated]


def _used_friction(captures: _Captures, known: _Known) -> float:
    """Coefficient of the presses: what is known, or what the indentations fit best with."""
    if known.stiffness is not None:
        return known.stiffness.friction
    return _press_frictions(captures, known)[-1]


def _with_stiffness(captures: _Captures, known: _Known, frictions: Sequence[float]) -> _Known:
    """E, and what else of the law the points determine; the rest is held. Presses had one of the
    coefficients of friction given."""
    points, options, gel = captures.points, captures.options, captures.gel
    if not points:
        return known
    start, remarks = require_plausible(points, gel.thickness_mm, known.poisson_ratio)
    law = KnownLaw(
        options.fixed.get("nu", captures.base.material.poisson_ratio),
        options.fixed.get("mooney_ratio", gel.material.mooney_ratio),
        "nu" not in options.fixed,
        gel.material.model == "mooney_rivlin" and "mooney_ratio" not in options.fixed,
    )
    tables: dict[float, list[ForceTable]] = {}
    for mu in frictions:
        try:
            tables[mu] = _force_tables(captures, mu, law)
        except SimulationError:
            if not tables:
                raise
    found = fit_stiffness(
        points, tables, law, start_pa=start, touch_sigma_mm=options.touch_sigma_mm
    )
    return replace(
        known,
        poisson_ratio=found.fit.poisson_ratio,
        mooney_ratio=found.fit.mooney_ratio,
        young=found.young,
        stiffness=replace(found, remarks=(*remarks, *found.remarks)),
    )


def _force_tables(captures: _Captures, mu: float, law: KnownLaw) -> list[ForceTable]:
    free_nu = "nu" not in captures.options.fixed
    gel = captures.gel.with_law(law.poisson_ratio, law.mooney_ratio)
    return [
        force_table(
            gel,
            item.tool,
            (float(item.depth_mm.min()), item.deepest_mm),
            free_nu=free_nu,
            free_ratio=law.free_ratio,
            friction=mu,
            progress=captures.progress,
        )
        for item in captures.points
    ]


def _with_friction(captures: _Captures, known: _Known) -> _Known:
    """The coefficient of friction of the slides, unless it is held."""
    if "friction" in captures.options.fixed:
        return known
    young = captures.gel.material.young_modulus_pa if known.young is None else known.young.value
    friction, remarks = friction_of_records(
        known.gel(captures), captures.folder, captures.slides, young, captures.progress
    )
    return replace(known, friction=friction, friction_remarks=tuple(remarks))


def _result(captures: _Captures, known: _Known, seconds: float) -> MaterialCalibration:
    stiffness, provenance = known.stiffness, captures.folder.provenance
    inputs = {item.name: item.sha256 for item in (*captures.points, *captures.slides)}
    if provenance.get("manifest_sha256"):
        inputs["captures.toml"] = provenance["manifest_sha256"]
    remarks = [r for item in captures.slides for r in item.remarks]
    remarks += () if stiffness is None else stiffness.remarks
    remarks += known.friction_remarks
    estimates = {
        "young_modulus_pa": None if "e" in captures.options.fixed else known.young,
        "poisson_ratio": None if stiffness is None else stiffness.nu,
        "mooney_ratio": None if stiffness is None else stiffness.ratio,
        "friction_coefficient": known.friction,
    }
    return MaterialCalibration(
        source=source_of(provenance, captures.folder.source),
        license=provenance.get("license", ""),
        model=captures.gel.material.model,
        estimates={name: value for name, value in estimates.items() if value is not None},
        used_poisson_ratio=known.poisson_ratio,
        used_mooney_ratio=known.mooney_ratio,
        used_friction=_used_friction(captures, known),
        physics=captures.options.physics,
        stiffness=stiffness,
        slides=captures.slides,
        inputs=inputs,
        remarks=tuple(remarks),
        seconds=seconds,
    )
