# SPDX-License-Identifier: Apache-2.0
"""``TactileVectorEnv``: a task as a ``gymnasium.vector.VectorEnv`` of torch tensors.

Everything stays on the solver's device but the report of a step, 80 bytes an environment, which the
solver reads, and which environments have ended, 1 byte each: these decide who steps next.

An environment's draws depend on its own seed and on how many episodes it has begun, and neither on
the others nor on the device: numbers are hashed from these, not taken from a stream.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.guards import nearest, require_known
from taccel_lab.learning.gel_colors import default_colors
from taccel_lab.learning.gel_faults import GelFaults
from taccel_lab.learning.gel_views import FORCES, VIEWS, GelViews
from taccel_lab.learning.gymnasium_names import AutoresetMode, VectorEnv, batch_space, spaces
from taccel_lab.learning.picture import EnvPicture
from taccel_lab.learning.ranges import Given
from taccel_lab.learning.task import LearningTask
from taccel_lab.model import Model
from taccel_lab.signals.frame_faults import FrameFaults
from taccel_lab.signals.gel_faces import Colors
from taccel_lab.solvers import Control, EnvStatus, SolverConfig, SolverIPC, StepReport
from taccel_lab.state import initial_state

if TYPE_CHECKING:
    from taccel_lab.learning.ranges import DrawnRange


wp.set_module_options({"enable_backward": False})


@wp.kernel
def _draw_kernel(
    seeds: wp.array(dtype=wp.int32),
    episodes: wp.array(dtype=wp.int32),
    draws: wp.array2d(dtype=wp.float64),
):
    env = wp.tid()
    state = wp.rand_init(seeds[env], episodes[env])
    for k in range(draws.shape[1]):
        draws[env, k] = wp.float64(wp.randf(state))


class EpisodeDraws:
    """Numbers of the episodes of a vector environment."""

    def __init__(self, model: Model, per_episode: int) -> None:
        """``per_episode``: numbers that each episode draws."""
        count, self._device = model.env_count, model.device
        self.seeds = wp.zeros(count, dtype=wp.int32, device=self._device)
        self.episodes = wp.zeros(count, dtype=wp.int32, device=self._device)
        """How many each environment has begun."""
        self._draws = wp.zeros((count, per_episode), dtype=wp.float64, device=self._device)

    def seed(self, first: int, who: torch.Tensor) -> None:
        """Environment i of ``who`` (bool, [env]) goes by seed ``first + i`` from now on, and is at
        its first episode again."""
        seeds = wp.to_torch(self.seeds)
        own = first + torch.arange(len(seeds), dtype=torch.int64, device=seeds.device)
        seeds.copy_(torch.where(who, own.to(torch.int32), seeds))
        wp.to_torch(self.episodes).masked_fill_(who, 0)

    def begin(self, who: torch.Tensor) -> torch.Tensor:
        """Numbers in [0, 1) of the next episode of each environment, float64, [env, per_episode];
        that of ``who`` (bool, [env]) begins, and the others will draw theirs again."""
        wp.launch(
            _draw_kernel,
            dim=len(self.seeds),
            inputs=[self.seeds, self.episodes],
            outputs=[self._draws],
            device=self._device,
        )
        wp.to_torch(self.episodes).add_(who)
        return wp.to_torch(self._draws).clone()


def randomise(
    model: Model, ranges: Sequence[DrawnRange], unit: torch.Tensor, who: torch.Tensor
) -> None:
    """Set parameters of bodies in the environments of ``who`` (bool, [env]): the k-th by the k-th
    number of each environment in [0, 1), float64, [env, ranges]."""
    for k, item in enumerate(ranges):
        value = (item.low + (item.high - item.low) * unit[:, k]).contiguous()
        for names in item.of:
            if item.what == "friction":
                model.set_friction(names[0], names[1], value, mask=who)
            else:
                model.set_body(names[0], **{item.what: value}, mask=who)


Observation = dict[str, torch.Tensor]
PROPRIOCEPTION = "proprioception"
OBSERVATIONS = (*VIEWS, PROPRIOCEPTION)
"""What there is to observe."""
RENDER_MODES = ("rgb_array",)
_HELD = ("solver", "state", "model", "task", "views", "_faults", "_picture", "_draws")
"""What has memory of the device."""


class TactileVectorEnv(VectorEnv[Observation, torch.Tensor, torch.Tensor]):
    """Environments of one solver, as gymnasium says.

    An episode is terminated by success and truncated by the step limit or by a simulation that
    failed, which is no exception: ``info["cause"]`` has the name of its ``EnvStatus``. With
    NEXT_STEP an environment that has ended is put to a new start by the next ``step``, which
    ignores its action, with a reward of 0; with SAME_STEP by the step that ends it; with DISABLED
    by ``reset(options={"reset_mask": mask})``, before it is stepped again.

    What ``step`` and ``reset`` return is memory of its own, a row for each environment: a dict of
    observations, rewards (float32), terminations and truncations (bool). ``info`` has ``success``
    (bool) and the task's figures (float32) as tensors, with ``faults`` the bits of those that the
    returned frames have, ``frame_faults`` (int32, [env, gel]; ``frame_faults.kinds_of`` names
    them), in ``reset``, too, and where a simulation failed ``cause``, an
    array of objects of the host, None elsewhere, with the mask ``_cause``. With SAME_STEP all of it
    is of the step that was taken, but observations of new episodes are of their starts: the last of
    the old ones are in ``final_obs``, with the mask ``_final_obs``.
    """

    def __init__(
        self,
        task: LearningTask,
        observe: str | Sequence[str] = ("wrench", PROPRIOCEPTION),
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        randomised: bool | Given = False,
        faults: FrameFaults | Mapping[str, Any] | None = None,
        size_px: tuple[int, int] = (80, 60),
        colors: Colors | None = None,
        view: PixelGrid | None = None,
        device: str | None = None,
        solver: dict[str, Any] | None = None,
        arrays: Literal["torch", "numpy"] = "torch",
        render_mode: str | None = None,
    ) -> None:
        """
        Args:
            task: As many environments as its scene has.
            observe: Name or names of ``OBSERVATIONS``; see ``GelViews.read`` for units.
            autoreset_mode: When ended environments begin anew, or the name of it.
            randomised: Whether episodes draw the parameters that the task randomises; ranges, by
                what is drawn, stand in place of the task's or the sensor's.
            faults: What can be wrong with frames of ``rgb`` and ``rgb_levels``, or a table of it
                by the fields of ``FrameFaults``; each gel has a camera.
            size_px: Width and height of images and depth.
            colors: For images: gives the colour network and the untouched image of a pixel grid;
                ``default_colors`` of the task's sensor when None.
            view: What pixels see of each gel; when None what the camera of the task's sensor does,
                without a sensor the contact face.
            device: "cpu" or "cuda:0"; as of ``Scene.finalize`` when None.
            solver: Settings of ``SolverConfig`` other than the task's.
            arrays: What ``step`` and ``reset`` return: tensors on the device, or arrays of the
                host, as gymnasium's wrappers take.
            render_mode: "rgb_array" for ``render``.

        Raises:
            InputError: Unknown observations, faults or modes, no colours, ranges of what is not
                drawn, faults without an image, or a sensor that does not state how far its gels
                spread.
        """
        observe = (observe,) if isinstance(observe, str) else tuple(observe)
        unknown = [name for name in observe if name not in OBSERVATIONS]
        if unknown or not observe or len(set(observe)) < len(observe):
            known, got = ", ".join(OBSERVATIONS), ", ".join(observe)
            meant = nearest(unknown[0], OBSERVATIONS) if unknown else ""
            raise InputError(f"observe names some of {known}, each once; got {got}{meant}")
        for name in solver or {}:
            require_known(
                "setting of the solver", name, [each.name for each in fields(SolverConfig)]
            )
        mode = str(getattr(autoreset_mode, "name", autoreset_mode))
        require_known("autoreset_mode", mode, [each.name for each in AutoresetMode])
        self._mode = AutoresetMode[mode]
        require_known("arrays", arrays, ("torch", "numpy"))
        if render_mode is not None:
            require_known("render_mode", render_mode, RENDER_MODES)
        if colors is None and ({"rgb", "rgb_levels"} & set(observe) or render_mode is not None):
            colors = default_colors(task.sensor)
        if view is None and task.sensor is not None:
            view = task.sensor.grid()
        stated = FrameFaults.of({} if faults is None else faults)
        self.render_mode = render_mode
        self._on_host = arrays == "numpy"
        self.task = task
        dt_s = task.scene.time.dt_s
        self.metadata = {
            "autoreset_mode": self._mode,
            "render_modes": list(RENDER_MODES),
            "render_fps": round(1 / dt_s),
        }
        self.model = task.scene.finalize(device)
        self.num_envs = self.model.env_count
        self.device = torch.device(wp.device_to_torch(self.model.device))
        """Device of all tensors."""
        self.solver = SolverIPC(self.model, replace(task.config, **(solver or {})))
        self.state = initial_state(self.model)
        task.attach(self.model, self.state)
        given = {} if isinstance(randomised, bool) else randomised
        self._ranges = task.ranges(given) if randomised else ()
        self._draws = EpisodeDraws(self.model, len(task.start_names) + len(self._ranges))
        self._seeded = False
        self._half = torch.tensor(task.start_half, dtype=torch.float64, device=self.device)
        self.views = GelViews(self.solver, observe, size_px, colors, view)
        """What the gels show and feel."""
        self._faults = GelFaults(stated, self.views, observe, self.num_envs)
        shown = render_mode is not None
        self._picture = EnvPicture(self.solver, self.state, colors, view) if shown else None
        self._observe = observe
        self._ended = np.ones(self.num_envs, dtype=bool)
        """Environments that are to begin an episode before they step, on the host."""
        self._steps = torch.zeros(self.num_envs, dtype=torch.int32, device=self.device)
        self._still = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        """Environments whose forces are those of no step of their episode."""
        self.single_action_space = spaces.Box(-1.0, 1.0, (len(task.action_names),), np.float32)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.single_observation_space = spaces.Dict({name: self._space(name) for name in observe})

    @cached_property
    def observation_space(self) -> spaces.Space:  # type: ignore[override]
        """Space of all environments; made on demand, as bounds of images take memory."""
        return batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin episodes.

        Args:
            seed: Environment i goes by seed + i, whatever runs beside it. When None episodes go on
                from the last seed, at first from one that nobody knows.
            options: ``reset_mask``: environments that begin, bool, [env], of numpy or torch; all
                when it is left out. ``start``: their starts, in place of drawn ones, [env,
                task.start_names].

        Raises:
            InputError: Unknown options or wrong shapes; after ``close``.
        """
        self._require_open()
        super().reset(seed=seed)
        options = dict(options or {})
        mask = self._mask(options.pop("reset_mask", None))
        start = options.pop("start", None)
        if options:
            raise InputError(f"options are reset_mask and start, got {', '.join(options)}")
        if start is not None:
            start = self._tensor(start, "start", len(self.task.start_names))
        if not self._seeded:
            first = int(self.np_random.integers(2**30)) if seed is None else seed
            self._draws.seed(first, torch.ones_like(self._still))
            self._seeded = True
        elif seed is not None:
            self._draws.seed(seed, torch.as_tensor(mask, device=self.device))
        self.begin_episodes(mask, start)
        return self._given((self._observation(), self._faults.kinds()))

    def step(
        self, actions: torch.Tensor
    ) -> tuple[Observation, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """A step of the environments whose episode goes on, by actions in [-1, 1], [env, action];
        see the class for the others. An action that is not a number ends its own environment.

        Raises:
            InputError: Wrong shape; before the first ``reset``, after ``close``; with DISABLED if
                an environment has ended and was not reset.
        """
        self._require_open()
        actions = self._tensor(actions, "actions", len(self.task.action_names))
        begin = self._ended.copy()
        if begin.any() and (self._mode is AutoresetMode.DISABLED or not self._seeded):
            which = ", ".join(map(str, np.flatnonzero(begin)[:5]))
            raise InputError(f"environments {which} have no episode: reset() begins one")
        if begin.any():
            self.begin_episodes(begin, None)
        going = torch.as_tensor(~begin, device=self.device)
        targets = self.task.act(going, actions.clamp(-1.0, 1.0))
        # Whatever a task makes of it, such as nothing while its gels close.
        targets = targets.masked_fill(actions.isnan().any(dim=1)[:, None, None], torch.nan)
        failed = np.zeros(self.num_envs, dtype=bool)
        info: dict[str, Any] = {}
        if not begin.all():
            report = self.solver.step(self.state, Control(target_poses=targets), who=~begin)
            failed = ~begin & ~report.converged
            info |= _causes(report, failed)
        good = going if not failed.any() else torch.as_tensor(~begin & ~failed, device=self.device)
        judged = self.task.judge()
        self._steps += going
        self._still &= ~good
        terminated = good & judged.success
        over = good & ~judged.success & (self._steps >= self.task.step_limit)
        truncated = over if not failed.any() else over | (going & ~good)
        self._ended = (terminated | truncated).cpu().numpy()
        reward = torch.where(good, judged.reward, 0.0)
        info |= {"success": terminated.clone(), **judged.figures}
        seen = self._observation()
        if self._mode is AutoresetMode.SAME_STEP and self._ended.any():
            info |= {"final_obs": seen, "_final_obs": terminated | truncated}
            self.begin_episodes(self._ended, None)
            seen = self._observation()
        info |= self._faults.kinds()
        return self._given((seen, reward, terminated, truncated, info))

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture of each environment, see ``EnvPicture``; None unless ``render_mode`` was set.

        Raises InputError after ``close``.
        """
        self._require_open()
        return None if self._picture is None else self._picture.draw(self.state)

    def close_extras(self, **kwargs: Any) -> None:
        """Let the device's memory go."""
        for name in _HELD:
            # An environment that could not be made is closed, too.
            self.__dict__.pop(name, None)

    def _require_open(self) -> None:
        if self.closed:
            raise InputError("the environment is closed: make another one")

    def begin_episodes(self, mask: np.ndarray, start: torch.Tensor | None) -> None:
        """New episodes in the environments of a mask (bool, [env]), from drawn starts when None;
        ``reset`` and NEXT_STEP do it."""
        who = torch.as_tensor(mask, device=self.device)
        unit = self._draws.begin(who)
        count = len(self.task.start_names)
        if start is None:
            start = self._half * (2 * unit[:, :count] - 1)
        poses = self.task.begin(who, start)
        randomise(self.model, self._ranges, unit[:, count:], who)
        self.solver.reset(self.state, who, poses)
        self._steps.masked_fill_(who, 0)
        self._still |= who
        self._ended = self._ended & ~mask

    def _given(self, value: Any) -> Any:
        """Tensors in it as the arrays that the user wants."""
        if not self._on_host:
            return value
        if isinstance(value, torch.Tensor):
            return value.cpu().numpy()
        if isinstance(value, dict):
            return {key: self._given(inner) for key, inner in value.items()}
        return tuple(map(self._given, value)) if isinstance(value, tuple) else value

    def _observation(self) -> Observation:
        found = {}
        for name in self._observe:
            if name == PROPRIOCEPTION:
                found[name] = self.task.proprioception().float()
                continue
            if name in self._faults.names:
                draws = self._draws
                found[name] = self._faults.read(
                    name, self.state, draws.seeds, draws.episodes, self._steps
                )
                continue
            seen = self.views.read(name, self.state)
            if name in FORCES:
                seen = seen.masked_fill(self._still.view(-1, *[1] * (seen.ndim - 1)), 0)
            found[name] = seen
        return found

    def _space(self, name: str) -> spaces.Box:
        if name == PROPRIOCEPTION:
            size = len(self.task.proprioception_names)
            return spaces.Box(-np.inf, np.inf, (size,), np.float32)
        return self.views.space(name)

    def _tensor(self, value: Any, name: str, width: int) -> torch.Tensor:
        # Policies outside ``torch.no_grad`` give actions with a gradient, which ends here.
        found = torch.as_tensor(value, dtype=torch.float64, device=self.device).detach()
        if found.shape != (self.num_envs, width):
            shape = list(found.shape)
            raise InputError(f"{name} must have shape [{self.num_envs}, {width}], got {shape}")
        return found

    def _mask(self, value: Any) -> np.ndarray:
        if value is None:
            return np.ones(self.num_envs, dtype=bool)
        found = value.cpu().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)
        if found.shape != (self.num_envs,) or found.dtype != bool or not found.any():
            raise InputError(
                f"reset_mask must be bool of shape [{self.num_envs}] and name an environment, got "
                f"{found.dtype} of shape {list(found.shape)}"
            )
        return found


def _causes(report: StepReport, failed: np.ndarray) -> dict[str, Any]:
    """Why simulations failed, for ``info``."""
    if not failed.any():
        return {}
    causes = np.full(len(failed), None, dtype=object)
    for env in np.flatnonzero(failed):
        causes[env] = EnvStatus(int(report.status[env])).name
    return {"cause": causes, "_cause": failed}
