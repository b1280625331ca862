"""Maps, scenarios and instances: their files, generators, and sources of episodes.

It imports only what is internal. Read `instance.py` first.
"""

from mapf_pz.instances.bundled import map_names, write_bundled
from mapf_pz.instances.delays import Delays
from mapf_pz.instances.files.lorr import LorrProblem, read_problem
from mapf_pz.instances.files.movingai import (
    format_map,
    format_scenario,
    parse_map,
    parse_scenario,
    read_map,
    read_scenario,
    write_map,
    write_scenario,
)
from mapf_pz.instances.files.pogema import read_pogema
from mapf_pz.instances.files.pogema_config import convert_pogema
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.instance import Grid, Instance, InstanceSource, Scenario
from mapf_pz.instances.library import load_map, load_scenario
from mapf_pz.instances.load import load_instance, load_instances, load_pogema, load_problem
from mapf_pz.instances.mixture import MapMixture
from mapf_pz.instances.place import components, largest_component, place, place_on
from mapf_pz.instances.sources import (
    FixedMap,
    FixedScenario,
    InstanceList,
    RandomMaps,
    RandomObstacles,
    SourceMixture,
)
from mapf_pz.instances.warehouse import Warehouse, WarehouseTasks, load_warehouse

__all__ = [
    "Delays",
    "FixedMap",
    "FixedScenario",
    "Grid",
    "Heading",
    "Instance",
    "InstanceList",
    "InstanceSource",
    "LorrProblem",
    "MapMixture",
    "RandomMaps",
    "RandomObstacles",
    "Scenario",
    "SourceMixture",
    "Warehouse",
    "WarehouseTasks",
    "components",
    "convert_pogema",
    "format_map",
    "format_scenario",
    "largest_component",
    "load_instance",
    "load_instances",
    "load_map",
    "load_pogema",
    "load_problem",
    "load_scenario",
    "load_warehouse",
    "map_names",
    "parse_map",
    "parse_scenario",
    "place",
    "place_on",
    "read_map",
    "read_pogema",
    "read_problem",
    "read_scenario",
    "write_bundled",
    "write_map",
    "write_scenario",
]
