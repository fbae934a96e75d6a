"""Import of optional packages, with an error that names their extra."""

import importlib
from typing import Any


def optional(module: str, purpose: str, extra: str) -> Any:
    """Return a module of a package that need not be installed.

    Raises:
        ValueError: It is not installed. The error says its purpose and how to install it.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        package = module.partition(".")[0].replace("_", "-")
        raise ValueError(
            f"{purpose} needs the package {package}; install it with: pip install "
            f"'assistax-zoo[{extra}]'"
        ) from None
