"""The evaluation service: robots are submitted, and scored on hidden partners.

Read in this order: `vocabulary` (the words), `schema` (the tables), `queries` (what pages and the
API may ask), `submissions` and `jobs` (how a submission comes to its end), `api` and `worker` (who
drives that).
"""
