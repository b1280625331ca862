"""Planning: planners, and whether what they make is legal."""

from mapf_pz.planners.base import Planner
from mapf_pz.planners.pibt import PIBT
from mapf_pz.planners.plan import Plan, Violation, validate

__all__ = ["PIBT", "Plan", "Planner", "Violation", "validate"]
