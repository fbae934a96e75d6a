"""Names of the page's figures, without drawing them."""

from assistax_envs.versions import PAPER_TASKS
from tools.paper_page.data import METHODS, Results


def picture_names(results: Results) -> list[str]:
    """Return the files that the data allow to draw."""
    names = ["population.png"] if results.humans else []
    names += ["curves.png"] if results.has_curves else []
    names += [f"crossplay_{task}.png" for task in PAPER_TASKS if task in results.crossplay]
    return names + [
        f"zsc_{task}.png"
        for task in PAPER_TASKS
        if any((task, method) in results.egos for method in METHODS)
    ]
