"""Print what LeRobot's own library reads in a dataset, as JSON: `read_lerobot.py FOLDER`.

Run by the interpreter of LeRobot's environment, which has nothing of ours.
"""

import json
import re
import sys

import torch


def import_torchvision() -> None:
    """Import it beside PyTorch for CPUs too, where its operators, made for CUDA, do not load.

    They are for pictures, and these datasets have none: their names alone are declared.
    """
    library = torch.library.Library("torchvision", "DEF")
    while True:
        try:
            import torchvision  # noqa: F401

            return
        except RuntimeError as error:
            missing = re.search(r"operator torchvision::(\w+) does not exist", str(error))
            if not missing:
                raise
            for name in [name for name in sys.modules if name.startswith("torchvision")]:
                del sys.modules[name]
            library.define(f"{missing[1]}() -> ()")


import_torchvision()

from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402

folder = sys.argv[1]
whole = LeRobotDataset("pair", root=folder)
ahead = {"action": [0, 1 / whole.fps]}  # this action and the next, as policies of chunks train
second = LeRobotDataset("pair", root=folder, episodes=[1], delta_timestamps=ahead)
batch = next(iter(torch.utils.data.DataLoader(whole, batch_size=4)))
frames = [whole[number] for number in range(len(whole))]
json.dump(
    {
        "episodes": whole.num_episodes,
        "fps": whole.fps,
        "state": [frame["observation.state"].tolist() for frame in frames],
        "action": [frame["action"].tolist() for frame in frames],
        "reward": [frame["next.reward"].item() for frame in frames],
        "done": [frame["next.done"].item() for frame in frames],
        "task": frames[0]["task"],
        "mean": whole.meta.stats["action"]["mean"].tolist(),
        "ahead": [second[number]["action"].tolist() for number in range(len(second))],
        "batch": list(batch["observation.human_state"].shape),
    },
    sys.stdout,
)
