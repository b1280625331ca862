"""Small problem files, large enough to train on."""

import json

import numpy as np

from mapf_pz.instances import write_map
from mapf_pz.instances.instance import Grid


def write_lorr(folder, name="depot", height=6, width=7, starts=(0, 3, 13), tasks=(41, 20, 8, 5, 30)):
    """Write a League of Robot Runners problem on an empty map; starts and tasks are cell numbers."""
    write_map(Grid(np.ones((height, width), np.bool_), name), folder / f"{name}.map")
    for ending, cells in (("agents", starts), ("tasks", tasks)):
        (folder / f"{name}.{ending}").write_text("\n".join(map(str, (len(cells), *cells))) + "\n")
    members = {"mapFile": f"{name}.map", "agentFile": f"{name}.agents", "taskFile": f"{name}.tasks"}
    members |= {"teamSize": len(starts), "taskAssignmentStrategy": "roundrobin"}
    (folder / f"{name}.json").write_text(json.dumps(members))
    return folder / f"{name}.json"


POGEMA_MAPS = {"small": ["......"] * 5, "large": [".......", ".###...", *["......."] * 4]}
POGEMA_INSTANCES = [
    {
        "map_name": "small",
        "agents_xy": [[0, 0], [1, 1], [2, 2]],
        "targets_xy": [[[4, 4], [0, 1]], [[3, 3]], [[0, 5], [1, 0]]],
    },
    {
        "map_name": "large",
        "agents_xy": [[0, 0], [5, 6], [2, 2], [3, 3]],
        "targets_xy": [[[4, 4]], [[0, 0], [5, 5], [2, 0]], [[5, 0]], [[0, 1]]],
    },
]


def write_pogema(folder, instances=POGEMA_INSTANCES):
    """Write a lifelong set of POGEMA's benchmark: two instances on maps of different sizes."""
    (folder / "01-set.maps.json").write_text(json.dumps(POGEMA_MAPS))
    (folder / "01-set.lmapf.json").write_text(json.dumps(instances))
    return folder / "01-set.lmapf.json"
