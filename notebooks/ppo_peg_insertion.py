# SPDX-License-Identifier: Apache-2.0
"""Proximal policy optimisation of the peg insertion, in one file, after CleanRL's
``ppo_continuous_action.py`` [Huang et al. 2022, JMLR 23:274].

    python notebooks/ppo_peg_insertion.py --device cuda:0 --envs 256 --updates 300
    python notebooks/ppo_peg_insertion.py --draw out/ppo_peg_insertion

Needs warp, numpy, scipy, torch and gymnasium, matplotlib for the picture alone, and tensorboard for
--tensorboard, which writes each row of the curve as scalars of its number of steps. Writes
curve.json, a row an update, policy.pt and curve.png into --output; Ctrl-C keeps what there is. At
the end the policy, without noise, meets the 64 starts of the task's own seeds, as its blind
baseline does.
"""

from __future__ import annotations

import argparse
import json
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import nn

from taccel_lab.files.atomic_file import write_json
from taccel_lab.learning.catalogue import make_vec
from taccel_lab.learning.scalars import Scalars, scalars_in, unwritten
from taccel_lab.report.machine import describe_run
from taccel_lab.tasks.draw import draw

TASK = "peg-insertion"
BASELINE = 53 / 64
"""Success rate of the task's blind baseline on seeds 0 to 63 (docs/tasks.md)."""
FOLDERS = ("output", "draw", "tensorboard")
"""Options that say where, and nothing of what is learned."""


class Policy(nn.Module):
    """A Gaussian policy and a value, of observations that are normalised by what was seen."""

    def __init__(self, observed: int, acted: int, width: int = 128) -> None:
        super().__init__()

        def layers(out: int, gain: float) -> nn.Sequential:
            sizes = [(observed, width, 2**0.5), (width, width, 2**0.5), (width, out, gain)]
            parts: list[nn.Module] = []
            for before, after, scale in sizes:
                linear = nn.Linear(before, after)
                nn.init.orthogonal_(linear.weight, scale)
                nn.init.zeros_(linear.bias)
                parts += [linear, nn.Tanh()]
            return nn.Sequential(*parts[:-1])

        self.mean, self.value = layers(acted, 0.01), layers(1, 1.0)
        self.log_std = nn.Parameter(torch.full((acted,), -0.5))
        self.register_buffer("seen", torch.zeros(3, observed))  # count, mean, sum of squares

    def see(self, x: torch.Tensor) -> None:
        """Follow mean and variance of what is observed [Chan et al. 1979]."""
        count, mean, squares = self.seen
        more, total = len(x), count + len(x)
        step = x.mean(dim=0) - mean
        squares = squares + x.var(dim=0, unbiased=False) * more + step**2 * count * more / total
        self.seen = torch.stack([total, mean + step * more / total, squares])

    def normalised(self, x: torch.Tensor) -> torch.Tensor:
        count, mean, squares = self.seen
        return ((x - mean) / (squares / count.clamp(min=1) + 1e-6).sqrt()).clamp(-10, 10)

    def values(self, x: torch.Tensor) -> torch.Tensor:
        """Values of observations that are normalised."""
        return self.value(x).squeeze(-1)

    def actions(self, x: torch.Tensor) -> torch.distributions.Normal:
        """Distribution of actions at observations that are normalised."""
        return torch.distributions.Normal(self.mean(x), self.log_std.exp())


def flat(observation: dict[str, torch.Tensor]) -> torch.Tensor:
    """All of it in a row for each environment."""
    return torch.cat([part.flatten(1).float() for part in observation.values()], dim=1)


def advantages(rows: dict[str, torch.Tensor], gamma: float, decay: float) -> torch.Tensor:
    """Generalised advantage estimates [Schulman et al. 2016]; what a truncated episode would have
    got is its last observation's value, a terminated one gets nothing more."""
    found = torch.zeros_like(rows["reward"])
    carry = torch.zeros_like(found[0])
    for k in reversed(range(len(found))):
        more = gamma * rows["next_value"][k] * ~rows["terminated"][k]
        error = rows["reward"][k] + more - rows["value"][k]
        carry = error + gamma * decay * carry * ~rows["ended"][k]
        found[k] = carry
    return found


def improve(
    policy: Policy, optimizer: torch.optim.Optimizer, rows: dict[str, torch.Tensor], args: Any
) -> dict[str, float]:
    """Epochs over the rollout; steps that only began an episode do not count."""
    gained = advantages(rows, args.gamma, args.gae_lambda)
    keep = rows["counts"].flatten()
    data = {name: rows[name].flatten(0, 1)[keep] for name in ("observation", "action", "log_prob")}
    data["gained"] = gained.flatten()[keep]
    data["wanted"] = (gained + rows["value"]).flatten()[keep]
    figures: dict[str, float] = {}
    for _ in range(args.epochs):
        order = torch.randperm(len(data["gained"]), device=gained.device)
        for chosen in order.chunk(args.minibatches):
            part = {name: value[chosen] for name, value in data.items()}
            actions = policy.actions(part["observation"])
            change = actions.log_prob(part["action"]).sum(1) - part["log_prob"]
            ratio = change.exp()
            # Of one row, too, whose unbiased deviation is not a number.
            spread = part["gained"].std(unbiased=False)
            scaled = (part["gained"] - part["gained"].mean()) / (spread + 1e-8)
            bounded = ratio.clamp(1 - args.clip, 1 + args.clip)
            policy_loss = -torch.minimum(ratio * scaled, bounded * scaled).mean()
            value_loss = (policy.values(part["observation"]) - part["wanted"]).square().mean()
            entropy = actions.entropy().sum(1).mean()
            loss = policy_loss + 0.5 * value_loss - args.entropy * entropy
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
            optimizer.step()
        figures = {
            "policy_loss": policy_loss.item(),
            "value_loss": value_loss.item(),
            "kl": (ratio - 1 - change).mean().item(),
            "std": policy.log_std.exp().mean().item(),
        }
    return figures


def train(args: argparse.Namespace, scalars: Scalars = unwritten) -> dict[str, Any]:
    """Learn, print a line an update, and write the results; returns what curve.json holds."""
    torch.manual_seed(args.seed)
    env = make_vec(
        TASK, args.envs, observe=tuple(args.observe), randomised=args.randomised, device=args.device
    )
    observation = flat(env.reset(seed=args.seed)[0])
    policy = Policy(observation.shape[1], env.single_action_space.shape[0]).to(env.device)
    optimizer = torch.optim.Adam(policy.parameters(), lr=args.lr, eps=1e-5)
    curve: dict[str, Any] = {
        "what": "PPO of peg-insertion: a row an update, of the episodes that ended in it",
        "run": describe_run(args.device),
        "settings": {k: v for k, v in vars(args).items() if k not in FOLDERS},
        "complete": False,
        "baseline_success": BASELINE,
        "rows": [],
    }
    started = time.perf_counter()
    beginning = torch.zeros(args.envs, dtype=torch.bool, device=env.device)
    returned = torch.zeros(args.envs, device=env.device)
    taken = 0
    try:
        for update in range(1, args.updates + 1):
            for group in optimizer.param_groups:
                group["lr"] = args.lr * (1 - (update - 1) / args.updates)
            rollout: list[dict[str, torch.Tensor]] = []
            failed = 0
            for _ in range(args.steps):
                with torch.no_grad():
                    policy.see(observation)
                    x = policy.normalised(observation)
                    actions, value = policy.actions(x), policy.values(x)
                    action = actions.sample()
                    seen, reward, terminated, truncated, info = env.step(action)
                    observation = flat(seen)
                    # NEXT_STEP: this is the episode's own last observation where it has ended.
                    next_value = policy.values(policy.normalised(observation))
                ended = terminated | truncated
                returned = torch.where(beginning, 0.0, returned) + reward
                rollout.append(
                    {
                        "observation": x,
                        "action": action,
                        "log_prob": actions.log_prob(action).sum(1),
                        "value": value,
                        "next_value": next_value,
                        "reward": reward,
                        "terminated": terminated,
                        "ended": ended,
                        "counts": ~beginning,
                        "returned": returned,
                    }
                )
                failed += int(info["_cause"].sum()) if "cause" in info else 0
                beginning = ended
            rows = {name: torch.stack([row[name] for row in rollout]) for name in rollout[0]}
            losses = improve(policy, optimizer, rows, args)
            taken, episodes = taken + int(rows["counts"].sum()), int(rows["ended"].sum())
            row = {
                "update": update,
                "env_steps": taken,
                "seconds": round(time.perf_counter() - started, 2),
                "episodes": episodes,
                "success": float(rows["terminated"].sum()) / max(episodes, 1),
                "return": float((rows["returned"] * rows["ended"]).sum()) / max(episodes, 1),
                "reward": float(rows["reward"][rows["counts"]].mean()),
                "failed": failed,
                **losses,
            }
            curve["rows"].append(row)
            scalars(row, taken)
            print(
                f"update {update}/{args.updates}, {taken:,} steps, {row['seconds']:.0f} s: return "
                f"{row['return']:.3f}, success {row['success']:.1%} of {episodes} episodes, "
                f"{failed} simulations failed",
                flush=True,
            )
            if update % args.save_every == 0:
                save(args.output, policy, curve)
        curve["complete"] = True
    except KeyboardInterrupt:
        print("interrupted: what was learned is kept")
    save(args.output, policy, curve)
    if args.judge and curve["complete"]:
        curve["judged"] = judge(policy, args)
        print("on the task's own starts:", curve["judged"])
        save(args.output, policy, curve)
    if find_spec("matplotlib"):
        draw_curve(args.output)
    return curve


def judge(policy: Policy, args: argparse.Namespace) -> dict[str, Any]:
    """The policy without noise on the starts of the task's seeds."""
    options: dict[str, Any] = {"observe": tuple(args.observe), "device": args.device}
    env = make_vec(TASK, args.judge, autoreset_mode=AutoresetMode.DISABLED, **options)
    half = dict(zip(env.task.start_names, env.task.start_half, strict=True))
    starts = np.array([list(draw(seed, half).values()) for seed in range(args.judge)])
    observation, _ = env.reset(seed=args.seed, options={"start": starts})
    success = torch.zeros(args.judge, dtype=torch.bool, device=env.device)
    open_ = torch.ones_like(success)
    while open_.any():
        with torch.no_grad():
            action = policy.actions(policy.normalised(flat(observation))).mean
        observation, _, terminated, truncated, _ = env.step(action)
        success |= terminated & open_
        ended = terminated | truncated
        open_ &= ~ended
        if ended.any():
            observation, _ = env.reset(options={"reset_mask": ended})
    return {"seeds": args.judge, "successes": int(success.sum()), "baseline": BASELINE}


def save(folder: Path, policy: Policy, curve: dict[str, Any]) -> None:
    """curve.json and policy.pt."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "curve.json", curve)
    torch.save({"policy": policy.state_dict(), "settings": curve["settings"]}, folder / "policy.pt")


def draw_curve(folder: Path) -> None:
    """curve.png of curve.json."""
    from taccel_lab.report.style import BLUE, ORANGE, new_figure, save_figure

    curve = json.loads((folder / "curve.json").read_text(encoding="utf-8"))
    figure, axes = new_figure(9, 3.4, 1, 2)
    shown = (("return", "mean return of episodes"), ("success", "success (dashed: blind baseline)"))
    for axis, (name, label) in zip(axes, shown, strict=True):
        axis.plot(
            *zip(*[(r["env_steps"], r[name]) for r in curve["rows"]], strict=True), color=BLUE
        )
        axis.set(xlabel="steps of environments", ylabel=label)
    axes[1].axhline(curve["baseline_success"], color=ORANGE, linestyle="--")
    save_figure(figure, folder / "curve.png")


def parse(words: list[str] | None = None) -> argparse.Namespace:
    """Options."""
    parser = argparse.ArgumentParser(description="Learn the peg insertion by PPO.")
    add = parser.add_argument
    add("--device", default="cpu", help="cpu, cuda:0, ...")
    add("--envs", type=int, default=256)
    add("--updates", type=int, default=300)
    add("--steps", type=int, default=64, help="of each environment between updates")
    add("--observe", nargs="+", default=["wrench", "proprioception"])
    add("--randomised", action="store_true", help="draw modulus, friction and mass, too")
    add("--seed", type=int, default=0)
    add("--lr", type=float, default=5e-4, help="of the first update; falls to 0")
    add("--gamma", type=float, default=0.99)
    add("--gae-lambda", type=float, default=0.95)
    add("--epochs", type=int, default=5)
    add("--minibatches", type=int, default=8)
    add("--clip", type=float, default=0.2)
    add("--entropy", type=float, default=0.0)
    add("--judge", type=int, default=64, help="seeds of the task that judge the policy; 0: none")
    add("--save-every", type=int, default=10, help="updates")
    add("--output", type=Path, default=Path("out/ppo_peg_insertion"))
    add("--tensorboard", type=Path, help="folder for scalars; needs the package tensorboard")
    add("--draw", type=Path, help="only draw curve.png of this folder")
    return parser.parse_args(words)


if __name__ == "__main__":
    arguments = parse()
    if arguments.draw:
        draw_curve(arguments.draw)
    else:
        with scalars_in(arguments.tensorboard) as written:
            train(arguments, written)
