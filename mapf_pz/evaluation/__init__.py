"""Evaluation of policies and planners on the same episodes, with the same rules.

It imports everything but the commands. Read `evaluate_policies.py` first.
"""

from mapf_pz._internal.digest import digest
from mapf_pz.environment.policy import BatchPolicy, Policy, PolicyInBatch, make_env
from mapf_pz.evaluation.episodes import Rollout, rollout
from mapf_pz.evaluation.evaluate_policies import evaluate
from mapf_pz.evaluation.inspection import InspectedPolicy
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.evaluation.reports.formats import markdown_table, terminal_table
from mapf_pz.evaluation.results import Episode
from mapf_pz.evaluation.solver import PolicySolver, solver_of
from mapf_pz.evaluation.suite import load_suite, suite_names
from mapf_pz.evaluation.task import EvaluationTask

__all__ = [
    "BatchPolicy",
    "Episode",
    "EvaluationTask",
    "InspectedPolicy",
    "Policy",
    "PolicyInBatch",
    "PolicySolver",
    "Rollout",
    "digest",
    "evaluate",
    "load_suite",
    "make_env",
    "markdown_table",
    "policy_factory",
    "rollout",
    "solver_of",
    "suite_names",
    "terminal_table",
]
