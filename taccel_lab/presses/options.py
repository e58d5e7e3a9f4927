# SPDX-License-Identifier: Apache-2.0
"""Every option of a press, with its default: ``press`` and ``taccel-lab press``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from taccel_lab.errors import InputError, naming
from taccel_lab.guards import require_known, require_positive, require_range
from taccel_lab.typed import typed

if TYPE_CHECKING:
    from taccel_lab.presses import PressPath, PressPhysics
    from taccel_lab.signals.texture import Texture

_LISTED_BY = "taccel-lab press --help"
_FILES = ("like", "untouched", "texture")
"""Options that are files."""


@typed
@dataclass(frozen=True)
class PressOptions:
    """How an indenter is pressed into a gel."""

    depth_mm: float | None = None
    """Depth past first touch [mm]; or give the force."""
    force_n: float | None = None
    """Normal force to press to in place of a depth, within 1 per cent [N]. Two to four
    extra presses find the depth. Shear and twist follow at that depth and change the force
    again."""
    like: Path | None = None
    """Image of a real press, in place of depth and place. The calibrated sensor reads both from it.
    One to three rough presses correct them, until their image reads the same. like.png shows photo,
    simulation and difference."""
    untouched: Path | None = None
    """Image of the untouched sensor for --like, if newer than the profile's. With a starter profile
    it is looked for beside the photo."""
    indenter: str = "sphere:2.0"
    """sphere:RADIUS, cylinder:RADIUS, box:XxY, roller:RADIUSxLENGTH, edge:ANGLExLENGTH[xRADIUS],
    grating:PITCHxRIDGESxLENGTH, pair:RADIUSxGAP or mesh:FILE[@AXIS] (STL, PLY, OBJ), in mm and
    degrees. A file's origin comes to --at-mm, its x points right and its y down in the image.
    Its -z side goes into the gel first, or the side of @AXIS, such as mesh:part.stl@+z. Its
    height above its origin does not matter."""
    texture: Path | None = None
    """Height map of the indenter's surface as a grey image, white highest. It is laid over the
    indenter along z (columns along x, rows along y) and repeated. It shows in the signals; the
    solver presses the indenter's smooth shape. Depth counts from its highest points."""
    texture_mm: tuple[float, float] = (0.05, 2.0)
    """Height from black to white, and width of the image on the indenter [mm]."""
    at_mm: tuple[float, float] = (0.0, 0.0)
    """Gel x and y of the indenter's axis, of a file's origin [mm]."""
    shear_mm: tuple[float, float] = (0.0, 0.0)
    """Sideways motion at full depth [mm]."""
    twist_deg: float = 0.0
    """Turn about +z at full depth [deg]."""
    friction: float | None = None
    """Friction coefficient. Default: the profile's."""
    step_mm: float = 0.2
    """Largest motion of a step [mm]."""
    step_deg: float = 2.0
    """Largest turn of a step [deg]."""
    speed_mm_s: float | None = None
    """Speed of the indenter, of a gel that relaxes (maxwell_modulus) [mm/s]. Default: 1."""
    hold_s: float = 0.0
    """Time at full depth, of a gel that relaxes [s]: the force falls."""
    unload: bool = False
    """Then go back to first touch: image and force are those after it, and press.json has the
    loop of force over depth."""
    accuracy: str = "default"
    """fast, default, reference, or the largest numerical error of the force, such as 3%. The three
    are fixed settings; a coarser press beside each measures its error. A percentage refines mesh,
    contact range and steps until that error is below it."""
    levels: int = 2
    """How often a percentage may refine, at most 4: each time takes about four times as long as the
    one before. The last press then states what is missing."""
    tolerance: float | None = None
    """Convergence tolerance: force residual over the sum of the contact forces. Default: that of
    the accuracy."""
    dhat_mm: float | None = None
    """Gap at which contact begins [mm]. Default: that of the accuracy, and a sixtieth of the depth
    at most."""
    element: Literal["linear", "quadratic"] | None = None
    """linear: for comparison only; forces are tens of per cent too large near nu 0.5."""
    mesh: Literal["focused", "profile"] = "focused"
    """focused: fine around the contact. profile: the stored mesh as it is."""
    states: bool = False
    """Keep every step in states.npz, for taccel-lab view: gel, pressure, stress, forces, image."""
    device: str = "cpu"
    """Device of the solver: cpu, cuda:0 or auto."""

    @classmethod
    def of(cls, **options: Any) -> Self:
        """Return the options of a call, in which files may be text; InputError for an unknown
        one."""
        for name, value in options.items():
            require_known("option of a press", name, cls.__dataclass_fields__, _LISTED_BY)
            if name in _FILES and isinstance(value, str):
                options[name] = Path(value)
            elif name == "indenter" and isinstance(value, Path):
                options[name] = f"mesh:{value}"
        return cls(**options)

    def require_aim(self) -> None:
        """Check that exactly one of depth, force and photo is given; InputError otherwise."""
        if self.untouched is not None and self.like is None:
            raise InputError("--untouched is the background of --like, which is not given")
        if self.like is not None:
            if (self.depth_mm, self.force_n, self.at_mm) != (None, None, (0.0, 0.0)):
                raise InputError(
                    "--like takes place and depth from the photo: leave out --depth-mm, --force-n "
                    "and --at-mm"
                )
            return
        if (self.depth_mm is None) == (self.force_n is None):
            raise InputError("say how far to press: one of --depth-mm, --force-n and --like")
        if self.force_n is not None:
            require_positive("the force of a press", self.force_n, "N")

    def aim(self) -> str:
        """Say how far the press goes."""
        if self.like is not None:
            return f"like {self.like.name}"
        return f"{self.depth_mm:g} mm" if self.force_n is None else f"to {self.force_n:g} N"

    @property
    def asked_share(self) -> float | None:
        """Wanted relative error of the force [1]; None for a grade."""
        from taccel_lab.presses.physics import Accuracy, parse_accuracy

        asked = parse_accuracy(self.accuracy)
        return None if isinstance(asked, Accuracy) else asked

    def path(self, depth_mm: float, aside: bool = True) -> PressPath:
        """Return the path to a depth [mm], then with ``aside`` its shear and twist, hold and way
        back."""
        from taccel_lab.presses import PressPath
        from taccel_lab.presses.path import SPEED_MM_S

        shear_mm, twist_deg = (self.shear_mm, self.twist_deg) if aside else ((0.0, 0.0), 0.0)
        return PressPath(
            depth_mm,
            shear_mm,
            twist_deg,
            self.step_mm,
            self.step_deg,
            back=self.unload and aside,
            speed_mm_s=SPEED_MM_S if self.speed_mm_s is None else self.speed_mm_s,
            hold_s=self.hold_s if aside else 0.0,
        )

    def read_texture(self) -> Texture | None:
        """Read the texture of the indenter's surface; InputError for an image that is none."""
        from taccel_lab.signals.texture import Texture

        if self.texture is None:
            return None
        return Texture.from_image(self.texture, *self.texture_mm)

    def physics(self) -> PressPhysics:
        """Return the physics of the accuracy, changed by the options that are set here.

        InputError names an option that the solver does not take."""
        from taccel_lab.bodies.bodies import check_friction
        from taccel_lab.presses import PHYSICS, Accuracy
        from taccel_lab.presses.numerical_error import MOST_LEVELS
        from taccel_lab.presses.physics import parse_accuracy
        from taccel_lab.scene import Element

        grade = parse_accuracy(self.accuracy)
        if self.unload and not isinstance(grade, Accuracy):
            raise InputError(
                f"--accuracy {self.accuracy} is of the force at the end, which --unload takes "
                "away: give fast, default or reference"
            )
        if not isinstance(grade, Accuracy):
            if (self.mesh, self.element) != ("focused", None):
                raise InputError(
                    f"--accuracy {self.accuracy} refines the mesh: leave out --mesh and --element"
                )
            require_range("--levels", self.levels, 0, MOST_LEVELS)
            grade = Accuracy.DEFAULT
        physics = PHYSICS[grade]
        if self.tolerance is not None:
            physics = replace(physics, relative_tolerance=self.tolerance)
            with naming("--tolerance"):
                physics.solver()
        if self.dhat_mm is not None:
            physics = replace(physics, dhat_m=self.dhat_mm * 1e-3)
            with naming("--dhat-mm"):
                physics.solver()
        if self.element is not None:
            require_known("element", self.element, Element)
            physics = replace(physics, element=Element(self.element))
        with naming("--friction"):
            check_friction(self.friction, self.indenter)
        return physics
