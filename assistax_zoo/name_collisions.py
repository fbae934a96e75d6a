"""Refusal of the user's modules that would be imported in place of ours."""

import importlib.machinery
import sys
from pathlib import Path

NAMES = ("assistax_envs", "population", "zoo", "evaluation")
_ROOT = Path(__file__).resolve().parent.parent


def refuse_shadows() -> None:
    """Refuse a file or folder that Python would import in place of one of our packages.

    Raises:
        ImportError: Names it. Without this, something of ours would be missing in something of
            theirs, much later.
    """
    for name in NAMES:
        module = sys.modules.get(name)
        spec = module.__spec__ if module else importlib.machinery.PathFinder.find_spec(name)
        if spec is None or spec.origin is None:
            places = list(spec.submodule_search_locations or ()) if spec else []
            place = Path(places[0]) if places else None
        else:
            place = Path(spec.origin)
            place = place.parent if place.name == "__init__.py" else place
        if place is not None and place.resolve() != _ROOT / name:
            raise ImportError(
                f"{place} has the name of a package of assistax-zoo, and Python imports it instead "
                "of ours; rename it, or start Python in another folder"
            )
