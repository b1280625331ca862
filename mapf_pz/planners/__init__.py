"""Planning: planners, and whether what they make is legal."""

from mapf_pz.planners.base import Planner
from mapf_pz.planners.epibt import EPIBT
from mapf_pz.planners.pibt import PIBT
from mapf_pz.planners.plan import Plan, Violation, validate

PLANNERS: dict[str, type[Planner]] = {"pibt": PIBT}
"""The planners by name."""

__all__ = ["EPIBT", "PIBT", "PLANNERS", "Plan", "Planner", "Violation", "validate"]
