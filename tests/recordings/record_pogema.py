"""Records what agents do in POGEMA 1.4.0, for `test_pogema_recording.py`: `make -f tests/Makefile record-pogema`.

It needs nothing but POGEMA, in a Python of its own, and writes a file for each collision system and each mode: a JSON
header with the episodes (map, starts, goals, seed, metrics), and for each step and agent whether it moved, and whether
it earned a reward. What it wanted follows from the seed: see `walk.py`.
"""

import json
import random
import sys
from pathlib import Path

import numpy as np
from pogema import GridConfig, pogema_v0  # pyright: ignore[reportMissingImports]

from tests.helpers.random_walk import intended

COLLISION_SYSTEMS = ("soft", "priority", "block_both")
MODES = ("nothing", "finish", "restart")
AGENT_STEPS = 200_000
"""So many at least in each file."""


def main() -> None:
    """Record into the folder that is named on the command line."""
    for collision_system in COLLISION_SYSTEMS:
        for on_target in MODES:
            record(Path(sys.argv[1]), collision_system, on_target)


def record(folder, collision_system, on_target):
    """Write one file."""
    episodes, moved, rewarded = [], [], []
    while sum(map(np.size, moved)) < AGENT_STEPS:
        draw = random.Random(f"{collision_system} {on_target} {len(episodes)}")
        config = draw_config(draw, collision_system, on_target)
        told, moves, rewards = play(config, seed=len(episodes))
        episodes.append(told)
        moved.append(moves)
        rewarded.append(rewards)
    name = f"pogema-{collision_system}-{on_target}.npz"
    bits = {"moved": np.concatenate(moved, axis=None), "rewarded": np.concatenate(rewarded, axis=None)}
    header = np.frombuffer(json.dumps(episodes).encode(), np.uint8)
    np.savez_compressed(folder / name, episodes=header, **{key: np.packbits(value) for key, value in bits.items()})
    print(f"{name}: {len(episodes)} episodes, {bits['moved'].size} agent steps, {bits['rewarded'].sum()} rewards")


def draw_config(draw, collision_system, on_target):
    """Draw a map on which all agents find room; POGEMA places them."""
    while True:
        height, width = draw.randint(3, 16), draw.randint(3, 16)
        density = draw.choice([0, 0.1, 0.2, 0.3])
        rows = ["".join("#" if draw.random() < density else "." for _ in range(width)) for _ in range(height)]
        room = sum(row.count(".") for row in rows)
        num_agents = draw.randint(1, max(1, int(room * draw.choice([0.05, 0.2, 0.4]))))
        try:
            return GridConfig(
                map="\n".join(rows),
                num_agents=num_agents,
                obs_radius=2,
                max_episode_steps=draw.choice([16, 64, 128]),
                seed=draw.randrange(2**31),
                collision_system=collision_system,
                on_target=on_target,
                observation_type="POMAPF",
            )
        except (ValueError, OverflowError):
            continue


def play(config, seed):
    """Play an episode; return its header, and two arrays (T, N) bool: who moved, and who earned a reward."""
    env = pogema_v0(grid_config=config)
    env.reset()
    grid = env.unwrapped.grid
    draw = random.Random(seed)
    starts = [list(map(int, place)) for place in grid.get_agents_xy(ignore_borders=True)]
    goals = [[list(map(int, place))] for place in grid.get_targets_xy(ignore_borders=True)]
    moved, rewarded = [], []
    before, over = starts, False
    while not over:
        now = grid.get_targets_xy(ignore_borders=True)
        for sequence, place in zip(goals, now, strict=True):
            if list(map(int, place)) != sequence[-1]:
                sequence.append(list(map(int, place)))
        actions = [intended(draw, here, sequence[-1]) for here, sequence in zip(before, goals, strict=True)]
        _, rewards, terminated, truncated, infos = env.step(actions.copy())  # POGEMA changes them
        after = [list(map(int, place)) for place in grid.get_agents_xy(ignore_borders=True)]
        moved.append([here != there for here, there in zip(before, after, strict=True)])
        rewarded.append([reward == 1 for reward in rewards])
        before, over = after, all(terminated) or all(truncated)
    told = {
        "map": rows_of(config),
        "starts": starts,
        "goals": goals,
        "seed": seed,
        "max_steps": config.max_episode_steps,
        "num_steps": len(moved),
        "solved": bool(all(terminated)),
        "metrics": {name: float(value) for name, value in infos[0]["metrics"].items()},
    }
    return told, np.array(moved), np.array(rewarded)


def rows_of(config):
    """Return the map's rows as text."""
    return ["".join(".#"[cell] for cell in row) for row in config.map]


if __name__ == "__main__":
    main()
