"""The card of a policy: a `README.md` that says what the policy is, and how it was trained."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

from mapf_pz._internal.digest import digest
from mapf_pz.rl.policies.folder import WEIGHTS, policy_folder
from mapf_pz.rl.policies.load import load_policy
from mapf_pz.rl.progress import PROGRESS, read_progress

_TEXT = """\
---
license: {license}
library_name: mapf_pz
pipeline_tag: reinforcement-learning
tags: [multi-agent-path-finding, multi-agent, reinforcement-learning, pettingzoo]
---

# {name}

A policy for multi-agent path finding, trained with `mapf_pz`.

```python
from mapf_pz.evaluation import make_env
from mapf_pz.rl import load_policy

policy = load_policy("{address}")
env = make_env(policy, map="{map}", num_agents={num_agents})
```

`mapf-pz evaluate --policy {address} --map {map} --num-agents {num_agents} --action-model {action_model}` measures it.

{table}
"""


def card(policy: str | Path, address: str, license: str, results: str = "") -> str:
    """Return the text of the card.

    Args:
        policy: the policy, as for `load_policy`. If it is the folder of a run, the card also has the run's length.
        address: the policy's address on the Hugging Face Hub.
        license: license of the weights.
        results: text about results, in Markdown.

    Raises as `load_policy`.
    """
    folder, loaded = policy_folder(policy), load_policy(policy)
    config, task, env = loaded.config, loaded.config.task, loaded.config.task.env
    maps = env.map or env.scenario or (", ".join(map(str, task.mixture.maps)) if env.source is None else "a source")
    rows = {
        "algorithm": config.algorithm,
        "actions": env.action_model,
        "agents in training": env.num_agents,
        "maps of training": maps,
        "goals": "one for each agent" if env.on_target == "nothing" else f"on_target={env.on_target}",
        "steps of an episode": env.max_steps,
        "observation": f"{'x'.join(map(str, env.view_size))}: {', '.join(map(str, (*env.channels, *env.features)))}",
        "weights": sum(weight.numel() for weight in loaded.network.state_dict().values()),
        "digest of the weights": digest(folder / WEIGHTS),
        "seed": config.seed,
        "agent steps": config.agent_steps,
        **_duration(folder),
        "version of mapf_pz": version("mapf-pz"),
        "license": license,
    }
    table = "\n".join(f"| {name} | {value} |" for name, value in ({"": "", "---": "---"} | rows).items())
    text = _TEXT.format(
        license=license.lower(),
        name=address.rpartition("/")[2],
        address=address,
        map=env.map if isinstance(env.map, str) else "random-16-16-20",
        num_agents=loaded.num_agents or 20,
        action_model=env.action_model,
        table=table,
    )
    return text + (f"\n## Results\n\n{results}" if results else "")


def _duration(folder: Path) -> dict[str, object]:
    """Return the length of the run in a folder, if it has a file of progress."""
    rows = read_progress(folder) if (folder / PROGRESS).exists() else []
    if not rows:
        return {}
    return {"agent steps": f"{rows[-1]['agent_steps']:.0f}", "hours": f"{rows[-1]['seconds'] / 3600:.2f}"}
