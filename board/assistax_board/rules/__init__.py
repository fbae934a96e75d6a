"""The board's rules: submissions, jobs, scores, seasons."""
