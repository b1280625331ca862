"""Wrappers of the environment.

They import the environment and the simulator. Read `centralized.py` first.
"""

from mapf_pz.simulator.actions import ACTION_MODES, ActionMode
from mapf_pz.wrappers.aec import to_aec
from mapf_pz.wrappers.agent_vector import AgentVectorEnv
from mapf_pz.wrappers.centralized import CentralizedEnv, TeamReward, centralized_env
from mapf_pz.wrappers.centralized_vector import CentralizedVectorEnv
from mapf_pz.wrappers.continuous_actions import ContinuousActions
from mapf_pz.wrappers.flat_observations import FlatObservations
from mapf_pz.wrappers.masked_observations import MaskedObservations
from mapf_pz.wrappers.record_episode import RecordEpisode

__all__ = [
    "ACTION_MODES",
    "ActionMode",
    "AgentVectorEnv",
    "CentralizedEnv",
    "CentralizedVectorEnv",
    "ContinuousActions",
    "FlatObservations",
    "MaskedObservations",
    "RecordEpisode",
    "TeamReward",
    "centralized_env",
    "to_aec",
]
