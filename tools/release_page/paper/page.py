"""The whole page: sections in order, hand-written reasons in their places."""

from tools.release_page.data import Played
from tools.release_page.making import costs
from tools.release_page.markdown import spoken
from tools.release_page.paper import population, sections
from tools.release_page.paper.claims import check_claims
from tools.release_page.paper.data import Results

_NO_REASONS = ("summary", "made")  # sections that set nothing beside the paper's figures


def make_page(results: Results, pictures: str, command: str) -> str:
    """Return the page as Markdown.

    Args:
        results: what there is of the release.
        pictures: folder of the figures, relative to the page.
        command: the command that makes the page, for its last section.
    """
    claims = check_claims(results)

    def picture(name: str) -> str:
        return f"{pictures}/{name}"

    parts = {
        "summary": ("In short", sections.summary(results, claims)),
        "population": (
            "The population: Table 6 and Figure 2",
            population.population(results, picture),
        ),
        "self-play": ("Self-play: Table 2", sections.self_play(results)),
        "curves": ("Learning curves: Figure 3", sections.curves(results, picture)),
        "cross-play": ("Cross-play: Figures 4 and 5", sections.cross_play(results, picture)),
        "zsc": ("Zero-shot coordination: Figures 6 and 14", sections.zero_shot(results, picture)),
        "claims": ("The paper's claims, criterion by criterion", sections.claim_table(claims)),
        "made": ("How this was made", _made(results, command)),
    }
    texts = [_head(results)]
    for key, (title, text) in parts.items():
        note = results.notes.get(key)
        label = "Note" if key in _NO_REASONS else "Why"
        texts.append(f"## {title}\n\n{text}" + (f"\n\n**{label}.** {note}" if note else ""))
    return "\n\n".join(texts) + "\n"


def tables(results: Results) -> dict[str, str]:
    """Return the files beside the page: none, it holds all of its tables."""
    return {}


def _head(results: Results) -> str:
    return (
        f"# Release {results.release} beside the paper\n\n"
        f"Our figures beside those of *{results.paper['source']}*. IQM and 95% bootstrap interval "
        "unless it says otherwise. This page is made from committed tables by the command at its "
        "end; only what begins with **Why** or **Note** is written by hand. In these tables all "
        "partners played the same starts, so no interval here speaks of other starts."
    )


def _made(results: Results, command: str) -> str:
    """Return device minutes of every part, then the commands; `command` makes the page."""
    named: dict[str, Played] = {
        f"cross-play of {spoken(task)}": played for task, played in results.crossplay.items()
    }
    named |= {
        f"evaluation of {m.upper()} egos, {spoken(t)}": egos
        for (t, m), egos in results.egos.items()
    }
    trained = {
        f"{spoken(task)} {method.upper()} egos": egos.training
        for (task, method), egos in results.egos.items()
        if egos.training
    }
    return costs(results.humans, trained, named, command)
