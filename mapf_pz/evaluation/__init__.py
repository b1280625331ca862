"""Evaluation of policies and planners on the same episodes, with the same rules."""

from mapf_pz.evaluation.evaluate_policies import evaluate
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.evaluation.report import markdown_table, terminal_table
from mapf_pz.evaluation.results import Episode
from mapf_pz.evaluation.rollout import Policy, make_env, play
from mapf_pz.evaluation.suite import load_suite, suite_names
from mapf_pz.evaluation.task import EvaluationTask

__all__ = [
    "Episode",
    "EvaluationTask",
    "Policy",
    "evaluate",
    "load_suite",
    "make_env",
    "markdown_table",
    "play",
    "policy_factory",
    "suite_names",
    "terminal_table",
]
