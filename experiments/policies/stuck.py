"""Classify the agents that a policy does not bring to their goals in mazes: `python -m experiments.policies.stuck`.

The mazes are the first that the policy with the safety layer does not solve; the policy also acts in them without it.
Prints the tables of `docs/explanation/stuck-agents.md`, and draws its pictures. An agent's cause is the first one in
`CAUSES` whose condition is true in the last `WINDOW` steps of the episode.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz.environment.policy import simulator_of
from mapf_pz.evaluation import InspectedPolicy, policy_factory, rollout
from mapf_pz.instances import MapMixture
from mapf_pz.instances.place import components
from mapf_pz.render import Inspection, Recording, save_html
from mapf_pz.simulator.actions import CardinalAction
from mapf_pz.simulator.seeds import FIRST_EVALUATION_SEED
from mapf_pz.wrappers import RecordEpisode

IMAGES = Path(__file__).parents[2] / "docs" / "images"
POLICIES = {
    "without": "oneshot-cardinal",
    "with": "oneshot-cardinal+pibt",
}
"""The policy without and with the safety layer."""
WINDOW = 32
"""Number of steps at the end of an episode that are looked at."""
CAUSES = {
    "late": "#2a9d3f",
    "cut off": "#183e76",
    "displaced": "#8a3ffc",
    "head-on": "#d1392b",
    "oscillates": "#d65fb8",
    "behind a goal": "#4393c3",
    "behind others": "#f0925a",
    "contested cell": "#00a5a5",
    "waits": "#d6b400",
    "other": "#111827",
}
"""The causes in order, with their colors."""
_MOVES = [CardinalAction.UP, CardinalAction.DOWN, CardinalAction.LEFT, CardinalAction.RIGHT]
_STEPS = np.array([[-1, 0], [1, 0], [0, -1], [0, 1]])
_OPPOSITE = [1, 0, 3, 2]


@dataclass(frozen=True)
class Options:
    """Options of the experiment."""

    mazes: int = 10
    """Number of mazes that the policy does not solve with the safety layer."""
    size: int = 21
    """Number of rows and columns of a maze."""
    loops: float = 0.3
    """Fraction of the walls that are open in addition, as in `mapf-pz maps generate`."""
    num_agents: int = 40
    """Number of agents."""
    max_steps: int = 128
    """Number of steps of an episode."""
    pages: Path | None = None
    """Folder for pages with the decisions of each episode, as of `mapf-pz render --inspect`. None: not written."""


@dataclass(frozen=True)
class Ending:
    """The last W steps of an episode with N agents; W is `WINDOW`, or less in a short episode."""

    recording: Recording
    """The episode, with the decisions of all agents."""
    costs: Floats
    """(T + 1, N): the lengths of the shortest paths to the goals."""

    @property
    def inspection(self) -> Inspection:
        """The decisions in the episode."""
        assert self.recording.inspection is not None
        return self.recording.inspection

    @property
    def solved(self) -> bool:
        """Whether all agents are at their goals at the end."""
        return bool((self.costs[-1] == 0).all())

    def at_goal(self) -> Bools:
        """Return which agents are at their goals before each step, (W, N)."""
        return self.costs[:-1][-WINDOW:] == 0

    def closer(self) -> Bools:
        """Return which moves lead closer to the goal, (W, N, 4): those that cost nothing more than the best action."""
        names, features = self.inspection.feature_names, self.inspection.features
        assert features is not None
        columns = [names.index(f"action_advantage {action + 1}") for action in _MOVES]
        return (features[-WINDOW:][..., columns] == 0) & ~self.at_goal()[..., None]

    def occupants(self) -> Ints:
        """Return the agent on the cell that each move leads to, (W, N, 4); -1 if there is none."""
        before = self.recording.positions[:-1][-WINDOW:]
        agents = np.full((len(before), *np.add(self.recording.free.shape, 2)), -1)
        rows, cols = np.moveaxis(before + 1, -1, 0)
        agents[np.arange(len(before))[:, None], rows, cols] = np.arange(before.shape[1])
        return agents[self.targets()]

    def targets(self) -> tuple[Ints, Ints, Ints]:
        """Return the step, row and column, each (W, N, 4), that each move leads to, on a map with an edge of a cell."""
        before = self.recording.positions[:-1][-WINDOW:]
        rows, cols = np.moveaxis(before[:, :, None] + _STEPS + 1, -1, 0)
        return np.broadcast_to(np.arange(len(before))[:, None, None], rows.shape), rows, cols

    def moved(self) -> Bools:
        """Return which agents changed their cells in each step, (W, N)."""
        positions = self.recording.positions[-WINDOW - 1 :]
        return (positions[1:] != positions[:-1]).any(-1)


def causes(ending: Ending) -> list[str]:
    """Return the cause (N,) of each agent's failure, one of `CAUSES`; empty for agents that are at their goals."""
    closer, occupants, moved = ending.closer(), ending.occupants(), ending.moved()
    occupied = occupants >= 0
    full = (closer <= occupied).all(-1) & closer.any(-1)
    resting = np.take_along_axis(ending.at_goal(), occupants.reshape(len(occupants), -1), 1).reshape(occupants.shape)
    conditions: dict[str, Any] = {
        "late": ending.costs[-WINDOW:].min(0) < ending.costs[:-WINDOW].min(0),
        "cut off": _cut_off(ending),
        "displaced": ending.at_goal().any(0),
        "head-on": _often(_head_on(closer, occupants)),
        "oscillates": _often(moved),
        "behind a goal": _often(full & np.any(closer & occupied & resting, axis=-1)),
        "behind others": _often(full),
        "contested cell": _often(_contested(ending, closer & ~occupied)),
        "waits": _often(~full & ~moved),
    }
    unfinished = ending.costs[-1] > 0
    first = [next((name for name, found in conditions.items() if found[i]), "other") for i in range(len(unfinished))]
    return [cause if is_away else "" for cause, is_away in zip(first, unfinished, strict=True)]


def _often(true: Any) -> Bools:
    """Return which agents it is true of in at least half of the steps; `true` is (W, N) bool."""
    return np.mean(true, axis=0) >= 0.5


def _contested(ending: Ending, wanted: Bools) -> Bools:
    """Return which agents (W, N) have free cells that are closer, `wanted`, all of which others want, too."""
    targets = ending.targets()
    demand = np.zeros((len(wanted), *np.add(ending.recording.free.shape, 2)), np.int64)
    np.add.at(demand, targets, wanted)
    return np.logical_and(wanted.any(-1), (~wanted | (demand[targets] > 1)).all(-1))


def _head_on(closer: Bools, occupants: Ints) -> Bools:
    """Return which agents (W, N) have on a closer cell another agent, to whose goal the agent's own cell is closer."""
    head_on = np.zeros(closer.shape[:2], np.bool_)
    for way, opposite in enumerate(_OPPOSITE):
        others = occupants[..., way]
        head_on |= closer[..., way] & (others >= 0) & np.take_along_axis(closer[..., opposite], others, 1)
    return head_on


def _cut_off(ending: Ending) -> Bools:
    """Return which agents (N,) cannot reach their goals if those that rest at theirs never move."""
    goals = ending.recording.goals
    assert goals is not None
    free, cells = ending.recording.free.copy(), ending.recording.positions[-1]
    resting = ending.at_goal().all(0) & (ending.costs[-1] == 0)
    free[tuple(cells[resting].T)] = False
    labels = components(free)
    return ~resting & (labels[tuple(cells.T)] != labels[tuple(goals[-1].T)])


def run_episode(policy_name: str, options: Options, seed: int) -> Ending:
    """Run a policy in the maze of this seed."""
    mixture = MapMixture(("maze",), options.size, options.size, loops=options.loops)
    keywords: dict[str, Any] = {"source": mixture.source(options.num_agents), "num_agents": options.num_agents}
    env, policy = policy_factory(policy_name)(keywords | {"max_steps": options.max_steps})
    recorded, inspected = RecordEpisode(env), InspectedPolicy(policy, env, options.num_agents)
    costs: list[Floats] = []
    rollout(recorded, inspected, seed, on_step=lambda: costs.append(simulator_of(env).cost_to_go()[0].copy()))
    recording = replace(recorded.recording, name=policy_name, inspection=inspected.inspection)
    return Ending(recording, np.array(costs))


def unsolved(options: Options) -> Iterator[tuple[int, dict[str, Ending]]]:
    """Yield the seeds of the mazes that the policy `with` does not solve, and the endings of all policies."""
    seed, found = FIRST_EVALUATION_SEED, 0
    while found < options.mazes:
        ending = run_episode(POLICIES["with"], options, seed)
        if not ending.solved:
            found += 1
            others = {name: run_episode(POLICIES[name], options, seed) for name in POLICIES if name != "with"}
            yield seed, {name: others.get(name, ending) for name in POLICIES}
        seed += 1


def decisions(ending: Ending) -> dict[str, Floats]:
    """Return numbers about the decisions of the agents that are away from their goals, in the last steps: (W * M,)."""
    inspection, recording, away = ending.inspection, ending.recording, ending.costs[-1] > 0
    assert inspection.preferred is not None
    assert inspection.probabilities is not None
    assert recording.actions is not None
    preferred, taken = inspection.preferred[-WINDOW:, away], recording.actions[-WINDOW:, away]
    ignored = np.zeros_like(preferred) if inspection.ignored is None else inspection.ignored[-WINDOW:, away]
    assert recording.blocked is not None
    numbers = {
        "probability of waiting": inspection.probabilities[-WINDOW:, away, CardinalAction.WAIT],
        "prefers to wait": preferred == CardinalAction.WAIT,
        "moves": ending.moved()[:, away],
        "move blocked": recording.blocked[-WINDOW:, away],
        "another action by the layer": (preferred != taken) & (ignored == 0),
        "follows PIBT": ignored,
    }
    return {name: np.ravel(values).astype(np.float64) for name, values in numbers.items()}


def departures(ending: Ending) -> Bools:
    """Return for each step in which a displaced agent leaves its goal whether it preferred another action, (K,)."""
    inspection, recording = ending.inspection, ending.recording
    assert inspection.preferred is not None
    assert recording.actions is not None
    displaced = np.array([cause == "displaced" for cause in causes(ending)])
    leaves = ending.at_goal() & ending.moved() & displaced
    return (inspection.preferred[-WINDOW:] != recording.actions[-WINDOW:])[leaves]


def draw(ending: Ending, path: Path) -> None:
    """Draw the last state: agents away from their goals have the color of the cause, and a line to the goal."""
    free, cells, goals = ending.recording.free, ending.recording.positions[-1], ending.recording.goals
    assert goals is not None
    figure = Figure((7.4, 5.6), layout="constrained")
    axes = figure.subplots()
    axes.imshow(np.where(free, 1.0, 0.35), cmap="gray", vmin=0, vmax=1)
    found = causes(ending)
    for (row, col), (goal_row, goal_col), cause in zip(cells.tolist(), goals[-1].tolist(), found, strict=True):
        color = CAUSES.get(cause, "#c9ccd1")
        axes.add_patch(Circle((col, row), 0.38, color=color, zorder=2))
        if cause:
            axes.plot([col, goal_col], [row, goal_row], color=color, linewidth=0.7, alpha=0.7)
            axes.add_patch(Rectangle((goal_col - 0.4, goal_row - 0.4), 0.8, 0.8, fill=False, edgecolor=color))
    handles = [Circle((0, 0), color="#c9ccd1", label="at its goal")]
    handles += [Circle((0, 0), color=color, label=cause) for cause, color in CAUSES.items() if cause in found]
    figure.legend(handles=handles, loc="outside right center", frameon=False)
    axes.set_axis_off()
    figure.savefig(path, dpi=100)


def print_tables(endings: dict[str, list[Ending]]) -> None:
    """Print the number of agents by cause, and the means of the numbers about decisions."""
    counts = {name: Counter(cause for ending in all for cause in causes(ending)) for name, all in endings.items()}
    for cause in CAUSES:
        print(f"| {cause} | " + " | ".join(str(count[cause]) for count in counts.values()) + " |")
    print("| all | " + " | ".join(str(count.total() - count[""]) for count in counts.values()) + " |\n")
    numbers = {name: [decisions(ending) for ending in all] for name, all in endings.items()}
    for name in numbers["with"][0]:
        means = (np.concatenate([each[name] for each in all]).mean() for all in numbers.values())
        print(f"| {name} | " + " | ".join(f"{mean:.2f}" for mean in means) + " |")
    for name, all in endings.items():
        left = np.concatenate([departures(ending) for ending in all])
        print(f"\n{name}: displaced agents leave their goals {len(left)} times, {left.sum()} against their preferences")


def main(options: Options) -> None:
    """Run the policies, print the tables, and draw the maze with the most agents away from their goals."""
    endings: dict[str, list[Ending]] = {name: [] for name in POLICIES}
    for seed, found in unsolved(options):
        print(f"maze {seed}:", {name: int((ending.costs[-1] > 0).sum()) for name, ending in found.items()})
        for name, ending in found.items():
            endings[name].append(ending)
        if options.pages is not None:
            options.pages.mkdir(parents=True, exist_ok=True)
            save_html([ending.recording for ending in list(found.values())], options.pages / f"maze-{seed}.html")
    print_tables(endings)
    drawn = int(np.argmax([(ending.costs[-1] > 0).sum() for ending in endings["with"]]))
    for name in ("without", "with"):
        draw(endings[name][drawn], IMAGES / f"stuck-{name}.png")


if __name__ == "__main__":
    main(tyro.cli(Options))
