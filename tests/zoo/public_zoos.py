"""Small zoos in the formats of the public Assistax code."""

import csv
import io
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

UUIDS = tuple(f"{n:08x}-0000-4000-8000-00000000000{n}" for n in range(4))
DISABILITY = """\
  disability:
    joint_idx: {joint}
    joint_restriction_factor: 0.7
    joint_strength: 0.4
    tremor_magnitude: 0.1
"""
CONFIG = """\
ALGORITHM: {algorithm}
ENV_NAME: {scenario}
ENV_KWARGS:
  homogenisation_method: max
{disability}network:
  recurrent: {recurrent}
  agent_param_sharing: false
  activation: tanh
  {width}: 128
OBS_DIM: 6
ACT_DIM: 3
seed: 0
"""


def leaves(recurrent: bool, joint: str, seed: int) -> dict[str, np.ndarray]:
    """Return what a public parameter file holds, with another joint between the names."""
    rng = np.random.default_rng(seed)
    shapes: dict[str, tuple[int, ...]] = {
        "Dense_0/kernel": (6, 8),
        "Dense_0/bias": (8,),
        "Dense_1/kernel": (8, 8),
        "Dense_2/kernel": (8, 3),
        "log_std": (3,),
    }
    if recurrent:
        shapes |= {"GRUCell_0/hn/kernel": (8, 8), "GRUCell_0/hn/bias": (8,)}
    return {
        name.replace("/", joint): rng.random(shape, np.float32) for name, shape in shapes.items()
    }


def write_zoo(folder: Path, version: int = 1, **changes: Any) -> Path:
    """Write a zoo with four policies; `changes` replace whole columns of its index."""
    for name in ("config", "params"):
        (folder / name).mkdir(parents=True)
    rows = []
    for number, uuid in enumerate(UUIDS):
        recurrent, role = number >= 2, ("robot", "human")[number % 2]
        scenario = ("scratchitch", "scratchitch", "bedbathing", "armmanipulation")[number]
        row: dict[str, Any] = {
            "agent_uuid": uuid,
            "scenario": scenario,
            "scenario_agent_id": role,
            "algorithm": ("IPPO", "MASAC")[number % 2],
            "is_rnn": str(recurrent),
            "rnn_dim": 8 if recurrent else "",
        }
        if version == 2:
            row |= {
                "team_uuid": f"team-{number // 2}",
                "w_speed": 1.0,
                "w_force": 0.5,
                "w_touch": "",
            }
        rows.append({**row, **changes})
        disability = "" if number == 3 else DISABILITY.format(joint=[3, 4] if number else 3)
        width = "gru_hidden_dim" if recurrent else "actor_hidden_dim"
        values = {
            "algorithm": row["algorithm"],
            "scenario": scenario,
            "recurrent": str(recurrent).lower(),
        }
        config = CONFIG.format(disability=disability, width=width, **values)
        (folder / "config" / f"{uuid}.yaml").write_text(config)
        data = safetensors.numpy.save(
            leaves(recurrent, "," if number == 1 else "/", number), {"format": "np"}
        )
        (folder / "params" / f"{uuid}.safetensors").write_bytes(data)
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0].keys())
    writer.writeheader()
    writer.writerows(rows)
    (folder / "index.csv").write_text(text.getvalue())
    return folder


def pack(folder: Path, archive: Path, prefix: str = "zoo/") -> Path:
    """Pack a zoo's folder as the public release does."""
    with tarfile.open(archive, "w:gz") as tar:
        tar.add(folder, prefix.rstrip("/") or ".")
    return archive


def member(name: str, data: bytes = b"", kind: bytes = tarfile.REGTYPE, target: str = "") -> tuple:
    info = tarfile.TarInfo(name)
    info.type, info.linkname, info.size = kind, target, len(data)
    return info, io.BytesIO(data)


def pack_members(archive: Path, *members: tuple) -> Path:
    with tarfile.open(archive, "w:gz") as tar:
        for info, data in members:
            tar.addfile(info, data)
    return archive
