"""The documentation's result tables are those of the results files, and what policies do has not changed since."""

import json
from dataclasses import asdict

import pytest

from experiments.tables import measured_numbers, results
from experiments.tables.paired import episodes_of, paired_rows, values_of
from experiments.tables.result_tables import NOT_MEASURED, TABLES, ResultTable, markdown
from experiments.tables.results import (
    as_json,
    changes,
    differences,
    is_reproducible,
    load_results,
    repeated,
    with_published,
)
from mapf_pz._internal.digest import digest
from mapf_pz.evaluation import Episode, load_suite, policy_factory


def row(policy, num_agents, task="maze", **means):
    return {
        "policy": policy,
        "task": task,
        "num_agents": num_agents,
        "episodes": num_agents // 8,
        "metrics": {name: {"mean": mean} for name, mean in means.items()},
    }


RESULTS = {
    "command": "mapf-pz evaluate --suite s",
    "suite": "s/1 89ab",
    "measured": {name: {"commit": "0123456789"} for name in ("pibt", "mappo")},
    "identities": {"policies": {"pibt": {"policy": "pibt"}, "mappo": None}},
    "rows": [row("pibt", 8, CSR=0.98765, SoC=1e4), row("pibt", 16, CSR=1.0), row("mappo", 16, CSR=0.5)],
    "published": [row("LaCAM", 16, CSR=0.25), row("LaCAM", 80, CSR=0.25), row("RHCR", 16, SoC=1.0)],
    "seeds": [],
}
RESULTS["rows"][1]["metrics"]["CSR"] |= {"low": 0.8, "high": 1.0}
AGENTS = """
|  | 8 | 16 | episodes |
| --- | --- | --- | --- |
| **pibt** | 0.988 | 1 (0.8 to 1) | 1 to 2 |
| **mappo** |  | 0.5 | 2 |
| LaCAM |  | 0.25 | 2 |
"""
TRIALS = """
|  | `pibt` | `mappo` |
| --- | --- | --- |
| maze, 8 agents | 0.988, 10000 |  |
| maze, 16 agents | 1 | 0.5 |
"""
INTERVALS = """
|  | `pibt` | `mappo` |
| --- | --- | --- |
| maze, 8 agents | 0.988 |  |
| maze, 16 agents | 1 (0.8 to 1) | 0.5 |
"""
POLICIES = """
|  | maze, 8 agents | maze, 16 agents |
| --- | --- | --- |
| `pibt` | 0.988 | 1 |
| `mappo` |  | 0.5 |
"""
SOURCE = """
```sh
mapf-pz evaluate --suite s  # suite s/1 89ab, commit 0123456
```
"""


LEADERBOARD = """
| method | source | 8 | 16 | mean | identity |
| --- | --- | --- | --- | --- | --- |
| `pibt` | mapf_pz | 0.988 | 1 | 0.994 | `IDENTITY` |
| `LaCAM` | published |  | 0.25 |  |  |
| `mappo` | mapf_pz |  | 0.5 |  |  |
""".replace("IDENTITY", digest({"policy": "pibt"})[:8])
PAIRED = """
|  | 8 | 16 |
| --- | --- | --- |
| best published | LaCAM | EPH (a) |
| **pibt** | +0.500 (-0.250 to +0.750) |  |
| **mappo** |  | +0.000 (-1.000 to +1.000) |
"""


@pytest.mark.parametrize(
    ("layout", "metrics", "expected"),
    [
        ("agents", ["CSR"], AGENTS),
        ("tasks", ["CSR", "SoC"], TRIALS),
        ("task_intervals", ["CSR"], INTERVALS),
        ("policies", ["CSR"], POLICIES),
        ("leaderboard", ["CSR"], LEADERBOARD),
        ("source", [], SOURCE),
    ],
)
def test_layouts(layout, metrics, expected):
    assert markdown(layout, [RESULTS], metrics) == expected.strip()


def test_differences_to_published_methods_are_paired_by_instance():
    ours = [Episode("pibt", "maze", 8, number, {"CSR": 1.0, "SoC": 9.0}) for number in range(4)]
    theirs = [
        Episode(f"{name} (published)", "maze", 8, number, {"CSR": solved, "SoC": 1.0})
        for name, all_solved in {"LaCAM": (1, 1, 1, 0), "EPH": (1, 1, 0, 0), "DCC": (0, 0, 0, 0), "IQL": (1,)}.items()
        for number, solved in enumerate(all_solved)
    ]
    unknown = [Episode("SCRIMP (published)", "maze", 8, -number, {"CSR": 1.0}) for number in range(1, 5)]
    (found,) = paired_rows(ours, [*theirs, *unknown], learned=False)
    assert (found["policy"], found["best"], found["episodes"]) == ("pibt", "LaCAM", 4)
    assert found["metrics"]["CSR"]["mean"] == 0.25
    assert found["metrics"]["CSR"]["low"] < 0.25 < found["metrics"]["CSR"]["high"]
    (learned,) = paired_rows(ours, [*theirs, *unknown], learned=True)
    assert (learned["best"], learned["metrics"]["CSR"]["mean"]) == ("EPH", 0.5)
    assert paired_rows(ours, unknown, learned=True) == []


def test_differences_are_those_of_the_values_in_the_file():
    ours = [Episode("pibt", "maze", 8, n, {"CSR": float(n > 0), "avg_throughput": 0.1234567}) for n in range(3)]
    (solved, reached) = values_of(ours)
    assert solved == {"policy": "pibt", "task": "maze", "num_agents": 8, "CSR": [0, 1, 1]}
    assert reached["avg_throughput"] == [0.123457] * 3
    theirs = [Episode("EPH (published)", "maze", 8, n, {"CSR": 1.0}) for n in range(3)]
    assert paired_rows(episodes_of([solved], ""), theirs, learned=True) == paired_rows(ours, theirs, learned=True)


def test_differences_without_values_are_kept_as_long_as_the_best_published_method_is_the_same():
    of_epibt = row("epibt", 8, CSR=0.5) | {"best": "EPH"}
    measured = {
        "suite": "mazes/1 89ab",
        "rows": [row(name, 8, CSR=0.5) | {"episodes": 3} for name in ("epibt", "pibt")],
        "measured": dict.fromkeys(("epibt", "pibt")),
        "values": [{"policy": "pibt", "task": "maze", "num_agents": 8, "CSR": [0, 1, 1]}],
        "paired_learned": [row("pibt", 8, CSR=-0.1) | {"best": "EPH"}, of_epibt],
    }

    def published(*names):
        return [
            Episode(f"{name} (published)", "maze", 8, n, {"CSR": 1.0}, suite="mazes/1 89ab")
            for name in names
            for n in range(3)
        ]

    same = with_published(measured, published("DCC", "EPH"))
    assert [one["policy"] for one in same["published"]] == ["DCC", "EPH"]
    of_pibt = same["paired_learned"][1]
    assert same["paired_learned"][0] == of_epibt
    assert (of_pibt["policy"], of_pibt["best"]) == ("pibt", "EPH")
    assert of_pibt["metrics"]["CSR"]["mean"] == pytest.approx(-1 / 3, abs=1e-6)
    other = with_published(same, published("EPH", "SCRIMP"))
    assert [(one["policy"], one["best"]) for one in other["paired_learned"]] == [("pibt", "SCRIMP")]
    assert "paired_learned" not in with_published(other | {"values": []}, [])


def test_differences_have_signs_and_intervals():
    rows = [
        row("pibt", 8, CSR=0.5) | {"best": "LaCAM"},
        row("mappo", 16, CSR=0.0) | {"best": "EPH (a)"},
        row("mappo", 16, avg_throughput=0.5) | {"best": "RHCR"},
    ]
    rows[0]["metrics"]["CSR"] |= {"low": -0.25, "high": 0.75}
    rows[1]["metrics"]["CSR"] |= {"low": -1.0, "high": 1.0}
    for layout in ("paired", "paired_learned"):
        assert markdown(layout, [RESULTS | {layout: rows}], ["CSR"]) == PAIRED.strip()


FIELD = """
|  | maze, 16 agents | rooms, 4 agents |
| --- | --- | --- |
| **trained policy with safety layer (`ours+pibt`)** | **0.6 (0.5 to 0.7)** | **0.75** |
| **trained policy (`other`)** | **0.7** | **0.5** |
| best published learned policy |  | 0.8 (`DDG`) |
| best published planner | 0.25 (`LaCAM`) |  |
| best planner of this package | 1 (`pibt`) | 0.25 (`pibt`) |
"""


def test_the_table_beside_the_field():
    trained = {
        "policies": {"pibt": {"policy": "pibt"}, "ours+pibt": {"policy": "trained"}, "other": {"policy": "trained"}}
    }
    first = RESULTS | {"identities": trained, "rows": [row("ours+pibt", 16, CSR=0.5), *RESULTS["rows"][:2]]}
    first["rows"].append(row("other", 16, CSR=0.7))
    first["published"] = RESULTS["published"][:1]
    first["seeds"] = [{"policy": "ours+pibt", "num_agents": "16", "metric": "CSR", "mean": "0.7"}]
    second = RESULTS | {
        "identities": trained,
        "rows": [
            row(name, 4, "rooms", CSR=mean) for name, mean in {"ours+pibt": 0.75, "other": 0.5, "pibt": 0.25}.items()
        ],
        "published": [row("MAPF-GPT", 4, "rooms", CSR=0.3), row("DDG", 4, "rooms", CSR=0.8)],
    }
    assert markdown("field", [first, second], ["CSR"]) == FIELD.strip()


def test_results_files_are_json():
    assert json.loads(as_json(RESULTS)) == RESULTS


@pytest.mark.parametrize(
    ("policy", "expected"),
    [
        ("pibt", True),
        ("epibt:depth=5", True),
        ("epibt:depth=5,time_limit=0.1", False),
        ("lacam", False),
        ("lacam:anytime=False", True),
        ("lacam:time_limit=1", False),
        ("lacam:time_limit=1,clock=work", True),
        ("prioritized", False),
        ("mappo+pibt", True),
    ],
)
def test_which_policies_depend_on_the_machine(policy, expected):
    assert is_reproducible(policy) == expected


def test_every_suite_is_on_the_leaderboard():
    text = (results.ROOT / "docs" / "leaderboard.md").read_text("utf-8")
    assert not [table.suite for table in TABLES if f"<!-- table: leaderboard {table.suite} " not in text]


def test_pages_have_the_tables_of_the_results():
    for page in results.pages():
        text = page.read_text("utf-8")
        assert results.with_tables(text) == text, f"{page}: run python -m experiments.tables.results write"


def test_every_table_is_measured_by_its_command():
    for table in TABLES:
        found = load_results(table.suite)
        assert found["command"] == table.command
        assert {row["policy"] for row in found["rows"]} == set(table.policies)


@pytest.mark.slow
def test_tables_without_results_can_be_measured():
    for table in NOT_MEASURED:
        assert not (results.FILES / f"{table.suite}.json").exists(), "it belongs to TABLES"
        assert policies_fit(table)


def policies_fit(table):
    """Whether every policy of a table can act in the first task of its suite."""
    keywords = load_suite(table.suite)[0].env_keywords(0)
    return all(policy_factory(name)(keywords) for name in table.policies)


def test_another_result_is_reported(monkeypatch):
    table = ResultTable("standard", ("pibt",))
    found = load_results("standard")
    (sample,) = [one for one in found["samples"] if one["policy"] == "pibt" and one["num_agents"] == 8]
    monkeypatch.setattr(results, "load_results", lambda suite: {"samples": [sample]})
    assert list(differences(table)) == []
    sample["metrics"]["SoC"] += 1
    (line,) = differences(table)
    assert line.startswith("pibt, 8 agents on random 12 x 12, 15 % obstacles, episode 0: {'CSR': ")
    assert " instead of " in line


def test_other_policies_and_tasks_are_reported(monkeypatch):
    table = ResultTable("standard", ("pibt", "mappo"))
    found = json.loads(as_json({"identities": asdict(results.identities(table))}))
    monkeypatch.setattr(results, "load_results", lambda suite: found)
    assert list(results.changes(table)) == []
    policies, tasks = found["identities"].values()
    assert not any("version" in identity for identity in policies.values())
    policies["mappo"]["weights"] = next(iter(tasks.values()))["instances"] = "other"
    lines = list(results.changes(table))
    advice = "run python -m experiments.tables.results measure --suites standard"
    assert lines == [
        f"standard, mappo: weights differ; {advice}",
        f"standard, {next(iter(tasks))}: instances differ; {advice}",
    ]


def test_results_of_some_policies_are_put_beside_earlier_ones_of_the_others():
    table = ResultTable("s", ("mappo", "pibt"))
    samples = [{"policy": "pibt", "task": "maze", "num_agents": 8}]
    identities = {"policies": {"pibt": {"seed": 0}, "mappo": {"seed": 1}, "epibt": None}, "tasks": {"8": {}}}
    earlier = RESULTS | {"identities": identities, "samples": samples}
    new = {
        **RESULTS,
        "measured": {"mappo": {"commit": "abcdef0123"}},
        "identities": {"policies": {"pibt": {"seed": 2}, "mappo": {"seed": 2}, "epibt": None}, "tasks": {"8": {}}},
        "rows": [row("mappo", 8, CSR=0.75), row("mappo", 16, CSR=0.25)],
        "samples": [],
    }
    both = results.merged(table, new, earlier, ["pibt"])
    assert [(one["policy"], one["num_agents"]) for one in both["rows"]] == [
        *(("mappo", 8), ("pibt", 8)),
        *(("mappo", 16), ("pibt", 16)),
    ]
    assert both["rows"][2]["metrics"]["CSR"]["mean"] == 0.25
    assert both["samples"] == samples
    assert both["identities"]["policies"] == {"pibt": {"seed": 0}, "mappo": {"seed": 2}, "epibt": None}
    assert (
        markdown("source", [both], [])
        .splitlines()[1]
        .endswith("suite s/1 89ab, commit abcdef0 (mappo), commit 0123456 (pibt)")
    )


def test_policies_that_were_not_measured_on_the_same_tasks_cannot_be_kept():
    earlier = RESULTS | {"identities": {"policies": {"pibt": {"seed": 0}}, "tasks": {"8": {}}}}
    results.check_kept(earlier, earlier, ["pibt"])
    with pytest.raises(SystemExit, match="s/1 89ab: its tasks have changed, measure all policies"):
        results.check_kept(earlier | {"identities": {"tasks": {}}}, earlier, ["pibt"])
    with pytest.raises(SystemExit, match="s/1 89ab: no earlier results, measure also the policies epibt: expected"):
        results.check_kept(earlier, earlier, ["pibt", "epibt"])


def test_numbers_have_an_origin(tmp_path, monkeypatch):
    assert [line for page in measured_numbers.pages() for line in measured_numbers.without_origin(page)] == []
    monkeypatch.setattr(measured_numbers, "ROOT", tmp_path)
    monkeypatch.setattr(measured_numbers, "_exists", "0123abc".__eq__)
    table = "| a | b |\n| --- | --- |\n| 1 | 0.5 |\n"
    page = tmp_path / "page.md"
    for text, expected in {
        table: ["expected the commit of its numbers, or <!-- not measured -->"],
        f"{table}\ncommit `0123abc`": [],
        f"{table}\ncommit `0123abd`": ["no commit 0123abd"],
        f"{table}\n<!-- not measured -->": [],
        f"<!-- table: agents s CSR -->\n{table}<!-- end of table -->": [],
        table.replace("0.5", "version 1.4.0"): [],
    }.items():
        page.write_text(f"# Other\n\nNothing.\n\n# Results\n\n{text}")
        assert list(measured_numbers.without_origin(page)) == [f"page.md, '# Results': {line}" for line in expected]


def test_the_fastest_sample_of_each_policy_is_repeated():
    runtimes = {"a": (0.1, 0.4, 0.2), "b": (0.7, 0.5), "c": (2.0,)}
    samples = [{"policy": name, "runtime": seconds} for name, some in runtimes.items() for seconds in some]
    assert [sample["runtime"] for sample in repeated(samples, quick=0.2)] == [0.1, 0.2, 0.5]
    assert [sample["runtime"] for sample in repeated(samples)] == [0.1, 0.4, 0.2, 0.7, 0.5]


@pytest.fixture(params=TABLES, ids=lambda table: table.suite)
def measured(request, monkeypatch):
    """A table whose instances and policies are there."""
    pytest.importorskip("torchrl")
    if request.param.suite == "lorr-2023":  # its problems are not bundled
        monkeypatch.setenv("MAPF_PZ_BENCHMARK", str(request.getfixturevalue("benchmark")))
    return request.param


def test_policies_and_tasks_are_those_that_were_measured(measured):
    assert list(changes(measured)) == []


@pytest.mark.slow
def test_episodes_end_as_when_they_were_measured(measured):
    assert list(differences(measured, quick=0.1)) == []  # `experiments.tables.results check` repeats more
