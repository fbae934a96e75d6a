"""The results of a release beside the paper's: a page made from small tables, and how those are condensed."""
