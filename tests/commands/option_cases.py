"""Every command, with a use of each of its options."""

import csv
import re
from collections.abc import Callable
from typing import NamedTuple

TIMES = re.compile(r"[\d.e-]+ seconds|comp_time=\d+|[\d.]+ ms a step| at 0x\w+")


class Case(NamedTuple):
    """A command, and a use of each of its options."""

    words: str
    """The command with its arguments, in a folder with `a.scen`, `suite.json`, `plan.txt` and `legal.txt`."""
    options: dict[str, str]
    """Uses by option: words that are added to the command. `!` at the front: the use is refused by the command. Words
    before `|` are added without the option, too."""
    replaced: tuple[str, ...] = ()
    """Functions, as `module.name`, that only print their arguments, since what they do takes too long here."""
    ignored: Callable[[str], str] = lambda text: TIMES.sub("", text)
    """Removes from a text, of a file or the output, what differs between two equal runs."""


def without_times(text):
    """Remove the columns of times from the episodes; other files and the output repeat them."""
    if not text.startswith("policy,"):
        return ""
    rows = list(csv.DictReader(text.splitlines()))
    return str([{name: row[name] for name in row if name not in ("runtime", "step_ms", "agent_us")} for row in rows])


OBSERVATIONS = {
    "--view-size": "--view-size 3 3",
    "--view": "--view centered",
    "--frame": "--frame map",
    "--see-through-walls": "--no-see-through-walls",
    "--channels": "--channels view",
    "--features": "--features time",
    "--num-last-actions": "--features last_actions | --num-last-actions 3",
    "--num-frames": "--num-frames 2",
    "--num-neighbors": "--num-neighbors 1",
    "--neighbor-radius": "--num-neighbors 2 | --neighbor-radius 1",
    "--around-agents-at-goals": "--channels cost_to_go --view-size 9 9 | --around-agents-at-goals",
}
NO_OBSERVATIONS = {option: f"!{use.rpartition('| ')[2]}" for option, use in OBSERVATIONS.items()}
REWARDS = {
    "--reward": "--reward report",
    "--forward": "--forward 3",
    "--rotate": "--rotate 3",
    "--wait": "--wait 3",
    "--goal": "--goal 3",
    "--pay-blocked-forward": "--forward 3 --no-pay-blocked-forward | --pay-blocked-forward",
    "--progress": "--progress 3",
    "--step-cost": "--step-cost 3",
    "--weighted-step-cost": "--weighted-step-cost 3",
    "--blocked": "--blocked 3",
    "--team-goal": "--team-goal 3",
    "--share": "--share 3",
    "--share-radius": "--share 3 | --share-radius 1",
}
NO_REWARDS = {option: f"!{use.rpartition('| ')[2]}" for option, use in REWARDS.items()} | {
    "--reward": "!--reward progress",
    "--pay-blocked-forward": "!--pay-blocked-forward",
}
EPISODES = {
    "--map": "--map random-16-16-20",
    "--scenario": "--scenario a.scen",
    "--num-agents": "--num-agents 3",
    "--max-steps": "--max-steps 8",
    "--action-model": "--action-model cardinal",
    "--collision-system": "--num-agents 25 | --collision-system block_both",
    "--on-target": "--on-target restart",
    "--goals": "!--goals alternating",
    "--initial-heading": "--initial-heading east",
    "--edge-weights": "--edge-weights crisscross",
    "--delays": "--delays 0.5:1-2",
    "--source": "!--source none",
    "--distance-bytes": "!--distance-bytes 1",
}
ENVIRONMENT = EPISODES | OBSERVATIONS | REWARDS
MIXTURE = {
    "--maps": "--maps maze",
    "--height": "--height 15",
    "--width": "--width 15",
    "--density": "--density 0.3",
    "--corridor": "--corridor 2",
    "--room-size": "--room-size 3",
    "--shelf-length": "--shelf-length 3",
    "--loops": "--loops 0.5",
    "--wall-density": "--wall-density 0.1",
    "--primal2-density": "--primal2-density 0.1",
    "--primal2-components": "--primal2-components 3",
    "--primal2-straight": "--primal2-straight 0.5 0.6",
}
GENERATED = {"--map": "--map random-16-16-20", "--output": "--output other.json"}

CASES = {
    "edit": Case(
        "edit random-32-32-20",
        {
            "--scenario": "--scenario random-2",
            "--folder": "--folder ..",
            "--solver": "--solver mapf_pz.planners:PIBT",
            "--port": "--port 8123",
            "--browser": "--no-browser",
            "--output": "--output page.html",
        },
        ("mapf_pz.commands.edit._serve",),
    ),
    "evaluate": Case(
        "evaluate --policy pibt --map empty-8-8 --num-agents 4 --max-steps 9 --episodes 2 --output out",
        {
            "--policy": "--policy random",
            "--plans": "!--plans .",
            "--time-limit": "!--time-limit 5",
            "--suite": "!--suite quickstart",
            "--columns": "!--columns steps",
            "--map": "--map random-16-16-20",
            "--scenario": "--scenario a.scen",
            "--num-agents": "--num-agents 5",
            "--max-steps": "--max-steps 8",
            "--action-model": "--action-model cardinal",
            "--collision-system": "--policy random --num-agents 25 | --collision-system block_both",
            "--on-target": "--on-target restart",
            "--goals": "!--goals alternating",
            "--initial-heading": "--initial-heading east",
            "--edge-weights": "--edge-weights crisscross",
            "--delays": "--delays 0.5:1-2",
            "--distance-bytes": "!--distance-bytes 1",
            "--episodes": "--episodes 3",
            "--seed": "--seed 5",
            "--policy-seed": "--policy-seed 5",
            "--deterministic": "",  # below
            "--jobs": "!--jobs 0",
            "--output": "--output other",
            "--overwrite": "",  # tests/evaluation/test_identity.py
            "--trust-remote-code": "",  # tests/test_trust.py
        },
        ignored=without_times,
    ),
    "evaluate a suite": Case(
        "evaluate --policy pibt --suite suite.json --output out",
        {
            "--num-agents": "--num-agents 3",
            "--episodes": "--episodes 1",
            "--seed": "--seed 5",
            "--max-steps": "--max-steps 8",
            "--map": "!--map empty-8-8",
            "--scenario": "!--scenario a.scen",
            "--action-model": "--action-model cardinal",
        },
        ignored=without_times,
    ),
    "evaluate a trained policy": Case(
        "evaluate --policy mappo --map empty-8-8 --max-steps 9 --episodes 2 --output out",
        {"--deterministic": "--deterministic", "--action-model": "!--action-model cardinal"},
        ignored=without_times,
    ),
    "solve": Case(
        "solve new.txt --map empty-8-8 --num-agents 20 --action-model cardinal",
        {
            "--planner": "--planner lacam:anytime=False",
            "--map": "--map random-16-16-20",
            "--scenario": "--num-agents 4 | --scenario a.scen",
            "--num-agents": "--num-agents 5",
            "--max-steps": "!--max-steps 2",
            "--action-model": "--action-model rotate",
            "--initial-heading": "--action-model rotate | --initial-heading random",
            "--edge-weights": "--edge-weights crisscross",
            "--distance-bytes": "!--distance-bytes 1",
            "--time-limit": "!--time-limit 0",
            "--partial": "!--max-steps 2 --partial",
            "--seed": "--seed 5",
            "--trace": "--trace trace.csv",
        },
    ),
    "compile": Case(
        "compile",
        {"--planner": "--planner pibt"},
        replaced=("mapf_pz.commands.compile.compile_all",),
    ),
    "execute": Case(
        "execute legal.txt --map empty-8-8",
        {
            "--map": "!--map nowhere",
            "--scenario": "!--scenario a.scen",
            "--num-agents": "!--num-agents 7",
            "--problem": "!--problem suite.json",
            "--delays": "--delays 0.5:3-3",
            "--seeds": "--seeds 1 2",
            "--switch": "--switch",
            "--output": "--output new.txt",
            "--graph": "--graph new.json",
            "--page": "--page new.html",
        },
    ),
    "validate": Case(
        "validate plan.txt --map empty-8-8",
        {
            "--map": "!--map nowhere",
            "--scenario": "!--scenario a.scen",
            "--num-agents": "!--num-agents 7",
            "--problem": "!--problem suite.json",
            "--all": "--all",
            "--edge-weights": "--edge-weights crisscross",
        },
    ),
    "maps generate": Case(
        "maps generate new --maps random maze room warehouse walls primal2 --num-agents 3 --number 20 --height 14 "
        "--width 14",
        {
            "--maps": "--maps maze",
            "--height": "--height 15",
            "--width": "--width 15",
            "--density": "--density 0.3",
            "--corridor": "--corridor 2",
            "--room-size": "--room-size 3",
            "--shelf-length": "--shelf-length 3",
            "--loops": "--loops 0.5",
            "--wall-density": "--wall-density 0.1",
            "--primal2-density": "--primal2-density 0.1",
            "--primal2-components": "--primal2-components 3",
            "--primal2-straight": "--primal2-straight 0.5 0.6",
            "--num-agents": "--num-agents 4",
            "--number": "--number 1",
            "--seed": "--seed 5",
        },
    ),
    "report": Case(
        "report results",
        {
            "--columns": "--columns ISR",
            "--format": "--format latex",
            "--baseline": "--baseline random",
            "--statistic": "--statistic iqm",
            "--method": "--method mine=ran*",
            "--output": "--output table.md",
            "--figures": "--figures figures",
            "--figure-format": "--figures figures | --figure-format svg",
            "--published": "--no-published",
        },
    ),
    "train quickstart": Case(
        "train quickstart",
        {
            "--output": "--output other",
            "--evaluate": "--evaluate none",
            "--overwrite": "--overwrite",
            "--seeds": "--seeds 3 5",
            "--sweep": "--sweep hidden=64",
            "--trust-remote-code": "--trust-remote-code",
            "--algorithm": "--algorithm ippo",
            "--initial-policy": "--initial-policy mappo",
            "--initial-temperature": "--initial-temperature 0.5",
            "--agent-steps": "--agent-steps 5",
            "--seed": "--seed 5",
            "--checkpoint-interval": "--checkpoint-interval 5",
            "--validation-interval": "--validation-interval 5",
            "--validation-episodes": "--validation-episodes 5",
            "--collector": "--collector processes",
            "--num-workers": "--num-workers 4",
            "--device": "--device cpu",
            "--precision": "--precision bfloat16",
            "--num-threads": "--num-threads 2",
            "--num-learners": "--num-learners 2",
            "--observation-precision": "--observation-precision float16",
            "--compile": "--compile",
            "--overlap": "--collector processes | --overlap",
            "--loggers": "--loggers wandb",
            "--project": "--project mine",
            "--group": "--group mine",
            "--run-name": "--run-name mine",
            "--tags": "--tags small new",
            "--action-mode": "--action-mode softmax",
            "--shield": "--shield",
            "--encoder": "--encoder residual",
            "--conv-channels": "--conv-channels 3",
            "--num-blocks": "--num-blocks 3",
            "--hidden": "--hidden 3",
            "--activation": "--activation gelu",
            "--recurrent": "--recurrent 3",
            "--head": "--head 3",
            "--communication": "--communication 1",
            "--communication-radius": "--communication-radius 3",
            "--decision-rounds": "--decision-rounds 2 --communication 1 --hidden 32 --features pose",
            "--mask-actions": "--mask-actions",
            "--num-envs": "--num-envs 8",
            "--steps-per-batch": "--steps-per-batch 8",
            "--num-epochs": "--num-epochs 3",
            "--minibatch-size": "--minibatch-size 8",
            "--learning-rate": "--learning-rate 0.1",
            "--final-learning-rate": "--final-learning-rate 1",
            "--max-grad-norm": "--max-grad-norm 3",
            "--gamma": "--gamma 0.5",
            "--lmbda": "--lmbda 0.5",
            "--clip-epsilon": "--clip-epsilon 0.5",
            "--entropy-coeff": "--entropy-coeff 0.5",
            "--critic-coeff": "--critic-coeff 0.7",
            "--credit": "--credit team",
            "--warmup-updates": "--warmup-updates 3",
            "--kl-coeff": "--initial-policy mappo | --kl-coeff 0.5",
            "--curiosity": "--curiosity rnd",
            "--curiosity-weight": "--curiosity-weight 0.7",
            "--curiosity-gamma": "--curiosity-gamma 0.7",
            "--curiosity-size": "--curiosity-size 3",
            "--curiosity-learning-rate": "--curiosity-learning-rate 0.1",
            "--curiosity-update-fraction": "--curiosity-update-fraction 0.7",
            "--expert": "--expert lacam",
            "--expert-share": "--expert-share 0.7",
            "--segment-steps": "--segment-steps 3",
            "--temperature": "--temperature 0.7",
            "--wait-share": "--wait-share 0.7",
            "--augment": "--augment",
            "--history-dropout": "--history-dropout 0.5",
            "--buffer-size": "--buffer-size 5000",
            "--replay": "--replay states",
            "--recent-size": "--replay states | --recent-size 300",
            "--dataset": "--dataset data",
        }
        | ENVIRONMENT
        | MIXTURE
        | {
            "--goals": "--on-target restart | --goals alternating",
            "--distance-bytes": "--distance-bytes 1",
            "--source": "--source plugin:name",
            "--view": "--view front",
            "--density": "--density 0.2",
        },
        ("mapf_pz.commands.train._train", "mapf_pz.commands.train._train_runs"),
    ),
    "train resume": Case(
        "train resume run",
        {
            "--agent-steps": "--agent-steps 5",
            "--num-learners": "--num-learners 2",
            "--device": "--device cpu",
            "--evaluate": "--evaluate none",
            "--trust-remote-code": "--trust-remote-code",
        },
        ("mapf_pz.commands.train._train",),
    ),
    "render": Case(
        "render out.html --policy random --map empty-8-8 --num-agents 4 --max-steps 20 --seed 3",
        EPISODES
        | NO_OBSERVATIONS
        | REWARDS
        | {
            "--edge-weights": "--policy pibt | --edge-weights crisscross",
            "--distance-bytes": "!--policy pibt --distance-bytes 1",
            "--goal": "--policy pibt | --goal 3",
            "--team-goal": "--policy pibt | --team-goal 3",
            "--reward": "--reward progress",
            "--policy": "--policy pibt",
            "--seed": "--seed 5",
            "--plan": "!--plan plan.txt",
            "--problem": "!--problem depot.json",
            "--fps": "--fps 9",
            "--trust-remote-code": "",  # tests/test_trust.py
            "--inspect": "--inspect",
        },
    ),
    "render a plan": Case(
        "render out.html --plan plan.txt --map empty-8-8",
        {name: f"!{use.rpartition('| ')[2]}" for name, use in (EPISODES | OBSERVATIONS).items()}
        | {
            "--seed": "!--seed 5",
            "--reward": "!--reward progress",
            "--goal": "!--goal 3",
            "--map": "--map empty-16-16",
            "--inspect": "!--inspect",
        }
        | {"--num-agents": "--num-agents 2", "--scenario": "--scenario a.scen", "--plan": "--plan plan.txt"},
    ),
    "play": Case(
        "play --policy random --map empty-8-8 --num-agents 4 --max-steps 20 --seed 3",
        EPISODES
        | NO_OBSERVATIONS
        | REWARDS
        | {
            "--edge-weights": "--policy pibt | --edge-weights crisscross",
            "--max-steps": "--max-steps 5",
            "--goal": "--scenario near.scen --num-agents 1 --action-model cardinal | --goal 3",
            "--team-goal": "--scenario near.scen --num-agents 1 --action-model cardinal | --team-goal 3",
            "--scenario": "--num-agents 1 | --scenario near.scen",
            "--policy": "--policy pibt",
            "--seed": "--seed 5",
            "--trust-remote-code": "",  # tests/test_trust.py
        },
    ),
    "plot": Case(
        "plot run",
        {
            "--columns": "--columns return",
            "--output": "--output other.svg",
        },
    ),
    "policy export": Case(
        "policy export mappo mappo.onnx",
        {"--trust-remote-code": ""},  # tests/test_trust.py
    ),
    "policy push": Case(
        "policy push mappo hf://me/mappo",
        {"--license": "--license Apache-2.0", "--private": "--private"},
        ("mapf_pz.commands.policy.push",),
    ),
    "policy pull": Case("policy pull hf://me/mappo mine", {}, ("mapf_pz.commands.policy._pull",)),
    "serve": Case(
        "serve mappo-cardinal --collision-system soft --on-target nothing --max-steps 9",
        {
            "--collision-system": "--collision-system priority",
            "--on-target": "--on-target restart",
            "--max-steps": "--max-steps 8",
            "--trust-remote-code": "--trust-remote-code",
        },
        ("mapf_pz.commands.serve.InPogema", "mapf_pz.commands.serve.replies"),
    ),
    "schedule": Case(
        "schedule depot.json out.json --num-steps 20",
        {
            "--planner": "--planner pibt",
            "--scheduler": "--scheduler keep",
            "--edge-weights": "--edge-weights crisscross",
            "--num-steps": "--num-steps 10",
            "--seed": "--planner pibt | --seed 5",
        },
    ),
    "dataset make": Case(
        "dataset make out --planner pibt --num-agents 4 --episodes 2 --max-steps 9 --no-solved-only",
        EPISODES
        | MIXTURE
        | {
            "--collision-system": "--collision-system block_both",
            "--planner": "--planner pibt:seed=1",
            "--episodes": "--episodes 3",
            "--shard-size": "--shard-size 1",
            "--solved-only": "--solved-only",
            "--seed": "--seed 5",
            "--license": "--license CC0-1.0",
            "--jobs": "!--jobs 0",
        },
    ),
    "dataset export": Case("dataset export data out", OBSERVATIONS | {"--reward": "--reward progress"}),
    "guidance show": Case(
        "guidance show crisscross --map empty-8-8 --output out.png",
        {
            "--map": "--map random-16-16-20",
            "--output": "--output other.svg",
            "--moves": "--moves moves.npz",
            "--cell-size": "--cell-size 9",
        },
    ),
    "guidance convert": Case("guidance convert weights.npz out.json --map empty-8-8", {"--map": "!--map empty-16-16"}),
    "guidance generate uniform": Case("guidance generate uniform --map empty-8-8 --output out.json", GENERATED),
    "guidance generate random": Case(
        "guidance generate random --map empty-8-8 --output out.json",
        GENERATED | {"--low": "--low 2", "--high": "--high 9", "--seed": "--seed 5"},
    ),
    "guidance generate crisscross": Case(
        "guidance generate crisscross --map empty-8-8 --output out.json",
        GENERATED | {"--along": "--along 0.1", "--against": "--against 9"},
    ),
    "guidance generate highway": Case(
        "guidance generate highway --map empty-8-8 --output out.json --arrows arrows.txt",
        GENERATED
        | {"--along": "--along 0.1", "--against": "--against 9", "--arrows": "!--arrows plan.txt"}
        | {"--map": "!--map empty-16-16"},
    ),
    "guidance generate traffic": Case(
        "guidance generate traffic --map empty-8-8 --output out.json --moves moves.npz",
        GENERATED
        | {"--contraflow": "--contraflow 9", "--congestion": "--congestion 9", "--moves": "!--moves weights.npz"}
        | {"--map": "!--map empty-16-16"},
    ),
    "guidance evaluate": Case(
        "guidance evaluate --map empty-8-8 --num-agents 6 --max-steps 40 --num-seeds 2",
        EPISODES
        | NO_OBSERVATIONS
        | NO_REWARDS
        | {
            "--max-steps": "--max-steps 20",
            "--scenario": "--on-target nothing --num-agents 4 | --scenario a.scen",
            "--on-target": "--on-target nothing",
            "--collision-system": "--planner random --num-agents 25 | --collision-system block_both",
            "--edge-weights": "!--edge-weights crisscross",
            "--planner": "--planner random",
            "--graphs": "--graphs crisscross",
            "--num-seeds": "--num-seeds 3",
            "--first-seed": "--first-seed 5",
            "--jobs": "!--jobs 0",
            "--trust-remote-code": "",  # tests/test_trust.py
        },
    ),
    "guidance optimize": Case(
        "guidance optimize --map empty-8-8 --jobs 1",
        EPISODES
        | NO_OBSERVATIONS
        | NO_REWARDS
        | {
            "--on-target": "--on-target nothing",
            "--planner": "--planner random",
            "--trust-remote-code": "--trust-remote-code",
            "--distance-bytes": "--distance-bytes 1",
            "--minutes": "--minutes 1",
            "--seed": "--seed 5",
            "--jobs": "--jobs 2",
            "--output": "--output other",
        },
        ("mapf_pz.commands.guidance._optimize",),
    ),
    "guidance resume": Case(
        "guidance resume run",
        {"--minutes": "--minutes 1", "--jobs": "--jobs 2", "--trust-remote-code": "--trust-remote-code"},
        ("mapf_pz.commands.guidance._resume",),
    ),
    "maps list": Case("maps list", {}),
    "maps write": Case("maps write new", {}),
    "maps convert": Case("maps convert pogema.yaml converted", {"--maps": "--maps other.yaml"}),
    "maps download": Case(
        "maps download",
        {"--scenarios": "--scenarios even", "--folder": "--folder other"},
        ("mapf_pz.commands.maps.download",),
    ),
}
