"""Planners, plans and their files, and the assignment of tasks.

It imports the environment and the simulator. Read `base.py` first, then `pibt/kernels.py` for a planner.
"""

from mapf_pz.planners.base import PlanFollower, Planner, StepPlanner
from mapf_pz.planners.cbs.planner import CBS
from mapf_pz.planners.epibt.planner import EPIBT
from mapf_pz.planners.lacam.planner import LaCAM
from mapf_pz.planners.named import PLANNERS, planner_of
from mapf_pz.planners.pibt.planner import PIBT
from mapf_pz.planners.plans.delayed import DelayedExecution, execute_delayed
from mapf_pz.planners.plans.dependencies import DependencyGraph
from mapf_pz.planners.plans.execution import Execution
from mapf_pz.planners.plans.plan import Plan, Violation, validate, violations
from mapf_pz.planners.plans.record import record_execution, record_plan
from mapf_pz.planners.plans.switching import SwitchableExecution
from mapf_pz.planners.shield.shield import BatchShield, Shield
from mapf_pz.planners.sipp.prioritized import PrioritizedSIPP
from mapf_pz.planners.trace import Solution, Trace, write_trace
from mapf_pz.planners.windowed.planner import WindowedLNS

__all__ = [
    "CBS",
    "EPIBT",
    "PIBT",
    "PLANNERS",
    "BatchShield",
    "DelayedExecution",
    "DependencyGraph",
    "Execution",
    "LaCAM",
    "Plan",
    "PlanFollower",
    "Planner",
    "PrioritizedSIPP",
    "Shield",
    "Solution",
    "StepPlanner",
    "SwitchableExecution",
    "Trace",
    "Violation",
    "WindowedLNS",
    "execute_delayed",
    "planner_of",
    "record_execution",
    "record_plan",
    "validate",
    "violations",
    "write_trace",
]
