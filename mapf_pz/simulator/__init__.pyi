from .actions import Action as Action
from .actions import CardinalAction as CardinalAction
from .config import EnvConfig as EnvConfig
from .kernels.reward import RewardConfig as RewardConfig
from .simulator import Simulator as Simulator
from .transition import Transition as Transition
