"""Task assignment for the League of Robot Runners: which agent carries out which task."""

from mapf_pz.planners.scheduling.run import ScheduledRun, run_problem
from mapf_pz.planners.scheduling.schedulers import SCHEDULERS, Scheduler

__all__ = ["SCHEDULERS", "ScheduledRun", "Scheduler", "run_problem"]
