from .mapf_env import MapfEnv as MapfEnv
from .mapf_env import env as env
from .mapf_env import parallel_env as parallel_env
