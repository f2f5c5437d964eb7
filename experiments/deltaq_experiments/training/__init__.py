"""The camera follower's task as a Gymnasium environment, in virtual time and through the gate.

Importing this registers it: `gymnasium.make("deltaq_experiments.training:deltaq/CameraFollower-v0")`.
"""

from deltaq_protocol.errors import DeltaqError

try:
    import gymnasium
except ModuleNotFoundError:
    raise DeltaqError("gymnasium is not installed: pip install 'deltaq[gymnasium]'") from None

ENVIRONMENT = "deltaq/CameraFollower-v0"
"""The name by which Gymnasium knows the environment."""

if ENVIRONMENT not in gymnasium.registry:
    gymnasium.register(ENVIRONMENT, "deltaq_experiments.training.environment:CameraEnvironment")
