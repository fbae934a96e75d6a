"""Which kind of partner a user asks for, by words, ids and globs."""

from collections.abc import Sequence

from assistax_base.errors import nearest
from zoo.partners.source import PartnerSource


def asked_source(
    sources: Sequence[PartnerSource], split: str | None, texts: Sequence[str]
) -> PartnerSource | None:
    """Return the kind that is asked for by name; None if teams or default partners are meant.

    Teams may be named beside a kind that plays with them.

    Args:
        sources: All kinds, teams first.
        split: Name of a split, with or without a side.
        texts: Words, and ids or globs over partners.

    Raises:
        ValueError: The texts are of several kinds, or one can be of no partner.
    """
    made = sources[1:]
    asked = {text: _source_of(made, text) for text in texts}
    words = [source.word for source in made]
    others = [text for text, source in asked.items() if source is None]
    if odd := [text for text in others if not set(text) & set("/*?[")]:
        near = ", ".join(nearest(odd[0], words)) or "an id of `assistax-zoo list`"
        meant = f"split {odd[0]!r}" if ":" in odd[0] else near
        raise ValueError(
            f"partners are {odd[0]!r}; allowed are {', '.join(map(repr, words))}, and ids and "
            f"globs over partners, such as 'scratch/ippo-d9-*'; did you mean {meant}?"
        )
    named = {source for source in asked.values() if source}
    apart = [source for source in named if not source.with_teams]
    if len(named) > 1 or (others and apart):
        kinds = [(text, source) for text, source in asked.items() if source]
        first, kind = min(kinds, key=lambda pair: pair[1].with_teams)
        beside = next(text for text, source in asked.items() if source is not kind)
        reason = "have their own preferences" if kind.own_preferences else "are of another kind"
        raise ValueError(
            f"partners are {first!r} beside {beside!r}; {kind.word} {reason}, so play them in "
            "a separate job"
        )
    if named:
        return named.pop()
    return next((source for source in made if source.names_split(split or "")), None)


def _source_of(sources: Sequence[PartnerSource], text: str) -> PartnerSource | None:
    """Return the kind that a word, an id or a glob names; None for teams."""
    return next((s for s in sources if text == s.word or s.owns(text)), None)
