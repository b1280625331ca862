"""Planning: planners, and whether what they make is legal."""

from mapf_pz.planners.base import Planner
from mapf_pz.planners.epibt import EPIBT
from mapf_pz.planners.lacam import LaCAM
from mapf_pz.planners.pibt import PIBT
from mapf_pz.planners.plan import Plan, Violation, validate
from mapf_pz.planners.prioritized import PrioritizedSIPP
from mapf_pz.planners.record import record_plan
from mapf_pz.planners.shield import Shield

PLANNERS: dict[str, type[Planner]] = {
    "pibt": PIBT,
    "epibt": EPIBT,
    "prioritized": PrioritizedSIPP,
    "lacam": LaCAM,
}
"""The planners by name."""

__all__ = [
    "EPIBT",
    "PIBT",
    "PLANNERS",
    "LaCAM",
    "Plan",
    "Planner",
    "PrioritizedSIPP",
    "Shield",
    "Violation",
    "record_plan",
    "validate",
]
