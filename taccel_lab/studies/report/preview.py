# SPDX-License-Identifier: Apache-2.0
"""One design before it is built: the pictures of its camera, photometric figures, a few presses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.guards import require_range
from taccel_lab.progress import Progress, silent
from taccel_lab.report.style import BLUE, in_report_style, new_figure, save_figure
from taccel_lab.studies.evaluate.evaluate import evaluate_designs
from taccel_lab.studies.metrics import METRICS, Metric
from taccel_lab.studies.metrics.design_point import LOAD_N, DesignFigures, DesignPoint
from taccel_lab.studies.metrics.evidence import photometry, view_model
from taccel_lab.studies.presses.press_record import PressRecord
from taccel_lab.studies.presses.standard import standard_presses
from taccel_lab.studies.spec.readings import readings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taccel_lab.optics.frames import LightField, PreviewImage
    from taccel_lab.optics.photometry import Photometry
    from taccel_lab.sensors.base import FamilyParameters, SensorFamily

_GAIN = 3.0
"""Factor by which the picture of the change is amplified."""


@dataclass(frozen=True)
class DesignPreview:
    """What can be said of a design without building it."""

    family: SensorFamily
    parameters: FamilyParameters
    rest: PreviewImage
    light: LightField
    photometry: Photometry
    pressed: PreviewImage | None
    """Picture at full depth of the first press; None without presses."""
    further: Mapping[str, PreviewImage]
    """Pictures of further cameras: ``rest_NAME``, and ``pressed_NAME`` where one is pressed."""
    rest_of_press: PreviewImage | None
    """The same sensor untouched, on the mesh of the press."""
    record: PressRecord | None
    result: DesignFigures
    metrics: tuple[Metric, ...]
    """Metrics that the presses feed, in order."""

    def to_json(self) -> dict[str, Any]:
        """Figures with units, causes of missing ones, photometry, force curves."""
        return {
            "sensor": self.family.name,
            "parameters": self.parameters.values(),
            "figures": {
                metric.name: {
                    "value": self.result.figures.get(metric.name),
                    "unit": metric.unit,
                    "description": metric.description,
                    "cause": self.result.causes.get(metric.name),
                }
                for metric in self.metrics
            },
            "photometry": self.photometry.to_json(),
            "presses": self.result.curves,
            "causes": self.result.causes,
            "simulations": self.result.simulations,
        }


def preview_design(
    family: SensorFamily,
    overrides: Mapping[str, Any] | None = None,
    *,
    presses: Sequence[str] = ("sphere",),
    size_px: int = 640,
    device: str = "cpu",
    progress: Progress = silent,
) -> DesignPreview:
    """Render a design untouched and pressed, and compute what its presses tell.

    Args:
        family: Sensor of the catalogue.
        overrides: Parameters other than the defaults.
        presses: Names of standard presses; the picture shows the first one.
        size_px: Longest side of the pictures.
        device: Warp device.
        progress: As of ``evaluate_designs``.

    Raises:
        InputError: Parameters out of bounds, a family without optics, an unknown press.
    """
    require_range("the size of a preview", size_px, 32, 4096, "px")
    chosen = standard_presses(list(presses))
    parameters = family.parameters(overrides)
    look = partial(view_model, parameters, size_px=size_px, enlarged=True, device=device)
    model = look()
    by_name = {press.name: press for press in chosen}
    metrics = tuple(
        reading
        for metric in METRICS.values()
        if not metric.runs_task
        and (not metric.presses or {*metric.presses, *metric.also} & set(by_name))
        for reading in readings(metric, (), by_name, (LOAD_N,))
    )
    point = DesignPoint("design", family.name, dict(overrides or {}))
    (result,) = evaluate_designs([point], chosen, metrics, device=device, progress=progress)
    record = next((r for made in result.records.values() for r in made if r.down.stop), None)
    pressed = rest_of_press = last = None
    if record is not None:
        on_press = look(record)
        rest_of_press = on_press.render(record.rest_m)
        last = record.positions_m(record.down.stop - 1)
        pressed = on_press.render(last)
    further = {}
    for name, seen in parameters.views().items():
        view = partial(view_model, seen, size_px=size_px, enlarged=True, device=device)
        further[f"rest_{name}"] = view().render()
        if last is not None:
            further[f"pressed_{name}"] = view(record).render(last)
    light = model.light_field()
    return DesignPreview(
        family=family,
        parameters=parameters,
        rest=model.picture(light),
        light=light,
        photometry=photometry(parameters, device),
        pressed=pressed,
        further=further,
        rest_of_press=rest_of_press,
        record=record,
        result=result,
        metrics=metrics,
    )


def write_preview(preview: DesignPreview, folder: Path) -> dict[str, Path]:
    """Write pictures and figures into a folder; names by kind."""
    from taccel_lab.files.atomic_file import write_image, write_json

    files = {"figures": folder / "preview.json", "overview": folder / "overview.png"}
    write_json(files["figures"], preview.to_json())
    save_figure(draw_preview(preview), files["overview"])
    images = {"rest": preview.rest, "pressed": preview.pressed, **preview.further}
    for name, image in images.items():
        if image is not None:
            files[name] = folder / f"{name}.png"
            write_image(files[name], image.rgb)
    return files


@in_report_style
def draw_preview(preview: DesignPreview) -> Figure:
    """Pictures above, maps and force curves below."""
    figure, axes = new_figure(11.5, 7.0, 2, 3)
    _show(axes[0, 0], preview.rest.rgb, "untouched")
    _draw_press(axes[0, 1], axes[0, 2], preview)
    _draw_maps(figure, axes[1, 0], axes[1, 1], preview)
    _draw_forces(axes[1, 2], preview)
    given = preview.result.point.parameters
    said = [preview.family.label, *(f"{name} = {value}" for name, value in given.items())]
    figure.suptitle(f"{', '.join(said)}: predicted by the optical model, not captured")
    return figure


def _show(axes: Any, image: np.ndarray, title: str) -> None:
    axes.imshow(image)
    axes.set_title(title)
    axes.set_axis_off()


def _draw_press(picture: Any, change: Any, preview: DesignPreview) -> None:
    if preview.pressed is None or preview.rest_of_press is None or preview.record is None:
        for axes in (picture, change):
            axes.text(0.5, 0.5, "no press", ha="center", va="center")
            axes.set_axis_off()
        return
    record = preview.record
    step = record.down.stop - 1
    force = float(record.force_n[step, 2])
    _show(
        picture,
        preview.pressed.rgb,
        f"{record.indenter}, {record.depth_mm[step]:.2g} mm deep, {force:.2g} N",
    )
    moved = preview.pressed.rgb.astype(float) - preview.rest_of_press.rgb
    _show(
        change,
        np.clip(128 + _GAIN * moved, 0, 255).astype(np.uint8),
        f"change, {_GAIN:g} times, on grey",
    )


def _draw_maps(figure: Figure, size: Any, evenness: Any, preview: DesignPreview) -> None:
    from taccel_lab.optics.photometry import pixel_footprint

    across, down, _ = pixel_footprint(preview.light.points_mm)
    # The picture has other pixels than the camera.
    scale = preview.light.points_mm.shape[1] / preview.parameters.grid().width_px
    shown = size.imshow(scale * np.sqrt(across * down), cmap="viridis")
    figure.colorbar(shown, ax=size, shrink=0.8, label="[mm]")
    size.set_title("size of a camera pixel on the gel")
    light = preview.light.irradiance().mean(axis=-1)
    light = np.where(preview.light.mask, light, np.nan)
    shown = evenness.imshow(light / np.nanmean(light), cmap="magma", vmin=0)
    figure.colorbar(shown, ax=evenness, shrink=0.8, label="[share of the mean]")
    evenness.set_title("light on the coating")
    for axes in (size, evenness):
        axes.set_axis_off()


def _draw_forces(axes: Any, preview: DesignPreview) -> None:
    for k, (name, made) in enumerate(preview.result.records.items()):
        for record in made:
            depth = np.concatenate([[0.0], record.depth_mm[record.down]])
            force = np.concatenate([[0.0], record.normal_n])
            color = BLUE if len(preview.result.records) == 1 else f"C{k}"
            label = name if record is made[0] else None
            axes.plot(depth, force, "o-", markersize=3.5, color=color, label=label)
    axes.set_title("normal force")
    axes.set_xlabel("depth past first touch [mm]")
    axes.set_ylabel("force [N]")
    if preview.result.records:
        axes.legend()
