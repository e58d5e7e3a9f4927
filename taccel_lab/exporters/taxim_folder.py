# SPDX-License-Identifier: Apache-2.0
"""The calibration folder of the PyPI package taxim, which TacEx reads as well.

``polycalib.npz`` (table), ``dataPack.npz`` (background as ``f0``, BGR), ``gelmap.npy`` (height of
the gel in pixels), ``shadowTable.npz`` and ``params.json``, as taxim 1.4.1 loads them.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.exporters.record import ExportRecord, required
from taccel_lab.exporters.taxim_distil import DistilledTable, distil_table
from taccel_lab.exporters.taxim_table import (
    TABLE_FILE,
    TableFile,
    for_one_scale,
    one_scale,
    read_table,
)
from taccel_lab.files.atomic_file import eight_bit, write_by, write_json
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.rest_surface import rest_surface

BINS = 125
_DIRECTION_STEP = 0.1
_HEIGHT_STEPS = 9
_NO_SHADOW = [1e6]
"""A shadow is the least of the table and the image: this one never is."""

_RELATIVE = {
    # Widths of Taxim's blurs and shadow steps, as fractions of image width and height: those of the
    # folders that taxim ships, but for the background, which is not blurred.
    "initial_frame_sigma_rel": [0.078125, 0.10416666666666667],
    "shadow_step_rel": [0.001953125, 0.0026041666666666665],
    "deform_pyramid_sigma_rel": [
        [0.04765625, 0.02421875, 0.0125, 0.00546875, 0.003125, 0.00171875],
        [
            0.06354166666666666,
            0.03229166666666667,
            0.016666666666666666,
            0.007291666666666667,
            0.004166666666666667,
            0.0022916666666666667,
        ],
    ],
    "deform_final_sigma_rel": [0.003125, 0.004166666666666667],
    "shadow_blur_sigma_rel": [0.00171875, 0.0022916666666666667],
    "shadow_attachment_kernel_size_rel": [0.0078125, 0.010416667],
}


def export_taxim(profile: SensorProfile, folder: Path, table: Path | None = None) -> ExportRecord:
    """Write the folder; needs the block background and, without a ``table``, color.

    ``table`` is a file of a table that was fitted to captures (``TableFile``); without one,
    the table is distilled from the colour model.
    """
    if table is None:
        required(profile, "color", "a Taxim folder", profile.color)
    background = required(profile, "background", "a Taxim folder", profile.background_rgb)
    file: TableFile | None = None
    if table is None:
        made, origin = distil_table(profile, BINS), "distilled from the network"
    else:
        file = read_table(table)
        made, origin = _fitted(profile, file, table), f"fitted to captures, from {table.name}"
    bins = made.table.bins
    grid = profile.grid()
    thickness_px = profile.gel.thickness_mm / made.mm_per_px

    write_by(folder / TABLE_FILE, partial(np.savez, **made.table.arrays("bgr")))
    shape = (grid.height_px, grid.width_px)
    flat = np.full(shape, thickness_px, dtype=np.float64)
    write_by(folder / "gelmap.npy", lambda file: np.save(file, flat))
    bgr = eight_bit(background)[..., ::-1]
    pack = {"f0": bgr, "img_size": np.array(bgr.shape)}
    write_by(folder / "dataPack.npz", partial(np.savez_compressed, **pack))
    _write_shadows(folder / "shadowTable.npz")
    write_json(folder / "params.json", _params(profile, made.mm_per_px, bins))

    rest = rest_surface(profile.mesh, grid)
    record = ExportRecord(
        carries={
            "color": f"as Taxim's table of {bins} x {bins} bins, {origin}",
            "background": "as f0 of dataPack.npz, 8 bit",
            "camera": "image size and scale",
            "gel": "thickness, as a flat gelmap",
        },
        approximations={
            **made.errors,
            "gel_sag_mm": float(-rest.height_m[rest.covered].min()) * 1e3,
            "scale_difference": abs(grid.mm_per_px_x / grid.mm_per_px_y - 1),
        },
        notes=[
            "height maps are z of the gel frame in mm over the flat gel, negative in a dent; row "
            "and column are those of the profile's image",
            "taxim cuts what rises over the gel: subtract the largest value from the map of a "
            "surface that bulges beside the contact",
            "grad_r is blue and grad_b red, as the loader expects; f0 is BGR",
            "frame_mixing_percentage is 0: the background is shown as it is, not blurred",
            "contact_scale and the blurs are Taxim's model of the gel, with the defaults of its "
            "own folders; set contact_scale to 0 to render a surface that was simulated elsewhere",
        ],
    )
    if file is not None and file.image_size_px is None:
        record.notes.append(
            f"{table} does not say over which images its polynomials count; it is taken as one of "
            f"{grid.width_px}x{grid.height_px} px"
        )
    record.left_out["shadow"] = (
        "shadowTable.npz is neutral: the colour model holds no shadows cast beyond the pixel"
    )
    record.left_out["color.displacement"] = (
        "the table knows only normals; it holds the mean over the displacements of "
        + ("ball presses" if file is None else "what was captured")
    )
    record.left_out["gel.shape"] = (
        "slopes are those over the rest surface, so gelmap is flat and the sag of the gel is not "
        "in it"
    )
    record.no_place_for(profile, "material", "optics", "lights", "markers")
    record.dots_stand_still(profile)
    return record


def _fitted(profile: SensorProfile, file: TableFile, path: Path) -> DistilledTable:
    """The table of a file, for the reader's one scale; refused when made for other images."""
    grid = profile.grid()
    size = (grid.width_px, grid.height_px)
    if file.image_size_px is not None and file.image_size_px != size:
        raise InputError(
            f"{path}: the table counts over images of {file.image_size_px[0]}x"
            f"{file.image_size_px[1]} px, the profile's are {size[0]}x{size[1]} px"
        )
    scale, stretch = one_scale(grid)
    errors = {f"table_{name}": value for name, value in file.figures.items()}
    return DistilledTable(for_one_scale(file.table, stretch), scale, errors)


def _write_shadows(path: Path) -> None:
    directions = np.arange(0.0, 2 * np.pi, _DIRECTION_STEP)
    table = np.empty((3, len(directions), _HEIGHT_STEPS), dtype=object)
    for index in np.ndindex(table.shape):
        table[index] = list(_NO_SHADOW)
    # The format is an array of lists, which numpy can only pickle.
    shadows = {"shadowDirections": directions, "shadowTable": table}
    write_by(path, partial(np.savez, **shadows))


def _params(profile: SensorProfile, mm_per_px: float, bins: int) -> dict[str, dict[str, object]]:
    grid = profile.grid()
    return {
        "simulator": {
            "diff_threshold": 5,
            "frame_mixing_percentage": 0.0,
            "discretize_precision": _DIRECTION_STEP,
            "height_precision": 0.1,
            "fan_angle": 0.1,
            "fan_precision": 0.05,
            "contact_scale": 0.4,
            **_RELATIVE,
        },
        "sensor": {
            "pixmm": mm_per_px,
            "num_bins": bins,
            "w": grid.width_px,
            "h": grid.height_px,
        },
    }
