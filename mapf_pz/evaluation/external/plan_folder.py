"""Plan files that exist already, one for each instance."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mapf_pz._internal.digest import digest
from mapf_pz.environment.mapf_env import MapfEnv, parallel_env
from mapf_pz.errors import FormatError
from mapf_pz.evaluation.external.planned_policy import ExternalPlan, NoPlanError, PlannedPolicy
from mapf_pz.instances.instance import Instance
from mapf_pz.planners import Planner
from mapf_pz.planners.plans.files import FORMATTERS, Selection, read_plan


@dataclass(frozen=True)
class PlanFolderFactory:
    """Makes a policy that executes the plan files of a folder.

    The plan for an instance is in the file `INSTANCE-Nagents.EXTENSION`, such as
    `random-32-32-20-random-1-50agents.txt`, in any of the formats and extensions of plan files. INSTANCE is the name of
    the instance in the results, such as that of its scenario; if several have the same name, it is followed by the
    number of the episode, as in `wfi_warehouse-0-32agents.txt`.

    Raises `FileNotFoundError` if the folder does not exist or has no plan files.
    """

    folder: Path
    """The folder."""

    def __post_init__(self) -> None:
        """Check that there are plan files."""
        if not self._files():
            expected = f"files INSTANCE-Nagents{'|'.join(FORMATTERS)}"
            raise FileNotFoundError(f"{self.folder}: expected a folder with plans, {expected}")

    @property
    def identity(self) -> dict[str, Any]:
        """The digest of the plan files."""
        return {"policy": "plans", "plans": digest({file.name: file for file in self._files()})}

    def __call__(self, keywords: dict[str, Any]) -> tuple[MapfEnv, PlannedPolicy]:
        """Return the environment and the policy."""
        env = parallel_env(**(Planner.env_kwargs | keywords))
        return env, PlannedPolicy(env, self.plan)

    def plan(self, instance: Instance, name: str) -> ExternalPlan:
        """Return the plan for an instance with this name; raises `NoPlanError` if there is none, or several."""
        stem = f"{name}-{instance.num_agents}agents"
        files = [file for file in self._files() if file.stem == stem]
        if len(files) != 1:
            raise NoPlanError(f"expected one plan file {stem}{'|'.join(FORMATTERS)}, found {len(files)}")
        try:
            return ExternalPlan(read_plan(files[0], Selection(instance.scenario, instance.num_agents, name)).plan)
        except FormatError as error:
            raise NoPlanError(str(error)) from None

    def _files(self) -> list[Path]:
        """Return the plan files, sorted."""
        return sorted(file for ending in FORMATTERS for file in self.folder.glob(f"*-*agents{ending}"))
