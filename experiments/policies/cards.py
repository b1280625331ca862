"""Write the cards of the package's policies: `python -m experiments.policies.cards`.

A card is the `README.md` in a policy's folder. It says how the policy was trained, what it cannot do, and has its
results from `docs/results`.
"""

from __future__ import annotations

from collections.abc import Iterator

from experiments.tables.result_tables import TABLES, Results, markdown
from experiments.tables.results import load_results
from mapf_pz._internal.atomic import write_whole
from mapf_pz.rl.policies.card import card
from mapf_pz.rl.policies.folder import bundled, policy_names

LICENSE = "MIT"
_BLOCKED = "Without the safety layer (`+pibt`), agents block each other where many of them meet"
_SMALL = f"It was trained with 32 agents on random maps of 20 x 20 cells. {_BLOCKED}."
LIMITS = {
    "central": "It was trained with 16 agents on random maps of at most 14 x 14 cells, and is not for large maps.",
    "central-ppo": "It acts for exactly 4 agents, and was trained on random maps of 8 x 8 cells.",
    "central-warehouse": "It was trained in warehouses; on small random maps, `central` is better.",
    "ippo": _SMALL,
    "lifelong": "Where it is crowded, agents need the safety layer. In training, no agent stayed at its goal: for "
    "episodes with one goal each, `oneshot` is better. Windowed planning, which it imitates, reaches more goals.",
    "lifelong-cardinal": "Windowed planning, which it imitates, reaches more goals, above all in mazes.",
    "mappo": _SMALL,
    "mappo-cardinal": _SMALL,
    "oneshot": "In mazes with many agents, some do not arrive in time. With 800 agents, its sum of costs is far above "
    "that of LaCAM, which it imitates.",
    "oneshot-cardinal": "In mazes with many agents, some do not arrive in time. The safety layer helps there, and "
    "makes paths longer where the policy needs no help.",
    "report-repaired": "It acts for exactly 10 agents, and was trained on one map with its optimized edge weights.",
}
"""What each policy cannot do."""


def main() -> None:
    """Write all cards."""
    for name in policy_names():
        write(name)


def write(name: str) -> None:
    """Write the card of a policy."""
    write_whole(bundled() / name / "README.md", text(name).encode())


def text(name: str) -> str:
    """Return the card of a policy."""
    limits = [f"Limits: {LIMITS[name]}"] if name in LIMITS else []
    return card(bundled() / name, name, LICENSE, "\n\n".join([*limits, *_sections(name)])) + "\n"


def _sections(name: str) -> Iterator[str]:
    """Yield the policy's tables, one for each suite."""
    for suite in (table.suite for table in TABLES):
        results = load_results(suite)
        rows = [row for row in results["rows"] if row["policy"].partition(":")[0].partition("+")[0] == name]
        if rows:
            metric = "CSR" if "CSR" in rows[0]["metrics"] else "avg_throughput"
            yield f"{metric} on the suite `{suite}`:\n\n{_table({**results, 'rows': rows, 'published': []}, metric)}"


def _table(results: Results, metric: str) -> str:
    """Return a table with a column for each number of agents, or for each task if there are several."""
    tasks = {row["task"] for row in results["rows"]}
    return markdown("agents" if len(tasks) == 1 else "policies", [results], [metric])


if __name__ == "__main__":
    main()
