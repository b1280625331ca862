"""Evaluation: policies and planners on the same episodes, under the same rules."""

from mapf_pz.evaluate.evaluation import evaluate
from mapf_pz.evaluate.policies import named_policy
from mapf_pz.evaluate.report import markdown_table, terminal_table
from mapf_pz.evaluate.results import Episode
from mapf_pz.evaluate.run import Policy, make_env, play
from mapf_pz.evaluate.suite import load_suite, suite_names
from mapf_pz.evaluate.trial import Trial

__all__ = [
    "Episode",
    "Policy",
    "Trial",
    "evaluate",
    "load_suite",
    "make_env",
    "markdown_table",
    "named_policy",
    "play",
    "suite_names",
    "terminal_table",
]
