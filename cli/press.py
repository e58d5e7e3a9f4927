# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab press``: press a rigid indenter into a sensor's gel and read what it senses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from taccel_lab.errors import InputError, naming

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from rich.console import Console

    from taccel_lab.envs import Indenter, PressOutcome, PressPath, PressPhysics
    from taccel_lab.envs.press_force import Told
    from taccel_lab.geometry import TetMesh
    from taccel_lab.profile import SensorProfile


@dataclass(frozen=True)
class Press:
    """Press an indenter into a gel: height map, normals, image, force and wrench, mesh, figures.

    Lengths are in mm in the gel frame: x right and y down in the image, z out of the gel; the
    origin is the middle of the contact face. What is about to be pressed is drawn first (scene.png)
    and can be looked at while the press is computed. Example: taccel-lab press gelsight --indenter
    sphere:2.0 --depth-mm 0.8 --shear-mm 0.3 0 --out out/press
    """

    sensor: Positional[str]
    """Profile folder, or a sensor of the catalogue, which has no colour model yet: its image is
    the one that the optical model predicts (predicted.png). Dots of the gel are written to
    markers.csv and drawn in markers.png."""
    out: Path
    """Folder to write; an earlier one is replaced when everything is done. A press that stops on
    its way leaves its finished steps there, and says where and why in press.json."""
    depth_mm: float | None = None
    """Depth past first touch [mm]; or give --force-n."""
    force_n: float | None = None
    """In place of a depth: press until the normal force is this, within 1 per cent [N]. The depth
    is found by presses of their own, two to four; --shear-mm and --twist-deg follow at that depth,
    where the force changes again."""
    indenter: str = "sphere:2.0"
    """sphere:RADIUS, cylinder:RADIUS, box:XxY, roller:RADIUSxLENGTH, edge:ANGLExLENGTH[xRADIUS],
    grating:PITCHxRIDGESxLENGTH, pair:RADIUSxGAP or mesh:FILE[@AXIS] (STL, PLY, OBJ), in mm and
    degrees. A file is placed by its own origin and axes, in mm: its origin comes to --at-mm, its x
    points right and its y down in the image, and its -z side goes into the gel first, or what
    @AXIS says, such as mesh:part.stl@+z. Its height above its origin does not matter."""
    texture: Path | None = None
    """Image whose grey is the height of the indenter's surface, white standing out most: laid over
    it along z, columns along x and rows along y, and repeated. It shows in the signals; the solver
    presses the indenter's own shape as the mean of it. Depth counts from its highest points."""
    texture_mm: tuple[float, float] = (0.05, 2.0)
    """Height from black to white, and width of the image on the indenter [mm]."""
    at_mm: tuple[float, float] = (0.0, 0.0)
    """Gel x and y of the indenter's axis, of a file's origin [mm]."""
    shear_mm: tuple[float, float] = (0.0, 0.0)
    """Sideways motion at full depth [mm]."""
    twist_deg: float = 0.0
    """Turn about +z at full depth [deg]."""
    friction: float | None = None
    """Friction coefficient; the profile's when left out."""
    step_mm: float = 0.2
    """Largest motion of a step [mm]."""
    step_deg: float = 2.0
    """Largest turn of a step [deg]."""
    accuracy: Literal["fast", "default", "reference"] = "default"
    """fast: errors of a few per cent in less time. default: force within 3 per cent, heights within
    5 um. reference: to check the others, ten times as long. Each estimates its own error."""
    tolerance: float | None = None
    """Force residual over the sum of the contact forces at which a step has converged; that of the
    accuracy when left out."""
    dhat_mm: float | None = None
    """Gap at which contact begins [mm]; that of the accuracy when left out."""
    element: Literal["linear", "quadratic"] | None = None
    """linear: only to see what it costs: forces tens of per cent too large near nu 0.5."""
    mesh: Literal["focused", "profile"] = "focused"
    """focused: fine around the contact. profile: the stored mesh as it is."""
    states: bool = False
    """Keep every step in states.npz, for taccel-lab view: gel, pressure, stress, forces, image."""
    device: str = "cpu"
    """Device of the solver: cpu, cuda:0 or auto."""
    json: bool = False
    """Print the figures as JSON instead of a table."""

    def run(self) -> None:
        from taccel_lab.cli.console import notes, print_json
        from taccel_lab.warp_output import quiet_warp

        quiet_warp()
        console = notes()
        outcome, _ = self.execute(console)
        if self.json:
            print_json({"folder": str(self.out), **outcome.figures()})
        else:
            _print_outcome(console, outcome)
        console.print(f"wrote {self.out}")

    def execute(self, console: Console) -> tuple[PressOutcome, np.ndarray | None]:
        """Press, write the files and return what was read and the image, if there is one."""
        import time
        from functools import cache, partial

        from taccel_lab.camera.gel_camera import camera_of, face_of
        from taccel_lab.cli.console import say_first_look
        from taccel_lab.envs import parse_indenter, profile_material, simulate_press
        from taccel_lab.envs.fitted_physics import physics_difference
        from taccel_lab.envs.press import check_depth, deepest_mm
        from taccel_lab.envs.press_files import write_press
        from taccel_lab.envs.press_force import FIRST_SHARE, check_force
        from taccel_lab.geometry.length_units import size_words
        from taccel_lab.model.devices import require_device
        from taccel_lab.output_folder import atomic_directory, require_replaceable
        from taccel_lab.scene import TriangleMesh
        from taccel_lab.sensors.profile import load_sensor
        from taccel_lab.sensors.registry import profile_sensor
        from taccel_lab.signals.color_model import ColorModel
        from taccel_lab.signals.rest_surface import rest_surface
        from taccel_lab.signals.texture import Texture
        from taccel_lab.studies.press_picture import write_scene

        require_replaceable(self.out)
        require_device(self.device)
        if (self.depth_mm is None) == (self.force_n is None):
            raise InputError("say how far to press: either --depth-mm or --force-n, not both")
        if self.force_n is not None:
            check_force(self.force_n)
        texture = None
        if self.texture is not None:
            texture = Texture.from_image(self.texture, *self.texture_mm)
        indenter = parse_indenter(self.indenter, texture)
        physics = self._physics()
        profile = load_sensor(self.sensor)
        stated = profile.material.friction_coefficient
        friction = stated if self.friction is None else self.friction
        note = physics_difference(profile.material, physics, friction)
        if note is not None:
            console.print(f"note: {note}")
        first_mm = FIRST_SHARE * profile.gel.thickness_mm
        if self.depth_mm is not None:
            first_mm = self.depth_mm
        self._path(first_mm)  # Refused before a mesh is made for it, as is what cannot be painted.
        check_depth(first_mm, profile)
        indenter.require_size(first_mm)
        if indenter.name.startswith("mesh:") and isinstance(indenter.shape, TriangleMesh):
            words = size_words(indenter.shape.vertices_m)
            console.print(f"note: {self.indenter} is {words}", soft_wrap=True, markup=False)
        ColorModel.from_profile(profile)
        mesh = cache(partial(self._mesh, profile, indenter))
        read: list[PressOutcome] = []
        failure: BaseException | None = None
        had_earlier = self.out.exists()
        with atomic_directory(self.out) as folder:
            # All of this without a kernel, which may have to be compiled: a picture within seconds.
            gel, family = mesh(physics, first_mm), profile_sensor(profile)
            aim = f"{self.depth_mm:g} mm" if self.force_n is None else f"to {self.force_n:g} N"
            scene = write_scene(folder, family, gel, indenter, self.at_mm, first_mm, aim)
            say_first_look(console, scene)
            started = time.perf_counter()
            camera = camera_of(profile)
            rest = rest_surface(profile.mesh, face_of(camera))

            def press(physics: PressPhysics, path: PressPath, told: Told) -> PressOutcome:
                gel = mesh(physics, path.depth_mm)
                outcome = simulate_press(
                    gel,
                    profile_material(profile.material, gel),
                    indenter,
                    self.at_mm,
                    path,
                    camera,
                    friction_coefficient=friction,
                    physics=physics,
                    designed_rest=rest,
                    device=self.device,
                    progress=told,
                    keep_states=self.states,
                    stopped=read.append,
                )
                read.append(outcome)
                return outcome

            try:
                with step_progress(console, f"pressing {self.indenter} {aim}") as progress:
                    if self.force_n is None:
                        outcome = press(physics, self._path(first_mm), progress)
                    else:
                        limit_mm = deepest_mm(gel, self.at_mm)
                        outcome = self._to_force(self.force_n, press, physics, limit_mm, progress)
            except BaseException as error:
                # Finished steps are kept; but who interrupts has not asked for an earlier result
                # to go.
                if not read or (had_earlier and not isinstance(error, Exception)):
                    raise
                failure, outcome = error, read[-1]
            seconds = time.perf_counter() - started
            rgb, frames = _painted(profile, outcome)
            about = {
                "sensor": self.sensor,
                "indenter": self.indenter,
                "texture": None if texture is None else str(self.texture),
                "texture_mm": None if texture is None else self.texture_mm,
                "at_mm": self.at_mm,
                "asked_force_n": self.force_n,
                "friction_coefficient": friction,
                "differs_from_calibration": note,
                "failure": None if failure is None else str(failure) or "interrupted",
                "seconds": seconds,
            }
            write_press(folder, outcome, profile, rgb, about, indenter, frames)
        if failure is not None:
            deepest = outcome.steps[-1].depth_mm
            console.print(
                f"wrote {self.out}: {len(outcome.steps)} finished steps, to {deepest:.4g} mm"
            )
            raise failure
        return outcome, rgb

    def _to_force(
        self,
        force_n: float,
        press: Callable[[PressPhysics, PressPath, Told], PressOutcome],
        physics: PressPhysics,
        limit_mm: float,
        told: Told,
    ) -> PressOutcome:
        """About how deep, by presses straight down of low accuracy; then as asked for."""
        from dataclasses import replace

        from taccel_lab.envs import PHYSICS, Accuracy
        from taccel_lab.envs.press_force import ROUGH_TOLERANCE, press_to_force

        first_mm = None
        if physics.accuracy != Accuracy.FAST:
            rough = replace(PHYSICS[Accuracy.FAST], element=physics.element)
            first_mm = press_to_force(
                force_n,
                lambda depth_mm, told: press(rough, self._path(depth_mm, aside=False), told),
                limit_mm,
                tolerance=ROUGH_TOLERANCE,
                told=told,
            ).path.depth_mm
        return press_to_force(
            force_n,
            lambda depth_mm, told: press(physics, self._path(depth_mm), told),
            limit_mm,
            first_mm=first_mm,
            told=told,
        )

    def _path(self, depth_mm: float, aside: bool = True) -> PressPath:
        from taccel_lab.envs import PressPath

        shear_mm, twist_deg = (self.shear_mm, self.twist_deg) if aside else ((0.0, 0.0), 0.0)
        return PressPath(depth_mm, shear_mm, twist_deg, self.step_mm, self.step_deg)

    def _physics(self) -> PressPhysics:
        """That of the accuracy, but for what is set here; what the solver does not take is refused
        by the option's name."""
        from dataclasses import replace

        from taccel_lab.bodies.bodies import check_friction
        from taccel_lab.envs import PHYSICS, Accuracy
        from taccel_lab.scene import Element

        physics = PHYSICS[Accuracy(self.accuracy)]
        if self.tolerance is not None:
            physics = replace(physics, relative_tolerance=self.tolerance)
            with naming("--tolerance"):
                physics.solver()
        if self.dhat_mm is not None:
            physics = replace(physics, dhat_m=self.dhat_mm * 1e-3)
            with naming("--dhat-mm"):
                physics.solver()
        if self.element is not None:
            physics = replace(physics, element=Element(self.element))
        with naming("--friction"):
            check_friction(self.friction, self.indenter)
        return physics

    def _mesh(
        self, profile: SensorProfile, indenter: Indenter, physics: PressPhysics, depth_mm: float
    ) -> TetMesh:
        if self.mesh == "profile":
            return profile.mesh
        from taccel_lab.sensors.press_mesh import profile_press_mesh

        try:
            contact = indenter.contact(depth_mm)
            return profile_press_mesh(profile, self.at_mm, contact, physics.mesh)
        except InputError as error:
            x, y = self.at_mm
            raise InputError(
                f"{self.sensor} cannot be meshed for a press at ({x:g}, {y:g}) mm: {error}"
            ) from error


def _painted(
    profile: SensorProfile, outcome: PressOutcome
) -> tuple[np.ndarray | None, list[np.ndarray] | None]:
    """The tactile image and those of all states that were kept, where colours are known."""
    from taccel_lab.signals.profile_options import image_painter

    paint = image_painter(profile, outcome.mesh)
    if paint is None:
        return None, None
    rgb = paint(outcome, outcome.positions_m)
    if outcome.states is None:
        return rgb, None
    rest, states = outcome.mesh.nodes_m, outcome.states
    seen = zip(states.surfaces, states.moved_m, strict=True)
    assert profile.background_rgb is not None
    return rgb, [profile.background_rgb, *(paint(one, rest + moved) for one, moved in seen)]


def step_progress(console: Console, title: str) -> Any:
    """A bar over the steps of a press, with the figures of the latest step beside it."""
    from contextlib import contextmanager

    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from taccel_lab.warp_output import first_step

    @contextmanager
    def bar() -> Any:
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}", markup=False),
            TimeElapsedColumn(),
        )
        with Progress(*columns, console=console) as progress:
            task = progress.add_task(title, total=None, note=first_step())

            def update(done: int, total: int, step: Any) -> None:
                report = step.report
                note = (
                    f"depth {step.depth_mm:.2f} mm, force {step.wrench[2]:.3g} N, residual "
                    f"{report.residual_n[0]:.1e} N, {report.newton_iterations[0]} Newton, "
                    f"{report.seconds:.2f} s"
                )
                progress.update(task, completed=done, total=total, note=note)

            yield update

    return bar()


def _print_outcome(console: Console, outcome: PressOutcome) -> None:
    from rich.table import Table

    figures = outcome.figures()
    force = figures["wrench"]["force_n"]
    moment = figures["wrench"]["moment_nm"] * 1e3
    table = Table("figure", "value", "unit", title="press", title_justify="left")
    for name, value, unit in (
        ("depth past first touch", f"{outcome.path.depth_mm:.4g}", "mm"),
        ("force of the gel on the indenter", "  ".join(f"{v:.4f}" for v in force), "N"),
        ("moment about the gel's origin", "  ".join(f"{v:.4f}" for v in moment), "N mm"),
        ("error of the force, estimated", f"{figures['force_error_n']:.4f}", "N"),
        ("error of the heights, estimated", f"{figures['height_error_m'] * 1e6:.1f}", "um rms"),
        ("contact radius (equal area)", f"{figures['contact_radius_mm']:.3f}", "mm"),
        ("force residual", f"{figures['residual_n']:.1e}", "N"),
        ("Newton iterations", f"{figures['newton_iterations']}", ""),
        ("smallest gap", f"{figures['min_distance_m'] * 1e6:.2f}", "um"),
        ("smallest volume ratio of a tet", f"{figures['smallest_volume_ratio']:.3f}", ""),
        ("time a step", f"{figures['seconds_per_step']:.2f}", "s"),
        ("nodes, tets", f"{outcome.mesh.node_count}, {outcome.mesh.tet_count}", ""),
    ):
        table.add_row(name, value, unit)
    if outcome.fine_force_n is not None:
        table.add_row("force of the contact with the texture", f"{outcome.fine_force_n:.4f}", "N")
    console.print(table)
