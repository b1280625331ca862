"""The command line `mapf-pz`, which imports only the modules that a command needs."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from functools import partial
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

import tyro

from mapf_pz._internal.interrupts import interrupts_deferred
from mapf_pz._internal.printable import printable
from mapf_pz._internal.suggest import expected_names
from mapf_pz.errors import USER_ERRORS

USAGE_ERROR, INTERRUPTED, BROKEN_PIPE = 2, 130, 141
OTHER_OPTIONS = {
    "--lr": "--learning-rate",
    "--policies": "--policy, once for each policy",
    "--agents": "--num-agents",
    "--envs": "--num-envs",
    "--epochs": "--num-epochs",
    "--batch-size": "--minibatch-size",
    "--timesteps": "--agent-steps",
    "--total-timesteps": "--agent-steps",
    "--max-episode-steps": "--max-steps",
}
"""Options that other programs have, and what they are called here."""


class Command(NamedTuple):
    """A command."""

    function: str
    """`module:function`. The module is imported when the command runs; the options are the function's parameters."""
    summary: str
    """One-line description in `mapf-pz --help`."""


COMMANDS: dict[str, Command] = {
    "compile": Command("mapf_pz.commands.compile:compile_kernels", "compile all kernels before they are needed"),
    "dataset": Command("mapf_pz.commands.dataset:dataset", "make demonstrations with a planner, and export them"),
    "edit": Command("mapf_pz.commands.edit:edit", "edit maps and scenarios in the browser, and solve them"),
    "evaluate": Command(
        "mapf_pz.commands.evaluate:evaluate_policies", "compare policies and planners on the same instances"
    ),
    "execute": Command("mapf_pz.commands.plans.execute:execute_plan", "execute a plan while agents are delayed"),
    "guidance": Command("mapf_pz.commands.guidance:guidance", "draw, generate, evaluate and optimize guidance graphs"),
    "maps": Command("mapf_pz.commands.maps:maps", "list, write, generate or download maps"),
    "play": Command("mapf_pz.commands.play:play", "control an agent with the keyboard"),
    "plot": Command("mapf_pz.commands.plot:plot", "draw the learning curves of training runs"),
    "policy": Command("mapf_pz.commands.policy:policy", "share a policy on the Hugging Face Hub, or export it to ONNX"),
    "render": Command("mapf_pz.commands.render:render", "save an episode or a plan as a web page, video or image"),
    "report": Command("mapf_pz.commands.report:report", "make tables and figures of evaluations, for papers"),
    "schedule": Command(
        "mapf_pz.commands.plans.solve:schedule", "run a League of Robot Runners problem, tasks assigned by a scheduler"
    ),
    "serve": Command("mapf_pz.commands.serve:serve", "act in POGEMA's environment, from a separate Python"),
    "solve": Command(
        "mapf_pz.commands.plans.solve:solve", "solve an instance with a planner or policy, and write the plan"
    ),
    "train": Command("mapf_pz.commands.train:train", "train a policy, and evaluate it"),
    "validate": Command("mapf_pz.commands.plans.validate:validate_plan", "validate a plan file, and compute its costs"),
}
"""The commands by name."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit status.

    The status is 0, or 1 after an error, 2 after wrong usage, 130 after Ctrl-C, and 141 if the reader of the output has
    exited.

    Args:
        arguments: the arguments after `mapf-pz`. None: those of the process.

    Raises:
        SystemExit: after a command's `--help` (0), or if its options are invalid (2).
    """
    with redirect_stdout(sys.stdout or open(os.devnull, "w")):  # a process may start without a standard output
        try:
            try:
                return _main(list(sys.argv[1:] if arguments is None else arguments))
            finally:
                sys.stdout.flush()
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes once more at exit
            if isinstance(error, BrokenPipeError):  # the reader, such as `head`, has exited
                return BROKEN_PIPE
            return _print_error("mapf-pz", f"standard output: {error}", 1)


def _main(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help"):
        print(_overview())
        return 0 if words else USAGE_ERROR
    if words[0] == "--version":
        from mapf_pz._internal.version import __version__

        print(f"mapf-pz {__version__}")
        return 0
    name = words[0]
    if name not in COMMANDS:
        return _print_error("mapf-pz", f"no command {name!r}, {expected_names(name, COMMANDS)}", USAGE_ERROR)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = partial(_show_warning, f"mapf-pz {name}")
            _run(name, words[1:])
    except BrokenPipeError:
        raise
    except KeyboardInterrupt:
        return _print_error(f"mapf-pz {name}", "interrupted", INTERRUPTED)
    except USER_ERRORS as error:
        return _print_error(f"mapf-pz {name}", str(error) or type(error).__name__, 1)
    return 0


def _run(name: str, words: list[str]) -> None:
    if "" not in sys.path:
        sys.path.append("")  # parts that users plug in may be in the current folder, as with `python -m`
    config = (tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes)
    try:
        with interrupts_deferred() as interrupted:  # packages may lose an interrupt during their import
            command, options = _command(name, words)
            from mapf_pz.commands.env_flags import ENV_FLAGS

            if interrupted():
                raise KeyboardInterrupt
        parse = partial(_parse, prog=f"mapf-pz {name}", args=options, config=config, registry=ENV_FLAGS)
        parameters = signature(command, eval_str=True).parameters
        if list(parameters) == ["options"]:  # one dataclass, whose name is not to be in the help text
            command(parse(parameters["options"].annotation, description=command.__doc__))
        else:
            parse(command)
    except ModuleNotFoundError as error:
        raise ImportError(f"{error}: pip install 'mapf-pz[train,render]'") from error


def _parse(kind: Any, *, args: list[str], **keywords: Any) -> Any:
    """Parse the options of a command; after wrong ones, also print what those of other programs are called here."""
    try:
        return tyro.cli(kind, args=args, **keywords)
    except SystemExit as error:
        given = {word.partition("=")[0] for word in args} if error.code == USAGE_ERROR else ()
        for word in (word for word in OTHER_OPTIONS if word in given):
            print(f"{word}: did you mean {OTHER_OPTIONS[word]}?", file=sys.stderr)
        raise


def _command(name: str, words: list[str]) -> tuple[Callable[..., None], list[str]]:
    """Return the function of a command, and its options; `train` accepts more than presets."""
    module, _, function = COMMANDS[name].function.partition(":")
    if name == "train" and words and words[0].endswith(".json"):  # a file with a configuration
        return import_module(module).train_from(Path(words[0]), "--trust-remote-code" in words), words[1:]
    if name == "train" and words and ":" in words[0]:  # package.module:Class, with the settings of `mappo`
        words = ["mappo", "--algorithm", *words]
    return getattr(import_module(module), function), words


def _overview() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:{width}}  {command.summary}" for name, command in COMMANDS.items()]
    hint = "Run mapf-pz COMMAND --help for the options of a command, mapf-pz --version for the version."
    return "\n".join(["usage: mapf-pz COMMAND [OPTIONS]", "", *lines, "", hint])


def _show_warning(source: str, message: Warning | str, *_location: object) -> None:
    """Print a warning in one line, without its location in the code."""
    _print_error(f"{source}: warning", str(message), 0)


def _print_error(source: str, message: str, status: int) -> int:
    print(f"{source}: {' '.join(printable(message).split())}", file=sys.stderr)
    return status
