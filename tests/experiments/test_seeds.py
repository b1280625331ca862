"""Other training seeds of the bundled policies: which are measured, their results, and their tables."""

from dataclasses import replace

import pytest

pytest.importorskip("torchrl")

from experiments.pages import read_rows
from experiments.policies import seeds
from experiments.tables.result_tables import ResultTable, markdown
from mapf_pz.evaluation import Episode
from mapf_pz.evaluation.identity import Identities
from mapf_pz.rl import load_policy
from mapf_pz.rl.config_file import save_config
from mapf_pz.rl.policies.folder import WEIGHTS, policy_folder
from mapf_pz.rl.progress import PROGRESS, read_progress

PRESET = "oneshot-cardinal"
OPTIONS = {"presets": (PRESET,), "suites": ("s",)}
RESULTS = {
    "rows": [
        {"policy": policy, "task": "maze", "num_agents": n, "metrics": {"CSR": {"mean": mean}}}
        for policy, n, mean in (("a", 8, 1.0), ("a", 16, 0.5), ("b", 16, 0.25))
    ],
    "seeds": [
        {"policy": "a", "num_agents": n, "metric": "CSR", "mean": mean}
        for n, mean in (("8", "1.0"), ("8", "1"), ("16", "0.75"), ("16", "0.25"))
    ],
}
TABLE = """
|  | 8 | 16 | seeds |
| --- | --- | --- | --- |
| **a** | 1 | 0.5 (0.25 to 0.75) | 3 |
"""


@pytest.fixture
def trained(tmp_path, monkeypatch):
    """The policy of the package is taken instead of trainings; the policies that were evaluated."""
    config, evaluated = load_policy(PRESET).config, []

    def copy(preset, seed, agent_steps, run):
        run.mkdir(exist_ok=True, parents=True)
        save_config(run, replace(config, seed=seed))
        for name in (WEIGHTS, PROGRESS):
            (run / name).write_bytes((policy_folder(PRESET) / name).read_bytes())

    def evaluate(policies, suite, output, jobs, overwrite):
        evaluated.append((dict(policies), suite))
        solved = {PRESET: (1.0, 0.0), f"{PRESET}+pibt": (1.0, 1.0)}
        return [Episode(name, "maze", 8, i, {"CSR": each}) for name in policies for i, each in enumerate(solved[name])]

    table = ResultTable("s", ("pibt", PRESET, f"{PRESET}+pibt"))
    monkeypatch.setattr(seeds, "TABLES", (table, ResultTable("other", ("pibt", "oneshot"))))
    for name, file in {"STUDY": "seeds.csv", "CURVES": "curves.csv"}.items():
        monkeypatch.setattr(seeds, name, replace(getattr(seeds, name), file=tmp_path / file))
    monkeypatch.setattr(seeds, "IMAGE", tmp_path / "curves.png")
    monkeypatch.setattr(seeds.imitation, "trained", copy)
    monkeypatch.setattr(seeds, "evaluate", evaluate)
    monkeypatch.setattr(seeds, "write", lambda: None)
    return evaluated


def test_other_seeds_are_measured_once(tmp_path, trained):
    bundled = load_policy(PRESET).config.seed
    others = [seed for seed in range(3) if seed != bundled]
    for _ in range(2):
        seeds.main(seeds.Options(tmp_path, **OPTIONS))
    runs = [tmp_path / f"{PRESET}-in-rounds-{seed}" for seed in others]
    assert trained == [({PRESET: f"{run}", f"{PRESET}+pibt": f"{run}+pibt"}, "s") for run in runs]
    rows = read_rows(tmp_path / "seeds.csv")
    assert [(int(row["seed"]), row["policy"], row["mean"]) for row in rows] == [
        (seed, name, mean) for seed in others for name, mean in ((PRESET, "0.5"), (f"{PRESET}+pibt", "1"))
    ]
    assert {(row["preset"], row["suite"], row["task"], row["num_agents"], row["metric"]) for row in rows} == {
        (PRESET, "s", "maze", "8", "CSR")
    }
    last = read_progress(policy_folder(PRESET))[-1]
    for seed in others:
        rows = [row for row in read_rows(tmp_path / "curves.csv") if row["seed"] == str(seed)]
        assert len(rows) == len(list(seeds.curve(PRESET, policy_folder(PRESET))))
        assert (float(rows[-1]["agent_steps"]), float(rows[-1]["value"])) == pytest.approx(
            (last["agent_steps"], last["validation_CSR"]), rel=1e-5
        )
    assert (tmp_path / "curves.png").stat().st_size > 10_000


def test_runs_with_another_configuration_are_refused(tmp_path, trained, monkeypatch):
    copy = seeds.imitation.trained

    def other(preset, seed, agent_steps, run):
        copy(preset, seed, agent_steps, run)
        save_config(run, replace(load_policy(run).config, agent_steps=7))

    monkeypatch.setattr(seeds.imitation, "trained", other)
    with pytest.raises(SystemExit, match=r"in-rounds-\d: expected the configuration of the bundled policy, apart from"):
        seeds.main(seeds.Options(tmp_path, **OPTIONS))
    assert not trained


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Files with results of two other seeds of two presets, written by the function that is returned."""
    found = [replace(study, file=tmp_path / study.file.name) for study in (seeds.STUDY, seeds.CURVES)]
    monkeypatch.setattr(seeds, "STUDY", found[0])
    monkeypatch.setattr(seeds, "CURVES", found[1])
    monkeypatch.setattr(seeds, "TABLES", (ResultTable("s", ("pibt", PRESET)), ResultTable("other", ("pibt",))))

    def fill():
        for study in found:
            study.write([{"preset": preset, "seed": seed} for preset in (PRESET, "x") for seed in "12"])
        return found

    return fill


def seeds_of(study):
    return [(row["preset"], row["seed"]) for row in study.rows()]


def test_a_new_bundled_policy_removes_what_no_longer_belongs_beside_it(files, monkeypatch):
    config = load_policy(PRESET).config
    monkeypatch.setattr(seeds, "keep", lambda preset, seed: None)
    all_of_them = [(preset, seed) for preset in (PRESET, "x") for seed in "12"]
    for now, expected in {
        replace(config, seed=3): all_of_them,
        replace(config, seed=1): all_of_them[1:],
        replace(config, agent_steps=7): all_of_them[2:],
    }.items():
        found = files()
        seeds.before_bundling(PRESET, now)
        assert [sorted(seeds_of(study)) for study in found] == [expected, expected]


@pytest.mark.parametrize("measured", [True, False], ids=["measured", "measured before"])
def test_the_results_of_the_bundled_policy_are_kept_when_another_seed_replaces_it(files, monkeypatch, measured):
    config = load_policy(PRESET).config
    identity = {"weights": "now"}
    results = {
        "identities": {"policies": {PRESET: identity if measured else {"weights": "before"}}},
        "measured": {PRESET: {"commit": "0123456789"}},
        "rows": [
            {"policy": name, "task": "maze", "num_agents": 8, "metrics": {"CSR": {"mean": mean}}}
            for name, mean in (("pibt", 1.0), (PRESET, 0.5))
        ],
    }
    monkeypatch.setattr(seeds, "load_results", lambda suite: {"s": results}[suite])
    monkeypatch.setattr(seeds, "identities", lambda table: Identities({PRESET: identity}, {}))
    measurements, curves = files()
    seeds.before_bundling(PRESET, replace(config, seed=3))
    kept = [row for row in measurements.rows() if row["seed"] == str(config.seed)]
    values = (PRESET, str(config.seed), "s", "0123456", "maze", "8", PRESET, "CSR", "0.5")
    assert kept == [dict(zip(seeds.STUDY.columns, values, strict=True))] * measured
    assert (PRESET, str(config.seed)) in seeds_of(curves)


def test_the_table_has_the_range_over_the_bundled_policy_and_the_other_seeds():
    assert markdown("seeds", [RESULTS], ["CSR"]) == TABLE.strip()
