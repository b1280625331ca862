"""Wrappers of the environment: one class a file."""

from mapf_pz.action_modes import ACTION_MODES, ActionMode
from mapf_pz.wrappers.action_vector import ActionVector
from mapf_pz.wrappers.centralized import CentralizedEnv, TeamReward, centralized_env
from mapf_pz.wrappers.centralized_vector import CentralizedVectorEnv
from mapf_pz.wrappers.history import History
from mapf_pz.wrappers.record import Record
from mapf_pz.wrappers.sharing import Sharing

__all__ = [
    "ACTION_MODES",
    "ActionMode",
    "ActionVector",
    "CentralizedEnv",
    "CentralizedVectorEnv",
    "History",
    "Record",
    "Sharing",
    "TeamReward",
    "centralized_env",
]
