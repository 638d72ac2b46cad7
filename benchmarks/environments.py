"""Scores of the baselines of the environments of gymnasium, as tables.

Run it from the top of the repository; the first episode grows the plants:

    python benchmarks/environments.py --episodes 50
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

import pepperscene.environments
from pepperscene.recipe.resolve.load import parse_changes

gymnasium.register_envs(pepperscene.environments)

Policy = Callable[[Any, np.random.Generator], Any]

VIEWS: dict[str, Policy] = {
    "random": lambda env, rng: rng.uniform(-1.0, 1.0, 5),
    "arc": lambda env, rng: env.arc_action(),
    "greedy": lambda env, rng: env.greedy_action(rng),
}
REACH: dict[str, Policy] = {
    "random": VIEWS["random"],
    "straight": lambda env, rng: env.straight_action(),
}


def play(env: Any, policy: Policy, seed: int) -> tuple[float, int, list[dict[str, Any]]]:
    """Score and number of actions of an episode, and the info of each state."""
    rng = np.random.default_rng([seed, 1])
    infos = [env.reset(seed=seed)[1]]
    score, is_over = 0.0, False
    while not is_over:
        _, reward, is_final, is_late, info = env.step(policy(env, rng))
        infos.append(info)
        score, is_over = score + reward, is_final or is_late
    return score, len(infos) - 1, infos


def view_row(env: Any, policy: Policy, episodes: int) -> str:
    """Cells of the table of views."""
    played = [play(env, policy, seed) for seed in range(episodes)]
    coverage = np.array([[info["coverage"] for info in infos] for _, _, infos in played])
    found = np.mean([infos[-1]["found"] / infos[-1]["ripe"] for _, _, infos in played])
    score = np.mean([score for score, _, _ in played])
    shown = [coverage[:, view - 1].mean() for view in (1, 2, 5, coverage.shape[1])]
    return " | ".join([f"{score:.3f}", *(f"{value:.1%}" for value in shown), f"{found:.1%}"])


def reach_row(env: Any, policy: Policy, episodes: int) -> str:
    """Cells of the table of the tool."""
    played = [play(env, policy, seed) for seed in range(episodes)]
    score, steps = (np.mean([one[column] for one in played]) for column in (0, 1))
    last = [infos[-1] for _, _, infos in played]
    there, distance, touches = (
        np.mean([info[name] for info in last]) for name in ("is_success", "distance_m", "touches")
    )
    cut = f"{there:.1%} | {1000.0 * distance:.0f} mm"
    return f"{score:.2f} | {cut} | {touches:.1f} | {steps:.1f}"


TABLES = {
    "pepperscene/NextBestView-v0": (
        "baseline | score | 1 view | 2 views | 5 views | all views | fruit found", VIEWS, view_row,
    ),
    "pepperscene/Reach-v0": (
        "baseline | score | reached the cut | last distance | touches | steps", REACH, reach_row,
    ),
}  # fmt: skip


def main() -> None:
    """Play and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recipe", default="barth2018", help="recipe of the scenes (default: barth2018)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change of the recipe"
    )
    parser.add_argument("--scenes", type=int, default=1, help="number of scenes (default: 1)")
    parser.add_argument("--episodes", type=int, default=10, help="of each baseline (default: 10)")
    options = parser.parse_args()
    if options.episodes < 1:
        parser.error("--episodes must be at least 1")
    common = {"recipe": options.recipe, "changes": parse_changes(options.set), "scenes": options.scenes}
    for name, (header, baselines, row) in TABLES.items():
        env = gymnasium.make(name, **common).unwrapped
        rule = "|".join(["---"] + ["---:"] * header.count("|"))
        sys.stdout.write(f"{name}, {options.episodes} episodes\n\n| {header} |\n|{rule}|\n")
        for baseline, policy in baselines.items():
            sys.stdout.write(f"| {baseline} | {row(env, policy, options.episodes)} |\n")
            sys.stdout.flush()
        sys.stdout.write("\n")


if __name__ == "__main__":
    main()
