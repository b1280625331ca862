"""Result tables: the policies and suites, and the conversion of results to Markdown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from experiments.pages import spread
from experiments.tables.field import field_table, seed_means
from mapf_pz._internal.digest import digest

Results = Mapping[str, Any]
"""The content of a results file, and the results of other training seeds: see `load_results` in `results.py`."""

ONE_SHOT = ("pibt", "epibt", "lacam:anytime=False", "lacam:clock=work")
CRISSCROSS = ("pibt:edge_weights=crisscross", "epibt:edge_weights=crisscross")
"""Planners with edge weights similar to those that the policies for lifelong episodes observe."""
LIFELONG = ("pibt", "epibt", "windowed")
LEARNED = ("mappo-cardinal", "mappo-cardinal+pibt")
TURNING = ("oneshot", "oneshot+pibt")
IMITATED = ("lifelong-cardinal", "lifelong-cardinal+pibt:temperature=0,patience=0")
EXECUTIONS = tuple(f"lacam:anytime=False,clock=work,execution={execution}" for execution in ("graph", "both", "replan"))
"""Planners of whole paths, which differ in what they do when agents are late."""
IMITATED_ONE_SHOT = ("oneshot-cardinal", "oneshot-cardinal+pibt")
TURNING_ONE_SHOT = (*ONE_SHOT, "mappo", "mappo+pibt", *TURNING)


@dataclass(frozen=True)
class ResultTable:
    """A suite and the policies that are evaluated on it."""

    suite: str
    """Name of the suite and of the results file."""
    policies: tuple[str, ...]
    """Names for `mapf-pz evaluate --policy`."""
    figure: bool = False
    """Whether there is a figure, too."""

    @property
    def command(self) -> str:
        """The command that runs all episodes."""
        policies = " ".join(f"--policy {policy}" for policy in self.policies)
        return f"mapf-pz evaluate {policies} --suite {self.suite} --output runs/results/{self.suite}"


TABLES = (
    ResultTable("pogema-random", (*ONE_SHOT, *LEARNED, *IMITATED_ONE_SHOT), figure=True),
    ResultTable(
        "pogema-random-lifelong", (*LIFELONG, *CRISSCROSS, "lacam:anytime=False", *LEARNED, *IMITATED), figure=True
    ),
    ResultTable("pogema-mazes", (*ONE_SHOT, *LEARNED, *IMITATED_ONE_SHOT)),
    ResultTable("pogema-mazes-lifelong", (*LIFELONG, *CRISSCROSS, "lacam:anytime=False", *LEARNED, *IMITATED)),
    ResultTable("pogema-warehouse", (*ONE_SHOT, *LEARNED, *IMITATED_ONE_SHOT)),
    ResultTable("pogema-warehouse-lifelong", (*LIFELONG, *CRISSCROSS, *LEARNED, *IMITATED)),
    ResultTable("pogema-cities", (*ONE_SHOT, *LEARNED, *IMITATED_ONE_SHOT)),
    ResultTable("pogema-cities-lifelong", (*LIFELONG, *CRISSCROSS, *LEARNED, *IMITATED)),
    # The maps of the puzzles are smaller than the views of the trained policies.
    ResultTable("pogema-puzzles", ONE_SHOT[:3]),
    ResultTable("pogema-puzzles-lifelong", (*LIFELONG, "lacam:anytime=False")),
    ResultTable("pogema-random-turning", TURNING_ONE_SHOT),
    ResultTable("pogema-mazes-turning", TURNING_ONE_SHOT),
    ResultTable("pogema-puzzles-turning", ONE_SHOT[:3]),
    ResultTable(
        "report",
        (
            "pibt",
            "lacam:clock=work",
            "mappo+pibt",
            *TURNING,
            "central-warehouse:temperature=0.85",
            "central-warehouse+pibt",
        ),
    ),
    ResultTable(
        "report-10",
        (
            "pibt",
            "lacam:clock=work",
            "central-warehouse:temperature=0.85",
            "report-repaired",
            "report-repaired:temperature=0",
        ),
    ),
    ResultTable("report-800", ("pibt", "lacam:clock=work", "mappo+pibt", "oneshot+pibt")),
    ResultTable(
        "lorr-2023-example",
        (*LIFELONG, *CRISSCROSS, "lifelong:temperature=0", "lifelong+pibt:temperature=0", "central", "central+pibt"),
    ),
    ResultTable("movingai-small", ("pibt", "epibt", "lacam:clock=work", *TURNING)),
    ResultTable(
        "lorr-2023",
        (
            *("pibt", "epibt:depth=3", "epibt:depth=4", "epibt:depth=5", "epibt:depth=7,time_limit=0.1", "windowed"),
            *("lifelong:temperature=0", "lifelong+pibt:temperature=0", "lifelong+pibt:temperature=0,depth=5"),
        ),
    ),
    ResultTable(
        "delays",
        (
            *("pibt", "epibt", *EXECUTIONS, "lacam:clock=work,execution=graph", "lacam:clock=work,execution=switch"),
            *("mappo-cardinal", *IMITATED_ONE_SHOT),
        ),
    ),
    ResultTable("delays-turning", ("pibt", "epibt", "lacam:clock=work,execution=graph", "mappo", *TURNING)),
    ResultTable("delays-lifelong", (*LIFELONG, "lifelong", "lifelong+pibt:temperature=0")),
    ResultTable("standard", ("pibt", "mappo", "mappo+pibt", "ippo", "mappo-cardinal", *TURNING)),
    ResultTable("central-4", ("central-ppo",)),
    ResultTable("central-8", ("pibt", "central")),
    ResultTable("central-16", ("pibt", "central")),
)

TURNING_LIFELONG = (*LIFELONG, *CRISSCROSS, "lifelong", "lifelong+pibt:temperature=0")
NOT_MEASURED = (
    ResultTable("pogema-random-lifelong-turning", TURNING_LIFELONG),
    ResultTable("pogema-mazes-lifelong-turning", TURNING_LIFELONG),
    ResultTable("pogema-puzzles-lifelong-turning", LIFELONG),
    ResultTable("pogema-warehouse-turning", TURNING_ONE_SHOT),
    ResultTable("pogema-warehouse-lifelong-turning", TURNING_LIFELONG),
    ResultTable("pogema-cities-turning", TURNING_ONE_SHOT),
    ResultTable("pogema-cities-lifelong-turning", TURNING_LIFELONG),
)
"""Tables without results, which no page has. Once measured, they belong to `TABLES`, and their blocks to the pages."""


def by_agents(results: Results, metrics: Sequence[str]) -> list[list[str]]:
    """Return a table with a row for each policy and a column for each number of agents.

    Policies of this package come first, in bold. Policies without any of the metrics are omitted. With one metric, the
    cells have 95 % intervals, and the last column the number of episodes in each cell.
    """
    counts = sorted({row["num_agents"] for row in results["rows"]})
    body: list[list[str]] = []
    for rows, name in ((results["rows"], "**{}**"), (results["published"], "{}")):
        for policy in dict.fromkeys(row["policy"] for row in rows):
            found = {row["num_agents"]: row for row in rows if row["policy"] == policy}
            cells = {count: _cell(row, metrics, intervals=len(metrics) == 1) for count, row in found.items()}
            if any(cells.get(count) for count in counts):
                numbers = sorted({found[count]["episodes"] for count in counts if cells.get(count)})
                episodes = " to ".join(map(str, dict.fromkeys((numbers[0], numbers[-1]))))
                body.append([name.format(policy), *(cells.get(count, "") for count in counts), episodes])
    return [["", *map(str, counts), "episodes"], *body]


def seeds(results: Results, metrics: Sequence[str]) -> list[list[str]]:
    """Return a table of the policies with several training seeds by number of agents.

    Cells have the mean over the seeds, in brackets the smallest and the largest.
    """
    metric = metrics[0]
    cells = list(dict.fromkeys((row["policy"], int(row["num_agents"])) for row in results["seeds"]))
    counts = sorted({count for _, count in cells})
    body: list[list[str]] = []
    for policy in dict.fromkeys(policy for policy, _ in cells):
        found = [seed_means(results, policy, count, metric) for count in counts]
        body.append([f"**{policy}**", *(spread(values, 3, "g") for values in found), f"{len(found[0])}"])
    return [["", *map(str, counts), "seeds"], *body]


def paired(results: Results, metrics: Sequence[str], rows: str = "paired") -> list[list[str]]:
    """Return a table of the differences to the best published method, by policy and number of agents, with intervals.

    The second line names the method of each column.
    """
    metric = metrics[0]
    found = [row for row in results.get(rows, ()) if metric in row["metrics"]]
    counts = sorted({row["num_agents"] for row in found})
    best = {row["num_agents"]: row["best"] for row in found}
    body = [["best published", *(best[count] for count in counts)]]
    for policy in dict.fromkeys(row["policy"] for row in found):
        cells = {row["num_agents"]: _cell(row, [metric], "+", True) for row in found if row["policy"] == policy}
        body.append([f"**{policy}**", *(cells.get(count, "") for count in counts)])
    return [["", *map(str, counts)], *body]


def paired_learned(results: Results, metrics: Sequence[str]) -> list[list[str]]:
    """Return the table `paired` of the differences to the best published learned method."""
    return paired(results, metrics, "paired_learned")


def leaderboard(results: Results, metrics: Sequence[str]) -> list[list[str]]:
    """Return a table of all policies and published methods in the order of the first metric's mean, best first.

    It has a column for each task or, if the suite has one task, for each number of agents, one for the mean over them,
    and one for the digest of the policy's identity: its weights, configuration, options and seed. Policies without
    results in some of them have no mean and come last; more is better.
    """
    metric = metrics[0]
    tasks = list(dict.fromkeys(row["task"] for row in results["rows"]))
    keys = list(dict.fromkeys((row["task"], row["num_agents"]) for row in results["rows"]))
    keys.sort(key=lambda key: (tasks.index(key[0]), key[1]))
    found: dict[tuple[str, str], dict[tuple[str, int], float]] = {}
    for source, rows in (("mapf_pz", results["rows"]), ("published", results["published"])):
        for row in rows:
            if metric in row["metrics"]:
                values = found.setdefault((row["policy"], source), {})
                values[row.get("task", tasks[0]), row["num_agents"]] = row["metrics"][metric]["mean"]
    means = {
        name: sum(values[key] for key in keys) / len(keys) for name, values in found.items() if {*keys} <= {*values}
    }
    body = [
        [
            *(f"`{name[0]}`", name[1], *(_value(found[name].get(key)) for key in keys), _value(means.get(name))),
            _identity(results, *name),
        ]
        for name in sorted(found, key=lambda name: (-means.get(name, float("-inf")), name))
    ]
    names = [str(count) if len(tasks) == 1 else f"{task}, {count} agents" for task, count in keys]
    return [["method", "source", *names, "mean", "identity"], *body]


def by_task(results: Results, metrics: Sequence[str], intervals: bool = False) -> list[list[str]]:
    """Return a table with a row for each task and a column for each policy, with 95 % intervals if they are wanted.

    Tasks without any of the metrics are omitted.
    """
    policies = list(dict.fromkeys(row["policy"] for row in results["rows"]))
    cells: dict[str, dict[str, str]] = {}
    for row in results["rows"]:
        task = f"{row['task']}, {row['num_agents']} agents"
        cells.setdefault(task, {})[row["policy"]] = _cell(row, metrics, intervals=intervals)
    filled = {task: found for task, found in cells.items() if any(found.values())}
    body = [[task, *(found.get(policy, "") for policy in policies)] for task, found in filled.items()]
    return [["", *(f"`{policy}`" for policy in policies)], *body]


def by_policy(results: Results, metrics: Sequence[str]) -> list[list[str]]:
    """Return a table with a row for each policy and a column for each task."""
    return [list(row) for row in zip(*by_task(results, metrics), strict=True)]


def _origin(results: Results) -> str:
    """Return the suite and the commit of results; several commits with their policies."""
    groups: dict[str, list[str]] = {}
    for policy, one in results["measured"].items():
        groups.setdefault(f"commit {one['commit'][:7]}", []).append(policy)
    names = [f" ({', '.join(policies)})" if len(groups) > 1 else "" for policies in groups.values()]
    return ", ".join([f"suite {results['suite']}", *map("".join, zip(groups, names, strict=True))])


def source(results: Results, _: Sequence[str]) -> list[str]:
    """Return lines with the command, the suite and the commit of the results."""
    return [
        "```sh",
        f"{results['command']}  # {_origin(results)}",
        "```",
    ]


LAYOUTS: dict[str, Callable[[Results, Sequence[str]], list[list[str]]]] = {
    "agents": by_agents,
    "tasks": by_task,
    "task_intervals": partial(by_task, intervals=True),
    "policies": by_policy,
    "leaderboard": leaderboard,
    "seeds": seeds,
    "paired": paired,
    "paired_learned": paired_learned,
}


def markdown(layout: str, results: Sequence[Results], metrics: Sequence[str]) -> str:
    """Return a block of Markdown: a table of these metrics in one of the `LAYOUTS`, `source`, or `field`.

    All but `field` have the results of one suite.
    """
    if layout == "source":
        return "\n".join(source(results[0], metrics))
    header, *body = field_table(results, *metrics) if layout == "field" else LAYOUTS[layout](results[0], metrics)
    return "\n".join(f"| {' | '.join(row)} |" for row in [header, ["---"] * len(header), *body])


def _cell(row: Mapping[str, Any], metrics: Sequence[str], sign: str = "", intervals: bool = False) -> str:
    """Return the means of metrics in a row, with their intervals; `sign` is "+" for differences."""
    found = [row["metrics"][name] for name in metrics if name in row["metrics"]]
    return ", ".join(
        f"{_number(one['mean'], sign)} ({_number(one['low'], sign)} to {_number(one['high'], sign)})"
        if intervals and "low" in one
        else _number(one["mean"], sign)
        for one in found
    )


def _identity(results: Results, policy: str, source: str) -> str:
    """Return the digest of the identity of a policy of this package; empty for published methods."""
    recorded = results["identities"]["policies"].get(policy)
    return f"`{digest(recorded)[:8]}`" if recorded is not None and source == "mapf_pz" else ""


def _value(value: float | None) -> str:
    return "" if value is None else _number(value)


def _number(value: float, sign: str = "") -> str:
    if sign:
        return f"{value:{sign}.3f}"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"
