"""The requests of the page: their members, and refusals."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, TypeVar

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from mapf_pz.simulator.config import MAX_WHOLE, EnvConfig

MAX_STEPS = 100_000
"""Maximum number of steps of an episode."""
MAX_SECONDS = 86_400.0
"""Maximum time limit in seconds."""
Steps = Annotated[int, Field(ge=1, le=MAX_STEPS)]
"""A number of steps."""
Seed = Annotated[int, Field(ge=0, lt=2**63)]
"""A random seed."""
Whole = Annotated[int, Field(ge=-MAX_WHOLE, le=MAX_WHOLE)]
"""A whole number, which kernels can read in any case."""
Number = Annotated[int | float, Field(ge=-MAX_WHOLE, le=MAX_WHOLE)]
"""A number, which is finite."""
Cell = tuple[Whole, Whole]
"""[row, col]."""
Kind = TypeVar("Kind", bound="Request")


class Refusal(Exception):
    """A request that is not carried out."""

    def __init__(self, status: int, message: str, **members: object) -> None:
        """Create the refusal: a status of HTTP, a message in one line, and further members of the response."""
        super().__init__(message)
        self.status = status
        self.members = members


@dataclass(frozen=True, kw_only=True)
class Request:
    """A request, of which unknown members are refused."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")  # also applies to nested objects


def parse_request(kind: type[Kind], body: bytes) -> Kind:
    """Parse a request, a JSON object; raises `Refusal` with the first member that is wrong."""
    try:
        return TypeAdapter(kind).validate_json(body, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise Refusal(400, f"{place}: {first['msg']}" if place else first["msg"]) from None


@dataclass(frozen=True, kw_only=True)
class NamesRequest(Request):
    """Request of all names."""


@dataclass(frozen=True, kw_only=True)
class ListRequest(Request):
    """Request of the entries of a folder."""

    path: str
    """The folder."""


@dataclass(frozen=True, kw_only=True)
class OpenRequest(Request):
    """Request of the text of one file: `path`, `map`, `scenario` with `map`, or `problem`."""

    path: str | None = None
    """A file."""
    map: str | None = None
    """Name of a map."""
    scenario: str | None = None
    """Name of a scenario of the map."""
    problem: str | None = None
    """Name or file of a problem of the League of Robot Runners."""


@dataclass(frozen=True, kw_only=True)
class GenerateRequest(Request):
    """Request of a generated map."""

    family: str
    """Name of the family."""
    options: dict[str, Number] = field(default_factory=dict[str, Number])
    """Options of the family by name."""
    seed: Seed = 0
    """Random seed."""


@dataclass(frozen=True, kw_only=True)
class CancelRequest(Request):
    """Request to end the generation of a map."""


@dataclass(frozen=True, kw_only=True)
class GraphRequest(Request):
    """Request of the weights of a guidance graph."""

    map: str
    """Text of the map."""
    name: str
    """Name of the guidance graph."""


@dataclass(frozen=True, kw_only=True)
class SaveRequest(Request):
    """Request to write a file."""

    path: str
    """The file."""
    text: str
    """Its content."""
    overwrite: bool = False
    """Whether an existing file is replaced."""


@dataclass(frozen=True, kw_only=True)
class EditedInstance(Request):
    """The instance on the page."""

    name: str
    """Name of the map."""
    map: str
    """Text of the map."""
    starts: list[Cell]
    """The start of each of N agents."""
    goals: list[list[Cell]]
    """The goals of each agent, in order."""
    headings: list[Whole] | None = None
    """The headings of agents that turn, 0 to 3 for east, south, west, north; None: agents do not turn."""
    weights: str | None = None
    """Edge weights, base64 of (5, H, W) little-endian float32: east, south, west, north, and waiting.
    None: uniform for planners, and those of its training for a policy."""


@dataclass(frozen=True, kw_only=True)
class SolveRequest(Request):
    """Request to run one or two solvers."""

    instance: EditedInstance
    """The instance."""
    solvers: Annotated[list[str], Field(min_length=1, max_length=2)]
    """Names of planners and policies, with options."""
    time_limit: Annotated[float, Field(gt=0, le=MAX_SECONDS, allow_inf_nan=False)] = 10.0
    """Time limit in seconds."""
    max_steps: Steps = EnvConfig.max_steps
    """Maximum number of steps."""
    seed: Seed = 0
    """Random seed."""
    lifelong: bool = False
    """Whether an agent receives its next goal when it reaches one."""
    delays: str | None = None
    """Text of the delays of agents, as in `EnvConfig`. None: there are none."""


@dataclass(frozen=True, kw_only=True)
class RunRequest(Request):
    """Request of the progress of a run, or to stop it."""

    run: Whole
    """Number of the run."""


@dataclass(frozen=True, kw_only=True)
class EpisodeRequest(RunRequest):
    """Request of the episode of a solver."""

    solver: Annotated[int, Field(ge=0, le=1)]
    """Index of the solver in the run."""


@dataclass(frozen=True, kw_only=True)
class StepRequest(EpisodeRequest):
    """Request to resume an episode from one of its steps."""

    start: Annotated[int, Field(alias="from", ge=0, le=MAX_STEPS)]
    """The number of steps that are kept."""
    actions: dict[Whole, Whole] = field(default_factory=dict[Whole, Whole])
    """Actions in the next step by agent; the policy moves the others."""
    steps: Steps = 1
    """Number of steps that are added."""
