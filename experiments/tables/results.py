"""Measure, write and check the result tables of the documentation: `python -m experiments.tables.results COMMAND`.

Every table is a file `docs/results/SUITE.json` and blocks of Markdown, which name it:

    <!-- table: LAYOUT SUITE METRIC ... -->
    ...
    <!-- end of table -->

The layout `field` has several suites, separated by commas.

`measure` runs the episodes and writes both, of all policies or of some, whose results are put beside earlier ones; it
can be resumed. `publish` renews the published results, without episodes. `write` writes the blocks. `check` compares
the policies and tasks of each table with those that were measured, runs some episodes again, and compares the results.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments.pages import FILES, read_rows
from experiments.study import check_known
from experiments.tables.measured_numbers import pages as measured_pages
from experiments.tables.measured_numbers import without_origin
from experiments.tables.paired import best_published, episodes_of, paired_rows, values_of
from experiments.tables.result_tables import NOT_MEASURED, TABLES, Results, ResultTable, markdown
from mapf_pz._internal.atomic import write_whole
from mapf_pz.evaluation import Episode, EvaluationTask, evaluate, load_suite, policy_factory
from mapf_pz.evaluation.identity import Identities, stated_identity
from mapf_pz.evaluation.reports.figures import Lines, draw_tasks
from mapf_pz.evaluation.reports.intervals import interval
from mapf_pz.evaluation.reports.published import PUBLISHED, check_possible, published_episodes
from mapf_pz.evaluation.reports.report import grouped
from mapf_pz.evaluation.suite import suite_label
from mapf_pz.instances.benchmarks import pogema

ROOT = Path(__file__).parents[2]
SEEDS = FILES / "seeds.csv"
RUNS = ROOT / "runs" / "results"
TIMES = ("runtime", "step_ms", "agent_us")
"""Metrics that depend on the machine."""
QUICK = 1.0
"""Maximum runtime of the policy, in seconds, of the episodes that `check` repeats."""
BLOCK = re.compile(r"(<!-- table: (\w+) ([\w,-]+)((?: \w+)*) -->\n).*?(<!-- end of table -->)", re.S)


def measure(suites: tuple[str, ...] = (), policies: tuple[str, ...] = (), jobs: int = 2) -> None:
    """Run the episodes of result tables, and write the tables. All tables take hours.

    Existing episodes in `runs/results/COMMIT`, which are those of the present commit, are reused if the identities of
    their policies and tasks are still the same: see `mapf_pz.evaluation.identity`. Others are replaced.

    Args:
        suites: suites of the tables, also of those that are not measured yet. Default: all that have results.
        policies: policies of the tables; earlier results of the others are kept. Default: all.
        jobs: number of processes.
    """
    every = (*TABLES, *NOT_MEASURED)
    tables = [table for table in every if table.suite in suites] if suites else TABLES
    check_known("suites", suites, [table.suite for table in every])
    check_known("policies", policies, list(chain.from_iterable(table.policies for table in tables)))
    for table in tables:
        chosen = [name for name in table.policies if not policies or name in policies]
        if not chosen:
            continue
        source, kept = _source(table, chosen), [name for name in table.policies if name not in chosen]
        earlier = load_results(table.suite) if kept else None
        if earlier:
            check_kept(source, earlier, kept)
        episodes = evaluate(chosen, table.suite, RUNS / commit() / table.suite, jobs, _show, overwrite=True)
        published = _published(table)
        results = source | {"rows": _rows(episodes), "published": [], "samples": _samples(episodes)}
        if published:
            results["values"] = values_of(episodes)
        if earlier:
            results = merged(table, results, earlier, kept)
        results = with_published(results, published)
        write_whole(FILES / f"{table.suite}.json", as_json(results).encode())
        print(f"{table.suite}: written", flush=True)
    write()


def publish() -> None:
    """Renew the published results of all tables, and the differences to them, and write the pages.

    Differences are known where the results file has the values of each episode, or the best published method is the
    same as before.
    """
    for table in TABLES:
        published = _published(table)
        if published:
            results = {name: value for name, value in load_results(table.suite).items() if name != "seeds"}
            write_whole(FILES / f"{table.suite}.json", as_json(with_published(results, published)).encode())
    write()


def with_published(results: Results, published: Sequence[Episode]) -> dict[str, Any]:
    """Return results with these published episodes, and the differences to the best of them.

    Differences of policies without values are kept if the best published method is still the same.
    """
    both = {**results, "published": _rows(published)}
    counts = {(row["task"], row["num_agents"]): row["episodes"] for row in results["rows"]}
    policies = list(results["measured"])
    measured = episodes_of(results.get("values", ()), results["suite"])
    paired_again = {episode.policy for episode in measured}
    for part, learned in (("paired", False), ("paired_learned", True)):
        best = {key: name.removesuffix(PUBLISHED) for key, name in best_published(published, counts, learned).items()}
        kept = [
            row
            for row in results.get(part, ())
            if row["policy"] not in paired_again
            and all(best.get(((row["task"], row["num_agents"]), metric)) == row["best"] for metric in row["metrics"])
        ]
        rows = sorted(
            [*kept, *paired_rows(measured, published, learned)],
            key=lambda row: (row["num_agents"], policies.index(row["policy"])),
        )
        if rows:
            both[part] = rows
        else:
            both.pop(part, None)
    return both


def check_kept(source: Results, earlier: Results, kept: Sequence[str]) -> None:
    """Exit if earlier results have other tasks, or none of the policies that are to be kept."""
    if earlier["identities"]["tasks"] != source["identities"]["tasks"]:
        raise SystemExit(f"{source['suite']}: its tasks have changed, measure all policies")
    check_known(f"{source['suite']}: no earlier results, measure also the policies", kept, list(earlier["measured"]))


def merged(table: ResultTable, results: Results, earlier: Results, kept: Sequence[str]) -> dict[str, Any]:
    """Return results together with those of the policies `kept` among the earlier ones, in the table's order."""
    both: dict[str, Any] = dict(results)
    of_policies = {name: earlier["identities"]["policies"][name] for name in kept}
    both["identities"] = results["identities"] | {"policies": results["identities"]["policies"] | of_policies}
    both["measured"] = {name: (earlier if name in kept else results)["measured"][name] for name in table.policies}
    tasks = list(dict.fromkeys((row["task"], row["num_agents"]) for row in results["rows"]))

    def place(row: Mapping[str, Any]) -> tuple[int, int]:
        return tasks.index((row["task"], row["num_agents"])), table.policies.index(row["policy"])

    for part in ("rows", "paired", "paired_learned", "samples", "values"):
        if part in results or part in earlier:
            old = [row for row in earlier.get(part, ()) if row["policy"] in kept]
            both[part] = sorted([*results.get(part, ()), *old], key=place)
    return both


def _draw(results: Results) -> None:
    """Draw the figures of the tasks."""
    lines, others = _lines(results["rows"]), _lines(results["published"], PUBLISHED)
    draw_tasks(lines, dict.fromkeys(lines, str(results["suite"])), FILES, published=others)


def _lines(rows: Sequence[Mapping[str, Any]], suffix: str = "") -> dict[str, Lines]:
    """Return the means of rows and their intervals by task, metric, policy with a suffix, and number of agents."""
    by_task: dict[str, Lines] = {}
    for row in rows:
        for metric, one in row["metrics"].items():
            points = by_task.setdefault(row["task"], {}).setdefault(metric, {}).setdefault(row["policy"] + suffix, {})
            points[row["num_agents"]] = one["mean"], one["low"], one["high"]
    return by_task


def as_json(results: Results) -> str:
    """Return results as JSON, with each list item on a separate line."""
    members = [
        f"{json.dumps(name)}: [\n{lines}\n]" if isinstance(value, list) else f"{json.dumps(name)}: {json.dumps(value)}"
        for name, value in results.items()
        for lines in [",\n".join(map(json.dumps, value))]
    ]
    return "{\n" + ",\n".join(members) + "\n}\n"


def write() -> None:
    """Write the tables into the pages with their blocks, and draw the figures."""
    for page in pages():
        write_whole(page, with_tables(page.read_text("utf-8")).encode())
    for table in TABLES:
        if table.figure:
            _draw(load_results(table.suite))


def check() -> None:
    """Fail if numbers of a page have no known origin, or if something differs from the results of a table.

    That is a page, a policy, a task, or a repeated episode, which other code must not change.
    """
    stale = [str(page) for page in pages() if with_tables(page.read_text("utf-8")) != page.read_text("utf-8")]
    if stale:
        raise SystemExit(f"{', '.join(stale)}: run python -m experiments.tables.results write")
    for line in chain.from_iterable(map(without_origin, measured_pages())):
        raise SystemExit(line)
    for table in TABLES:
        for line in changes(table):
            raise SystemExit(line)
        for line in differences(table):
            raise SystemExit(line)
        print(f"{table.suite}: as before", flush=True)


def identities(table: ResultTable) -> Identities:
    """Return what a table's policies state, and the identities of its tasks.

    Without the version: whether a table holds for another one, its repeated episodes tell. And without best known
    costs, which not every machine has.
    """
    policies = {name: stated_identity(policy_factory(name)) for name in table.policies}
    tasks = [task.with_(best_costs=()) for task in load_suite(table.suite)]
    return replace(Identities.of({}, tasks), policies=policies)


def changes(table: ResultTable) -> Iterator[str]:
    """Yield a line for each policy and task of a table that is not the one that was measured."""
    results, now = load_results(table.suite), identities(table)
    found = Identities(**results["identities"]).changes(now, now.policies, now.tasks)
    for name, text in (*found.policies.items(), *found.tasks.items()):
        yield f"{table.suite}, {name}: {text}; run python -m experiments.tables.results measure --suites {table.suite}"


def differences(table: ResultTable, quick: float = QUICK) -> Iterator[str]:
    """Repeat the samples that `repeated` selects; yield a line for each difference in metrics that were measured."""
    results = load_results(table.suite)
    tasks = {(task.name, task.num_agents): task for task in load_suite(table.suite)}
    for sample in repeated(results["samples"], quick):
        policy, number = sample["policy"], sample["episode"]
        task = tasks[sample["task"], sample["num_agents"]]
        run = _comparable(_run(policy, task, number).metrics)
        metrics = {name: value for name, value in run.items() if name in sample["metrics"]}
        if metrics != sample["metrics"]:
            yield f"{policy}, {task.label}, episode {number}: {metrics} instead of {sample['metrics']}"


def repeated(samples: Sequence[dict[str, Any]], quick: float = QUICK) -> Iterator[dict[str, Any]]:
    """Yield the samples of at most `quick` seconds, and the fastest of each policy if it took at most `QUICK`."""
    fastest: dict[str, float] = {}
    for sample in samples:
        fastest[sample["policy"]] = min(sample["runtime"], fastest.get(sample["policy"], QUICK))
    for sample in samples:
        if sample["runtime"] <= max(quick, fastest[sample["policy"]]):
            yield sample


def load_results(suite: str) -> Results:
    """Return the results of a suite, and as `seeds` those of its policies with other training seeds.

    Raises `FileNotFoundError` if it was not measured.
    """
    others = [row for row in read_rows(SEEDS) if row["suite"] == suite]
    return json.loads((FILES / f"{suite}.json").read_text("utf-8")) | {"seeds": others}


def _run(policy: str, task: EvaluationTask, number: int) -> Episode:
    """Run one episode of a task."""
    return evaluate([policy], [task.only(number)])[0]


def _source(table: ResultTable, policies: Sequence[str]) -> dict[str, Any]:
    """Return the origin of the results of policies, which are those of the present commit."""
    return {
        "command": table.command,
        "suite": suite_label(table.suite),
        "measured": {name: {"commit": commit()} for name in policies},
        "identities": asdict(identities(table)),
    }


def commit() -> str:
    """Return the present commit."""
    head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True)
    return head.stdout.strip()


def _rows(episodes: Sequence[Episode]) -> list[dict[str, Any]]:
    """Return the means of each policy in each task."""
    return [
        {
            "policy": policy.removesuffix(PUBLISHED),
            "task": task_name,
            "num_agents": num_agents,
            "episodes": max(map(len, values.values())),
            "metrics": {name: _mean(name, numbers) for name, numbers in values.items()},
        }
        for (task_name, num_agents, policy), values in grouped(episodes).items()
    ]


def _mean(metric: str, values: Sequence[float]) -> dict[str, float]:
    """Return the mean and its 95 % interval, rounded to six digits."""
    low, high = interval(metric, values)
    return {name: float(f"{v:.6g}") for name, v in (("mean", np.mean(values)), ("low", low), ("high", high))}


def _samples(episodes: Sequence[Episode]) -> list[dict[str, Any]]:
    """Return the first episode of each task and policy, if it does not depend on the machine."""
    return [
        {
            "policy": episode.policy,
            "task": episode.task,
            "num_agents": episode.num_agents,
            "episode": episode.number,
            "runtime": round(episode.metrics["runtime"], 3),
            "metrics": _comparable(episode.metrics),
        }
        for episode in episodes
        if episode.number == 0 and is_reproducible(episode.policy)
    ]


def is_reproducible(policy: str) -> bool:
    """Return whether a policy depends only on its seed, and not on the machine's speed."""
    stops_by_time = policy.partition(":")[0] in ("lacam", "prioritized") and "anytime=False" not in policy
    return "clock=work" in policy or not (stops_by_time or "time_limit" in policy)


def _comparable(metrics: dict[str, float]) -> dict[str, float]:
    return {name: value for name, value in metrics.items() if name not in TIMES}


def _published(table: ResultTable) -> list[Episode]:
    """Return the published episodes of a suite; check that they are possible, and print those that are not."""
    if not pogema.is_bundled(table.suite):
        return []
    tasks, suite = load_suite(table.suite), suite_label(table.suite)
    published = published_episodes(
        Episode("", task.name, task.num_agents, number, suite=suite)
        for task in tasks
        for number in range(task.episodes)
    )
    largest = max(tasks, key=lambda task: task.num_agents)
    for episode in check_possible(published, largest.instances, largest.keywords["max_steps"]):
        print(f"impossible, {episode.task_label}: {episode.policy}, {episode.instance}", file=sys.stderr)
    return published


def pages() -> list[Path]:
    """Return the pages that have tables."""
    candidates = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in candidates if BLOCK.search(page.read_text("utf-8"))]


def with_tables(text: str) -> str:
    """Return the text of a page with updated tables."""

    def table(found: re.Match[str]) -> str:
        start, layout, suites, metrics, end = found.groups()
        results = [load_results(suite) for suite in suites.split(",")]
        return f"{start}\n{markdown(layout, results, metrics.split())}\n\n{end}"

    return BLOCK.sub(table, text)


def _show(episode: Episode | None, left: int) -> None:
    """Print the number of remaining episodes at intervals."""
    if left % 100 == 0 and episode is not None:
        print(f"{left} episodes left of {episode.task}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"measure": measure, "publish": publish, "write": write, "check": check})
