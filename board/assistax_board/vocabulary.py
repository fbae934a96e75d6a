"""The fixed words of the service: states, reasons and scopes.

Whatever a submitter reads about a submission is chosen from these tables. Free text could carry a
value of a hidden partner; a word of a table cannot.
"""

from typing import Literal

SubmissionState = Literal["queued", "running", "scored", "refused", "failed", "retracted"]
SeasonState = Literal["draft", "open", "closing", "closed"]
Kind = Literal["file", "reference"]  # a reference is nobody's: zero actions, a script
AttemptState = Literal["free", "reserved", "spent", "refunded"]
Scope = Literal["submit", "work", "organise"]

BACKEND = "fused"  # what a service plays with, if no other is named
# Where commands find the server and the token that no option names.
SERVER_VARIABLE, TOKEN_VARIABLE = "ASSISTAX_ZOO_SERVER", "ASSISTAX_ZOO_TOKEN"

PEOPLE = "people"  # the ledger's word for accepted logs of people
REFERENCE = "reference"  # the submitter of rows that others are measured by
GONE_STATES: tuple[SubmissionState, ...] = ("refused", "failed", "retracted")  # that no board has
FINAL_STATES: tuple[SubmissionState, ...] = ("scored", *GONE_STATES)
SCOPES: tuple[Scope, ...] = ("submit", "work", "organise")

# Why a submission was refused: something about the file, which the submitter can mend.
REFUSALS = {
    "too_large": "the file is larger than 16 MiB",
    "unknown_format": "the file is neither .safetensors of this project nor ONNX",
    "malformed": "the file is damaged, or is not what its format says",
    "wrong_role": "the policy is not one of a robot",
    "wrong_sizes": "its observations or actions have another width than this task's",
    "wrong_parameters": "its parameters are not those of its spec",
    "not_finite": "it holds or returns numbers that are not finite",
    "wrong_interface": "its inputs and outputs are not obs [N, O] (carry [N, H], first [N]) and "
    "action [N, A] (next carry [N, H])",
    "operator_not_allowed": "it uses an operator, or a form of one, that is not on the list",
    "opset_not_allowed": "it uses operator sets other than the standard one, 13 to 22",
    "external_data": "it keeps weights outside of the file; PyTorch writes one file with "
    "external_data=False",
    "subgraph": "it has functions or subgraphs",
    "graph_too_large": "it has too many nodes, or values that are too large",
    "shape_unknown": "a shape depends on something other than the number of rows",
    "too_slow": "it takes more seconds or memory than a robot may",
}

# Why a submission failed.
FAILURES = {
    "worker_errors": "the workers failed several times; ask the organiser",
    "withdrawn": "its submitter took it back",
    "season_closed": "the season closed before it was played",
    "entry_incomplete": "another file of its declared entry was refused; declare the entry again",
    "disqualified": "the organiser disqualified its lab; ask the organiser",
    "broke_down": "it returned numbers that are not finite to hidden partners",
}
# Failures by the robot's own doing: after it met hidden partners they cost the attempt, or each
# would be a free answer about them.
OWN_FAILURES = ("withdrawn", "broke_down")
REASONS = {**REFUSALS, **FAILURES}
