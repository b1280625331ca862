"""The command line, `mapf-pz`: finds a command by the first word, and loads no more than that command needs."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from typing import NamedTuple

import tyro

from mapf_pz.interrupts import interrupts_deferred

USAGE_ERROR, INTERRUPTED, BROKEN_PIPE = 2, 130, 141
TOLD = (ValueError, TypeError, OSError, RuntimeError, MemoryError, ImportError)
"""Errors that a user can cause, told in one line; any other is our mistake, and shows where."""


class Command(NamedTuple):
    """A command."""

    function: str
    """`module:function`. The module is loaded when the command is used; tyro reads the options off the function."""
    summary: str
    """One line for `mapf-pz --help`."""


COMMANDS: dict[str, Command] = {
    "benchmark": Command("mapf_pz.commands.benchmark:benchmark", "measure how fast environments step"),
    "evaluate": Command(
        "mapf_pz.commands.evaluate:evaluate_policies", "compare policies and planners on the same instances"
    ),
    "maps": Command("mapf_pz.commands.maps:maps", "list the bundled maps, write them, or download the benchmark"),
    "play": Command("mapf_pz.commands.play:play", "steer an agent with the keyboard, among others"),
    "render": Command("mapf_pz.commands.render:render", "save an episode or a plan as page, film or picture"),
    "solve": Command("mapf_pz.commands.solve:solve", "let a planner solve an instance, and write its plan"),
    "train": Command("mapf_pz.commands.train:train", "train a policy, and evaluate it"),
    "validate": Command("mapf_pz.commands.validate:validate_plan", "check a plan file, and count its costs"),
}
"""The commands by name."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit status.

    It is 0; 1 after an error, 2 for wrong usage, 130 after Ctrl-C, and 141 where the reader of the output is gone.

    Args:
        arguments: The words after `mapf-pz`; None takes those of the process.

    Raises:
        SystemExit: A command's `--help` was asked for (0), or it has no such options (2).
    """
    try:
        try:
            return _main(list(sys.argv[1:] if arguments is None else arguments))
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes once more at exit
        return BROKEN_PIPE


def _main(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help"):
        print(_overview())
        return 0 if words else USAGE_ERROR
    name = words[0]
    if name not in COMMANDS:
        return _tell("mapf-pz", f"no command {name!r}, expected one of {', '.join(COMMANDS)}", USAGE_ERROR)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = partial(_show_warning, f"mapf-pz {name}")
            _run(name, words[1:])
    except BrokenPipeError:
        raise
    except KeyboardInterrupt:
        return _tell(f"mapf-pz {name}", "interrupted", INTERRUPTED)
    except TOLD as error:
        return _tell(f"mapf-pz {name}", str(error) or type(error).__name__, 1)
    return 0


def _run(name: str, words: list[str]) -> None:
    module, _, function = COMMANDS[name].function.partition(":")
    config = (tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes)
    try:
        with interrupts_deferred() as check:  # packages that are interrupted while they load may lose it
            command = getattr(import_module(module), function)
            from mapf_pz.commands.env_flags import ENV_FLAGS
            from mapf_pz.core.jit import reporting_compilation

            check()
        with reporting_compilation(_report_compilation):
            tyro.cli(command, prog=f"mapf-pz {name}", args=words, config=config, registry=ENV_FLAGS)
    except ModuleNotFoundError as error:
        raise ImportError(f"{error}: pip install 'mapf-pz[train,render]'") from error


def _report_compilation() -> None:
    """Say why nothing seems to happen, if somebody is looking."""
    if sys.stderr.isatty():
        print("compiling kernels, which takes up to two minutes (once per machine and version) ...", file=sys.stderr)


def _overview() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:{width}}  {command.summary}" for name, command in COMMANDS.items()]
    return "\n".join(["usage: mapf-pz COMMAND [OPTIONS]", "", *lines, "", "mapf-pz COMMAND --help tells its options."])


def _show_warning(who: str, message: Warning | str, *_place: object) -> None:
    """Print a warning in one line, without the place in the code."""
    _tell(f"{who}: warning", str(message), 0)


def _tell(who: str, message: str, status: int) -> int:
    print(f"{who}: {' '.join(message.split())}", file=sys.stderr)
    return status
