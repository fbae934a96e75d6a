"""Help texts of the groups of commands."""

TOKEN = "Who may use an evaluation service."
SUBMISSION = "What you have handed in to an evaluation service."
SEASON = "Hidden partners of an evaluation service."
RECEIPT = "Signed scores."
LEDGER = "Everything that happened on an evaluation service."
SERVICE = "Care of an evaluation service's data."
