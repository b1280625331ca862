"""Multi-agent path finding (MAPF) on standard benchmark maps, as a PettingZoo environment.

Importing this package is quick: names and packages are loaded when they are first used, and nothing is compiled.
"""

import gymnasium
import lazy_loader
import pettingzoo

# The names are those of `__init__.pyi`.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

if hasattr(pettingzoo, "register"):  # since PettingZoo 1.27
    pettingzoo.register("parallel", "mapf_pz/Mapf-v0", entry_point="mapf_pz.environment:parallel_env")
    pettingzoo.register("aec", "mapf_pz/Mapf-v0", entry_point="mapf_pz.environment:env")
gymnasium.register(
    "Mapf-Centralized-v0",
    entry_point="mapf_pz.wrappers.centralized:centralized_env",
    vector_entry_point="mapf_pz.wrappers.centralized_vector:CentralizedVectorEnv",
)
gymnasium.register(
    "Mapf-Agents-v0",
    entry_point="mapf_pz.wrappers.agent_vector:refuse_single",
    vector_entry_point="mapf_pz.wrappers.agent_vector:AgentVectorEnv",
)
