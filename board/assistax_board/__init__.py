"""The evaluation service: submit a robot, and be scored on partners that nobody has.

Read in this order: `vocabulary` (the words), `schema` (the tables), `queries` (what pages and the
API may ask), `submissions` and `jobs` (how a submission comes to its end), `api` and `worker` (who
drives that).
"""
