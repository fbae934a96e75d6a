"""Tasks: a folder for each, whose `TASK` is a `kind.TaskKind`; and what they share."""
