# SPDX-License-Identifier: Apache-2.0
"""From the results of the demo to the sections of its report."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version

import numpy as np

from taccel_lab.calibration.color.evaluate import ImageScore
from taccel_lab.calibration.color.heldout import mean_bare
from taccel_lab.calibration.color.report import PLACED_BY
from taccel_lab.calibration.demo import DemoCalibration
from taccel_lab.calibration.report.color_discs import color_discs
from taccel_lab.envs import PressOutcome
from taccel_lab.geometry import Region
from taccel_lab.report.model import (
    ColorScore,
    ColorSection,
    DetectionSection,
    ForceDepth,
    HeldoutFrame,
    LossCurve,
    MeshSection,
    NormalDisc,
    PressMaps,
    PressRecord,
    PressSection,
    Report,
    Stage,
    Target,
)

GOALS = (
    ("crop_psnr_db", "PSNR in the 1.6 r crop", 34.0, True, "dB", 2),
    ("crop_ssim", "SSIM in the 1.6 r crop", 0.97, True, "", 4),
    ("disc_l1", "L1 in the contact disc", 2.6, False, "levels", 2),
)
"""Goals on the held-out presses: key, label, goal, larger is better, unit, digits."""


def build_report(
    results: DemoCalibration,
    outcome: PressOutcome,
    image: np.ndarray | None,
    dihedral_deg: np.ndarray,
    seconds: Mapping[str, float],
) -> Report:
    """All sections.

    Args:
        results: What was calibrated.
        outcome: A press of the calibrated sensor.
        image: What the sensor sees of it, RGB levels.
        dihedral_deg: Dihedral angles of the design's tets [deg], shape [tet_count, 6].
        seconds: The stages' times.
    """
    captures = results.captures
    return Report(
        title=f"{results.profile.sensor.name}: calibrated on {len(captures.presses)} real presses, "
        f"judged by {_heldout_count(results)} more",
        subtitle=(
            f"ball of {captures.ball_radius_mm:g} mm radius, "
            f"{captures.grid.width_px}x{captures.grid.height_px} px, "
            f"{captures.grid.mm_per_px_x:g} mm/px; every surface from finite-element presses"
        ),
        targets=tuple(
            Target(f"color.heldout.{key}", label, goal, at_least, unit, digits, _cause(results))
            for key, label, goal, at_least, unit, digits in GOALS
        ),
        color=_color(results),
        press=_press(results, outcome, image),
        mesh=_mesh(results, dihedral_deg),
        detection=_detection(results),
        stages=tuple(Stage(name, value) for name, value in seconds.items()),
        remarks=_remarks(results),
        provenance=_provenance(results),
    )


def _heldout_count(results: DemoCalibration) -> int:
    return len(results.calibration.heldout) + len(results.calibration.failures)


def _score(values: Mapping[str, float]) -> ColorScore:
    return ColorScore(**{key: float(values[key]) for key in ColorScore.__dataclass_fields__})


def _frame_score(score: ImageScore) -> ColorScore:
    return _score(vars(score))


def _cause(results: DemoCalibration) -> str:
    """The likely cause of a missed goal, from what was measured."""
    floor = results.calibration.noise_floor_l1
    return (
        f"Captures differ from the background by {floor:.1f} levels even far from the contact, "
        "and material, friction and thickness of this gel are assumptions."
    )


def _color(results: DemoCalibration) -> ColorSection:
    calibration = results.calibration
    way = calibration.placement
    frames = tuple(
        HeldoutFrame(
            name=item.name,
            real_rgb=item.captured,
            rendered_rgb=item.placed[way].shown,
            circle_px=(item.circle.u_px, item.circle.v_px, item.circle.radius_px),
            score=_frame_score(item.placed[way].score),
            background_score=_frame_score(item.background_only),
        )
        for item in calibration.heldout
    )
    by = {name: calibration.heldout_means(name)["crop_psnr_db"] for name in calibration.placements}
    curve = np.asarray(calibration.fit.loss_curve, dtype=float)
    fit = calibration.fit
    return ColorSection(
        heldout=_score(calibration.heldout_means()),
        background_only=_score(mean_bare(calibration.heldout, calibration.failures)),
        frames=frames,
        train_count=len(calibration.train_names),
        discs=_discs(results),
        loss=LossCurve(steps=curve[:, 0], train=curve[:, 1]),
        noise_floor_l1=calibration.noise_floor_l1,
        facts={
            "network": " - ".join(str(width) for width in fit.model.config.hidden),
            "inputs": ", ".join(fit.model.config.inputs),
            "parameters": sum(value.size for value in fit.model.weights.values()),
            "fit time [s]": round(fit.seconds, 1),
            "surfaces": calibration.surface_provider,
            "held-out presses": PLACED_BY[way],
            **{f"crop PSNR, {PLACED_BY[name]} [dB]": round(by[name], 2) for name in by},
            "held-out presses that failed": len(calibration.failures),
        },
    )


def _discs(results: DemoCalibration) -> tuple[NormalDisc, ...]:
    """Colour change over the hemisphere of normals at the middle and near the corners."""
    training = set(results.calibration.train_names)
    surfaces = [
        surface
        for surface, press in zip(results.surfaces, results.captures.presses, strict=True)
        if press.name in training
    ]
    tilt = np.concatenate([np.sqrt(1 - s.normals[..., 2].ravel() ** 2)[::7] for s in surfaces])
    trained = float(np.quantile(tilt, 0.9999))
    return color_discs(
        results.calibration.fit.model,
        min(0.98, 1.05 * trained),
        float(np.median([s.displacement_mm().min() for s in surfaces])) / 2,
        rest_normals=results.surfaces[0].rest_normals,
        trained_sine=trained,
    )


def _press(
    results: DemoCalibration, outcome: PressOutcome, image: np.ndarray | None
) -> PressSection:
    figures = outcome.figures()
    records = []
    for press, circle, surface in zip(
        results.captures.presses, results.circles, results.surfaces, strict=True
    ):
        effort = surface.effort
        if effort is None:
            # Read off the presses that were simulated.
            continue
        scale = results.captures.grid.mm_per_px_x
        records.append(
            PressRecord(
                name=press.name,
                depth_mm=surface.depth_mm,
                force_n=surface.force_n,
                residual_n=surface.residual_n,
                newton_iterations=effort.newton_iterations / effort.step_count,
                seconds_per_step=effort.seconds_per_step,
                min_distance_m=effort.min_distance_m,
                steps=effort.step_count,
                contact_radius_mm=surface.contact_radius_px * scale,
                labelled_radius_mm=circle.radius_px * scale,
            )
        )
    steps = outcome.steps
    material = results.profile.material
    return PressSection(
        reference=PressRecord(
            name="the calibrated sensor, at a place never captured",
            depth_mm=outcome.path.depth_mm,
            force_n=figures["force_n"],
            residual_n=figures["residual_n"],
            newton_iterations=figures["newton_iterations"] / figures["step_count"],
            seconds_per_step=figures["seconds_per_step"],
            min_distance_m=figures["min_distance_m"],
            steps=figures["step_count"],
            contact_radius_mm=figures["contact_radius_mm"],
        ),
        records=tuple(records),
        force_depth=ForceDepth(
            label="simulated press",
            depth_mm=np.array([0.0] + [step.depth_mm for step in steps]),
            force_n=np.array([0.0] + [step.wrench[2] for step in steps]),
        ),
        maps=PressMaps(
            grid=results.captures.grid,
            height_m=outcome.height_m,
            normals=outcome.normals,
            rgb=image,
            positions_m=outcome.positions_m,
            contact_faces=outcome.mesh.region_faces(Region.CONTACT),
            forces_n=outcome.contact_forces_n,
            pressures_pa=outcome.contact_pressures_pa,
        ),
        facts={
            "Young's modulus [kPa]": material.young_modulus_pa / 1e3,
            "Poisson's ratio": material.poisson_ratio,
            "friction coefficient": material.friction_coefficient,
            "nodes of a press": outcome.mesh.node_count,
            "tets of a press": outcome.mesh.tet_count,
            "smallest volume ratio of a tet": round(outcome.smallest_volume_ratio, 3),
        },
    )


def _mesh(results: DemoCalibration, dihedral_deg: np.ndarray) -> MeshSection:
    mesh, quality = results.design.mesh, results.design.quality
    return MeshSection(
        node_count=mesh.node_count,
        tet_count=mesh.tet_count,
        min_dihedral_deg=quality.min_dihedral_deg,
        nodes_m=mesh.nodes_m,
        faces=mesh.faces,
        face_regions=mesh.face_regions,
        dihedral_deg=dihedral_deg,
        facts={
            "mesher": results.design.mesher,
            "volume error [%]": round(quality.volume_error_percent or 0.0, 3),
            "Hausdorff distance [mm]": round(quality.hausdorff_mm or 0.0, 4),
            "mean ratio, mean": round(quality.mean_mean_ratio, 3),
            "back plane error [mm]": quality.back_plane_error_mm,
        },
    )


def _detection(results: DemoCalibration) -> DetectionSection | None:
    """Found against labelled circles of the presses that have labels."""
    pairs = [
        (press.name, press.circle, contact.circle)
        for press, contact in zip(results.captures.presses, results.contacts, strict=True)
        if press.circle is not None
    ]
    if not pairs:
        return None
    return DetectionSection(
        names=tuple(name for name, _, _ in pairs),
        labelled_px=np.array([(c.u_px, c.v_px, c.radius_px) for _, c, _ in pairs]),
        detected_px=np.array([(c.u_px, c.v_px, c.radius_px) for _, _, c in pairs]),
    )


def _remarks(results: DemoCalibration) -> tuple[str, ...]:
    misses = [
        abs(surface.contact_radius_px - circle.radius_px)
        for surface, circle in zip(results.surfaces, results.circles, strict=True)
        if surface.effort is not None
    ]
    remark = (
        f"The simulated contact radius meets the circle within {np.median(misses):.1f} px "
        f"(median), {max(misses):.1f} px at worst"
    )
    return (
        remark + ".",
        "Forces rest on an assumed Young's modulus and scale with it; shapes and images do not.",
    )


def _provenance(results: DemoCalibration) -> dict[str, str]:
    names = ("taccel-lab", "warp-lang", "numpy", "torch", "build123d")
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machine": f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}",
        "packages": ", ".join(f"{name} {version(name)}" for name in names),
        "captures": results.captures.source,
        **{f"captures, {name}": value for name, value in results.captures.provenance.items()},
    }
