"""Run a robot in its own process, so that its modules and its failures cannot harm a run."""

import os
import subprocess
import sys
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.cast import policy_worker

_HERE = Path(__file__).resolve().parent
# This project's packages: they belong to the environment's version, not to the robot's code.
_OURS = ("assistax_envs", "population", "zoo", "evaluation", "assistax_zoo")
# One thread for each library. A robot's network is small, and idle threads that spin would slow the
# simulation.
_THREADS = {
    **dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"),
    "OMP_WAIT_POLICY": "PASSIVE",
}
_UNKNOWN_FORM = "the robot's process answers in no form that is known"


class PolicyError(Exception):
    """The robot's code failed; the message is one line."""


class PolicyProcess:
    """A callable from observations [N, O] to actions [N, A] in a process that ends with it."""

    def __init__(self, module: str, factory: str, arguments: Mapping[str, str]) -> None:
        """Start the process and make the robot.

        Args:
            module: A module's name, or the path of its file, which ends in .py.
            factory: The name of the module's function that makes the robot.
            arguments: Keyword arguments of the factory.

        Raises:
            PolicyError: The robot cannot be made.
        """
        folder = str(Path(module).resolve().parent) if module.endswith(".py") else os.getcwd()
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(_HERE / "policy_worker.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**_THREADS, **os.environ},
        )
        self._end = weakref.finalize(self, _end, self._process)
        made, _ = self._ask(
            {
                "do": "load",
                "module": module,
                "factory": factory,
                "arguments": dict(arguments),
                # A module of this project: its errors name no line of code, and it has metadata.
                "plain": _HERE in Path(module).resolve().parents,
                "path": list(dict.fromkeys([folder, os.getcwd(), *sys.path])),
                "foreign": [str(_HERE.parent / name) for name in _OURS],
            }
        )
        # The files of its code, with the sha256 of the bytes that ran.
        self.files = _one_hash_each(made["files"])
        # The files that its arguments name and its module declares, with the sha256 from before the
        # robot was made.
        self.inputs = [(Path(path), str(digest)) for path, digest in made["inputs"]]
        self.declares: bool = made["declares"]  # whether its module has the list `DEPENDS`
        self.trained_with: Any = made["trained_with"]  # `TRAINED_WITH` of its module, or None
        self.metadata: str | None = made["metadata"]  # an ONNX file's untrusted JSON

    def reset(self, rows: int) -> None:
        """Begin `rows` episodes."""
        self._ask({"do": "reset", "rows": rows})

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return the robot's actions [N, A] for observations [N, O]."""
        _, answer = self._ask({"do": "act"}, obs)
        if answer is None:
            raise PolicyError(_UNKNOWN_FORM)
        return answer

    def loaded(self) -> dict[Path, str]:
        """Return the files of the robot's own code that ran until now, each with its sha256.

        Raises:
            PolicyError: A file ran twice and was changed in between, or the reply is malformed.
        """
        reply, _ = self._ask({"do": "loaded"})
        try:
            return _one_hash_each(reply["files"])
        except (KeyError, TypeError, ValueError, AttributeError):
            raise PolicyError(_UNKNOWN_FORM) from None

    def close(self) -> None:
        """End the process."""
        self._end()

    def _ask(
        self, header: dict[str, Any], obs: np.ndarray | None = None
    ) -> tuple[dict[str, Any], np.ndarray | None]:
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            policy_worker.send(self._process.stdin, header, obs)  # ty: ignore[invalid-argument-type]
            reply, answer = policy_worker.receive(
                self._process.stdout,  # ty: ignore[invalid-argument-type]
                policy_worker.LARGEST_ANSWER,
            )
        except (EOFError, BrokenPipeError):
            self.close()
            code = self._process.returncode
            raise PolicyError(f"the robot's process ended by itself, with code {code}") from None
        except (ValueError, TypeError, KeyError):
            self.close()
            raise PolicyError(_UNKNOWN_FORM) from None
        except BaseException:
            # After Ctrl-C in the middle of a message, the stream cannot be read further.
            self.close()
            raise
        if not isinstance(reply, dict):
            self.close()
            raise PolicyError(_UNKNOWN_FORM)
        if "error" in reply:
            raise PolicyError(policy_worker.one_line(str(reply["error"])))
        return reply, answer


def _one_hash_each(files: Mapping[str, list[str]]) -> dict[Path, str]:
    for path, digests in files.items():
        if len(digests) > 1:
            raise PolicyError(f"{path} was loaded twice and changed in between; play it again")
    return {Path(path): str(digest) for path, [digest] in files.items()}


def _end(process: subprocess.Popen) -> None:
    with process:  # closes the pipes, then waits
        if process.poll() is None:
            process.kill()
