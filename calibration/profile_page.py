# SPDX-License-Identifier: Apache-2.0
"""A whole profile as a page: what each block says, how far to trust it, what it looks like, and
what its colour model answers to every normal at a few places of the image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.remarks import BLOCK, BLOCK_STATE
from taccel_lab.calibration.scores import profile_scores
from taccel_lab.files.atomic_file import eight_bit
from taccel_lab.profile import Block, SensorProfile
from taccel_lab.report.figures import draw_mesh
from taccel_lab.report.lead import Picture
from taccel_lab.report.mesh_view import mesh_view
from taccel_lab.report.page import Page, Table, picture
from taccel_lab.report.remark import Remark, Severity
from taccel_lab.report.style import BLUE, GREY, ORANGE, in_report_style, new_figure
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.perturbation import draw_perturbation
from taccel_lab.signals.perturbed_sensors import PerturbedSensors
from taccel_lab.with_error import NORMAL_95

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CORE = ("gel", "material", "camera", "background", "color")
"""Blocks without which a sensor cannot be simulated with pictures."""
DRAWS = 6
"""Sensors that are drawn from the spread."""
PLACES = ((0.5, 0.5), (0.2, 0.25), (0.8, 0.25), (0.2, 0.75), (0.8, 0.75))
"""Shares of the image's width and height: the middle and near the corners."""
DISC_SIZE = 65
SPAN = 0.7
"""Largest sine of the tilt at which colours are compared: 44 degrees."""
DISPLACEMENT_MM = -0.3
"""Indentation at which they are compared [mm]."""


def profile_page(profile: SensorProfile) -> Page:
    """The profile's report: verdict from the blocks' own, a table a block, and pictures."""
    blocks = profile.blocks()
    return Page(
        f"Sensor profile {profile.sensor.name}",
        f"A {profile.sensor.family}: {len(blocks)} blocks, "
        f"{sum(b.provenance.kind == 'calibrated' for b in blocks.values())} of them calibrated "
        "to captures.",
        _remarks(profile),
        (
            _overview(blocks),
            *_recordings(profile),
            *(
                table
                for key, block in blocks.items()
                for table in (_block_table(key, block), _residual_table(key, block))
                if table is not None
            ),
        ),
        _pictures(profile),
        {key: block.model_dump(mode="json") for key, block in blocks.items()},
        scores=profile_scores(profile),
    )


def _remarks(profile: SensorProfile) -> list[Remark]:
    found = []
    blocks = profile.blocks()
    for key, block in blocks.items():
        where = block.provenance
        if where.verdict == "weak":
            found.append(BLOCK_STATE(block=key, what="weak", grave=True))
        elif where.verdict == "usable":
            found.append(BLOCK_STATE(block=key, what="with reservations"))
        elif where.kind == "assumed" and key in CORE:
            how = f"taccel-lab calibrate {key} measures it"
            if key == "gel":
                how = "state what you measured on it under [design] of captures.toml"
            found.append(BLOCK(block=key, what=f"assumed, not measured; {how}"))
    return found + _block_remarks(blocks)


def _block_remarks(blocks: dict[str, Block]) -> list[Remark]:
    """Remarks of the blocks, once where several have the same; each as grave as it says."""
    keys: dict[str, list[str]] = {}
    for key, block in blocks.items():
        for text in block.provenance.remarks:
            keys.setdefault(text, []).append(key)
    found = []
    for text, of in keys.items():
        severity, _, message = text.partition(": ")
        if severity not in list(Severity):
            severity, message = Severity.INFO, text
        remark = BLOCK(block=", ".join(of), what=message)
        found.append(replace(remark, severity=Severity(severity)))
    return found


def _overview(blocks: dict[str, Block]) -> Table:
    """Calibrated blocks first; a row for all others that came about alike."""
    alike: dict[tuple[Any, ...], list[str]] = {}
    for key, block in blocks.items():
        of = block.provenance
        said = of.kind, of.verdict or "–", of.method, len(of.inputs) or None
        alike.setdefault(said, []).append(key)

    def sources(keys: list[str]) -> str:
        return "; ".join(dict.fromkeys(blocks[key].provenance.source for key in keys))

    rows = [
        (", ".join(keys), kind, verdict, method, sources(keys), inputs)
        for (kind, verdict, method, inputs), keys in alike.items()
    ]
    rows.sort(key=lambda row: row[1] != "calibrated")
    return Table("Blocks", ("blocks", "kind", "verdict", "method", "source", "inputs"), rows)


def _recordings(profile: SensorProfile) -> list[Table]:
    """How the captures were recorded: a row a fact, a column for what it is about."""
    rows: list[tuple[Any, ...]] = []
    for session in profile.sensor.recorded:
        begun = "not known" if session.begun is None else f"{session.begun:%Y-%m-%d %H:%M} UTC"
        rows += [
            ("blocks", ", ".join(session.blocks)),
            ("begun", begun),
            ("source", session.source or "not stated"),
            ("camera", session.camera),
            *session.controls.items(),
            ("framing", session.framing),
            *(("left out", text) for text in session.left_out),
        ]
    caption = "As taccel-lab capture record wrote it down, a session after another."
    return [Table("Recordings", ("fact", "value"), rows, caption)] if rows else []


def _block_table(key: str, block: Block) -> Table:
    where = block.provenance
    rows = []
    for name, value in _flat(
        block.model_dump(mode="python", exclude={"provenance", "recorded"})
    ).items():
        spread = where.spread.get(name)
        interval = where.interval.get(name)
        if interval is None and spread is not None and isinstance(value, (int, float)):
            interval = (value - NORMAL_95 * spread, value + NORMAL_95 * spread)
        tested = where.valid_region.get(name)
        rows.append((name, value, spread, _interval(interval), _interval(tested)))
    columns = ("key", "value", "standard deviation", "95 % interval", "tested within")
    return Table(key, columns, rows, folded=True)


def _residual_table(key: str, block: Block) -> Table | None:
    where = block.provenance
    shown = set(_flat(block.model_dump(mode="python", exclude={"provenance"})))
    rows: list[tuple[Any, ...]] = [
        ("residual", name, value, None) for name, value in where.residuals.items()
    ]
    rows += [("spread", n, v, None) for n, v in where.spread.items() if n not in shown]
    rows += [("tested within", n, *v) for n, v in where.valid_region.items() if n not in shown]
    rows += [("correlation", name, value, None) for name, value in where.correlation.items()]
    if not rows:
        return None
    return Table(f"{key}: evidence", ("kind", "quantity", "value", "to"), rows, folded=True)


def _interval(bounds: tuple[float, float] | None) -> str | None:
    return None if bounds is None else f"{bounds[0]:.4g} to {bounds[1]:.4g}"


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values by dotted key; long lists are shortened for the page, the JSON holds them whole."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{name}.")
        elif isinstance(value, (list, tuple)):
            text = ", ".join(str(item) for item in value)
            flat[prefix + name] = text if len(text) < 90 else f"{len(value)} entries"
        else:
            flat[prefix + name] = value
    return flat


def _pictures(profile: SensorProfile) -> list[Picture]:
    """What the sensor shows first, then its gel."""
    mesh, pictures = profile.mesh, []
    if profile.background_rgb is not None:
        pictures.append(
            Picture(
                "image_at_rest",
                profile.plot,
                "The untouched sensor, in mm of the gel frame"
                + ("; circles are the markers' places." if profile.markers else "."),
            )
        )
    if profile.color is not None:
        pictures.append(
            Picture(
                "color_response",
                lambda: draw_color_discs(profile_discs(profile)),
                "Colour of every normal, 0.3 mm below rest, at the middle and near the corners; "
                "the rim is a tilt of 44 degrees.",
            )
        )
    pictures.append(
        Picture(
            "mesh",
            lambda: draw_mesh(mesh.nodes_m, mesh.faces, mesh.face_regions),
            "The gel's mesh, faces by region.",
            mesh_view(mesh.nodes_m, mesh.faces, mesh.face_regions),
        )
    )
    if profile.depth_response is not None:
        pictures.append(_depth_response(profile))
    if profile.perturbation is not None and profile.background_rgb is not None:
        pictures.append(_perturbed(profile))
    return pictures


@picture("depth_response", "Indentation from how far a pixel darkens.")
def _depth_response(profile: SensorProfile) -> Figure:
    """Drop of the grey level against indentation, with the stated spread as a band."""
    block = profile.depth_response
    assert block is not None
    drop, depth = np.array(block.drop_levels), np.array(block.depth_mm)
    figure, axes = new_figure(6.4, 3.6)
    axes.grid(True)
    axes.plot(drop, depth, color=BLUE)
    sigma = block.provenance.spread.get("depth_mm")
    if sigma is not None:
        axes.fill_between(
            drop, depth - sigma, depth + sigma, color=ORANGE, alpha=0.25, linewidth=0,
            label="± 1 standard deviation",
        )  # fmt: skip
        axes.legend()
    axes.set(xlabel=f"background minus image, {block.channel} [levels]", ylabel="indentation [mm]")
    return figure


@picture("perturbed", "The image at rest of six sensors drawn from the measured spread.")
def _perturbed(profile: SensorProfile) -> Figure:
    """The image at rest of a few drawn sensors."""
    image, block = profile.background_rgb, profile.perturbation
    assert image is not None and block is not None
    rng = np.random.default_rng(0)
    sensors = PerturbedSensors(draw_perturbation(block, DRAWS, rng))
    images = sensors.apply(np.repeat(image[None].astype(np.float32), DRAWS, axis=0), rng)
    ratio = image.shape[0] / image.shape[1]
    figure, axes = new_figure(9.0, 6.0 * ratio + 0.4, 2, 3)
    for panel, drawn in zip(axes.ravel(), images, strict=True):
        panel.imshow(drawn.astype(np.uint8))
        panel.set_axis_off()
    return figure


@dataclass(frozen=True)
class NormalDisc:
    """Colour change that the model predicts at one pixel over the hemisphere of normals."""

    pixel_uv: tuple[float, float]
    delta_rgb: np.ndarray
    """Colour change [levels], shape [n, n, 3]: rows ny, columns nx from -``SPAN`` to ``SPAN``
    (``disc_normals``); NaN outside the disc."""


def disc_normals(count: int, max_sine: float) -> np.ndarray:
    """Unit normals over a disc of (nx, ny) for ``NormalDisc``: shape [count, count, 3].

    Rows run over ny and columns over nx from -max_sine to max_sine; NaN outside the disc.
    """
    axis = np.linspace(-max_sine, max_sine, count)
    nx, ny = np.meshgrid(axis, axis)
    sine2 = nx**2 + ny**2
    nz = np.sqrt(np.where(sine2 <= max_sine**2 * (1 + 1e-12), 1 - sine2, np.nan))
    return np.stack([np.where(np.isnan(nz), np.nan, n) for n in (nx, ny, nz)], axis=-1)


def profile_discs(profile: SensorProfile) -> tuple[NormalDisc, ...]:
    """Colour change over the hemisphere of normals at ``PLACES``; empty without a colour model."""
    model = ColorModel.from_profile(profile)
    if model is None:
        return ()
    normals = disc_normals(DISC_SIZE, SPAN)
    seen = np.isfinite(normals[..., 0])
    count = int(seen.sum())
    width, height = model.config.width_px, model.config.height_px
    discs = []
    for share_u, share_v in PLACES:
        u, v = round(share_u * (width - 1)), round(share_v * (height - 1))
        delta = np.full((*seen.shape, 3), np.nan)
        delta[seen] = model.predict_pixels(
            np.full(count, v * width + u),
            normals[seen],
            np.full(count, DISPLACEMENT_MM),
            np.broadcast_to([0.0, 0.0, 1.0], (count, 3)),
        )
        discs.append(NormalDisc((u, v), delta))
    return tuple(discs)


@in_report_style
def draw_color_discs(discs: tuple[NormalDisc, ...]) -> Figure:
    """Colour change over (nx, ny), as grey plus change, placed as the pixels lie in the image."""
    from matplotlib.patches import Circle

    columns = sorted({disc.pixel_uv[0] for disc in discs})
    rows = sorted({disc.pixel_uv[1] for disc in discs})
    figure, axes = new_figure(
        2.1 * len(columns) + 0.6, 2.25 * len(rows), len(rows), len(columns), squeeze=False
    )
    for panel in axes.ravel():
        panel.set_axis_off()
    for disc in discs:
        panel = axes[rows.index(disc.pixel_uv[1]), columns.index(disc.pixel_uv[0])]
        image = panel.imshow(
            eight_bit(128 + disc.delta_rgb),
            extent=(-SPAN, SPAN, SPAN, -SPAN),
            interpolation="bilinear",
        )
        panel.set_title(f"u {disc.pixel_uv[0]:.0f}, v {disc.pixel_uv[1]:.0f}", color=GREY)
        panel.plot(0, 0, "+", color="black", markersize=6, markeredgewidth=0.8)
        # Clipped a little inside the disc, where all neighbours of a sample are known.
        rim = Circle((0, 0), 0.97 * SPAN, fill=False, edgecolor=GREY, linewidth=0.8)
        panel.add_patch(rim)
        image.set_clip_path(rim)
    return figure
