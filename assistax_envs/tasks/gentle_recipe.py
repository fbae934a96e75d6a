"""Changes of PPO's presets that all gentle tasks share. Imports no JAX or MuJoCo."""

from collections.abc import Mapping
from typing import Any

# Noise of the size of a whole joint's torque rubs no skin gently, hence the small deviation at the
# start. The bonus keeps it from shrinking before both have found their part of the act, and ends
# with the run. MAPPO learns at IPPO's rate. On a CPU `--set num_envs=256 --steps 6M` gives a team
# of scratch or bath in five minutes.
RECIPE: Mapping[str, Any] = {
    "initial_log_std": -1.2,
    "anneal_lr": True,
    "anneal_entropy": True,
    "learning_rate": 1e-3,
    # A narrow liking pays nothing to a robot that knows nothing yet.
    "liking_width": 0.7,
}
