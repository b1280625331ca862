"""Planning: what a plan is, and whether it is legal."""

from mapf_pz.planners.plan import Plan, Violation, validate

__all__ = ["Plan", "Violation", "validate"]
