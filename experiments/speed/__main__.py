"""Measure the speed of environments, training, evaluation and pages: `python -m experiments.speed COMMAND`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

import tyro

from mapf_pz.commands.env_flags import ENV_FLAGS
from mapf_pz.errors import USER_ERRORS

COMMANDS = {
    "environments": "this package's interfaces, parts of the simulator, and other environments",
    "collector": "TorchRL's collector and rollout, also on an environment that does nothing",
    "scale": "memory and time with many agents",
    "training": "training runs",
    "evaluation": "trained policies, one episode at a time and in batches",
    "replay": "demonstrations",
    "page": "the page of mapf-pz render",
    "editor": "the page of mapf-pz edit",
}
"""What the commands measure; each is the function `main` of the module of its name."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command.

    Args:
        arguments: the arguments after `experiments.speed`. None: those of the process.

    Raises:
        SystemExit: after `--help` (0), if the command or its options are invalid, or with an error's message.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or words[0] not in COMMANDS:
        print("usage: python -m experiments.speed COMMAND [OPTIONS]\n")
        print("\n".join(f"  {name:12}  {summary}" for name, summary in COMMANDS.items()))
        raise SystemExit(0 if words in (["-h"], ["--help"]) else 2)
    command = import_module(f"experiments.speed.{words[0]}").main
    config = (tyro.conf.OmitArgPrefixes,)
    try:
        tyro.cli(command, prog=f"experiments.speed {words[0]}", args=words[1:], config=config, registry=ENV_FLAGS)
    except USER_ERRORS as error:
        raise SystemExit(f"experiments.speed {words[0]}: {error}") from None


if __name__ == "__main__":
    main()
