# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab profile show``, ``validate``, ``report`` and ``add-view``; and ``taccel-lab
export``, which writes a profile for another simulator or tool."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile


def _profile_or_design(place: Path) -> SensorProfile:
    """The profile in a folder; where there is none, the catalogue's sensor of that name."""
    from taccel_lab.profile import load_profile
    from taccel_lab.sensors.profile import stock_sensor
    from taccel_lab.sensors.registry import catalogue_family

    if not place.exists() and catalogue_family(str(place)) is not None:
        return stock_sensor(str(place))
    return load_profile(place)


@dataclass(frozen=True)
class ProfileShow:
    """Show what a sensor profile holds and where each block comes from, one line per block."""

    profile: Positional[Path]
    """Profile folder; FOLDER@NAME is one of its views."""
    full: bool = False
    """Print every value with its sources, residuals and remarks."""
    json: bool = False
    """Print all of it as JSON."""

    def run(self) -> None:
        from taccel_lab.cli.console import print_json
        from taccel_lab.profile import load_profile

        profile = load_profile(self.profile)
        if self.json:
            views = {name: _as_dict(profile.seen_by(name)) for name in profile.views}
            print_json({**_as_dict(profile), **({"views": views} if views else {})})
        elif self.full:
            _print_tables(profile)
        else:
            _print_overview(profile, self.profile)


@dataclass(frozen=True)
class ProfileValidate:
    """Check a sensor profile: schema, bounds, parameters, file hashes, arrays, networks and their
    answers. Exits with 2 when unsound."""

    profile: Positional[Path]
    """Profile folder."""
    json: bool = False
    """Print the findings as JSON."""

    def run(self) -> None:
        from taccel_lab.cli.console import print_json, results
        from taccel_lab.profile import validate_profile

        findings = validate_profile(self.profile)
        errors = sum(finding.severity == "error" for finding in findings)
        if self.json:
            print_json(
                {
                    "profile": str(self.profile),
                    "valid": errors == 0,
                    "findings": [dataclasses.asdict(finding) for finding in findings],
                }
            )
        else:
            console = results()
            for finding in findings:
                style = "red" if finding.severity == "error" else "yellow"
                console.print(f"{finding.severity}: {finding}", style=style, soft_wrap=True)
            if not errors:
                console.print(f"{self.profile} is a sound profile", style="green", soft_wrap=True)
        if errors:
            plural = "s" if errors > 1 else ""
            raise InputError(f"{self.profile} is not a sound profile: {errors} error{plural}")


@dataclass(frozen=True)
class ProfileReport:
    """Write a page about a sensor profile: each block with its evidence, verdict and pictures."""

    profile: Positional[Path]
    """Profile folder, or a sensor of the catalogue."""
    out: Path
    """Folder to write: report.html, report.json and the pictures."""
    json: bool = False
    """Print what report.json says."""

    def run(self) -> None:
        from json import loads

        from taccel_lab.calibration.profile_page import profile_page
        from taccel_lab.cli.console import notes, print_json, working
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.report.page import write_page

        require_replaceable(self.out)
        page = profile_page(_profile_or_design(self.profile))
        console = notes()
        with working(console, "drawing the pictures"):
            write_page(page, self.out)
        if self.json:
            print_json(loads((self.out / "report.json").read_text("utf-8")))
        console.print(f"wrote {self.out / 'report.html'}")


@dataclass(frozen=True)
class ProfileAddView:
    """Put a camera among those of a profile: one more, or one that was calibrated.

    Example: taccel-lab profile add-view out/stereo camera_2 out/calibrated --out out/both
    """

    profile: Positional[Path]
    """Profile folder of the sensor."""
    name: Positional[str]
    """Name of the view; main is the camera of the profile itself."""
    seen: Positional[Path]
    """Profile folder whose camera, images and networks the view gets."""
    out: Path
    """Profile folder to write."""
    json: bool = False
    """Print the names of the views as JSON."""

    def run(self) -> None:
        from taccel_lab.cli.console import notes, print_json
        from taccel_lab.profile import load_profile, require_profile_folder, save_profile

        require_profile_folder(self.out)
        profile = load_profile(self.profile).with_view(self.name, load_profile(self.seen))
        save_profile(profile, self.out)
        if self.json:
            print_json({"profile": str(self.out), "views": list(profile.view_names())})
        notes().print(f"wrote {self.out}: {', '.join(profile.view_names())}")


def _as_dict(profile: SensorProfile) -> dict[str, Any]:
    blocks = {key: block.model_dump(mode="json") for key, block in profile.blocks().items()}
    networks = {
        "color": profile.color_weights,
        "normals": profile.normal_weights,
        "force": profile.force_weights,
    }
    for key, weights in networks.items():
        if weights is not None:
            shapes = {name: list(array.shape) for name, array in weights.items()}
            blocks[key]["weight_shapes"] = shapes
    return blocks


_KEY_VALUES: dict[str, tuple[str, ...]] = {
    "sensor": ("name", "family", "unit"),
    "gel": ("thickness_mm", "node_count"),
    "material": ("young_modulus_pa", "poisson_ratio", "friction_coefficient", "model"),
    "camera": ("width_px", "height_px", "mm_per_px_x", "mm_per_px_y"),
    "optics": ("model", "focal_x_px", "distance_mm"),
    "markers": ("columns", "rows", "pitch_x_mm", "pitch_y_mm"),
    "perturbation": ("noise_levels",),
}
"""What is shown of a block; residuals of the others."""
_MOST_VALUES, _MOST_RESIDUALS = 4, 2


def _print_overview(profile: SensorProfile, folder: Path) -> None:
    """A table of one screen: what each block says, where from, and what to know of it."""
    from taccel_lab.cli.console import print_table, results

    rows = []
    for key, values in _as_dict(profile).items():
        provenance = values.pop("provenance")
        origin = " ".join(word for word in (provenance["kind"], provenance.get("verdict")) if word)
        remarks = len(provenance.get("remarks") or ())
        told = f"{remarks} remark{'s' if remarks > 1 else ''}" if remarks else ""
        rows.append((key, origin, _said(key, values, provenance), told))
    print_table(("block", "from", "values, +- one standard deviation", "to know"), rows)
    console = results()
    for name in profile.views:
        words = f"a further camera, {name}: taccel-lab profile show {folder}@{name}"
        console.print(words, soft_wrap=True)
    for session in profile.sensor.recorded:
        when = "" if session.begun is None else f" on {session.begun:%Y-%m-%d}"
        short = "; a quick session, see --full for what that leaves out" if session.left_out else ""
        words = f"{', '.join(session.blocks)}: recorded with {session.camera}{when}{short}"
        console.print(words, soft_wrap=True)
    console.print(
        f"every value with its source and remarks: taccel-lab profile show {folder} --full; "
        f"as a page with pictures: taccel-lab profile report {folder} --out PAGE"
    )


def _said(key: str, values: dict[str, Any], provenance: dict[str, Any]) -> str:
    """A block's few values, or how well it was fitted where it is a network or an image."""
    spread = provenance.get("spread") or {}
    names = [name for name in _KEY_VALUES.get(key, ()) if values.get(name) is not None]
    residuals = sorted(
        (provenance.get("residuals") or {}).items(), key=lambda one: "heldout" not in one[0]
    )
    shown = {name: values[name] for name in names} or dict(residuals[:_MOST_RESIDUALS])
    return ("" if names or not shown else "off by ") + ", ".join(
        f"{name} {_number(value)}" + (f" +- {_number(spread[name])}" if name in spread else "")
        for name, value in list(shown.items())[:_MOST_VALUES]
    )


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _print_tables(profile: SensorProfile) -> None:
    from taccel_lab.cli.console import print_table

    for key, values in _as_dict(profile).items():
        flat = _flat(values | {"provenance": values.pop("provenance")})
        print_table((key, ""), [(name, str(value)) for name, value in flat.items()])


def _flat(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values by dotted names, those of inner tables and lists too."""
    flat: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{name}.")
        elif isinstance(value, list) and value and all(isinstance(one, dict) for one in value):
            flat |= _flat({str(k + 1): one for k, one in enumerate(value)}, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat


@dataclass(frozen=True)
class Export:
    """Export a sensor profile for another simulator or tool.

    export.json in the folder states what the files carry, what is left out and why, and the error
    of each approximation. docs/exporters.md describes the formats.
    """

    profile: Positional[Path]
    """Profile folder, or a sensor of the catalogue."""
    to: Literal[
        "taccel",
        "tacto",
        "taxim",
        "isaac-lab",
        "gs-sdk",
        "onnx",
        "safetensors",
        "opencv",
        "urdf",
    ]
    """Format.
    taccel: Taccel's fabrication list: JSON, tets as VTK, masks and markers, STL.
    tacto: TACTO's sensor configuration: YAML with camera, gel and lights, STL.
    taxim: Calibration folder of the PyPI package taxim and of TacEx: colour table, background.
    isaac-lab: Isaac Lab's GelSight data folder (TacSL) with its configuration.
    gs-sdk: gs_sdk's device file, background and network from colour to gradients.
    onnx: The networks of colour, normals and force as ONNX graphs.
    safetensors: The same networks as safetensors, with settings and formula.
    opencv: Camera matrix, distortion and pose as OpenCV's YAML.
    urdf: A URDF with meshes, inertias and the frames of gel and camera."""
    out: Path
    """Folder to write; an earlier export there is replaced when everything is done."""
    table: Path | None = None
    """Table fitted to captures, written instead of one distilled from the colour model: taxim only.
    calibrate color leaves it in its report folder as polycalib.npz."""
    json: bool = False
    """Print export.json instead of a summary."""

    def run(self) -> None:
        from taccel_lab.cli.console import notes, print_json, print_table, results, working
        from taccel_lab.files.output_folder import require_replaceable

        require_replaceable(self.out)
        profile = _profile_or_design(self.profile)

        from taccel_lab.exporters.export import export_profile

        with working(notes(), f"exporting {profile.sensor.name} to {self.to}"):
            document = export_profile(profile, self.to, self.out, table=self.table)
        if self.json:
            print_json(document)
            return
        rows = [
            *(("carries", *item) for item in document["carries"].items()),
            *(("left out", *item) for item in document["left_out"].items()),
            *(("figure", name, f"{x:.4g}") for name, x in document["approximations"].items()),
        ]
        print_table(("", "block", "what"), rows, f"{document['sensor']} for {document['peer']}")
        for note in document["notes"]:
            results().print(f"- {note}")
        results().print(f"wrote {len(document['files'])} files to {self.out}")
