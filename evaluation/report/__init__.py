"""One self-contained page about a finished evaluation or cross-play."""

from evaluation.report.page import write_report

__all__ = ["write_report"]
