# SPDX-License-Identifier: Apache-2.0
"""The blocks of a sensor profile; those of its optics, and of how it answers a touch, are in
``optional_blocks``.

Every block is frozen, refuses unknown keys, checks its ``bounds`` and says where it comes from
(``Provenance``). Blocks are the same in memory and in ``profile.toml``; the arrays they describe
(mesh, background image, colour-model weights) lie beside them, see ``taccel_lab.profile.io``.

A block that is built from bad values raises ``InputError`` with the path of each wrong key. Use
``block.replace(...)`` for a changed copy; it is checked again, as ``model_copy`` would not be.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import cache
from pkgutil import resolve_name
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple, Self

from pydantic import (
    AwareDatetime,
    Field,
    StringConstraints,
    ValidationError,
    field_validator,
    model_validator,
)

from taccel_lab.errors import InputError
from taccel_lab.files.strict_model import (
    MAX_FAULTS,
    Flag,
    Number,
    Scalar,
    StrictModel,
    Whole,
    describe_errors,
)
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile.bounds import MOST_BRANCHES, evidence_faults, out_of_bounds
from taccel_lab.version import __version__

if TYPE_CHECKING:
    from taccel_lab.profile.schema import SensorBlock

SCHEMA_VERSION = 14

Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
Name = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f]+$")]
Text = Annotated[str, StringConstraints(min_length=1, max_length=20_000)]
ConfigValue = Scalar | list[Scalar] | list[list[Scalar]]


class Provenance(StrictModel):
    """Where a block comes from and how far it can be trusted."""

    tool_version: Name = Field(default_factory=lambda: __version__)
    """Version of taccel-lab that made the block."""
    created: AwareDatetime = Field(
        default_factory=lambda: datetime.now(UTC).replace(microsecond=0), strict=True
    )
    """When it was made, UTC."""
    kind: Literal["assumed", "stated", "published", "designed", "measured", "calibrated"]
    """Assumed for want of data; stated in the captures, which nothing here checked; taken from a
    publication or data sheet; a design choice; measured directly; or estimated from captures."""
    method: Text
    """How the values were obtained."""
    source: Text
    """The publication, data set or assumption the values rest on."""
    inputs: dict[Name, Sha256] = Field(default_factory=dict)
    """SHA-256 of every input, by file name."""
    residuals: dict[Name, Number] = Field(default_factory=dict)
    """What the fit left over; names carry the unit (``heldout_crop_psnr_db``)."""
    spread: dict[Name, Number] = Field(default_factory=dict)
    """Standard deviation, or cross-validated spread, of each estimated quantity."""
    valid_region: dict[Name, tuple[Number, Number]] = Field(default_factory=dict)
    """Interval of each quantity inside which the block was tested."""
    interval: dict[Name, tuple[Number, Number]] = Field(default_factory=dict)
    """95 % confidence interval of each estimated quantity, where it is not 2 spreads about it."""
    correlation: dict[Name, Number] = Field(default_factory=dict)
    """Correlation of two estimates, named ``first*second``, where it matters."""
    verdict: Literal["good", "usable", "weak"] | None = None
    """What a calibration says of itself; None of a block that was not calibrated."""
    remarks: tuple[Text, ...] = ()
    """What a user has to know: weak data, parameters that the data cannot tell."""

    @field_validator("created")
    @classmethod
    def _check_utc(cls, value: datetime) -> datetime:
        if value.utcoffset() != timedelta(0):
            raise ValueError("must be given in UTC (offset Z)")
        return value.astimezone(UTC)

    @model_validator(mode="after")
    def _check_evidence(self) -> Self:
        if self.kind == "calibrated":
            for name in ("inputs", "residuals", "valid_region"):
                if not getattr(self, name):
                    raise ValueError(f"a calibrated block must name its {name}; the table is empty")
        for table in ("valid_region", "interval"):
            for name, (low, high) in getattr(self, table).items():
                if low > high:
                    raise ValueError(f"{table}.{name}: {low} > {high}")
        for name, value in self.correlation.items():
            if not -1 <= value <= 1:
                raise ValueError(f"correlation.{name}: {value} is not in -1..1")
        return self


class Block(StrictModel):
    """A part of a profile, with its provenance."""

    key: ClassVar[str]
    """Name of the block's table in ``profile.toml`` and of its field in ``SensorProfile``."""

    provenance: Provenance

    if not TYPE_CHECKING:  # keeps the checked signature that type checkers derive from the fields
        # `/`: a key of a file may be called self.
        def __init__(self, /, **values: Any) -> None:
            try:
                super().__init__(**values)
            except ValidationError as error:
                faulty = {fault["loc"][0] for fault in error.errors() if fault["loc"]}
                rest = {name: value for name, value in values.items() if name not in faulty}
                lines = [f"{self.key}.{t}" for t in describe_errors(error, type(self)).splitlines()]
                lines += out_of_bounds(self.key, SimpleNamespace(**rest), self.key)
                raise InputError("\n".join(lines[:MAX_FAULTS])) from None
            faults = [
                *out_of_bounds(self.key, self, self.key),
                *evidence_faults(self.key, self.provenance, self),
            ]
            if faults:
                raise InputError("\n".join(faults))


class Session(StrictModel):
    """A recording that blocks of a profile rest on."""

    blocks: tuple[Name, ...] = Field(min_length=1)
    """Keys of the blocks."""
    camera: Text
    """Id by which the camera is found again, or the path of what was replayed."""
    begun: AwareDatetime | None = Field(default=None, strict=True)
    """When the untouched gel was taken, UTC."""
    source: Text | None = None
    """Where and by whom, as it was stated."""
    controls: dict[Name, Text] = Field(default_factory=dict)
    """What was said of exposure, gain and white balance when they were locked."""
    framing: Text
    """What was cut from the camera's images and made smaller."""
    left_out: tuple[Text, ...] = ()
    """What a short session does without, in words."""


class SensorBlock(Block):
    """Which sensor this is."""

    key: ClassVar[str] = "sensor"

    name: Name
    """Name of this very sensor or model, e.g. ``gelsight``."""
    family: Name
    """Design family in the catalogue, e.g. ``gelsight``."""
    parameters: dict[Name, ConfigValue] = Field(default_factory=dict)
    """Design parameters of the family; names carry the unit (``width_mm``)."""
    recorded: tuple[Session, ...] = ()
    """How the captures of calibrated blocks were recorded, where taccel-lab did that."""


class GelBlock(Block):
    """The gel pad's tetrahedral mesh, stored in ``mesh.npz``."""

    key: ClassVar[str] = "gel"

    file: Literal["mesh.npz"] = "mesh.npz"
    thickness_mm: Number
    """Depth of the pad below its apex [mm]."""
    node_count: Whole = Field(ge=4)
    tet_count: Whole = Field(ge=1)
    min_dihedral_deg: Number
    """Smallest dihedral angle of any tet [degrees]; a regular tet has 70.53."""


class _Solid(StrictModel):
    """A hyperelastic solid at small strain."""

    young_modulus_pa: Number
    """Young's modulus at small strain [Pa]."""
    poisson_ratio: Number
    """Poisson's ratio, from 0 and below 0.5."""
    density_kg_m3: Number

    @field_validator("poisson_ratio")
    @classmethod
    def _check_poisson_ratio(cls, value: float) -> float:
        if value >= 0.5:
            raise ValueError(
                "must be below 0.5: at 0.5 the gel is incompressible and its bulk modulus "
                "E / (3 (1 - 2 nu)) infinite; soft gels are modelled with 0.45 to 0.49"
            )
        if value < 0:
            raise ValueError("must be at least 0: no gel grows thicker when it is pulled")
        return value


class LayerMaterial(_Solid):
    """A layer over the gel proper, such as a skin."""

    name: Name


class BranchEntry(StrictModel):
    """A Maxwell branch of the gel (``bodies.material.MaxwellBranch``)."""

    relative_modulus: Number
    """Modulus over that of the relaxed gel."""
    time_s: Number
    """Relaxation time [s]."""


class FittedWith(StrictModel):
    """The presses that a material was fitted with: only like ones reproduce what it was fitted to.

    Stiffness is what makes simulated forces those of the records, so it depends on the element, the
    mesh, the contact range and the friction of the simulation.
    """

    physics: dict[Name, Scalar | dict[Name, Scalar]]
    """``PressPhysics.record()``."""
    friction_coefficient: Number
    """Coefficient of friction between tool and gel."""
    friction_measured: Flag
    """Whether a record told it; otherwise it was held, or is the one that fits best."""
    indenters: tuple[Name, ...] = ()
    """Indenters of the indentations, as ``taccel-lab press --indenter`` takes them."""
    touch_shift_mm: dict[Name, Number] = Field(default_factory=dict)
    """How much later the tool touched than each record says [mm]: a press reproduces a force at
    the recorded depth minus this."""


class MaterialBlock(Block, _Solid):
    """The gel as a solid, and the layers over it, if it has any."""

    key: ClassVar[str] = "material"

    model: Literal["neo_hookean", "stable_neo_hookean", "st_venant_kirchhoff", "mooney_rivlin"] = (
        "neo_hookean"
    )
    """Energy of the gel and of its layers."""
    mooney_ratio: Number = 0.0
    """Mooney-Rivlin only: c01 / (c10 + c01)."""
    branches: tuple[BranchEntry, ...] = Field(default=(), max_length=MOST_BRANCHES)
    """Maxwell branches of the gel and of its layers, three at most; ``young_modulus_pa`` is the
    modulus of the relaxed gel."""
    friction_coefficient: Number
    """Coulomb friction between the gel and what presses on it."""
    layers: tuple[LayerMaterial, ...] = ()
    """Materials of the mesh's layers 1, 2, ...; layer 0 is the gel proper, this block's own."""
    fitted_with: FittedWith | None = None
    """The presses that it was fitted with; None where it was not fitted to presses, or by a version
    that did not record them."""


class CameraBlock(Block):
    """The pixel grid that the tactile image lays over the gel (see ``PixelGrid``)."""

    key: ClassVar[str] = "camera"

    width_px: Whole
    height_px: Whole
    mm_per_px_x: Number
    mm_per_px_y: Number
    center_u_px: Number
    """Column of the gel frame's origin [px]."""
    center_v_px: Number
    """Row of the gel frame's origin [px]."""
    rectified: bool = False
    """Whether this is the grid of rectified images: the camera's own have another."""

    @classmethod
    def from_grid(
        cls, grid: PixelGrid, provenance: Provenance, rectified: bool = False
    ) -> CameraBlock:
        """Make the block of a pixel grid."""
        return cls(
            width_px=grid.width_px,
            height_px=grid.height_px,
            mm_per_px_x=grid.mm_per_px_x,
            mm_per_px_y=grid.mm_per_px_y,
            center_u_px=grid.center_u_px,
            center_v_px=grid.center_v_px,
            rectified=rectified,
            provenance=provenance,
        )

    def grid(self) -> PixelGrid:
        """Return the pixel grid of the tactile image."""
        return PixelGrid(
            width_px=self.width_px,
            height_px=self.height_px,
            mm_per_px_x=self.mm_per_px_x,
            mm_per_px_y=self.mm_per_px_y,
            center_u_px=self.center_u_px,
            center_v_px=self.center_v_px,
        )


class BackgroundBlock(Block):
    """The image of the untouched sensor, RGB, stored in ``background.npz``."""

    key: ClassVar[str] = "background"

    file: Literal["background.npz"] = "background.npz"


class ColorBlock(Block):
    """The model from pixel position and surface normal to colour change.

    Its weights are stored in ``color_model.safetensors``.
    """

    key: ClassVar[str] = "color"

    file: Literal["color_model.safetensors"] = "color_model.safetensors"
    architecture: dict[Name, ConfigValue]
    """What is needed to rebuild the network: features, layer widths, activation, scales."""


_CATALOGUE = "taccel_lab.sensors.registry:judge_parameters"
"""The judge of design parameters, named as an entry point names an object: families stand above
profiles, and packages bring more of them. It loads when the first profile is read."""


class ParameterVerdict(NamedTuple):
    """What a catalogue says of a block's parameters."""

    faults: tuple[str, ...] = ()
    """What the bounds of the family refuse, a sentence each."""
    unjudged: str = ""
    """Why nobody could judge them; empty where somebody did."""


def judge_parameters(sensor: SensorBlock) -> ParameterVerdict:
    """The verdict of the catalogue's families."""
    return _judge()(sensor)


@cache
def _judge() -> Callable[[SensorBlock], ParameterVerdict]:
    return resolve_name(_CATALOGUE)
