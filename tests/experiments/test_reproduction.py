"""The reproduction of the report: that its flaws are what they are said to be, and that it can be run."""

from dataclasses import replace

import pytest
import torch

pytest.importorskip("torchrl")

from torchrl.envs import TransformedEnv

from experiments.report import flaws, repair, reproduction
from mapf_pz.rl import BatchedMapfEnv


def make_env(*transforms, **keywords):
    channels = ("view", "goal", "orientation", "edge_weights", "other_goals")
    env = BatchedMapfEnv(2, channels=channels, **{"num_agents": 3} | keywords)
    env.set_seed(0)
    for transform in transforms:
        env = TransformedEnv(env, transform)
    return env


def test_bytes_lose_all_fractions():
    seen = flaws.Bytes().change_image(torch.tensor([0.0, 0.25, 0.99, 1.0, -0.5, -1.0]))
    assert torch.equal(seen * 255, torch.tensor([0.0, 0.0, 0.0, 1.0, 0.0, 255.0]))


def test_all_goals_look_alike():
    plain, flawed = (make_env(*flawed, num_agents=12).reset() for flawed in ((), (flaws.AllGoals(),)))
    own, others = (plain["agents", "observation"][..., plane, :, :] for plane in (flaws.GOAL, flaws.OTHER_GOALS))
    seen = flawed["agents", "observation"]
    assert torch.equal(seen[..., flaws.GOAL, :, :], torch.maximum(own, others))
    assert not seen[..., flaws.OTHER_GOALS, :, :].any()
    assert others.any()


def test_agents_at_their_goals_never_move_again():
    env = make_env(flaws.Freeze(), max_steps=10)
    torch.manual_seed(0)
    now, frozen = env.reset(), torch.zeros(2, 3, dtype=torch.bool)
    for _ in range(300):
        before = now["agents", "position"]
        step, now = env.step_and_maybe_reset(env.rand_action(now))
        still = (step["next", "agents", "position"] == before).all(-1)
        assert still[frozen].all()
        frozen |= step["next", "agents", "at_goal"].squeeze(-1)
    assert frozen.any()


def test_every_variation_can_be_trained():
    rows = list(reproduction.variations())
    assert len({row.name for row in rows}) == len(rows)
    for row in rows:
        flaws.FlawedPPO(row.config, row.flaws).transforms(0)


@pytest.mark.slow
def test_a_run_is_kept(tmp_path, monkeypatch):
    options = reproduction.Options(output=tmp_path, agent_steps=8192)
    row = next(reproduction.variations())
    reproduction.learn(row, 0, options)
    (run,) = tmp_path.iterdir()
    (last,) = reproduction.curve(run)
    assert last[0] == 8192
    monkeypatch.setattr(reproduction, "train", None)
    reproduction.learn(row, 0, options)


def test_the_changes_of_the_repair_lead_from_the_report_to_the_repaired_one():
    by_name = {setting.name: setting for setting in repair.settings()}
    full, now = by_name["report-repaired"], by_name["report"]
    for name, fields in repair.CHANGES.items():
        before = now
        now = repair.changed(now, name, full, fields)
        assert now.config != before.config
    # `learn` sets the length of trainings and of the intervals between validations.
    lengths = {"agent_steps": full.config.agent_steps, "validation_interval": full.config.validation_interval}
    assert replace(now.config, **lengths) == full.config


def test_a_setting_of_the_repair_differs_in_what_its_name_says():
    by_name = {setting.name: setting.config for setting in repair.settings()}
    assert len(by_name) == 3 + 2 * len(repair.CHANGES)
    full, bare = by_name["report-repaired"], by_name["report"]
    env = replace(full.task.env, features=("action_advantage", "goal_vector", "location"))
    without = replace(full, task=replace(full.task, env=env))
    assert by_name["report-repaired without past actions (idea 5)"] == without
    env = replace(bare.task.env, view="centered")
    assert by_name["report with centered view"] == replace(bare, task=replace(bare.task, env=env))


def test_the_table_of_the_repair_is_made_from_the_results(tmp_path, monkeypatch):
    page, study = tmp_path / "report.md", replace(repair.STUDY, file=tmp_path / "repair.csv")
    page.write_text("<!-- repair -->\n<!-- end of repair -->\n")
    row = {"setting": "report with GELU", "agent_steps": "8"}
    study.write([row | {"seed": str(s), "CSR": "0.25", "ISR": f"0.{s}"} for s in (1, 3)])
    monkeypatch.setattr(repair, "PAGE", page)
    monkeypatch.setattr(repair, "STUDY", study)
    repair.write()
    assert "| GELU |  |  | 0.25 | 0.20 (0.10 to 0.30) |" in page.read_text()


def test_the_table_of_the_repair_has_what_is_most_necessary_first(tmp_path, monkeypatch):
    page, study = tmp_path / "report.md", replace(repair.STUDY, file=tmp_path / "repair.csv")
    page.write_text("<!-- repair -->\n<!-- end of repair -->\n")
    without = {"GELU": "0.75", "reward for progress": "0.00", "centered view": "0.50"}
    names = {"report-repaired": "1.00"} | {f"report-repaired without {name}": isr for name, isr in without.items()}
    study.write(
        [
            {"setting": name, "seed": "0", "agent_steps": steps, "CSR": "0", "ISR": isr}
            for name, last in names.items()
            for steps, isr in (("4", "0.9"), ("8", last))
        ]
    )
    monkeypatch.setattr(repair, "PAGE", page)
    monkeypatch.setattr(repair, "STUDY", study)
    repair.write()
    assert [line for line in page.read_text().splitlines() if line.startswith("|")] == [
        "| change | taken back: CSR | ISR |",
        "| --- | --- | --- |",
        "| all of it | 0.00 | 1.00 |",
        "| reward for progress | 0.00 | 0.00 |",
        "| centered view | 0.00 | 0.50 |",
        "| GELU | 0.00 | 0.75 |",
    ]
