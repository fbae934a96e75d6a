"""The command that ranks the numbers of persons by their effect on robots."""

from pathlib import Path
from typing import Any

from assistax_zoo.shell.console import answer, stdout_is_data


def persons(
    folder: Path,
    /,
    *,
    over: str | None = None,
    bins: int = 5,
    most: int = 5,
    out: Path | None = None,
    json: bool = False,
) -> None:
    """Say which of the numbers of persons matter most for the robots of a folder.

    By each number persons are sorted into bins of equal counts. A number's share is how much of the
    variance of persons' mean returns, or of their safe successes, lies between its bins, beyond
    chance (omega squared). Intervals resample persons.

    Args:
        folder: Folder that `assistax-zoo evaluate --partners persons --out` filled.
        over: Two numbers for a surface of both outcomes, such as strength,liked_force; default the
            two that matter most for the return.
        bins: Bins of each number.
        most: How many numbers to show.
        out: Figure to write, .png, .pdf or .svg.
        json: Print JSON.

    Example:
        assistax-zoo persons results/ppo --over strength,liked_force --out persons.png
    """
    with stdout_is_data():
        from evaluation.plots.figures import persons_figure
        from evaluation.record.record import Record
        from evaluation.record.verification import check_whole

        check_whole(folder)
        summary = _summary(Record.read(folder), over, bins, most)
        if out is not None:
            persons_figure(summary, out)
    answer(json, summary, *_lines(summary), *([str(out)] if out else []))


def _summary(record: Any, over: str | None, bins: int, most: int) -> dict[str, Any]:
    from evaluation.figures.by_parameter import summarise_parameters

    return summarise_parameters(record, over.split(",") if over else (), bins=bins, most=most)


def _lines(summary: dict[str, Any]) -> list[str]:
    lines = [
        f"{summary['task']}: {summary['persons']} persons, robots {summary['egos']}, "
        f"episodes {summary['episodes']}"
    ]
    for outcome, matter in summary["matter"].items():
        digits = 1 if outcome == "return" else 3
        name = outcome.replace("_", " ")
        lines.append(
            f"{name} {summary['means'][outcome]:.{digits}f}; of its variance over persons (chance "
            f"{matter['chance']:.1%}), and highest minus lowest of {summary['bins']} bins:"
        )
        lines += [_effect_line(effect, digits) for effect in matter["parameters"]]
    surface = summary["surface"]
    lines.append(f"mean return over {surface['x']} (down) and {surface['y']} (across):")
    lines.append(" " * 17 + "".join(f"{edge:>9.3g}+" for edge in surface["y_edges"][:-1]))
    rows = zip(surface["x_edges"], surface["values"]["return"], surface["count"], strict=False)
    for edge, means, counts in rows:
        cells = (
            f"{mean:>6.0f} ({count})" if mean is not None else "-"
            for mean, count in zip(means, counts, strict=True)
        )
        lines.append(f"{edge:>14.3g}+  " + "".join(f"{cell:>10}" for cell in cells))
    return lines


def _effect_line(effect: dict[str, Any], digits: int) -> str:
    low, high = effect["share_ci"]
    step, ends = effect["low_to_high"], effect["low_to_high_ci"]
    return (
        f"  {effect['parameter']:17} {effect['share']:6.1%} [{max(low, 0):.1%}, {max(high, 0):.1%}]"
        f"   {step:+.{digits}f} [{ends[0]:+.{digits}f}, {ends[1]:+.{digits}f}]"
    )
