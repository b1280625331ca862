"""Wrappers of the environment: one class a file."""

from mapf_pz.action_modes import ACTION_MODES, ActionMode
from mapf_pz.wrappers.action_vector import ActionVector
from mapf_pz.wrappers.centralized import CentralizedEnv, TeamReward, centralized_env

__all__ = ["ACTION_MODES", "ActionMode", "ActionVector", "CentralizedEnv", "TeamReward", "centralized_env"]
