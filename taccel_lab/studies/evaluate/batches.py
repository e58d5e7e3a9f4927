# SPDX-License-Identifier: Apache-2.0
"""Batches of designs that share simulations: what one process of a study evaluates and writes, rows
of figures and the files beside them: mesh, STEP, and a picture of the first press."""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError, SimulationError, is_of_a_file
from taccel_lab.files.atomic_file import content_id
from taccel_lab.progress import Progress, silent
from taccel_lab.report.style import BLUE, GREY, LIGHT, in_report_style, new_figure, save_figure
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.studies.evaluate.design_row import DesignRow, row_of
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.studies.metrics.design_point import DesignFigures, DesignPoint
from taccel_lab.studies.metrics.evidence import section_mm, view_model
from taccel_lab.studies.presses.press_record import PressRecord
from taccel_lab.studies.spec.study import Study
from taccel_lab.studies.spec.study_file import StudyOutput
from taccel_lab.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taccel_lab.cad.parts.pad import Pad
    from taccel_lab.sensors.base import FamilyParameters

Needs = tuple[tuple[str, ...], tuple[str, ...]]
"""Metrics and presses."""
MAX_BATCH = 32
"""Designs in a batch: what is lost at most, with every process, when a run is killed."""
GROUPS_ON_GPU = 16
"""Groups of designs in a batch on a GPU, which wants many environments at once. On a CPU each
group goes alone, so that rows appear early and cores share the work evenly."""


@dataclass(frozen=True)
class DesignBatch:
    """Designs that are evaluated together, all for the same metrics."""

    designs: tuple[DesignPoint, ...]
    metrics: tuple[str, ...]
    presses: tuple[str, ...]

    def one_by_one(self) -> list[DesignBatch]:
        """A batch of each design."""
        return [replace(self, designs=(design,)) for design in self.designs]


def sharing_key(family: SensorFamily, design: DesignPoint) -> str:
    """Equal for designs whose presses are the same but for the scale of the forces.

    Quasi-static presses scale with Young's modulus, and optics do not touch them: what counts is
    the pad, the camera's view (it places the presses), and the layers' other properties.
    """
    try:
        parameters = family.parameters(design.parameters)
    except InputError:
        return f"cannot be built: {design.id}"
    layers = parameters.layer_materials()
    modulus = layers[0].young_modulus_pa
    return repr(
        (
            parameters.pad(),
            parameters.grid(),
            [
                (m.young_modulus_pa / modulus, m.poisson_ratio, m.friction_coefficient)
                for m in layers
            ],
        )
    )


def gather_batches(
    family: SensorFamily, wanted: Sequence[DesignBatch], device: str
) -> list[DesignBatch]:
    """Batches made of others, in the order of each one's first design."""
    groups: dict[tuple[str, Needs], list[DesignPoint]] = {}
    for batch in wanted:
        for design in batch.designs:
            key = sharing_key(family, design)
            groups.setdefault((key, (batch.metrics, batch.presses)), []).append(design)
    merged = GROUPS_ON_GPU if device.startswith("cuda") else 1
    batches: list[DesignBatch] = []
    room = 0
    for (_, needs), group in groups.items():
        for start in range(0, len(group), MAX_BATCH):
            part = DesignBatch(tuple(group[start : start + MAX_BATCH]), *needs)
            if room and (batches[-1].metrics, batches[-1].presses) == needs:
                batches[-1] = replace(part, designs=batches[-1].designs + part.designs)
                room -= 1
            else:
                batches.append(part)
                room = merged - 1
    return batches


def evaluate_batch(
    study: Study, root: Path, device: str, batch: DesignBatch, progress: Progress = silent
) -> None:
    """Evaluate designs as one batch and write each one's result.

    When a batch raises, its designs go one by one, so that only the one to blame is lost: an
    ``InputError`` or ``SimulationError`` makes a failed row, any other error a broken one with its
    traceback beside it. A full disk and the like are no design's fault: they are raised.
    """
    folder = StudyFolder(root)
    for design in batch.designs:
        folder.design(design.id).mkdir(parents=True, exist_ok=True)
    try:
        results = study.kit.evaluate(
            batch.designs,
            [study.presses[name] for name in batch.presses],
            [study.metrics[name] for name in batch.metrics],
            device=device,
            progress=progress,
            folder=folder.designs if study.spec.output.records else None,
            unit_spread=0.01 * study.spec.study.unit_spread_percent,
        )
        found = {result.point.id: result for result in results}
        if missing := [design.id for design in batch.designs if design.id not in found]:
            raise RuntimeError(f"the evaluation left out {', '.join(missing)}")
    except Exception as error:
        if is_of_a_file(error):
            raise
        if len(batch.designs) > 1:
            for single in batch.one_by_one():
                evaluate_batch(study, root, device, single, progress)
        else:
            folder.add_row(_lost_row(folder, batch, error))
        return
    for design in batch.designs:
        folder.add_row(_row(folder, study, batch, found[design.id]))


def _row(folder: StudyFolder, study: Study, batch: DesignBatch, result: DesignFigures) -> DesignRow:
    row = row_of(
        result,
        {name: study.figure_keys[name] for name in batch.metrics},
        {name: study.press_keys[name] for name in batch.presses},
        __version__,
        now(),
    )
    if row.unbuildable:
        return row
    try:
        name = study.name_of(row.parameters)
        files, causes = write_design_files(folder, result, study.spec.output, name)
    except Exception as error:
        if is_of_a_file(error):
            raise
        files, causes = {}, {"files": _note(folder, row.id, error)}
    return replace(row, files=files, causes={**row.causes, **causes})


def _lost_row(folder: StudyFolder, batch: DesignBatch, error: Exception) -> DesignRow:
    design = batch.designs[0]
    ours = isinstance(error, (InputError, SimulationError))
    cause = str(error) if ours else _note(folder, design.id, error)
    lost = broken_row(design, batch.metrics, cause)
    return replace(lost, status="failed") if ours else lost


def _note(folder: StudyFolder, design_id: str, error: Exception) -> str:
    """Keep the traceback; returns the error in one line."""
    folder.write_text(
        f"designs/{design_id}/traceback.txt", "".join(traceback.format_exception(error))
    )
    return f"{type(error).__name__}: {error}"


def broken_row(design: DesignPoint, metrics: tuple[str, ...], cause: str) -> DesignRow:
    """The row of a design that was lost for another reason."""
    return DesignRow(
        id=design.id,
        family=design.family,
        parameters=dict(design.parameters),
        status="broken",
        figures=dict.fromkeys(metrics),
        causes={"design": cause},
        tool_version=__version__,
        finished=now(),
    )


def now() -> str:
    """UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


PREVIEW_PX = 240
"""Longer side of the camera's preview."""
SECTION_RADII = 3.0
"""Half width of the section, in widths of the contact that the press is meshed for."""
_DPI = 90


def write_picture(
    parameters: FamilyParameters, records: dict[str, list[PressRecord]], path: Path, title: str
) -> str | None:
    """Draw the first press that got anywhere; returns its name, or None when none did."""
    for press, made in records.items():
        for record in made:
            if len(record.depth_mm) and record.down.stop:
                preview, why = camera_preview(parameters, record)
                save_figure(draw_design(record, preview, why, title), path, dpi=_DPI)
                return press
    return None


def camera_preview(
    parameters: FamilyParameters, record: PressRecord
) -> tuple[np.ndarray | None, str]:
    """What the camera would see at full depth, RGB levels [H, W, 3], or why there is no image."""
    try:
        model = view_model(
            parameters, record, size_px=PREVIEW_PX, enlarged=True, device=record.device
        )
        return model.render(record.positions_m(record.down.stop - 1)).rgb, ""
    except InputError as error:
        return None, str(error)


@in_report_style
def draw_design(record: PressRecord, preview: np.ndarray | None, why: str, title: str) -> Figure:
    """The preview above the section, at rest and at every step."""
    figure, (image, cut) = new_figure(3.9, 4.7, 2, 1, gridspec_kw={"height_ratios": [1.9, 1.0]})
    if preview is None:
        image.text(0.5, 0.5, f"no image:\n{why}", ha="center", va="center", wrap=True, fontsize=8)
    else:
        image.imshow(np.clip(np.round(preview), 0, 255).astype(np.uint8))
    image.set_axis_off()
    image.set_title(title, fontsize=9)
    _draw_section(cut, record)
    return figure


def _draw_section(axes: Any, record: PressRecord) -> None:
    reach = np.abs(record.in_press(record.rest_m[record.surface.node_idx])[:, 0]).max() * 1e3
    half = min(SECTION_RADII * max(_contact_mm(record), 1.0), 1.02 * reach)
    x, heights = section_mm(record, half, range(record.down.stop))
    bottom = -record.thickness_mm
    axes.fill_between(x, bottom, heights[-1], color=BLUE, alpha=0.12, linewidth=0)
    for height in heights[1:-1]:
        axes.plot(x, height, color=LIGHT, linewidth=0.8)
    axes.plot(x, heights[0], color=GREY, linewidth=1.0, linestyle="--", label="at rest")
    axes.plot(x, heights[-1], color=BLUE, linewidth=1.6, label=_label(record))
    axes.axhline(bottom, color=GREY, linewidth=1.5)
    axes.set_xlim(-half, half)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7.5)
    axes.set_xlabel("x through the press [mm]", fontsize=8)
    axes.set_ylabel("z [mm]", fontsize=8)
    axes.legend(fontsize=7.5, loc="upper center", ncols=2, bbox_to_anchor=(0.5, 1.3))


def _contact_mm(record: PressRecord) -> float:
    """Reach of the dent: half of the width over which the face moved by a tenth of the depth."""
    idx = record.surface.node_idx
    last = record.down.stop - 1
    moved = np.linalg.norm(record.moved_m[last][idx], axis=1) * 1e3
    x = np.abs(record.in_press(record.rest_m[idx])[:, 0]) * 1e3
    dented = x[moved > 0.1 * moved.max()]
    return float(dented.max()) / 2 if len(dented) else 1.0


def _label(record: PressRecord) -> str:
    step = record.down.stop - 1
    return f"{record.indenter}, {record.depth_mm[step]:.2g} mm, {record.force_n[step, 2]:.2g} N"


MESHES, STEPS, PICTURE = "meshes", "steps", "picture.png"
"""Designs with the same pad share one mesh and one STEP file, named by a hash of the pad."""


def write_design_files(
    folder: StudyFolder, result: DesignFigures, output: StudyOutput, name: str
) -> tuple[dict[str, str], dict[str, str]]:
    """Write what ``output`` asks for; ``name`` is what the picture calls the design.

    Returns:
        Files by kind, relative to the study's folder, and causes why some could not be written.
    """
    from taccel_lab.sensors.registry import sensor_family

    family = result.point.family
    sensor = sensor_family(family)
    parameters = sensor.parameters(result.point.parameters)
    pad = parameters.pad()
    files: dict[str, str] = {}
    causes: dict[str, str] = {}
    if output.meshes:
        files["mesh"] = f"{MESHES}/{content_id(repr(pad))}.vtu"
    if output.step:
        files["step"] = f"{STEPS}/{content_id(repr(pad))}.step"
    for kind, write in (("mesh", _write_mesh), ("step", _write_step)):
        path = folder.root / files.get(kind, ".")
        if kind not in files or path.is_file():
            continue
        path.parent.mkdir(exist_ok=True)
        try:
            write(pad, path, sensor.label)
        except InputError as error:
            causes[f"file {kind}"] = str(error)
            del files[kind]
    if output.pictures:
        file = f"designs/{result.point.id}/{PICTURE}"
        title = f"{sensor.label}, {name}"
        if write_picture(parameters, result.records, folder.root / file, title) is not None:
            files["picture"] = file
    return files, causes


def _write_mesh(pad: Pad, path: Path, family: str) -> None:
    """The gel at the default resolution; presses have their own, finer meshes."""
    from taccel_lab.cad.mesh.gel_mesh import gel_mesh
    from taccel_lab.geometry.vtu import write_mesh_vtu

    write_mesh_vtu(path, gel_mesh(pad))


def _write_step(pad: Pad, path: Path, family: str) -> None:
    from taccel_lab.cad.export import write_step
    from taccel_lab.cad.parts.pad_solid import labelled_solid

    write_step(labelled_solid(pad), path, name=f"{family}_gel_pad")
